// Edges that are smoothed after drawing, on renderers without multisampling.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <functional>

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

constexpr int kWidth = 320;
constexpr int kHeight = 240;
constexpr int kFiner = 4;  // reference: this number of times as many pixels per side

using test::RenderedImage;

enum class Lens { pinhole, distorted };

CameraModel view_of(int scale, Lens lens = Lens::pinhole) {
  CameraParameters p = test::enlarged_view(kWidth, kHeight, scale);
  if (lens == Lens::distorted) p.distortion = {-0.28, 0.08, 0.001, -0.0008, 0.0};
  return CameraModel::make(p).value();
}

PoseEstimate view_pose() {
  return test::tracked(test::look_at({0.25, -0.45, 0.4}, {0.0, 0.0, 0.03}));
}

// Video of kWidth x kHeight pixels, each `scale` x `scale` pixels large.
Frame video_of(int scale, const std::function<int(int x, int y)>& luma) {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, scale * kWidth, scale * kHeight);
  for (int y = 0; y < scale * kHeight; ++y) {
    std::uint8_t* row = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    for (int x = 0; x < scale * kWidth; ++x)
      row[x] = static_cast<std::uint8_t>(luma(x / scale, y / scale));
  }
  return buffer.frame;
}
int plain(int /*x*/, int /*y*/) {
  return 220;
}
// Squares of three pixels, as contrasty as a tag.
int tag_like(int x, int y) {
  return (x / 3 + y / 3) % 2 == 0 ? 215 : 45;
}

// Writes frames for inspection if PENUMBRA_EDGE_IMAGES=FOLDER is set.
void save_for_inspection(const RenderedImage& image, const std::string& name) {
  const char* folder = std::getenv("PENUMBRA_EDGE_IMAGES");
  if (folder == nullptr) return;
  ASSERT_TRUE(save_png(std::filesystem::path(folder) / (name + ".png"), image.width, image.height,
                       image.rgba));
}

using SharedScene = std::shared_ptr<const Scene>;

test::SceneBuilder lit_scene() {
  test::SceneBuilder builder;
  SceneLight lamp;
  lamp.position = {-0.25, -0.1, 0.7};
  lamp.intensity = 0.85;
  builder.scene().lights.push_back(lamp);
  return builder;
}

SharedScene box_scene() {
  auto builder = lit_scene();
  builder.add(test::finished(make_box({0.14F, 0.09F, 0.06F}), {0.9F, 0.3F, 0.2F, 1.0F}),
              test::at(0.0, 0.0, 0.08, {1, 2, 3}, 0.7));
  return builder.build();
}

SharedScene torus_scene() {
  test::ShapeBuilder ring;
  ring.torus(0.06, 0.022, 32, 64);
  auto builder = lit_scene();
  builder.add(test::finished(ring.build(), {0.2F, 0.35F, 0.7F, 1.0F}),
              test::at(0.0, 0.0, 0.07, {1, 0.2, 0}, 0.6));
  return builder.build();
}

// A ball over a box and a ball of the real world.
SharedScene phantom_scene() {
  auto builder = lit_scene();
  test::ShapeBuilder ball;
  ball.sphere(0.035, 24, 48);
  const auto sphere = test::finished(ball.build(), {0.8F, 0.5F, 0.1F, 1.0F});
  builder.add(sphere, test::at(-0.03, 0.01, 0.14));
  builder.add(test::finished(make_box({0.12F, 0.1F, 0.05F}), glm::vec4(1.0F)),
              test::at(0.02, 0.03, 0.025, {0, 0, 1}, 0.4), false, true);
  builder.add(sphere, test::at(0.11, -0.06, 0.03), false, true);
  builder.add(sphere, test::at(0.09, 0.02, 0.08));
  return builder.build();
}

