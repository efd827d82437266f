#include "app/output/video_writer.hpp"

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

extern "C" {
#include <libavutil/opt.h>
#include <libswscale/swscale.h>
}

namespace penumbra {
namespace {

struct ScalerFree {
  void operator()(SwsContext* p) const { sws_freeContext(p); }
};
constexpr AVRational kTimeBase{1, 90000};  // MP4's usual clock; Matroska rounds to 1 ms
// Pictures this tall or taller are taken by players as BT.709 where a file doesn't say, smaller
// ones as BT.601: the file says what they would guess.
constexpr int kSmallestBt709Height = 720;

class VideoWriter final : public FrameWriter {
 public:
  VideoWriter(OutputFile file, VideoCodec codec, const FrameFormat& format)
      : file_(std::move(file)), codec_(codec), format_(format) {}

  // The muxer, encoder and buffers, and the header of the file.
  Result<void> open() {
    const AVCodec* encoder = codec_ == VideoCodec::ffv1 ? avcodec_find_encoder(AV_CODEC_ID_FFV1)
                                                        : avcodec_find_encoder_by_name("libx264");
    if (encoder == nullptr) {
      return fail("{}: this libavcodec has no {} encoder; {}", name(),
                  codec_ == VideoCodec::ffv1 ? "FFV1" : "H.264 (libx264)",
                  codec_ == VideoCodec::ffv1 ? "write to a folder instead"
                                             : "write to an .mkv file instead");
    }
    AVFormatContext* muxer = nullptr;
    int error = avformat_alloc_output_context2(
        &muxer, nullptr, codec_ == VideoCodec::ffv1 ? "matroska" : "mp4", file_.partial().c_str());
    if (error < 0) return failed("cannot be written", error);
    muxer_.reset(muxer);
    muxer_->flags |= AVFMT_FLAG_BITEXACT;  // no random ids, no dates

    encoder_.reset(avcodec_alloc_context3(encoder));
    PENUMBRA_ASSERT(encoder_ != nullptr);
    const bool even = codec_ == VideoCodec::h264;
    encoder_->width = even ? (format_.width + 1) / 2 * 2 : format_.width;
    encoder_->height = even ? (format_.height + 1) / 2 * 2 : format_.height;
    encoder_->time_base = kTimeBase;
    encoder_->framerate = av_d2q(1.0 / format_.frame_interval_s, 100000);
    encoder_->sample_aspect_ratio = {1, 1};
    // One thread: the bytes don't depend on the machine, and the time told for encoding is all of
    // it.
    encoder_->thread_count = 1;
    encoder_->flags |= AV_CODEC_FLAG_BITEXACT;
    if ((muxer_->oformat->flags & AVFMT_GLOBALHEADER) != 0) {
      encoder_->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    }
    AVDictionary* options = nullptr;
    if (codec_ == VideoCodec::ffv1) {
      encoder_->pix_fmt = AV_PIX_FMT_0RGB32;
      encoder_->colorspace = AVCOL_SPC_RGB;
      encoder_->color_range = AVCOL_RANGE_JPEG;
      encoder_->color_primaries = AVCOL_PRI_BT709;
      encoder_->color_trc = AVCOL_TRC_IEC61966_2_1;
      encoder_->level = 3;
      encoder_->gop_size = 1;
      encoder_->slices = 4;
      av_dict_set(&options, "slicecrc", "1", 0);
    } else {
      const bool bt709 = format_.height >= kSmallestBt709Height;
      encoder_->pix_fmt = AV_PIX_FMT_YUV420P;
      encoder_->colorspace = bt709 ? AVCOL_SPC_BT709 : AVCOL_SPC_SMPTE170M;
      encoder_->color_primaries = bt709 ? AVCOL_PRI_BT709 : AVCOL_PRI_SMPTE170M;
      encoder_->color_trc = bt709 ? AVCOL_TRC_BT709 : AVCOL_TRC_SMPTE170M;
      encoder_->color_range = AVCOL_RANGE_MPEG;
      encoder_->chroma_sample_location = AVCHROMA_LOC_LEFT;
      encoder_->gop_size =
          std::clamp(static_cast<int>(std::lround(2.0 / format_.frame_interval_s)), 1, 600);
      av_dict_set(&options, "preset", "fast", 0);
      av_dict_set(&options, "crf", "18", 0);
    }
    error = avcodec_open2(encoder_.get(), encoder, &options);
    av_dict_free(&options);
    if (error < 0) return failed("the encoder cannot be set up", error);

    AVStream* stream = avformat_new_stream(muxer_.get(), nullptr);
    PENUMBRA_ASSERT(stream != nullptr);
    error = avcodec_parameters_from_context(stream->codecpar, encoder_.get());
    if (error < 0) return failed("the encoder cannot be set up", error);
    stream->time_base = kTimeBase;
    stream->avg_frame_rate = encoder_->framerate;
    stream->sample_aspect_ratio = encoder_->sample_aspect_ratio;

    picture_.reset(av_frame_alloc());
    packet_.reset(av_packet_alloc());
    PENUMBRA_ASSERT(picture_ != nullptr && packet_ != nullptr);
    picture_->format = encoder_->pix_fmt;
    picture_->width = encoder_->width;
    picture_->height = encoder_->height;
    picture_->colorspace = encoder_->colorspace;
    picture_->color_primaries = encoder_->color_primaries;
    picture_->color_trc = encoder_->color_trc;
    picture_->color_range = encoder_->color_range;
    error = av_frame_get_buffer(picture_.get(), 0);
    if (error < 0) return failed("no memory for a frame", error);
    if (codec_ == VideoCodec::h264) {
      if (auto made = make_scaler(); !made) return made;
    }

    // "file:": a name with a colon in it is no protocol.
    error = avio_open(&muxer_->pb, ("file:" + file_.partial().string()).c_str(), AVIO_FLAG_WRITE);
    if (error < 0) return failed("cannot be written", error);
    AVDictionary* mux_options = nullptr;
    // The index goes to the front when the file is finished, so that a browser plays it at once.
    if (codec_ == VideoCodec::h264) av_dict_set(&mux_options, "movflags", "+faststart", 0);
    error = avformat_write_header(muxer_.get(), &mux_options);
    av_dict_free(&mux_options);
    if (error < 0) return failed("cannot be written", error);
    return {};
  }

