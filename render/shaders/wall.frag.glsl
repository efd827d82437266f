// A virtual wall: a faint pane with the lines of a grid, which starts at its lower left corner.
in vec2 view;

uniform vec3 inverse_depth;      // see receiver.vert.glsl
uniform mat3 plane_from_camera;  // rotation
uniform vec3 eye;                // plane frame [m]
uniform vec4 wall_bounds;        // minimum and maximum (u, v) [m]
uniform float spacing;           // of the lines [m]
uniform float line_width;        // [px]
uniform float opacity;           // of the overlay

const vec4 kPane = vec4(0.80, 0.84, 0.88, 0.20);  // alpha: opacity
const vec4 kLine = vec4(0.20, 0.22, 0.26, 0.40);
const float kVanishing = 4.0;  // spacing at which lines vanish [px]; they fade from twice that

layout(location = 0) out vec4 color;

void main() {
  vec3 ray = vec3(view, 1.0);
  vec2 uv = eye.xy + (plane_from_camera * ray).xy / max(dot(inverse_depth, ray), 1.0e-6);
  vec2 along_x = dFdx(uv);
  vec2 along_y = dFdy(uv);
  vec2 pixel = max(sqrt(along_x * along_x + along_y * along_y), vec2(1.0e-9));  // [m]
  vec2 inside = min(uv - wall_bounds.xy, wall_bounds.zw - uv) / pixel;
  vec2 cells = (uv - wall_bounds.xy) / spacing;
  vec2 distance_to_line = min(abs(cells - floor(cells + 0.5)) * spacing / pixel, abs(inside));
  vec2 on_line = clamp(0.5 * line_width + 0.5 - distance_to_line, 0.0, 1.0);
  on_line *= clamp(spacing / (kVanishing * pixel) - 1.0, 0.0, 1.0);
  vec4 ink = mix(kPane, kLine, max(on_line.x, on_line.y));
  float at_edge = clamp(min(inside.x, inside.y) + 0.5, 0.0, 1.0);
  float share = ink.a * at_edge * opacity;
#if defined(SCREEN_DOOR)
  // Takes the pixels that a shadow darkens last.
  if (float(15 - dither_threshold()) >= floor(16.0 * share + 0.5)) discard;
  color = vec4(ink.rgb, 1.0);
#else
  color = mixed_in_by_alpha(ink.rgb, share);
#endif
}
