#include "app/output/frame_writer.hpp"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <optional>

#include "app/libav.hpp"
#include "app/output/output_file.hpp"
#include "app/recording/video_reader.hpp"
#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct ScalerFree {
  void operator()(SwsContext* p) const { sws_freeContext(p); }
};
constexpr AVRational kTimeBase{1, 90000};  // MP4's usual clock; Matroska rounds to 1 ms
// Without a declared matrix, players assume BT.709 for videos of this height or more and BT.601 for
// smaller videos. The file declares the matrix that they would assume.
constexpr int kSmallestBt709Height = 720;

class VideoWriter final : public FrameWriter {
 public:
  VideoWriter(OutputFile file, OutputKind codec, const FrameFormat& format)
      : file_(std::move(file)), lossless_(codec == OutputKind::ffv1), format_(format) {}

  // Sets up muxer, encoder and buffers, and writes the header of the file.
  Result<void> open() {
    const AVCodec* codec = lossless_ ? avcodec_find_encoder(AV_CODEC_ID_FFV1)
                                     : avcodec_find_encoder_by_name("libx264");
    if (codec == nullptr) {
      return fail("{}: this libavcodec has no {} encoder; {}", name(),
                  lossless_ ? "FFV1" : "H.264 (libx264)",
                  lossless_ ? "write to a folder instead" : "write to an .mkv file instead");
    }
    const std::string partial = file_.partial().string();
    int error = av_.allocate(codec, lossless_ ? "matroska" : "mp4", partial);
    if (error < 0) return failed("cannot be written", error);
    av_.muxer->flags |= AVFMT_FLAG_BITEXACT;  // omits random ids and dates
    set_up_encoder();
    error = lossless_ ? av_.open_encoder({{"slicecrc", "1"}})
                      : av_.open_encoder({{"preset", "fast"}, {"crf", "18"}});
    if (error >= 0) error = av_.add_stream();
    if (error < 0) return failed("the encoder cannot be set up", error);
    av_.muxer->streams[0]->avg_frame_rate = av_.encoder->framerate;
    av_.muxer->streams[0]->sample_aspect_ratio = av_.encoder->sample_aspect_ratio;
    error = av_.allocate_image();
    if (error < 0) return failed("no memory for a frame", error);
    AVDictionary* options = nullptr;
    if (!lossless_) {
      PENUMBRA_TRY_VOID(make_scaler());
      // Moves the index to the front of the file, so that a browser can play it immediately.
      av_dict_set(&options, "movflags", "+faststart", 0);
    }
    error = av_.write_header(partial, options);
    if (error < 0) return failed("cannot be written", error);
    return {};
  }

  Result<void> write(std::uint64_t /*number*/, std::int64_t timestamp_ns,
                     std::span<const std::uint8_t> rgba) override {
    PENUMBRA_ASSERT(rgba.size() == static_cast<std::size_t>(format_.width) *
                                       static_cast<std::size_t>(format_.height) * 4U);
    const int error = av_frame_make_writable(av_.image.get());
    if (error < 0) return failed("no memory for a frame", error);
    if (lossless_) {
      copy_bgr(rgba);
    } else {
      convert_yuv(rgba);
    }
    if (!first_ns_) first_ns_ = timestamp_ns;
    av_.image->pts = next_pts(timestamp_ns - *first_ns_);
    return encode(av_.image.get());
  }

  Result<void> finish() override {
    if (!first_ns_) return fail("{}: no frame was written", name());
    PENUMBRA_TRY_VOID(encode(nullptr));
    int error = av_write_trailer(av_.muxer.get());
    if (error >= 0) error = avio_closep(&av_.muxer->pb);
    if (error < 0) return failed("cannot be written", error);
    return file_.commit();
  }

  // Keeps a Matroska file, which is readable without an index. An MP4 file is not.
  void rescue() override {
    if (!lossless_ || !first_ns_) return;
    avio_closep(&av_.muxer->pb);
    const auto frames = count_video_frames(file_.partial());
    if (frames && *frames > 0) (void)file_.commit();
  }

