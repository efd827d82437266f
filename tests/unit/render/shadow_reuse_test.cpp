// Tests what the CPU recomputes after each kind of change between two frames
// (docs/shadows.md#own-frame), for every technique. Also tests drawn shadow fields.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "render/shadow/casters/caster.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "render/shadow/layers/own_frame.hpp"
#include "support/field_sample.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra::shadow_reuse_test {
namespace {

using test::RenderedImage;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 300;
constexpr double kDegree = std::numbers::pi / 180.0;

CameraModel camera() {
  return test::camera_of(kSide, kSide, 600.0);
}
PoseEstimate overhead() {
  return test::tracked(test::look_at({0.0, 0.0, 1.0}, {0.0, 0.0, 0.0}));
}
Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}
ShapeBuilder l_shape() {
  ShapeBuilder shape;
  shape.box(-0.05, -0.05, 0.0, 0.05, -0.02, 0.03);
  shape.box(-0.05, -0.02, 0.0, -0.02, 0.05, 0.03);
  return shape;
}
std::shared_ptr<const Model> l_model() {
  return test::finished(l_shape().build(), glm::vec4(0.8F, 0.3F, 0.1F, 1.0F));
}
std::shared_ptr<const Model> card() {
  ShapeBuilder shape;
  const std::uint32_t a = shape.vertex(-0.05, -0.05, 0.0);
  const std::uint32_t b = shape.vertex(0.05, -0.05, 0.0);
  const std::uint32_t c = shape.vertex(0.05, 0.05, 0.0);
  const std::uint32_t d = shape.vertex(-0.05, 0.05, 0.0);
  shape.triangle(a, b, c);
  shape.triangle(a, c, d);
  return test::finished(shape.build(), glm::vec4(1.0F));
}
Placement turned(const Placement& placement, const Eigen::Vector3d& axis, double angle) {
  Placement result = placement;
  result.rotation =
      Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis.normalized())) * placement.rotation;
  return result;
}

// A scene with one caster that the test moves.
class Stage {
 public:
  Stage(ShadowTechnique technique, std::shared_ptr<const Model> model, const Placement& start,
        LightMode light_mode = LightMode::proportional,
        KernelSource kernels = KernelSource::automatic)
      : scene_([&] {
          SceneBuilder builder;
          builder.add(std::move(model), start);
          builder.scene().shadows[0].technique = technique;
          builder.scene().shadows[0].light_mode = light_mode;
          builder.scene().shadows[0].kernels = kernels;
          builder.scene().shadows[0].layered = make_layered_constants(0.6, 2.5, 0.0).value();
          return builder.build();
        }()),
        studio_(scene_, camera()) {}

  RenderedImage draw(const Placement& placement, const PoseEstimate& pose = overhead(),
                     const LayeredConstants* constants = nullptr) {
    PlanOptions options;
    options.layers = LayerDrawing::direct;  // a sliding caster would need a new mask
    FramePlan plan = studio_.plan(pose, options);
    if (plan.shadows.size() != 1) throw std::runtime_error("one shadow is expected");
    plan.shadows[0].T_table_object = placement;
    if (constants != nullptr) plan.shadows[0].constants = *constants;
    return studio_.draw_shadows(white(), plan);
  }
  [[nodiscard]] const CompositeStats& stats() const { return studio_.stats(); }

 private:
  std::shared_ptr<const Scene> scene_;
  Studio studio_;
};

