#include "app/capture/recording_feed.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <utility>

#include "core/file.hpp"
#include "core/image_file.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

// Steady time is CLOCK_MONOTONIC here, as drivers use it.
using Clock = std::chrono::steady_clock;

class RecordingFeed final : public LiveSource {
 public:
  RecordingFeed(const Recording& recording, StreamFormat format, PixelFormat pixels)
      : name_(recording.name),
        frames_(recording.frames),
        format_(std::move(format)),
        pixels_(pixels),
        interval_(nanoseconds(format_.interval_s)),
        faults_(name_) {}

  // A picture that can't be read, or is another than the first ones are, is left out and counted,
  // as a camera's is.
  Result<std::optional<CapturedImage>> next_image() override {
    if (!start_) start_ = Clock::now();
    while (true) {
      // The frame after the last one, or a later one whose time has come.
      const auto elapsed = Clock::now() - *start_;
      const std::uint64_t sequence = std::max(
          next_, static_cast<std::uint64_t>(std::max<std::int64_t>(0, elapsed / interval_)));
      if (sequence > next_) {
        faults_.count(CaptureFault::gap, "frames are missing: nobody took them", sequence - next_);
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
      image.timestamp_ns =
          std::chrono::duration_cast<std::chrono::nanoseconds>(due.time_since_epoch()).count();
      const RecordedFrame& listed = frames_[sequence % frames_.size()];
      image.exposure_s = listed.exposure_s;
      if (!take(listed.file, image)) continue;
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
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> controls() const override {
    return {};
  }
  [[nodiscard]] std::string description() const override {
    return fmt::format("recording {} as a camera, {} {}x{} at {:.4g}/s", name_, format_.name,
                       format_.width, format_.height, 1.0 / format_.interval_s);
  }

  static constexpr const char* kJpegName = "MJPEG";

 private:
  bool take(const std::filesystem::path& file, CapturedImage& image) {
    auto bytes = read_file(file);
    if (!bytes) {
      faults_.count(CaptureFault::damaged, bytes.error().message);
      return false;
    }
    const auto is_other = [this, &file] {
      faults_.count(CaptureFault::wrong_format,
                    fmt::format("{}: a picture of another size or format than the first ones is "
                                "left out",
                                file.string()));
      return false;
    };
    if (format_.name == kJpegName) {
      // One that is torn is left to whoever decodes it, as a camera's is.
      const auto size = jpeg_size(*bytes);
      if (size && (size->width != format_.width || size->height != format_.height)) {
        return is_other();
      }
      auto kept = std::make_shared<const std::vector<std::uint8_t>>(std::move(*bytes));
      image.jpeg = *kept;
      image.owner = std::move(kept);
      return true;
    }
    auto frame = decode_image(*bytes, file.string());
    if (!frame) {
      faults_.count(CaptureFault::damaged, frame.error().message);
      return false;
    }
    if (frame->width != format_.width || frame->height != format_.height ||
        frame->format != pixels_) {
      return is_other();
    }
    image.frame = std::move(*frame);
    image.owner = image.frame.owner;
    image.frame.sequence = image.sequence;
    image.frame.timestamp_ns = image.timestamp_ns;
    return true;
  }

  const std::string name_;
  const std::vector<RecordedFrame> frames_;
  const StreamFormat format_;
  const PixelFormat pixels_;  // where a picture is no JPEG
  const std::chrono::nanoseconds interval_;
  FaultCounter faults_;
  std::optional<Clock::time_point> start_;
  std::uint64_t next_ = 0;
  std::mutex mutex_;
  std::condition_variable stop_changed_;
  bool stopped_ = false;  // guarded by mutex_
};

}  // namespace

Result<std::unique_ptr<LiveSource>> open_recording_feed(const Recording& recording,
                                                        std::optional<double> fps) {
  if (!recording.video.empty()) {
    return fail("{}: only recordings with pictures (frames/) can stand for a camera",
                recording.folder.string());
  }
  const std::filesystem::path& first_file = recording.frames.front().file;
  const auto bytes = read_file(first_file);
  if (!bytes) return tl::unexpected(bytes.error());
  const auto first = decode_image(*bytes, first_file.string());
  if (!first) return tl::unexpected(first.error());
  StreamFormat format;
  const std::string extension = first_file.extension().string();
  format.name = extension == ".jpg" || extension == ".jpeg" ? RecordingFeed::kJpegName : "PNG";
  format.width = first->width;
  format.height = first->height;
  const auto count = static_cast<std::int64_t>(recording.frames.size());
  if (fps) {
    format.interval_s = 1.0 / *fps;
  } else if (count > 1) {
    format.interval_s =
        seconds((recording.frames.back().timestamp_ns - recording.frames.front().timestamp_ns) /
                (count - 1));
  }
  format.interval_s = std::clamp(format.interval_s, 1e-4, 10.0);
  return std::make_unique<RecordingFeed>(recording, std::move(format), first->format);
}

}  // namespace penumbra
