#include "app/recording/video_reader.hpp"

#include <array>
#include <deque>
#include <span>
#include <string>
#include <utility>

#include "app/libav.hpp"
#include "app/recording/decoded_frame.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

// Headers between the blocks of a Matroska file have 20 to 60 bytes. A larger gap means that the
// demuxer skipped damaged data up to the next cluster.
constexpr std::int64_t kMaxGapBytes = 512;
constexpr std::int64_t kMaxPixels = 256'000'000;

// Reads the packets of the video stream in order.
class Demuxer {
 public:
  static Result<Demuxer> open(const std::filesystem::path& file) {
    PENUMBRA_TRY_VOID(load_libav());
    Demuxer demuxer;
    demuxer.name_ = file.string();
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(file, error);
    if (status.type() == std::filesystem::file_type::not_found) {
      return fail("{}: no such file", demuxer.name_);
    }
    if (!std::filesystem::is_regular_file(status)) {
      return fail("{}: {}", demuxer.name_,
                  error ? "cannot be read: " + error.message() : "is not a file");
    }
    AVFormatContext* format = nullptr;
    const int opened = avformat_open_input(&format, ("file:" + demuxer.name_).c_str(),
                                           av_find_input_format("matroska"), nullptr);
    if (opened < 0) {
      return fail("{}: cannot be read as Matroska video ({}); record or copy it again",
                  demuxer.name_, av_error_text(opened));
    }
    demuxer.format_.reset(format);
    for (unsigned i = 0; i < format->nb_streams; ++i) {
      if (format->streams[i]->codecpar->codec_type == AVMEDIA_TYPE_VIDEO) {
        demuxer.stream_ = static_cast<int>(i);
        break;
      }
    }
    if (demuxer.stream_ < 0) return fail("{}: holds no video stream", demuxer.name_);
    const AVCodecID codec = demuxer.parameters().codec_id;
    if (codec != AV_CODEC_ID_FFV1 && codec != AV_CODEC_ID_RAWVIDEO) {
      return fail("{}: is {} video; recordings hold FFV1: ffmpeg -i IN -c:v ffv1 -level 3 {}",
                  demuxer.name_, avcodec_get_name(codec), file.filename().string());
    }
    demuxer.packet_.reset(av_packet_alloc());
    if (!demuxer.packet_) return fail("{}: no memory for the reader", demuxer.name_);
    demuxer.end_of_last_ = avio_seek(format->pb, 0, SEEK_CUR);
    return demuxer;
  }

  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] const AVCodecParameters& parameters() const {
    return *format_->streams[stream_]->codecpar;
  }

  // Returns the next packet, valid until the next call; nullptr at the end.
  Result<AVPacket*> next() {
    while (true) {
      av_packet_unref(packet_.get());
      const int status = av_read_frame(format_.get(), packet_.get());
      if (status == AVERROR_EOF) return nullptr;
      if (status < 0) return fail("{}: cannot be read: {}", name_, av_error_text(status));
      if (packet_->pos >= 0) {
        if (packet_->pos - end_of_last_ > kMaxGapBytes) {
          return fail("{}: damaged after frame {} (bytes {} to {} are no video); copy it again",
                      name_, frames_ - 1, end_of_last_, packet_->pos);
        }
        end_of_last_ = packet_->pos + packet_->size;
      }
      if (packet_->stream_index != stream_) continue;
      ++frames_;
      return packet_.get();
    }
  }

 private:
  AvInput format_;
  Av<AVPacket> packet_;
  std::string name_;
  int stream_ = -1;
  int frames_ = 0;
  std::int64_t end_of_last_ = 0;  // [bytes]
};

// FFV1 version 3 (RFC 9043, section 4.9): each slice ends with its size (3 bytes). In files with
// checksums, an error status (1 byte) and a CRC follow, chosen so that the CRC-32 of the slice is
// 0. Slices are located from the packet's end. Checked here, because libav's decoder only conceals
// a bad slice.
enum class SliceChecksums { none, right, wrong, bad_sizes };

