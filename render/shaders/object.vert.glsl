layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in vec4 color;
#if defined(MATERIAL_MAPS)
layout(location = 4) in vec4 tangent;
layout(location = 5) in vec2 texcoord_2;
#endif

uniform mat4x3 table_from_object;
uniform mat4x3 camera_from_object;

out vec3 table_point;  // table frame [m]
out vec3 table_normal;
out vec2 uv;
out vec4 tint;
#if defined(MATERIAL_MAPS)
out vec4 table_tangent;  // w: as Mesh::tangents
out vec2 uv_2;
#endif

// Several programs must give a surface exactly the same depth.
invariant gl_Position;

void main() {
  table_point = table_from_object * vec4(position, 1.0);
  table_normal = table_from_object * vec4(normal, 0.0);
  uv = texcoord;
  tint = color;
#if defined(MATERIAL_MAPS)
  table_tangent = vec4(table_from_object * vec4(tangent.xyz, 0.0), tangent.w);
  uv_2 = texcoord_2;
#endif
  gl_Position = lens_clip(camera_from_object * vec4(position, 1.0), 1.0);
}
