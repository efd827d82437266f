// --object and --save-scene.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "replay/live_frames.hpp"
#include "support/animated_gltf.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

std::string bundled_model(const char* name) {
  return (source_dir() / "scenes" / "models" / name).string();
}

class ObjectOption : public testing::Test {
 protected:
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  // Replays 3 frames; returns the images.
  std::map<std::string, std::string> replay(const std::string& name,
                                            const std::vector<std::string>& more,
                                            const std::string& recording = bundled("tabletop")) {
    std::vector<std::string> words = {"replay",      recording,      "--frames",
                                      "60:63",       "--output",     path(name),
                                      "--no-window", "--poses-from", "groundtruth"};
    words.insert(words.end(), more.begin(), more.end());
    last_ = penumbra(words);
    EXPECT_EQ(last_.exit_code, 0) << last_.err;
    return contents_of(path(name));
  }
  // Writes a box of 80 x 60 x 40 units.
  std::string write_obj(const char* name) {
    std::ofstream file(path(name));
    for (const int z : {0, 40}) {
      for (const int y : {0, 60}) {
        for (const int x : {0, 80}) file << fmt::format("v {} {} {}\n", x, y, z);
      }
    }
    for (const char* face : {"1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"})
      file << "f " << face << "\n";
    return path(name);
  }
  // Writes a square that moves within two seconds.
  std::string write_moving_square() {
    std::ofstream(path("square.glb"), std::ios::binary) << moving_square().glb();
    return path("square.glb");
  }

  TemporaryFolder folder_;
  ProgramResult last_;
};

TEST_F(ObjectOption, ShowsModelAloneAndDescribesIt) {
  const std::string toy = write_obj("toy.obj");
  const auto shown = replay("shown", {"--object", toy});
  ASSERT_EQ(shown.size(), 3U);
  EXPECT_THAT(last_.out, HasSubstr("object: " + toy +
                                   ": scale 0.001 (taken as millimetres), 4.0 cm high, at x "));
  const auto table = replay("table", {"--scene", (source_dir() / "scenes/table.json").string()});
  EXPECT_NE(shown, table);
  const auto given = replay("given", {"--object", toy + ",unit=mm"});
  EXPECT_EQ(given, shown);
  EXPECT_NE(replay("large", {"--object", toy + ",height=0.1"}), shown);
  EXPECT_NE(replay("upright", {"--object", toy + ",up=y"}), shown);
  EXPECT_THAT(last_.out, HasSubstr("6.0 cm high"));
  EXPECT_EQ(replay("lying", {"--object", toy + ",up=z"}), shown);
  EXPECT_NE(replay("moved", {"--object", toy + ",x=-0.2,y=0.1,z=0.02"}), shown);
}

TEST_F(ObjectOption, WarnsOfAbsurdSize) {
  const std::string toy = write_obj("toy.obj");
  (void)replay("huge", {"--object", toy + ",unit=m"});
  EXPECT_THAT(last_.err, HasSubstr("toy.obj: is 80 m wide; in millimetres? use scale 0.001"));
  (void)replay("small", {"--object", toy + ",scale=1e-6"});
  EXPECT_THAT(last_.err, HasSubstr("toy.obj: is 0.08 mm wide"));
  (void)replay("good", {"--object", toy});
  EXPECT_THAT(last_.err, Not(HasSubstr("wide")));
}

TEST_F(ObjectOption, AddsToSceneOfSceneOption) {
  const std::string scene = (source_dir() / "scenes/default.json").string();
  const auto alone = replay("alone", {"--scene", scene});
  const auto both = replay("both", {"--scene", scene, "--object", write_obj("toy.obj")});
  const auto toy = replay("toy", {"--object", path("toy.obj")});
  EXPECT_NE(both, alone);
  EXPECT_NE(both, toy);
}

TEST_F(ObjectOption, PlaysAnimation) {
  const std::string square = write_moving_square();
  const auto rest = replay("rest", {"--object", square});
  EXPECT_THAT(last_.err, HasSubstr("its animations (1) are not played"));
  const auto played = replay("played", {"--object", square + ",animation=all"});
  EXPECT_THAT(last_.err, Not(HasSubstr("not played")));
  EXPECT_NE(played, rest);
  EXPECT_EQ(replay("index", {"--object", square + ",animation=0"}), played);
  std::ofstream(path("scene.json"))
      << R"({"objects": [{"name": "square", "model": "square.glb", "animation": 0}]})";
  EXPECT_NE(replay("scene", {"--scene", path("scene.json")}), rest);
}

TEST_F(ObjectOption, WarnsIfSceneHasNoShadowNode) {
  (void)replay("shown",
               {"--scene", empty_scene_in(folder_.path()), "--object", write_obj("toy.obj")});
  EXPECT_THAT(last_.err, HasSubstr("empty.json: has no shadow node, so added objects cast no"));
}

