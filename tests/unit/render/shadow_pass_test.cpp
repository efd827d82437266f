// Drawn shadows: areas are compared with closed formulas, pixels with a projection on the CPU.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <set>

#include "render/passes/shadow_pass.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/casters/caster_geometry.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "support/plane_coverage.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::shadow_pass_test {
namespace {

using test::box;
using test::RenderedImage;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 400;
constexpr double kEyeHeight = 1.0;
constexpr double kFocal = 800.0;

// A camera 1 m above the table that looks straight down; the table has 800 px/m.
CameraModel overhead_camera() {
  CameraParameters p;
  p.width = p.height = kSide;
  p.fx = p.fy = kFocal;
  p.cx = p.cy = 199.5 + 0.27;
  return CameraModel::make(p).value();
}
PoseEstimate overhead() {
  return test::tracked(test::look_at({0.0, 0.0, kEyeHeight}, {0.0, 0.0, 0.0}));
}
Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}

constexpr double square(double x) {
  return x * x;
}

std::shared_ptr<const Model> disc(double radius) {
  ShapeBuilder shape;
  const std::uint32_t centre = shape.vertex(0, 0, 0);
  std::vector<std::uint32_t> rim;
  for (int i = 0; i < 96; ++i) {
    const double t = 2.0 * std::numbers::pi * i / 96;
    rim.push_back(shape.vertex(radius * std::cos(t), radius * std::sin(t), 0.0));
  }
  for (std::size_t i = 0; i < 96; ++i) shape.triangle(centre, rim[i], rim[(i + 1) % 96]);
  return test::finished(shape.build(), glm::vec4(1.0F));
}
std::shared_ptr<const Model> torus() {
  ShapeBuilder shape;
  shape.torus(0.06, 0.015, 16, 48);
  return test::finished(shape.build(), glm::vec4(0.2F, 0.5F, 0.9F, 1.0F));
}

LayeredConstants constants_with(double light_height, double ratio, double umbra_height = 0.0) {
  return make_layered_constants(light_height, ratio, umbra_height).value();
}

// Pixels of one layer of the only shadow, drawn alone, and their area on the table.
struct Layer {
  std::vector<std::uint8_t> pixels;
  double area_m2 = 0.0;
};
Layer draw_layer(Studio& studio, const PoseEstimate& pose, ShadowLayer layer, bool skip = true) {
  PlanOptions options;
  options.layers = LayerDrawing::direct;  // silhouette_mask_test.cpp tests masks
  options.skip = skip;
  FramePlan plan = studio.plan(pose, options);
  for (ShadowDraw& shadow : plan.shadows) {
    shadow.umbra = shadow.umbra && layer == ShadowLayer::umbra;
    shadow.middle = shadow.middle && layer == ShadowLayer::middle;
    shadow.penumbra = shadow.penumbra && layer == ShadowLayer::penumbra;
  }
  const RenderedImage image = studio.draw_shadows(white(), plan);
  Layer drawn;
  int count = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const bool dark = image.red(x, y) < 255;
      drawn.pixels.push_back(dark ? 1 : 0);
      count += dark ? 1 : 0;
    }
  }
  drawn.area_m2 = count * square(kEyeHeight / kFocal);
  return drawn;
}

int count_differing(const std::vector<std::uint8_t>& a, const std::vector<std::uint8_t>& b) {
  int count = 0;
  for (std::size_t i = 0; i < a.size(); ++i) count += a[i] != b[i] ? 1 : 0;
  return count;
}