  Result<void> write(std::uint64_t /*number*/, std::int64_t timestamp_ns,
                     std::span<const std::uint8_t> rgba) override {
    PENUMBRA_ASSERT(rgba.size() == static_cast<std::size_t>(format_.width) *
                                       static_cast<std::size_t>(format_.height) * 4U);
    const int error = av_frame_make_writable(picture_.get());
    if (error < 0) return failed("no memory for a frame", error);
    if (codec_ == VideoCodec::ffv1) {
      copy_bgr(rgba);
    } else {
      convert_yuv(rgba);
    }
    if (!first_ns_) first_ns_ = timestamp_ns;
    picture_->pts = next_pts(timestamp_ns - *first_ns_);
    return encode(picture_.get());
  }

  Result<void> finish() override {
    if (!first_ns_) return fail("{}: no frame was written", name());
    if (auto flushed = encode(nullptr); !flushed) return flushed;
    int error = av_write_trailer(muxer_.get());
    if (error < 0) return failed("cannot be written", error);
    error = avio_closep(&muxer_->pb);
    if (error < 0) return failed("cannot be written", error);
    return file_.commit();
  }

  // A Matroska file reads without its index up to where it ends; an MP4 file does not.
  void rescue() override {
    if (codec_ != VideoCodec::ffv1 || !first_ns_) return;
    avio_closep(&muxer_->pb);
    const auto whole = count_video_frames(file_.partial());
    if (whole && *whole > 0) (void)file_.commit();
  }

 private:
  [[nodiscard]] std::string name() const { return file_.target().string(); }
  [[nodiscard]] tl::unexpected<Error> failed(std::string_view what, int error) const {
    const char* remedy = error == AVERROR(ENOMEM) ? "end other programs, or use smaller frames"
                                                  : "free some space or choose another place";
    return fail("{}: {}: {}; {}", name(), what, av_error_text(error), remedy);
  }

