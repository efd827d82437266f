#include "tracking/rigid_tags.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>

namespace penumbra {

int RigidTags::in_view(const MapFromCamera& pose) const {
  constexpr double kMargin = 4.0;          // [px] white around the black square
  constexpr double kSmallestArea = 200.0;  // [px^2]: 8 x 8 cells of 1.8 px
  const auto T_camera_map = pose.inverse();
  int count = 0;
  for (const MappedTag& tag : tags) {
    std::array<Eigen::Vector2d, 4> corners;
    bool inside = true;
    const std::array<Eigen::Vector3d, 4> corners_map = tag.corners();
    for (std::size_t i = 0; i < 4 && inside; ++i) {
      const std::optional<Eigen::Vector2d> pixel = camera.project(T_camera_map * corners_map[i]);
      inside = pixel && pixel->x() >= kMargin && pixel->y() >= kMargin &&
               pixel->x() <= camera.width() - 1 - kMargin &&
               pixel->y() <= camera.height() - 1 - kMargin;
      if (inside) corners[i] = *pixel;
    }
    if (!inside) continue;
    const Eigen::Vector2d a = corners[2] - corners[0];
    const Eigen::Vector2d b = corners[3] - corners[1];
    // Area by the diagonals' cross product; negative for a tag that faces the camera.
    if (-0.5 * (a.x() * b.y() - a.y() * b.x()) >= kSmallestArea) ++count;
  }
  return count;
}

std::optional<PixelBox> RigidTags::box_about(const MapFromCamera& pose) const {
  constexpr double kMinMargin_px = 32.0;
  constexpr double kMaxImageFraction = 0.6;
  const auto T_camera_map = pose.inverse();
  Eigen::AlignedBox2d box;
  for (const MappedTag& tag : tags) {
    for (const Eigen::Vector3d& corner : tag.corners()) {
      const std::optional<Eigen::Vector2d> pixel = camera.project(T_camera_map * corner);
      if (pixel && pixel->allFinite()) box.extend(*pixel);
    }
  }
  const Eigen::AlignedBox2d image(Eigen::Vector2d::Zero(),
                                  Eigen::Vector2d(camera.width(), camera.height()));
  if (box.isEmpty()) return std::nullopt;
  const double margin = std::max(kMinMargin_px, 0.25 * box.sizes().maxCoeff());
  box.min().array() -= margin;
  box.max().array() += margin;
  box = box.intersection(image);
  if (box.isEmpty() || box.volume() > kMaxImageFraction * image.volume()) return std::nullopt;
  const Eigen::Vector2i begin = box.min().cast<int>();
  const Eigen::Vector2i size = box.max().cast<int>() - begin;
  if (size.minCoeff() < 1) return std::nullopt;
  return PixelBox{begin.x(), begin.y(), size.x(), size.y()};
}

double RigidTags::corner_distance_px(const MapFromCamera& a, const MapFromCamera& b,
                                     std::span<const TagAlignment> seen) const {
  const auto from_a = a.inverse();
  const auto from_b = b.inverse();
  double sum = 0.0;
  double count = 0.0;
  for (const TagAlignment& tag : seen) {
    if (!tag.verified) continue;
    for (const Eigen::Vector3d& corner : (*this)[tag.index].corners()) {
      const auto pixel_a = camera.project(from_a * corner);
      const auto pixel_b = camera.project(from_b * corner);
      if (!pixel_a || !pixel_b) continue;
      sum += (*pixel_a - *pixel_b).norm();
      count += 1.0;
    }
  }
  return count > 0.0 ? sum / count : 0.0;
}

bool many_are_inconsistent(const AlignmentResult& result) {
  const auto inconsistent = std::ranges::count_if(
      result.tags, [](const TagAlignment& tag) { return !tag.verified && tag.inconsistent; });
  return result.verified && result.tags_verified < 2 * inconsistent;
}

Matrix6d uninformative_covariance() {
  return covariance_of(0.05, 0.1);
}

}  // namespace penumbra
