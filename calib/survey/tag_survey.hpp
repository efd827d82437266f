// Estimates the poses of loose tags of known size from a sweep over them
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

// The table's plane z = 0.
enum class SurveyPlane {
  fitted,  // fitted to the tags parallel to the anchor; the anchor's if they are fewer than three
  anchor,  // the anchor's own
};

struct SurveyOptions {
  TagFamily family = TagFamily::tag36h11;
  std::optional<double> tag_size_m;  // of tags that `sizes_m` does not name
  std::map<int, double> sizes_m;     // by id
  // The tag that fixes the table frame: its centre, projected to the plane, is the origin, and its
  // x axis gives that of the table.
  int anchor = 0;
  SurveyPlane plane = SurveyPlane::fitted;
  int most_frames = 150;  // of more, every n-th
  // Solves for one outward shift of all edges that were not measured one by one (camera response,
  // blur).
  bool edge_shift = true;
  bool refine_camera = false;  // solves for the lens as well
  std::stop_token stop;        // once requested, the survey fails soon
};

struct SurveyedTag {
  MappedTag tag;
  // Covariance of [position; rotation] in the table frame: position [m], rotation [rad] about table
  // axes, without the error of the sizes, which scales all positions.
  Matrix6d covariance = Matrix6d::Zero();
  int frames = 0;  // without outliers
};

struct TagSurvey {
  std::vector<SurveyedTag> tags;  // by id
  // Tags that can't be placed or are inconsistent with the others, and why.
  std::vector<std::string> left_out;
  // Those of them that would be consistent with another size, with that size.
  std::vector<MappedTag> misfits;
  int frames_used = 0;
  // T_table_camera of each given frame; nothing for unused ones.
  std::vector<std::optional<CameraPose>> cameras;
  double rms_px = 0.0;         // 2-D distance
  double edge_shift_px = 0.0;  // SurveyOptions::edge_shift
  double clustering = 1.0;     // covariance inflation for correlated errors of neighbouring frames
  // Tags in the table's plane, RMS height of their centres over it, and its tilt against the
  // anchor.
  int tags_on_plane = 0;
  double flatness_m = 0.0;
  double plane_tilt_rad = 0.0;
  // The lens as given or as refined, with its covariance (as in CalibrationSolution).
  CameraModel camera;
  Eigen::MatrixXd lens_covariance;
};

// One frame's tags, as detected and, if available, as measured by their edges.
struct SurveyFrame {
  std::vector<TagDetection> tags;
  std::vector<std::optional<MeasuredTag>> measured;  // one for each of `tags`, or none at all
};

// Chains cameras and tags from the anchor outwards and then adjusts them together. An error says in
// one line what the sweep lacks.
[[nodiscard]] Result<TagSurvey> survey_tags(const CameraModel& camera,
                                            std::span<const SurveyFrame> frames,
                                            const SurveyOptions& options);

// Measures the edges of a frame's tags, predicted by `survey` (of detected frames, where `index` is
// this one). A second survey with measured frames is several times more accurate.
[[nodiscard]] SurveyFrame measured_frame(const TagSurvey& survey, std::size_t index,
                                         const SurveyFrame& frame, ImageView luma);

// Writes a tags.yaml with an additional key per tag, `covariance`: 36 numbers, row by row.
[[nodiscard]] Result<void> save_tag_survey(const std::filesystem::path& file,
                                           const TagSurvey& survey);

// Sizes by id [m]: a YAML map of ID: METRES, or the sizes of a tags.yaml.
[[nodiscard]] Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file);

}  // namespace penumbra
