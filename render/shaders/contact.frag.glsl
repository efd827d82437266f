// Darkens a plane around places of contact.
in vec2 texel;
uniform sampler2D field;      // blue: see contact_shade.hpp [texels^2]
uniform vec2 field_last;      // index of the last texel
uniform float greatest;       // of the field [texels^2]
uniform float contact_light;  // fraction of light left at a place of contact
uniform float encoding;       // exponent of the video: encoded = linear ^ encoding
uniform float opacity;

layout(location = 0) out vec4 color;

void main() {
  float shade = textureLod(field, (texel + 0.5) / (field_last + 1.0), 0.0).b / greatest;
  if (shade <= 0.0) discard;
  float light_left = pow(1.0 - min(shade, 1.0) * (1.0 - contact_light), encoding);
  color = darkened(vec3(1.0 - opacity * (1.0 - light_left)));
}