// Returns the pixels of the overhead camera whose centres lie in any of the projected triangles.
std::vector<std::uint8_t> covered_by(const std::vector<PlanePoint>& points) {
  std::vector<std::uint8_t> mask(static_cast<std::size_t>(kSide * kSide), 0);
  const CameraModel camera = overhead_camera();
  const CameraPose pose = overhead().T_table_camera;
  std::vector<Eigen::Vector2d> px;
  for (const PlanePoint& p : points) {
    px.push_back(*camera.project(
        pose.inverse() * Eigen::Vector3d(static_cast<double>(p.u), static_cast<double>(p.v), 0.0)));
  }
  for (std::size_t i = 0; i + 2 < px.size(); i += 3) {
    const Eigen::Vector2d& a = px[i];
    const Eigen::Vector2d& b = px[i + 1];
    const Eigen::Vector2d& c = px[i + 2];
    const auto low = [&](int axis) {
      return std::max(0, static_cast<int>(std::ceil(std::min({a[axis], b[axis], c[axis]}))));
    };
    const auto high = [&](int axis) {
      return std::min(kSide - 1,
                      static_cast<int>(std::floor(std::max({a[axis], b[axis], c[axis]}))));
    };
    const auto side = [](const Eigen::Vector2d& from, const Eigen::Vector2d& to, double x,
                         double y) {
      return (to.x() - from.x()) * (y - from.y()) - (to.y() - from.y()) * (x - from.x());
    };
    if (side(a, b, c.x(), c.y()) == 0.0) continue;
    for (int y = low(1); y <= high(1); ++y) {
      for (int x = low(0); x <= high(0); ++x) {
        const double s0 = side(a, b, x, y);
        const double s1 = side(b, c, x, y);
        const double s2 = side(c, a, x, y);
        if ((s0 >= 0 && s1 >= 0 && s2 >= 0) || (s0 <= 0 && s1 <= 0 && s2 <= 0))
          mask[static_cast<std::size_t>(y * kSide + x)] = 1;
      }
    }
  }
  return mask;
}

// The scene's first object, placed over the first plane as `penumbra shadow` does. Its long edges
// are split for the overhead camera.
struct PlacedObject {
  ShadowMesh mesh;
  CasterGeometry geometry;
  ShadowKernels kernels;               // kernels of `mesh`
  std::vector<CasterVertex> vertices;  // vertices of `geometry`
};
PlacedObject first_object(const Scene& scene) {
  const SceneObject& object = scene.objects[0];
  const PlaneFrame plane = PlaneFrame::make(scene.planes[0].normal, scene.planes[0].point);
  PlacedObject placed;
  placed.mesh = make_shadow_mesh(*object.model);
  placed.geometry =
      split_long_edges(placed.mesh, longest_caster_edges(scene, overhead_camera())[0]);
  const Eigen::Vector3d up =
      KernelDirection::nearest(object.placement.rotation.conjugate() * plane.n).up();
  placed.kernels = generate_kernels(placed.mesh, up, scene.shadows[0].kernels);
  ShadowMesh split;
  split.positions = placed.geometry.positions;
  split.indices = placed.geometry.indices;
  const ShadowKernels levelled{up, level_kernels(placed.geometry, placed.kernels), {}};
  placed.vertices = place_caster(split, levelled, object.placement, plane);
  return placed;
}

// Computes the layer on the CPU, without OpenGL.
std::vector<std::uint8_t> cpu_layer(const Scene& scene, ShadowLayer layer) {
  const LayeredConstants& constants = scene.shadows[0].layered;
  const PlacedObject placed = first_object(scene);
  std::vector<PlanePoint> points;
  for (const CasterVertex& v : clip_to_heights(placed.vertices, placed.geometry.indices,
                                               layer_height_range(constants, layer)))
    points.push_back(project_to_layer(v, constants, layer));
  return covered_by(points);
}

TEST(ShadowPass, ScalesAreaOfHorizontalDiscBySquaredLayerFactor) {
  struct Case {
    LayeredConstants constants;
    double h;
  };
  const double inf = std::numeric_limits<double>::infinity();
  const std::vector<Case> cases = {
      {constants_with(0.9, 3.0), 0.0},     {constants_with(0.9, 3.0), 0.05},
      {constants_with(0.9, 3.0), 0.15},    {constants_with(0.9, 3.0), 0.25},
      {constants_with(1.5, 5.0), 0.1},     {constants_with(inf, 0.0, 0.3), 0.1},
      {constants_with(inf, 0.0, 0.3), 0.2}};
  for (const Case& c : cases) {
    SceneBuilder builder;
    builder.add(disc(0.05), test::at(0.011, -0.017, c.h));
    builder.scene().shadows[0].layered = c.constants;
    Studio studio(builder.build(), overhead_camera());
    for (const ShadowLayer layer : kShadowLayers) {
      const double s = layer_factor(c.constants, layer, c.h);
      const double expected =
          48.0 * std::sin(2.0 * std::numbers::pi / 96.0) * square(0.05 * s);  // 96 corners
      const double drawn = draw_layer(studio, overhead(), layer).area_m2;
      // A pixel is 1.6 mm^2. Counting pixels at the boundary has an error of less than a few tens
      // of pixels.
      EXPECT_NEAR(drawn, expected, 0.004 * expected + 12 * square(kEyeHeight / kFocal))
          << "H " << c.constants.light_height << " h " << c.h << " lambda " << lambda_of(layer);
    }
  }
}

