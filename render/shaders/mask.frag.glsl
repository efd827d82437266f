// Darkens by a mask's value. `centroid` keeps samples inside the drawn piece of the mask, because
// the next piece may be skipped.
centroid in vec2 texel;
uniform sampler2D mask;
layout(location = 0) out vec4 color;

void main() {
  float light_left = texture(mask, texel).r;
#if defined(SCREEN_DOOR)
  // The mask has the fraction of open pixels, interpolated at edges.
  color = darkened_by_layer(floor(16.0 * (1.0 - light_left) + 0.5));
#else
  color = darkened_by_layer(light_left);
#endif
}
