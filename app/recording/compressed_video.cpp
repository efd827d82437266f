#include "app/recording/compressed_video.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <utility>

#include "app/libav.hpp"
#include "app/recording/decoded_frame.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

// Containers that hold times and refer to no other file. Playlists, image sequences and network
// protocols are excluded, because an untrusted file could name any other file or host with them.
constexpr const char* kContainers =
    "mov,matroska,avi,mpegts,mpeg,ogg,flv,asf,ivf,yuv4mpegpipe,dv,mxf,nut";
constexpr std::int64_t kMaxPixels = 36'000'000;  // 8192 x 4320; decoders keep up to 17 frames
constexpr int kMaxSide = 16384;
constexpr std::size_t kMaxFrames = 10'000'000;
constexpr std::int64_t kLongest_ns = 1'000'000'000'000'000;  // 11 days
constexpr int kSmallHeight = 576;  // larger video has BT.709 colours unless it says otherwise

struct FreeScaler {
  void operator()(SwsContext* scaler) const { sws_freeContext(scaler); }
};

// Side data of a stream; libav moved it with version 61 of libavformat.
const std::int32_t* display_matrix_of(const AVStream& stream) {
  constexpr std::size_t kBytes = 9 * sizeof(std::int32_t);
#if LIBAVFORMAT_VERSION_MAJOR >= 61
  const AVPacketSideData* data = stream.codecpar->coded_side_data;
  const int count = stream.codecpar->nb_coded_side_data;
#else
  const AVPacketSideData* data = stream.side_data;
  const int count = stream.nb_side_data;
#endif
  for (int i = 0; i < count; ++i) {
    if (data[i].type == AV_PKT_DATA_DISPLAYMATRIX && data[i].size >= kBytes)
      return reinterpret_cast<const std::int32_t*>(data[i].data);
  }
  return nullptr;
}

// Rotation that makes the stored image upright.
struct Orientation {
  int quarter_turns = 0;     // clockwise, 0 to 3
  bool unsupported = false;  // the container has another angle, or mirrors the image
};

Orientation orientation_of(const AVStream& stream) {
  const std::int32_t* raw = display_matrix_of(stream);
  if (raw == nullptr) return {};
  std::array<double, 9> m{};
  for (std::size_t i = 0; i < m.size(); ++i) {
    std::int32_t value = 0;
    std::memcpy(&value, raw + i, sizeof value);
    m[i] = value;
  }
  const double scale_x = std::hypot(m[0], m[3]);
  const double scale_y = std::hypot(m[1], m[4]);
  if (scale_x == 0.0 || scale_y == 0.0) return {};
  const double turns = std::atan2(m[1] / scale_y, m[0] / scale_x) / (0.5 * std::numbers::pi);
  const double whole = std::round(turns);
  const bool mirrored = m[0] * m[4] - m[1] * m[3] < 0.0;
  if (mirrored || std::abs(turns - whole) > 0.01) return {0, true};
  return {(static_cast<int>(whole) + 4) % 4, false};
}