TEST(ShadowPass, DrawsCubeWithAreaOfLayerFactor) {
  const LayeredConstants constants = constants_with(0.9, 3.0);
  SceneBuilder builder;
  builder.add(box(0.08, 0.08, 0.08), test::at(0.003, 0.005, 0.1));
  builder.scene().shadows[0].layered = constants;
  Studio studio(builder.build(), overhead_camera());
  // The box's bottom determines the umbra, which shrinks with height; its top determines the other
  // layers.
  const double umbra = square(0.08 * layer_factor(constants, ShadowLayer::umbra, 0.06));
  const double middle = square(0.08 * layer_factor(constants, ShadowLayer::middle, 0.14));
  const double penumbra = square(0.08 * layer_factor(constants, ShadowLayer::penumbra, 0.14));
  EXPECT_NEAR(draw_layer(studio, overhead(), ShadowLayer::umbra).area_m2, umbra, 0.02 * umbra);
  EXPECT_NEAR(draw_layer(studio, overhead(), ShadowLayer::middle).area_m2, middle, 0.02 * middle);
  EXPECT_NEAR(draw_layer(studio, overhead(), ShadowLayer::penumbra).area_m2, penumbra,
              0.02 * penumbra);
}

TEST(ShadowPass, NestsLayersOfDiscAndCube) {
  for (const auto& model : {disc(0.05), box(0.08, 0.05, 0.06)}) {
    SceneBuilder builder;
    builder.add(model, test::at(0.0, 0.0, 0.12, {0, 0, 1}, 0.3));
    Studio studio(builder.build(), overhead_camera());
    const Layer umbra = draw_layer(studio, overhead(), ShadowLayer::umbra);
    const Layer middle = draw_layer(studio, overhead(), ShadowLayer::middle);
    const Layer penumbra = draw_layer(studio, overhead(), ShadowLayer::penumbra);
    EXPECT_GT(umbra.area_m2, 0.0);
    EXPECT_GT(middle.area_m2, umbra.area_m2);
    EXPECT_GT(penumbra.area_m2, middle.area_m2);
    for (std::size_t i = 0; i < umbra.pixels.size(); ++i) {
      ASSERT_LE(umbra.pixels[i], middle.pixels[i]);
      ASSERT_LE(middle.pixels[i], penumbra.pixels[i]);
    }
  }
}

TEST(ShadowPass, MatchesProjectionOnCpu) {
  const double inf = std::numeric_limits<double>::infinity();
  struct Case {
    const char* name;
    std::shared_ptr<const Model> model;
    Placement placement;
    LayeredConstants constants;
  };
  const std::vector<Case> cases = {
      {"torus, tilted", torus(), test::at(0.01, 0.02, 0.12, {1, 0.3, 0}, 0.6),
       constants_with(0.9, 3.0)},
      {"bar through h_u", box(0.2, 0.02, 0.02), test::at(0, 0, 0.3, {0, 1, 0}, -0.5236),
       constants_with(0.9, 3.0)},
      {"bar through the plane", box(0.2, 0.02, 0.02), test::at(0, 0, 0.02, {0, 1, 0}, -0.5236),
       constants_with(0.9, 3.0)},
      {"bar through the cap", box(0.2, 0.02, 0.02), test::at(0, 0, 0.33, {0, 1, 0}, -0.5236),
       LayeredConstants{0.45, 1.2, 0.375, 4.0}},
      {"zenith", torus(), test::at(0, 0, 0.28, {0, 1, 0}, 0.5), constants_with(inf, 0.0, 0.3)},
      {"scaled", torus(), test::at(0, 0, 0.1, {0, 1, 1}, 0.5, 0.7), constants_with(0.6, 2.0)}};
  for (const Case& c : cases) {
    SceneBuilder builder;
    builder.add(c.model, c.placement);
    builder.scene().shadows[0].layered = c.constants;
    Studio studio(builder.build(), overhead_camera());
    for (const ShadowLayer layer : kShadowLayers) {
      const Layer drawn = draw_layer(studio, overhead(), layer);
      const std::vector<std::uint8_t> expected = cpu_layer(studio.scene(), layer);
      const auto size = std::count(expected.begin(), expected.end(), 1);
      // Only pixel centres on an edge may differ, because of rounding to 1/256 px and to float.
      EXPECT_LE(count_differing(drawn.pixels, expected), 2 + size / 400)
          << c.name << ", lambda " << lambda_of(layer) << ", " << size << " px";
      EXPECT_GT(size, 100) << c.name;
    }
  }
}