struct Case {
  const char* name;
  ShadowTechnique technique;
  Placement placement;
  bool on_cpu;  // true if the CPU processes vertices after a change
  LightMode light_mode = LightMode::proportional;
};
class ShadowReuse : public testing::TestWithParam<Case> {
 protected:
  // Number of kernel generations per tilt. A light of fixed size also computes the parts' sizes.
  static int sets_per_tilt() {
    if (GetParam().technique == ShadowTechnique::simple) return 0;
    return GetParam().light_mode == LightMode::fixed ? 2 : 1;
  }
  // Expects that only the placement of existing geometry changed.
  static void expect_reused(const CompositeStats& stats, const char* what) {
    EXPECT_EQ(stats[Counter::shadow_vertices], 0) << what;
    EXPECT_EQ(stats[Counter::kernel_generations], 0) << what;
    EXPECT_EQ(stats[Counter::reprojections], 1) << what;
    EXPECT_EQ(stats[Counter::triples_recomputed], 0) << what;
  }
  static void expect_recomputed(const CompositeStats& stats, const char* what) {
    EXPECT_EQ(stats[Counter::shadow_vertices] > 0, GetParam().on_cpu) << what;
    EXPECT_EQ(stats[Counter::reprojections], 0) << what;
    EXPECT_EQ(stats[Counter::triples_recomputed], 1) << what;
  }
};
// The rotation axis is slanted, so that every coordinate is rounded. The clipped caster extends
// below the plane.
const Placement kFree = test::at(0.01, 0.02, 0.11, {1.0, 0.4, 0.2}, 0.33);
const Placement kClipped = test::at(0.01, 0.02, 0.01, {1.0, 0.4, 0.2}, 0.33);
INSTANTIATE_TEST_SUITE_P(
    Techniques, ShadowReuse,
    testing::Values(Case{"simple", ShadowTechnique::simple, kFree, false},
                    Case{"simple_clipped", ShadowTechnique::simple, kClipped, true},
                    Case{"layered", ShadowTechnique::layered, kFree, false},
                    Case{"layered_clipped", ShadowTechnique::layered, kClipped, true},
                    Case{"fixed_light", ShadowTechnique::layered, kFree, true, LightMode::fixed},
                    Case{"field", ShadowTechnique::field, kFree, true},
                    Case{"field_clipped", ShadowTechnique::field, kClipped, true}),
    [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(ShadowReuse, KeepsGeometryWhileCameraMoves) {
  Stage stage(GetParam().technique, l_model(), GetParam().placement, GetParam().light_mode);
  stage.draw(GetParam().placement);
  expect_recomputed(stage.stats(), "the first frame");
  EXPECT_EQ(stage.stats()[Counter::kernel_generations], sets_per_tilt());
  for (int i = 0; i < 20; ++i) {
    const Eigen::Vector3d eye(0.5 * std::cos(0.3 * i), 0.5 * std::sin(0.3 * i), 0.5 + 0.02 * i);
    stage.draw(GetParam().placement, test::tracked(test::look_at(eye, {0, 0, 0})));
    expect_reused(stage.stats(), "the camera moved");
  }
}

TEST_P(ShadowReuse, KeepsGeometryWhileCasterSlidesAndTurns) {
  Placement placement = GetParam().placement;
  Stage stage(GetParam().technique, l_model(), placement, GetParam().light_mode);
  stage.draw(placement);
  for (int i = 1; i <= 40; ++i) {
    placement = turned(placement, Eigen::Vector3d::UnitZ(), 0.17);
    placement.position.x() = 0.03 * std::sin(0.7 * i);
    placement.position.y() = 0.02 * std::cos(1.1 * i);
    const RenderedImage moved = stage.draw(placement);
    expect_reused(stage.stats(), "slid and turned");
    if (i % 10 != 0) continue;
    Stage fresh(GetParam().technique, l_model(), placement, GetParam().light_mode);
    EXPECT_EQ(moved, fresh.draw(placement)) << "the frame does not depend on earlier frames";
  }
}

TEST_P(ShadowReuse, KeepsKernelsWhenHeightChanges) {
  Placement placement = GetParam().placement;
  Stage stage(GetParam().technique, l_model(), placement, GetParam().light_mode);
  stage.draw(placement);
  for (int i = 1; i <= 5; ++i) {
    placement.position.z() += 0.002;
    stage.draw(placement);
    expect_recomputed(stage.stats(), "lifted");
    EXPECT_EQ(stage.stats()[Counter::kernel_generations], 0);
  }
}

TEST_P(ShadowReuse, KeepsKernelsWhenConstantsChange) {
  Stage stage(GetParam().technique, l_model(), GetParam().placement, GetParam().light_mode);
  stage.draw(GetParam().placement);
  const LayeredConstants other = make_layered_constants(0.7, 2.0, 0.0).value();
  stage.draw(GetParam().placement, overhead(), &other);
  EXPECT_EQ(stage.stats()[Counter::kernel_generations], 0);
  if (GetParam().technique == ShadowTechnique::simple) {
    expect_reused(stage.stats(), "constants that it does not use");
  } else {
    expect_recomputed(stage.stats(), "another light");
  }
}

TEST_P(ShadowReuse, GeneratesKernelsForTiltBeyondThreshold) {
  const Placement start = GetParam().placement;
  Stage stage(GetParam().technique, l_model(), start, GetParam().light_mode);
  stage.draw(start);
  const auto cell = [](const Placement& p) {
    return KernelDirection::nearest(p.rotation.conjugate() * Eigen::Vector3d::UnitZ());
  };
  std::int64_t generations = 0;
  int cells = 0;
  KernelDirection last = cell(start);
  for (int i = 1; i <= 100; ++i) {
    const Placement tilted = turned(start, {0.3, 1.0, 0.0}, 0.15 * i * kDegree);
    stage.draw(tilted);
    generations += stage.stats()[Counter::kernel_generations];
    if (cell(tilted) != last) ++cells;
    last = cell(tilted);
  }
  EXPECT_GT(cells, 4);
  EXPECT_LT(cells, 20);
  EXPECT_EQ(generations, sets_per_tilt() * cells);
  stage.draw(start);
  EXPECT_EQ(stage.stats()[Counter::kernel_generations], 0)
      << "kernels of the first tilt are still stored";
}

// Kernels that no generator would produce, so that the drawn shadow shows whether they are used.
std::shared_ptr<const Model> l_with_stored_kernels(const std::string& stamp = "") {
  Model model = *l_model();
  for (Mesh& mesh : model.meshes)
    mesh.shadow_kernels.assign(mesh.positions.size(), glm::vec3(0.2F, 0.1F, 0.0F));
  model.shadow_kernel_up = glm::vec3(0.0F, 0.0F, 1.0F);
  model.shadow_kernel_geometry = stamp;
  return std::make_shared<const Model>(std::move(model));
}

TEST(StoredKernels, AreUsedForTiltsBelowTwoDegrees) {
  const auto model = l_with_stored_kernels();
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d axis(std::cos(0.75 * i), std::sin(0.75 * i), 0.0);
    for (const double tilt : {0.0, 1.3, 1.9, 1.99, 2.01, 2.3, 2.8, 3.2, 3.7, 4.5}) {
      const Placement placement = turned(test::at(0.0, 0.0, 0.05), axis, tilt * kDegree);
      Stage stage(ShadowTechnique::layered, model, placement);
      stage.draw(placement);
      EXPECT_EQ(stage.stats()[Counter::kernel_generations], tilt < 2.0 ? 0 : 1)
          << tilt << " degrees, " << i;
    }
  }
}

TEST(StoredKernels, AreUsedForFixedLightUnlessCentroid) {
  const Placement placement = test::at(0.0, 0.0, 0.05);
  for (const auto& [stamp, serves] :
       {std::pair<std::string, bool>{"g-p-cocl", false}, {"g-p-auto", true}, {"", true}}) {
    for (const LightMode mode : {LightMode::proportional, LightMode::fixed}) {
      Stage stage(ShadowTechnique::layered, l_with_stored_kernels(stamp), placement, mode);
      stage.draw(placement);
      // A light of fixed size also needs the kernels' radii and the part sizes.
      const int others = mode == LightMode::fixed ? (serves ? 2 : 1) : 0;
      EXPECT_EQ(stage.stats()[Counter::kernel_generations],
                others + (serves || mode == LightMode::proportional ? 0 : 1))
          << stamp << " " << name_of(kLightModeNames, mode);
    }
  }
}

TEST(StoredKernels, SelectSameGeneratorForOtherTilts) {
  const Placement tilted = turned(test::at(0.0, 0.0, 0.08), {1, 0, 0}, 20.0 * kDegree);
  const auto draw = [&](std::shared_ptr<const Model> model, KernelSource source) {
    Stage stage(ShadowTechnique::layered, std::move(model), tilted, LightMode::proportional,
                source);
    return stage.draw(tilted);
  };
  const RenderedImage automatic = draw(l_model(), KernelSource::automatic);
  const RenderedImage centroid = draw(l_model(), KernelSource::centroid);
  ASSERT_NE(automatic, centroid);
  EXPECT_EQ(draw(l_with_stored_kernels("g-p-cocl"), KernelSource::automatic), centroid);
  EXPECT_EQ(draw(l_with_stored_kernels("g-p-auto"), KernelSource::automatic), automatic);
  EXPECT_EQ(draw(l_with_stored_kernels("g-p-smooth"), KernelSource::centroid), centroid)
      << "a requested kind has priority";
}

TEST(ShadowField, IsReusedForNegligibleTilt) {
  // The level placement lies in the middle of a rounding step of the tilt.
  const Placement level = test::at(0.0, 0.0, 0.1);
  Stage stage(ShadowTechnique::field, l_model(), level);
  const RenderedImage before = stage.draw(level);
  const RenderedImage after = stage.draw(turned(level, {1, 0, 0}, 4e-5));
  EXPECT_EQ(stage.stats()[Counter::reprojections], 1);
  EXPECT_EQ(after, before);
  stage.draw(turned(level, {1, 0, 0}, 1e-3));
  EXPECT_EQ(stage.stats()[Counter::triples_recomputed], 1);
}

TEST(OwnFrame, ReproducesObjectPlacement) {
  for (int i = 0; i < 200; ++i) {
    const PlaneFrame plane =
        PlaneFrame::make(Eigen::Vector3d(std::sin(1.3 * i), std::sin(2.1 * i), std::cos(0.7 * i)) +
                             Eigen::Vector3d::Constant(0.01),
                         {0.1 * i, -0.3, 0.02 * i});
    const Placement T = test::at(std::cos(0.9 * i), std::sin(1.7 * i), 0.3,
                                 {std::sin(0.3 * i), 0.5, std::cos(i)}, 0.37 * i, 0.5 + 0.01 * i);
    const OwnFrame own = OwnFrame::make(T, plane, T.scale, 40);
    for (const Eigen::Vector3d& p : {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0, 1, 0),
                                     Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, 0, 0)}) {
      const Eigen::Vector3d expected = plane.to_plane(T * p);
      const Eigen::Vector3d x = own.T_own_object * p;
      const Eigen::Vector2d placed = own.T_plane_own * Eigen::Vector2d(x.head<2>());
      EXPECT_NEAR((placed - expected.head<2>()).norm(), 0.0, 1e-10);
      EXPECT_NEAR(x.z(), expected.z(), 1e-10);
    }
  }
}

