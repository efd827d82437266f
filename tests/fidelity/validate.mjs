// Prints the errors that the glTF validator finds in the files given; the exit code is 1 if there are any.
import {createRequire} from 'node:module';
import {dirname, resolve} from 'node:path';
import {readFileSync} from 'node:fs';

const validator = createRequire(resolve('package.json'))('gltf-validator');
let errors = 0;
for (const file of process.argv.slice(2)) {
  const external = (uri) => Promise.resolve(new Uint8Array(readFileSync(resolve(dirname(file), decodeURIComponent(uri)))));
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), {uri: file, externalResourceFunction: external});
  for (const {severity, code, message, pointer} of report.issues.messages) {
    if (severity > 0) continue;  // a warning, also about the original of a copy
    console.log(`${file}: ${code}: ${message} (${pointer ?? 'file'})`);
    ++errors;
  }
}
process.exit(errors > 0 ? 1 : 0);
