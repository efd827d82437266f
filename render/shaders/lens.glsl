// Projects the camera frame (x right, y down, z forward [m]) to clip coordinates by the lens models
// of core/camera/camera_model.hpp. Row 0 of the framebuffer is the image's top row.
uniform vec4 lens_scale_offset;  // normalised distorted (x, y) -> NDC: xy scale, zw offset
uniform vec4 lens_k_low;         // k1 k2 p1 p2; fisheye: k1 k2 k3 k4
uniform vec4 lens_k_high;        // k3 k4 k5 k6
uniform int lens_model;          // 0: no distortion, 1: plumb_bob, 2: rational, 3: fisheye
uniform float lens_max_radius;   // undistorted radius up to which the model holds; then linear
uniform vec2 lens_depth;         // clip z = x * z + y

vec2 lens_distort(vec2 p) {
  float r2 = dot(p, p);
  if (lens_model == 3) {
    float r = sqrt(r2);
    if (r < 1.0e-4) return p;  // theta_d / r -> 1
    float theta = atan(r, 1.0);
    float t2 = theta * theta;
    float scale = 1.0 + t2 * (lens_k_low.x + t2 * (lens_k_low.y +
                        t2 * (lens_k_low.z + t2 * lens_k_low.w)));
    return p * (theta * scale / r);
  }
  float radial = 1.0 + r2 * (lens_k_low.x + r2 * (lens_k_low.y + r2 * lens_k_high.x));
  if (lens_model == 2)
    radial /= 1.0 + r2 * (lens_k_high.y + r2 * (lens_k_high.z + r2 * lens_k_high.w));
  vec2 tangential = vec2(lens_k_low.z * 2.0 * p.x * p.y + lens_k_low.w * (r2 + 2.0 * p.x * p.x),
                         lens_k_low.z * (r2 + 2.0 * p.y * p.y) + lens_k_low.w * 2.0 * p.x * p.y);
  return p * radial + tangential;
}

// Returns w = depth, so that the rasteriser interpolates and clips as for a pinhole camera. Beyond
// lens_max_radius and behind the camera, distorted_z depends only on (x, y), so that primitives
// across the camera's plane stay connected.
vec4 lens_clip(vec3 p, float depth_factor) {
  vec2 distorted_z;  // distorted (x, y) times z
  if (lens_model == 0) {
    distorted_z = p.xy;
  } else {
    float rz = max(length(p.xy), 1.0e-9);  // avoids 0 / 0 on the axis behind the camera
    if (p.z > 0.0 && rz <= lens_max_radius * p.z)
      distorted_z = lens_distort(p.xy / p.z) * p.z;
    else
      distorted_z = lens_distort(p.xy * (lens_max_radius / rz)) * (rz / lens_max_radius);
  }
  return vec4(lens_scale_offset.xy * distorted_z + lens_scale_offset.zw * p.z,
              lens_depth.x * p.z + lens_depth.y / depth_factor, p.z);
}

// Projects the point (u, v) of a shadow's plane, 0.1 % farther in depth, so that rounding never
// hides objects that stand on the plane.
vec4 shadow_clip(mat4x3 camera_from_plane, vec2 uv) {
  return lens_clip(camera_from_plane * vec4(uv, 0.0, 1.0), 1.001);
}
