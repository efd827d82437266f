// Light from the upper half of the room, less and warmer from the table below, on a surface whose
// normal's third coordinate is `up`.
vec3 hemisphere(vec3 ambient, float up) {
  vec3 sky = ambient * vec3(1.08, 1.12, 1.18);
  vec3 ground = ambient * vec3(0.52, 0.49, 0.45);
  return mix(ground, sky, clamp(0.5 + 0.5 * up, 0.0, 1.0));
}
