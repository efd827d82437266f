#include "render/compositor.hpp"

#include <epoxy/gl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

using test::RenderedImage;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

std::shared_ptr<const Model> box(double side, const glm::vec4& color) {
  ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, -side / 2, side / 2, side / 2, side / 2);
  return test::finished(shape.build(), color);
}

Frame noise_frame(PixelFormat format, int width, int height, ColorMatrix matrix, ColorRange range) {
  FrameBuffer buffer = allocate_frame(format, width, height);
  std::mt19937 random(5);
  for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
    const PixelPlane& plane = buffer.frame.planes[i];
    const std::ptrdiff_t bytes = plane.stride * plane.height;
    for (std::ptrdiff_t j = 0; j < bytes; ++j)
      buffer.plane_data[i][j] = static_cast<std::uint8_t>(random() & 0xFFU);
  }
  buffer.frame.color_matrix = matrix;
  buffer.frame.color_range = range;
  return buffer.frame;
}

// Reference colour of one pixel by the formulas of the colour standards, in double precision.
std::array<double, 3> reference_rgb(const Frame& f, int x, int y) {
  const auto byte = [&f](std::size_t plane, int bx, int by) {
    return static_cast<double>(f.planes[plane].data[by * f.planes[plane].stride + bx]);
  };
  if (f.format == PixelFormat::rgb24)
    return {byte(0, 3 * x, y), byte(0, 3 * x + 1, y), byte(0, 3 * x + 2, y)};
  double luma = 0;
  double u = 128;
  double v = 128;
  switch (f.format) {
    case PixelFormat::grey8:
      luma = byte(0, x, y);
      break;
    case PixelFormat::yuyv:
      luma = byte(0, 2 * x, y);
      u = byte(0, (x / 2) * 4 + 1, y);
      v = byte(0, (x / 2) * 4 + 3, y);
      break;
    case PixelFormat::nv12:
      luma = byte(0, x, y);
      u = byte(1, (x / 2) * 2, y / 2);
      v = byte(1, (x / 2) * 2 + 1, y / 2);
      break;
    default: {
      luma = byte(0, x, y);
      const int cx = f.format == PixelFormat::yuv444p ? x : x / 2;
      const int cy = f.format == PixelFormat::yuv420p ? y / 2 : y;
      u = byte(1, cx, cy);
      v = byte(2, cx, cy);
    }
  }
  const double kr = f.color_matrix == ColorMatrix::bt601 ? 0.299 : 0.2126;
  const double kb = f.color_matrix == ColorMatrix::bt601 ? 0.114 : 0.0722;
  const bool limited = f.color_range == ColorRange::limited;
  luma = limited ? (luma - 16) * 255 / 219 : luma;
  u = (u - 128) * (limited ? 255.0 / 224 : 1.0);
  v = (v - 128) * (limited ? 255.0 / 224 : 1.0);
  const double r = luma + 2 * (1 - kr) * v;
  const double b = luma + 2 * (1 - kb) * u;
  const double g = (luma - kr * r - kb * b) / (1 - kr - kb);
  const auto clip = [](double c) { return std::clamp(c, 0.0, 255.0); };
  return {clip(r), clip(g), clip(b)};
}

