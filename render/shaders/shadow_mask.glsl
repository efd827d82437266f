// A shadow that falls along a plane's normal, as pictures of where its layers lie, one for each of
// several heights above the plane.
uniform sampler2DArray shadow_mask;
uniform int mask_layer;          // the channel of the pictures; -1: of all the first one there
uniform vec3 mask_light_left;    // what the layers leave of the encoded picture
uniform float encoding;          // of the video: encoded = linear ^ encoding
uniform mat4x3 mask_from_table;  // -> (u, v, h)
uniform vec3 mask_normal;        // of the plane, table frame
uniform vec2 mask_origin;        // (u, v) in the pictures' corner [m]
uniform vec2 mask_extent;        // [m]
uniform vec4 mask_levels[MAX_LEVELS / 4];  // heights [m], ascending
uniform int mask_count;
uniform float mask_step;         // farther above all of them nothing receives [m]

float mask_level(int i) {
  return mask_levels[i / 4][i % 4];
}

// The encoded factor for a surface at `place` that faces `normal`; over 1 where it is not in the
// layer, or in any.
float left_under_mask(vec3 place, vec3 normal) {
  const float kNotInIt = 2.0;
  vec3 p = mask_from_table * vec4(place, 1.0);
  float facing = dot(mask_normal, normal);
  vec2 at = (p.xy - mask_origin) / mask_extent;
  if (facing <= 0.0 || p.z < -1.0e-4 || p.z > mask_level(mask_count - 1) + mask_step ||
      at != clamp(at, 0.0, 1.0))
    return kNotInIt;
  // The lowest level that is no lower than the place, by halving.
  int above = mask_count - 1;
  for (int low = 0; low < above;) {
    int middle = (low + above) / 2;
    if (mask_level(middle) < p.z)
      low = middle + 1;
    else
      above = middle;
  }
  int nearest = above;
  if (above > 0 && p.z - mask_level(above - 1) < mask_level(above) - p.z) nearest = above - 1;
  vec3 layers = texture(shadow_mask, vec3(at, float(nearest))).rgb;
  int layer = mask_layer;
  if (layer < 0) layer = layers.r >= 0.5 ? 0 : layers.g >= 0.5 ? 1 : 2;
  if (layers[layer] < 0.5) return kNotInIt;
  // The share of light that is lost is the light's own, by Lambert's law.
  float lost = (1.0 - pow(mask_light_left[layer], 1.0 / encoding)) * min(facing, 1.0);
  return pow(max(1.0 - lost, 0.0), encoding);
}
