// Shadows that fall along a plane's normal, as pictures of what they leave of the encoded light, one
// for each of several heights above the plane.
uniform sampler2DArray shadow_mask;
uniform mat4x3 mask_from_table;  // -> (u, v, h)
uniform vec3 mask_normal;        // of the plane, table frame
uniform vec2 mask_origin;        // (u, v) in the pictures' corner [m]
uniform vec2 mask_extent;        // [m]
uniform vec4 mask_levels[4];     // heights [m], ascending
uniform int mask_count;

float mask_level(int i) {
  return mask_levels[i / 4][i % 4];
}

// The encoded factor for a surface at `place` that faces `normal`; 1 where there is no shadow.
float left_under_mask(vec3 place, vec3 normal) {
  vec3 p = mask_from_table * vec4(place, 1.0);
  float facing = dot(mask_normal, normal);
  vec2 at = (p.xy - mask_origin) / mask_extent;
  if (facing <= 0.0 || p.z < -1.0e-4) return 1.0;
  int above = 0;  // the lowest level that is no lower than the place
  while (above < mask_count - 1 && mask_level(above) < p.z) ++above;
  float left = texture(shadow_mask, vec3(at, float(above))).r;
  if (above > 0) {
    float low = mask_level(above - 1);
    float part = clamp((p.z - low) / (mask_level(above) - low), 0.0, 1.0);
    left = mix(texture(shadow_mask, vec3(at, float(above - 1))).r, left, part);
  }
  // The share of light that is lost is the light's own, by Lambert's law.
  float lost = (1.0 - pow(left, 2.2)) * min(facing, 1.0);
  return pow(max(1.0 - lost, 0.0), 1.0 / 2.2);
}
