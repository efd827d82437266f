// Calibration from images to a camera file: which images are rejected and why, and whether other
// programs can read the file.
#include "calib/camera_calibration.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <opencv2/core.hpp>
#include <random>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/image/image_file.hpp"
#include "support/calibration_views.hpp"
#include "support/recording_folder.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

GreyImage box_blurred(GreyImage image, int rounds) {
  for (int round = 0; round < rounds; ++round) {
    const GreyImage before = image;
    for (int y = 1; y + 1 < image.height; ++y) {
      for (int x = 1; x + 1 < image.width; ++x) {
        int sum = 0;
        for (int v = -1; v <= 1; ++v) {
          for (int u = -1; u <= 1; ++u) sum += before.view().row(y + v)[x + u];
        }
        image.pixels[static_cast<std::size_t>(y * image.width + x)] =
            static_cast<std::uint8_t>((sum + 4) / 9);
      }
    }
  }
  return image;
}

GreyImage mirrored(GreyImage image) {
  for (int y = 0; y < image.height; ++y) {
    const auto row = image.pixels.begin() + static_cast<std::ptrdiff_t>(y) * image.width;
    std::reverse(row, row + image.width);
  }
  return image;
}

TEST(CameraCalibrator, RejectsBlurredPartialMirroredAndRepeatedImages) {
  const CameraModel camera = test::wide_camera();
  const auto board = test::board(4, 3, 0.04);
  auto renderer = PatternRenderer::create(camera, board);
  ASSERT_TRUE(renderer);
  std::uint64_t seed = 0;
  const auto image_from = [&](const Eigen::Vector3d& at, double distance_m, double elevation,
                              double azimuth) {
    PatternRenderOptions options;
    options.samples = 32;
    options.noise_grey = 1.0;
    options.seed = ++seed;
    return renderer->render(std::array{test::looking_at(at, distance_m, elevation, azimuth, 0.0)},
                            options);
  };
  CalibrationOptions options;
  options.model = DistortionModel::plumb_bob;
  options.shape = BoardShape::rigid;
  auto calibrator =
      CameraCalibrator::create(tag_target(TagMap::make(board).value()).value(), options);
  ASSERT_TRUE(calibrator);
  const auto add = [&](const char* name, const GreyImage& image) {
    const auto added = calibrator->add(name, image.view());
    EXPECT_TRUE(added);
  };
  std::vector<GreyImage> good;
  for (int k = 0; k < 9; ++k) {
    const Eigen::Vector3d at(0.05 * (k % 3 - 1), 0.04 * (k / 3 - 1), 0.0);
    good.push_back(
        image_from(at, 0.38 + 0.05 * (k % 4), radians(40.0 + 12.0 * (k % 4)), radians(80.0 * k)));
    add(("view " + std::to_string(k)).c_str(), good.back());
  }
  add("blurred", box_blurred(image_from({0.0, 0.02, 0.0}, 0.4, radians(55.0), radians(33.0)), 12));
  add("again", good[4]);
  add("cut off", image_from({0.25, 0.15, 0.0}, 0.3, radians(75.0), radians(90.0)));
  for (const std::size_t k : {2U, 5U, 7U}) add("mirrored", mirrored(good[k]));
  const auto result = calibrator->finish();
  ASSERT_TRUE(result) << result.error().message;
  ASSERT_EQ(result->images.size(), 15U);
  for (std::size_t k = 0; k < 9; ++k) EXPECT_EQ(result->images[k].left_out, "") << k;
  EXPECT_THAT(result->images[9].left_out, StartsWith("blurred: edges are "));
  EXPECT_EQ(result->images[10].left_out, "the same view as view 4");
  EXPECT_THAT(result->images[11].left_out, StartsWith("only 1 of 12 tags are seen whole"));
  for (std::size_t k = 12; k < 15; ++k) {
    EXPECT_THAT(result->images[k].left_out, StartsWith("the images are mirrored")) << k;
  }
  EXPECT_EQ(result->solution.views.size(), 9U);
  EXPECT_LT(projection_difference(camera, result->solution.camera).mean_px, 2.0);
}

