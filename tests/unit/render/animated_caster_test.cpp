// Casting meshes and kernels of models with an animation; the quality and continuity of their
// layers, compared with ray casting.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "support/animated_gltf.hpp"
#include "support/moving_shadow.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

using test::AnimatedModelPtr;
using test::loaded;
using test::MovingShadow;

const AnimatedModelPtr& figure() {
  static const AnimatedModelPtr model = loaded(models::make_figure());
  return model;
}
const AnimatedModelPtr& blob() {
  static const AnimatedModelPtr model = loaded(models::make_blob());
  return model;
}

const AnimatedCaster::Kernels kUpright = {KernelDirection::nearest(Eigen::Vector3d::UnitZ()),
                                          KernelSource::automatic};
const AnimatedCaster::Use kUse = {LightMode::proportional, MovingShadow::kUmbraHeight};

ShadowMesh mesh_of(const AnimatedCaster& caster, const AnimatedModelPtr& model, double time_s) {
  return caster.mesh_of(*model->at(time_s).value()).value();
}

// Two squares, the second of which vanishes at 1 s.
AnimatedModelPtr vanishing_square() {
  test::GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  file.node({{"mesh", 0}, {"translation", {0.3, 0, 0}}});
  test::animate(file, 1, "scale", {0, 1}, std::vector<float>{1, 1, 1, 0, 0, 0},
                {.interpolation = "STEP"});
  return loaded(file.glb());
}

// --- mesh ---

TEST(AnimatedCaster, HasMeshOfFirstShapeInEveryShape) {
  const AnimatedCaster caster(figure(), {});
  const ShadowMesh welded = make_shadow_mesh(*figure()->at(0.0).value());
  const ShadowMesh first = mesh_of(caster, figure(), 0.0);
  EXPECT_EQ(first.positions, welded.positions);
  EXPECT_EQ(first.indices, welded.indices);
  EXPECT_EQ(first.part, welded.part);
  for (const double time_s : {0.13, 0.5, 0.77}) {
    const ShadowMesh again = make_shadow_mesh(*figure()->at(time_s).value());
    const ShadowMesh moved = mesh_of(caster, figure(), time_s);
    EXPECT_EQ(moved.positions, again.positions);
    EXPECT_NE(moved.positions, welded.positions);
    EXPECT_EQ(moved.indices, again.indices);
  }
}

TEST(AnimatedCaster, HasNoMeshInShapeWithOtherFaces) {
  const AnimatedModelPtr model = vanishing_square();
  AnimatedCaster caster(model, {});
  EXPECT_TRUE(caster.mesh_of(*model->at(0.5).value()));
  EXPECT_FALSE(caster.mesh_of(*model->at(1.0).value()));
  EXPECT_FALSE(caster.suits(kUpright, kUse));
  EXPECT_EQ(caster.agreement(kUpright, kUse).umbra, 0.0);
}

// Two squares share an edge at time 0 and separate.
TEST(AnimatedCaster, HasNoMeshIfWeldedVerticesSeparate) {
  test::GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  file.node({{"mesh", 0}, {"translation", {0.1, 0, 0}}});
  test::animate(file, 1, "translation", {0, 1}, std::vector<float>{0.1F, 0, 0, 0.15F, 0, 0});
  const AnimatedModelPtr model = loaded(file.glb());
  AnimatedCaster caster(model, {});
  EXPECT_TRUE(caster.mesh_of(*model->at(0.0).value()));
  EXPECT_FALSE(caster.mesh_of(*model->at(0.5).value()));
  EXPECT_FALSE(caster.suits(kUpright, kUse));
}

// --- kernels ---