struct EdgeCase {
  const char* name;
  SharedScene (*scene)();
  ShadowTechnique technique;
  int (*video)(int x, int y);
  Lens lens = Lens::pinhole;
  double least_plain = 8.0;  // the error without smoothing is larger than this
};
class EdgeSmoothing : public testing::TestWithParam<EdgeCase> {};
INSTANTIATE_TEST_SUITE_P(
    Edges, EdgeSmoothing,
    testing::Values(
        EdgeCase{"Box", box_scene, ShadowTechnique::none, plain},
        EdgeCase{"BoxOverTags", box_scene, ShadowTechnique::none, tag_like},
        EdgeCase{"Torus", torus_scene, ShadowTechnique::none, plain},
        EdgeCase{"TorusThroughLens", torus_scene, ShadowTechnique::none, plain, Lens::distorted},
        EdgeCase{"HardShadowOfBox", box_scene, ShadowTechnique::hard, plain},
        EdgeCase{"HardShadowOfTorusOverTags", torus_scene, ShadowTechnique::hard, tag_like},
        EdgeCase{"HardShadowThroughLens", torus_scene, ShadowTechnique::hard, plain,
                 Lens::distorted},
        EdgeCase{"VolumeOfTorus", torus_scene, ShadowTechnique::volume, plain},
        EdgeCase{"VolumesOnRealAndVirtualObjects", phantom_scene, ShadowTechnique::volume, plain},
        EdgeCase{"VolumesThroughLens", phantom_scene, ShadowTechnique::volume, plain,
                 Lens::distorted}),
    [](const auto& instance) { return std::string(instance.param.name); });

RenderedImage draw(const EdgeCase& c, int scale, std::optional<int> msaa, GlApi api = GlApi::gl33) {
  CompositorOptions options;
  options.msaa = msaa;
  test::Studio studio(c.scene(), view_of(scale, c.lens), api, options);
  PlanOptions plan;
  plan.technique = c.technique;
  return studio.draw(video_of(scale, c.video), studio.plan(view_pose(), plan));
}

TEST_P(EdgeSmoothing, LeavesAtMostSixCodes) {
  const EdgeCase& c = GetParam();
  const RenderedImage fine = draw(c, kFiner, 0);
  const RenderedImage without = draw(c, 1, 0);
  const RenderedImage smooth = draw(c, 1, std::nullopt);
  save_for_inspection(fine, std::string(c.name) + "-fine");
  save_for_inspection(without, std::string(c.name) + "-without");
  save_for_inspection(smooth, std::string(c.name) + "-smooth");
  const test::EdgeError before = test::edge_error(without, fine, kFiner);
  const test::EdgeError after = test::edge_error(smooth, fine, kFiner);
  RecordProperty("without", std::to_string(before.rms));
  RecordProperty("smoothed", std::to_string(after.rms));
  std::printf("%s: edge error [codes RMS] %.2f without smoothing, %.2f with, over %d pixels\n",
              c.name, before.rms, after.rms, after.edges);
  EXPECT_GT(after.edges, 200);
  EXPECT_GT(before.rms, c.least_plain);
  EXPECT_LE(after.rms, 6.0);
  EXPECT_EQ(after.largest_elsewhere, before.largest_elsewhere);
}

// Pixels without an edge keep their bytes, and equal frames give equal images.
TEST(EdgeSmoothingOf, ChangesOnlyEdgesAndRepeatsExactly) {
  const EdgeCase c{"", phantom_scene, ShadowTechnique::volume, tag_like};
  const RenderedImage without = draw(c, 1, 0);
  const RenderedImage smooth = draw(c, 1, std::nullopt);
  EXPECT_EQ(smooth, draw(c, 1, std::nullopt));
  EXPECT_EQ(smooth, draw(c, 1, std::nullopt, GlApi::gles30));
  int changed = 0;
  for (std::size_t i = 0; i < smooth.rgba.size(); i += 4) {
    changed += std::equal(&smooth.rgba[i], &smooth.rgba[i] + 4, &without.rgba[i]) ? 0 : 1;
    ASSERT_EQ(smooth.rgba[i + 3], without.rgba[i + 3]) << "alpha";
  }
  EXPECT_GT(changed, 300);
  EXPECT_LT(changed, kWidth * kHeight / 20);
}

