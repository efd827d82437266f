flat in float light_left;
layout(location = 0) out vec4 color;

void main() {
  color = darkened_by_layer(light_left);
}
