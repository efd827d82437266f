#include "tracking/alignment/simd/alignment_loops.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "support/cameras.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

using simd::AccumulateInput;
using simd::Loops;
using simd::Samples;
using simd::Sums;

std::vector<const Loops*> variants() {
  std::vector<const Loops*> list;
  for (const Loops* const* v = simd::available_loops(); *v != nullptr; ++v) list.push_back(*v);
  return list;
}

// Pose of a lattice of 11 x 11 vertices with cells of 10 mm, seen obliquely from half a metre.
Eigen::Isometry3d lattice_pose() {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();  // T_camera_lattice [cells]
  T.linear() = (Eigen::AngleAxisd(2.5, Eigen::Vector3d::UnitX()) *
                Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitY()) *
                Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()))
                   .toRotationMatrix();
  T.translation() = Eigen::Vector3d(-4.0, 3.5, 50.0);
  return T;
}

void set_pose(const Eigen::Isometry3d& T, AccumulateInput& in) {
  Eigen::Matrix3d ray_from_lattice;
  ray_from_lattice << T.linear().col(0), T.linear().col(1), T.translation();
  const Eigen::Matrix3d M = ray_from_lattice.inverse();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) in.lattice_from_ray[3 * r + c] = static_cast<float>(M(r, c));
  }
  const Eigen::Vector3d centre = T.inverse().translation();
  for (int k = 0; k < 3; ++k) in.centre[k] = static_cast<float>(centre[k]);
}

// Samples whose arrays are allocated and filled with zeros.
struct SampleSet {
  std::vector<std::vector<float>> arrays;
  std::vector<std::int32_t> vertex;
  Samples s;

  explicit SampleSet(int count) {
    s.count = count;
    vertex.resize(static_cast<std::size_t>(count));
    s.vertex = vertex.data();
    arrays.reserve(40);
    const auto take = [&] {
      arrays.emplace_back(static_cast<std::size_t>(count), 0.0F);
      return arrays.back().data();
    };
    for (float** array : {&s.pixel_x, &s.pixel_y, &s.ray_x, &s.ray_y, &s.value, &s.weight, &s.va,
                          &s.vb, &s.ka, &s.kb, &s.rho, &s.model, &s.residual})
      *array = take();
    for (float*& array : s.c) array = take();
  }
};

// Returns samples at random points of the lattice, with random pattern coefficients.
SampleSet random_samples(int count, const Eigen::Isometry3d& T, float correlation) {
  SampleSet set(count);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> u(0.0F, 1.0F);
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d p(1.0 + 8.0 * static_cast<double>(u(random)),
                            1.0 + 8.0 * static_cast<double>(u(random)), 0.0);
    const Eigen::Vector3d q = T * p;
    Samples& s = set.s;
    s.ray_x[i] = static_cast<float>(q.x() / q.z());
    s.ray_y[i] = static_cast<float>(q.y() / q.z());
    s.va[i] = std::round(static_cast<float>(p.x()));
    s.vb[i] = std::round(static_cast<float>(p.y()));
    s.ka[i] = 3.0F + 2.0F * u(random);
    s.kb[i] = 3.0F + 2.0F * u(random);
    s.rho[i] = correlation * u(random);
    s.weight[i] = 1.0F;
    s.value[i] = 40.0F + 150.0F * u(random);
    for (float*& c : s.c) c[i] = std::floor(3.0F * u(random)) - 1.0F;
  }
  return set;
}

TEST(SimdLoops, JacobiansMatchCentralDifferences) {
  const Eigen::Isometry3d T = lattice_pose();
  for (const int reach : {1, 2, 3}) {
    for (const bool correlated : {false, true}) {
      SampleSet set = random_samples(simd::kBlock, T, correlated ? 0.8F : 0.0F);
      AccumulateInput in;
      set_pose(T, in);
      in.gain = 120.0F;
      in.offset = 30.0F;
      in.reach = reach;
      in.correlated = correlated;
      const Loops& variant = simd::widest_loops();
      // Numeric derivative of each sample's model value by each component of the motion.
      std::array<std::vector<double>, 6> numeric;
      for (int k = 0; k < 6; ++k) {
        const double step = k < 3 ? 4e-3 : 4e-4;
        Vector6d xi = Vector6d::Zero();
        xi[k] = step;
        AccumulateInput moved = in;
        set_pose(T * exp_se3(xi), moved);
        variant.evaluate(&moved, &set.s, 1);
        std::vector<float> plus(set.s.model, set.s.model + set.s.count);
        set_pose(T * exp_se3(-xi), moved);
        variant.evaluate(&moved, &set.s, 1);
        for (int i = 0; i < set.s.count; ++i) {
          numeric[static_cast<std::size_t>(k)].push_back(
              120.0 *
              (static_cast<double>(plus[static_cast<std::size_t>(i)]) -
               static_cast<double>(set.s.model[i])) /
              (2.0 * step));
        }
      }
      variant.evaluate(&in, &set.s, 1);
      for (int i = 0; i < set.s.count; ++i) {
        // If only one sample has a weight, the gradient is its Jacobian times its residual.
        for (int j = 0; j < set.s.count; ++j) set.s.weight[j] = i == j ? 1.0F : 0.0F;
        set.s.value[i] = in.offset + in.gain * set.s.model[i] + 1.0F;
        Sums sums;
        variant.accumulate(in, set.s, sums);
        for (int k = 0; k < 6; ++k) {
          const double expected = numeric[static_cast<std::size_t>(k)][static_cast<std::size_t>(i)];
          const double scale = k < 3 ? 120.0 : 1200.0;
          EXPECT_NEAR(sums.g[k], expected, 0.01 * std::abs(expected) + 0.003 * scale)
              << "reach " << reach << ", correlated " << correlated << ", parameter " << k;
        }
        EXPECT_NEAR(sums.g[6], static_cast<double>(set.s.model[i]), 1e-4);
        EXPECT_NEAR(sums.g[7], 1.0, 1e-4);
      }
    }
  }
}

// Returns inputs for the first, middle and last moment of an exposure with this camera motion.
constexpr int kMoments = 3;
std::array<AccumulateInput, kMoments> moments_of(const Eigen::Isometry3d& T, const Vector6d& motion,
                                                 const AccumulateInput& in) {
  std::array<AccumulateInput, kMoments> inputs;
  for (int k = 0; k < kMoments; ++k) {
    inputs[static_cast<std::size_t>(k)] = in;
    set_pose(exp_se3(0.5 * (k - 1) * motion) * T, inputs[static_cast<std::size_t>(k)]);
  }
  return inputs;
}

Vector6d some_motion() {
  return (Vector6d() << 0.5, -0.3, 0.4, 0.01, 0.02, -0.03).finished();
}

TEST(SimdLoops, AnchorFindsSameVerticesAsPrepare) {
  const Eigen::Isometry3d T = lattice_pose();
  AccumulateInput in;
  set_pose(T, in);
  for (const Loops* variant : variants()) {
    for (const int reach : {1, 2, 3}) {
      SampleSet set = random_samples(simd::kBlock, T, 0.0F);
      simd::Lens lens;
      lens.fx = lens.fy = 500.0F;
      for (int i = 0; i < set.s.count; ++i) {
        set.s.pixel_x[i] = lens.fx * set.s.ray_x[i];
        set.s.pixel_y[i] = lens.fy * set.s.ray_y[i];
      }
      variant->prepare(lens, in.lattice_from_ray, reach, 11, set.s);
      const std::vector<std::int32_t> vertex = set.vertex;
      const std::vector<float> va(set.s.va, set.s.va + set.s.count);
      const std::vector<float> vb(set.s.vb, set.s.vb + set.s.count);
      std::fill_n(set.s.va, set.s.count, -1.0F);
      std::fill_n(set.s.vb, set.s.count, -1.0F);
      std::fill(set.vertex.begin(), set.vertex.end(), -1);
      variant->anchor(in.lattice_from_ray, reach, 11, set.s);
      EXPECT_EQ(vertex, set.vertex);
      EXPECT_TRUE(std::equal(va.begin(), va.end(), set.s.va));
      EXPECT_TRUE(std::equal(vb.begin(), vb.end(), set.s.vb));
    }
  }
}

