#include "core/camera/camera_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "core/text/text.hpp"
#include "support/cameras.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

std::string camera_text(const std::string& model = "distortion_model: plumb_bob",
                        const std::string& coefficients = "[-0.2, 0.06, 0.0008, -0.0006, -0.004]",
                        const std::string& matrix = "[500, 0, 320.5, 0, 510, 240, 0, 0, 1]",
                        const std::string& width = "640") {
  return "%YAML 1.1\n---\nimage_width: " + width + "\nimage_height: 480\ncamera_name: \"desk\"\n" +
         "camera_matrix:\n  rows: 3\n  cols: 3\n  data: " + matrix + "\n" + model +
         "\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: " + coefficients +
         "\nfx: 1.0\nsomething_else: {a: [1, 2]}\n";
}

class CameraFile : public testing::Test {
 protected:
  Result<CameraModel> load(std::string_view text) {
    EXPECT_TRUE(write_text_file(file_, text));
    return load_camera(file_);
  }
  void refuses(std::string_view text, const char* what) {
    const Result<CameraModel> read = load(text);
    ASSERT_FALSE(read) << text;
    EXPECT_THAT(read.error().message,
                testing::AllOf(testing::HasSubstr("camera.yaml"), testing::HasSubstr(what)));
  }
  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "camera.yaml";
};

TEST_F(CameraFile, PrefersMatrixOverFlatNumbers) {
  const auto camera = load(camera_text());
  ASSERT_TRUE(camera) << camera.error().message;
  const CameraParameters& p = camera->parameters();
  EXPECT_EQ(p.width, 640);
  EXPECT_EQ(p.height, 480);
  EXPECT_EQ(p.fx, 500.0);
  EXPECT_EQ(p.fy, 510.0);
  EXPECT_EQ(p.cx, 320.5);
  EXPECT_EQ(p.cy, 240.0);
  EXPECT_EQ(p.name, "desk");
  EXPECT_EQ(p.model, DistortionModel::plumb_bob);
  EXPECT_THAT(p.distortion, testing::ElementsAre(-0.2, 0.06, 0.0008, -0.0006, -0.004, 0, 0, 0));
}

TEST_F(CameraFile, ReadsEveryModelUnderBothKeys) {
  EXPECT_TRUE(load(camera_text("camera_model: plumb_bob", "[1e-3, 0, 0, 0]")));
  EXPECT_EQ(
      load(camera_text("distortion_model: rational_polynomial", "[0.1, 0.2, 0, 0, 0, 0.1, 0, 0]"))
          ->parameters()
          .model,
      DistortionModel::rational);
  EXPECT_EQ(
      load(camera_text("distortion_model: equidistant", "[0.1, 0, 0, 0]"))->parameters().model,
      DistortionModel::fisheye);
  EXPECT_EQ(load(camera_text("camera_model: fisheye", "[0.1, 0, 0, 0]"))->parameters().model,
            DistortionModel::fisheye);
}

