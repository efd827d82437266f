// Row time of a survey whose camera moves in front of the tags. Every row is exposed at its time.
#include "calib/survey/row_time.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <vector>

#include "core/units.hpp"
#include "support/cameras.hpp"
#include "support/rolling_camera.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

constexpr double kInterval_s = 1.0 / 30.0;
constexpr double kNoise_px = 0.03;

// `row_s` 0: global shutter; `speed` 0: the camera turns about the table only slowly.
std::vector<SurveyFrame> moving_sweep(const CameraModel& camera,
                                      const std::vector<MappedTag>& board, double row_s,
                                      double speed, int count = 48) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::vector<SurveyFrame> frames;
  for (int k = 0; k < count; ++k) {
    SurveyFrame frame;
    frame.time_s = k * kInterval_s;
    for (const MappedTag& tag : board) {
      MeasuredTag measured;
      measured.covariance = kNoise_px * kNoise_px * Matrix8d::Identity();
      const auto corners = tag.corners();
      bool visible = true;
      for (std::size_t i = 0; i < 4; ++i) {
        const Eigen::Vector2d pixel =
            test::rolling_pixel(camera, corners[i], frame.time_s, row_s, speed);
        visible = visible && pixel.x() > 4.0 && pixel.y() > 4.0 &&
                  pixel.x() < camera.width() - 5.0 && pixel.y() < camera.height() - 5.0;
        measured.corners_px[i] =
            pixel + kNoise_px * Eigen::Vector2d(normal(random), normal(random));
      }
      if (!visible) continue;
      frame.tags.push_back({});
      frame.tags.back().id = tag.id;
      frame.tags.back().corners_px = measured.corners_px;
      frame.measured.push_back(measured);
    }
    frames.push_back(std::move(frame));
  }
  return frames;
}

class RowTimeOfSweep : public testing::Test {
 protected:
  [[nodiscard]] TagSurvey survey(const std::vector<SurveyFrame>& frames) const {
    SurveyOptions options;
    options.tag_size_m = 0.04;
    auto result = survey_tags(camera_, frames, options);
    if (!result) throw std::runtime_error(result.error().message);
    return *std::move(result);
  }
  CameraModel camera_ = test::desk_camera();
  std::vector<MappedTag> board_ = test::board(4, 3, 0.04);
};

TEST_F(RowTimeOfSweep, IsFoundInFewRounds) {
  for (const double row_s : {10e-6, 20e-6, 40e-6}) {
    const auto frames = moving_sweep(camera_, board_, row_s, 1.0);
    CameraModel rolling = camera_;
    TagSurvey map = survey(frames);
    double sigma_s = 0.0;
    for (int round = 0; round < 5; ++round) {
      const auto found = find_row_time(rolling, map, frames, round > 0);
      ASSERT_TRUE(found) << row_s;
      sigma_s = found->sigma_s;
      rolling = test::with_row_time(camera_, found->seconds);
      map = survey(at_middle_row(rolling, map, frames));
    }
    const double error_s = std::abs(*rolling.parameters().rolling_shutter_row_s - row_s);
    EXPECT_LT(error_s, 4.0 * sigma_s) << row_s;
    EXPECT_LT(error_s, 0.02 * row_s) << row_s;
  }
}

TEST_F(RowTimeOfSweep, IsNotFoundForGlobalShutterOrCameraAtRest) {
  for (const auto& [row_s, speed] : {std::pair(0.0, 1.0), std::pair(0.0, 0.0)}) {
    const auto frames = moving_sweep(camera_, board_, row_s, speed);
    EXPECT_FALSE(find_row_time(camera_, survey(frames), frames)) << row_s << ' ' << speed;
  }
  auto rest = moving_sweep(camera_, board_, 40e-6, 1.0);
  for (SurveyFrame& frame : rest) {
    const double time_s = frame.time_s;
    frame = rest.front();
    frame.time_s = time_s;
  }
  EXPECT_FALSE(find_row_time(camera_, survey(rest), rest));
}

TEST_F(RowTimeOfSweep, ReplacesOnlyWrongRowTimeOfCamera) {
  constexpr double kRow_s = 40e-6;
  const auto frames = moving_sweep(camera_, board_, kRow_s, 1.0);
  const auto found_with = [&](double given_s) {
    const CameraModel given = test::with_row_time(camera_, given_s);
    TagSurvey map = survey(frames);
    for (int round = 0; round < 3; ++round) map = survey(at_middle_row(given, map, frames));
    return find_row_time(given, map, frames);
  };
  EXPECT_FALSE(found_with(kRow_s));
  for (const double wrong_s : {25e-6, 55e-6}) {
    const auto found = found_with(wrong_s);
    ASSERT_TRUE(found) << wrong_s;
    EXPECT_NEAR(found->seconds, kRow_s, 4e-6) << wrong_s;
  }
}