// The flattened ray must meet the lattice where the given ray meets the curved paper.
TEST(SimdLoops, FlattenFindsPointsOfCurvedPaper) {
  const Eigen::Isometry3d T = lattice_pose();
  AccumulateInput in;
  set_pose(T, in);
  simd::CurvedPaper paper;
  paper.height[0] = -0.1F;
  paper.height[1] = 0.02F;
  paper.height[2] = -0.01F;
  paper.height[3] = 0.015F;
  paper.half = 5.0F;
  std::ranges::copy(in.centre, paper.camera);
  std::ranges::copy(in.lattice_from_ray, paper.lattice_from_ray);
  for (int r = 0; r < 3; ++r) {
    const Eigen::Vector3d row(T.linear()(r, 0), T.linear()(r, 1), T.translation()[r]);
    for (int c = 0; c < 3; ++c) paper.ray_from_lattice[3 * r + c] = static_cast<float>(row[c]);
  }
  const Eigen::Vector3d camera = T.inverse().translation();
  const auto lattice_point = [&](float x, float y) {
    const Eigen::Vector3d direction = T.linear().transpose() * Eigen::Vector3d(x, y, 1.0);
    const Eigen::Vector3d p = camera - camera.z() / direction.z() * direction;
    return Eigen::Vector2d(p.x(), p.y());
  };
  for (const Loops* variant : variants()) {
    for (const int reach : {1, 2, 3}) {
      const SampleSet given = random_samples(simd::kBlock, T, 0.0F);
      SampleSet set = random_samples(simd::kBlock, T, 0.0F);
      variant->flatten(paper, reach, 11, set.s);
      for (int i = 0; i < set.s.count; ++i) {
        const Eigen::Vector2d point = lattice_point(set.s.ray_x[i], set.s.ray_y[i]);
        const Eigen::Vector2d d = point - Eigen::Vector2d(5.0, 5.0);
        const double height =
            -0.1 + 0.5 * (0.02 * d.x() * d.x() - 0.02 * d.x() * d.y() + 0.015 * d.y() * d.y());
        const Eigen::Vector3d on_paper = T * Eigen::Vector3d(point.x(), point.y(), height);
        // The height is taken at the ray's point on the plane, which is up to 0.2 cells away.
        EXPECT_NEAR(on_paper.x() / on_paper.z(), given.s.ray_x[i], 0.02 / 50.0) << variant->name;
        EXPECT_NEAR(on_paper.y() / on_paper.z(), given.s.ray_y[i], 0.02 / 50.0) << variant->name;
        const double shift = reach == 2 ? 0.5 : 0.0;
        EXPECT_NEAR(set.s.va[i], point.x() - shift, 0.5 + 1e-4) << variant->name;
        EXPECT_NEAR(set.s.vb[i], point.y() - shift, 0.5 + 1e-4) << variant->name;
        EXPECT_EQ(set.vertex[static_cast<std::size_t>(i)],
                  static_cast<int>(set.s.vb[i]) * 11 + static_cast<int>(set.s.va[i]));
      }
    }
  }
}

// The model value over several moments must be the mean of the values at single moments.
TEST(SimdLoops, EvaluateOfSeveralMomentsIsMeanOfEachMoment) {
  const Eigen::Isometry3d T = lattice_pose();
  const Loops& variant = simd::widest_loops();
  for (const int reach : {1, 2, 3}) {
    for (const bool correlated : {false, true}) {
      SCOPED_TRACE(testing::Message() << "reach " << reach << ", correlated " << correlated);
      SampleSet set = random_samples(simd::kBlock, T, correlated ? 0.8F : 0.0F);
      AccumulateInput in;
      in.gain = 120.0F;
      in.offset = 30.0F;
      in.reach = reach;
      in.correlated = correlated;
      // Each moment has separate anchors and coefficients.
      std::array<SampleSet, kMoments> sets = {random_samples(simd::kBlock, T, 0.5F),
                                              random_samples(simd::kBlock, T, 0.6F),
                                              random_samples(simd::kBlock, T, 0.7F)};
      std::array<Samples, kMoments> moments;
      for (std::size_t k = 0; k < kMoments; ++k) {
        moments[k] = set.s;
        moments[k].va = sets[k].s.va;
        moments[k].vb = sets[k].s.vb;
        moments[k].ka = sets[k].s.ka;
        moments[k].kb = sets[k].s.kb;
        moments[k].rho = sets[k].s.rho;
        for (std::size_t c = 0; c < 16; ++c) moments[k].c[c] = sets[k].s.c[(c + k) % 16];
      }
      const auto inputs = moments_of(T, some_motion(), in);
      std::vector<double> mean(static_cast<std::size_t>(set.s.count), 0.0);
      for (std::size_t k = 0; k < kMoments; ++k) {
        variant.evaluate(&inputs[k], &moments[k], 1);
        for (std::size_t i = 0; i < mean.size(); ++i)
          mean[i] += static_cast<double>(set.s.model[i]) / kMoments;
      }
      variant.evaluate(inputs.data(), moments.data(), kMoments);
      for (std::size_t i = 0; i < mean.size(); ++i)
        EXPECT_NEAR(static_cast<double>(set.s.model[i]), mean[i], 1e-6);
    }
  }
}

// With a correlation of zero, the bivariate distribution is the product of two normal
// distributions.
TEST(SimdLoops, CorrelatedModelMatchesProductForZeroCorrelation) {
  const Eigen::Isometry3d T = lattice_pose();
  SampleSet set = random_samples(simd::kBlock, T, 0.0F);
  AccumulateInput in;
  set_pose(T, in);
  const Loops& variant = simd::widest_loops();
  for (const int reach : {1, 2, 3}) {
    in.reach = reach;
    in.correlated = false;
    variant.evaluate(&in, &set.s, 1);
    const std::vector<float> plain(set.s.model, set.s.model + set.s.count);
    in.correlated = true;
    variant.evaluate(&in, &set.s, 1);
    for (int i = 0; i < set.s.count; ++i)
      EXPECT_NEAR(set.s.model[i], plain[static_cast<std::size_t>(i)], 2e-4F);
  }
}

TEST(SimdLoops, CorrelatedBlurMatchesBivariateNormal) {
  // The coefficients describe a single corner, so the model value is P(X < x, Y < y). The test
  // integrates this probability numerically.
  const Eigen::Isometry3d T = lattice_pose();
  SampleSet set = random_samples(simd::kBlock, T, 0.0F);
  AccumulateInput in;
  set_pose(T, in);
  in.correlated = true;
  const std::array<double, 4> correlations = {-0.8, -0.4, 0.3, 0.9};
  for (int i = 0; i < set.s.count; ++i) {
    for (int k = 0; k < 4; ++k) set.s.c[k][i] = k == 3 ? 1.0F : 0.0F;
    set.s.rho[i] = static_cast<float>(correlations[static_cast<std::size_t>(i % 4)]);
  }
  simd::widest_loops().evaluate(&in, &set.s, 1);
  for (int i = 0; i < 16; ++i) {
    const double rho = static_cast<double>(set.s.rho[i]);
    const Eigen::Matrix3d M =
        Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(in.lattice_from_ray)
            .cast<double>();
    const Eigen::Vector3d h = M * Eigen::Vector3d(static_cast<double>(set.s.ray_x[i]),
                                                  static_cast<double>(set.s.ray_y[i]), 1.0);
    const double x =
        static_cast<double>(set.s.ka[i]) * (h.x() / h.z() - static_cast<double>(set.s.va[i]));
    const double y =
        static_cast<double>(set.s.kb[i]) * (h.y() / h.z() - static_cast<double>(set.s.vb[i]));
    double sum = 0.0;
    constexpr int kSteps = 4000;
    for (int k = 0; k < kSteps; ++k) {
      const double u = -8.0 + (x + 8.0) * (k + 0.5) / kSteps;
      const double conditional =
          0.5 * std::erfc(-(y - rho * u) / std::sqrt(1.0 - rho * rho) / std::sqrt(2.0));
      sum += std::exp(-0.5 * u * u) / std::sqrt(2.0 * M_PI) * conditional;
    }
    EXPECT_NEAR(static_cast<double>(set.s.model[i]), sum * (x + 8.0) / kSteps, 3e-3);
  }
}

