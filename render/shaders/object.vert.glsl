layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 color;

uniform mat4x3 table_from_object;
uniform mat4x3 camera_from_object;

out vec3 place;  // table frame [m]
out vec3 facing;
out vec2 surface;
out vec4 tint;

// Drawn again by another program, a surface has the same depth.
invariant gl_Position;

void main() {
  place = table_from_object * vec4(position, 1.0);
  facing = table_from_object * vec4(normal, 0.0);
  surface = texcoord;
  tint = color;
  gl_Position = lens_clip(camera_from_object * vec4(position, 1.0), 1.0);
}
