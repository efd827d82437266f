// Translucency modes of shadows and fading overlays: density and nesting of patterns, agreement of
// retexturing and blending. Only `blend` may enable blending.
#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <random>
#include <set>
#include <span>
#include <string>

#include "render/gl/fragment_probe.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/passes/translucent_program.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"
#include "support/test_form.hpp"

namespace penumbra::translucency_test {
namespace {

using test::box;
using test::RenderedImage;
using test::ring;
using test::SceneBuilder;
using test::Studio;

constexpr int kWidth = 320;
constexpr int kHeight = 240;
constexpr std::array kWithoutBlending = {Translucency::mesh, Translucency::retexture,
                                         Translucency::geometry_mesh};
const std::array<double, 8> kBent = {-0.28, 0.09, 0.0012, -0.0009, -0.006};

CameraModel undistorted_camera() {
  return test::camera_of(kWidth, kHeight, 300.0);
}
CameraModel distorted_camera() {
  return test::camera_of(kWidth, kHeight, 260.0, DistortionModel::plumb_bob, kBent);
}
Frame white() {
  return test::plain_frame(kWidth, kHeight, 255);
}
Frame noise(PixelFormat format, int width = kWidth, int height = kHeight) {
  FrameBuffer buffer = allocate_frame(format, width, height);
  std::mt19937 random(11);
  for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
    const PixelPlane& plane = buffer.frame.planes[i];
    const std::ptrdiff_t bytes = plane.stride * plane.height;
    for (std::ptrdiff_t j = 0; j < bytes; ++j)
      buffer.plane_data[i][j] = static_cast<std::uint8_t>(random() & 0xFFU);
  }
  buffer.frame.color_matrix = ColorMatrix::bt709;
  buffer.frame.color_range = ColorRange::limited;
  return buffer.frame;
}

// A plate, seen from above, whose three layers are visible side by side.
SceneBuilder plate(const LightFractions& fractions) {
  SceneBuilder builder;
  builder.add(box(0.12, 0.12, 0.004), test::at(0.0, 0.0, 0.1));
  builder.scene().shadows[0].layered = make_layered_constants(0.6, 3.0, 0.0).value();
  builder.scene().shadows[0].fractions = fractions;
  return builder;
}
PoseEstimate above() {
  return test::tracked(test::look_at({0.02, -0.06, 0.45}, {0.0, 0.0, 0.0}));
}

// A table with casters, a phantom, two lights, and a wall with an outline.
SceneBuilder busy() {
  SceneBuilder builder;
  builder.add(ring(), test::at(0.05, 0.0, 0.1, {1, 0, 0}, 0.4));
  builder.add(box(0.06, 0.06, 0.06), test::at(-0.08, 0.04, 0.03));
  builder.add(box(0.05, 0.05, 0.05), test::at(0.0, -0.1, 0.17, {1, 1, 0}, 0.5));
  builder.add(box(0.09, 0.09, 0.06), test::at(0.06, 0.0, 0.03), false, true);
  ScenePlane& wall = builder.scene().planes.emplace_back();
  wall.name = "wall";
  wall.normal = {0, -1, 0};
  wall.point = {0, 0.15, 0};
  wall.outline = {{-0.2, 0.0}, {0.2, 0.0}, {0.2, 0.2}, {-0.2, 0.2}};
  builder.scene().shadows[0].walls = {1};
  SceneLight lamp;
  lamp.name = "lamp";
  lamp.position = {0.2, -0.3, 0.9};
  lamp.intensity = 0.8;
  builder.scene().lights.push_back(lamp);
  lamp.name = "other";
  lamp.position = {-0.5, -0.4, 0.7};
  lamp.color = {1.0, 0.7, 0.4};
  builder.scene().lights.push_back(lamp);
  builder.scene().shadows[0].lights = {0, 1};
  return builder;
}
// The node casts onto both planes, so that the phantom receives shadows from two directions.
SceneBuilder busy_on_both() {
  SceneBuilder builder = busy();
  builder.scene().shadows[0].planes = {0, 1};
  return builder;
}
std::vector<CameraPose> views() {
  return {test::look_at({0.3, -0.5, 0.4}, {0.0, 0.0, 0.05}),
          test::look_at({-0.2, -0.4, 0.25}, {0.1, 0.0, 0.02}),
          test::look_at({0.05, -0.1, 0.6}, {0.0, 0.0, 0.0}),
          test::look_at({0.06, 0.01, 0.13}, {0.3, 0.1, 0.05}),
          test::look_at({0.5, -0.2, 0.2}, {0.4, 0.4, 0.0})};
}

// The nightly form draws all views for each case. The short form draws one view, a different one
// for each case.
std::vector<CameraPose> views_of_case(std::size_t number) {
  const std::vector<CameraPose> all = views();
  if (test::nightly()) return all;
  return {all[number % all.size()]};
}

PlanOptions options_of(Translucency mode, ShadowTechnique technique = ShadowTechnique::layered) {
  PlanOptions options;
  options.translucency = mode;
  options.technique = technique;
  return options;
}

bool is_black(const RenderedImage& image, int x, int y) {
  return image.at(x, y)[0] == 0 && image.at(x, y)[1] == 0 && image.at(x, y)[2] == 0;
}
int black_pixels(const RenderedImage& image) {
  int count = 0;
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) count += is_black(image, x, y) ? 1 : 0;
  }
  return count;
}
bool black_pixels_are_subset(const RenderedImage& lighter, const RenderedImage& darker) {
  for (int y = 0; y < lighter.height; ++y) {
    for (int x = 0; x < lighter.width; ++x) {
      if (is_black(lighter, x, y) && !is_black(darker, x, y)) return false;
    }
  }
  return true;
}
// Returns the allowed difference between two shader programs: a GPU may round differently, software
// OpenGL does not.
int rounding_grey_levels(Studio& studio) {
  return studio.context().info().software ? 0 : 1;
}