// The written scene shows the same frames, also from another folder.
TEST_F(ObjectOption, SavesSceneThatShowsSameFrames) {
  fs::create_directory(path("models"));
  fs::create_directory(path("scenes"));
  const std::string toy = write_obj("models/toy.obj");
  fs::copy(bundled_model("tree.glb"), path("models/tree.glb"));
  const std::string base = (source_dir() / "scenes/default.json").string();
  const std::vector<std::vector<std::string>> runs = {
      {"--object", toy, "--object", path("models/tree.glb") + ",height=0.12", "--object", toy},
      {"--scene", base, "--object", toy, "--shadow", "walls"},
      {"--object", path("models/tree.glb") + ",height=0.12", "--shadow", "walls", "--object", toy},
      {"--scene", base, "--object", toy + ",up=y", "--shadow", "cocl"},
      {"--object", toy, "--object", write_moving_square() + ",animation=all"},
  };
  int number = 0;
  for (std::vector<std::string> run : runs) {
    SCOPED_TRACE(run.back());
    const std::string saved = path(fmt::format("scenes/saved{}.json", ++number));
    run.insert(run.end(), {"--save-scene", saved});
    const auto seen = replay(fmt::format("seen{}", number), run);
    EXPECT_THAT(last_.out, HasSubstr(saved));
    EXPECT_THAT(bytes_of(saved),
                AllOf(HasSubstr("\"../models/toy.obj\""), Not(HasSubstr("\": \"/"))));
    const auto again = replay(fmt::format("again{}", number), {"--scene", saved});
    EXPECT_EQ(seen.size(), 3U);
    EXPECT_EQ(again, seen);
    EXPECT_THAT(last_.err, Not(HasSubstr("error")));
  }
}

TEST_F(ObjectOption, SavesSceneToStandardOutput) {
  (void)replay("frames", {"--object", write_obj("toy.obj"), "--save-scene", "-"});
  EXPECT_THAT(last_.out, testing::StartsWith("{"));
  EXPECT_THAT(last_.err, HasSubstr("object: "));
}

TEST_F(ObjectOption, ReportsProblemsInOneLine) {
  const auto error = [this](const std::string& object, int exit_code) {
    const ProgramResult result =
        penumbra({"replay", bundled("tabletop"), "--frames", "60:61", "--no-window", "--poses-from",
                  "groundtruth", "--object", object});
    EXPECT_EQ(result.exit_code, exit_code) << object;
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
    return result.err;
  };
  EXPECT_THAT(error(path("missing.glb"), 1), HasSubstr("missing.glb"));
  std::ofstream(path("empty.obj")) << "";
  EXPECT_THAT(error(path("empty.obj"), 1), HasSubstr("empty.obj"));
  std::ofstream(path("point.obj")) << "v 1 1 1\nf 1 1 1\n";
  EXPECT_THAT(error(path("point.obj"), 1), HasSubstr("point.obj: has no size"));
  EXPECT_THAT(error((source_dir() / "README.md").string(), 1), HasSubstr("README.md"));
  const std::string toy = write_obj("toy,1.obj");
  EXPECT_THAT(
      error(toy + ",heigth=0.1", 2),
      AllOf(HasSubstr("--object: heigth: no such key; known: height, scale, unit, x, y, z")));
  EXPECT_THAT(error(toy + ",height", 2), HasSubstr("height=: give metres from 0.001 to 10"));
  EXPECT_THAT(error(toy + ",height=tall", 2), HasSubstr("height=tall: give metres"));
  EXPECT_THAT(error(toy + ",x=nan", 2), HasSubstr("x=nan: give metres"));
  EXPECT_THAT(error(toy + ",x=1,x=2", 2), HasSubstr("x: is given twice"));
  EXPECT_THAT(error(toy + ",unit=ft", 2), HasSubstr("unit=ft: is none of mm, cm, m and in"));
  EXPECT_THAT(error(toy + ",height=0.1,scale=2", 2), HasSubstr("leave out scale"));
  EXPECT_THAT(error(toy + ",up=x", 2), HasSubstr("up=x: is neither y nor z"));
  EXPECT_THAT(error(toy + ",up=y,up=y", 2), HasSubstr("up: is given twice"));
  EXPECT_THAT(error(",height=1", 2), HasSubstr("name a model file first"));
  EXPECT_THAT(error(toy + ",animation=", 2), HasSubstr("animation: give a name, an index or all"));
  EXPECT_THAT(error(toy + ",animation=0,animation=0", 2), HasSubstr("animation: is given twice"));
  EXPECT_THAT(error(toy + ",animation=walk", 1),
              AllOf(HasSubstr("toy,1.obj"), HasSubstr("only glTF files")));
  EXPECT_THAT(error(write_moving_square() + ",animation=walk", 1),
              AllOf(HasSubstr("square.glb"), HasSubstr("has no animation \"walk\"")));
  EXPECT_EQ(penumbra({"demo", "--object", toy + ",wide=1"}).exit_code, 2);
  EXPECT_EQ(penumbra({"replay", bundled("tabletop"), "--save-scene", path("scene.txt")}).exit_code,
            2);
}

