#include "calib/camera_calibration.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "calib/target/image_cells.hpp"
#include "core/propagate.hpp"
#include "tracking/detection/image_check.hpp"

namespace penumbra {
namespace {

constexpr double kDegrees = 180.0 / M_PI;
// Views whose boards are all within this of parallel do not tell focal length from distance.
constexpr double kLeastTilt_deg = 8.0;
// What the advice asks for.
constexpr double kGoodTilt_deg = 40.0;
constexpr std::size_t kGoodViews = 10;
// Of the image's diagonal: so near to a corner that was seen, a lens does not guess.
constexpr double kNear = 0.05;
// Tone curve, blur and ink make black squares look larger or smaller; by more than this share of
// their size, and this far at each edge, they are of another size than the target file says.
constexpr double kOtherSize = 0.04;
constexpr double kOtherEdge_px = 0.8;
// The same where views from near and from far tell the two apart, and how many standard errors it
// takes.
constexpr double kOtherSlope = 0.012;
constexpr double kSurelyOther = 5.0;

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

std::optional<double> other_size(std::span<const double> sizes_px,
                                 std::span<const double> shifts_px) {
  const std::size_t n = sizes_px.size();
  if (n < 6 || shifts_px.size() != n) return std::nullopt;
  double size = 0.0;
  double shift = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    size += sizes_px[v] / static_cast<double>(n);
    shift += shifts_px[v] / static_cast<double>(n);
  }
  double squared = 0.0;
  double across = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    squared += (sizes_px[v] - size) * (sizes_px[v] - size);
    across += (sizes_px[v] - size) * (shifts_px[v] - shift);
  }
  const double slope = across / squared;
  double left = 0.0;
  for (std::size_t v = 0; v < n; ++v) {
    const double off = shifts_px[v] - shift - slope * (sizes_px[v] - size);
    left += off * off;
  }
  const double error = std::sqrt(left / static_cast<double>(n - 2) / squared);
  // Both edges of a square are moved.
  if (!std::isfinite(slope) || std::abs(2.0 * slope) <= kOtherSlope ||
      std::abs(slope) <= kSurelyOther * error)
    return std::nullopt;
  return 2.0 * slope;
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

std::vector<std::optional<int>> told_left_out(std::span<const CalibrationPicture> pictures,
                                              int most) {
  std::map<LeftOut, int> count;
  for (const CalibrationPicture& picture : pictures) ++count[picture.reason];
  std::vector<std::optional<int>> told(pictures.size());
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const LeftOut reason = pictures[i].reason;
    if (reason == LeftOut::no || count[reason] == 0) continue;
    const bool many = count[reason] > most;
    told[i] = many ? count[reason] - 1 : 0;
    if (many) count[reason] = 0;
  }
  return told;
}

UncertaintyMap uncertainty_map(const CameraModel& camera, const Eigen::MatrixXd& covariance,
                               int columns, int rows) {
  UncertaintyMap map;
  map.columns = columns;
  map.rows = rows;
  double sum = 0.0;
  int count = 0;
  const ImageCells cells{columns, rows, camera.width(), camera.height()};
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    const auto here = projection_covariance(camera, covariance, cells.middle(cell));
    if (!here) {
      map.sigma_px.push_back(std::numeric_limits<double>::quiet_NaN());
      continue;
    }
    // A covariance that is no number says that nothing is known, not that all is.
    double sigma = std::numeric_limits<double>::infinity();
    if (here->allFinite()) {
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(*here);
      sigma = std::sqrt(std::max(eigen.eigenvalues()[1], 0.0));
    }
    map.sigma_px.push_back(sigma);
    map.largest_px = std::max(map.largest_px, sigma);
    sum += sigma;
    ++count;
  }
  map.mean_px = sum / count;
  // Nothing is known of where such a lens draws what it can't describe; nor of one that draws
  // nothing.
  if (count == 0 || (count < columns * rows && fold_in_image(camera)))
    map.mean_px = map.largest_px = std::numeric_limits<double>::infinity();
  return map;
}