int largest_difference(const RenderedImage& a, const RenderedImage& b) {
  int largest = 0;
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    largest =
        std::max(largest, std::abs(static_cast<int>(a.rgba[i]) - static_cast<int>(b.rgba[i])));
  return largest;
}

void keep_layer(FramePlan& plan, int layer) {
  for (ShadowDraw& draw : plan.shadows) {
    draw.umbra = layer == 0;
    draw.middle = layer == 1;
    draw.penumbra = layer == 2;
  }
}

TEST(Translucency, RoundTripsEveryName) {
  for (const auto& [mode, name] : kTranslucencyNames) {
    EXPECT_EQ(to_string(mode), name);
    EXPECT_EQ(value_named(kTranslucencyNames, name), mode);
  }
  EXPECT_FALSE(value_named(kTranslucencyNames, "glass"));
}

TEST(Translucency, SelectsRequestedOrSupportedMode) {
  for (const bool blends : {false, true}) {
    for (const bool fetches : {false, true}) {
      const FragmentAbilities abilities{blends, fetches};
      for (const Translucency mode : kWithoutBlending)
        EXPECT_EQ(choose_translucency(mode, abilities), mode);
      EXPECT_EQ(choose_translucency(Translucency::blend, abilities), Translucency::blend);
      EXPECT_EQ(choose_translucency(Translucency::automatic, abilities),
                blends    ? Translucency::blend
                : fetches ? Translucency::retexture
                          : Translucency::mesh);
    }
  }
}

