// The virtual walls of the technique `walls` are drawn where they are visible, over their shadows.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <optional>

#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::virtual_wall_test {
namespace {

using test::at;
using test::box;
using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

constexpr int kSide = 320;
constexpr std::uint8_t kGrey = 128;

Frame grey(std::uint8_t value = kGrey) {
  return test::plain_frame(kSide, kSide, value);
}
CameraModel pinhole() {
  return test::camera_of(kSide, kSide, 400.0);
}
PoseEstimate in_front() {
  return test::tracked(test::look_at({0.2, -0.6, 0.35}, {0.0, 0.05, 0.06}));
}

// A table with a back wall of 0.3 m x 0.2 m at y = 0.12 m, and no caster.
SceneBuilder wall_scene(ShadowTechnique technique = ShadowTechnique::walls) {
  SceneBuilder builder;
  ScenePlane& wall = builder.scene().planes.emplace_back();
  wall.name = "back";
  wall.normal = {0, -1, 0};
  wall.point = {0, 0.12, 0};
  wall.outline = {{-0.15, 0.0}, {0.15, 0.0}, {0.15, 0.2}, {-0.15, 0.2}};
  builder.scene().shadows[0].technique = technique;
  builder.scene().shadows[0].walls = {1};
  return builder;
}

// The pixel of a point of the back wall; x and z as in the table frame.
Eigen::Vector2i pixel_of(const CameraModel& camera, double x, double z) {
  const Eigen::Vector3d p = in_front().T_table_camera.inverse() * Eigen::Vector3d(x, 0.12, z);
  return camera.project(p).value().array().round().cast<int>();
}

int count_different(const RenderedImage& a, const RenderedImage& b) {
  int different = 0;
  for (std::size_t i = 0; i < a.rgba.size(); i += 4)
    different += std::equal(&a.rgba[i], &a.rgba[i] + 4, &b.rgba[i]) ? 0 : 1;
  return different;
}

int greatest_difference(const RenderedImage& a, const RenderedImage& b) {
  int greatest = 0;
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    greatest = std::max(greatest, std::abs(int{a.rgba[i]} - int{b.rgba[i]}));
  return greatest;
}

class VirtualWall : public testing::TestWithParam<bool> {
 protected:
  [[nodiscard]] static CameraModel camera() {
    return GetParam() ? test::distorted_camera(kSide, 400.0) : pinhole();
  }
};
INSTANTIATE_TEST_SUITE_P(Lenses, VirtualWall, testing::Bool(), [](const auto& lens) {
  return std::string(lens.param ? "Distorted" : "Undistorted");
});

TEST_P(VirtualWall, ChangesPixelsInsideItsOutlineOnly) {
  const CameraModel view_camera = camera();
  Studio studio(wall_scene().build(), view_camera);
  const RenderedImage image = studio.draw(grey(0), studio.plan(in_front()));
  const CameraPose T_table_camera = in_front().T_table_camera;
  int inside = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = view_camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray.has_value());
      const Eigen::Vector3d direction = T_table_camera.rotation() * *ray;
      const Eigen::Vector3d eye = T_table_camera.translation();
      const Eigen::Vector3d p = eye + (0.12 - eye.y()) / direction.y() * direction;
      // Distance to the outline, positive inside [m]; a pixel is 1.7 to 2.4 mm.
      const double depth = std::min(0.15 - std::abs(p.x()), std::min(p.z(), 0.2 - p.z()));
      const bool changed = image.red(x, y) > 0;
      if (depth > 0.003) {
        EXPECT_TRUE(changed) << x << ", " << y;
        ++inside;
      }
      if (depth < -0.003) {
        EXPECT_FALSE(changed) << x << ", " << y;
      }
    }
  }
  EXPECT_GT(inside, 10'000);
}

