// Multisampling smooths edges and changes nothing else.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "core/image/image_file.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/shapes.hpp"
#include "support/edge_error.hpp"
#include "support/paths.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/techniques.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

constexpr int kViewWidth = 320;
constexpr int kViewHeight = 240;

CameraModel view_of(int scale) {
  return CameraModel::make(test::enlarged_view(kViewWidth, kViewHeight, scale)).value();
}

PoseEstimate view_pose() {
  return test::tracked(test::look_at({0.25, -0.45, 0.4}, {0.0, 0.0, 0.05}));
}

// Writes frames for inspection if PENUMBRA_MSAA_IMAGES=FOLDER is set.
void save_for_inspection(const test::RenderedImage& image, const std::string& name) {
  const char* folder = std::getenv("PENUMBRA_MSAA_IMAGES");
  if (folder == nullptr) return;
  ASSERT_TRUE(save_png(std::filesystem::path(folder) / (name + ".png"), image.width, image.height,
                       image.rgba));
}

TEST(Multisampling, DefaultsToNoSamplesOnSoftwareRenderer) {
  EXPECT_EQ(multisampling_for(true, 8), 0);
  EXPECT_EQ(multisampling_for(false, 8), 4);
  EXPECT_EQ(multisampling_for(false, 2), 2);
  EXPECT_EQ(multisampling_for(false, 0), 0);
  test::Studio studio(test::SceneBuilder().build(), view_of(1), GlApi::gl33, {});
  EXPECT_EQ(studio.compositor().samples() == 0, studio.context().info().software);
}

TEST(Multisampling, RejectsMoreSamplesThanDriverSupports) {
  auto context = create_offscreen_context().value();
  CompositorOptions options;
  options.msaa = 1'000'000;
  const auto made = Compositor::create(*context, test::SceneBuilder().build(), view_of(1), options);
  ASSERT_FALSE(made);
  EXPECT_NE(made.error().message.find("--msaa"), std::string::npos) << made.error().message;
}

// The reference is a frame of 8 times the width and height, averaged over 8 x 8 pixels.
TEST(Multisampling, SmoothsObjectEdges) {
  constexpr int kFiner = 8;
  test::SceneBuilder builder;
  builder.add(test::finished(make_box({0.14F, 0.09F, 0.06F}), glm::vec4(0.9F, 0.3F, 0.2F, 1.0F)),
              test::at(0.0, 0.0, 0.08, {1, 2, 3}, 0.7), false);
  const auto draw = [&](int scale, int samples, GlApi api) {
    CompositorOptions options;
    options.msaa = samples;
    test::Studio studio(builder.build(), view_of(scale), api, options);
    EXPECT_GE(studio.compositor().samples(), samples);
    return studio.draw(test::plain_frame(scale * kViewWidth, scale * kViewHeight, 220),
                       studio.plan(view_pose()));
  };
  const test::RenderedImage fine = draw(kFiner, 0, GlApi::gl33);
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    const test::RenderedImage plain = draw(1, 0, api);
    const test::RenderedImage smooth = draw(1, 4, api);
    save_for_inspection(plain, "plain");
    save_for_inspection(smooth, "smooth");
    double plain_sum = 0.0;
    double smooth_sum = 0.0;
    int edge_pixels = 0;
    for (int y = 0; y < kViewHeight; ++y) {
      for (int x = 0; x < kViewWidth; ++x) {
        double mean = 0.0;
        int lowest = 255;
        int highest = 0;
        for (int j = 0; j < kFiner; ++j) {
          for (int i = 0; i < kFiner; ++i) {
            const int green = fine.at(kFiner * x + i, kFiner * y + j)[1];
            mean += green / static_cast<double>(kFiner * kFiner);
            lowest = std::min(lowest, green);
            highest = std::max(highest, green);
          }
        }
        const double plain_error = plain.at(x, y)[1] - mean;
        const double smooth_error = smooth.at(x, y)[1] - mean;
        if (highest - lowest <= 1) {
          EXPECT_NEAR(smooth.at(x, y)[1], plain.at(x, y)[1], 1) << x << ", " << y;
        }
        if (highest - lowest < 8) continue;
        ++edge_pixels;
        plain_sum += plain_error * plain_error;
        smooth_sum += smooth_error * smooth_error;
      }
    }
    ASSERT_GT(edge_pixels, 200);
    const double plain_rms = std::sqrt(plain_sum / edge_pixels);
    const double smooth_rms = std::sqrt(smooth_sum / edge_pixels);
    RecordProperty("plain_rms", std::to_string(plain_rms));
    RecordProperty("smooth_rms", std::to_string(smooth_rms));
    EXPECT_LT(smooth_rms, 0.5 * plain_rms) << plain_rms;
  }
}