TEST_F(CameraFile, ReportsFileAndFieldOfError) {
  refuses("", "map");
  refuses(camera_text("distortion_model: omnidirectional"), "omnidirectional");
  refuses(camera_text("distortion_model: plumb_bob", "[1, 2]"), "distortion_coefficients");
  refuses(camera_text("distortion_model: equidistant", "[0, 0, 0, 0, 0.1]"), "equidistant has 4");
  refuses(camera_text("distortion_model: plumb_bob", "[0, nan, 0, 0, 0]"), "data");
  refuses(camera_text("distortion_model: plumb_bob", "[0, 0, 0, 0, 0]", "[500, 0, 320]"),
          "camera_matrix: data");
  refuses(camera_text("distortion_model: plumb_bob", "[0, 0, 0, 0, 0]",
                      "[500, 3, 320, 0, 500, 240, 0, 0, 1]"),
          "skew");
  refuses(camera_text("distortion_model: plumb_bob", "[0, 0, 0, 0, 0]",
                      "[-500, 0, 320, 0, 500, 240, 0, 0, 1]"),
          "fx");
  refuses(camera_text("distortion_model: plumb_bob", "[0, 0, 0, 0, 0]",
                      "[500, 0, 320, 0, 500, 240, 0, 0, 1]", "wide"),
          "image_width");
  refuses("image_width: 640\nimage_height: 480\n", "camera_matrix: is missing");
  refuses(camera_text() + "tone_curve: bright\n", "tone_curve");
  refuses(camera_text() + "tone_curve: -2\n", "tone_curve");
  refuses(camera_text() + "tone_curv: 2\n", "did you mean `tone_curve`?");
  refuses(camera_text() + "rolling_shutter_row: 0.00003\n", "`rolling_shutter_row_s`?");
  for (const char* others : {"rolling_shutter: true\n", "rolling: 1\n", "tone: warm\n"})
    EXPECT_TRUE(load(camera_text() + others)) << "keys of other tools must be accepted: " << others;
  refuses(camera_text() + "uncertainty: {overlay_pix: 3}\n", "`overlay_px`?");
  refuses(camera_text() + "uncertainty: {overlay: 3}\n", "`overlay_px`?");
  refuses(camera_text() + "rolling_shutter_row_s: 0.001\n", "480 rows then take 0.48 s");
  refuses(camera_text() + "uncertainty: 3\n", "uncertainty");
  refuses(camera_text() + "uncertainty: {overlay_px: much}\n", "overlay_px");
  refuses(camera_text() + "uncertainty: {overlay_px: -1}\n", "overlay_px");
  refuses(camera_text() + "uncertainty: {table_volume: {tracked_px: [.nan]}}\n", "tracked_px");
  refuses("image_width: [\n", "line");
  EXPECT_FALSE(load_camera(folder_.path() / "absent.yaml"));
}

TEST_F(CameraFile, ReadsOverlayErrorOfLens) {
  EXPECT_FALSE(load(camera_text())->parameters().overlay_sigma_px);
  EXPECT_FALSE(load(camera_text() + "uncertainty: {views: 3}\n")->parameters().overlay_sigma_px);
  const auto of_corners =
      load(camera_text() + "uncertainty: {table_volume: {tracked_px: [3, 4, 0, 0]}}\n");
  ASSERT_TRUE(of_corners) << of_corners.error().message;
  EXPECT_EQ(of_corners->parameters().overlay_sigma_px, 2.5);
  EXPECT_EQ(scaled_to(*of_corners, 320, 240)->parameters().overlay_sigma_px, 1.25);
  // The record has the keys that `calibrate` writes.
  CalibrationRecord record;
  record.table_tracked_px = {3.0, 4.0, 0.0, 0.0};
  record.table_known_pose_px = {5.0, 5.0, 5.0, 5.0};
  for (const auto format : {CameraFileFormat::ros, CameraFileFormat::opencv}) {
    ASSERT_TRUE(save_camera(file_, *of_corners, format, &record));
    const auto read = load_camera(file_);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->parameters().overlay_sigma_px, 2.5);
  }
}

