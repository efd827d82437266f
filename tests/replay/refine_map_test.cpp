// replay and live with --refine-map.
#include <gmock/gmock.h>

#include "core/camera/camera_file.hpp"
#include "core/geometry/tag_map.hpp"
#include "replay_support.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

class RefineMap : public testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  // Replays a recording without drawing, and returns the report.
  [[nodiscard]] nlohmann::json replayed(const std::string& recording, const std::string& name,
                                        std::vector<std::string> more) const {
    std::vector<std::string> arguments = {"replay",
                                          recording,
                                          "--no-window",
                                          "--scene",
                                          empty_scene_in(folder_.path()),
                                          "--poses",
                                          file(name + ".tum"),
                                          "--report",
                                          file(name + ".json")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    out_ = result.out;
    return read_json(file(name + ".json"));
  }

  TemporaryFolder folder_;
  mutable std::string out_;
};

TEST_F(RefineMap, KeepsMapAndLensOfFlatSheet) {
  const std::string recording = bundled("tabletop");
  (void)replayed(recording, "plain", {});
  const nlohmann::json report =
      replayed(recording, "refined",
               {"--refine-map", file("map.yaml"), "--refine-camera", file("camera.yaml")});
  EXPECT_GE(report["map_refinement"]["keyframes"], 8);
  EXPECT_EQ(report["map_refinement"]["refinements"], 0);
  EXPECT_EQ(report["map_refinement"]["change_mm"]["max"], 0.0);
  EXPECT_EQ(report["map_refinement"]["file"], file("map.yaml"));
  EXPECT_THAT(out_, HasSubstr("tag map: not refined"));
  EXPECT_EQ(bytes_of(file("refined.tum")), bytes_of(file("plain.tum")));
  const TagMap given = load_tag_map(std::filesystem::path(recording) / "tags.yaml").value();
  EXPECT_EQ(bytes_of(file("map.yaml")), tag_map_text(given));
  EXPECT_FALSE(report["map_refinement"].contains("lens_gain"));
  EXPECT_FALSE(report["map_refinement"].contains("row_time_us"));
  EXPECT_THAT(out_, HasSubstr("camera: the given lens"));
  const auto given_camera = load_camera(std::filesystem::path(recording) / "camera.yaml");
  const auto written = load_camera(file("camera.yaml"));
  ASSERT_TRUE(given_camera && written);
  EXPECT_EQ(written->parameters().fx, given_camera->parameters().fx);
  EXPECT_EQ(written->parameters().distortion, given_camera->parameters().distortion);
}

TEST_F(RefineMap, ReportsWhyShortRecordingIsNotRefined) {
  const nlohmann::json report =
      replayed(bundled("tabletop"), "short", {"--frames", "0:3", "--refine-map"});
  EXPECT_TRUE(report["map_refinement"]["file"].is_null());
  EXPECT_THAT(out_, HasSubstr("8 are needed"));
  EXPECT_THAT(out_, HasSubstr("not written (--refine-map FILE writes it)"));
}

TEST_F(RefineMap, FindsShapeOfBentSheetWithAnyNumberOfThreads) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::string recording = (shared_dir() / "recordings" / "bent").string();
  const auto replayed_half = [&](const std::string& name, std::vector<std::string> more) {
    more.insert(more.end(), {"--frames", "0:32", "--refine-map", file(name + ".yaml")});
    return replayed(recording, name, more);
  };
  const nlohmann::json report = replayed_half("parallel", {});
  (void)replayed_half("serial", {"--threads", "1"});
  EXPECT_EQ(bytes_of(file("parallel.tum")), bytes_of(file("serial.tum")));
  EXPECT_EQ(bytes_of(file("parallel.yaml")), bytes_of(file("serial.yaml")));
  EXPECT_GE(report["map_refinement"]["refinements"], 3);
  EXPECT_NEAR(report["map_refinement"]["change_mm"]["rmse"], 1.8, 0.1);
  EXPECT_EQ(report["frames_tracked"], 32);
  EXPECT_LT(report["accuracy"]["overlay_px"]["median"], 0.06);  // 1.0 px with the flat map
  const nlohmann::json again =
      replayed(recording, "again", {"--tags", file("parallel.yaml"), "--frames", "32:64"});
  EXPECT_LT(again["accuracy"]["overlay_px"]["rmse"], 0.097);  // 1.9 px with the flat map
}