// The first block initializes the sums; the others add to them.
TEST(SimdLoops, AccumulateAddsUpBlocks) {
  const Eigen::Isometry3d T = lattice_pose();
  constexpr int kBlocks = 5;
  SampleSet set = random_samples(kBlocks * simd::kBlock, T, 0.0F);
  for (int i = 0; i < set.s.count; ++i) set.s.weight[i] = i % 7 == 0 ? 0.0F : 1.0F;
  AccumulateInput in;
  set_pose(T, in);
  in.gain = 120.0F;
  in.offset = 30.0F;
  in.inverse_cutoff = 1.0F / 80.0F;
  for (const Loops* variant : variants()) {
    SCOPED_TRACE(variant->name);
    Sums whole;
    variant->accumulate(in, set.s, whole);
    Sums added;
    for (int block = 0; block < kBlocks; ++block) {
      Samples part = set.s;
      part.count = simd::kBlock;
      const std::ptrdiff_t begin = std::ptrdiff_t{block} * simd::kBlock;
      for (float** array : {&part.ray_x, &part.ray_y, &part.value, &part.weight, &part.va, &part.vb,
                            &part.ka, &part.kb, &part.rho, &part.residual})
        *array += begin;
      for (float*& array : part.c) array += begin;
      Sums sums;
      variant->accumulate(in, part, sums);
      for (int k = 0; k < 36; ++k) added.H[k] += sums.H[k];
      for (int k = 0; k < 8; ++k) added.g[k] += sums.g[k];
      added.cost += sums.cost;
      added.weight += sums.weight;
      added.base_weight += sums.base_weight;
    }
    // Each row and column of the matrix has its own scale.
    const auto diagonal = [](int p) { return p * 8 - p * (p - 1) / 2; };
    int index = 0;
    for (int p = 0; p < 8; ++p) {
      for (int q = p; q < 8; ++q, ++index) {
        const double scale = std::sqrt(whole.H[diagonal(p)] * whole.H[diagonal(q)]);
        EXPECT_NEAR(whole.H[index], added.H[index], 1e-6 * scale) << p << ' ' << q;
      }
      const double scale = std::sqrt(whole.H[diagonal(p)] * whole.cost);
      EXPECT_NEAR(whole.g[p], added.g[p], 1e-6 * scale) << p;
    }
    EXPECT_NEAR(whole.cost, added.cost, 1e-6 * added.cost);
    EXPECT_NEAR(whole.weight, added.weight, 1e-6 * added.weight);
    EXPECT_EQ(whole.base_weight, added.base_weight);
    EXPECT_EQ(whole.base_weight, 320.0 - 46.0);
  }
  // Without samples, all sums are zero.
  set.s.count = 0;
  for (const Loops* variant : variants()) {
    Sums sums;
    sums.weight = 1.0;
    variant->accumulate(in, set.s, sums);
    EXPECT_EQ(sums.H[0], 0.0);
    EXPECT_EQ(sums.weight, 0.0);
  }
}

simd::Lens wide_lens(simd::Lens::Kind kind) {
  simd::Lens lens;
  lens.fx = 530.0F;
  lens.fy = 528.0F;
  lens.cx = 320.0F;
  lens.cy = 240.0F;
  lens.kind = kind;
  lens.k[0] = kind == simd::Lens::Kind::none ? 0.0F : -0.1F;
  lens.k[1] = kind == simd::Lens::Kind::none ? 0.0F : 0.02F;
  return lens;
}

std::vector<simd::Lens::Kind> lens_kinds() {
  std::vector<simd::Lens::Kind> kinds = {simd::Lens::Kind::none};
  for (const DistortionModel model : kDistortionModels)
    kinds.push_back(simd::lens_of(test::lens_of(model)).kind);
  return kinds;
}

// Sums have a fixed order of lanes and no fused operations. All instruction sets therefore give the
// same bits, and all machines the same poses.
TEST(SimdLoops, EveryInstructionSetGivesSameBits) {
  const Eigen::Isometry3d T = lattice_pose();
  std::mt19937 random(3);
  std::vector<std::uint8_t> image(200 * 200);
  for (std::uint8_t& pixel : image) pixel = static_cast<std::uint8_t>(random() & 255U);
  std::array<const std::uint8_t*, 20> points{};
  std::array<std::ptrdiff_t, 20> strides{};
  for (std::size_t k = 0; k < points.size(); ++k) {
    points[k] = image.data() + random() % 100 * 200 + random() % 100;
    strides[k] = 200;
  }
  const auto all = variants();
  ASSERT_FALSE(all.empty());
  for (const int reach : {1, 2, 3}) {
    for (const bool correlated : {false, true}) {
      for (const simd::Lens::Kind kind : lens_kinds()) {
        std::vector<Sums> results;
        std::vector<std::vector<float>> models;
        std::vector<std::vector<float>> rays;
        std::vector<std::vector<std::int16_t>> scores;
        for (const Loops* variant : all) {
          SampleSet set = random_samples(4 * simd::kBlock, T, 0.7F);
          const simd::Lens lens = wide_lens(kind);
          for (int i = 0; i < set.s.count; ++i) {
            set.s.pixel_x[i] = std::round(lens.fx * set.s.ray_x[i] + lens.cx);
            set.s.pixel_y[i] = std::round(lens.fy * set.s.ray_y[i] + lens.cy);
          }
          AccumulateInput in;
          set_pose(T, in);
          in.gain = 120.0F;
          in.offset = 30.0F;
          in.inverse_cutoff = 1.0F / 80.0F;
          in.reach = reach;
          in.correlated = correlated;
          variant->prepare(lens, in.lattice_from_ray, reach, 11, set.s);
          Sums sums;
          variant->accumulate(in, set.s, sums);
          results.push_back(sums);
          const auto inputs = moments_of(T, some_motion(), in);
          const std::array<Samples, kMoments> moments = {set.s, set.s, set.s};
          variant->anchor(inputs[0].lattice_from_ray, reach, 11, set.s);
          variant->evaluate(inputs.data(), moments.data(), kMoments);
          models.emplace_back(set.s.model, set.s.model + set.s.count);
          rays.emplace_back(set.s.ray_x, set.s.ray_x + set.s.count);
          std::vector<std::int16_t> map(64 * 20);
          variant->search(points.data(), strides.data(), 10, 20, 64, 20, 2, map.data());
          scores.push_back(map);
        }
        for (std::size_t k = 1; k < all.size(); ++k) {
          EXPECT_EQ(std::memcmp(&results[0], &results[k], sizeof(Sums)), 0) << all[k]->name;
          EXPECT_EQ(models[0], models[k]) << all[k]->name;
          EXPECT_EQ(rays[0], rays[k]) << all[k]->name;
          EXPECT_EQ(scores[0], scores[k]) << all[k]->name;
        }
        EXPECT_GT(results[0].weight, 1.0);
      }
    }
  }
}