void widen(UncertaintyMap& map, const CameraModel& camera, const CameraModel& other,
           std::span<const CalibrationPicture> pictures) {
  const double near = kNear * std::hypot(camera.width(), camera.height());
  const ImageCells cells{map.columns, map.rows, camera.width(), camera.height()};
  std::vector<double> differences(map.sigma_px.size(), 0.0);
  std::vector<bool> seen(map.sigma_px.size(), false);
  double largest = 0.0;  // where corners were seen
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    const Eigen::Vector2d pixel = cells.middle(cell);
    const auto direction = camera.unproject(pixel);
    const auto there = direction ? other.project_extended(*direction) : std::nullopt;
    if (there) differences[cell] = (*there - pixel).norm();
    for (const CalibrationPicture& picture : pictures) {
      if (picture.solved < 0 || seen[cell]) continue;
      seen[cell] = std::any_of(
          picture.view.corners.begin(), picture.view.corners.end(),
          [&](const TargetCorner& corner) { return (corner.pixel - pixel).norm() < near; });
    }
    if (seen[cell]) largest = std::max(largest, differences[cell]);
  }
  double sum = 0.0;
  int count = 0;
  for (std::size_t cell = 0; cell < cells.count(); ++cell) {
    double& sigma = map.sigma_px[cell];
    if (std::isnan(sigma)) continue;
    sigma = std::max(sigma, seen[cell] ? differences[cell] : largest);
    map.largest_px = std::max(map.largest_px, sigma);
    sum += sigma;
    ++count;
  }
  if (std::isfinite(map.mean_px) && count > 0) map.mean_px = sum / count;
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
  difference.skipped = 1.0 - static_cast<double>(count) / (kColumns * kRows);
  difference.mean_px =
      count > 0 ? difference.mean_px / count : std::numeric_limits<double>::quiet_NaN();
  return difference;
}

struct CameraCalibrator::Impl {
  Target target;
  CalibrationOptions options;
  std::optional<TargetDetector> detector;
  std::optional<ImageCheck> check;  // of targets with tags
  bool some_faulty = false;         // an image was mirrored or negative
  std::vector<CalibrationPicture> pictures;
  int width = 0;
  int height = 0;
  std::string first;   // picture that set the size
  int seen_in = 0;     // pictures with a corner of the target
  int wide_in = 0;     // ... whose tags mostly have a border of two cells
  int candidates = 0;  // pictures that are not left out
  // Sizes of chessboards in some images, the first of them without the target.
  std::vector<std::array<int, 2>> boards_seen;
  int searched_for_boards = 0;
  std::stop_token stop;

