// Shadow volumes are closed surfaces. The darkening is compared with rays to the light.
#include "render/shadow/volumes/shadow_volume.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <random>
#include <tuple>

#include "render/camera_gl.hpp"
#include "render/model/model.hpp"
#include "support/interior_pixels.hpp"
#include "support/paths.hpp"
#include "support/shadow_cases.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"
#include "support/test_form.hpp"

namespace penumbra::shadow_volume_test {
namespace {

using test::box;
using test::RenderedImage;
using test::ring;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 240;

Frame white(int side = kSide) {
  return test::plain_frame(side, side, 255);
}
SceneBuilder with_light(const Eigen::Vector3d& position_or_direction,
                        SceneLight::Kind kind = SceneLight::Kind::point) {
  SceneBuilder builder;
  builder.scene().shadows[0].technique = ShadowTechnique::volume;
  SceneLight& light = builder.scene().lights.emplace_back();
  light.name = "lamp";
  light.kind = kind;
  (kind == SceneLight::Kind::point ? light.position : light.direction) = position_or_direction;
  return builder;
}
ShadowMesh mesh_of(ShapeBuilder shape) {
  return make_shadow_mesh(shape.build());
}
const PlaneFrame kTable;

// Returns a frame of the scene as seen from the right and above.
std::vector<std::uint8_t> draw_view(const SceneBuilder& builder) {
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.3, -0.4, 0.5}, {0.0, 0.0, 0.0}));
  return studio.draw(white(), studio.plan(pose)).rgba;
}

// Tests if each edge is traversed equally often in both directions.
bool closed(const std::vector<glm::vec3>& triangles) {
  const auto key = [](const glm::vec3& p) { return std::tuple(p.x, p.y, p.z); };
  std::map<std::pair<std::tuple<float, float, float>, std::tuple<float, float, float>>, int> edges;
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    for (std::size_t k = 0; k < 3; ++k) {
      const auto a = key(triangles[i + k]);
      const auto b = key(triangles[i + (k + 1) % 3]);
      if (a < b) ++edges[{a, b}];
      if (b < a) --edges[{b, a}];
    }
  }
  return std::ranges::all_of(edges, [](const auto& edge) { return edge.second == 0; });
}

TEST(ShadowVolume, IsClosedForAnyCaster) {
  ShapeBuilder cube;
  cube.box(-0.05, -0.05, 0.1, 0.05, 0.05, 0.2);
  ShapeBuilder torus;
  torus.torus(0.06, 0.02, 16, 40);
  ShapeBuilder open;  // three sides of a box, one of them with reversed winding
  open.quad(open.vertex(0, 0, 0.1), open.vertex(0.1, 0, 0.1), open.vertex(0.1, 0.1, 0.1),
            open.vertex(0, 0.1, 0.1));
  open.quad(open.vertex(0, 0, 0.1), open.vertex(0.1, 0, 0.1), open.vertex(0.1, 0, 0.2),
            open.vertex(0, 0, 0.2));
  open.quad(open.vertex(0, 0, 0.1), open.vertex(0, 0.1, 0.1), open.vertex(0, 0.1, 0.2),
            open.vertex(0, 0, 0.2));
  for (const ShapeBuilder& shape : {cube, torus, open}) {
    const VolumeCaster caster(mesh_of(shape));
    for (const Eigen::Vector4d& light :
         {Eigen::Vector4d(0.3, 0.1, 0.6, 1.0), Eigen::Vector4d(-0.4, 0.1, 0.12, 1.0),
          Eigen::Vector4d(0.2, 0.3, 0.9, 0.0)}) {
      const ShadowVolume volume =
          caster.volume(test::at(0.01, 0.02, 0.03, {1, 2, 3}, 0.4), light, {{kTable}}, 12.0);
      ASSERT_FALSE(volume.triangles.empty());
      EXPECT_FALSE(volume.light_inside);
      EXPECT_TRUE(closed(volume.triangles));
      EXPECT_TRUE(closed(split_for_lens(volume.triangles, 0.01)));
      float lowest = 1.0F;
      for (const glm::vec3& p : volume.triangles) lowest = std::min(lowest, p.z);
      EXPECT_LT(lowest, 0.0F) << "the volume reaches through the table";
    }
  }
}

TEST(ShadowVolume, IsEmptyForLightInsideCaster) {
  ShapeBuilder cube;
  cube.box(-0.05, -0.05, 0.1, 0.05, 0.05, 0.2);
  const VolumeCaster caster(mesh_of(cube));
  const ShadowVolume inside = caster.volume({}, {0.0, 0.0, 0.15, 1.0}, {{kTable}}, 12.0);
  EXPECT_TRUE(inside.light_inside);
  EXPECT_TRUE(inside.triangles.empty());
  // For a light in the plane of the box's top, that face counts as unlit and two sides remain lit.
  const ShadowVolume level = caster.volume({}, {0.3, 0.3, 0.2, 1.0}, {{kTable}}, 12.0);
  EXPECT_FALSE(level.light_inside);
  EXPECT_TRUE(closed(level.triangles));
}

TEST(ShadowVolume, ReportsLightInsideCaster) {
  SceneBuilder builder = with_light({0.0, 0.0, 0.15});
  builder.add(box(0.1, 0.1, 0.1), test::at(0.0, 0.0, 0.15));
  builder.add(box(0.02, 0.02, 0.02), test::at(0.08, 0.0, 0.05));
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0));
  const FramePlan plan = studio.plan(test::tracked(test::look_at({0.3, -0.4, 0.5}, {0, 0, 0})));
  for (int frame = 0; frame < 2; ++frame) {  // computed, then reused
    studio.draw(white(), plan);
    ASSERT_EQ(studio.stats().skipped.size(), 1U);
    const SkippedPass& skipped = studio.stats().skipped[0];
    EXPECT_EQ(skipped.reason, SkipReason::light_inside_caster);
    EXPECT_NE(text_of(skipped, studio.scene()).find("object1: the light \"lamp\" is inside"),
              std::string::npos);
    EXPECT_EQ(studio.stats()[Counter::passes_skipped], 1);
  }
}