// The set of requested outputs must not change a lattice's pixels, rays, depths and blur. The
// expected blur is that of the image, mapped back by the projection's derivative.
TEST(SimdLoops, ProjectGivesSameValuesForAnyOutputs) {
  const Eigen::Isometry3d T = lattice_pose();
  constexpr int kSide = 11;
  constexpr std::size_t kCount = 128;
  std::vector<float> a;
  std::vector<float> b;
  for (int k = 0; k < kSide * kSide; ++k) {
    a.push_back(static_cast<float>(k % kSide));
    b.push_back(static_cast<float>(k / kSide));
  }
  a.resize(kCount, -4000.0F);  // behind the camera
  b.resize(kCount, -4000.0F);
  AccumulateInput in;
  set_pose(T, in);
  std::array<float, 9> M{};
  for (int r = 0; r < 3; ++r) {
    M[static_cast<std::size_t>(3 * r)] = static_cast<float>(T.linear()(r, 0));
    M[static_cast<std::size_t>(3 * r + 1)] = static_cast<float>(T.linear()(r, 1));
    M[static_cast<std::size_t>(3 * r + 2)] = static_cast<float>(T.translation()[r]);
  }
  struct Projected {
    std::array<std::vector<float>, 8> arrays;
    simd::Vertices v;
  };
  for (const simd::Lens::Kind kind : lens_kinds()) {
    for (const Eigen::Vector2f& motion :
         {Eigen::Vector2f(0.0F, 0.0F), Eigen::Vector2f(3.0F, 0.0F), Eigen::Vector2f(3.0F, -2.0F)}) {
      SCOPED_TRACE(testing::Message() << static_cast<int>(kind) << ' ' << motion.transpose());
      const simd::Lens lens = wide_lens(kind);
      simd::Blur blur;
      blur.variance_px2 = 0.34F;
      blur.motion_x_px = motion.x();
      blur.motion_y_px = motion.y();
      const auto projected = [&](const Loops& variant, bool spread, bool correlation) {
        Projected p;
        for (std::vector<float>& array : p.arrays) array.assign(kCount, -7.0F);
        p.v.count = kCount;
        p.v.a = a.data();
        p.v.b = b.data();
        p.v.pixel_x = p.arrays[0].data();
        p.v.pixel_y = p.arrays[1].data();
        p.v.depth = p.arrays[2].data();
        if (spread) {
          p.v.ray_x = p.arrays[3].data();
          p.v.ray_y = p.arrays[4].data();
          p.v.ka = p.arrays[5].data();
          p.v.kb = p.arrays[6].data();
        }
        if (correlation) p.v.rho = p.arrays[7].data();
        variant.project(lens, blur, M.data(), in.lattice_from_ray, p.v);
        return p;
      };
      const Projected all = projected(simd::widest_loops(), true, true);
      for (const Loops* variant : variants()) {
        SCOPED_TRACE(variant->name);
        const Projected same = projected(*variant, true, true);
        const Projected without = projected(*variant, true, false);
        const Projected places = projected(*variant, false, false);
        for (std::size_t k = 0; k < 8; ++k) {
          SCOPED_TRACE(k);
          // Compares bytes, because vertices behind the camera may be NaN.
          const auto equal = [&](const Projected& some) {
            return std::memcmp(some.arrays[k].data(), all.arrays[k].data(),
                               sizeof(float) * kSide * kSide) == 0;
          };
          EXPECT_TRUE(equal(same));
          EXPECT_EQ(equal(without), k < 7);
          EXPECT_EQ(equal(places), k < 3);
        }
        for (const Projected* some : {&same, &without, &places})
          EXPECT_EQ(some->arrays[2], all.arrays[2]);
      }
      EXPECT_LE(all.v.depth[kCount - 1], 0.0F);
      // Differences between neighbouring vertices approximate the derivative of the pixel position.
      const Eigen::Matrix2d covariance =
          0.34 * Eigen::Matrix2d::Identity() + (motion * motion.transpose()).cast<double>() / 12.0;
      for (int j = 1; j + 1 < kSide; ++j) {
        for (int i = 1; i + 1 < kSide; ++i) {
          const int v = j * kSide + i;
          const auto difference = [&](int to, int from) {
            return Eigen::Vector2d(static_cast<double>(all.v.pixel_x[to] - all.v.pixel_x[from]),
                                   static_cast<double>(all.v.pixel_y[to] - all.v.pixel_y[from]));
          };
          Eigen::Matrix2d pixel_by_lattice;
          pixel_by_lattice << 0.5 * difference(v + 1, v - 1),
              0.5 * difference(v + kSide, v - kSide);
          const Eigen::Matrix2d back = pixel_by_lattice.inverse();
          const Eigen::Matrix2d spread = back * covariance * back.transpose();
          EXPECT_NEAR(all.v.ka[v] * std::sqrt(spread(0, 0)), 1.0, 0.01);
          EXPECT_NEAR(all.v.kb[v] * std::sqrt(spread(1, 1)), 1.0, 0.01);
          const double rho = spread(0, 1) / std::sqrt(spread(0, 0) * spread(1, 1));
          EXPECT_NEAR(all.v.rho[v], std::clamp(rho, -0.95, 0.95), 0.01);
        }
      }
    }
  }
}

// For each coefficient of each model, project and unproject must agree with the camera model in
// double precision: over the whole image, for fisheye up to 75 degrees from the axis.
TEST(SimdLoops, LensMatchesCameraModel) {
  struct Case {
    std::string name;
    DistortionModel model;
    double focal_px;
    std::array<double, 8> k;
    double radius;  // largest radius of a ray
  };
  std::vector<Case> cases = {
      {"none", DistortionModel::plumb_bob, 530.0, {}, 0.9},
      {"wide_fisheye", DistortionModel::fisheye, 240.0, {-0.04, 0.012, -0.006, 0.001}, 3.73},
      {"wide_fisheye_without_coefficients", DistortionModel::fisheye, 240.0, {}, 3.73},
  };
  for (const DistortionModel model : kDistortionModels) {
    const CameraParameters p = test::lens_of(model).parameters();
    cases.push_back({std::string(to_string(model)), model, p.fx, p.distortion, 0.8});
  }
  std::mt19937 random(8);
  std::uniform_real_distribution<double> u(-1.0, 1.0);
  for (const Case& c : cases) {
    SCOPED_TRACE(c.name);
    CameraParameters p;
    p.width = 640;
    p.height = 480;
    p.fx = c.focal_px;
    p.fy = 0.997 * c.focal_px;
    p.cx = 322.0;
    p.cy = 236.0;
    p.model = c.model;
    p.distortion = c.k;
    const CameraModel camera = CameraModel::make(p).value();
    ASSERT_GT(camera.max_radius(), c.radius);
    const simd::Lens lens = simd::lens_of(camera);
    // The rays of the vertices are their lattice coordinates, 0.02 apart.
    constexpr int kCount = 64 * simd::kBlock;
    constexpr double kCell = 0.02;
    const std::array<float, 9> M = {0.02F, 0, 0, 0, 0.02F, 0, 0, 0, 1};
    const std::array<float, 9> N = {50, 0, 0, 0, 50, 0, 0, 0, 1};
    std::vector<float> a;
    std::vector<float> b;
    std::vector<Eigen::Vector2d> pixels;
    std::vector<Eigen::Vector2d> rays;
    while (static_cast<int>(a.size()) < kCount) {
      const double radius = c.radius * std::sqrt(0.5 + 0.5 * u(random));
      const double angle = 3.1416 * u(random);
      a.push_back(static_cast<float>(radius * std::cos(angle) / kCell));
      b.push_back(static_cast<float>(radius * std::sin(angle) / kCell));
      rays.emplace_back(static_cast<double>(a.back()) * kCell,
                        static_cast<double>(b.back()) * kCell);
      const auto pixel = camera.project({rays.back().x(), rays.back().y(), 1.0});
      ASSERT_TRUE(pixel);
      pixels.push_back(*pixel);
    }
    std::array<std::vector<float>, 3> out;
    for (std::vector<float>& array : out) array.resize(kCount);
    simd::Vertices vertices;
    vertices.count = kCount;
    vertices.a = a.data();
    vertices.b = b.data();
    vertices.pixel_x = out[0].data();
    vertices.pixel_y = out[1].data();
    vertices.depth = out[2].data();
    SampleSet set(kCount);
    for (int i = 0; i < kCount; ++i) {
      const auto k = static_cast<std::size_t>(i);
      // The initial guesses are within three pixels.
      const auto guess = camera.unproject(pixels[k] + 3.0 * Eigen::Vector2d(u(random), u(random)));
      ASSERT_TRUE(guess);
      set.s.ray_x[i] = static_cast<float>(guess->x());
      set.s.ray_y[i] = static_cast<float>(guess->y());
      set.s.pixel_x[i] = static_cast<float>(pixels[k].x());
      set.s.pixel_y[i] = static_cast<float>(pixels[k].y());
    }
    simd::widest_loops().project(lens, {}, M.data(), N.data(), vertices);
    simd::widest_loops().prepare(lens, N.data(), 1, 11, set.s);
    double pixel_off = 0.0;
    double ray_off = 0.0;
    for (int i = 0; i < kCount; ++i) {
      const auto k = static_cast<std::size_t>(i);
      EXPECT_GT(out[2][k], 0.0F);
      const Eigen::Vector2d pixel(static_cast<double>(out[0][k]), static_cast<double>(out[1][k]));
      pixel_off = std::max(pixel_off, (pixel - pixels[k]).norm());
      const auto back = camera.project(
          {static_cast<double>(set.s.ray_x[i]), static_cast<double>(set.s.ray_y[i]), 1.0});
      ASSERT_TRUE(back);
      ray_off = std::max(ray_off, (*back - pixels[k]).norm());
    }
    EXPECT_LT(pixel_off, 5e-4);
    EXPECT_LT(ray_off, 5e-3);
    RecordProperty(c.name, std::to_string(pixel_off) + ", " + std::to_string(ray_off) + " px");
    // A ray beyond the lens's field of view gives no pixel.
    if (std::isfinite(camera.max_radius())) {
      a[0] = static_cast<float>(1.01 * camera.max_radius() / kCell);
      b[0] = 0.0F;
      simd::widest_loops().project(lens, {}, M.data(), N.data(), vertices);
      EXPECT_LT(out[2][0], 0.0F);
    }
  }
}

