// A shadow field's rectangle on its plane, as a grid fine enough to follow the lens.
layout(location = 0) in vec2 corner;  // 0 .. 1

uniform vec4 field_rect;      // first texel's centre, vector to the last texel's centre [m]
uniform vec2 field_last;      // index of the last texel
uniform vec4 plane_from_own;  // PlanarMotion of the field: cosine, sine, translation [m]
uniform mat4x3 camera_from_plane;

out vec2 texel;

void main() {
  texel = corner * field_last;
  vec2 p = field_rect.xy + corner * field_rect.zw;
  vec2 uv = vec2(plane_from_own.x * p.x - plane_from_own.y * p.y,
                 plane_from_own.y * p.x + plane_from_own.x * p.y) + plane_from_own.zw;
  gl_Position = shadow_clip(camera_from_plane, uv);
}
