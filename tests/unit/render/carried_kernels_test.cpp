// Kernels that are carried by the vertices around them.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "render/model/to_eigen.hpp"
#include "render/shadow/kernels/carried_kernels.hpp"
#include "support/shapes.hpp"
#include "tools/models/bundled_models.hpp"

namespace penumbra {
namespace {

using Vectors = std::vector<glm::vec3>;

template <class Map>
Vectors moved(const Vectors& points, const Map& map) {
  Vectors result;
  for (const glm::vec3& p : points) {
    const Eigen::Vector3d q = map(to_eigen(p));
    result.emplace_back(q.x(), q.y(), q.z());
  }
  return result;
}

bool all_finite(const Vectors& points) {
  return std::ranges::all_of(points, [](const glm::vec3& p) {
    return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z);
  });
}

double size_of(const Vectors& points) {
  Eigen::AlignedBox3d box;
  for (const glm::vec3& p : points) box.extend(to_eigen(p));
  return box.isEmpty() ? 0.0 : box.sizes().norm();
}

// Meshes of one part and of many, round and flat.
std::vector<ShadowMesh> meshes() {
  std::vector<ShadowMesh> all;
  for (const Model& model : {models::make_hand(), models::make_l_shape(), models::make_ring(),
                             models::make_helicopter()})
    all.push_back(make_shadow_mesh(model));
  test::ShapeBuilder sheet;
  sheet.quad(sheet.vertex(0, 0, 0.1), sheet.vertex(0.1, 0, 0.1), sheet.vertex(0.1, 0.2, 0.1),
             sheet.vertex(0, 0.2, 0.1));
  all.push_back(make_shadow_mesh(sheet.build()));
  return all;
}

constexpr std::array kSources = {KernelSource::automatic, KernelSource::smooth,
                                 KernelSource::per_axis, KernelSource::centroid};

TEST(CarriedKernels, KeepBytesInTheirShape) {
  for (const ShadowMesh& mesh : meshes()) {
    for (const KernelSource source : kSources) {
      const ShadowKernels kernels = generate_kernels(mesh, {0.3, -0.2, 0.9}, source);
      const ShadowKernels carried = CarriedKernels(mesh, kernels).at(mesh.positions);
      EXPECT_EQ(carried.kernels, kernels.kernels);
      EXPECT_EQ(carried.radius, kernels.radius);
      EXPECT_EQ(carried.up, kernels.up);
    }
  }
}

// An affine map moves kernels as points. Their heights along `up` are irrelevant, so they are
// compared along the image of `up`.
TEST(CarriedKernels, FollowRigidAndAffineMotion) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto vector = [&] {
    return Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
  };
  for (const ShadowMesh& mesh : meshes()) {
    const bool is_flat = mesh.positions.size() == 4;
    for (const KernelSource source : kSources) {
      const Eigen::Vector3d up = is_flat ? Eigen::Vector3d::UnitZ() : vector();
      const ShadowKernels kernels = generate_kernels(mesh, up, source);
      const CarriedKernels carried(mesh, kernels);
      for (int run = 0; run < 3; ++run) {
        Eigen::Matrix3d linear =
            Eigen::AngleAxisd(std::numbers::pi * uniform(random), vector().normalized())
                .toRotationMatrix();
        if (run == 1) linear *= 2.5;
        if (run == 2 && !is_flat) linear += 0.2 * Eigen::Matrix3d{{0, 1, 0}, {0, 0, 1}, {1, 0, 0}};
        const Eigen::Vector3d shift = 0.3 * vector();
        const auto map = [&](const Eigen::Vector3d& p) {
          return Eigen::Vector3d(linear * p + shift);
        };
        const ShadowKernels result = carried.at(moved(mesh.positions, map));
        const Eigen::Vector3d along = (linear * kernels.up).normalized();
        double worst = 0.0;
        for (std::size_t i = 0; i < kernels.kernels.size(); ++i) {
          const Eigen::Vector3d miss =
              to_eigen(result.kernels[i]) - map(to_eigen(kernels.kernels[i]));
          worst = std::max(worst, miss.cross(along).norm());
        }
        EXPECT_LT(worst, 2e-5 * size_of(mesh.positions) * linear.norm())
            << mesh.positions.size() << " vertices, " << to_string(source) << ", run " << run;
      }
    }
  }
}

// A spindle along x: its right half rotates about a hinge in the middle, its left half stays.
TEST(CarriedKernels, FollowTheBoneOfTheirDisc) {
  test::ShapeBuilder shape;
  shape.sphere(0.01, 60, 12);
  ShadowMesh mesh = make_shadow_mesh(shape.build());
  for (glm::vec3& p : mesh.positions) p = {10.0F * p.z, p.y, p.x};
  const ShadowKernels kernels = generate_kernels(mesh, {0, 0, 1}, KernelSource::automatic);
  const Eigen::AngleAxisd turn(0.5, Eigen::Vector3d::UnitZ());
  const auto weight = [](double x) { return std::clamp(0.5 + x / 0.02, 0.0, 1.0); };
  const auto map = [&](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(p + weight(p.x()) * (turn * p - p));
  };
  const ShadowKernels carried = CarriedKernels(mesh, kernels).at(moved(mesh.positions, map));
  int left = 0, right = 0;
  for (std::size_t i = 0; i < kernels.kernels.size(); ++i) {
    const Eigen::Vector3d k = to_eigen(kernels.kernels[i]), now = to_eigen(carried.kernels[i]);
    if (k.x() < -0.03) {
      EXPECT_LT((now - k).head<2>().norm(), 1e-6) << k.transpose();
      ++left;
    } else if (k.x() > 0.03) {
      EXPECT_LT((now - turn * k).head<2>().norm(), 1e-6) << k.transpose();
      ++right;
    } else {
      // Between the halves: inside the bent spindle.
      EXPECT_LT(std::abs(now.y() - weight(k.x()) * (turn * k).y()), 0.005) << k.transpose();
    }
  }
  EXPECT_GT(left, 100);
  EXPECT_GT(right, 100);
}

