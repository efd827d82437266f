#include "calib/target/target_detector.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "calib/survey/edge_spread.hpp"
#include "calib/survey/luma_sample.hpp"
#include "core/propagate.hpp"
#include "tracking/alignment/tag_pattern.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {
namespace {

constexpr int kFewestCorners = 8;
constexpr double kBorder = 3.0;  // [px] that corners keep from the image's edge

cv::Mat as_mat(ImageView luma) {
  // OpenCV has no read-only header; nothing here writes.
  return {luma.height, luma.width, CV_8UC1, const_cast<std::uint8_t*>(luma.data),
          static_cast<std::size_t>(luma.stride)};
}

bool inside(ImageView luma, const Eigen::Vector2d& p, double margin) {
  return p.x() >= margin && p.y() >= margin && p.x() <= luma.width - 1 - margin &&
         p.y() <= luma.height - 1 - margin;
}

// Four sectors, black and white in turn, around the point: what a chessboard's corner looks like.
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
  if (highest - lowest < 20.0) return false;
  const double middle = 0.5 * (lowest + highest);
  int changes = 0;
  for (std::size_t i = 0; i < kSamples; ++i) {
    if ((ring[i] > middle) != (ring[(i + 1) % kSamples] > middle)) ++changes;
  }
  return changes == 4;
}

// The saddle nearest to `start`; nothing where the search leaves its window or finds no saddle.
std::optional<Eigen::Vector2d> find_saddle(ImageView luma, const Eigen::Vector2d& start,
                                           double half_window_px, double largest_step_px) {
  const int half = std::clamp(static_cast<int>(std::lround(half_window_px)), 2, 15);
  if (!inside(luma, start, half + 2.0)) return std::nullopt;
  std::vector<cv::Point2f> points = {
      {static_cast<float>(start.x()), static_cast<float>(start.y())}};
  cv::cornerSubPix(as_mat(luma), points, {half, half}, {-1, -1},
                   {cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 60, 1e-4});
  const Eigen::Vector2d found(points[0].x, points[0].y);
  if (!found.allFinite() || (found - start).norm() > largest_step_px) return std::nullopt;
  if (!is_saddle(luma, found, std::max(2.0, 0.7 * half))) return std::nullopt;
  return found;
}

// Sigma of the blur across the middle of an edge from a to b: what height over steepest slope of a
// blurred step says. Nothing where there is no edge.
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
    for (const double t : {0.42, 0.46, 0.5, 0.54, 0.58}) {  // along the edge: less noise
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
  if (*highest - *lowest < 20.0 || slope <= 0.0) return std::nullopt;
  return (*highest - *lowest) / (slope * std::sqrt(2.0 * M_PI));
}

void set_spreads(std::array<TargetCorner, 4>& corners) {
  const auto spreads =
      edge_spreads({corners[0].pixel, corners[1].pixel, corners[2].pixel, corners[3].pixel});
  for (std::size_t i = 0; i < 4; ++i) corners[i].spread = spreads[i];
}

}  // namespace

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
  constexpr int kLeast = 3;
  std::vector<cv::Point2f> corners;
  cv::Mat found;  // a cell for each corner
  try {
    if (!cv::findChessboardCornersSB(as_mat(luma), {kLeast, kLeast}, corners,
                                     cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_LARGER, found)) {
      return std::nullopt;
    }
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  return std::array{std::max(found.cols, found.rows), std::min(found.cols, found.rows)};
}

struct TargetDetector::Impl {
  Target target;
  std::optional<TagDetector> tags;
  std::optional<TagDetector> two_cell_tags;
  int cells = 8;       // of a tag's black square, across
  double gap_m = 0.0;  // between the black squares of neighbouring tags in a grid

  [[nodiscard]] TargetView detect_tags(ImageView luma);
  [[nodiscard]] TargetView detect_chessboard(ImageView luma) const;
  [[nodiscard]] TargetView detect_charuco(ImageView luma);
  [[nodiscard]] std::optional<TargetView::MarkerShare> marker_share(
      const TargetView& view, const std::map<std::size_t, TagDetection>& seen) const;
  [[nodiscard]] double blur_of(ImageView luma, const TargetView& view) const;
  [[nodiscard]] bool has_squares(ImageView luma, const TargetView& view) const;
  [[nodiscard]] std::optional<std::array<Eigen::Vector2d, 4>> follow_edges(
      ImageView luma, const MappedTag& tag, const CameraModel& camera,
      const Transform<frame::Camera, frame::Table>& T_camera_board) const;
  [[nodiscard]] std::optional<Eigen::Vector2d> follow_crossing(
      ImageView luma, const Eigen::Vector3d& corner, double arm_m, double clear_m,
      const CameraModel& camera,
      const Transform<frame::Camera, frame::Table>& T_camera_board) const;
  // Every tag of the map once; ids that are seen twice are nobody's.
  [[nodiscard]] std::map<std::size_t, TagDetection> seen_tags(ImageView luma, TagDetector& detector,
                                                              int* repeated) const;
};

