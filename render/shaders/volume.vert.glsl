// A shadow volume's surface, for the stencil.
layout(location = 0) in vec3 position;  // table frame [m]
uniform mat4x3 camera_from_table;

void main() {
  gl_Position = lens_clip(camera_from_table * vec4(position, 1.0), 1.0);
}