// The CPU's conversion of the video changes a frame without smooth edges by at most one code, and
// is kept while the frame is the same.
TEST(Compositor, DiffersByAtMostOneCodeWithVideoConvertedOnCpu) {
  SceneBuilder builder;
  builder.add(box(0.06, glm::vec4(0.8F, 0.4F, 0.2F, 1.0F)), test::at(0, 0, 0.1));
  const auto scene = builder.build();
  const CameraModel camera = test::camera_of(161, 121, 150.0);
  Studio by_shader(scene, camera, GlApi::gl33, {.msaa = 0, .video_on_cpu = false});
  Studio by_cpu(scene, camera, GlApi::gl33, {.msaa = 0, .video_on_cpu = true});
  const PoseEstimate pose = test::tracked(test::look_at({0.0, -0.4, 0.5}, {0.0, 0.0, 0.0}));
  for (const Translucency mode :
       {Translucency::blend, Translucency::mesh, Translucency::geometry_mesh}) {
    SCOPED_TRACE(to_string(mode));
    PlanOptions options;
    options.translucency = mode;
    const FramePlan plan = by_shader.plan(pose, options);
    const Frame frame =
        noise_frame(PixelFormat::nv12, 161, 121, ColorMatrix::bt601, ColorRange::full);
    const RenderedImage expected = by_shader.draw(frame, plan);
    const RenderedImage image = by_cpu.draw(frame, plan);
    int worst = 0;
    int different = 0;
    for (std::size_t i = 0; i < image.rgba.size(); ++i) {
      const int difference = std::abs(image.rgba[i] - expected.rgba[i]);
      worst = std::max(worst, difference);
      different += difference > 0 ? 1 : 0;
    }
    EXPECT_LE(worst, 1);
    EXPECT_LT(different, static_cast<int>(image.rgba.size()) / 20);
    EXPECT_EQ(by_cpu.stats()[Counter::video_copies], 1);
    EXPECT_EQ(by_cpu.draw(frame, plan), image);
    EXPECT_EQ(by_cpu.stats()[Counter::video_copies], 0) << "the frame is the same";
  }
}

// A pass of the frame graph that draws counts once, for any number of draw calls.
TEST(Compositor, CountsPassesAndDrawCallsSeparately) {
  SceneBuilder builder;
  builder.add(box(0.06, glm::vec4(1.0F)), test::at(0, 0, 0.1));
  builder.add(box(0.05, glm::vec4(1.0F)), test::at(0.1, 0, 0.06));
  Studio studio(builder.build(), test::camera_of(160, 120, 150.0), GlApi::gl33,
                {.msaa = 0, .video_on_cpu = true});
  const Frame frame = test::plain_frame(160, 120, 90);
  studio.draw(frame, FramePlan());
  EXPECT_EQ(studio.stats()[Counter::passes_drawn], 1) << "video only";
  EXPECT_EQ(studio.stats()[Counter::draw_calls], 0) << "the CPU converts the video";

  FramePlan plan = studio.plan(test::tracked(test::look_at({0.0, -0.4, 0.5}, {0.0, 0.0, 0.0})));
  ASSERT_EQ(plan.objects.size(), 2U);
  ASSERT_EQ(plan.shadows.size(), 2U);
  plan.received_shadows.clear();
  FramePlan part = plan;
  part.objects.clear();
  part.shadows.clear();
  studio.draw(frame, part);
  EXPECT_EQ(studio.stats()[Counter::passes_drawn], 1) << "video only";
  part.objects = plan.objects;
  studio.draw(frame, part);
  EXPECT_EQ(studio.stats()[Counter::passes_drawn], 2) << "video and objects";
  EXPECT_EQ(studio.stats()[Counter::draw_calls], 2) << "two objects";
  studio.draw(frame, plan);
  EXPECT_EQ(studio.stats()[Counter::passes_drawn], 3) << "video, objects and shadows";
  EXPECT_GT(studio.stats()[Counter::draw_calls], 2);
  part.phantoms = plan.objects;
  studio.draw(frame, part);
  EXPECT_EQ(studio.stats()[Counter::passes_drawn], 3) << "phantoms are a separate pass";
  EXPECT_EQ(studio.stats()[Counter::draw_calls], 4);

  SceneBuilder glass;
  auto model = std::make_shared<Model>(*box(0.06, glm::vec4(1.0F, 1.0F, 1.0F, 0.5F)));
  model->materials[0].alpha_mode = AlphaMode::blend;
  glass.add(model, test::at(0, 0, 0.1), false);
  Studio seen_through(glass.build(), test::camera_of(160, 120, 150.0));
  seen_through.draw(
      frame, seen_through.plan(test::tracked(test::look_at({0.0, -0.4, 0.5}, {0.0, 0.0, 0.0}))));
  EXPECT_EQ(seen_through.stats()[Counter::passes_drawn], 2)
      << "the video and the translucent object";
}

