// Which view is worth taking next, while a person moves the target before the camera: a view counts
// when it makes the projection surer, and there is one bar for each thing that is still missing.
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
  // The lens that is solved for; else chosen among those that a calibration would try, by the same
  // rule, after every few views.
  std::optional<DistortionModel> model;
  bool for_kalibr = false;  // only lenses that Kalibr's files can say
  // Share by which a view must lower the mean projection uncertainty over the image (one sigma).
  double least_gain = 0.03;
  double goal_px = 0.3;  // of the largest projection uncertainty in the image
  int fewest_views = 12;
  // Pictures follow one another while a person holds the target: one that moves is not taken, since
  // the next one will be better. Else (a recording) each stands by itself, and its blur decides.
  bool held = true;
  std::stop_token stop;  // once requested, the view that is looked at is not solved for
};

// Where in the image the target was seen often enough: equal cells, row by row from the top left.
struct GuideCoverage {
  int columns = 0;
  int rows = 0;
  std::vector<bool> seen;
  std::optional<std::size_t> next;  // the cell that the advice speaks of
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
  std::string advice;                // what to do next; of a recording: what is still missing
  GuideCoverage coverage;
  bool enough = false;
};

// What became of a picture.
struct GuideLook {
  bool taken = false;
  std::string why;    // not taken: in words
  double gain = 0.0;  // share by which it lowers the uncertainty; 0 while no lens is known
  std::vector<Eigen::Vector2d> corners_px;  // of the target, as detected; also where not taken
};

class ViewGuide {
 public:
  [[nodiscard]] static Result<ViewGuide> create(const Target& target,
                                                const GuideOptions& options = {});
  ViewGuide(ViewGuide&&) noexcept;
  ViewGuide& operator=(ViewGuide&&) noexcept;
  ~ViewGuide();

  // All pictures are of one size. A view that is taken is solved for at once.
  [[nodiscard]] GuideLook look(ImageView luma);
  [[nodiscard]] const GuideProgress& progress() const;

 private:
  struct Impl;
  explicit ViewGuide(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// What corners of one view say of the lens, its pose (and for tags its edge shift, as the solver
// has it) eliminated: the inverse of a covariance, for corners of 1 px noise. `view` must be
// explained by `camera`; nothing where no pose does.
[[nodiscard]] std::optional<Eigen::MatrixXd> view_information(
    const CameraModel& camera, const std::vector<Eigen::Vector3d>& board,
    const std::vector<TargetCorner>& corners);

}  // namespace penumbra
