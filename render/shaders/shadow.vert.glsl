// Projects a caster's vertex x with the kernel k and the height h to the plane in one layer, as in
// render/shadow/layers/layered_penumbra.hpp, but with 1/H, which is 0 for a light at the zenith:
//   q = 1 / (1 - h/H);  umbra: k + (1 - h/h_u) q (x - k);  middle: x + (h/H) q (x - k);
//   penumbra: x + (h/H + h/h_u) q (x - k)
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 kernel;

uniform mat4x3 plane_from_caster;  // -> (u, v, h)
uniform mat4x3 camera_from_plane;
uniform float inverse_light_height;  // 1/H [1/m]
uniform float umbra_height;          // h_u [m]
uniform float inverse_umbra_height;  // 1/h_u [1/m]
uniform float height_cap;            // maximum of h [m]
uniform int first_layer;             // layer of the first instance: 0 umbra, 1 middle, 2 penumbra
uniform int layer_step;              // difference of the layers of consecutive instances: 1 or -1
uniform vec3 layer_light;            // light left in each layer, for darkened_by_layer()

flat out float light_left;

void main() {
  vec3 x = plane_from_caster * vec4(position, 1.0);
  vec2 k = (plane_from_caster * vec4(kernel, 1.0)).xy;
  float h = clamp(x.z, 0.0, height_cap);
  float q = 1.0 / (1.0 - h * inverse_light_height);
  float t = h * inverse_light_height * q;
  int layer = first_layer + layer_step * gl_InstanceID;
  vec2 uv;
  if (layer == 0) {
    // Computed from k, so that the factor is exactly 0 at h_u.
    uv = k + max((umbra_height - h) * inverse_umbra_height * q, 0.0) * (x.xy - k);
    light_left = layer_light.x;
  } else if (layer == 1) {
    uv = x.xy + t * (x.xy - k);
    light_left = layer_light.y;
  } else {
    uv = x.xy + (t + h * inverse_umbra_height * q) * (x.xy - k);
    light_left = layer_light.z;
  }
  gl_Position = shadow_clip(camera_from_plane, uv);
}
