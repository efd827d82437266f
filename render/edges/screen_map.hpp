// Projects points and edges to the image, like lens.glsl.
#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/edges/screen_edge.hpp"

namespace penumbra {

// Maps points of the camera frame to pixels, like lens.glsl.
class ScreenMap {
 public:
  ScreenMap(const LensUniforms& lens, int width, int height);

  // Returns the pixel (corner of the image: 0, 0) and the inverse depth [1/m]. `p.z` must be > 0.
  [[nodiscard]] glm::vec3 operator()(const glm::vec3& p) const;
  // Returns the undistorted normalised coordinates (x / z, y / z) of a point of the image, to 1e-3.
  [[nodiscard]] glm::vec2 ray(const glm::vec2& pixel) const;
  // Adds the edge a -> b (camera frame [m]), cut off at the near plane. `normal`: of its surface.
  // `pieces`: the largest number of straight pieces if the lens bends the edge.
  void add(const glm::vec3& a, const glm::vec3& b, const glm::vec3& normal, int pieces,
           std::vector<ScreenEdge>& edges) const;
  [[nodiscard]] bool distorts() const { return lens_.model != 0; }

 private:
  LensUniforms lens_;
  glm::vec2 half_size_;
  glm::vec2 focal_px_;
};

}  // namespace penumbra