// The author's proxy casts projected shadows and volumes, unless proxies are disabled.
TEST(ShadowVolume, UsesAuthoredProxyModel) {
  for (const ShadowTechnique technique : {ShadowTechnique::hard, ShadowTechnique::volume}) {
    SceneBuilder builder = with_light({0.0, 0.0, 0.6});
    builder.scene().shadows[0].technique = technique;
    builder.add(box(0.05, 0.05, 0.02), test::at(0.0, 0.0, 0.1));
    const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
    const PoseEstimate pose = test::tracked(test::look_at({0.3, -0.4, 0.5}, {0.0, 0.0, 0.0}));
    const auto shadow = [&](bool proxies) {
      Studio studio(builder.build(), camera);
      PlanOptions options;
      options.proxies = proxies;
      FramePlan plan = studio.plan(pose, options);
      plan.objects.clear();
      return studio.draw(white(), plan).rgba;
    };
    const auto own = shadow(true);
    SceneObject& object = builder.scene().objects[0];
    object.proxy_model = box(0.1, 0.02, 0.02);
    const auto reduced = shadow(true);
    EXPECT_EQ(shadow(false), own);
    EXPECT_NE(reduced, own);
    object.model = object.proxy_model;
    object.proxy_model.reset();
    EXPECT_EQ(reduced, shadow(true));
  }
}

// The oracle's bitmaps show the table from outside the volume, from inside it, and with the near
// plane in the volume's side.
TEST(ShadowVolume, MatchesReferenceMasks) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto json = test::read_json(test::shared_dir() / "vectors" / "shadow_volume.json");
  std::size_t count = 0;
  for (const auto& entry : json.at("cases")) {
    const auto xyz = entry.at("caster_hull_points").get<std::vector<double>>();
    ASSERT_EQ(xyz.size(), 24U) << "only boxes are supported here";
    Eigen::Vector3d low = Eigen::Vector3d::Constant(1e9);
    Eigen::Vector3d high = -low;
    for (std::size_t i = 0; i < xyz.size(); i += 3) {
      const Eigen::Vector3d p(xyz[i], xyz[i + 1], xyz[i + 2]);
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    SceneBuilder builder = with_light(test::vector_from(entry.at("light")));
    const Eigen::Vector3d size = high - low;
    const Eigen::Vector3d middle = 0.5 * (low + high);
    builder.add(box(size.x(), size.y(), size.z()), test::at(middle.x(), middle.y(), middle.z()));
    const int side = entry.at("size").get<int>();
    CameraParameters p;
    p.width = p.height = side;
    p.fx = p.fy =
        0.5 * side / std::tan(0.5 * entry.at("fov_deg").get<double>() * std::numbers::pi / 180.0);
    p.cx = p.cy = 0.5 * (side - 1);
    Studio studio(builder.build(), CameraModel::make(p).value());
    Eigen::Matrix3d R;
    R << test::vector_from(entry.at("right")), -test::vector_from(entry.at("up")),
        test::vector_from(entry.at("forward"));
    const CameraPose pose(R, test::vector_from(entry.at("eye")));
    FramePlan plan = studio.plan(test::tracked(pose));
    plan.objects.clear();  // the oracle does not draw the caster
    const RenderedImage image = studio.draw(white(side), plan);
    const auto rows = entry.at("rows").get<std::vector<std::string>>();
    int dark = 0;
    int wrong = 0;
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        const bool expected = rows[static_cast<std::size_t>(y)][static_cast<std::size_t>(x)] == '#';
        dark += expected ? 1 : 0;
        wrong += (image.red(x, y) < 255) != expected ? 1 : 0;
      }
    }
    EXPECT_GT(dark, 20);
    EXPECT_LE(wrong, side * side / 100) << "case " << count << ", " << dark << " dark";
    ++count;
  }
  EXPECT_GE(count, 3U);
}

