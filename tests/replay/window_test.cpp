// The whole program in a real window, on a virtual display.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "replay/replay_support.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;

TEST(Window, PicturesAreTheSameWithAndWithoutWindowAndHud) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const auto arguments = [&](const std::string& name, const std::vector<std::string>& more) {
    std::vector<std::string> words = {
        "replay",       bundled("tabletop"), "--frames", "30:36",
        "--poses-from", "groundtruth",       "--output", (folder.path() / name).string()};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  const ProgramResult offscreen = penumbra(arguments("offscreen", {"--no-window"}));
  ASSERT_EQ(offscreen.exit_code, 0) << offscreen.err;
  const ProgramResult hud = in_window(arguments("hud", {}), folder.path());
  ASSERT_EQ(hud.exit_code, 0) << hud.err;
  EXPECT_EQ(hud.out.find("offscreen"), std::string::npos) << "there was a window";
  const ProgramResult bare = in_window(arguments("bare", {"--no-hud"}), folder.path());
  ASSERT_EQ(bare.exit_code, 0) << bare.err;
  const auto expected = contents_of(folder.path() / "offscreen");
  EXPECT_EQ(expected.size(), 6U);
  EXPECT_EQ(contents_of(folder.path() / "hud"), expected);
  EXPECT_EQ(contents_of(folder.path() / "bare"), expected);
}

// What was done while it was recorded happens again, the same each time, and can be left out.
TEST(Window, RecordedEditsAreReplayed) {
  const TemporaryFolder folder;
  const fs::path recording = folder.path() / "recording";
  fs::create_directory(recording);
  for (const auto& entry : fs::directory_iterator(bundled("tabletop"))) {
    fs::create_symlink(entry.path(), recording / entry.path().filename());
  }
  std::string first_time = lines_of(bytes_of(recording / "timestamps.csv"))[1 + 33];
  first_time = first_time.substr(first_time.find(',') + 1);
  first_time = first_time.substr(0, first_time.find(','));
  std::ofstream(recording / "events.jsonl")
      << R"({"timestamp_s":)" << first_time
      << R"(,"event":"object_moved","object":"helicopter","position":[0.0,0.0,0.05],)"
      << R"("quaternion_xyzw":[0.0,0.0,0.0,1.0],"scale":1.0})"
      << "\n";
  const auto run = [&](const std::string& name, const std::vector<std::string>& more) {
    std::vector<std::string> words = {
        "replay",      recording.string(), "--frames",
        "31:35",       "--poses-from",     "groundtruth",
        "--no-window", "--output",         (folder.path() / name).string()};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return contents_of(folder.path() / name);
  };
  const auto edited = run("edited", {});
  const auto again = run("again", {});
  const auto without = run("without", {"--no-edits"});
  ASSERT_EQ(edited.size(), 4U);
  EXPECT_EQ(edited, again);
  for (const char* before : {"000031.png", "000032.png"}) {
    EXPECT_EQ(edited.at(before), without.at(before));
  }
  for (const char* after : {"000033.png", "000034.png"}) {
    EXPECT_NE(edited.at(after), without.at(after));
  }
}

// A person's hand in a live session: what was dragged there replays to the same pictures, bit for
// bit, at the poses that the session had.
TEST(Window, ADragIsRecordedAndReplaysToTheSamePictures) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  // As wide as the view's middle is uncertain: it lies under the pixel wherever the camera goes.
  std::ofstream(path("scene.json"))
      << R"({"objects":[{"name":"block","shape":{"kind":"box","size":[0.1,0.08,0.04]},)"
      << R"("position":[0,0,0.06],"animation":{"spin":{"turns_per_s":0.1}}}],)"
      << R"("lights":[{"name":"lamp","kind":"point","position":[-0.2,-0.1,0.9]}],)"
      << R"("shadows":[{"name":"shadow","technique":"layered"}]})";
  const ProgramResult live =
      run_program(source_dir() / "tests" / "support" / "with-display",
                  {(source_dir() / "tests" / "support" / "drag-by-mouse").string(),
                   path("session/events.jsonl"),
                   "320 240",
                   "380 250",
                   program().string(),
                   "live",
                   "--camera",
                   "recording:" + bundled("tabletop"),
                   "--calibration",
                   bundled("tabletop") + "/camera.yaml",
                   "--scene",
                   path("scene.json"),
                   "--record",
                   path("session"),
                   "--output",
                   path("live"),
                   "--poses",
                   path("live.tum"),
                   "--poses-all",
                   "--duration",
                   "120"},
                  {}, folder.path());
  ASSERT_EQ(live.exit_code, 0) << live.err;
  const auto replayed = [&](const char* name, const std::vector<std::string>& more) {
    std::vector<std::string> words = {"replay",         path("session"),    "--no-window",
                                      "--scene",        path("scene.json"), "--poses-from",
                                      path("live.tum"), "--output",         path(name)};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return contents_of(folder.path() / name);
  };
  const auto seen = contents_of(folder.path() / "live");
  const auto edited = replayed("edited", {});
  const auto unedited = replayed("unedited", {"--no-edits"});
  ASSERT_GT(seen.size(), 10U);
  int moved = 0;
  for (const auto& [name, picture] : seen) {
    ASSERT_TRUE(edited.contains(name)) << name;
    EXPECT_EQ(picture, edited.at(name)) << name;
    moved += picture != unedited.at(name) ? 1 : 0;
  }
  EXPECT_GT(moved, 3);
}

}  // namespace
}  // namespace penumbra::test
