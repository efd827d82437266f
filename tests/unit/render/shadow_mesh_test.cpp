#include "render/shadow/shadow_mesh.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "support/shapes.hpp"

namespace penumbra {
namespace {

// Each triangle with three vertices of its own.
Model soup_of(const Model& model) {
  Model soup;
  Mesh& mesh = soup.meshes.emplace_back();
  for (const std::uint32_t index : model.meshes[0].indices) {
    mesh.positions.push_back(model.meshes[0].positions[index]);
    mesh.indices.push_back(static_cast<std::uint32_t>(mesh.indices.size()));
    mesh.source_vertex.push_back(index);
  }
  soup.source_vertex_count = model.source_vertex_count;
  return soup;
}

TEST(ShadowMesh, WeldsASoupBackTogether) {
  const Model model = test::torus_model(12, 32);
  const ShadowMesh mesh = make_shadow_mesh(soup_of(model));
  EXPECT_EQ(mesh.positions.size(), model.meshes[0].positions.size());
  EXPECT_EQ(mesh.indices.size(), model.meshes[0].indices.size());
  EXPECT_EQ(mesh.part_count, 1U);
  for (std::size_t source = 0; source < model.source_vertex_count; ++source) {
    ASSERT_LT(mesh.from_source[source], mesh.positions.size());
    EXPECT_EQ(mesh.positions[mesh.from_source[source]], model.meshes[0].positions[source]);
  }
}

TEST(ShadowMesh, WeldDistanceIsTenMicrometresAcrossEveryCellWall) {
  for (float at = 0.0F; at < 300e-6F; at += 3e-6F) {
    Model model;
    Mesh& mesh = model.meshes.emplace_back();
    mesh.positions = {{at, -at, at}, {at + 9e-6F, -at, at}, {at, -at + 12e-6F, at}};
    mesh.indices = {0, 1, 2};
    const ShadowMesh welded = make_shadow_mesh(model);
    EXPECT_EQ(welded.positions.size(), 2U) << at;
    EXPECT_TRUE(welded.indices.empty()) << "the face has collapsed";
    EXPECT_EQ(welded.part_count, 1U) << "but still holds its ends together";
  }
}

TEST(ShadowMesh, PartsAreConnectedComponentsOverAllMeshes) {
  test::ShapeBuilder shape;
  shape.box(0, 0, 0, 0.1, 0.1, 0.1);
  shape.box(0.3, 0, 0, 0.4, 0.1, 0.1);
  shape.box(0.1, 0.1, 0.1, 0.2, 0.2, 0.2);  // touches the first at a corner
  Model model = shape.build();
  model.meshes.push_back(test::box_model(0.05).meshes[0]);
  model.meshes[1].source_vertex.clear();
  const ShadowMesh mesh = make_shadow_mesh(model);
  EXPECT_EQ(mesh.part_count, 3U);
  EXPECT_EQ(mesh.positions.size(), 8U + 8U + 7U + 8U);
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    EXPECT_EQ(mesh.part[mesh.indices[i]], mesh.part[mesh.indices[i + 1]]);
    EXPECT_EQ(mesh.part[mesh.indices[i]], mesh.part[mesh.indices[i + 2]]);
  }
}

TEST(ShadowMesh, LeavesOutWhatIsNotFiniteOrOutOfRange) {
  Model model = test::box_model(0.1);
  Mesh& mesh = model.meshes[0];
  const std::size_t faces = mesh.indices.size();
  mesh.positions.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F);
  mesh.positions.emplace_back(0.0F, std::numeric_limits<float>::infinity(), 0.0F);
  mesh.positions.emplace_back(3e38F, -3e38F, 0.0F);
  mesh.source_vertex.insert(mesh.source_vertex.end(), {8, 9, 10});
  model.source_vertex_count = 12;  // one vertex of the file is used by no mesh
  mesh.indices.insert(mesh.indices.end(), {0, 1, 8, 0, 1, 9, 0, 1, 10, 0, 1, 4000000000U});
  const ShadowMesh shadow = make_shadow_mesh(model);
  EXPECT_EQ(shadow.indices.size(), faces + 3);
  EXPECT_EQ(shadow.from_source[8], kNoShadowPosition);
  EXPECT_EQ(shadow.from_source[9], kNoShadowPosition);
  EXPECT_LT(shadow.from_source[10], shadow.positions.size());
  EXPECT_EQ(shadow.from_source[11], kNoShadowPosition);
}

TEST(ShadowMesh, OfNothingIsNothing) {
  const ShadowMesh mesh = make_shadow_mesh(Model());
  EXPECT_TRUE(mesh.positions.empty());
  EXPECT_EQ(mesh.part_count, 0U);
}

}  // namespace
}  // namespace penumbra
