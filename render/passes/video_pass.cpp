#include "render/passes/video_pass.hpp"

#include <epoxy/gl.h>

namespace penumbra {
namespace {

enum class Layout : std::size_t { grey, rgb, yuyv, nv12, planar };

Layout layout_of(PixelFormat format) {
  switch (format) {
    case PixelFormat::grey8:
      return Layout::grey;
    case PixelFormat::rgb24:
      return Layout::rgb;
    case PixelFormat::yuyv:
      return Layout::yuyv;
    case PixelFormat::nv12:
      return Layout::nv12;
    case PixelFormat::yuv420p:
    case PixelFormat::yuv422p:
    case PixelFormat::yuv444p:
      return Layout::planar;
  }
  return Layout::planar;
}

TexelFormat texel_format(PixelFormat format, std::size_t plane) {
  switch (format) {
    case PixelFormat::rgb24:
      return TexelFormat::rgb8;
    case PixelFormat::yuyv:
      return TexelFormat::rgba8;
    case PixelFormat::nv12:
      return plane == 0 ? TexelFormat::r8 : TexelFormat::rg8;
    default:
      return TexelFormat::r8;
  }
}

}  // namespace

YuvConversion yuv_conversion(ColorMatrix matrix, ColorRange range) {
  // ITU-R BT.601 and BT.709: the shares of red and blue in luma.
  const float kr = matrix == ColorMatrix::bt601 ? 0.299F : 0.2126F;
  const float kb = matrix == ColorMatrix::bt601 ? 0.114F : 0.0722F;
  const float kg = 1.0F - kr - kb;
  const bool limited = range == ColorRange::limited;
  const float y = limited ? 255.0F / 219.0F : 1.0F;
  const float c = limited ? 255.0F / 224.0F : 1.0F;
  const float v_red = 2.0F * (1.0F - kr) * c;
  const float u_blue = 2.0F * (1.0F - kb) * c;
  YuvConversion conversion;
  conversion.rgb_from_yuv =
      glm::mat3(glm::vec3(y, y, y), glm::vec3(0.0F, -u_blue * kb / kg, u_blue),
                glm::vec3(v_red, -v_red * kr / kg, 0.0F));
  conversion.offset = {limited ? 16.0F / 255.0F : 0.0F, 128.0F / 255.0F, 128.0F / 255.0F};
  return conversion;
}

bool VideoPass::upload(const Frame& frame) {
  // The same buffer, still held by someone, is the same frame: frames are immutable.
  const bool same =
      frame.owner && !uploaded_owner_.expired() && !uploaded_owner_.owner_before(frame.owner) &&
      !frame.owner.owner_before(uploaded_owner_) && frame.planes[0].data == uploaded_data_;
  if (same) return false;
  const auto count = static_cast<std::size_t>(frame.plane_count);
  while (textures_.size() < count) textures_.emplace_back(TextureFilter::nearest);
  for (std::size_t i = 0; i < count; ++i) {
    const PixelPlane& plane = frame.planes[i];
    textures_[i].upload(texel_format(frame.format, i), plane.width, plane.height, plane.data,
                        plane.stride);
  }
  uploaded_owner_ = frame.owner;
  uploaded_data_ = frame.planes[0].data;
  return true;
}

Result<const ShaderProgram*> VideoPass::program_for(PixelFormat format) {
  constexpr std::array<std::string_view, 5> kDefines = {"VIDEO_GREY", "VIDEO_RGB", "VIDEO_YUYV",
                                                        "VIDEO_NV12", "VIDEO_PLANAR"};
  constexpr std::array<std::string_view, 1> kVertex = {"video.vert.glsl"};
  constexpr std::array<std::string_view, 1> kFragment = {"video.frag.glsl"};
  const auto index = static_cast<std::size_t>(layout_of(format));
  std::optional<ShaderProgram>& program = programs_[index];
  if (!program) {
    auto linked =
        ShaderProgram::link(api_, kVertex, kFragment, std::span(&kDefines[index], std::size_t{1}));
    if (!linked) return tl::unexpected(linked.error());
    program.emplace(std::move(*linked));
  }
  return &*program;
}

Result<void> VideoPass::draw(const Frame& frame) {
  const auto program = program_for(frame.format);
  if (!program) return tl::unexpected(program.error());
  const ShaderProgram& p = **program;
  p.use();
  p.set("plane0", 0);
  p.set("plane1", 1);
  p.set("plane2", 2);
  const YuvConversion conversion = yuv_conversion(frame.color_matrix, frame.color_range);
  p.set("yuv_offset", conversion.offset);
  p.set("rgb_from_yuv", conversion.rgb_from_yuv);
  p.set("chroma_step", glm::vec2(frame.format == PixelFormat::yuv444p ? 1.0F : 2.0F,
                                 frame.format == PixelFormat::yuv420p ? 2.0F : 1.0F));
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i)
    textures_[i].bind(static_cast<int>(i));
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_FALSE);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
  return {};
}

}  // namespace penumbra
