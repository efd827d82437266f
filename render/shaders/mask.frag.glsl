// Darkens by the darkest of several layers. `centroid`: skipped pieces next to this one draw nothing.
centroid in vec2 texel;
uniform sampler2D mask;
layout(location = 0) out vec4 color;

void main() {
  float left = texture(mask, texel).r;
#if defined(SCREEN_DOOR)
  // The mask holds the fraction of open places, on edges between its sides' values.
  color = darkened_by_layer(floor(16.0 * (1.0 - left) + 0.5));
#else
  color = darkened_by_layer(left);
#endif
}
