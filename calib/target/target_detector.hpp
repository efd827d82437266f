// Luma -> corners of a calibration target with sub-pixel places.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calib/target/target.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct TargetCorner {
  int point = 0;          // of Target::points
  Eigen::Vector2d pixel;  // [px], (0, 0) at the centre of the top-left pixel
  // Where the corner moves to for each pixel by which the edges of its black square move outwards:
  // what tone curves and blur do to squares (but not to the saddles of chessboards: zero there).
  Eigen::Vector2d spread = Eigen::Vector2d::Zero();
};

struct TargetView {
  std::vector<TargetCorner> corners;  // by point; each point once
  // Sigma of the blur across the target's edges [px], the larger of most edges; 0 when unknown.
  double blur_px = 0.0;
  // Tags of this board that were seen with a border of two cells, as Kalibr prints them.
  int two_cell_tags = 0;
  // Of ChArUco boards: the edge of a marker over that of a square, as seen, and by how many pixels
  // the marker's edges lie elsewhere than the target file says; nothing where no marker is seen
  // with the four corners around it.
  struct MarkerShare {
    double share = 0.0;
    double edge_px = 0.0;
  };
  std::optional<MarkerShare> markers;
  bool black_squares = false;  // the sheet has Kalibr's squares at the tags' corners
  // Why there are no corners, or too few: empty when the view can be used.
  std::string problem;
};

// RMS distance between the corners that two views share [px]; infinite where these are none, or
// fewer than half of what either of them has.
[[nodiscard]] double corner_distance(std::span<const TargetCorner> a,
                                     std::span<const TargetCorner> b);

// Numbers of inner corners of the chessboard in the image, the larger one first. A board that is
// cut off or hidden has fewer. Nothing where no board of at least 3 x 3 is found.
[[nodiscard]] std::optional<std::array<int, 2>> chessboard_size(ImageView luma);

class TargetDetector {
 public:
  [[nodiscard]] static Result<TargetDetector> create(const Target& target);
  TargetDetector(TargetDetector&&) noexcept;
  TargetDetector& operator=(TargetDetector&&) noexcept;
  ~TargetDetector();

  [[nodiscard]] TargetView detect(ImageView luma);

  // The corners again, now that camera and pose are known nearly: edges of tags are followed along
  // the curves that the lens makes of them, and corners that detection missed are looked for where
  // they must be. `view` is what detect() gave for the same picture.
  [[nodiscard]] TargetView refine(ImageView luma, const TargetView& view, const CameraModel& camera,
                                  const CameraPose& T_board_camera) const;

 private:
  struct Impl;
  explicit TargetDetector(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