// Compares the pixels near edges with those of a loop in double precision.
TEST(SimdLoops, EdgeWalkSelectsPixelsNearEdge) {
  const Eigen::Isometry3d T = lattice_pose();
  // The edges along a are at b = 3 from 1 to 4 and at b = 7 from 2 to 9. For edges along b, a and b
  // are exchanged.
  std::vector<simd::Walk::Cell> cells;
  for (const auto& [from, to, across, run] : {std::array{1, 4, 3, 5}, std::array{2, 9, 7, 8}}) {
    for (int cell = from; cell < to; ++cell)
      cells.push_back({static_cast<float>(cell - static_cast<int>(cells.size())),
                       static_cast<float>(across), run});
  }
  const auto cell_count = static_cast<int>(cells.size());
  cells.push_back(simd::Walk::Cell(cells.back()));
  std::array<float, 9> M{};
  for (int r = 0; r < 3; ++r) {
    M[static_cast<std::size_t>(3 * r)] = static_cast<float>(T.linear()(r, 0));
    M[static_cast<std::size_t>(3 * r + 1)] = static_cast<float>(T.linear()(r, 1));
    M[static_cast<std::size_t>(3 * r + 2)] = static_cast<float>(T.translation()[r]);
  }
  std::array<float, 20> offsets{};
  for (std::size_t k = 0; k < offsets.size(); ++k) offsets[k] = static_cast<float>(k);
  const std::array<float, 20> band = {-4.0F, -1.0F, 0.0F, 1.0F, 3.0F, 5.0F};
  for (const auto kind : {simd::Lens::Kind::none, simd::Lens::Kind::polynomial}) {
    const simd::Lens lens = wide_lens(kind);
    const auto pixel_of = [&](double a, double b) {
      const Eigen::Vector3d p = T * Eigen::Vector3d(a, b, 0.0);
      const double x = p.x() / p.z();
      const double y = p.y() / p.z();
      const double r2 = x * x + y * y;
      const double radial =
          1.0 + r2 * (static_cast<double>(lens.k[0]) + r2 * static_cast<double>(lens.k[1]));
      return Eigen::Vector2d(static_cast<double>(lens.fx) * radial * x + 320.0,
                             static_cast<double>(lens.fy) * radial * y + 240.0);
    };
    for (const bool along_b : {false, true}) {
      for (const int band_count : {0, 6}) {
        SCOPED_TRACE(testing::Message() << static_cast<int>(kind) << along_b << band_count);
        const Eigen::Vector2d along = along_b
                                          ? Eigen::Vector2d(pixel_of(5, 5.5) - pixel_of(5, 4.5))
                                          : Eigen::Vector2d(pixel_of(5.5, 5) - pixel_of(4.5, 5));
        simd::Walk walk;
        walk.cells = cells.data();
        walk.cell_count = cell_count;
        walk.count = 21;
        walk.ray_from_lattice = M.data();
        walk.along_b = along_b;
        walk.along_x = std::abs(along.x()) >= std::abs(along.y());
        walk.width = 640;
        walk.height = 270;  // part of the edges is below the image
        walk.stride = 700;
        walk.reach_px = 1.3F;
        walk.max_rows = band_count > 0 ? band_count : 5;
        walk.band_count = band_count;
        walk.offsets = band_count > 0 ? band.data() : offsets.data();
        std::vector<std::int32_t> end(32);
        std::vector<std::int32_t> run(32);
        walk.end = end.data();
        walk.run = run.data();
        std::vector<SampleSet> sets;
        std::vector<int> used;
        for (const Loops* variant : variants()) {
          SampleSet& set = sets.emplace_back(4 * simd::kBlock);
          used.push_back(variant->walk(lens, walk, set.s, 0));
          const SampleSet& first = sets.front();
          ASSERT_EQ(used.back(), used.front()) << variant->name;
          const auto size = static_cast<std::size_t>(used.back()) * sizeof(float);
          EXPECT_EQ(std::memcmp(set.s.pixel_x, first.s.pixel_x, size), 0) << variant->name;
          EXPECT_EQ(std::memcmp(set.s.pixel_y, first.s.pixel_y, size), 0) << variant->name;
          EXPECT_EQ(std::memcmp(set.s.vertex, first.s.vertex, size), 0) << variant->name;
        }
        const Samples& s = sets.front().s;
        int begin = 0;
        int outside = 0;
        for (int k = 0; k < walk.count; ++k) {
          const double at = (k + 0.5) * cell_count / walk.count;
          const double going = at < 3.0 ? at + 1.0 : at - 1.0;
          const double fixed = at < 3.0 ? 3.0 : 7.0;
          const auto place = [&](double d) {
            return along_b ? pixel_of(fixed, going + d) : pixel_of(going + d, fixed);
          };
          Eigen::Vector2d p = place(0.0);
          Eigen::Vector2d d = place(1e-4) - place(-1e-4);
          if (!walk.along_x) {
            std::swap(p.x(), p.y());
            std::swap(d.x(), d.y());
          }
          const double slope = d.y() / d.x();
          const double step = std::round(p.x());
          const double centre = p.y() + slope * (step - p.x());
          const double half_width = 1.3 * std::sqrt(1.0 + slope * slope);
          std::vector<double> expected;
          for (int c = -20; c < 700; ++c) {
            if (band_count == 0 && std::abs(c - centre) <= half_width) expected.push_back(c);
          }
          for (int i = 0; i < band_count; ++i)
            expected.push_back(std::floor(centre) +
                               static_cast<double>(band[static_cast<std::size_t>(i)]));
          const double cross_limit = walk.along_x ? walk.height : walk.width;
          const double walk_limit = walk.along_x ? walk.width : walk.height;
          if (step < 0.0 || step >= walk_limit || expected.front() < 0.0 ||
              expected.back() >= cross_limit)
            expected.clear();
          outside += expected.empty() ? 1 : 0;
          EXPECT_EQ(run[static_cast<std::size_t>(k)], at < 3.0 ? 5 : 8);
          const int stop = end[static_cast<std::size_t>(k)];
          ASSERT_EQ(stop - begin, static_cast<int>(expected.size())) << k;
          for (int i = begin; i < stop; ++i) {
            const auto x = static_cast<int>(s.pixel_x[i]);
            const auto y = static_cast<int>(s.pixel_y[i]);
            EXPECT_EQ(walk.along_x ? x : y, static_cast<int>(step));
            EXPECT_EQ(walk.along_x ? y : x,
                      static_cast<int>(expected[static_cast<std::size_t>(i - begin)]));
            EXPECT_EQ(s.vertex[i], 700 * y + x);
          }
          begin = stop;
        }
        EXPECT_EQ(begin, used.front());
        EXPECT_LT(outside, walk.count);
      }
    }
  }
}