std::map<std::size_t, TagDetection> TargetDetector::Impl::seen_tags(ImageView luma,
                                                                    TagDetector& detector,
                                                                    int* repeated) const {
  std::map<std::pair<TagFamily, int>, std::size_t> index;
  for (std::size_t i = 0; i < target.tags->tags().size(); ++i)
    index[{target.tags->tags()[i].family, target.tags->tags()[i].id}] = i;
  std::map<std::size_t, int> times;
  std::map<std::size_t, TagDetection> seen;
  for (const TagDetection& detection : detector.detect(luma)) {
    const auto found = index.find({detection.family, detection.id});
    if (found == index.end()) continue;
    ++times[found->second];
    seen[found->second] = detection;
  }
  for (const auto& [tag, count] : times) {
    if (count == 1) continue;
    seen.erase(tag);
    if (repeated != nullptr) ++*repeated;
  }
  return seen;
}

// Black at the middle of the squares that Kalibr prints between the tags, where neither the tag's
// own margin nor another tag lies.
bool TargetDetector::Impl::has_squares(ImageView luma, const TargetView& view) const {
  if (!target.may_have_squares) return false;
  const double spacing = std::min(gap_m / target.tags->tags().front().size_m, 0.5);
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
          0.5 * (corner + view.corners[i + (k + 1) % 4].pixel) - centre;  // to the side's middle
      const auto at_square = sample_luma(luma, centre + (1.0 + spacing) * (corner - centre));
      const auto at_border = sample_luma(luma, centre + (1.0 - 1.0 / cells) * side);
      const auto at_paper = sample_luma(luma, centre + (1.0 + spacing) * side);
      if (!at_square || !at_border || !at_paper || *at_paper - *at_border < 20.0) continue;
      ++(*at_square < 0.5 * (*at_paper + *at_border) ? black : white);
    }
  }
  return black > white;
}

double TargetDetector::Impl::blur_of(ImageView luma, const TargetView& view) const {
  std::vector<const TargetCorner*> at(target.points.size(), nullptr);
  for (const TargetCorner& corner : view.corners)
    at[static_cast<std::size_t>(corner.point)] = &corner;
  std::vector<double> blurs;
  for (const auto& [a, b] : target.edges) {
    const TargetCorner* p = at[static_cast<std::size_t>(a)];
    const TargetCorner* q = at[static_cast<std::size_t>(b)];
    if (p == nullptr || q == nullptr) continue;
    const double length = (p->pixel - q->pixel).norm();
    const double reach = target.kind == TargetKind::tags      ? 0.9 * length / cells
                         : target.kind == TargetKind::charuco ? 0.1 * length
                                                              : 0.4 * length;
    if (const auto blur = blur_across(luma, p->pixel, q->pixel, std::min(reach, 10.0)))
      blurs.push_back(*blur);
  }
  if (blurs.size() < 4) return 0.0;
  // Motion blurs the edges across it only: the larger of two directions is at the upper part.
  const auto high = blurs.begin() + static_cast<std::ptrdiff_t>(blurs.size() * 3 / 4);
  std::nth_element(blurs.begin(), high, blurs.end());
  return *high;
}

