// Programs of translucent fragments, in each mode of drawing (shaders/translucency.glsl).
#pragma once

#include <optional>
#include <span>
#include <string_view>
#include <utility>
#include <vector>

#include "core/image/frame.hpp"
#include "render/gl/shader.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Texture units reserved for all passes.
inline constexpr int kPictureBeforeUnit = 3;
inline constexpr int kSumsBeforeUnit = 4;
inline constexpr int kVideoUnit = 5;  // and the next two

// The content under a program's fragments.
enum class Under {
  video,    // only video: retextured, they fetch it from the video's textures
  picture,  // anything: retextured, they fetch it from a copy of the framebuffer
};

class TranslucentProgram {
 public:
  TranslucentProgram() = default;  // no program
  // As ShaderProgram::link(); translucency.glsl is put before the fragment files.
  [[nodiscard]] static Result<TranslucentProgram> create(GlApi api, ShaderFiles vertex,
                                                         ShaderFiles fragment,
                                                         std::vector<std::string_view> defines = {},
                                                         Under under = Under::picture);

  // Selects the program that get() returns, and links it on first use. The baseline geometry_mesh
  // takes mesh outside of planes. `video`: the format of the frames to fetch; none if the
  // background is not the video pixel by pixel, and a copy is fetched.
  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);
  [[nodiscard]] const ShaderProgram& get() const { return variants_[chosen_].second; }
  // The program for blending and for opaque drawing.
  [[nodiscard]] const ShaderProgram& plain() const { return variants_.front().second; }

 private:
  [[nodiscard]] Result<ShaderProgram> link(std::span<const std::string_view> mode_defines) const;

  GlApi api_ = GlApi::gl33;
  ShaderFiles vertex_files_, fragment_files_;
  std::vector<std::string_view> defines_;
  Under under_ = Under::picture;
  // By their last define; the first has none.
  std::vector<std::pair<std::string_view, ShaderProgram>> variants_;
  std::size_t chosen_ = 0;
};

enum class Blending {
  darken,       // multiplied
  sum,          // added; alpha: the maximum
  mix,          // mixed in by the opacity of set_mixing()
  see_through,  // mixed in by the fragment's alpha
};
// Sets the blending in mode blend; the shaders do it in all other modes.
void begin_translucent(Translucency mode, Blending blending);
void set_mixing(Translucency mode, const ShaderProgram& program, float opacity);
void end_translucent();  // back to opaque

// Number of a screen-door's places that are black where this fraction of the encoded value is left:
// they take the same share of the linear light.
[[nodiscard]] float door_places(float light_left);

}  // namespace penumbra
