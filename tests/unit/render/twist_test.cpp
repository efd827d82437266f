// Overshoot of layers: area added by faces whose vertices have different kernels.
#include "render/shadow/kernels/twist.hpp"

#include <gtest/gtest.h>

#include "render/shadow/layers/coverage.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

double overshoot_of(const Model& model, KernelSource source, const Eigen::Vector3d& up) {
  const ShadowMesh mesh = make_shadow_mesh(model);
  return layer_overshoot(mesh, generate_kernels(mesh, up, source), 1.65);
}

TEST(LayerOvershoot, IsSmallForAutomaticAndLargeForSingleKernels) {
  test::ShapeBuilder bar;
  bar.box(-0.1, -0.01, 0.0, 0.1, 0.01, 0.02);
  const Model rod = bar.build();
  for (const Eigen::Vector3d& up :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0.3, 0.2, 1.0), Eigen::Vector3d(0, 0.4, -1.0)}) {
    EXPECT_LT(overshoot_of(test::box_model(0.08), KernelSource::automatic, up), 0.02);
    EXPECT_LT(overshoot_of(rod, KernelSource::automatic, up), 0.02);
    EXPECT_LT(overshoot_of(test::torus_model(12, 64), KernelSource::automatic, up), 0.02);
    EXPECT_GT(overshoot_of(rod, KernelSource::centroid, up), 0.2);
    EXPECT_GT(overshoot_of(test::torus_model(12, 64), KernelSource::centroid, up), 0.4);
  }
}

TEST(LayerOvershoot, IsIndependentOfDistanceFromOrigin) {
  for (const KernelSource source : {KernelSource::automatic, KernelSource::centroid}) {
    for (const bool rod : {true, false}) {
      test::ShapeBuilder shape, far;
      // Multiples of a quarter metre are exact in float at 8 km.
      const double width = rod ? 0.125 : 1.0;
      shape.box(0.0, 0.0, 0.0, 1.0, width, 0.25);
      far.box(8192.0, -4096.0, 0.0, 8193.0, -4096.0 + width, 0.25);
      const Eigen::Vector3d up(0, 0, 1);
      EXPECT_NEAR(overshoot_of(far.build(), source, up), overshoot_of(shape.build(), source, up),
                  0.005)
          << rod << " " << to_string(source);
    }
  }
}

TEST(LayerOvershoot, IsBoundedForDegenerateMeshes) {
  const Eigen::Vector3d up(0, 0, 1);
  EXPECT_EQ(layer_overshoot({}, {}, 1.5), 0.0);
  Model model;
  Mesh& mesh = model.meshes.emplace_back();
  for (const float size : {0.0F, 1e-30F, 3e38F}) {
    mesh.positions = {{0, 0, 0}, {size, 0, 0}, {-size, size, 0}};
    mesh.indices = {0, 1, 2};
    const double overshoot = overshoot_of(model, KernelSource::automatic, up);
    EXPECT_TRUE(overshoot >= 0.0 && overshoot <= 1.0) << size;
  }
}

TEST(Coverage, CountsCellsWithCentreInside) {
  Coverage grid({-1.0F, -1.0F}, 0.1F, 20, 20);
  Coverage other = grid;
  EXPECT_EQ(grid.iou(other), 1.0) << "both empty";
  const std::vector<PlanePoint> half = {{-1, -1}, {1, -1},     {-1, -0.02F},
                                        {1, -1},  {1, -0.02F}, {-1, -0.02F}};
  grid.cover(half);
  EXPECT_EQ(grid.count(), 200U);
  other.cover_square({0.0F, 0.0F}, 0.2F);
  EXPECT_EQ(other.count(), 16U);
  EXPECT_EQ(grid.count_with(other), 8U);
  EXPECT_DOUBLE_EQ(grid.iou(other), 8.0 / 208.0);
  other.cover_square({5.0F, 0.0F}, 0.5F);
  other.cover_square({0.0F, -9.0F}, 0.5F);
  EXPECT_EQ(other.count(), 16U) << "outside";
}

}  // namespace
}  // namespace penumbra
