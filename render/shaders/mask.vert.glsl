// A mask's rectangle, in a grid fine enough to follow the lens -> its place in the picture.
layout(location = 0) in vec2 corner;  // 0 .. 1

uniform vec4 mask_rect;  // corner, then extents [m]
uniform mat4x3 camera_from_plane;

centroid out vec2 texel;

void main() {
  texel = corner;
  // 0.1 % farther in depth, as the layers of shadow.vert.glsl.
  gl_Position = lens_clip(camera_from_plane * vec4(mask_rect.xy + corner * mask_rect.zw, 0.0, 1.0),
                          1.001);
}
