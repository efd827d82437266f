// Darkens a plane by the light that shadow casters block.
in vec2 view;

uniform vec3 inverse_depth;  // see receiver.vert.glsl
uniform mat3 table_from_camera;
uniform vec3 eye;       // table frame [m]
uniform vec3 normal;    // unit normal of the plane
uniform float opacity;  // shadow opacity
uniform int add_up;     // 1: writes the blocked fraction, for light_sum.frag.glsl

layout(location = 0) out vec4 color;

void main() {
  vec3 ray = vec3(view, 1.0);
  vec3 point = eye + table_from_camera * ray / max(dot(inverse_depth, ray), 1.0e-6);
  color = darkening(blocked_share(point, normal), opacity, add_up != 0);
}
