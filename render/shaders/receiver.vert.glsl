// An unbounded plane: a grid over the view, with each point at the plane's depth. 1 / depth is
// linear in undistorted coordinates, so the grid only has to follow the lens.
layout(location = 0) in vec2 corner;  // 0 .. 1

uniform vec4 view_rect;      // undistorted normalised coordinates: corner, extents
uniform vec3 inverse_depth;  // 1/z [1/m] = dot(inverse_depth, (x, y, 1)); <= 0: beyond the horizon

out vec2 view;

void main() {
  view = view_rect.xy + corner * view_rect.zw;
  vec4 clip = lens_clip(vec3(view, 1.0), 1.0);
  // 0.1 % farther, as in shadow_clip(). Points beyond the horizon are beyond the far plane.
  float z = lens_depth.x + lens_depth.y / 1.001 * dot(inverse_depth, vec3(view, 1.0));
  gl_Position = vec4(clip.xy, z, 1.0);
}
