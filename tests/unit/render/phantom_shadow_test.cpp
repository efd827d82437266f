// Layered, field and simple shadows on phantoms and objects. Each point of a receiver is compared
// with the shadow on a plane at the point's height; reuse and skipping must not change the result.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>

#include "render/scene/shapes.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "render/shadow/layers/receiving_levels.hpp"
#include "support/edge_error.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"
#include "support/test_form.hpp"

namespace penumbra::phantom_shadow_test {
namespace {

using test::box;
using test::RenderedImage;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 300;

Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}
// Draws the plane's shadow without masks, so that no pixel is partly covered. Tests compare shadows
// on receivers with the values on both sides of such an edge.
RenderedImage draw_directly(Studio& studio, FramePlan plan) {
  plan.layers = LayerDrawing::direct;
  return studio.draw_shadows(white(), plan);
}
// Returns the distance of `value` from the range of values in the pixel's 3 x 3 neighbourhood,
// which contains both sides of an edge.
double off(double value, const RenderedImage& image, int x, int y) {
  int low = 255;
  int high = 0;
  for (int j = std::max(y - 1, 0); j <= std::min(y + 1, image.height - 1); ++j) {
    for (int i = std::max(x - 1, 0); i <= std::min(x + 1, image.width - 1); ++i) {
      low = std::min(low, image.red(i, j));
      high = std::max(high, image.red(i, j));
    }
  }
  return std::max({low - value, value - high, 0.0});
}
CameraModel camera() {
  return test::camera_of(kSide, kSide, 420.0);
}
PoseEstimate from(const Eigen::Vector3d& eye) {
  return test::tracked(test::look_at(eye, {0.0, 0.0, 0.05}));
}
std::shared_ptr<const Model> solid(const Model& shape) {
  return test::finished(shape, glm::vec4(1.0F));
}
// A letter L with arms of unequal length.
std::shared_ptr<const Model> l_shape() {
  ShapeBuilder shape;
  shape.box(-0.04, -0.04, 0.0, 0.05, -0.015, 0.02);
  shape.box(-0.04, -0.015, 0.0, -0.015, 0.04, 0.02);
  return solid(shape.build());
}
SceneBuilder builder_with(ShadowTechnique technique,
                          LightMode light_mode = LightMode::proportional) {
  SceneBuilder builder;
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = technique;
  node.light_mode = light_mode;
  node.layered = make_layered_constants(0.6, 2.5, 0.0).value();
  node.fractions = {0.1, 0.3, 0.7};
  return builder;
}

// Removes the scene's first object, the caster, from the plan but keeps its shadow.
FramePlan without_caster(FramePlan plan) {
  std::erase_if(plan.objects, [](const ObjectDraw& draw) { return draw.object == 0; });
  return plan;
}
FramePlan without_received(FramePlan plan) {
  plan.received_shadows.clear();
  return plan;
}

const Eigen::AlignedBox2d kEverywhere(Eigen::Vector2d(-10.0, -10.0), Eigen::Vector2d(10.0, 10.0));

std::vector<double> levels_of(const Model& model, const Placement& placement, double top = 10.0) {
  return ReceivingSurface(model, placement, PlaneFrame()).levels(kEverywhere, top, 64);
}
Model ball(double radius, int rings) {
  ShapeBuilder shape;
  shape.sphere(radius, rings, 2 * rings);
  return shape.build();
}
Model standing_box(double side, double height) {
  ShapeBuilder shape;
  shape.box(-side / 2, -side / 2, 0.0, side / 2, side / 2, height);
  return shape.build();
}
// A staircase of twenty steps along x, each 15 mm high and 20 mm deep.
Model staircase() {
  ShapeBuilder shape;
  for (int i = 0; i < 20; ++i) {
    shape.box(0.02 * i, -0.05, 0.0, 0.02 * (i + 1), 0.05, 0.015 * (i + 1));
  }
  return shape.build();
}
// A ramp from x = 0 to `length` that rises by `slope`, in cells of size `cell`.
Model ramp(double length, double slope, double cell) {
  ShapeBuilder shape;
  const int count = static_cast<int>(std::lround(length / cell));
  for (int i = 0; i < count; ++i) {
    for (int j = -4; j < 4; ++j) {
      const auto at = [&](int x, int y) {
        return shape.vertex(cell * x, 0.0125 * y, 0.001 + slope * cell * x);
      };
      shape.quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
    }
  }
  return shape.build();
}

TEST(ReceivingLevels, LieOnSurfacesFacingLight) {
  const Model cube = make_box(glm::vec3(0.1F));
  const auto top = levels_of(cube, test::at(0.2, 0.1, 0.05, {0, 0, 1}, 0.7));
  ASSERT_FALSE(top.empty());
  EXPECT_NEAR(top.back(), 0.1, 1e-7);
  EXPECT_TRUE(levels_of(cube, test::at(0, 0, -0.06)).empty()) << "under the plane";
  // The receiver has two levels, one for each step.
  ShapeBuilder steps;
  steps.box(0, 0, 0, 0.05, 0.1, 0.02);
  steps.box(0.05, 0, 0, 0.1, 0.1, 0.06);
  const auto two = levels_of(steps.build(), Placement());
  ASSERT_EQ(two.size(), 2U);
  EXPECT_NEAR(two[0], 0.02, 1e-7);
  EXPECT_NEAR(two[1], 0.06, 1e-7);
  EXPECT_EQ(levels_of(staircase(), Placement()).size(), 20U);
  // Levels above the caster or beside it do not count.
  EXPECT_EQ(levels_of(staircase(), Placement(), 0.16).size(), 10U);
  const ReceivingSurface surface(staircase(), Placement(), PlaneFrame());
  const Eigen::AlignedBox2d third(Eigen::Vector2d(0.045, 0.0), Eigen::Vector2d(0.055, 0.01));
  ASSERT_EQ(surface.levels(third, 1.0, 64).size(), 1U);
  EXPECT_NEAR(surface.levels(third, 1.0, 64)[0], 0.045, 1e-7);
}

// The spacing must not depend on the size of the faces.
TEST(ReceivingLevels, AreCloselySpacedOnSlopes) {
  const auto check = [](const std::vector<double>& levels, double low, double high) {
    ASSERT_GT(levels.size(), 2U);
    EXPECT_LE(levels.size(), 64U);
    EXPECT_NEAR(levels.front(), low, 2e-3);
    EXPECT_NEAR(levels.back(), high, 2e-3);
    for (std::size_t i = 1; i < levels.size(); ++i) {
      EXPECT_GT(levels[i], levels[i - 1]);
      EXPECT_LE(levels[i] - levels[i - 1], std::max(kLevelStep, (high - low) / 60.0) + 1e-9);
    }
  };
  for (const int rings : {12, 60, 400}) {
    SCOPED_TRACE(rings);
    check(levels_of(ball(0.05, rings), test::at(0, 0, 0.05)), 0.0, 0.1);
  }
  for (const double cell : {0.0005, 0.004, 0.02}) {
    SCOPED_TRACE(cell);
    check(levels_of(ramp(0.2, 0.18, cell), Placement()), 0.001, 0.037);
  }
  check(levels_of(make_box(glm::vec3(0.4F)), test::at(0, 0, 0, {1, 0, 0}, 0.7)), 0.0, 0.28);
}

TEST(ReceivingLevels, AreSortedAndBoundedForTriangleSoup) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> coordinate(-0.2, 0.2);
  int with_levels = 0;
  for (int i = 0; i < 200; ++i) {
    ShapeBuilder soup;
    double lowest = 1.0;
    double highest = 0.0;
    const Placement placement = test::at(0, 0, 0.05, {1, 2, 3}, 0.1 * i);
    for (int face = 0; face < 12; ++face) {
      const auto corner = [&] {
        const Eigen::Vector3d p(coordinate(random), coordinate(random), coordinate(random));
        const double z = (placement * p).z();
        lowest = std::min(lowest, std::max(z, 0.0));
        highest = std::max(highest, z);
        return soup.vertex(p.x(), p.y(), p.z());
      };
      const std::uint32_t a = corner();
      const std::uint32_t b = corner();
      soup.triangle(a, b, i % 7 == 0 && face > 0 ? b : corner());
    }
    const std::size_t max_levels = 2 + static_cast<std::size_t>(i) % 15;
    const Model model = soup.build();
    const auto levels =
        ReceivingSurface(model, placement, PlaneFrame()).levels(kEverywhere, 10.0, max_levels);
    if (levels.empty()) continue;
    ++with_levels;
    EXPECT_LE(levels.size(), max_levels);
    EXPECT_TRUE(std::ranges::is_sorted(levels));
    EXPECT_GE(levels.front(), lowest - 1e-6);
    EXPECT_LE(levels.back(), highest + 1e-6);
    // Reversed winding gives the same levels.
    Model reversed = model;
    for (Mesh& mesh : reversed.meshes) {
      for (std::size_t k = 0; k + 2 < mesh.indices.size(); k += 3)
        std::swap(mesh.indices[k], mesh.indices[k + 1]);
    }
    EXPECT_EQ(
        ReceivingSurface(reversed, placement, PlaneFrame()).levels(kEverywhere, 10.0, max_levels),
        levels);
  }
  EXPECT_GT(with_levels, 190);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(levels_of(make_box(glm::vec3(0.1F)), test::at(0, nan, 0)).empty());
}

