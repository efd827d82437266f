#include "render/shadow/kernels/shadow_kernels.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "render/shadow/kernels/footprint.hpp"
#include "support/kernel_distances.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

Eigen::Vector3d to_eigen(const glm::vec3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

Model moved(Model model, const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
  for (glm::vec3& p : model.meshes[0].positions) {
    const Eigen::Vector3d q = R * to_eigen(p) + t;
    p = {static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(q.z())};
  }
  return model;
}

Model l_shape() {
  test::ShapeBuilder shape;
  shape.prism({{0.0, 0.0}, {0.1, 0.0}, {0.1, 0.03}, {0.03, 0.03}, {0.03, 0.1}, {0.0, 0.1}}, 0.0,
              0.01);
  return shape.build();
}

TEST(ShadowKernels, CollapseToCentreOfCube) {
  const ShadowMesh mesh = make_shadow_mesh(test::box_model(0.08));
  for (const KernelSource source : {KernelSource::automatic, KernelSource::smooth,
                                    KernelSource::per_axis, KernelSource::centroid}) {
    const ShadowKernels kernels = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), source);
    for (const glm::vec3& k : kernels.kernels) {
      EXPECT_LT(std::hypot(k.x, k.y), 0.0013) << to_string(source) << ": half a cell";
    }
  }
}

TEST(ShadowKernels, FormCircleForLevelTorus) {
  const ShadowMesh mesh = make_shadow_mesh(test::torus_model(12, 64));
  const ShadowKernels kernels =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Vector2d x = to_eigen(mesh.positions[i]).head<2>();
    const Eigen::Vector2d k = to_eigen(kernels.kernels[i]).head<2>();
    EXPECT_NEAR(k.norm(), 0.05, 0.0015);
    EXPECT_NEAR(kernels.radius[i], 0.012, 0.0012);
    EXPECT_GT(k.normalized().dot(x.normalized()), 0.98)
        << "kernel and vertex on different sides of the ring";
  }
}

TEST(ShadowKernels, FormRingForUprightTubeAndLineForLyingTube) {
  test::ShapeBuilder shape;  // a pipe with two radii and open ends
  shape.limb({0, 0, 0}, {0, 0, 0.1}, 0.03, 0.03, 48);
  shape.limb({0, 0, 0}, {0, 0, 0.1}, 0.02, 0.02, 48);
  Model model = shape.build();
  // Annuli close both ends between the inner and outer surface.
  Mesh& mesh = model.meshes[0];
  for (std::uint32_t i = 0; i < 48; ++i) {
    const std::uint32_t j = (i + 1) % 48;
    for (const std::uint32_t end : {0U, 48U}) {
      const std::uint32_t outer = end;
      const std::uint32_t inner = 96 + end;
      mesh.indices.insert(mesh.indices.end(),
                          {outer + i, outer + j, inner + j, outer + i, inner + j, inner + i});
    }
  }
  const ShadowMesh tube = make_shadow_mesh(model);
  ASSERT_EQ(tube.part_count, 1U);
  const ShadowKernels upright =
      generate_kernels(tube, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  for (const glm::vec3& k : upright.kernels) EXPECT_NEAR(std::hypot(k.x, k.y), 0.025, 0.001);
  const ShadowKernels lying =
      generate_kernels(tube, Eigen::Vector3d::UnitX(), KernelSource::automatic);
  for (std::size_t i = 0; i < tube.positions.size(); ++i) {
    EXPECT_NEAR(lying.kernels[i].y, 0.0F, 0.0015F);
    EXPECT_NEAR(lying.radius[i], 0.03F, 0.002F);
  }
}

TEST(ShadowKernels, StayInArmsOfLShape) {
  const ShadowMesh mesh = make_shadow_mesh(l_shape());
  const ShadowKernels kernels =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Vector2d k = to_eigen(kernels.kernels[i]).head<2>();
    // The kernel is near the centre line of an arm, never in the empty quarter of the L.
    const bool in_lower_arm = std::abs(k.y() - 0.015) < 0.004;
    const bool in_left_arm = std::abs(k.x() - 0.015) < 0.004;
    EXPECT_TRUE(in_lower_arm || in_left_arm) << k.transpose();
    EXPECT_LT(k.minCoeff(), 0.02);
  }
}

