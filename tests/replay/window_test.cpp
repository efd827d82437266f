// The program in a real window, on a virtual display.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "core/image/image_file.hpp"
#include "replay/live_frames.hpp"
#include "support/replay_tracking.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;

TEST(Window, WritesSameFramesWithAndWithoutHud) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const auto arguments = [&](const std::string& name, const std::vector<std::string>& more) {
    std::vector<std::string> words = {
        "replay",       bundled("tabletop"), "--frames", "30:33",
        "--poses-from", "groundtruth",       "--output", (folder.path() / name).string()};
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  const ProgramResult offscreen = penumbra(arguments("offscreen", {"--no-window"}));
  ASSERT_EQ(offscreen.exit_code, 0) << offscreen.err;
  const ProgramResult hud = in_window(arguments("hud", {}), folder.path());
  ASSERT_EQ(hud.exit_code, 0) << hud.err;
  EXPECT_EQ(hud.out.find("offscreen"), std::string::npos)
      << "the program drew offscreen, without a window";
  const ProgramResult bare = in_window(arguments("bare", {"--no-hud"}), folder.path());
  ASSERT_EQ(bare.exit_code, 0) << bare.err;
  const auto expected = contents_of(folder.path() / "offscreen");
  EXPECT_EQ(expected.size(), 3U);
  EXPECT_EQ(contents_of(folder.path() / "hud"), expected);
  EXPECT_EQ(contents_of(folder.path() / "bare"), expected);
}

// Recorded edits replay deterministically, and --no-edits ignores them.
TEST(Window, ReplaysRecordedEdits) {
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

// A drag in a live session must replay to the same images, bit for bit, with the session's poses.
TEST(Window, RecordsDragThatReplaysToSameFrames) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  // The block is larger than the variation of the view's centre, so it is under the pixel for every
  // camera pose.
  std::ofstream(path("scene.json"))
      << R"({"objects":[{"name":"block","shape":{"kind":"box","size":[0.1,0.08,0.04]},)"
      << R"("position":[0,0,0.06],"animation":{"spin":{"turns_per_s":0.1}}}],)"
      << R"("lights":[{"name":"lamp","kind":"point","position":[-0.2,-0.1,0.9]}],)"
      << R"("shadows":[{"name":"shadow","technique":"layered"}]})";
  std::vector<std::string> dragging = {
      (source_dir() / "tests" / "support" / "drag-by-mouse").string(),
      path("session/events.jsonl"),
      path("live"),
      "320 240",
      "380 250",
      program().string()};
  const auto session = live_arguments(
      folder.path(), {"--calibration", bundled("tabletop") + "/camera.yaml", "--scene",
                      path("scene.json"), "--fps", "15", "--duration", "120"});
  dragging.insert(dragging.end(), session.begin(), session.end());
  const ProgramResult live =
      run_program(source_dir() / "tests" / "support" / "with-display", dragging, {}, folder.path());
  ASSERT_EQ(live.exit_code, 0) << live.err;
  const auto replayed = [&](const char* name, const std::vector<std::string>& more) {
    std::vector<std::string> words = {"--scene", path("scene.json")};
    words.insert(words.end(), more.begin(), more.end());
    ProgramResult done;
    return replay_session(folder.path(), name, words, done);
  };
  const auto seen = contents_of(folder.path() / "live");
  const auto edited = replayed("edited", {});
  ASSERT_GT(seen.size(), 10U);
  // A session names images by the camera's frame numbers, which have gaps on a slow machine. A
  // replay numbers them consecutively, so images are matched by their timestamps.
  const auto listed = list_frames(folder.path() / "session");
  ASSERT_TRUE(listed) << listed.error().message;
  // The block moves only at the end.
  const std::size_t first_unedited = listed->size() - std::min<std::size_t>(listed->size(), 20);
  const auto unedited = replayed(
      "unedited", {"--no-edits", "--frames", fmt::format("{}:{}", first_unedited, listed->size())});
  constexpr double kInterval_ns = 1e9 / 15.0 * kSlowness;
  int moved = 0;
  std::size_t compared = 0;
  for (std::size_t i = 0; i < listed->size(); ++i) {
    const auto age_ns =
        static_cast<double>((*listed)[i].timestamp_ns - listed->front().timestamp_ns);
    const auto image = seen.find(fmt::format("{:06}.png", std::lround(age_ns / kInterval_ns)));
    if (image == seen.end()) continue;
    const std::string name = fmt::format("{:06}.png", i);
    ASSERT_TRUE(edited.contains(name)) << name;
    EXPECT_EQ(image->second, edited.at(name)) << name;
    moved += i >= first_unedited && image->second != unedited.at(name) ? 1 : 0;
    ++compared;
  }
  EXPECT_EQ(compared, seen.size());
  EXPECT_GT(moved, 3);
}

