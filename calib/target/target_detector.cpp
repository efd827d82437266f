#include "calib/target/target_detector.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/target/target_edges.hpp"
#include "core/propagate.hpp"
#include "core/statistics.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

constexpr int kMinCorners = 8;
constexpr double kMinContrast = 20.0;  // [grey levels]

// Do not write to the returned matrix: OpenCV has no read-only view.
cv::Mat as_mat(ImageView luma) {
  return {luma.height, luma.width, CV_8UC1, const_cast<std::uint8_t*>(luma.data),
          static_cast<std::size_t>(luma.stride)};
}

cv::Point2f as_point(const Eigen::Vector2d& p) {
  return {static_cast<float>(p.x()), static_cast<float>(p.y())};
}

void refine_saddles(ImageView luma, std::vector<cv::Point2f>& corners, int half_window) {
  cv::cornerSubPix(as_mat(luma), corners, {half_window, half_window}, {-1, -1},
                   {cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 60, 1e-4});
}

// Returns true if four sectors around the point alternate between black and white.
bool is_saddle(ImageView luma, const Eigen::Vector2d& centre, double radius_px) {
  constexpr int kSamples = 24;
  std::array<double, kSamples> ring{};
  double lowest = 255.0;
  double highest = 0.0;
  for (int i = 0; i < kSamples; ++i) {
    const double angle = 2.0 * M_PI * i / kSamples;
    const auto value =
        sample_luma(luma, centre + radius_px * Eigen::Vector2d(std::cos(angle), std::sin(angle)));
    if (!value) return false;
    ring[static_cast<std::size_t>(i)] = *value;
    lowest = std::min(lowest, *value);
    highest = std::max(highest, *value);
  }
  if (highest - lowest < kMinContrast) return false;
  const double middle = 0.5 * (lowest + highest);
  int changes = 0;
  for (std::size_t i = 0; i < kSamples; ++i) {
    if ((ring[i] > middle) != (ring[(i + 1) % kSamples] > middle)) ++changes;
  }
  return changes == 4;
}

// Returns the saddle point nearest to `start` within `largest_step_px`, or nullopt.
std::optional<Eigen::Vector2d> find_saddle(ImageView luma, const Eigen::Vector2d& start,
                                           double half_window_px, double largest_step_px) {
  const int half = std::clamp(static_cast<int>(std::lround(half_window_px)), 2, 15);
  if (!is_inside(luma, start, half + 2.0)) return std::nullopt;
  std::vector<cv::Point2f> points = {as_point(start)};
  refine_saddles(luma, points, half);
  const Eigen::Vector2d found(points[0].x, points[0].y);
  if (!found.allFinite() || (found - start).norm() > largest_step_px) return std::nullopt;
  if (!is_saddle(luma, found, std::max(2.0, 0.7 * half))) return std::nullopt;
  return found;
}

// Returns sigma of the blur across the middle of an edge from a to b [px], from the height and
// maximum slope of the blurred step; nullopt if there is no edge.
std::optional<double> blur_across(ImageView luma, const Eigen::Vector2d& a,
                                  const Eigen::Vector2d& b, double reach_px) {
  const Eigen::Vector2d along = b - a;
  const double length = along.norm();
  if (length < 6.0 || reach_px < 1.5) return std::nullopt;
  const Eigen::Vector2d normal(-along.y() / length, along.x() / length);
  constexpr double kStep = 0.25;  // [px]
  const int steps = static_cast<int>(reach_px / kStep);
  std::vector<double> profile;
  for (int i = -steps; i <= steps; ++i) {
    double sum = 0.0;
    for (const double t : {0.42, 0.46, 0.5, 0.54, 0.58}) {  // averaged along the edge
      const auto value = sample_luma(luma, a + t * along + i * kStep * normal);
      if (!value) return std::nullopt;
      sum += *value;
    }
    profile.push_back(sum / 5.0);
  }
  const auto [lowest, highest] = std::minmax_element(profile.begin(), profile.end());
  double slope = 0.0;
  for (std::size_t i = 4; i < profile.size(); ++i)
    slope = std::max(slope, std::abs(profile[i] - profile[i - 4]) / (4.0 * kStep));
  if (*highest - *lowest < kMinContrast || slope <= 0.0) return std::nullopt;
  return (*highest - *lowest) / (slope * std::sqrt(2.0 * M_PI));
}

