#include "calib/target/target_motion.hpp"

#include <algorithm>
#include <cmath>

#include "tracking/detection/pose_refiner.hpp"
#include "tracking/evaluation/pose_velocity.hpp"
#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {
namespace {

// The time of the test grows with the cube of the number of squares.
constexpr std::size_t kMaxSquares = 24;
constexpr std::size_t kMaxTested = 96;  // images
constexpr double kCornerSigma_px = 0.1;
constexpr std::size_t kMinCorners = 8;

// Returns at most `count` elements, evenly spaced.
template <class T>
std::vector<T> thinned(std::vector<T> all, std::size_t count) {
  if (all.size() <= count) return all;
  std::vector<T> kept;
  for (std::size_t i = 0; i < count; ++i) kept.push_back(std::move(all[i * all.size() / count]));
  return kept;
}

// Returns the index of the point at `p`; -1 if there is none.
int point_at(const std::vector<Eigen::Vector3d>& points, const Eigen::Vector3d& p,
             double tolerance_m) {
  const auto nearest = std::ranges::min_element(
      points, {}, [&](const Eigen::Vector3d& other) { return (other - p).squaredNorm(); });
  if (nearest == points.end() || !((*nearest - p).norm() < tolerance_m)) return -1;
  return static_cast<int>(nearest - points.begin());
}

// The tags of a target, or squares of a chessboard that share no corner.
std::vector<MappedTag> squares_of(const Target& target) {
  if (target.kind == TargetKind::tags) return target.tags->tags();
  std::vector<MappedTag> squares;
  for (int row = 0; row + 1 < target.rows; row += 2) {
    for (int column = 0; column + 1 < target.columns; column += 2) {
      const auto index = static_cast<std::size_t>(row * target.columns + column);
      const auto opposite = index + static_cast<std::size_t>(target.columns) + 1;
      MappedTag& square = squares.emplace_back();
      square.id = static_cast<int>(squares.size()) - 1;
      square.size_m = target.square_m;
      square.T_table_tag = {Eigen::Quaterniond::Identity(),
                            0.5 * (target.points[index] + target.points[opposite])};
    }
  }
  return squares;
}

}  // namespace

TargetMotion::TargetMotion(const Target& target) : points_(target.points) {
  for (const MappedTag& tag : thinned(squares_of(target), kMaxSquares)) {
    Square square{tag, {}};
    const auto corners = tag.corners();
    for (std::size_t i = 0; i < 4; ++i)
      square.points[i] = point_at(points_, corners[i], 0.1 * tag.size_m);
    if (std::ranges::find(square.points, -1) == square.points.end()) squares_.push_back(square);
  }
}

void TargetMotion::add(std::int64_t timestamp_ns, std::span<const TargetCorner> corners) {
  const bool is_later = images_.empty() || timestamp_ns > images_.back().timestamp_ns;
  if (!is_later || images_.size() >= kMaxImages || corners.size() < kMinCorners) return;
  images_.push_back({timestamp_ns, {corners.begin(), corners.end()}});
}

std::optional<MapFromCamera> TargetMotion::pose_of(const CameraModel& camera,
                                                   const Image& image) const {
  std::vector<PointObservation> points;
  for (const TargetCorner& corner : image.corners)
    points.push_back({points_[static_cast<std::size_t>(corner.point)], corner.pixel});
  const auto found = find_pose(camera, points);
  return found ? std::optional(found->T_map_camera) : std::nullopt;
}

std::vector<TagCorners> TargetMotion::corners_of(const Image& image) const {
  std::vector<const TargetCorner*> seen(points_.size(), nullptr);
  for (const TargetCorner& corner : image.corners)
    seen[static_cast<std::size_t>(corner.point)] = &corner;
  std::vector<TagCorners> result;
  for (std::size_t s = 0; s < squares_.size(); ++s) {
    TagCorners corners{s, {}, kCornerSigma_px};
    bool is_complete = true;
    for (std::size_t i = 0; i < 4; ++i) {
      const TargetCorner* corner = seen[static_cast<std::size_t>(squares_[s].points[i])];
      is_complete = is_complete && corner != nullptr;
      if (corner != nullptr) corners.corners_px[i] = corner->pixel;
    }
    if (is_complete) result.push_back(corners);
  }
  return result;
}

std::optional<RowTime> TargetMotion::row_time(const CameraModel& camera) const {
  // Only images between two others have a velocity.
  std::vector<std::size_t> inner;
  for (std::size_t i = 1; i + 1 < images_.size(); ++i) inner.push_back(i);
  std::vector<FrameCorners> frames;
  for (const std::size_t i : thinned(std::move(inner), kMaxTested)) {
    const auto posed = [&](std::size_t index) {
      return TimedPose{images_[index].timestamp_ns, pose_of(camera, images_[index])};
    };
    const TimedPose here = posed(i);
    if (!here.pose) continue;
    const TimedPose before = posed(i - 1);
    const TimedPose after = posed(i + 1);
    const Vector6d velocity = velocity_at(&before, here, &after);
    if (velocity.isZero(0.0)) continue;  // unknown
    frames.push_back({*here.pose, velocity, corners_of(images_[i])});
  }
  std::vector<MappedTag> tags;
  for (const Square& square : squares_) tags.push_back(square.tag);
  return row_time_of(camera, find_residual_causes(camera, tags, frames));
}

}  // namespace penumbra
