layout(location = 0) out vec4 color;

void main() {
  color = vec4(video_color(ivec2(gl_FragCoord.xy)), 1.0);
}
