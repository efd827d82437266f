// The choice between direct drawing and masks, and the brightness of shadows, for several views and
// scenes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "render/frame_plan.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;

constexpr int kSide = 200;
constexpr std::uint8_t kGrey = 200;

std::shared_ptr<const Model> block(double side) {
  test::ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, -side / 2, side / 2, side / 2, side / 2);
  return test::finished(shape.build(), glm::vec4(1.0F));
}
PoseEstimate from_the_side(double distance) {
  return test::tracked(test::look_at({0.0, -0.7 * distance, 0.7 * distance}, {0.0, -0.05, 0.0}));
}
PoseEstimate from_height(double z) {
  return test::tracked(test::look_at({0.0, -0.05, z}, {0.0, 0.0, 0.0}));
}
Frame grey() {
  return test::plain_frame(kSide, kSide, kGrey);
}

// A block of 12 faces in view, and optionally a second block whose shadow is not visible.
enum class SecondBlock { none, through_table, above_table, off_outline };
SceneBuilder block_and(SecondBlock second) {
  SceneBuilder builder;
  builder.add(block(0.05), test::at(0, 0, 0.07));
  if (second == SecondBlock::through_table) builder.add(block(0.05), test::at(8, 0, 0));
  if (second == SecondBlock::above_table) builder.add(block(0.05), test::at(8, 0, 0.06));
  if (second == SecondBlock::off_outline) {
    // The second block is in view, nearer to the camera; its shadow lies outside the plane's
    // outline.
    builder.scene().planes[0].outline = {{-0.2, -0.08}, {0.2, -0.08}, {0.2, 0.2}, {-0.2, 0.2}};
    builder.add(block(0.05), test::at(0.0, -0.2, 0.05));
  }
  return builder;
}

TEST(LayerDrawingChoice, IgnoresCulledShadows) {
  const CameraModel camera = test::distorted_camera(kSide, 220.0);
  for (const SecondBlock second : {SecondBlock::none, SecondBlock::through_table,
                                   SecondBlock::above_table, SecondBlock::off_outline}) {
    SCOPED_TRACE(static_cast<int>(second));
    Studio skipping(block_and(second).build(), camera);
    Studio unskipped(block_and(second).build(), camera);
    PlanOptions all;
    all.skip = false;
    for (const double distance : {0.6, 0.53, 0.47, 0.4}) {
      const FramePlan plan = skipping.plan(from_the_side(distance));
      EXPECT_EQ(plan.shadows.size(), 1U);
      EXPECT_EQ(plan.skipped_shadows.size(), second == SecondBlock::none ? 0U : 1U);
      const RenderedImage image = skipping.draw(grey(), plan);
      EXPECT_EQ(image, unskipped.draw(grey(), unskipped.plan(from_the_side(distance), all)));
      const auto masks = skipping.stats()[Counter::layer_masks_drawn] +
                         skipping.stats()[Counter::layer_masks_kept];
      EXPECT_EQ(masks, 1);
    }
  }
}

// Finds by bisection a height at which the size of the masks changes. Then moves the camera across
// that height by a hundredth of a millimetre; no mask may be redrawn. `drawn_at` returns the frame
// drawn at a height and the number of masks drawn for it. Returns the lower height and its frame.
template <typename DrawnAt>
std::pair<double, RenderedImage> expect_reuse_during_jitter(const DrawnAt& drawn_at, double high,
                                                            double low) {
  constexpr double kStep = 1e-5;
  static_cast<void>(drawn_at(high));
  while (high - low > kStep) {
    const double middle = 0.5 * (low + high);
    static_cast<void>(drawn_at(high));
    (drawn_at(middle).second > 0 ? low : high) = middle;
  }
  const RenderedImage above = drawn_at(high).first;
  const RenderedImage below = drawn_at(low).first;
  std::int64_t redrawn = 0;
  for (int i = 0; i < 10; ++i) {
    const auto [up, up_redrawn] = drawn_at(high);
    const auto [down, down_redrawn] = drawn_at(low);
    EXPECT_EQ(up, above) << "the frame must not depend on earlier frames";
    EXPECT_EQ(down, below);
    redrawn += up_redrawn + down_redrawn;
  }
  EXPECT_EQ(redrawn, 0);
  return {low, below};
}