// In a 4 x 4 block of pixels inside one layer, the fraction of unchanged pixels must equal the
// layer's light fraction to within half a pixel. Blocks may lie at any position.
TEST(ScreenDoor, MatchesLightFractionsByDensity) {
  struct Case {
    LightFractions fractions;
    std::array<int, 3> black;  // black pixels of 16
  };
  for (const Case& c : {Case{{0.0625, 0.4375, 0.8125}, {15, 9, 3}},
                        Case{{0.15, 0.4, 0.83}, {14, 10, 3}}, Case{{0.0, 0.5, 1.0}, {16, 8, 0}}}) {
    for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
      Studio studio(plate(c.fractions).build(), undistorted_camera(), api);
      const RenderedImage blended =
          studio.draw_shadows(white(), studio.plan(above(), options_of(Translucency::blend)));
      const FramePlan plan = studio.plan(above(), options_of(Translucency::mesh));
      const RenderedImage mesh = studio.draw_shadows(white(), plan);
      const glm::vec3 light = layer_light(plan.shadows.at(0));
      std::array<int, 3> blocks{};
      for (int y = 0; y + 4 <= kHeight; ++y) {
        for (int x = 0; x + 4 <= kWidth; ++x) {
          const int code = blended.red(x, y);
          bool uniform = true;
          int black = 0;
          for (int dy = 0; dy < 4; ++dy) {
            for (int dx = 0; dx < 4; ++dx) {
              uniform = uniform && blended.red(x + dx, y + dy) == code;
              black += is_black(mesh, x + dx, y + dy) ? 1 : 0;
            }
          }
          if (!uniform || (code == 255 && c.fractions.penumbra < 1.0)) continue;
          for (int layer = 0; layer < 3; ++layer) {
            if (std::abs(code - 255.0 * static_cast<double>(light[layer])) > 0.6) continue;
            ++blocks[static_cast<std::size_t>(layer)];
            ASSERT_EQ(black, c.black[static_cast<std::size_t>(layer)]) << x << " " << y;
          }
        }
      }
      for (const int count : blocks) EXPECT_GT(count, 500);
      EXPECT_EQ(studio.stats().translucency, Translucency::mesh);
    }
  }
}

// Pixels that are dark in one pattern are dark in every darker pattern. Layers and casters can
// therefore be drawn in any order, separately or together.
// (DrawnMask.CoversSamePixelsAsDirectScreenDoor tests the graded edges of masks.)
TEST(ScreenDoor, NestsDarkerPatterns) {
  SceneBuilder builder = plate({0.15, 0.4, 0.83});
  builder.add(ring(), test::at(0.04, 0.03, 0.06));
  Studio studio(builder.build(), distorted_camera());
  PlanOptions options = options_of(Translucency::mesh);
  options.layers = LayerDrawing::direct;
  FramePlan plan = studio.plan(above(), options);
  const RenderedImage whole = studio.draw_shadows(white(), plan);
  std::array<RenderedImage, 3> layers;
  RenderedImage together = studio.draw(white(), FramePlan());
  for (int layer = 0; layer < 3; ++layer) {
    FramePlan alone = plan;
    keep_layer(alone, layer);
    RenderedImage& image = layers[static_cast<std::size_t>(layer)];
    image = studio.draw_shadows(white(), alone);
    EXPECT_GT(black_pixels(image), 200);
    EXPECT_TRUE(black_pixels_are_subset(image, whole));
    for (std::size_t i = 0; i < together.rgba.size(); ++i)
      together.rgba[i] = std::min(together.rgba[i], image.rgba[i]);
  }
  EXPECT_EQ(together, whole);
  // Overlapping layers of one caster must darken the same pixels.
  FramePlan solid = plan;
  for (ShadowDraw& draw : solid.shadows) draw.fractions = {0.0, 0.0, 0.0};
  std::array<RenderedImage, 3> masks;
  for (int layer = 0; layer < 3; ++layer) {
    FramePlan alone = solid;
    keep_layer(alone, layer);
    masks[static_cast<std::size_t>(layer)] = studio.draw_shadows(white(), alone);
  }
  int compared = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (std::size_t dark = 0; dark < 2; ++dark) {
        if (!is_black(masks[dark], x, y) || !is_black(masks[dark + 1], x, y)) continue;
        ++compared;
        ASSERT_TRUE(!is_black(layers[dark + 1], x, y) || is_black(layers[dark], x, y)) << x << y;
      }
    }
  }
  EXPECT_GT(compared, 1000);

  std::ranges::reverse(plan.shadows);
  EXPECT_EQ(studio.draw_shadows(white(), plan), whole);
}