  [[nodiscard]] SolverOptions solver_options() const {
    SolverOptions solver;
    solver.without_k3 = options.for_kalibr;
    solver.stop = stop;
    return solver;
  }
  [[nodiscard]] std::string problem_of(const TargetView& view, ImageView luma);
  void look_for_board(ImageView luma, int most_images);
  void look_for_board_in_views();
  [[nodiscard]] std::optional<std::string> other_board_in_words() const;
  [[nodiscard]] Result<void> check_found() const;
  [[nodiscard]] Result<void> check_markers() const;
  void leave_out_blurred();
  void leave_out_surplus();
  void leave_out(CalibrationPicture& picture, LeftOut reason, std::string words);
  [[nodiscard]] int most_candidates() const {
    return options.most_candidates > 0 ? std::max(options.most_candidates, options.most_views)
                                       : 2 * options.most_views;
  }
  [[nodiscard]] std::vector<CalibrationView> used_views();
  void refine_corners(const CalibrationSolution& solution);
  [[nodiscard]] Result<void> check_solution(const CalibrationSolution& solution,
                                            const std::vector<CalibrationView>& views) const;
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
  PENUMBRA_TRY(TargetDetector detector, TargetDetector::create(target));
  impl->detector.emplace(std::move(detector));
  if (target.tags) {
    PENUMBRA_TRY(ImageCheck check, ImageCheck::create(*target.tags));
    impl->check.emplace(std::move(check));
  }
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
  ++self.candidates;
  if (!picture.view.corners.empty()) ++self.seen_in;
  if (4 * picture.view.two_cell_tags > static_cast<int>(picture.view.corners.size()))
    ++self.wide_in;
  if (!picture.view.problem.empty()) {
    constexpr int kMostImages = 8;
    self.look_for_board(luma, kMostImages);
    self.leave_out(picture, LeftOut::not_seen, self.problem_of(picture.view, luma));
  }
  if (picture.left_out.empty()) {
    // Less than a finger's tremor apart: the same view once more weighs its errors double.
    const double nearest = 0.002 * self.width;
    for (const CalibrationPicture& other : self.pictures) {
      if (!other.left_out.empty() ||
          corner_distance(picture.view.corners, other.view.corners) > nearest)
        continue;
      self.leave_out(picture, LeftOut::seen_before, fmt::format("the same view as {}", other.name));
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
  // A recording of minutes does not fit into memory, and would be compared with all of itself.
  if (self.candidates > self.most_candidates()) {
    self.leave_out_blurred();
    self.leave_out_surplus();
    for (CalibrationPicture& other : self.pictures) {
      if (other.reason != LeftOut::no) other.luma = std::vector<std::uint8_t>();
    }
  }
  return {};
}

// Why the target is not seen in an image. A lens found from mirrored images would be mirrored too.
std::string CameraCalibrator::Impl::problem_of(const TargetView& view, ImageView luma) {
  if (!check || !view.corners.empty() || view.two_cell_tags > 0) return view.problem;
  // Once one is faulty, others are likely to be, and each is checked.
  const auto fault = some_faulty ? check->look(luma) : check->nothing_found(luma);
  if (!fault) return view.problem;
  some_faulty = true;
  return std::string(advice(*fault));
}

// Looks for a chessboard of any size, unless `most_images` were searched: it takes a tenth of a
// second.
void CameraCalibrator::Impl::look_for_board(ImageView luma, int most_images) {
  if (target.kind != TargetKind::chessboard || searched_for_boards >= most_images) return;
  ++searched_for_boards;
  if (const auto size = chessboard_size(luma)) boards_seen.push_back(*size);
}

// A part of a larger board is found as the target in some images, and not in others.
void CameraCalibrator::Impl::look_for_board_in_views() {
  if (searched_for_boards == 0) return;
  constexpr int kMostImages = 12;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.left_out.empty()) look_for_board(picture.picture(), kMostImages);
  }
}

// Names the size that most of these images show, where it is not the target file's. A board that is
// seen in part is smaller; a single image may be read wrongly.
std::optional<std::string> CameraCalibrator::Impl::other_board_in_words() const {
  constexpr int kLeastImages = 3;
  std::map<std::array<int, 2>, int> counts;
  for (const std::array<int, 2>& size : boards_seen) ++counts[size];
  const auto most = std::ranges::max_element(counts, {}, [](const auto& c) { return c.second; });
  const std::array target_size = {std::max(target.columns, target.rows),
                                  std::min(target.columns, target.rows)};
  if (most == counts.end() || most->second < kLeastImages || most->first == target_size)
    return std::nullopt;
  const bool larger = most->first[0] > target_size[0] || most->first[1] > target_size[1];
  if (!larger && 2 * most->second < static_cast<int>(boards_seen.size())) return std::nullopt;
  return fmt::format(
      "{} images show a chessboard of {} x {} inner corners, but the target file says {} x {}: "
      "correct the target file, or show the whole board",
      most->second, most->first[0], most->first[1], target.columns, target.rows);
}

int CameraCalibrator::held() const {
  const auto held = [](const CalibrationPicture& picture) { return picture.luma.capacity() > 0; };
  return static_cast<int>(std::count_if(impl_->pictures.begin(), impl_->pictures.end(), held));
}

void CameraCalibrator::Impl::leave_out(CalibrationPicture& picture, LeftOut reason,
                                       std::string words) {
  picture.reason = reason;
  picture.left_out = std::move(words);
  --candidates;
  if (reason != LeftOut::seen_before && reason != LeftOut::surplus) return;
  // `= {}` would keep the memory.
  picture.view.corners = std::vector<TargetCorner>();
  picture.luma = std::vector<std::uint8_t>();
}

void CameraCalibrator::add_unreadable(const std::string& name, const std::string& why) {
  CalibrationPicture picture;
  picture.name = name;
  picture.reason = LeftOut::unreadable;
  picture.left_out = why;
  impl_->pictures.push_back(std::move(picture));
}

