// Surveys of loose tags. Corners are exact except for the errors that a test adds.
#include "calib/survey/tag_survey.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <random>
#include <vector>

#include "core/units.hpp"
#include "support/paths.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

// Views of a board from 0.5 to 1.1 m. The edges of the black squares are shifted outwards by
// `shift_px`.
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

TEST_F(TagSurveyTest, EstimatesEdgeShiftOfCameraResponse) {
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 0.2), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_NEAR(survey->edge_shift_px, 0.2, 0.05);
  EXPECT_NEAR(pitch(*survey), 0.08, 1e-4);
}

TEST_F(TagSurveyTest, RejectsImplausiblyLargeEdgeShift) {
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 1.2), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_EQ(survey->edge_shift_px, 0.0);
}

// Runs a complete survey: images, detection, first survey, edges, second survey.
Result<TagSurvey> survey_images(const CameraModel& camera, const std::vector<MappedTag>& board,
                                const std::vector<GreyImage>& images,
                                const SurveyOptions& options) {
  TagDetector detector = TagDetector::create(std::array{TagFamily::tag36h11}).value();
  std::vector<SurveyFrame> frames;
  for (const GreyImage& image : images) frames.push_back({detector.detect(image.view()), {}});
  const auto first = survey_tags(camera, frames, options);
  if (!first) return first;
  for (std::size_t f = 0; f < frames.size(); ++f)
    frames[f] = measured_frame(*first, f, frames[f], images[f].view());
  EXPECT_EQ(first->tags.size(), board.size());
  return survey_tags(camera, frames, options);
}

std::vector<GreyImage> render_views(const CameraModel& camera, const std::vector<MappedTag>& board,
                                    int count, std::uint64_t seed) {
  PatternRenderer renderer = PatternRenderer::create(camera, board).value();
  std::vector<GreyImage> images;
  for (int k = 0; k < count; ++k) {
    const CameraPose pose =
        test::looking_at({0.01 * (k % 3), 0.0, 0.0}, 0.5 + 0.03 * (k % 6),
                         radians(40.0 + 9.0 * (k % 5)), radians(75.0 * k), radians(4.0 * k));
    PatternRenderOptions render;
    render.gamma = 2.2;
    render.noise_grey = 3.0;
    render.samples = 64;
    render.seed = seed + static_cast<std::uint64_t>(k);
    images.push_back(renderer.render(std::array{pose}, render));
  }
  return images;
}

