// Drawn hard shadows: their pixels are compared with a projection on the CPU, their brightness with
// Lambert's law.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/projected/projected_shadow.hpp"
#include "support/plane_coverage.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::hard_shadow_test {
namespace {

using test::box;
using test::RenderedImage;
using test::ring;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 200;

CameraModel undistorted_camera() {
  return test::camera_of(kSide, kSide, 300.0);
}
CameraModel distorted_camera() {
  return test::distorted_camera(kSide, 280.0);
}
PoseEstimate slanted() {
  return test::tracked(test::look_at({0.35, -0.5, 0.55}, {0.0, 0.02, 0.0}));
}
Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}

SceneLight lamp(double x, double y, double z, double intensity = 1.0) {
  SceneLight light;
  light.name = "lamp";
  light.position = {x, y, z};
  light.intensity = intensity;
  return light;
}
SceneLight parallel(double x, double y, double z, double intensity = 1.0) {
  SceneLight light;
  light.name = "sun";
  light.kind = SceneLight::Kind::directional;
  light.direction = Eigen::Vector3d(x, y, z).normalized();
  light.intensity = intensity;
  return light;
}
SceneBuilder with_lights(const std::vector<SceneLight>& lights) {
  SceneBuilder builder;
  builder.scene().shadows[0].technique = ShadowTechnique::hard;
  for (const SceneLight& light : lights) {
    builder.scene().shadows[0].lights.push_back(static_cast<int>(builder.scene().lights.size()));
    builder.scene().lights.push_back(light);
  }
  return builder;
}

// Intersection of a pixel centre's ray with a plane.
std::optional<Eigen::Vector3d> point_at_pixel(const CameraModel& camera, const CameraPose& pose,
                                              const PlaneFrame& plane, int x, int y) {
  const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
  if (!ray) return std::nullopt;
  const Eigen::Vector3d direction = pose.rotation() * *ray;
  const double t = -plane.height(pose.translation()) / plane.n.dot(direction);
  if (!(t > 0.0)) return std::nullopt;
  return pose.translation() + t * direction;
}

// Tests if a face of the scene's casters blocks the light at a point.
class Blocked {
 public:
  Blocked(const Scene& scene, int light, const PlaneFrame& plane) : plane_(plane) {
    const SceneState state = evaluate_scene(scene, 0.0);
    for (const int caster : scene.shadows[0].casters) {
      const auto i = static_cast<std::size_t>(caster);
      const ShadowMesh mesh = make_shadow_mesh(*scene.objects[i].model);
      const ShadowKernels none{plane.n, mesh.positions, {}};
      const auto triangles =
          projected_triangles(place_caster(mesh, none, state.objects[i], plane), mesh.indices,
                              state.lights[static_cast<std::size_t>(light)].position, plane);
      triangles_.insert(triangles_.end(), triangles.begin(), triangles.end());
    }
  }
  [[nodiscard]] bool at(const Eigen::Vector3d& place) const {
    return test::covers(triangles_, plane_.to_plane(place).head<2>());
  }

 private:
  PlaneFrame plane_;
  std::vector<PlanePoint> triangles_;
};

// Red value of white video if the given fraction of each light is blocked. The ambient light is
// never blocked. Uses the formulas of blocked_light.frag.glsl.
double expected_red(const Scene& scene, const std::vector<double>& blocked, const PlaneFrame& plane,
                    const Eigen::Vector3d& place) {
  const double up = 0.5 + 0.5 * plane.n.z();
  double all = scene.ambient.x() * (0.52 + up * (1.08 - 0.52));
  double lost = 0.0;
  const SceneState state = evaluate_scene(scene, 0.0);
  for (std::size_t i = 0; i < state.lights.size(); ++i) {
    const Eigen::Vector4d& at = state.lights[i].position;
    const Eigen::Vector3d l = (at.head<3>() - place * at.w()).normalized();
    const double arriving = state.lights[i].color.x() * std::max(plane.n.dot(l), 0.0);
    all += arriving;
    lost += blocked[i] * arriving;
  }
  return 255.0 * std::pow(1.0 - lost / all, 1.0 / 2.2);
}