class Container {
 public:
  static Result<Container> open(const std::filesystem::path& file) {
    PENUMBRA_TRY_VOID(load_libav());
    Container container;
    container.name_ = file.string();
    std::error_code error;
    if (!std::filesystem::is_regular_file(file, error)) {
      return fail("{}: {}", container.name_, error ? error.message() : "is not a file");
    }
    AVDictionary* options = nullptr;
    av_dict_set(&options, "format_whitelist", kContainers, 0);
    av_dict_set(&options, "protocol_whitelist", "file", 0);
    AVFormatContext* format = nullptr;
    int status =
        avformat_open_input(&format, ("file:" + container.name_).c_str(), nullptr, &options);
    av_dict_free(&options);
    if (status >= 0) {
      container.format_.reset(format);
      format->flags |= AVFMT_FLAG_GENPTS;
      PENUMBRA_TRY_VOID(container.check_sizes());  // before the streams are probed by decoding
      status = avformat_find_stream_info(format, nullptr);
    }
    if (status < 0) {
      return fail(
          "{}: is not a folder, and cannot be read as a video ({}); if it is one, it is cut off "
          "(copy it again) or of another container (ffmpeg -i IN OUT.mp4)",
          container.name_, av_error_text(status));
    }
    for (unsigned i = 0; i < format->nb_streams && container.stream_ < 0; ++i) {
      const AVStream& stream = *format->streams[i];
      const bool cover = (stream.disposition & AV_DISPOSITION_ATTACHED_PIC) != 0;
      if (stream.codecpar->codec_type == AVMEDIA_TYPE_VIDEO && !cover)
        container.stream_ = static_cast<int>(i);
    }
    if (container.stream_ < 0) return fail("{}: holds no video stream", container.name_);
    for (unsigned i = 0; i < format->nb_streams; ++i) {
      if (static_cast<int>(i) != container.stream_) format->streams[i]->discard = AVDISCARD_ALL;
    }
    PENUMBRA_TRY_VOID(container.check_sizes());
    container.packet_.reset(av_packet_alloc());
    if (!container.packet_) return fail("{}: no memory for the reader", container.name_);
    return container;
  }

  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] const AVStream& stream() const { return *format_->streams[stream_]; }

  // Fails if the image of a stream is too large.
  [[nodiscard]] Result<void> check_sizes() const {
    for (unsigned i = 0; i < format_->nb_streams; ++i) {
      const AVCodecParameters& stream = *format_->streams[i]->codecpar;
      if (std::int64_t{stream.width} * stream.height <= kMaxPixels &&
          std::max(stream.width, stream.height) <= kMaxSide)
        continue;
      return fail("{}: is {} x {} px; at most {} million pixels and {} on a side are read", name_,
                  stream.width, stream.height, kMaxPixels / 1'000'000, kMaxSide);
    }
    return {};
  }

  // Returns the next packet of the video, valid until the next call; nullptr at the end, or where
  // the rest of the file is damaged.
  AVPacket* next() {
    while (true) {
      av_packet_unref(packet_.get());
      status_ = av_read_frame(format_.get(), packet_.get());
      if (status_ < 0) return nullptr;
      // An empty packet repeats the frame before it; a decoder would take it as the end.
      if (packet_->stream_index == stream_ && packet_->size > 0) return packet_.get();
    }
  }

  // Returns the duration of the longest stream; 0 if the container does not declare it.
  [[nodiscard]] std::int64_t duration_ns() const {
    constexpr std::int64_t kNsPerUnit = 1'000'000'000 / AV_TIME_BASE;
    const std::int64_t duration = format_->duration;
    return duration > 0 && duration < kLongest_ns / kNsPerUnit ? duration * kNsPerUnit : 0;
  }

  // Returns true if next() ended before the end of the file.
  [[nodiscard]] bool is_cut_off() const { return status_ != AVERROR_EOF; }

  // Converts a time of the stream; nullopt if it is unknown or out of range.
  [[nodiscard]] std::optional<std::int64_t> nanoseconds_of(std::int64_t time) const {
    if (time == AV_NOPTS_VALUE) return std::nullopt;
    const AVRational unit = stream().time_base;
    if (unit.num <= 0 || unit.den <= 0) return std::nullopt;
    const std::int64_t ns =
        av_rescale_rnd(time, unit.num * std::int64_t{1'000'000'000}, unit.den, AV_ROUND_NEAR_INF);
    if (ns < -kLongest_ns || ns > kLongest_ns) return std::nullopt;
    return ns;
  }

 private:
  AvInput format_;
  Av<AVPacket> packet_;
  std::string name_;
  int stream_ = -1;
  int status_ = 0;  // of av_read_frame()
};

std::vector<std::string> notices_of(const Container& container) {
  std::vector<std::string> notices;
  const auto add = [&](std::string_view text) {
    notices.push_back(fmt::format("{}: {}", container.name(), text));
  };
  const AVStream& stream = container.stream();
  const Orientation orientation = orientation_of(stream);
  if (orientation.quarter_turns != 0) {
    add(
        fmt::format("is rotated clockwise by {} degrees (display matrix); calibrate with video "
                    "that was held the same way",
                    90 * orientation.quarter_turns));
  }
  if (orientation.unsupported) {
    add("its display matrix mirrors the image or rotates it by another angle than 90 degrees; it "
        "is ignored");
  }
  const AVFieldOrder order = stream.codecpar->field_order;
  if (order != AV_FIELD_UNKNOWN && order != AV_FIELD_PROGRESSIVE)
    add("is interlaced, so that each image mixes two times; record progressive video");
  const AVRational pixel = stream.sample_aspect_ratio.num != 0
                               ? stream.sample_aspect_ratio
                               : stream.codecpar->sample_aspect_ratio;
  if (pixel.num > 0 && pixel.den > 0 && pixel.num != pixel.den) {
    add(
        fmt::format("has pixels of {}:{}; they are shown as squares, and the camera file must be "
                    "of this video",
                    pixel.num, pixel.den));
  }
  const auto format = static_cast<AVPixelFormat>(stream.codecpar->format);
  if (const AVPixFmtDescriptor* description = av_pix_fmt_desc_get(format);
      description != nullptr && description->comp[0].depth > 8)
    add(fmt::format("{} bits per sample are reduced to 8", description->comp[0].depth));
  return notices;
}

// Returns the format with the same colours that frame_of() converts, and that can be rotated.
AVPixelFormat plain_format(const AVPixFmtDescriptor& of) {
  if ((of.flags & (AV_PIX_FMT_FLAG_RGB | AV_PIX_FMT_FLAG_PAL)) != 0) return AV_PIX_FMT_GBRP;
  if (of.nb_components < 3) return AV_PIX_FMT_GRAY8;
  return of.log2_chroma_h == 0 ? AV_PIX_FMT_YUV444P : AV_PIX_FMT_YUV420P;
}

// Old decoders declare the range by the pixel format.
bool is_full_range(const AVFrame& frame) {
  constexpr std::array kFull = {AV_PIX_FMT_YUVJ420P, AV_PIX_FMT_YUVJ422P, AV_PIX_FMT_YUVJ444P,
                                AV_PIX_FMT_YUVJ440P, AV_PIX_FMT_YUVJ411P};
  return frame.color_range == AVCOL_RANGE_JPEG ||
         std::ranges::count(kFull, static_cast<AVPixelFormat>(frame.format)) > 0;
}

// Copies a plane of bytes, rotated clockwise.
void rotate_plane(const std::uint8_t* from, std::ptrdiff_t stride, int width, int height, int turns,
                  std::uint8_t* to, std::ptrdiff_t to_stride) {
  for (std::ptrdiff_t y = 0; y < height; ++y) {
    for (std::ptrdiff_t x = 0; x < width; ++x) {
      const std::uint8_t value = from[y * stride + x];
      if (turns == 1) to[x * to_stride + (height - 1 - y)] = value;
      if (turns == 2) to[(height - 1 - y) * to_stride + (width - 1 - x)] = value;
      if (turns == 3) to[(width - 1 - x) * to_stride + y] = value;
    }
  }
}

}  // namespace