TEST(Compositor, DrawsVideoInEveryFormat) {
  SceneBuilder empty;
  for (const auto& [api, on_cpu] : {std::pair(GlApi::gl33, false), std::pair(GlApi::gles30, false),
                                    std::pair(GlApi::gl33, true), std::pair(GlApi::gles30, true)}) {
    // In frames of odd size, half of the rightmost and lowest chroma samples lies outside. In large
    // frames a texel is a small fraction of the frame.
    for (const auto& [width, height] : {std::pair{64, 48}, std::pair{37, 23}, std::pair{3841, 3},
                                        std::pair{4096, 2}, std::pair{5, 2161}}) {
      Studio studio(empty.build(), test::camera_of(width, height, 50.0), api,
                    {.msaa = 0, .video_on_cpu = on_cpu});
      for (const PixelFormat format :
           {PixelFormat::grey8, PixelFormat::rgb24, PixelFormat::yuyv, PixelFormat::nv12,
            PixelFormat::yuv420p, PixelFormat::yuv422p, PixelFormat::yuv444p}) {
        for (const ColorMatrix matrix : {ColorMatrix::bt601, ColorMatrix::bt709}) {
          for (const ColorRange range : {ColorRange::full, ColorRange::limited}) {
            const Frame frame = noise_frame(format, width, height, matrix, range);
            const RenderedImage image = studio.draw(frame, FramePlan());
            double worst = 0.0;
            for (int y = 0; y < height; ++y) {
              for (int x = 0; x < width; ++x) {
                const auto expected = reference_rgb(frame, x, y);
                for (std::size_t c = 0; c < 3; ++c)
                  worst = std::max(worst, std::abs(image.at(x, y)[c] - expected[c]));
                ASSERT_EQ(image.at(x, y)[3], 255);
              }
            }
            // A GPU's texture filter may interpolate chroma with 8 bits of weight. The fixed point
            // of the CPU rounds values near the middle of two codes the other way.
            EXPECT_LE(worst, !on_cpu && studio.context().info().software ? 0.51 : 0.6)
                << static_cast<int>(format) << " " << width;
          }
        }
      }
    }
  }
}

Frame test_frame(int width, int height) {
  FrameBuffer buffer = allocate_frame(PixelFormat::yuv420p, width, height);
  const Frame& f = buffer.frame;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x)
      buffer.plane_data[0][y * f.planes[0].stride + x] =
          static_cast<std::uint8_t>(150 + ((x / 16 + y / 16) % 2) * 50);
  }
  for (std::size_t p = 1; p < 3; ++p) {
    for (int y = 0; y < f.planes[p].height; ++y) {
      for (int x = 0; x < f.planes[p].width; ++x)
        buffer.plane_data[p][y * f.planes[p].stride + x] =
            static_cast<std::uint8_t>(p == 1 ? 110 + x % 20 : 140 - y % 20);
    }
  }
  return f;
}

std::shared_ptr<const Scene> busy_scene() {
  SceneBuilder builder;
  ShapeBuilder shape;
  shape.torus(0.06, 0.02, 20, 60);
  builder.add(test::finished(shape.build(), {0.1F, 0.4F, 0.8F, 1.0F}),
              test::at(0.05, 0.0, 0.1, {1, 0, 0}, 0.4));
  builder.add(box(0.06, {0.8F, 0.25F, 0.1F, 1.0F}), test::at(-0.08, 0.04, 0.03));
  builder.add(box(0.05, {0.8F, 0.8F, 0.1F, 1.0F}), test::at(0.0, -0.1, 0.29, {1, 1, 0}, 0.5));
  builder.add(box(0.08, {0.8F, 0.8F, 0.8F, 1.0F}), test::at(0.1, -0.08, 0.04), false, true);
  SceneLight lamp;
  lamp.position = {0.2, -0.3, 0.9};
  lamp.intensity = 0.8;
  builder.scene().lights.push_back(lamp);
  return builder.build();
}