struct Agreement {
  int dark = 0;       // pixels that are dark in the reference
  int differing = 0;  // pixels that differ by more than 1.5 grey levels
  int deepest = 0;    // largest number of lights blocked at one pixel
};
Agreement agreement(const Scene& scene, const CameraModel& camera, const PoseEstimate& pose,
                    const RenderedImage& image, const PlaneFrame& plane = {}) {
  std::vector<Blocked> lights;
  for (int i = 0; i < static_cast<int>(scene.lights.size()); ++i) {
    lights.emplace_back(scene, i, plane);
  }
  Agreement result;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto place = point_at_pixel(camera, pose.T_table_camera, plane, x, y);
      double expected = 255.0;
      if (place) {
        std::vector<double> blocked;
        for (const Blocked& light : lights) blocked.push_back(light.at(*place) ? 1.0 : 0.0);
        expected = expected_red(scene, blocked, plane, *place);
        result.deepest =
            std::max(result.deepest, static_cast<int>(std::ranges::count(blocked, 1.0)));
      }
      result.dark += expected < 254.0 ? 1 : 0;
      result.differing += std::abs(image.red(x, y) - expected) > 1.5 ? 1 : 0;
    }
  }
  return result;
}

struct LensCase {
  const char* name;
  CameraModel camera;
};
class HardShadow : public testing::TestWithParam<LensCase> {};
INSTANTIATE_TEST_SUITE_P(Lenses, HardShadow,
                         testing::Values(LensCase{"undistorted", undistorted_camera()},
                                         LensCase{"distorted", distorted_camera()}),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(HardShadow, MatchesCpuProjection) {
  struct Case {
    const char* name;
    std::shared_ptr<const Model> model;
    Placement placement;
    SceneLight light;
  };
  const std::vector<Case> cases = {
      {"ring under a lamp", ring(), test::at(0.01, 0.02, 0.1, {1, 0.3, 0}, 0.6),
       lamp(-0.2, 0.1, 0.6)},
      {"bar through the plane", box(0.2, 0.03, 0.03), test::at(0, 0, 0.02, {0, 1, 0}, -0.5),
       lamp(-0.2, 0.1, 0.5)},
      {"bar up past the light", box(0.02, 0.02, 0.5), test::at(0.05, 0, 0.25),
       lamp(-0.1, 0.0, 0.3)},
      {"beside the light, half above it", box(0.1, 0.1, 0.1), test::at(0.06, 0.0, 0.13),
       lamp(-0.05, 0.02, 0.14)},
      {"parallel light", ring(), test::at(0, 0, 0.12, {0, 1, 0}, 0.5), parallel(0.3, -0.2, 0.7)},
      {"parallel, low", box(0.05, 0.05, 0.05), test::at(-0.1, 0, 0.03), parallel(-0.9, 0.1, 0.2)},
      {"scaled", ring(), test::at(0, 0, 0.1, {0, 1, 1}, 0.5, 0.7), lamp(0.1, 0.3, 0.4)}};
  for (const Case& c : cases) {
    SceneBuilder builder = with_lights({c.light});
    builder.add(c.model, c.placement);
    Studio studio(builder.build(), GetParam().camera);
    const RenderedImage image = studio.draw_shadows(white(), studio.plan(slanted()));
    const Agreement a = agreement(studio.scene(), GetParam().camera, slanted(), image);
    EXPECT_GT(a.dark, 200) << c.name;
    // Only pixel centres on an edge may differ, because of rounding and the lens's error of 0.1 px.
    EXPECT_LE(a.differing, 4 + a.dark / 100) << c.name << ", " << a.dark << " px";
  }
}

TEST_P(HardShadow, EndsAtOutlineOfSlantedPlane) {
  SceneBuilder builder = with_lights({lamp(-0.2, -0.3, 0.5)});
  builder.add(box(0.08, 0.08, 0.08), test::at(0.0, 0.0, 0.08, {1, 1, 0}, 0.4));
  ScenePlane& plane = builder.scene().planes[0];
  plane.normal = Eigen::Vector3d(0.2, -0.5, 1.0).normalized();
  plane.point = {0.02, 0.05, 0.01};
  const PlaneFrame frame = PlaneFrame::make(plane.normal, plane.point);
  Studio whole(builder.build(), GetParam().camera);
  const RenderedImage all = whole.draw_shadows(white(), whole.plan(slanted()));
  const Agreement a = agreement(whole.scene(), GetParam().camera, slanted(), all, frame);
  EXPECT_GT(a.dark, 1000);
  EXPECT_LE(a.differing, 4 + a.dark / 100);

  plane.outline = {{-0.3, -0.3}, {0.05, -0.3}, {0.05, 0.05}, {-0.3, 0.05}};
  Studio cut(builder.build(), GetParam().camera);
  const RenderedImage part = cut.draw_shadows(white(), cut.plan(slanted()));
  int kept = 0;
  int wrong = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto place = point_at_pixel(GetParam().camera, slanted().T_table_camera, frame, x, y);
      const Eigen::Vector3d p = frame.to_plane(*place);
      const double inside =
          std::min({p.x() + 0.3, p.y() + 0.3, 0.05 - p.x(), 0.05 - p.y()});  // [m] to the edge
      if (std::abs(inside) < 0.002) continue;
      const int expected = inside > 0.0 ? all.red(x, y) : 255;
      kept += expected < 255 ? 1 : 0;
      wrong += part.red(x, y) != expected ? 1 : 0;
    }
  }
  EXPECT_GT(kept, 250);
  EXPECT_LT(kept, a.dark - 250);
  EXPECT_EQ(wrong, 0);
}

