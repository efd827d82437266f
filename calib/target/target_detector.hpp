// Detects the corners of a calibration target in an image.
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "calib/target/target.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

struct TargetCorner {
  int point = 0;          // index into Target::points
  Eigen::Vector2d pixel;  // [px], (0, 0) at the centre of the top-left pixel
  // Derivative of `pixel` by an outward shift of the black square's edges, which camera response
  // and blur cause; 0 at saddle points.
  Eigen::Vector2d spread = Eigen::Vector2d::Zero();
};

struct TagsInView {
  std::vector<std::size_t> seen;  // indices into the target's tag map
  // Tags of the target's families that are not in its map.
  std::vector<std::pair<TagFamily, int>> others;
};

struct TargetView {
  std::vector<TargetCorner> corners;  // by point; each point once
  // Sigma of the blur across the target's edges [px], upper quartile; 0 if unknown.
  double blur_px = 0.0;
  TagsInView tags;
  // Number of the board's tags with a border of two cells, as Kalibr prints them.
  int two_cell_tags = 0;
  // Median marker size of a ChArUco board; nullopt if no marker is detected with all four corners
  // of its square.
  struct MarkerShare {
    double share = 0.0;    // marker edge / square edge
    double edge_px = 0.0;  // [px] outward shift of its edges against the target file
  };
  std::optional<MarkerShare> markers;
  bool black_squares = false;  // the sheet has Kalibr's black squares at the tags' corners
  std::string problem;         // why there are too few corners; empty for a usable view
};

// Returns a pointer for each point of the target; null if the point is not detected.
[[nodiscard]] std::vector<const TargetCorner*> corners_by_point(
    const Target& target, std::span<const TargetCorner> corners);

// Returns the RMS distance between corners of the same points in two views [px]; infinite if fewer
// than half of the smaller view's points are in both.
[[nodiscard]] double corner_distance(std::span<const TargetCorner> a,
                                     std::span<const TargetCorner> b);

// Returns the numbers of visible inner corners of a chessboard, the larger one first; nullopt if no
// board of 3 x 3 or more is found.
[[nodiscard]] std::optional<std::array<int, 2>> chessboard_size(ImageView luma);

class TargetDetector {
 public:
  [[nodiscard]] static Result<TargetDetector> create(const Target& target);
  [[nodiscard]] TargetView detect(ImageView luma);

  // Refines the corners of detect() by an approximate camera and pose: follows edges along their
  // distorted curves and searches for missed saddle points.
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
  // Returns the detected tags by index in the map. Skips repeated ids, which `repeated` counts.
  // Lists what was detected in `view`, if it is not nullptr.
  [[nodiscard]] std::map<std::size_t, TagDetection> seen_tags(ImageView luma, TagDetector& detector,
                                                              TargetView* view = nullptr,
                                                              int* repeated = nullptr) const;

  Target target_;
  std::optional<TagDetector> tags_;
  std::optional<TagDetector> two_cell_tags_;
  int cells_ = 8;         // width of a tag's black square
  double gap_m_ = 0.0;    // between the black squares of neighbouring tags in a grid
  double spacing_ = 0.0;  // gap / tag size, limited to 0.5
};

}  // namespace penumbra