TEST(Multisampling, ChangesOnlyEdges) {
  const auto scene = std::make_shared<const Scene>(
      load_scene(test::source_dir() / "scenes" / "default.json").value());
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    std::size_t cases = 0;
    CompositorOptions multisampled;
    multisampled.msaa = 4;
    CompositorOptions single_sampled;
    single_sampled.msaa = 0;
    test::Studio plain(scene, view_of(1), api, single_sampled);
    test::Studio smooth(scene, view_of(1), api, multisampled);
    const Frame frame = test::plain_frame(kViewWidth, kViewHeight, 200);
    for (const ShadowTechnique technique : test::techniques_without({})) {
      ++cases;
      for (const Translucency mode : {Translucency::blend, Translucency::mesh,
                                      Translucency::retexture, Translucency::geometry_mesh}) {
        // The short form draws each technique and mode with one API, the long form with both.
        if (!test::nightly() && ++cases % 2 == (api == GlApi::gl33 ? 0U : 1U)) continue;
        const std::string name =
            std::string(to_string(technique)) + "-" + std::string(to_string(mode));
        SCOPED_TRACE(name);
        PlanOptions options;
        options.technique = technique;
        options.translucency = mode;
        const test::RenderedImage a = plain.draw(frame, plain.plan(view_pose(), options, 0.8));
        const test::RenderedImage b = smooth.draw(frame, smooth.plan(view_pose(), options, 0.8));
        save_for_inspection(a, name + "-plain");
        save_for_inspection(b, name + "-smooth");
        int changed = 0;
        for (int y = 0; y < kViewHeight; ++y) {
          for (int x = 0; x < kViewWidth; ++x) {
            const auto differs = [&](int channel) {
              return std::abs(a.at(x, y)[channel] - b.at(x, y)[channel]) > 2;
            };
            changed += differs(0) || differs(1) || differs(2) ? 1 : 0;
          }
        }
        EXPECT_GT(changed, 50) << "edges are smoothed";
        EXPECT_LT(changed, kViewWidth * kViewHeight / 20) << "of " << kViewWidth * kViewHeight;
      }
    }
  }
}

// With multisampling, casters with few faces are drawn directly. Their edges must be as smooth as a
// mask's.
TEST(Multisampling, DrawsFewFacesDirectly) {
  const auto scene_of = [](int around) {
    test::ShapeBuilder shape;
    shape.torus(0.06, 0.02, around, 16);  // the torus has 2 * 16 * `around` faces
    test::SceneBuilder builder;
    builder.add(test::finished(shape.build(), glm::vec4(1.0F)), test::at(0, 0, 0.1));
    return builder.build();
  };
  struct Drawn {
    test::RenderedImage image;
    std::int64_t masks = 0;
  };
  const auto draw = [](const std::shared_ptr<const Scene>& scene, int scale, int samples,
                       LayerDrawing layers) {
    CompositorOptions options;
    options.msaa = samples;
    test::Studio studio(scene, view_of(scale), GlApi::gl33, options);
    PlanOptions plan;
    plan.layers = layers;
    const test::RenderedImage image =
        studio.draw_shadows(test::plain_frame(scale * kViewWidth, scale * kViewHeight, 255),
                            studio.plan(view_pose(), plan));
    return Drawn{image, studio.stats()[Counter::layer_masks_drawn]};
  };
  const auto few = scene_of(14);
  const auto many = scene_of(16);
  EXPECT_EQ(draw(few, 1, 4, LayerDrawing::automatic).masks, 0);
  EXPECT_EQ(draw(few, 1, 0, LayerDrawing::automatic).masks, 1);
  EXPECT_EQ(draw(few, 1, 4, LayerDrawing::mask).masks, 1);
  EXPECT_EQ(draw(many, 1, 4, LayerDrawing::automatic).masks, 1);
  const test::RenderedImage fine = draw(few, 8, 0, LayerDrawing::direct).image;
  const auto error = [&](int samples, LayerDrawing layers) {
    const auto of_edges = test::edge_error(draw(few, 1, samples, layers).image, fine, 8);
    EXPECT_GT(of_edges.edges, 300);
    return of_edges.rms;
  };
  const double directly = error(4, LayerDrawing::direct);
  const double mask = error(4, LayerDrawing::mask);
  const double plain = error(0, LayerDrawing::direct);
  std::printf("edge error [grey levels RMS]: direct with 4 samples %.2f, mask %.2f, direct %.2f\n",
              directly, mask, plain);
  EXPECT_LT(directly, 6.0);
  EXPECT_LT(mask, 6.0);
  EXPECT_GT(plain, 12.0);
}

}  // namespace
}  // namespace penumbra
