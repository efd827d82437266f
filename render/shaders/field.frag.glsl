// Darkens by the darkest layer whose power-distance field is > 0. The shader interpolates, because
// the hardware's weights have only 8 bits.
in vec2 texel;
uniform sampler2D field;    // channels: umbra, middle, penumbra
uniform vec2 field_last;    // index of the last texel
uniform vec3 layer_wanted;  // 1: the layer is drawn; 0: it is not
uniform vec3 layer_light;   // light left in each layer, for darkened_by_layer()
layout(location = 0) out vec4 color;

void main() {
  vec2 base = clamp(floor(texel), vec2(0.0), field_last - 1.0);
  vec2 t = texel - base;
  ivec2 i = ivec2(base);
  vec3 low = mix(texelFetch(field, i, 0).rgb, texelFetch(field, i + ivec2(1, 0), 0).rgb, t.x);
  vec3 high = mix(texelFetch(field, i + ivec2(0, 1), 0).rgb,
                  texelFetch(field, i + ivec2(1, 1), 0).rgb, t.x);
  vec3 inside = mix(low, high, t.y) * layer_wanted;
  float light_left;
  if (inside.x > 0.0)
    light_left = layer_light.x;
  else if (inside.y > 0.0)
    light_left = layer_light.y;
  else if (inside.z > 0.0)
    light_left = layer_light.z;
  else
    discard;
  color = darkened_by_layer(light_left);
}
