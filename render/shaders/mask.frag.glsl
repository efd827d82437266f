// What the darkest of several layers leaves of the picture.
in vec2 texel;
uniform sampler2D mask;
layout(location = 0) out vec4 color;

void main() {
  color = darkened_by_layer(texture(mask, texel).r);
}
