#include "app/recording/lossless_video.hpp"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <utility>

#include "app/libav.hpp"
#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr AVRational kMatroskaTimeBase{1, 1000};  // Matroska's

AVPixelFormat stored_format(PixelFormat format) {
  switch (format) {
    case PixelFormat::grey8:
      return AV_PIX_FMT_GRAY8;
    case PixelFormat::rgb24:
      return AV_PIX_FMT_0RGB32;
    case PixelFormat::nv12:
    case PixelFormat::yuv420p:
      return AV_PIX_FMT_YUV420P;
    case PixelFormat::yuyv:
    case PixelFormat::yuv422p:
      return AV_PIX_FMT_YUV422P;
    case PixelFormat::yuv444p:
      return AV_PIX_FMT_YUV444P;
  }
  return AV_PIX_FMT_NONE;
}

std::uint8_t* row_of(AVFrame& picture, std::size_t plane, int y) {
  return picture.data[plane] + static_cast<std::ptrdiff_t>(y) * picture.linesize[plane];
}

void copy_plane(const PixelPlane& from, AVFrame& picture, std::size_t plane) {
  for (int y = 0; y < from.height; ++y) {
    std::memcpy(row_of(picture, plane, y), from.data + y * from.stride,
                static_cast<std::size_t>(from.width));
  }
}

// Each sample to its plane.
void sort_samples(const Frame& frame, AVFrame& picture) {
  const PixelPlane& first = frame.planes[0];
  switch (frame.format) {
    case PixelFormat::yuyv:
      for (int y = 0; y < frame.height; ++y) {
        const std::uint8_t* in = first.data + y * first.stride;
        std::uint8_t* luma = row_of(picture, 0, y);
        std::uint8_t* u = row_of(picture, 1, y);
        std::uint8_t* v = row_of(picture, 2, y);
        for (int x = 0; x < frame.width; ++x) luma[x] = in[2 * x];
        for (int x = 0; x < first.width; ++x) {
          u[x] = in[4 * x + 1];
          v[x] = in[4 * x + 3];
        }
      }
      return;
    case PixelFormat::nv12:
      copy_plane(first, picture, 0);
      for (int y = 0; y < frame.planes[1].height; ++y) {
        const std::uint8_t* in = frame.planes[1].data + y * frame.planes[1].stride;
        std::uint8_t* u = row_of(picture, 1, y);
        std::uint8_t* v = row_of(picture, 2, y);
        for (int x = 0; x < frame.planes[1].width; ++x) {
          u[x] = in[2 * x];
          v[x] = in[2 * x + 1];
        }
      }
      return;
    case PixelFormat::rgb24:
      for (int y = 0; y < frame.height; ++y) {
        const std::uint8_t* in = first.data + y * first.stride;
        std::uint8_t* out = row_of(picture, 0, y);
        for (int x = 0; x < frame.width; ++x, in += 3, out += 4) {
          const std::uint32_t pixel =
              (std::uint32_t{in[0]} << 16U) | (std::uint32_t{in[1]} << 8U) | std::uint32_t{in[2]};
          std::memcpy(out, &pixel, sizeof(pixel));  // 0RGB in the machine's own byte order
        }
      }
      return;
    default:
      for (int i = 0; i < frame.plane_count; ++i) {
        copy_plane(frame.planes[static_cast<std::size_t>(i)], picture, static_cast<std::size_t>(i));
      }
  }
}

}  // namespace

struct LosslessVideo::Impl {
  std::string name;
  PixelFormat format = PixelFormat::grey8;
  AvOutput muxer;
  Av<AVCodecContext> encoder;
  Av<AVFrame> picture;
  Av<AVPacket> packet;
  std::int64_t first_ns = 0;
  std::int64_t last_pts = -1;

  tl::unexpected<Error> failed(const char* what, int error) const {
    const char* remedy = error == AVERROR(ENOMEM) ? "end other programs, or use a smaller --size"
                                                  : "free some space or choose another place";
    return fail("{}: {}: {}; {}", name, what, av_error_text(error), remedy);
  }
  tl::unexpected<Error> not_set_up(int error) const {
    return fail("{}: the encoder cannot be set up: {}; choose another --size, or --format mjpeg",
                name, av_error_text(error));
  }