TEST_F(TagSurveyTest, RemovesCameraResponseBiasByEdges) {
  const auto images = render_views(camera_, board_, 12, 1);
  const auto survey = survey_images(camera_, board_, images, options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_LT(survey->rms_px, 0.06);
  // On these images, the detector's corners alone would increase the tags' spacing by 0.4 mm.
  EXPECT_NEAR(pitch(*survey), 0.08, 2.5e-5);
  double squares = 0.0;
  int count = 0;
  const Eigen::Vector3d anchor = board_[0].T_table_tag.translation();
  for (std::size_t i = 1; i < board_.size(); ++i) {
    const Eigen::Vector3d error = survey->tags[i].tag.T_table_tag.translation() -
                                  (board_[i].T_table_tag.translation() - anchor);
    const Eigen::Matrix2d covariance = survey->tags[i].covariance.topLeftCorner<2, 2>();
    squares += error.head<2>().dot(covariance.inverse() * error.head<2>());
    count += 2;
  }
  EXPECT_LT(squares / count, 4.0) << "the covariance is too small";
  EXPECT_GT(squares / count, 0.01) << "the covariance is far too large";
}

TEST_F(TagSurveyTest, RefinesCameraWhenRequested) {
  CameraParameters off = camera_.parameters();
  off.fx *= 1.02;
  off.fy *= 1.02;
  off.distortion[0] += 0.02;
  off.overlay_sigma_px = 3.0;
  const CameraModel given = CameraModel::make(off).value();
  options_.refine_camera = true;
  const auto frames = sweep(camera_, board_, 0.0);
  const auto survey = survey_tags(given, frames, options_);
  ASSERT_TRUE(survey) << survey.error().message;
  // 19.6 px off before; the prior about the given lens leaves a small part.
  EXPECT_NEAR(survey->camera.parameters().fx, camera_.parameters().fx, 0.2);
  EXPECT_NEAR(survey->camera.parameters().cy, camera_.parameters().cy, 0.2);
  EXPECT_EQ(survey->lens_covariance.rows(), 9);
  EXPECT_FALSE(survey->camera.parameters().overlay_sigma_px)
      << "the value describes the camera before refinement";
  options_.refine_camera = false;
  const auto unrefined = survey_tags(given, frames, options_);
  ASSERT_TRUE(unrefined) << unrefined.error().message;
  EXPECT_EQ(unrefined->camera.parameters().fx, off.fx);
  EXPECT_EQ(unrefined->camera.parameters().overlay_sigma_px, 3.0);
  EXPECT_GT(unrefined->rms_px, 10.0 * survey->rms_px);
}

// The anchor tag is tilted by a pencil under it, and another tag stands upright.
TEST_F(TagSurveyTest, FitsTablePlaneToMostTags) {
  const Eigen::Quaterniond tilted(
      Eigen::AngleAxisd(radians(3.0), Eigen::Vector3d(1.0, 1.0, 0.0).normalized()));
  board_[0].T_table_tag = {tilted,
                           board_[0].T_table_tag.translation() + 0.006 * Eigen::Vector3d::UnitZ()};
  MappedTag wall;
  wall.id = 9;
  wall.size_m = 0.06;
  wall.T_table_tag = {
      Eigen::Quaterniond(Eigen::AngleAxisd(radians(40.0), Eigen::Vector3d::UnitX())),
      Eigen::Vector3d(0.0, 0.15, 0.04)};
  board_.push_back(wall);
  const auto frames = sweep(camera_, board_, 0.0);
  const auto survey = survey_tags(camera_, frames, options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_EQ(survey->tags_on_plane, 5);
  EXPECT_NEAR(survey->tags[5].tag.T_table_tag.translation().z(), 0.0, 1e-4);
  EXPECT_NEAR(survey->plane_tilt_rad, radians(3.0), radians(0.05));
  const Eigen::Vector3d up = survey->tags[5].tag.T_table_tag.rotation() * Eigen::Vector3d::UnitZ();
  EXPECT_LT(std::acos(up.z()), radians(0.05));
  EXPECT_NEAR(survey->tags[6].tag.T_table_tag.translation().z(), 0.04, 1e-4);
  options_.plane = SurveyPlane::anchor;
  const auto anchored = survey_tags(camera_, frames, options_);
  ASSERT_TRUE(anchored) << anchored.error().message;
  EXPECT_EQ(anchored->tags_on_plane, 1);
  EXPECT_EQ(anchored->tags[0].tag.T_table_tag.translation().norm(), 0.0);
  EXPECT_TRUE(anchored->tags[0].covariance.isZero());
  const Eigen::Vector3d tipped =
      anchored->tags[5].tag.T_table_tag.rotation() * Eigen::Vector3d::UnitZ();
  EXPECT_NEAR(std::acos(tipped.z()), radians(3.0), radians(0.05));
}

// A tag whose size differs from the given one is rejected and reported with its measured size. The
// other tags are not affected.
TEST_F(TagSurveyTest, RejectsAndReportsTagOfWrongSize) {
  for (const double factor : {0.5, 0.9, 1.5, 3.0}) {
    SCOPED_TRACE(factor);
    auto board = board_;
    board[4].size_m *= factor;
    const auto frames = sweep(camera_, board, 0.0);
    const auto survey = survey_tags(camera_, frames, options_);
    ASSERT_TRUE(survey) << survey.error().message;
    ASSERT_EQ(survey->left_out.size(), 1U);
    EXPECT_THAT(survey->left_out[0], testing::StartsWith(fmt::format(
                                         "tag 4: appears to be {:.1f} mm in size, but 60.0 mm is "
                                         "given",
                                         60.0 * factor)));
    ASSERT_EQ(survey->tags.size(), 5U);
    EXPECT_NEAR(pitch(*survey), 0.08, 1e-5);
    EXPECT_EQ(survey->tags[1].frames, 12);
    ASSERT_EQ(survey->misfits.size(), 1U);
    EXPECT_NEAR(survey->misfits[0].size_m, 0.06 * factor, 1e-5);
    const Eigen::Vector3d at =
        board_[4].T_table_tag.translation() - board_[0].T_table_tag.translation();
    EXPECT_LT((survey->misfits[0].T_table_tag.translation() - at).norm(), 1e-4);
    // With the corrected size all tags fit.
    auto corrected = options_;
    corrected.sizes_m[4] = survey->misfits[0].size_m;
    const auto again = survey_tags(camera_, frames, corrected);
    ASSERT_TRUE(again) << again.error().message;
    EXPECT_TRUE(again->left_out.empty());
    EXPECT_EQ(again->tags.size(), 6U);
  }
}

TEST_F(TagSurveyTest, ReportsInconsistentAnchor) {
  board_[0].size_m *= 1.4;
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 0.0), options_);
  ASSERT_FALSE(survey);
  EXPECT_THAT(survey.error().message,
              testing::StartsWith("the anchor, tag 0: appears to be 84.0 mm in size, but 60.0 mm"));
}

