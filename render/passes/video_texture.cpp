#include "render/passes/video_texture.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <span>
#include <tuple>

#include "core/propagate.hpp"
#include "core/text/enum_names.hpp"
#include "render/scene/yuv_conversion.hpp"

namespace penumbra {
namespace {

// Exceeds the number of a camera's buffers. Buffers of an earlier stream are evicted first.
constexpr std::size_t kMaxImported = 12;
// Maximum number of frames that the GPU may be reading while the next one is drawn.
constexpr std::size_t kMaxInUse = 1;
constexpr GLuint64 kMaxWait_ns = 1'000'000'000;  // maximum wait for the GPU

TexelFormat texel_format(PixelFormat format, std::size_t plane) {
  if (format == PixelFormat::rgb24) return TexelFormat::rgb8;
  if (format == PixelFormat::yuyv) return TexelFormat::rgba8;
  return format == PixelFormat::nv12 && plane > 0 ? TexelFormat::rg8 : TexelFormat::r8;
}

glm::vec2 chroma_step(PixelFormat format) {
  return {format == PixelFormat::yuv444p ? 1.0F : 2.0F,
          format == PixelFormat::yuv420p || format == PixelFormat::nv12 ? 2.0F : 1.0F};
}

// Returns the image's size as a fraction of the first plane's size (xy) and of the chroma planes'
// size (zw); < 1 if the last sample is partly outside the image.
glm::vec4 plane_extents(const Frame& frame) {
  const glm::vec2 size_px(frame.width, frame.height);
  const auto size = [&frame](std::size_t i) {
    return glm::vec2(frame.planes[i].width, frame.planes[i].height);
  };
  const glm::vec2 first_step(frame.format == PixelFormat::yuyv ? 2.0F : 1.0F, 1.0F);
  const glm::vec2 first = size_px / (first_step * size(0));
  if (frame.plane_count < 2) return {first, first};
  return {first, size_px / (chroma_step(frame.format) * size(1))};
}

}  // namespace

std::string_view layout_define(PixelFormat format) {
  constexpr auto kDefines =
      std::to_array<EnumName<PixelFormat>>({{PixelFormat::grey8, "VIDEO_GREY"},
                                            {PixelFormat::rgb24, "VIDEO_RGB"},
                                            {PixelFormat::yuyv, "VIDEO_YUYV"},
                                            {PixelFormat::nv12, "VIDEO_NV12"},
                                            {PixelFormat::yuv420p, "VIDEO_PLANAR"},
                                            {PixelFormat::yuv422p, "VIDEO_PLANAR"},
                                            {PixelFormat::yuv444p, "VIDEO_PLANAR"}});
  return name_of(kDefines, format);
}

Result<const ShaderProgram*> VideoProgram::get(PixelFormat format) {
  const std::string_view layout = layout_define(format);
  const auto found = programs_.find(layout);
  if (found != programs_.end()) return &found->second;
  std::vector<std::string_view> defines = defines_;
  defines.push_back(layout);
  PENUMBRA_TRY(auto linked, ShaderProgram::link(api_, vertex_, fragment_, defines));
  return &programs_.emplace(layout, std::move(linked)).first->second;
}

void VideoTexture::bind_texels(const ShaderProgram& program, const Frame& frame,
                               int first_unit) const {
  program.set("plane0", first_unit);
  program.set("plane1", first_unit + 1);
  program.set("plane2", first_unit + 2);
  const YuvConversion conversion = yuv_conversion(frame.color_matrix, frame.color_range);
  program.set("yuv_offset", conversion.offset);
  program.set("rgb_from_yuv", conversion.rgb_from_yuv);
  program.set("chroma_step", chroma_step(frame.format));
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const int unit = first_unit + static_cast<int>(i);
    if (shows_imported_) {
      imported_.back().planes[i].bind(unit);
    } else {
      textures_[i].bind(unit);
    }
  }
}

VideoTexture::~VideoTexture() {
  release(0);
}

VideoTexture::Upload VideoTexture::upload(const Frame& frame, bool reuse) {
  if (reuse && uploaded_.matches(frame)) return Upload::there;
  release(kMaxInUse);
  uploaded_.remember(frame);
  shows_imported_ = can_import_ && frame.dma_buf.descriptor >= 0 && import(frame);
  if (shows_imported_) return Upload::imported;
  const auto count = static_cast<std::size_t>(frame.plane_count);
  while (textures_.size() < count) textures_.emplace_back(TextureFilter::nearest);
  if (pixel_buffers_ && upload_through_buffer(frame)) return Upload::buffered;
  for (std::size_t i = 0; i < count; ++i) {
    const PixelPlane& plane = frame.planes[i];
    textures_[i].upload(texel_format(frame.format, i), plane.width, plane.height, plane.data,
                        plane.stride);
  }
  return Upload::copied;
}