// Computes a layer of a light of fixed size on the CPU.
std::vector<std::uint8_t> cpu_light_layer(const Scene& scene, ShadowLayer layer) {
  const PlacedObject placed = first_object(scene);
  std::vector<VertexDisc> discs =
      vertex_discs(placed.mesh, placed.kernels, part_discs(placed.mesh, placed.kernels.up),
                   scene.objects[0].placement.scale);
  for (const auto& [a, b] : placed.geometry.midpoint_of) {
    discs.push_back({0.5F * (discs[a].radius + discs[b].radius), discs[a].part_radius});
  }
  return covered_by(fixed_light_triangles(placed.vertices, discs, placed.geometry.indices,
                                          scene.shadows[0].layered, layer));
}

TEST(ShadowPass, MatchesProjectionOnCpuForFixedLight) {
  // The club is thick at one end and thin at the other, which makes the two light modes differ.
  ShapeBuilder club;
  club.limb({-0.06, 0.0, 0.0}, {0.06, 0.01, 0.0}, 0.025, 0.006, 24);
  club.sphere(0.025, 16, 24, -0.06);
  const auto model = test::finished(club.build(), glm::vec4(1.0F));
  struct Case {
    const char* name;
    std::shared_ptr<const Model> model;
    Placement placement;
  };
  const std::vector<Case> cases = {
      {"club", model, test::at(0.0, 0.0, 0.12, {0, 0, 1}, 0.4)},
      {"club, tilted and larger", model,
       test::at(0.0, 0.0, 0.15, {0, 1, 0}, 11.0 * KernelDirection::kStepRad, 1.2)},
      {"club on the table", model, test::at(0.0, 0.0, 0.025)},
      {"torus", torus(), test::at(0.01, 0.02, 0.2, {1, 0.3, 0}, 0.6)}};
  for (const Case& c : cases) {
    SceneBuilder builder;
    builder.add(c.model, c.placement);
    builder.scene().shadows[0].layered = constants_with(0.9, 3.0);
    Studio proportional(builder.build(), overhead_camera());
    builder.scene().shadows[0].light_mode = LightMode::fixed;
    Studio studio(builder.build(), overhead_camera());
    int changed = 0;
    for (const ShadowLayer layer : kShadowLayers) {
      const Layer drawn = draw_layer(studio, overhead(), layer);
      const std::vector<std::uint8_t> expected = cpu_light_layer(studio.scene(), layer);
      const auto size = std::count(expected.begin(), expected.end(), 1);
      EXPECT_LE(count_differing(drawn.pixels, expected), 4 + size / 100)
          << c.name << ", lambda " << lambda_of(layer) << ", " << size << " px";
      EXPECT_GT(size, 100) << c.name;
      EXPECT_EQ(draw_layer(studio, overhead(), layer, false).pixels, drawn.pixels) << c.name;
      changed += count_differing(drawn.pixels, draw_layer(proportional, overhead(), layer).pixels);
    }
    EXPECT_GT(changed, 100) << c.name << ": the shadow must differ from a proportional light's";
  }
}