struct Technique {
  const char* name;
  ShadowTechnique technique;
  LightMode light_mode = LightMode::proportional;
  // Maximum RMS error at drawn edges [grey levels]. It is larger for simple shadows, whose single
  // step is as high as the three steps of layered shadows together, and for fields, whose edges
  // follow the centres of texels.
  double drawn_edge_error = 6.0;
};
class PhantomShadow : public testing::TestWithParam<Technique> {};
INSTANTIATE_TEST_SUITE_P(
    Techniques, PhantomShadow,
    testing::Values(Technique{"simple", ShadowTechnique::simple, LightMode::proportional, 8.0},
                    Technique{"layered", ShadowTechnique::layered},
                    Technique{"fixed_light", ShadowTechnique::layered, LightMode::fixed},
                    Technique{"field", ShadowTechnique::field, LightMode::proportional, 8.5}),
    [](const auto& instance) { return std::string(instance.param.name); });

// The top of a phantom box shows the same shadow as a plane at its height.
TEST_P(PhantomShadow, MatchesPlaneShadowOnHorizontalTop) {
  constexpr double kTop = 0.07;
  const Placement placement = test::at(0.015, 0.01, 0.2, {0.3, 1.0, 0.2}, 0.4);
  const auto scene = [&](bool phantom) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    builder.add(l_shape(), placement);
    if (phantom) {
      builder.add(box(0.12, 0.1, kTop), test::at(0.02, 0.0, kTop / 2), false, true);
    } else {
      builder.scene().planes[0].point = {0.0, 0.0, kTop};
    }
    return builder.build();
  };
  Studio with_phantom(scene(true), camera());
  Studio with_plane(scene(false), camera());
  const Eigen::Vector3d eye(0.1, -0.35, 0.6);
  const PoseEstimate pose = from(eye);
  const RenderedImage on_phantom = draw_directly(with_phantom, with_phantom.plan(pose));
  const RenderedImage on_plane = draw_directly(with_plane, with_plane.plan(pose));
  int dark = 0;
  int wrong = 0;
  int dark_sides = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d p = eye + (kTop - eye.z()) / d.z() * d;
      if (std::abs(p.x() - 0.02) < 0.0595 && std::abs(p.y()) < 0.0495) {
        dark += on_plane.red(x, y) < 250 ? 1 : 0;
        wrong += off(on_phantom.red(x, y), on_plane, x, y) > 2.0 ? 1 : 0;
        continue;
      }
      // The light comes from straight above and does not reach the box's front, so the front has no
      // shadow.
      const Eigen::Vector3d q = eye + (-0.05 - eye.y()) / d.y() * d;
      const bool front = std::abs(q.x() - 0.02) < 0.0595 && q.z() > 0.0005 && q.z() < kTop - 0.0005;
      dark_sides += front && on_phantom.red(x, y) != 255 ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 1000);
  EXPECT_LT(wrong, 0.01 * dark) << "pixels away from edges differ";
  EXPECT_EQ(dark_sides, 0);
}

// Fraction of the light from straight above that layered casters leave at a point. It equals the
// light in the darkest layer that covers the point, on a plane at its height.
class RemainingLight {
 public:
  // Casters may be rotated about the vertical only.
  explicit RemainingLight(const ShadowNode& node) : node_(node) {}
  void add(const Model& caster, const Placement& placement) {
    ShadowMesh mesh = make_shadow_mesh(caster);
    ShadowKernels kernels = generate_kernels(
        mesh, KernelDirection::nearest(Eigen::Vector3d::UnitZ()).up(), KernelSource::automatic);
    casters_.push_back({std::move(mesh), std::move(kernels), placement});
  }
  [[nodiscard]] double at(const Eigen::Vector3d& p) const {
    double light_left = 1.0;
    for (const Caster& caster : casters_) light_left = std::min(light_left, under(caster, p));
    return light_left;
  }

 private:
  struct Caster {
    ShadowMesh mesh;
    ShadowKernels kernels;
    Placement placement;
  };
  [[nodiscard]] double under(const Caster& caster, const Eigen::Vector3d& p) const {
    const PlaneFrame plane = PlaneFrame::make({0, 0, 1}, {0, 0, p.z()});
    const auto vertices = place_caster(caster.mesh, caster.kernels, caster.placement, plane);
    const double fractions[] = {node_.fractions.umbra, node_.fractions.middle,
                                node_.fractions.penumbra};
    for (std::size_t i = 0; i < 3; ++i) {
      const auto triangles =
          layer_triangles(vertices, caster.mesh.indices, node_.layered, kShadowLayers[i]);
      for (std::size_t t = 0; t + 2 < triangles.size(); t += 3) {
        const auto side = [&](const PlanePoint& a, const PlanePoint& b) {
          return (static_cast<double>(b.u) - static_cast<double>(a.u)) *
                     (p.y() - static_cast<double>(a.v)) -
                 (static_cast<double>(b.v) - static_cast<double>(a.v)) *
                     (p.x() - static_cast<double>(a.u));
        };
        const double s0 = side(triangles[t], triangles[t + 1]);
        const double s1 = side(triangles[t + 1], triangles[t + 2]);
        const double s2 = side(triangles[t + 2], triangles[t]);
        if ((s0 >= 0 && s1 >= 0 && s2 >= 0) || (s0 <= 0 && s1 <= 0 && s2 <= 0)) return fractions[i];
      }
    }
    return 1.0;
  }
  ShadowNode node_;
  std::vector<Caster> casters_;
};

// Scales the view about the frame's corner, half a pixel before the centre of pixel (0, 0).
CameraModel camera_by(int scale, int side = kSide) {
  CameraParameters p;
  p.width = p.height = side * scale;
  p.fx = p.fy = 420.0 * scale;
  p.cx = p.cy = (0.5 * side + 0.5) * scale - 0.5;
  return CameraModel::make(p).value();
}
// Side of the frames that are compared with finer ones [px]. The short form draws only the middle
// of the view, which contains the shadows.
int compared_side() {
  return test::nightly() ? kSide : 180;
}
struct CasterAt {
  std::shared_ptr<const Model> model;
  Placement placement;
};
std::vector<CasterAt> some_casters(int count) {
  std::vector<CasterAt> casters = {{count == 2 ? solid(ball(0.04, 24)) : l_shape(),
                                    test::at(0.015, 0.01, 0.16, {0.0, 0.0, 1.0}, 0.4)},
                                   {l_shape(), test::at(-0.01, 0.02, 0.2, {0.0, 0.0, 1.0}, 2.3)},
                                   {l_shape(), test::at(0.03, -0.02, 0.13, {0.0, 0.0, 1.0}, 1.2)}};
  casters.resize(static_cast<std::size_t>(count));
  return casters;
}

