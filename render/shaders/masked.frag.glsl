// What a shadow's layer leaves of the picture on a surface, by shadow_mask.glsl.
in vec3 place;
in vec3 facing;

layout(location = 0) out vec4 color;

uniform vec3 eye;  // table frame

void main() {
  float left = left_under_mask(place, surface_normal(facing, normalize(eye - place)));
  if (left > 1.0) discard;
  color = darkened(vec3(left));
}