// Pixels whose rays meet the plane z = 0 inside the layer that `penumbra shadow` computes, for any
// lens; and the number of these pixels that have a neighbour outside.
struct Expected {
  std::vector<std::uint8_t> pixels;
  int size = 0, border = 0;
};
Expected offline_layer(const Scene& scene, const std::vector<Eigen::Vector2d>& ground,
                       ShadowLayer layer) {
  const SceneObject& object = scene.objects[0];
  const ShadowNode& node = scene.shadows[0];
  const PlaneFrame plane;
  const ShadowMesh mesh = make_shadow_mesh(*object.model);
  const Eigen::Vector3d up =
      KernelDirection::nearest(object.placement.rotation.conjugate() * plane.n).up();
  ShadowKernels kernels = generate_kernels(mesh, up, node.kernels);
  kernels.kernels = level_kernels(split_long_edges(mesh, 0.0F), kernels);
  const auto vertices = place_caster(mesh, kernels, object.placement, plane);
  const auto triangles =
      node.light_mode == LightMode::fixed
          ? fixed_light_triangles(
                vertices, vertex_discs(mesh, kernels, part_discs(mesh, up), object.placement.scale),
                mesh.indices, node.layered, layer)
          : layer_triangles(vertices, mesh.indices, node.layered, layer);
  Expected expected;
  for (const Eigen::Vector2d& p : ground)
    expected.pixels.push_back(test::covers(triangles, p) ? 1 : 0);
  for (int y = 1; y + 1 < kSide; ++y) {
    for (int x = 1; x + 1 < kSide; ++x) {
      const auto at = [&](int dx, int dy) {
        return expected.pixels[static_cast<std::size_t>((y + dy) * kSide + x + dx)] != 0;
      };
      if (!at(0, 0)) continue;
      ++expected.size;
      expected.border += at(1, 0) && at(-1, 0) && at(0, 1) && at(0, -1) ? 0 : 1;
    }
  }
  return expected;
}

// Returns the intersections of the pixels' rays with the plane z = 0.
std::vector<Eigen::Vector2d> ground_under(const CameraModel& camera, const PoseEstimate& pose) {
  std::vector<Eigen::Vector2d> ground;
  const CameraPose& T = pose.T_table_camera;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Eigen::Vector3d ray = T.rotation() * *camera.unproject({x, y});
      const double t = -T.translation().z() / ray.z();
      ground.emplace_back((T.translation() + t * ray).head<2>());
    }
  }
  return ground;
}

// Faces are split to follow the lens distortion, but the layer must equal the projection of the
// unsplit faces. The faces are large, tilted, and near enough to be split.
TEST(ShadowPass, MatchesShadowCommandThroughLens) {
  const CameraModel camera = test::camera_of(kSide, kSide, 420.0, DistortionModel::plumb_bob,
                                             {-0.25, 0.07, 0.001, -0.001});
  const PoseEstimate pose = test::tracked(test::look_at({0.05, -0.28, 0.42}, {0.0, 0.0, 0.0}));
  struct Case {
    const char* name;
    std::shared_ptr<const Model> model;
    Placement placement;
  };
  const std::vector<Eigen::Vector2d> ground = ground_under(camera, pose);
  const double step = KernelDirection::kStepRad;
  const std::vector<Case> cases = {
      {"plate", box(0.12, 0.1, 0.004), test::at(0, 0, 0.1, {0, 1, 0}, 20.0 * step)},
      {"bar", box(0.16, 0.02, 0.02), test::at(0.01, 0, 0.12, {0, 1, 0}, -15.0 * step)},
      {"plate in the table", box(0.12, 0.1, 0.004), test::at(0, 0, 0.02, {0, 1, 0}, 20.0 * step)},
      {"bar through h_u", box(0.16, 0.02, 0.02), test::at(0, 0, 0.2, {0, 1, 0}, -15.0 * step)}};
  for (const LightMode mode : {LightMode::proportional, LightMode::fixed}) {
    for (const Case& c : cases) {
      SceneBuilder builder;
      builder.add(c.model, c.placement);
      builder.scene().shadows[0].layered = constants_with(0.5, 2.5);
      builder.scene().shadows[0].light_mode = mode;
      Studio studio(builder.build(), camera);
      for (const ShadowLayer layer : kShadowLayers) {
        const Expected expected = offline_layer(studio.scene(), ground, layer);
        const std::string what = std::string(c.name) + ", " +
                                 std::string(name_of(kLightModeNames, mode)) + ", lambda " +
                                 std::to_string(lambda_of(layer));
        const Layer drawn = draw_layer(studio, pose, layer);
        EXPECT_GT(expected.size, 100) << what;
        // Edges lie within 0.15 px of their exact position, so pixels that close to an edge may
        // differ.
        EXPECT_LE(count_differing(drawn.pixels, expected.pixels), 4 + 0.15 * expected.border)
            << what << ", " << expected.size << " px";
        EXPECT_EQ(draw_layer(studio, pose, layer, false).pixels, drawn.pixels) << what;
      }
    }
  }
}

