// Every bundled scene, replayed by the built program.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "replay/replay_support.hpp"
#include "support/animated_gltf.hpp"
#include "support/recording_folder.hpp"
#include "support/techniques.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

std::vector<std::string> bundled_scenes() {
  std::vector<std::string> scenes;
  for (const auto& entry : std::filesystem::directory_iterator(source_dir() / "scenes")) {
    const std::string stem = entry.path().stem().string();
    if (entry.path().extension() == ".json" && stem != "scene.schema") scenes.push_back(stem);
  }
  std::ranges::sort(scenes);
  return scenes;
}
std::string scene_file(const std::string& scene) {
  return (source_dir() / "scenes" / (scene + ".json")).string();
}

class Scenes : public testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Bundled, Scenes, testing::ValuesIn(bundled_scenes()),
                         [](const auto& instance) { return instance.param; });

TEST_P(Scenes, ReplayOverTabletop) {
  const TemporaryFolder folder;
  std::vector<std::string> words = {"replay",   bundled("tabletop"),
                                    "--scene",  scene_file(GetParam()),
                                    "--frames", "100:106",
                                    "--output", (folder.path() / "out").string(),
                                    "--report", (folder.path() / "report.json").string()};
  // The scene `table` is empty.
  if (GetParam() == "table")
    words.insert(words.end(), {"--object", (source_dir() / "scenes/models/tree.glb").string()});
  const ProgramResult result = penumbra(words);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  // The scene `corner` has an upright board, whose tag group this recording lacks.
  if (GetParam() != "corner") {
    EXPECT_EQ(result.err, "");
  }
  EXPECT_EQ(contents_of(folder.path() / "out").size(), 6U);
  const nlohmann::json report = read_json(folder.path() / "report.json");
  EXPECT_EQ(report.at("frames_tracked"), 6);
  EXPECT_GT(report.at("work").at("triples_recomputed"), 0) << "the scene must have a shadow";
}

// Frames drawn with all skips and caches must equal frames drawn without them. Tests every bundled
// scene and every technique over the recording `tabletop`. The nightly form adds the recording
// `corner` and the scene `stack`.
struct Session {
  std::string scene;
  std::string recording;
  std::string technique;  // empty: the scene's own technique
};
std::vector<Session> sessions() {
  std::vector<Session> sessions;
  for (const std::string& scene : bundled_scenes()) {
    sessions.push_back({scene, "tabletop", ""});
    if (test::nightly() || scene == "corner" || scene == "default")
      sessions.push_back({scene, "corner", ""});
  }
  for (const std::string& technique :
       shadow_words_without({ShadowTechnique::none, ShadowTechnique::layered}))
    sessions.push_back({"default", "tabletop", technique});
  if (test::nightly()) {
    for (const char* technique : {"layered", "field", "hard"})
      sessions.push_back({"stack", "tabletop", technique});
  }
  return sessions;
}
class ReplayedSession : public testing::TestWithParam<Session> {};
INSTANTIATE_TEST_SUITE_P(Bundled, ReplayedSession, testing::ValuesIn(sessions()),
                         [](const auto& instance) {
                           const Session& s = instance.param;
                           return s.scene + "_" + s.recording +
                                  (s.technique.empty() ? "" : "_" + s.technique);
                         });

TEST_P(ReplayedSession, WritesSameFramesWithNoSkip) {
  const Session& session = GetParam();
  const TemporaryFolder folder;
  // In `tabletop` the casters are low at frame 40, and high and over the pad at the end.
  const bool tabletop = session.recording == "tabletop";
  const auto is_used = [&](int frame) {
    if (nightly() || frame == 0) return true;  // the first frame starts the scene's clock
    if (!tabletop) return frame == 30 || frame == 31;
    const bool low = frame == 40 || frame == 41;
    return frame == 116 || frame == 117 || (low && !session.technique.empty());
  };
  const std::filesystem::path recording = folder.path() / "recording";
  write_recording_subset(recording, bundled(session.recording.c_str()), is_used);
  const std::string frames =
      nightly() ? (tabletop ? "0:120" : "0:40") : (tabletop ? "1:118" : "1:32");
  std::map<std::string, nlohmann::json> reports;
  for (const std::string option : {"skip", "no-skip"}) {
    std::vector<std::string> words = {"replay",   recording.string(),
                                      "--scene",  scene_file(session.scene),
                                      "--frames", frames,
                                      "--output", (folder.path() / option).string(),
                                      "--report", (folder.path() / "report.json").string()};
    if (!session.technique.empty()) words.insert(words.end(), {"--shadow", session.technique});
    if (option == "no-skip") words.emplace_back("--no-skip");
    const ProgramResult result = penumbra(words);
    ASSERT_EQ(result.exit_code, 0) << result.err;
    reports[option] = read_json(folder.path() / "report.json");
  }
  EXPECT_GT(contents_of(folder.path() / "skip").size(), 1U);
  EXPECT_EQ(contents_of(folder.path() / "skip"), contents_of(folder.path() / "no-skip"));
  const nlohmann::json& work = reports["no-skip"].at("work");
  for (const char* counter : {"reprojections", "layer_masks_kept", "phantom_masks_kept"}) {
    EXPECT_EQ(work.at(counter), 0) << counter;
  }
  // Groups without a pose are not drawn.
  const nlohmann::json& skipped = reports["no-skip"].at("skipped");
  EXPECT_EQ(work.at("passes_skipped"), skipped.value("group_not_seen", 0));
  EXPECT_EQ(skipped.size(), skipped.count("group_not_seen")) << skipped;
}

