// Chooses views while a person moves the target in front of the camera: a view counts if it lowers
// the projection uncertainty. Progress shows what is still missing.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"
#include "calib/target/target.hpp"
#include "core/error.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct GuideOptions {
  // Else chosen after every few views, as a calibration would.
  std::optional<DistortionModel> model;
  bool for_kalibr = false;  // only lenses that Kalibr's files have
  // Share by which a view must lower the mean projection uncertainty over the image (one sigma).
  double least_gain = 0.03;
  double goal_px = 0.3;  // of the largest projection uncertainty in the image
  // A person holds the target: images in which it moves are not taken, since a better one will
  // follow. Else (a recording) only the blur decides.
  bool held = true;
  std::stop_token stop;  // once requested, solving ends soon
};

// Cells of the image in which the target was seen often enough, row by row from the top left.
struct GuideCoverage {
  int columns = 0;
  int rows = 0;
  std::vector<bool> seen;
  std::optional<std::size_t> next;  // the cell that the advice names
};

// Shares of what is needed, 0 to 1.
struct GuideProgress {
  double image = 0.0;      // of the image where the target was seen
  double size = 0.0;       // nearest over furthest view
  double tilt = 0.0;       // between views
  double certainty = 0.0;  // of the projection
  int views = 0;
  std::optional<double> largest_px;  // projection uncertainty, once a lens is known
  std::string lens;                  // as ModelTrial names it; empty before
  std::string advice;                // the next step; for a recording: what is still missing
  GuideCoverage coverage;
  bool enough = false;
};

struct GuideResult {
  bool taken = false;
  std::string why;    // it was not taken
  double gain = 0.0;  // relative reduction of the uncertainty; 0 while no lens is known
  std::vector<Eigen::Vector2d> corners_px;  // as detected
};

class ViewGuide {
 public:
  [[nodiscard]] static Result<ViewGuide> create(const Target& target,
                                                const GuideOptions& options = {});
  ViewGuide(ViewGuide&&) noexcept;
  ~ViewGuide();

  // All images have one size. Solves at once with a view that is taken.
  [[nodiscard]] GuideResult look(ImageView luma);
  [[nodiscard]] const GuideProgress& progress() const;

 private:
  struct Impl;
  explicit ViewGuide(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Information matrix of the lens from the corners of one view with 1 px noise; the pose and (for
// tags) the edge shift are marginalised. Nothing if no pose explains the corners.
[[nodiscard]] std::optional<Eigen::MatrixXd> view_information(
    const CameraModel& camera, const std::vector<Eigen::Vector3d>& board,
    const std::vector<TargetCorner>& corners);

}  // namespace penumbra
