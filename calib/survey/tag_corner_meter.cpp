#include "calib/survey/tag_corner_meter.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "calib/survey/tag_edges.hpp"
#include "core/propagate.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

// Expected error of a tag's pose relative to the map.
constexpr double kPrior_m = 0.02;
constexpr double kPrior_rad = 0.1;

struct SingleTag {
  MappedTag tag;
  TagPattern pattern;
  TagAligner aligner;
};

}  // namespace

struct TagCornerMeter::Impl {
  CameraModel camera;
  std::vector<SingleTag> tags;

  [[nodiscard]] bool is_in_view(const MappedTag& tag, const MapFromCamera& pose) const {
    const auto T_camera_map = pose.inverse();
    const Eigen::Vector3d normal = tag.T_table_tag.rotation() * Eigen::Vector3d::UnitZ();
    if (normal.dot(pose.translation() - tag.T_table_tag.translation()) <= 0.0) return false;
    return std::ranges::all_of(tag.corners(), [&](const Eigen::Vector3d& corner) {
      const std::optional<Eigen::Vector2d> pixel = camera.project(T_camera_map * corner);
      return pixel && pixel->x() >= 0.0 && pixel->y() >= 0.0 && pixel->x() <= camera.width() - 1 &&
             pixel->y() <= camera.height() - 1;
    });
  }
};

TagCornerMeter::TagCornerMeter(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TagCornerMeter::TagCornerMeter(TagCornerMeter&&) noexcept = default;
TagCornerMeter& TagCornerMeter::operator=(TagCornerMeter&&) noexcept = default;
TagCornerMeter::~TagCornerMeter() = default;

Result<TagCornerMeter> TagCornerMeter::create(const CameraModel& camera,
                                              std::span<const MappedTag> tags) {
  auto impl = std::make_unique<Impl>(Impl{camera, {}});
  AlignmentOptions options;
  options.effort = AlignmentEffort::accurate;
  for (const MappedTag& tag : tags) {
    PENUMBRA_TRY(TagPattern pattern, TagPattern::make(tag.family, tag.id));
    PENUMBRA_TRY(TagAligner aligner, TagAligner::create(camera, {&tag, 1}, options));
    impl->tags.push_back({tag, std::move(pattern), std::move(aligner)});
  }
  return TagCornerMeter(std::move(impl));
}

std::vector<std::size_t> TagCornerMeter::in_view(const MapFromCamera& pose) const {
  std::vector<std::size_t> indices;
  for (std::size_t k = 0; k < impl_->tags.size(); ++k) {
    if (impl_->is_in_view(impl_->tags[k].tag, pose)) indices.push_back(k);
  }
  return indices;
}

FrameCorners TagCornerMeter::measure(ImageView luma, const MapFromCamera& pose,
                                     const Vector6d& velocity) {
  FrameCorners result{pose, velocity, {}};
  const CameraModel& camera = impl_->camera;
  const double row_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
  for (const std::size_t k : in_view(pose)) {
    SingleTag& single = impl_->tags[k];
    AlignmentInput input;
    input.luma = luma;
    input.predicted = pose;
    input.covariance = covariance_of(kPrior_m, kPrior_rad);
    input.velocity = velocity;
    const AlignmentResult aligned = single.aligner.align(input);
    if (!aligned.verified) continue;
    const auto centre =
        camera.project(aligned.T_map_camera.inverse() * single.tag.T_table_tag.translation());
    if (!centre) continue;
    // The pose at the exposure of the tag's row.
    const double time_s = (centre->y() - 0.5 * (camera.height() - 1)) * row_s;
    const CameraPose at_row = as_table_pose(perturbed(aligned.T_map_camera, time_s * velocity));
    const std::optional<MeasuredTag> measured = measure_tag(
        luma, camera, single.pattern, single.tag, at_row.inverse() * single.tag.T_table_tag);
    if (!measured) continue;
    result.tags.push_back({k, measured->corners_px, std::sqrt(measured->covariance.trace() / 8.0)});
  }
  return result;
}

}  // namespace penumbra