TEST(ShadowKernels, FollowMeshUnderTranslationAndYaw) {
  const Model model = l_shape();
  const Eigen::Vector3d up = Eigen::Vector3d(0.3, -0.2, 1.0).normalized();
  const Eigen::Matrix3d R = Eigen::AngleAxisd(0.7, up).toRotationMatrix();
  const Eigen::Vector3d t(0.31, -0.17, 0.4);
  const ShadowMesh mesh = make_shadow_mesh(model);
  const ShadowMesh rotated = make_shadow_mesh(moved(model, R, t));
  for (const KernelSource source :
       {KernelSource::automatic, KernelSource::smooth, KernelSource::centroid}) {
    const ShadowKernels before = generate_kernels(mesh, up, source);
    const ShadowKernels after = generate_kernels(rotated, up, source);
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const Eigen::Vector3d expected = R * to_eigen(before.kernels[i]) + t;
      Eigen::Vector3d difference = to_eigen(after.kernels[i]) - expected;
      difference -= difference.dot(up) * up;
      EXPECT_LT(difference.norm(), 1e-4) << to_string(source);
    }
  }
}

TEST(ShadowKernels, AreEqualSeenFromBelow) {
  const ShadowMesh mesh = make_shadow_mesh(l_shape());
  const Eigen::Vector3d up(0.3, -0.2, 0.4);
  for (const KernelSource source : {KernelSource::automatic, KernelSource::smooth,
                                    KernelSource::per_axis, KernelSource::centroid}) {
    EXPECT_EQ(generate_kernels(mesh, up, source).kernels,
              generate_kernels(mesh, -up, source).kernels);
  }
}

TEST(ShadowKernels, AreDeterministic) {
  const ShadowMesh mesh = make_shadow_mesh(test::bush_model(40));
  const Eigen::Vector3d up(0.1, 0.2, 1.0);
  EXPECT_EQ(generate_kernels(mesh, up, KernelSource::automatic).kernels,
            generate_kernels(mesh, up, KernelSource::automatic).kernels);
}