TEST(AnimatedCaster, HasGeneratedKernelsAtItsKeys) {
  AnimatedCaster caster(figure(), {});
  for (const int key : {0, 3, 10}) {
    const double time_s = kKernelKeyStep_s * key;
    const ShadowMesh mesh = mesh_of(caster, figure(), time_s);
    const ShadowKernels expected =
        generate_kernels(mesh, kUpright.direction.up(), KernelSource::automatic);
    int generated = 0;
    const ShadowKernels kernels = caster.kernels_at(kUpright, time_s, mesh.positions, generated);
    double worst = 0.0;
    for (std::size_t i = 0; i < kernels.kernels.size(); ++i)
      worst =
          std::max(worst, (to_eigen(kernels.kernels[i]) - to_eigen(expected.kernels[i])).norm());
    // A time is not exactly that of a key.
    EXPECT_LT(worst, key == 0 ? 1e-30 : 1e-6) << key;
  }
}

TEST(AnimatedCaster, GeneratesKernelsOncePerKey) {
  AnimatedCaster caster(figure(), {});
  int generated = 0;
  for (const int run : {0, 1}) {
    for (int i = 0; i <= 40; ++i) {
      const double time_s = i / 40.0;
      (void)caster.kernels_at(kUpright, time_s, mesh_of(caster, figure(), time_s).positions,
                              generated);
    }
    EXPECT_EQ(generated, 11) << run;
  }
}

// Kernels move no farther in a short time than the fastest of their vertices, times a factor, plus
// the way between the kernels of two keys.
TEST(AnimatedCaster, MovesKernelsContinuously) {
  for (const AnimatedModelPtr& model : {figure(), blob()}) {
    AnimatedCaster caster(model, {});
    int generated = 0;
    constexpr double kStep_s = 1e-4;
    double worst = 0.0;
    for (int i = 0; i < 120; ++i) {
      const double time_s = 0.05 * model->end_s() * i / 120.0 + 0.07;
      const auto at = [&](double t) {
        return caster.kernels_at(kUpright, t, mesh_of(caster, model, t).positions, generated)
            .kernels;
      };
      const auto a = at(time_s), b = at(time_s + kStep_s);
      for (std::size_t k = 0; k < a.size(); ++k)
        worst = std::max(worst, (to_eigen(a[k]) - to_eigen(b[k])).head<2>().norm());
    }
    // 0.05 m, the size of a part, in a step between keys.
    EXPECT_LT(worst, 0.1 * kStep_s / kKernelKeyStep_s);
  }
}

TEST(AnimatedCaster, AcceptsAnimationOfOneKey) {
  test::GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  test::animate(file, 0, "translation", {0}, std::vector<float>{0, 0.02F, 0});
  const AnimatedModelPtr model = loaded(file.glb());
  AnimatedCaster caster(model, {});
  int generated = 0;
  const ShadowMesh mesh = mesh_of(caster, model, 0.0);
  EXPECT_EQ(caster.kernels_at(kUpright, 0.0, mesh.positions, generated).kernels,
            generate_kernels(mesh, {0, 0, 1}, KernelSource::automatic).kernels);
  EXPECT_TRUE(caster.suits(kUpright, kUse));
}

// --- lights of fields ---

TEST(AnimatedCaster, HasFieldPartsOfItsKeys) {
  AnimatedCaster caster(figure(), {});
  int generated = 0;
  for (const int key : {0, 3, 10, 3}) {
    const double time_s = kKernelKeyStep_s * key;
    const ShadowMesh mesh = mesh_of(caster, figure(), time_s);
    const auto expected = part_discs(mesh, kUpright.direction.up(), kHalfFieldCell, false);
    const auto parts = caster.field_parts_at(kUpright.direction, time_s, mesh, generated);
    ASSERT_TRUE(parts && parts->size() == expected.size());
    for (std::size_t i = 0; i < expected.size(); ++i) {
      EXPECT_NEAR((*parts)[i].radius, expected[i].radius, 1e-7) << key << ' ' << i;
      EXPECT_LT(glm::distance((*parts)[i].centre, expected[i].centre), 1e-6) << key << ' ' << i;
    }
  }
  EXPECT_EQ(generated, 6);  // two for each of three times; the last time has been before
}

