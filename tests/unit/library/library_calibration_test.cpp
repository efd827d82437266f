#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <penumbra/calibration.hpp>
#include <random>
#include <sstream>
#include <tuple>

#include "recorded_frames.hpp"
#include "support/run_program.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

constexpr int kWidth = 640;
constexpr int kHeight = 480;

types::CameraModel true_camera() {
  types::CameraParameters p;
  p.width = kWidth;
  p.height = kHeight;
  p.fx = 531.7;
  p.fy = 530.4;
  p.cx = 322.3;
  p.cy = 237.6;
  p.distortion = {-0.215, 0.062, 0.0008, -0.0006, -0.004};
  return types::CameraModel(p);
}

// Returns views of a chessboard that is tilted by `tilt_rad` to different sides, with noise of 0.05
// px (1 sigma).
std::vector<calibration::CornerView> views_of(const std::vector<types::Vector3>& points,
                                              double tilt_rad, int count) {
  const types::CameraModel camera = true_camera();
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0.0, 0.05);
  std::vector<calibration::CornerView> views;
  for (int i = 0; i < count; ++i) {
    // Rotates about an axis in the board's plane, after turning z towards the camera.
    const double angle = 2.4 * i;
    const double x = std::cos(angle);
    const double y = std::sin(angle);
    const double c = std::cos(tilt_rad);
    const double s = std::sin(tilt_rad);
    calibration::CornerView& view = views.emplace_back();
    view.name = "view " + std::to_string(i);
    for (std::size_t k = 0; k < points.size(); ++k) {
      const auto& [px, py, pz] = points[k];
      const double along = x * px + y * py;
      const double across = -y * px + x * py;
      const types::Vector3 p = {x * along - y * across * c + 0.05 * std::cos(1.3 * i),
                                -(y * along + x * across * c) + 0.04 * std::sin(1.7 * i),
                                0.5 + 0.02 * (i % 4) - across * s};
      const auto pixel = camera.project(p);
      if (!pixel || (*pixel)[0] < 0.0 || (*pixel)[0] > kWidth - 1 || (*pixel)[1] < 0.0 ||
          (*pixel)[1] > kHeight - 1)
        continue;
      view.corners.push_back(
          {static_cast<int>(k), {(*pixel)[0] + noise(random), (*pixel)[1] + noise(random)}});
    }
  }
  return views;
}

std::vector<types::Vector3> board() {
  return calibration::Target::chessboard(9, 6, 0.03).points();
}

calibration::Calibration calibrated(const std::vector<calibration::CornerView>& views) {
  return calibration::calibrate(kWidth, kHeight, board(), views,
                                {.model = types::DistortionModel::plumb_bob});
}

TEST(LibraryCalibration, RecoversCameraFromCorners) {
  const calibration::Calibration result = calibrated(views_of(board(), 0.6, 14));
  const types::CameraParameters found = result.camera().parameters();
  const types::CameraParameters truth = true_camera().parameters();
  const std::vector<std::string> names = result.parameter_names();
  const std::vector<double> covariance = result.covariance();
  EXPECT_THAT(names, testing::ElementsAre("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"));
  ASSERT_EQ(covariance.size(), names.size() * names.size());
  const std::array errors = {found.fx - truth.fx, found.fy - truth.fy, found.cx - truth.cx,
                             found.cy - truth.cy};
  for (std::size_t i = 0; i < errors.size(); ++i) {
    const double sigma = std::sqrt(covariance[i * names.size() + i]);
    EXPECT_LT(std::abs(errors[i]), 4.0 * sigma) << names[i];
    EXPECT_LT(sigma, 2.0) << names[i];
  }
  EXPECT_NEAR(result.rms_px(), 0.05 * std::sqrt(2.0), 0.015);
  ASSERT_EQ(result.views().size(), 14U);
  EXPECT_TRUE(result.views().front().used);
  EXPECT_GE(result.projection_largest_px(), result.projection_mean_px());
  EXPECT_NE(result.verdict(), "");

  const TemporaryFolder folder;
  result.save(folder.path() / "camera.yaml", "2026-03-01");
  EXPECT_EQ(types::CameraModel::load(folder.path() / "camera.yaml").parameters().fx, found.fx);
}

TEST(LibraryCalibration, RejectsViewsWithoutTilt) {
  EXPECT_THAT(message_of([] { std::ignore = calibrated(views_of(board(), 0.0, 8)); }),
              HasSubstr("tilt"));
}

