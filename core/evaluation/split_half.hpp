// Compares poses of the same frames that were tracked with two disjoint halves of the tags.
// See docs/tracking.md#split-halves.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/statistics.hpp"
#include "core/text/enum_names.hpp"

namespace penumbra {

// Reasons why the two poses of a frame are not compared. The names are keys of the report.
enum class HalfRejection {
  too_few_tags,  // fewer than kMinSplitTags tags were used in both halves together
  not_measured,  // a half found no tag
  uncertain,     // a half is uncertain
  out_of_view,   // the overlay cube is behind the camera
};
inline constexpr std::size_t kHalfRejections = 4;
[[nodiscard]] constexpr std::string_view to_string(HalfRejection rejection) {
  constexpr auto kNames =
      std::to_array<EnumName<HalfRejection>>({{HalfRejection::too_few_tags, "too_few_tags"},
                                              {HalfRejection::not_measured, "not_measured"},
                                              {HalfRejection::uncertain, "uncertain"},
                                              {HalfRejection::out_of_view, "out_of_view"}});
  return name_of(kNames, rejection);
}
[[nodiscard]] std::string_view text_of(HalfRejection rejection);

inline constexpr int kMinSplitTags = 4;

struct HalfDifference {
  std::int64_t timestamp_ns = 0;
  std::optional<HalfRejection> rejection;
  // If there is no rejection: overlay error between the two poses over sqrt 2, and the RMS of their
  // predicted overlay errors without the uncertainty of the lens, which both halves share [px].
  double difference_px = 0.0, predicted_px = 0.0;

  // difference_px / predicted_px; nullopt if the frame is rejected or predicts no error.
  [[nodiscard]] std::optional<double> ratio() const {
    if (rejection || !(predicted_px > 0.0)) return std::nullopt;
    return difference_px / predicted_px;
  }
};
[[nodiscard]] HalfDifference compare_halves(const CameraModel& camera, std::int64_t timestamp_ns,
                                            const PoseEstimate& first, const PoseEstimate& second);

struct SplitHalfErrors {
  int frames_compared = 0;
  std::array<int, kHalfRejections> frames_rejected{};  // by HalfRejection
  Statistics difference_px, predicted_px;              // over the compared frames
  double ratio = 0.0;                                  // RMS difference over RMS prediction
  Statistics frame_ratio;                              // difference over prediction of each frame
  double share_above_3 = 0.0;  // fraction of the compared frames with a ratio above 3
};
[[nodiscard]] SplitHalfErrors split_half_errors(std::span<const HalfDifference> frames);

}  // namespace penumbra
