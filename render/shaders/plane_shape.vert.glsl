// A shape on a plane -> its place in the picture.
layout(location = 0) in vec2 position;  // (u, v) on the plane [m]
uniform mat4x3 camera_from_plane;

void main() {
  // 0.1 % farther in depth, as the layers of shadow.vert.glsl.
  gl_Position = lens_clip(camera_from_plane * vec4(position, 0.0, 1.0), 1.001);
}
