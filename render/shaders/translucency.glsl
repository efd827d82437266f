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
  float light_left = dot(pow(factor, vec3(2.2)), vec3(0.2126, 0.7152, 0.0722));
  discard_by_dither(floor(16.0 * (1.0 - light_left) + 0.5));
  return vec4(0.0, 0.0, 0.0, 1.0);
}
// `opaque`: the layer's number of opaque pixels among 16.
vec4 darkened_by_layer(float opaque) {
  discard_by_dither(opaque);
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
// `factor`: the layer's factor on the encoded value.
vec4 darkened_by_layer(float factor) {
  return darkened(vec3(factor));
}
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(mix(under_fragment(), color, opacity), 1.0);
}

#else
// The blending multiplies the image by the factor.
vec4 darkened(vec3 factor) {
  return vec4(factor, 1.0);
}
vec4 darkened_by_layer(float factor) {
  return vec4(vec3(factor), 1.0);
}
// The opacity is a constant of the blending.
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(color, 1.0);
}
#endif

// Like mixed_in(), with an opacity per fragment. Blending uses the opacity as alpha.
vec4 mixed_in_by_alpha(vec3 color, float opacity) {
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
  return mixed_in(color, opacity);
#else
  return vec4(color, opacity);
#endif
}

// Adds a draw call's colour to the sum of previous draw calls; keeps the maximum of their alphas.
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
uniform sampler2D sums_copy;
vec4 added(vec4 value) {
  vec4 sum = texelFetch(sums_copy, ivec2(gl_FragCoord.xy), 0);
  return vec4(sum.rgb + value.rgb, max(sum.a, value.a));
}
#else
vec4 added(vec4 value) {
  return value;
}
#endif
