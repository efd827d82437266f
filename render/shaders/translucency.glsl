// How what is translucent reaches the picture: as a factor that is blended; RETEXTURED, what lies
// under the fragment is fetched and written anew; or through a SCREEN_DOOR, whose pixels are opaque
// or left alone. The last two need no blending.
#if defined(SCREEN_DOOR)
// 0 to 15, each once in 4 x 4 pixels, ordered so that those below any number are spread evenly
// (Bayer, 1973). What is darker is black in all the pixels where the lighter is: drawn over each
// other in any order, the darkest is seen.
int door_place() {
  ivec2 at = ivec2(gl_FragCoord.xy) & 3;
  int either = at.x ^ at.y;
  return ((either & 1) << 3) | ((at.y & 1) << 2) | (either & 2) | (at.y >> 1);
}

// Of 16 places, how many are opaque.
void open_door(float opaque) {
  if (float(door_place()) >= opaque) discard;
}

// The eye adds up light, not codes: black pixels take a share of the linear light, of all colours
// alike.
vec4 darkened(vec3 factor) {
  float left = dot(pow(factor, vec3(2.2)), vec3(0.2126, 0.7152, 0.0722));
  open_door(floor(16.0 * (1.0 - left) + 0.5));
  return vec4(0.0, 0.0, 0.0, 1.0);
}
// `layer`: the number of its opaque places.
vec4 darkened_by_layer(float layer) {
  open_door(layer);
  return vec4(0.0, 0.0, 0.0, 1.0);
}
vec4 mixed_in(vec3 color, float opacity) {
  open_door(floor(16.0 * opacity + 0.5));
  return vec4(color, 1.0);
}

#elif defined(RETEXTURED)
#if defined(OVER_VIDEO)
vec3 under_fragment() {
  // In whole codes, as the picture has it: fetched from there instead, nothing changes.
  return floor(255.0 * clamp(video_color(ivec2(gl_FragCoord.xy)), 0.0, 1.0) + 0.5) / 255.0;
}
#else
uniform sampler2D picture_before;
vec3 under_fragment() {
  return texelFetch(picture_before, ivec2(gl_FragCoord.xy), 0).rgb;
}
#endif
vec4 darkened(vec3 factor) {
  return vec4(under_fragment() * factor, 1.0);
}
vec4 darkened_by_layer(float layer) {
  return darkened(vec3(layer));
}
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(mix(under_fragment(), color, opacity), 1.0);
}

#else
// Blended: picture * factor.
vec4 darkened(vec3 factor) {
  return vec4(factor, 1.0);
}
// `layer`: what it leaves of the picture's (encoded) value, here and where it is retextured.
vec4 darkened_by_layer(float layer) {
  return vec4(vec3(layer), 1.0);
}
// The opacity is the blending's own.
vec4 mixed_in(vec3 color, float opacity) {
  return vec4(color, 1.0);
}
#endif

// The same with an opacity of each fragment.
vec4 seen_through(vec3 color, float opacity) {
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
  return mixed_in(color, opacity);
#else
  return vec4(color, opacity);
#endif
}

// Colour that is summed up over several draws, alpha the greatest of theirs.
#if defined(SCREEN_DOOR) || defined(RETEXTURED)
uniform sampler2D sums_before;
vec4 added(vec4 value) {
  vec4 before = texelFetch(sums_before, ivec2(gl_FragCoord.xy), 0);
  return vec4(before.rgb + value.rgb, max(before.a, value.a));
}
#else
vec4 added(vec4 value) {
  return value;
}
#endif
