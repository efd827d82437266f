#include "tracking/evaluation/residual_causes.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "core/evaluation/evaluation.hpp"
#include "core/statistics.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

// Unknowns: six per tag (translation and rotation of the tag), then the camera's.
constexpr Eigen::Index kPerTag = 6;
constexpr Eigen::Index kLens = 5;  // focal length, centre x and y, radial of third and fifth order
constexpr Eigen::Index kCameraUnknowns = kLens + 1;  // lens parameters and row time
// Priors (1 sigma). Every unknown is in units of its prior, which only bounds directions that the
// data do not determine.
constexpr double kPaperPrior_m = 0.005;  // shift of a tag, and of its corners by its rotation
constexpr double kFocalPrior = 0.02;
constexpr double kCentrePrior_px = 10.0;
constexpr double kRadialPrior = 0.1;
constexpr double kRowPrior_s = 50e-6;

constexpr double kModel_px = 0.1;       // error of a corner that its covariance does not include
constexpr double kOutlier = 4.0;        // residual of an outlier over the median residual
constexpr double kMinOutlier_px = 0.3;  // residual that is never an outlier
constexpr int kRounds = 3;
constexpr int kPoseSteps = 2;       // Gauss-Newton steps of a frame's pose before all is linearised
constexpr std::size_t kBlocks = 8;  // number of jackknife blocks of consecutive frames
// Minimum part that a significant cause explains: fraction of the squares that the others leave,
// and RMS.
constexpr double kSignificant = 0.05;
constexpr double kSignificant_px = 0.03;

using Vector8d = Eigen::Matrix<double, 8, 1>;

// Derivatives of the eight coordinates of a tag's corners.
struct View {
  std::size_t tag = 0;
  double weight = 1.0;
  bool outlier = false;
  Vector8d residual;  // measured - predicted [px]
  Eigen::Matrix<double, 8, 6> pose;
  Eigen::Matrix<double, 8, kPerTag> paper;
  Eigen::Matrix<double, 8, kCameraUnknowns> camera;
};

// Derivatives of the corners of the overlay cube; zero for corners behind the camera.
struct CubeView {
  Eigen::Matrix<double, 16, 6> pose = Eigen::Matrix<double, 16, 6>::Zero();
  Eigen::Matrix<double, 16, kLens> lens = Eigen::Matrix<double, 16, kLens>::Zero();
  int corners = 0;
};

struct FrameViews {
  std::vector<View> views;
  CubeView cube;

  [[nodiscard]] std::size_t used() const {
    return static_cast<std::size_t>(std::ranges::count(views, false, &View::outlier));
  }
};

// d pixel / d unknowns of the lens.
Eigen::Matrix<double, 2, kLens> lens_columns(const CameraParameters& p,
                                             const Eigen::Vector2d& pixel) {
  const Eigen::Vector2d from_centre = pixel - Eigen::Vector2d(p.cx, p.cy);
  const double r2 = Eigen::Vector2d(from_centre.x() / p.fx, from_centre.y() / p.fy).squaredNorm();
  Eigen::Matrix<double, 2, kLens> columns;
  columns << kFocalPrior * from_centre, kCentrePrior_px * Eigen::Matrix2d::Identity(),
      kRadialPrior * r2 * from_centre, kRadialPrior * r2 * r2 * from_centre;
  return columns;
}