// The spacing is 2 cm, from the lower left corner of the wall.
TEST_P(VirtualWall, HasDarkLinesAtMultiplesOfSpacing) {
  Studio studio(wall_scene().build(), camera());
  const RenderedImage image = studio.draw(grey(), studio.plan(in_front()));
  const auto red_at = [&](double x, double z) {
    const Eigen::Vector2i p = pixel_of(camera(), x, z);
    return image.red(p.x(), p.y());
  };
  const auto darkest_at = [&](double x, double z) {  // of 3 x 3 pixels
    const Eigen::Vector2i p = pixel_of(camera(), x, z);
    int darkest = 255;
    for (int i = 0; i < 9; ++i)
      darkest = std::min(darkest, image.red(p.x() + i % 3 - 1, p.y() + i / 3 - 1));
    return darkest;
  };
  for (int column = 1; column < 15; ++column) {
    for (int row = 1; row < 10; ++row) {
      const double x = -0.15 + 0.02 * column;
      const double z = 0.02 * row;
      SCOPED_TRACE(testing::Message() << "x " << x << ", z " << z);
      EXPECT_LT(darkest_at(x, z), kGrey);                    // a crossing of lines
      EXPECT_LT(darkest_at(x, z - 0.01), kGrey);             // on a vertical line
      EXPECT_LT(darkest_at(x - 0.01, z), kGrey);             // on a horizontal line
      EXPECT_NEAR(red_at(x - 0.01, z - 0.01), 128 + 15, 2);  // the pane: 0.2 of 204 - 128
    }
  }
}

TEST(VirtualWalls, AreDrawnByTechniqueWallsAlone) {
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    SCOPED_TRACE(name);
    Studio studio(wall_scene(technique).build(), pinhole());
    const RenderedImage image = studio.draw(grey(), studio.plan(in_front()));
    const bool is_plain = std::ranges::all_of(
        image.rgba, [](std::uint8_t value) { return value == kGrey || value == 255; });
    EXPECT_EQ(is_plain, technique != ShadowTechnique::walls);
  }
}

RenderedImage without_walls() {
  Studio studio(wall_scene(ShadowTechnique::none).build(), pinhole());
  return studio.draw(grey(), studio.plan(in_front()));
}

TEST(VirtualWalls, AreHiddenOnRequest) {
  Studio studio(wall_scene().build(), pinhole());
  EXPECT_NE(studio.draw(grey(), studio.plan(in_front())), without_walls());
  PlanOptions hidden;
  hidden.walls = false;
  EXPECT_EQ(studio.draw(grey(), studio.plan(in_front(), hidden)), without_walls());
}

TEST(VirtualWalls, AreInvisibleFromBehind) {
  Studio studio(wall_scene().build(), pinhole());
  const PoseEstimate behind = test::tracked(test::look_at({0.2, 0.8, 0.35}, {0.0, 0.05, 0.06}));
  EXPECT_EQ(studio.draw(grey(), studio.plan(behind)), without_walls());
}

// A wall without an outline, with a tag group, or that another node has in `planes`, is real.
TEST(VirtualWalls, AreNotReal) {
  SceneBuilder unbounded = wall_scene();
  unbounded.scene().planes[1].outline.clear();
  SceneBuilder tagged = wall_scene();
  tagged.scene().planes[1].tag_group = "wall";
  SceneBuilder received = wall_scene();
  ShadowNode& node = received.scene().shadows.emplace_back();
  node.name = "another";
  node.planes = {0, 1};
  for (SceneBuilder* builder : {&unbounded, &tagged, &received}) {
    Studio studio(builder->build(), pinhole());
    for (const PlaneReceiver& receiver : studio.plan(in_front()).receivers)
      EXPECT_FALSE(receiver.virtual_wall);
  }
  EXPECT_TRUE(Studio(wall_scene().build(), pinhole()).plan(in_front()).receivers[1].virtual_wall);
}