void set_spreads(std::array<TargetCorner, 4>& corners) {
  const auto spreads =
      edge_spreads({corners[0].pixel, corners[1].pixel, corners[2].pixel, corners[3].pixel});
  for (std::size_t i = 0; i < 4; ++i) corners[i].spread = spreads[i];
}

}  // namespace

std::vector<const TargetCorner*> corners_by_point(const Target& target,
                                                  std::span<const TargetCorner> corners) {
  std::vector<const TargetCorner*> by_point(target.points.size(), nullptr);
  for (const TargetCorner& corner : corners)
    by_point[static_cast<std::size_t>(corner.point)] = &corner;
  return by_point;
}

double corner_distance(std::span<const TargetCorner> a, std::span<const TargetCorner> b) {
  double sum = 0.0;
  std::size_t count = 0;
  auto j = b.begin();
  for (const TargetCorner& corner : a) {
    while (j != b.end() && j->point < corner.point) ++j;
    if (j == b.end()) break;
    if (j->point != corner.point) continue;
    sum += (j->pixel - corner.pixel).squaredNorm();
    ++count;
  }
  if (count == 0 || 2 * count < std::min(a.size(), b.size()))
    return std::numeric_limits<double>::infinity();
  return std::sqrt(sum / static_cast<double>(count));
}