std::vector<CameraPose> views() {
  std::vector<CameraPose> poses;
  for (int i = 0; i < 16; ++i) {
    const double turn = 0.4 * i;
    const double up = 0.08 + 0.05 * (i % 9);
    const Eigen::Vector3d eye(0.45 * std::cos(turn), 0.45 * std::sin(turn), up);
    // The targets vary, so that objects and shadows leave the view on all sides.
    poses.push_back(test::look_at(eye, {0.3 * std::sin(2.1 * i), 0.3 * std::cos(1.3 * i), 0.02}));
  }
  poses.push_back(test::look_at({0.06, 0.01, 0.1}, {0.3, 0.1, 0.05}));  // between the objects
  poses.push_back(test::look_at({0.3, 0.3, -0.2}, {0.0, 0.0, 0.1}));    // from under the table
  poses.push_back(test::look_at({0.3, 0.3, 0.2}, {0.6, 0.6, 0.1}));     // no object in view
  return poses;
}

const std::array<double, 8> kBent = {-0.28, 0.09, 0.0012, -0.0009, -0.006};

// The nightly form draws all views for each technique. The short form draws a third of them, a
// different third for each technique.
std::vector<CameraPose> views_of(ShadowTechnique technique) {
  const std::vector<CameraPose> all = views();
  if (test::nightly()) return all;
  std::vector<CameraPose> some;
  for (std::size_t i = static_cast<std::size_t>(technique) % 3; i < all.size(); i += 3)
    some.push_back(all[i]);
  return some;
}

TEST(Compositor, DrawsSameFrameWhenSkippingInvisibleParts) {
  const auto scene = busy_scene();
  const CameraModel camera = test::camera_of(320, 240, 260.0, DistortionModel::plumb_bob, kBent);
  Studio skipping(scene, camera);
  Studio complete(scene, camera);
  const Frame frame = test_frame(320, 240);
  std::size_t skipped = 0;
  PlanOptions all;
  all.skip = false;
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    PlanOptions options;
    options.technique = all.technique = technique;
    for (const CameraPose& pose : views_of(technique)) {
      const FramePlan plan = skipping.plan(test::tracked(pose), options);
      skipped += plan.skipped.size();
      ASSERT_EQ(skipping.draw(frame, plan),
                complete.draw(frame, complete.plan(test::tracked(pose), all)))
          << name << ", " << pose.translation().transpose();
    }
  }
  EXPECT_GT(skipped, 60U);
}

TEST(Compositor, DrawsSameFrameOnBothApisAndEveryRun) {
  const auto scene = busy_scene();
  const CameraModel camera = test::camera_of(320, 240, 260.0, DistortionModel::plumb_bob, kBent);
  Studio desktop(scene, camera, GlApi::gl33);
  Studio embedded(scene, camera, GlApi::gles30);
  Studio again(scene, camera, GlApi::gl33);
  const Frame frame = test_frame(320, 240);
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    PlanOptions options;
    options.technique = technique;
    for (const CameraPose& pose : views_of(technique)) {
      const FramePlan plan = desktop.plan(test::tracked(pose), options);
      const RenderedImage image = desktop.draw(frame, plan);
      ASSERT_EQ(image, again.draw(frame, plan));
      const RenderedImage other = embedded.draw(frame, plan);
      int differing = 0;
      for (std::size_t i = 0; i < image.rgba.size(); ++i)
        differing += std::abs(image.rgba[i] - other.rgba[i]) > 2 ? 1 : 0;
      EXPECT_LE(differing, 8) << name;
    }
  }
}

TEST(Compositor, UsesPhantomsAsInvisibleOccluders) {
  const CameraModel camera = test::camera_of(320, 240, 300.0);
  const CameraPose pose = test::look_at({0.0, -0.5, 0.3}, {0.0, 0.0, 0.05});
  const Frame frame = test::plain_frame(320, 240, 200);
  SceneBuilder alone;
  alone.add(box(0.12, glm::vec4(1.0F)), test::at(0.0, -0.15, 0.06), false, true);
  Studio phantom(alone.build(), camera);
  EXPECT_EQ(phantom.draw(frame, phantom.plan(test::tracked(pose))),
            phantom.draw(frame, FramePlan()));

  SceneBuilder behind;
  behind.add(box(0.05, {0.9F, 0.1F, 0.1F, 1.0F}), test::at(0.0, 0.05, 0.03));
  Studio open(behind.build(), camera);
  behind.add(box(0.12, glm::vec4(1.0F)), test::at(0.0, -0.15, 0.06), false, true);
  Studio hidden(behind.build(), camera);
  const auto changed = [&](Studio& studio) {
    const RenderedImage a = studio.draw(frame, studio.plan(test::tracked(pose)));
    int count = 0;
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 320; ++x) count += a.red(x, y) != 200 ? 1 : 0;
    }
    return count;
  };
  const int seen = changed(open);
  EXPECT_GT(seen, 300);
  EXPECT_LT(changed(hidden), seen / 3);
}

