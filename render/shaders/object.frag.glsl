// Metallic-roughness surface under a few lights and hemisphere ambient light. Computes linear light
// and encodes it with the camera response. DARKENS: darkens the surface by a shadow instead.
// UNLIT: draws the base colour as it is. REFLECTS: reflects the video (docs/rendering.md#reflections).
in vec3 table_point;
in vec3 table_normal;  // not of unit length
in vec2 uv;  // texture coordinates
in vec4 tint;
#if defined(MATERIAL_MAPS)
in vec4 table_tangent;  // w: as Mesh::tangents
in vec2 uv_2;
#endif

layout(location = 0) out vec4 color;

uniform vec3 base_color;
uniform vec3 emissive;
uniform float metallic;
uniform float roughness;
uniform int has_texture;
uniform sampler2D base_color_texture;  // decoded to linear light by the sampler
uniform vec3 eye;                      // table frame
// encoded = tone.y * linear ^ tone.x - tone.z; below tone.w: 12.92 * linear, as in sRGB
uniform vec4 tone;
#if defined(DARKENS)
uniform int darkens;  // 1: darkens; 2: writes the blocked fraction, for light_sum.frag.glsl
#endif
uniform float opacity;  // opacity of the shadow or the surface

#if defined(MATERIAL_MAPS)
uniform float base_color_by_second;  // 1: the texture uses the second texture coordinates
// x = 1: the material has the map; y = 1: the map uses the second texture coordinates.
uniform vec2 has_metal_map;
uniform vec2 has_normal_map;
uniform vec2 has_occlusion_map;
uniform vec2 has_emissive_map;
uniform sampler2D metal_map;  // roughness in green, metallic in blue
uniform sampler2D normal_map;
uniform sampler2D occlusion_map;  // occlusion in red
uniform sampler2D emissive_map;   // decoded by the sampler
uniform float normal_scale;
uniform float occlusion_strength;
uniform float base_alpha;
uniform float alpha_cutoff;  // fragments below it are discarded; negative: no cutoff
uniform int alpha_blends;

vec2 map_uv(float by_second) {
  return by_second > 0.5 ? uv_2 : uv;
}

// Applies the normal map on the visible side.
vec3 mapped_normal(vec3 n) {
  vec3 t = table_tangent.xyz - n * dot(n, table_tangent.xyz);
  float size = length(t);
  if (has_normal_map.x < 0.5 || size < 1.0e-6) return n;
  // For a flipped normal, the tangents are flipped as well.
  float side = dot(n, table_normal) < 0.0 ? -1.0 : 1.0;
  t *= side / size;
  vec3 b = cross(n * side, t * side) * table_tangent.w * side;
  vec3 m = (2.0 * texture(normal_map, map_uv(has_normal_map.y)).xyz - 1.0) *
           vec3(normal_scale, normal_scale, 1.0);
  vec3 mapped = t * m.x + b * m.y + n * m.z;
  float mapped_length = length(mapped);
  return mapped_length > 1.0e-6 ? mapped / mapped_length : n;
}
#endif

#if defined(REFLECTS)
uniform sampler2D environment;  // the video before anything is drawn over it, with mipmaps
uniform mat4x3 camera_from_table;

const float kMinHeight = 1.0e-4;  // of a reflecting point [m]
const float kMinDepth = 1.0e-3;   // of a reflected point / its distance

// Inverts the encoding of main().
vec3 linear_light(vec3 encoded) {
  vec3 high = pow((encoded + tone.z) / tone.y, vec3(1.0 / tone.x));
  vec3 low = encoded / 12.92;
  return mix(high, low, vec3(lessThan(high, vec3(tone.w))));
}

// Returns the light that arrives at the point from a direction (unit, table frame): that of the
// table (z = 0) in the video. Above the horizon it turns into the room's light.
vec3 environment_light(vec3 point, vec3 direction, float rough) {
  // A ray that does not meet the table nearby ends at infinity.
  bool far = direction.z > -1.0e-3;
  float distance_m = far ? 1.0 : max(point.z, kMinHeight) / -direction.z;
  vec3 seen = far ? mat3(camera_from_table) * direction
                  : camera_from_table * vec4(point + distance_m * direction, 1.0);
  float depth = seen.z / distance_m;
  bool behind = depth < kMinDepth;
  vec4 clip = lens_clip(behind ? vec3(0.0, 0.0, 1.0) : seen, 1.0);
  vec2 wanted = 0.5 + 0.5 * clip.xy / clip.w;
  vec2 at = clamp(wanted, 0.0, 1.0);
  // In texels: the width of the lobe, the distance to the image, and the width of a pixel.
  vec2 size = vec2(textureSize(environment, 0));
  float lobe = rough * rough * lens_scale_offset.x * size.x / depth;
  float outside = 2.0 * length((wanted - at) * size);
  vec2 step_x = dFdx(wanted) * size;
  vec2 step_y = dFdy(wanted) * size;
  float pixel = sqrt(max(dot(step_x, step_x), dot(step_y, step_y)));
  float level = log2(max(1.0, lobe + outside + pixel));
  float mean_level = log2(max(size.x, size.y));  // one texel
  level = behind ? mean_level : min(level, mean_level);
  vec3 light = linear_light(textureLod(environment, at, level).rgb);
  return mix(light, sky_light, smoothstep(0.0, 0.5, direction.z));
}
#endif

