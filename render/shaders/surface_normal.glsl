// Returns the unit normal of the visible side, or `view` if the surface has no normal. `view`: unit
// vector to the eye.
vec3 surface_normal(vec3 normal, vec3 view) {
  float normal_length = length(normal);
  vec3 n = normal_length > 0.0 ? normal / normal_length : view;
  return dot(n, view) < 0.0 && !gl_FrontFacing ? -n : n;
}