// The opacity of a fading pose scales the fraction of pattern pixels.
TEST(ScreenDoor, ThinsOutWithFadingPose) {
  SceneBuilder builder;
  builder.add(box(0.2, 0.2, 0.02), test::at(0, 0, 0.01), false);
  Studio studio(builder.build(), undistorted_camera());
  PoseEstimate pose = above();
  const RenderedImage solid =
      studio.draw(white(), studio.plan(pose, options_of(Translucency::mesh)));
  pose.status = TrackStatus::held;
  pose.age_s = 0.25;
  const FramePlan plan = studio.plan(pose, options_of(Translucency::mesh));
  ASSERT_NEAR(plan.overlay_opacity, 0.5, 1e-6);
  const RenderedImage faint = studio.draw(white(), plan);
  int of_object = 0;
  int seen = 0;
  for (int y = 90; y < 90 + 60; ++y) {
    for (int x = 130; x < 130 + 60; ++x) {
      ASSERT_NE(solid.red(x, y), 255);
      const bool object = std::equal(faint.at(x, y), faint.at(x, y) + 4, solid.at(x, y));
      of_object += object ? 1 : 0;
      seen += faint.red(x, y) == 255 ? 1 : 0;
    }
  }
  EXPECT_EQ(of_object, 60 * 60 / 2);
  EXPECT_EQ(seen, 60 * 60 / 2);
}

// Retexturing has the shader's conversion of the video.
constexpr CompositorOptions kVideoByShader = {.msaa = 0, .video_on_cpu = false};

// Retexturing must equal blending up to rounding: for shadows on planes, phantoms and objects, of
// several lights, and for fading overlays.
TEST(Retexture, MatchesBlending) {
  const std::array builders = {busy(), busy_on_both()};
  for (const SceneBuilder& builder : builders) {
    for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
      // The short form draws each scene with one API.
      const bool first = &builder == &builders.front();
      if (!test::nightly() && first != (api == GlApi::gles30)) continue;
      Studio studio(builder.build(), distorted_camera(), api, kVideoByShader);
      const Frame frame = noise(PixelFormat::nv12);
      const auto poses = views();
      // Both APIs give the same frame (Translucency.DrawsSameFrameOnBothApis).
      const std::size_t count = test::nightly() && api == GlApi::gl33 ? 3 : 1;
      for (const auto& [technique, name] : kShadowTechniqueNames) {
        for (const CameraPose& view : std::span(poses).first(count)) {
          for (const double age_s : {0.0, 0.25}) {
            PoseEstimate pose = test::tracked(view);
            if (age_s > 0.0) pose.status = TrackStatus::held;
            pose.age_s = age_s;
            const auto draw = [&](Translucency mode) {
              return studio.draw(frame, studio.plan(pose, options_of(mode, technique)));
            };
            // Blending rounds a faint object in a shadow twice, and a shadow under a pane.
            const bool twice = age_s > 0.0 || technique == ShadowTechnique::walls;
            EXPECT_LE(largest_difference(draw(Translucency::blend), draw(Translucency::retexture)),
                      rounding_grey_levels(studio) + (twice ? 2 : 1))
                << name << " " << age_s;
          }
        }
      }
    }
  }
}

