// Light measured from video, and virtual objects lit by it.
#include "render/scene/light_meter.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra::light_meter_test {
namespace {

using Color = Eigen::Vector3d;

double encode(double linear) {
  const double v = std::clamp(linear, 0.0, 1.0);
  return v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1.0 / 2.4) - 0.055;
}

// Reflectance as a function of the pixel.
using Reflectance = Color (*)(int x, int y);

// A desk of dark wood in many shades. A sheet of paper covers a tenth of the frame, and ink covers
// half of the paper.
Color desk(int x, int y) {
  if (x >= 200 && x < 330 && y >= 150 && y < 390) {
    return Color::Constant(((x / 13 + y / 13) & 1) == 0 ? kPaperReflectance : 0.04);
  }
  const double shade = 0.10 + 0.12 * ((x * 7 + y * 3) % 97) / 97.0;
  return {1.3 * shade, shade, 0.6 * shade};
}
// The desk with a lamp in view that is much brighter than paper.
Color desk_with_lamp(int x, int y) {
  return x > 560 && y < 120 ? Color(Color::Constant(30.0)) : desk(x, y);
}

Frame rgb_frame(Reflectance scene, const Color& light, std::int64_t time_ns = 0, double noise = 0.0,
                unsigned seed = 1) {
  FrameBuffer buffer = allocate_frame(PixelFormat::rgb24, 640, 480);
  std::mt19937 random(seed);
  std::normal_distribution<double> gauss(0.0, 1.0);
  for (int y = 0; y < 480; ++y) {
    std::uint8_t* row = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    for (int x = 0; x < 640; ++x) {
      const Color shown = scene(x, y).cwiseProduct(light);
      for (int c = 0; c < 3; ++c) {
        const double code = 255.0 * encode(shown[c]) + noise * gauss(random);
        row[3 * x + c] = static_cast<std::uint8_t>(std::lround(std::clamp(code, 0.0, 255.0)));
      }
    }
  }
  buffer.frame.timestamp_ns = time_ns;
  return buffer.frame;
}

double max_log_ratio(const Color& a, const Color& b) {
  return (a.array() / b.array()).log().abs().maxCoeff();
}

TEST(LightMeter, MeasuresLightOnDesk) {
  for (const Color& light : {Color(0.9, 0.9, 0.9), Color(0.3, 0.3, 0.3), Color(0.05, 0.05, 0.05),
                             Color(0.9, 0.7, 0.45), Color(0.3, 0.4, 0.6)}) {
    for (const Reflectance scene : {&desk, &desk_with_lamp}) {
      const VideoLight found = measure_light(rgb_frame(scene, light), std::nullopt);
      EXPECT_LT(max_log_ratio(found.on_table, light), 0.06) << light.transpose();
      EXPECT_LT(found.around.maxCoeff(), light.maxCoeff()) << light.transpose();
    }
  }
}

// Over dark surfaces the mean brightness is low, regardless of the light's strength.
TEST(LightMeter, MeasuresMeanOfVisibleSurfaces) {
  const auto wood = [](int, int) { return Color(0.2, 0.15, 0.1); };
  const VideoLight found = measure_light(rgb_frame(wood, Color::Ones()), std::nullopt);
  EXPECT_LT(max_log_ratio(found.around, {0.2, 0.15, 0.1}), 0.02);
}

// The frame has the same YUV values in every pixel format of a camera.
TEST(LightMeter, MeasuresSameLightInEveryPixelFormat) {
  for (const ColorRange range : {ColorRange::full, ColorRange::limited}) {
    std::optional<VideoLight> expected;
    for (const PixelFormat format : {PixelFormat::yuv444p, PixelFormat::yuv422p,
                                     PixelFormat::yuv420p, PixelFormat::nv12, PixelFormat::yuyv}) {
      FrameBuffer buffer = allocate_frame(format, 322, 241);  // odd width and height
      buffer.frame.color_range = range;
      for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
        const PixelPlane& plane = buffer.frame.planes[i];
        for (int y = 0; y < plane.height; ++y) {
          std::uint8_t* row = buffer.plane_data[i] + y * plane.stride;
          for (int x = 0; x < plane.width; ++x) {
            constexpr std::uint8_t kLuma = 170, kU = 110, kV = 140;
            if (format == PixelFormat::yuyv) {
              const std::array<std::uint8_t, 4> pair = {kLuma, kU, kLuma, kV};
              std::copy(pair.begin(), pair.end(), row + 4 * x);
            } else if (format == PixelFormat::nv12 && i == 1) {
              row[2 * x] = kU;
              row[2 * x + 1] = kV;
            } else {
              row[x] = i == 0 ? kLuma : (i == 1 ? kU : kV);
            }
          }
        }
      }
      const VideoLight found = measure_light(buffer.frame, std::nullopt);
      if (!expected) expected = found;
      EXPECT_EQ(found.on_table, expected->on_table) << static_cast<int>(format);
      EXPECT_EQ(found.around, expected->around) << static_cast<int>(format);
    }
    // BT.601: red is 170 + 1.402 * 12, green and blue are lower; limited range is stretched.
    EXPECT_GT(expected->around.x(), expected->around.z());
  }
}

