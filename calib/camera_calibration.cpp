#include "calib/camera_calibration.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

namespace penumbra {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
// Views whose boards are all within this of parallel do not tell focal length from distance.
constexpr double kLeastTilt_deg = 8.0;
// Tone curve, blur and ink make black squares look larger or smaller; by more than this share of
// their size, and this far at each edge, they are of another size than the target file says.
constexpr double kOtherSize = 0.04;
constexpr double kOtherEdge_px = 0.8;
constexpr double kWorthwhile = 0.97;  // of the held-out error: what a further freedom must bring

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// RMS distance between the corners that two views share [px]; infinite when they share few.
double view_distance(const TargetView& a, const TargetView& b) {
  double sum = 0.0;
  int count = 0;
  auto j = b.corners.begin();
  for (const TargetCorner& corner : a.corners) {
    while (j != b.corners.end() && j->point < corner.point) ++j;
    if (j == b.corners.end()) break;
    if (j->point != corner.point) continue;
    sum += (j->pixel - corner.pixel).squaredNorm();
    ++count;
  }
  const auto fewer = static_cast<int>(std::min(a.corners.size(), b.corners.size()));
  return 2 * count < fewer || count == 0 ? std::numeric_limits<double>::infinity()
                                         : std::sqrt(sum / count);
}

// Of nine equal cells of the image, the one that holds the pixel: 0, 1 or 2.
std::size_t third_of(double at, int size) {
  return static_cast<std::size_t>(std::clamp(static_cast<int>(3.0 * at / size), 0, 2));
}

std::string cell_name(int column, int row) {
  constexpr std::array<const char*, 3> kRows = {"top", "middle", "bottom"};
  constexpr std::array<const char*, 3> kColumns = {"left", "centre", "right"};
  const auto i = static_cast<std::size_t>(column);
  const auto j = static_cast<std::size_t>(row);
  if (row == 1 && column == 1) return "middle";
  if (row == 1) return kColumns[i];
  if (column == 1) return kRows[j];
  return fmt::format("{} {}", kRows[j], kColumns[i]);
}

std::string cell_name(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return cell_name(static_cast<int>(third_of(pixel.x(), camera.width())),
                   static_cast<int>(third_of(pixel.y(), camera.height())));
}

struct Lens {
  DistortionModel model = DistortionModel::plumb_bob;
  bool without_k3 = false;
};

// Simplest first.
std::vector<Lens> lenses_of(const LensChoice& choice) {
  constexpr Lens kNoK3 = {DistortionModel::plumb_bob, true};
  constexpr Lens kPlumbBob = {DistortionModel::plumb_bob, false};
  if (choice.model)
    return {{*choice.model, choice.for_kalibr && *choice.model == DistortionModel::plumb_bob}};
  if (choice.for_kalibr) return {kNoK3, {DistortionModel::fisheye}};
  return {kNoK3, kPlumbBob, {DistortionModel::fisheye}, {DistortionModel::rational}};
}

}  // namespace

std::string lens_name(const ModelTrial& trial) {
  return fmt::format("{}{}", to_string(trial.model), trial.without_k3 ? ", k3 = 0" : "");
}

std::optional<Eigen::Vector2d> fold_in_image(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const bool whole = p.model == DistortionModel::fisheye && !std::isfinite(camera.max_radius());
  // Distortion grows outwards: what the border's pixels show is the furthest that there is.
  constexpr int kSteps = 64;  // along each side
  const Eigen::Vector2d centre(p.cx, p.cy);
  std::optional<Eigen::Vector2d> nearest;
  const auto look_at = [&](double x, double y) {
    const Eigen::Vector2d pixel(x, y);
    const auto direction = camera.unproject(pixel);
    const bool said =
        direction ? camera.distortion_jacobian(direction->head<2>()).determinant() > 0.0 : whole;
    if (!said && (!nearest || (pixel - centre).norm() < (*nearest - centre).norm()))
      nearest = pixel;
  };
  for (int i = 0; i <= kSteps; ++i) {
    const double x = (p.width - 1.0) * i / kSteps;
    const double y = (p.height - 1.0) * i / kSteps;
    look_at(x, 0.0);
    look_at(x, p.height - 1.0);
    look_at(0.0, y);
    look_at(p.width - 1.0, y);
  }
  return nearest;
}

