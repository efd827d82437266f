#include "core/camera/camera_plausibility.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;

CameraParameters typical_camera() {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = p.fy = 500.0;
  p.cx = 319.5;
  p.cy = 239.5;
  return p;
}

std::string warning_of(const CameraParameters& p) {
  return implausible_parameter(CameraModel::make(p).value()).value_or("");
}

TEST(CameraPlausibility, AcceptsWideTelephotoAndCroppedCameras) {
  EXPECT_EQ(warning_of(typical_camera()), "");
  struct Case {
    const char* name;
    double fx;
    DistortionModel model;
    std::array<double, 8> distortion;
  };
  for (const Case& c :
       {Case{"action camera", 290.0, DistortionModel::plumb_bob, {-0.25, 0.06, 0.0, 0.0, -0.007}},
        Case{"depth camera of 120 degrees",
             315.0,
             DistortionModel::rational,
             {0.4, -2.6, 0.0, 0.0, 1.5, 0.28, -2.4, 1.4}},
        Case{"only corners non-monotonic", 500.0, DistortionModel::plumb_bob, {-0.35, 0.05}},
        Case{"fisheye of 190 degrees",
             193.0,
             DistortionModel::fisheye,
             {0.0034, 0.0007, -0.002, 0.0002}},
        Case{"fisheye of 220 degrees", 167.0, DistortionModel::fisheye, {}},
        Case{"telephoto lens of 2 degrees", 18000.0, DistortionModel::plumb_bob, {0.1}}}) {
    CameraParameters p = typical_camera();
    p.fx = p.fy = c.fx;
    p.model = c.model;
    p.distortion = c.distortion;
    EXPECT_EQ(warning_of(p), "") << c.name;
  }
  CameraParameters p = typical_camera();
  p.cx = 40.0;  // a crop of the right side of a larger image
  p.cy = 470.0;
  EXPECT_EQ(warning_of(p), "");
  p = typical_camera();
  p.fy = 250.0;  // every second row is skipped
  p.height = 240;
  p.cy = 119.5;
  EXPECT_EQ(warning_of(p), "");
}

TEST(CameraPlausibility, ReportsFieldValueAndCause) {
  CameraParameters p = typical_camera();
  p.cx = 959.5;
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("cx is 959.5"), HasSubstr("640 px"),
                                   HasSubstr("another image size")));
  p = typical_camera();
  p.cy = -239.5;
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("cy is -239.5"), HasSubstr("480 px")));
  p = typical_camera();
  p.fy = 5000.0;
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("fy is 5000"), HasSubstr("fx is 500")));
  p = typical_camera();
  p.fx = p.fy = 4.0;
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("fx is 4 px"), HasSubstr("millimetres")));
  p.fx = p.fy = 0.8;
  EXPECT_THAT(warning_of(p), HasSubstr("fx is 0.8 px"));
  p.fx = p.fy = 50000.0;
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("fx is 50000 px"), HasSubstr("0.73 degrees")));
  p.model = DistortionModel::fisheye;
  p.fx = p.fy = 50.0;
  EXPECT_THAT(warning_of(p), HasSubstr("733 degrees"));
}

TEST(CameraPlausibility, WarnsOfDistortionNonMonotonicInsideImage) {
  CameraParameters p = typical_camera();
  p.distortion = {-2.0};
  EXPECT_THAT(warning_of(p), AllOf(HasSubstr("[-2, 0, 0, 0, 0] of plumb_bob"),
                                   HasSubstr("non-monotonic from 136 px")));
  p.model = DistortionModel::fisheye;
  p.distortion = {-0.8};
  EXPECT_THAT(warning_of(p), HasSubstr("[-0.8, 0, 0, 0] of equidistant"));
}

TEST(CameraPlausibility, ReportsFileInWarning) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "camera.yaml";
  CameraParameters p = typical_camera();
  p.cx = 959.5;
  ASSERT_TRUE(save_camera(file, CameraModel::make(p).value()));
  const auto loaded = load_camera_file(file);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_THAT(loaded->warnings,
              testing::ElementsAre(testing::StartsWith(file.string() + ": cx is 959.5")));
}

// Reads every camera file of the bundled and shared recordings, cases and data.
TEST(CameraPlausibility, AcceptsBundledAndSharedCameras) {
  std::vector<fs::path> roots = {test::source_dir() / "recordings"};
  if (const fs::path shared = test::shared_dir(); !shared.empty()) {
    for (const char* name : {"recordings", "cases", "data/real", "vectors"})
      roots.push_back(shared / name);
  }
  int cameras = 0;
  for (const fs::path& root : roots) {
    if (!fs::is_directory(root)) continue;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root)) {
      const fs::path& file = entry.path();
      const std::string extension = file.extension().string();
      if (!entry.is_regular_file() || entry.file_size() > 200'000 ||
          (extension != ".yaml" && extension != ".yml" && extension != ".xml" &&
           extension != ".json"))
        continue;
      const auto camera = load_camera(file);
      if (!camera) continue;  // not a camera file, or a case that must be rejected
      ++cameras;
      EXPECT_EQ(implausible_parameter(*camera).value_or(""), "") << file;
    }
  }
  EXPECT_GE(cameras, roots.size() == 1 ? 2 : 25);
}

}  // namespace
}  // namespace penumbra
