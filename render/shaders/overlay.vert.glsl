// Flat shapes and glyphs over the image, in pixels from the top left corner.
layout(location = 0) in vec2 position;
layout(location = 1) in vec2 texcoord;
layout(location = 2) in vec4 color;
uniform vec2 screen_size;
out vec2 glyph_uv;
out vec4 tint;

void main() {
  glyph_uv = texcoord;
  tint = color;
  vec2 at = position / screen_size * 2.0 - 1.0;
  gl_Position = vec4(at.x, -at.y, 0.0, 1.0);
}
