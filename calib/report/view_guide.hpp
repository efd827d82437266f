// Selects views while a person moves the target in front of the camera. A view is used if it lowers
// the projection uncertainty. GuideProgress describes what is missing.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "core/error.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct GuideOptions {
  // If empty, the lens model is chosen again after every few views.
  std::optional<DistortionModel> model;
  bool for_kalibr = false;  // only lenses that Kalibr's files can represent
  // Minimum relative reduction of the mean projection uncertainty (1 sigma) for a view to be used.
  double min_gain = 0.03;
  double goal_px = 0.3;  // target for the maximum projection uncertainty in the image
  // True if a person holds the target: rejects images with motion, because a better one will
  // follow. False for a recording: rejects only blurred images.
  bool held = true;
  std::stop_token stop;  // once requested, solving fails soon
};

// Image cells in which the target was visible often enough, row by row from the top left.
struct GuideCoverage {
  int columns = 0;
  int rows = 0;
  std::vector<bool> seen;
  std::optional<std::size_t> next;  // cell that the advice refers to
};

// `image`, `size`, `tilt` and `certainty` are fractions of the required amount, 0 to 1.
struct GuideProgress {
  double image = 0.0;      // image area that the target has covered
  double size = 0.0;       // size ratio of the nearest and the furthest view
  double tilt = 0.0;       // angle between views
  double certainty = 0.0;  // goal / maximum projection uncertainty
  int views = 0;
  std::optional<double> largest_px;  // projection uncertainty; empty before the first solution
  std::string lens;                  // lens_name(); empty before the first solution
  std::string advice;                // the next step; for a recording: what is still missing
  GuideCoverage coverage;
  bool enough = false;
};

struct GuideResult {
  bool taken = false;
  std::string why;    // reason if it was not taken
  double gain = 0.0;  // relative reduction of the uncertainty; 0 while no lens is known
  std::vector<TargetCorner> corners;  // detected corners of the target
  TagsInView tags;
};

class ViewGuide {
 public:
  [[nodiscard]] static Result<ViewGuide> create(const Target& target,
                                                const GuideOptions& options = {});
  ViewGuide(ViewGuide&&) noexcept;
  ~ViewGuide();

  // Tests an image and solves immediately if its view is used. All images must have the same size.
  [[nodiscard]] GuideResult look(ImageView luma);
  [[nodiscard]] const GuideProgress& progress() const;

 private:
  struct Impl;
  explicit ViewGuide(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Returns the information matrix of the lens from the corners of one view with 1 px noise. Pose and
// (for tags) edge shift are marginalised. Returns nullopt if no pose explains the corners.
[[nodiscard]] std::optional<Eigen::MatrixXd> view_information(
    const CameraModel& camera, const std::vector<Eigen::Vector3d>& board,
    const std::vector<TargetCorner>& corners);

}  // namespace penumbra