TEST(ShadowKernels, IgnoreSplitVerticesAndFlippedFaces) {
  const Model model = test::torus_model(12, 48);
  Model soup;
  Mesh& mesh = soup.meshes.emplace_back();
  const Mesh& source = model.meshes[0];
  for (std::size_t i = 0; i < source.indices.size(); i += 3) {
    const bool flip = (i / 3) % 2 == 1;
    for (const std::size_t corner :
         {std::size_t{0}, std::size_t{flip ? 2U : 1U}, std::size_t{flip ? 1U : 2U}}) {
      const std::uint32_t vertex = source.indices[i + corner];
      mesh.positions.push_back(source.positions[vertex]);
      mesh.source_vertex.push_back(vertex);
      mesh.indices.push_back(static_cast<std::uint32_t>(mesh.indices.size()));
    }
  }
  soup.source_vertex_count = model.source_vertex_count;
  const ShadowMesh original = make_shadow_mesh(model);
  const ShadowMesh welded = make_shadow_mesh(soup);
  const auto expected =
      generate_kernels(original, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto actual = generate_kernels(welded, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  for (std::size_t v = 0; v < model.source_vertex_count; ++v) {
    const Eigen::Vector3d difference = to_eigen(expected.kernels[original.from_source[v]]) -
                                       to_eigen(actual.kernels[welded.from_source[v]]);
    EXPECT_LT(difference.norm(), 5e-4) << v;
  }
}

TEST(ShadowKernels, FillMissingFaces) {
  Model model = test::torus_model(40, 120);
  const ShadowMesh whole = make_shadow_mesh(model);
  std::vector<std::uint32_t> remaining;
  std::mt19937 random(5);
  const auto& indices = model.meshes[0].indices;
  for (std::size_t i = 0; i < indices.size(); i += 3) {
    if (random() % 10 == 0) continue;
    remaining.insert(remaining.end(), {indices[i], indices[i + 1], indices[i + 2]});
  }
  ShadowMesh torn = whole;
  torn.indices = remaining;
  const auto expected = generate_kernels(whole, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto actual = generate_kernels(torn, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  std::size_t deviating = 0;
  for (std::size_t i = 0; i < whole.positions.size(); ++i) {
    const Eigen::Vector3d d = to_eigen(expected.kernels[i]) - to_eigen(actual.kernels[i]);
    if (d.head<2>().norm() > 0.003) ++deviating;
  }
  EXPECT_LT(deviating, whole.positions.size() / 50);
}

// Checks |x - k| <= 1.5 r plus one cell, where r is the radius of the largest disc about k inside
// the silhouette, measured on polygons. The radius stored with a kernel must equal r.
TEST(ShadowKernels, StayWithinDistanceBoundOfTheirDisc) {
  for (const Model& model : {l_shape(), test::torus_model(12, 64), test::box_model(0.1)}) {
    const ShadowMesh mesh = make_shadow_mesh(model);
    for (const Eigen::Vector3d& up : {Eigen::Vector3d(0.2, 0.5, 1.0), Eigen::Vector3d(0, 0, 1),
                                      Eigen::Vector3d(1.0, 0.3, 0.1)}) {
      const ShadowKernels kernels = generate_kernels(mesh, up, KernelSource::automatic);
      const auto distances = test::kernel_distances(mesh, kernels);
      ASSERT_EQ(kernels.radius.size(), mesh.positions.size());
      for (std::size_t i = 0; i < distances.size(); ++i) {
        ASSERT_GT(distances[i].cell, 0.0);
        EXPECT_GT(distances[i].inside, 0.0) << "a kernel outside its silhouette";
        EXPECT_LE(distances[i].distance, test::max_allowed_distance(distances[i]));
        EXPECT_NEAR(static_cast<double>(kernels.radius[i]), distances[i].inside, distances[i].cell);
      }
      // A mean of such kernels may lie outside the silhouette, but no farther than the largest
      // disc's radius.
      const ShadowKernels smooth = generate_kernels(mesh, up, KernelSource::smooth);
      double farthest = 0.0;
      for (const test::KernelDistance& kernel : distances)
        farthest = std::max(farthest, test::max_allowed_distance(kernel));
      for (const test::KernelDistance& kernel : test::kernel_distances(mesh, smooth))
        EXPECT_LE(kernel.distance, farthest);
    }
  }
}

// Shows that the check of StayWithinDistanceBoundOfTheirDisc fails for kernels that are too far
// away.
TEST(ShadowKernels, ExceedDistanceBoundForCentroidOfBar) {
  test::ShapeBuilder shape;
  shape.box(-0.1, -0.01, -0.01, 0.1, 0.01, 0.01);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  for (const test::KernelDistance& kernel : test::kernel_distances(
           mesh, generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::centroid))) {
    EXPECT_NEAR(kernel.inside, 0.01, 0.001);
    EXPECT_GT(kernel.distance, 2.0 * test::max_allowed_distance(kernel));
  }
}

TEST(ShadowKernels, StayFiniteForDegenerateMeshes) {
  const auto all_finite = [](const Model& model, const char* what) {
    const ShadowMesh mesh = make_shadow_mesh(model);
    for (const KernelSource source : {KernelSource::automatic, KernelSource::smooth,
                                      KernelSource::per_axis, KernelSource::centroid}) {
      for (const Eigen::Vector3d& up :
           {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0.2, 0.3, 0.9)}) {
        const ShadowKernels kernels = generate_kernels(mesh, up, source);
        ASSERT_EQ(kernels.kernels.size(), mesh.positions.size()) << what;
        for (const glm::vec3& k : kernels.kernels)
          EXPECT_TRUE(to_eigen(k).allFinite()) << what << " " << to_string(source);
      }
    }
  };
  Model model;
  all_finite(model, "nothing");
  Mesh& mesh = model.meshes.emplace_back();
  mesh.positions = {{0.1F, 0.2F, 0.3F}};
  all_finite(model, "one vertex");
  mesh.indices = {0, 0, 0};
  all_finite(model, "one vertex three times");
  mesh.positions = {{0, 0, 0}, {0.1F, 0, 0}, {0.2F, 0, 0}};
  mesh.indices = {0, 1, 2};
  all_finite(model, "a line");
  mesh.positions = {{0, 0, 0}, {0, 0, 0.1F}, {0, 0, 0.2F}, {0, 1e-9F, 0.1F}};
  mesh.indices = {0, 1, 2, 0, 2, 3};
  all_finite(model, "a line along up");
  mesh.positions = {{0, 0, 0}, {1e4F, 0, 0}, {0, 1e-4F, 0}};
  mesh.indices = {0, 1, 2};
  all_finite(model, "a sliver of 1e4 by 1e-4 m");
  mesh.positions = {{1e4F, 1e4F, 0}, {1.0001e4F, 1e4F, 0}, {1e4F, 1.0001e4F, 0}};
  all_finite(model, "far away");
  mesh.positions = {{3e38F, 0, 0}, {-3e38F, 1, 0}, {0, 3e38F, 0}};
  all_finite(model, "as large as floats go");
  mesh.positions = {{1e-30F, 0, 0}, {0, 1e-30F, 0}, {0.1F, 0.1F, 0}};
  all_finite(model, "denormal differences");
}

TEST(ShadowKernels, EqualPositionOfVertexWithoutFace) {
  Model model = test::box_model(0.1);
  model.meshes[0].positions.emplace_back(1.0F, 2.0F, 3.0F);
  model.meshes[0].source_vertex.push_back(8);
  const ShadowMesh mesh = make_shadow_mesh(model);
  const auto kernels = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  EXPECT_EQ(kernels.kernels.back(), mesh.positions.back());
}

TEST(ShadowKernels, AreSeparateForEachPart) {
  test::ShapeBuilder shape;
  shape.box(-0.2, -0.02, 0, -0.16, 0.02, 0.04);
  shape.box(0.16, -0.02, 0, 0.2, 0.02, 0.04);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  const auto by_part = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto shared = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::centroid);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    EXPECT_NEAR(by_part.kernels[i].x, mesh.positions[i].x < 0 ? -0.18F : 0.18F, 0.001F);
    EXPECT_NEAR(shared.kernels[i].x, 0.0F, 0.005F);
  }
}