TEST(Compositor, DrawsNoShadowForCameraBehindPlane) {
  SceneBuilder builder;
  builder.add(box(0.1, glm::vec4(1.0F)), test::at(0, 0, 0.2));
  Studio studio(builder.build(), test::camera_of(320, 240, 300.0));
  for (const bool skip : {true, false}) {
    PlanOptions options;
    options.skip = skip;
    const FramePlan plan =
        studio.plan(test::tracked(test::look_at({0, -0.3, -0.3}, {0, 0, 0})), options);
    EXPECT_TRUE(plan.shadows.empty());
    EXPECT_EQ(plan.objects.size(), 1U);
  }
}

TEST(Compositor, FadesOutCoastingPose) {
  SceneBuilder builder;
  builder.add(box(0.1, {0.9F, 0.1F, 0.1F, 1.0F}), test::at(0, 0, 0.15));
  Studio studio(builder.build(), test::camera_of(320, 240, 300.0));
  PoseEstimate pose = test::tracked(test::look_at({0, -0.3, 0.4}, {0, 0, 0.05}));
  const Frame frame = test::plain_frame(320, 240, 200);
  for (const LayerDrawing layers : {LayerDrawing::direct, LayerDrawing::mask}) {
    PlanOptions options;
    options.layers = layers;
    pose.status = TrackStatus::tracked;
    pose.age_s = 0.0;
    const RenderedImage full = studio.draw(frame, studio.plan(pose, options));
    pose.status = TrackStatus::held;
    pose.age_s = 0.25;
    const RenderedImage half = studio.draw(frame, studio.plan(pose, options));
    // The mask's values are rounded in both frames, which adds to the difference.
    const double tolerance = layers == LayerDrawing::direct ? 1.01 : 1.01 + 0.5 * 200 / 255 * 1.5;
    for (std::size_t i = 0; i < full.rgba.size(); ++i) {
      if (i % 4 == 3) {
        ASSERT_EQ(half.rgba[i], 255);
      } else {
        ASSERT_NEAR(half.rgba[i], 0.5 * (full.rgba[i] + 200), tolerance);
      }
    }
  }
  pose.age_s = 0.6;
  EXPECT_FALSE(studio.plan(pose).has_pose);
}

TEST(Compositor, RejectsFrameOfOtherSize) {
  SceneBuilder builder;
  Studio studio(builder.build(), test::camera_of(64, 48, 60.0));
  const auto drawn = studio.compositor().draw(test::plain_frame(48, 64, 0), FramePlan());
  ASSERT_FALSE(drawn);
  EXPECT_THAT(drawn.error().message, testing::HasSubstr("48 x 64"));
}

TEST(Compositor, ReportsDriverErrorInSameFrame) {
  SceneBuilder builder;
  Studio studio(builder.build(), test::camera_of(64, 48, 60.0));
  const Frame frame = test::plain_frame(64, 48, 0);
  glEnable(0xFFFF);  // an invalid capability
  const auto drawn = studio.compositor().draw(frame, FramePlan());
  ASSERT_FALSE(drawn);
  EXPECT_THAT(drawn.error().message, testing::HasSubstr("frame 0: the graphics driver refuses"));
  EXPECT_THAT(drawn.error().message, testing::HasSubstr("0x500"));
  EXPECT_TRUE(studio.compositor().draw(frame, FramePlan()))
      << "an error is reported for its own frame only";
}

PFNGLGETERRORPROC driver_get_error = nullptr;
GLenum simulated_error = GL_NO_ERROR;
GLenum get_error() {
  return simulated_error == GL_NO_ERROR ? driver_get_error() : simulated_error;
}

