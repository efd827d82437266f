// A piece of a black strip on a plane. Strips repeat every strip.x, their pieces every strip.z.
layout(location = 0) in vec2 corner;  // 0 .. 1, across and along

uniform mat4x3 camera_from_plane;
uniform int first_strip;
uniform int first_piece;
uniform int pieces;  // number per strip
uniform vec3 strip;  // period, width, length of a piece [m]

void main() {
  int across = first_strip + gl_InstanceID / pieces;
  int along = first_piece + gl_InstanceID % pieces;
  vec2 uv = vec2(float(across) * strip.x + corner.x * strip.y,
                 (float(along) + corner.y) * strip.z);
  gl_Position = shadow_clip(camera_from_plane, uv);
}