TEST_F(CameraFile, KeepsCalibrationRecord) {
  const CameraModel camera = test::pinhole_camera(0.25);
  const auto saved = [&](const CalibrationRecord& record, CameraFileFormat format) {
    EXPECT_TRUE(save_camera(file_, camera, format, &record));
    const auto loaded = load_calibration_record(file_, camera);
    EXPECT_TRUE(loaded && *loaded) << (loaded ? "no record" : loaded.error().message);
    return loaded && *loaded ? **loaded : CalibrationRecord();
  };
  CalibrationRecord record;
  record.calibrated_on = "2026-03-01";
  record.target = "6 x 6 tags of 30 mm";
  record.views = 24;
  record.rms_px = 0.125;
  record.held_out_px = 0.25;
  record.projection_mean_px = 0.5;
  record.projection_largest_px = 1.5;
  record.table_tracked_px = {3.0, 4.0};
  record.table_known_pose_px = {5.0, 6.0};
  record.table_distance_m = 0.75;
  record.standard_deviations = {0.5, 0.25, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  record.focus_position = 30.0;
  record.tone_curve_sigma = 0.0625;
  record.row_time_sigma_s = 1e-6;
  for (const auto format : {CameraFileFormat::ros, CameraFileFormat::opencv}) {
    const CalibrationRecord read = saved(record, format);
    EXPECT_EQ(read.calibrated_on, record.calibrated_on);
    EXPECT_EQ(read.target, record.target);
    EXPECT_EQ(read.views, record.views);
    EXPECT_EQ(read.rms_px, record.rms_px);
    EXPECT_EQ(read.held_out_px, record.held_out_px);
    EXPECT_EQ(read.projection_mean_px, record.projection_mean_px);
    EXPECT_EQ(read.projection_largest_px, record.projection_largest_px);
    EXPECT_EQ(read.table_tracked_px, record.table_tracked_px);
    EXPECT_EQ(read.table_known_pose_px, record.table_known_pose_px);
    EXPECT_EQ(read.table_distance_m, record.table_distance_m);
    EXPECT_EQ(read.standard_deviations, record.standard_deviations);
    EXPECT_EQ(read.focus_position, record.focus_position);
    EXPECT_EQ(read.tone_curve_sigma, record.tone_curve_sigma);
    EXPECT_EQ(read.row_time_sigma_s, record.row_time_sigma_s);
    // A record that was read is written again unchanged.
    const std::string before = read_text_file(file_, 1 << 20).value();
    ASSERT_TRUE(save_camera(file_, camera, format, &read));
    EXPECT_EQ(read_text_file(file_, 1 << 20).value(), before);
  }
  // A record without the lens keeps the lens's overlay error.
  CalibrationRecord of_shutter;
  of_shutter.row_time_sigma_s = 1e-6;
  const CalibrationRecord read = saved(of_shutter, CameraFileFormat::ros);
  EXPECT_TRUE(read.standard_deviations.empty());
  EXPECT_TRUE(std::isnan(read.rms_px));
  EXPECT_EQ(load_camera(file_)->parameters().overlay_sigma_px, 0.25);
  // Non-finite numbers are not written.
  record.standard_deviations[1] = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(saved(record, CameraFileFormat::ros).standard_deviations.empty());
}

TEST_F(CameraFile, HasNoRecordWithoutItsKeys) {
  const CameraModel camera = test::pinhole_camera();
  ASSERT_TRUE(save_camera(file_, camera));
  const auto none = load_calibration_record(file_, camera);
  ASSERT_TRUE(none);
  EXPECT_FALSE(*none);
  EXPECT_FALSE(*load_calibration_record(file_.string() + ".missing", camera));
}

TEST_F(CameraFile, RejectsInvalidStandardDeviations) {
  const CameraModel camera = *load(camera_text());
  for (const char* wrong :
       {"[1, 1]", "[1, 1, 1, 1, -0.1, 0, 0, 0, 0]", "[1, 1, 1, .nan, 0, 0, 0, 0, 0]",
        "[1, 1, 1, 1e9, 0, 0, 0, 0, 0]", "x"}) {
    ASSERT_TRUE(
        load(camera_text() + fmt::format("uncertainty: {{standard_deviations: {}}}\n", wrong)));
    const auto record = load_calibration_record(file_, camera);
    ASSERT_FALSE(record) << wrong;
    EXPECT_THAT(record.error().message, testing::AllOf(testing::HasSubstr("standard_deviations"),
                                                       testing::HasSubstr("(line ")))
        << wrong;
  }
}

// With k1 = -5000 the lens is monotonic only in a fortieth of the image.
TEST_F(CameraFile, RejectsDistortionNonMonotonicNearPrincipalPoint) {
  refuses(camera_text("distortion_model: plumb_bob", "[-5000, 0, 0, 0, 0]"), "non-monotonic");
  refuses(camera_text("distortion_model: plumb_bob", "[-20, 0, 0, 0, 0]"), "distortion");
  refuses(camera_text("distortion_model: equidistant", "[-20, 0, 0, 0]"), "non-monotonic");
  refuses(camera_text("distortion_model: plumb_bob", "[1e6, 0, 0, 0, 0]"), "times as far out");
  refuses(camera_text("distortion_model: plumb_bob", "[0, 0, 0, 0, 0]",
                      "[500, 0, 99999, 0, 500, 240, 0, 0, 1]"),
          "principal point");
  // Non-monotonic in the corners only, as is common for fits of wide-angle lenses.
  EXPECT_TRUE(load(camera_text("distortion_model: plumb_bob", "[-0.35, 0.05, 0, 0, 0]")));
  EXPECT_TRUE(load(camera_text("distortion_model: plumb_bob", "[-1.2, 0, 0, 0, 0]")));
}

TEST_F(CameraFile, RoundTripsExactly) {
  for (const DistortionModel model : kDistortionModels) {
    CameraParameters p = test::lens_of(model).parameters();
    p.fx = 1600.0 / 3.0;
    p.cy = 239.0 + 1e-12;
    p.distortion[0] /= 3.0;
    p.name = "a \"quoted\" \\ name";
    p.tone_curve = 1.55;
    p.rolling_shutter_row_s = 1.0 / 48000.0;
    p.overlay_sigma_px = 0.1 / 3.0;
    const CameraModel camera = CameraModel::make(p).value();
    if (model_name(model, CameraFileFormat::opencv)) {
      ASSERT_TRUE(save_camera(file_, camera, CameraFileFormat::opencv));
      const auto read_opencv = load_camera(file_);
      ASSERT_TRUE(read_opencv) << read_opencv.error().message;
      EXPECT_EQ(read_opencv->parameters().distortion, p.distortion);
      EXPECT_EQ(read_opencv->parameters().tone_curve, p.tone_curve);
      EXPECT_EQ(read_opencv->parameters().rolling_shutter_row_s, p.rolling_shutter_row_s);
      EXPECT_EQ(read_opencv->parameters().overlay_sigma_px, p.overlay_sigma_px);
    }
    ASSERT_TRUE(save_camera(file_, camera));
    const auto read = load_camera(file_);
    ASSERT_TRUE(read) << read.error().message;
    const CameraParameters& q = read->parameters();
    EXPECT_EQ(q.width, p.width);
    EXPECT_EQ(q.fx, p.fx);
    EXPECT_EQ(q.fy, p.fy);
    EXPECT_EQ(q.cx, p.cx);
    EXPECT_EQ(q.cy, p.cy);
    EXPECT_EQ(q.model, p.model);
    EXPECT_EQ(q.distortion, p.distortion);
    EXPECT_EQ(q.name, p.name);
    EXPECT_EQ(q.tone_curve, p.tone_curve);
    EXPECT_EQ(q.rolling_shutter_row_s, p.rolling_shutter_row_s);
    EXPECT_EQ(q.overlay_sigma_px, p.overlay_sigma_px);
  }
}

// Binning merges pixels 2 p and 2 p + 1 into p, so the principal point moves by half a pixel.
TEST_F(CameraFile, ScalesCalibrationByWholePixels) {
  const auto camera = load(camera_text() + "rolling_shutter_row_s: 0.00003\ntone_curve: 2.2\n");
  ASSERT_TRUE(camera) << camera.error().message;
  for (const auto& [width, height, scale] :
       {std::tuple{320, 240, 0.5}, std::tuple{128, 96, 0.2}, std::tuple{1920, 1440, 3.0}}) {
    const auto scaled = scaled_to(*camera, width, height);
    ASSERT_TRUE(scaled) << scaled.error().message;
    EXPECT_EQ(scaled->width(), width);
    EXPECT_EQ(scaled->height(), height);
    EXPECT_EQ(scaled->parameters().tone_curve, 2.2);
    EXPECT_FALSE(scaled->parameters().rolling_shutter_row_s)
        << "the row time is unknown at another size";
    for (const Eigen::Vector3d& p :
         {Eigen::Vector3d(0.0, 0.0, 1.0), Eigen::Vector3d(0.3, -0.2, 0.7),
          Eigen::Vector3d(-0.4, 0.1, 0.9)}) {
      const Eigen::Vector2d centre(0.5, 0.5);
      const Eigen::Vector2d expected = (camera->project(p).value() + centre) * scale - centre;
      EXPECT_LT((scaled->project(p).value() - expected).norm(), 1e-9);
    }
    const auto back = scaled_to(*scaled, 640, 480);
    ASSERT_TRUE(back);
    EXPECT_NEAR(back->parameters().cx, camera->parameters().cx, 1e-9);
  }
  EXPECT_EQ(scaled_to(*camera, 640, 480)->parameters().rolling_shutter_row_s, 0.00003);
  for (const auto& [width, height] :
       {std::pair{320, 480}, std::pair{320, 180}, std::pair{480, 360}, std::pair{1280, 720},
        std::pair{0, 0}, std::pair{-640, -480}}) {
    const auto refused = scaled_to(*camera, width, height);
    ASSERT_FALSE(refused) << width << "x" << height;
    EXPECT_THAT(refused.error().message, testing::HasSubstr("640x480"));
  }
}

TEST_F(CameraFile, FormatsSameTextAsFile) {
  const auto camera = load(camera_text());
  ASSERT_TRUE(camera);
  ASSERT_TRUE(save_camera(file_, *camera));
  EXPECT_EQ(read_text_file(file_, 100'000).value(), ros_camera_text(*camera));
}

TEST(CameraFileOutput, KeepsFormatOfReplacedFile) {
  const test::TemporaryFolder folder;
  const CameraModel camera = test::pinhole_camera();
  const auto file = folder.path() / "camera.yaml";
  const std::string flow_camera =
      "image_width: 640, image_height: 480, camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, "
      "0, 500, 240, 0, 0, 1]}, distortion_model: plumb_bob, "
      "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}";
  for (const CameraFileFormat format :
       {CameraFileFormat::ros, CameraFileFormat::opencv, CameraFileFormat::kalibr}) {
    ASSERT_TRUE(save_camera(file, camera, format));
    EXPECT_EQ(output_format_of(file), format) << to_string(format);
  }
  EXPECT_EQ(camera_count(file), 1U);
  ASSERT_TRUE(write_text_file(file, "left: {" + flow_camera + "}\nright: {" + flow_camera + "}\n"));
  EXPECT_EQ(camera_count(file), 2U);
  EXPECT_EQ(output_format_of(file), CameraFileFormat::ros) << "wrapped, but not Kalibr's";
  EXPECT_EQ(camera_count(folder.path() / "new.yaml"), 0U);
  EXPECT_EQ(output_format_of(folder.path() / "new.yaml"), CameraFileFormat::ros);
  EXPECT_EQ(output_format_of(folder.path() / "new.yml"), CameraFileFormat::opencv);
  EXPECT_EQ(output_format_of(folder.path() / "camchain-new.yaml"), CameraFileFormat::kalibr);
  ASSERT_TRUE(write_text_file(file, "nothing: [1\n"));
  EXPECT_EQ(output_format_of(file), CameraFileFormat::ros);
  EXPECT_EQ(output_format_of(folder.path()), CameraFileFormat::ros);
  EXPECT_EQ(output_format_of("/dev/stdout"), CameraFileFormat::ros);
}

}  // namespace
}  // namespace penumbra