Result<void> CameraCalibrator::Impl::check_found() const {
  if (pictures.empty()) return fail("there are no pictures");
  std::map<std::string, int> reasons;
  for (const CalibrationPicture& picture : pictures) {
    if (picture.reason == LeftOut::seen_before) {
      ++reasons["the same view as another"];
    } else if (picture.reason != LeftOut::no) {
      ++reasons[picture.left_out];
    }
  }
  const int usable = candidates;
  if (wide_in > usable) {
    return fail(
        "in {} of {} pictures the tags have a black border of two cells, as Kalibr prints them; "
        "libapriltag, which finds tags here and while tracking, reads borders of one cell: print a "
        "sheet with penumbra target",
        wide_in, pictures.size());
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
  if (usable < 3) {
    if (const auto other_board = other_board_in_words()) return fail("{}", *other_board);
  }
  if (seen_in == 0) {
    if (some_faulty) {
      return fail("the target ({}) is in none of {} images as they are{}", target.description,
                  pictures.size(), because);
    }
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
    // A board with other numbers of corners looks cut off or hidden.
    const std::string count =
        target.kind == TargetKind::chessboard
            ? fmt::format("; has it {} x {} inner corners? If so,", target.columns, target.rows)
            : ";";
    return fail(
        "only {} of {} pictures can be used{}, and a camera needs at least 3{} take 20, with the "
        "target tilted in several directions and in every part of the image",
        usable, pictures.size(), because, count);
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
      "square_m again, and count columns and rows",
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
  for (CalibrationPicture& picture : pictures) {
    if (!picture.left_out.empty() || picture.view.blur_px <= limit || candidates <= 4) continue;
    leave_out(picture, LeftOut::blurred,
              fmt::format("blurred: edges are {:.1f} px wide (sigma), {:.1f} in most views",
                          picture.view.blur_px, median(blurs)));
  }
}

// Of many views those that differ most: each next one is the furthest from all that are chosen.
void CameraCalibrator::Impl::leave_out_surplus() {
  if (candidates <= options.most_views) return;
  std::vector<std::size_t> at;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    if (pictures[i].left_out.empty()) at.push_back(i);
  }
  const double largest = 10.0 * width;
  std::vector<double> distance(at.size(), largest);
  std::vector<bool> chosen(at.size(), false);
  std::size_t next = 0;
  for (int n = 0; n < options.most_views; ++n) {
    chosen[next] = true;
    std::size_t furthest = next;
    double most = -1.0;
    for (std::size_t i = 0; i < at.size(); ++i) {
      distance[i] = std::min(distance[i], corner_distance(pictures[at[i]].view.corners,
                                                          pictures[at[next]].view.corners));
      // A view of the whole target says more than one of a corner of it.
      const double worth =
          distance[i] * std::sqrt(static_cast<double>(pictures[at[i]].view.corners.size()));
      if (!chosen[i] && worth > most) {
        most = worth;
        furthest = i;
      }
    }
    next = furthest;
  }
  for (std::size_t i = 0; i < at.size(); ++i) {
    if (!chosen[i]) leave_out(pictures[at[i]], LeftOut::surplus, "much like others: enough views");
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
    if (const auto other_board = other_board_in_words()) return fail("{}", *other_board);
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
    std::vector<double> tag_sizes;
    for (std::size_t v = 0; v < views.size(); ++v) {
      std::vector<double> sizes;
      for (std::size_t c = 1; c < views[v].corners.size(); ++c) {
        if (views[v].corners[c].point / 4 == views[v].corners[c - 1].point / 4)
          sizes.push_back((views[v].corners[c].pixel - views[v].corners[c - 1].pixel).norm());
      }
      if (sizes.empty()) continue;
      shares.push_back(2.0 * solution.views[v].edge_shift_px / median(sizes));
      shifts.push_back(solution.views[v].edge_shift_px);
      tag_sizes.push_back(median(sizes));
    }
    std::optional<double> share = other_size(tag_sizes, shifts);
    if (!share && std::abs(median(shares)) > kOtherSize && std::abs(median(shifts)) > kOtherEdge_px)
      share = median(shares);
    if (share) {
      return fail(
          "the tags' black squares are {:.1f} % {} than the target file says, for the distances "
          "between them; measure tag size and spacing again",
          // A share of what is seen; of what is said it is another.
          std::abs(*share / (1.0 - *share)) * 100.0, *share > 0.0 ? "larger" : "smaller");
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

namespace {

// The name of the one of `cells` where the projection is known least: "the top left".
std::string worst_place(const UncertaintyMap& map, const ImageCells& cells) {
  const ImageCells of_map{map.columns, map.rows, cells.width, cells.height};
  std::size_t worst = 0;
  double most = -1.0;
  for (std::size_t cell = 0; cell < map.sigma_px.size(); ++cell) {
    if (!(map.sigma_px[cell] > most)) continue;  // nor where the lens reaches no pixel: NaN
    worst = cell;
    most = map.sigma_px[cell];
  }
  return "the " + cells.name(cells.at(of_map.middle(worst)));
}

}  // namespace

void judge(CameraCalibration& result) {
  const CalibrationSolution& solution = result.solution;
  const int width = solution.camera.width();
  const int height = solution.camera.height();
  result.uncertainty = uncertainty_map(solution.camera, solution.covariance);
  // What the views can't tell apart is not known, whichever of them was taken.
  for (const ModelTrial& trial : result.trials) {
    if (trial.rival && !trial.fold_px)
      widen(result.uncertainty, solution.camera, trial.camera, result.pictures);
  }
  result.table = table_volume_uncertainty(solution.camera, solution.covariance);
  result.tilt_spread_deg = tilt_spread(solution.views) * kDegrees;
  std::vector<double> blurs;
  const ImageCells cells{3, 3, width, height};
  std::vector<int> seen(cells.count(), 0);
  for (const CalibrationPicture& picture : result.pictures) {
    if (picture.solved < 0) continue;
    blurs.push_back(picture.view.blur_px);
    for (const TargetCorner& corner : picture.view.corners) ++seen[cells.at(corner.pixel)];
  }
  result.blur_px = median(blurs);

  std::vector<std::string> empty;
  std::vector<std::string> nearly_empty;
  for (std::size_t cell = 0; cell < seen.size(); ++cell) {
    if (seen[cell] * 100 < solution.corners)
      (seen[cell] == 0 ? empty : nearly_empty).push_back(cells.name(cell));
  }
  if (!empty.empty())
    result.advice.push_back(fmt::format("no views near the {}", fmt::join(empty, ", the ")));
  if (!nearly_empty.empty())
    result.advice.push_back(
        fmt::format("few views near the {}", fmt::join(nearly_empty, ", the ")));
  const bool places = !result.advice.empty();
  if (result.other_board) result.advice.insert(result.advice.begin(), *result.other_board);
  if (result.tilt_spread_deg < kGoodTilt_deg) {
    // Rounded down: 39.9 is less than 40.
    result.advice.push_back(
        fmt::format("tilt the target by 30 to 45 degrees to every side: no two views differ by "
                    "more than {:.0f} "
                    "degrees, {:.0f} are good",
                    std::floor(result.tilt_spread_deg), kGoodTilt_deg));
  }
  if (solution.views.size() < kGoodViews) {
    result.advice.push_back(fmt::format("{} views are few: take {} or more, better 20",
                                        solution.views.size(), kGoodViews));
  }
  if (result.blur_px > 1.5)
    result.advice.push_back(fmt::format(
        "images are blurred ({:.1f} px): hold still, focus, more light", result.blur_px));
  // A lens that explains more, but not all of the image: then the one that was taken is wrong
  // somewhere, however sure it is of itself.
  std::string non_monotonic;
  for (const ModelTrial& trial : result.trials) {
    // Told where that lens might have been the better one.
    if (!trial.fold_px || !non_monotonic.empty() || !trial.held_out_px || !result.held_out_px ||
        *trial.held_out_px >= kWorthwhile * *result.held_out_px)
      continue;
    non_monotonic = fmt::format(
        "{} explains the views better ({:.3f} px), but was not taken, since it is non-monotonic "
        "near the {}, "
        "where too few corners were seen: take views there",
        lens_name(trial), *trial.held_out_px, cells.name(cells.at(*trial.fold_px)));
    result.advice.push_back(non_monotonic);
  }
  if (solution.shape != BoardShape::rigid)
    result.advice.emplace_back("the target is not flat or not true: glue it on glass or a board");

  const double error = result.held_out_px.value_or(solution.rms_px);
  const double sigma = result.uncertainty.largest_px;
  const bool finite = std::isfinite(sigma) && std::isfinite(error) && non_monotonic.empty();
  result.grade = finite && sigma <= kGoodProjection_px && error <= 1.0 ? CalibrationGrade::good
                 : finite && sigma <= 2.0 && error <= 2.0              ? CalibrationGrade::usable
                                                                       : CalibrationGrade::poor;
  const std::string worst = std::isfinite(sigma) ? worst_place(result.uncertainty, cells) : "";
  std::string text = fmt::format(
      "{}: projection is known to {:.2f} px (1 sigma) at the worst place in the image{}, {:.2f} "
      "on average; {} are explained to {:.2f} px",
      to_string(result.grade), sigma, worst.empty() ? "" : fmt::format(" ({})", worst),
      result.uncertainty.mean_px,
      result.held_out_px ? "views left out of the solution" : "the views, none of them left out,",
      error);
  if (result.grade != CalibrationGrade::good) {
    if (error > 1.0)
      result.advice.emplace_back(
          "the corners are off by too much: is the target flat, the focus fixed?");
    // Where nothing else stands out, what helps most.
    if (!(sigma <= kGoodProjection_px) && !places && result.tilt_spread_deg >= kGoodTilt_deg) {
      result.advice.push_back(
          fmt::format("take more views: from near, so that the target fills the picture, tilted to "
                      "every side{}",
                      worst.empty() ? std::string() : ", and near " + worst));
    }
    if (!result.advice.empty()) text += fmt::format("; {}", fmt::join(result.advice, "; "));
  } else if (places || result.other_board) {
    text += fmt::format("; {}", result.advice.front());
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

Result<CameraCalibration> CameraCalibrator::finish(std::stop_token stop, const TellStep& tell) {
  Impl& self = *impl_;
  self.stop = std::move(stop);
  PENUMBRA_TRY_VOID(self.check_found());
  PENUMBRA_TRY_VOID(self.check_markers());
  self.leave_out_blurred();
  self.leave_out_surplus();
  std::vector<CalibrationView> views = self.used_views();
  // Steps before lenses are tried, and after.
  constexpr int kBefore = 3;
  constexpr int kAfter = 1;
  self.look_for_board_in_views();
  LensChoice choice = {self.options.model, self.options.for_kalibr, self.stop, {}};
  int last = kBefore + most_steps(choice, self.options.shape.has_value()) + kAfter;
  const auto tell_step = [&](const char* what, int step) {
    if (tell) tell({what, step, last});
  };
  choice.tell = [&](const SolvingStep& trial) {
    last = kBefore + trial.most + kAfter;
    if (tell) tell({trial.what, kBefore + trial.step, last});
  };
  tell_step("a first lens", 1);
  Result<CalibrationSolution> solution =
      first_solution(self.width, self.height, self.target.points, views, choice);
  if (!solution) return tl::unexpected(solution.error());
  PENUMBRA_TRY_VOID(self.check_solution(*solution, views));
  // Corners once more where the solution puts them; twice, since the first solution is off by what
  // straight lines on a bent picture are off.
  for (int round = 0; round < 2; ++round) {
    tell_step("corners, by the lens that is known", 2 + round);
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
  Result<ChosenLens> chosen =
      choose_lens(*solution, self.target.points, views, choice, self.options.shape, result.trials);
  if (self.stop.stop_requested()) return fail("ended early");
  if (!chosen) return tl::unexpected(chosen.error());
  result.solution = std::move(chosen->solution);
  result.held_out_px = chosen->held_out_px;
  PENUMBRA_TRY_VOID(self.check_solution(result.solution, views));
  result.pictures = std::move(self.pictures);
  result.other_board = self.other_board_in_words();
  judge(result);
  tell_step("tone curve", last);
  self.estimate_tone(result);
  if (self.stop.stop_requested()) return fail("ended early");
  return result;
}

}  // namespace penumbra
