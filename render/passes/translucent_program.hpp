// Programs that draw translucent fragments, in each Translucency mode (shaders/translucency.glsl).
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
inline constexpr int kFramebufferCopyUnit = 3;
inline constexpr int kSumsCopyUnit = 4;
inline constexpr int kVideoUnit = 5;  // first of the units 5 to 7

// The content under a program's fragments.
enum class Background {
  video,        // the video alone: in mode retexture, fetched from the video's textures
  any_content,  // any content: in mode retexture, fetched from a copy of the framebuffer
};

class TranslucentProgram {
 public:
  TranslucentProgram() = default;  // no program
  // Like ShaderProgram::link(), with translucency.glsl before the fragment files.
  [[nodiscard]] static Result<TranslucentProgram> create(
      GlApi api, ShaderFiles vertex, ShaderFiles fragment,
      std::vector<std::string_view> defines = {}, Background background = Background::any_content);

  // Selects the program that get() returns, and links it on first use. The baseline geometry_mesh
  // uses `mesh` for everything except planes. `video`: the format of the frames to fetch; nullopt
  // if the background is not a 1:1 copy of the video, so that a framebuffer copy is fetched.
  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);
  [[nodiscard]] const ShaderProgram& get() const { return variants_[chosen_].second; }
  // The program for blending and for opaque drawing.
  [[nodiscard]] const ShaderProgram& plain() const { return variants_.front().second; }

 private:
  [[nodiscard]] Result<ShaderProgram> link(std::span<const std::string_view> mode_defines) const;

  GlApi api_ = GlApi::gl33;
  ShaderFiles vertex_files_, fragment_files_;
  std::vector<std::string_view> defines_;
  Background background_ = Background::any_content;
  // Key: the mode's last define; "" for the first.
  std::vector<std::pair<std::string_view, ShaderProgram>> variants_;
  std::size_t chosen_ = 0;
};

enum class Blending {
  darken,       // multiplied by the fragment
  sum,          // added; alpha: the maximum
  mix,          // mixed with the opacity of set_mixing()
  see_through,  // mixed with the fragment's alpha
};
// Sets the blending in mode blend; in all other modes the shaders blend.
void begin_translucent(Translucency mode, Blending blending);
void set_mixing(Translucency mode, const ShaderProgram& program, float opacity);
void end_translucent();  // back to opaque

// Returns the number of black pixels of the screen-door pattern that reduces the linear light as
// much as this factor on the encoded value.
[[nodiscard]] float opaque_screen_door_pixels(float factor);

}  // namespace penumbra