// Adds the derivatives of one corner as rows 2 i and 2 i + 1. Returns false behind the camera.
bool add_corner(const CameraModel& camera, const FrameCorners& frame, const MappedTag& tag,
                std::size_t i, const Eigen::Vector2d& measured, View& view) {
  const CameraParameters& p = camera.parameters();
  const double row = measured.y() - 0.5 * (camera.height() - 1);
  const double given_row_s = p.rolling_shutter_row_s.value_or(0.0);
  const MapFromCamera pose = perturbed(frame.T_map_camera, row * given_row_s * frame.velocity);
  const std::array<Eigen::Vector3d, 4> on_tag = tag_corners(tag.size_m);
  const Eigen::Vector3d p_map = tag.T_table_tag * on_tag[i];
  const std::optional<Eigen::Vector2d> pixel = camera.project(pose.inverse() * p_map);
  if (!pixel) return false;
  const Eigen::Matrix<double, 2, 6> J = reprojection_jacobian(camera, pose, p_map);
  const auto at = static_cast<Eigen::Index>(2 * i);
  view.residual.segment<2>(at) = measured - *pixel;
  view.pose.middleRows<2>(at) = J;
  // A camera translation by nu moves a point by -nu.
  const Eigen::Matrix<double, 2, 3> J_tag =
      -J.leftCols<3>() * pose.rotation_matrix().transpose() * tag.T_table_tag.rotation_matrix();
  view.paper.middleRows<2>(at).leftCols<3>() = kPaperPrior_m * J_tag;
  const double half_m = 0.5 * tag.size_m;
  view.paper.middleRows<2>(at).rightCols<3>() = -kPaperPrior_m / half_m * J_tag * skew(on_tag[i]);
  view.camera.middleRows<2>(at) << lens_columns(p, *pixel), kRowPrior_s * row * J * frame.velocity;
  return true;
}

CubeView cube_of(const CameraModel& camera, const MapFromCamera& pose) {
  CubeView cube;
  Eigen::Index at = 0;
  for (const Eigen::Vector3d& corner : overlay_cube()) {
    const std::optional<Eigen::Vector2d> pixel = camera.project(pose.inverse() * corner);
    if (pixel) {
      cube.pose.middleRows<2>(at) = reprojection_jacobian(camera, pose, corner);
      cube.lens.middleRows<2>(at) = lens_columns(camera.parameters(), *pixel);
      ++cube.corners;
    }
    at += 2;
  }
  return cube;
}

// Fits the pose of a frame to `pixels(view)`; returns nullopt for too few tags.
std::optional<Vector6d> fit_pose(const FrameViews& frame, const auto& pixels) {
  if (frame.used() < kMinResidualTags) return std::nullopt;
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  for (const View& view : frame.views) {
    if (view.outlier) continue;
    H += view.weight * view.pose.transpose() * view.pose;
    g += view.weight * view.pose.transpose() * pixels(view);
  }
  return Vector6d(H.ldlt().solve(g));
}

// Linearises at the pose that fits the corners.
FrameViews views_of(const CameraModel& camera, std::span<const MappedTag> tags,
                    FrameCorners frame) {
  FrameViews result;
  for (int step = 0; step <= kPoseSteps; ++step) {
    result.views.clear();
    for (const TagCorners& seen : frame.tags) {
      View view;
      view.tag = seen.tag;
      view.weight = kModel_px * kModel_px / (kModel_px * kModel_px + seen.sigma_px * seen.sigma_px);
      bool in_front = true;
      for (std::size_t i = 0; i < 4 && in_front; ++i)
        in_front = add_corner(camera, frame, tags[seen.tag], i, seen.corners_px[i], view);
      if (in_front && view.residual.allFinite()) result.views.push_back(view);
    }
    const auto xi = fit_pose(result, [](const View& view) { return view.residual; });
    if (!xi || step == kPoseSteps) break;
    frame.T_map_camera = perturbed(frame.T_map_camera, *xi);
  }
  result.cube = cube_of(camera, frame.T_map_camera);
  return result;
}

// Normal equations of all unknowns, with each frame's pose marginalised.
struct NormalEquations {
  Eigen::MatrixXd A;
  Eigen::VectorXd b;
  double squares = 0.0;  // weighted squares of the residuals after the pose fit
  double corners = 0.0;  // sum of the corners' weights
  int frames = 0;

  explicit NormalEquations(std::size_t tags) {
    const Eigen::Index size = kPerTag * static_cast<Eigen::Index>(tags) + kCameraUnknowns;
    A.setZero(size, size);
    b.setZero(size);
  }
  void add(const FrameViews& frame);
  // Adds `sign` times the other equations.
  void add(const NormalEquations& other, int sign) {
    A += sign * other.A;
    b += sign * other.b;
    squares += sign * other.squares;
    corners += sign * other.corners;
    frames += sign * other.frames;
  }
  // Weighted squares that remain with these unknowns.
  [[nodiscard]] double squares_after(const Eigen::VectorXd& x) const {
    return squares - 2.0 * x.dot(b) + x.dot(A * x);
  }
  [[nodiscard]] double variance() const { return squares / std::max(2.0 * corners, 1.0); }
};

