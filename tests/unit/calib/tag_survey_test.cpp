// Sweeps over loose tags, with corners that are exact but for what each test does to them.
#include "calib/tag_survey.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

// Views of a board from 0.5 to 1.1 m; the edges of the black squares lie `shift_px` further out
// than they should.
std::vector<SurveyFrame> sweep(const CameraModel& camera, const std::vector<MappedTag>& board,
                               double shift_px) {
  std::vector<SurveyFrame> frames;
  for (int k = 0; k < 12; ++k) {
    const double distance = 0.5 + 0.05 * k;
    const CameraPose pose =
        test::looking_at({0.0, 0.0, 0.0}, distance, radians(50.0 + 7.0 * (k % 5)),
                         radians(75.0 * k), radians(4.0 * k));
    SurveyFrame frame;
    for (const MappedTag& tag : board) {
      const auto T_camera_table = pose.inverse();
      MappedTag larger = tag;
      const double depth = (T_camera_table * tag.T_table_tag.translation()).z();
      larger.size_m += 2.0 * shift_px * depth / camera.parameters().fx;
      TagDetection seen;
      seen.id = tag.id;
      const auto corners = larger.corners();
      for (std::size_t i = 0; i < 4; ++i)
        seen.corners_px[i] = camera.project(T_camera_table * corners[i]).value();
      frame.tags.push_back(seen);
    }
    frames.push_back(std::move(frame));
  }
  return frames;
}

double pitch(const TagSurvey& survey) {
  return (survey.tags[1].tag.T_table_tag.translation() -
          survey.tags[0].tag.T_table_tag.translation())
      .norm();
}

class TagSurveyTest : public testing::Test {
 protected:
  CameraModel camera_ = test::wide_camera();
  std::vector<MappedTag> board_ = test::board(3, 2, 0.06);
  SurveyOptions options_ = [] {
    SurveyOptions options;
    options.tag_size_m = 0.06;
    return options;
  }();
};

TEST_F(TagSurveyTest, FindsTheShiftThatAToneCurveMakes) {
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 0.2), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_NEAR(survey->edge_shift_px, 0.2, 0.05);
  EXPECT_NEAR(pitch(*survey), 0.08, 1e-4);
}

TEST_F(TagSurveyTest, BelievesNoShiftThatIsTooLargeForOne) {
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 1.2), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_EQ(survey->edge_shift_px, 0.0);
}

TEST_F(TagSurveyTest, LeavesTheShiftOutWhenAsked) {
  options_.edge_shift = false;
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 0.0), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_EQ(survey->edge_shift_px, 0.0);
  EXPECT_NEAR(pitch(*survey), 0.08, 1e-6);
  const auto shifted = survey_tags(camera_, sweep(camera_, board_, 0.2), options_);
  ASSERT_TRUE(shifted) << shifted.error().message;
  EXPECT_EQ(shifted->edge_shift_px, 0.0);
}

}  // namespace
}  // namespace penumbra
