// Faces of OBJ files with more than three corners.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "render/model/shadow_mesh.hpp"
#include "support/model_text.hpp"

namespace penumbra {
namespace {

using test::area_of;
using test::area_vector;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class ObjPolygon : public testing::Test {
 protected:
  test::ModelFolder folder_;
};

const std::string kPlus =
    "v 0.03 0 0.05\nv 0.06 0 0.05\nv 0.06 0.03 0.05\nv 0.09 0.03 0.05\nv 0.09 0.06 0.05\n"
    "v 0.06 0.06 0.05\nv 0.06 0.09 0.05\nv 0.03 0.09 0.05\nv 0.03 0.06 0.05\nv 0 0.06 0.05\n"
    "v 0 0.03 0.05\nv 0.03 0.03 0.05\n";

TEST_F(ObjPolygon, KeepsAreaOfConcaveOutline) {
  const Result<Model> model = folder_.obj(kPlus + "f 1 2 3 4 5 6 7 8 9 10 11 12\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->triangle_count(), 10U);
  EXPECT_NEAR(area_of(*model), 45e-4, 45e-10);
  EXPECT_NEAR(area_vector(*model).z(), 45e-4, 45e-10);
  EXPECT_THAT(model->warnings, IsEmpty());
  for (const glm::vec3& normal : model->meshes[0].normals) EXPECT_EQ(normal, glm::vec3(0, 0, 1));
}

TEST_F(ObjPolygon, KeepsOrientationOfPolygon) {
  const Result<Model> model = folder_.obj(kPlus + "f 12 11 10 9 8 7 6 5 4 3 2 1\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_NEAR(area_vector(*model).z(), -45e-4, 45e-10);
}

TEST_F(ObjPolygon, KeepsTextureCoordinatesAndNormalsOfCorners) {
  std::string text = kPlus, face = "f";
  for (int i = 1; i <= 12; ++i) {
    text += fmt::format("vt {} 0.25\nvn 0 {} 1\n", 0.01 * i, 0.1 * i);
    face += fmt::format(" {0}/{0}/{0}", i);
  }
  const Result<Model> model = folder_.obj(text + face + "\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_NEAR(area_of(*model), 45e-4, 45e-10);
  const Mesh& mesh = model->meshes[0];
  ASSERT_EQ(mesh.positions.size(), 12U);
  for (std::size_t i = 0; i < 12; ++i) {
    const auto number = static_cast<float>(mesh.source_vertex[i] + 1);
    EXPECT_NEAR(mesh.texcoords[i].x, 0.01F * number, 1e-6F);
    EXPECT_NEAR(mesh.normals[i].y / mesh.normals[i].z, 0.1F * number, 1e-5F);
  }
}

// A square with a square hole, joined to the outline by a bridge, and a U with repeated corners.
TEST_F(ObjPolygon, KeepsAreaOfPolygonsWithBridgesAndRepeatedCorners) {
  Result<Model> model = folder_.obj(
      "v 0 0 0.05\nv 0.03 0.03 0.05\nv 0.03 0.07 0.05\nv 0.07 0.07 0.05\nv 0.07 0.03 0.05\n"
      "v 0.1 0 0.05\nv 0.1 0.1 0.05\nv 0 0.1 0.05\nf 1 2 3 4 5 2 1 6 7 8\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_NEAR(area_of(*model), 84e-4, 84e-10);
  EXPECT_THAT(model->warnings, IsEmpty());
  model = folder_.obj(
      "v 0 0 0.05\nv 0.1 0 0.05\nv 0.1 0.1 0.05\nv 0.07 0.1 0.05\nv 0.07 0.03 0.05\n"
      "v 0.03 0.03 0.05\nv 0.03 0.1 0.05\nv 0 0.1 0.05\nf 1 2 2 3 4 5 5 6 7 8\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_NEAR(area_of(*model), 72e-4, 72e-10);
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(ObjPolygon, SplitsQuadAlongShorterDiagonal) {
  const Result<Model> model = folder_.obj("v 0 0 0\nv 2 0 0\nv 3 1 0\nv 0 1 0\nf 1 2 3 4\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_THAT(model->meshes[0].source_vertex, ElementsAre(0, 1, 3, 2));
}

TEST_F(ObjPolygon, FillsAndReportsCrossingOutlineOnce) {
  const Result<Model> model = folder_.obj(
      "v 0 0 0 1 0 0\nv 1 1 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nvt 0 0\nvt 1 1\nvt 1 0\n"
      "vt 0 1\nf 1/1 2/2 3/3 4/4\nf 1/1 2/2 3/3 4/4\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_NEAR(area_of(*model), 2 * 0.5, 1e-6);
  EXPECT_THAT(model->warnings,
              ElementsAre(testing::AllOf(HasSubstr("line 9: a face's outline crosses itself"),
                                         HasSubstr("(2 such lines)"))));
  // The crossing of each face adds a vertex after the file's vertices.
  EXPECT_EQ(model->source_vertex_count, 6U);
  const Mesh& mesh = model->meshes[0];
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    EXPECT_EQ(mesh.colors[i], glm::vec4(1, 0, 0, 1));
    EXPECT_NEAR(mesh.texcoords[i].x, mesh.positions[i].x, 1e-6F);
    EXPECT_NEAR(mesh.texcoords[i].y, 1.0F - mesh.positions[i].y, 1e-6F);
    if (mesh.source_vertex[i] < 4) continue;
    EXPECT_NEAR(mesh.positions[i].x, 0.5F, 1e-6F);
    EXPECT_NEAR(mesh.positions[i].y, 0.5F, 1e-6F);
  }
  EXPECT_EQ(make_shadow_mesh(*model).from_source.size(), 6U);
}

TEST_F(ObjPolygon, ReportsFaceThatIsNotFlat) {
  const Result<Model> model = folder_.obj("v 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nf 1 2 3 4\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->triangle_count(), 2U);
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("line 5: a face is not flat")));
}

TEST_F(ObjPolygon, SkipsAndReportsFaceWithTooManyCrossings) {
  std::string text, face = "f";
  for (int i = 0; i < 3000; ++i) {
    text += fmt::format("v {} {} 0\n", (i * 7919) % 3001, (i * 104729) % 2999);
    face += fmt::format(" {}", i + 1);
  }
  const Result<Model> model = folder_.obj(text + face + "\nf 1 2 3\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->triangle_count(), 1U);
  EXPECT_THAT(model->warnings,
              ElementsAre(HasSubstr("line 3001: a face crosses itself too often")));
}

TEST_F(ObjPolygon, AcceptsFaceWithHundredsOfCorners) {
  std::string text, face = "f";
  for (int i = 0; i < 300; ++i) {
    const double angle = 2.0 * M_PI * i / 300;
    text += fmt::format("v {:.6f} {:.6f} 0\n", 0.1 * std::cos(angle), 0.1 * std::sin(angle));
    face += fmt::format(" {}", i + 1);
  }
  const Result<Model> model = folder_.obj(text + face + "\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_EQ(model->triangle_count(), 298U);
  EXPECT_NEAR(area_of(*model), 314.136e-4, 0.003e-4);
}

struct SharedCase {
  std::string file;
  double area_cm2;
  std::size_t faces;
};

TEST(ObjPolygonCases, MatchAreaOfSharedFiles) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared cases beside the checkout";
  const std::filesystem::path folder = test::shared_dir() / "cases";
  for (const auto& [file, area_cm2, faces] : std::vector<SharedCase>{
           {"obj-concave-polygon/plus.obj", 45.0, 10},
           {"obj-concave-polygon/u-clockwise.obj", 63.0, 6},
           {"obj-concave-polygon/comb-clockwise.obj", 171.0, 18},
           {"obj-concave-polygon/concave_polygon-assimp.obj", 2454.97, 64},
           {"obj-keyhole-and-doubled-corners/keyhole-square-ccw-flat.obj", 84.0, 8},
           {"obj-keyhole-and-doubled-corners/u-corner-twice.obj", 72.0, 6},
           {"obj-face-corner-forms/ngon300.obj", 314.136, 298}}) {
    const Result<Model> model = load_model(folder / file);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_EQ(model->triangle_count(), faces) << file;
    EXPECT_NEAR(1e4 * area_of(*model), area_cm2, 1e-5 * area_cm2) << file;
  }
}

// Three tilted polygons. The expected areas, seen from above, follow from the shoelace formula.
TEST(ObjPolygonCases, MatchAreaOfTiltedPolygons) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared cases beside the checkout";
  const std::filesystem::path file =
      test::shared_dir() / "cases" / "obj-concave-polygon" / "issue-319-002-tinyobjloader.obj";
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model) << model.error().message;
  // Two of the 19 corners coincide.
  EXPECT_EQ(model->triangle_count(), 13U);
  constexpr double kArea_cm2 = 30679.211 + 149699.826 + 15457.629;
  EXPECT_NEAR(1e4 * std::abs(test::area_vector(*model).z()), kArea_cm2, 1e-5 * kArea_cm2);
}

}  // namespace
}  // namespace penumbra