void NormalEquations::add(const FrameViews& frame) {
  if (frame.used() < kMinResidualTags) return;
  const Eigen::Index camera = A.rows() - kCameraUnknowns;
  Matrix6d H = Matrix6d::Zero();
  Vector6d g = Vector6d::Zero();
  Eigen::MatrixXd cross = Eigen::MatrixXd::Zero(6, A.rows());  // pose by unknowns
  for (const View& view : frame.views) {
    if (view.outlier) continue;
    const double w = view.weight;
    const Eigen::Index at = kPerTag * static_cast<Eigen::Index>(view.tag);
    H += w * view.pose.transpose() * view.pose;
    g += w * view.pose.transpose() * view.residual;
    cross.middleCols<kPerTag>(at) += w * view.pose.transpose() * view.paper;
    cross.rightCols<kCameraUnknowns>() += w * view.pose.transpose() * view.camera;
    A.block<kPerTag, kPerTag>(at, at) += w * view.paper.transpose() * view.paper;
    A.block<kPerTag, kCameraUnknowns>(at, camera) += w * view.paper.transpose() * view.camera;
    A.block<kCameraUnknowns, kPerTag>(camera, at) += w * view.camera.transpose() * view.paper;
    A.bottomRightCorner<kCameraUnknowns, kCameraUnknowns>() +=
        w * view.camera.transpose() * view.camera;
    b.segment<kPerTag>(at) += w * view.paper.transpose() * view.residual;
    b.tail<kCameraUnknowns>() += w * view.camera.transpose() * view.residual;
    squares += w * view.residual.squaredNorm();
    corners += 4.0 * w;
  }
  const Eigen::LLT<Matrix6d> pose(H);
  const Eigen::MatrixXd Y = pose.matrixL().solve(cross);
  const Vector6d y = pose.matrixL().solve(g);
  A.noalias() -= Y.transpose() * Y;
  b.noalias() -= Y.transpose() * y;
  squares -= y.squaredNorm();
  ++frames;
}

// A set of causes, as bits of ErrorCause.
using Causes = unsigned;
constexpr Causes kAll = (1U << kErrorCauses) - 1U;
constexpr Causes bit(std::size_t cause) {
  return 1U << cause;
}

std::vector<Eigen::Index> unknowns_of(Causes causes, Eigen::Index size) {
  const std::array<Eigen::Index, kErrorCauses + 1> begin = {0, size - kCameraUnknowns, size - 1,
                                                            size};
  std::vector<Eigen::Index> unknowns;
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    if ((causes & bit(cause)) == 0) continue;
    for (Eigen::Index i = begin[cause]; i < begin[cause + 1]; ++i) unknowns.push_back(i);
  }
  return unknowns;
}

// Solves for the unknowns of these causes; the others are zero.
Eigen::VectorXd solve(const NormalEquations& equations, Causes causes) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(equations.b.size());
  const std::vector<Eigen::Index> unknowns = unknowns_of(causes, x.size());
  if (unknowns.empty()) return x;
  Eigen::MatrixXd A = equations.A(unknowns, unknowns);
  A.diagonal().array() += std::max(equations.variance(), 1e-12);  // the prior
  const Eigen::VectorXd b = equations.b(unknowns);
  const Eigen::VectorXd solved = A.ldlt().solve(b);
  x(unknowns) = solved;
  return x;
}

// Equations of frames [begin, end), every `step`-th one.
NormalEquations equations_of(std::span<const FrameViews> frames, std::size_t tags,
                             std::size_t begin, std::size_t end, std::size_t step = 1) {
  NormalEquations equations(tags);
  for (std::size_t i = begin; i < end; i += step) equations.add(frames[i]);
  return equations;
}

// Returns the displacement of a view's corners by the unknowns [px].
Vector8d effect_of(const Eigen::VectorXd& x, const View& view) {
  return view.paper * x.segment<kPerTag>(kPerTag * static_cast<Eigen::Index>(view.tag)) +
         view.camera * x.tail<kCameraUnknowns>();
}

