#include "app/recording/recording_feed.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <utility>

#include "app/capture/camera_jpeg.hpp"
#include "app/capture/clocks.hpp"
#include "app/logging.hpp"
#include "app/recording/recorded_video.hpp"
#include "core/image/sample_depth.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

// CLOCK_MONOTONIC, which drivers use.
using Clock = std::chrono::steady_clock;

class RecordingFeed final : public LiveSource {
 public:
  RecordingFeed(const Recording& recording, StreamFormat format, PixelFormat pixels)
      : recording_(recording),
        clamps_(recording.sample_bits),
        format_(std::move(format)),
        pixels_(pixels),
        interval_(nanoseconds(format_.interval_s)),
        faults_(recording.name) {}

  // Skips and counts images that can't be read or have another size or format than the first one.
  Result<std::optional<CapturedImage>> next_image() override {
    if (!start_) start_ = Clock::now();
    while (true) {
      // A video decodes every frame, so it plays slower instead of dropping frames.
      if (recording_.is_video_file()) {
        *start_ = std::max(*start_, Clock::now() - static_cast<std::int64_t>(next_) * interval_);
      }
      const auto elapsed = Clock::now() - *start_;
      // Number of the next frame, or of a later frame that is already due.
      const std::uint64_t sequence = std::max(
          next_, static_cast<std::uint64_t>(std::max<std::int64_t>(0, elapsed / interval_)));
      if (sequence > next_) {
        faults_.count(
            CaptureFault::gap,
            "frames were dropped because the program was too slow for the recording's rate; use a "
            "smaller --fps, or end other programs",
            sequence - next_);
      }
      const auto due = *start_ + static_cast<std::int64_t>(sequence) * interval_;
      {
        std::unique_lock lock(mutex_);
        if (stop_changed_.wait_until(lock, due, [this] { return stopped_; })) {
          return std::optional<CapturedImage>();
        }
      }
      next_ = sequence + 1;
      CapturedImage image;
      image.sequence = sequence;
      image.timestamp_ns = due.time_since_epoch() / std::chrono::nanoseconds(1);
      image.utc_ns = utc_at(image.timestamp_ns);
      const std::size_t index = sequence % recording_.frames.size();
      image.exposure_s = recording_.frames[index].exposure_s;
      if (!(recording_.video.empty()
                ? take(recording_.frames[index].file, image)
                : accept_frame(frame_of_video(index), recording_.video.string(), image))) {
        continue;
      }
      faults_.count_frame();
      return std::optional<CapturedImage>(std::move(image));
    }
  }

  void stop() override {
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    stop_changed_.notify_all();
  }
  [[nodiscard]] StreamFormat format() const override { return format_; }
  [[nodiscard]] FaultCounter& faults() override { return faults_; }
  [[nodiscard]] std::string_view damage_remedy() const override { return kRecordAgain; }
  [[nodiscard]] std::string description() const override {
    return fmt::format("recording {} as a camera, {} {}x{} at {:.4g}/s", recording_.name,
                       format_.name, format_.width, format_.height, 1.0 / format_.interval_s);
  }

  static constexpr const char* kJpegName = "MJPEG";

 private:
  bool skip(CaptureFault fault, std::string_view detail) {
    faults_.count(fault, detail);
    return false;
  }
  bool skip_other(const std::string& what) {
    return skip(
        CaptureFault::wrong_format,
        fmt::format("{}: an image of another size or format than the first is skipped", what));
  }

  // Returns false if the frame is skipped.
  bool accept_frame(Result<Frame> frame, const std::string& what, CapturedImage& image) {
    if (!frame) return skip(CaptureFault::damaged, frame.error().message);
    if (frame->width != format_.width || frame->height != format_.height ||
        frame->format != pixels_) {
      return skip_other(what);
    }
    image.frame = std::move(*frame);
    image.owner = image.frame.owner;
    image.frame.sequence = image.sequence;
    image.frame.timestamp_ns = image.timestamp_ns;
    return true;
  }

  Result<Frame> frame_of_video(std::size_t index) {
    if (!video_ || index < video_at_) {
      PENUMBRA_TRY(video_, RecordedVideo::open(recording_));
      video_at_ = 0;
    }
    if (index > video_at_) {
      PENUMBRA_TRY_VOID(video_->skip(static_cast<int>(index - video_at_)));
    }
    video_at_ = index + 1;
    PENUMBRA_TRY(auto frame, video_->next());
    if (!frame)
      return fail("{}: ends before frame {}; copy it again", recording_.video.string(), index);
    return std::move(*frame);
  }