// A box with any placement in the table frame, for ray tests.
struct Block {
  Placement placement;
  Eigen::Vector3d half;
  // Returns the smallest t above `min_distance` at which p + t d crosses the box's surface.
  [[nodiscard]] double hit(const Eigen::Vector3d& p, const Eigen::Vector3d& d,
                           double min_distance) const {
    const Eigen::Vector3d from =
        placement.rotation.conjugate() * (p - placement.position) / placement.scale;
    const Eigen::Vector3d along = placement.rotation.conjugate() * d / placement.scale;
    double enter = -std::numeric_limits<double>::infinity();
    double leave = -enter;
    for (int i = 0; i < 3; ++i) {
      const double a = (-half[i] - from[i]) / along[i];
      const double b = (half[i] - from[i]) / along[i];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    if (enter > leave || leave <= min_distance) return std::numeric_limits<double>::infinity();
    return enter > min_distance ? enter : leave;
  }
  // Returns the normal of the face that contains this surface point, in the table frame.
  [[nodiscard]] Eigen::Vector3d normal(const Eigen::Vector3d& p) const {
    const Eigen::Vector3d at =
        placement.rotation.conjugate() * (p - placement.position) / placement.scale;
    Eigen::Index axis = 0;
    at.cwiseQuotient(half).cwiseAbs().maxCoeff(&axis);
    Eigen::Vector3d n = Eigen::Vector3d::Zero();
    n[axis] = at[axis] > 0.0 ? 1.0 : -1.0;
    return placement.rotation * n;
  }
};

// Returns the fraction of the red light at a point that comes from one light, by Lambert's law.
double share_of(int light, const FramePlan& plan, const Scene& scene, const Eigen::Vector3d& place,
                const Eigen::Vector3d& normal) {
  const double up = 0.5 + 0.5 * normal.z();
  double total = scene.ambient.x() * (0.52 + up * (1.08 - 0.52));
  double of_light = 0.0;
  for (std::size_t i = 0; i < plan.lights.size(); ++i) {
    const Eigen::Vector4d& at = plan.lights[i].position;
    const Eigen::Vector3d l = (at.head<3>() - at.w() * place).normalized();
    const double arriving = plan.lights[i].color.x() * std::max(0.0, normal.dot(l));
    total += arriving;
    if (static_cast<int>(i) == light) of_light = arriving;
  }
  return of_light / total;
}

struct View {
  const char* name;
  Eigen::Vector3d eye, target;
};

// The scene has a table, a phantom box, a virtual box and two casters. Each pixel is compared with
// the ray from its surface point to the light. The views are from outside, from within the shadow,
// and with the near plane in the volume's side.
class VolumeView : public testing::TestWithParam<std::tuple<View, bool>> {};
INSTANTIATE_TEST_SUITE_P(
    Views, VolumeView,
    testing::Combine(
        testing::Values(View{"outside", {0.35, -0.5, 0.45}, {0.02, 0.0, 0.03}},
                        View{"inside", {0.04, -0.01, 0.06}, {0.12, 0.03, 0.0}},
                        View{"wall_in_near_plane", {0.008, -0.05, 0.05}, {0.1, 0.03, 0.0}},
                        View{"above_the_caster", {-0.1, -0.05, 0.5}, {0.0, 0.0, 0.0}}),
        testing::Bool()),
    [](const auto& instance) {
      return std::string(std::get<0>(instance.param).name) +
             (std::get<1>(instance.param) ? "_distorted" : "");
    });

TEST_P(VolumeView, DarkensUnlitPixelsOnly) {
  const auto& [view, bent] = GetParam();
  const Eigen::Vector3d light(-0.25, 0.05, 0.6);
  SceneBuilder builder = with_light(light);
  const std::vector<Block> casters = {
      {test::at(0.0, 0.0, 0.16, {1, 0, 0}, 0.3), {0.05, 0.03, 0.01}},
      {test::at(0.02, 0.02, 0.2, {0, 0, 1}, 0.5), {0.01, 0.06, 0.01}}};
  const std::vector<Block> others = {
      {test::at(0.1, 0.02, 0.02, {0, 0, 1}, 0.3), {0.03, 0.03, 0.02}},
      {test::at(0.03, 0.09, 0.015), {0.02, 0.02, 0.015}}};
  for (const Block& block : casters) {
    builder.add(box(2 * block.half.x(), 2 * block.half.y(), 2 * block.half.z()), block.placement);
  }
  for (std::size_t i = 0; i < others.size(); ++i) {
    const Eigen::Vector3d& half = others[i].half;
    builder.add(box(2 * half.x(), 2 * half.y(), 2 * half.z()), others[i].placement, false, i == 0);
  }
  const CameraModel camera =
      bent ? test::camera_of(kSide, kSide, 200.0, DistortionModel::plumb_bob,
                             {-0.25, 0.06, 0.001, -0.0008, 0.0, 0.0, 0.0, 0.0})
           : test::camera_of(kSide, kSide, 200.0);
  Studio studio(builder.build(), camera);
  const PoseEstimate pose = test::tracked(test::look_at(view.eye, view.target));
  const RenderedImage with = studio.draw(white(), studio.plan(pose));
  PlanOptions none;
  none.technique = ShadowTechnique::none;
  const RenderedImage without = studio.draw(white(), studio.plan(pose, none));

  std::vector<int> expected(std::size_t{kSide} * kSide, -1);  // 1 shadow, 0 lit, -1 unknown
  std::vector<bool> off(expected.size());
  int dark = 0;
  int on_phantom = 0;
  int away = 0;
  int wrong = 0;
  int compared = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * (*ray / ray->z());
      double t = -view.eye.z() / d.z();
      if (!(t > 0.0)) t = std::numeric_limits<double>::infinity();
      bool phantom = false;
      const Block* shown = nullptr;
      for (std::size_t i = 0; i < others.size(); ++i) {
        const double at = others[i].hit(view.eye, d, kNear);
        if (at >= t) continue;
        phantom = i == 0;
        shown = &others[i];
        t = at;
      }
      double caster = t;
      for (const Block& block : casters) caster = std::min(caster, block.hit(view.eye, d, kNear));
      if (caster < t || !std::isfinite(t)) continue;  // the pixel shows the caster itself
      const Eigen::Vector3d place = view.eye + t * d;
      const Eigen::Vector3d to_light = light - place;
      bool blocked = false;
      for (const Block& block : casters)
        blocked = blocked || block.hit(place, to_light, 1e-9) < 1.0;
      // A face that is turned away from the light receives no light, so it can't lose any.
      const Eigen::Vector3d normal =
          shown != nullptr ? shown->normal(place) : Eigen::Vector3d::UnitZ();
      const double cosine = normal.dot(to_light.normalized());
      if (cosine > 0.0 && cosine < 0.03) continue;  // the difference is less than a grey level
      away += blocked && cosine < 0.0 ? 1 : 0;
      blocked = blocked && cosine > 0.0;
      ++compared;
      dark += blocked ? 1 : 0;
      on_phantom += blocked && phantom ? 1 : 0;
      const bool drawn = with.red(x, y) < without.red(x, y);
      wrong += drawn != blocked ? 1 : 0;
      expected[static_cast<std::size_t>(kSide * y + x)] = blocked ? 1 : 0;
      off[static_cast<std::size_t>(kSide * y + x)] = drawn != blocked;
    }
  }
  // An edge may fall on either side of a pixel centre. Pixels whose whole neighbourhood is lit or
  // in shadow must match.
  const auto [interior, wrong_interior] = test::count_interior_pixels(kSide, expected, off);
  EXPECT_GT(interior, 5000);
  EXPECT_EQ(wrong_interior, 0) << "of " << interior;
  EXPECT_GT(dark, 1000);
  EXPECT_GT(compared - dark, 1000) << "some pixels are lit";
  if (std::string(view.name) == "outside") {
    EXPECT_GT(on_phantom, 50);
    EXPECT_GT(away, 50);
  }
  EXPECT_LE(wrong, 20 + dark / 60) << dark << " dark of " << compared;
}