// Residual of each view with these unknowns, RMS distance of its corners [px].
std::vector<double> view_residuals_px(const FrameViews& frame, const Eigen::VectorXd& x) {
  const auto left = [&](const View& view) -> Vector8d {
    return view.residual - effect_of(x, view);
  };
  const Vector6d xi = fit_pose(frame, left).value_or(Vector6d::Zero());
  std::vector<double> residuals;
  for (const View& view : frame.views)
    residuals.push_back(0.5 * (left(view) - view.pose * xi).norm());
  return residuals;
}

// Lens that projects the reference overlay.
enum class ImageLens { true_lens, given };

// Overlay error of poses that absorb the effect of these unknowns, RMS over the frames [px].
double overlay_px(std::span<const FrameViews> frames, const Eigen::VectorXd& x, ImageLens lens) {
  double sum = 0.0;
  int corners = 0;
  for (const FrameViews& frame : frames) {
    const auto xi = fit_pose(frame, [&](const View& view) { return effect_of(x, view); });
    if (!xi) continue;
    Eigen::Matrix<double, 16, 1> error = frame.cube.pose * *xi;
    if (lens == ImageLens::true_lens)
      error -= frame.cube.lens * x.tail<kCameraUnknowns>().head<kLens>();
    sum += error.squaredNorm();
    corners += frame.cube.corners;
  }
  return corners == 0 ? 0.0 : std::sqrt(sum / corners);
}

// Marks the views that all causes together do not explain, such as partly covered tags.
void mark_outliers(std::vector<FrameViews>& frames, std::size_t tags) {
  for (int round = 0; round < kRounds; ++round) {
    const Eigen::VectorXd x = solve(equations_of(frames, tags, 0, frames.size()), kAll);
    std::vector<std::vector<double>> residuals;
    std::vector<double> all;
    for (const FrameViews& frame : frames) {
      residuals.push_back(view_residuals_px(frame, x));
      all.insert(all.end(), residuals.back().begin(), residuals.back().end());
    }
    const double limit = std::max(kOutlier * upper_median(all), kMinOutlier_px);
    for (std::size_t i = 0; i < frames.size(); ++i) {
      for (std::size_t k = 0; k < frames[i].views.size(); ++k)
        frames[i].views[k].outlier = residuals[i][k] > limit;
    }
  }
}

// Two-fold cross-validation: fraction of the squared residuals of one half of the frames that a fit
// to the other half explains.
class CrossValidation {
 public:
  CrossValidation(const NormalEquations& odd, const NormalEquations& even)
      : odd_(odd), even_(even) {
    for (Causes causes = 0; causes <= kAll; ++causes) {
      const double left =
          even_.squares_after(solve(odd_, causes)) + odd_.squares_after(solve(even_, causes));
      explained_[causes] = 1.0 - left / std::max(odd_.squares + even_.squares, 1e-300);
    }
  }
  [[nodiscard]] double explained(Causes causes) const { return explained_[causes]; }

 private:
  const NormalEquations& odd_;
  const NormalEquations& even_;
  std::array<double, kAll + 1> explained_{};
};

CauseSizes sizes_of(const Eigen::VectorXd& x, std::span<const MappedTag> tags,
                    const NormalEquations& equations, const CameraModel& camera) {
  CauseSizes sizes;
  double off = 0.0;
  double in = 0.0;
  int corners = 0;
  for (std::size_t k = 0; k < tags.size(); ++k) {
    const Eigen::Index at = kPerTag * static_cast<Eigen::Index>(k);
    if (!(equations.A(at, at) > 0.0)) continue;  // not seen
    const Eigen::Vector3d shift = kPaperPrior_m * x.segment<3>(at);
    const Eigen::Vector3d turn = 2.0 * kPaperPrior_m / tags[k].size_m * x.segment<3>(at + 3);
    for (const Eigen::Vector3d& corner : tag_corners(tags[k].size_m)) {
      const Eigen::Vector3d moved = shift + turn.cross(corner);
      off += moved.z() * moved.z();
      in += moved.head<2>().squaredNorm();
      ++corners;
    }
  }
  sizes.off_flat_m = std::sqrt(off / std::max(corners, 1));
  sizes.in_plane_m = std::sqrt(in / std::max(corners, 1));
  const Eigen::Matrix<double, kCameraUnknowns, 1> camera_unknowns = x.tail<kCameraUnknowns>();
  sizes.focal_fraction = kFocalPrior * camera_unknowns[0];
  sizes.centre_px = kCentrePrior_px * camera_unknowns.segment<2>(1);
  const double half_width_px = 0.5 * camera.width();
  const double r2 = std::pow(half_width_px / camera.parameters().fx, 2);
  sizes.radial_px =
      kRadialPrior * half_width_px * r2 * (camera_unknowns[3] + r2 * camera_unknowns[4]);
  sizes.row_time_s = kRowPrior_s * camera_unknowns[5];
  return sizes;
}

