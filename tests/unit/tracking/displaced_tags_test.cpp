// Alignment with a map that has displaced every tag, for example because the sheet is bent.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "core/geometry/group_pose.hpp"
#include "support/random_session.hpp"
#include "support/synthetic_board.hpp"
#include "support/synthetic_view.hpp"
#include "tracking/alignment/pattern_renderer.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {
namespace {

using test::random_view;

constexpr double kDisplacement_m = 0.002;

class DisplacedTags : public testing::Test {
 protected:
  static CameraModel camera() {
    CameraParameters p = test::lens_camera(test::Lens::plumb_bob, 640, 480, 0.85).parameters();
    p.tone_curve = 1.0;
    return CameraModel::make(p).value();
  }
  // Returns the map's tags with independent displacements.
  std::vector<MappedTag> displaced(double sigma_m) {
    std::normal_distribution<double> normal(0.0, sigma_m);
    std::vector<MappedTag> tags = tags_;
    for (MappedTag& tag : tags) {
      const Eigen::Vector3d shift(normal(random_), normal(random_), normal(random_));
      tag.T_table_tag = {tag.T_table_tag.rotation(), tag.T_table_tag.translation() + shift};
    }
    return tags;
  }
  // Aligns an image of `sheet` with the map. Returns the overlay error.
  double error_px(const std::vector<MappedTag>& sheet, const CameraPose& truth,
                  double map_sigma_m) {
    auto renderer = PatternRenderer::create(camera_, sheet).value();
    PatternRenderOptions render;
    render.noise_grey = 2.0;
    render.samples = 64;
    const GreyImage image = renderer.render(std::array{truth}, render);
    AlignmentInput input;
    input.luma = image.view();
    input.predicted = as_map_pose(truth);
    input.covariance = test::loose_prior(0.003, 0.005);
    input.map_sigma_m = map_sigma_m;
    const AlignmentResult result = aligner_.refine(input);
    EXPECT_TRUE(result.T_map_camera.is_finite());
    return overlay_difference(camera_, result.T_map_camera, as_map_pose(truth)).rms_px();
  }

  const CameraModel camera_ = camera();
  const std::vector<MappedTag> tags_ = test::board(4, 3, 0.05);
  TagAligner aligner_ = TagAligner::create(camera_, tags_).value();
  std::mt19937_64 random_{7};
};

TEST_F(DisplacedTags, CauseSmallerErrorIfWeighedForIt) {
  double plain = 0.0;
  double weighed = 0.0;
  for (int trial = 0; trial < 24; ++trial) {
    const CameraPose truth = random_view(random_);
    const auto sheet = displaced(kDisplacement_m);
    plain += std::pow(error_px(sheet, truth, 0.0), 2);
    weighed += std::pow(error_px(sheet, truth, kDisplacement_m), 2);
  }
  RecordProperty("ratio", std::to_string(std::sqrt(weighed / plain)));
  EXPECT_LT(std::sqrt(weighed), 0.9 * std::sqrt(plain));
}

TEST_F(DisplacedTags, AreWeighedAlikeByAnySigmaFarAboveTheNoise) {
  for (int trial = 0; trial < 5; ++trial) {
    const CameraPose truth = random_view(random_);
    const auto sheet = displaced(kDisplacement_m);
    const double once = error_px(sheet, truth, kDisplacement_m);
    EXPECT_NEAR(error_px(sheet, truth, 2.0 * kDisplacement_m), once, 0.3 * once + 0.1) << trial;
  }
}

TEST_F(DisplacedTags, LeaveExactMapAccurate) {
  for (int trial = 0; trial < 5; ++trial) {
    const CameraPose truth = random_view(random_);
    EXPECT_LT(error_px(tags_, truth, kDisplacement_m), 0.25) << trial;
  }
}

TEST_F(DisplacedTags, GiveFinitePosesForExtremeSigmas) {
  const CameraPose truth = random_view(random_);
  const double exact = error_px(tags_, truth, 0.0);
  for (const double sigma_m : {1e-300, 1e-12, 1.0, 1e6, 1e150, 1e300}) {
    const double error = error_px(tags_, truth, sigma_m);
    EXPECT_TRUE(std::isfinite(error)) << sigma_m;
    EXPECT_LT(error, exact + 1.0) << sigma_m;
  }
}

}  // namespace
}  // namespace penumbra