  Result<void> open(const Frame& first) {
    const AVCodec* codec = avcodec_find_encoder(AV_CODEC_ID_FFV1);
    if (codec == nullptr) return fail("{}: this libavcodec has no FFV1 encoder", name);
    format = first.format;
    first_ns = first.timestamp_ns;
    AVFormatContext* made = nullptr;
    int error = avformat_alloc_output_context2(&made, nullptr, "matroska", name.c_str());
    if (error < 0) return failed("cannot be written", error);
    muxer.reset(made);
    encoder.reset(avcodec_alloc_context3(codec));
    picture.reset(av_frame_alloc());
    packet.reset(av_packet_alloc());
    if (!encoder || !picture || !packet)
      return failed("the encoder has no memory", AVERROR(ENOMEM));
    encoder->width = first.width;
    encoder->height = first.height;
    encoder->pix_fmt = stored_format(first.format);
    encoder->time_base = kMatroskaTimeBase;
    encoder->thread_count = 1;
    encoder->level = 3;
    encoder->gop_size = 1;  // every frame stands alone
    encoder->slices = 4;
    encoder->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    encoder->colorspace = first.format == PixelFormat::rgb24         ? AVCOL_SPC_RGB
                          : first.color_matrix == ColorMatrix::bt709 ? AVCOL_SPC_BT709
                                                                     : AVCOL_SPC_SMPTE170M;
    encoder->color_range =
        first.color_range == ColorRange::full ? AVCOL_RANGE_JPEG : AVCOL_RANGE_MPEG;
    AVDictionary* options = nullptr;
    av_dict_set(&options, "slicecrc", "1", 0);
    error = avcodec_open2(encoder.get(), codec, &options);
    av_dict_free(&options);
    if (error < 0) return not_set_up(error);
    picture->format = encoder->pix_fmt;
    picture->width = encoder->width;
    picture->height = encoder->height;
    picture->colorspace = encoder->colorspace;
    picture->color_range = encoder->color_range;
    error = av_frame_get_buffer(picture.get(), 0);
    if (error < 0) return failed("no memory for a frame", error);

    AVStream* stream = avformat_new_stream(muxer.get(), nullptr);
    if (stream == nullptr) return failed("the encoder has no memory", AVERROR(ENOMEM));
    stream->time_base = kMatroskaTimeBase;
    error = avcodec_parameters_from_context(stream->codecpar, encoder.get());
    if (error < 0) return not_set_up(error);
    error = avio_open(&muxer->pb, ("file:" + name).c_str(), AVIO_FLAG_WRITE);
    if (error < 0) return failed("cannot be written", error);
    error = avformat_write_header(muxer.get(), nullptr);
    if (error < 0) return failed("cannot be written", error);
    avio_flush(muxer->pb);
    return {};
  }

  Result<void> encode(const AVFrame& frame) {
    int error = avcodec_send_frame(encoder.get(), &frame);
    while (error >= 0) {
      error = avcodec_receive_packet(encoder.get(), packet.get());
      if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return {};
      if (error < 0) break;
      packet->stream_index = 0;
      av_packet_rescale_ts(packet.get(), kMatroskaTimeBase, muxer->streams[0]->time_base);
      error = av_write_frame(muxer.get(), packet.get());
      av_packet_unref(packet.get());
      // Ends the cluster: from here on the frame is in the file, whatever happens to the program.
      if (error >= 0) error = av_write_frame(muxer.get(), nullptr);
      if (error >= 0) {
        avio_flush(muxer->pb);
        error = muxer->pb->error;
      }
    }
    return failed("cannot be written", error);
  }
};

LosslessVideo::LosslessVideo(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
LosslessVideo::LosslessVideo(LosslessVideo&&) noexcept = default;
LosslessVideo& LosslessVideo::operator=(LosslessVideo&&) noexcept = default;
LosslessVideo::~LosslessVideo() = default;

Result<LosslessVideo> LosslessVideo::create(const std::filesystem::path& file, const Frame& first) {
  auto impl = std::make_unique<Impl>();
  impl->name = file.string();
  PENUMBRA_TRY_VOID(impl->open(first));
  return LosslessVideo(std::move(impl));
}

Result<void> LosslessVideo::write(const Frame& frame) {
  Impl& m = *impl_;
  if (frame.format != m.format || frame.width != m.encoder->width ||
      frame.height != m.encoder->height) {
    return fail(
        "{}: a frame of another size or format than the first cannot be stored; record again",
        m.name);
  }
  const int error = av_frame_make_writable(m.picture.get());
  if (error < 0) return m.failed("no memory for a frame", error);
  sort_samples(frame, *m.picture);
  m.last_pts = std::max(m.last_pts + 1, (frame.timestamp_ns - m.first_ns) / 1'000'000);
  m.picture->pts = m.last_pts;
  return m.encode(*m.picture);
}

Result<void> LosslessVideo::finish() {
  const int error = av_write_trailer(impl_->muxer.get());
  if (error < 0) return impl_->failed("cannot be written", error);
  return {};
}

}  // namespace penumbra