// The fit of some causes to all frames, and to all but one block of frames (jackknife).
struct BlockFits {
  Eigen::VectorXd x;
  std::vector<Eigen::VectorXd> without_block;

  // Jackknife standard deviation. `value`: magnitude of the difference of two fits.
  [[nodiscard]] double sigma(const auto& value) const {
    double sum = 0.0;
    for (const Eigen::VectorXd& other : without_block)
      sum += std::pow(value(Eigen::VectorXd(other - x)), 2);
    const auto count = static_cast<double>(without_block.size());
    return std::sqrt(sum * (count - 1.0) / count);
  }
};

BlockFits fit_blocks(std::span<const FrameViews> frames, std::size_t tags,
                     const NormalEquations& all, Causes causes) {
  BlockFits fits{solve(all, causes), {}};
  for (std::size_t block = 0; block < kBlocks; ++block) {
    NormalEquations others = all;
    others.add(equations_of(frames, tags, block * frames.size() / kBlocks,
                            (block + 1) * frames.size() / kBlocks),
               -1);
    fits.without_block.push_back(solve(others, causes));
  }
  return fits;
}

// Copies the part of the sizes that belongs to a cause.
void copy_size(const CauseSizes& from, ErrorCause cause, CauseSizes& to) {
  switch (cause) {
    case ErrorCause::paper:
      to.off_flat_m = from.off_flat_m;
      to.in_plane_m = from.in_plane_m;
      return;
    case ErrorCause::lens:
      to.focal_fraction = from.focal_fraction;
      to.focal_sigma = from.focal_sigma;
      to.centre_px = from.centre_px;
      to.radial_px = from.radial_px;
      return;
    case ErrorCause::shutter:
      to.row_time_s = from.row_time_s;
      to.row_time_sigma_s = from.row_time_sigma_s;
      return;
  }
}

Causes significant_causes(const ResidualCauses& result) {
  Causes causes = 0;
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    if (result.evidence[cause].significant) causes |= bit(cause);
  }
  return causes;
}

Causes possible_causes(const ResidualCauses& result) {
  Causes causes = 0;
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    if (result.evidence[cause].possible) causes |= bit(cause);
  }
  return causes;
}

void judge(const CrossValidation& validation, ResidualCauses& result) {
  const auto px = [&](double fraction) {
    return result.rms_px * std::sqrt(std::clamp(fraction, 0.0, 1.0));
  };
  // `causes` explain a significant part of what `others` leave.
  const auto enough = [&](Causes causes, Causes others) {
    const double more = validation.explained(causes | others) - validation.explained(others);
    const double left = std::max(1.0 - validation.explained(others), 1e-9);
    return more >= kSignificant * left && px(more) >= kSignificant_px;
  };
  result.explained = validation.explained(kAll);
  result.noise_px = px(1.0 - result.explained);
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    CauseEvidence& evidence = result.evidence[cause];
    evidence.alone = validation.explained(bit(cause));
    evidence.unique = result.explained - validation.explained(kAll & ~bit(cause));
    evidence.alone_px = px(evidence.alone);
    evidence.unique_px = px(evidence.unique);
    evidence.significant = enough(bit(cause), kAll & ~bit(cause));
  }
  // Several other causes may explain the residuals that the significant causes leave.
  const Causes significant = significant_causes(result);
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    CauseEvidence& evidence = result.evidence[cause];
    evidence.possible = !evidence.significant && enough(bit(cause), significant);
  }
}