Result<ChosenLens> choose_lens(const CalibrationSolution& start,
                               const std::vector<Eigen::Vector3d>& board,
                               const std::vector<CalibrationView>& views, const LensChoice& choice,
                               std::optional<BoardShape> shape, std::vector<ModelTrial>& trials) {
  std::optional<ChosenLens> best;
  std::optional<Error> first_error;
  const auto consider = [&](const Lens& lens, BoardShape board_shape) {
    if (choice.stop.stop_requested()) return;
    SolverOptions solver;
    solver.stop = choice.stop;
    solver.without_k3 = lens.without_k3;
    solver.model = lens.model;
    solver.shape = board_shape;
    Result<CalibrationSolution> solved =
        solve_intrinsics(best ? best->solution : start, board, views, solver);
    if (!solved) {
      if (!first_error) first_error = solved.error();
      return;
    }
    const auto held_out = held_out_error(*solved, board, views, solver);
    const auto fold = fold_in_image(solved->camera);
    trials.push_back(
        {lens.model, lens.without_k3, board_shape, solved->rms_px, held_out, fold, false});
    // What explains no view that was left out is worse than what explains some.
    const bool better =
        !best || (held_out && (!best->held_out_px || *held_out < kWorthwhile * *best->held_out_px));
    if (!fold && better)
      best = ChosenLens{std::move(*solved), held_out, lens.without_k3, trials.size() - 1};
  };
  const std::vector<Lens> lenses = lenses_of(choice);
  const BoardShape first_shape = shape.value_or(BoardShape::rigid);
  for (const Lens& lens : lenses) consider(lens, first_shape);
  // A lens that was asked for, but folds for want of corners far out, may do without its last term.
  if (!best && choice.model == DistortionModel::plumb_bob && !choice.for_kalibr)
    consider({DistortionModel::plumb_bob, true}, first_shape);
  if (best && !shape) {
    const auto lens_of_best = [&] {
      return Lens{best->solution.camera.parameters().model, best->without_k3};
    };
    consider(lens_of_best(), BoardShape::bowed);
    // Offsets of their own need every point seen many times.
    if (views.size() >= 8) consider(lens_of_best(), BoardShape::free);
    // What a board that is not flat hides may need a lens with more freedoms.
    const BoardShape found = best->solution.shape;
    const Lens before = lens_of_best();
    bool richer = false;
    for (const Lens& lens : lenses) {
      if (found != BoardShape::rigid && richer) consider(lens, found);
      richer = richer || (lens.model == before.model && lens.without_k3 == before.without_k3);
    }
  }
  if (choice.stop.stop_requested()) return fail("ended early");
  if (best) {
    trials[best->trial].chosen = true;
    return std::move(*best);
  }
  if (!trials.empty() && trials.front().fold_px) {
    const Eigen::Vector2d& at = *trials.front().fold_px;
    return fail(
        "every lens that explains the views folds its picture back inside the image, first at "
        "({:.0f}, {:.0f}): no corners were seen so far out; take views with the target near the {} "
        "and in the other corners{}",
        at.x(), at.y(), cell_name(start.camera, at),
        choice.model == DistortionModel::fisheye ? "" : ", or try --model fisheye");
  }
  return fail(
      "the views do not fix a lens ({}); take views with the target near every corner of the "
      "image, "
      "tilted in several directions",
      first_error ? first_error->message : "none explains them");
}

std::string_view to_string(CalibrationGrade grade) {
  switch (grade) {
    case CalibrationGrade::good:
      return "good";
    case CalibrationGrade::usable:
      return "usable";
    case CalibrationGrade::poor:
      return "poor";
  }
  return "poor";
}

UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance,
                               int columns, int rows) {
  UncertaintyMap map;
  map.columns = columns;
  map.rows = rows;
  double sum = 0.0;
  int count = 0;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const Eigen::Vector2d pixel((i + 0.5) * camera.width() / columns - 0.5,
                                  (j + 0.5) * camera.height() / rows - 0.5);
      const auto here = projection_covariance(camera, covariance, pixel);
      if (!here) {
        map.sigma_px.push_back(std::numeric_limits<double>::quiet_NaN());
        continue;
      }
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(*here);
      const double sigma = std::sqrt(std::max(eigen.eigenvalues()[1], 0.0));
      map.sigma_px.push_back(sigma);
      map.largest_px = std::max(map.largest_px, sigma);
      sum += sigma;
      ++count;
    }
  }
  map.mean_px = count > 0 ? sum / count : std::numeric_limits<double>::quiet_NaN();
  // Nothing is known of where such a lens draws what it can't describe.
  if (count < columns * rows && fold_in_image(camera))
    map.mean_px = map.largest_px = std::numeric_limits<double>::infinity();
  return map;
}

ProjectionDifference projection_difference(const CameraModel& a, const CameraModel& b) {
  constexpr int kColumns = 32;
  constexpr int kRows = 24;
  ProjectionDifference difference;
  int count = 0;
  for (int j = 0; j < kRows; ++j) {
    for (int i = 0; i < kColumns; ++i) {
      const Eigen::Vector2d pixel((a.width() - 1.0) * i / (kColumns - 1),
                                  (a.height() - 1.0) * j / (kRows - 1));
      const auto direction = a.unproject(pixel);
      if (!direction) continue;
      const auto other = b.project_extended(*direction);
      if (!other) continue;
      const double distance = (*other - pixel).norm();
      difference.mean_px += distance;
      difference.largest_px = std::max(difference.largest_px, distance);
      ++count;
    }
  }
  difference.mean_px =
      count > 0 ? difference.mean_px / count : std::numeric_limits<double>::quiet_NaN();
  return difference;
}

struct CameraCalibrator::Impl {
  Target target;
  CalibrationOptions options;
  std::optional<TargetDetector> detector;
  std::vector<CalibrationPicture> pictures;
  int width = 0;
  int height = 0;
  std::string first;  // picture that set the size
  std::stop_token stop;

  [[nodiscard]] SolverOptions solver_options() const {
    SolverOptions solver;
    solver.without_k3 = options.for_kalibr;
    solver.stop = stop;
    return solver;
  }
  [[nodiscard]] Result<void> check_found() const;
  [[nodiscard]] Result<void> check_markers() const;
  void leave_out_blurred();
  void leave_out_surplus();
  [[nodiscard]] std::vector<CalibrationView> used_views();
  void refine_corners(const CalibrationSolution& solution);
  [[nodiscard]] Result<CalibrationSolution> first_solution(
      const std::vector<CalibrationView>& views) const;
  [[nodiscard]] Result<void> check_solution(const CalibrationSolution& solution,
                                            const std::vector<CalibrationView>& views) const;
  void judge(CameraCalibration& result) const;
  void estimate_tone(CameraCalibration& result) const;
};