std::optional<std::array<int, 2>> chessboard_size(ImageView luma) {
  constexpr int kMinSize = 3;
  std::vector<cv::Point2f> corners;
  cv::Mat found;  // one element per corner
  try {
    if (!cv::findChessboardCornersSB(as_mat(luma), {kMinSize, kMinSize}, corners,
                                     cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_LARGER, found)) {
      return std::nullopt;
    }
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  return std::array{std::max(found.cols, found.rows), std::min(found.cols, found.rows)};
}

std::map<std::size_t, TagDetection> TargetDetector::seen_tags(ImageView luma, TagDetector& detector,
                                                              TargetView* view,
                                                              int* repeated) const {
  const std::vector<MappedTag>& mapped = target_.tags->tags();
  std::map<std::size_t, int> times;
  std::map<std::size_t, TagDetection> seen;
  for (const TagDetection& detection : detector.detect(luma)) {
    const MappedTag* tag = target_.tags->find(detection.family, detection.id);
    if (tag == nullptr && view != nullptr)
      view->tags.others.emplace_back(detection.family, detection.id);
    if (tag == nullptr) continue;
    const auto index = static_cast<std::size_t>(tag - mapped.data());
    ++times[index];
    seen[index] = detection;
  }
  for (const auto& [tag, count] : times) {
    if (view != nullptr) view->tags.seen.push_back(tag);
    if (count == 1) continue;
    seen.erase(tag);
    if (repeated != nullptr) ++*repeated;
  }
  return seen;
}

// Returns true if there are black squares between the tags, as Kalibr prints them.
bool TargetDetector::has_squares(ImageView luma, const TargetView& view) const {
  if (!target_.may_have_squares) return false;
  int black = 0;
  int white = 0;
  for (std::size_t i = 0; i + 3 < view.corners.size(); ++i) {
    if (view.corners[i].point % 4 != 0 || view.corners[i + 3].point != view.corners[i].point + 3)
      continue;
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    for (std::size_t k = 0; k < 4; ++k) centre += 0.25 * view.corners[i + k].pixel;
    for (std::size_t k = 0; k < 4; ++k) {
      const Eigen::Vector2d& corner = view.corners[i + k].pixel;
      const Eigen::Vector2d side =
          0.5 * (corner + view.corners[i + (k + 1) % 4].pixel) - centre;  // to the side's midpoint
      const auto at_square = sample_luma(luma, centre + (1.0 + spacing_) * (corner - centre));
      const auto at_border = sample_luma(luma, centre + (1.0 - 1.0 / cells_) * side);
      const auto at_paper = sample_luma(luma, centre + (1.0 + spacing_) * side);
      if (!at_square || !at_border || !at_paper || *at_paper - *at_border < kMinContrast) continue;
      ++(*at_square < 0.5 * (*at_paper + *at_border) ? black : white);
    }
  }
  return black > white;
}

double TargetDetector::blur_of(ImageView luma, const TargetView& view) const {
  const std::vector<const TargetCorner*> at = corners_by_point(target_, view.corners);
  std::vector<double> blurs;
  for (const auto& [a, b] : target_.edges) {
    const TargetCorner* p = at[static_cast<std::size_t>(a)];
    const TargetCorner* q = at[static_cast<std::size_t>(b)];
    if (p == nullptr || q == nullptr) continue;
    const double length = (p->pixel - q->pixel).norm();
    const double reach = target_.kind == TargetKind::tags      ? 0.9 * length / cells_
                         : target_.kind == TargetKind::charuco ? 0.1 * length
                                                               : 0.4 * length;
    if (const auto blur = blur_across(luma, p->pixel, q->pixel, std::min(reach, 10.0)))
      blurs.push_back(*blur);
  }
  if (blurs.size() < 4) return 0.0;
  // Motion blurs only edges across it; the upper quartile is the median of the blurred half.
  return order_statistic(std::move(blurs), 0.75);
}

TargetView TargetDetector::detect_tags(ImageView luma) {
  TargetView view;
  int repeated = 0;
  const auto seen = seen_tags(luma, *tags_, &view, &repeated);
  int cut_off = 0;
  for (const auto& [index, detection] : seen) {
    std::array<TargetCorner, 4> corners;
    bool inside = true;
    for (std::size_t i = 0; i < 4; ++i) {
      corners[i].point = static_cast<int>(4 * index + i);
      corners[i].pixel = detection.corners_px[i];
      inside = inside && is_inside(luma, corners[i].pixel, kCornerBorder);
    }
    if (!inside) {
      ++cut_off;
      continue;
    }
    set_spreads(corners);
    view.corners.insert(view.corners.end(), corners.begin(), corners.end());
  }
  if (two_cell_tags_ && 4 * seen.size() < target_.tags->tags().size()) {
    view.two_cell_tags = static_cast<int>(seen_tags(luma, *two_cell_tags_).size());
  }
  const std::size_t needed = std::min<std::size_t>(kMinCorners, target_.points.size());
  if (view.corners.size() < needed) {
    view.problem = seen.empty() && !view.tags.others.empty()
                       ? "only tags that are not in the target file are seen"
                   : seen.empty() ? "no tag of the target is seen"
                   : repeated > 0
                       ? "the target's tags are seen twice"
                       : fmt::format("only {} of {} tags are seen whole{}", view.corners.size() / 4,
                                     target_.tags->tags().size(), cut_off > 0 ? ": cut off" : "");
    if (view.two_cell_tags > static_cast<int>(seen.size())) {
      view.problem = fmt::format("{} tags have a black border of two cells", view.two_cell_tags);
    }
  }
  if (has_squares(luma, view)) {
    view.black_squares = true;
    // A point where a corner of a square touches a corner of a tag is a saddle point.
    std::vector<TargetCorner> saddles;
    for (std::size_t i = 0; i < view.corners.size(); ++i) {
      const std::size_t first = i - i % 4;
      const double size =
          (view.corners[first].pixel - view.corners[first + 2].pixel).norm() / std::sqrt(2.0);
      const auto found =
          find_saddle(luma, view.corners[i].pixel, 0.4 * spacing_ * size, 0.5 * spacing_ * size);
      if (!found) continue;
      saddles.push_back({view.corners[i].point, *found});
    }
    view.corners = std::move(saddles);
    if (view.corners.size() < needed) view.problem = "too few corners between tags and squares";
  }
  return view;
}

TargetView TargetDetector::detect_chessboard(ImageView luma) const {
  TargetView view;
  const cv::Mat image = as_mat(luma);
  const cv::Size size(target_.columns, target_.rows);
  std::vector<cv::Point2f> found;
  bool all = false;
  try {
    all = cv::findChessboardCorners(
        image, size, found,
        cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_FAST_CHECK);
    if (!all) all = cv::findChessboardCornersSB(image, size, found, cv::CALIB_CB_NORMALIZE_IMAGE);
  } catch (const cv::Exception&) {
    all = false;
  }
  if (!all || found.size() != target_.points.size()) {
    view.problem = "the chessboard is not seen whole: not there, cut off, hidden or blurred";
    return view;
  }
  // The board is never visible from behind. A mirrored order of corners is reversed in each row.
  const auto at = [&](int i, int j) {
    const cv::Point2f& p = found[static_cast<std::size_t>(j * target_.columns + i)];
    return Eigen::Vector2d(p.x, p.y);
  };
  const Eigen::Vector2d right = at(target_.columns - 1, 0) - at(0, 0);
  const Eigen::Vector2d down = at(0, target_.rows - 1) - at(0, 0);
  const bool mirrored = right.x() * down.y() - right.y() * down.x() < 0.0;
  // The window must not contain a neighbouring corner.
  double nearest = 1e9;
  for (const auto& [a, b] : target_.edges) {
    nearest = std::min(
        nearest, cv::norm(found[static_cast<std::size_t>(a)] - found[static_cast<std::size_t>(b)]));
  }
  const int half = std::clamp(static_cast<int>(0.35 * nearest), 2, 11);
  std::vector<cv::Point2f> refined = found;
  refine_saddles(luma, refined, half);
  for (int j = 0; j < target_.rows; ++j) {
    for (int i = 0; i < target_.columns; ++i) {
      const int source = j * target_.columns + (mirrored ? target_.columns - 1 - i : i);
      const cv::Point2f p = refined[static_cast<std::size_t>(source)];
      const cv::Point2f before = found[static_cast<std::size_t>(source)];
      const bool kept = cv::norm(p - before) <= half && std::isfinite(p.x) && std::isfinite(p.y);
      const cv::Point2f& used = kept ? p : before;
      view.corners.push_back({j * target_.columns + i, Eigen::Vector2d(used.x, used.y)});
    }
  }
  return view;
}

// Measures the markers' size by the homography from a square to the unit square. A square is so
// small that the distortion is negligible.
std::optional<TargetView::MarkerShare> TargetDetector::marker_share(
    const TargetView& view, const std::map<std::size_t, TagDetection>& seen) const {
  std::vector<double> shares;
  std::vector<double> squares_px;
  for (const auto& [index, detection] : seen) {
    const MappedTag& tag = target_.tags->tags()[index];
    std::vector<cv::Point2f> from;
    std::vector<cv::Point2f> to;
    for (const TargetCorner& corner : view.corners) {
      const Eigen::Vector3d offset =
          (target_.points[static_cast<std::size_t>(corner.point)] - tag.T_table_tag.translation()) /
          target_.square_m;
      if (std::max(std::abs(offset.x()), std::abs(offset.y())) > 0.51) continue;
      from.push_back(as_point(corner.pixel));
      to.push_back(as_point(offset.head<2>()));
    }
    if (from.size() != 4) continue;  // a square at the board's edge, or partly visible
    const cv::Mat h = cv::getPerspectiveTransform(from, to);
    std::vector<cv::Point2f> corners;
    for (const Eigen::Vector2d& p : detection.corners_px) corners.push_back(as_point(p));
    cv::perspectiveTransform(corners, corners, h);
    double perimeter = 0.0;
    double perimeter_px = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
      perimeter += cv::norm(corners[i] - corners[(i + 1) % 4]);
      perimeter_px += (detection.corners_px[i] - detection.corners_px[(i + 1) % 4]).norm();
    }
    if (!(perimeter > 0.0)) continue;
    shares.push_back(0.25 * perimeter);
    squares_px.push_back(perimeter_px / perimeter);
  }
  if (shares.empty()) return std::nullopt;
  const double share = upper_median(std::move(shares));
  const double nominal = target_.tags->tags().front().size_m / target_.square_m;
  return TargetView::MarkerShare{share,
                                 0.5 * (share - nominal) * upper_median(std::move(squares_px))};
}