// Returns the number of pixels that differ from the video; -1 if the image can't be compared.
int pixels_drawn(const fs::path& image, const RgbaImage& video) {
  const auto seen = load_rgba(image);
  if (!seen || seen->pixels.size() != video.pixels.size()) return -1;
  constexpr int kMaxConversionError = 24;  // error of JPEG, colour conversion and screen
  int drawn = 0;
  for (std::size_t i = 0; i < video.pixels.size(); i += 4) {
    int difference = 0;
    for (std::size_t k = i; k < i + 3; ++k) {
      difference = std::max(difference, std::abs(int{seen->pixels[k]} - int{video.pixels[k]}));
    }
    drawn += difference > kMaxConversionError ? 1 : 0;
  }
  return drawn;
}

// Keys in a live session with a slow camera: a frozen image must not look live, screenshots show
// the window's content, and the recording between two presses of R replays.
TEST(Window, FadesOnStreamStallAndRecordsByKey) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  // The camera repeats one view, so that any change on the screen was drawn by the program. Its
  // first and last image are whole; for more than a second between them, all images are damaged. (A
  // recording drops damaged images at its end.) Damaged images have start and end markers, because
  // truncated images are not recorded.
  const fs::path camera = folder.path() / "camera";
  const fs::path view = fs::path(bundled("tabletop")) / "frames" / "000030.jpg";
  fs::create_directories(camera / "frames");
  fs::copy(view, camera / "frames" / "0.jpg");
  const std::string whole = bytes_of(view);
  constexpr int kImages = 12;
  std::string listing = "frame,timestamp_s,file\n0,0.0,frames/0.jpg\n";
  for (int i = 1; i < kImages; ++i) {
    const std::string name = fmt::format("frames/{}.jpg", i);
    std::ofstream(camera / name, std::ios::binary)
        << (i + 1 < kImages ? whole.substr(0, whole.size() / 2) + "\xFF\xD9" : whole);
    listing += fmt::format("{},{:.1f},{}\n", i, 0.1 * i, name);
  }
  for (const char* file : {"camera.yaml", "tags.yaml"}) {
    fs::copy(fs::path(bundled("tabletop")) / file, camera / file);
  }
  std::ofstream(camera / "timestamps.csv") << listing;
  std::ofstream(path("scene.json"))
      << R"({"objects":[{"name":"block","shape":{"kind":"box","size":[0.1,0.08,0.04]},)"
      << R"("position":[0,0,0.06]}],"shadows":[]})";
  constexpr int kScreenshots = 10;
  std::string steps = "+live.tum.partial* r +penumbra-*/timestamps.csv";
  for (int i = 0; i < kScreenshots; ++i) steps += fmt::format(" s {:.2f}", 0.17 * kSlowness);
  steps += " r 0.3 Escape";
  const ProgramResult live =
      run_program(source_dir() / "tests" / "support" / "with-display",
                  {(source_dir() / "tests" / "support" / "press-keys").string(), steps,
                   program().string(), "live", "--camera", "recording:" + camera.string(), "--fps",
                   "10", "--no-background-search", "--calibration",
                   (camera / "camera.yaml").string(), "--tags", (camera / "tags.yaml").string(),
                   "--scene", path("scene.json"), "--poses", path("live.tum"), "--duration", "120"},
                  {}, folder.path());
  ASSERT_EQ(live.exit_code, 0) << live.err;

  const auto video = load_rgba(view);
  ASSERT_TRUE(video);
  std::vector<int> drawn;
  fs::path recorded;
  for (const auto& entry : fs::directory_iterator(folder.path())) {
    if (entry.path().extension() == ".png") drawn.push_back(pixels_drawn(entry.path(), *video));
    if (entry.is_directory() && entry.path() != camera) recorded = entry.path();
  }
  ASSERT_GE(drawn.size(), 3U);
  EXPECT_GT(*std::ranges::max_element(drawn), 2000)
      << "the block must be drawn right after a frame";
  EXPECT_LT(*std::ranges::min_element(drawn), 100)
      << "the block must disappear half a second later";
  EXPECT_GE(*std::ranges::min_element(drawn), 0);

  ASSERT_FALSE(recorded.empty());
  EXPECT_NE(live.out.find("recorded "), std::string::npos) << live.out;
  const auto rows = lines_of(bytes_of(recorded / "timestamps.csv"));
  EXPECT_GE(rows.size(), 3U);
  EXPECT_NE(lines_of(bytes_of(recorded / "events.jsonl")).back().find("\"end\""),
            std::string::npos);
  const ProgramResult replayed = penumbra({"replay", recorded.string(), "--no-window", "--scene",
                                           path("scene.json"), "--report", path("report.json")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const auto report = read_json(path("report.json"));
  EXPECT_GE(report["frames"], 1);
  EXPECT_LT(report["frames"], rows.size() - 1) << "replay must skip damaged frames";
  EXPECT_EQ(report["frames_tracked"], report["frames"]);
}

// In a session started in the folder of the played recording, keys save neither screenshots nor
// recordings there.
TEST(Window, NeverSavesIntoPlayedRecording) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const fs::path played = folder.path() / "played";
  fs::copy(bundled("tabletop"), played, fs::copy_options::recursive);
  const auto names = [&played] {
    std::set<std::string> all;
    for (const auto& entry : fs::recursive_directory_iterator(played)) all.insert(entry.path());
    return all;
  };
  const auto before = names();
  const std::string poses = (folder.path() / "out.tum").string();
  for (const std::vector<std::string>& command :
       {std::vector<std::string>{"live", "--camera", "recording:" + played.string(),
                                 "--calibration", (played / "camera.yaml").string(), "--duration",
                                 "120"},
        std::vector<std::string>{"replay", played.string()},
        std::vector<std::string>{"replay", played.string(), "--compare", "none,layered"}}) {
    SCOPED_TRACE(command.front() + " " + command.back());
    std::vector<std::string> words = {(source_dir() / "tests" / "support" / "press-keys").string(),
                                      "+" + poses + ".partial* r 0.15 s 0.15 w 0.15 Escape",
                                      program().string()};
    words.insert(words.end(), command.begin(), command.end());
    words.insert(words.end(), {"--poses", poses, "--log-level", "info"});
    const ProgramResult done =
        run_program(source_dir() / "tests" / "support" / "with-display", words, {}, played);
    ASSERT_EQ(done.exit_code, 0) << done.err;
    EXPECT_NE(done.err.find("start elsewhere to save images"), std::string::npos) << done.err;
    if (command.front() == "live") {
      EXPECT_NE(done.err.find("start elsewhere to record"), std::string::npos) << done.err;
    }
    EXPECT_EQ(names(), before);
  }
}

// The key W writes the arrangement into the current folder, as --save-scene does at the end.
TEST(Window, SavesSceneByKey) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  fs::copy(source_dir() / "scenes/models/tree.glb", path("tree.glb"));
  const ProgramResult live = run_program(
      source_dir() / "tests" / "support" / "with-display",
      {(source_dir() / "tests" / "support" / "press-keys").string(),
       "+live.tum.partial* w +penumbra-*.json Escape", program().string(), "live", "--camera",
       "recording:" + bundled("tabletop"), "--object", path("tree.glb"), "--poses",
       path("live.tum"), "--save-scene", path("end.json"), "--duration", "120"},
      {}, folder.path());
  ASSERT_EQ(live.exit_code, 0) << live.err;
  std::vector<fs::path> saved;
  for (const auto& entry : fs::directory_iterator(folder.path())) {
    if (entry.path().filename().string().starts_with("penumbra-")) saved.push_back(entry.path());
  }
  ASSERT_EQ(saved.size(), 1U);
  EXPECT_EQ(bytes_of(saved.front()), bytes_of(path("end.json")));
  EXPECT_NE(bytes_of(path("end.json")).find("\"model\": \"tree.glb\""), std::string::npos);
}

}  // namespace
}  // namespace penumbra::test