// Writes a scene with an animated square over a block, and a model of it at rest.
std::filesystem::path write_animated_scene(const std::filesystem::path& folder) {
  std::ofstream(folder / "square.glb", std::ios::binary) << moving_square().glb();
  const nlohmann::json scene = {
      {"objects",
       {{{"name", "moving"}, {"model", "square.glb"}, {"animation", 0}, {"start", 0.4}},
        {{"name", "rest"}, {"model", "square.glb"}, {"position", {-0.12, 0, 0.03}}},
        {{"name", "block"},
         {"shape", {{"kind", "box"}, {"size", {0.06, 0.06, 0.02}}}},
         {"position", {0.06, -0.04, 0.01}}}}},
      {"lights", {{{"name", "lamp"}, {"kind", "point"}, {"position", {-0.3, 0.1, 0.7}}}}},
      {"shadows", {{{"name", "shadow"}, {"technique", "layered"}}}}};
  std::ofstream(folder / "scene.json") << scene;
  return folder / "scene.json";
}

class AnimatedModels : public testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Techniques, AnimatedModels,
                         testing::ValuesIn(shadow_words_without({ShadowTechnique::none})),
                         [](const auto& instance) { return instance.param; });

TEST_P(AnimatedModels, WriteSameFramesWithNoSkip) {
  const TemporaryFolder folder;
  const std::string scene = write_animated_scene(folder.path()).string();
  const auto frames_with = [&](const std::string& output, const std::vector<std::string>& more) {
    std::vector<std::string> words = {
        "replay", bundled("tabletop"), "--scene",  scene,      "--frames",
        "30:36",  "--shadow",          GetParam(), "--output", (folder.path() / output).string()};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return contents_of(folder.path() / output);
  };
  const auto frames = frames_with("skip", {});
  EXPECT_EQ(frames.size(), 6U);
  EXPECT_EQ(frames, frames_with("no-skip", {"--no-skip"}));
}

// A tree of 26,000 faces under a moving sun and a fixed lantern. Only the sun's shadow may be
// recomputed.
TEST(AnimatedLight, RecomputesOnlyShadowsOfMovingLight) {
  const TemporaryFolder folder;
  constexpr int kFrames = 8;
  const auto work_of = [&](const std::vector<std::string>& more) {
    std::vector<std::string> words = {"replay",       bundled("tabletop"),
                                      "--scene",      scene_file("tree"),
                                      "--poses-from", "groundtruth",
                                      "--frames",     "20:" + std::to_string(20 + kFrames),
                                      "--report",     (folder.path() / "report.json").string()};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return read_json(folder.path() / "report.json").at("work");
  };
  const nlohmann::json hard = work_of({});
  EXPECT_EQ(hard.at("light_moved"), kFrames - 1);
  EXPECT_EQ(hard.at("object_moved"), 0);
  EXPECT_EQ(hard.at("object_rotated"), 0);
  // One tree, one plane and two lights: the first frame computes both shadows, each later frame the
  // sun's.
  EXPECT_EQ(hard.at("triples_recomputed"), 2 + (kFrames - 1));
  EXPECT_EQ(hard.at("reprojections"), kFrames - 1) << "the lantern's shadow is reprojected";
  // Layers are projected along the plane's normal, so a moving light does not change them.
  const nlohmann::json layered = work_of({"--shadow", "layered"});
  EXPECT_EQ(layered.at("light_moved"), kFrames - 1);
  EXPECT_EQ(layered.at("triples_recomputed"), 1);
  EXPECT_EQ(layered.at("reprojections"), kFrames - 1);
}

}  // namespace
}  // namespace penumbra::test
