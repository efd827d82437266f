layout(location = 0) out vec4 color;

void main() {
#if defined(WHOLE_PICTURE)
  color = vec4(video_color(), 1.0);
#else
  color = vec4(video_color(ivec2(gl_FragCoord.xy)), 1.0);
#endif
}
