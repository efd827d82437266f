// Tests whether the residuals of tag corners come from the map (paper), the lens or the rolling
// shutter. See docs/tracking.md#causes-of-the-residuals.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/text/enum_names.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

struct TagCorners {
  std::size_t tag = 0;                          // index into the list of tags
  std::array<Eigen::Vector2d, 4> corners_px{};  // measured, in the order of tag_corners()
  double sigma_px = 0.0;                        // standard deviation of a coordinate
};

struct FrameCorners {
  MapFromCamera T_map_camera;
  // Velocity at the middle row, T_map_camera * exp(t velocity) [m/s, rad/s]; zero if unknown.
  Vector6d velocity = Vector6d::Zero();
  std::vector<TagCorners> tags;
};

// - paper: the residual of a tag is constant in the table frame.
// - lens: the residual depends only on the position in the image.
// - shutter: the residual is the row's distance from the middle row times the image velocity.
enum class ErrorCause { paper, lens, shutter };
inline constexpr std::size_t kErrorCauses = 3;

[[nodiscard]] constexpr std::string_view to_string(ErrorCause cause) {
  constexpr auto kNames = std::to_array<EnumName<ErrorCause>>(
      {{ErrorCause::paper, "paper"}, {ErrorCause::lens, "lens"}, {ErrorCause::shutter, "shutter"}});
  return name_of(kNames, cause);
}

// Fractions of the squared residuals of frames that the fit did not use. They may be negative.
struct CauseEvidence {
  double alone = 0.0;                      // explained by this cause alone
  double unique = 0.0;                     // explained by all causes, minus explained by the others
  double alone_px = 0.0, unique_px = 0.0;  // the same as RMS [px]; 0 if negative
  bool significant = false;
  // Explains a significant part, but other causes explain it as well.
  bool possible = false;
  // If significant or possible: overlay error of the poses because of this cause, RMS [px].
  double overlay_px = 0.0, overlay_sigma_px = 0.0;
};

// Errors of the map, the lens and the row time that explain the residuals best; zero for a cause
// that is neither significant nor possible. Standard deviations are of a jackknife over blocks of
// consecutive frames.
struct CauseSizes {
  // RMS displacement of the tags' corners: normal to the map's tag, and within its plane [m].
  double off_flat_m = 0.0, in_plane_m = 0.0;
  double focal_fraction = 0.0, focal_sigma = 0.0;       // true over given focal length - 1
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();  // true - given principal point
  double radial_px = 0.0;                               // outward shift at the half width
  double row_time_s = 0.0, row_time_sigma_s = 0.0;      // true - given
};

struct ResidualCauses {
  int frames = 0, corners = 0;
  int outliers = 0;        // views of a tag that were rejected
  double rms_px = 0.0;     // distance of a corner after the pose fit
  double noise_px = 0.0;   // RMS that no cause explains
  double explained = 0.0;  // fraction explained by all causes together
  // Overlay error because of all significant causes together, RMS [px].
  double overlay_px = 0.0, overlay_sigma_px = 0.0;
  // The part of overlay_px that comes from the poses: overlay error if the lens is drawn as given
  // (core/evaluation/evaluation.hpp) [px]. If no cause is significant, that of the possible ones.
  double pose_px = 0.0;
  std::array<CauseEvidence, kErrorCauses> evidence{};  // by ErrorCause
  CauseSizes sizes;
  // Row time from a joint fit with the paper, also if it is not significant. Tags that were mapped
  // from the same frames have absorbed a part of the shutter's effect.
  double joint_row_time_s = 0.0, joint_row_time_sigma_s = 0.0;

  [[nodiscard]] const CauseEvidence& of(ErrorCause cause) const {
    return evidence[static_cast<std::size_t>(cause)];
  }
};

// Returns what seems wrong and the remedy. `given_row_s`: row time in the camera file.
[[nodiscard]] std::string advice(ErrorCause cause, const CauseSizes& sizes, double given_row_s);

inline constexpr int kMinResidualFrames = 8;
inline constexpr std::size_t kMinResidualTags = 3;
// Skips frames with fewer than kMinResidualTags tags. With fewer than kMinResidualFrames frames
// nothing is tested, and ResidualCauses::frames is 0. `camera` and `tags`: those that the poses
// were tracked with.
[[nodiscard]] ResidualCauses find_residual_causes(const CameraModel& camera,
                                                  std::span<const MappedTag> tags,
                                                  std::span<const FrameCorners> frames);

}  // namespace penumbra
