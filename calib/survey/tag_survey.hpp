// A sweep over loose tags -> where each of them is: tags of known size at unknown places.
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

// What z = 0 of the table is.
enum class SurveyPlane {
  fitted,  // the plane that fits the tags best that lie flat beside the anchor; the anchor's where
           // fewer than three do
  anchor,  // the anchor's own
};

struct SurveyOptions {
  TagFamily family = TagFamily::tag36h11;
  std::optional<double> tag_size_m;  // of every tag that `sizes_m` does not name
  std::map<int, double> sizes_m;     // by id
  // The tag that the table frame is fixed to: its centre is the origin (on the plane, right below
  // or above it) and its x axis points along the table's.
  int anchor = 0;
  SurveyPlane plane = SurveyPlane::fitted;
  int most_frames = 150;  // of more, every n-th
  // Whether the edges of black squares that were not measured one by one may lie further out in the
  // image than the tags' sizes say, by one number for all (tone curve, blur).
  bool edge_shift = true;
  bool refine_camera = false;  // the lens is solved for too
  std::stop_token stop;        // once requested, the survey fails soon
};

struct SurveyedTag {
  MappedTag tag;
  // Of [position; rotation] in the table frame: position [m], rotation [rad] about table axes. That
  // all sizes are as wrong as one is not in it: places are as true to scale as the sizes.
  Matrix6d covariance = Matrix6d::Zero();
  int frames = 0;  // that say where it is: outliers are not counted
};

struct TagSurvey {
  std::vector<SurveyedTag> tags;  // by id
  // Tags that were seen but can't be placed, or that contradict the others (by their size, or since
  // they moved), and why.
  std::vector<std::string> left_out;
  // Of these, those that would fit if they had another size: with that size, where they then are.
  std::vector<MappedTag> misfits;
  int frames_used = 0;
  // T_table_camera of each frame that was given; nothing for those that were not used.
  std::vector<std::optional<CameraPose>> cameras;
  double rms_px = 0.0;  // 2-D distance
  // By which black squares look larger where edges were not measured one by one.
  double edge_shift_px = 0.0;
  // Factor by which the covariance was raised, since errors of neighbouring frames hang together.
  double clustering = 1.0;
  // Of the plane: tags that lie flat in it, RMS height of their centres over it, and its tilt
  // against the anchor's own.
  int tags_on_plane = 0;
  double flatness_m = 0.0;
  double plane_tilt_rad = 0.0;
  // The lens as it was given, or as refined with its covariance (as in CalibrationSolution).
  CameraModel camera;
  Eigen::MatrixXd lens_covariance;
};

// One frame's tags, as detected and, where they were, as measured by their edges.
struct SurveyFrame {
  std::vector<TagDetection> tags;
  std::vector<std::optional<MeasuredTag>> measured;  // one for each of `tags`, or none at all
};

// Cameras and tags are chained from the anchor outwards and then adjusted all together. An error
// says in one line what the sweep lacks.
[[nodiscard]] Result<TagSurvey> survey_tags(const CameraModel& camera,
                                            std::span<const SurveyFrame> frames,
                                            const SurveyOptions& options);

// Measures the edges of a frame's tags in its picture, from where `survey` (of frames as detected)
// puts them: survey_tags once more, with all frames measured, is several times closer. `index` is
// the frame's in that survey.
[[nodiscard]] SurveyFrame measured_frame(const TagSurvey& survey, std::size_t index,
                                         const SurveyFrame& frame, ImageView luma);

// A tags.yaml with one more key per tag, `covariance`: 36 numbers, row by row, of [position;
// rotation].
[[nodiscard]] Result<void> save_tag_survey(const std::filesystem::path& file,
                                           const TagSurvey& survey);

// Sizes by id [m]: a YAML map of ID: METRES, or the sizes of a tags.yaml.
[[nodiscard]] Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file);

}  // namespace penumbra