// Shadows by a screen-door have no values between light and dark.
TEST(EdgeSmoothingOf, LeavesShadowsOfScreenDoorAsDrawn) {
  test::Studio smooth(box_scene(), view_of(1), GlApi::gl33, {});
  test::Studio plain_edges(box_scene(), view_of(1), GlApi::gl33, {.msaa = 0});
  PlanOptions options;
  options.technique = ShadowTechnique::hard;
  options.translucency = Translucency::mesh;
  const Frame video = video_of(1, plain);
  EXPECT_EQ(smooth.draw_shadows(video, smooth.plan(view_pose(), options)),
            plain_edges.draw_shadows(video, plain_edges.plan(view_pose(), options)));
  options.translucency = Translucency::blend;
  EXPECT_NE(smooth.draw_shadows(video, smooth.plan(view_pose(), options)),
            plain_edges.draw_shadows(video, plain_edges.plan(view_pose(), options)));
}

// A shadow ends at the outline of its plane. Beyond it, smoothing changes neither the video nor the
// shadow on another plane.
TEST(EdgeSmoothingOf, LeavesPixelsBeyondOutlineAsTheyAre) {
  for (const ShadowTechnique technique : {ShadowTechnique::hard, ShadowTechnique::volume}) {
    const auto draw_with = [technique](const std::vector<Eigen::Vector2d>& outline) {
      auto builder = lit_scene();
      builder.add(test::finished(make_box({0.14F, 0.09F, 0.06F}), glm::vec4(0.5F)),
                  test::at(0.0, 0.0, 0.08, {1, 2, 3}, 0.7));
      if (!outline.empty()) {
        ScenePlane slope;
        slope.normal = Eigen::Vector3d(0.3, 0.2, 0.9).normalized();
        slope.outline = outline;
        builder.scene().planes.push_back(slope);
        builder.scene().shadows.front().planes.push_back(1);
      }
      test::Studio studio(builder.build(), view_of(1), GlApi::gl33, {});
      PlanOptions plan;
      plan.technique = technique;
      plan.skip = false;
      return studio.draw_shadows(video_of(1, tag_like), studio.plan(view_pose(), plan));
    };
    const auto square_at = [](double u) {
      return std::vector<Eigen::Vector2d>{{u, -0.5}, {u + 0.5, -0.5}, {u + 0.5, 0.5}, {u, 0.5}};
    };
    const RenderedImage table_only = draw_with({});
    EXPECT_NE(draw_with(square_at(0.0)), table_only) << to_string(technique);
    EXPECT_EQ(draw_with(square_at(20.0)), table_only) << to_string(technique);
  }
}

// An object that is cut by the near plane, or that surrounds the camera, has edges out of range.
TEST(EdgeSmoothingOf, AcceptsObjectsAroundTheCamera) {
  for (const double scale : {0.1, 3.0, 3000.0}) {
    test::SceneBuilder builder = lit_scene();
    test::ShapeBuilder ring;
    ring.torus(0.06, 0.022, 6, 8);
    builder.add(test::finished(ring.build(), glm::vec4(0.5F)),
                test::at(0.25, -0.45, 0.4, {1, 0.2, 0}, 0.6, scale));
    const auto scene = builder.build();
    test::Studio smooth(scene, view_of(1), GlApi::gl33, {});
    test::Studio plain_edges(scene, view_of(1), GlApi::gl33, {.msaa = 0});
    for (const ShadowTechnique technique : {ShadowTechnique::hard, ShadowTechnique::volume}) {
      PlanOptions options;
      options.technique = technique;
      const FramePlan plan = smooth.plan(view_pose(), options);
      const RenderedImage with = smooth.draw(video_of(1, plain), plan);
      const RenderedImage without = plain_edges.draw(video_of(1, plain), plan);
      int changed = 0;
      for (std::size_t i = 0; i < with.rgba.size(); i += 4)
        changed += std::equal(&with.rgba[i], &with.rgba[i] + 4, &without.rgba[i]) ? 0 : 1;
      EXPECT_LT(changed, kWidth * kHeight / 20) << scale;
    }
  }
}

}  // namespace
}  // namespace penumbra