// Compares the pixels along runs with those of a loop in double precision, step by step.
TEST(SimdLoops, WalkRunsVisitsEveryPixel) {
  constexpr int kWidth = 300;
  constexpr int kHeight = 200;
  constexpr int kStride = 350;
  std::mt19937 random(5);
  std::uniform_real_distribution<float> anywhere(-30.0F, 310.0F);
  std::uniform_real_distribution<float> near(-12.0F, 12.0F);
  constexpr std::size_t kVertices = 200;
  std::vector<float> x(kVertices);
  std::vector<float> y(kVertices);
  std::vector<float> ray_x(kVertices);
  std::vector<float> ray_y(kVertices);
  std::vector<float> depth(kVertices, 1.0F);
  std::vector<simd::RunWalk::Run> runs;
  for (std::size_t k = 0; k < kVertices; k += 2) {
    x[k] = anywhere(random);
    y[k] = anywhere(random);
    x[k + 1] = x[k] + near(random) * (k % 7 == 0 ? 4.0F : 1.0F);
    y[k + 1] = y[k] + near(random);
    for (const std::size_t v : {k, k + 1}) {
      ray_x[v] = x[v] / 300.0F + 1e-4F * near(random);
      ray_y[v] = y[v] / 300.0F + 1e-4F * near(random);
    }
    runs.push_back({static_cast<std::uint32_t>(k), static_cast<std::uint32_t>(k + 1), false});
  }
  depth[10] = -1.0F;
  depth[31] = 0.0F;
  x[40] = x[41];  // degenerate run of length 0
  y[40] = y[41];
  x[50] = 2e5F;
  std::array<float, 20> all_rows{};
  for (std::size_t k = 0; k < all_rows.size(); ++k) all_rows[k] = static_cast<float>(k);
  const std::array<float, 20> band = {-4.0F, -1.0F, 0.0F, 1.0F, 3.0F, 5.0F};
  for (const int band_count : {0, 6}) {
    for (const double stride : {1.0, 1.37, 9.0}) {
      for (const auto kind : {simd::Lens::Kind::none, simd::Lens::Kind::polynomial}) {
        SCOPED_TRACE(testing::Message() << band_count << ' ' << stride);
        simd::Lens lens;
        lens.kind = kind;
        simd::RunWalk walk;
        walk.runs = runs.data();
        walk.count = static_cast<int>(runs.size());
        walk.pixel_x = x.data();
        walk.pixel_y = y.data();
        walk.ray_x = ray_x.data();
        walk.ray_y = ray_y.data();
        walk.depth = depth.data();
        walk.reach_px = 1.7;
        walk.stride_px = stride;
        walk.width = kWidth;
        walk.height = kHeight;
        walk.stride = kStride;
        walk.band_count = band_count;
        walk.max_rows = band_count > 0 ? band_count : 5;
        walk.offsets = band_count > 0 ? band.data() : all_rows.data();
        struct Sample {
          int x, y, place;
          float ray_x, ray_y;
        };
        std::vector<Sample> expected;
        std::vector<std::pair<std::int32_t, std::int32_t>> ends;
        double along_px = 0.0;
        double carry = 0.5 * stride;
        for (std::size_t k = 0; k < runs.size(); ++k) {
          const std::size_t v0 = runs[k].begin;
          const std::size_t v1 = runs[k].end;
          if (!(depth[v0] > 0.0F && depth[v1] > 0.0F)) continue;
          Eigen::Vector2d p(static_cast<double>(x[v0]), static_cast<double>(y[v0]));
          Eigen::Vector2d q(static_cast<double>(x[v1]), static_cast<double>(y[v1]));
          along_px +=
              static_cast<double>(std::max(std::abs(x[v1] - x[v0]), std::abs(y[v1] - y[v0])));
          const double length = (q - p).cwiseAbs().maxCoeff();
          if (length < 1e-6 || std::max(p.cwiseAbs().maxCoeff(), q.cwiseAbs().maxCoeff()) > 1e5)
            continue;
          const bool along_x = std::abs(q.x() - p.x()) >= std::abs(q.y() - p.y());
          if (!along_x) {
            std::swap(p.x(), p.y());
            std::swap(q.x(), q.y());
          }
          const double slope = (q.y() - p.y()) / length;
          const double half_width = std::min(1.7 * std::sqrt(1.0 + slope * slope), 8.0);
          double at = carry;
          for (; at < length; at += stride) {
            const double toward = q.x() < p.x() ? -1.0 : 1.0;
            const double step = std::floor(p.x() + toward * at + 0.5);
            const double exact = toward * (step - p.x());
            const double centre = p.y() + slope * exact;
            std::vector<double> rows;
            if (band_count == 0) {
              for (double c = std::ceil(centre - half_width);
                   c <= centre + half_width && rows.size() < 5; ++c)
                rows.push_back(c);
            }
            for (int i = 0; i < band_count; ++i)
              rows.push_back(std::floor(centre) +
                             static_cast<double>(band[static_cast<std::size_t>(i)]));
            if (step < 0.0 || step >= (along_x ? kWidth : kHeight) || rows.front() < 0.0 ||
                rows.back() >= (along_x ? kHeight : kWidth))
              continue;
            const auto guess = [&](const std::vector<float>& ray) {
              const auto from = static_cast<double>(ray[v0]);
              return static_cast<float>(from +
                                        (static_cast<double>(ray[v1]) - from) / length * exact);
            };
            for (const double row : rows) {
              const int px = static_cast<int>(along_x ? step : row);
              const int py = static_cast<int>(along_x ? row : step);
              expected.push_back({px, py, py * kStride + px, guess(ray_x), guess(ray_y)});
            }
          }
          if (carry < length)
            ends.emplace_back(static_cast<std::int32_t>(k),
                              static_cast<std::int32_t>(expected.size()));
          carry = at - length;
        }
        ASSERT_GT(expected.size(), 100U);
        for (const Loops* variant : variants()) {
          SCOPED_TRACE(variant->name);
          std::vector<simd::RunWalk::Part> parts((runs.size() + 15) / 16);
          std::vector<std::int32_t> end(runs.size());
          std::vector<std::int32_t> run(runs.size());
          walk.parts = parts.data();
          walk.end = end.data();
          walk.run = run.data();
          double along = 0.0;
          double across = 0.0;
          variant->measure_runs(walk, along, across);
          EXPECT_EQ(along, along_px);
          SampleSet set(200 * simd::kBlock);
          const int used = variant->walk_runs(lens, walk, set.s);
          ASSERT_EQ(static_cast<std::size_t>(used), expected.size());
          ASSERT_EQ(static_cast<std::size_t>(walk.walked), ends.size());
          for (std::size_t k = 0; k < ends.size(); ++k) {
            EXPECT_EQ(run[k], ends[k].first);
            EXPECT_EQ(end[k], ends[k].second) << k;
          }
          for (std::size_t i = 0; i < expected.size(); ++i) {
            ASSERT_EQ(static_cast<int>(set.s.pixel_x[i]), expected[i].x) << i;
            ASSERT_EQ(static_cast<int>(set.s.pixel_y[i]), expected[i].y) << i;
            ASSERT_EQ(set.s.vertex[i], expected[i].place) << i;
            if (kind == simd::Lens::Kind::none) continue;
            ASSERT_NEAR(set.s.ray_x[i], expected[i].ray_x, 1e-6F) << i;
            ASSERT_NEAR(set.s.ray_y[i], expected[i].ray_y, 1e-6F) << i;
          }
        }
      }
    }
  }
}

