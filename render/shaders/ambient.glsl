// Hemisphere light: from the room above and the table below. `up`: z of the surface's unit normal.
uniform vec3 sky_light;
uniform vec3 ground_light;

vec3 hemisphere(float up) {
  return mix(ground_light, sky_light, clamp(0.5 + 0.5 * up, 0.0, 1.0));
}