  // Times in the encoder's clock, each at least one tick of the file's clock after the one before.
  std::int64_t next_pts(std::int64_t since_first_ns) {
    const std::int64_t tick = codec_ == VideoCodec::ffv1 ? 90 : 1;  // 1 ms, 1/90000 s
    std::int64_t pts =
        av_rescale_rnd(since_first_ns, kTimeBase.den, 1'000'000'000, AV_ROUND_NEAR_INF);
    if (last_pts_) pts = std::max(pts, *last_pts_ + tick);
    last_pts_ = pts;
    return pts;
  }

  // 0RGB32 is B G R X in memory on the machines this runs on.
  void copy_bgr(std::span<const std::uint8_t> rgba) {
    const auto width = static_cast<std::size_t>(format_.width);
    for (int y = 0; y < format_.height; ++y) {
      const std::uint8_t* in = rgba.data() + static_cast<std::size_t>(y) * width * 4U;
      std::uint8_t* out =
          picture_->data[0] + static_cast<std::ptrdiff_t>(y) * picture_->linesize[0];
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
        encoder_->width, encoder_->height, AV_PIX_FMT_RGBA, encoder_->width, encoder_->height,
        AV_PIX_FMT_YUV420P,
        SWS_BICUBIC | SWS_ACCURATE_RND | SWS_BITEXACT | SWS_FULL_CHR_H_INP | SWS_FULL_CHR_H_INT,
        nullptr, nullptr, nullptr));
    if (!scaler_) return fail("{}: libswscale cannot convert RGBA to yuv420p", name());
    const int matrix = encoder_->colorspace == AVCOL_SPC_BT709 ? SWS_CS_ITU709 : SWS_CS_SMPTE170M;
    constexpr int kFull = 1;
    constexpr int kLimited = 0;
    constexpr int kOne = 1 << 16;
    const int error =
        sws_setColorspaceDetails(scaler_.get(), sws_getCoefficients(matrix), kFull,
                                 sws_getCoefficients(matrix), kLimited, 0, kOne, kOne);
    if (error < 0) return fail("{}: libswscale cannot convert RGBA to yuv420p", name());
    if (encoder_->width != format_.width || encoder_->height != format_.height) {
      padded_.resize(static_cast<std::size_t>(encoder_->width) *
                     static_cast<std::size_t>(encoder_->height) * 4U);
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
    const std::array<int, 1> strides{encoder_->width * 4};
    sws_scale(scaler_.get(), planes.data(), strides.data(), 0, encoder_->height, picture_->data,
              picture_->linesize);
  }

  // Repeats the last column and row up to even sides.
  void pad(std::span<const std::uint8_t> rgba) {
    const auto width = static_cast<std::size_t>(format_.width);
    const auto padded_width = static_cast<std::size_t>(encoder_->width);
    for (int y = 0; y < encoder_->height; ++y) {
      const auto from = static_cast<std::size_t>(std::min(y, format_.height - 1));
      const std::uint8_t* in = rgba.data() + from * width * 4U;
      std::uint8_t* out = padded_.data() + static_cast<std::size_t>(y) * padded_width * 4U;
      std::memcpy(out, in, width * 4U);
      for (std::size_t x = width; x < padded_width; ++x) {
        std::memcpy(out + x * 4U, in + (width - 1) * 4U, 4);
      }
    }
  }

  // Sends one picture (null: the end) and writes what comes out.
  Result<void> encode(const AVFrame* picture) {
    int error = avcodec_send_frame(encoder_.get(), picture);
    if (error < 0) return failed("a frame cannot be encoded", error);
    const std::int64_t duration =
        std::llround(format_.frame_interval_s * static_cast<double>(kTimeBase.den));
    while (true) {
      error = avcodec_receive_packet(encoder_.get(), packet_.get());
      if (error == AVERROR(EAGAIN) || error == AVERROR_EOF) return {};
      if (error < 0) return failed("a frame cannot be encoded", error);
      packet_->stream_index = 0;
      packet_->duration = duration;
      av_packet_rescale_ts(packet_.get(), kTimeBase, muxer_->streams[0]->time_base);
      error = av_interleaved_write_frame(muxer_.get(), packet_.get());
      if (error < 0) return failed("cannot be written", error);
    }
  }

  OutputFile file_;
  VideoCodec codec_;
  FrameFormat format_;
  AvOutput muxer_;
  Av<AVCodecContext> encoder_;
  Av<AVFrame> picture_;
  Av<AVPacket> packet_;
  std::unique_ptr<SwsContext, ScalerFree> scaler_;
  std::vector<std::uint8_t> padded_;
  std::optional<std::int64_t> first_ns_;
  std::optional<std::int64_t> last_pts_;
};

}  // namespace

Result<std::unique_ptr<FrameWriter>> create_video_writer(const std::filesystem::path& file,
                                                         VideoCodec codec,
                                                         const FrameFormat& format) {
  PENUMBRA_ASSERT(format.width > 0 && format.height > 0 && format.frame_interval_s > 0.0);
  PENUMBRA_TRY(auto output, OutputFile::create(file));
  auto writer = std::make_unique<VideoWriter>(std::move(output), codec, format);
  PENUMBRA_TRY_VOID(writer->open());
  return writer;
}

}  // namespace penumbra
