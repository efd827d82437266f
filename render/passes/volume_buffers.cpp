#include "render/passes/volume_buffers.hpp"

#include <epoxy/gl.h>

#include <array>
#include <cmath>
#include <glm/vec3.hpp>
#include <span>
#include <string_view>

#include "render/passes/lens_uniforms.hpp"

namespace penumbra {

std::size_t VolumeBuffers::write(const ShadowVolume& volume, std::optional<double> longest_edge) {
  std::vector<glm::vec3> triangles;
  batch_ends_.clear();
  for (std::size_t i = 0; i < volume.batch_ends.size(); ++i) {
    const std::size_t begin = i == 0 ? 0 : volume.batch_ends[i - 1];
    const std::span<const glm::vec3> batch =
        std::span(volume.triangles).subspan(begin, volume.batch_ends[i] - begin);
    if (longest_edge) {
      // Of all triangles that there may be, the batch's share.
      const auto budget = static_cast<std::size_t>(
          std::ceil(static_cast<double>(kMostVolumeTriangles) * static_cast<double>(batch.size()) /
                    static_cast<double>(volume.triangles.size())));
      const std::vector<glm::vec3> pieces =
          split_for_lens({batch.begin(), batch.end()}, *longest_edge, budget);
      triangles.insert(triangles.end(), pieces.begin(), pieces.end());
    } else {
      triangles.insert(triangles.end(), batch.begin(), batch.end());
    }
    batch_ends_.push_back(static_cast<int>(triangles.size()));
  }
  layout_.bind();
  vertices_.write(std::span<const glm::vec3>(triangles), BufferLife::every_frame);
  if (!layout_made_) {
    VertexArray::attribute(0, 3, sizeof(glm::vec3), 0);
    layout_made_ = true;
  }
  return triangles.size();
}

void VolumeBuffers::draw(std::size_t batch) const {
  layout_.bind();
  const int begin = batch == 0 ? 0 : batch_ends_[batch - 1];
  glDrawArrays(GL_TRIANGLES, begin, batch_ends_[batch] - begin);
}

Result<ShaderProgram> volume_program(GlApi api) {
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "volume.vert.glsl"};
  constexpr std::array<std::string_view, 1> kNothing = {"outline.frag.glsl"};
  return ShaderProgram::link(api, kVertex, kNothing);
}

void count_volume(const ShaderProgram& program, const LensUniforms& lens,
                  const glm::mat4x3& camera_from_table, const VolumeBuffers& volume,
                  std::size_t batch, unsigned left_out) {
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glDisable(GL_BLEND);
  glEnable(GL_DEPTH_TEST);
  program.use();
  set_lens(program, lens);
  program.set("camera_from_table", camera_from_table);
  glDepthFunc(GL_LESS);
  glStencilMask(kMostVolumesCounted);
  glStencilFunc(GL_EQUAL, 0, left_out);
  glStencilOpSeparate(GL_FRONT, GL_KEEP, GL_DECR_WRAP, GL_KEEP);
  glStencilOpSeparate(GL_BACK, GL_KEEP, GL_INCR_WRAP, GL_KEEP);
  volume.draw(batch);
  glDisable(GL_DEPTH_TEST);
}

}  // namespace penumbra
