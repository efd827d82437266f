// Decodes the frames of a recording ahead of the reader.
#include "app/recording/recording_source.hpp"

#include <algorithm>
#include <utility>

#include "app/capture/camera_jpeg.hpp"
#include "app/capture/capture_stats.hpp"
#include "app/logging.hpp"
#include "app/recording/look_ahead.hpp"
#include "app/recording/recorded_video.hpp"
#include "core/image/sample_depth.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

struct TimedFrame {
  Frame frame;
  StageTime time;  // time for reading and decoding
};

// Decodes the frames in order, on the look-ahead thread.
class Decoder {
 public:
  // `recording`: contains only the frames to decode.
  Decoder(Recording recording, std::optional<RecordedVideo> video)
      : recording_(std::move(recording)),
        video_(std::move(video)),
        clamps_(recording_.sample_bits),
        faults_(recording_.folder.string()) {
    if (const auto& camera = recording_.camera) {
      size_ = ImageSize{camera->width(), camera->height()};
    }
  }

  Result<std::optional<TimedFrame>> next() {
    while (at_ < recording_.frames.size()) {
      const Stopwatch watch;
      const RecordedFrame& listed = recording_.frames[at_++];
      PENUMBRA_TRY(auto frame, video_ ? next_of_video(listed) : next_image(listed));
      if (frame) return timed(std::move(*frame), listed, watch);
    }
    return std::optional<TimedFrame>();
  }
  // Thread-safe.
  [[nodiscard]] std::int64_t damaged() const {
    return static_cast<std::int64_t>(faults_.stats().of(CaptureFault::damaged));
  }

 private:
  [[nodiscard]] Result<std::optional<TimedFrame>> timed(Frame frame, const RecordedFrame& listed,
                                                        const Stopwatch& watch) const {
    if (size_ && ImageSize{frame.width, frame.height} != *size_) {
      const bool is_turned = frame.width == size_->height && frame.height == size_->width;
      return fail("{}: is of {}x{} px, but {} is {}x{} px; {}", recording_.camera_file.string(),
                  size_->width, size_->height, place(listed), frame.width, frame.height,
                  is_turned ? "hold the camera as in the calibration, or calibrate with it held so"
                            : "give this recording its own camera file, or calibrate at its image "
                              "size (penumbra calibrate)");
    }
    frame.sequence = static_cast<std::uint64_t>(listed.number);
    frame.timestamp_ns = listed.timestamp_ns;
    frame.utc_ns = listed.utc_ns;
    frame.exposure_s = listed.exposure_s;
    return std::optional<TimedFrame>({std::move(frame), watch.elapsed()});
  }

  [[nodiscard]] std::string place(const RecordedFrame& listed) const {
    return video_ ? fmt::format("{}: frame {}", recording_.video.string(), listed.number)
                  : listed.file.string();
  }

  Result<std::optional<Frame>> next_of_video(const RecordedFrame& listed) {
    auto frame = video_->next();
    if (frame && !*frame) {
      return fail("{}: is missing; the file ends before it: copy it again", place(listed));
    }
    if (frame || !recording_.is_video_file()) return frame;
    // A player skips it too.
    faults_.count(CaptureFault::damaged,
                  fmt::format("frame {}: is damaged, or builds on a damaged one, and is skipped",
                              listed.number));
    return std::optional<Frame>();
  }

  // Returns nullopt if a live session's frame is damaged, because the session skipped it, too.
  Result<std::optional<Frame>> next_image(const RecordedFrame& listed) {
    PENUMBRA_TRY(const auto bytes, read_file(listed.file));
    const std::string name = listed.file.string();
    auto frame = decode_recorded_image(bytes, name, size_, clamps_.options());
    if (const auto warning = clamps_.take_warning(name)) log_warning("{}", *warning);
    if (frame) return std::optional<Frame>(std::move(*frame));
    if (!recording_.from_camera) {
      return fail("{}, or remove its line from the listing", frame.error().message);
    }
    faults_.count(CaptureFault::damaged,
                  fmt::format("{}; it is skipped, as in the live session", frame.error().message));
    return std::optional<Frame>();
  }

  const Recording recording_;
  std::optional<RecordedVideo> video_;
  ClampWatch clamps_;
  FaultCounter faults_;
  std::optional<ImageSize> size_;
  std::size_t at_ = 0;
};

class RecordingSource final : public FrameSource {
 public:
  RecordingSource(int count, std::unique_ptr<Decoder> decoder, int look_ahead)
      : count_(count),
        decoder_(std::move(decoder)),
        frames_([this] { return decoder_->next(); }, look_ahead) {}

  Result<std::optional<Frame>> next() override {
    PENUMBRA_TRY(auto timed, frames_.next());
    if (!timed) return std::optional<Frame>();
    capture_time_ = timed->time;
    return std::optional<Frame>(std::move(timed->frame));
  }
  [[nodiscard]] StageTime capture_time() const override { return capture_time_; }
  [[nodiscard]] std::int64_t damaged() const override { return decoder_->damaged(); }
  [[nodiscard]] std::optional<int> frame_count() const override { return count_; }

 private:
  const int count_;
  const std::unique_ptr<Decoder> decoder_;
  StageTime capture_time_;
  LookAhead<TimedFrame> frames_;  // declared last: its thread uses the decoder
};

}  // namespace

Result<std::unique_ptr<FrameSource>> open_recording_source(const Recording& recording,
                                                           const RecordingSourceOptions& options) {
  const int total = static_cast<int>(recording.frames.size());
  const int last = std::min(options.last.value_or(total), total);
  if (options.first < 0 || options.first >= last) {
    return fail("{}: frames {}:{} hold none of its {} frames (0 is the first)",
                recording.folder.string(), options.first, options.last.value_or(total), total);
  }
  std::optional<RecordedVideo> video;
  if (!recording.video.empty()) {
    PENUMBRA_TRY(video, RecordedVideo::open(recording));
    if (options.first > 0) PENUMBRA_TRY_VOID(video->skip(options.first));
  }
  Recording selected = recording;
  selected.frames.assign(recording.frames.begin() + options.first, recording.frames.begin() + last);
  auto decoder = std::make_unique<Decoder>(std::move(selected), std::move(video));
  return std::make_unique<RecordingSource>(last - options.first, std::move(decoder),
                                           options.look_ahead);
}

}  // namespace penumbra