// A bar of 0.2 m, inclined by 30 degrees, rises through h_u. Its umbra must shrink without a jump
// although the bar has only 12 triangles (docs/shadows.md#layers).
TEST(ShadowPass, ShrinksUmbraOfRisingBarEvenly) {
  double previous = -1.0;
  double start = 0.0;
  double largest_jump = 0.0;
  for (int i = 0; i <= 24; ++i) {
    SceneBuilder builder;
    builder.add(box(0.2, 0.02, 0.02),
                test::at(0, 0, 0.2 + 0.007 * i, {0, 1, 0}, -std::numbers::pi / 6));
    builder.scene().shadows[0].layered = constants_with(0.9, 3.0);
    Studio studio(builder.build(), overhead_camera());
    const double area = draw_layer(studio, overhead(), ShadowLayer::umbra).area_m2;
    if (i == 0) start = area;
    if (previous >= 0.0) {
      EXPECT_LE(area, previous * 1.01) << i;
      largest_jump = std::max(largest_jump, (previous - area) / start);
    }
    previous = area;
  }
  EXPECT_LE(largest_jump, 7 * 0.015) << "fraction of the initial area lost per step of 7 mm";
  EXPECT_EQ(previous, 0.0) << "the bar is above h_u";
}

TEST(ShadowPass, DarkensPixelOnceByDarkestLayer) {
  SceneBuilder two_objects;
  SceneBuilder only_box;
  SceneBuilder only_torus;
  const Placement a = test::at(-0.03, 0.0, 0.12);
  const Placement b = test::at(0.04, 0.02, 0.16, {1, 0, 0}, 0.3);
  two_objects.add(box(0.1, 0.06, 0.05), a);
  two_objects.add(torus(), b);
  only_box.add(box(0.1, 0.06, 0.05), a);
  only_torus.add(torus(), b);
  const auto draw = [](const SceneBuilder& builder) {
    Studio studio(builder.build(), overhead_camera());
    PlanOptions options;
    options.layers = LayerDrawing::direct;
    return studio.draw_shadows(white(), studio.plan(overhead(), options));
  };
  const RenderedImage together = draw(two_objects);
  const RenderedImage first = draw(only_box);
  const RenderedImage second = draw(only_torus);
  std::set<int> values;
  int overlap = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      values.insert(together.red(x, y));
      ASSERT_EQ(together.red(x, y), std::min(first.red(x, y), second.red(x, y))) << x << " " << y;
      overlap += first.red(x, y) < 255 && second.red(x, y) < 255 ? 1 : 0;
    }
  }
  EXPECT_GT(overlap, 1000);
  // Light fractions of the scene, encoded: 255 f^(1/2.2).
  std::set<int> expected = {255};
  for (const double f : {0.15, 0.4, 0.83})
    expected.insert(static_cast<int>(std::lround(255.0 * std::pow(f, 1.0 / 2.2))));
  EXPECT_EQ(values, expected);
}

TEST(ShadowPass, DrawsFootprintAsSimpleShadow) {
  SceneBuilder builder;
  builder.add(box(0.08, 0.05, 0.02), test::at(0, 0, 0.2));
  Studio studio(builder.build(), overhead_camera());
  PlanOptions options;
  options.technique = ShadowTechnique::simple;
  const RenderedImage image = studio.draw_shadows(white(), studio.plan(overhead(), options));
  int dark = 0;
  for (std::size_t i = 0; i < image.rgba.size(); i += 4) dark += image.rgba[i] < 255 ? 1 : 0;
  EXPECT_NEAR(dark * square(kEyeHeight / kFocal), 0.08 * 0.05, 0.01 * 0.08 * 0.05);
}

