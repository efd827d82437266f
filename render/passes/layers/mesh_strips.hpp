// The mesh of Layered Penumbrae (for Indigo2 hardware without blending), as a baseline for the
// screen-door: black strips, fixed to the plane. Their relative width is the fraction of light that
// a layer removes. Strips thinner than pixels cause moire.
#pragma once

#include <Eigen/Geometry>

#include "render/camera_gl.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"

namespace penumbra {

class MeshStrips {
 public:
  [[nodiscard]] static Result<MeshStrips> create(GlApi api, const CameraModel& camera);

  // Returns the linear light that a layer removes [1/127] with this factor on the encoded
  // value.
  [[nodiscard]] static unsigned level_of(float factor);
  // Draws the strips of a level within `bounds` (on the plane, [m]) and the table, with the current
  // tests. Returns the number of draw calls.
  int draw(unsigned level, const Eigen::AlignedBox2d& bounds, const LensUniforms& lens,
           const glm::mat4x3& camera_from_plane) const;

 private:
  ShaderProgram program_;
  double piece_ = 0.0;  // length of a strip's pieces [m]
  GlMesh corners_{2};
};

}  // namespace penumbra
