// The guide accepts views that add information and rejects others.
#include "calib/report/view_guide.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <array>
#include <random>

#include "core/units.hpp"
#include "support/calibration_views.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

// The information of the single views adds up to the solver's.
TEST(ViewInformation, AddsUpToSolverCovariance) {
  std::mt19937 rng(5);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  const auto views = test::simulate_views(truth, board, {}, rng);
  const auto solved = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(solved) << solved.error().message;
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(9, 9);
  for (const CalibrationView& view : views) {
    const auto information = view_information(solved->camera, board, view.corners);
    ASSERT_TRUE(information);
    sum += *information;
  }
  const Eigen::MatrixXd expected =
      sum.inverse() * solved->noise_px * solved->noise_px * solved->covariance_inflation;
  for (int i = 0; i < 9; ++i)
    EXPECT_NEAR(expected(i, i) / solved->covariance(i, i), 1.0, 0.02) << i;
}

// The edges of tags shift by an unknown amount per view, which reduces the information about tag
// sizes.
TEST(ViewInformation, AddsUpToSolverCovarianceForTags) {
  std::mt19937 rng(6);
  const CameraModel truth = test::desk_camera();
  const auto board = test::flat_board();
  auto views = test::simulate_views(truth, board, {}, rng);
  auto plain = views;
  for (CalibrationView& view : views) {
    for (TargetCorner& corner : view.corners)  // a tag is a square of 2 x 2 points
      corner.spread = {corner.point % 9 % 2 == 0 ? -1.0 : 1.0,
                       corner.point / 9 % 2 == 0 ? -1.0 : 1.0};
  }
  const auto solved = solve_intrinsics(640, 480, board, views);
  ASSERT_TRUE(solved) << solved.error().message;
  Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(9, 9);
  Eigen::MatrixXd without = sum;
  for (std::size_t v = 0; v < views.size(); ++v) {
    const auto information = view_information(solved->camera, board, views[v].corners);
    const auto more = view_information(solved->camera, board, plain[v].corners);
    ASSERT_TRUE(information && more);
    sum += *information;
    without += *more;
  }
  const double noise = solved->noise_px * solved->noise_px * solved->covariance_inflation;
  const Eigen::MatrixXd expected = sum.inverse() * noise;
  for (int i = 0; i < 9; ++i)
    EXPECT_NEAR(expected(i, i) / solved->covariance(i, i), 1.0, 0.02) << i;
  EXPECT_GT((without - sum).norm(), 1e-4 * sum.norm()) << "the shift must reduce the information";
}

class ViewGuideTest : public testing::Test {
 protected:
  [[nodiscard]] GreyImage image(const Eigen::Vector3d& at, double distance_m, double elevation,
                                double azimuth) {
    PatternRenderOptions options;
    options.samples = 32;
    options.noise_grey = 1.0;
    options.seed = ++seed_;
    return renderer_.render(std::array{test::looking_at(at, distance_m, elevation, azimuth, 0.0)},
                            options);
  }

  CameraModel camera_ = test::desk_camera();
  std::vector<MappedTag> board_ = test::board(4, 3, 0.04);
  PatternRenderer renderer_ = PatternRenderer::create(camera_, board_).value();
  static GuideOptions options() {
    GuideOptions options;
    options.goal_px = 1.2;
    return options;
  }
  ViewGuide guide_ =
      ViewGuide::create(tag_target(TagMap::make(board_).value()).value(), options()).value();
  std::uint64_t seed_ = 0;
};

TEST_F(ViewGuideTest, AcceptsInformativeViewsUntilLensIsKnown) {
  EXPECT_THAT(guide_.progress().advice, testing::HasSubstr("show the target"));

  double before_px = 1e9;
  for (int k = 0; k < 40 && !guide_.progress().enough; ++k) {
    const Eigen::Vector3d at(0.14 * ((k * 7) % 5 - 2) / 2.0, 0.08 * ((k * 3) % 3 - 1), 0.0);
    const GreyImage view =
        image(at, 0.3 + 0.07 * (k % 4), radians(30.0 + 15.0 * (k % 4)), radians(80.0 * k));
    (void)guide_.look(view.view());  // the target has just appeared and still moves
    (void)guide_.look(view.view());
    if (const auto px = guide_.progress().largest_px) {
      EXPECT_LT(*px, 2.0 * before_px);
      before_px = *px;
    }
  }
  const GuideProgress& progress = guide_.progress();
  EXPECT_TRUE(progress.enough) << progress.advice << ' ' << progress.image << ' ' << progress.size
                               << ' ' << progress.tilt << ' ' << progress.certainty;
  EXPECT_LE(*progress.largest_px, options().goal_px);
  EXPECT_THAT(progress.lens, testing::StartsWith("plumb_bob"));
  // A repeated view adds no information.
  const GreyImage again = image({0.0, 0.0, 0.0}, 0.4, radians(60.0), radians(80.0));
  (void)guide_.look(again.view());
  (void)guide_.look(again.view());
  const GuideResult look = guide_.look(again.view());
  EXPECT_FALSE(look.taken);
  EXPECT_LT(look.gain, 0.03);
}

TEST_F(ViewGuideTest, ReportsWhyImageIsRejected) {
  const std::vector<std::uint8_t> grey(640 * 480, 128);
  EXPECT_EQ(guide_.look({grey.data(), 640, 480, 640}).why, "no tag of the target is seen");
  const GreyImage one = image({0.0, 0.0, 0.0}, 0.5, radians(80.0), 0.0);
  const GreyImage other = image({0.04, 0.0, 0.0}, 0.5, radians(80.0), 0.0);
  EXPECT_TRUE(guide_.look(one.view()).taken);
  EXPECT_EQ(guide_.look(other.view()).why, "it moves: hold still");
  EXPECT_EQ(guide_.look(one.view()).why, "it moves: hold still");
  EXPECT_EQ(guide_.look(one.view()).why, "too much like a view before");
  EXPECT_EQ(guide_.progress().views, 1);
}

}  // namespace
}  // namespace penumbra
