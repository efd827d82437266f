// The mesh of Layered Penumbrae (Indigo2 hardware without blending): black strips on the plane, so
// wide that they take a layer's share of the light. A baseline to compare the screen-door with:
// where strips are thinner than pixels it shows moire. They are fixed to the plane, 600 of them for
// three layers over a table of 0.6 m, more where shadows reach farther.
#pragma once

#include <Eigen/Geometry>

#include "render/camera_gl.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"

namespace penumbra {

class MeshStrips {
 public:
  [[nodiscard]] static Result<MeshStrips> create(GlApi api, const CameraModel& camera);

  // How dark a layer is that leaves so much of the encoded value, in 1/127 of the linear light.
  [[nodiscard]] static unsigned level_of(float light_left);
  // The strips for that, over `bounds` [m] of the plane and all of the table, with the tests as
  // they are. Number of draw calls.
  int draw(unsigned level, const Eigen::AlignedBox2d& bounds, const LensUniforms& lens,
           const glm::mat4x3& camera_from_plane) const;

 private:
  explicit MeshStrips(ShaderProgram program) : program_(std::move(program)) {}

  ShaderProgram program_;
  double piece_ = 0.0;  // [m]
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
};

}  // namespace penumbra
