#include "core/evaluation/pose_convention_hint.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>
#include <utility>
#include <vector>

#include "core/statistics.hpp"

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
    if (true_pose) pairs.push_back({pose.T_table_camera, *true_pose});
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

// Returns the RMS over pairs of hypot(angle [rad], distance / median distance from the origin).
double difference_of(const std::vector<PosePair>& pairs, const Convention& of_estimated,
                     const Convention& of_truth) {
  std::vector<double> distances;
  double position_sum = 0.0;
  double angle_sum = 0.0;
  for (const PosePair& pair : pairs) {
    const CameraPose estimated = converted(pair.estimated, of_estimated);
    const CameraPose truth = converted(pair.truth, of_truth);
    distances.push_back(std::min(estimated.translation().norm(), truth.translation().norm()));
    position_sum += (estimated.translation() - truth.translation()).squaredNorm();
    const double angle = estimated.rotation().angularDistance(truth.rotation());
    angle_sum += angle * angle;
  }
  constexpr double kMinDistance_m = 1e-6;
  const double distance = std::max(upper_median(std::move(distances)), kMinDistance_m);
  return std::sqrt((position_sum / (distance * distance) + angle_sum) /
                   static_cast<double>(pairs.size()));
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
  if (!(as_given > kLarge)) return std::nullopt;
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
  return std::nullopt;
}

}  // namespace penumbra
