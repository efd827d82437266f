// A corner of a light ray's ribbon, or of a dot; both have a constant width in the image.
layout(location = 0) in vec3 table_point;  // table frame [m]
layout(location = 1) in vec3 direction;  // table frame; zero: a dot
layout(location = 2) in vec2 corner;
layout(location = 3) in vec3 color;

uniform mat4x3 camera_from_table;
uniform vec2 half_width;  // half widths of ribbon and dot, divided by the depth

// Several programs must give a ray exactly the same depth.
invariant gl_Position;

out vec3 tint;
out vec2 from_middle;  // length 1 at a dot's rim; 0 in a ribbon

void main() {
  tint = color;
  vec3 p = camera_from_table * vec4(table_point, 1.0);
  float depth = abs(p.z);
  if (dot(direction, direction) > 0.0) {
    vec3 side = cross(camera_from_table * vec4(direction, 0.0), p);
    float size = length(side);
    if (size > 0.0) p += side / size * (corner.x * half_width.x * depth);
    from_middle = vec2(0.0);
    // Drawn slightly nearer, to be visible on surfaces; dots are nearer than rays.
    gl_Position = lens_clip(p, 0.998);
  } else {
    p.xy += corner * half_width.y * depth;
    from_middle = corner;
    gl_Position = lens_clip(p, 0.99);
  }
}