// A sweep of 36 images for 8 views: surplus images are rejected and freed during the sweep.
TEST(CameraCalibrator, FreesSurplusImagesOfLongSweep) {
  const CameraModel camera = test::wide_camera();
  const auto board = test::board(4, 3, 0.04);
  auto renderer = PatternRenderer::create(camera, board);
  ASSERT_TRUE(renderer);
  constexpr int kImages = 36;
  std::vector<GreyImage> sweep;
  for (int k = 0; k < kImages; ++k) {
    PatternRenderOptions options;
    options.samples = 8;
    options.seed = static_cast<std::uint64_t>(k + 1);
    // A slow sweep, in which neighbouring images are similar.
    const double t = 2.0 * M_PI * k / kImages;
    const Eigen::Vector3d at(0.05 * std::cos(t), 0.04 * std::sin(2.0 * t), 0.0);
    sweep.push_back(renderer->render(
        std::array{test::looking_at(at, 0.42 + 0.06 * std::sin(3.0 * t),
                                    radians(60.0 + 15.0 * std::cos(5.0 * t)), 2.0 * t, 0.0)},
        options));
  }
  CalibrationOptions options;
  options.model = DistortionModel::plumb_bob;
  options.shape = BoardShape::rigid;
  options.max_views = 8;
  auto calibrator =
      CameraCalibrator::create(tag_target(TagMap::make(board).value()).value(), options);
  for (const GreyImage& image : sweep) {
    EXPECT_TRUE(calibrator->add("an image", image.view()));
    EXPECT_LE(calibrator->images_in_memory(), 2 * options.max_views);
  }
  std::vector<SolvingStep> steps;
  const auto found =
      calibrator->finish({}, [&](const SolvingStep& step) { steps.push_back(step); });
  ASSERT_TRUE(found) << found.error().message;
  ASSERT_EQ(steps.size(), 6U);
  for (std::size_t i = 0; i < steps.size(); ++i) {
    EXPECT_EQ(steps[i].step, static_cast<int>(i) + 1) << steps[i].what;
    EXPECT_EQ(steps[i].max_step, 6) << steps[i].what;
  }
  EXPECT_EQ(steps[4].what, "plumb_bob, rigid board");
  EXPECT_EQ(found->solution.views.size(), 8U);
  int surplus = 0;
  for (const CalibrationImage& image : found->images) {
    if (image.reason != ImageRejection::surplus) continue;
    ++surplus;
    EXPECT_EQ(image.luma.capacity() + image.view.corners.capacity(), 0U);
  }
  EXPECT_EQ(surplus, kImages - 8);
  EXPECT_LT(projection_difference(camera, found->solution.camera).mean_px, 2.0);
}

TEST(ReportedRejections, ListOneImagePerRepeatedReason) {
  std::vector<CalibrationImage> images(8);
  images[1].reason = ImageRejection::blurred;
  for (const std::size_t i : {2U, 4U, 5U}) images[i].reason = ImageRejection::surplus;
  for (const std::size_t i : {3U, 7U}) images[i].reason = ImageRejection::seen_before;
  using Reported = std::vector<std::optional<int>>;
  const std::nullopt_t no = std::nullopt;
  EXPECT_EQ(images_to_report(images, 3), (Reported{no, 0, 0, 0, 0, 0, no, 0}));
  EXPECT_EQ(images_to_report(images, 2), (Reported{no, 0, 2, 0, no, no, no, 0}));
  EXPECT_EQ(images_to_report(images, 1), (Reported{no, 0, 2, 1, no, no, no, no}));
}

// Tags printed at another size than in the file, and corner shifts with another cause.
TEST(TagSizeMismatch, IsFoundFromShiftsThatGrowWithTagSize) {
  std::mt19937 rng(3);
  std::normal_distribution<double> noise(0.0, 0.02);
  std::uniform_real_distribution<double> size(25.0, 70.0);
  const auto size_error_of_views = [&](double size_error, double everywhere_px, std::size_t views) {
    std::vector<double> sizes;
    std::vector<double> shifts;
    for (std::size_t v = 0; v < views; ++v) {
      sizes.push_back(size(rng));
      shifts.push_back(everywhere_px + 0.5 * size_error * sizes.back() + noise(rng));
    }
    return tag_size_error_of(sizes, shifts);
  };
  for (int run = 0; run < 200; ++run) {
    EXPECT_FALSE(size_error_of_views(0.0, 0.4, 20));
    EXPECT_FALSE(size_error_of_views(0.005, -0.4, 20)) << "within the tolerance of paper";
    for (const double wrong : {-0.05, -0.02, 0.02, 0.05}) {
      const auto found = size_error_of_views(wrong, 0.4, 20);
      ASSERT_TRUE(found) << wrong;
      EXPECT_NEAR(*found, wrong, 0.005);
    }
  }
  EXPECT_FALSE(size_error_of_views(0.05, 0.0, 5)) << "too few views";
  EXPECT_FALSE(tag_size_error_of(std::vector<double>(20, 40.0), std::vector<double>(20, 0.5)));
  EXPECT_FALSE(
      tag_size_error_of(std::vector<double>(20, std::nan("")), std::vector<double>(20, 0.5)));
}

