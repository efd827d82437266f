// Groups join parts that form one body, such as the separate bricks of a wall.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

#include "render/model/part_groups.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "support/paths.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

// A brick wall that lies on its side. Alternate rows are shifted by half a brick, so that corners
// do not meet. Each brick is a node below "wall"; the ball beside it is not.
Model brick_wall() {
  Model model;
  model.nodes.push_back({"wall", "", -1});
  Mesh merged;
  const auto add = [&](test::ShapeBuilder& shape, const std::string& name, int parent) {
    const Mesh part = std::move(shape.build().meshes[0]);
    merged.node_faces.push_back({static_cast<std::uint32_t>(model.nodes.size()),
                                 merged.indices.size(), part.indices.size()});
    model.nodes.push_back({name, "", parent});
    for (const std::uint32_t index : part.indices) {
      merged.indices.push_back(static_cast<std::uint32_t>(merged.positions.size()) + index);
    }
    merged.positions.insert(merged.positions.end(), part.positions.begin(), part.positions.end());
  };
  for (int row = 0; row < 4; ++row) {
    const double y = 0.02 * row;
    double x = 0.0;
    for (int i = 0; x < 0.16 - 1e-9; ++i) {
      const double length = i == 0 && row % 2 == 1 ? 0.02 : std::min(0.04, 0.16 - x);
      test::ShapeBuilder brick;
      // The bricks are slightly uneven, so that no two share a corner.
      const double z = 0.0002 * ((2 * row + i) % 5);
      brick.box(x, y, z, x + length, y + 0.02, z + 0.02);
      add(brick, fmt::format("brick_{}_{}", row, i), 0);
      x += length;
    }
  }
  test::ShapeBuilder ball;
  ball.sphere(0.01, 8, 12, 0.25, 0.0, 0.02);
  add(ball, "ball", -1);
  for (std::uint32_t i = 0; i < merged.positions.size(); ++i) merged.source_vertex.push_back(i);
  model.source_vertex_count = static_cast<std::uint32_t>(merged.positions.size());
  model.meshes.push_back(std::move(merged));
  return model;
}

double ring_area(const std::vector<Eigen::Vector2d>& ring) {
  double twice = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Eigen::Vector2d& a = ring[i];
    const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
    twice += a.x() * b.y() - a.y() * b.x();
  }
  return 0.5 * twice;
}

struct Shape {
  std::size_t pieces = 0;
  double area = 0.0;
  double holes = 0.0;  // fraction of the area
};
// Returns the shape of the wall's umbra at a height where its area is clearly reduced.
Shape wall_umbra(const std::vector<std::string>& groups) {
  const ShadowMesh mesh = make_shadow_mesh(brick_wall(), groups);
  const PlaneFrame plane;
  const ShadowKernels kernels = generate_kernels(mesh, plane.n, KernelSource::automatic);
  const Placement raised{{0.0, 0.0, 0.1}, Eigen::Quaterniond::Identity(), 1.0};
  std::vector<PlanePoint> wall;  // the wall's triangles, without the ball
  const auto triangles =
      layer_triangles(place_caster(mesh, kernels, raised, plane), mesh.indices,
                      make_layered_constants(0.9, 3.0, 0.0).value(), ShadowLayer::umbra);
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    if (triangles[i].u < 0.2F) wall.insert(wall.end(), &triangles[i], &triangles[i] + 3);
  }
  const LayerOutline outline = union_of_triangles(wall).value();
  Shape shape{outline.polygons.size(), outline.area, 0.0};
  for (const LayerPolygon& polygon : outline.polygons) {
    for (const auto& hole : polygon.holes) shape.holes += std::abs(ring_area(hole)) / outline.area;
  }
  return shape;
}

