#include "app/session/pose_smoother.hpp"

#include <cmath>
#include <numbers>

#include "core/evaluation/evaluation.hpp"

namespace penumbra {
namespace {

constexpr double kMinCutoff_hz = 1.0;
constexpr double kCutoffGain_s_px2 = 1.0;
constexpr double kVelocityCutoff_hz = 2.0;  // noise of a resting pose must not look like motion

// Returns the fraction of a step that a first-order low-pass filter follows within dt_s.
double step_fraction(double dt_s, double cutoff_hz) {
  const double angle_rad = 2.0 * std::numbers::pi * cutoff_hz * dt_s;
  return std::isinf(angle_rad) ? 1.0 : angle_rad / (1.0 + angle_rad);
}

// Subtracts as unsigned, because the difference of two times may overflow a signed integer.
double seconds_between(std::int64_t before_ns, std::int64_t after_ns) {
  return 1e-9 * static_cast<double>(static_cast<std::uint64_t>(after_ns) -
                                    static_cast<std::uint64_t>(before_ns));
}

}  // namespace

SmoothedPose PoseSmoother::start(std::int64_t timestamp_ns, const CameraPose& measured) {
  last_ = Last{timestamp_ns, measured, {measured, 0.0, 0.0}, Vector6d::Zero()};
  return last_->drawn;
}

SmoothedPose PoseSmoother::smooth(std::int64_t timestamp_ns, const CameraPose& measured) {
  if (!measured.is_finite()) {
    reset();
    return {measured, 0.0, 0.0};
  }
  if (!last_ || timestamp_ns < last_->timestamp_ns) return start(timestamp_ns, measured);
  const double dt = seconds_between(last_->timestamp_ns, timestamp_ns);
  if (dt > kMaxGap_s) return start(timestamp_ns, measured);

  double fraction = 0.0;
  double lag_ms = last_->drawn.lag_ms;
  if (dt > 0.0) {
    const Vector6d velocity = perturbation_between(last_->measured, measured) / dt;
    last_->velocity += step_fraction(dt, kVelocityCutoff_hz) * (velocity - last_->velocity);
    last_->timestamp_ns = timestamp_ns;
    last_->measured = measured;
    const double speed =
        overlay_difference(camera_, perturbed(measured, last_->velocity * dt), measured).rms_px() /
        dt;
    fraction = step_fraction(dt, kMinCutoff_hz + kCutoffGain_s_px2 * speed * speed);
  }
  const Vector6d step_to_measured = perturbation_between(last_->drawn.T_table_camera, measured);
  SmoothedPose drawn;
  // Raises `fraction` until the offset is small enough. The offset falls almost linearly.
  constexpr int kMaxSteps = 8;
  for (int step = 0; step < kMaxSteps; ++step) {
    drawn.T_table_camera = perturbed(last_->drawn.T_table_camera, fraction * step_to_measured);
    drawn.offset_px = overlay_difference(camera_, drawn.T_table_camera, measured).rms_px();
    if (drawn.offset_px <= kMaxOffset_px && drawn.T_table_camera.is_finite()) {
      drawn.lag_ms = dt > 0.0 ? 1e3 * dt * (1.0 - fraction) / fraction : lag_ms * (1.0 - fraction);
      last_->drawn = drawn;
      return drawn;
    }
    const double remaining_fraction = (1.0 - fraction) * 0.99 * kMaxOffset_px / drawn.offset_px;
    if (!std::isfinite(remaining_fraction)) break;
    fraction = 1.0 - remaining_fraction;
  }
  return start(timestamp_ns, measured);
}

void LagMeter::add(std::int64_t timestamp_ns, const CameraPose& measured, const CameraPose& drawn) {
  const Pose after{timestamp_ns, measured, drawn};
  if (before_ && here_) compare(*before_, *here_, after);
  before_ = std::exchange(here_, after);
}

void LagMeter::compare(const Pose& before, const Pose& here, const Pose& after) {
  if (after.timestamp_ns <= before.timestamp_ns) return;
  const double dt = seconds_between(before.timestamp_ns, after.timestamp_ns);
  if (dt > kMaxGap_s) return;
  const OverlayDifference to_before = overlay_difference(camera_, before.measured, here.measured);
  const OverlayDifference to_after = overlay_difference(camera_, after.measured, here.measured);
  const OverlayDifference lag_offset = overlay_difference(camera_, here.drawn, here.measured);
  double along = 0.0;
  double squares = 0.0;
  int corners = 0;
  for (std::size_t k = 0; k < lag_offset.valid.size(); ++k) {
    if (!lag_offset.valid[k]) continue;
    const Eigen::Vector2d velocity = (to_after.difference_px[k] - to_before.difference_px[k]) / dt;
    along -= lag_offset.difference_px[k].dot(velocity);
    squares += velocity.squaredNorm();
    ++corners;
  }
  if (!(squares > corners * kMinSpeed_px_s * kMinSpeed_px_s)) return;
  if (!std::isfinite(along) || !std::isfinite(squares)) return;
  along_ += along;
  squares_ += squares;
}

std::optional<double> LagMeter::lag_ms() const {
  if (!(squares_ > 0.0) || !std::isfinite(along_) || !std::isfinite(squares_)) return std::nullopt;
  return 1e3 * along_ / squares_;
}

}  // namespace penumbra