// A plane may lie in front of an object. Retexturing must keep the object there, even where a mask
// is empty.
TEST(Retexture, KeepsShadowsOnObjectsBehindPlane) {
  SceneBuilder builder = busy_on_both();
  builder.add(box(0.4, 0.004, 0.2), test::at(0.0, 0.154, 0.1));   // behind the wall's plane
  builder.add(box(0.2, 0.2, 0.02), test::at(0.05, 0.0, -0.015));  // below the table
  builder.scene().shadows[0].casters = {0, 1, 2};
  Studio studio(builder.build(), distorted_camera(), GlApi::gl33, kVideoByShader);
  const Frame frame = noise(PixelFormat::yuyv);
  std::size_t cases = 0;
  for (const ShadowTechnique technique : {ShadowTechnique::layered, ShadowTechnique::field,
                                          ShadowTechnique::simple, ShadowTechnique::walls}) {
    ++cases;
    for (const LayerDrawing layers : {LayerDrawing::mask, LayerDrawing::direct}) {
      ++cases;
      for (const std::size_t number : {0U, 1U}) {
        // The short form draws one view of each case; every technique and drawing mode has both.
        if (!test::nightly() && number != cases % 2) continue;
        const CameraPose view = views()[number];
        const auto draw = [&](Translucency mode, bool skip) {
          PlanOptions options = options_of(mode, technique);
          options.layers = layers;
          options.skip = skip;
          return studio.draw(frame, studio.plan(test::tracked(view), options));
        };
        const RenderedImage blended = draw(Translucency::blend, true);
        const RenderedImage retextured = draw(Translucency::retexture, true);
        EXPECT_LE(largest_difference(blended, retextured), 1);
        EXPECT_EQ(retextured, draw(Translucency::retexture, false));
      }
    }
  }
}

// A frame with faint rays is the mean of a frame with solid rays and one without rays.
TEST(Retexture, BlendsRaysOnceWhileOverlayFades) {
  Studio studio(busy().build(), distorted_camera());
  const Frame frame = noise(PixelFormat::nv12);
  const auto draw = [&](bool faint, bool rays) {
    PoseEstimate pose = test::tracked(views().front());
    if (faint) pose.status = TrackStatus::held;
    pose.age_s = faint ? 0.25 : 0.0;
    PlanOptions options = options_of(Translucency::retexture, ShadowTechnique::hard);
    options.light_rays = rays;
    return studio.draw(frame, studio.plan(pose, options));
  };
  const RenderedImage solid = draw(false, true);
  const RenderedImage solid_without = draw(false, false);
  const RenderedImage faint = draw(true, true);
  const RenderedImage faint_without = draw(true, false);
  int rays = 0;
  int wrong = 0;
  for (std::size_t i = 0; i < solid.rgba.size(); i += 4) {
    const bool ray = !std::equal(&solid.rgba[i], &solid.rgba[i] + 4, &solid_without.rgba[i]);
    rays += ray ? 1 : 0;
    for (std::size_t c = i; c < i + 3; ++c) {
      const double expected =
          ray ? 0.5 * (solid.rgba[c] + faint_without.rgba[c]) : faint_without.rgba[c];
      wrong += std::abs(faint.rgba[c] - expected) > 1.01 ? 1 : 0;
    }
  }
  // A GPU may resolve the depth test differently where a ray and an object have almost the same
  // depth.
  EXPECT_LE(wrong, 3 * rounding_grey_levels(studio));
  EXPECT_GT(rays, 500);
}

TEST(Retexture, FetchesEveryVideoFormat) {
  Studio studio(plate({0.15, 0.4, 0.83}).build(), undistorted_camera());
  for (const PixelFormat format :
       {PixelFormat::grey8, PixelFormat::rgb24, PixelFormat::yuyv, PixelFormat::nv12,
        PixelFormat::yuv420p, PixelFormat::yuv422p, PixelFormat::yuv444p}) {
    for (const ShadowTechnique technique : {ShadowTechnique::layered, ShadowTechnique::field}) {
      const Frame frame = noise(format);
      const auto draw = [&](Translucency mode) {
        return studio.draw_shadows(frame, studio.plan(above(), options_of(mode, technique)));
      };
      const RenderedImage blended = draw(Translucency::blend);
      EXPECT_LE(largest_difference(blended, draw(Translucency::retexture)),
                1 + rounding_grey_levels(studio));
      EXPECT_GT(largest_difference(blended, studio.draw(frame, FramePlan())), 40);
    }
  }
}