struct CompressedVideo::Impl {
  Container container;
  std::vector<std::int64_t> times_ns;
  std::int64_t offset_ns = 0;  // of the listed times from those of the container
  int quarter_turns = 0;
  Av<AVCodecContext> decoder;
  std::unique_ptr<SwsContext, FreeScaler> scaler;
  AVPixelFormat scaled_from = AV_PIX_FMT_NONE;
  int scaled_width = 0, scaled_height = 0;
  Av<AVFrame> waiting;  // decoded, for a later listed frame
  std::int64_t waiting_ns = 0;
  std::size_t at = 0;             // index of the next listed frame
  bool ended = false;             // all packets were sent
  bool builds_on_damage = false;  // a frame since the last intra-coded one is damaged

  tl::unexpected<Error> damaged() const {
    return fail("{}: frame {}: is damaged; record or copy the video again", container.name(), at);
  }

  // Decodes the next image, in the order of display; null at the end.
  Result<Av<AVFrame>> decode() {
    Av<AVFrame> decoded(av_frame_alloc());
    if (!decoded) return fail("{}: no memory for a frame", container.name());
    while (true) {
      const int status = avcodec_receive_frame(decoder.get(), decoded.get());
      if (status >= 0) return decoded;
      if (status == AVERROR_EOF || ended) return Av<AVFrame>();
      const AVPacket* packet = container.next();
      ended = packet == nullptr;
      // The frames of damaged packets are missing among the decoded ones.
      const int sent = avcodec_send_packet(decoder.get(), packet);
      if (status != AVERROR(EAGAIN) || sent < 0) builds_on_damage = true;
    }
  }

