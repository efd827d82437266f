// Low-pass filter of the drawn pose. Its cutoff is 1 Hz + 1 s/px^2 * speed^2. The speed is that of
// the overlay cube [px/s] (RMS over its corners, see "overlay error" in docs/conventions.md). In
// steady motion the lag stays below 0.08 px (docs/tracking.md#smoothing).
#pragma once

#include <cstdint>
#include <optional>
#include <utility>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct SmoothedPose {
  CameraPose T_table_camera;
  double lag_ms = 0.0;     // delay during steady motion [ms]
  double offset_px = 0.0;  // distance from the measured pose's overlay (RMS over cube corners)
};

class PoseSmoother {
 public:
  // Largest offset of the drawn overlay from the measured one. If the pose jumps further, the drawn
  // pose follows immediately up to this offset.
  static constexpr double kMaxOffset_px = 0.25;
  // The filter restarts if no pose arrives for longer than this [s].
  static constexpr double kMaxGap_s = 0.5;

  explicit PoseSmoother(CameraModel camera) : camera_(std::move(camera)) {}

  // Call this in order of time. The result lies between the previous drawn pose and the measured
  // one. Some poses are returned as measured: the first one, one after a gap or a step back in
  // time, and one whose overlay is behind the camera. A repeated time returns the previous result.
  [[nodiscard]] SmoothedPose smooth(std::int64_t timestamp_ns, const CameraPose& measured);
  // Resets the filter: the next pose is drawn as measured.
  void reset() { last_.reset(); }

 private:
  struct Last {
    std::int64_t timestamp_ns = 0;
    CameraPose measured;
    SmoothedPose drawn;
    Vector6d velocity = Vector6d::Zero();  // velocity of the camera, in its frame [m/s, rad/s]
  };
  [[nodiscard]] SmoothedPose start(std::int64_t timestamp_ns, const CameraPose& measured);

  CameraModel camera_;
  std::optional<Last> last_;
};

// Measures the delay of the drawn overlay while it moves. It is the least-squares solution of
// offset = delay * velocity over the corners [px]; the offset is measured minus drawn position.
class LagMeter {
 public:
  static constexpr double kMinSpeed_px_s = 5.0;  // slower motion is ignored
  static constexpr double kMaxGap_s = 0.25;      // longer intervals between poses are ignored

  explicit LagMeter(CameraModel camera) : camera_(std::move(camera)) {}

  // Call this in order of time.
  void add(std::int64_t timestamp_ns, const CameraPose& measured, const CameraPose& drawn);
  // Call this if the next pose does not continue the previous motion.
  void restart() { before_ = here_ = std::nullopt; }
  // Returns the delay [ms], or nullopt if the overlay never moved.
  [[nodiscard]] std::optional<double> lag_ms() const;

 private:
  struct Pose {
    std::int64_t timestamp_ns = 0;
    CameraPose measured, drawn;
  };
  void compare(const Pose& before, const Pose& here, const Pose& after);

  CameraModel camera_;
  std::optional<Pose> before_, here_;
  double along_ = 0.0;    // sum of offset . velocity over the corners of all poses
  double squares_ = 0.0;  // sum of velocity^2 over the corners of all poses
};

}  // namespace penumbra
