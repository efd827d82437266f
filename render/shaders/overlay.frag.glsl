uniform sampler2D glyphs;
in vec2 glyph_uv;
in vec4 tint;
layout(location = 0) out vec4 color;

void main() {
  color = tint * texture(glyphs, glyph_uv);
}
