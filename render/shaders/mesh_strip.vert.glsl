// A piece of a black strip on a plane: strips lie at whole multiples of a period, pieces at those of
// their length, so that a piece is the same whichever others are drawn.
layout(location = 0) in vec2 corner;  // 0 .. 1, across and along

uniform mat4x3 camera_from_plane;
uniform int first_strip;
uniform int first_piece;
uniform int pieces;  // of each strip
uniform vec3 strip;  // period, width, length of a piece [m]

void main() {
  int across = first_strip + gl_InstanceID / pieces;
  int along = first_piece + gl_InstanceID % pieces;
  vec2 place = vec2(float(across) * strip.x + corner.x * strip.y,
                    (float(along) + corner.y) * strip.z);
  gl_Position = lens_clip(camera_from_plane * vec4(place, 0.0, 1.0), 1.001);
}
