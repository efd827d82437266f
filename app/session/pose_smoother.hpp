// Takes the jitter out of the pose that is drawn: a low-pass filter whose cutoff rises with the
// square of the speed at which the overlay moves through the picture,
//   cutoff = 1 Hz + 1 s/px^2 * speed^2    (RMS over the corners of the overlay cube, px/s).
// At rest it averages over 0.16 s. In a steady motion at speed v the overlay trails by
// v / (2 pi cutoff): 0.08 px at most, at 1 px/s, and less the faster it goes, where One-Euro's
// (a cutoff that rises with the speed itself) trails the same number of pixels at any speed.
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
  // How late a motion is drawn that goes on as it does [ms].
  double lag_ms = 0.0;
  // The overlay's distance from where the measured pose has it: the overlay error (RMS over the
  // corners, as in core/evaluation/evaluation.hpp) between the two.
  double offset_px = 0.0;
};

class PoseSmoother {
 public:
  // Whatever the motion, the overlay stays so near to where it was measured; a jump is followed up
  // to this at once.
  static constexpr double kMostOffset_px = 0.25;
  // After a longer time without a pose it starts anew [s].
  static constexpr double kLongestGap_s = 0.5;

  explicit PoseSmoother(CameraModel camera) : camera_(std::move(camera)) {}

  // Poses in order of time; the result lies on the way from the last one drawn to the measured one,
  // never beyond. The first one, and one after a gap or after time ran backwards, is drawn as
  // measured; so is one whose overlay is behind the camera. A pose at the time of the last one (a
  // picture that is drawn again) is drawn as that one was.
  [[nodiscard]] SmoothedPose smooth(std::int64_t timestamp_ns, const CameraPose& measured);
  // The pose was lost: the next one is drawn as measured.
  void reset() { last_.reset(); }

 private:
  struct Last {
    std::int64_t timestamp_ns = 0;
    CameraPose measured;
    SmoothedPose drawn;
    Vector6d velocity = Vector6d::Zero();  // of the camera, in its frame [m/s, rad/s]
  };
  [[nodiscard]] SmoothedPose start(std::int64_t timestamp_ns, const CameraPose& measured);

  CameraModel camera_;
  std::optional<Last> last_;
};

// How late the overlay is where it moves: the delay that explains the distance of its corners
// between the poses as measured and as drawn best (least squares), from their speeds as measured.
// Keeps the last two poses.
class LagMeter {
 public:
  // Slower motion says nothing of a delay [px/s], and so do poses that are farther apart [s].
  static constexpr double kLeastSpeed_px_s = 5.0;
  static constexpr double kLongestGap_s = 0.25;

  explicit LagMeter(CameraModel camera) : camera_(std::move(camera)) {}

  // Poses in order of time.
  void add(std::int64_t timestamp_ns, const CameraPose& measured, const CameraPose& drawn);
  // The next pose does not go on from the last one.
  void restart() { before_ = here_ = std::nullopt; }
  // [ms]; nothing where the overlay never moved.
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