SliceChecksums check_slices(std::span<const std::uint8_t> packet, std::size_t trailer) {
  const AVCRC* table = av_crc_get_table(AV_CRC_32_IEEE);
  bool valid = true;
  std::size_t end = packet.size();
  while (end > 0) {
    if (end < trailer) return SliceChecksums::bad_sizes;
    const std::uint8_t* field = packet.data() + end - trailer;
    const std::size_t size =
        (std::size_t{field[0]} << 16U) | (std::size_t{field[1]} << 8U) | std::size_t{field[2]};
    if (size + trailer > end) return SliceChecksums::bad_sizes;
    end -= size + trailer;
    if (trailer > 3 && av_crc(table, 0, packet.data() + end, size + trailer) != 0) valid = false;
  }
  if (trailer <= 3) return SliceChecksums::none;
  return valid ? SliceChecksums::right : SliceChecksums::wrong;
}

constexpr std::size_t kTrailerBytesWithCrc = 8;
constexpr std::size_t kTrailerBytesWithoutCrc = 3;

}  // namespace

struct VideoReader::Impl {
  Demuxer demuxer;
  Av<AVCodecContext> decoder;
  std::deque<Av<AVPacket>> waiting;  // skipped packets since the last key frame
  int frame = 0;                     // number of the next frame
  bool broken = false;               // a frame since the last key frame was damaged
  bool has_checksums = false;

  tl::unexpected<Error> damaged(std::string_view what) const {
    return fail("{}: frame {}: damaged ({}); record or copy it again", demuxer.name(), frame, what);
  }

  Result<void> verify(const AVPacket& packet) {
    const AVCodecParameters& parameters = demuxer.parameters();
    // FFV1 versions 0 and 1 have no configuration record and no checksums.
    if (parameters.codec_id != AV_CODEC_ID_FFV1 || parameters.extradata_size <= 0) return {};
    const std::span<const std::uint8_t> bytes(packet.data, static_cast<std::size_t>(packet.size));
    const SliceChecksums sums = check_slices(bytes, kTrailerBytesWithCrc);
    if (sums == SliceChecksums::wrong) return damaged("a check sum is wrong");
    if (sums == SliceChecksums::right) {
      has_checksums = true;
    } else if (has_checksums ||
               check_slices(bytes, kTrailerBytesWithoutCrc) == SliceChecksums::bad_sizes) {
      return damaged("its slices do not fill it");
    }
    return {};
  }

  // Fails also for frames that refer to a damaged frame.
  Result<Av<AVFrame>> decode_next(const AVPacket& packet) {
    broken = broken && (packet.flags & AV_PKT_FLAG_KEY) == 0;
    auto decoded =
        broken ? Result<Av<AVFrame>>(damaged("it builds on a damaged frame")) : decode(packet);
    broken = !decoded;
    ++frame;
    return decoded;
  }

  Result<Av<AVFrame>> decode(const AVPacket& packet) {
    PENUMBRA_TRY_VOID(verify(packet));
    Av<AVFrame> decoded(av_frame_alloc());
    if (!decoded) return fail("{}: no memory for a frame", demuxer.name());
    int status = avcodec_send_packet(decoder.get(), &packet);
    if (status >= 0) status = avcodec_receive_frame(decoder.get(), decoded.get());
    if (status < 0) return damaged(av_error_text(status));
    if (decoded->decode_error_flags != 0 || (decoded->flags & AV_FRAME_FLAG_CORRUPT) != 0) {
      return damaged("the decoder could not read all of it");
    }
    if (decoded->width <= 0 || decoded->height <= 0) return damaged("it has no pixels");
    return decoded;
  }

