// What is left of the encoded picture where several lights do not arrive, from their shares added
// up.
uniform sampler2D sums;  // rgb: share of all light, linear, times strength; a: greatest strength
uniform float encoding;  // of the video: encoded = linear ^ encoding
layout(location = 0) out vec4 color;

void main() {
  vec4 sum = texelFetch(sums, ivec2(gl_FragCoord.xy), 0);
  vec3 left = clamp(1.0 - sum.rgb / max(sum.a, 1.0e-3), 0.0, 1.0);
  // Linear light -> factor for the video's encoded value.
  vec3 encoded = pow(left, vec3(encoding));
  color = darkened(1.0 - sum.a * (1.0 - encoded));
}
