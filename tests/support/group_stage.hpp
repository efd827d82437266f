// A table, a wall and a block with tags, each moved independently, in rendered images.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "support/random_session.hpp"
#include "tracking/alignment/pattern_renderer.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra::test {

inline Eigen::Quaterniond turned(double degrees, const Eigen::Vector3d& axis) {
  return Eigen::Quaterniond(Eigen::AngleAxisd(radians(degrees), axis.normalized()));
}

// A wall on the table's far edge, with upright tags.
inline constexpr int kWallId = 100;
inline std::vector<MappedTag> wall(int columns = 3, int rows = 2) {
  std::vector<MappedTag> tags;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      MappedTag tag;
      tag.id = kWallId + j * columns + i;
      tag.size_m = 0.05;
      tag.T_table_tag = {turned(90.0, Eigen::Vector3d::UnitX()),
                         Eigen::Vector3d(0.07 * (i - 0.5 * (columns - 1)), 0.14, 0.12 - 0.07 * j)};
      tag.group = "wall";
      tags.push_back(tag);
    }
  }
  return tags;
}
// A hand-held block: a tag on top, and one on the side towards the viewer.
inline constexpr int kBlockId = 200;
inline std::vector<MappedTag> block() {
  std::vector<MappedTag> tags(2);
  for (int i = 0; i < 2; ++i) {
    MappedTag& tag = tags[static_cast<std::size_t>(i)];
    tag.id = kBlockId + i;
    tag.size_m = 0.04;
    tag.group = "block";
  }
  tags[0].T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.13, -0.05, 0.05)};
  tags[1].T_table_tag = {turned(90.0, Eigen::Vector3d::UnitX()),
                         Eigen::Vector3d(0.13, -0.075, 0.025)};
  return tags;
}

using Placement = GroupPose;
using Placements = std::map<std::string, Placement>;
inline Placement shifted(double x, double y, double z) {
  return {Eigen::Quaterniond::Identity(), Eigen::Vector3d(x, y, z)};
}

// Renders images along a camera path over moving tag groups.
class Stage {
 public:
  explicit Stage(std::vector<std::vector<MappedTag>> groups) {
    RandomNumbers draw(11);
    camera = lens_camera(Lens::plumb_bob, 640, 480, 0.85);
    tags = layout_of(Layout::sheet, draw);
    for (MappedTag& tag : tags) tag.id %= 90;  // below the ids of wall and block
    for (const auto& group : groups) tags.insert(tags.end(), group.begin(), group.end());
    path = hand_motion(1, 0.5, radians(40.0), draw);
    path.azimuth.middle = -0.5 * std::numbers::pi;
    light.samples = 64;
    light.noise_grey = 2.0;
  }
  [[nodiscard]] CameraPose truth(int frame) const { return path.at(frame / 30.0); }
  // Renders a frame with groups moved by `moves`. `drawn`: tags to render if they differ from the
  // map's.
  [[nodiscard]] Frame frame_image(int frame, const Placements& moves = {},
                                  const std::vector<MappedTag>* drawn = nullptr) const {
    PatternRenderer& renderer = renderer_of(drawn != nullptr ? *drawn : tags);
    std::vector<GroupPlacement> placements;
    for (const auto& [group, placement] : moves) placements.push_back({group, placement});
    PatternRenderOptions options = light;
    options.seed = 77U + static_cast<std::uint64_t>(frame);
    const std::array<CameraPose, 1> poses = {truth(frame)};
    const GreyImage image = renderer.render(poses, options, placements);
    FrameBuffer buffer = allocate_frame(PixelFormat::grey8, image.width, image.height);
    for (int y = 0; y < image.height; ++y) {
      std::copy_n(image.view().row(y), image.width,
                  buffer.plane_data[0] + y * buffer.frame.planes[0].stride);
    }
    buffer.frame.sequence = static_cast<std::uint64_t>(frame);
    buffer.frame.timestamp_ns = 1'000'000'000 + frame * std::int64_t{33'333'333};
    return buffer.frame;
  }
  [[nodiscard]] TagMap map() const { return TagMap::make(tags).value(); }
  [[nodiscard]] GroupTracker tracker(const TrackerOptions& options = {}) const {
    return GroupTracker::create(camera, map(), options).value();
  }
  // Overlay error of a cube at the group's centre [px].
  [[nodiscard]] double error_px(const TrackedFrame& tracked, const GroupEstimate& group, int frame,
                                const Placement& placement = {}) const {
    const auto drawn =
        (group.T_table_group * group.T_group_middle).inverse() * tracked.pose.T_table_camera;
    const auto truth_pose = (placement * group.T_group_middle).inverse() * truth(frame);
    return overlay_difference(camera, CameraPose(drawn.rotation(), drawn.translation()),
                              CameraPose(truth_pose.rotation(), truth_pose.translation()))
        .rms_px();
  }

  CameraModel camera = lens_camera(Lens::none, 640, 480, 0.85);
  std::vector<MappedTag> tags;
  HandMotion path;
  PatternRenderOptions light;

 private:
  // Renderers are reused, because each computes the ray of every pixel that it draws.
  struct TagRenderer {
    std::vector<MappedTag> tags;
    std::shared_ptr<PatternRenderer> renderer;
  };
  PatternRenderer& renderer_of(const std::vector<MappedTag>& drawn) const {
    const auto same = [](const MappedTag& a, const MappedTag& b) {
      return a.id == b.id && a.family == b.family && a.size_m == b.size_m && a.group == b.group &&
             a.T_table_tag.matrix() == b.T_table_tag.matrix() && a.curvature == b.curvature;
    };
    for (const TagRenderer& known : renderers_) {
      if (std::ranges::equal(known.tags, drawn, same)) return *known.renderer;
    }
    renderers_.push_back(
        {drawn, std::make_shared<PatternRenderer>(PatternRenderer::create(camera, drawn).value())});
    return *renderers_.back().renderer;
  }
  mutable std::vector<TagRenderer> renderers_;
};

inline const GroupEstimate& group_named(const TrackedFrame& tracked, std::string_view name) {
  return *std::ranges::find(tracked.groups, name, &GroupEstimate::name);
}

}  // namespace penumbra::test