TEST(ShadowPass, ClipsShadowAtReceiverOutline) {
  SceneBuilder builder;
  builder.add(box(0.16, 0.16, 0.02), test::at(0, 0, 0.05));
  // An L-shaped outline whose inner corner lies at the origin, under the shadow.
  builder.scene().planes[0].outline = {{-0.3, -0.3}, {0.3, -0.3}, {0.3, 0.0},
                                       {0.0, 0.0},   {0.0, 0.3},  {-0.3, 0.3}};
  Studio clipped(builder.build(), overhead_camera());
  builder.scene().planes[0].outline.clear();
  Studio unclipped(builder.build(), overhead_camera());
  const Layer a = draw_layer(clipped, overhead(), ShadowLayer::penumbra);
  const Layer b = draw_layer(unclipped, overhead(), ShadowLayer::penumbra);
  EXPECT_NEAR(a.area_m2, 0.75 * b.area_m2, 0.01 * b.area_m2);
  const CameraModel camera = overhead_camera();
  const auto pixel = [&](double x, double y) {
    const auto p = *camera.project(overhead().T_table_camera.inverse() * Eigen::Vector3d(x, y, 0));
    return static_cast<std::size_t>(std::lround(p.y()) * kSide + std::lround(p.x()));
  };
  EXPECT_EQ(a.pixels[pixel(0.04, 0.04)], 0);
  EXPECT_EQ(b.pixels[pixel(0.04, 0.04)], 1);
  EXPECT_EQ(a.pixels[pixel(-0.04, 0.04)], 1);
  EXPECT_EQ(a.pixels[pixel(0.04, -0.04)], 1);
}

TEST(ShadowPass, DoesNoWorkWhenOnlyCameraMoves) {
  SceneBuilder builder;
  builder.add(box(0.2, 0.02, 0.02), test::at(0, 0, 0.3, {0, 1, 0}, -0.5236));  // clipped
  // The torus stands apart, because a mask on another object would depend on the camera's distance.
  builder.add(torus(), test::at(0.0, 0.2, 0.1));
  Studio studio(builder.build(), overhead_camera());
  // Masks depend on the camera's distance (DrawnMask.IsReusedUntilCasterMoves).
  PlanOptions options;
  options.layers = LayerDrawing::direct;
  studio.draw(white(), studio.plan(overhead(), options));
  EXPECT_EQ(studio.stats()[Counter::kernel_generations], 2);
  EXPECT_GT(studio.stats()[Counter::shadow_vertices], 0);
  studio.draw(white(),
              studio.plan(test::tracked(test::look_at({0.3, -0.4, 0.8}, {0, 0, 0})), options));
  EXPECT_EQ(studio.stats()[Counter::kernel_generations], 0);
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  EXPECT_EQ(studio.stats()[Counter::reprojections], 2);
}

TEST(ShadowPass, ReportsKernelsInUse) {
  SceneBuilder builder;
  builder.add(box(0.06, 0.06, 0.06), test::at(0.031, -0.017, 0.1, {0, 0, 1}, 0.4));
  builder.add(torus(), test::at(-0.1, 0.05, 0.1));
  Studio studio(builder.build(), overhead_camera());
  studio.draw(white(), studio.plan(overhead()));
  const auto casters = studio.compositor().kernels_in_use();
  ASSERT_EQ(casters.size(), 2U);
  ASSERT_FALSE(casters[0].on_plane.empty());
  for (const Eigen::Vector3d& p : casters[0].on_plane)
    EXPECT_LT((p - Eigen::Vector3d(0.031, -0.017, 0.0)).norm(), 0.0015) << "half a cell";
  EXPECT_GT(casters[1].on_plane.size(), 40U);
  for (const Eigen::Vector3d& p : casters[1].on_plane) {
    EXPECT_NEAR((p - Eigen::Vector3d(-0.1, 0.05, 0.0)).norm(), 0.06, 0.002);
    EXPECT_EQ(p.z(), 0.0);
  }
  EXPECT_EQ(casters[1].object, 1);
  EXPECT_LT(casters[1].spill, 0.02);
  // A field uses no kernels, so none are reported.
  PlanOptions options;
  options.technique = ShadowTechnique::field;
  studio.draw(white(), studio.plan(overhead(), options));
  EXPECT_TRUE(studio.compositor().kernels_in_use().empty());
}

