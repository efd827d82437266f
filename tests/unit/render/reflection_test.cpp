// Smooth metal reflects the table in the video (docs/rendering.md#reflections).
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>

#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::reflection_test {
namespace {

using test::at;
using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

constexpr int kSide = 320;

// Pixel (x, y) has the code 40 + (x + 2 y) / 8.
double code_of_video(double x, double y) {
  return 40.0 + (x + 2.0 * y) / 8.0;
}
Frame slope() {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, kSide, kSide);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x)
      buffer.plane_data[0][y * buffer.frame.planes[0].stride + x] =
          static_cast<std::uint8_t>(std::lround(code_of_video(x, y)));
  }
  return buffer.frame;
}
// Squares of 8 px with the codes 40 and 140.
Frame squares() {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, kSide, kSide);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x)
      buffer.plane_data[0][y * buffer.frame.planes[0].stride + x] = (x / 8 + y / 8) % 2 ? 140 : 40;
  }
  return buffer.frame;
}

std::shared_ptr<const Model> metal(const std::shared_ptr<const Model>& shape, float metallic,
                                   float roughness) {
  auto model = std::make_shared<Model>(*shape);
  model->materials[0].base_color = glm::vec4(1.0F);
  model->materials[0].metallic = metallic;
  model->materials[0].roughness = roughness;
  return model;
}

PoseEstimate pose() {
  return test::tracked(test::look_at({0.05, -0.45, 0.35}, {0.0, 0.05, 0.03}));
}

// A thin upright plate, turned about the vertical axis, without lamps near its mirror directions.
SceneBuilder plate(float metallic, float roughness, double angle = 0.0) {
  SceneBuilder builder;
  builder.scene().shadows[0].technique = ShadowTechnique::none;
  builder.scene().ambient = Eigen::Vector3d::Constant(0.3);
  SceneLight lamp;
  lamp.position = {0.0, 3.0, 0.2};  // behind the plate
  builder.scene().lights = {lamp};
  builder.add(metal(test::box(0.16, 0.004, 0.12), metallic, roughness),
              at(0.0, 0.08, 0.062, {0, 0, 1}, angle), false);
  return builder;
}

class Reflection : public testing::TestWithParam<bool> {
 protected:
  [[nodiscard]] static CameraModel camera() {
    return GetParam() ? test::distorted_camera(kSide, 400.0) : test::camera_of(kSide, kSide, 400.0);
  }
};
INSTANTIATE_TEST_SUITE_P(Lenses, Reflection, testing::Bool(), [](const auto& lens) {
  return std::string(lens.param ? "Distorted" : "Undistorted");
});

TEST_P(Reflection, ShowsTableInPlate) {
  const CameraModel lens = camera();
  std::mt19937 random(5);
  std::uniform_real_distribution<double> any_angle(-0.3, 0.3), any_x(-0.07, 0.07),
      any_z(0.01, 0.11);
  int compared = 0;
  for (int turn = 0; turn < 6; ++turn) {
    const double angle = any_angle(random);
    Studio studio(plate(1.0F, 0.0F, angle).build(), lens);
    const RenderedImage image = studio.draw(slope(), studio.plan(pose()));
    const Eigen::Matrix3d R = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const Eigen::Vector3d normal = -R.col(1);
    const CameraPose T_table_camera = pose().T_table_camera;
    const auto T_camera_table = T_table_camera.inverse();
    for (int i = 0; i < 200; ++i) {
      const Eigen::Vector3d p =
          R * Eigen::Vector3d(any_x(random), -0.002, any_z(random)) + Eigen::Vector3d(0, 0.08, 0);
      const auto seen = lens.project(T_camera_table * p);
      ASSERT_TRUE(seen.has_value());
      const Eigen::Vector2i pixel = seen->array().round().cast<int>();
      // The ray through the pixel's centre, up to the plate.
      const Eigen::Vector3d ray = T_table_camera.rotation() * *lens.unproject(pixel.cast<double>());
      const Eigen::Vector3d eye = T_table_camera.translation();
      const Eigen::Vector3d on_plate = eye + ray * (normal.dot(p - eye) / normal.dot(ray));
      const Eigen::Vector3d mirrored = ray - 2.0 * normal.dot(ray) * normal;
      if (mirrored.z() >= 0.0) continue;
      const Eigen::Vector3d on_table = on_plate - mirrored * (on_plate.z() / mirrored.z());
      const Eigen::Vector3d in_camera = T_camera_table * on_table;
      if (in_camera.z() < 0.02) continue;
      const auto source = lens.project(in_camera);
      if (!source || source->minCoeff() < 4.0 || source->maxCoeff() > kSide - 5.0) continue;
      EXPECT_NEAR(image.red(pixel.x(), pixel.y()), code_of_video(source->x(), source->y()), 2.0)
          << "turn " << turn << ", pixel " << pixel.transpose() << ", from " << source->transpose();
      ++compared;
    }
  }
  EXPECT_GT(compared, 400);
}

TEST(Reflections, ReproduceUniformVideo) {
  for (const int code : {30, 60, 90, 120, 150}) {
    Studio studio(plate(1.0F, 0.0F).build(), test::camera_of(kSide, kSide, 400.0));
    const RenderedImage image = studio.draw(
        test::plain_frame(kSide, kSide, static_cast<std::uint8_t>(code)), studio.plan(pose()));
    EXPECT_NEAR(image.red(160, 110), code, 1);
  }
}

