// Estimates the poses of separate tags of known size from a video of them
// (docs/calibration.md#survey).
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/survey/tag_edges.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

// Definition of the plane z = 0.
enum class SurveyPlane {
  fitted,  // fitted to the tags parallel to the anchor; with fewer than three, as `anchor`
  anchor,  // the anchor's plane
};

struct SurveyOptions {
  TagFamily family = TagFamily::tag36h11;
  std::optional<double> tag_size_m;  // size of tags without an entry in `sizes_m`
  std::map<int, double> sizes_m;     // by id
  // Tag that defines the table frame: its centre, projected to the plane, is the origin; its x axis
  // is the frame's x axis.
  int anchor = 0;
  SurveyPlane plane = SurveyPlane::fitted;
  int max_frames = 150;  // uses every n-th frame if there are more
  // Solves for the lens as well. The given lens remains if the refined one is not clearly better
  // (is_better_lens()).
  bool refine_camera = false;
  // Standard deviations of fx, fy, cx, cy [px] and the distortion coefficients of the given lens;
  // empty if unknown.
  std::vector<double> lens_sigmas;
  std::stop_token stop;  // once requested, the survey fails soon

  // Size of a tag [m]; 0 if unknown.
  [[nodiscard]] double size_m(int id) const {
    const auto named = sizes_m.find(id);
    return named != sizes_m.end() ? named->second : tag_size_m.value_or(0.0);
  }
};

struct SurveyedTag {
  MappedTag tag;
  // Covariance of [position; rotation] in the table frame: position [m], rotation about the frame's
  // axes [rad]. Excludes the error of the sizes, which scales all positions.
  Matrix6d covariance = Matrix6d::Zero();
  int frames = 0;  // number of frames that show the tag, without outliers
};

struct TagSurvey {
  std::vector<SurveyedTag> tags;  // by id
  // Tags that can't be placed or are inconsistent with the others, with the reason.
  std::vector<std::string> left_out;
  // Rejected tags that would be consistent with another size, with that size.
  std::vector<MappedTag> misfits;
  int frames_used = 0;
  // T_table_camera of each given frame; nullopt if unused.
  std::vector<std::optional<CameraPose>> cameras;
  double rms_px = 0.0;  // 2-D reprojection error of the corners
  // Solved outward edge shift (camera response, blur) of all tags without MeasuredTag.
  double edge_shift_px = 0.0;
  double covariance_inflation = 1.0;  // factor for correlated errors of neighbouring frames
  int tags_on_plane = 0;              // tags in the plane z = 0
  double flatness_m = 0.0;            // RMS height of the centres of these tags
  // RMS and maximum height over that plane of the corners of these tags, with their curvature [m].
  double corner_height_m = 0.0;
  double max_corner_height_m = 0.0;
  // The paper is curved (docs/calibration.md#curved-paper); `tags` have their curvatures.
  bool is_curved = false;
  double plane_tilt_rad = 0.0;      // angle between the plane and the anchor
  CameraModel camera;               // given or refined lens
  Eigen::MatrixXd lens_covariance;  // as in CalibrationSolution; empty for the given lens
  Eigen::MatrixXd lens_prior;       // covariance before the refinement; empty for the given lens
  // Fraction by which the refined lens reduces the squared residuals of frames that it was not
  // solved from. See lens_gain().
  double lens_gain = 0.0;

  [[nodiscard]] bool lens_is_refined() const { return lens_prior.size() > 0; }
};

// Tags of one frame: detections and, if available, edge measurements.
struct SurveyFrame {
  std::vector<TagDetection> tags;
  std::vector<std::optional<MeasuredTag>> measured;  // one per element of `tags`, or empty
  double time_s = 0.0;                               // at the exposure of the middle row
  // Velocity of the camera at that time, T_map_camera * exp(t velocity) [m/s, rad/s]; nullopt: it
  // follows from the neighbouring frames.
  std::optional<Vector6d> velocity = {};
};

// Chains cameras and tags outwards from the anchor, then bundle adjusts them. The error is one line
// that explains what the sweep lacks.
[[nodiscard]] Result<TagSurvey> survey_tags(const CameraModel& camera,
                                            std::span<const SurveyFrame> frames,
                                            const SurveyOptions& options);

// Measures the edges of a frame's tags. `survey`: result for the detected frames; `index`: index of
// this frame. A second survey with measured frames is several times more accurate.
[[nodiscard]] SurveyFrame measured_frame(const TagSurvey& survey, std::size_t index,
                                         const SurveyFrame& frame, ImageView luma);

// Writes a tags.yaml with an additional key per tag, `covariance`: 36 numbers, row by row.
[[nodiscard]] Result<void> save_tag_survey(const std::filesystem::path& file,
                                           const TagSurvey& survey);

// Reads sizes by id [m] from a YAML map of ID: METRES or from a tags.yaml.
[[nodiscard]] Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file);

}  // namespace penumbra
