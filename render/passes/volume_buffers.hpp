// A shadow volume on the GPU, and how it is counted into the stencil.
#pragma once

#include <optional>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/shader.hpp"
#include "render/shadow/volumes/shadow_volume.hpp"

namespace penumbra {

class VolumeBuffers {
 public:
  // Its triangles split for a lens where there is a longest edge [m]. How many they are, in
  // vertices.
  std::size_t write(const ShadowVolume& volume, std::optional<double> longest_edge);
  [[nodiscard]] std::size_t batches() const { return batch_ends_.size(); }
  void draw(std::size_t batch) const;

 private:
  std::vector<int> batch_ends_;  // in vertices
  bool layout_made_ = false;
  VertexArray layout_;
  GlBuffer vertices_{BufferUse::vertices};
};

[[nodiscard]] Result<ShaderProgram> volume_program(GlApi api);

// z-fail: leaves in kMostVolumesCounted of the stencil how often each pixel's ray is in one batch
// of a volume, where those bits were 0: walls behind what the pixel shows count, those turned to
// the eye one way, those turned away the other. Only where `left_out` of the stencil is 0.
void count_volume(const ShaderProgram& program, const LensUniforms& lens,
                  const glm::mat4x3& camera_from_table, const VolumeBuffers& volume,
                  std::size_t batch, unsigned left_out);

}  // namespace penumbra