TEST(ShadowPass, QuantizesKernelDirectionsWithinTwoDegrees) {
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d d =
        Eigen::Vector3d(std::sin(i * 1.7), std::sin(i * 2.3 + 1.0), std::sin(i * 3.1 + 2.0))
            .normalized();
    const KernelDirection cell = KernelDirection::nearest(d);
    EXPECT_LE(std::acos(std::min(1.0, std::abs(cell.up().dot(d)))), 2.0 * std::numbers::pi / 180);
    EXPECT_EQ(cell, KernelDirection::nearest(-d)) << "k(d) = k(-d)";
  }
  EXPECT_EQ(KernelDirection::nearest({0, 0, 1}).up(), Eigen::Vector3d(0, 0, 1));
}

TEST(ShadowPass, KeepsSurfaceAndKernelsWhenSplitting) {
  ShapeBuilder shape;
  shape.box(-0.1, -0.05, 0.0, 0.1, 0.05, 0.02);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  const CasterGeometry g = split_long_edges(mesh, 0.02F);
  EXPECT_GT(g.indices.size(), mesh.indices.size());
  double area = 0.0;
  for (std::size_t i = 0; i + 2 < g.indices.size(); i += 3) {
    const glm::vec3 a = g.positions[g.indices[i]];
    const glm::vec3 b = g.positions[g.indices[i + 1]];
    const glm::vec3 c = g.positions[g.indices[i + 2]];
    area += 0.5 * static_cast<double>(glm::length(glm::cross(b - a, c - a)));
    for (const auto& [p, q] : {std::pair{a, b}, std::pair{b, c}, std::pair{c, a}})
      EXPECT_LE(glm::distance(p, q), 0.02F);
  }
  EXPECT_NEAR(area, 2.0 * (0.2 * 0.1 + 0.2 * 0.02 + 0.1 * 0.02), 1e-6);
  // Coarser levels approximate the same surface with longer edges.
  ASSERT_GT(g.coarser.size(), 1U);
  EXPECT_EQ(g.coarser[0].indices, mesh.indices);
  float previous_longest = std::numeric_limits<float>::infinity();
  for (const CasterGeometry::Coarser& coarser : g.coarser) {
    EXPECT_LT(coarser.longest_edge, previous_longest);
    EXPECT_LT(coarser.indices.size(), g.indices.size());
    EXPECT_GT(coarser.longest_edge, 0.02F);
    previous_longest = coarser.longest_edge;
    float longest = 0.0F;
    double same_area = 0.0;
    for (std::size_t i = 0; i + 2 < coarser.indices.size(); i += 3) {
      const glm::vec3 a = g.positions[coarser.indices[i]];
      const glm::vec3 b = g.positions[coarser.indices[i + 1]];
      const glm::vec3 c = g.positions[coarser.indices[i + 2]];
      same_area += 0.5 * static_cast<double>(glm::length(glm::cross(b - a, c - a)));
      longest = std::max({longest, glm::distance(a, b), glm::distance(b, c), glm::distance(c, a)});
    }
    EXPECT_NEAR(same_area, area, 1e-6);
    EXPECT_EQ(longest, coarser.longest_edge);
  }
}

TEST(ShadowPass, ReportsFieldThatIsTooCoarse) {
  const auto reported = [](double length, LayerDrawing layers, bool lifted = false) {
    SceneBuilder builder;
    builder.scene().shadows[0].technique = ShadowTechnique::field;
    builder.scene().shadows[0].layered = constants_with(0.4, 2.5);
    builder.add(box(length, 0.01, 0.01), test::at(0.0, 0.0, lifted ? 5.0 : 0.08, {0, 0, 1}, 0.5));
    Studio studio(builder.build(), overhead_camera());
    PlanOptions options;
    options.layers = layers;
    options.skip = !lifted;
    for (int frame = 0; frame < 2; ++frame) {  // computed in the first frame, reused in the second
      studio.draw(white(), studio.plan(overhead(), options));
    }
    const auto& skipped = studio.stats().skipped;
    return std::ranges::count(skipped, SkipReason::field_too_coarse, &SkippedPass::reason);
  };
  for (const LayerDrawing layers : {LayerDrawing::direct, LayerDrawing::mask}) {
    EXPECT_EQ(reported(0.5, layers), 0);
    EXPECT_EQ(reported(20.0, layers), 1);
    EXPECT_EQ(reported(0.1, layers, true), 0) << "the caster is above all layers";
  }
}

}  // namespace
}  // namespace penumbra::shadow_pass_test