TargetView TargetDetector::detect_charuco(ImageView luma) {
  TargetView view;
  const auto seen = seen_tags(luma, *tags_, &view);
  for (std::size_t point = 0; point < target_.points.size(); ++point) {
    // Averages the predictions by the homographies of adjacent tags, which is accurate for any
    // lens.
    Eigen::Vector2d predicted = Eigen::Vector2d::Zero();
    double square_px = 1e9;
    int count = 0;
    for (const auto& [index, detection] : seen) {
      const MappedTag& tag = target_.tags->tags()[index];
      const Eigen::Vector3d offset = target_.points[point] - tag.T_table_tag.translation();
      if (std::max(std::abs(offset.x()), std::abs(offset.y())) > 0.51 * target_.square_m) continue;
      const auto corners = tag.corners();
      std::array<cv::Point2f, 4> from;
      std::array<cv::Point2f, 4> to;
      for (std::size_t i = 0; i < 4; ++i) {
        from[i] = as_point((corners[i] - tag.T_table_tag.translation()).head<2>());
        to[i] = as_point(detection.corners_px[i]);
      }
      const cv::Mat h = cv::getPerspectiveTransform(from.data(), to.data());
      std::vector<cv::Point2f> at = {as_point(offset.head<2>())};
      cv::perspectiveTransform(at, at, h);
      predicted += Eigen::Vector2d(at[0].x, at[0].y);
      for (std::size_t i = 0; i < 4; ++i)
        square_px =
            std::min(square_px, cv::norm(to[i] - to[(i + 1) % 4]) * target_.square_m / tag.size_m);
      ++count;
    }
    if (count == 0) continue;
    predicted /= count;
    const double gap = (target_.square_m - target_.tags->tags().front().size_m) / target_.square_m;
    const auto found =
        find_saddle(luma, predicted, std::max(0.45 * gap, 0.12) * square_px, 0.2 * square_px);
    if (found) view.corners.push_back({static_cast<int>(point), *found});
  }
  view.markers = marker_share(view, seen);
  if (view.corners.size() < kMinCorners) {
    view.problem = seen.empty() && !view.tags.others.empty()
                       ? "only tags that are not in the target file are seen"
                   : seen.empty() ? "no tag of the board is seen"
                                  : fmt::format("only {} of {} corners are seen",
                                                view.corners.size(), target_.points.size());
  }
  return view;
}

