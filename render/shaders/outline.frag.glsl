layout(location = 0) out vec4 color;  // masked off

void main() {
  color = vec4(0.0);
}