// Simulates a driver that reports a reset at every query, and a driver that is out of memory.
TEST(Compositor, ReportsLostContextInOneLine) {
  SceneBuilder builder;
  Studio studio(builder.build(), test::camera_of(64, 48, 60.0));
  const Frame frame = test::plain_frame(64, 48, 0);
  ASSERT_TRUE(studio.compositor().draw(frame, FramePlan()));
  std::vector<std::uint8_t> rgba(std::size_t{4} * 64 * 48);
  driver_get_error = epoxy_glGetError;
  epoxy_glGetError = get_error;
  for (const auto& [error, what] :
       {std::pair(GL_CONTEXT_LOST, "was reset"), std::pair(GL_OUT_OF_MEMORY, "out of memory")}) {
    simulated_error = static_cast<GLenum>(error);
    const auto drawn = studio.compositor().draw(frame, FramePlan());
    const auto read = studio.compositor().read_back(rgba);
    simulated_error = GL_NO_ERROR;
    for (const auto& result : {drawn, read}) {
      ASSERT_FALSE(result);
      EXPECT_THAT(result.error().message, testing::HasSubstr(what));
      EXPECT_THAT(result.error().message, testing::Not(testing::HasSubstr("\n")));
    }
    EXPECT_TRUE(studio.compositor().draw(frame, FramePlan()));
  }
  epoxy_glGetError = driver_get_error;
}

PFNGLGETGRAPHICSRESETSTATUSPROC driver_reset_status = nullptr;
bool driver_was_reset = false;
GLenum reset_status() {
  return driver_was_reset ? GL_UNKNOWN_CONTEXT_RESET : driver_reset_status();
}

// Some drivers report a reset only when asked.
TEST(Compositor, DetectsDriverReset) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const auto context = create_offscreen_context(api);
    ASSERT_TRUE(context);
    EXPECT_TRUE((*context)->info().reports_resets) << "Mesa's software rasterisers report resets";
    SceneBuilder builder;
    const auto camera = test::camera_of(64, 48, 60.0);
    auto compositor = Compositor::create(**context, builder.build(), camera);
    ASSERT_TRUE(compositor);
    const Frame frame = test::plain_frame(64, 48, 0);
    EXPECT_TRUE(compositor->draw(frame, FramePlan()));
    driver_reset_status = epoxy_glGetGraphicsResetStatus;
    epoxy_glGetGraphicsResetStatus = reset_status;
    driver_was_reset = true;
    const auto drawn = compositor->draw(frame, FramePlan());
    const auto made = Compositor::create(**context, builder.build(), camera);
    GlInfo silent = (*context)->info();
    silent.reports_resets = false;
    EXPECT_FALSE(take_gl_error(silent)) << "no query if the context can't report resets";
    driver_was_reset = false;
    epoxy_glGetGraphicsResetStatus = driver_reset_status;
    ASSERT_FALSE(drawn);
    EXPECT_THAT(drawn.error().message, testing::HasSubstr("was reset"));
    ASSERT_FALSE(made);
    EXPECT_THAT(made.error().message, testing::HasSubstr("was reset"));
    EXPECT_TRUE(compositor->draw(frame, FramePlan()));
  }
}

// Errors that occur while models and textures are uploaded are reported before the first frame.
TEST(Compositor, ReportsDriverErrorWhileLoadingScene) {
  const auto context = create_offscreen_context();
  ASSERT_TRUE(context);
  SceneBuilder builder;
  glEnable(0xFFFF);
  const auto made = Compositor::create(**context, builder.build(), test::camera_of(64, 48, 60.0));
  ASSERT_FALSE(made);
  EXPECT_THAT(made.error().message, testing::StartsWith("test.json: the graphics driver refuses"));
  EXPECT_TRUE(Compositor::create(**context, builder.build(), test::camera_of(64, 48, 60.0)));
}

TEST(Framebuffer, RejectsSizeBeyondDriverLimit) {
  const auto context = create_offscreen_context();
  ASSERT_TRUE(context);
  const auto made = Framebuffer::create(10'000'000, 48);
  ASSERT_FALSE(made);
  EXPECT_THAT(made.error().message, testing::HasSubstr("10000000 x 48 px is too large"));
}

