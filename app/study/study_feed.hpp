// Provides the images for a study: the newest images of a camera, or a recording in a loop that
// restarts at every trial.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "app/capture/live_source.hpp"
#include "app/recording/recording_source.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

struct StudyImage {
  Frame frame;
  // Time at which the image is due, increasing. Clock: the recording's (from 0) or the camera's.
  std::int64_t clock_ns = 0;
};

class StudyFeed {
 public:
  StudyFeed() = default;
  StudyFeed(const StudyFeed&) = delete;
  StudyFeed& operator=(const StudyFeed&) = delete;
  virtual ~StudyFeed() = default;

  // Returns the next image, or nullopt if the camera delivers none within a short wait.
  [[nodiscard]] virtual Result<std::optional<StudyImage>> next() = 0;
  // Restarts a recording; has no effect on a camera.
  virtual void rewind() = 0;
  // Returns true for a recording, whose images are produced on demand; false for a camera.
  [[nodiscard]] virtual bool produces_on_demand() const = 0;
};

// Plays a recording in a loop, with `interval_s` between last and first frame. `given_poses`:
// frames keep their recorded times, which select the poses. Else times increase over all loops.
[[nodiscard]] std::unique_ptr<StudyFeed> feed_of_recording(const Recording& recording,
                                                           double interval_s, bool given_poses);
[[nodiscard]] std::unique_ptr<StudyFeed> feed_of_camera(std::unique_ptr<LiveSource> source);

}  // namespace penumbra