TEST(PartGroups, CloseGapsBetweenGroupedBricks) {
  const Shape ungrouped = wall_umbra({});
  EXPECT_GT(ungrouped.pieces, 10U) << "each brick's umbra shrinks towards its own kernel";
  for (const char* group : {"all", "wall", "brick_*", "brick_?_?"}) {
    const Shape grouped = wall_umbra({group});
    EXPECT_EQ(grouped.pieces, 1U) << group;
    EXPECT_LT(grouped.holes, 1e-3) << group;
    EXPECT_GT(grouped.area, ungrouped.area) << group;
  }
}

TEST(PartGroups, ContainPartsMatchedByName) {
  const Model model = brick_wall();
  const std::uint32_t loose = make_shadow_mesh(model).part_count;
  EXPECT_EQ(loose, 19U);  // 4 + 5 + 4 + 5 bricks and a ball
  const auto parts = [&](const std::vector<std::string>& groups) {
    return make_shadow_mesh(model, groups).part_count;
  };
  EXPECT_EQ(parts({"all"}), 1U);
  EXPECT_EQ(parts({"wall"}), 2U);
  EXPECT_EQ(parts({"brick_0_*"}), loose - 3U);
  EXPECT_EQ(parts({"brick_0_*", "brick_1_*"}), loose - 3U - 4U) << "one group per pattern";
  EXPECT_EQ(parts({"brick_0_*", "brick_?_0"}), loose - 3U - 3U)
      << "both patterns match brick_0_0, so they form one group";
  EXPECT_EQ(parts({"ball"}), loose);
  // Grouping only renumbers parts; indices and positions stay the same.
  const ShadowMesh grouped = make_shadow_mesh(model, std::vector<std::string>{"all"});
  const ShadowMesh ungrouped = make_shadow_mesh(model);
  EXPECT_EQ(grouped.indices, ungrouped.indices);
  EXPECT_EQ(grouped.positions, ungrouped.positions);
}

TEST(PartGroups, ListKnownNamesForUnknownName) {
  const Model model = brick_wall();
  EXPECT_TRUE(check_groups(model, std::vector<std::string>{"all", "wall", "b*"}));
  const auto checked = check_groups(model, std::vector<std::string>{"wall", "tower"});
  ASSERT_FALSE(checked);
  EXPECT_THAT(checked.error().message, HasSubstr("\"tower\""));
  EXPECT_THAT(checked.error().message, HasSubstr("wall, brick_0_0"));
  // Matching time is bounded for any pattern.
  Model named;
  named.nodes.push_back({std::string(5000, 'a'), "", -1});
  std::string pattern;
  for (int i = 0; i < 90; ++i) pattern += "a*";
  EXPECT_FALSE(check_groups(named, std::vector<std::string>{pattern + "b"}));
  EXPECT_TRUE(check_groups(named, std::vector<std::string>{pattern + "a"}));
}

TEST(PartGroups, UseNodeNamesOfFile) {
  const test::TemporaryFolder folder;
  const auto obj = folder.path() / "two.obj";
  std::ofstream(obj) << "o left\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
                        "o right\nv 2 0 0\nv 3 0 0\nv 2 1 0\nf 4 5 6\n";
  const Result<Model> model = load_model(obj);
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_THAT(nodes_of_group(*model, "left"), ElementsAre(true, false));
  EXPECT_EQ(make_shadow_mesh(*model).part_count, 2U);
  EXPECT_EQ(make_shadow_mesh(*model, std::vector<std::string>{"*t"}).part_count, 1U);

  const Result<Model> glb = load_model(test::source_dir() / "scenes/models/helicopter.glb");
  ASSERT_TRUE(glb) << glb.error().message;
  ASSERT_FALSE(glb->nodes.empty());
  std::size_t faces = 0;
  for (const Mesh& mesh : glb->meshes) {
    for (const NodeFaces& run : mesh.node_faces) faces += run.index_count / 3;
  }
  EXPECT_EQ(faces, glb->triangle_count()) << "every face belongs to a node";
}

}  // namespace
}  // namespace penumbra
