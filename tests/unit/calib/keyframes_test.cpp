// Choice of the frames from which a tag map is refined.
#include "calib/refinement/keyframes.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

class MapKeyframesTest : public testing::Test {
 protected:
  MapKeyframesTest() {
    CameraParameters p;
    p.width = 64;
    p.height = 48;
    p.fx = p.fy = 200.0;
    p.cx = 31.5;
    p.cy = 23.5;
    camera_ = CameraModel::make(p).value();
    pixels_.assign(std::size_t{64} * 48, 128);
    keyframes_.emplace(camera_, TagMap::make(test::board(3, 2, 0.06)).value());
  }
  [[nodiscard]] ImageView image() const { return {pixels_.data(), 64, 48, 64}; }
  static CameraPose pose_at(double azimuth_deg, double elevation_deg = 60.0) {
    return test::looking_at({0.0, 0.0, 0.0}, 0.6, radians(elevation_deg), radians(azimuth_deg),
                            0.0);
  }
  bool add(const CameraPose& pose) { return add(image(), pose); }
  bool add(ImageView luma, const CameraPose& pose) {
    return keyframes_->add(luma, kInterval_ns * count_++, pose);
  }

  CameraModel camera_;
  std::vector<std::uint8_t> pixels_;
  std::optional<MapKeyframes> keyframes_;
  std::int64_t count_ = 0;  // number of frames
  static constexpr std::int64_t kInterval_ns = 33'333'333;
};

TEST_F(MapKeyframesTest, KeepsOneOfManyFramesFromTheSamePlace) {
  for (int i = 0; i < 50; ++i) EXPECT_FALSE(add(pose_at(0.01 * (i % 3))));
  EXPECT_EQ(keyframes_->kept().size(), 1U);
  EXPECT_EQ(keyframes_->added(), 1);
}

TEST_F(MapKeyframesTest, RequestsRefinementAfterEveryEightKeyframes) {
  std::vector<int> due;
  for (int i = 0; keyframes_->kept().size() < 24; ++i) {
    ASSERT_LT(i, 100);
    if (add(pose_at(4.0 * i))) due.push_back(static_cast<int>(keyframes_->kept().size()));
  }
  EXPECT_THAT(due, testing::ElementsAre(8, 16, 24));
}

TEST_F(MapKeyframesTest, KeepsAtMostThirtyTwoThatAreFarApart) {
  int refinements = 0;
  for (int i = 0; i < 3000; ++i) {
    refinements += add(pose_at(1.5 * i, 25.0 + 0.02 * i)) ? 1 : 0;
    ASSERT_LE(keyframes_->kept().size(), MapKeyframes::kMaxKeyframes);
  }
  EXPECT_GT(keyframes_->added(), 40);
  EXPECT_LT(keyframes_->added(), 500);
  EXPECT_GT(refinements, 4);
  EXPECT_LT(refinements, 40);
  const KeyframeList& kept = keyframes_->kept();
  const auto held_out =
      std::ranges::count_if(kept, [](const auto& keyframe) { return keyframe->held_out; });
  EXPECT_GE(held_out, 2);
  EXPECT_LT(2 * held_out, std::ssize(kept));
  for (const auto& a : kept) {
    for (const auto& b : kept) {
      if (a != b) {
        EXPECT_GT((a->camera_m - b->camera_m).norm(), 0.03 * 0.6);
      }
    }
  }
}

TEST_F(MapKeyframesTest, SkipsFramesWhileTheViewMovesFast) {
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(add(pose_at(90.0 * i)));
  EXPECT_TRUE(keyframes_->kept().empty());
}

TEST_F(MapKeyframesTest, SkipsInvalidPosesAndImages) {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e300}) {
    const CameraPose pose(Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, bad, 0.5));
    for (int i = 0; i < 3; ++i) EXPECT_FALSE(add(pose));
  }
  const CameraPose no_rotation(Eigen::Quaterniond(0.0, 0.0, 0.0, 0.0), Eigen::Vector3d::Ones());
  EXPECT_FALSE(add(no_rotation));
  const ImageView half{pixels_.data(), 32, 48, 64};
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(add(half, pose_at(4.0 * i)));
  EXPECT_FALSE(add(ImageView(), pose_at(0.0)));
  for (const auto& keyframe : keyframes_->kept()) EXPECT_TRUE(keyframe->camera_m.allFinite());
}

// A camera at a constant angular velocity about the vertical axis.
TEST_F(MapKeyframesTest, HasVelocityFromNeighbouringFrames) {
  constexpr double kTurn_deg = 0.5;  // per frame
  for (int i = 0; i < 3; ++i) (void)add(pose_at(kTurn_deg * i));
  ASSERT_EQ(keyframes_->kept().size(), 1U);
  ASSERT_TRUE(keyframes_->kept().front()->velocity);
  const Vector6d velocity = *keyframes_->kept().front()->velocity;
  const double turn = radians(kTurn_deg) / (static_cast<double>(kInterval_ns) * 1e-9);
  EXPECT_NEAR(velocity.tail<3>().norm(), turn, 1e-3 * turn);
  EXPECT_NEAR(velocity.head<3>().norm(), turn * 0.6 * std::cos(radians(60.0)), 1e-3 * turn);
}

TEST_F(MapKeyframesTest, CopiesRowsWithoutPadding) {
  std::vector<std::uint8_t> padded(std::size_t{100} * 48, 7);
  padded[100] = 9;  // first pixel of the second row
  const ImageView view{padded.data(), 64, 48, 100};
  (void)add(view, pose_at(0.0));
  (void)add(view, pose_at(0.1));
  ASSERT_EQ(keyframes_->kept().size(), 1U);
  const ImageView copy = keyframes_->kept().front()->luma();
  EXPECT_EQ(copy.row(1)[0], 9);
  EXPECT_EQ(copy.row(47)[63], 7);
}

}  // namespace
}  // namespace penumbra