// Objects of an uncertain or coasting group are drawn faintly. So are their shadows and the shadows
// on them. A pixel in two shadows shows the stronger shadow.
TEST(ShadowVolume, FadesWithCasterAndReceiver) {
  const Eigen::Vector3d light(-0.15, 0.05, 0.6);
  SceneBuilder builder = with_light(light);
  const std::vector<Block> casters = {{test::at(0.0, 0.0, 0.2), {0.05, 0.04, 0.01}},
                                      {test::at(0.05, 0.02, 0.22), {0.04, 0.05, 0.01}}};
  const std::vector<Block> others = {{test::at(0.10, -0.085, 0.02), {0.03, 0.03, 0.02}},
                                     {test::at(0.10, 0.045, 0.015), {0.04, 0.03, 0.015}}};
  for (const auto* blocks : {&casters, &others}) {
    for (std::size_t i = 0; i < blocks->size(); ++i) {
      const Block& block = (*blocks)[i];
      const bool casts = blocks == &casters;
      builder.add(box(2 * block.half.x(), 2 * block.half.y(), 2 * block.half.z()), block.placement,
                  casts, !casts && i == 0);
    }
  }
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  Studio studio(builder.build(), camera);
  const Eigen::Vector3d eye(0.3, -0.4, 0.5);
  const PoseEstimate pose = test::tracked(test::look_at(eye, {0.05, 0.02, 0.05}));
  constexpr float kTableOpacity = 0.9F;
  constexpr float kPhantomOpacity = 0.65F;
  constexpr float kObjectOpacity = 0.3F;
  constexpr std::array<float, 2> kCasterOpacity = {0.5F, 1.0F};
  FramePlan plan = studio.plan(pose);
  ASSERT_EQ(plan.volumes.size(), 2U);
  plan.receivers[0].opacity = kTableOpacity;
  plan.phantoms[0].opacity = kPhantomOpacity;
  for (ObjectDraw& object : plan.objects) {
    if (object.object == 3) object.opacity = kObjectOpacity;
  }
  for (std::size_t i = 0; i < 2; ++i) plan.volumes[i].opacity = kCasterOpacity[i];
  const RenderedImage with = studio.draw(white(), plan);
  plan.volumes.clear();
  const RenderedImage without = studio.draw(white(), plan);

  std::map<std::pair<float, float>, int> seen;  // keyed by the opacity of receiver and caster
  int wrong = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * (*ray / ray->z());
      double t = -eye.z() / d.z();
      float receiver = kTableOpacity;
      const Block* shown = nullptr;
      for (std::size_t i = 0; i < others.size(); ++i) {
        const double at = others[i].hit(eye, d, kNear);
        if (at >= t) continue;
        t = at;
        shown = &others[i];
        receiver = i == 0 ? kPhantomOpacity : kObjectOpacity;
      }
      const Eigen::Vector3d place = eye + t * d;
      bool caster_seen = false;
      float caster = 0.0F;
      for (std::size_t i = 0; i < casters.size(); ++i) {
        caster_seen = caster_seen || casters[i].hit(eye, d, kNear) < t;
        if (casters[i].hit(place, light - place, 1e-9) < 1.0) {
          caster = std::max(caster, kCasterOpacity[i]);
        }
      }
      if (caster_seen) continue;
      ++seen[{receiver, caster}];
      const double opacity = static_cast<double>(std::min(receiver, caster));
      const double covered =
          share_of(0, plan, builder.scene(), place,
                   shown != nullptr ? shown->normal(place) : Eigen::Vector3d::UnitZ());
      const double expected =
          without.red(x, y) * (1.0 - opacity * (1.0 - std::pow(1.0 - covered, 1.0 / 2.2)));
      wrong += std::abs(with.red(x, y) - expected) > 1.5 ? 1 : 0;
    }
  }
  for (const float receiver : {kTableOpacity, kPhantomOpacity, kObjectOpacity}) {
    for (const float caster : {0.0F, 0.5F, 1.0F}) {
      EXPECT_GT((seen[{receiver, caster}]), 20) << receiver << " " << caster;
    }
  }
  EXPECT_LE(wrong, 350) << "pixels away from edges differ; total: " << kSide * kSide;

  // With uniform opacity, both drawing modes give the same frame.
  FramePlan even = studio.plan(pose);
  const RenderedImage solid = studio.draw(white(), even);
  even.phantoms[0].opacity = 0.999999F;
  const RenderedImage by_receiver = studio.draw(white(), even);
  int other = 0;
  for (std::size_t i = 0; i < solid.rgba.size(); ++i) {
    other += std::abs(solid.rgba[i] - by_receiver.rgba[i]) > 1 ? 1 : 0;
  }
  EXPECT_EQ(other, 0);
}

