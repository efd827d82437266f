// A shadow along a plane's normal: masks at several heights above the plane. Channels: coverage of
// the texel by umbra, middle and penumbra.
uniform sampler2DArray shadow_mask;
uniform vec3 mask_light_left;    // each layer's factor on the encoded image
uniform float encoding;          // exponent of the video: encoded = linear ^ encoding
uniform mat4x3 mask_from_table;  // -> (u, v, h)
uniform vec3 mask_normal;        // plane normal, table frame
uniform vec2 mask_origin;        // (u, v) of the masks' corner [m]
uniform vec2 mask_extent;        // [m]
uniform vec4 mask_levels[MAX_LEVELS / 4];  // heights [m], ascending
uniform int mask_count;
uniform float mask_step;         // surfaces farther above the highest level receive no shadow [m]
uniform float mask_level_width;  // no interpolation up to this height above a level [m]

float mask_level(int i) {
  return mask_levels[i / 4][i % 4];
}

// Returns the factor on the encoded value of a surface at `point` with the normal `normal`.
float light_left_under_mask(vec3 point, vec3 normal) {
  vec3 p = mask_from_table * vec4(point, 1.0);
  float facing = dot(mask_normal, normal);
  vec2 at = (p.xy - mask_origin) / mask_extent;
  if (facing <= 0.0 || p.z < -1.0e-4 || p.z > mask_level(mask_count - 1) + mask_step ||
      at != clamp(at, 0.0, 1.0))
    return 1.0;
  // Bisects for the lowest level that is not below the surface.
  int above = mask_count - 1;
  for (int low = 0; low < above;) {
    int middle = (low + above) / 2;
    if (mask_level(middle) < p.z)
      low = middle + 1;
    else
      above = middle;
  }
  vec3 cover = texture(shadow_mask, vec3(at, float(above))).rgb;
  // Interpolates between two levels, except within a level's width.
  if (above > 0) {
    float low = mask_level(above - 1);
    float high = mask_level(above);
    float lower_weight = clamp((high - p.z) / max(high - low - mask_level_width, 1.0e-4), 0.0, 1.0);
    cover = mix(cover, texture(shadow_mask, vec3(at, float(above - 1))).rgb, lower_weight);
  }
  // Lambert's law for the blocked light.
  vec3 lost = (1.0 - pow(mask_light_left, vec3(1.0 / encoding))) * min(facing, 1.0);
  vec3 dimming = 1.0 - pow(max(1.0 - lost, 0.0), vec3(encoding));
  // Each layer counts only where no darker layer covers the texel.
  cover.g = max(cover.g, cover.r);
  cover.b = max(cover.b, cover.g);
  float light_left = 1.0 - dot(vec3(cover.r, cover.g - cover.r, cover.b - cover.g), dimming);
  // Rounds to 8 bits, because the framebuffer's alpha does so with gathered values.
  return floor(255.0 * light_left + 0.5) / 255.0;
}