// The reference has 4 x 4 times as many pixels. Receivers are level or curved. Where shadows of
// several casters overlap, the darkest counts. The short form draws three casters on level ground
// and two on the dome; the nightly form draws all combinations.
TEST_P(PhantomShadow, HasSmoothEdges) {
  const std::vector<std::pair<const char*, CasterAt>> grounds = {
      {"level", {box(0.6, 0.6, 0.06), test::at(0.0, 0.0, 0.03)}},
      {"dome", {solid(ball(0.3, 200)), test::at(0.0, 0.0, -0.22)}}};
  for (const auto& [name, ground] : grounds) {
    for (const int count : {1, 2, 3}) {
      const bool level = &ground == &grounds.front().second;
      if (count != (level ? 3 : 2) && !test::nightly()) continue;
      SCOPED_TRACE(std::string(name) + ", casters: " + std::to_string(count));
      SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
      for (const CasterAt& caster : some_casters(count))
        builder.add(caster.model, caster.placement);
      builder.add(ground.model, ground.placement, false, true);
      const auto scene = builder.build();
      const int side = compared_side();
      const auto draw = [side](Studio& studio, int scale, LayerDrawing layers) {
        FramePlan plan = studio.plan(from({0.05, -0.3, 0.6}));
        plan.shadows.clear();
        plan.layers = layers;
        return studio.draw_shadows(test::plain_frame(side * scale, side * scale, 255), plan);
      };
      // Direct drawing and masks agree except at edges.
      Studio fine_studio(scene, camera_by(4, side));
      const RenderedImage fine = draw(fine_studio, 4, LayerDrawing::direct);
      Studio studio(scene, camera_by(1, side));
      for (const LayerDrawing layers : {LayerDrawing::direct, LayerDrawing::mask}) {
        const test::EdgeError error = test::edge_error(draw(studio, 1, layers), fine, 4);
        std::printf("%s, %s, %s, %d casters: %.2f grey levels RMS over %d pixels\n",
                    GetParam().name, layers == LayerDrawing::direct ? "drawn" : "covered", name,
                    count, error.rms, error.edges);
        EXPECT_GT(error.edges, 200);
        EXPECT_LE(error.rms, layers == LayerDrawing::mask ? 6.0 : GetParam().drawn_edge_error);
        EXPECT_LE(error.largest_elsewhere, 1);
      }
    }
  }
}

// The beam is much longer than the receiver, so no mask can hold its whole shadow. The mask must
// still contain the part of the shadow that is visible on the receiver.
TEST(PhantomShadow, CoversShadowOfLargeCaster) {
  for (const double length : {0.3, 3.0, 300.0}) {
    for (const LightMode light_mode : {LightMode::proportional, LightMode::fixed}) {
      // The short form draws one light mode per length.
      if (!test::nightly() && (light_mode == LightMode::fixed) != (length == 3.0)) continue;
      SCOPED_TRACE(length);
      SceneBuilder builder = builder_with(ShadowTechnique::layered, light_mode);
      ShapeBuilder beam;
      beam.box(0.0, -0.02, 0.0, length, 0.02, 0.02);
      builder.add(solid(beam.build()), test::at(-0.05, -0.01, 0.13, {0.0, 0.0, 1.0}, 0.1));
      builder.add(box(0.6, 0.6, 0.06), test::at(0.0, 0.0, 0.03), false, true);
      const auto scene = builder.build();
      const int side = compared_side();
      const auto draw = [side](Studio& studio, int scale, LayerDrawing layers) {
        FramePlan plan = studio.plan(from({0.05, -0.3, 0.6}));
        plan.shadows.clear();
        plan.layers = layers;
        return studio.draw_shadows(test::plain_frame(side * scale, side * scale, 255), plan);
      };
      Studio coarse(scene, camera_by(1, side));
      Studio fine(scene, camera_by(4, side));
      const RenderedImage reference = draw(fine, 4, LayerDrawing::direct);
      const test::EdgeError drawn =
          test::edge_error(draw(coarse, 1, LayerDrawing::direct), reference, 4);
      const std::int64_t calls = coarse.stats()[Counter::draw_calls];
      const test::EdgeError covered =
          test::edge_error(draw(coarse, 1, LayerDrawing::mask), reference, 4);
      EXPECT_EQ(coarse.stats()[Counter::masks_drawn], 1);
      EXPECT_LT(coarse.stats()[Counter::draw_calls], calls)
          << "the mask replaces the draw calls of the layers";
      std::printf("beam of %.1f m: covered %.2f, drawn %.2f grey levels RMS over %d pixels\n",
                  length, covered.rms, drawn.rms, covered.edges);
      EXPECT_GT(covered.edges, 100);
      EXPECT_LE(covered.rms, 6.0);
      EXPECT_LE(covered.largest_elsewhere, 1);
      EXPECT_LE(drawn.largest_elsewhere, 1);
    }
  }
}

// The reference is the exact shadow at each height, sampled at 4 x 4 points of each pixel.
TEST(PhantomShadow, HasSmoothEdgesOnSlope) {
  constexpr double kSlope = 0.4;
  constexpr double kOutsideRamp = -1.0;  // the sample is outside the ramp
  for (const int count : {1, 3}) {
    SCOPED_TRACE(count);
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    RemainingLight remaining_light(builder.scene().shadows[0]);
    for (const CasterAt& caster : some_casters(count)) {
      builder.add(caster.model, caster.placement);
      remaining_light.add(*caster.model, caster.placement);
    }
    builder.add(solid(ramp(0.8, kSlope, 0.01)), test::at(-0.4, 0.0, -0.1), false, true);
    Studio studio(builder.build(), camera_by(1));
    const Eigen::Vector3d eye(0.05, -0.3, 0.6);
    const PoseEstimate pose = from(eye);
    FramePlan plan = studio.plan(pose);
    plan.shadows.clear();
    const RenderedImage image = studio.draw_shadows(white(), plan);
    // Plane of the ramp: z = 0.001 - 0.1 + slope * (x + 0.4).
    const Eigen::Vector3d normal(-kSlope, 0.0, 1.0);
    const double offset = 0.001 - 0.1 + kSlope * 0.4;
    const auto expected_at = [&](double x, double y) {
      const Eigen::Vector3d d =
          pose.T_table_camera.rotation() * camera_by(1).unproject({x, y}).value();
      const Eigen::Vector3d p = eye + (offset - normal.dot(eye)) / normal.dot(d) * d;
      if (std::abs(p.y()) > 0.047) return kOutsideRamp;
      const double lost = (1.0 - remaining_light.at(p)) / normal.norm();
      return 255.0 * std::pow(1.0 - lost, 1.0 / 2.2);
    };
    double sum = 0.0;
    int edges = 0;
    for (int y = 60; y < 240; y += 2) {
      for (int x = 60; x < 240; x += 2) {
        const double corners[] = {expected_at(x - 0.5, y - 0.5), expected_at(x + 0.5, y - 0.5),
                                  expected_at(x - 0.5, y + 0.5), expected_at(x + 0.5, y + 0.5)};
        if (std::ranges::count(corners, corners[0]) == 4) continue;
        if (std::ranges::count(corners, kOutsideRamp) > 0) continue;
        double total = 0.0;
        for (int i = 0; i < 16; ++i) {
          const double value =
              expected_at(x + (i % 4 - 1.5) / 4.0, y + (static_cast<double>(i / 4) - 1.5) / 4.0);
          total += value;
        }
        sum += std::pow(image.red(x, y) - total / 16.0, 2);
        ++edges;
      }
    }
    std::printf("slope, %d casters: %.2f grey levels RMS over %d pixels\n", count,
                std::sqrt(sum / edges), edges);
    EXPECT_GT(edges, 100);
    EXPECT_LE(std::sqrt(sum / edges), 6.0);
  }
}

// Each pixel of a phantom or virtual ball is compared with the shadow on a plane at the pixel's
// height.
class SphereShadow : public testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(Receivers, SphereShadow, testing::Bool(), [](const auto& instance) {
  return std::string(instance.param ? "phantom" : "object");
});
TEST_P(SphereShadow, MatchesShadowAtEachHeight) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  const auto caster = l_shape();
  const Placement placement = test::at(0.0, 0.0, 0.17, {0, 0, 1}, 0.4);
  builder.add(caster, placement);
  constexpr double kRadius = 0.05;
  const Eigen::Vector3d middle(0.03, 0.02, kRadius);
  builder.add(solid(make_sphere(static_cast<float>(kRadius))),
              {middle, Eigen::Quaterniond::Identity(), 1.0}, false, GetParam());
  Studio studio(builder.build(), camera());
  const Eigen::Vector3d eye(0.15, -0.4, 0.5);
  const PoseEstimate pose = from(eye);
  const FramePlan plan = without_caster(studio.plan(pose));
  const RenderedImage image = studio.draw(white(), plan);
  const RenderedImage unshadowed = studio.draw(white(), without_received(plan));

  RemainingLight remaining_light(studio.scene().shadows[0]);
  remaining_light.add(*caster, placement);
  int on_ball = 0;
  int dark = 0;
  int wrong = 0;
  for (int y = 0; y < kSide; y += 2) {
    for (int x = 0; x < kSide; x += 2) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      const Eigen::Vector3d d = (pose.T_table_camera.rotation() * *ray).normalized();
      const double b = d.dot(eye - middle);
      const double discriminant = b * b - (eye - middle).squaredNorm() + kRadius * kRadius;
      if (discriminant < 4e-5) continue;  // near the silhouette, which is a polyline
      const Eigen::Vector3d p = eye + (-b - std::sqrt(discriminant)) * d;
      const double facing = std::max((p - middle).z() / kRadius, 0.0);
      const double lost = (1.0 - remaining_light.at(p)) * facing;
      const double expected = unshadowed.red(x, y) * std::pow(1.0 - lost, 1.0 / 2.2);
      ++on_ball;
      dark += expected < 0.94 * unshadowed.red(x, y) ? 1 : 0;
      // Normals of neighbouring faces differ by 4 degrees.
      wrong += std::abs(image.red(x, y) - expected) > 14.0 ? 1 : 0;
    }
  }
  EXPECT_GT(on_ball, 800);
  EXPECT_GT(dark, 250);
  EXPECT_LT(wrong, 0.03 * dark) << "pixels away from edges differ; dark: " << dark;
}

