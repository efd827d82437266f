// Every pixel that the stencil lets through.
uniform vec3 light_left;  // of the encoded value
layout(location = 0) out vec4 factor;

void main() {
  factor = vec4(light_left, 1.0);  // blended: video * factor
}