CameraCalibrator::CameraCalibrator(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
CameraCalibrator::CameraCalibrator(CameraCalibrator&&) noexcept = default;
CameraCalibrator& CameraCalibrator::operator=(CameraCalibrator&&) noexcept = default;
CameraCalibrator::~CameraCalibrator() = default;

Result<CameraCalibrator> CameraCalibrator::create(const Target& target,
                                                  const CalibrationOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->target = target;
  impl->options = options;
  Result<TargetDetector> detector = TargetDetector::create(target);
  if (!detector) return tl::unexpected(detector.error());
  impl->detector.emplace(std::move(*detector));
  return CameraCalibrator(std::move(impl));
}

Result<void> CameraCalibrator::add(const std::string& name, ImageView luma) {
  Impl& self = *impl_;
  if (self.first.empty()) {
    self.first = name;
    self.width = luma.width;
    self.height = luma.height;
  } else if (luma.width != self.width || luma.height != self.height) {
    return fail("{}: is {} x {} px, but {} is {} x {}; give pictures of one camera and one size",
                name, luma.width, luma.height, self.first, self.width, self.height);
  }
  CalibrationPicture picture;
  picture.name = name;
  picture.width = luma.width;
  picture.height = luma.height;
  picture.view = self.detector->detect(luma);
  picture.left_out = picture.view.problem;
  if (picture.left_out.empty()) {
    // Less than a finger's tremor apart: the same view once more weighs its errors double.
    const double nearest = 0.002 * self.width;
    for (const CalibrationPicture& other : self.pictures) {
      if (!other.left_out.empty() || view_distance(picture.view, other.view) > nearest) continue;
      picture.left_out = fmt::format("the same view as {}", other.name);
      break;
    }
  }
  if (picture.left_out.empty()) {
    picture.luma.reserve(static_cast<std::size_t>(luma.width) *
                         static_cast<std::size_t>(luma.height));
    for (int y = 0; y < luma.height; ++y)
      picture.luma.insert(picture.luma.end(), luma.row(y), luma.row(y) + luma.width);
  }
  self.pictures.push_back(std::move(picture));
  return {};
}

void CameraCalibrator::add_unreadable(const std::string& name, const std::string& why) {
  CalibrationPicture picture;
  picture.name = name;
  picture.left_out = why;
  impl_->pictures.push_back(std::move(picture));
}

Result<void> CameraCalibrator::Impl::check_found() const {
  if (pictures.empty()) return fail("there are no pictures");
  int usable = 0;
  int seen = 0;
  int wide = 0;
  std::map<std::string, int> reasons;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.left_out.empty()) ++usable;
    if (!picture.view.corners.empty()) ++seen;
    if (4 * picture.view.two_cell_tags > static_cast<int>(picture.view.corners.size())) ++wide;
    if (!picture.left_out.empty()) ++reasons[picture.left_out];
  }
  if (wide > usable) {
    return fail(
        "in {} of {} pictures the tags have a black border of two cells, as Kalibr prints them; "
        "libapriltag, which finds tags here and while tracking, reads borders of one cell: print a "
        "sheet with penumbra target",
        wide, pictures.size());
  }
  const auto most =
      std::max_element(reasons.begin(), reasons.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  const std::string because = most == reasons.end()
                                  ? ""
                                  : fmt::format(" ({} time{}: {})", most->second,
                                                most->second == 1 ? "" : "s", most->first);
  const auto is_unreadable = [](const CalibrationPicture& picture) { return picture.width == 0; };
  if (std::all_of(pictures.begin(), pictures.end(), is_unreadable)) {
    return fail("none of {} pictures can be read ({})", pictures.size(), pictures.front().left_out);
  }
  if (seen == 0) {
    return fail("the target ({}) is in none of {} pictures{}; is it the right target file?",
                target.description, pictures.size(), because);
  }
  if (usable < 3 && usable == static_cast<int>(pictures.size())) {
    return fail(
        "{} picture{} too few, a camera needs at least 3; take 20, with the target tilted in "
        "several directions and in every part of the image",
        usable, usable == 1 ? " is" : "s are");
  }
  if (usable < 3) {
    return fail(
        "only {} of {} pictures can be used{}, and a camera needs at least 3; take 20, with the "
        "target tilted in several directions and in every part of the image",
        usable, pictures.size(), because);
  }
  return {};
}

// Markers of another size than the file says are found all the same, and the lens is right, but who
// tracks the board by them next would be wrong.
Result<void> CameraCalibrator::Impl::check_markers() const {
  if (target.kind != TargetKind::charuco) return {};
  std::vector<double> shares;
  std::vector<double> edges_px;
  for (const CalibrationPicture& picture : pictures) {
    if (!picture.left_out.empty() || !picture.view.markers) continue;
    shares.push_back(picture.view.markers->share);
    edges_px.push_back(picture.view.markers->edge_px);
  }
  if (shares.empty()) return {};
  const double said = target.tags->tags().front().size_m / target.square_m;
  const double seen = median(shares);
  if (std::abs(seen / said - 1.0) <= kOtherSize || std::abs(median(edges_px)) <= kOtherEdge_px)
    return {};
  return fail(
      "the markers are {:.3f} of a square wide, but the target file says {:.3f}; measure tag_m and "
      "square_m again",
      seen, said);
}

void CameraCalibrator::Impl::leave_out_blurred() {
  std::vector<double> blurs;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.left_out.empty() && picture.view.blur_px > 0.0)
      blurs.push_back(picture.view.blur_px);
  }
  if (blurs.size() < 6) return;
  const double limit = std::max(2.0 * median(blurs), 1.5);
  auto left = static_cast<int>(blurs.size());
  for (CalibrationPicture& picture : pictures) {
    if (!picture.left_out.empty() || picture.view.blur_px <= limit || left <= 4) continue;
    picture.left_out =
        fmt::format("blurred: edges are {:.1f} px wide (sigma), {:.1f} in most views",
                    picture.view.blur_px, median(blurs));
    --left;
  }
}