TEST_F(ObjectOption, DemoShowsObject) {
  const ProgramResult demo = penumbra(
      {"demo", "--no-window", "--object", write_obj("toy.obj"), "--output", path("a.mkv")});
  EXPECT_EQ(demo.exit_code, 0) << demo.err;
  EXPECT_THAT(demo.out, HasSubstr("toy.obj: scale 0.001"));
}

// The material of a model is an input, although no option names it.
TEST_F(ObjectOption, RefusesOutputsOverFilesThatModelsRead) {
  const std::string material = "newmtl red\nKd 0.8 0.1 0.1\n";
  std::ofstream(path("paint.json")) << material;
  std::ofstream(path("board.obj"))
      << "mtllib paint.json\nusemtl red\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\n"
         "f 1 2 3\n";
  std::ofstream(path("scene.json"))
      << R"({"objects": [{"name": "a", "model": "board.obj"}], "shadows": []})";
  const std::vector<std::string> replay = {"replay", bundled("tabletop"), "--no-window", "--frames",
                                           "0:1"};
  const auto with = [](std::vector<std::string> words, const std::vector<std::string>& more) {
    words.insert(words.end(), more.begin(), more.end());
    return words;
  };
  for (const auto& words :
       {std::vector<std::string>{"kernels", path("board.obj"), "--output", path("paint.json")},
        std::vector<std::string>{"shadow", path("board.obj"), "--output", path("paint.json")},
        with(replay, {"--object", path("board.obj"), "--report", path("paint.json")}),
        with(replay, {"--scene", path("scene.json"), "--save-scene", path("paint.json")})}) {
    const ProgramResult refused = penumbra(words);
    EXPECT_EQ(refused.exit_code, 1) << words.front();
    EXPECT_THAT(refused.err, HasSubstr("paint.json")) << words.front();
    std::ifstream kept(path("paint.json"));
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(kept), {}), material) << words.front();
  }
}

// Scene files are UTF-8. The name is refused before the run and not at its end.
TEST_F(ObjectOption, RefusesToSaveNameThatIsNotUtf8) {
  const std::string toy = write_obj("toy\xe9.obj");
  last_ = penumbra({"replay", bundled("tabletop"), "--no-window", "--frames", "0:1", "--object",
                    toy, "--save-scene", path("saved.json")});
  EXPECT_EQ(last_.exit_code, 1);
  EXPECT_THAT(last_.err, AllOf(HasSubstr("is not UTF-8"), HasSubstr("rename")));
  EXPECT_FALSE(fs::exists(path("saved.json")));
}

// A recorded session contains its added objects: a replay without options shows the same frames.
TEST_F(ObjectOption, RecordsObjectsForReplay) {
  const std::string toy = write_obj("toy.obj");
  const ProgramResult live = penumbra(live_arguments(
      folder_.path(),
      {"--object", toy + ",up=y", "--object", write_moving_square() + ",animation=all", "--fps",
       "10", "--duration", "2", "--no-window", "--save-scene", path("saved.json")}));
  ASSERT_EQ(live.exit_code, 0) << live.err;
  const auto replayed = [&](const std::string& name, const std::vector<std::string>& more) {
    return replay_session(folder_.path(), name, more, last_);
  };
  const auto without_options = replayed("without", {});
  EXPECT_GT(expect_frames_of_live(path("live"), path("live.tum"), path("session"), without_options),
            3);
  EXPECT_EQ(replayed("saved", {"--scene", path("saved.json"), "--no-edits"}), without_options);
  // The recording has the model.
  fs::create_directory(path("other"));
  fs::rename(toy, path("other/toy.obj"));
  EXPECT_EQ(replayed("kept", {}), without_options);
  for (const auto& file : fs::recursive_directory_iterator(path("session/scene/models"))) {
    if (file.path().filename() == "toy.obj") fs::remove(file.path());
  }
  EXPECT_EQ(replayed("named", {"--object", path("other/toy.obj") + ",up=y"}), without_options);
  const ProgramResult missing = penumbra({"replay", path("session"), "--no-window"});
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_THAT(missing.err, AllOf(HasSubstr("events.jsonl"), HasSubstr("toy.obj"),
                                 HasSubstr("--object"), HasSubstr("--no-edits")));
}

}  // namespace
}  // namespace penumbra::test
