#include "core/evaluation/pose_convention_hint.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>
#include <utility>
#include <vector>

#include "core/statistics.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

struct PosePair {
  CameraPose estimated, truth;
};

std::vector<PosePair> pairs_of(const Trajectory& estimated, const Trajectory& truth,
                               const PairingOptions& options) {
  std::vector<PosePair> pairs;
  for (const StampedPose& pose : estimated.poses) {
    const auto true_pose =
        pose_at(truth, shifted(pose.timestamp_ns, options.time_offset_ns), options.max_gap_ns);
    if (true_pose && true_pose->is_finite() && pose.T_table_camera.is_finite())
      pairs.push_back({pose.T_table_camera, *true_pose});
  }
  return pairs;
}

// Deviations of one trajectory from the expected convention.
struct Convention {
  bool millimetres = false;
  bool w_first = false;
  bool inverse = false;
};

CameraPose converted(const CameraPose& pose, const Convention& from) {
  Eigen::Quaterniond rotation = pose.rotation();
  // The file's w x y z was read as x y z w.
  if (from.w_first) {
    rotation = Eigen::Quaterniond(rotation.x(), rotation.y(), rotation.z(), rotation.w());
  }
  const CameraPose read(rotation, (from.millimetres ? 1e-3 : 1.0) * pose.translation());
  if (!from.inverse) return read;
  const auto inverse = read.inverse();
  return {inverse.rotation(), inverse.translation()};
}

// Returns the median distance of the cameras from the table's origin [m].
double camera_distance(const std::vector<PosePair>& pairs) {
  std::vector<double> distances;
  for (const PosePair& pair : pairs) {
    distances.push_back(
        std::min(pair.estimated.translation().norm(), pair.truth.translation().norm()));
  }
  constexpr double kMinDistance_m = 1e-6;
  return std::max(upper_median(std::move(distances)), kMinDistance_m);
}

// Returns the RMS over pairs of hypot(angle [rad], distance / `camera_distance_m`).
double difference_of(const std::vector<PosePair>& pairs, double camera_distance_m) {
  double sum = 0.0;
  for (const auto& [estimated, truth] : pairs) {
    const double angle = estimated.rotation().angularDistance(truth.rotation());
    const Eigen::Vector3d offset =
        (estimated.translation() - truth.translation()) / camera_distance_m;
    sum += offset.squaredNorm() + angle * angle;
  }
  return std::sqrt(sum / static_cast<double>(pairs.size()));
}

double difference_of(std::vector<PosePair> pairs, const Convention& of_estimated,
                     const Convention& of_truth) {
  for (PosePair& pair : pairs)
    pair = {converted(pair.estimated, of_estimated), converted(pair.truth, of_truth)};
  return difference_of(pairs, camera_distance(pairs));
}

// Returns the rigid offset that maps the estimates to the true poses: the mean rotation, then the
// translation of least squares.
using FrameOffset = Transform<frame::Table, frame::Table>;  // T_truth_estimate
FrameOffset mean_offset(const std::vector<PosePair>& pairs) {
  Eigen::Vector4d sum = Eigen::Vector4d::Zero();
  for (const auto& [estimated, truth] : pairs) {
    const Eigen::Vector4d q = (truth.rotation() * estimated.rotation().conjugate()).coeffs();
    sum += (sum.dot(q) < 0.0 ? -1.0 : 1.0) * q;  // q and -q are the same rotation
  }
  const Eigen::Quaterniond rotation = Eigen::Quaterniond(sum).normalized();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  for (const auto& [estimated, truth] : pairs)
    translation += truth.translation() - rotation * estimated.translation();
  return {rotation, translation / static_cast<double>(pairs.size())};
}

double difference_after(std::vector<PosePair> pairs, const FrameOffset& T_truth_estimate,
                        double camera_distance_m) {
  for (PosePair& pair : pairs) pair.estimated = T_truth_estimate * pair.estimated;
  return difference_of(pairs, camera_distance_m);
}