TEST(LibraryCalibration, RejectsInvalidCorners) {
  const std::vector<calibration::CornerView> good = views_of(board(), 0.6, 4);
  const auto message = [&](auto change) {
    std::vector<calibration::CornerView> views = good;
    change(views);
    return message_of([&] { std::ignore = calibrated(views); });
  };
  EXPECT_THAT(message([](auto& views) { views.clear(); }), HasSubstr("too few"));
  EXPECT_THAT(message([](auto& views) { views.resize(2); }), HasSubstr("too few"));
  EXPECT_NE(message([](auto& views) { views[1].corners.clear(); }), "");
  EXPECT_THAT(message([](auto& views) { views[1].corners[3].point = -1; }),
              HasSubstr("view 1: point -1 does not exist"));
  EXPECT_THAT(message([](auto& views) { views[1].corners[3].point = 54; }),
              HasSubstr("point 54 does not exist; the target has 54 points"));
  EXPECT_THAT(message([](auto& views) { views[1].corners[3].point = views[1].corners[4].point; }),
              HasSubstr("twice"));
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(),
                           std::numeric_limits<double>::infinity(), -2.0, 1e9}) {
    EXPECT_THAT(message([&](auto& views) { views[2].corners[0].pixel[1] = bad; }),
                HasSubstr("outside the image"));
    EXPECT_NE(message_of([&] {
                auto points = board();
                if (bad != -2.0) points[5][0] = bad;
                if (bad == -2.0) points.clear();
                std::ignore = calibration::calibrate(kWidth, kHeight, points, good);
              }),
              "");
  }
  EXPECT_THAT(message_of([&] { std::ignore = calibration::calibrate(0, 480, board(), good); }),
              HasSubstr("width"));
  EXPECT_THAT(message_of([&] {
                std::ignore =
                    calibration::calibrate(kWidth, kHeight, board(), good, {.max_views = 0});
              }),
              HasSubstr("max_views"));
}

TEST(LibraryCalibration, RejectsInvalidTargetsAndImages) {
  EXPECT_THAT(message_of([] { std::ignore = calibration::Target::chessboard(2, 6, 0.03); }),
              HasSubstr("at least 3 x 3"));
  EXPECT_NE(message_of([] {
              std::ignore =
                  calibration::Target::chessboard(9, 6, std::numeric_limits<double>::quiet_NaN());
            }),
            "");
  EXPECT_THAT(message_of([] { std::ignore = calibration::Target::load("none.yaml"); }),
              HasSubstr("none.yaml"));

  calibration::Calibrator calibrator(calibration::Target::chessboard(9, 6, 0.03));
  EXPECT_THAT(message_of([&] { calibrator.add("empty", {}); }), HasSubstr("empty: data: is null"));
  const std::vector<std::uint8_t> grey(64 * 48, 128);
  calibrator.add("grey", {grey.data(), 64, 48, 64});
  EXPECT_THAT(message_of([&] {
                calibrator.add("narrow", {grey.data(), 48, 48, 64});
              }),
              HasSubstr("one size"));
  EXPECT_THAT(message_of([&] { std::ignore = calibrator.solve(); }), HasSubstr("none of"));
  EXPECT_THAT(message_of([&] { std::ignore = calibrator.solve(); }), HasSubstr("no images"));
}

std::string text_of_file(const std::filesystem::path& file) {
  std::stringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

TEST(LibraryCalibration, EqualsCalibrateCommand) {
  const TemporaryFolder folder;
  const std::filesystem::path recording = recordings_dir() / "tabletop";
  const ProgramResult simulated = run_program(
      program(), {"simulate", "board", "--camera", (recording / "camera.yaml").string(), "--tags",
                  (recording / "tags.yaml").string(), "--trajectory",
                  (source_dir() / "tests" / "support" / "tilted_views.tum").string(), "--output",
                  (folder.path() / "session").string(), "--noise", "1", "--seed", "3"});
  ASSERT_EQ(simulated.exit_code, 0) << simulated.err;
  const std::filesystem::path images = folder.path() / "session" / "frames";
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(images))
    names.push_back(entry.path().filename().string());
  std::ranges::sort(names);
  ASSERT_EQ(names.size(), 7U);
  const std::filesystem::path expected = folder.path() / "expected.yaml";
  const ProgramResult command = run_program(
      program(), {"calibrate", images.string(), "--target", (recording / "tags.yaml").string(),
                  "--output", expected.string(), "--model", "plumb_bob"});
  ASSERT_EQ(command.exit_code, 0) << command.err;

  calibration::Calibrator calibrator(calibration::Target::load(recording / "tags.yaml"),
                                     {.model = types::DistortionModel::plumb_bob});
  for (const std::string& name : names)
    calibrator.add(name, types::Image::load(images / name).view());
  const calibration::Calibration result = calibrator.solve();
  const std::string text = text_of_file(expected);
  const std::size_t at = text.find("calibrated_on: ");
  ASSERT_NE(at, std::string::npos);
  std::string date = text.substr(at + 15, text.find('\n', at) - at - 15);
  std::erase_if(date, [](char c) { return c == '"' || c == '\''; });
  result.save(folder.path() / "found.yaml", date);
  EXPECT_EQ(text_of_file(folder.path() / "found.yaml"), text);
  EXPECT_THAT(command.out, HasSubstr(result.verdict()));
}

}  // namespace
}  // namespace penumbra::test