TEST(LightMeter, ReturnsFiniteLightForExtremes) {
  for (const double shown : {0.0, 1e-4, 1.0, 100.0}) {
    for (const std::optional<double> tone :
         {std::optional<double>(), std::optional<double>(2.2), std::optional<double>(10.0)}) {
      const auto grey = [](int, int) { return Color(Color::Ones()); };
      const VideoLight found = measure_light(rgb_frame(grey, Color::Constant(shown)), tone);
      for (const Color& light : {found.on_table, found.around}) {
        EXPECT_TRUE(light.allFinite());
        EXPECT_GT(light.minCoeff(), 0.0);
        EXPECT_LE(light.maxCoeff(), 1.0 / kPaperReflectance);
      }
    }
  }
  // A frame of one pixel, and a frame that is narrower than the grid.
  for (const int width : {1, 7}) {
    const VideoLight found = measure_light(test::plain_frame(width, 1, 188), std::nullopt);
    EXPECT_NEAR(found.around.x(), 0.5029, 1e-3);
  }
}

TEST(LightMeter, FollowsLampButNotNoise) {
  LightMeter meter(std::nullopt);
  constexpr std::int64_t kFrame_ns = 33'333'333;
  std::int64_t now = 5'000'000'000;
  const Color dim = Color::Constant(0.3);
  const Color bright(0.8, 0.7, 0.5);
  double previous = 0.0;
  double largest_step = 0.0;
  std::vector<Frame> noisy;
  for (unsigned seed = 1; seed <= 8; ++seed) noisy.push_back(rgb_frame(desk, dim, 0, 6.0, seed));
  for (std::size_t i = 0; i < 40; ++i, now += kFrame_ns) {
    Frame& frame = noisy[i % noisy.size()];
    frame.timestamp_ns = now;
    const double measured = meter.measure(frame).on_table.y();
    if (i > 20) largest_step = std::max(largest_step, std::abs(std::log(measured / previous)));
    previous = measured;
  }
  // On a bright surface, a change of 1 in 255 grey levels is a change of 2.2 / 255 = 0.0086 in
  // light.
  EXPECT_LT(largest_step, 0.004);

  const Color before = meter.measure(rgb_frame(desk, dim, now)).on_table;
  now += kFrame_ns;
  const Color after_one_frame = meter.measure(rgb_frame(desk, bright, now)).on_table;
  EXPECT_GT(after_one_frame.x(), before.x());
  EXPECT_LT(after_one_frame.x(), 0.5);
  for (int i = 0; i < 15; ++i) {
    now += kFrame_ns;
    meter.measure(rgb_frame(desk, bright, now));
  }
  now += kFrame_ns;
  EXPECT_LT(max_log_ratio(meter.measure(rgb_frame(desk, bright, now)).on_table, bright), 0.15);
}

// Drawing a frame again during a pause changes no value. A step back in time restarts the filter.
TEST(LightMeter, IsDeterministicForSameFrames) {
  std::array<VideoLight, 2> ends;
  for (std::size_t run = 0; run < 2; ++run) {
    LightMeter meter(std::nullopt);
    for (int i = 0; i < 5; ++i) {
      const Frame frame = rgb_frame(desk, Color::Constant(0.2 + 0.1 * i), 40'000'000LL * i, 2.0, 3);
      for (std::size_t again = 0; again <= run; ++again) ends[run] = meter.measure(frame);
    }
    if (run == 0) continue;
    const Frame first = rgb_frame(desk, Color::Constant(0.2), 0, 2.0, 3);
    EXPECT_EQ(meter.measure(first).on_table, measure_light(first, std::nullopt).on_table);
  }
  EXPECT_EQ(ends[0].on_table, ends[1].on_table);
  EXPECT_EQ(ends[0].around, ends[1].around);
}

// A level white sheet that fills the middle of the frame; the tests compare its drawn colour.
class LitSheet : public testing::Test {
 protected:
  static Color shown(const std::optional<VideoLight>& light, double lamp, const CameraModel& camera,
                     const Color& ambient = Color::Constant(0.35)) {
    test::SceneBuilder builder;
    test::ShapeBuilder sheet;
    sheet.box(-0.3, -0.3, 0.0, 0.3, 0.3, 0.01);
    builder.add(test::finished(sheet.build(), glm::vec4(1.0F)), test::at(0.0, 0.0, 0.05), false);
    SceneLight above;
    above.kind = SceneLight::Kind::directional;
    above.intensity = lamp;
    builder.scene().lights.push_back(above);
    builder.scene().ambient = ambient;
    const auto scene = builder.build();
    test::Studio studio(scene, camera);
    SceneState state = evaluate_scene(*scene, 0.0);
    state.video_light = light;
    const FramePlan plan = plan_frame(
        *scene, state, test::tracked(test::look_at({0.0, -0.01, 0.5}, {0, 0, 0})), camera);
    const test::RenderedImage image = studio.draw(test::plain_frame(160, 120, 60), plan);
    const std::uint8_t* pixel = image.at(80, 60);
    return {static_cast<double>(pixel[0]), static_cast<double>(pixel[1]),
            static_cast<double>(pixel[2])};
  }
  static CameraModel camera() { return test::camera_of(160, 120, 150.0); }
};

