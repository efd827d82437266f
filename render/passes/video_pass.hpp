// The video as captured -> the picture's background, 1:1.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <vector>

#include "core/frame.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/context.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"

namespace penumbra {

// RGB in [0, 1] = matrix * (yuv - offset), yuv being stored bytes / 255.
struct YuvConversion {
  glm::mat3 rgb_from_yuv{1.0F};
  glm::vec3 offset{0.0F};
};
[[nodiscard]] YuvConversion yuv_conversion(ColorMatrix matrix, ColorRange range);

class VideoPass {
 public:
  explicit VideoPass(GlApi api) : api_(api) {}

  // Copies the planes to the GPU; does nothing when they are there already. False when nothing was
  // to be done.
  bool upload(const Frame& frame);
  // Covers every pixel: no clearing of colour is needed.
  [[nodiscard]] Result<void> draw(const Frame& frame);

 private:
  [[nodiscard]] Result<const ShaderProgram*> program_for(PixelFormat format);

  GlApi api_;
  VertexArray no_vertices_;
  std::vector<Texture2d> textures_;
  std::array<std::optional<ShaderProgram>, 5> programs_;
  std::weak_ptr<const void> uploaded_owner_;
  const std::uint8_t* uploaded_data_ = nullptr;
};

}  // namespace penumbra
