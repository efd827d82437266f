#include "tracking/pose_confidence.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>

#include "core/evaluation/evaluation.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

class PoseConfidence : public ::testing::Test {
 protected:
  // Returns a measurement with this predicted overlay error.
  [[nodiscard]] Measurement measured(double error_px) const {
    Measurement measurement;
    measurement.best.T_map_camera = pose_;
    measurement.best.covariance = covariance_of(error_px);
    measurement.tags_used = 6;
    measurement.aligned = true;
    return measurement;
  }
  [[nodiscard]] Matrix6d covariance_of(double error_px) const {
    const double unit = predicted_overlay_error_px(group_.camera, pose_, Matrix6d::Identity());
    return error_px * error_px / (unit * unit) * Matrix6d::Identity();
  }
  // Adds a second pose, rotated about the table's x axis.
  void add_second(Measurement& measurement, double turn_rad) const {
    measurement.second = measurement.best;
    const Transform<frame::Map, frame::Map> turn(
        Eigen::Quaterniond(Eigen::AngleAxisd(turn_rad, Eigen::Vector3d::UnitX())),
        Eigen::Vector3d::Zero());
    measurement.second->T_map_camera = turn * pose_;
    measurement.ambiguous = true;
  }

  const RigidTags group_{test::wide_camera(), test::board(3, 2, 0.06)};
  const MapFromCamera pose_ =
      as_map_pose(test::looking_at(Eigen::Vector3d::Zero(), 0.5, 1.0, 0.3, 0.0));
};

TEST_F(PoseConfidence, TracksPoseBelowLimit) {
  const AssessedPose judged = judge(group_, measured(1.0), std::nullopt);
  EXPECT_EQ(judged.estimate.status, TrackStatus::tracked);
  EXPECT_NEAR(judged.estimate.predicted_overlay_error_px, 1.0, 1e-6);
  EXPECT_EQ(judged.estimate.reason.cause, PoseCause::none);
}

TEST_F(PoseConfidence, IsUncertainAboveLimit) {
  const AssessedPose judged = judge(group_, measured(3.0), std::nullopt);
  EXPECT_EQ(judged.estimate.status, TrackStatus::uncertain);
  EXPECT_EQ(text_of(judged.estimate.reason), "predicted error 3.0 px");
  EXPECT_FALSE(judged.only_lens_uncertain);
}

TEST_F(PoseConfidence, IsUncertainWhenTagsAreInconsistent) {
  Measurement measurement = measured(0.1);
  measurement.inconsistent = true;
  EXPECT_EQ(judge(group_, measurement, std::nullopt).estimate.reason.cause,
            PoseCause::inconsistent_tags);
}

TEST_F(PoseConfidence, IsUncertainWhenTwoPosesFit) {
  Measurement measurement = measured(0.1);
  add_second(measurement, 0.4);
  EXPECT_EQ(judge(group_, measurement, std::nullopt).estimate.reason.cause, PoseCause::two_poses);
}

TEST_F(PoseConfidence, ChoosesBetweenTwoPosesByPrediction) {
  Measurement measurement = measured(0.1);
  add_second(measurement, 0.4);
  const MapFromCamera second = measurement.second->T_map_camera;
  const AssessedPose best = judge(group_, measurement, pose_);
  EXPECT_EQ(best.estimate.status, TrackStatus::tracked);
  EXPECT_EQ(best.estimate.T_map_camera.matrix(), pose_.matrix());
  const AssessedPose other = judge(group_, measurement, second);
  EXPECT_EQ(other.estimate.status, TrackStatus::tracked);
  EXPECT_EQ(other.estimate.T_map_camera.matrix(), second.matrix());
}

TEST_F(PoseConfidence, AttributesErrorToLensWhenOnlyCameraFileIsUncertain) {
  CameraParameters parameters = group_.camera.parameters();
  parameters.overlay_sigma_px = 5.0;
  const RigidTags group{CameraModel::make(parameters).value(), group_.tags};
  const AssessedPose judged = judge(group, measured(1.0), std::nullopt);
  EXPECT_EQ(judged.estimate.status, TrackStatus::uncertain);
  EXPECT_THAT(text_of(judged.estimate.reason), HasSubstr("the lens is known to"));
  EXPECT_TRUE(judged.only_lens_uncertain);
}

TEST_F(PoseConfidence, AttributesErrorToMapWhenItAddsError) {
  Measurement measurement = measured(3.0);
  measurement.map_px = 2.9;
  EXPECT_THAT(text_of(judge(group_, measurement, std::nullopt).estimate.reason),
              HasSubstr("are inconsistent with the map"));
}

TEST_F(PoseConfidence, EnlargesErrorOfDetectedPoseForMissedTags) {
  Measurement measurement = measured(0.5);
  measurement.aligned = false;
  measurement.tags_used = 1;
  ASSERT_EQ(group_.in_view(pose_), 6);
  const AssessedPose judged = judge(group_, measurement, std::nullopt);
  EXPECT_NEAR(judged.estimate.predicted_overlay_error_px, 0.5 * std::sqrt(6.0), 1e-6);
}

TEST_F(PoseConfidence, ReportsRejectedTags) {
  Measurement measurement = measured(0.5);
  measurement.rejected = {4};
  EXPECT_THAT(judge(group_, measurement, std::nullopt).estimate.tags_rejected,
              testing::ElementsAre(RejectedTag{group_.tags[4].id, TagRejection::inconsistent}));
}

}  // namespace
}  // namespace penumbra
