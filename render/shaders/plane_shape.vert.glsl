// A shape on a plane.
layout(location = 0) in vec2 position;  // (u, v) on the plane [m]
uniform mat4x3 camera_from_plane;

void main() {
  gl_Position = shadow_clip(camera_from_plane, position);
}