// The scene has three lights, two casters and two nodes. The lights of a node act on its casters
// only. If several lights do not reach a pixel, the pixel loses the light of each of them once.
TEST(ShadowVolume, DrawsEveryLightOfEveryNode) {
  const std::vector<Eigen::Vector3d> lights = {
      {-0.2, 0.05, 0.6}, {0.15, -0.25, 0.5}, {0.2, 0.3, 0.7}};
  SceneBuilder builder = with_light(lights[0]);
  for (std::size_t i = 1; i < lights.size(); ++i) {
    SceneLight& light = builder.scene().lights.emplace_back(builder.scene().lights[0]);
    light.name += std::to_string(i);
    light.position = lights[i];
    light.intensity = 0.7 - 0.2 * static_cast<double>(i);
    light.color = {1.0, 0.5, 0.3};
  }
  const std::vector<Block> casters = {{test::at(-0.02, 0.0, 0.06), {0.05, 0.07, 0.01}},
                                      {test::at(0.04, 0.02, 0.09), {0.05, 0.06, 0.01}}};
  for (const Block& block : casters) {
    builder.add(box(2 * block.half.x(), 2 * block.half.y(), 2 * block.half.z()), block.placement);
  }
  const std::vector<std::vector<int>> lights_of_caster = {{0, 1}, {1, 2}};
  std::vector<ShadowNode>& nodes = builder.scene().shadows;
  nodes.push_back(nodes[0]);
  nodes[1].name = "second";
  for (std::size_t i = 0; i < 2; ++i) {
    nodes[i].casters = {static_cast<int>(i)};
    nodes[i].lights = lights_of_caster[i];
  }
  const CameraModel camera = test::camera_of(kSide, kSide, 260.0);
  Studio studio(builder.build(), camera);
  const Eigen::Vector3d eye(0.3, -0.4, 0.5);
  const PoseEstimate pose = test::tracked(test::look_at(eye, {0.02, 0.02, 0.0}));
  FramePlan plan = studio.plan(pose);
  EXPECT_TRUE(plan.skipped.empty());
  ASSERT_EQ(plan.volumes.size(), 4U);
  plan.objects.clear();
  const RenderedImage solid = studio.draw(white(), plan);
  // An opacity just below 1 selects drawing caster by caster.
  plan.volumes[0].opacity = 0.999999F;
  const RenderedImage faint = studio.draw(white(), plan);

  std::map<int, int> seen;  // keyed by the set of blocked lights
  int wrong = 0;
  int apart = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d place = eye - d * (eye.z() / d.z());
      int missed = 0;
      for (std::size_t i = 0; i < casters.size(); ++i) {
        for (const int light : lights_of_caster[i]) {
          const Eigen::Vector3d to_light = lights[static_cast<std::size_t>(light)] - place;
          if (casters[i].hit(place, to_light, 1e-9) < 1.0) missed |= 1 << light;
        }
      }
      double left = 1.0;
      for (int light = 0; light < 3; ++light) {
        if ((missed >> light & 1) == 0) continue;
        left -= share_of(light, plan, builder.scene(), place, Eigen::Vector3d::UnitZ());
      }
      ++seen[missed];
      wrong += std::abs(solid.red(x, y) - 255.0 * std::pow(left, 1.0 / 2.2)) > 1.5 ? 1 : 0;
      apart += std::abs(solid.red(x, y) - faint.red(x, y)) > 1 ? 1 : 0;
    }
  }
  for (const int missed : {0, 1, 2, 3, 4, 6}) EXPECT_GT(seen[missed], 40) << missed;
  EXPECT_LE(wrong, 350) << "pixels away from edges differ; total: " << kSide * kSide;
  EXPECT_EQ(apart, 0);
}

// More closed parts overlap than the stencil can count. The result must stay dark.
TEST(ShadowVolume, StaysDarkForManyStackedParts) {
  ShapeBuilder stack;
  constexpr int kParts = 128;  // twice the range of the stencil counter
  for (int i = 0; i < kParts; ++i) {
    const double z = 0.05 + 0.001 * i;
    stack.box(-0.05, -0.05, z, 0.05, 0.05, z + 0.0005);
  }
  const VolumeCaster caster(mesh_of(stack));
  const ShadowVolume volume = caster.volume({}, {0.0, 0.0, 5.0, 1.0}, {{kTable}}, 12.0);
  ASSERT_GE(volume.batch_ends.size(), 3U);
  EXPECT_LE(volume.batch_ends.size(), 6U);
  EXPECT_EQ(volume.batch_ends.back(), volume.triangles.size());
  std::size_t begin = 0;
  for (const std::size_t end : volume.batch_ends) {
    ASSERT_GT(end, begin);
    EXPECT_TRUE(closed({volume.triangles.begin() + static_cast<std::ptrdiff_t>(begin),
                        volume.triangles.begin() + static_cast<std::ptrdiff_t>(end)}));
    begin = end;
  }
  SceneBuilder builder = with_light({0.0, 0.0, 5.0});
  builder.add(test::finished(stack.build(), glm::vec4(1.0F)), Placement());
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 200.0));
  FramePlan plan = studio.plan(test::tracked(test::look_at({0.0, -0.3, 0.4}, {0, 0, 0})));
  plan.objects.clear();
  const RenderedImage image = studio.draw(white(), plan);
  EXPECT_LT(image.red(kSide / 2, kSide / 2), 250);
}

// Coincident planes (two names for one table) darken each pixel once.
TEST(ShadowVolume, DarkensCoincidentPlanesOnce) {
  SceneBuilder builder = with_light({-0.2, 0.05, 0.6});
  builder.add(box(0.08, 0.08, 0.02), test::at(0.0, 0.0, 0.1));
  const auto once = draw_view(builder);
  ScenePlane& again = builder.scene().planes.emplace_back(builder.scene().planes[0]);
  again.name = "again";
  builder.scene().shadows[0].planes = {0, 1};
  EXPECT_EQ(draw_view(builder), once);
}

