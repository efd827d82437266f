// What the darkest of several layers leaves of the picture.
// Of a sample in this piece: what is left out beside it shows nothing of its own.
centroid in vec2 texel;
uniform sampler2D mask;
layout(location = 0) out vec4 color;

void main() {
  float left = texture(mask, texel).r;
#if defined(SCREEN_DOOR)
  // The share of places that stay open; where an edge runs through, between its sides' numbers.
  color = darkened_by_layer(floor(16.0 * (1.0 - left) + 0.5));
#else
  color = darkened_by_layer(left);
#endif
}
