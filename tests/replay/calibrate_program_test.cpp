// The program on recordings with a known lens, and on what it must refuse.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "calib/camera_calibration.hpp"
#include "core/camera_file.hpp"
#include "core/tag_map.hpp"
#include "support/paths.hpp"
#include "support/recording_folder.hpp"
#include "support/run_program.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;
using testing::Not;

class CalibrateProgram : public testing::Test {
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
  // Frames first, first + step, ... of a recording, in a folder of their own.
  [[nodiscard]] std::filesystem::path some_frames(const std::string& recording, int count) const {
    const auto pictures = folder_.path() / "pictures";
    std::filesystem::create_directories(pictures);
    for (int i = 0; i < count; ++i) {
      const std::string name = test::number6(i) + ".png";
      std::filesystem::copy_file(shared(recording) / "frames" / name, pictures / name);
    }
    return pictures;
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

TEST_F(CalibrateProgram, FindsTheLensOfTheTagGrid) {
  const auto report = folder() / "report.html";
  const auto result =
      calibrate(shared("recordings/calibration"), shared("recordings/calibration/aprilgrid.yaml"),
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
  const std::string html = test::read_bytes(report);
  EXPECT_THAT(html, HasSubstr("class=\"verdict good\""));
  EXPECT_THAT(html, Not(HasSubstr("http")));  // nothing is fetched
}

TEST_F(CalibrateProgram, FindsTheLensOfTheChessboard) {
  const auto result =
      calibrate(shared("recordings/chessboard"), shared("recordings/chessboard/chessboard.yaml"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto truth = load_camera(shared("recordings/chessboard/camera.yaml"));
  const auto camera = load_camera(output());
  ASSERT_TRUE(truth && camera);
  EXPECT_NEAR(camera->parameters().fx, truth->parameters().fx, 1e-3 * truth->parameters().fx);
  EXPECT_NEAR(camera->parameters().cx, truth->parameters().cx, 0.5);
  EXPECT_NEAR(camera->parameters().cy, truth->parameters().cy, 0.5);
  EXPECT_LT(projection_difference(*truth, *camera).mean_px, 0.2);
}

TEST_F(CalibrateProgram, ReadsKalibrsSquares) {
  const auto result = calibrate(shared("recordings/calibration-kalibr"),
                                shared("recordings/calibration-kalibr/aprilgrid.yaml"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto camera = load_camera(output());
  ASSERT_TRUE(camera);
  EXPECT_NEAR(camera->parameters().fx, 531.7, 1.5);
}

TEST_F(CalibrateProgram, IgnoresTheCameraInTheSource) {
  const auto copy = folder() / "copy";
  std::filesystem::copy(shared("recordings/chessboard"), copy,
                        std::filesystem::copy_options::recursive);
  std::filesystem::permissions(copy, std::filesystem::perms::owner_all,
                               std::filesystem::perm_options::add);
  std::filesystem::remove(copy / "camera.yaml");
  test::write_text(copy / "camera.yaml", "broken: [");
  const auto result = calibrate(copy, shared("recordings/chessboard/chessboard.yaml"),
                                {"--model", "plumb_bob", "--board", "rigid"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
}

TEST_F(CalibrateProgram, RefusesWhatCannotWork) {
  const auto grid = shared("recordings/calibration/aprilgrid.yaml");
  const auto chessboard = shared("recordings/chessboard/chessboard.yaml");
  expect_refused(calibrate(shared("recordings/chessboard"), grid), "target");
  expect_refused(calibrate(some_frames("recordings/calibration", 2), grid), "at least 3");
  expect_refused(calibrate(folder() / "nowhere", grid), "no such folder");
  const auto broken = folder() / "broken";
  std::filesystem::create_directories(broken);
  for (int i = 0; i < 5; ++i) test::write_text(broken / (std::to_string(i) + ".png"), "no picture");
  expect_refused(calibrate(broken, chessboard), "in none of 5 pictures");
  const auto mixed = folder() / "pictures";
  test::write_text(mixed / "999999.jpg", test::jpeg_of(1));
  expect_refused(calibrate(mixed, grid), "64 x 48");
  const auto metres = folder() / "metres.yaml";
  test::write_text(metres,
                   "target_type: checkerboard\ninner_cols: 9\ninner_rows: 6\nsquare_m: 25\n");
  expect_refused(calibrate(shared("recordings/chessboard"), metres), "did you mean 0.025");
}

TEST_F(CalibrateProgram, RefusesAGridOfOtherProportions) {
  const auto wrong = folder() / "wrong.yaml";
  test::write_text(wrong,
                   "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.033\n"
                   "tagSpacing: 0.1818\n");
  expect_refused(calibrate(shared("recordings/calibration"), wrong), "");
}

TEST_F(CalibrateProgram, MapFindsTheTabletop) {
  const auto tags = folder() / "tags.yaml";
  const auto result = test::run_program(
      test::program(), {"map", shared("recordings/tabletop").string(), "--tag-size", "0.04",
                        "--anchor", "5", "--output", tags.string()});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto found = load_tag_map(tags);
  const auto truth = load_tag_map(shared("recordings/tabletop/tags.yaml"));
  ASSERT_TRUE(found && truth);
  ASSERT_EQ(found->tags().size(), truth->tags().size());
  // The gauge is the anchor's frame in one and the sheet's in the other: a rigid motion apart.
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
  EXPECT_LT(std::sqrt((moved - b).squaredNorm() / static_cast<double>(a.cols())), 0.5e-3);
}

}  // namespace
}  // namespace penumbra