// A caster beside a phantom casts no shadow onto its top unless it is higher.
TEST_P(PhantomShadow, FallsOnlyDownwards) {
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  builder.add(box(0.04, 0.04, 0.06), test::at(0.0, 0.0, 0.03));
  builder.add(box(0.04, 0.04, 0.08), test::at(0.0, 0.0, 0.04), false, true);
  Studio studio(builder.build(), camera());
  FramePlan plan = studio.plan(from({0.1, -0.3, 0.5}));
  const RenderedImage with = draw_directly(studio, plan);
  plan.received_shadows.clear();
  EXPECT_EQ(with, draw_directly(studio, plan));
}

// Adds an L and a box at random positions, upright or tilted. The box is a phantom, or a virtual
// object that also casts a shadow.
void add_anywhere(SceneBuilder& builder, std::mt19937& random, bool upright, bool phantom) {
  const auto uniform = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  builder.add(l_shape(), test::at(uniform(-0.12, 0.12), uniform(-0.12, 0.12), uniform(0.0, 0.3),
                                  {1, 1, 0}, uniform(0, 3)));
  builder.add(box(uniform(0.02, 0.1), uniform(0.02, 0.1), uniform(0.02, 0.1)),
              test::at(uniform(-0.12, 0.12), uniform(-0.12, 0.12), uniform(-0.05, 0.1), {0, 1, 1},
                       upright ? 0.0 : uniform(0, 3)),
              !phantom, phantom);
}

TEST_P(PhantomShadow, IsIndependentOfSkipping) {
  std::mt19937 random(5);
  int skipped = 0;
  int drawn = 0;
  for (int i = 0; i < (test::nightly() ? 16 : 8); ++i) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    add_anywhere(builder, random, i % 2 == 0, true);
    Studio studio(builder.build(), camera());
    const PoseEstimate pose = from({0.3, -0.4, 0.5});
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(pose);
    const FramePlan complete = studio.plan(pose, all);
    EXPECT_EQ(complete.received_shadows.size(), 1U);
    (skipping.received_shadows.empty() ? skipped : drawn) += 1;
    EXPECT_EQ(std::ranges::count(skipping.skipped, SkipReason::shadow_misses_phantoms,
                                 &SkippedPass::reason),
              skipping.received_shadows.empty() ? 1 : 0);
    EXPECT_EQ(studio.draw(white(), skipping), studio.draw(white(), complete)) << i;
  }
  EXPECT_GT(skipped, 1);
  EXPECT_GT(drawn, test::nightly() ? 3 : 1);
}

TEST_P(PhantomShadow, IsReusedWhileOnlyCameraMoves) {
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.15));
  builder.add(box(0.08, 0.08, 0.04), test::at(0.02, 0.0, 0.02), false, true);
  const auto scene = builder.build();
  Studio studio(scene, camera());
  PlanOptions direct;
  direct.layers = LayerDrawing::direct;  // plane masks depend on the camera's distance
  studio.draw(white(), studio.plan(from({0.1, -0.3, 0.5}), direct));
  EXPECT_EQ(studio.stats()[Counter::masks_drawn], 1);
  EXPECT_EQ(studio.stats()[Counter::masks_kept], 0);
  const CompositeStats first = studio.stats();
  EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 1)
      << "a phantom's top is not a plane of the scene";
  const FramePlan moved = studio.plan(from({-0.2, -0.3, 0.4}), direct);
  const RenderedImage reused = studio.draw(white(), moved);
  EXPECT_EQ(studio.stats()[Counter::masks_drawn], 0);
  EXPECT_EQ(studio.stats()[Counter::masks_kept], 1);
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  EXPECT_EQ(studio.stats()[Counter::passes_skipped], first[Counter::passes_skipped]);
  EXPECT_EQ(studio.stats()[Counter::proxy_shadows], first[Counter::proxy_shadows]);
  Studio fresh(scene, camera());
  EXPECT_EQ(reused, fresh.draw(white(), fresh.plan(from({-0.2, -0.3, 0.4}), direct)));
  // If the caster slides, the shadow is redrawn from its stored geometry.
  FramePlan slid = moved;
  for (ShadowDraw& draw : slid.shadows) draw.T_table_object.position.x() += 0.01;
  for (ReceivedShadowDraw& draw : slid.received_shadows)
    draw.shadow.T_table_object.position.x() += 0.01;
  EXPECT_NE(studio.draw(white(), slid), reused);
  EXPECT_EQ(studio.stats()[Counter::masks_drawn], 1);
  // Except for fields and fixed lights, the shadow's extent is computed once, from all vertices.
  const bool measures_vertices = GetParam().technique != ShadowTechnique::field &&
                                 GetParam().light_mode == LightMode::proportional;
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], measures_vertices ? 14 : 0);
  EXPECT_EQ(studio.stats()[Counter::kernel_generations], 0);
}

// After any change between two frames, the second frame equals that of a new compositor.
TEST(PhantomShadow, IsRecomputedAfterEachKindOfChange) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.scene().shadows[0].kernels = KernelSource::centroid;
  builder.add(l_shape(), test::at(0.0, 0.0, 0.15, {1, 0, 0}, 0.3));
  builder.add(solid(ball(0.04, 24)), test::at(0.02, 0.0, 0.04), false, true);
  const auto scene = builder.build();
  using Change = std::function<void(FramePlan&)>;
  const auto each = [](const std::function<void(ShadowDraw&)>& change) -> Change {
    return [change](FramePlan& plan) {
      for (ShadowDraw& draw : plan.shadows) change(draw);
      for (ReceivedShadowDraw& draw : plan.received_shadows) change(draw.shadow);
    };
  };
  const std::vector<std::pair<const char*, Change>> changes = {
      {"nothing", each([](ShadowDraw&) {})},
      {"slide", each([](ShadowDraw& d) { d.T_table_object.position.x() += 0.003; })},
      {"lift", each([](ShadowDraw& d) { d.T_table_object.position.z() += 0.01; })},
      {"tilt", each([](ShadowDraw& d) {
         d.T_table_object.rotation =
             Eigen::Quaterniond(Eigen::AngleAxisd(0.01, Eigen::Vector3d::UnitY())) *
             d.T_table_object.rotation;
       })},
      {"scale", each([](ShadowDraw& d) { d.T_table_object.scale = 1.05; })},
      {"kernels", each([](ShadowDraw& d) { d.kernels = KernelSource::automatic; })},
      {"light mode", each([](ShadowDraw& d) {
         d.kernels = KernelSource::automatic;
         d.light_mode = LightMode::fixed;
       })},
      {"technique", each([](ShadowDraw& d) { d.technique = ShadowTechnique::field; })},
      {"constants",
       each([](ShadowDraw& d) { d.constants = make_layered_constants(0.4, 3.0, 0.0).value(); })},
      {"fractions", each([](ShadowDraw& d) { d.fractions.middle = 0.5; })},
      {"opacity", each([](ShadowDraw& d) { d.opacity = 0.4F; })},
      {"plane",
       [](FramePlan& plan) {
         for (PlaneReceiver& receiver : plan.receivers) receiver.frame.q.z() -= 0.01;
         for (ShadowDraw& draw : plan.shadows) draw.plane_frame.q.z() -= 0.01;
         for (ReceivedShadowDraw& draw : plan.received_shadows) {
           draw.shadow.plane_frame.q.z() -= 0.01;
           draw.top += 0.01;
         }
       }},
      {"phantom", [](FramePlan& plan) { plan.phantoms[0].T_table_object.position.y() += 0.004; }}};
  const PoseEstimate pose = from({0.1, -0.3, 0.5});
  Studio studio(scene, camera());
  for (const auto& [name, change] : changes) {
    FramePlan plan = studio.plan(pose);
    const RenderedImage before = draw_directly(studio, plan);
    change(plan);
    const RenderedImage after = draw_directly(studio, plan);
    Studio fresh(scene, camera());
    EXPECT_EQ(after, draw_directly(fresh, plan)) << name;
    EXPECT_EQ(after == before, std::string(name) == "nothing") << name;
  }
}