TargetView TargetDetector::Impl::detect_tags(ImageView luma) {
  TargetView view;
  int repeated = 0;
  const auto seen = seen_tags(luma, *tags, &repeated);
  int cut = 0;
  for (const auto& [index, detection] : seen) {
    std::array<TargetCorner, 4> corners;
    bool whole = true;
    for (std::size_t i = 0; i < 4; ++i) {
      corners[i].point = static_cast<int>(4 * index + i);
      corners[i].pixel = detection.corners_px[i];
      whole = whole && inside(luma, corners[i].pixel, kBorder);
    }
    if (!whole) {
      ++cut;
      continue;
    }
    set_spreads(corners);
    view.corners.insert(view.corners.end(), corners.begin(), corners.end());
  }
  if (two_cell_tags && 4 * seen.size() < target.tags->tags().size()) {
    view.two_cell_tags = static_cast<int>(seen_tags(luma, *two_cell_tags, nullptr).size());
  }
  const std::size_t needed = std::min<std::size_t>(kFewestCorners, target.points.size());
  if (view.corners.size() < needed) {
    view.problem = seen.empty() ? "no tag of the target is seen"
                   : repeated > 0
                       ? "the target's tags are seen twice"
                       : fmt::format("only {} of {} tags are seen whole{}", view.corners.size() / 4,
                                     target.tags->tags().size(), cut > 0 ? ": cut off" : "");
    if (view.two_cell_tags > static_cast<int>(seen.size())) {
      view.problem = fmt::format("{} tags have a black border of two cells", view.two_cell_tags);
    }
  }
  if (has_squares(luma, view)) {
    view.black_squares = true;
    // Where a square touches a tag's corner, that is a saddle and no corner.
    const double spacing = std::min(gap_m / target.tags->tags().front().size_m, 0.5);
    std::vector<TargetCorner> saddles;
    for (std::size_t i = 0; i < view.corners.size(); ++i) {
      const std::size_t first = i - i % 4;
      const double size =
          (view.corners[first].pixel - view.corners[first + 2].pixel).norm() / std::sqrt(2.0);
      const auto found =
          find_saddle(luma, view.corners[i].pixel, 0.4 * spacing * size, 0.5 * spacing * size);
      if (!found) continue;
      saddles.push_back({view.corners[i].point, *found, Eigen::Vector2d::Zero()});
    }
    view.corners = std::move(saddles);
    if (view.corners.size() < needed) view.problem = "too few corners between tags and squares";
  }
  return view;
}

TargetView TargetDetector::Impl::detect_chessboard(ImageView luma) const {
  TargetView view;
  const cv::Mat image = as_mat(luma);
  const cv::Size size(target.columns, target.rows);
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
  if (!all || found.size() != target.points.size()) {
    view.problem = "the chessboard is not seen whole: not there, cut off, hidden or blurred";
    return view;
  }
  // A board is never seen from behind: corners in mirrored order are put right.
  const auto at = [&](int i, int j) {
    const cv::Point2f& p = found[static_cast<std::size_t>(j * target.columns + i)];
    return Eigen::Vector2d(p.x, p.y);
  };
  const Eigen::Vector2d right = at(target.columns - 1, 0) - at(0, 0);
  const Eigen::Vector2d down = at(0, target.rows - 1) - at(0, 0);
  const bool mirrored = right.x() * down.y() - right.y() * down.x() < 0.0;
  // No window reaches a neighbouring corner.
  double nearest = 1e9;
  for (const auto& [a, b] : target.edges) {
    nearest = std::min(
        nearest, cv::norm(found[static_cast<std::size_t>(a)] - found[static_cast<std::size_t>(b)]));
  }
  const int half = std::clamp(static_cast<int>(0.35 * nearest), 2, 11);
  std::vector<cv::Point2f> refined = found;
  cv::cornerSubPix(image, refined, {half, half}, {-1, -1},
                   {cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 60, 1e-4});
  for (int j = 0; j < target.rows; ++j) {
    for (int i = 0; i < target.columns; ++i) {
      const int source = j * target.columns + (mirrored ? target.columns - 1 - i : i);
      const cv::Point2f p = refined[static_cast<std::size_t>(source)];
      const cv::Point2f before = found[static_cast<std::size_t>(source)];
      const bool kept = cv::norm(p - before) <= half && std::isfinite(p.x) && std::isfinite(p.y);
      const cv::Point2f& used = kept ? p : before;
      view.corners.push_back(
          {j * target.columns + i, Eigen::Vector2d(used.x, used.y), Eigen::Vector2d::Zero()});
    }
  }
  return view;
}