// Counts of draw calls since the latest Watch was created.
struct Watched {
  std::int64_t draws = 0, blended = 0, stencilled = 0;
};
Watched watched;
void watch() {
  ++watched.draws;
  watched.blended += glIsEnabled(GL_BLEND) == GL_TRUE ? 1 : 0;
  watched.stencilled += glIsEnabled(GL_STENCIL_TEST) == GL_TRUE ? 1 : 0;
}
PFNGLDRAWARRAYSPROC driver_draw_arrays;
PFNGLDRAWELEMENTSPROC driver_draw_elements;
PFNGLDRAWARRAYSINSTANCEDPROC driver_draw_arrays_instanced;
PFNGLDRAWELEMENTSINSTANCEDPROC driver_draw_elements_instanced;
void draw_arrays(GLenum mode, GLint first, GLsizei count) {
  watch();
  driver_draw_arrays(mode, first, count);
}
void draw_elements(GLenum mode, GLsizei count, GLenum type, const void* indices) {
  watch();
  driver_draw_elements(mode, count, type, indices);
}
void draw_arrays_instanced(GLenum mode, GLint first, GLsizei count, GLsizei instances) {
  watch();
  driver_draw_arrays_instanced(mode, first, count, instances);
}
void draw_elements_instanced(GLenum mode, GLsizei count, GLenum type, const void* indices,
                             GLsizei instances) {
  watch();
  driver_draw_elements_instanced(mode, count, type, indices, instances);
}
// Replaces the driver's draw functions by functions that record the OpenGL state in `watched`.
class Watch {
 public:
  Watch() {
    watched = {};
    driver_draw_arrays = epoxy_glDrawArrays;
    driver_draw_elements = epoxy_glDrawElements;
    driver_draw_arrays_instanced = epoxy_glDrawArraysInstanced;
    driver_draw_elements_instanced = epoxy_glDrawElementsInstanced;
    epoxy_glDrawArrays = draw_arrays;
    epoxy_glDrawElements = draw_elements;
    epoxy_glDrawArraysInstanced = draw_arrays_instanced;
    epoxy_glDrawElementsInstanced = draw_elements_instanced;
  }
  Watch(const Watch&) = delete;
  Watch& operator=(const Watch&) = delete;
  ~Watch() {
    epoxy_glDrawArrays = driver_draw_arrays;
    epoxy_glDrawElements = driver_draw_elements;
    epoxy_glDrawArraysInstanced = driver_draw_arrays_instanced;
    epoxy_glDrawElementsInstanced = driver_draw_elements_instanced;
  }
};

