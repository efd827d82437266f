// Corners measured tag by tag, on images with exact truth.
#include "calib/survey/tag_corner_meter.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>

#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

// A sheet as printed, and an image of it whose tags may be elsewhere.
struct Scene {
  CameraModel camera = test::wide_camera();
  std::vector<MappedTag> map = test::board(3, 2, 0.06);
  std::vector<MappedTag> actual = map;
  CameraPose pose = test::looking_at({0.0, 0.0, 0.0}, 0.6, radians(60.0), radians(30.0), 0.1);

  [[nodiscard]] FrameCorners measure() const {
    PatternRenderer renderer = PatternRenderer::create(camera, actual).value();
    PatternRenderOptions options;
    options.noise_grey = 2.0;
    options.samples = 96;
    const GreyImage image = renderer.render(std::array{pose}, options);
    TagCornerMeter meter = TagCornerMeter::create(camera, map).value();
    return meter.measure(image.view(), as_map_pose(pose), Vector6d::Zero());
  }
  [[nodiscard]] double largest_error_px(const FrameCorners& measured) const {
    double largest = 0.0;
    for (const TagCorners& tag : measured.tags) {
      for (std::size_t i = 0; i < 4; ++i) {
        const Eigen::Vector3d p = pose.inverse() * actual[tag.tag].corners()[i];
        largest = std::max(largest, (tag.corners_px[i] - camera.project(p).value()).norm());
      }
    }
    return largest;
  }
};

std::vector<std::size_t> tags_of(const FrameCorners& measured) {
  std::vector<std::size_t> tags;
  for (const TagCorners& tag : measured.tags) tags.push_back(tag.tag);
  return tags;
}

TEST(TagCornerMeter, MeasuresCornersOfFlatSheet) {
  const Scene scene;
  const FrameCorners measured = scene.measure();
  EXPECT_THAT(tags_of(measured), testing::ElementsAre(0, 1, 2, 3, 4, 5));
  EXPECT_LT(scene.largest_error_px(measured), 0.08);
  for (const TagCorners& tag : measured.tags) {
    EXPECT_GT(tag.sigma_px, 0.0);
    EXPECT_LT(tag.sigma_px, 0.05);
  }
}

TEST(TagCornerMeter, FindsTagsThatAreNotWhereTheMapHasThem) {
  Scene scene;
  scene.actual[1].T_table_tag = {
      exp_quaternion({0.08, -0.05, 0.02}),
      scene.map[1].T_table_tag.translation() + Eigen::Vector3d(0.001, -0.001, 0.006)};
  const FrameCorners measured = scene.measure();
  EXPECT_EQ(measured.tags.size(), 6U);
  EXPECT_LT(scene.largest_error_px(measured), 0.08);
}

TEST(TagCornerMeter, OmitsTagsThatItCannotRead) {
  Scene scene;
  scene.actual.pop_back();  // tag 5 is not there
  EXPECT_THAT(tags_of(scene.measure()), testing::ElementsAre(0, 1, 2, 3, 4));
}

TEST(TagCornerMeter, ReturnsTagsInView) {
  const Scene scene;
  const TagCornerMeter meter = TagCornerMeter::create(scene.camera, scene.map).value();
  EXPECT_EQ(meter.in_view(as_map_pose(scene.pose)).size(), 6U);
  // Beside the sheet, and below the table.
  EXPECT_THAT(meter.in_view(as_map_pose(test::looking_at({1.0, 0.0, 0.0}, 0.6, 1.0, 0.0, 0.0))),
              testing::IsEmpty());
  EXPECT_THAT(meter.in_view(as_map_pose(test::looking_at({0.0, 0.0, 0.0}, 0.6, -1.0, 0.0, 0.0))),
              testing::IsEmpty());
}

}  // namespace
}  // namespace penumbra
