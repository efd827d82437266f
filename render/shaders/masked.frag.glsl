// Darkens a surface by a shadow (shadow_mask.glsl), or by the darkest of several shadows, which the
// framebuffer's alpha gathers.
in vec3 table_point;
in vec3 table_normal;

layout(location = 0) out vec4 color;

uniform vec3 eye;  // table frame
uniform int gathering;  // enum Gathering: 0 none, 1 first, 2 further, 3 result

void main() {
  if (gathering == 3) {
#if defined(RETEXTURED)
    color = darkened(vec3(texelFetch(framebuffer_copy, ivec2(gl_FragCoord.xy), 0).a));
#else
    color = vec4(1.0);  // the blending multiplies by the framebuffer's alpha
#endif
    return;
  }
  vec3 n = surface_normal(table_normal, normalize(eye - table_point));
  float light = light_left_under_mask(table_point, n);
  if (gathering == 0) {
    color = darkened(vec3(light));
    return;
  }
#if defined(RETEXTURED)
  if (gathering == 2) light = min(light, texelFetch(framebuffer_copy, ivec2(gl_FragCoord.xy), 0).a);
#endif
  color = vec4(vec3(0.0), light);
}