// Two boxes and three lights. A pixel in the shadows of two lights loses the light of both. If both
// boxes block the same light, the pixel loses it once.
TEST(HardShadowLight, IsRemovedOncePerLight) {
  SceneBuilder builder = with_lights(
      {lamp(-0.25, 0.0, 0.5, 0.8), lamp(0.2, 0.25, 0.4, 0.5), parallel(0.1, -0.3, 0.9, 0.6)});
  builder.add(box(0.1, 0.1, 0.02), test::at(0.0, 0.0, 0.08));
  builder.add(box(0.12, 0.04, 0.02), test::at(0.03, 0.02, 0.15, {0, 0, 1}, 0.7));
  Studio studio(builder.build(), undistorted_camera());
  const RenderedImage image = studio.draw_shadows(white(), studio.plan(slanted()));
  const Agreement a = agreement(studio.scene(), undistorted_camera(), slanted(), image);
  EXPECT_EQ(a.deepest, 3) << "some pixel lies in the shadow of all three lights";
  EXPECT_GT(a.dark, 2000);
  EXPECT_LE(a.differing, 4 + a.dark / 60);
}

// A caster of a coasting group blocks light in proportion to its opacity. Where two casters
// overlap, the more opaque caster determines the shadow.
TEST(HardShadowLight, FadesWithItsCaster) {
  SceneBuilder builder = with_lights({lamp(-0.25, 0.0, 0.5, 0.8), parallel(0.1, -0.3, 0.9, 0.6)});
  builder.add(box(0.1, 0.1, 0.02), test::at(0.0, 0.0, 0.08));
  builder.add(box(0.12, 0.04, 0.02), test::at(0.03, 0.02, 0.15, {0, 0, 1}, 0.7));
  Studio studio(builder.build(), undistorted_camera());
  FramePlan plan = studio.plan(slanted());
  constexpr std::array<float, 2> kOpacity = {0.4F, 1.0F};
  for (HardShadowDraw& draw : plan.hard_shadows) {
    draw.opacity = kOpacity[static_cast<std::size_t>(draw.object)];
  }
  const RenderedImage image = studio.draw_shadows(white(), plan);

  std::vector<std::vector<Blocked>> blockers;  // indexed [light][caster]
  for (int light = 0; light < 2; ++light) {
    blockers.emplace_back();
    for (int caster = 0; caster < 2; ++caster) {
      Scene alone = studio.scene();
      alone.shadows[0].casters = {caster};
      blockers.back().emplace_back(alone, light, PlaneFrame());
    }
  }
  int faint = 0;
  int both = 0;
  int wrong = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto place = point_at_pixel(undistorted_camera(), slanted().T_table_camera, {}, x, y);
      if (!place) continue;
      std::vector<double> blocked;
      for (const std::vector<Blocked>& casters : blockers) {
        const bool weak = casters[0].at(*place);
        const bool strong = casters[1].at(*place);
        blocked.push_back(strong ? 1.0 : weak ? static_cast<double>(kOpacity[0]) : 0.0);
        faint += weak && !strong ? 1 : 0;
        both += weak && strong ? 1 : 0;
      }
      const double expected = expected_red(studio.scene(), blocked, {}, *place);
      wrong += std::abs(image.red(x, y) - expected) > 1.5 ? 1 : 0;
    }
  }
  EXPECT_GT(faint, 1000);
  EXPECT_GT(both, 300);
  EXPECT_LE(wrong, 60);
}