TEST(ShadowMasks, AreReusedOnPlanesDuringCameraJitter) {
  Studio studio(block_and(SecondBlock::none).build(), test::camera_of(kSide, kSide, 220.0));
  const auto drawn_at = [&](double height) {
    const RenderedImage image = studio.draw(grey(), studio.plan(from_height(height)));
    EXPECT_EQ(
        studio.stats()[Counter::layer_masks_drawn] + studio.stats()[Counter::layer_masks_kept], 1);
    return std::pair(image, studio.stats()[Counter::layer_masks_drawn]);
  };
  const auto [low, below] = expect_reuse_during_jitter(drawn_at, 0.8, 0.4);
  Studio other(block_and(SecondBlock::none).build(), test::camera_of(kSide, kSide, 220.0));
  EXPECT_EQ(other.draw(grey(), other.plan(from_height(low))), below);
}

TEST(ShadowMasks, AreReusedOnReceiversDuringCameraJitter) {
  SceneBuilder builder;
  builder.add(block(0.05), test::at(0, 0, 0.15));
  builder.add(block(0.06), test::at(0.01, 0, 0.03), false, true);
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 220.0));
  expect_reuse_during_jitter(
      [&](double height) {
        const RenderedImage image = studio.draw(grey(), studio.plan(from_height(height)));
        EXPECT_GT(studio.stats()[Counter::masks_drawn] + studio.stats()[Counter::masks_kept], 0);
        return std::pair(image, studio.stats()[Counter::masks_drawn]);
      },
      1.2, 0.5);
}

TEST(FrameReuse, IsDisabledWithoutSkipping) {
  for (const ShadowTechnique technique : {ShadowTechnique::layered, ShadowTechnique::field,
                                          ShadowTechnique::hard, ShadowTechnique::volume}) {
    SceneBuilder builder;
    builder.add(block(0.05), test::at(0, 0, 0.15));
    builder.add(block(0.06), test::at(0.01, 0, 0.03), false, true);
    SceneLight& light = builder.scene().lights.emplace_back();
    light.position = {0.1, 0.0, 1.0};
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 220.0));
    PlanOptions options;
    options.technique = technique;
    const Frame frame = grey();
    const RenderedImage first = studio.draw(frame, studio.plan(from_height(0.5), options));
    EXPECT_EQ(studio.draw(frame, studio.plan(from_height(0.5), options)), first);
    const CompositeStats again = studio.stats();
    EXPECT_EQ(again[Counter::triples_recomputed], 0);
    EXPECT_EQ(again[Counter::video_copies], 0);
    EXPECT_EQ(again[Counter::masks_drawn] + again[Counter::layer_masks_drawn], 0);
    options.skip = false;
    EXPECT_EQ(studio.draw(frame, studio.plan(from_height(0.5), options)), first);
    const CompositeStats fresh = studio.stats();
    EXPECT_EQ(fresh[Counter::video_copies], 1);
    EXPECT_EQ(fresh[Counter::reprojections], 0);
    EXPECT_GT(fresh[Counter::triples_recomputed], 0);
    EXPECT_EQ(fresh[Counter::masks_kept] + fresh[Counter::layer_masks_kept], 0);
    EXPECT_EQ(fresh[Counter::masks_drawn], again[Counter::masks_kept]);
    EXPECT_EQ(fresh[Counter::layer_masks_drawn], again[Counter::layer_masks_kept]);
  }
}

// For every technique, the darkest pixel is the remaining light, encoded with the camera response.
TEST(ShadowBrightness, FollowsCameraResponse) {
  struct Case {
    ShadowTechnique technique;
    int lights;
    bool phantom;
  };
  for (const Case& c :
       {Case{ShadowTechnique::layered, 1, false}, Case{ShadowTechnique::simple, 1, false},
        Case{ShadowTechnique::field, 1, false}, Case{ShadowTechnique::hard, 1, false},
        Case{ShadowTechnique::volume, 1, false}, Case{ShadowTechnique::volume, 2, false},
        Case{ShadowTechnique::layered, 1, true}}) {
    SCOPED_TRACE(std::string(to_string(c.technique)));
    SceneBuilder builder;
    builder.add(block(0.05), test::at(0, 0, 0.12));
    if (c.phantom) builder.add(block(0.08), test::at(0.0, 0.0, 0.04), false, true);
    for (int i = 0; i < c.lights; ++i)
      builder.scene().lights.emplace_back().position = {0.2 - 0.4 * i, 0.0, 1.0};
    std::vector<RenderedImage> images;
    for (const std::optional<double> tone : {std::optional<double>(), std::optional(1.0)}) {
      CameraParameters parameters = test::camera_of(kSide, kSide, 220.0).parameters();
      parameters.tone_curve = tone;
      Studio studio(builder.build(), CameraModel::make(parameters).value());
      PlanOptions options;
      options.technique = c.technique;
      // Edges of masks, and all edges on phantoms, are interpolated after encoding.
      options.layers = LayerDrawing::direct;
      images.push_back(studio.draw_shadows(grey(), studio.plan(from_height(0.6), options)));
    }
    const auto is_edge = [&image = images[0]](int x, int y) {
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, kSide - 1); ++j) {
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, kSide - 1); ++i) {
          if (image.red(i, j) != image.red(x, y)) return true;
        }
      }
      return false;
    };
    int dark = 0;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        if (c.phantom && is_edge(x, y)) continue;
        const double light_left =
            std::pow(images[0].red(x, y) / double{kGrey}, kDefaultToneExponent);
        ASSERT_NEAR(images[1].red(x, y), light_left * kGrey, 2.6) << x << ", " << y;
        dark += images[1].red(x, y) < kGrey - 20 ? 1 : 0;
      }
    }
    EXPECT_GT(dark, 100);
    const int darkest = *std::ranges::min_element(images[1].rgba);
    if (c.technique == ShadowTechnique::layered) {
      EXPECT_NEAR(darkest, LightFractions().umbra * kGrey, 1.0);
    }
  }
}

