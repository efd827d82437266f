// Output of translucent fragments. Default: a factor for blending. RETEXTURED: the fetched colour
// under the fragment with the factor applied. SCREEN_DOOR: pixels are opaque or unchanged.
#if defined(SCREEN_DOOR)
// Returns the pixel's threshold in a 4 x 4 ordered dither matrix, 0 to 15 (Bayer, 1973). A darker
// pattern contains each lighter one, so the drawing order does not matter.
int dither_threshold() {
  ivec2 at = ivec2(gl_FragCoord.xy) & 3;
  int mixed = at.x ^ at.y;
  return ((mixed & 1) << 3) | ((at.y & 1) << 2) | (mixed & 2) | (at.y >> 1);
}

// Discards the fragment unless it is one of the `opaque` opaque pixels among 16.
void discard_by_dither(float opaque) {
  if (float(dither_threshold()) >= opaque) discard;
}

// The eye averages linear light, so the fraction of black pixels equals the fraction of blocked
// light.
vec4 darkened(vec3 factor) {
  float left = dot(pow(factor, vec3(2.2)), vec3(0.2126, 0.7152, 0.0722));
  discard_by_dither(floor(16.0 * (1.0 - left) + 0.5));
  return vec4(0.0, 0.0, 0.0, 1.0);
}
// `layer`: its number of opaque pixels among 16.
vec4 darkened_by_layer(float layer) {
  discard_by_dither(layer);
  return vec4(0.0, 0.0, 0.0, 1.0);
}
vec4 mixed_in(vec3 color, float opacity) {
  discard_by_dither(floor(16.0 * opacity + 0.5));
  return vec4(color, 1.0);
}

#elif defined(RETEXTURED)
#if defined(OVER_VIDEO)
vec3 under_fragment() {
  // Rounds to 8 bits, as the framebuffer does.
  return floor(255.0 * clamp(video_color(ivec2(gl_FragCoord.xy)), 0.0, 1.0) + 0.5) / 255.0;
}
#else
uniform sampler2D framebuffer_copy;
vec3 under_fragment() {
  return texelFetch(framebuffer_copy, ivec2(gl_FragCoord.xy), 0).rgb;
}
#endif
vec4 darkened(vec3 factor) {
  return vec4(under_fragment() * factor, 1.0);
}
// `layer`: its factor on the encoded value.
vec4 darkened_by_layer(float layer) {
  return darkened(vec3(layer));
}
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(mix(under_fragment(), color, opacity), 1.0);
}

#else
// Blended: image * factor.
vec4 darkened(vec3 factor) {
  return vec4(factor, 1.0);
}
vec4 darkened_by_layer(float layer) {
  return vec4(vec3(layer), 1.0);
}
// The opacity is a constant of the blending.
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(color, 1.0);
}
#endif

// mixed_in() with an opacity per fragment, which is the alpha if blended.
vec4 seen_through(vec3 color, float opacity) {
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
  return mixed_in(color, opacity);
#else
  return vec4(color, opacity);
#endif
}

// Sums the colours of several draw calls, and takes the maximum of their alphas.
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
uniform sampler2D sums_copy;
vec4 added(vec4 value) {
  vec4 before = texelFetch(sums_copy, ivec2(gl_FragCoord.xy), 0);
  return vec4(before.rgb + value.rgb, max(before.a, value.a));
}
#else
vec4 added(vec4 value) {
  return value;
}
#endif
