// What one layer of a shadow leaves of the picture; where it lies says the stencil.
layout(location = 0) out vec4 color;

uniform float light_left;  // of the encoded picture

void main() {
  color = darkened(vec3(light_left));
}