TEST(AmbientLightFractions, IncreaseWithAmbientLight) {
  Scene scene;
  const LightFractions given;
  const auto lifted = [&](double ambient, const std::vector<PlacedLight>& lights) {
    scene.ambient.setConstant(ambient);
    return lifted_by_ambient(given, scene, lights, Eigen::Vector3d::UnitZ(), {0.1, 0.0, 0.0});
  };
  PlacedLight above;  // straight above the point, not attenuated
  above.position = {0.1, 0.0, 2.0, 1.0};
  PlacedLight sideways;
  sideways.position = {1.0, 0.0, 0.0, 0.0};
  for (const double weak : {0.0, 0.2, Scene::kBrightRoomAmbient}) {
    EXPECT_EQ(lifted(weak, {above}).umbra, given.umbra);
    EXPECT_EQ(lifted(weak, {above}).penumbra, given.penumbra);
  }
  // An ambient light of 0.36 gives a total of 1.36; here the total is 1.66. The shadow
  // removes the same amount of light in both cases.
  EXPECT_NEAR(lifted(0.66, {above}).umbra, 1.0 - 0.85 * 1.36 / 1.66, 1e-9);
  EXPECT_NEAR(lifted(0.66, {above}).middle, 1.0 - 0.6 * 1.36 / 1.66, 1e-9);
  EXPECT_NEAR(lifted(0.66, {above}).penumbra, 1.0 - 0.17 * 1.36 / 1.66, 1e-9);
  EXPECT_NEAR(lifted(0.66, {above, sideways}).umbra, lifted(0.66, {above}).umbra, 1e-9)
      << "light at grazing incidence adds nothing";
  EXPECT_NEAR(lifted(0.66, {}).umbra, lifted(0.66, {default_light()}).umbra, 1e-9);
  double before = given.umbra;
  for (const double strong : {0.37, 0.5, 1.0, 10.0, 1e6}) {
    const LightFractions now = lifted(strong, {above});
    EXPECT_GT(now.umbra, before);
    EXPECT_LE(now.umbra, now.middle);
    EXPECT_LE(now.middle, now.penumbra);
    EXPECT_LE(now.penumbra, 1.0);
    before = now.umbra;
  }
  EXPECT_GT(before, 0.999) << "strong ambient light hides the shadow";
}

TEST(AmbientLightFractions, MatchDrawnShadow) {
  int before = 0;
  for (const double ambient : {0.36, 0.7, 2.0}) {
    SceneBuilder builder = block_and(SecondBlock::none);
    builder.scene().ambient.setConstant(ambient);
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 220.0));
    const FramePlan plan = studio.plan(from_height(0.5));
    const LightFractions expected =
        lifted_by_ambient(LightFractions(), studio.scene(), plan.lights, Eigen::Vector3d::UnitZ(),
                          Eigen::Vector3d::Zero());
    const RenderedImage image = studio.draw_shadows(grey(), plan);
    const int darkest = *std::ranges::min_element(image.rgba);
    EXPECT_NEAR(darkest, kGrey * std::pow(expected.umbra, 1.0 / kDefaultToneExponent), 1.0);
    EXPECT_GT(darkest, before);
    before = darkest;
  }
}

}  // namespace
}  // namespace penumbra
