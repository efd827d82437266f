// make_models FOLDER: writes the bundled models (scenes/models/*.glb).
#include <cstdio>
#include <filesystem>

#include "core/text/text.hpp"
#include "tools/models/bundled_models.hpp"
#include "tools/models/glb_writer.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: make_models FOLDER\n", stderr);
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  for (const penumbra::Model& model : penumbra::models::make_bundled_models()) {
    const auto bytes = penumbra::models::encode_glb(model);
    const auto written =
        bytes ? penumbra::write_file(folder / (model.name + ".glb"), *bytes)
              : penumbra::Result<void>(tl::unexpected<penumbra::Error>(bytes.error()));
    if (!written) {
      std::fprintf(stderr, "make_models: %s\n", written.error().message.c_str());
      return 1;
    }
    std::size_t vertices = 0;
    std::size_t triangles = 0;
    for (const penumbra::Mesh& mesh : model.meshes) {
      vertices += mesh.positions.size();
      triangles += mesh.indices.size() / 3;
    }
    std::printf("%-24s %6zu vertices %6zu triangles %8zu bytes\n", model.name.c_str(), vertices,
                triangles, bytes->size());
  }
  return 0;
}