// A ball that grows by morphing keeps its kernels in its centre.
TEST(CarriedKernels, StayInTheMiddleOfGrowingBody) {
  test::ShapeBuilder shape;
  shape.sphere(0.05, 24, 32, 0.1, 0.2, 0.3);
  const ShadowMesh mesh = make_shadow_mesh(shape.build());
  const CarriedKernels carried(mesh, generate_kernels(mesh, {0, 0, 1}, KernelSource::automatic));
  const Eigen::Vector3d centre(0.1, 0.2, 0.3);
  const ShadowKernels grown = carried.at(moved(mesh.positions, [&](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(centre + 1.7 * (p - centre));
  }));
  for (std::size_t i = 0; i < grown.kernels.size(); ++i) {
    const Eigen::Vector3d first = to_eigen(carried.first().kernels[i]);
    const Eigen::Vector2d expected = (centre + 1.7 * (first - centre)).head<2>();
    EXPECT_LT((to_eigen(grown.kernels[i]).head<2>() - expected).norm(), 1e-6);
    EXPECT_LT((expected - centre.head<2>()).norm(), 0.01);
  }
}

TEST(CarriedKernels, AreFiniteForAnyPositions) {
  std::mt19937 random(6);
  for (const ShadowMesh& mesh : meshes()) {
    for (const KernelSource source : kSources) {
      const CarriedKernels carried(mesh, generate_kernels(mesh, {0, 0, 1}, source));
      for (const float size : {0.0F, 1e-30F, 1.0F, 1e6F, 1e30F, 3e38F}) {
        std::uniform_real_distribution<float> uniform(-1.0F, 1.0F);
        Vectors positions;
        for (std::size_t i = 0; i < mesh.positions.size(); ++i)
          positions.push_back(size * glm::vec3(uniform(random), uniform(random), uniform(random)));
        EXPECT_TRUE(all_finite(carried.at(positions).kernels)) << size;
      }
      // A vertex that is not finite spoils only the kernels that it carries: these become those of
      // their vertices.
      Vectors positions = moved(mesh.positions, [](const Eigen::Vector3d& p) {
        return Eigen::Vector3d(p + Eigen::Vector3d::Constant(0.01));
      });
      positions[1].x = std::numeric_limits<float>::infinity();
      positions[2].y = std::numeric_limits<float>::quiet_NaN();
      const ShadowKernels result = carried.at(positions);
      for (std::size_t i = 3; i < positions.size(); ++i)
        ASSERT_TRUE(std::isfinite(result.kernels[i].x) && std::isfinite(result.kernels[i].y));
    }
  }
}

TEST(CarriedKernels, AcceptDegenerateMeshes) {
  test::ShapeBuilder line;
  line.triangle(line.vertex(0, 0, 0), line.vertex(0.1, 0, 0), line.vertex(0.2, 0, 0));
  const ShadowMesh mesh = make_shadow_mesh(line.build());
  for (const KernelSource source : kSources) {
    const CarriedKernels carried(mesh, generate_kernels(mesh, {0, 0, 1}, source));
    const ShadowKernels result = carried.at(moved(mesh.positions, [](const Eigen::Vector3d& p) {
      return Eigen::Vector3d(p + Eigen::Vector3d(1.0, 2.0, 3.0));
    }));
    for (std::size_t i = 0; i < result.kernels.size(); ++i) {
      EXPECT_NEAR(result.kernels[i].x, carried.first().kernels[i].x + 1.0F, 1e-6F);
      EXPECT_NEAR(result.kernels[i].y, carried.first().kernels[i].y + 2.0F, 1e-6F);
    }
  }
  EXPECT_TRUE(CarriedKernels(ShadowMesh(), {}).at({}).kernels.empty());
}

TEST(BlendedKernels, LieBetweenBothSets) {
  const ShadowKernels a{{0, 0, 1}, {{0, 0, 0}, {1, 2, 3}}, {1.0F, 2.0F}};
  const ShadowKernels b{{0, 0, 1}, {{4, 0, 0}, {1, 2, 7}}, {3.0F, 2.0F}};
  EXPECT_EQ(blended(a, b, 0.0).kernels, a.kernels);
  EXPECT_EQ(blended(a, b, 1.0).kernels, b.kernels);
  const ShadowKernels quarter = blended(a, b, 0.25);
  EXPECT_EQ(quarter.kernels, (Vectors{{1, 0, 0}, {1, 2, 4}}));
  EXPECT_EQ(quarter.radius, (std::vector<float>{1.5F, 2.0F}));
  const ShadowKernels without_discs{{0, 0, 1}, {{4, 0, 0}, {1, 2, 7}}, {}};
  EXPECT_TRUE(blended(a, without_discs, 0.5).radius.empty());
}

}  // namespace
}  // namespace penumbra
