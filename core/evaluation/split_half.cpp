#include "core/evaluation/split_half.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/evaluation/evaluation.hpp"

namespace penumbra {
namespace {

// Ratio of the actual to the predicted error above which the prediction counts as wrong.
constexpr double kWrongPrediction = 3.0;

std::optional<HalfRejection> rejection_of(const PoseEstimate& first, const PoseEstimate& second) {
  if (first.tags_used == 0 || second.tags_used == 0) return HalfRejection::not_measured;
  if (first.tags_used + second.tags_used < kMinSplitTags) return HalfRejection::too_few_tags;
  if (first.status != TrackStatus::tracked || second.status != TrackStatus::tracked)
    return HalfRejection::uncertain;
  return std::nullopt;
}

}  // namespace

std::string_view text_of(HalfRejection rejection) {
  switch (rejection) {
    case HalfRejection::too_few_tags:
      return "fewer than 4 tags were used";
    case HalfRejection::not_measured:
      return "a half found no tag";
    case HalfRejection::uncertain:
      return "a half is uncertain";
    case HalfRejection::out_of_view:
      return "the table's origin is behind the camera";
  }
  return {};
}

HalfDifference compare_halves(const CameraModel& camera, std::int64_t timestamp_ns,
                              const PoseEstimate& first, const PoseEstimate& second) {
  HalfDifference result;
  result.timestamp_ns = timestamp_ns;
  result.rejection = rejection_of(first, second);
  if (result.rejection) return result;
  const auto predicted_px = [&](const PoseEstimate& pose) {
    return predicted_overlay_error_px(camera, pose.T_table_camera, pose.covariance);
  };
  result.difference_px =
      overlay_difference(camera, first.T_table_camera, second.T_table_camera).rms_px() /
      std::numbers::sqrt2;
  result.predicted_px = std::hypot(predicted_px(first), predicted_px(second)) / std::numbers::sqrt2;
  if (!std::isfinite(result.difference_px) || !std::isfinite(result.predicted_px))
    result.rejection = HalfRejection::out_of_view;
  return result;
}

SplitHalfErrors split_half_errors(std::span<const HalfDifference> frames) {
  SplitHalfErrors errors;
  std::vector<double> difference;
  std::vector<double> predicted;
  std::vector<double> ratio;
  for (const HalfDifference& frame : frames) {
    if (frame.rejection) {
      ++errors.frames_rejected[static_cast<std::size_t>(*frame.rejection)];
      continue;
    }
    difference.push_back(frame.difference_px);
    predicted.push_back(frame.predicted_px);
    if (const auto of_frame = frame.ratio()) ratio.push_back(*of_frame);
  }
  errors.frames_compared = static_cast<int>(difference.size());
  errors.difference_px = statistics_of(std::move(difference));
  errors.predicted_px = statistics_of(std::move(predicted));
  if (errors.predicted_px.rmse > 0.0)
    errors.ratio = errors.difference_px.rmse / errors.predicted_px.rmse;
  if (!ratio.empty()) {
    const auto above = std::ranges::count_if(ratio, [](double r) { return r > kWrongPrediction; });
    errors.share_above_3 = static_cast<double>(above) / static_cast<double>(ratio.size());
  }
  errors.frame_ratio = statistics_of(std::move(ratio));
  return errors;
}

}  // namespace penumbra
