// A program whose fragments are translucent, in each of the ways that they can reach the picture
// (shaders/translucency.glsl).
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/image/frame.hpp"
#include "render/gl/shader.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Texture units that no pass has another use for.
inline constexpr int kPictureBeforeUnit = 3;
inline constexpr int kSumsBeforeUnit = 4;
inline constexpr int kVideoUnit = 5;  // and the two behind it

// Where a program's fragments lie.
enum class Under {
  video,    // nothing but video is under any of them: retextured, they fetch it from where it is
  picture,  // what was drawn before: retextured, they fetch it from a copy
};

class TranslucentProgram {
 public:
  // As ShaderProgram::link(), for blending; translucency.glsl is put before the fragment files.
  [[nodiscard]] static Result<TranslucentProgram> create(
      GlApi api, std::span<const std::string_view> vertex_files,
      std::span<const std::string_view> fragment_files,
      std::span<const std::string_view> defines = {}, Under under = Under::picture);

  // From here on get() is the program for this way, linked when it is first asked for. Of the
  // baseline with geometry that of the mesh: what is not on a plane is drawn so. `video`: the
  // format of the frames that are fetched; none where the picture under shadows is not the video
  // pixel by pixel, and is fetched from a copy instead.
  [[nodiscard]] Result<void> choose(Translucency way, std::optional<PixelFormat> video);
  [[nodiscard]] const ShaderProgram& get() const { return variants_[chosen_].second; }
  // What is blended, or drawn where nothing shines through.
  [[nodiscard]] const ShaderProgram& plain() const { return variants_.front().second; }

 private:
  TranslucentProgram() = default;
  [[nodiscard]] Result<ShaderProgram> link(std::span<const std::string_view> way_defines) const;

  GlApi api_ = GlApi::gl33;
  std::vector<std::string_view> vertex_files_, fragment_files_, defines_;
  Under under_ = Under::picture;
  // By the last of their defines; the first has none.
  std::vector<std::pair<std::string_view, ShaderProgram>> variants_;
  std::size_t chosen_ = 0;
};

// How the picture is darkened, or summed up, by the fragments that follow; with anything but
// blending they say themselves what becomes of it.
void begin_darkening(Translucency way);
void begin_summing(Translucency way);
// How they are mixed in; of blending, by the opacity that set_mixing() gives.
void begin_mixing(Translucency way);
void set_mixing(Translucency way, const ShaderProgram& program, float opacity);
// The same by an opacity of each fragment: seen_through() of translucency.glsl.
void begin_seeing_through(Translucency way);
// Back to opaque.
void end_translucent();

// How many of a screen-door's places are black where this much of the encoded value is left: as
// many as take that share of the linear light.
[[nodiscard]] float door_places(float light_left);

}  // namespace penumbra