bool VideoTexture::upload_through_buffer(const Frame& frame) {
  constexpr std::size_t kAlignment = 64;  // alignment of planes: a cache line
  const auto count = static_cast<std::size_t>(frame.plane_count);
  struct Packed {
    std::size_t offset = 0, row_bytes = 0, rows = 0;
  };
  std::array<Packed, std::tuple_size_v<decltype(Frame::planes)>> packed;
  std::size_t bytes = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const PixelPlane& plane = frame.planes[i];
    const int texel = bytes_per_texel(texel_format(frame.format, i));
    packed[i] = {bytes, static_cast<std::size_t>(plane.width) * static_cast<std::size_t>(texel),
                 static_cast<std::size_t>(plane.height)};
    bytes += packed[i].row_bytes * packed[i].rows;
    bytes = (bytes + kAlignment - 1) / kAlignment * kAlignment;
  }
  const std::span<std::uint8_t> to = buffers_.map(bytes);
  if (to.empty()) return false;
  for (std::size_t i = 0; i < count; ++i) {
    const PixelPlane& plane = frame.planes[i];
    const auto& [offset, row_bytes, rows] = packed[i];
    if (plane.stride == static_cast<std::ptrdiff_t>(row_bytes)) {
      std::memcpy(to.data() + offset, plane.data, row_bytes * rows);
      continue;
    }
    for (std::size_t y = 0; y < rows; ++y) {
      std::memcpy(to.data() + offset + y * row_bytes,
                  plane.data + static_cast<std::ptrdiff_t>(y) * plane.stride, row_bytes);
    }
  }
  if (!buffers_.unmap()) return false;
  for (std::size_t i = 0; i < count; ++i) {
    textures_[i].upload_from_buffer(texel_format(frame.format, i), frame.planes[i].width,
                                    frame.planes[i].height, packed[i].offset);
  }
  UploadBuffers::unbind();
  return true;
}

bool VideoTexture::import(const Frame& frame) {
  const auto known = std::find_if(
      imported_.begin(), imported_.end(),
      [&](const ImportedBuffer& buffer) { return buffer.number == frame.dma_buf.buffer; });
  if (known != imported_.end()) {
    std::rotate(known, known + 1, imported_.end());
    return true;
  }
  ImportedBuffer buffer;
  buffer.number = frame.dma_buf.buffer;
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const PixelPlane& plane = frame.planes[i];
    auto texture =
        ImportedTexture::create({frame.dma_buf.descriptor, texel_format(frame.format, i),
                                 plane.width, plane.height, frame.dma_buf.offset[i], plane.stride});
    if (!texture) {
      can_import_ = false;  // later frames will fail as well
      imported_.clear();
      return false;
    }
    buffer.planes.push_back(std::move(*texture));
  }
  imported_.push_back(std::move(buffer));
  if (imported_.size() > kMaxImported) imported_.pop_front();
  return true;
}

void VideoTexture::release(std::size_t max_in_use) {
  while (!in_use_.empty()) {
    auto* fence = static_cast<GLsync>(in_use_.front().drawn);
    const bool wait = in_use_.size() > max_in_use;
    const GLenum state = glClientWaitSync(fence, wait ? GL_SYNC_FLUSH_COMMANDS_BIT : 0U,
                                          wait ? kMaxWait_ns : GLuint64{0});
    if (!wait && state == GL_TIMEOUT_EXPIRED) return;
    glDeleteSync(fence);
    in_use_.pop_front();
  }
}

Result<void> VideoTexture::draw(const Frame& frame) {
  PENUMBRA_TRY(const auto program, program_.get(frame.format));
  const ShaderProgram& p = *program;
  p.use();
  bind_texels(p, frame, 0);
  p.set("plane_extents", plane_extents(frame));
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glDepthMask(GL_FALSE);
  no_vertices_.bind();
  glDrawArrays(GL_TRIANGLES, 0, 3);
  return {};
}

void VideoTexture::release_all() {
  release(0);
  shows_imported_ = false;
  uploaded_ = {};
}

void VideoTexture::hold(const Frame& frame) {
  if (!shows_imported_) return;
  if (!in_use_.empty() && in_use_.back().owner == frame.owner) {  // the same frame again
    glDeleteSync(static_cast<GLsync>(in_use_.back().drawn));
    in_use_.pop_back();
  }
  in_use_.push_back({frame.owner, glFenceSync(GL_SYNC_GPU_COMMANDS_COMPLETE, 0)});
}

}  // namespace penumbra
