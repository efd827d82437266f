in vec3 tint;
in vec2 from_middle;

layout(location = 0) out vec4 color;

uniform float opacity;

void main() {
  float r2 = dot(from_middle, from_middle);
  if (r2 > 1.0) discard;
  // A dark rim separates a dot from a background of its colour.
  color = mixed_in(r2 > 0.55 ? tint * 0.25 : tint, opacity);
}