// Halfway between keys, between which the limbs of the figure move by up to 2 cm.
TEST(AnimatedCaster, MovesFieldPartsWithTheirVertices) {
  AnimatedCaster caster(figure(), {});
  int generated = 0;
  double moved = 0.0;
  std::vector<PartDisc> last;
  for (double time_s = 0.05; time_s < figure()->end_s(); time_s += kKernelKeyStep_s) {
    const ShadowMesh mesh = mesh_of(caster, figure(), time_s);
    const auto exact = part_discs(mesh, kUpright.direction.up(), kHalfFieldCell, false);
    const auto parts = caster.field_parts_at(kUpright.direction, time_s, mesh, generated).value();
    ASSERT_EQ(parts.size(), exact.size());
    for (std::size_t i = 0; i < exact.size(); ++i) {
      const auto distance = [](const glm::vec3& a, const glm::vec3& b) {
        return std::hypot(static_cast<double>(a.x - b.x), static_cast<double>(a.y - b.y));
      };
      EXPECT_LT(distance(parts[i].centre, exact[i].centre), 0.002) << time_s << ' ' << i;
      EXPECT_NEAR(parts[i].radius / exact[i].radius, 1.0F, 0.08F) << time_s << ' ' << i;
      if (!last.empty()) moved = std::max(moved, distance(parts[i].centre, last[i].centre));
    }
    last = parts;
  }
  EXPECT_GT(moved, 0.015);
}

TEST(AnimatedCaster, HasNoFieldPartsBesideShapeWithOtherFaces) {
  const AnimatedModelPtr model = vanishing_square();
  AnimatedCaster caster(model, {});
  int generated = 0;
  const auto parts_at = [&](double time_s) {
    return caster.field_parts_at(kUpright.direction, time_s, mesh_of(caster, model, time_s),
                                 generated);
  };
  EXPECT_TRUE(parts_at(0.85));
  EXPECT_FALSE(parts_at(0.95));
}

// Keys of a long animation are as near to each other as those of a short one.
TEST(AnimatedCaster, HasFieldKeysAtMostATenthOfASecondApart) {
  test::GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  test::animate(file, 0, "scale", {0, 50, 50.1F, 100},
                std::vector<float>{1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2});
  const AnimatedModelPtr model = loaded(file.glb());
  AnimatedCaster caster(model, {});
  int generated = 0;
  const auto radius_at = [&](double time_s) {
    return caster
        .field_parts_at(kUpright.direction, time_s, mesh_of(caster, model, time_s), generated)
        .value()
        .front()
        .radius;
  };
  const float small = radius_at(49.9), large = radius_at(50.2);
  EXPECT_NEAR(large / small, 2.0, 0.01);
  EXPECT_NEAR(radius_at(50.05) / small, 1.5, 0.05);
}

// --- which technique draws an object ---

TEST(AnimatedCaster, SuitsObjectsWhoseKernelsAgreeWithField) {
  AnimatedCaster caster(figure(), {});
  EXPECT_TRUE(caster.suits(kUpright, kUse));
  // One kernel for the whole figure is far from its shadow.
  EXPECT_FALSE(caster.suits({kUpright.direction, KernelSource::centroid}, kUse));
}

// --- comparison with ray casting ---