// A phantom on the plane blocks the light rays behind it, so the projected shadow must continue on
// the phantom. The phantom's pixels are compared with rays to the light. The plane's own shadow
// must not change.
TEST(ShadowVolume, ContinuesProjectedShadowsOnPhantoms) {
  const Eigen::Vector3d light(-0.25, 0.05, 0.6);
  SceneBuilder builder = with_light(light);
  builder.scene().shadows[0].technique = ShadowTechnique::hard;
  const Block caster = {test::at(0.0, 0.0, 0.16, {1, 0, 0}, 0.3), {0.05, 0.03, 0.01}};
  const Block phantom = {test::at(0.1, 0.02, 0.02, {0, 0, 1}, 0.3), {0.03, 0.03, 0.02}};
  const Block object = {test::at(0.03, 0.09, 0.015), {0.02, 0.02, 0.015}};
  const auto add = [&builder](const Block& block, bool casts, bool is_phantom) {
    builder.add(box(2 * block.half.x(), 2 * block.half.y(), 2 * block.half.z()), block.placement,
                casts, is_phantom);
  };
  add(caster, true, false);
  add(phantom, false, true);
  add(object, false, false);
  const CameraModel camera = test::camera_of(kSide, kSide, 200.0);
  Studio studio(builder.build(), camera);
  const Eigen::Vector3d eye(0.35, -0.5, 0.45);
  const PoseEstimate pose = test::tracked(test::look_at(eye, {0.05, 0.0, 0.03}));
  FramePlan plan = studio.plan(pose);
  ASSERT_EQ(plan.volumes.size(), 1U);
  EXPECT_FALSE(plan.volumes[0].on_planes);
  ASSERT_EQ(plan.hard_shadows.size(), 1U);
  const RenderedImage with = studio.draw(white(), plan);
  plan.volumes.clear();
  const RenderedImage without = studio.draw(white(), plan);
  int dark = 0;
  int wrong = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const double t = phantom.hit(eye, d, kNear);
      const bool shown =
          t < std::min({-eye.z() / d.z(), object.hit(eye, d, kNear), caster.hit(eye, d, kNear)});
      double left = 1.0;
      if (shown) {
        const Eigen::Vector3d place = eye + t * d;
        const bool blocked = caster.hit(place, light - place, 1e-9) < 1.0;
        if (blocked) left -= share_of(0, plan, builder.scene(), place, phantom.normal(place));
        dark += left < 1.0 ? 1 : 0;
      }
      const double expected = without.red(x, y) * std::pow(left, 1.0 / 2.2);
      wrong += std::abs(with.red(x, y) - expected) > 1.5 ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 80);
  EXPECT_LE(wrong, 20) << "pixels away from edges differ; dark: " << dark;
}

// A volume is skipped only if it contains no part of a phantom. Skipping must not change the frame.
TEST(ShadowVolume, SkipsVolumesWithoutPhantomForProjectedShadows) {
  std::mt19937 random(11);
  const auto within = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  int left_out = 0;
  int drawn = 0;
  for (int i = 0; i < 24; ++i) {
    SceneBuilder builder =
        i % 2 == 0
            ? with_light({within(-0.3, 0.3), within(-0.3, 0.3), within(0.25, 0.6)})
            : with_light(Eigen::Vector3d(within(-1, 1), within(-1, 1), within(0.3, 1)).normalized(),
                         SceneLight::Kind::directional);
    builder.scene().shadows[0].technique = ShadowTechnique::hard;
    builder.add(box(within(0.02, 0.1), within(0.02, 0.1), within(0.02, 0.1)),
                test::at(within(-0.12, 0.12), within(-0.12, 0.12), within(0.06, 0.2), {1, 1, 0},
                         within(0, 3)));
    builder.add(box(within(0.02, 0.1), within(0.02, 0.1), within(0.02, 0.1)),
                test::at(within(-0.12, 0.12), within(-0.12, 0.12), within(0.0, 0.1), {0, 0, 1},
                         within(0, 3)),
                false, true);
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0));
    const PoseEstimate pose = test::tracked(test::look_at({0.3, -0.4, 0.5}, {0.0, 0.0, 0.0}));
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(pose);
    const FramePlan whole = studio.plan(pose, all);
    EXPECT_EQ(whole.volumes.size(), 1U);
    (skipping.volumes.empty() ? left_out : drawn) += 1;
    EXPECT_EQ(studio.draw(white(), skipping).rgba, studio.draw(white(), whole).rgba) << i;
  }
  EXPECT_GT(left_out, 5);
  EXPECT_GT(drawn, 5);
}

// One light acts in two nodes, by projection in one and by volume in the other. A pixel in both
// shadows loses the light once.
TEST(ShadowVolume, CountsLightOnceWithProjectedShadow) {
  SceneBuilder builder = with_light({-0.2, 0.05, 0.6});
  builder.add(box(0.08, 0.08, 0.02), test::at(0.0, 0.0, 0.1));
  builder.add(box(0.06, 0.1, 0.02), test::at(0.02, 0.01, 0.2));
  std::vector<ShadowNode>& nodes = builder.scene().shadows;
  nodes[0].casters = {0, 1};
  const auto volumes = draw_view(builder);
  nodes.push_back(nodes[0]);
  nodes[0].casters = {0};
  nodes[1].casters = {1};
  nodes[1].technique = ShadowTechnique::hard;
  EXPECT_EQ(draw_view(builder), volumes);
}

// One light has a projected shadow, the other a shadow volume. A pixel in both shadows loses the
// light of both lights.
TEST(ShadowVolume, AddsToProjectedShadowOfOtherLight) {
  SceneBuilder builder = with_light({-0.2, 0.05, 0.6});
  SceneLight& second = builder.scene().lights.emplace_back(builder.scene().lights[0]);
  second.name = "second";
  second.position = {0.1, -0.2, 0.5};
  builder.add(box(0.08, 0.08, 0.02), test::at(0.0, 0.0, 0.1));
  std::vector<ShadowNode>& nodes = builder.scene().shadows;
  nodes.push_back(nodes[0]);
  nodes[1].lights = {1};
  nodes[1].name = "other";
  const auto volumes = draw_view(builder);
  nodes[1].technique = ShadowTechnique::hard;
  EXPECT_EQ(draw_view(builder), volumes);
}

// The plane hides a phantom below it. Pixels there are darkened only by the plane's shadow.
TEST(ShadowVolume, IgnoresPhantomsUnderPlane) {
  SceneBuilder builder = with_light({-0.2, 0.05, 0.6});
  builder.scene().shadows[0].technique = ShadowTechnique::hard;
  builder.add(box(0.08, 0.08, 0.02), test::at(0.0, 0.0, 0.1));
  const auto alone = draw_view(builder);
  builder.add(box(0.3, 0.3, 0.02), test::at(0.0, 0.0, -0.015), false, true);
  EXPECT_EQ(draw_view(builder), alone);
}