// Costs a tenth of pow().
float fifth_power(float x) {
  float square = x * x;
  return square * square * x;
}

void main() {
  vec3 view = normalize(eye - table_point);
  vec3 n = surface_normal(table_normal, view);
#if defined(MATERIAL_MAPS)
  float alpha = base_alpha * tint.a;
  if (has_texture != 0)
    alpha *= texture(base_color_texture, map_uv(base_color_by_second)).a;
  // Derivatives, which reflections need, are undefined after a discard.
  bool is_cut_out = alpha < alpha_cutoff;
#if !defined(REFLECTS)
  if (is_cut_out) discard;
#endif
#if !defined(UNLIT)
  n = mapped_normal(n);
#endif
#endif
#if defined(DARKENS)
  color = darkening(blocked_share(table_point, n), opacity, darkens == 2);
#else
  vec3 albedo = base_color * tint.rgb;
#if defined(MATERIAL_MAPS)
  if (has_texture != 0)
    albedo *= texture(base_color_texture, map_uv(base_color_by_second)).rgb;
#else
  if (has_texture != 0) albedo *= texture(base_color_texture, uv).rgb;
#endif
#if defined(UNLIT)
  vec3 sum = albedo;
#else
  vec3 emitted = emissive;
  float metal = metallic;
  float rough = roughness;
  float occlusion = 1.0;
#if defined(MATERIAL_MAPS)
  if (has_emissive_map.x > 0.5)
    emitted *= texture(emissive_map, map_uv(has_emissive_map.y)).rgb;
  if (has_metal_map.x > 0.5) {
    vec4 maps = texture(metal_map, map_uv(has_metal_map.y));
    rough *= maps.g;
    metal *= maps.b;
  }
  if (has_occlusion_map.x > 0.5) {
    float map_occlusion = texture(occlusion_map, map_uv(has_occlusion_map.y)).r;
    occlusion = 1.0 + occlusion_strength * (map_occlusion - 1.0);
  }
#endif
  float n_v = max(dot(n, view), 1.0e-3);

  vec3 f0 = mix(vec3(0.04), albedo, metal);
  vec3 diffuse = albedo * (1.0 - metal);
  float ggx_alpha = max(rough * rough, 0.02);
  float alpha2 = ggx_alpha * ggx_alpha;
  // The share of light that one reflection at the facets loses, because it meets further facets;
  // it leaves these after further reflections (docs/rendering.md#light-between-facets).
  float lost = rough * (0.303 - 0.177 * rough + n_v * (rough * (1.726 - 0.596 * n_v) - 0.558));
  vec3 between_facets = 1.0 + f0 * (max(lost, 0.0) / (1.0 - lost));

  vec3 sum = emitted;
  for (int i = 0; i < MAX_LIGHTS; ++i) {
    if (i >= light_count) break;
    vec3 l = normalize(light_place[i].xyz - table_point * light_place[i].w);
    float n_l = dot(n, l);
    if (n_l <= 0.0) continue;
    vec3 h = normalize(l + view);
    float n_h = max(dot(n, h), 0.0);
    float v_h = max(dot(view, h), 0.0);
    // GGX distribution, Smith's visibility with correlated heights, Schlick's Fresnel term; times
    // pi, so that a light of intensity 1 gives a white Lambert surface the value 1.
    float d = n_h * n_h * (alpha2 - 1.0) + 1.0;
    float visibility = 0.5 / (n_l * sqrt(alpha2 + (1.0 - alpha2) * n_v * n_v) +
                              n_v * sqrt(alpha2 + (1.0 - alpha2) * n_l * n_l));
    vec3 fresnel = f0 + (1.0 - f0) * fifth_power(max(1.0 - v_h, 0.0));
    vec3 specular = fresnel * between_facets * (alpha2 / (d * d) * visibility);
    sum += (diffuse * (1.0 - fresnel) + specular) * light_color[i].rgb * n_l;
  }
  vec3 mirror = reflect(-view, n);
  vec3 ambient_fresnel = f0 + (max(vec3(1.0 - rough), f0) - f0) * fifth_power(max(1.0 - n_v, 0.0));
  sum += occlusion * diffuse * hemisphere(n.z);
  vec3 arriving = hemisphere(mix(clamp(mirror.z * 2.5, -1.0, 1.0), n.z, rough));
#if defined(REFLECTS)
  float reflected = clamp(4.0 * metal * (1.0 - rough) - 1.0, 0.0, 1.0);
  arriving = mix(arriving, environment_light(table_point, mirror, rough), reflected);
#endif
  sum += occlusion * ambient_fresnel * arriving;

  // Compresses values above 0.75 smoothly instead of clipping at 1.
  const float knee = 0.75;
  vec3 over = max(sum - knee, 0.0);
  sum = min(sum, vec3(knee)) + (1.0 - knee) * (1.0 - exp(-over / (1.0 - knee)));
#endif
#if defined(REFLECTS)
  if (is_cut_out) discard;
#endif
  vec3 low = sum * 12.92;
  vec3 high = tone.y * pow(max(sum, tone.w), vec3(tone.x)) - tone.z;
  vec3 encoded = mix(high, low, vec3(lessThan(sum, vec3(tone.w))));
#if defined(MATERIAL_MAPS)
  if (alpha_blends != 0) {
    color = mixed_in_by_alpha(encoded, alpha * opacity);
    return;
  }
#endif
  color = mixed_in(encoded, opacity);
#endif
}