// Numbers of dark pixels on a level part of a phantom and on a plane at its height, and of pixels
// that differ between the two.
struct DarkPixels {
  int on_phantom = 0, on_plane = 0, differing = 0;
};
DarkPixels compare(const Model& phantom, const std::shared_ptr<const Model>& caster,
                   const Placement& placement, double height, const Eigen::AlignedBox2d& part,
                   const std::function<void(FramePlan&)>& change = {}) {
  const auto draw = [&](bool with_phantom) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    builder.add(caster, placement);
    if (with_phantom) {
      builder.add(solid(phantom), Placement(), false, true);
    } else {
      builder.scene().planes[0].point = {0.0, 0.0, height};
    }
    Studio studio(builder.build(), camera());
    FramePlan plan = studio.plan(from({0.1, -0.35, 0.6}));
    if (change) change(plan);
    return draw_directly(studio, plan);
  };
  const RenderedImage on_phantom = draw(true);
  const RenderedImage on_plane = draw(false);
  const PoseEstimate pose = from({0.1, -0.35, 0.6});
  const Eigen::Vector3d eye = pose.T_table_camera.translation();
  DarkPixels result;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d p = eye + (height - eye.z()) / d.z() * d;
      if (!part.contains(Eigen::Vector2d(p.head<2>()))) continue;
      result.on_phantom += on_phantom.red(x, y) < 250 ? 1 : 0;
      result.on_plane += on_plane.red(x, y) < 250 ? 1 : 0;
      result.differing += off(on_phantom.red(x, y), on_plane, x, y) > 3.0 ? 1 : 0;
    }
  }
  return result;
}
Eigen::AlignedBox2d around(double x, double y, double half_x, double half_y) {
  const Eigen::Vector2d middle(x, y);
  const Eigen::Vector2d half(half_x, half_y);
  return {middle - half, middle + half};
}

// A thin plate lies on one of the steps.
TEST(PhantomShadow, FallsOnEveryStepOfStaircase) {
  for (const int step : {2, 5, 8}) {
    SCOPED_TRACE(step);
    const double height = 0.015 * (step + 1);
    const double x = 0.02 * step + 0.01;
    const DarkPixels pixels =
        compare(staircase(), box(0.012, 0.06, 0.01), test::at(x, 0.0, height + 0.005), height,
                around(x, 0.0, 0.0095, 0.045));
    EXPECT_GT(pixels.on_plane, 60);
    EXPECT_LT(pixels.differing, 0.01 * pixels.on_plane) << "pixels away from edges differ";
  }
}

TEST(PhantomShadow, FallsFromPlateThinnerThanAdjacentStep) {
  ShapeBuilder shape;
  shape.box(-0.06, -0.06, 0.0, 0.06, 0.06, 0.03);
  shape.box(0.04, -0.06, 0.0, 0.06, 0.06, 0.0304);
  const DarkPixels pixels =
      compare(shape.build(), box(0.05, 0.05, 0.0003), test::at(-0.01, 0.0, 0.03015), 0.03,
              around(0.0, 0.0, 0.039, 0.055));
  EXPECT_GT(pixels.on_plane, 400);
  EXPECT_LT(pixels.differing, 0.01 * pixels.on_plane);
}

// A face without a normal is treated as facing the camera, so that no pixel becomes NaN.
TEST(PhantomShadow, StaysFiniteOnSurfaceWithoutNormals) {
  Model bare = *solid(standing_box(0.12, 0.06));
  for (Mesh& mesh : bare.meshes) mesh.normals.assign(mesh.normals.size(), glm::vec3(0.0F));
  SceneBuilder builder = builder_with(ShadowTechnique::simple);
  builder.add(l_shape(), test::at(0, 0, 0.15));
  builder.add(std::make_shared<const Model>(bare), Placement(), false, true);
  Studio studio(builder.build(), camera());
  const RenderedImage image = draw_directly(studio, studio.plan(from({0.1, -0.35, 0.6})));
  int dark = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      dark += image.red(x, y) < 250 ? 1 : 0;
      EXPECT_GT(image.red(x, y), 100) << x << " " << y;
    }
  }
  EXPECT_GT(dark, 800);
}

// Reversed winding gives the same shadow.
TEST(PhantomShadow, IsIndependentOfFaceWinding) {
  Model reversed = standing_box(0.12, 0.06);
  for (Mesh& mesh : reversed.meshes) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3)
      std::swap(mesh.indices[i], mesh.indices[i + 1]);
  }
  const DarkPixels pixels =
      compare(reversed, l_shape(), test::at(0, 0, 0.15), 0.06, around(0, 0, 0.055, 0.055));
  EXPECT_GT(pixels.on_plane, 800);
  EXPECT_LT(pixels.differing, 0.01 * pixels.on_plane);
}

// For one caster, the first layer that covers a pixel counts, as on planes, even if it is fainter
// than others. If several casters cover a pixel, the darkest layer counts.
TEST(PhantomShadow, UsesDarkestLayerOfAllCasters) {
  const Model block = standing_box(0.16, 0.06);
  const auto all = around(0, 0, 0.075, 0.075);
  const DarkPixels fractions =
      compare(block, l_shape(), test::at(0, 0, 0.15), 0.06, all, [](FramePlan& plan) {
        const auto lightest_first = [](ShadowDraw& draw) { draw.fractions = {0.9, 0.5, 0.2}; };
        for (ShadowDraw& draw : plan.shadows) lightest_first(draw);
        for (ReceivedShadowDraw& draw : plan.received_shadows) lightest_first(draw.shadow);
      });
  EXPECT_GT(fractions.on_plane, 800);
  EXPECT_LT(fractions.differing, 0.01 * fractions.on_plane);
  const DarkPixels opacity =
      compare(block, l_shape(), test::at(0, 0, 0.15), 0.06, all, [](FramePlan& plan) {
        // Adds a second, fainter caster beside the first.
        const auto add_faint = [](auto& draws, const auto& shadow_of) {
          const auto count = draws.size();
          for (std::size_t i = 0; i < count; ++i) {
            auto second = draws[i];
            shadow_of(second).node = 0;
            shadow_of(second).T_table_object.position += Eigen::Vector3d(0.02, 0.015, 0.03);
            shadow_of(second).opacity = 0.3F;
            if constexpr (requires { second.top; }) {
              second.top += 0.03;
              second.radius += 0.05;
              second.shadow.node = 1;
            }
            draws.push_back(second);
          }
        };
        add_faint(plan.shadows, [](ShadowDraw& draw) -> ShadowDraw& { return draw; });
        add_faint(plan.received_shadows,
                  [](ReceivedShadowDraw& draw) -> ShadowDraw& { return draw.shadow; });
      });
  EXPECT_GT(opacity.on_plane, 800);
  EXPECT_LT(opacity.differing, 0.01 * opacity.on_plane);
}

// The shadow must not depend on another caster's shadow elsewhere on the receiver, whether they are
// drawn separately or in one mask.
TEST(PhantomShadow, IsIndependentOfNeighbouringShadow) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(l_shape(), test::at(-0.07, 0.0, 0.16, {0, 0, 1}, 0.4));
  builder.add(l_shape(), test::at(0.09, 0.0, 0.2, {0, 0, 1}, 0.9));
  builder.add(box(0.4, 0.2, 0.06), test::at(0, 0, 0.03), false);
  Studio studio(builder.build(), camera());
  FramePlan plan = studio.plan(from({0.05, -0.3, 0.6}));
  std::erase_if(plan.objects, [](const ObjectDraw& draw) { return draw.object < 2; });
  plan.shadows.clear();
  std::erase_if(plan.received_shadows,
                [](const ReceivedShadowDraw& draw) { return draw.receiver < 2; });
  ASSERT_EQ(plan.received_shadows.size(), 2U);
  FramePlan alone = plan;
  alone.received_shadows.resize(1);
  for (const Translucency mode :
       {Translucency::blend, Translucency::mesh, Translucency::retexture}) {
    SCOPED_TRACE(to_string(mode));
    plan.translucency = alone.translucency = mode;
    const RenderedImage both = studio.draw(white(), plan);
    const RenderedImage one = studio.draw(white(), alone);
    int differing = 0;
    int elsewhere = 0;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const bool other = x > 155;
        (other ? elsewhere : differing) += both.red(x, y) != one.red(x, y) ? 1 : 0;
      }
    }
    EXPECT_EQ(differing, 0);
    EXPECT_GT(elsewhere, 500);
    for (int i = 3; i < 4 * kSide * kSide; i += 4)
      ASSERT_EQ(both.rgba[static_cast<std::size_t>(i)], 255);
  }
}