 private:
  [[nodiscard]] std::string name() const { return file_.target().string(); }
  [[nodiscard]] tl::unexpected<Error> failed(std::string_view what, int error) const {
    const char* remedy = error == AVERROR(ENOMEM) ? "end other programs, or use smaller frames"
                                                  : "free some space or choose another place";
    return fail("{}: {}: {}; {}", name(), what, av_error_text(error), remedy);
  }

  void set_up_encoder() {
    AVCodecContext& encoder = *av_.encoder;
    encoder.width = lossless_ ? format_.width : (format_.width + 1) / 2 * 2;
    encoder.height = lossless_ ? format_.height : (format_.height + 1) / 2 * 2;
    encoder.time_base = kTimeBase;
    encoder.framerate = av_d2q(1.0 / format_.frame_interval_s, 100000);
    encoder.sample_aspect_ratio = {1, 1};
    encoder.thread_count = 1;  // the output must not depend on the machine
    encoder.flags |= AV_CODEC_FLAG_BITEXACT;
    if ((av_.muxer->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
      encoder.flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    }
    if (lossless_) {
      encoder.pix_fmt = AV_PIX_FMT_0RGB32;
      encoder.colorspace = AVCOL_SPC_RGB;
      encoder.color_range = AVCOL_RANGE_JPEG;
      encoder.color_primaries = AVCOL_PRI_BT709;
      encoder.color_trc = AVCOL_TRC_IEC61966_2_1;
      encoder.level = 3;
      encoder.gop_size = 1;
      encoder.slices = 4;
      return;
    }
    const bool bt709 = format_.height >= kSmallestBt709Height;
    encoder.pix_fmt = AV_PIX_FMT_YUV420P;
    encoder.colorspace = bt709 ? AVCOL_SPC_BT709 : AVCOL_SPC_SMPTE170M;
    encoder.color_primaries = bt709 ? AVCOL_PRI_BT709 : AVCOL_PRI_SMPTE170M;
    encoder.color_trc = bt709 ? AVCOL_TRC_BT709 : AVCOL_TRC_SMPTE170M;
    encoder.color_range = AVCOL_RANGE_MPEG;
    encoder.chroma_sample_location = AVCHROMA_LOC_LEFT;
    encoder.gop_size =
        std::clamp(static_cast<int>(std::lround(2.0 / format_.frame_interval_s)), 1, 600);
  }

  // Converts a time to the encoder's clock, at least one tick of the file after the previous time.
  std::int64_t next_pts(std::int64_t since_first_ns) {
    const std::int64_t tick = lossless_ ? 90 : 1;  // 1 ms, 1/90000 s
    std::int64_t pts =
        av_rescale_rnd(since_first_ns, kTimeBase.den, 1'000'000'000, AV_ROUND_NEAR_INF);
    if (last_pts_) pts = std::max(pts, *last_pts_ + tick);
    last_pts_ = pts;
    return pts;
  }

  // 0RGB32 is stored as B G R X on little-endian machines.
  void copy_bgr(std::span<const std::uint8_t> rgba) {
    const auto width = static_cast<std::size_t>(format_.width);
    for (int y = 0; y < format_.height; ++y) {
      const std::uint8_t* in = rgba.data() + static_cast<std::size_t>(y) * width * 4U;
      std::uint8_t* out =
          av_.image->data[0] + static_cast<std::ptrdiff_t>(y) * av_.image->linesize[0];
      for (std::size_t x = 0; x < width; ++x, in += 4, out += 4) {
        out[0] = in[2];
        out[1] = in[1];
        out[2] = in[0];
        out[3] = 0;
      }
    }
  }

  Result<void> make_scaler() {
    scaler_.reset(sws_getContext(
        av_.encoder->width, av_.encoder->height, AV_PIX_FMT_RGBA, av_.encoder->width,
        av_.encoder->height, AV_PIX_FMT_YUV420P,
        SWS_BICUBIC | SWS_ACCURATE_RND | SWS_BITEXACT | SWS_FULL_CHR_H_INP | SWS_FULL_CHR_H_INT,
        nullptr, nullptr, nullptr));
    if (!scaler_) return fail("{}: libswscale cannot convert RGBA to yuv420p", name());
    const int matrix =
        av_.encoder->colorspace == AVCOL_SPC_BT709 ? SWS_CS_ITU709 : SWS_CS_SMPTE170M;
    constexpr int kFullRange = 1;
    constexpr int kLimitedRange = 0;
    constexpr int kUnity = 1 << 16;  // contrast and saturation 1, fixed point
    const int error =
        sws_setColorspaceDetails(scaler_.get(), sws_getCoefficients(matrix), kFullRange,
                                 sws_getCoefficients(matrix), kLimitedRange, 0, kUnity, kUnity);
    if (error < 0) return fail("{}: libswscale cannot convert RGBA to yuv420p", name());
    if (av_.encoder->width != format_.width || av_.encoder->height != format_.height) {
      padded_.resize(static_cast<std::size_t>(av_.encoder->width) *
                     static_cast<std::size_t>(av_.encoder->height) * 4U);
    }
    return {};
  }

  void convert_yuv(std::span<const std::uint8_t> rgba) {
    const std::uint8_t* pixels = rgba.data();
    if (!padded_.empty()) {
      pad(rgba);
      pixels = padded_.data();
    }
    const std::array<const std::uint8_t*, 1> planes{pixels};
    const std::array<int, 1> strides{av_.encoder->width * 4};
    sws_scale(scaler_.get(), planes.data(), strides.data(), 0, av_.encoder->height, av_.image->data,
              av_.image->linesize);
  }

  // Repeats the last column and row, so that both sides are even.
  void pad(std::span<const std::uint8_t> rgba) {
    const auto width = static_cast<std::size_t>(format_.width);
    const auto padded_width = static_cast<std::size_t>(av_.encoder->width);
    for (int y = 0; y < av_.encoder->height; ++y) {
      const auto from = static_cast<std::size_t>(std::min(y, format_.height - 1));
      const std::uint8_t* in = rgba.data() + from * width * 4U;
      std::uint8_t* out = padded_.data() + static_cast<std::size_t>(y) * padded_width * 4U;
      std::memcpy(out, in, width * 4U);
      for (std::size_t x = width; x < padded_width; ++x) {
        std::memcpy(out + x * 4U, in + (width - 1) * 4U, 4);
      }
    }
  }

  // Encodes one frame (nullptr: end of the video) and writes the packets.
  Result<void> encode(const AVFrame* image) {
    int error = avcodec_send_frame(av_.encoder.get(), image);
    if (error < 0) return failed("a frame cannot be encoded", error);
    const std::int64_t duration =
        std::llround(format_.frame_interval_s * static_cast<double>(kTimeBase.den));
    while (true) {
      error = avcodec_receive_packet(av_.encoder.get(), av_.packet.get());
      if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return {};
      if (error < 0) return failed("a frame cannot be encoded", error);
      av_.packet->stream_index = 0;
      av_.packet->duration = duration;
      av_packet_rescale_ts(av_.packet.get(), kTimeBase, av_.muxer->streams[0]->time_base);
      error = av_interleaved_write_frame(av_.muxer.get(), av_.packet.get());
      if (error < 0) return failed("cannot be written", error);
    }
  }

  OutputFile file_;
  bool lossless_;  // FFV1, else H.264
  FrameFormat format_;
  AvEncoding av_;
  std::unique_ptr<SwsContext, ScalerFree> scaler_;
  std::vector<std::uint8_t> padded_;
  std::optional<std::int64_t> first_ns_;
  std::optional<std::int64_t> last_pts_;
};

}  // namespace

Result<std::unique_ptr<FrameWriter>> create_video_writer(const std::filesystem::path& file,
                                                         OutputKind codec,
                                                         const FrameFormat& format) {
  PENUMBRA_ASSERT(format.width > 0 && format.height > 0 && format.frame_interval_s > 0.0);
  PENUMBRA_TRY_VOID(load_libav());
  PENUMBRA_TRY(auto output, OutputFile::create(file));
  auto writer = std::make_unique<VideoWriter>(std::move(output), codec, format);
  PENUMBRA_TRY_VOID(writer->open());
  return writer;
}

}  // namespace penumbra