  bool take(const std::filesystem::path& file, CapturedImage& image) {
    auto bytes = read_file(file);
    if (!bytes) return skip(CaptureFault::damaged, bytes.error().message);
    if (format_.name == kJpegName) {
      auto received = receive_camera_jpeg(*bytes, {format_.width, format_.height}, kRecordAgain);
      if (!received) {
        const StreamError& trouble = received.error();
        if (trouble.fault != CaptureFault::damaged) return skip_other(file.string());
        // Counts as captured, because the report lists damaged and late frames separately.
        faults_.count_frame();
        faults_.count_undecoded(fmt::format("{}: {}", file.string(), trouble.message));
        return false;
      }
      // Moving the vector keeps the spans valid.
      const auto kept = std::make_shared<const std::vector<std::uint8_t>>(std::move(*bytes));
      image.jpeg = received->bytes;
      if (received->frame) image.frame = std::move(*received->frame);
      image.owner = kept;
      return true;
    }
    auto frame = decode_recorded_image(*bytes, file.string(),
                                       ImageSize{format_.width, format_.height}, clamps_.options());
    if (const auto warning = clamps_.take_warning(file.string())) log_warning("{}", *warning);
    return accept_frame(std::move(frame), file.string(), image);
  }

  const Recording recording_;
  ClampWatch clamps_;
  std::optional<RecordedVideo> video_;
  std::size_t video_at_ = 0;  // index of the video's next frame
  const StreamFormat format_;
  const PixelFormat pixels_;  // unused if images are JPEGs
  const std::chrono::nanoseconds interval_;
  FaultCounter faults_;
  std::optional<Clock::time_point> start_;
  std::uint64_t next_ = 0;
  std::mutex mutex_;
  std::condition_variable stop_changed_;
  bool stopped_ = false;  // guarded by mutex_
};

// Returns the first decodable frame. A live session's recording may begin with damaged frames.
Result<Frame> first_image(const Recording& recording) {
  const auto& camera = recording.camera;
  const auto size = camera ? std::optional(ImageSize{camera->width(), camera->height()})
                           : std::optional<ImageSize>();
  std::optional<Error> first_error;
  for (const RecordedFrame& listed : recording.frames) {
    auto frame = read_file(listed.file).and_then([&](const std::vector<std::uint8_t>& bytes) {
      return decode_recorded_image(bytes, listed.file.string(), size, {recording.sample_bits});
    });
    if (frame || !recording.from_camera) return frame;
    if (!first_error) first_error = frame.error();
  }
  return tl::unexpected(*first_error);
}

Result<Frame> first_frame(const Recording& recording) {
  if (recording.video.empty()) return first_image(recording);
  PENUMBRA_TRY(auto video, RecordedVideo::open(recording));
  while (true) {
    auto frame = video.next();
    if (frame && !*frame) {
      return fail("{}: holds no complete frame; record or copy it again", recording.video.string());
    }
    if (frame) return std::move(**frame);
    if (!recording.is_video_file()) return tl::unexpected(frame.error());
  }
}

}  // namespace

Result<std::unique_ptr<LiveSource>> open_recording_feed(const Recording& recording,
                                                        std::optional<double> fps) {
  PENUMBRA_TRY(const auto first, first_frame(recording));
  StreamFormat format;
  const std::string extension = recording.frames.front().file.extension().string();
  format.name = recording.is_video_file()                     ? "video"
                : !recording.video.empty()                    ? "FFV1"
                : extension == ".jpg" || extension == ".jpeg" ? RecordingFeed::kJpegName
                                                              : "PNG";
  format.width = first.width;
  format.height = first.height;
  const auto count = static_cast<std::int64_t>(recording.frames.size());
  if (fps) {
    format.interval_s = 1.0 / *fps;
  } else if (count > 1) {
    format.interval_s =
        seconds((recording.frames.back().timestamp_ns - recording.frames.front().timestamp_ns) /
                (count - 1));
  }
  format.interval_s = std::clamp(format.interval_s, 1e-4, 10.0);
  return std::make_unique<RecordingFeed>(recording, std::move(format), first.format);
}

}  // namespace penumbra