// A plate hovers at a constant distance above a ramp, then below the ramp's surface. It must not
// cast a shadow upwards.
TEST(PhantomShadow, StaysBelowItsCaster) {
  const auto darkened = [](double over, double x) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    builder.add(box(0.03, 0.06, 0.002), test::at(x, 0.0, 0.001 + 0.5 * x + over));
    builder.add(solid(ramp(0.5, 0.5, 0.01)), Placement(), false, true);
    Studio studio(builder.build(), camera());
    const PoseEstimate pose = test::tracked(test::look_at({x, -0.5, 0.7}, {x, 0.0, 0.1}));
    FramePlan plan = studio.plan(pose);
    const RenderedImage with = draw_directly(studio, plan);
    plan.received_shadows.clear();
    const RenderedImage without = draw_directly(studio, plan);
    int dark = 0;
    for (int y = 0; y < kSide; ++y)
      for (int column = 0; column < kSide; ++column)
        dark += with.red(column, y) < without.red(column, y) ? 1 : 0;
    return dark;
  };
  for (const double x : {0.05, 0.2, 0.4}) {
    SCOPED_TRACE(x);
    EXPECT_GT(darkened(0.03, x), 300);
    EXPECT_EQ(darkened(-0.03, x), 0) << "the plate is below the ramp's surface";
  }
}

// The result must not depend on the order of two planes that meet at an angle.
TEST(PhantomShadow, IsIndependentOfPlaneOrder) {
  const auto image = [](bool swapped) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    ScenePlane& board = builder.scene().planes.emplace_back(builder.scene().planes[0]);
    board.normal = Eigen::Vector3d(0.0, -1.0, 1.0).normalized();
    board.point = {0.0, 0.1, 0.0};
    builder.scene().shadows[0].planes = {0, 1};
    if (swapped) std::swap(builder.scene().planes[0], builder.scene().planes[1]);
    builder.add(l_shape(), test::at(0.0, -0.02, 0.15));
    builder.add(solid(ball(0.05, 24)), test::at(0.0, 0.02, 0.05), false, true);
    Studio studio(builder.build(), camera());
    FramePlan plan = studio.plan(from({0.1, -0.4, 0.5}));
    plan.shadows.clear();
    EXPECT_EQ(plan.received_shadows.size(), 2U);
    return draw_directly(studio, plan);
  };
  const RenderedImage in_order = image(false);
  const RenderedImage in_swapped_order = image(true);
  int differing = 0;
  for (std::size_t i = 0; i < in_order.rgba.size(); ++i)
    differing += std::abs(in_order.rgba[i] - in_swapped_order.rgba[i]) > 1 ? 1 : 0;
  EXPECT_EQ(differing, 0);
}

// The pass must restore the OpenGL state that later passes depend on.
TEST(PhantomShadow, KeepsHardShadowsUnchanged) {
  const auto image = [](bool simple, bool hard) {
    SceneBuilder builder = builder_with(ShadowTechnique::simple);
    builder.scene().lights.emplace_back().position = {0.3, 0.1, 0.6};
    // The plane is too small to show the shadow.
    builder.scene().planes[0].outline = {{0.4, 0.4}, {0.41, 0.4}, {0.41, 0.41}};
    builder.add(box(0.04, 0.04, 0.01), test::at(-0.02, 0.0, 0.12));
    builder.add(box(0.04, 0.04, 0.01), test::at(0.1, 0.02, 0.05));
    builder.add(box(0.08, 0.08, 0.04), test::at(0.0, 0.0, 0.02), false, true);
    Scene& scene = builder.scene();
    scene.planes.emplace_back().name = "floor";
    scene.shadows.push_back(scene.shadows[0]);
    scene.shadows[0].casters = simple ? std::vector<int>{0} : std::vector<int>{};
    scene.shadows[1].casters = hard ? std::vector<int>{1} : std::vector<int>{};
    scene.shadows[1].technique = ShadowTechnique::hard;
    scene.shadows[1].planes = {1};
    Studio studio(builder.build(), camera());
    FramePlan plan = studio.plan(from({0.1, -0.3, 0.5}));
    plan.volumes.clear();
    std::erase_if(plan.receivers,
                  [](const PlaneReceiver& receiver) { return receiver.plane == 0; });
    std::erase_if(plan.shadows, [](const ShadowDraw& draw) { return draw.plane == 0; });
    for (ReceivedShadowDraw& draw : plan.received_shadows) draw.shadow.plane = 1;
    return draw_directly(studio, plan);
  };
  const RenderedImage both = image(true, true);
  const RenderedImage simple = image(true, false);
  const RenderedImage hard = image(false, true);
  int differing = 0;
  int dark = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      dark += simple.red(x, y) < 250 ? 1 : 0;
      differing += std::abs(both.red(x, y) - simple.red(x, y) * hard.red(x, y) / 255) > 2 ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 200);
  EXPECT_EQ(differing, 0);
}

// Skipping one caster must not change the shadows of others on the same phantom.
TEST(PhantomShadow, IsIndependentOfSkippedNodes) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.15));
  builder.add(l_shape(), test::at(0.6, 0.0, 0.1));
  builder.add(solid(ball(0.05, 24)), test::at(0.0, 0.0, 0.05), false, true);
  Scene& scene = builder.scene();
  scene.shadows.push_back(scene.shadows[0]);
  scene.shadows[0].casters = {0};
  scene.shadows[1].casters = {1};
  scene.shadows[1].technique = ShadowTechnique::field;
  Studio studio(builder.build(), camera());
  const PoseEstimate pose = from({0.1, -0.3, 0.5});
  PlanOptions all;
  all.skip = false;
  ASSERT_NE(studio.plan(pose).received_shadows.size(),
            studio.plan(pose, all).received_shadows.size());
  EXPECT_EQ(studio.draw(white(), studio.plan(pose)), studio.draw(white(), studio.plan(pose, all)));
}

// Several casters, or coincident planes, darken a pixel once, by the darkest shadow.
TEST(PhantomShadow, DarkensPixelOnce) {
  const auto image = [](int casters, int planes) {
    SceneBuilder builder = builder_with(ShadowTechnique::simple);
    for (int i = 0; i < casters; ++i) {
      builder.add(box(0.05, 0.05, 0.01), test::at(0.0, 0.0, 0.1 + 0.05 * i));
    }
    builder.add(box(0.1, 0.1, 0.04), test::at(0.0, 0.0, 0.02), false, true);
    for (int i = 1; i < planes; ++i) {
      builder.scene().planes.push_back(builder.scene().planes[0]);
      builder.scene().shadows[0].planes.push_back(i);
    }
    Studio studio(builder.build(), camera());
    return draw_directly(studio, studio.plan(from({0.1, -0.3, 0.5})));
  };
  const RenderedImage once = image(1, 1);
  EXPECT_EQ(image(2, 1), once);
  EXPECT_EQ(image(1, 2), once);
  EXPECT_EQ(image(3, 3), once);
}