// Of many views those that differ most: each next one is the furthest from all that are chosen.
void CameraCalibrator::Impl::leave_out_surplus() {
  std::vector<std::size_t> candidates;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (pictures[i].left_out.empty()) candidates.push_back(i);
  }
  if (candidates.size() <= static_cast<std::size_t>(options.most_views)) return;
  const double largest = 10.0 * width;
  std::vector<double> distance(candidates.size(), largest);
  std::vector<bool> chosen(candidates.size(), false);
  std::size_t next = 0;
  for (int n = 0; n < options.most_views; ++n) {
    chosen[next] = true;
    std::size_t furthest = next;
    double most = -1.0;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      distance[i] = std::min(distance[i], view_distance(pictures[candidates[i]].view,
                                                        pictures[candidates[next]].view));
      // A view of the whole target says more than one of a corner of it.
      const double worth =
          distance[i] * std::sqrt(static_cast<double>(pictures[candidates[i]].view.corners.size()));
      if (!chosen[i] && worth > most) {
        most = worth;
        furthest = i;
      }
    }
    next = furthest;
  }
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    if (chosen[i]) continue;
    pictures[candidates[i]].left_out = "much like others: enough views";
    pictures[candidates[i]].luma = {};
  }
}

std::vector<CalibrationView> CameraCalibrator::Impl::used_views() {
  std::vector<CalibrationView> views;
  for (CalibrationPicture& picture : pictures) {
    picture.solved = -1;
    if (!picture.left_out.empty()) continue;
    picture.solved = static_cast<int>(views.size());
    views.push_back({picture.name, picture.view.corners});
  }
  return views;
}

void CameraCalibrator::Impl::refine_corners(const CalibrationSolution& solution) {
  for (CalibrationPicture& picture : pictures) {
    if (stop.stop_requested()) return;
    if (picture.solved < 0) continue;
    picture.view =
        detector->refine(picture.picture(), picture.view, solution.camera,
                         solution.views[static_cast<std::size_t>(picture.solved)].T_board_camera);
  }
}

Result<CalibrationSolution> CameraCalibrator::Impl::first_solution(
    const std::vector<CalibrationView>& views) const {
  SolverOptions solver = solver_options();
  if (options.model) {
    solver.model = *options.model;
    return solve_intrinsics(width, height, target.points, views, solver);
  }
  Result<CalibrationSolution> best = solve_intrinsics(width, height, target.points, views, solver);
  if (best && !solver.without_k3 && fold_in_image(best->camera)) {
    solver.without_k3 = true;
    Result<CalibrationSolution> plainer =
        solve_intrinsics(width, height, target.points, views, solver);
    if (plainer) best = std::move(plainer);
  }
  solver.model = DistortionModel::fisheye;
  // A wide lens can't be described by a polynomial in tan(angle): where that fits badly, or not at
  // all, the other is tried before corners are refined with it.
  if (!best || best->noise_px > 0.5 || best->outliers * 20 > best->corners) {
    Result<CalibrationSolution> wide =
        solve_intrinsics(width, height, target.points, views, solver);
    if (wide && (!best || wide->noise_px < best->noise_px)) return wide;
  }
  return best;
}