// Compares each pixel with the field's value at the pixel's point on the table.
TEST(ShadowField, MatchesFieldValuesOnPlane) {
  const Placement unturned = test::at(0.0, 0.0, 0.09);
  const double yaw = 0.6;
  Placement placement = turned(unturned, Eigen::Vector3d::UnitZ(), yaw);
  placement.position += Eigen::Vector3d(0.013, -0.021, 0.0);
  Stage stage(ShadowTechnique::field, l_model(), placement);
  const RenderedImage image = stage.draw(placement);

  const ShadowMesh mesh = make_shadow_mesh(*l_model());
  const PlaneFrame plane;
  const ShadowKernels none{plane.n, mesh.positions, {}};
  const ShadowField field =
      power_distance_layers(place_caster(mesh, none, unturned, plane), mesh.indices, mesh.part,
                            part_lights(part_discs(mesh, plane.n), unturned, plane),
                            make_layered_constants(0.6, 2.5, 0.0).value());
  const CameraModel lens = camera();
  const CameraPose pose = overhead().T_table_camera;
  std::array<int, 4> size{};
  int differing = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Eigen::Vector3d ray =
          pose.rotation() * Eigen::Vector3d((x - lens.parameters().cx) / lens.parameters().fx,
                                            (y - lens.parameters().cy) / lens.parameters().fy, 1.0);
      const Eigen::Vector3d on_table =
          pose.translation() - ray * (pose.translation().z() / ray.z());
      const Eigen::Vector2d p =
          Eigen::Rotation2Dd(-yaw) * (on_table.head<2>() - placement.position.head<2>());
      std::size_t layer = 3;
      for (std::size_t i = 0; i < 3 && layer == 3; ++i) {
        if (test::field_at(field, kShadowLayers[i], p) > 0.0F) layer = i;
      }
      ++size[layer];
      constexpr std::array kLightLeft = {0.15, 0.4, 0.83, 1.0};
      const auto expected =
          static_cast<int>(std::lround(255.0 * std::pow(kLightLeft[layer], 1.0 / 2.2)));
      differing += image.red(x, y) != expected ? 1 : 0;
    }
  }
  for (std::size_t i = 0; i < 3; ++i) EXPECT_GT(size[i], 300) << i;
  // Rounding to half floats moves an edge by at most 1/2000 cell, so few pixels can differ.
  EXPECT_LE(differing, 5);
}

