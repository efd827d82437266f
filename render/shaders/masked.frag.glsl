// What a shadow's layer leaves of the picture on a surface, by shadow_mask.glsl.
in vec3 place;
in vec3 facing;

layout(location = 0) out vec4 factor;

uniform vec3 eye;  // table frame

void main() {
  vec3 view = eye - place;
  vec3 n = normalize(facing);
  if (dot(n, view) < 0.0 && !gl_FrontFacing) n = -n;  // the inside of an open surface
  float left = left_under_mask(place, n);
  if (left > 1.0) discard;
  factor = vec4(vec3(left), 1.0);
}