// Sizes of the significant and possible causes, and their effect on the overlay.
void measure_causes(const CameraModel& camera, std::span<const MappedTag> tags,
                    std::span<const FrameViews> frames, const NormalEquations& all,
                    ResidualCauses& result) {
  const auto overlay = [&](const Eigen::VectorXd& x) {
    return overlay_px(frames, x, ImageLens::true_lens);
  };
  const Causes significant = significant_causes(result);
  const BlockFits joint =
      fit_blocks(frames, tags.size(), all,
                 significant | bit(static_cast<std::size_t>(ErrorCause::paper)) |
                     bit(static_cast<std::size_t>(ErrorCause::shutter)));
  const auto row_time_s = [](const Eigen::VectorXd& x) { return kRowPrior_s * x[x.size() - 1]; };
  result.joint_row_time_s = row_time_s(joint.x);
  result.joint_row_time_sigma_s = joint.sigma(row_time_s);
  if (significant != 0) {
    const BlockFits fits = fit_blocks(frames, tags.size(), all, significant);
    result.overlay_px = overlay(fits.x);
    result.overlay_sigma_px = fits.sigma(overlay);
  }
  const Causes likely = significant != 0 ? significant : possible_causes(result);
  if (likely != 0) result.pose_px = overlay_px(frames, solve(all, likely), ImageLens::given);
  for (std::size_t cause = 0; cause < kErrorCauses; ++cause) {
    CauseEvidence& evidence = result.evidence[cause];
    if (!evidence.significant && !evidence.possible) continue;
    const BlockFits fits = fit_blocks(frames, tags.size(), all, significant | bit(cause));
    const auto size = [&](const Eigen::VectorXd& x) { return sizes_of(x, tags, all, camera); };
    CauseSizes sizes = size(fits.x);
    sizes.focal_sigma =
        fits.sigma([&](const Eigen::VectorXd& x) { return size(x).focal_fraction; });
    sizes.row_time_sigma_s =
        fits.sigma([&](const Eigen::VectorXd& x) { return size(x).row_time_s; });
    copy_size(sizes, static_cast<ErrorCause>(cause), result.sizes);
    const std::vector<Eigen::Index> unknowns = unknowns_of(bit(cause), fits.x.size());
    const auto cause_overlay_px = [&](const Eigen::VectorXd& x) {
      Eigen::VectorXd only = Eigen::VectorXd::Zero(x.size());
      for (const Eigen::Index i : unknowns) only[i] = x[i];
      return overlay(only);
    };
    evidence.overlay_px = cause_overlay_px(fits.x);
    evidence.overlay_sigma_px = fits.sigma(cause_overlay_px);
  }
}

}  // namespace

ResidualCauses find_residual_causes(const CameraModel& camera, std::span<const MappedTag> tags,
                                    std::span<const FrameCorners> frames) {
  std::vector<FrameViews> views;
  for (const FrameCorners& frame : frames) {
    FrameViews frame_views = views_of(camera, tags, frame);
    if (frame_views.used() >= kMinResidualTags) views.push_back(std::move(frame_views));
  }
  ResidualCauses result;
  if (static_cast<int>(views.size()) < kMinResidualFrames) return result;
  mark_outliers(views, tags.size());
  const NormalEquations even = equations_of(views, tags.size(), 0, views.size(), 2);
  const NormalEquations odd = equations_of(views, tags.size(), 1, views.size(), 2);
  if (even.frames == 0 || odd.frames == 0) return result;
  NormalEquations all = even;
  all.add(odd, 1);
  result.frames = all.frames;
  for (const FrameViews& frame_views : views) {
    const int used = static_cast<int>(frame_views.used());
    result.corners += 4 * used;
    result.outliers += static_cast<int>(frame_views.views.size()) - used;
  }
  result.rms_px = std::sqrt(std::max(all.squares, 0.0) / all.corners);
  judge(CrossValidation(odd, even), result);
  measure_causes(camera, tags, views, all, result);
  return result;
}

}  // namespace penumbra