Result<void> CameraCalibrator::Impl::check_solution(
    const CalibrationSolution& solution, const std::vector<CalibrationView>& views) const {
  const double tilt = tilt_spread(solution.views) * kDegrees;
  if (tilt < kLeastTilt_deg) {
    return fail(
        "all {} views show the target parallel to one plane (within {:.1f} degrees), so focal "
        "length and distance can't be told apart; tilt the target by 30 to 45 degrees in several "
        "directions",
        views.size(), tilt);
  }
  if (solution.noise_px > 3.0 || solution.outliers * 2 > solution.corners) {
    return fail(
        "no camera explains the corners: they are off by {:.1f} px, {} of {} outliers; does the "
        "target file say what is printed (tag size, spacing, squares), and is it one camera with "
        "one focus?",
        solution.rms_all_px, solution.outliers, solution.corners);
  }
  if (target.kind == TargetKind::tags) {
    // Squares of a size that the file does not say look as if all edges were moved.
    std::vector<double> shares;
    std::vector<double> shifts;
    for (std::size_t v = 0; v < views.size(); ++v) {
      std::vector<double> sizes;
      for (std::size_t c = 1; c < views[v].corners.size(); ++c) {
        if (views[v].corners[c].point / 4 == views[v].corners[c - 1].point / 4)
          sizes.push_back((views[v].corners[c].pixel - views[v].corners[c - 1].pixel).norm());
      }
      if (sizes.empty()) continue;
      shares.push_back(2.0 * solution.views[v].edge_shift_px / median(sizes));
      shifts.push_back(solution.views[v].edge_shift_px);
    }
    const double share = median(shares);
    if (std::abs(share) > kOtherSize && std::abs(median(shifts)) > kOtherEdge_px) {
      return fail(
          "the tags' black squares are {:.0f} % {} than the target file says, for the distances "
          "between them; measure tag size and spacing again",
          std::abs(share) * 100.0, share > 0.0 ? "larger" : "smaller");
    }
  }
  const double sigma_f = std::sqrt(solution.covariance(0, 0)) / solution.camera.parameters().fx;
  if (!(sigma_f < 0.2)) {
    return fail(
        "the views leave the focal length open by {:.0f} %; tilt the target by 30 to 45 degrees in "
        "several directions",
        sigma_f * 100.0);
  }
  return {};
}

void CameraCalibrator::Impl::judge(CameraCalibration& result) const {
  const CalibrationSolution& solution = result.solution;
  result.uncertainty = uncertainty_map(solution.camera, solution.covariance);
  result.table = table_volume_uncertainty(solution.camera, solution.covariance);
  result.tilt_spread_deg = tilt_spread(solution.views) * kDegrees;
  std::vector<double> blurs;
  std::array<std::array<int, 3>, 3> cells{};
  for (const CalibrationPicture& picture : result.pictures) {
    if (picture.solved < 0) continue;
    blurs.push_back(picture.view.blur_px);
    for (const TargetCorner& corner : picture.view.corners) {
      ++cells[third_of(corner.pixel.y(), height)][third_of(corner.pixel.x(), width)];
    }
  }
  result.blur_px = median(blurs);

  std::vector<std::string> empty;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      const int count = cells[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)];
      if (count * 100 < solution.corners) empty.push_back(cell_name(column, row));
    }
  }
  if (!empty.empty())
    result.advice.push_back(fmt::format("no views near the {}", fmt::join(empty, ", the ")));
  if (result.tilt_spread_deg < 40.0) {
    result.advice.push_back(fmt::format("tilt the target more: views differ by {:.0f} degrees only",
                                        result.tilt_spread_deg));
  }
  if (solution.views.size() < 10)
    result.advice.push_back(fmt::format("{} views are few: take 20", solution.views.size()));
  if (result.blur_px > 1.5)
    result.advice.push_back(fmt::format(
        "pictures are blurred ({:.1f} px): hold still, focus, more light", result.blur_px));
  std::string folds;
  for (const ModelTrial& trial : result.trials) {
    // Told where that lens might have been the better one.
    if (!trial.fold_px || !folds.empty() || !trial.held_out_px || !result.held_out_px ||
        *trial.held_out_px >= kWorthwhile * *result.held_out_px)
      continue;
    folds = fmt::format(
        "{} was not taken, since it folds near the {}, where too few corners were seen: take views "
        "there",
        lens_name(trial), cell_name(solution.camera, *trial.fold_px));
    result.advice.push_back(folds);
  }
  if (solution.shape != BoardShape::rigid)
    result.advice.emplace_back("the target is not flat or not true: glue it on glass or a board");

  const double error = result.held_out_px.value_or(solution.rms_px);
  const double sigma = result.uncertainty.largest_px;
  const bool finite = std::isfinite(sigma) && std::isfinite(error);
  result.grade = finite && sigma <= 0.5 && error <= 1.0   ? CalibrationGrade::good
                 : finite && sigma <= 2.0 && error <= 2.0 ? CalibrationGrade::usable
                                                          : CalibrationGrade::poor;
  std::string text = fmt::format(
      "{}: projection is known to {:.2f} px (1 sigma) at the worst place in the image, {:.2f} on "
      "average; {} are explained to {:.2f} px",
      to_string(result.grade), sigma, result.uncertainty.mean_px,
      result.held_out_px ? "views left out of the solution" : "the views, none of them left out,",
      error);
  if (result.grade != CalibrationGrade::good) {
    if (result.advice.empty()) {
      text += error > 1.0
                  ? "; the corners are off by too much: is the target flat, the focus fixed?"
                  : "; take more views";
    } else {
      text += fmt::format("; {}", fmt::join(result.advice, "; "));
    }
  } else if (!empty.empty()) {
    text += fmt::format("; {}", result.advice.front());
  } else if (!folds.empty()) {
    text += fmt::format("; {}", folds);
  }
  result.verdict = text;
}

