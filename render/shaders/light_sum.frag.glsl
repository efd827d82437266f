// Darkens the encoded image by the sum of several lights' blocked fractions.
uniform sampler2D sums;  // rgb: sum of opacity * blocked linear fraction; a: max. opacity
uniform float encoding;  // exponent of the video: encoded = linear ^ encoding
layout(location = 0) out vec4 color;

void main() {
  vec4 sum = texelFetch(sums, ivec2(gl_FragCoord.xy), 0);
  vec3 light_left = clamp(1.0 - sum.rgb / max(sum.a, 1.0e-3), 0.0, 1.0);
  // Factor on the encoded value.
  vec3 encoded = pow(light_left, vec3(encoding));
  color = darkened(1.0 - sum.a * (1.0 - encoded));
}
