// Corners measured from all edges of a tag, on images with exact truth.
#include "calib/survey/tag_edges.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <array>

#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

class TagEdges : public testing::Test {
 protected:
  // Errors of measured corners over several views.
  struct Errors {
    double rms_px = 0.0;   // RMS distance from the true corners
    double size_px = 0.0;  // mean excess of the corners' distance from the tag's centre
    double chi2 = 0.0;     // mean square of a coordinate's error, normalised by the covariance
    int tags = 0;
    Eigen::Vector2d shift = Eigen::Vector2d::Zero();
  };

  [[nodiscard]] Errors measure(const PatternRenderOptions& render, double distance_m = 0.6) const {
    const CameraModel camera = test::wide_camera();
    const auto board = test::board(3, 2, 0.06);
    PatternRenderer renderer = PatternRenderer::create(camera, board).value();
    Errors errors;
    for (int k = 0; k < 6; ++k) {
      const CameraPose pose = test::looking_at({0.0, 0.0, 0.0}, distance_m, radians(45.0 + 8.0 * k),
                                               radians(70.0 * k), radians(5.0 * k));
      PatternRenderOptions options = render;
      options.seed += static_cast<std::uint64_t>(k);
      options.samples = 96;
      const GreyImage image = renderer.render(std::array{pose}, options);
      // The predicted pose has the error of a first survey.
      Vector6d off;
      off << 2e-4, -1e-4, 3e-4, 4e-4, -3e-4, 2e-4;
      const auto predicted = perturbed(pose, off).inverse();
      for (const MappedTag& tag : board) {
        const TagPattern pattern = TagPattern::make(tag.family, tag.id).value();
        const auto measured =
            measure_tag(image.view(), camera, pattern, tag, predicted * tag.T_table_tag);
        if (!measured) continue;
        Eigen::Matrix<double, 8, 1> e;
        std::array<Eigen::Vector2d, 4> truth;
        Eigen::Vector2d centre = Eigen::Vector2d::Zero();
        for (std::size_t i = 0; i < 4; ++i) {
          truth[i] = camera.project(pose.inverse() * tag.corners()[i]).value();
          centre += 0.25 * truth[i];
        }
        for (std::size_t i = 0; i < 4; ++i) {
          const Eigen::Vector2d d = measured->corners_px[i] - truth[i];
          e.segment<2>(static_cast<Eigen::Index>(2 * i)) = d;
          errors.rms_px += d.squaredNorm() / 4.0;
          errors.size_px += d.dot((truth[i] - centre).normalized()) / 4.0;
        }
        errors.chi2 += e.dot(measured->covariance.inverse() * e) / 8.0;
        errors.shift += measured->edge_shift_px;
        ++errors.tags;
      }
    }
    errors.rms_px = std::sqrt(errors.rms_px / errors.tags);
    errors.size_px /= errors.tags;
    errors.chi2 /= errors.tags;
    errors.shift /= errors.tags;
    return errors;
  }
};

TEST_F(TagEdges, MatchPrintedPositions) {
  PatternRenderOptions render;
  render.noise_grey = 2.0;
  const Errors errors = measure(render);
  EXPECT_EQ(errors.tags, 36);
  EXPECT_LT(errors.rms_px, 0.03);
  EXPECT_NEAR(errors.size_px, 0.0, 0.01);
  EXPECT_NEAR(errors.shift.norm(), 0.0, 0.02);
}

TEST_F(TagEdges, ShiftWithCameraResponseButKeepCorners) {
  PatternRenderOptions render;
  render.noise_grey = 2.0;
  render.gamma = 2.2;
  const Errors errors = measure(render);
  EXPECT_EQ(errors.tags, 36);
  EXPECT_LT(errors.shift.maxCoeff(), -0.1);  // white bleeds into black
  EXPECT_LT(errors.rms_px, 0.035);
  EXPECT_NEAR(errors.size_px, 0.0, 0.015);
}

TEST_F(TagEdges, PropagateNoiseToCovariance) {
  PatternRenderOptions render;
  render.noise_grey = 12.0;
  const Errors errors = measure(render);
  EXPECT_GE(errors.tags, 34);
  EXPECT_GT(errors.chi2, 0.3);
  EXPECT_LT(errors.chi2, 3.0);
}

// Sums the equations of views from all sides, as a survey does.
TEST_F(TagEdges, DetermineCurvatureOfPaper) {
  const CameraModel camera = test::wide_camera();
  auto board = test::board(3, 2, 0.06);
  for (std::size_t i = 0; i < board.size(); ++i)
    board[i].curvature = {i % 2 == 0 ? 1.5 : -1.0, i % 3 == 0 ? 0.6 : -0.3, i < 3 ? 0.0 : 0.8};
  PatternRenderer renderer = PatternRenderer::create(camera, board).value();
  std::vector<MappedTag> assumed = test::board(3, 2, 0.06);
  struct View {
    CameraPose pose;
    GreyImage image;
  };
  std::vector<View> views;
  for (int k = 0; k < 6; ++k) {
    const CameraPose pose = test::looking_at({0.0, 0.0, 0.0}, 0.55, radians(40.0 + 5.0 * k),
                                             radians(75.0 * k), radians(9.0 * k));
    PatternRenderOptions options;
    options.noise_grey = 2.0;
    options.samples = 48;
    options.seed = static_cast<std::uint64_t>(k) + 1;
    views.push_back({pose, renderer.render(std::array{pose}, options)});
  }
  constexpr int kRounds = 2;  // the second is linearised at the first's result
  for (int round = 0; round < kRounds; ++round) {
    std::vector<Eigen::Matrix3d> information(board.size(), Eigen::Matrix3d::Zero());
    std::vector<Eigen::Vector3d> gradient(board.size(), Eigen::Vector3d::Zero());
    for (const View& view : views) {
      for (std::size_t i = 0; i < board.size(); ++i) {
        const TagPattern pattern = TagPattern::make(board[i].family, board[i].id).value();
        const auto measured = measure_tag(view.image.view(), camera, pattern, assumed[i],
                                          view.pose.inverse() * board[i].T_table_tag);
        ASSERT_TRUE(measured);
        information[i] += measured->curvature.information;
        gradient[i] += measured->curvature.gradient;
      }
    }
    for (std::size_t i = 0; i < board.size(); ++i) {
      const Eigen::Vector3d change = information[i].ldlt().solve(gradient[i]);
      TagCurvature& c = assumed[i].curvature;
      c = {c.xx + change.x(), c.xy + change.y(), c.yy + change.z()};
    }
  }
  for (std::size_t i = 0; i < board.size(); ++i) {
    // 0.05 1/m is a height of 0.02 mm on this tag.
    EXPECT_NEAR(assumed[i].curvature.xx, board[i].curvature.xx, 0.05) << i;
    EXPECT_NEAR(assumed[i].curvature.xy, board[i].curvature.xy, 0.05) << i;
    EXPECT_NEAR(assumed[i].curvature.yy, board[i].curvature.yy, 0.05) << i;
  }
}

TEST_F(TagEdges, AreNotMeasuredOnNarrowCellsOrHiddenTags) {
  EXPECT_EQ(measure({}, 3.2).tags, 0);
  PatternRenderOptions hidden;
  hidden.covered_fraction = 0.6;
  EXPECT_EQ(measure(hidden).tags, 0);
}

}  // namespace
}  // namespace penumbra