// The wall is the only plane that a camera under the table sees.
TEST(VirtualWalls, AreBehindObjectsWithoutTable) {
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.0, 0.0, 0.1), false);
  Studio studio(builder.build(), pinhole());
  const PoseEstimate below = test::tracked(test::look_at({0.0, -0.6, -0.05}, {0.0, 0.05, 0.1}));
  const FramePlan plan = studio.plan(below);
  ASSERT_EQ(plan.receivers.size(), 1U);
  ASSERT_TRUE(plan.receivers[0].virtual_wall);
  const RenderedImage with_walls = studio.draw(grey(), plan);
  PlanOptions hidden;
  hidden.walls = false;
  const RenderedImage without = studio.draw(grey(), studio.plan(below, hidden));
  const Eigen::Vector3d middle = below.T_table_camera.inverse() * Eigen::Vector3d(0, 0, 0.1);
  const Eigen::Vector2i p = pinhole().project(middle).value().array().round().cast<int>();
  EXPECT_EQ(with_walls.red(p.x(), p.y()), without.red(p.x(), p.y()));
  EXPECT_GT(count_different(with_walls, without), 5'000);
}

// On a CPU rasteriser, compared with four samples per pixel.
TEST(VirtualWalls, LeaveEdgesOfObjectsInFrontSmooth) {
  FrameBuffer squares = allocate_frame(PixelFormat::grey8, kSide, kSide);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x)
      squares.plane_data[0][y * squares.frame.planes[0].stride + x] =
          (x / 8 + y / 8) % 2 == 0 ? 10 : 230;
  }
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.0, 0.0, 0.1, {0, 1, 0}, 0.3), false);
  const auto drawn = [&](std::optional<int> msaa) {
    Studio studio(builder.build(), pinhole(), GlApi::gl33, {.msaa = msaa});
    return studio.draw(squares.frame, studio.plan(in_front()));
  };
  const RenderedImage samples = drawn(4);
  const Eigen::Vector3d middle = in_front().T_table_camera.inverse() * Eigen::Vector3d(0, 0, 0.1);
  const Eigen::Vector2i p = pinhole().project(middle).value().array().round().cast<int>();
  const auto error_of = [&](const RenderedImage& image) {
    double sum = 0.0;
    for (int y = p.y() - 40; y <= p.y() + 40; ++y) {
      for (int x = p.x() - 40; x <= p.x() + 40; ++x)
        sum += std::pow(image.red(x, y) - samples.red(x, y), 2);
    }
    return std::sqrt(sum);
  };
  EXPECT_LT(error_of(drawn(std::nullopt)), 0.5 * error_of(drawn(0)));
}

TEST(VirtualWalls, AreBehindObjectsAndPhantomsInFront) {
  for (const bool phantom : {false, true}) {
    SCOPED_TRACE(phantom);
    SceneBuilder builder = wall_scene();
    builder.add(box(0.06, 0.02, 0.06), at(0.0, 0.0, 0.1), false, phantom);
    Studio studio(builder.build(), pinhole());
    const RenderedImage with_walls = studio.draw(grey(), studio.plan(in_front()));
    PlanOptions hidden;
    hidden.walls = false;
    const RenderedImage without = studio.draw(grey(), studio.plan(in_front(), hidden));
    const Eigen::Vector3d middle =
        in_front().T_table_camera.inverse() * Eigen::Vector3d(0.0, 0.0, 0.1);
    const Eigen::Vector2i p = pinhole().project(middle).value().array().round().cast<int>();
    for (int y = p.y() - 8; y <= p.y() + 8; ++y) {
      for (int x = p.x() - 8; x <= p.x() + 8; ++x)
        EXPECT_EQ(with_walls.red(x, y), without.red(x, y));
    }
    EXPECT_GT(count_different(with_walls, without), 5'000);
  }
}

TEST(VirtualWalls, ShowShadowsThroughThePane) {
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.05, -0.05, 0.1));
  Studio studio(builder.build(), pinhole());
  const RenderedImage image = studio.draw_shadows(grey(), studio.plan(in_front()));
  const Eigen::Vector2i in_shadow = pixel_of(pinhole(), 0.06, 0.09);
  const Eigen::Vector2i beside = pixel_of(pinhole(), -0.06, 0.09);
  EXPECT_LT(image.red(in_shadow.x(), in_shadow.y()), image.red(beside.x(), beside.y()) - 25);
}