TEST(ShadowField, DarkensOnceForOverlappingCasters) {
  SceneBuilder both, one, other;
  const Placement a = test::at(-0.02, 0.0, 0.1);
  const Placement b = test::at(0.03, 0.02, 0.15, {1, 0, 0}, 0.3);
  both.add(l_model(), a);
  both.add(card(), b);
  one.add(l_model(), a);
  other.add(card(), b);
  const auto draw = [](SceneBuilder& builder) {
    builder.scene().shadows[0].technique = ShadowTechnique::field;
    Studio studio(builder.build(), camera());
    PlanOptions options;
    options.layers = LayerDrawing::direct;  // in a mask, coverages of one pixel add up
    return studio.draw_shadows(white(), studio.plan(overhead(), options));
  };
  const RenderedImage together = draw(both);
  const RenderedImage first = draw(one);
  const RenderedImage second = draw(other);
  int overlap = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      ASSERT_EQ(together.red(x, y), std::min(first.red(x, y), second.red(x, y))) << x << " " << y;
      overlap += first.red(x, y) < 255 && second.red(x, y) < 255 ? 1 : 0;
    }
  }
  EXPECT_GT(overlap, 500);
}

TEST(ShadowField, DrawsCompleteCardInPlaneDespiteRounding) {
  for (const double angle : {0.0, 0.7, 2.9}) {
    // The card lies in the slanted plane, so every height of it is a rounding error.
    SceneBuilder builder;
    Placement placement = test::at(0.0, 0.0, 0.0, {1.0, 0.3, 0.0}, 0.4);
    const Eigen::Vector3d normal = placement.rotation * Eigen::Vector3d::UnitZ();
    placement = turned(placement, normal, angle);
    builder.add(card(), placement);
    builder.scene().planes[0].normal = normal;
    builder.scene().shadows[0].technique = ShadowTechnique::field;
    Studio studio(builder.build(), camera());
    for (const LayerDrawing layers : {LayerDrawing::direct, LayerDrawing::mask}) {
      PlanOptions options;
      options.layers = layers;
      const RenderedImage image = studio.draw_shadows(white(), studio.plan(overhead(), options));
      constexpr int kHalfUmbra = (255 + 107) / 2;  // value of a pixel on an edge
      int dark = 0;
      for (int y = 0; y < kSide; ++y)
        for (int x = 0; x < kSide; ++x) dark += image.red(x, y) < kHalfUmbra ? 1 : 0;
      const double expected = 0.01 * normal.z() * 600.0 * 598.2;
      EXPECT_NEAR(dark, expected, 0.06 * expected) << angle;
    }
  }
}

}  // namespace
}  // namespace penumbra::shadow_reuse_test
