// Samples the video with interpolation; black outside the video. The shader interpolates,
// because the video's planes differ in size and the hardware's weights have only 8 bits.
in vec2 source;
layout(location = 0) out vec4 color;

uniform vec2 last_pixel;

vec3 at_pixel(ivec2 at) {
  return clamp(video_color(clamp(at, ivec2(0), ivec2(last_pixel))), 0.0, 1.0);
}

void main() {
  vec2 low = floor(source);
  vec2 fraction = source - low;
  ivec2 at = ivec2(low);
  vec3 above = mix(at_pixel(at), at_pixel(at + ivec2(1, 0)), fraction.x);
  vec3 below = mix(at_pixel(at + ivec2(0, 1)), at_pixel(at + ivec2(1, 1)), fraction.x);
  bool inside = all(greaterThanEqual(source, vec2(-0.5))) &&
                all(lessThanEqual(source, last_pixel + 0.5));
  color = vec4(inside ? mix(above, below, fraction.y) : vec3(0.0), 1.0);
}
