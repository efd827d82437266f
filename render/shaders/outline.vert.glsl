// A plane's outline, drawn into the stencil.
layout(location = 0) in vec2 position;  // (u, v) on the plane [m]
uniform mat4x3 camera_from_plane;

void main() {
  gl_Position = lens_clip(camera_from_plane * vec4(position, 0.0, 1.0), 1.0);
}