TEST(GlError, DescribesCauseAndRemedy) {
  EXPECT_THAT(gl_error_text(GL_OUT_OF_MEMORY), testing::HasSubstr("out of memory; use a smaller"));
  EXPECT_THAT(gl_error_text(GL_CONTEXT_LOST), testing::HasSubstr("was reset"));
  EXPECT_THAT(gl_error_text(GL_INVALID_OPERATION), testing::HasSubstr("refuses"));
  EXPECT_THAT(gl_error_text(0x9999), testing::HasSubstr("0x9999"));
  // Several pending errors are read by one call, which returns the first error.
  const auto context = create_offscreen_context();
  ASSERT_TRUE(context);
  EXPECT_FALSE(take_gl_error((*context)->info()));
  for (int i = 0; i < 3; ++i) glEnable(0xFFFF);
  EXPECT_EQ(take_gl_error((*context)->info()), static_cast<unsigned>(GL_INVALID_ENUM));
  EXPECT_FALSE(take_gl_error((*context)->info()));
}

TEST(Compositor, RejectsMoreLightsThanSupported) {
  SceneBuilder builder;
  builder.scene().lights.resize(9);
  const auto context = create_offscreen_context();
  ASSERT_TRUE(context);
  const auto made = Compositor::create(**context, builder.build(), test::camera_of(64, 48, 60.0));
  ASSERT_FALSE(made);
  EXPECT_THAT(made.error().message, testing::HasSubstr("lights: 9"));
}

TEST(Shader, ReportsFileAndLineOfError) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const auto context = create_offscreen_context(api);
    ASSERT_TRUE(context) << context.error().message;
    const std::array<ShaderText, 2> vertex = {
        ShaderText{"first.glsl", "vec4 place() {\n  return vec4(0.0);\n}\n"},
        ShaderText{"second.glsl", "void main() {\n  gl_Position = plase();\n}\n"}};
    const std::array<ShaderText, 1> fragment = {ShaderText{"f.glsl", "void main() {}\n"}};
    const auto program = ShaderProgram::link_texts(api, vertex, fragment);
    ASSERT_FALSE(program);
    EXPECT_THAT(program.error().message, testing::HasSubstr("second.glsl:2"));
  }
}

TEST(GlContext, ReportsRendererAndApi) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const auto context = create_offscreen_context(api);
    ASSERT_TRUE(context) << context.error().message;
    EXPECT_FALSE((*context)->info().renderer.empty());
    EXPECT_EQ((*context)->info().api, api);
    EXPECT_TRUE((*context)->poll_events());
    EXPECT_EQ((*context)->window_size().width, 0);
  }
}

TEST(Compositor, ReportsImageBeyondDriverLimit) {
  const auto plain = box(0.05, glm::vec4(1.0F));
  auto model = std::make_shared<Model>(*plain);
  constexpr int kWidth = 1 << 17;  // more than any driver supports
  model->textures.push_back(std::make_shared<const Texture>(
      Texture{kWidth, 1, std::vector<std::uint8_t>(std::size_t{4} * kWidth, std::uint8_t{200})}));
  model->materials[0].base_color_texture.image = 0;
  SceneBuilder builder;
  builder.add(plain, test::at(0.0, 0.0, 0.1));
  builder.add(model, test::at(0.1, 0.0, 0.1));
  builder.scene().objects[1].model_file = "wide.glb";
  auto context = create_offscreen_context(GlApi::gl33);
  ASSERT_TRUE(context) << context.error().message;
  const auto compositor =
      Compositor::create(**context, builder.build(), test::camera_of(64, 64, 60.0), {});
  ASSERT_FALSE(compositor);
  EXPECT_THAT(compositor.error().message,
              testing::MatchesRegex("test.json: object \"object2\": an image of its model wide.glb "
                                    "is 131072 x 1 px, and this graphics driver takes [0-9]+ px "
                                    "along a side at most; make the image smaller"));
}

}  // namespace
}  // namespace penumbra
