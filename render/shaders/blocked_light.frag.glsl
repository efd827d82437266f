// What is left of a plane's light where some lights do not reach it: each takes its own share away,
// by Lambert's law, so that shadows add up as light does.
in vec2 view;

uniform vec3 inverse_depth;  // see receiver.vert.glsl
uniform mat3 table_from_camera;
uniform vec3 eye;     // table frame [m]
uniform vec3 normal;  // of the plane, unit
uniform vec3 ambient;
uniform float opacity;  // of the overlay
uniform int add_up;     // 1: the blocked share itself, for light_sum.frag.glsl
uniform int light_count;
uniform vec4 light_place[MAX_LIGHTS];  // w 1: position; w 0: direction towards the light
uniform vec4 light_color[MAX_LIGHTS];  // w: the share that is blocked

layout(location = 0) out vec4 factor;

void main() {
  vec3 ray = vec3(view, 1.0);
  vec3 place = eye + table_from_camera * ray / max(dot(inverse_depth, ray), 1.0e-6);
  vec3 all = hemisphere(ambient, normal.z);
  vec3 blocked = vec3(0.0);
  for (int i = 0; i < MAX_LIGHTS; ++i) {
    if (i >= light_count) break;
    vec3 l = normalize(light_place[i].xyz - place * light_place[i].w);
    vec3 arriving = light_color[i].rgb * max(dot(normal, l), 0.0);
    all += arriving;
    blocked += arriving * light_color[i].w;
  }
  vec3 share = clamp(blocked / max(all, vec3(1.0e-4)), 0.0, 1.0);
  if (add_up != 0) {
    factor = opacity * vec4(share, 1.0);
    return;
  }
  vec3 left = 1.0 - share;
  // Linear light -> factor for the video's encoded value.
  vec3 encoded = pow(left, vec3(1.0 / 2.2));
  factor = vec4(1.0 - opacity * (1.0 - encoded), 1.0);  // blended: video * factor
}