  // Sets `waiting` to the next decoded image whose time is not before that of the listed frame.
  Result<void> fetch() {
    while (!waiting || waiting_ns < times_ns[at]) {
      PENUMBRA_TRY(waiting, decode());
      if (!waiting) return {};
      // The estimate of libav may be the time of decoding.
      const auto time_ns = container.nanoseconds_of(
          waiting->pts != AV_NOPTS_VALUE ? waiting->pts : waiting->best_effort_timestamp);
      waiting_ns = time_ns ? *time_ns + offset_ns : -1;  // listed times are not negative
    }
    return {};
  }

  // Returns the listed frame; null if it is damaged or builds on a damaged one.
  Result<Av<AVFrame>> take() {
    PENUMBRA_TRY_VOID(fetch());
    if (!waiting || waiting_ns > times_ns[at]) return Av<AVFrame>();
    Av<AVFrame> taken = std::move(waiting);
    const bool broken = taken->decode_error_flags != 0 ||
                        (taken->flags & AV_FRAME_FLAG_CORRUPT) != 0 || taken->width <= 0 ||
                        taken->height <= 0;
    builds_on_damage = broken || (builds_on_damage && taken->pict_type != AV_PICTURE_TYPE_I);
    return builds_on_damage ? Av<AVFrame>() : std::move(taken);
  }

  // Converts the pixel format, without a change of matrix and range.
  Result<Av<AVFrame>> converted(Av<AVFrame> decoded, AVPixelFormat to) {
    const auto from = static_cast<AVPixelFormat>(decoded->format);
    if (from != scaled_from || decoded->width != scaled_width || decoded->height != scaled_height) {
      scaler.reset(sws_getContext(decoded->width, decoded->height, from, decoded->width,
                                  decoded->height, to, SWS_POINT | SWS_ACCURATE_RND | SWS_BITEXACT,
                                  nullptr, nullptr, nullptr));
      scaled_from = from;
      scaled_width = decoded->width;
      scaled_height = decoded->height;
    }
    Av<AVFrame> image(av_frame_alloc());
    if (!image) return fail("{}: no memory for a frame", container.name());
    image->format = to;
    image->width = decoded->width;
    image->height = decoded->height;
    image->colorspace = decoded->colorspace;
    const bool full = is_full_range(*decoded);
    image->color_range = full ? AVCOL_RANGE_JPEG : decoded->color_range;
    const char* format = av_get_pix_fmt_name(from);
    if (!scaler || av_frame_get_buffer(image.get(), 0) < 0) {
      return fail("{}: its pixel format {} can't be read; convert it: ffmpeg -i IN OUT.mp4",
                  container.name(), format != nullptr ? format : "unknown");
    }
    constexpr int kUnity = 1 << 16;
    const int* matrix = sws_getCoefficients(SWS_CS_ITU709);
    sws_setColorspaceDetails(scaler.get(), matrix, full ? 1 : 0, matrix, full ? 1 : 0, 0, kUnity,
                             kUnity);
    sws_scale(scaler.get(), decoded->data, decoded->linesize, 0, decoded->height, image->data,
              image->linesize);
    return image;
  }