// Checks the values read, the padding of the last block, and the vertex records.
TEST(SimdLoops, ReadAndAttachFillSamples) {
  std::mt19937 random(8);
  std::uniform_int_distribution<int> byte(0, 255);
  constexpr std::size_t kVertices = 50;
  std::vector<std::uint8_t> pixels(1000);
  for (std::uint8_t& pixel : pixels) pixel = static_cast<std::uint8_t>(byte(random));
  std::array<float, 256> levels{};
  for (std::size_t k = 0; k < levels.size(); ++k) levels[k] = 0.37F * static_cast<float>(k);
  std::vector<float> ka(kVertices);
  std::vector<float> kb(kVertices);
  std::vector<float> coefficients(4 * kVertices);
  for (std::vector<float>* array : {&ka, &kb, &coefficients}) {
    for (float& value : *array) value = static_cast<float>(byte(random));
  }
  for (const Loops* variant : variants()) {
    for (const int used : {0, 1, 63, 64, 100, 128}) {
      SCOPED_TRACE(testing::Message() << variant->name << ' ' << used);
      SampleSet set(3 * simd::kBlock);
      set.s.count = (used + simd::kBlock - 1) / simd::kBlock * simd::kBlock;
      const std::array<float*, 4> kept = {set.s.pixel_x, set.s.pixel_y, set.s.ray_x, set.s.ray_y};
      for (std::size_t k = 0; k < kept.size(); ++k) {
        for (int i = 0; i < 3 * simd::kBlock; ++i) kept[k][i] = static_cast<float>(i * 4 + k);
      }
      std::vector<std::int32_t> places;
      for (int i = 0; i < used; ++i) places.push_back(set.s.vertex[i] = (37 * i + 5) % 1000);
      variant->read(pixels.data(), levels.data(), used, set.s);
      for (int i = 0; i < 3 * simd::kBlock; ++i) {
        const bool sampled = i < used;
        const bool filled = i < set.s.count;
        const float value =
            sampled ? levels[pixels[static_cast<std::size_t>(places[static_cast<std::size_t>(i)])]]
                    : 0.0F;
        EXPECT_EQ(set.s.value[i], value);
        EXPECT_EQ(set.s.weight[i], sampled ? 1.0F : 0.0F);
        for (std::size_t k = 0; k < kept.size(); ++k)
          EXPECT_EQ(kept[k][i], static_cast<float>((!sampled && filled ? used - 1 : i) * 4 + k));
      }
      for (int i = 0; i < set.s.count; ++i)
        set.s.vertex[i] = (11 * i + 3) % static_cast<int>(kVertices);
      variant->attach(ka.data(), kb.data(), coefficients.data(), set.s);
      for (int i = 0; i < set.s.count; ++i) {
        const auto v = static_cast<std::size_t>(set.s.vertex[i]);
        EXPECT_EQ(set.s.ka[i], ka[v]);
        EXPECT_EQ(set.s.kb[i], kb[v]);
        for (std::size_t c = 0; c < 4; ++c) EXPECT_EQ(set.s.c[c][i], coefficients[4 * v + c]);
      }
    }
  }
}

// Compares the pixels nearest to cells with those of a loop in double precision, cell by cell.
TEST(SimdLoops, PixelsOfCellsAreNearestPixels) {
  constexpr int kWidth = 90;
  constexpr int kHeight = 70;
  std::mt19937 random(3);
  std::uniform_real_distribution<float> jitter(-0.4F, 0.4F);
  for (const int side : {7, 9, 12}) {
    for (const int stride : {100, -100}) {
      const auto vertices = static_cast<std::size_t>(side * side);
      std::vector<float> x(vertices);
      std::vector<float> y(vertices);
      std::vector<float> depth(vertices, 2.0F);
      for (int j = 0; j < side; ++j) {
        for (int i = 0; i < side; ++i) {
          const auto v = static_cast<std::size_t>(j * side + i);
          x[v] =
              -9.0F + 11.3F * static_cast<float>(i) + 1.2F * static_cast<float>(j) + jitter(random);
          y[v] =
              -7.0F + 10.6F * static_cast<float>(j) - 0.7F * static_cast<float>(i) + jitter(random);
        }
      }
      depth[static_cast<std::size_t>(3 * side + 2)] = -1.0F;
      x[static_cast<std::size_t>(4 * side + 4)] = 1e7F;
      simd::CellCorners corners;
      corners.pixel_x = x.data();
      corners.pixel_y = y.data();
      corners.depth = depth.data();
      for (const Loops* variant : variants()) {
        std::vector<std::int32_t> places(vertices, 7);
        variant->cell_pixels(side, corners, {kWidth, kHeight, stride}, places.data());
        int outside = 0;
        for (int j = 0; j + 1 < side; ++j) {
          for (int i = 0; i + 1 < side; ++i) {
            Eigen::Vector2d sum(0.0, 0.0);
            bool seen = true;
            for (const int v :
                 {j * side + i, j * side + i + 1, (j + 1) * side + i, (j + 1) * side + i + 1}) {
              const auto at = static_cast<std::size_t>(v);
              sum += Eigen::Vector2d(static_cast<double>(x[at]), static_cast<double>(y[at]));
              seen = seen && depth[at] > 0.0F;
            }
            const double px = std::floor(0.25 * sum.x() + 0.5);
            const double py = std::floor(0.25 * sum.y() + 0.5);
            seen = seen && px >= 0.0 && py >= 0.0 && px < kWidth && py < kHeight;
            outside += seen ? 0 : 1;
            EXPECT_EQ(places[static_cast<std::size_t>(j * side + i)],
                      seen ? static_cast<int>(py) * stride + static_cast<int>(px) : simd::kNowhere)
                << variant->name << ' ' << side << ' ' << i << ' ' << j;
          }
        }
        EXPECT_GT(outside, 6);
        EXPECT_LT(outside, (side - 1) * (side - 1));
      }
    }
  }
}