TEST_F(TagSurveyTest, ReportsSizeOfTagWithoutGivenSize) {
  options_.tag_size_m.reset();
  for (int id = 0; id < 5; ++id) options_.sizes_m[id] = 0.06;
  board_[5].size_m = 0.045;
  const auto survey = survey_tags(camera_, sweep(camera_, board_, 0.0), options_);
  ASSERT_TRUE(survey) << survey.error().message;
  EXPECT_EQ(survey->tags.size(), 5U);
  EXPECT_THAT(
      survey->left_out,
      testing::ElementsAre("tag 5: has no size, and appears to be 45.0 mm; give its size with "
                           "--sizes"));
}

// The tag is moved during the sweep, early or late.
TEST_F(TagSurveyTest, RejectsAndReportsMovedTag) {
  for (const std::size_t when : {std::size_t{3}, std::size_t{6}, std::size_t{9}}) {
    for (const int id : {3, 0}) {  // tag 0 is the anchor
      SCOPED_TRACE(fmt::format("tag {} at {}", id, when));
      auto frames = sweep(camera_, board_, 0.0);
      auto moved = board_;
      const auto i = static_cast<std::size_t>(id);
      moved[i].T_table_tag = {moved[i].T_table_tag.rotation(),
                              moved[i].T_table_tag.translation() + Eigen::Vector3d(0.01, 0.0, 0.0)};
      const auto after = sweep(camera_, moved, 0.0);
      std::copy(after.begin() + static_cast<std::ptrdiff_t>(when), after.end(),
                frames.begin() + static_cast<std::ptrdiff_t>(when));
      const auto survey = survey_tags(camera_, frames, options_);
      const std::string words = fmt::format("tag {}: moved by 10.0 mm at about frame {}", id, when);
      if (id == options_.anchor) {
        ASSERT_FALSE(survey);
        EXPECT_THAT(survey.error().message, testing::StartsWith("the anchor, " + words));
        continue;
      }
      ASSERT_TRUE(survey) << survey.error().message;
      ASSERT_EQ(survey->left_out.size(), 1U);
      EXPECT_THAT(survey->left_out[0], testing::StartsWith(words));
      EXPECT_EQ(survey->tags.size(), 5U);
      EXPECT_NEAR(pitch(*survey), 0.08, 1e-5);
    }
  }
}

// In two frames the corners of a tag are displaced, as if it were partly hidden. These frames do
// not count for the tag.
TEST_F(TagSurveyTest, CountsOnlyInlierFramesOfTag) {
  auto frames = sweep(camera_, board_, 0.0);
  for (const std::size_t f : {2U, 7U}) {
    for (Eigen::Vector2d& corner : frames[f].tags[2].corners_px)
      corner += Eigen::Vector2d(9.0, 4.0 * static_cast<double>(f));
  }
  const auto survey = survey_tags(camera_, frames, options_);
  ASSERT_TRUE(survey) << survey.error().message;
  ASSERT_EQ(survey->tags.size(), 6U) << survey->left_out.front();
  EXPECT_EQ(survey->tags[2].frames, 10);
  EXPECT_EQ(survey->tags[3].frames, 12);
}

// Errors follow the survey's model: independent noise per corner with the given covariance, plus an
// error along the edges of each tag that is common to all frames. Over many surveys, the normalised
// squared errors of the tags' poses must follow a chi-square distribution.
TEST_F(TagSurveyTest, PredictsCovarianceConsistentWithErrors) {
  constexpr int kSurveys = 60;
  constexpr double kNoise = 0.08;    // [px], per coordinate
  constexpr double kCommon = 0.025;  // [px]
  for (const SurveyPlane plane : {SurveyPlane::anchor, SurveyPlane::fitted}) {
    options_.plane = plane;
    std::mt19937 random(11);
    std::normal_distribution<double> normal;
    std::map<int, double> squares;
    const auto exact = sweep(camera_, board_, 0.0);
    for (int k = 0; k < kSurveys; ++k) {
      auto frames = exact;
      std::vector<std::array<Eigen::Vector2d, 4>> common(board_.size());
      for (auto& corners : common) {
        for (auto& corner : corners)
          corner = kCommon * Eigen::Vector2d(normal(random), normal(random));
      }
      for (SurveyFrame& frame : frames) {
        frame.measured.assign(frame.tags.size(), std::nullopt);
        for (std::size_t i = 0; i < frame.tags.size(); ++i) {
          auto& corners = frame.tags[i].corners_px;
          const Eigen::Vector2d a =
              (corners[1] - corners[0] + corners[2] - corners[3]).normalized();
          const Eigen::Vector2d b =
              (corners[3] - corners[0] + corners[2] - corners[1]).normalized();
          for (std::size_t c = 0; c < 4; ++c) {
            corners[c] += common[i][c].x() * a + common[i][c].y() * b +
                          kNoise * Eigen::Vector2d(normal(random), normal(random));
          }
          MeasuredTag measured;
          measured.corners_px = corners;
          measured.covariance = kNoise * kNoise * Matrix8d::Identity();
          frame.measured[i] = measured;
        }
      }
      const auto survey = survey_tags(camera_, frames, options_);
      ASSERT_TRUE(survey) << survey.error().message;
      ASSERT_EQ(survey->tags.size(), board_.size());
      for (std::size_t i = 1; i < board_.size(); ++i) {  // tag 0 is the anchor
        const SurveyedTag& tag = survey->tags[i];
        Eigen::Matrix<double, 6, 1> error;
        error.head<3>() = tag.tag.T_table_tag.translation() - (board_[i].T_table_tag.translation() -
                                                               board_[0].T_table_tag.translation());
        const Eigen::AngleAxisd turn(tag.tag.T_table_tag.rotation());
        error.tail<3>() = turn.angle() * turn.axis();
        squares[tag.tag.id] += error.dot(tag.covariance.ldlt().solve(error));
      }
    }
    // 6 degrees of freedom per tag: the expected value is 6, and the mean over n surveys has a
    // standard deviation of sqrt(12 / n). The survey inflates the covariance if errors of
    // neighbouring frames correlate, even by chance, but never deflates it. On average, the
    // covariance is therefore about 1/6 too large.
    for (const auto& [id, sum] : squares) {
      const double mean = sum / kSurveys;
      EXPECT_LT(mean, 6.0 + 3.0 * std::sqrt(12.0 / kSurveys)) << id;
      EXPECT_GT(mean, 4.0) << id;
    }
  }
}