// The tone curve from the tags' edges in the views, now that lens and poses are known. The lens
// does not hang on it: each view's edges may be displaced by a number of their own.
void CameraCalibrator::Impl::estimate_tone(CameraCalibration& result) const {
  if (!target.tags) {
    result.tone_unknown = "a chessboard's corners do not show it, tags do";
    return;
  }
  Result<ToneEstimator> estimator =
      ToneEstimator::create(result.solution.camera, target.tags->tags());
  if (!estimator) {
    result.tone_unknown = estimator.error().message;
    return;
  }
  for (const CalibrationPicture& picture : result.pictures) {
    if (stop.stop_requested()) return;
    if (picture.solved < 0) continue;
    const SolvedView& view = result.solution.views[static_cast<std::size_t>(picture.solved)];
    estimator->add(picture.picture(), view.T_board_camera);
  }
  const Result<ToneEstimate> tone = estimator->estimate();
  if (!tone) {
    result.tone_unknown = tone.error().message;
    return;
  }
  CameraParameters parameters = result.solution.camera.parameters();
  parameters.tone_curve = tone->exponent;
  Result<CameraModel> camera = CameraModel::make(parameters);
  if (!camera) {
    result.tone_unknown = camera.error().message;
    return;
  }
  result.solution.camera = std::move(*camera);
  result.tone = *tone;
}

Result<CameraCalibration> CameraCalibrator::finish(std::stop_token stop) {
  Impl& self = *impl_;
  self.stop = std::move(stop);
  if (const auto ok = self.check_found(); !ok) return tl::unexpected(ok.error());
  if (const auto ok = self.check_markers(); !ok) return tl::unexpected(ok.error());
  self.leave_out_blurred();
  self.leave_out_surplus();
  std::vector<CalibrationView> views = self.used_views();
  Result<CalibrationSolution> solution = self.first_solution(views);
  if (!solution) return tl::unexpected(solution.error());
  if (const auto ok = self.check_solution(*solution, views); !ok) return tl::unexpected(ok.error());
  // Corners once more where the solution puts them; twice, since the first solution is off by what
  // straight lines on a bent picture are off.
  for (int round = 0; round < 2; ++round) {
    self.refine_corners(*solution);
    views = self.used_views();
    SolverOptions solver = self.solver_options();
    solver.model = solution->camera.parameters().model;
    solver.without_k3 = solver.model == DistortionModel::plumb_bob &&
                        solution->camera.parameters().distortion[4] == 0.0;
    solution = solve_intrinsics(*solution, self.target.points, views, solver);
    if (!solution) return tl::unexpected(solution.error());
  }
  CameraCalibration result;
  Result<ChosenLens> chosen = choose_lens(*solution, self.target.points, views,
                                          {self.options.model, self.options.for_kalibr, self.stop},
                                          self.options.shape, result.trials);
  if (self.stop.stop_requested()) return fail("ended early");
  if (!chosen) return tl::unexpected(chosen.error());
  result.solution = std::move(chosen->solution);
  result.held_out_px = chosen->held_out_px;
  if (const auto ok = self.check_solution(result.solution, views); !ok)
    return tl::unexpected(ok.error());
  result.pictures = std::move(self.pictures);
  self.judge(result);
  self.estimate_tone(result);
  if (self.stop.stop_requested()) return fail("ended early");
  return result;
}

}  // namespace penumbra