TEST(RayCastLayers, MatchShadowOfLevelDisc) {
  std::vector<CasterVertex> vertices = {{0, 0, 0.1F, 0, 0}};
  std::vector<std::uint32_t> indices;
  constexpr std::uint32_t kCorners = 256;
  for (std::uint32_t i = 0; i < kCorners; ++i) {
    const float turn = 2.0F * std::numbers::pi_v<float> * static_cast<float>(i) / kCorners;
    vertices.push_back({0.1F * std::cos(turn), 0.1F * std::sin(turn), 0.1F, 0, 0});
    indices.insert(indices.end(), {0, i + 1, (i + 1) % kCorners + 1});
  }
  const std::vector<std::uint32_t> part(vertices.size(), 0);
  const std::vector<double> slope = {0.3};
  const test::PlaneLayers layers =
      test::ray_cast_layers(vertices, indices, part, slope, test::PlaneBits({-0.2, -0.2}, 0.4, 200),
                            test::light_points(64, 96));
  const auto area = [](double radius) { return std::numbers::pi * radius * radius; };
  EXPECT_NEAR(layers.umbra.area() / area(0.07), 1.0, 0.01);
  EXPECT_NEAR(layers.middle.area() / area(0.1), 1.0, 0.01);
  EXPECT_NEAR(layers.penumbra.area() / area(0.13), 1.0, 0.01);
}

struct DeformingCase {
  std::string name;
  models::MovingModel (*model)();
  double tilt_rad = 0.0;
  bool is_carried = true;  // drawn with carried kernels, not as a field
};

class DeformingShadow : public testing::TestWithParam<DeformingCase> {
 protected:
  // The long form has more phases and pixels.
  [[nodiscard]] static MovingShadow shadow() {
    const DeformingCase& of = GetParam();
    return {loaded(of.model()), test::nightly() ? 256 : 144, of.tilt_rad};
  }
};

TEST_P(DeformingShadow, AgreesWithRayCasting) {
  const int phases = test::nightly() ? 20 : 3;
  MovingShadow moving = shadow();
  std::array<double, 3> kernels{}, field{};
  for (int i = 0; i < phases; ++i) {
    const double time_s = moving.end_s() * (i + 0.37) / phases;
    const test::PlaneLayers rays = moving.by_rays(time_s);
    const auto add = [&](std::array<double, 3>& sum, const test::PlaneLayers& layers) {
      sum[0] += layers.umbra.iou(rays.umbra) / phases;
      sum[1] += layers.middle.iou(rays.middle) / phases;
      sum[2] += layers.penumbra.iou(rays.penumbra) / phases;
    };
    add(kernels, moving.by_kernels(time_s));
    add(field, moving.by_field(time_s));
  }
  EXPECT_EQ(moving.agreement().is_sufficient(), GetParam().is_carried);
  EXPECT_GT(kernels[1], 0.999);
  if (GetParam().is_carried) {
    EXPECT_GE(kernels[0], 0.93);
    EXPECT_GE(kernels[2], 0.97);
  } else {
    EXPECT_TRUE(kernels[0] < 0.93 || kernels[2] < 0.97) << "is a field without need";
  }
  EXPECT_GE(field[0], 0.95);
  EXPECT_GE(field[1], 0.99);
  EXPECT_GE(field[2], 0.98);
}

TEST_P(DeformingShadow, ChangesAreaBetweenFramesNoMoreThanTwiceAsRaysDo) {
  MovingShadow moving = shadow();
  const int frames = test::nightly() ? static_cast<int>(std::lround(60.0 * moving.end_s())) : 7;
  const test::AreaChanges changes = test::area_changes(moving, frames);
  for (std::size_t layer = 0; layer < 3; ++layer) {
    EXPECT_LE(changes.by_kernels[layer], 2.0 * changes.by_rays[layer]) << layer;
    EXPECT_LE(changes.by_field[layer], 2.0 * changes.by_rays[layer]) << layer;
  }
}

models::MovingModel lobed_blob() {
  return models::make_blob(2.0);
}
models::MovingModel round_blob() {
  return models::make_blob();
}

INSTANTIATE_TEST_SUITE_P(
    Models, DeformingShadow,
    testing::Values(DeformingCase{"Figure", models::make_figure}, DeformingCase{"Blob", round_blob},
                    DeformingCase{"FigureOnItsSide", models::make_figure, 1.5708},
                    DeformingCase{"BlobWithDeepLobes", lobed_blob, 0.0, false}),
    [](const auto& of) { return of.param.name; });

}  // namespace
}  // namespace penumbra
