// A mask's rectangle on its plane, as a grid fine enough to follow the lens.
layout(location = 0) in vec2 corner;  // 0 .. 1

uniform vec4 mask_rect;  // corner, extents [m]
uniform mat4x3 camera_from_plane;

centroid out vec2 texel;  // 0 .. 1 over the mask

void main() {
  texel = corner;
  gl_Position = shadow_clip(camera_from_plane, mask_rect.xy + corner * mask_rect.zw);
}