TEST(ProjectionDifference, ReportsFractionOfImageNotCompared) {
  const CameraModel camera = test::desk_camera();
  EXPECT_EQ(projection_difference(camera, camera).skipped, 0.0);
  CameraParameters p = camera.parameters();
  p.distortion = {-0.6};  // monotonic only up to half of the image's radius
  const CameraModel folds = CameraModel::make(p).value();
  const double skipped = projection_difference(folds, camera).skipped;
  EXPECT_GT(skipped, 0.05);
  EXPECT_LT(skipped, 1.0);
}

// OpenCV must read the same digits from the written file.
TEST(CalibratedCameraFile, IsReadByOpenCvWithSameNumbers) {
  const test::TemporaryFolder folder;
  for (const CameraModel& camera : {test::desk_camera(), test::wide_lens()}) {
    const auto file = folder.path() / "camera.yml";
    CalibrationRecord record;
    record.calibrated_on = "2026-03-01";
    record.target = "6 x 6 tags of 30 mm: \"true\"";
    record.standard_deviations = {1.0, 2.0, 0.1};
    record.focus_position = 20.0;
    ASSERT_TRUE(save_camera(file, camera, CameraFileFormat::opencv, &record));
    cv::FileStorage read(file.string(), cv::FileStorage::READ);
    ASSERT_TRUE(read.isOpened());
    const CameraParameters& p = camera.parameters();
    cv::Mat matrix;
    cv::Mat distortion;
    read["camera_matrix"] >> matrix;
    read["distortion_coefficients"] >> distortion;
    EXPECT_EQ(static_cast<int>(read["image_width"]), p.width);
    EXPECT_EQ(static_cast<int>(read["image_height"]), p.height);
    EXPECT_EQ(static_cast<int>(read["fisheye_model"]), p.model == DistortionModel::fisheye ? 1 : 0);
    ASSERT_EQ(matrix.type(), CV_64F);
    ASSERT_EQ(matrix.size(), cv::Size(3, 3));
    EXPECT_EQ(matrix.at<double>(0, 0), p.fx);
    EXPECT_EQ(matrix.at<double>(1, 1), p.fy);
    EXPECT_EQ(matrix.at<double>(0, 2), p.cx);
    EXPECT_EQ(matrix.at<double>(1, 2), p.cy);
    EXPECT_EQ(matrix.at<double>(2, 2), 1.0);
    ASSERT_EQ(distortion.type(), CV_64F);
    ASSERT_EQ(static_cast<int>(distortion.total()), coefficient_count(p.model));
    for (int i = 0; i < coefficient_count(p.model); ++i)
      EXPECT_EQ(distortion.at<double>(i), p.distortion[static_cast<std::size_t>(i)]);
  }
}

TEST(CalibratedCameraFile, OmitsNonFiniteValues) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "camera.yaml";
  CalibrationRecord record;
  record.projection_mean_px = std::nan("");
  record.projection_largest_px = std::numeric_limits<double>::infinity();
  record.held_out_px = std::nan("");
  record.standard_deviations = {1.0, std::nan("")};
  record.table_tracked_px = {std::nan("")};
  ASSERT_TRUE(save_camera(file, test::desk_camera(), CameraFileFormat::ros, &record));
  const std::string text = test::read_bytes(file);
  EXPECT_THAT(text, testing::Not(HasSubstr(": nan")));
  EXPECT_THAT(text, testing::Not(HasSubstr(": inf")));
  EXPECT_TRUE(load_camera(file));
}

TEST(TagTarget, RejectsCurvedTags) {
  auto board = test::board(2, 2, 0.04);
  board[3].curvature.xy = 0.1;
  const auto target = tag_target(TagMap::make(board).value());
  ASSERT_FALSE(target);
  EXPECT_NE(target.error().message.find("surface of tag 3: a target must be flat"),
            std::string::npos);
}

}  // namespace
}  // namespace penumbra