// Parts that do not overlap share a batch of stencil counting.
TEST(ShadowVolume, HasFewBatchesForTree) {
  const Result<Model> tree = load_model(test::source_dir() / "scenes" / "models" / "tree.glb");
  ASSERT_TRUE(tree) << tree.error().message;
  const VolumeCaster caster(make_shadow_mesh(*tree));
  for (const Eigen::Vector4d& light :
       {Eigen::Vector4d(0.3, 0.1, 0.9, 1.0), Eigen::Vector4d(-0.4, 0.1, 0.3, 1.0),
        Eigen::Vector4d(0.2, 0.3, 0.9, 0.0), Eigen::Vector4d(0.9, 0.0, 0.2, 0.0),
        Eigen::Vector4d(0.01, 0.0, 0.2, 1.0)}) {  // this light is among the leaves
    const ShadowVolume volume = caster.volume({}, light, {{kTable}}, 12.0);
    EXPECT_FALSE(volume.triangles.empty());
    EXPECT_LE(volume.batch_ends.size(), 3U);
  }
}

TEST(ShadowVolume, IsUnchangedForInvertedClosedPart) {
  ShapeBuilder cube;
  cube.box(-0.05, -0.05, 0.1, 0.05, 0.05, 0.2);
  ShadowMesh mesh = mesh_of(cube);
  const Eigen::Vector4d outside(0.3, 0.1, 0.6, 1.0);
  const Eigen::Vector4d inside(0.0, 0.0, 0.15, 1.0);
  const std::size_t right =
      VolumeCaster(mesh).volume({}, outside, {{kTable}}, 12.0).triangles.size();
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    std::swap(mesh.indices[i], mesh.indices[i + 1]);
  }
  const VolumeCaster caster(mesh);
  const ShadowVolume volume = caster.volume({}, outside, {{kTable}}, 12.0);
  EXPECT_EQ(volume.triangles.size(), right);
  EXPECT_TRUE(closed(volume.triangles));
  EXPECT_TRUE(caster.volume({}, inside, {{kTable}}, 12.0).light_inside);
  // A double-sided card has no interior, even if seen edge-on.
  ShapeBuilder card;
  const auto a = card.vertex(0, 0, 0.1), b = card.vertex(0.1, 0, 0.1),
             c = card.vertex(0.1, 0.1, 0.1), d = card.vertex(0, 0.1, 0.1);
  card.quad(a, b, c, d);
  card.quad(d, c, b, a);
  EXPECT_FALSE(
      VolumeCaster(mesh_of(card)).volume({}, {0.3, 0.3, 0.1, 1.0}, {{kTable}}, 12.0).light_inside);
}

// Two nodes share caster and light. The volume is computed once and extends to the receivers of
// both.
TEST(ShadowVolume, IsDrawnOnceForTwoNodes) {
  SceneBuilder builder = with_light({-0.2, 0.05, 0.6});
  builder.add(box(0.08, 0.08, 0.02), test::at(0.0, 0.0, 0.1));
  std::vector<ShadowNode>& nodes = builder.scene().shadows;
  ScenePlane& sunk = builder.scene().planes.emplace_back();
  sunk.name = "sunk";
  sunk.point.z() = -0.3;
  nodes.push_back(nodes[0]);
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.3, -0.4, 0.5}, {0.0, 0.0, 0.0}));
  const FramePlan twice = studio.plan(pose);
  EXPECT_EQ(twice.volumes.size(), 1U);
  EXPECT_EQ(twice.volumes[0].floors.size(), 1U);
  nodes[1].planes = {1};
  EXPECT_EQ(Studio(builder.build(), test::camera_of(kSide, kSide, 260.0))
                .plan(pose)
                .volumes.at(0)
                .floors.size(),
            2U);
  builder.scene().planes[1].outline = {{-1, -1}, {1, -1}, {1, 1}, {-1, 1}};
  const FramePlan bounded =
      Studio(builder.build(), test::camera_of(kSide, kSide, 260.0)).plan(pose);
  EXPECT_TRUE(bounded.volumes.at(0).floors.empty())
      << "the volume must extend to the farthest receiver";
}

TEST(ShadowVolume, NeverDarkensPixelsWithoutReceiver) {
  SceneBuilder builder = with_light({0.0, 0.0, 0.5});
  builder.add(ring(), test::at(0.0, 0.0, 0.2));
  builder.scene().planes[0].outline = {{0.03, -0.06}, {0.15, -0.06}, {0.15, 0.06}, {0.03, 0.06}};
  const CameraModel camera = test::camera_of(kSide, kSide, 200.0);
  Studio studio(builder.build(), camera);
  FramePlan plan = studio.plan(test::tracked(test::look_at({0.3, -0.4, 0.4}, {0, 0, 0})));
  plan.objects.clear();
  const RenderedImage image = studio.draw(white(), plan);
  int dark = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      if (image.red(x, y) == 255) continue;
      ++dark;
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      const Eigen::Vector3d d = plan.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d eye = plan.T_table_camera.translation();
      const Eigen::Vector3d p = eye - d * (eye.z() / d.z());
      EXPECT_LE((p.head<2>() - Eigen::Vector2d(0.09, 0.0)).cwiseAbs().maxCoeff(), 0.062)
          << "outside the sheet";
    }
  }
  EXPECT_GT(dark, 100);
}