// Returns the hint if a constant offset between two table frames explains the difference.
std::optional<std::string> frame_hint(const std::vector<PosePair>& pairs,
                                      std::string_view truth_file) {
  constexpr std::size_t kMinPairs = 5;
  // About 0.6 degrees, or 1 % of the camera's distance from the table's origin.
  constexpr double kLarge = 0.01;
  constexpr double kReduction = 0.25;
  if (pairs.size() < kMinPairs) return std::nullopt;
  const double distance_m = camera_distance(pairs);
  const double as_given = difference_of(pairs, distance_m);
  const FrameOffset offset = mean_offset(pairs);
  const double after = difference_after(pairs, offset, distance_m);
  if (!(as_given > kLarge && after < kReduction * as_given)) return std::nullopt;
  // A constant offset of the camera has another cause, such as the lens. If the camera hardly
  // moves, the two can't be distinguished.
  std::vector<PosePair> inverse = pairs;
  constexpr Convention kInverse{.inverse = true};
  for (PosePair& pair : inverse)
    pair = {converted(pair.estimated, kInverse), converted(pair.truth, kInverse)};
  if (!(after < 0.5 * difference_after(inverse, mean_offset(inverse), distance_m)))
    return std::nullopt;
  return fmt::format(
      "{}: the ground truth and the estimate have different table frames: {:.1f} mm between their "
      "origins and {:.2f} degrees between their axes explain over 75 % of the error. Nothing was "
      "changed; track with the tag map that the ground truth belongs to, or convert the ground "
      "truth",
      truth_file, 1e3 * offset.translation().norm(),
      degrees(offset.rotation().angularDistance(Eigen::Quaterniond::Identity())));
}

std::string in_words(const Convention& convention, const char* millimetres, const char* w_first,
                     const char* inverse) {
  std::string text;
  for (const auto& [present, words] :
       {std::pair(convention.millimetres, millimetres), std::pair(convention.w_first, w_first),
        std::pair(convention.inverse, inverse)}) {
    if (present) text += fmt::format("{}{}", text.empty() ? "" : " and ", words);
  }
  return text;
}

std::string hint_of(const Convention& convention, bool of_truth, std::string_view file) {
  return fmt::format(
      "{}: the {} looks like it has {}: that explains over 95 % of the error. Nothing was changed; "
      "give {}{}",
      file, of_truth ? "ground truth" : "estimate",
      in_words(convention, "positions in millimetres", "quaternions in the order w x y z",
               "inverse poses (T_camera_table)"),
      in_words(convention, "positions in metres", "quaternions as qx qy qz qw", "T_table_camera"),
      convention.inverse ? " (or the other file has inverse poses)" : "");
}

}  // namespace

std::optional<std::string> pose_convention_hint(const NamedTrajectory& estimated,
                                                const NamedTrajectory& truth,
                                                const PairingOptions& options) {
  const std::vector<PosePair> pairs = pairs_of(estimated.trajectory, truth.trajectory, options);
  if (pairs.empty()) return std::nullopt;
  const double as_given = difference_of(pairs, {}, {});
  // About 10 degrees, or 20 % of the camera's distance from the table's origin.
  constexpr double kLarge = 0.2;
  constexpr double kReduction = 0.05;
  if (!(as_given > kLarge)) return frame_hint(pairs, truth.name);
  // In order of increasing complexity.
  constexpr std::array<Convention, 7> kConventions = {{{.millimetres = true},
                                                       {.w_first = true},
                                                       {.inverse = true},
                                                       {.millimetres = true, .w_first = true},
                                                       {.millimetres = true, .inverse = true},
                                                       {.w_first = true, .inverse = true},
                                                       {true, true, true}}};
  for (const Convention& convention : kConventions) {
    for (const bool of_truth : {true, false}) {
      const double difference =
          of_truth ? difference_of(pairs, {}, convention) : difference_of(pairs, convention, {});
      if (!(difference < kReduction * as_given && difference < kLarge)) continue;
      return hint_of(convention, of_truth, of_truth ? truth.name : estimated.name);
    }
  }
  return frame_hint(pairs, truth.name);
}

}  // namespace penumbra