TEST(ShadowKernels, ReportProgress) {
  const ShadowMesh mesh = make_shadow_mesh(test::bush_model(40));
  for (const KernelSource source : {KernelSource::automatic, KernelSource::smooth,
                                    KernelSource::per_axis, KernelSource::centroid}) {
    KernelProgress progress;
    const ShadowKernels with = generate_kernels(mesh, {0.3, 0.2, 1.0}, source, &progress);
    const std::size_t sets = source == KernelSource::per_axis ? 3 : 1;
    EXPECT_EQ(progress.total, sets * mesh.positions.size()) << to_string(source);
    EXPECT_EQ(progress.done, progress.total) << to_string(source);
    EXPECT_EQ(with.kernels, generate_kernels(mesh, {0.3, 0.2, 1.0}, source).kernels);
  }
}

TEST(ShadowKernels, AreExactOnAxesAndInterpolatedBetweenThem) {
  const ShadowMesh mesh = make_shadow_mesh(l_shape());
  const auto direct = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const auto composed = generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::per_axis);
  EXPECT_EQ(direct.kernels, composed.kernels);
  const auto along_x = generate_kernels(mesh, Eigen::Vector3d::UnitX(), KernelSource::automatic);
  const Eigen::Vector3d d = Eigen::Vector3d(0.6, 0.0, 0.8);
  const auto mixed = generate_kernels(mesh, d, KernelSource::per_axis);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Eigen::Vector3d expected =
        0.36 * to_eigen(along_x.kernels[i]) + 0.64 * to_eigen(direct.kernels[i]);
    EXPECT_LT((to_eigen(mixed.kernels[i]) - expected).norm(), 1e-7);
  }
}

// Compares the depths of random rasters, which have holes and bays, with an exhaustive search over
// all uncovered cells.
TEST(Footprint, MeasuresDistanceToNearestOutsideCell) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  FootprintRaster raster;
  for (int round = 0; round < 60; ++round) {
    const float height = std::exp2(-6.0F * unit(random));
    std::vector<Eigen::Vector2f> points;
    std::vector<std::uint32_t> faces;
    const int triangles = 1 + round % 7;
    for (int i = 0; i < 3 * triangles; ++i) {
      faces.push_back(static_cast<std::uint32_t>(points.size()));
      points.emplace_back(unit(random), height * unit(random));
    }
    ASSERT_TRUE(raster.cover(points, faces, 4 << round % 12));
    raster.compute_depth();
    struct Cell {
      int column, row;
    };
    std::vector<Cell> outside;
    for (int row = 0; row < raster.height(); ++row) {
      for (int column = 0; column < raster.width(); ++column) {
        if (raster.covered_row(row)[column] == 0.0F) outside.push_back({column, row});
      }
    }
    for (int row = 0; row < raster.height(); ++row) {
      for (int column = 0; column < raster.width(); ++column) {
        int nearest = std::numeric_limits<int>::max();
        for (const Cell& cell : outside) {
          const int dx = cell.column - column;
          const int dy = cell.row - row;
          nearest = std::min(nearest, dx * dx + dy * dy);
        }
        ASSERT_EQ(raster.depth_row(row)[column], std::sqrt(static_cast<float>(nearest)))
            << "round " << round << ", cell " << column << ", " << row << " of " << raster.width()
            << " x " << raster.height();
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