// Compares one step over packs of four tags with matrix operations, tag by tag.
TEST(SimdLoops, PackedTagsMatchSingleTags) {
  std::mt19937 random(21);
  std::normal_distribution<double> n(0.0, 1.0);
  constexpr std::size_t kRejected = 2;  // first lane of the second pack without a valid tag
  std::array<simd::TagPack, 2> packs;
  struct Tag {
    Eigen::Matrix<double, 8, 8> H;
    Eigen::Matrix<double, 8, 1> g;
    Eigen::Matrix3d R;
    Eigen::Vector3d centre;
    Eigen::Matrix3d M;
    double cell_m = 0.0;
    int side = 0;
  };
  std::vector<Tag> tags;
  for (std::size_t k = 0; k < 4 + kRejected; ++k) {
    Tag tag;
    Eigen::Matrix<double, 20, 8> J;
    for (double& j : J.reshaped()) j = n(random);
    tag.H = J.transpose() * J;
    for (double& g : tag.g) g = n(random);
    tag.R = Eigen::Quaterniond(n(random), n(random), n(random), n(random))
                .normalized()
                .toRotationMatrix();
    tag.centre = Eigen::Vector3d(n(random), n(random), 30.0 + n(random));
    tag.M = Eigen::Matrix3d::Zero();
    tag.M.col(0) = Eigen::Vector3d(0.01, 0.001 * n(random), 0.001 * n(random));
    tag.M.col(1) = Eigen::Vector3d(0.001 * n(random), 0.01, 0.001 * n(random));
    tag.M.col(2) = Eigen::Vector3d(0.1 * n(random), 0.1 * n(random), 0.6);
    tag.cell_m = 0.01;
    tag.side = 9;
    simd::TagPack& pack = packs[k / 4];
    const std::size_t lane = k % 4;
    int index = 0;
    for (int p = 0; p < 8; ++p) {
      pack.g[p][lane] = tag.g[p];
      for (int q = p; q < 8; ++q, ++index) pack.H[index][lane] = tag.H(p, q);
    }
    pack.weight[lane] = 100.0;
    for (int r = 0; r < 3; ++r) {
      pack.centre[r][lane] = tag.centre[r];
      for (int c = 0; c < 3; ++c) {
        pack.R[3 * r + c][lane] = tag.R(r, c);
        pack.ray_from_lattice[3 * r + c][lane] = tag.M(r, c);
      }
    }
    pack.per_cell[lane] = 1.0 / tag.cell_m;
    pack.side_cells[lane] = tag.side;
    tags.push_back(tag);
  }
  // Lane kRejected has too few samples; the next lane has a value that is not finite.
  packs[1].weight[kRejected] = 3.0;
  packs[1].weight[3] = 100.0;
  packs[1].H[4][3] = std::numeric_limits<double>::quiet_NaN();
  simd::CameraStep step;
  Vector6d xi;
  xi << 0.002, -0.001, 0.003, 0.01, -0.02, 0.005;
  std::copy(xi.data(), xi.data() + 6, step.xi);
  const Eigen::Isometry3d motion = exp_se3(xi);
  for (int r = 0; r < 3; ++r) {
    step.t[r] = motion.translation()[r];
    for (int c = 0; c < 3; ++c) step.R[3 * r + c] = motion.linear()(r, c);
  }
  step.fx = 500.0;
  step.fy = 510.0;
  step.slope = 0.8;
  std::vector<std::array<simd::TagPack, 2>> results;
  for (const Loops* variant : variants()) {
    results.push_back(packs);
    variant->marginalise(results.back().data(), 2);
    variant->follow(step, results.back().data(), 2);
    for (std::size_t p = 0; p < 2; ++p) {
      const simd::TagPack& a = results.front()[p];
      const simd::TagPack& b = results.back()[p];
      EXPECT_EQ(std::memcmp(a.H_camera, b.H_camera, sizeof a.H_camera), 0) << variant->name;
      EXPECT_EQ(std::memcmp(a.g_camera, b.g_camera, sizeof a.g_camera), 0) << variant->name;
      EXPECT_EQ(std::memcmp(a.levels, b.levels, sizeof a.levels), 0) << variant->name;
      EXPECT_EQ(std::memcmp(a.moved_px2, b.moved_px2, sizeof a.moved_px2), 0) << variant->name;
    }
  }
  for (const std::size_t lane : {kRejected, std::size_t{3}}) {
    const simd::TagPack& pack = results[0][1];
    EXPECT_FALSE(pack.valid[lane]);
    for (const auto& h : pack.H_camera) EXPECT_EQ(h[lane], 0.0);
    for (const auto& g : pack.g_camera) EXPECT_EQ(g[lane], 0.0);
  }
  for (std::size_t k = 0; k < tags.size(); ++k) {
    SCOPED_TRACE(k);
    const Tag& tag = tags[k];
    const simd::TagPack& pack = results[0][k / 4];
    const std::size_t lane = k % 4;
    if (k >= 4 + kRejected) continue;
    ASSERT_TRUE(pack.valid[lane]);
    const Eigen::Matrix2d inverse = tag.H.bottomRightCorner<2, 2>().inverse();
    const Eigen::Matrix<double, 6, 2> cross = tag.H.topRightCorner<6, 2>();
    const Matrix6d H = tag.H.topLeftCorner<6, 6>() - cross * inverse * cross.transpose();
    const Vector6d g = tag.g.head<6>() - cross * inverse * tag.g.tail<2>();
    Matrix6d to_lattice = Matrix6d::Zero();
    to_lattice.topLeftCorner<3, 3>() = tag.R / tag.cell_m;
    to_lattice.topRightCorner<3, 3>() = skew(tag.centre) * tag.R;
    to_lattice.bottomRightCorner<3, 3>() = tag.R;
    const Matrix6d H_camera = to_lattice.transpose() * H * to_lattice;
    const Vector6d g_camera = to_lattice.transpose() * g;
    int index = 0;
    const double scale = 1e-12 * H_camera.cwiseAbs().maxCoeff();
    for (const auto& [row, column] : {std::pair(0, 0), std::pair(0, 3), std::pair(3, 3)}) {
      for (int p = 0; p < 3; ++p) {
        for (int q = row == column ? p : 0; q < 3; ++q, ++index)
          EXPECT_NEAR(pack.H_camera[index][lane], H_camera(row + p, column + q), scale);
      }
    }
    for (int p = 0; p < 6; ++p)
      EXPECT_NEAR(pack.g_camera[p][lane], g_camera[p], 1e-12 * g_camera.norm());
    const Eigen::Vector2d levels =
        inverse * (tag.g.tail<2>() / step.slope - cross.transpose() * (to_lattice * xi));
    EXPECT_NEAR(pack.levels[0][lane], levels[0], 1e-10);
    EXPECT_NEAR(pack.levels[1][lane], levels[1], 1e-10);
    double max_moved_px2 = 0.0;
    for (const double a : {0.0, 9.0}) {
      for (const double b : {0.0, 9.0}) {
        const Eigen::Vector3d p = tag.M * Eigen::Vector3d(a, b, 1.0);
        const Eigen::Vector3d q = motion * p;
        const Eigen::Vector2d moved = q.hnormalized() - p.hnormalized();
        max_moved_px2 = std::max(max_moved_px2,
                                 moved.cwiseProduct(Eigen::Vector2d(500.0, 510.0)).squaredNorm());
      }
    }
    EXPECT_NEAR(pack.moved_px2[lane], max_moved_px2, 1e-9 * max_moved_px2);
  }
}

TEST(SimdLoops, LeverageMatchesEdgeDisplacement) {
  for (const Loops* variant : variants()) {
    SampleSet set(2 * simd::kBlock);
    std::vector<float> leverage(3 * 2 * simd::kBlock, -1.0F);
    set.s.leverage = leverage.data();
    std::mt19937 random(4);
    std::uniform_real_distribution<float> uniform(-1.0F, 1.0F);
    for (int i = 0; i < set.s.count; ++i) {
      set.s.value[i] = 100.0F + 90.0F * uniform(random);
      set.s.residual[i] = 20.0F * uniform(random);
    }
    simd::LeverageInput in;
    in.inverse_gain = 1.0F / 120.0F;
    in.offset = 40.0F;
    in.inverse_limit = 1.0F / 0.12F;
    variant->leverage(in, set.s);
    for (int i = 0; i < set.s.count; ++i) {
      const float r = set.s.residual[i] / 120.0F;
      const float m = (set.s.value[i] - 40.0F) / 120.0F - r;
      const float inside = std::max(0.0F, 1.0F - r * r / (0.12F * 0.12F));
      const float slope = std::max(0.0F, m * (1.0F - m));
      const float effect = slope * inside * inside;
      const float* const pair = leverage.data() + 2 * i;
      EXPECT_NEAR(pair[0], effect * r, 1e-6F);
      EXPECT_NEAR(pair[1], effect * slope, 1e-6F);
      EXPECT_NEAR(leverage[static_cast<std::size_t>(2 * set.s.count + i)], effect * effect, 1e-6F);
    }
  }
}

}  // namespace
}  // namespace penumbra