// A tag that the survey rejected, perhaps because of the shutter, may fit after the correction.
TEST_F(RowTimeOfSweep, CorrectsRejectedTags) {
  constexpr double kRow_s = 40e-6;
  const CameraModel rolling = test::with_row_time(camera_, kRow_s);
  const auto frames = moving_sweep(camera_, board_, kRow_s, 1.0);
  TagSurvey map = survey(frames);
  for (int round = 0; round < 4; ++round) map = survey(at_middle_row(rolling, map, frames));
  const auto with_all = at_middle_row(rolling, map, frames);
  const int rejected = map.tags.front().tag.id;  // far from the middle row
  std::erase_if(map.tags, [&](const SurveyedTag& tag) { return tag.tag.id == rejected; });
  const auto without = at_middle_row(rolling, map, frames);
  int compared = 0;
  double largest_px = 0.0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (std::size_t i = 0; i < frames[f].tags.size(); ++i) {
      if (frames[f].tags[i].id != rejected) continue;
      ++compared;
      for (std::size_t c = 0; c < 4; ++c) {
        const Eigen::Vector2d moved =
            with_all[f].tags[i].corners_px[c] - frames[f].tags[i].corners_px[c];
        const Eigen::Vector2d moved_too =
            without[f].tags[i].corners_px[c] - frames[f].tags[i].corners_px[c];
        largest_px = std::max(largest_px, moved.norm());
        EXPECT_NEAR((moved - moved_too).norm(), 0.0, 0.3) << f;
      }
    }
  }
  EXPECT_GT(compared, 20);
  EXPECT_GT(largest_px, 1.0) << "the test needs fast motion";
}

TEST_F(RowTimeOfSweep, CorrectsCornersAndMap) {
  constexpr double kRow_s = 40e-6;
  const CameraModel rolling = test::with_row_time(camera_, kRow_s);
  const auto frames = moving_sweep(camera_, board_, kRow_s, 1.0);
  const auto truth = moving_sweep(camera_, board_, 0.0, 1.0);
  TagSurvey map = survey(frames);
  const double rms_before_px = map.rms_px;
  for (int round = 0; round < 4; ++round) map = survey(at_middle_row(rolling, map, frames));
  const auto corrected = at_middle_row(rolling, map, frames);
  double before = 0.0;
  double after = 0.0;
  for (std::size_t f = 0; f < frames.size(); ++f) {
    ASSERT_EQ(corrected[f].tags.size(), frames[f].tags.size());
    for (std::size_t i = 0; i < frames[f].tags.size(); ++i) {
      const auto same = std::ranges::find(truth[f].tags, frames[f].tags[i].id, &TagDetection::id);
      if (same == truth[f].tags.end()) continue;
      for (std::size_t c = 0; c < 4; ++c) {
        const Eigen::Vector2d& expected = same->corners_px[c];
        before += (frames[f].tags[i].corners_px[c] - expected).squaredNorm();
        after += (corrected[f].measured[i]->corners_px[c] - expected).squaredNorm();
        EXPECT_EQ(corrected[f].tags[i].corners_px[c], corrected[f].measured[i]->corners_px[c]);
      }
    }
  }
  EXPECT_LT(after, 0.02 * before);
  EXPECT_LT(map.rms_px, 0.5 * rms_before_px);
}

TEST_F(RowTimeOfSweep, LeavesCornersWithoutRowTime) {
  const auto frames = moving_sweep(camera_, board_, 0.0, 1.0, 12);
  const auto same = at_middle_row(camera_, survey(frames), frames);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    for (std::size_t i = 0; i < frames[f].tags.size(); ++i)
      EXPECT_EQ(same[f].tags[i].corners_px, frames[f].tags[i].corners_px);
  }
}

// Times that are equal, decreasing, far apart or not numbers give no velocity.
TEST_F(RowTimeOfSweep, IgnoresUnusableTimes) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const CameraModel rolling = test::with_row_time(camera_, 40e-6);
  auto frames = moving_sweep(camera_, board_, 40e-6, 1.0, 16);
  const TagSurvey map = survey(frames);
  for (const double interval_s : {0.0, -kInterval_s, 10.0, 1e300, kNaN, kInfinity}) {
    SCOPED_TRACE(interval_s);
    for (std::size_t f = 0; f < frames.size(); ++f)
      frames[f].time_s = static_cast<double>(f) * interval_s;
    EXPECT_FALSE(find_row_time(camera_, map, frames));
    const auto corrected = at_middle_row(rolling, map, frames);
    for (std::size_t f = 0; f < frames.size(); ++f) {
      for (std::size_t i = 0; i < frames[f].tags.size(); ++i)
        EXPECT_EQ(corrected[f].tags[i].corners_px, frames[f].tags[i].corners_px);
    }
  }
  // Tiny intervals give huge velocities.
  for (std::size_t f = 0; f < frames.size(); ++f) frames[f].time_s = 1e-9 * static_cast<double>(f);
  if (const auto found = find_row_time(camera_, map, frames)) {
    EXPECT_TRUE(std::isfinite(found->seconds) && std::isfinite(found->sigma_s));
  }
  for (const SurveyFrame& frame : at_middle_row(rolling, map, frames)) {
    for (const TagDetection& tag : frame.tags) {
      for (const Eigen::Vector2d& corner : tag.corners_px) EXPECT_TRUE(corner.allFinite());
    }
  }
  EXPECT_FALSE(find_row_time(camera_, map, {}));
}

}  // namespace
}  // namespace penumbra