TEST(HardShadowLight, IsIgnoredBelowPlaneAndDefaultsToFirstOfScene) {
  SceneBuilder builder = with_lights({lamp(0.0, 0.0, -0.2), parallel(0.2, 0.1, -0.5)});
  builder.add(box(0.1, 0.1, 0.02), test::at(0.0, 0.0, 0.08));
  Studio studio(builder.build(), undistorted_camera());
  const FramePlan plan = studio.plan(slanted());
  EXPECT_TRUE(plan.hard_shadows.empty());
  EXPECT_EQ(plan.skipped.size(), 2U);
  const RenderedImage image = studio.draw_shadows(white(), plan);
  EXPECT_EQ(std::ranges::count_if(image.rgba, [](std::uint8_t v) { return v < 255; }), 0);

  SceneBuilder unnamed = with_lights({lamp(0.1, 0.1, 0.5), lamp(-0.3, 0.1, 0.5)});
  unnamed.scene().shadows[0].lights.clear();
  unnamed.add(box(0.1, 0.1, 0.02), test::at(0.0, 0.0, 0.08));
  Studio first(unnamed.build(), undistorted_camera());
  ASSERT_EQ(first.plan(slanted()).hard_shadows.size(), 1U);
  EXPECT_EQ(first.plan(slanted()).hard_shadows[0].light, 0);
  unnamed.scene().lights.clear();
  Studio dark(unnamed.build(), undistorted_camera());
  EXPECT_EQ(dark.plan(slanted()).hard_shadows.size(), 0U);
}

TEST(HardShadowLight, MatchesFrameWithoutSkipping) {
  for (int i = 0; i < 12; ++i) {
    SceneBuilder builder = with_lights({lamp(-0.25, 0.0, 0.3, 0.8), parallel(0.5, -0.3, 0.3, 0.6)});
    builder.add(box(0.1, 0.1, 0.02), test::at(0.9 - 0.15 * i, 0.0, 0.08));
    builder.add(ring(), test::at(0.1, 0.1 * i - 0.4, 0.05 * i - 0.12, {1, 0, 0}, 0.3));
    ScenePlane& wall = builder.scene().planes.emplace_back();
    wall.name = "wall";
    wall.normal = {0, -1, 0};
    wall.point = {0, 0.2, 0};
    wall.outline = {{-0.1, 0.0}, {0.1, 0.0}, {0.1, 0.2}, {-0.1, 0.2}};
    builder.scene().shadows[0].planes = {0, 1};
    Studio studio(builder.build(), distorted_camera());
    PlanOptions all;
    all.skip = false;
    const RenderedImage plain = studio.draw(white(), studio.plan(slanted(), all));
    EXPECT_EQ(studio.draw(white(), studio.plan(slanted())), plain) << i;
  }
}

TEST(HardShadowWork, RecomputesOnlyShadowsOfMovedLightsAndObjects) {
  SceneBuilder builder = with_lights({lamp(-0.25, 0.0, 0.5), lamp(0.2, 0.25, 0.4)});
  builder.add(box(0.1, 0.1, 0.02), test::at(0.0, 0.0, 0.08));
  builder.add(box(0.04, 0.04, 0.02), test::at(0.1, 0.1, 0.08));
  Studio studio(builder.build(), undistorted_camera());
  FramePlan plan = studio.plan(slanted());
  studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 4);
  const auto redraw = [&] {
    studio.draw(white(), plan);
    return std::pair(studio.stats()[Counter::triples_recomputed],
                     studio.stats()[Counter::reprojections]);
  };
  plan.T_table_camera = test::look_at({-0.2, -0.5, 0.6}, {0, 0, 0});
  EXPECT_EQ(redraw(), std::pair(std::int64_t{0}, std::int64_t{4})) << "only the camera moved";
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  for (HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.light == 1) draw.light_position.x() += 0.01;
  }
  EXPECT_EQ(redraw(), std::pair(std::int64_t{2}, std::int64_t{2})) << "one light";
  for (HardShadowDraw& draw : plan.hard_shadows) {
    if (draw.object == 0) draw.T_table_object.position.z() += 0.01;
  }
  EXPECT_EQ(redraw(), std::pair(std::int64_t{2}, std::int64_t{2})) << "one object";
}

}  // namespace
}  // namespace penumbra::hard_shadow_test