  Result<Av<AVFrame>> rotated(const AVFrame& stored) {
    const bool sideways = quarter_turns % 2 == 1;
    Av<AVFrame> image(av_frame_alloc());
    if (!image) return fail("{}: no memory for a frame", container.name());
    image->format = stored.format;
    image->width = sideways ? stored.height : stored.width;
    image->height = sideways ? stored.width : stored.height;
    image->colorspace = stored.colorspace;
    image->color_range = stored.color_range;
    if (av_frame_get_buffer(image.get(), 0) < 0)
      return fail("{}: no memory for a frame", container.name());
    const AVPixFmtDescriptor& format =
        *av_pix_fmt_desc_get(static_cast<AVPixelFormat>(stored.format));
    for (int i = 0; i < av_pix_fmt_count_planes(static_cast<AVPixelFormat>(stored.format)); ++i) {
      const bool chroma = (i == 1 || i == 2) && (format.flags & AV_PIX_FMT_FLAG_RGB) == 0;
      const int width = chroma ? AV_CEIL_RSHIFT(stored.width, format.log2_chroma_w) : stored.width;
      const int height =
          chroma ? AV_CEIL_RSHIFT(stored.height, format.log2_chroma_h) : stored.height;
      rotate_plane(stored.data[i], stored.linesize[i], width, height, quarter_turns, image->data[i],
                   image->linesize[i]);
    }
    return image;
  }

  Result<Frame> convert(Av<AVFrame> decoded) {
    const auto format = static_cast<AVPixelFormat>(decoded->format);
    const AVPixFmtDescriptor* description = av_pix_fmt_desc_get(format);
    if (description == nullptr) return damaged();
    const AVPixelFormat plain = plain_format(*description);
    if ((quarter_turns != 0 ? format != plain : !is_frame_format(format)) ||
        has_upward_rows(*decoded)) {
      PENUMBRA_TRY(decoded, converted(std::move(decoded), plain));
    }
    if (quarter_turns != 0) {
      PENUMBRA_TRY(decoded, rotated(*decoded));
    }
    const ColorMatrix matrix = std::min(decoded->width, decoded->height) > kSmallHeight
                                   ? ColorMatrix::bt709
                                   : ColorMatrix::bt601;
    return frame_of(std::move(decoded), matrix);
  }
};