// The pane takes other pixels of the pattern than the shadow, which stays as dark.
TEST(VirtualWalls, KeepPixelsOfShadowsInModeMesh) {
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.05, -0.05, 0.1));
  Studio studio(builder.build(), pinhole());
  PlanOptions options;
  options.translucency = Translucency::mesh;
  const RenderedImage with_walls = studio.draw_shadows(grey(), studio.plan(in_front(), options));
  options.walls = false;
  const RenderedImage without = studio.draw_shadows(grey(), studio.plan(in_front(), options));
  int black = 0, kept = 0;
  for (std::size_t i = 0; i < without.rgba.size(); i += 4) {
    if (without.rgba[i] != 0) continue;
    ++black;
    kept += with_walls.rgba[i] == 0 ? 1 : 0;
  }
  EXPECT_GT(black, 500);
  EXPECT_EQ(kept, black);
}

TEST(VirtualWalls, AreRetexturedAsBlended) {
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.05, -0.05, 0.1));
  Studio studio(builder.build(), pinhole());
  PlanOptions options;
  options.translucency = Translucency::blend;
  const RenderedImage blended = studio.draw(grey(), studio.plan(in_front(), options));
  options.translucency = Translucency::retexture;
  const RenderedImage retextured = studio.draw(grey(), studio.plan(in_front(), options));
  EXPECT_LE(greatest_difference(blended, retextured), 1);
}

// Three of 16 pixels of the pane and six of 16 of a line.
TEST(VirtualWalls, AreScreenDoorsInModeMesh) {
  Studio studio(wall_scene().build(), pinhole());
  PlanOptions options;
  options.translucency = Translucency::mesh;
  const RenderedImage image = studio.draw(grey(), studio.plan(in_front(), options));
  int changed = 0, darkened = 0;
  for (std::size_t i = 0; i < image.rgba.size(); i += 4) {
    changed += image.rgba[i] != kGrey ? 1 : 0;
    darkened += image.rgba[i] < kGrey - 12 ? 1 : 0;
  }
  EXPECT_GT(changed, 2'500);
  EXPECT_LT(changed, 8'000);
  EXPECT_GT(darkened, 500);
}

TEST(VirtualWalls, FadeWithUncertainPose) {
  Studio studio(wall_scene().build(), pinhole());
  PoseEstimate uncertain = in_front();
  uncertain.status = TrackStatus::uncertain;
  const RenderedImage full = studio.draw(grey(0), studio.plan(in_front()));
  const RenderedImage half = studio.draw(grey(0), studio.plan(uncertain));
  int greatest = 0;
  for (std::size_t i = 0; i < full.rgba.size(); ++i)
    if (i % 4 != 3)
      greatest = std::max(greatest, std::abs(int{full.rgba[i]} - 2 * int{half.rgba[i]}));
  EXPECT_LE(greatest, 2);
  EXPECT_GT(count_different(full, half), 10'000);
}

TEST(VirtualWalls, AreTheSameWithoutSkipping) {
  SceneBuilder builder = wall_scene();
  builder.add(box(0.06, 0.02, 0.06), at(0.05, -0.05, 0.1));
  Studio studio(builder.build(), pinhole());
  PlanOptions options;
  const RenderedImage skipped = studio.draw(grey(), studio.plan(in_front(), options));
  options.skip = false;
  EXPECT_EQ(studio.draw(grey(), studio.plan(in_front(), options)), skipped);
}

}  // namespace
}  // namespace penumbra::virtual_wall_test