// The sheet looks like paper in the video: dim in dim light, warm in warm light. Additional lamps
// in the scene do not make it brighter.
TEST_F(LitSheet, IsAsBrightAsPaperInVideo) {
  for (const Color& light :
       {Color(0.6, 0.6, 0.6), Color(0.15, 0.15, 0.15), Color(0.5, 0.35, 0.2)}) {
    for (const double lamp : {0.9, 3.0}) {
      const Color color = shown(VideoLight{light, 0.3 * light}, lamp, camera());
      for (int c = 0; c < 3; ++c) {
        // Ambient light is a little cooler than the lamp, and specular reflection is added.
        EXPECT_NEAR(color[c], 255.0 * encode(light[c]), 14.0) << c << " " << light.transpose();
      }
    }
  }
  // If the scene's author dims the lamp, the sheet is darker than paper.
  const Color light = Color::Constant(0.6);
  const Color dimmed = shown(VideoLight{light, 0.3 * light}, 0.1, camera());
  EXPECT_LT(dimmed.maxCoeff(), 255.0 * encode(0.6 * 0.62));
}

TEST_F(LitSheet, UsesSceneLightWithoutVideoLight) {
  const Color a = shown(std::nullopt, 0.4, camera());
  EXPECT_GT(a.y(), 190.0);
  // If the video light equals the scene's light, only the light from below changes. The sheet's top
  // does not receive it.
  const Color sky = Color(0.35 * 1.08, 0.35 * 1.12, 0.35 * 1.18);
  EXPECT_EQ(shown(VideoLight{Color::Ones(), Color::Constant(0.2)}, 0.4, camera()), a)
      << sky.transpose();
}

// Another camera response (tone curve) encodes the same light with other pixel values.
TEST_F(LitSheet, IsEncodedWithCameraResponse) {
  CameraParameters p = camera().parameters();
  p.tone_curve = 1.0;
  const VideoLight light{Color::Constant(0.5), Color::Constant(0.2)};
  const Color linear = shown(light, 0.9, CameraModel::make(p).value());
  const Color srgb = shown(light, 0.9, camera());
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(255.0 * encode(linear[c] / 255.0), srgb[c], 1.5);
  p.tone_curve = 2.2;
  const Color power = shown(light, 0.9, CameraModel::make(p).value());
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(255.0 * std::pow(linear[c] / 255.0, 1.0 / 2.2), power[c], 1.5);
  }
}

// A shadow on the table removes the same fraction of light for any light of the video.
TEST(VideoLight, KeepsShadowStrengthOnTable) {
  test::SceneBuilder builder;
  test::ShapeBuilder block;
  block.box(-0.05, -0.05, 0.0, 0.05, 0.05, 0.1);
  builder.add(test::finished(block.build(), glm::vec4(0.5F)), test::at(0.0, 0.0, 0.1));
  SceneLight lamp;
  lamp.position = {0.3, 0.2, 0.9};
  lamp.color = {1.0, 0.9, 0.8};
  builder.scene().lights.push_back(lamp);
  const auto scene = builder.build();
  const CameraModel camera = test::camera_of(160, 120, 150.0);
  test::Studio studio(scene, camera);
  const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.5, 0.6}, {0, 0, 0}));
  for (const ShadowTechnique technique :
       {ShadowTechnique::layered, ShadowTechnique::hard, ShadowTechnique::volume}) {
    PlanOptions options;
    options.technique = technique;
    SceneState state = evaluate_scene(*scene, 0.0);
    const Frame frame = test::plain_frame(160, 120, 180);
    const test::RenderedImage without =
        studio.draw_shadows(frame, plan_frame(*scene, state, pose, camera, options));
    state.video_light = VideoLight{{0.4, 0.3, 0.2}, {0.1, 0.08, 0.05}};
    const test::RenderedImage with =
        studio.draw_shadows(frame, plan_frame(*scene, state, pose, camera, options));
    int darkened = 0;
    for (std::size_t i = 0; i < with.rgba.size(); ++i) {
      EXPECT_NEAR(with.rgba[i], without.rgba[i], 1) << to_string(technique);
      if (i % 4 == 0 && without.rgba[i] < 170) ++darkened;
    }
    EXPECT_GT(darkened, 100) << to_string(technique);
  }
}

}  // namespace
}  // namespace penumbra::light_meter_test
