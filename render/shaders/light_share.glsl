// The lights of the scene, and the fraction of all light that a surface loses if some lights are
// blocked, by Lambert's law. The shadows of several lights add up physically.
uniform int light_count;
uniform vec4 light_place[MAX_LIGHTS];  // w 1: position; w 0: direction towards the light
uniform vec4 light_color[MAX_LIGHTS];  // w: the fraction of this light that is blocked
uniform float encoding;                // exponent of the video: encoded = linear ^ encoding

// Returns the blocked fraction of linear light. `point`: table frame [m]; `normal`: unit.
vec3 blocked_share(vec3 point, vec3 normal) {
  vec3 total = hemisphere(normal.z);
  vec3 blocked = vec3(0.0);
  for (int i = 0; i < MAX_LIGHTS; ++i) {
    if (i >= light_count) break;
    vec3 l = normalize(light_place[i].xyz - point * light_place[i].w);
    vec3 arriving = light_color[i].rgb * max(dot(normal, l), 0.0);
    total += arriving;
    blocked += arriving * light_color[i].w;
  }
  return clamp(blocked / max(total, vec3(1.0e-4)), 0.0, 1.0);
}

// Darkens the encoded image by the blocked fraction `share`; if `add_up`, returns
// opacity * (share, 1) for light_sum.frag.glsl instead.
vec4 darkening(vec3 share, float opacity, bool add_up) {
  if (add_up) return added(opacity * vec4(share, 1.0));
  vec3 encoded = pow(1.0 - share, vec3(encoding));
  return darkened(1.0 - opacity * (1.0 - encoded));
}