CompressedVideo::CompressedVideo(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
CompressedVideo::CompressedVideo(CompressedVideo&&) noexcept = default;
CompressedVideo& CompressedVideo::operator=(CompressedVideo&&) noexcept = default;
CompressedVideo::~CompressedVideo() = default;

Result<VideoListing> CompressedVideo::list(const std::filesystem::path& file) {
  PENUMBRA_TRY(Container container, Container::open(file));
  VideoListing listing;
  std::size_t without_time = 0;
  std::int64_t packets = 0;
  while (const AVPacket* packet = container.next()) {
    ++packets;
    if ((packet->flags & AV_PKT_FLAG_DISCARD) != 0) continue;  // before the start of an edit
    if (const auto time_ns = container.nanoseconds_of(packet->pts)) {
      listing.times_ns.push_back(*time_ns);
    } else {
      ++without_time;
    }
    if (listing.times_ns.size() + without_time > kMaxFrames)
      return fail("{}: has more than {} frames; cut it", file.string(), kMaxFrames);
  }
  std::ranges::sort(listing.times_ns);
  const auto repeated = std::ranges::unique(listing.times_ns);
  without_time += repeated.size();
  listing.times_ns.erase(repeated.begin(), repeated.end());
  if (listing.times_ns.empty()) {
    return fail("{}: {}", file.string(),
                without_time > 0
                    ? "its frames have no times; give them times: ffmpeg -i IN -r 30 OUT.mp4"
                    : "holds no frames; record or copy it again");
  }
  listing.notices = notices_of(container);
  if (container.is_cut_off() || packets < container.stream().nb_frames) {
    listing.notices.push_back(
        fmt::format("{}: is cut off after {} frames; copy it again", file.string(), packets));
  }
  if (without_time > 0) {
    listing.notices.push_back(fmt::format("{}: {} frames have no time of their own and are skipped",
                                          file.string(), without_time));
  }
  // Sound may go on a little longer than the images.
  constexpr double kLongerSound_s = 0.7;
  const std::int64_t shown_ns = listing.times_ns.back() - listing.times_ns.front();
  if (seconds(container.duration_ns() - shown_ns) > kLongerSound_s + 0.1 * seconds(shown_ns) &&
      !container.is_cut_off() && packets >= container.stream().nb_frames) {
    listing.notices.push_back(fmt::format(
        "{}: declares {:.1f} s, but its frames end at {:.1f} s; if it is cut off, copy it "
        "again",
        file.string(), seconds(container.duration_ns()), seconds(shown_ns)));
  }
  const std::int64_t offset_ns = std::max<std::int64_t>(0, -listing.times_ns.front());
  for (std::int64_t& time_ns : listing.times_ns) time_ns += offset_ns;
  listing.offset_ns = offset_ns;
  return listing;
}

Result<CompressedVideo> CompressedVideo::open(const std::filesystem::path& file,
                                              VideoListing listing) {
  PENUMBRA_TRY(Container container, Container::open(file));
  auto impl = std::make_unique<Impl>();
  impl->container = std::move(container);
  impl->times_ns = std::move(listing.times_ns);
  impl->offset_ns = listing.offset_ns;
  const AVStream& stream = impl->container.stream();
  impl->quarter_turns = orientation_of(stream).quarter_turns;
  const AVCodec* codec = avcodec_find_decoder(stream.codecpar->codec_id);
  if (codec == nullptr) {
    return fail("{}: this libav has no decoder for {}; convert it: ffmpeg -i IN OUT.mp4",
                file.string(), avcodec_get_name(stream.codecpar->codec_id));
  }
  impl->decoder.reset(avcodec_alloc_context3(codec));
  if (!impl->decoder) return fail("{}: no memory for the decoder", file.string());
  impl->decoder->thread_count = 1;  // LookAhead provides the parallelism
  impl->decoder->max_pixels = kMaxPixels;
  impl->decoder->err_recognition = AV_EF_CRCCHECK;
  int status = avcodec_parameters_to_context(impl->decoder.get(), stream.codecpar);
  impl->decoder->pkt_timebase = stream.time_base;
  if (status >= 0) status = avcodec_open2(impl->decoder.get(), codec, nullptr);
  if (status < 0) {
    return fail("{}: is damaged ({}: {}); record or copy it again", file.string(), codec->name,
                av_error_text(status));
  }
  return CompressedVideo(std::move(impl));
}

Result<void> CompressedVideo::skip(int count) {
  for (int i = 0; i < count && impl_->at < impl_->times_ns.size(); ++i) {
    PENUMBRA_TRY_VOID(impl_->take());
    ++impl_->at;
  }
  return {};
}

Result<std::optional<Frame>> CompressedVideo::next() {
  Impl& m = *impl_;
  if (m.at >= m.times_ns.size()) return std::optional<Frame>();
  PENUMBRA_TRY(auto taken, m.take());
  if (!taken) {
    const auto error = m.damaged();
    ++m.at;
    return error;
  }
  PENUMBRA_TRY(Frame frame, m.convert(std::move(taken)));
  ++m.at;
  return std::optional<Frame>(std::move(frame));
}

}  // namespace penumbra