// A board's shadow falls along the board's normal, onto the box in front of it.
TEST(PhantomShadow, FallsAlongNormalOfItsPlane) {
  SceneBuilder builder = builder_with(ShadowTechnique::simple);
  builder.scene().planes[0].normal = {0.0, -1.0, 0.0};
  builder.scene().planes[0].point = {0.0, 0.3, 0.0};
  builder.add(box(0.05, 0.01, 0.05), test::at(0.0, -0.1, 0.05));
  builder.add(box(0.1, 0.1, 0.1), test::at(0.0, 0.05, 0.05), false, true);
  Studio studio(builder.build(), camera());
  const Eigen::Vector3d eye(0.1, -0.6, 0.35);
  const PoseEstimate pose = from(eye);
  const RenderedImage image = draw_directly(studio, studio.plan(pose));
  const auto red_at = [&](const Eigen::Vector3d& point) {
    const auto pixel = camera().project(pose.T_table_camera.inverse() * point);
    return image.red(static_cast<int>(std::lround(pixel->x())),
                     static_cast<int>(std::lround(pixel->y())));
  };
  EXPECT_LT(red_at({0.0, 0.0, 0.05}), 200) << "the box's front";
  EXPECT_EQ(red_at({0.04, 0.0, 0.05}), 255);
  EXPECT_EQ(red_at({0.0, 0.05, 0.1}), 255) << "the box's top";
}

// The top of a virtual box shows the same shadow as a plane. The box's sides stay unchanged, and
// the box occludes the shadow on the table behind it.
TEST_P(PhantomShadow, MatchesPlaneShadowOnTopOfObject) {
  constexpr double kTop = 0.07;
  const Placement placement = test::at(0.015, 0.01, 0.2, {0.3, 1.0, 0.2}, 0.4);
  const auto scene = [&](bool object) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    builder.add(l_shape(), placement);
    if (object) {
      builder.add(box(0.12, 0.1, kTop), test::at(0.02, 0.0, kTop / 2), false);
    } else {
      builder.scene().planes[0].point = {0.0, 0.0, kTop};
    }
    return builder.build();
  };
  Studio with_object(scene(true), camera());
  Studio with_plane(scene(false), camera());
  const Eigen::Vector3d eye(0.1, -0.35, 0.6);
  const PoseEstimate pose = from(eye);
  const FramePlan plan = without_caster(with_object.plan(pose));
  const RenderedImage shadowed = with_object.draw(white(), plan);
  const RenderedImage unshadowed = with_object.draw(white(), without_received(plan));
  const RenderedImage on_plane = draw_directly(with_plane, with_plane.plan(pose));
  int dark = 0;
  int wrong = 0;
  int front = 0;
  int changed = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      ASSERT_TRUE(ray);
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
      const Eigen::Vector3d p = eye + (kTop - eye.z()) / d.z() * d;
      if (std::abs(p.x() - 0.02) < 0.0595 && std::abs(p.y()) < 0.0495) {
        dark += on_plane.red(x, y) < 250 ? 1 : 0;
        const double light_left = 255.0 * shadowed.red(x, y) / unshadowed.red(x, y);
        wrong += off(light_left, on_plane, x, y) > 3.0 ? 1 : 0;
        continue;
      }
      const Eigen::Vector3d q = eye + (-0.05 - eye.y()) / d.y() * d;
      if (std::abs(q.x() - 0.02) < 0.0595 && q.z() > 0.0005 && q.z() < kTop - 0.0005) ++front;
      changed += shadowed.red(x, y) != unshadowed.red(x, y) ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 1000);
  EXPECT_LT(wrong, 0.01 * dark) << "pixels away from edges differ";
  EXPECT_GT(front, 1000);
  EXPECT_LT(changed, 0.03 * dark) << "pixels beyond the top's edge change";
}

// Casters are tilted, clipped at the umbra height and below the light, and consist of several
// parts. Skipping layers must not remove a visible pixel of the shadow.
TEST(PhantomShadow, MatchesPlaneShadowOnPhantomTopAtRandomHeight) {
  std::mt19937 random(11);
  const auto uniform = [&random](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  int on_any = 0;
  const int scenes = test::nightly() ? 10 : 5;
  for (int i = 0; i < scenes; ++i) {
    SCOPED_TRACE(i);
    const double top = uniform(0.02, 0.1);
    const Placement placement =
        test::at(uniform(-0.03, 0.03), uniform(-0.03, 0.03), top + uniform(-0.02, 0.22),
                 {1, uniform(-1, 1), 0.3}, uniform(0, 3));
    const auto draw = [&](bool with_phantom) {
      SceneBuilder builder = builder_with(ShadowTechnique::layered);
      builder.scene().shadows[0].layered = make_layered_constants(0.3, 2.0, 0.0).value();
      builder.add(l_shape(), placement);
      if (with_phantom) {
        builder.add(box(0.5, 0.5, top), test::at(0, 0, top / 2), false, true);
      } else {
        builder.scene().planes[0].point = {0.0, 0.0, top};
      }
      Studio studio(builder.build(), camera());
      return draw_directly(studio, studio.plan(from({0.1, -0.35, 0.6})));
    };
    const RenderedImage on_phantom = draw(true);
    const RenderedImage on_plane = draw(false);
    const PoseEstimate pose = from({0.1, -0.35, 0.6});
    const Eigen::Vector3d eye = pose.T_table_camera.translation();
    int dark = 0;
    int differing = 0;
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
        const Eigen::Vector3d d = pose.T_table_camera.rotation() * *ray;
        const Eigen::Vector3d p = eye + (top - eye.z()) / d.z() * d;
        if (std::max(std::abs(p.x()), std::abs(p.y())) > 0.248) continue;
        dark += on_plane.red(x, y) < 250 ? 1 : 0;
        differing += off(on_phantom.red(x, y), on_plane, x, y) > 2.0 ? 1 : 0;
      }
    }
    on_any += dark;
    EXPECT_LT(differing, 0.01 * dark) << "pixels away from edges differ; dark: " << dark;
  }
  EXPECT_GT(on_any, 1000 * scenes);
}

TEST_P(PhantomShadow, NeverFallsOnItsCaster) {
  ShapeBuilder shape;
  shape.box(-0.01, -0.01, 0.0, 0.01, 0.01, 0.1);
  shape.box(-0.06, -0.06, 0.1, 0.06, 0.06, 0.11);
  shape.box(-0.05, -0.05, 0.0, 0.05, 0.05, 0.01);
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  builder.add(solid(shape.build()), Placement());
  Studio studio(builder.build(), camera());
  PlanOptions all;
  all.skip = false;
  EXPECT_TRUE(studio.plan(from({0.1, -0.35, 0.6}), all).received_shadows.empty());
}

// An object casts no shadow onto its parent or siblings. Children of a joint without a model count
// as separate objects.
TEST(PhantomShadow, IsOmittedWithinOneObjectHierarchy) {
  for (const bool on_model : {true, false}) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    const int base = builder.add(on_model ? box(0.1, 0.1, 0.05) : nullptr, test::at(0, 0, 0.025));
    const int low = builder.add(box(0.1, 0.1, 0.02), test::at(0, 0, 0.05));
    const int high = builder.add(l_shape(), test::at(0, 0, 0.15));
    for (const int child : {low, high})
      builder.scene().objects[static_cast<std::size_t>(child)].parent = base;
    Studio studio(builder.build(), camera());
    const FramePlan plan = studio.plan(from({0.1, -0.35, 0.6}));
    EXPECT_EQ(plan.received_shadows.size(), on_model ? 0U : 1U);
  }
}

// A phantom receives the shadows of its children, which also cast shadows on each other.
TEST(PhantomShadow, FallsOnPhantomParent) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  const int base = builder.add(box(0.1, 0.1, 0.05), test::at(0, 0, 0.025));
  builder.scene().objects[static_cast<std::size_t>(base)].phantom = true;
  const int low = builder.add(box(0.1, 0.1, 0.02), test::at(0, 0, 0.05));
  const int high = builder.add(l_shape(), test::at(0, 0, 0.15));
  for (const int child : {low, high})
    builder.scene().objects[static_cast<std::size_t>(child)].parent = base;
  Studio studio(builder.build(), camera());
  const FramePlan plan = studio.plan(from({0.1, -0.35, 0.6}));
  const auto falls = [&](int caster, int receiver) {
    return std::ranges::any_of(plan.received_shadows, [&](const ReceivedShadowDraw& draw) {
      return draw.shadow.object == caster && draw.receiver == receiver;
    });
  };
  EXPECT_TRUE(falls(low, base));
  EXPECT_TRUE(falls(high, base));
  EXPECT_TRUE(falls(high, low));
}

