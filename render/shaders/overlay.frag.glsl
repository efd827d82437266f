uniform sampler2D letters;
in vec2 letter;
in vec4 tint;
layout(location = 0) out vec4 color;

void main() {
  color = tint * texture(letters, letter);
}