// Exact corners with equations for the curvature (0, 0, yy) of each tag. `yy`: by frame [1/m].
std::vector<SurveyFrame> curved_sweep(const CameraModel& camera,
                                      const std::vector<MappedTag>& board, std::size_t count,
                                      const std::function<double(std::size_t)>& yy) {
  std::vector<SurveyFrame> frames = sweep(camera, board, 0.0);
  frames.resize(count);
  for (std::size_t f = 0; f < count; ++f) {
    for (const TagDetection& tag : frames[f].tags) {
      MeasuredTag measured;
      measured.corners_px = tag.corners_px;
      measured.covariance = 1e-4 * Matrix8d::Identity();
      measured.curvature.information = 100.0 * Eigen::Matrix3d::Identity();
      measured.curvature.gradient = Eigen::Vector3d(0.0, 0.0, 100.0 * yy(f));
      frames[f].measured.push_back(measured);
    }
  }
  return frames;
}

TEST_F(TagSurveyTest, AcceptsCurvatureThatHalvesOfFramesAgreeOn) {
  for (const std::size_t count : {3U, 4U, 5U, 8U, 12U}) {
    const auto survey = survey_tags(
        camera_, curved_sweep(camera_, board_, count, [](std::size_t) { return 1.5; }), options_);
    ASSERT_TRUE(survey) << survey.error().message;
    EXPECT_TRUE(survey->is_curved) << count << " frames";
    for (const SurveyedTag& tag : survey->tags) {
      EXPECT_NEAR(tag.tag.curvature.xx, 0.0, 1e-9);
      EXPECT_NEAR(tag.tag.curvature.yy, 1.5, 0.01);
    }
  }
}

TEST_F(TagSurveyTest, TakesPaperAsFlatWhenHalvesDisagreeOrHeightsAreTiny) {
  const auto is_curved = [&](const std::function<double(std::size_t)>& yy) {
    const auto survey = survey_tags(camera_, curved_sweep(camera_, board_, 8, yy), options_);
    EXPECT_TRUE(survey);
    return survey && survey->is_curved;
  };
  EXPECT_FALSE(is_curved([](std::size_t f) { return f % 2 == 0 ? 1.5 : -1.5; }));
  // Heights of 0.012 mm at the middles of sides: 1/5000 of the size.
  EXPECT_FALSE(is_curved([](std::size_t) { return 0.0275; }));
  EXPECT_TRUE(is_curved([](std::size_t) { return 0.15; }));
}

TEST_F(TagSurveyTest, WritesOnlyCurvaturesThatCanBeRead) {
  const test::TemporaryFolder folder;
  for (const double yy : {-1e6, 15.0, 16.6666, 16.67, 1e6, 1e300}) {
    const auto survey = survey_tags(
        camera_, curved_sweep(camera_, board_, 8, [yy](std::size_t) { return yy; }), options_);
    ASSERT_TRUE(survey) << survey.error().message;
    const auto file = folder.path() / "tags.yaml";
    ASSERT_TRUE(save_tag_survey(file, *survey));
    const auto read = load_tag_map(file);
    ASSERT_TRUE(read) << yy << ": " << read.error().message;
    EXPECT_EQ(read->tags().size(), board_.size());
  }
}

}  // namespace
}  // namespace penumbra