TEST_F(RefineMap, FindsRowTimeOfRollingShutterAndUsesIt) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::string recording = (shared_dir() / "recordings" / "rolling").string();
  const nlohmann::json report =
      replayed(recording, "first",
               {"--refine-map", file("map.yaml"), "--refine-camera", file("camera.yaml")});
  EXPECT_NEAR(report["map_refinement"]["row_time_us"]["value"], 40.0, 2.0);
  EXPECT_GE(report["frames_tracked"], 60);
  EXPECT_LT(report["accuracy"]["overlay_px"]["median"], 0.35);  // 1.9 px without a row time
  const nlohmann::json again = replayed(
      recording, "again", {"--tags", file("map.yaml"), "--calibration", file("camera.yaml")});
  EXPECT_EQ(again["frames_tracked"], 64);
  EXPECT_LT(again["accuracy"]["overlay_px"]["rmse"], 0.33);  // 2.7 px without a row time
}

TEST_F(RefineMap, WritesRefinedLensForTheNextRun) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::string recording = (shared_dir() / "recordings" / "lens").string();
  const nlohmann::json report =
      replayed(recording, "first",
               {"--refine-map", file("map.yaml"), "--refine-camera", file("camera.yaml")});
  EXPECT_GT(report["map_refinement"]["lens_gain"], 0.5);
  EXPECT_THAT(out_, HasSubstr("camera: refined lens"));
  EXPECT_THAT(out_, HasSubstr("tag map: refined with the lens"));
  const nlohmann::json again = replayed(
      recording, "again", {"--tags", file("map.yaml"), "--calibration", file("camera.yaml")});
  EXPECT_EQ(again["frames_tracked"], 60);
  const auto truth = load_camera(std::filesystem::path(recording) / "camera-true.yaml");
  const auto written = load_camera(file("camera.yaml"));
  ASSERT_TRUE(truth && written);
  EXPECT_NEAR(written->parameters().fx / truth->parameters().fx, 1.0, 0.002);  // given: 1.006
  EXPECT_NEAR(written->parameters().distortion[0], truth->parameters().distortion[0], 0.01);
  EXPECT_LT(again["accuracy"]["overlay_px"]["rmse"], 2.0);  // 4.1 px with the given lens
}

TEST_F(RefineMap, RefinesInLiveBesideTheTracking) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::string recording = (shared_dir() / "recordings" / "bent").string();
  const ProgramResult result =
      penumbra({"live", "--camera", "recording:" + recording, "--no-window", "--scene",
                empty_scene_in(folder_.path()), "--duration", "4", "--fps", "30", "--record",
                file("session"), "--refine-map", file("map.yaml"), "--report", file("live.json")});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json report = read_json(file("live.json"));
  EXPECT_GE(report["map_refinement"]["refinements"], 1) << result.out;
  EXPECT_NEAR(report["map_refinement"]["change_mm"]["rmse"], 1.8, 0.2);
  EXPECT_TRUE(load_tag_map(file("map.yaml")));
  // The recording has the map that the session began with.
  EXPECT_EQ(bytes_of(folder_.path() / "session" / "tags.yaml"),
            bytes_of(std::filesystem::path(recording) / "tags.yaml"));
}

TEST_F(RefineMap, WritesCameraAtTheEndOfLive) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const std::string recording = (shared_dir() / "recordings" / "rolling").string();
  const ProgramResult result = penumbra(
      {"live", "--camera", "recording:" + recording, "--no-window", "--scene",
       empty_scene_in(folder_.path()), "--duration", "4",
       "--fps=30",  // not slowed down with a sanitizer, because the rows' shear shows the speed
       "--refine-map", file("map.yaml"), "--refine-camera", file("camera.yaml"), "--report",
       file("live.json")});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const nlohmann::json report = read_json(file("live.json"));
  EXPECT_EQ(report["map_refinement"]["camera_file"], file("camera.yaml"));
  const auto given = load_camera(std::filesystem::path(recording) / "camera.yaml");
  const auto written = load_camera(file("camera.yaml"));
  ASSERT_TRUE(given && written);
  EXPECT_FALSE(given->parameters().rolling_shutter_row_s);
  ASSERT_TRUE(written->parameters().rolling_shutter_row_s) << result.out;
  EXPECT_NEAR(*written->parameters().rolling_shutter_row_s, 40e-6, 4e-6);
  EXPECT_NEAR(report["map_refinement"]["row_time_us"]["value"],
              1e6 * *written->parameters().rolling_shutter_row_s, 0.01);
  EXPECT_EQ(written->width(), given->width());
  EXPECT_TRUE(load_tag_map(file("map.yaml")));
}

}  // namespace
}  // namespace penumbra::test
