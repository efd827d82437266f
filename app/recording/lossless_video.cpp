#include "app/recording/lossless_video.hpp"

#include <algorithm>
#include <cstring>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr AVRational kMatroskaTimeBase{1, 1000};

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

std::uint8_t* row_of(AVFrame& image, std::size_t plane, int y) {
  return image.data[plane] + static_cast<std::ptrdiff_t>(y) * image.linesize[plane];
}

// Copies `width` samples of each row, from byte `start` in steps of `step`, to a plane.
void copy_every(const PixelPlane& from, int start, int step, int width, AVFrame& image,
                std::size_t plane) {
  for (int y = 0; y < from.height; ++y) {
    const std::uint8_t* in = from.data + y * from.stride + start;
    std::uint8_t* out = row_of(image, plane, y);
    if (step == 1) {
      std::memcpy(out, in, static_cast<std::size_t>(width));
    } else {
      for (int x = 0; x < width; ++x) out[x] = in[step * x];
    }
  }
}

void copy_samples(const Frame& frame, AVFrame& image) {
  const PixelPlane& first = frame.planes[0];
  switch (frame.format) {
    case PixelFormat::yuyv:
      copy_every(first, 0, 2, frame.width, image, 0);
      copy_every(first, 1, 4, first.width, image, 1);
      copy_every(first, 3, 4, first.width, image, 2);
      return;
    case PixelFormat::nv12:
      copy_every(first, 0, 1, first.width, image, 0);
      copy_every(frame.planes[1], 0, 2, frame.planes[1].width, image, 1);
      copy_every(frame.planes[1], 1, 2, frame.planes[1].width, image, 2);
      return;
    case PixelFormat::rgb24:
      for (int y = 0; y < frame.height; ++y) {
        const std::uint8_t* in = first.data + y * first.stride;
        std::uint8_t* out = row_of(image, 0, y);
        for (int x = 0; x < frame.width; ++x, in += 3, out += 4) {
          const std::uint32_t pixel =
              (std::uint32_t{in[0]} << 16U) | (std::uint32_t{in[1]} << 8U) | std::uint32_t{in[2]};
          std::memcpy(out, &pixel, sizeof(pixel));  // 0RGB in native byte order
        }
      }
      return;
    default:
      for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
        copy_every(frame.planes[i], 0, 1, frame.planes[i].width, image, i);
      }
  }
}

}  // namespace

tl::unexpected<Error> LosslessVideo::failed(const char* what, int error) const {
  const char* remedy = error == AVERROR(ENOMEM) ? "end other programs, or use a smaller --size"
                                                : "free some space or choose another place";
  return fail("{}: {}: {}; {}", name_, what, av_error_text(error), remedy);
}

Result<LosslessVideo> LosslessVideo::create(const std::filesystem::path& file, const Frame& first) {
  PENUMBRA_TRY_VOID(load_libav());
  LosslessVideo video;
  video.name_ = file.string();
  PENUMBRA_TRY_VOID(video.open(first));
  return video;
}

Result<void> LosslessVideo::open(const Frame& first) {
  const AVCodec* codec = avcodec_find_encoder(AV_CODEC_ID_FFV1);
  if (codec == nullptr) return fail("{}: this libavcodec has no FFV1 encoder", name_);
  format_ = first.format;
  first_ns_ = first.timestamp_ns;
  int error = av_.allocate(codec, "matroska", name_);
  if (error == AVERROR(ENOMEM)) return failed("the encoder has no memory", error);
  if (error < 0) return failed("cannot be written", error);
  AVCodecContext& encoder = *av_.encoder;
  encoder.width = first.width;
  encoder.height = first.height;
  encoder.pix_fmt = stored_format(first.format);
  encoder.time_base = kMatroskaTimeBase;
  encoder.thread_count = 1;
  encoder.level = 3;
  encoder.gop_size = 1;  // every frame is a key frame
  encoder.slices = 4;
  encoder.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
  encoder.colorspace = first.format == PixelFormat::rgb24         ? AVCOL_SPC_RGB
                       : first.color_matrix == ColorMatrix::bt709 ? AVCOL_SPC_BT709
                                                                  : AVCOL_SPC_SMPTE170M;
  encoder.color_range = first.color_range == ColorRange::full ? AVCOL_RANGE_JPEG : AVCOL_RANGE_MPEG;
  error = av_.open_encoder({{"slicecrc", "1"}});
  if (error >= 0) error = av_.add_stream();
  if (error < 0) {
    return fail("{}: the encoder cannot be set up: {}; choose another --size, or --format mjpeg",
                name_, av_error_text(error));
  }
  error = av_.allocate_image();
  if (error < 0) return failed("no memory for a frame", error);
  error = av_.write_header(name_);
  if (error < 0) return failed("cannot be written", error);
  avio_flush(av_.muxer->pb);
  return {};
}

Result<void> LosslessVideo::write(const Frame& frame) {
  if (frame.format != format_ || frame.width != av_.encoder->width ||
      frame.height != av_.encoder->height) {
    return fail(
        "{}: a frame of another size or format than the first cannot be stored; record again",
        name_);
  }
  const int error = av_frame_make_writable(av_.image.get());
  if (error < 0) return failed("no memory for a frame", error);
  copy_samples(frame, *av_.image);
  last_pts_ = std::max(last_pts_ + 1, (frame.timestamp_ns - first_ns_) / 1'000'000);
  av_.image->pts = last_pts_;
  return encode();
}

Result<void> LosslessVideo::encode() {
  AVFormatContext* muxer = av_.muxer.get();
  AVPacket* packet = av_.packet.get();
  int error = avcodec_send_frame(av_.encoder.get(), av_.image.get());
  while (error >= 0) {
    error = avcodec_receive_packet(av_.encoder.get(), packet);
    if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return {};
    if (error < 0) break;
    packet->stream_index = 0;
    av_packet_rescale_ts(packet, kMatroskaTimeBase, muxer->streams[0]->time_base);
    error = av_write_frame(muxer, packet);
    av_packet_unref(packet);
    // Ends the cluster, so that the frame is in the file even if the program crashes.
    if (error >= 0) error = av_write_frame(muxer, nullptr);
    if (error >= 0) {
      avio_flush(muxer->pb);
      error = muxer->pb->error;
    }
  }
  return failed("cannot be written", error);
}

Result<void> LosslessVideo::finish() {
  const int error = av_write_trailer(av_.muxer.get());
  if (error < 0) return failed("cannot be written", error);
  return {};
}

}  // namespace penumbra
