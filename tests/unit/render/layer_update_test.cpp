#include "render/shadow/layers/layer_update.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "support/shapes.hpp"

namespace penumbra {
namespace {

void expect_same_as_vertex_by_vertex(const LayeredConstants& constants, const PlaneFrame& plane,
                                     const Placement& placement, double tolerance) {
  const ShadowMesh mesh = make_shadow_mesh(test::bush_model(50));
  const ShadowKernels kernels =
      generate_kernels(mesh, up_in_object(placement, plane), KernelSource::automatic);
  const auto vertices = place_caster(mesh, kernels, placement, plane);
  LayerArrays layers;
  update_layers(CasterArrays::make(mesh, kernels), placement, plane, constants, layers);
  ASSERT_EQ(layers.h.size(), vertices.size());
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    EXPECT_NEAR(layers.h[i], vertices[i].h, tolerance);
    for (std::size_t layer = 0; layer < 3; ++layer) {
      const PlanePoint point = project_to_layer(vertices[i], constants, kShadowLayers[layer]);
      ASSERT_NEAR(layers.u[layer][i], point.u, tolerance) << "layer " << layer << " vertex " << i;
      ASSERT_NEAR(layers.v[layer][i], point.v, tolerance) << "layer " << layer << " vertex " << i;
    }
  }
}

TEST(LayerUpdate, SameAsVertexByVertex) {
  const Placement placement = {
      Eigen::Vector3d(0.1, -0.2, 0.05),
      Eigen::Quaterniond(Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, 3).normalized())), 0.8};
  const PlaneFrame plane =
      PlaneFrame::make(Eigen::Vector3d(0.1, 0.2, 1.0), Eigen::Vector3d(0.0, 0.1, -0.02));
  expect_same_as_vertex_by_vertex(make_layered_constants(0.9, 3.0, 0.0).value(), plane, placement,
                                  3e-7);
  expect_same_as_vertex_by_vertex(make_layered_constants(0.6, 0.8, 0.0).value(), plane, placement,
                                  3e-7);
  expect_same_as_vertex_by_vertex(
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, 0.2).value(), plane,
      placement, 3e-7);
}

TEST(LayerUpdate, APlaneAHundredMetresAwayCostsNoDigits) {
  const Eigen::Vector3d far(60.0, -50.0, 62.0);
  const PlaneFrame plane = PlaneFrame::make(Eigen::Vector3d(0.2, 0.1, 1.0), far);
  const Placement placement = {far + Eigen::Vector3d(0.02, 0.03, 0.04),
                               Eigen::Quaterniond::Identity(), 1.0};
  const PlaneFrame near = PlaneFrame::make(Eigen::Vector3d(0.2, 0.1, 1.0), Eigen::Vector3d::Zero());
  const Placement near_placement = {Eigen::Vector3d(0.02, 0.03, 0.04),
                                    Eigen::Quaterniond::Identity(), 1.0};
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowMesh mesh = make_shadow_mesh(test::bush_model(20));
  const auto kernels =
      generate_kernels(mesh, up_in_object(placement, plane), KernelSource::automatic);
  const CasterArrays caster = CasterArrays::make(mesh, kernels);
  LayerArrays at_far;
  LayerArrays at_near;
  update_layers(caster, placement, plane, constants, at_far);
  update_layers(caster, near_placement, near, constants, at_near);
  for (std::size_t i = 0; i < at_far.h.size(); ++i) {
    EXPECT_NEAR(at_far.h[i], at_near.h[i], 1e-7);
    for (std::size_t layer = 0; layer < 3; ++layer)
      EXPECT_NEAR(at_far.u[layer][i], at_near.u[layer][i], 1e-7);
  }
}

}  // namespace
}  // namespace penumbra
