// Finds the corners of a calibration target in an image.
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/target/target.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

struct TargetCorner {
  int point = 0;          // of Target::points
  Eigen::Vector2d pixel;  // [px], (0, 0) at the centre of the top-left pixel
  // d pixel / d outward shift of its black square's edges, by camera response and blur. Zero at
  // saddle points.
  Eigen::Vector2d spread = Eigen::Vector2d::Zero();
};

struct TargetView {
  std::vector<TargetCorner> corners;  // by point; each point once
  // Sigma of the blur across the target's edges [px], upper quartile; 0 when unknown.
  double blur_px = 0.0;
  // Tags of this board that were seen with a border of two cells, as Kalibr prints them.
  int two_cell_tags = 0;
  // Median size of a ChArUco board's markers; nothing if no marker is seen with all four corners of
  // its square.
  struct MarkerShare {
    double share = 0.0;    // marker edge over square edge
    double edge_px = 0.0;  // displacement of the marker's edges against the target file
  };
  std::optional<MarkerShare> markers;
  bool black_squares = false;  // the sheet has Kalibr's squares at the tags' corners
  std::string problem;         // why there are too few corners; empty for a usable view
};

// A pointer for each point of the target; null for points that are not seen.
[[nodiscard]] std::vector<const TargetCorner*> corners_by_point(
    const Target& target, std::span<const TargetCorner> corners);

// RMS distance [px] between the corners that two views share; infinite if they share fewer than
// half of the smaller view's.
[[nodiscard]] double corner_distance(std::span<const TargetCorner> a,
                                     std::span<const TargetCorner> b);

// Numbers of visible inner corners of the chessboard in the image, the larger one first. Nothing if
// no board of at least 3 x 3 is found.
[[nodiscard]] std::optional<std::array<int, 2>> chessboard_size(ImageView luma);

class TargetDetector {
 public:
  [[nodiscard]] static Result<TargetDetector> create(const Target& target);
  [[nodiscard]] TargetView detect(ImageView luma);

  // Refines the corners of detect(), with camera and pose known approximately: follows edges along
  // the curves of the lens and searches for missed saddle points.
  [[nodiscard]] TargetView refine(ImageView luma, const TargetView& view, const CameraModel& camera,
                                  const CameraPose& T_board_camera) const;

 private:
  TargetDetector() = default;
  [[nodiscard]] TargetView detect_tags(ImageView luma);
  [[nodiscard]] TargetView detect_chessboard(ImageView luma) const;
  [[nodiscard]] TargetView detect_charuco(ImageView luma);
  [[nodiscard]] std::optional<TargetView::MarkerShare> marker_share(
      const TargetView& view, const std::map<std::size_t, TagDetection>& seen) const;
  [[nodiscard]] double blur_of(ImageView luma, const TargetView& view) const;
  [[nodiscard]] bool has_squares(ImageView luma, const TargetView& view) const;
  // Detected tags, by index in the map, without ids that are seen twice (`repeated` counts them).
  [[nodiscard]] std::map<std::size_t, TagDetection> seen_tags(ImageView luma, TagDetector& detector,
                                                              int* repeated = nullptr) const;

  Target target_;
  std::optional<TagDetector> tags_;
  std::optional<TagDetector> two_cell_tags_;
  int cells_ = 8;         // of a tag's black square, across
  double gap_m_ = 0.0;    // between the black squares of neighbouring tags in a grid
  double spacing_ = 0.0;  // the gap over the tag size, at most 0.5
};

}  // namespace penumbra
