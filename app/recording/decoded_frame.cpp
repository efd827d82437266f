#include "app/recording/decoded_frame.hpp"

#include <algorithm>
#include <array>
#include <iterator>
#include <memory>
#include <utility>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// Pixel formats that are returned as planes.
struct Mapping {
  AVPixelFormat stored;
  PixelFormat format;
  bool full_range;  // used if the file does not declare the range
};
constexpr std::array<Mapping, 9> kPlanar{{
    {AV_PIX_FMT_GRAY8, PixelFormat::grey8, true},
    {AV_PIX_FMT_YUV420P, PixelFormat::yuv420p, false},
    {AV_PIX_FMT_YUVJ420P, PixelFormat::yuv420p, true},
    {AV_PIX_FMT_YUV422P, PixelFormat::yuv422p, false},
    {AV_PIX_FMT_YUVJ422P, PixelFormat::yuv422p, true},
    {AV_PIX_FMT_YUV444P, PixelFormat::yuv444p, false},
    {AV_PIX_FMT_YUVJ444P, PixelFormat::yuv444p, true},
    {AV_PIX_FMT_NV12, PixelFormat::nv12, false},
    {AV_PIX_FMT_YUYV422, PixelFormat::yuyv, false},
}};

// Memory layout of R, G and B. libav decodes 8-bit RGB of FFV1 to bgr0 or bgra (0rgb on a
// big-endian machine), later versions to planes.
struct RgbLayout {
  AVPixelFormat stored;
  std::array<int, 3> plane;   // plane index of R, G, B
  std::array<int, 3> offset;  // offset in the plane [bytes]
  int step;                   // distance between pixels [bytes]
};
constexpr std::array<RgbLayout, 5> kRgb{{
    {AV_PIX_FMT_GBRP, {2, 0, 1}, {0, 0, 0}, 1},
    {AV_PIX_FMT_BGR0, {0, 0, 0}, {2, 1, 0}, 4},
    {AV_PIX_FMT_BGRA, {0, 0, 0}, {2, 1, 0}, 4},
    {AV_PIX_FMT_0RGB, {0, 0, 0}, {1, 2, 3}, 4},
    {AV_PIX_FMT_RGBA, {0, 0, 0}, {0, 1, 2}, 4},
}};

Frame to_rgb(const AVFrame& stored, const RgbLayout& layout) {
  FrameBuffer buffer = allocate_frame(PixelFormat::rgb24, stored.width, stored.height);
  for (int y = 0; y < stored.height; ++y) {
    std::array<const std::uint8_t*, 3> in{};
    for (std::size_t c = 0; c < 3; ++c) {
      const int plane = layout.plane[c];
      in[c] = stored.data[plane] + static_cast<std::ptrdiff_t>(y) * stored.linesize[plane] +
              layout.offset[c];
    }
    std::uint8_t* out = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    for (std::ptrdiff_t x = 0; x < stored.width; ++x) {
      for (std::size_t c = 0; c < 3; ++c) *out++ = in[c][x * layout.step];
    }
  }
  return std::move(buffer.frame);
}

// Returns a view of the decoder's buffer.
Frame to_planar(Av<AVFrame> stored, const Mapping& mapping, ColorMatrix matrix) {
  Frame frame;
  frame.width = stored->width;
  frame.height = stored->height;
  frame.format = mapping.format;
  const bool unknown = stored->colorspace == AVCOL_SPC_UNSPECIFIED;
  const bool bt709 = stored->colorspace == AVCOL_SPC_BT709 ||
                     stored->colorspace == AVCOL_SPC_BT2020_NCL ||
                     stored->colorspace == AVCOL_SPC_BT2020_CL;
  frame.color_matrix = unknown ? matrix : bt709 ? ColorMatrix::bt709 : ColorMatrix::bt601;
  const bool full = stored->color_range == AVCOL_RANGE_UNSPECIFIED
                        ? mapping.full_range
                        : stored->color_range == AVCOL_RANGE_JPEG;
  frame.color_range = full ? ColorRange::full : ColorRange::limited;
  const AVPixFmtDescriptor* description = av_pix_fmt_desc_get(mapping.stored);
  frame.plane_count = av_pix_fmt_count_planes(mapping.stored);
  for (int i = 0; i < frame.plane_count; ++i) {
    PixelPlane& plane = frame.planes[static_cast<std::size_t>(i)];
    const bool chroma = i > 0;
    plane.data = stored->data[i];
    plane.stride = stored->linesize[i];
    plane.width = chroma ? AV_CEIL_RSHIFT(frame.width, description->log2_chroma_w) : frame.width;
    plane.height = chroma ? AV_CEIL_RSHIFT(frame.height, description->log2_chroma_h) : frame.height;
    if (mapping.format == PixelFormat::yuyv) plane.width = (frame.width + 1) / 2;
  }
  frame.owner = std::shared_ptr<const void>(std::move(stored));
  return frame;
}

}  // namespace

bool is_frame_format(AVPixelFormat format) {
  return std::ranges::count(kPlanar, format, &Mapping::stored) > 0 ||
         std::ranges::count(kRgb, format, &RgbLayout::stored) > 0;
}

bool has_upward_rows(const AVFrame& decoded) {
  return std::any_of(std::begin(decoded.linesize), std::end(decoded.linesize),
                     [](int bytes) { return bytes < 0; });
}

Frame frame_of(Av<AVFrame> decoded, ColorMatrix matrix) {
  const auto format = static_cast<AVPixelFormat>(decoded->format);
  PENUMBRA_ASSERT(is_frame_format(format) && !has_upward_rows(*decoded));
  const auto planar = std::ranges::find(kPlanar, format, &Mapping::stored);
  if (planar != kPlanar.end()) return to_planar(std::move(decoded), *planar, matrix);
  return to_rgb(*decoded, *std::ranges::find(kRgb, format, &RgbLayout::stored));
}

}  // namespace penumbra