// A square is small enough to be seen without its lens: what maps its corners to the unit square
// says how large the marker in it is.
std::optional<TargetView::MarkerShare> TargetDetector::Impl::marker_share(
    const TargetView& view, const std::map<std::size_t, TagDetection>& seen) const {
  std::vector<double> shares;
  std::vector<double> squares_px;
  for (const auto& [index, detection] : seen) {
    const MappedTag& tag = target.tags->tags()[index];
    std::vector<cv::Point2f> from;
    std::vector<cv::Point2f> to;
    for (const TargetCorner& corner : view.corners) {
      const Eigen::Vector3d offset =
          (target.points[static_cast<std::size_t>(corner.point)] - tag.T_table_tag.translation()) /
          target.square_m;
      if (std::max(std::abs(offset.x()), std::abs(offset.y())) > 0.51) continue;
      from.emplace_back(static_cast<float>(corner.pixel.x()), static_cast<float>(corner.pixel.y()));
      to.emplace_back(static_cast<float>(offset.x()), static_cast<float>(offset.y()));
    }
    if (from.size() != 4) continue;  // a square at the board's edge, or one seen in part
    const cv::Mat h = cv::getPerspectiveTransform(from, to);
    std::vector<cv::Point2f> corners;
    for (const Eigen::Vector2d& p : detection.corners_px)
      corners.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
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
  const auto middle = [](std::vector<double>& values) {
    const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  const double share = middle(shares);
  const double said = target.tags->tags().front().size_m / target.square_m;
  return TargetView::MarkerShare{share, 0.5 * (share - said) * middle(squares_px)};
}

TargetView TargetDetector::Impl::detect_charuco(ImageView luma) {
  TargetView view;
  const auto seen = seen_tags(luma, *tags, nullptr);
  for (std::size_t point = 0; point < target.points.size(); ++point) {
    // From the tags around it, each by its own homography: close enough for any lens.
    Eigen::Vector2d predicted = Eigen::Vector2d::Zero();
    double square_px = 1e9;
    int count = 0;
    for (const auto& [index, detection] : seen) {
      const MappedTag& tag = target.tags->tags()[index];
      const Eigen::Vector3d offset = target.points[point] - tag.T_table_tag.translation();
      if (std::max(std::abs(offset.x()), std::abs(offset.y())) > 0.51 * target.square_m) continue;
      const auto corners = tag.corners();
      std::array<cv::Point2f, 4> from;
      std::array<cv::Point2f, 4> to;
      for (std::size_t i = 0; i < 4; ++i) {
        from[i] = {static_cast<float>((corners[i].x() - tag.T_table_tag.translation().x())),
                   static_cast<float>((corners[i].y() - tag.T_table_tag.translation().y()))};
        to[i] = {static_cast<float>(detection.corners_px[i].x()),
                 static_cast<float>(detection.corners_px[i].y())};
      }
      const cv::Mat h = cv::getPerspectiveTransform(from.data(), to.data());
      std::vector<cv::Point2f> out;
      cv::perspectiveTransform(std::vector<cv::Point2f>{{static_cast<float>(offset.x()),
                                                         static_cast<float>(offset.y())}},
                               out, h);
      predicted += Eigen::Vector2d(out[0].x, out[0].y);
      for (std::size_t i = 0; i < 4; ++i)
        square_px =
            std::min(square_px, cv::norm(to[i] - to[(i + 1) % 4]) * target.square_m / tag.size_m);
      ++count;
    }
    if (count == 0) continue;
    predicted /= count;
    const double gap = (target.square_m - target.tags->tags().front().size_m) / target.square_m;
    const auto found =
        find_saddle(luma, predicted, std::max(0.45 * gap, 0.12) * square_px, 0.2 * square_px);
    if (found) view.corners.push_back({static_cast<int>(point), *found, Eigen::Vector2d::Zero()});
  }
  view.markers = marker_share(view, seen);
  if (view.corners.size() < kFewestCorners) {
    view.problem = seen.empty() ? "no tag of the board is seen"
                                : fmt::format("only {} of {} corners are seen", view.corners.size(),
                                              target.points.size());
  }
  return view;
}

namespace {

// A straight edge of the board as it was found in the picture: how far it lies, along the normals,
// from the curve where camera and pose put it.
struct FollowedEdge {
  double at_begin = 0.0;  // [px]
  double at_middle = 0.0;
  double at_end = 0.0;
  Eigen::Vector2d normal_begin;
  Eigen::Vector2d normal_middle;
  Eigen::Vector2d normal_end;
};

// Follows the edge from a to b [m, board frame] within `reach` px of its curve. A straight line
// fitted to it would be off by what the lens bends it: 0.1 px on the tags of a webcam. Normals
// point away from `away_from` [px]. `alternates`: black and white change sides in the middle (at a
// chessboard's corner), so what a tone curve does to one half it does to the other the other way
// round; else white is where normals point. Nothing where less than half of the edge is seen.
std::optional<FollowedEdge> follow_edge(
    ImageView luma, const CameraModel& camera,
    const Transform<frame::Camera, frame::Table>& T_camera_board, const Eigen::Vector3d& a,
    const Eigen::Vector3d& b, const Eigen::Vector2d& away_from, double reach, bool alternates) {
  struct Place {
    double t = 0.0;  // -0.5 at a, 0.5 at b
    Eigen::Vector2d p;
    Eigen::Vector2d normal;
  };
  const auto place_at = [&](double t) -> std::optional<Place> {
    const auto p = camera.project(T_camera_board * Eigen::Vector3d(a + (t + 0.5) * (b - a)));
    const auto q = camera.project(T_camera_board * Eigen::Vector3d(a + (t + 0.51) * (b - a)));
    if (!p || !q || !((*q - *p).norm() > 1e-6)) return std::nullopt;
    Eigen::Vector2d normal(-(*q - *p).y(), (*q - *p).x());
    normal.normalize();
    if (normal.dot(*p - away_from) < 0.0) normal = -normal;
    return Place{t, *p, normal};
  };
  const auto begin = place_at(-0.5);
  const auto middle = place_at(0.0);
  const auto end = place_at(0.49);
  if (!begin || !middle || !end) return std::nullopt;
  const double length = (end->p - begin->p).norm();
  if (reach < 1.2 || length < 8.0) return std::nullopt;
  const double corner = std::clamp(1.5 * reach / length, 0.04, 0.2);  // corners are round
  const int count = std::clamp(static_cast<int>(length), 10, 80);
  std::vector<Place> places;
  for (int k = 0; k < count; ++k) {
    const double t = (k + 0.5) / count - 0.5;
    if (std::abs(t) > 0.5 - corner || (alternates && std::abs(t) < corner)) continue;
    const auto place = place_at(t);
    if (!place) return std::nullopt;
    places.push_back(*place);
  }
  // Offset = x0 + x1 t + x2 sign(t).
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  for (int round = 0; round < 5; ++round) {
    Eigen::Matrix3d A = Eigen::Vector3d(0.0, 1e-9, alternates ? 1e-9 : 1.0).asDiagonal();
    Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
    std::size_t used = 0;
    for (const Place& place : places) {
      const Eigen::Vector3d basis(1.0, place.t, !alternates ? 0.0 : place.t < 0.0 ? -1.0 : 1.0);
      const double expected = basis.dot(x);
      constexpr double kStep = 0.25;  // [px]
      const int steps = static_cast<int>(reach / kStep);
      std::array<double, 64> values{};
      bool ok = true;
      for (int s = 0; s <= 2 * steps + 1; ++s) {
        const auto value =
            sample_luma(luma, place.p + (expected + (s - steps - 0.5) * kStep) * place.normal);
        if (!value) {
          ok = false;
          break;
        }
        values[static_cast<std::size_t>(s)] = *value;
      }
      if (!ok) continue;
      // Where the change from black to white is: its centre of mass, as seen through a window that
      // forgets the next edge. A change the other way is another edge's.
      const double whole = values[static_cast<std::size_t>(2 * steps + 1)] - values[0];
      const double sign = alternates && whole < 0.0 ? -1.0 : 1.0;
      const double width = round < 2 ? 0.6 * reach : std::min(0.6 * reach, 1.2);
      double mass = 0.0;
      double moment = 0.0;
      for (int s = 0; s <= 2 * steps; ++s) {
        const double rise =
            sign * (values[static_cast<std::size_t>(s + 1)] - values[static_cast<std::size_t>(s)]);
        if (rise <= 0.0) continue;
        const double at = (s - steps) * kStep;
        const double weight = rise * std::exp(-0.5 * at * at / (width * width));
        mass += weight;
        moment += weight * at;
      }
      if (mass < 10.0) continue;
      // The window draws the centre of mass of a change of sigma 0.8 px towards its own middle.
      const double offset = moment / mass * (1.0 + 0.64 / (width * width));
      if (!(std::abs(offset) < reach)) continue;
      const double weight = round == 0 ? 1.0 : 1.0 / (1.0 + 4.0 * offset * offset);
      A += weight * basis * basis.transpose();
      rhs += weight * (expected + offset) * basis;
      ++used;
    }
    if (2 * used < places.size() || used < 6) return std::nullopt;
    x = A.ldlt().solve(rhs);
    if (!x.allFinite() || x.cwiseAbs().maxCoeff() > 6.0) return std::nullopt;
  }
  return FollowedEdge{x[0] - 0.5 * x[1], x[0],           x[0] + 0.5 * x[1],
                      begin->normal,     middle->normal, end->normal};
}

}  // namespace

// The tag's four sides, and where they meet.
std::optional<std::array<Eigen::Vector2d, 4>> TargetDetector::Impl::follow_edges(
    ImageView luma, const MappedTag& tag, const CameraModel& camera,
    const Transform<frame::Camera, frame::Table>& T_camera_board) const {
  const auto corners = tag.corners();
  std::array<Eigen::Vector2d, 4> predicted;
  for (std::size_t i = 0; i < 4; ++i) {
    const auto pixel = camera.project(T_camera_board * corners[i]);
    if (!pixel || !inside(luma, *pixel, kBorder)) return std::nullopt;
    predicted[i] = *pixel;
  }
  const Eigen::Vector2d centre = 0.25 * (predicted[0] + predicted[1] + predicted[2] + predicted[3]);
  std::array<FollowedEdge, 4> sides;
  for (std::size_t i = 0; i < 4; ++i) {
    // The black border is one cell wide.
    const Eigen::Vector2d along = predicted[(i + 1) % 4] - predicted[i];
    double cell = 1e9;
    for (const std::size_t k : {(i + 2) % 4, (i + 3) % 4}) {
      const Eigen::Vector2d d = predicted[k] - predicted[i];
      cell = std::min(cell, std::abs(along.x() * d.y() - along.y() * d.x()) / along.norm() / cells);
    }
    const auto side = follow_edge(luma, camera, T_camera_board, corners[i], corners[(i + 1) % 4],
                                  centre, std::min(0.75 * cell, 4.0), false);
    if (!side) return std::nullopt;
    sides[i] = *side;
  }
  std::array<Eigen::Vector2d, 4> found;
  for (std::size_t i = 0; i < 4; ++i) {
    const FollowedEdge& before = sides[(i + 3) % 4];
    const FollowedEdge& after = sides[i];
    Eigen::Matrix2d normals;
    normals.row(0) = before.normal_end.transpose();
    normals.row(1) = after.normal_begin.transpose();
    if (std::abs(normals.determinant()) < 0.2) return std::nullopt;
    found[i] = predicted[i] + normals.inverse() * Eigen::Vector2d(before.at_end, after.at_begin);
  }
  return found;
}

// A corner where two edges cross and black and white change sides, from `arm_m` of each edge on
// both sides of it; nothing else lies within `clear_m` of them.
std::optional<Eigen::Vector2d> TargetDetector::Impl::follow_crossing(
    ImageView luma, const Eigen::Vector3d& corner, double arm_m, double clear_m,
    const CameraModel& camera, const Transform<frame::Camera, frame::Table>& T_camera_board) const {
  const auto predicted = camera.project(T_camera_board * corner);
  if (!predicted || !inside(luma, *predicted, kBorder)) return std::nullopt;
  Eigen::Matrix2d normals;
  Eigen::Vector2d offsets;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector3d x = axis == 0 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
    const Eigen::Vector3d y = axis == 0 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
    const auto away = camera.project(T_camera_board * Eigen::Vector3d(corner - clear_m * y));
    const auto along = camera.project(T_camera_board * Eigen::Vector3d(corner + arm_m * x));
    if (!away || !along) return std::nullopt;
    const Eigen::Vector2d e = *along - *predicted;
    const Eigen::Vector2d d = *away - *predicted;
    const double clear = std::abs(e.x() * d.y() - e.y() * d.x()) / e.norm();
    const auto edge = follow_edge(luma, camera, T_camera_board, corner - arm_m * x,
                                  corner + arm_m * x, *away, std::min(clear, 4.0), true);
    if (!edge) return std::nullopt;
    normals.row(axis) = edge->normal_middle.transpose();
    offsets[axis] = edge->at_middle;
  }
  if (std::abs(normals.determinant()) < 0.2) return std::nullopt;
  const Eigen::Vector2d moved = normals.inverse() * offsets;
  if (!(moved.norm() < 5.0)) return std::nullopt;
  return *predicted + moved;
}

TargetDetector::TargetDetector(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TargetDetector::TargetDetector(TargetDetector&&) noexcept = default;
TargetDetector& TargetDetector::operator=(TargetDetector&&) noexcept = default;
TargetDetector::~TargetDetector() = default;

Result<TargetDetector> TargetDetector::create(const Target& target) {
  auto impl = std::make_unique<Impl>();
  impl->target = target;
  if (target.tags) {
    const std::vector<TagFamily> families = target.tags->families();
    PENUMBRA_TRY(TagDetector tags, TagDetector::create(families));
    impl->tags.emplace(std::move(tags));
    const MappedTag& first = target.tags->tags().front();
    if (const auto pattern = TagPattern::make(first.family, first.id))
      impl->cells = pattern->width_at_border();
    const auto& tags_of = target.tags->tags();
    impl->gap_m = 1e9;
    for (std::size_t i = 1; i < tags_of.size(); ++i) {
      const double distance =
          (tags_of[i].T_table_tag.translation() - tags_of[0].T_table_tag.translation()).norm();
      impl->gap_m = std::min(impl->gap_m, distance - tags_of[0].size_m);
    }
    if (families.size() == 1 && families.front() == TagFamily::tag36h11) {
      TagDetectorOptions options;
      options.border_cells = 2;
      PENUMBRA_TRY(TagDetector wide, TagDetector::create(families, options));
      impl->two_cell_tags.emplace(std::move(wide));
    }
  }
  return TargetDetector(std::move(impl));
}

TargetView TargetDetector::detect(ImageView luma) {
  TargetView view;
  if (luma.empty() || luma.width < 32 || luma.height < 32) {
    view.problem = "the picture is too small";
    return view;
  }
  switch (impl_->target.kind) {
    case TargetKind::tags:
      view = impl_->detect_tags(luma);
      break;
    case TargetKind::chessboard:
      view = impl_->detect_chessboard(luma);
      break;
    case TargetKind::charuco:
      view = impl_->detect_charuco(luma);
      break;
  }
  view.blur_px = impl_->blur_of(luma, view);
  return view;
}

TargetView TargetDetector::refine(ImageView luma, const TargetView& view, const CameraModel& camera,
                                  const CameraPose& T_board_camera) const {
  const Target& target = impl_->target;
  TargetView refined = view;
  refined.corners.clear();
  const auto T_camera_board = T_board_camera.inverse();
  if (target.kind == TargetKind::tags && !view.black_squares) {
    for (std::size_t i = 0; i + 3 < view.corners.size(); i += 4) {
      const auto tag = static_cast<std::size_t>(view.corners[i].point / 4);
      const auto found =
          impl_->follow_edges(luma, target.tags->tags()[tag], camera, T_camera_board);
      if (!found) continue;
      std::array<TargetCorner, 4> corners;
      for (std::size_t k = 0; k < 4; ++k)
        corners[k] = {static_cast<int>(4 * tag + k), (*found)[k], Eigen::Vector2d::Zero()};
      set_spreads(corners);
      refined.corners.insert(refined.corners.end(), corners.begin(), corners.end());
    }
    return refined.corners.size() >= std::min<std::size_t>(kFewestCorners, view.corners.size())
               ? refined
               : view;
  }
  // Crossings: each is looked for where it must be, found before or not.
  double arm_m = target.square_m;
  double clear_m = 0.4 * target.square_m;
  if (target.kind == TargetKind::charuco) {
    clear_m = 0.4 * (target.square_m - target.tags->tags().front().size_m);
  } else if (target.kind == TargetKind::tags) {
    arm_m = impl_->gap_m;
    clear_m = 0.75 * target.tags->tags().front().size_m / impl_->cells;
  }
  std::vector<const TargetCorner*> before(target.points.size(), nullptr);
  for (const TargetCorner& corner : view.corners)
    before[static_cast<std::size_t>(corner.point)] = &corner;
  for (std::size_t i = 0; i < target.points.size(); ++i) {
    const auto found =
        impl_->follow_crossing(luma, target.points[i], arm_m, clear_m, camera, T_camera_board);
    if (found) {
      refined.corners.push_back({static_cast<int>(i), *found, Eigen::Vector2d::Zero()});
    } else if (before[i] != nullptr) {
      refined.corners.push_back(*before[i]);
    }
  }
  return refined;
}

}  // namespace penumbra
