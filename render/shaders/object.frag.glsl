// Metal-rough surface under a few lights and a hemisphere of ambient light. Linear light inside,
// encoded as the video is when written. Or, where shadows fall on the surface, what is left of its
// light.
in vec3 place;
in vec3 facing;
in vec2 surface;
in vec4 tint;

layout(location = 0) out vec4 color;

uniform vec3 base_color;
uniform vec3 emissive;
uniform float metallic;
uniform float roughness;
uniform int has_texture;
uniform sampler2D base_color_texture;  // decoded to linear light by the sampler
uniform vec3 eye;                      // table frame
// encoded = tone.y * linear ^ tone.x - tone.z; below tone.w linear, as sRGB has it
uniform vec4 tone;
uniform int darkens;    // 1: the shadow on it; 2: the blocked share, for light_sum.frag.glsl
uniform float opacity;  // of the shadow, or of the surface

void main() {
  vec3 view = normalize(eye - place);
  vec3 n = surface_normal(facing, view);
  if (darkens != 0) {
    color = darkening(blocked_share(place, n), opacity, darkens == 2);
    return;
  }

  vec3 albedo = base_color * tint.rgb;
  if (has_texture != 0) albedo *= texture(base_color_texture, surface).rgb;
  float n_v = max(dot(n, view), 1.0e-3);

  vec3 f0 = mix(vec3(0.04), albedo, metallic);
  vec3 diffuse = albedo * (1.0 - metallic);
  float alpha = max(roughness * roughness, 0.02);
  float alpha2 = alpha * alpha;

  vec3 sum = emissive;
  for (int i = 0; i < MAX_LIGHTS; ++i) {
    if (i >= light_count) break;
    vec3 l = normalize(light_place[i].xyz - place * light_place[i].w);
    float n_l = dot(n, l);
    if (n_l <= 0.0) continue;
    vec3 h = normalize(l + view);
    float n_h = max(dot(n, h), 0.0);
    float v_h = max(dot(view, h), 0.0);
    // GGX distribution, Smith's visibility in its fast form, Schlick's Fresnel term; times pi, so
    // that a light of intensity 1 shows a white Lambert surface at 1.
    float d = n_h * n_h * (alpha2 - 1.0) + 1.0;
    float k = 0.5 * alpha;
    float visibility = 0.25 / ((n_v * (1.0 - k) + k) * (n_l * (1.0 - k) + k));
    vec3 fresnel = f0 + (1.0 - f0) * pow(max(1.0 - v_h, 0.0), 5.0);
    vec3 specular = fresnel * (alpha2 / (d * d) * visibility);
    sum += (diffuse * (1.0 - fresnel) + specular) * light_color[i].rgb * n_l;
  }
  vec3 mirror = reflect(-view, n);
  vec3 ambient_fresnel = f0 + (max(vec3(1.0 - roughness), f0) - f0) * pow(max(1.0 - n_v, 0.0), 5.0);
  sum += diffuse * hemisphere(n.z);
  sum += ambient_fresnel * hemisphere(mix(clamp(mirror.z * 2.5, -1.0, 1.0), n.z, roughness));

  // A shoulder above 0.75 in place of a hard clip.
  const float knee = 0.75;
  vec3 over = max(sum - knee, 0.0);
  sum = min(sum, vec3(knee)) + (1.0 - knee) * (1.0 - exp(-over / (1.0 - knee)));
  vec3 low = sum * 12.92;
  vec3 high = tone.y * pow(max(sum, tone.w), vec3(tone.x)) - tone.z;
  color = mixed_in(mix(high, low, vec3(lessThan(sum, vec3(tone.w)))), opacity);
}
