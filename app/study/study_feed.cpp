#include "app/study/study_feed.hpp"

#include <chrono>
#include <utility>

#include "app/capture/newest_image.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

class RecordedFeed final : public StudyFeed {
 public:
  RecordedFeed(Recording recording, double interval_s, bool given_poses)
      : recording_(std::move(recording)),
        interval_ns_(nanoseconds(interval_s)),
        given_poses_(given_poses) {}

  Result<std::optional<StudyImage>> next() override {
    for (int attempt = 0; attempt < 2; ++attempt) {
      if (!source_) {
        PENUMBRA_TRY(source_, open_recording_source(recording_));
        last_ns_.reset();
      }
      PENUMBRA_TRY(auto frame, source_->next());
      if (!frame) {  // at the end, restarts from the beginning
        source_.reset();
        continue;
      }
      const std::int64_t recorded_ns = frame->timestamp_ns;
      if (started_) clock_ns_ += last_ns_ ? recorded_ns - *last_ns_ : interval_ns_;
      started_ = true;
      last_ns_ = recorded_ns;
      StudyImage image{std::move(*frame), clock_ns_};
      if (!given_poses_) {
        image.frame.timestamp_ns = recording_.frames.front().timestamp_ns + clock_ns_;
      }
      return std::optional<StudyImage>(std::move(image));
    }
    return fail("{}: holds no frame that can be decoded; record or copy it again",
                recording_.folder.string());
  }
  void rewind() override { source_.reset(); }
  [[nodiscard]] bool produces_on_demand() const override { return true; }

 private:
  const Recording recording_;
  const std::int64_t interval_ns_;
  const bool given_poses_;
  std::unique_ptr<FrameSource> source_;
  bool started_ = false;
  std::int64_t clock_ns_ = 0;
  std::optional<std::int64_t> last_ns_;  // recorded time of the previous frame
};

class CameraFeed final : public StudyFeed {
 public:
  explicit CameraFeed(std::unique_ptr<LiveSource> source)
      : source_(std::move(source)), newest_(*source_) {}

  Result<std::optional<StudyImage>> next() override {
    // Short, so that the times of a person's events are precise.
    constexpr std::chrono::milliseconds kPatience(2);
    const bool finished = newest_.finished();
    std::optional<Frame> frame = newest_.take(kPatience);
    if (!frame && finished) {
      if (const auto error = newest_.error()) return tl::unexpected(*error);
      return fail("{}: the stream ended; check the camera's connection", source_->description());
    }
    if (!frame) return std::optional<StudyImage>();
    const std::int64_t time_ns = frame->timestamp_ns;
    return std::optional<StudyImage>({std::move(*frame), time_ns});
  }
  void rewind() override {}
  [[nodiscard]] bool produces_on_demand() const override { return false; }

 private:
  std::unique_ptr<LiveSource> source_;
  NewestImage newest_;
};

}  // namespace

std::unique_ptr<StudyFeed> feed_of_recording(const Recording& recording, double interval_s,
                                             bool given_poses) {
  return std::make_unique<RecordedFeed>(recording, interval_s, given_poses);
}

std::unique_ptr<StudyFeed> feed_of_camera(std::unique_ptr<LiveSource> source) {
  return std::make_unique<CameraFeed>(std::move(source));
}

}  // namespace penumbra
