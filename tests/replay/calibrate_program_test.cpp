// The calibration commands on recordings with a known lens, and on input that they must reject.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <yaml-cpp/yaml.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <thread>

#include "calib/camera_calibration.hpp"
#include "calib/target/target.hpp"
#include "core/camera/camera_file.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_file.hpp"
#include "core/stopwatch.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"
#include "support/recording_folder.hpp"
#include "support/run_program.hpp"
#include "support/running_program.hpp"
#include "support/synthetic_board.hpp"
#include "support/test_form.hpp"
#include "tracking/alignment/pattern_renderer.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;
using testing::Not;

class CalibrateCommand : public testing::Test {
 protected:
  void SetUp() override {
    if (test::shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  }
  [[nodiscard]] static std::filesystem::path shared(const std::string& path) {
    return test::shared_dir() / path;
  }
  [[nodiscard]] test::ProgramResult calibrate(const std::filesystem::path& source,
                                              const std::filesystem::path& target,
                                              std::vector<std::string> more = {}) const {
    std::vector<std::string> arguments = {"calibrate",     source.string(), "--target",
                                          target.string(), "--output",      output().string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return test::run_program(test::program(), arguments);
  }
  [[nodiscard]] std::filesystem::path output() const { return folder_.path() / "camera.yaml"; }
  [[nodiscard]] std::filesystem::path folder() const { return folder_.path(); }
  [[nodiscard]] static std::string last_line(const std::string& text) {
    std::istringstream lines(text);
    std::string line;
    std::string last;
    while (std::getline(lines, line)) last = line;
    return last;
  }
  // Creates a folder with `count` frames of a recording.
  [[nodiscard]] std::filesystem::path copy_frames(const std::string& recording, int count,
                                                  int first = 0) const {
    const auto images = folder_.path() / "pictures";
    std::filesystem::create_directories(images);
    for (int i = first; i < first + count; ++i) {
      const std::string name = test::six_digits(i) + ".png";
      std::filesystem::copy_file(shared(recording) / "frames" / name, images / name);
    }
    return images;
  }
  void expect_refused(const test::ProgramResult& result, const std::string& why) const {
    EXPECT_EQ(result.exit_code, 1) << result.out << result.err;
    EXPECT_THAT(result.err, HasSubstr(why));
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
    EXPECT_FALSE(std::filesystem::exists(output()));
  }

 private:
  test::TemporaryFolder folder_;
};
class TargetMeasurement : public CalibrateCommand {};
class MapCommand : public CalibrateCommand {};

// The short form uses every other image. Its views determine the lens to 0.24 px at worst, so the
// bounds are the same.
TEST_F(CalibrateCommand, RecoversCameraFromAprilGrid) {
  const auto report = folder() / "report.html";
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/calibration"), test::nightly() ? 1 : 2);
  const auto result = calibrate(source, shared("recordings/calibration/aprilgrid.yaml"),
                                {"--report", report.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(last_line(result.out), testing::StartsWith("good: ")) << result.out;
  const auto truth = load_camera(shared("recordings/calibration/camera.yaml"));
  const auto camera = load_camera(output());
  ASSERT_TRUE(truth && camera);
  const CameraParameters& t = truth->parameters();
  const CameraParameters& p = camera->parameters();
  EXPECT_EQ(p.model, DistortionModel::plumb_bob);
  EXPECT_NEAR(p.fx, t.fx, 1e-3 * t.fx);
  EXPECT_NEAR(p.fy, t.fy, 1e-3 * t.fy);
  EXPECT_NEAR(p.cx, t.cx, 0.5);
  EXPECT_NEAR(p.cy, t.cy, 0.5);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.2);
  // The images have a camera response, whose value is not in the recording's README.
  ASSERT_TRUE(p.tone_curve);
  EXPECT_GT(*p.tone_curve, 1.3);
  EXPECT_LT(*p.tone_curve, 2.4);
  EXPECT_THAT(result.out, HasSubstr("camera response (tone_curve): light = grey ^ "));
  const std::string html = test::read_bytes(report);
  EXPECT_THAT(html, HasSubstr("class=\"verdict good\""));
  EXPECT_THAT(html, Not(HasSubstr("http")));  // the report has no external resources
}

TEST_F(CalibrateCommand, RecoversCameraFromChessboard) {
  const auto result =
      calibrate(shared("recordings/chessboard"), shared("recordings/chessboard/chessboard.yaml"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto truth = load_camera(shared("recordings/chessboard/camera.yaml"));
  const auto camera = load_camera(output());
  ASSERT_TRUE(truth && camera);
  EXPECT_NEAR(camera->parameters().fx, truth->parameters().fx, 1e-3 * truth->parameters().fx);
  EXPECT_NEAR(camera->parameters().fy, truth->parameters().fy, 1e-3 * truth->parameters().fy);
  EXPECT_NEAR(camera->parameters().cx, truth->parameters().cx, 0.5);
  EXPECT_NEAR(camera->parameters().cy, truth->parameters().cy, 0.5);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.2);
  EXPECT_FALSE(camera->parameters().tone_curve);
  EXPECT_THAT(result.out, HasSubstr("camera response (tone_curve): unknown: a chessboard"));
  EXPECT_THAT(result.out, Not(HasSubstr("mirror")));
}

TEST_F(CalibrateCommand, ReportsDetectedChessboardSizeOnMismatch) {
  const auto target = folder() / "target.yaml";
  const auto images = copy_frames("recordings/chessboard", 3, 8);
  for (const auto& [columns, rows] : {std::pair(8, 5), std::pair(10, 7)}) {
    test::write_text(target, fmt::format("target_type: checkerboard\ninner_cols: {}\n"
                                         "inner_rows: {}\nsquare_m: 0.025\n",
                                         columns, rows));
    const auto result = calibrate(images, target);
    EXPECT_EQ(result.exit_code, 1);
    EXPECT_THAT(
        result.err,
        testing::AllOf(HasSubstr("images show a chessboard of 9 x 6 inner corners"),
                       HasSubstr(fmt::format("the target file says {} x {}", columns, rows)),
                       HasSubstr("correct the target file")));
  }
}

TEST_F(CalibrateCommand, WritesKalibrCamchainForSupportedModelsOnly) {
  const auto chain = folder() / "camchain.yaml";
  // The short form uses ten images, whose views determine the lens to 0.35 px on average; its bound
  // is three times that.
  const bool whole = test::nightly();
  const auto source = shared(whole ? "recordings/chessboard" : "recordings/calibration-kalibr");
  const auto target = source / (whole ? "chessboard.yaml" : "aprilgrid.yaml");
  const std::vector<std::string> arguments = {"calibrate",     source.string(), "--target",
                                              target.string(), "--output",      chain.string(),
                                              "--board",       "rigid"};
  const auto result = test::run_program(test::program(), arguments);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(YAML::LoadFile(chain.string())["cam0"]["distortion_coeffs"].size(), 4U);
  const auto truth = load_camera(source / "camera.yaml");
  const auto camera = load_camera(chain);
  ASSERT_TRUE(truth && camera);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, whole ? 0.2 : 1.05);
  auto rational = arguments;
  rational.insert(rational.end(), {"--model", "rational"});
  EXPECT_EQ(test::run_program(test::program(), rational).exit_code, 2);
}

TEST_F(CalibrateCommand, DetectsAprilGridWithCornerSquares) {
  const auto result = calibrate(shared("recordings/calibration-kalibr"),
                                shared("recordings/calibration-kalibr/aprilgrid.yaml"),
                                {"--model", "plumb_bob", "--board", "rigid"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto camera = load_camera(output());
  ASSERT_TRUE(camera);
  EXPECT_NEAR(camera->parameters().fx, 531.7, 1.5);
}

TEST_F(CalibrateCommand, IgnoresCameraFileOfSource) {
  const auto copy = folder() / "copy";
  test::write_thinned_recording(copy, shared("recordings/chessboard"), 5);
  std::filesystem::remove(copy / "camera.yaml");
  test::write_text(copy / "camera.yaml", "broken: [");
  const auto result = calibrate(copy, shared("recordings/chessboard/chessboard.yaml"),
                                {"--model", "plumb_bob", "--board", "rigid"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
}

TEST_F(CalibrateCommand, RejectsUnusableInputs) {
  const auto grid = shared("recordings/calibration/aprilgrid.yaml");
  const auto chessboard = shared("recordings/chessboard/chessboard.yaml");
  const auto boards = folder() / "boards";
  test::write_thinned_recording(boards, shared("recordings/chessboard"), 6);
  expect_refused(calibrate(boards, grid), "is it the right target file");
  expect_refused(calibrate(copy_frames("recordings/calibration", 2), grid), "at least 3");
  expect_refused(calibrate(folder() / "nowhere", grid), "no such folder");
  const auto broken = folder() / "broken";
  std::filesystem::create_directories(broken);
  for (int i = 0; i < 5; ++i) test::write_text(broken / (std::to_string(i) + ".png"), "no image");
  expect_refused(calibrate(broken, chessboard), "none of 5 images can be read");
  const auto mixed = folder() / "pictures";
  test::write_text(mixed / "999999.jpg", test::jpeg_of(1));
  expect_refused(calibrate(mixed, grid), "64 x 48");
  const auto sheet = folder() / "sheet.pdf";
  test::write_text(sheet, "%PDF-1.5\n");
  expect_refused(calibrate(shared("recordings/calibration"), sheet), "target.yaml or tags.yaml");
  const auto metres = folder() / "metres.yaml";
  test::write_text(metres,
                   "target_type: checkerboard\ninner_cols: 9\ninner_rows: 6\nsquare_m: 25\n");
  expect_refused(calibrate(shared("recordings/chessboard"), metres), "did you mean 0.025");
}

// Photographs of a Kalibr sheet whose tags have a border of two cells.
TEST_F(CalibrateCommand, RejectsTagsWithTwoCellBorders) {
  const auto images = folder() / "kalibr";
  std::filesystem::create_directories(images);
  for (const char* name : {"a.png", "b.png", "c.png"})
    std::filesystem::copy_file(shared("data/real/aprilgrid/EuRoC.png"), images / name);
  const auto grid = folder() / "euroc.yaml";
  test::write_text(grid,
                   "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\n"
                   "tagSpacing: 0.3\n");
  const auto result = calibrate(images, grid);
  expect_refused(result, "black border of two cells");
  EXPECT_THAT(result.err, HasSubstr("3 of 3 images"));
}

TEST_F(CalibrateCommand, RejectsComparisonCameraOfOtherSizeBeforeSolving) {
  CameraParameters p = load_camera(shared("recordings/chessboard/camera.yaml"))->parameters();
  p.width = 1280;
  const auto earlier = folder() / "earlier.yaml";
  ASSERT_TRUE(save_camera(earlier, CameraModel::make(p).value()));
  const auto source = shared("recordings/chessboard");
  const auto result =
      calibrate(source, source / "chessboard.yaml",
                {"--compare", earlier.string(), "--report", (folder() / "report.html").string()});
  expect_refused(result, "earlier.yaml: is of 1280 x 480 px, but the images are 640 x 480");
  EXPECT_FALSE(std::filesystem::exists(folder() / "report.html"));
  EXPECT_EQ(result.out, "") << "no calibration must be printed";
}

// A command must not overwrite its input files or write two outputs to one file.
TEST_F(CalibrateCommand, RejectsOutputsThatWouldOverwriteInputsOrOutputs) {
  const std::string text =
      "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.03\n"
      "tagSpacing: 0.3\n";
  const auto grid = (folder() / "grid.yaml").string();
  const auto out = (folder() / "out.yaml").string();
  const auto images = shared("recordings/calibration").string();
  const auto sweep = shared("recordings/tabletop").string();
  test::write_text(grid, text);
  using Arguments = std::vector<std::string>;
  for (const Arguments& arguments :
       {Arguments{"calibrate", images, "--target", grid, "--output", grid},
        Arguments{"calibrate", images, "--target", grid, "--output", out, "--report", grid},
        Arguments{"calibrate", images, "--target", grid, "--output", out, "--report", out},
        Arguments{"calibrate", images, "--target", grid, "--output", out, "--compare", out},
        Arguments{"map", sweep, "--anchor", "5", "--sizes", grid, "--output", grid},
        Arguments{"map", sweep, "--anchor", "5", "--tag-size", "0.04", "--camera", grid, "--output",
                  grid},
        Arguments{"map", sweep, "--anchor", "5", "--sizes", grid, "--output", out,
                  "--refine-camera", grid}}) {
    const auto refused = test::run_program(test::program(), arguments);
    EXPECT_EQ(refused.exit_code, 2) << refused.err;
    EXPECT_THAT(refused.err, HasSubstr("is also named as another input or output"));
    EXPECT_EQ(read_text_file(grid, 1000).value(), text);
    EXPECT_FALSE(std::filesystem::exists(out));
  }
}

// Follows the README: print, measure the ruler, pass --measured.
TEST_F(TargetMeasurement, CorrectsTargetFileOfEveryKind) {
  for (const char* type : {"tags", "aprilgrid", "charuco", "chessboard"}) {
    SCOPED_TRACE(type);
    const auto at = folder() / type;
    std::filesystem::create_directories(at);
    const auto file = at / (std::string(type) == "tags" ? "tags.yaml" : "target.yaml");
    const auto print = [&](std::vector<std::string> more) {
      std::vector<std::string> arguments = {"target", "--type", type, "--output",
                                            (at / "sheet.pdf").string()};
      arguments.insert(arguments.end(), more.begin(), more.end());
      return test::run_program(test::program(), arguments);
    };
    ASSERT_EQ(print({}).exit_code, 0);
    const std::string nominal = read_text_file(file, 1 << 20).value();
    const auto measured = print({"--measured", "99.2"});
    ASSERT_EQ(measured.exit_code, 0) << measured.err;
    const std::string corrected = read_text_file(file, 1 << 20).value();
    EXPECT_NE(corrected, nominal);
    // A second measurement replaces the first one, which the message mentions.
    const auto again = print({"--measured", "100.4"});
    ASSERT_EQ(again.exit_code, 0) << again.err;
    EXPECT_THAT(again.out, HasSubstr("ruler: 100.4 mm on paper (before: 99.2 mm)"));
    const auto corrected_target = load_target(file);
    ASSERT_TRUE(corrected_target) << corrected_target.error().message;
    test::write_text(file, nominal);
    const auto length = [](const Target& target) {
      return (target.points.back() - target.points.front()).norm();
    };
    EXPECT_NEAR(length(*corrected_target) / length(load_target(file).value()), 1.004, 1e-7);
    ASSERT_EQ(print({"--measured", "100.4"}).exit_code, 0);
    // Without --measured, the measured file must stay.
    const std::string measured_text = read_text_file(file, 1 << 20).value();
    const auto without_measured = print({});
    EXPECT_EQ(without_measured.exit_code, 1);
    EXPECT_THAT(without_measured.err, HasSubstr("keep that with --measured 100.4"));
    EXPECT_EQ(read_text_file(file, 1 << 20).value(), measured_text);
    ASSERT_EQ(print({"--measured", "100"}).exit_code, 0);
    EXPECT_EQ(read_text_file(file, 1 << 20).value(), nominal);
    // The file of another sheet, or a changed file, must not be replaced.
    test::write_text(file, nominal + "# mine\n");
    const auto kept = print({"--measured", "99.2"});
    EXPECT_EQ(kept.exit_code, 1);
    EXPECT_THAT(kept.err, HasSubstr("exists with other content"));
    EXPECT_EQ(read_text_file(file, 1 << 20).value(), nominal + "# mine\n");
  }
}

// All views show the target from the front, so focal length and distance can't be separated.
TEST_F(CalibrateCommand, RejectsPurelyFrontalViews) {
  const auto camera = load_camera(shared("recordings/calibration/camera.yaml"));
  const auto tags = load_tag_map(shared("recordings/calibration/tags.yaml"));
  ASSERT_TRUE(camera && tags);
  auto renderer = PatternRenderer::create(*camera, tags->tags());
  ASSERT_TRUE(renderer);
  const auto images = folder() / "front";
  std::filesystem::create_directories(images);
  PatternRenderOptions options;
  options.samples = 4;
  for (int i = 0; i < 5; ++i) {
    const Eigen::Vector3d at(0.02 * (i % 3 - 1), 0.015 * (i / 3 - 1), 0.0);
    const auto pose = test::looking_at(at, 0.4 + 0.04 * i, radians(90.0), 0.0, radians(20.0 * i));
    options.seed = static_cast<std::uint64_t>(i + 1);
    ASSERT_TRUE(save_grey_png(images / (std::to_string(i) + ".png"),
                              renderer->render(std::array{pose}, options).view()));
  }
  expect_refused(calibrate(images, shared("recordings/calibration/aprilgrid.yaml")),
                 "tilt the target");
}

// Unreadable images in a folder are skipped, each with its reason.
TEST_F(CalibrateCommand, SkipsUnreadableImages) {
  const auto images = folder() / "pictures";
  std::filesystem::create_directories(images);
  const auto source = shared("recordings/chessboard");
  for (int i = 0; i < 8; ++i) {
    const std::string name = test::six_digits(i) + ".png";
    const std::string bytes = test::read_bytes(source / "frames" / name);
    const bool broken = i == 2 || i == 7;
    test::write_text(images / name, broken ? bytes.substr(0, bytes.size() / 2) : bytes);
  }
  const auto result =
      calibrate(images, source / "chessboard.yaml", {"--model", "plumb_bob", "--board", "rigid"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("rejected: 000002.png"));
  EXPECT_THAT(result.out, HasSubstr("rejected: 000007.png"));
  EXPECT_THAT(result.out, HasSubstr("of 8 images"));
}

// Plays the calibration recording as a camera, like a hand-held target: each image is repeated.
class CalibrateFromCamera : public CalibrateCommand {
 protected:
  void SetUp() override {
    CalibrateCommand::SetUp();
    if (IsSkipped()) return;
    std::filesystem::create_directories(played_folder());
    const auto source = shared("recordings/calibration");
    std::filesystem::create_directory_symlink(source / "frames", played_folder() / "frames");
    write_listing(32, 4);
  }
  // Lists the first `images` images, each `times` times.
  void write_listing(int images, int times, double interval_s = 0.1) const {
    std::string lines = "frame,timestamp_s,file\n";
    for (int i = 0; i < images * times; ++i)
      lines +=
          fmt::format("{},{:.2f},frames/{}.png\n", i, interval_s * i, test::six_digits(i / times));
    test::write_text(played_folder() / "timestamps.csv", lines);
  }
  [[nodiscard]] std::filesystem::path played_folder() const { return folder() / "held"; }
  [[nodiscard]] std::filesystem::path views_folder() const { return folder() / "views"; }
  [[nodiscard]] std::vector<std::string> arguments(std::vector<std::string> more) const {
    std::vector<std::string> words = {
        "calibrate", "recording:" + played_folder().string(),
        "--target",  shared("recordings/calibration/aprilgrid.yaml").string(),
        "--output",  output().string(),
        "--keep",    views_folder().string()};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  }
};

// Number of pixels of about this colour.
int count_pixels_of_colour(const RgbaImage& image, int red, int green, int blue) {
  int count = 0;
  for (std::size_t i = 0; i + 3 < image.pixels.size(); i += 4) {
    count += std::abs(image.pixels[i] - red) < 12 && std::abs(image.pixels[i + 1] - green) < 12 &&
                     std::abs(image.pixels[i + 2] - blue) < 12
                 ? 1
                 : 0;
  }
  return count;
}

TEST_F(CalibrateFromCamera, GuidesInWindowAndReproducesResultFromKeptViews) {
  ASSERT_EQ(std::system("command -v Xvfb >/dev/null 2>&1 && command -v xdotool >/dev/null 2>&1"), 0)
      << "scripts/setup installs both";
  write_listing(13, 2);
  std::vector<std::string> words = {
      (test::source_dir() / "tests" / "support" / "guide-by-keys").string(),
      views_folder().string(), output().string(), test::program().string()};
  for (const std::string& word : arguments({"--model", "plumb_bob", "--board", "rigid"}))
    words.push_back(word);
  const auto result = test::run_program(test::source_dir() / "tests" / "support" / "with-display",
                                        words, {}, folder());
  ASSERT_EQ(result.exit_code, 0) << result.err << result.out;
  EXPECT_THAT(result.out, HasSubstr("view 5 ("));
  EXPECT_THAT(result.out, Not(HasSubstr("without a window")));
  const auto truth = load_camera(shared("recordings/calibration/camera.yaml"));
  const auto camera = load_camera(output());
  ASSERT_TRUE(truth && camera);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.5);

  // The first screenshot is from the views, with bars, corners and cells; the last one shows the
  // verdict. There are more if the program was so slow that the key was pressed again.
  std::vector<std::filesystem::path> shots;
  for (const auto& entry : std::filesystem::directory_iterator(folder())) {
    if (entry.path().extension() == ".png") shots.push_back(entry.path());
  }
  std::sort(shots.begin(), shots.end());
  ASSERT_GE(shots.size(), 2U);
  if (!test::kSanitized) {
    EXPECT_EQ(shots.size(), 2U);
  }
  if (const char* image_folder = std::getenv("PENUMBRA_HUD_IMAGES")) {
    std::filesystem::copy_file(shots.front(), std::filesystem::path(image_folder) / "guide.png",
                               std::filesystem::copy_options::overwrite_existing);
    std::filesystem::copy_file(shots.back(), std::filesystem::path(image_folder) / "verdict.png",
                               std::filesystem::copy_options::overwrite_existing);
  }
  const auto during = load_rgba(shots.front());
  const auto at_end = load_rgba(shots.back());
  ASSERT_TRUE(during && at_end);
  EXPECT_GE(during->width, 640);
  const int bars =
      count_pixels_of_colour(*during, 255, 190, 60) + count_pixels_of_colour(*during, 70, 215, 110);
  EXPECT_GT(bars, 1000);
  EXPECT_LT(
      count_pixels_of_colour(*at_end, 255, 190, 60) + count_pixels_of_colour(*at_end, 70, 215, 110),
      bars / 2);

  // Calibrating from the stored views must give the same digits.
  const std::string first = test::read_bytes(output());
  std::filesystem::remove(output());
  const auto again = calibrate(views_folder(), shared("recordings/calibration/aprilgrid.yaml"),
                               {"--model", "plumb_bob", "--board", "rigid"});
  ASSERT_EQ(again.exit_code, 0) << again.err;
  EXPECT_EQ(test::read_bytes(output()), first);
  EXPECT_EQ(last_line(again.out), last_line(result.out));
}

// The session checks every image of the recording and ends without a key press. Its camera must
// match the camera that `calibrate` computes offline. The short form plays 13 of the images.
TEST_F(CalibrateFromCamera, MatchesOfflineCalibrationOnPlayedRecording) {
  write_listing(test::nightly() ? 32 : 13, 1, test::nightly() ? 0.1 : 0.03);
  const auto source = played_folder();
  const auto target = shared("recordings/calibration/aprilgrid.yaml");
  const std::vector<std::string> fixed = {"--model", "plumb_bob", "--board", "rigid"};
  const auto offline = calibrate(source, target, fixed);
  ASSERT_EQ(offline.exit_code, 0) << offline.err;
  const auto before = load_camera(output());
  std::filesystem::remove(output());
  const auto played = calibrate("recording:" + source.string(), target, fixed);
  ASSERT_EQ(played.exit_code, 0) << played.err;
  const auto camera = load_camera(output());
  ASSERT_TRUE(before && camera);
  EXPECT_LT(projection_difference(*before, *camera).mean_px, 0.03);
  EXPECT_THAT(last_line(played.out), testing::StartsWith("good: "));
  EXPECT_THAT(last_line(offline.out), testing::StartsWith("good: "));
  EXPECT_THAT(played.out, HasSubstr(test::nightly() ? "view 25: " : "view 13: "));
  EXPECT_THAT(played.out, Not(HasSubstr("hold")))
      << "a recording needs no advice to hold the target";
  const auto sized = calibrate("recording:" + source.string(), target, {"--size", "640x480"});
  EXPECT_EQ(sized.exit_code, 2) << sized.err;
}

TEST_F(CalibrateFromCamera, WritesNoResultWhenInterruptedWithTooFewViews) {
  write_listing(1, 2000);
  std::jthread interrupt;
  const auto result = test::run_program(test::program(), arguments({}), {}, {}, [&](pid_t process) {
    // Sends SIGINT after the first view.
    interrupt = std::jthread([this, process] {
      for (int i = 0; i < 600 && !std::filesystem::exists(views_folder() / "000000.png"); ++i)
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
      kill(process, SIGINT);
    });
  });
  interrupt = {};  // joins the thread
  expect_refused(result, "at least 3 views");
  EXPECT_THAT(result.out, HasSubstr("no display; going on without a window"));
  EXPECT_TRUE(std::filesystem::exists(views_folder() / "000000.png"))
      << "the kept views must remain";
  // A folder that is not empty must be rejected.
  const auto second = test::run_program(test::program(), arguments({"--no-window"}));
  expect_refused(second, "holds files already");
  EXPECT_THAT(second.out, Not(HasSubstr("window")));
}

// The key V takes a session from a guessed lens to a calibrated one.
TEST_F(CalibrateFromCamera, BeginsByKeyOfLiveAndGoesOn) {
  ASSERT_EQ(std::system("command -v Xvfb >/dev/null 2>&1 && command -v xdotool >/dev/null 2>&1"), 0)
      << "scripts/setup installs both";
  write_listing(13, 2);
  const auto result = test::run_program(
      test::source_dir() / "tests" / "support" / "with-display",
      {(test::source_dir() / "tests" / "support" / "calibrate-by-key").string(),
       test::program().string(), "live", "--camera", "recording:" + played_folder().string(),
       "--fov", "--tags", shared("recordings/calibration/tags.yaml").string(), "--duration", "60"},
      {}, folder());
  ASSERT_EQ(result.exit_code, 0) << result.err << result.out;
  EXPECT_THAT(result.out, HasSubstr("(60 degrees are assumed)"));
  const auto truth = load_camera(shared("recordings/calibration/camera.yaml"));
  const auto camera = load_camera(folder() / "camera.yaml");
  ASSERT_TRUE(truth && camera);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.5);
  // The table of the second session.
  const std::size_t first = result.out.find("tracked 0, uncertain ");
  ASSERT_NE(first, std::string::npos) << result.out;
  EXPECT_THAT(result.out.substr(first + 1),
              testing::ContainsRegex("tracked [1-9][0-9]*, uncertain "));
}

// A run from existing tags to a checked camera, and a second one that goes on with its files.
TEST_F(CalibrateFromCamera, SetsUpTableInOneRun) {
  write_listing(13, 2);
  const auto table = folder() / "table";
  std::filesystem::create_directory(table);
  std::filesystem::copy_file(shared("recordings/calibration/tags.yaml"), table / "tags.yaml");
  const auto config = folder() / "config" / "config.yaml";
  const auto set_up = [&] {
    return test::run_program(test::program(),
                             {"setup", table.string(), "--camera",
                              "recording:" + played_folder().string(), "--config", config.string()},
                             {}, folder());
  };
  const auto first = set_up();
  ASSERT_EQ(first.exit_code, 0) << first.err << first.out;
  EXPECT_THAT(first.out, HasSubstr("tags.yaml: used as it is"));
  EXPECT_THAT(first.out, testing::ContainsRegex("tracked in [1-9][0-9]* of"));
  EXPECT_THAT(first.out, HasSubstr("Good."));
  EXPECT_THAT(first.out, HasSubstr("config.yaml: written. Start with: penumbra live --config"));
  const auto truth = load_camera(shared("recordings/calibration/camera.yaml"));
  const auto camera = load_camera(table / "camera.yaml");
  ASSERT_TRUE(truth && camera);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.5);
  EXPECT_TRUE(std::filesystem::exists(table / "calibration.html"));
  const auto live = test::run_program(
      test::program(), {"live", "--config", config.string(), "--duration", "1", "--no-window"}, {},
      folder());
  EXPECT_EQ(live.exit_code, 0) << live.err;
  EXPECT_THAT(live.out, HasSubstr("config.yaml (camera, calibration, tags)"));

  const std::string written = test::read_bytes(table / "camera.yaml");
  const auto second = set_up();
  ASSERT_EQ(second.exit_code, 0) << second.err;
  EXPECT_THAT(second.out, HasSubstr("camera.yaml exists. Calibrate again?"));
  EXPECT_EQ(test::read_bytes(table / "camera.yaml"), written);
  EXPECT_THAT(second.out, HasSubstr("has these options already"));
}

// The tags of another sheet are named with a camera too, and nothing is written.
TEST_F(CalibrateFromCamera, NamesSheetInViewAtSetup) {
  write_listing(4, 1);
  const auto table = folder() / "table";
  std::filesystem::create_directory(table);
  ASSERT_TRUE(write_text_file(table / "tags.yaml",
                              "tags:\n  - {id: 0, family: tag25h9, size_m: 0.04, "
                              "position: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n"));
  const auto result = test::run_program(
      test::program(),
      {"setup", table.string(), "--camera", "recording:" + played_folder().string(), "--config",
       (folder() / "config.yaml").string()},
      {}, folder());
  EXPECT_EQ(result.exit_code, 1) << result.out;
  EXPECT_THAT(result.err, HasSubstr("not in the target file (tag36h11 0 to 35)"));
  EXPECT_FALSE(std::filesystem::exists(folder() / "config.yaml"));
}

// The sheet is printed before the lens is known, and stays if the calibration fails.
TEST_F(CalibrateFromCamera, PrintsSheetWithMeasuredRulerAtSetup) {
  write_listing(4, 1);
  const auto table = folder() / "table";
  const auto result = test::run_program(
      "/bin/bash",
      {"-c", "printf 'long\\n10\\n99\\n' | \"$@\"", "bash", test::program().string(), "setup",
       table.string(), "--camera", "recording:" + played_folder().string(), "--config",
       (folder() / "config.yaml").string(), "--page", "letter"},
      {}, folder());
  EXPECT_EQ(result.exit_code, 1) << result.out;
  EXPECT_THAT(result.out, HasSubstr("10: give a number from 50 to 200"));
  EXPECT_THAT(result.out, HasSubstr("tags of 39.60 mm"));
  EXPECT_TRUE(test::read_bytes(table / "sheet.pdf").starts_with("%PDF"));
  EXPECT_THAT(test::read_bytes(table / "tags.yaml"), HasSubstr("size_m: 0.0396"));
  EXPECT_FALSE(std::filesystem::exists(folder() / "config.yaml"));
}

// If the display is lost, the program calibrates from the views it has kept so far.
TEST_F(CalibrateFromCamera, SolvesFromKeptViewsWhenDisplayIsLost) {
  ASSERT_EQ(std::system("command -v Xvfb >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  write_listing(16, 2);
  test::VirtualDisplay display;
  std::vector<std::string> words = arguments({"--model", "plumb_bob", "--board", "rigid",
                                              "--report", (folder() / "report.html").string()});
  words.insert(words.begin(), test::program().string());
  test::RunningProgram running(words, [&] { setenv("DISPLAY", display.name().c_str(), 1); });
  while (running.runs() && !std::filesystem::exists(views_folder() / "000005.png")) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  display.end(SIGKILL);
  EXPECT_EQ(running.exit_code(), 1);
  const auto camera = load_camera(output());
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_TRUE(test::read_bytes(folder() / "report.html").ends_with("</html>\n"));
  // Calibrating from the stored views must give the same result.
  const std::string first = test::read_bytes(output());
  const auto again = calibrate(views_folder(), shared("recordings/calibration/aprilgrid.yaml"),
                               {"--model", "plumb_bob", "--board", "rigid"});
  ASSERT_EQ(again.exit_code, 0) << again.err;
  EXPECT_EQ(test::read_bytes(output()), first);
}

TEST_F(CalibrateFromCamera, KeepsViewsWhenDisplayIsLostTooEarlyToSolve) {
  ASSERT_EQ(std::system("command -v Xvfb >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  write_listing(1, 2000);
  test::VirtualDisplay display;
  std::vector<std::string> words = arguments({});
  words.insert(words.begin(), test::program().string());
  test::RunningProgram running(words, [&] { setenv("DISPLAY", display.name().c_str(), 1); });
  while (running.runs() && !std::filesystem::exists(views_folder() / "000000.png")) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  display.end(SIGTERM);
  EXPECT_EQ(running.exit_code(), 1);
  EXPECT_FALSE(std::filesystem::exists(output()));
  EXPECT_TRUE(load_image(views_folder() / "000000.png"));
}

// Ctrl-C and SIGTERM end the program soon, even during the solution, and leave old files unchanged.
// The short form sends two signals, the nightly form a series.
TEST_F(CalibrateCommand, StopsPromptlyOnSignalAndKeepsOldFiles) {
  const auto results = folder() / "results";
  std::filesystem::create_directories(results);
  const auto in_results = [&](const char* name) { return (results / name).string(); };
  test::write_text(results / "camera.yaml", "mine");
  // The short form uses every other image and calibrates in half of the time.
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/calibration"), test::nightly() ? 1 : 2);
  struct Run {
    std::vector<std::string> arguments;
    int first_delay_ms;  // short form: the second signal comes during the solution
  };
  const std::vector<Run> runs = {
      {{"calibrate", source.string(), "--target", (source / "aprilgrid.yaml").string(), "--output",
        in_results("camera.yaml"), "--report", in_results("report.html")},
       600},
      {{"map", shared("recordings/tabletop").string(), "--tag-size", "0.04", "--anchor", "5",
        "--refine-camera", in_results("camera.yaml"), "--output", in_results("tags.yaml")},
       400}};
  for (const auto& [arguments, first_delay_ms] : runs) {
    int early = 0;  // number of runs that the signal ended early
    const int percent = test::nightly() ? 160 : 200;
    for (int delay_ms = test::nightly() ? 400 : first_delay_ms;
         delay_ms <= 12'000 && (test::nightly() || early < 2);
         delay_ms = delay_ms * percent / 100) {
      Stopwatch since_signal;
      const auto result = test::run_program(test::program(), arguments, {}, {}, [&](pid_t process) {
        siginfo_t ended{};
        for (int ms = 0; ms < delay_ms && ended.si_pid == 0; ms += 20) {
          std::this_thread::sleep_for(std::chrono::milliseconds(20));
          waitid(P_PID, static_cast<id_t>(process), &ended, WEXITED | WNOHANG | WNOWAIT);
        }
        since_signal.restart();
        kill(process, early % 2 == 0 ? SIGINT : SIGTERM);
      });
      if (result.exit_code == 0) break;
      EXPECT_EQ(std::distance(std::filesystem::directory_iterator(results), {}), 1);
      if (result.exit_code > 128)
        continue;  // the signal killed the program before it opened a file
      EXPECT_LT(since_signal.elapsed().wall_ms, 3000.0) << arguments[0] << ' ' << delay_ms;
      EXPECT_EQ(result.exit_code, 1) << result.err;
      EXPECT_THAT(result.err, HasSubstr("ended early; no file was written"));
      EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
      EXPECT_EQ(test::read_bytes(results / "camera.yaml"), "mine");
      ++early;
    }
    EXPECT_GE(early, 2) << arguments[0];
    std::filesystem::remove_all(results);
    std::filesystem::create_directories(results);
    test::write_text(results / "camera.yaml", "mine");
  }
}

TEST_F(CalibrateCommand, ReportsPredictedErrorOverTable) {
  const auto report = folder() / "report.html";
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/chessboard"), 2);
  const auto result =
      calibrate(source, source / "chessboard.yaml",
                {"--model", "plumb_bob", "--board", "rigid", "--report", report.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("objects on the table are drawn to "));
  EXPECT_THAT(test::read_bytes(report), HasSubstr("Over the table"));
  const YAML::Node volume = YAML::LoadFile(output().string())["uncertainty"]["table_volume"];
  const auto tracked = volume["tracked_px"].as<std::vector<double>>();
  ASSERT_EQ(tracked.size(), 8U);
  ASSERT_EQ(volume["known_pose_px"].size(), 8U);
  for (const double sigma : tracked) {
    EXPECT_GT(sigma, 0.0);
    EXPECT_LT(sigma, 1.0);
  }
}

TEST_F(CalibrateCommand, RejectsAprilGridOfWrongProportions) {
  const auto wrong = folder() / "wrong.yaml";
  test::write_text(wrong,
                   "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.033\n"
                   "tagSpacing: 0.1818\n");
  const auto thinned = folder() / "thinned";
  test::write_thinned_recording(thinned, shared("recordings/calibration"), 4);
  expect_refused(calibrate(thinned, wrong), "smaller than the target file says");
}

// The tags of `bent` are curved: their corners are 0.22 mm RMS off the best flat squares.
TEST_F(MapCommand, MeasuresCurvatureOfBentSheet) {
  const auto tags = folder() / "tags.yaml";
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/bent"), test::nightly() ? 1 : 2);
  const auto result =
      test::run_program(test::program(), {"map", source.string(), "--sizes",
                                          shared("recordings/bent/tags.yaml").string(), "--anchor",
                                          "57", "--output", tags.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("paper: curved (surface); "));
  const auto found = load_tag_map(tags);
  ASSERT_TRUE(found) << found.error().message;
  std::map<std::pair<int, int>, Eigen::Vector3d> truth;  // by tag and corner
  std::ifstream file(shared("recordings/bent/corners-true.csv"));
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::ranges::replace(line, ',', ' ');
    std::istringstream fields(line);
    int id = 0;
    int corner = 0;
    Eigen::Vector3d p;
    fields >> id >> corner >> p.x() >> p.y() >> p.z();
    truth[{id, corner}] = p;
  }
  Eigen::Matrix3Xd a(3, 4 * found->tags().size());
  Eigen::Matrix3Xd b(3, 4 * found->tags().size());
  for (std::size_t i = 0; i < found->tags().size(); ++i) {
    const auto corners = found->tags()[i].corners();
    for (std::size_t k = 0; k < 4; ++k) {
      const auto column = static_cast<Eigen::Index>(4 * i + k);
      a.col(column) = corners[k];
      b.col(column) = truth.at({found->tags()[i].id, static_cast<int>(k)});
    }
  }
  const Eigen::Matrix4d motion = Eigen::umeyama(a, b, false);
  const Eigen::Matrix3Xd moved =
      (motion.topLeftCorner<3, 3>() * a).colwise() + Eigen::Vector3d(motion.topRightCorner<3, 1>());
  // 0.095 mm with all frames, 0.27 mm with flat tags. Half of the frames have larger errors by the
  // square root of 2.
  EXPECT_LT(std::sqrt((moved - b).squaredNorm() / static_cast<double>(a.cols())), 0.15e-3);
}

// The short form uses every third frame; the covariances in its file predict larger errors, and
// its bounds are larger by the square root of 3.
TEST_F(MapCommand, RecoversTabletopTags) {
  const auto tags = folder() / "tags.yaml";
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/tabletop"), test::nightly() ? 1 : 3);
  const double factor = test::nightly() ? 1.0 : std::sqrt(3.0);
  const auto result = test::run_program(
      test::program(),
      {"map", source.string(), "--tag-size", "0.04", "--anchor", "5", "--output", tags.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto found = load_tag_map(tags);
  const auto truth = load_tag_map(shared("recordings/tabletop/tags.yaml"));
  ASSERT_TRUE(found && truth);
  ASSERT_EQ(found->tags().size(), truth->tags().size());
  // One map is relative to the anchor, the other to the sheet, so they differ by a rigid motion.
  Eigen::Matrix3Xd a(3, found->tags().size());
  Eigen::Matrix3Xd b(3, found->tags().size());
  for (std::size_t i = 0; i < found->tags().size(); ++i) {
    const MappedTag& tag = found->tags()[i];
    a.col(static_cast<Eigen::Index>(i)) = tag.T_table_tag.translation();
    b.col(static_cast<Eigen::Index>(i)) =
        truth->find(tag.family, tag.id)->T_table_tag.translation();
  }
  const Eigen::Matrix4d motion = Eigen::umeyama(a, b, false);
  const Eigen::Matrix3Xd moved =
      (motion.topLeftCorner<3, 3>() * a).colwise() + Eigen::Vector3d(motion.topRightCorner<3, 1>());
  EXPECT_LT(std::sqrt((moved - b).squaredNorm() / static_cast<double>(a.cols())), factor * 0.1e-3);
  // The scale is accurate to 1/1000; ignoring the camera response would cause a larger error.
  const auto spread = [](const Eigen::Matrix3Xd& p) {
    return (p.colwise() - p.rowwise().mean()).norm();
  };
  EXPECT_NEAR(spread(a) / spread(b), 1.0, factor * 1e-3);
  for (const MappedTag& tag : found->tags()) EXPECT_TRUE(tag.curvature.is_flat()) << tag.id;
  // The errors must match the covariances in the file.
  const YAML::Node file = YAML::LoadFile(tags.string());
  const Eigen::Vector3d anchor = truth->find(TagFamily::tag36h11, 5)->T_table_tag.translation();
  double squares = 0.0;
  int count = 0;
  for (const YAML::Node& tag : file["tags"]) {
    const int id = tag["id"].as<int>();
    if (id == 5) continue;
    const auto p = tag["position"].as<std::array<double, 3>>();
    const Eigen::Vector2d e =
        Eigen::Vector2d(p[0], p[1]) -
        (truth->find(TagFamily::tag36h11, id)->T_table_tag.translation() - anchor).head<2>();
    Eigen::Matrix2d covariance;
    for (int row = 0; row < 2; ++row) {
      for (int column = 0; column < 2; ++column)
        covariance(row, column) = tag["covariance"][6 * row + column].as<double>();
    }
    squares += e.dot(covariance.inverse() * e);
    count += 2;
  }
  EXPECT_LT(squares / count, 2.0);
  EXPECT_GT(squares / count, 0.1);
}

TEST_F(MapCommand, ReportsAndRejectsTagOfWrongSize) {
  const auto sizes = folder() / "sizes.yaml";
  std::string lines;
  const auto thinned = folder() / "thinned";
  test::write_thinned_recording(thinned, shared("recordings/tabletop"), 4);
  for (int id = 0; id < 12; ++id) lines += fmt::format("{}: {}\n", id, id == 7 ? 0.06 : 0.04);
  test::write_text(sizes, lines);
  const auto tags = folder() / "tags.yaml";
  const auto result =
      test::run_program(test::program(), {"map", thinned.string(), "--sizes", sizes.string(),
                                          "--anchor", "5", "--output", tags.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("tag 7: appears to be 40.0 mm in size, but 60.0 mm is given"));
  const auto found = load_tag_map(tags);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->tags().size(), 11U);
}

// The lens of `tabletop` is true, so it stays as it is, with the record of its calibration.
TEST_F(MapCommand, KeepsTrueLens) {
  const auto tags = folder() / "tags.yaml";
  const auto camera = folder() / "refined.yaml";
  const auto thinned = folder() / "thinned";
  test::write_thinned_recording(thinned, shared("recordings/tabletop"), 6);
  const auto given = folder() / "given.yaml";
  test::write_text(given, read_text_file(thinned / "camera.yaml", 1 << 20).value() +
                              "calibrated_on: \"2026-03-01\"\nfocus_position: 30\n"
                              "uncertainty: {target: \"a sheet\", views: 7, overlay_px: 0.25, "
                              "standard_deviations: [1, 1, 2, 2, 0.01, 0.01, 0, 0, 0.01]}\n");
  const auto result =
      test::run_program(test::program(), {"map", thinned.string(), "--camera", given.string(),
                                          "--tag-size", "0.04", "--anchor", "5", "--output",
                                          tags.string(), "--refine-camera", camera.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto found = load_camera(camera);
  const auto truth = load_camera(thinned / "camera.yaml");
  ASSERT_TRUE(found && truth);
  EXPECT_EQ(found->parameters().fx, truth->parameters().fx);
  EXPECT_EQ(found->parameters().distortion, truth->parameters().distortion);
  EXPECT_THAT(result.out, HasSubstr("camera: the given lens, "));
  EXPECT_EQ(found->parameters().overlay_sigma_px, 0.25);
  const auto record = load_calibration_record(camera, *found);
  ASSERT_TRUE(record && *record);
  EXPECT_EQ((*record)->calibrated_on, "2026-03-01");
  EXPECT_EQ((*record)->target, "a sheet");
  EXPECT_EQ((*record)->views, 7);
  EXPECT_EQ((*record)->focus_position, 30.0);
  EXPECT_EQ((*record)->standard_deviations.size(), 9U);
  const auto same = test::run_program(
      test::program(), {"map", thinned.string(), "--tag-size", "0.04", "--anchor", "5", "--output",
                        tags.string(), "--refine-camera", tags.string()});
  EXPECT_EQ(same.exit_code, 2) << same.err;
}

TEST_F(MapCommand, CorrectsWrongLens) {
  const auto camera = folder() / "refined.yaml";
  const auto source = folder() / "source";
  test::write_thinned_recording(source, shared("recordings/lens"), test::nightly() ? 1 : 2);
  const auto result = test::run_program(
      test::program(), {"map", source.string(), "--tag-size", "0.04", "--anchor", "5", "--output",
                        (folder() / "tags.yaml").string(), "--refine-camera", camera.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("camera: refined lens, "));
  const auto found = load_camera(camera);
  const auto truth = load_camera(shared("recordings/lens/camera-true.yaml"));
  ASSERT_TRUE(found && truth);
  const CameraParameters& p = found->parameters();
  const CameraParameters& q = truth->parameters();
  const auto record = load_calibration_record(camera, *found);
  ASSERT_TRUE(record && *record);
  const auto& sigmas = (*record)->standard_deviations;
  ASSERT_EQ(sigmas.size(), 9U);
  EXPECT_LT(std::abs(p.fx - q.fx), 3.0 * sigmas[0]);
  EXPECT_LT(std::abs(p.cy - q.cy), 3.0 * sigmas[3]);
  EXPECT_LT(std::abs(p.fx - q.fx), 1.5) << "3.2 px in the given file";
  EXPECT_LT(std::abs(p.distortion[0] - q.distortion[0]), 0.004) << "0.02 in the given file";
  ASSERT_TRUE(p.overlay_sigma_px);
  EXPECT_LT(*p.overlay_sigma_px, 1.0);
}

// The rows of `rolling` are exposed 40 us after each other, which its camera file does not say.
TEST_F(MapCommand, EstimatesRowTime) {
  const auto camera = folder() / "refined.yaml";
  const std::string tags = (folder() / "tags.yaml").string();
  const std::string source = shared("recordings/rolling").string();
  const auto result =
      test::run_program(test::program(), {"map", source, "--tag-size", "0.04", "--anchor", "5",
                                          "--output", tags, "--refine-camera", camera.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("shutter: the row time is "));
  const auto found = load_camera(camera);
  ASSERT_TRUE(found) << found.error().message;
  ASSERT_TRUE(found->parameters().rolling_shutter_row_s);
  EXPECT_NEAR(*found->parameters().rolling_shutter_row_s, 40e-6, 2e-6);
  const YAML::Node sigma = YAML::LoadFile(camera.string())["uncertainty"]["rolling_shutter_row_s"];
  EXPECT_GT(sigma.as<double>(), 0.0);
  EXPECT_LT(sigma.as<double>(), 2e-6);
  const auto hint = test::run_program(
      test::program(), {"map", source, "--tag-size", "0.04", "--anchor", "5", "--output", tags});
  ASSERT_EQ(hint.exit_code, 0) << hint.err;
  EXPECT_THAT(hint.out, HasSubstr("repeat with --refine-camera"));
}

}  // namespace
}  // namespace penumbra
