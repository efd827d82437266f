#include "render/model/shadow_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "render/shadow/kernels/shadow_kernels.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

// Gives each triangle separate vertices.
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

TEST(ShadowMesh, WeldsTriangleSoup) {
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

TEST(ShadowMesh, WeldsWithinTenMicrometresAcrossCells) {
  for (float offset = 0.0F; offset < 300e-6F; offset += 3e-6F) {
    Model model;
    Mesh& mesh = model.meshes.emplace_back();
    mesh.positions = {{offset, -offset, offset},
                      {offset + 9e-6F, -offset, offset},
                      {offset, -offset + 12e-6F, offset},
                      {0.2F, 0.0F, 0.0F}};  // about the size of an object on a table
    mesh.indices = {0, 1, 2};
    const ShadowMesh welded = make_shadow_mesh(model);
    EXPECT_EQ(welded.positions.size(), 3U) << offset;
    EXPECT_TRUE(welded.indices.empty()) << "the face has collapsed";
    EXPECT_EQ(welded.part_count, 2U) << "the collapsed face still connects its ends";
    EXPECT_EQ(welded.lost_faces, 1U);
  }
}

// The file's unit must change neither the parts nor, apart from the scale, the kernels.
TEST(ShadowMesh, KeepsPartsAndKernelsInAnyUnit) {
  test::ShapeBuilder shape;
  shape.box(0.01, 0.02, 0.0, 0.08, 0.05, 0.03);
  shape.limb({-0.05, -0.04, 0.01}, {0.03, -0.06, 0.08}, 0.011, 0.006, 9);
  shape.limb({-0.06, 0.05, 0.02}, {-0.02, 0.03, 0.05}, 0.002, 0.004, 7);
  const Model model = soup_of(shape.build());
  const ShadowMesh mesh = make_shadow_mesh(model);
  ASSERT_EQ(mesh.part_count, 3U);
  const Eigen::Vector3d up(0.2, -0.1, 1.0);
  const ShadowKernels kernels = generate_kernels(mesh, up, KernelSource::automatic);
  for (const float scale : {1e-12F, 1e-4F, 1.0F, 1e4F}) {
    Model scaled = model;
    std::mt19937 random(5);
    for (glm::vec3& p : scaled.meshes[0].positions) {
      p *= scale;
      // Each corner of a face is rounded separately, as in files with a triangle soup.
      for (int i = 0; i < 3; ++i) p[i] = std::nextafter(p[i], random() % 2 == 0 ? 1e9F : -1e9F);
    }
    const ShadowMesh scaled_mesh = make_shadow_mesh(scaled);
    EXPECT_EQ(scaled_mesh.indices, mesh.indices) << scale;
    EXPECT_EQ(scaled_mesh.part, mesh.part) << scale;
    EXPECT_EQ(scaled_mesh.lost_faces, 0U) << scale;
    EXPECT_EQ(warning_of_lost_faces(scaled, "tiny.obj"), std::nullopt) << scale;
    ASSERT_EQ(scaled_mesh.positions.size(), mesh.positions.size()) << scale;
    const ShadowKernels scaled_kernels = generate_kernels(scaled_mesh, up, KernelSource::automatic);
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const glm::vec3 difference = scaled_kernels.kernels[i] / scale - kernels.kernels[i];
      EXPECT_LT(std::hypot(difference.x, difference.y, difference.z), 2e-6F) << scale << " " << i;
      EXPECT_NEAR(scaled_kernels.radius[i] / scale, kernels.radius[i], 1e-6F) << scale << " " << i;
    }
  }
}

// The weld distance must follow the precision of most vertices, not of a distant vertex.
TEST(ShadowMesh, KeepsWeldDistanceDespiteFarVertex) {
  Model model = test::box_model(0.1);
  model.meshes[0].positions.emplace_back(1e6F, 0.0F, 0.0F);
  model.meshes[0].source_vertex.push_back(8);
  model.source_vertex_count = 9;
  EXPECT_EQ(weld_distance(model), 10e-6);
  EXPECT_EQ(make_shadow_mesh(model).positions.size(), 9U);
}

TEST(ShadowMesh, WarnsOfPartsWithoutShadow) {
  Model point = test::box_model(0.1);
  for (glm::vec3& p : point.meshes[0].positions) p = {0.1F, 0.2F, 0.3F};
  auto warning = warning_of_lost_faces(point, "point.obj");
  ASSERT_TRUE(warning.has_value());
  EXPECT_THAT(*warning, testing::StartsWith("point.obj: "));
  EXPECT_THAT(*warning, testing::HasSubstr("12 faces"));
  EXPECT_THAT(*warning, testing::HasSubstr("export"));

  test::ShapeBuilder shape;  // one box above the weld distance, and one of 4 um below it
  shape.box(0.0, 0.0, 0.0, 0.1, 0.1, 0.1);
  shape.box(0.2, 0.0, 0.0, 0.200004, 4e-6, 4e-6);
  warning = warning_of_lost_faces(shape.build(), "two.obj");
  ASSERT_TRUE(warning.has_value());
  EXPECT_THAT(*warning, testing::HasSubstr("12 of its 24 faces"));

  // Faces at a sphere's poles have no area; their neighbours cover the gap.
  shape.sphere(0.05, 12, 24);
  EXPECT_EQ(warning_of_lost_faces(shape.build(), "sphere.obj"), std::nullopt);
}

TEST(ShadowMesh, FindsConnectedComponentsOverAllMeshes) {
  test::ShapeBuilder shape;
  shape.box(0, 0, 0, 0.1, 0.1, 0.1);
  shape.box(0.3, 0, 0, 0.4, 0.1, 0.1);
  shape.box(0.1, 0.1, 0.1, 0.2, 0.2, 0.2);  // touches the first box at a corner
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

TEST(ShadowMesh, DropsNonFiniteAndOutOfRangeVertices) {
  Model model = test::box_model(0.1);
  Mesh& mesh = model.meshes[0];
  const std::size_t faces = mesh.indices.size();
  mesh.positions.emplace_back(std::numeric_limits<float>::quiet_NaN(), 0.0F, 0.0F);
  mesh.positions.emplace_back(0.0F, std::numeric_limits<float>::infinity(), 0.0F);
  mesh.positions.emplace_back(3e38F, -3e38F, 0.0F);
  mesh.source_vertex.insert(mesh.source_vertex.end(), {8, 9, 10});
  model.source_vertex_count = 12;  // one vertex of the file is not used by a face
  mesh.indices.insert(mesh.indices.end(), {0, 1, 8, 0, 1, 9, 0, 1, 10, 0, 1, 4000000000U});
  const ShadowMesh shadow = make_shadow_mesh(model);
  EXPECT_EQ(shadow.indices.size(), faces + 3);
  EXPECT_EQ(shadow.from_source[8], kNoShadowPosition);
  EXPECT_EQ(shadow.from_source[9], kNoShadowPosition);
  EXPECT_LT(shadow.from_source[10], shadow.positions.size());
  EXPECT_EQ(shadow.from_source[11], kNoShadowPosition);
}

TEST(ShadowMesh, IsEmptyForEmptyModel) {
  const ShadowMesh mesh = make_shadow_mesh(Model());
  EXPECT_TRUE(mesh.positions.empty());
  EXPECT_EQ(mesh.part_count, 0U);
}

}  // namespace
}  // namespace penumbra