Result<TargetDetector> TargetDetector::create(const Target& target) {
  TargetDetector self;
  self.target_ = target;
  if (!target.tags) return self;
  const std::vector<TagFamily> families = target.tags->families();
  PENUMBRA_TRY(self.tags_, TagDetector::create(families));
  const MappedTag& first = target.tags->tags().front();
  if (const auto pattern = TagPattern::make(first.family, first.id))
    self.cells_ = pattern->width_at_border();
  self.gap_m_ = 1e9;
  for (const MappedTag& tag : std::span(target.tags->tags()).subspan(1)) {
    const double distance =
        (tag.T_table_tag.translation() - first.T_table_tag.translation()).norm();
    self.gap_m_ = std::min(self.gap_m_, distance - first.size_m);
  }
  self.spacing_ = std::min(self.gap_m_ / first.size_m, 0.5);
  if (families.size() == 1 && families.front() == TagFamily::tag36h11) {
    TagDetectorOptions options;
    options.border_cells = 2;
    PENUMBRA_TRY(self.two_cell_tags_, TagDetector::create(families, options));
  }
  return self;
}

TargetView TargetDetector::detect(ImageView luma) {
  TargetView view;
  if (luma.empty() || luma.width < 32 || luma.height < 32) {
    view.problem = "the image is too small";
    return view;
  }
  view = target_.kind == TargetKind::tags         ? detect_tags(luma)
         : target_.kind == TargetKind::chessboard ? detect_chessboard(luma)
                                                  : detect_charuco(luma);
  view.blur_px = blur_of(luma, view);
  return view;
}

TargetView TargetDetector::refine(ImageView luma, const TargetView& view, const CameraModel& camera,
                                  const CameraPose& T_board_camera) const {
  TargetView refined = view;
  refined.corners.clear();
  const auto T_camera_board = T_board_camera.inverse();
  if (target_.kind == TargetKind::tags && !view.black_squares) {
    for (std::size_t i = 0; i + 3 < view.corners.size(); i += 4) {
      const auto tag = static_cast<std::size_t>(view.corners[i].point / 4);
      const auto found =
          follow_tag(luma, camera, T_camera_board, target_.tags->tags()[tag].corners(), cells_);
      if (!found) continue;
      std::array<TargetCorner, 4> corners;
      for (std::size_t k = 0; k < 4; ++k)
        corners[k] = TargetCorner{static_cast<int>(4 * tag + k), (*found)[k]};
      set_spreads(corners);
      refined.corners.insert(refined.corners.end(), corners.begin(), corners.end());
    }
    return refined.corners.size() >= std::min<std::size_t>(kMinCorners, view.corners.size())
               ? refined
               : view;
  }
  // Searches for every crossing, including those that detection missed.
  double arm_m = target_.square_m;
  double clearance_m = 0.4 * target_.square_m;
  if (target_.kind == TargetKind::charuco) {
    clearance_m = 0.4 * (target_.square_m - target_.tags->tags().front().size_m);
  } else if (target_.kind == TargetKind::tags) {
    arm_m = gap_m_;
    clearance_m = 0.75 * target_.tags->tags().front().size_m / cells_;
  }
  const std::vector<const TargetCorner*> before = corners_by_point(target_, view.corners);
  for (std::size_t i = 0; i < target_.points.size(); ++i) {
    const auto found =
        follow_crossing(luma, camera, T_camera_board, target_.points[i], arm_m, clearance_m);
    if (found) {
      refined.corners.push_back({static_cast<int>(i), *found});
    } else if (before[i] != nullptr) {
      refined.corners.push_back(*before[i]);
    }
  }
  return refined;
}

}  // namespace penumbra
