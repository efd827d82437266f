// A sweep over loose tags -> where each of them is: tags of known size at unknown places.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/camera_model.hpp"
#include "core/error.hpp"
#include "core/image_view.hpp"
#include "core/tag_map.hpp"
#include "tracking/pose_refiner.hpp"
#include "tracking/tag_detector.hpp"

namespace penumbra {

struct SurveyOptions {
  TagFamily family = TagFamily::tag36h11;
  std::optional<double> tag_size_m;  // of every tag that `sizes_m` does not name
  std::map<int, double> sizes_m;     // by id
  int anchor = 0;                    // its frame becomes the table's, in all six freedoms
  int most_frames = 150;             // of more, every n-th
  // Whether the edges of black squares may lie further out in the image than the tags' sizes say,
  // by one number for all (tone curve, blur).
  bool edge_shift = true;
};

struct SurveyedTag {
  MappedTag tag;
  // Of [position; rotation] in the table frame: position [m], rotation [rad] about table axes.
  Matrix6d covariance = Matrix6d::Zero();
  int frames = 0;  // it was seen in
};

struct TagSurvey {
  std::vector<SurveyedTag> tags;      // by id
  std::vector<std::string> left_out;  // tags that were seen but can't be placed, and why
  int frames_used = 0;
  double rms_px = 0.0;  // 2-D distance
  // By which black squares look larger (tone curve, blur); 0 where it was not asked for, or the
  // views don't tell it from the tags' distances: with all of them as large in every view a larger
  // shift and a longer way between them show the same.
  double edge_shift_px = 0.0;
  // RMS height of tag centres over the plane that fits them best, and its tilt against the
  // anchor's.
  double flatness_m = 0.0;
  double plane_tilt_rad = 0.0;
};

// One frame's tags, as measured.
struct SurveyFrame {
  std::vector<TagDetection> tags;
};

// Cameras and tags are chained from the anchor outwards and then adjusted all together, along with
// the one number by which tone curve and blur move all edges of black squares. An error says in one
// line what the sweep lacks.
[[nodiscard]] Result<TagSurvey> survey_tags(const CameraModel& camera,
                                            std::span<const SurveyFrame> frames,
                                            const SurveyOptions& options);

// A tags.yaml with one more key per tag, `covariance`: 36 numbers, row by row, of [position;
// rotation].
[[nodiscard]] Result<void> save_tag_survey(const std::filesystem::path& file,
                                           const TagSurvey& survey);

// Sizes by id [m]: a YAML map of ID: METRES, or the sizes of a tags.yaml.
[[nodiscard]] Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file);

}  // namespace penumbra