TEST(ShadowVolume, IsRecomputedOnlyWhenCasterOrLightMoves) {
  SceneBuilder builder = with_light({0.1, 0.2, 0.8}, SceneLight::Kind::directional);
  builder.add(ring(), test::at(0.0, 0.0, 0.2));
  builder.add(box(0.02, 0.02, 0.02), test::at(0.1, 0.0, 0.1));
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 200.0));
  FramePlan plan = studio.plan(test::tracked(test::look_at({0.3, -0.4, 0.4}, {0, 0, 0})));
  studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 2);
  plan.T_table_camera = test::look_at({-0.3, -0.4, 0.4}, {0, 0, 0});
  studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 0);
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  plan.volumes[1].T_table_object.position.z() += 0.01;
  studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 1);
  // If a floor sinks, the volume must become longer.
  for (ShadowVolumeDraw& draw : plan.volumes) draw.floors[0].q.z() -= 0.3;
  studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 2);
}

// Skipping volumes must not change the frame, for one light and for two.
TEST(ShadowVolume, IsSkippedOutOfView) {
  std::mt19937 random(5);
  const auto within = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  int skipped_count = 0;
  int drawn = 0;
  const int scenes = test::nightly() ? 40 : 20;
  for (int i = 0; i < scenes; ++i) {
    SceneBuilder builder =
        i % 2 == 0
            ? with_light({within(-0.5, 0.5), within(-0.5, 0.5), within(0.1, 0.8)})
            : with_light(Eigen::Vector3d(within(-1, 1), within(-1, 1), within(0.1, 1)).normalized(),
                         SceneLight::Kind::directional);
    if (i % 3 == 0) {
      SceneLight& second = builder.scene().lights.emplace_back(builder.scene().lights[0]);
      second.name = "second";
      second.position = {within(-0.5, 0.5), within(-0.5, 0.5), within(0.2, 0.8)};
      builder.scene().shadows[0].lights = {0, 1};
    }
    if (i % 5 == 0) {
      builder.scene().planes[0].outline = {{-0.4, -0.4}, {0.4, -0.4}, {0.4, 0.4}, {-0.4, 0.4}};
    }
    for (int k = 0; k < 4; ++k) {
      builder.add(box(within(0.02, 0.1), within(0.02, 0.1), within(0.02, 0.1)),
                  test::at(within(-0.8, 0.8), within(-0.8, 0.8), within(0.03, 0.3), {1, 1, 0},
                           within(0, 3)));
    }
    builder.add(box(0.1, 0.1, 0.1), test::at(within(-0.2, 0.2), within(-0.2, 0.2), 0.02), false,
                i % 2 == 0);
    Studio studio(builder.build(), i % 4 == 0 ? test::distorted_camera(kSide, 260.0)
                                              : test::camera_of(kSide, kSide, 260.0));
    const PoseEstimate pose = test::tracked(test::look_at(
        {within(-0.5, 0.5), -0.4, within(0.1, 0.6)}, {within(-0.3, 0.3), within(-0.3, 0.3), 0.0}));
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(pose);
    const FramePlan whole = studio.plan(pose, all);
    const auto reported =
        std::ranges::count(skipping.skipped, SkipReason::volume_out_of_view, &SkippedPass::reason);
    EXPECT_EQ(skipping.volumes.size() + static_cast<std::size_t>(reported), whole.volumes.size());
    EXPECT_EQ(
        std::ranges::count(whole.skipped, SkipReason::volume_out_of_view, &SkippedPass::reason), 0);
    skipped_count += static_cast<int>(reported);
    drawn += static_cast<int>(skipping.volumes.size());
    EXPECT_EQ(studio.draw(white(), skipping).rgba, studio.draw(white(), whole).rgba) << i;
  }
  EXPECT_GT(skipped_count, scenes / 2);
  EXPECT_GT(drawn, scenes / 2);
}

TEST(ShadowVolume, DrawsNothingWhenEverythingIsOutOfView) {
  SceneBuilder builder = with_light({3.1, 0.0, 0.6});
  builder.scene().shadows[0].light_rays = true;
  builder.add(box(0.1, 0.1, 0.1), test::at(3.0, 0.0, 0.1));
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0), GlApi::gl33,
                {.msaa = 0, .video_on_cpu = true});
  const PoseEstimate pose = test::tracked(test::look_at({0.0, -0.2, 0.4}, {0.0, 0.0, 0.0}));
  const FramePlan plan = studio.plan(pose);
  EXPECT_TRUE(plan.objects.empty() && plan.volumes.empty() && plan.rays.empty());
  std::vector<std::string> reasons;
  for (const SkippedPass& pass : plan.skipped) reasons.push_back(text_of(pass, studio.scene()));
  EXPECT_EQ(reasons, (std::vector<std::string>{"object1: outside the view",
                                               "object1: its light rays are outside the view",
                                               "object1: its shadow volume is outside the view"}));
  const RenderedImage image = studio.draw(white(), plan);
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  EXPECT_LE(studio.stats()[Counter::draw_calls], 1) << "the plane's stencil";
  PlanOptions all;
  all.skip = false;
  EXPECT_EQ(image, studio.draw(white(), studio.plan(pose, all)));
  EXPECT_GT(studio.stats()[Counter::draw_calls], 5);
}

TEST(ShadowVolume, ReportsCasterThatIsTooLarge) {
  const auto reported = [](double length) {
    SceneBuilder builder = with_light({0.05, -0.05, 0.7});
    builder.add(box(length, 0.02, 0.02), test::at(0.0, 0.0, 0.08));
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 260.0));
    const PoseEstimate pose = test::tracked(test::look_at({0.3, -0.4, 0.5}, {0.0, 0.0, 0.0}));
    for (int frame = 0; frame < 2; ++frame) {  // computed, then reused
      studio.draw(white(), studio.plan(pose));
    }
    return studio.stats().skipped.size() == 1 &&
           studio.stats().skipped[0].reason == SkipReason::volume_too_far;
  };
  EXPECT_FALSE(reported(0.5));
  EXPECT_FALSE(reported(10.0));
  EXPECT_TRUE(reported(22.0));
  EXPECT_TRUE(reported(40.0));
}

}  // namespace
}  // namespace penumbra::shadow_volume_test
