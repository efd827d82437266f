// Low-pass filter of the drawn pose. Its cutoff is 1 Hz + 1 s/px^2 * speed^2, with the speed of the
// overlay (RMS over the cube's corners [px/s]), so the lag stays below 0.08 px in steady motion
// (docs/tracking.md#smoothing).
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
  double offset_px = 0.0;  // from the measured pose's overlay (RMS over the cube's corners)
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
  // Ignores slower motion [px/s] and longer intervals between poses [s].
  static constexpr double kMinSpeed_px_s = 5.0;
  static constexpr double kMaxGap_s = 0.25;

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
  double along_ = 0.0, squares_ = 0.0;  // sums over corners: offset . velocity, velocity^2
};

}  // namespace penumbra