// As on planes, each pixel shows the darkest shadow of all casters.
TEST_P(PhantomShadow, ShowsDarkestCasterOnObject) {
  SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
  const int first = builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
  const int second = builder.add(l_shape(), test::at(0.03, 0.02, 0.22, {0, 0, 1}, 1.0));
  builder.add(box(0.2, 0.2, 0.06), test::at(0.02, 0.0, 0.03), false);
  Studio studio(builder.build(), camera());
  FramePlan plan = studio.plan(from({0.1, -0.35, 0.6}));
  std::erase_if(plan.objects, [](const ObjectDraw& draw) { return draw.object < 2; });
  const auto image_under = [&](int caster) {
    FramePlan single = plan;
    std::erase_if(single.received_shadows, [caster](const ReceivedShadowDraw& draw) {
      return draw.shadow.object != caster;
    });
    return studio.draw(white(), single);
  };
  const RenderedImage a = image_under(first);
  const RenderedImage b = image_under(second);
  const RenderedImage both = studio.draw(white(), plan);
  int differing = 0;
  int of_both = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      differing += both.red(x, y) != std::min(a.red(x, y), b.red(x, y)) ? 1 : 0;
      of_both += a.red(x, y) != b.red(x, y) ? 1 : 0;
    }
  }
  EXPECT_EQ(differing, 0);
  EXPECT_GT(of_both, 500);
}

TEST_P(PhantomShadow, OnObjectsIsIndependentOfSkipping) {
  std::mt19937 random(6);
  int skipped = 0;
  int drawn = 0;
  for (int i = 0; i < (test::nightly() ? 12 : 6); ++i) {
    SceneBuilder builder = builder_with(GetParam().technique, GetParam().light_mode);
    add_anywhere(builder, random, i % 2 == 0, false);
    Studio studio(builder.build(), camera());
    const PoseEstimate pose = from({0.3, -0.4, 0.5});
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(pose);
    const FramePlan complete = studio.plan(pose, all);
    EXPECT_EQ(complete.received_shadows.size(), 2U);
    const auto missed = std::ranges::count(skipping.skipped, SkipReason::shadow_misses_objects,
                                           &SkippedPass::reason);
    EXPECT_EQ(static_cast<std::size_t>(missed) + skipping.received_shadows.size(), 2U);
    skipped += static_cast<int>(missed);
    drawn += static_cast<int>(skipping.received_shadows.size());
    EXPECT_EQ(studio.draw(white(), skipping), studio.draw(white(), complete)) << i;
    if (skipping.received_shadows.empty()) {
      studio.draw(white(), skipping);
      EXPECT_EQ(studio.stats()[Counter::masks_drawn] + studio.stats()[Counter::masks_kept], 0);
    }
  }
  EXPECT_GT(skipped, 1);
  EXPECT_GT(drawn, 3);
}

// Blended materials receive no shadow. Skipping them must not change the frame.
TEST(PhantomShadow, SkipsBlendedReceivers) {
  const auto glass = std::make_shared<Model>(*box(0.2, 0.2, 0.06));
  ASSERT_FALSE(glass->materials.empty());
  for (Material& material : glass->materials) {
    material.alpha_mode = AlphaMode::blend;
    material.base_color.a = 0.5F;
  }
  const auto half_of_glass = std::make_shared<Model>(*glass);
  half_of_glass->materials.emplace_back();
  half_of_glass->meshes.push_back(half_of_glass->meshes.front());
  half_of_glass->meshes.back().material = static_cast<int>(half_of_glass->materials.size()) - 1;
  struct Case {
    std::shared_ptr<const Model> model;
    bool phantom, receives;
  };
  for (const Case& c : {Case{glass, false, false}, Case{half_of_glass, false, true},
                        Case{glass, true, true}, Case{box(0.2, 0.2, 0.06), false, true}}) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
    builder.add(c.model, test::at(0.02, 0.0, 0.03), false, c.phantom);
    Studio studio(builder.build(), camera());
    PlanOptions all;
    all.skip = false;
    const FramePlan skipping = studio.plan(from({0.1, -0.35, 0.6}));
    const FramePlan complete = studio.plan(from({0.1, -0.35, 0.6}), all);
    EXPECT_EQ(skipping.received_shadows.size(), c.receives ? 1U : 0U);
    EXPECT_EQ(
        std::ranges::count(skipping.skipped, SkipReason::receiver_blends, &SkippedPass::reason),
        c.receives ? 0 : 1);
    EXPECT_GE(complete.received_shadows.size(), 1U);
    EXPECT_EQ(
        std::ranges::count(complete.skipped, SkipReason::receiver_blends, &SkippedPass::reason), 0);
    EXPECT_EQ(studio.draw(white(), skipping), studio.draw(white(), complete));
  }
}

// Retexturing equals blending up to rounding. A screen-door pattern darkens a fraction of the
// pixels.
TEST(PhantomShadow, FallsOnObjectsInEveryTranslucencyMode) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
  builder.add(box(0.2, 0.2, 0.06), test::at(0.02, 0.0, 0.03), false);
  Studio studio(builder.build(), camera());
  const auto drawn = [&](Translucency mode, bool received) {
    PlanOptions options;
    options.translucency = mode;
    FramePlan plan = studio.plan(from({0.1, -0.35, 0.6}), options);
    if (!received) plan.received_shadows.clear();
    return studio.draw(white(), plan);
  };
  const RenderedImage blended = drawn(Translucency::blend, true);
  const RenderedImage retextured = drawn(Translucency::retexture, true);
  const RenderedImage dithered = drawn(Translucency::mesh, true);
  const RenderedImage lit = drawn(Translucency::blend, false);
  int differing = 0;
  int dark = 0;
  int black = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      differing += std::abs(blended.red(x, y) - retextured.red(x, y)) > 1 ? 1 : 0;
      dark += blended.red(x, y) < lit.red(x, y) ? 1 : 0;
      black += dithered.red(x, y) == 0 && lit.red(x, y) > 0 && blended.red(x, y) < lit.red(x, y);
    }
  }
  EXPECT_EQ(differing, 0);
  EXPECT_GT(dark, 1000);
  EXPECT_GT(black, 0.1 * dark);
  EXPECT_LT(black, 0.9 * dark);
}

// The resolution of a shadow on a receiver must not depend on other objects in the scene.
TEST(PhantomShadow, KeepsResolutionDespiteDistantObjects) {
  const auto drawn = [](int far_away, bool skip) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    ShapeBuilder torus;
    torus.torus(0.06, 0.02, 16, 40);
    builder.add(solid(torus.build()), test::at(0.0, 0.0, 0.12, {1, 0, 0}, 0.2));
    builder.add(solid(ball(0.12, 24)), test::at(0.0, 0.0, -0.07), false, true);
    for (int i = 0; i < far_away; ++i)
      builder.add(box(0.02, 0.02, 0.02), test::at(50.0 + 0.1 * i, 40.0, 0.05));
    Studio studio(builder.build(), camera());
    PlanOptions options;
    options.skip = skip;
    options.layers = LayerDrawing::mask;
    const FramePlan plan = studio.plan(from({0.1, -0.25, 0.3}), options);
    EXPECT_EQ(plan.caster_receiver_pairs, 1U);
    const RenderedImage image = studio.draw(white(), plan);
    EXPECT_GT(studio.stats()[Counter::masks_drawn], 0);
    return image;
  };
  const RenderedImage alone = drawn(0, true);
  EXPECT_EQ(alone, drawn(40, true));
  EXPECT_EQ(alone, drawn(40, false));
}

// Under a caster at a large distance, a slope has fewer, evenly spaced levels. Elsewhere the
// spacing is kLevelStep.
TEST(ReceivingLevels, AreSpacedWiderUnderHighCaster) {
  const ReceivingSurface surface(ramp(0.2, 0.5, 0.002), Placement(), PlaneFrame());
  const auto levels = surface.levels(kEverywhere, 1.0, 64, {kLevelStep, 0.06, 0.02});
  EXPECT_NEAR(levels.front(), 0.001, 1e-6);
  EXPECT_NEAR(levels.back(), 0.101, 1e-6);
  for (std::size_t i = 1; i < levels.size(); ++i) {
    EXPECT_LE(levels[i] - levels[i - 1], (levels[i] <= 0.06 ? 0.02 : kLevelStep) + 1e-9);
  }
  EXPECT_LE(levels.size(), 4U + 12U);  // steps of 20 mm over 59 mm, then of 4 mm over 41 mm
  EXPECT_GE(surface.levels(kEverywhere, 1.0, 64).size(), 26U);
  EXPECT_NEAR(surface.lowest({Eigen::Vector2d(0.1, 0.0), Eigen::Vector2d(0.11, 0.01)}), 0.051,
              1.1e-3);
}

}  // namespace
}  // namespace penumbra::phantom_shadow_test