// Contrast of the image on the plate.
int contrast(float metallic, float roughness) {
  Studio studio(plate(metallic, roughness).build(), test::camera_of(kSide, kSide, 400.0));
  const RenderedImage image = studio.draw(squares(), studio.plan(pose()));
  const CameraModel lens = test::camera_of(kSide, kSide, 400.0);
  const auto pixel_of = [&](double x, double z) -> Eigen::Vector2i {
    return lens.project(pose().T_table_camera.inverse() * Eigen::Vector3d(x, 0.078, z))
        .value()
        .array()
        .round()
        .cast<int>();
  };
  const Eigen::Vector2i from = pixel_of(-0.04, 0.10);
  const Eigen::Vector2i to = pixel_of(0.04, 0.06);
  int low = 255, high = 0;
  for (int y = from.y(); y <= to.y(); ++y) {
    for (int x = from.x(); x <= to.x(); ++x) {
      low = std::min(low, image.red(x, y));
      high = std::max(high, image.red(x, y));
    }
  }
  return high - low;
}

TEST(Reflections, BlurWithRoughness) {
  const int mirror = contrast(1.0F, 0.0F);
  const int brushed = contrast(1.0F, 0.25F);
  EXPECT_GT(mirror, 70);
  EXPECT_LT(brushed, mirror / 2);
}

TEST(Reflections, AreOnlyInSmoothMetal) {
  EXPECT_LT(contrast(0.0F, 0.0F), 12);
  EXPECT_LT(contrast(1.0F, 0.9F), 12);
}

// While a pose is uncertain, surfaces are mixed into the video by the program of the mode.
TEST(Reflections, AreRetexturedAsBlended) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    PoseEstimate uncertain = pose();
    uncertain.status = TrackStatus::uncertain;
    const auto drawn = [&](Translucency mode) {
      Studio studio(plate(1.0F, 0.1F).build(), test::distorted_camera(kSide, 400.0), api);
      PlanOptions options;
      options.translucency = mode;
      return studio.draw(slope(), studio.plan(uncertain, options));
    };
    const RenderedImage blended = drawn(Translucency::blend);
    const RenderedImage retextured = drawn(Translucency::retexture);
    for (std::size_t i = 0; i < blended.rgba.size(); ++i)
      ASSERT_NEAR(blended.rgba[i], retextured.rgba[i], 1) << "byte " << i;
  }
}

TEST(Reflections, AreTheSameInSurfacesThatBlend) {
  SceneBuilder blended = plate(1.0F, 0.0F);
  auto model = std::make_shared<Model>(*blended.scene().objects[0].model);
  model->materials[0].alpha_mode = AlphaMode::blend;
  blended.scene().objects[0].model = model;
  const CameraModel lens = test::camera_of(kSide, kSide, 400.0);
  Studio of_opaque(plate(1.0F, 0.0F).build(), lens), of_blended(blended.build(), lens);
  const RenderedImage opaque = of_opaque.draw(slope(), of_opaque.plan(pose()));
  const RenderedImage through = of_blended.draw(slope(), of_blended.plan(pose()));
  for (int x = 130; x < 200; x += 7) EXPECT_NEAR(opaque.red(x, 120), through.red(x, 120), 1);
}

TEST(Reflections, AreTheSameWithSeveralSamples) {
  const CameraModel lens = test::camera_of(kSide, kSide, 400.0);
  Studio single(plate(1.0F, 0.0F).build(), lens);
  Studio several(plate(1.0F, 0.0F).build(), lens, GlApi::gl33, {.msaa = 4});
  const RenderedImage a = single.draw(slope(), single.plan(pose()));
  const RenderedImage b = several.draw(slope(), several.plan(pose()));
  for (int x = 130; x < 200; x += 7) EXPECT_NEAR(a.red(x, 120), b.red(x, 120), 1);
}

// Also where a reflected ray is level, meets the table behind the camera, or starts below it.
TEST(Reflections, AreNeverBlackUnderUniformVideo) {
  const Frame grey = test::plain_frame(kSide, kSide, 120);
  std::mt19937 random(11);
  std::uniform_real_distribution<double> place(-0.1, 0.1), turn(-3.1, 3.1);
  SceneBuilder builder;
  builder.scene().shadows[0].technique = ShadowTechnique::none;
  builder.scene().ambient = Eigen::Vector3d::Constant(0.4);
  const auto mirror_box = metal(test::box(0.05, 0.05, 0.05), 1.0F, 0.0F);
  for (int i = 0; i < 12; ++i)
    builder.add(mirror_box,
                at(place(random), place(random), place(random),
                   {place(random), place(random), place(random)}, turn(random)),
                false);
  Studio studio(builder.build(), test::distorted_camera(kSide, 250.0));
  for (int i = 0; i < 10; ++i) {
    const Eigen::Vector3d eye(3.0 * place(random), -0.4 + place(random), 0.22 + place(random));
    const RenderedImage image =
        studio.draw(grey, studio.plan(test::tracked(test::look_at(eye, {0.0, 0.0, 0.05}))));
    int darkest = 255;
    for (std::size_t j = 0; j < image.rgba.size(); j += 4)
      darkest = std::min(darkest, int{image.rgba[j]});
    EXPECT_GT(darkest, 100) << "view " << i;
  }
}

}  // namespace
}  // namespace penumbra::reflection_test