TEST(Translucency, EnablesBlendingOnlyInBlendMode) {
  // The OpenGL state does not depend on the frame's size.
  constexpr int kSmallWidth = kWidth / 4;
  constexpr int kSmallHeight = kHeight / 4;
  Studio studio(busy_on_both().build(), test::camera_of(kSmallWidth, kSmallHeight, 65.0,
                                                        DistortionModel::plumb_bob, kBent));
  const Frame frame = noise(PixelFormat::yuv420p, kSmallWidth, kSmallHeight);
  const RenderedImage video = studio.draw(frame, FramePlan());
  std::size_t cases = 0;
  const auto draw_all = [&](Translucency mode, LayerDrawing layers) {
    for (const auto& [technique, name] : kShadowTechniqueNames) {
      ++cases;
      for (const bool faint : {false, true}) {
        // The short form draws each case once. Each technique alternates between solid and faint.
        if (!test::nightly() && faint != (cases % 2 == 0)) continue;
        PoseEstimate pose = test::tracked(views().front());
        if (faint) pose.status = TrackStatus::held;
        pose.age_s = faint ? 0.25 : 0.0;
        PlanOptions options = options_of(mode, technique);
        options.light_rays = true;
        options.layers = layers;
        ASSERT_NE(studio.draw(frame, studio.plan(pose, options)), video) << name;
      }
    }
    if (kShadowTechniqueNames.size() % 2 == 0) ++cases;
  };
  constexpr std::array kLayers = {LayerDrawing::direct, LayerDrawing::mask};
  // The first draws load the driver's functions, which the test then replaces.
  for (const LayerDrawing layers : kLayers) draw_all(Translucency::blend, layers);
  for (const LayerDrawing layers : kLayers) {
    for (const Translucency mode : kWithoutBlending) {
      const Watch watch;
      draw_all(mode, layers);
      EXPECT_GT(watched.draws, test::nightly() ? 100 : 50);
      EXPECT_EQ(watched.blended, 0) << to_string(mode);
    }
    const Watch watch;
    draw_all(Translucency::blend, layers);
    ++cases;  // with masks, cases that were solid are faint, and vice versa
    EXPECT_GT(watched.blended, test::nightly() ? 30 : 15);
  }
}

// On an unbounded plane, only blending needs the stencil.
TEST(Translucency, NeedsNoStencilForMeshAndRetextureOnTable) {
  SceneBuilder builder = busy();
  builder.scene().planes.resize(1);
  builder.scene().shadows[0].walls.clear();
  Studio studio(builder.build(), distorted_camera());
  const Frame frame = noise(PixelFormat::yuyv);
  const auto stencilled = [&](Translucency mode) {
    const auto draw = [&] {
      (void)studio.draw(frame, studio.plan(test::tracked(views().front()), options_of(mode)));
    };
    draw();
    const Watch watch;
    draw();
    EXPECT_GT(watched.draws, 5);
    return watched.stencilled;
  };
  EXPECT_EQ(stencilled(Translucency::blend), 2);
  EXPECT_EQ(stencilled(Translucency::mesh), 0);
  EXPECT_EQ(stencilled(Translucency::retexture), 0);
}

TEST(Translucency, DrawsSameFrameWhenSkippingInvisibleParts) {
  const auto scene = busy_on_both().build();
  Studio with(scene, distorted_camera());
  Studio without(scene, distorted_camera());
  const Frame frame = noise(PixelFormat::nv12);
  std::size_t cases = 0;
  std::size_t skipped = 0;
  for (const Translucency mode : kWithoutBlending) {
    for (const auto& [technique, name] : kShadowTechniqueNames) {
      PlanOptions some = options_of(mode, technique);
      PlanOptions all = some;
      all.skip = false;
      for (const CameraPose& view : views_of_case(cases++)) {
        const FramePlan plan = with.plan(test::tracked(view), some);
        skipped += plan.skipped.size();
        const RenderedImage skipping = with.draw(frame, plan);
        const RenderedImage whole = without.draw(frame, without.plan(test::tracked(view), all));
        ASSERT_LE(largest_difference(skipping, whole), rounding_grey_levels(with))
            << to_string(mode) << " " << name << " " << view.translation().transpose();
      }
    }
  }
  EXPECT_GT(skipped, 30U);
}

TEST(Translucency, DrawsSameFrameOnBothApis) {
  const auto scene = busy_on_both().build();
  Studio desktop(scene, distorted_camera(), GlApi::gl33);
  Studio embedded(scene, distorted_camera(), GlApi::gles30);
  const Frame frame = noise(PixelFormat::nv12);
  std::size_t cases = 0;
  for (const Translucency mode : kWithoutBlending) {
    for (const auto& [technique, name] : kShadowTechniqueNames) {
      for (const CameraPose& view : views_of_case(cases++)) {
        const FramePlan plan = desktop.plan(test::tracked(view), options_of(mode, technique));
        const RenderedImage one = desktop.draw(frame, plan);
        const RenderedImage other = embedded.draw(frame, plan);
        int over = 0;
        for (std::size_t i = 0; i < one.rgba.size(); ++i)
          over += std::abs(one.rgba[i] - other.rgba[i]) > 2 ? 1 : 0;
        EXPECT_LE(over, 8) << to_string(mode) << " " << name;
      }
    }
  }
}

