// Images for a study: of a recording, from its first frame at every trial and in a loop, or the
// newest ones of a camera.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

struct StudyPicture {
  Frame frame;
  // When it is due, monotonic, on the recording's clock (from 0) or the camera's.
  std::int64_t clock_ns = 0;
};

class StudyFeed {
 public:
  StudyFeed() = default;
  StudyFeed(const StudyFeed&) = delete;
  StudyFeed& operator=(const StudyFeed&) = delete;
  virtual ~StudyFeed() = default;

  // The next image; nothing if the camera has none yet, after a short wait.
  [[nodiscard]] virtual Result<std::optional<StudyPicture>> next() = 0;
  // A recording begins again.
  virtual void rewind() = 0;
  // Returns true for images that come on demand rather than at their own pace.
  [[nodiscard]] virtual bool waits() const = 0;
};

// `given_poses`: frames keep the times of the given poses; else their times are monotonic, for the
// tracker.
[[nodiscard]] std::unique_ptr<StudyFeed> feed_of_recording(const Recording& recording,
                                                           double interval_s, bool given_poses);
[[nodiscard]] std::unique_ptr<StudyFeed> feed_of_camera(std::unique_ptr<LiveSource> source);

}  // namespace penumbra