  Result<Frame> convert(Av<AVFrame> decoded) const {
    const auto format = static_cast<AVPixelFormat>(decoded->format);
    if (has_upward_rows(*decoded)) return damaged("its rows are stored upside down");
    if (is_frame_format(format)) return frame_of(std::move(decoded), ColorMatrix::bt601);
    const char* name = av_get_pix_fmt_name(format);
    return fail("{}: pixel format {}; recordings hold 8-bit grey, YUV or RGB", demuxer.name(),
                name != nullptr ? name : "unknown");
  }
};

VideoReader::VideoReader(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
VideoReader::VideoReader(VideoReader&&) noexcept = default;
VideoReader& VideoReader::operator=(VideoReader&&) noexcept = default;
VideoReader::~VideoReader() = default;

Result<VideoReader> VideoReader::open(const std::filesystem::path& file) {
  PENUMBRA_TRY(Demuxer demuxer, Demuxer::open(file));
  auto impl = std::make_unique<Impl>();
  impl->demuxer = std::move(demuxer);
  const AVCodecParameters& parameters = impl->demuxer.parameters();
  const AVCodec* codec = avcodec_find_decoder(parameters.codec_id);
  if (codec == nullptr) {
    return fail("{}: this libav has no decoder for {}", file.string(),
                avcodec_get_name(parameters.codec_id));
  }
  impl->decoder.reset(avcodec_alloc_context3(codec));
  if (!impl->decoder) return fail("{}: no memory for the decoder", file.string());
  impl->decoder->thread_count = 1;  // LookAhead provides the parallelism
  impl->decoder->max_pixels = kMaxPixels;
  impl->decoder->err_recognition = AV_EF_CRCCHECK | AV_EF_EXPLODE;
  int status = avcodec_parameters_to_context(impl->decoder.get(), &parameters);
  if (status >= 0) status = avcodec_open2(impl->decoder.get(), codec, nullptr);
  if (status < 0) {
    return fail("{}: damaged ({}: {}); record or copy it again", file.string(), codec->name,
                av_error_text(status));
  }
  return VideoReader(std::move(impl));
}

Result<void> VideoReader::skip(int count) {
  const int target = impl_->frame + count;
  // Reads one packet beyond the target: if it is a key frame, no earlier packet is decoded.
  while (impl_->frame + static_cast<int>(impl_->waiting.size()) <= target) {
    PENUMBRA_TRY(const AVPacket* packet, impl_->demuxer.next());
    if (packet == nullptr) break;
    if ((packet->flags & AV_PKT_FLAG_KEY) != 0) {
      impl_->frame += static_cast<int>(impl_->waiting.size());
      impl_->waiting.clear();
    }
    impl_->waiting.emplace_back(av_packet_clone(packet));
    if (!impl_->waiting.back()) return fail("{}: no memory", impl_->demuxer.name());
  }
  while (impl_->frame < target && !impl_->waiting.empty()) {
    (void)impl_->decode_next(*impl_->waiting.front());  // next() reports errors
    impl_->waiting.pop_front();
  }
  return {};
}

Result<std::optional<Frame>> VideoReader::next() {
  Av<AVPacket> kept;
  const AVPacket* packet = nullptr;
  if (!impl_->waiting.empty()) {
    kept = std::move(impl_->waiting.front());
    impl_->waiting.pop_front();
    packet = kept.get();
  } else {
    PENUMBRA_TRY(packet, impl_->demuxer.next());
  }
  if (packet == nullptr) return std::optional<Frame>();
  PENUMBRA_TRY(auto decoded, impl_->decode_next(*packet));
  PENUMBRA_TRY(Frame frame, impl_->convert(std::move(decoded)));
  return std::optional<Frame>(std::move(frame));
}

Result<int> count_video_frames(const std::filesystem::path& file) {
  PENUMBRA_TRY(Demuxer demuxer, Demuxer::open(file));
  for (int count = 0;; ++count) {
    PENUMBRA_TRY(const AVPacket* packet, demuxer.next());
    if (packet == nullptr) return count;
  }
}

}  // namespace penumbra