// The strips are many pixels wide. They must cover a fraction of the layer's area that equals the
// fraction of light that the layer blocks.
TEST(GeometryMesh, CoversPixelFractionOfBlockedLight) {
  const LightFractions fractions{0.15, 0.4, 0.83};
  Studio studio(plate(fractions).build(), test::camera_of(900, 900, 1200.0));
  const PoseEstimate near = test::tracked(test::look_at({0.0, -0.01, 0.2}, {0.0, 0.0, 0.0}));
  const Frame frame = test::plain_frame(900, 900, 255);
  const std::array<double, 3> left = {fractions.umbra, fractions.middle, fractions.penumbra};
  for (int layer = 0; layer < 3; ++layer) {
    FramePlan blended = studio.plan(near, options_of(Translucency::blend));
    FramePlan strips = studio.plan(near, options_of(Translucency::geometry_mesh));
    keep_layer(blended, layer);
    keep_layer(strips, layer);
    const RenderedImage mask = studio.draw_shadows(frame, blended);
    const RenderedImage image = studio.draw_shadows(frame, strips);
    EXPECT_EQ(studio.stats().translucency, Translucency::geometry_mesh);
    int inside = 0;
    int black = 0;
    for (int y = 0; y < 900; ++y) {
      for (int x = 0; x < 900; ++x) {
        const bool is_inside = mask.red(x, y) != 255;
        inside += is_inside ? 1 : 0;
        black += is_black(image, x, y) ? 1 : 0;
        ASSERT_TRUE(is_inside || image.red(x, y) == 255);
        ASSERT_TRUE(is_black(image, x, y) || image.red(x, y) == 255);
      }
    }
    ASSERT_GT(inside, 100'000);
    EXPECT_NEAR(static_cast<double>(black) / inside, 1.0 - left[static_cast<std::size_t>(layer)],
                0.02);
  }
}

// Simulates a driver that does not blend.
void (*driver_enable)(GLenum);
void enable_without_blending(GLenum ability) {
  if (ability != GL_BLEND) driver_enable(ability);
}

TEST(TranslucencyProbe, DetectsSupportedModes) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const auto context = create_offscreen_context(api).value();
    context->make_current();
    const FragmentAbilities found = probe_fragment_abilities(api).value();
    EXPECT_TRUE(found.blends);
    EXPECT_TRUE(found.fetches);
    EXPECT_EQ(glGetError(), static_cast<GLenum>(GL_NO_ERROR));

    driver_enable = epoxy_glEnable;
    epoxy_glEnable = enable_without_blending;
    const FragmentAbilities without = probe_fragment_abilities(api).value();
    epoxy_glEnable = driver_enable;
    EXPECT_FALSE(without.blends);
    EXPECT_TRUE(without.fetches);
  }
}

TEST(TranslucencyProbe, SelectsRetextureWhenDriverDoesNotBlend) {
  const auto drawn = [](Studio& studio) {
    (void)studio.draw(white(), studio.plan(above()));
    return studio.stats().translucency;
  };
  Studio studio(plate({0.15, 0.4, 0.83}).build(), undistorted_camera());
  EXPECT_EQ(drawn(studio), Translucency::blend);
  driver_enable = epoxy_glEnable;
  epoxy_glEnable = enable_without_blending;
  Studio without(plate({0.15, 0.4, 0.83}).build(), undistorted_camera());
  epoxy_glEnable = driver_enable;
  EXPECT_EQ(drawn(without), Translucency::retexture);
}

}  // namespace
}  // namespace penumbra::translucency_test
