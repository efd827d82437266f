// A recording of live keeps the session's scene, models and options, so that a replay needs nothing
// else.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "replay/live_frames.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

// A red board of 8 x 6 cm, with its material in another folder.
constexpr const char* kBoard =
    "mtllib paint/board.mtl\nusemtl red\nv -0.04 -0.03 0.05\nv 0.04 -0.03 0.05\nv 0.04 0.03 0.05\n"
    "v -0.04 0.03 0.05\nf 1 2 3 4\n";
constexpr const char* kScene = R"({"name": "board", "objects": [
  {"name": "board", "model": "models/board.obj", "position": [0, 0.02, 0.01]}],
  "lights": [{"name": "lamp", "kind": "point", "position": [0.2, -0.3, 0.5]}],
  "shadows": [{"name": "shadow", "technique": "layered"}]})";

class SessionRecord : public testing::Test {
 protected:
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  void write(const std::string& name, const std::string& text) {
    fs::create_directories((folder_.path() / name).parent_path());
    std::ofstream(path(name), std::ios::binary) << text;
  }
  // Records a live session with options, and then removes the files that it named.
  void record(const std::vector<std::string>& more) {
    write("scene/models/board.obj", kBoard);
    write("scene/models/paint/board.mtl", "newmtl red\nKd 0.8 0.1 0.1\n");
    write("scene/board.json", kScene);
    write("toy.obj",
          "v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nv 0 0 0.05\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n");
    std::vector<std::string> words = {"--scene",    path("scene/board.json"),
                                      "--object",   path("toy.obj"),
                                      "--fps",      "10",
                                      "--duration", "1.5",
                                      "--no-window"};
    words.insert(words.end(), more.begin(), more.end());
    last_ = penumbra(live_arguments(folder_.path(), words));
    ASSERT_EQ(last_.exit_code, 0) << last_.err;
    fs::remove_all(path("scene"));
    fs::remove(path("toy.obj"));
  }
  std::map<std::string, std::string> replay(const std::string& name,
                                            const std::vector<std::string>& more = {}) {
    return replay_session(folder_.path(), name, more, last_);
  }
  TemporaryFolder folder_;
  ProgramResult last_;
};

TEST_F(SessionRecord, ShowsFramesOfSessionWhoseFilesAreGone) {
  record({"--shadow", "hard", "--no-video-light", "--tracking", "accurate"});
  const auto replayed = replay("replayed");
  EXPECT_GT(expect_frames_of_live(path("live"), path("live.tum"), path("session"), replayed), 3);
  EXPECT_THAT(last_.err, AllOf(Not(HasSubstr("session")), Not(HasSubstr("--tracking"))));
  // Options of the command line come first.
  EXPECT_NE(replay("layered", {"--shadow", "layered"}), replayed);
  EXPECT_NE(replay("compared", {"--compare", "hard,layered"}), replayed);
  const nlohmann::json session = read_json(path("session/session.json"));
  EXPECT_THAT(session.at("program").get<std::string>(), HasSubstr("penumbra "));
  EXPECT_EQ(session.at("options"),
            (nlohmann::json{
                {"--shadow", "hard"}, {"--no-video-light", "true"}, {"--tracking", "accurate"}}));
  // The recording may be moved.
  fs::rename(path("session"), path("moved"));
  fs::create_directory_symlink(path("moved"), path("session"));
  EXPECT_EQ(replay("of-moved"), replayed);
}

TEST_F(SessionRecord, NamesFilesThatChanged) {
  record({});
  const auto replayed = replay("replayed");
  for (const char* file : {"camera.yaml", "scene/models/1/paint/board.mtl"}) {
    std::ofstream(path(std::string("session/") + file), std::ios::app) << "# another line\n";
    EXPECT_EQ(replay("changed"), replayed);
    EXPECT_THAT(last_.err, HasSubstr(fmt::format("session/{}: has changed", file)));
    fs::remove_all(path("changed"));
  }
  fs::remove(path("session/scene/models/1/paint/board.mtl"));
  EXPECT_NE(replay("missing"), replayed);
  EXPECT_THAT(last_.err, HasSubstr("board.mtl: is missing, but the session used it"));
}

TEST_F(SessionRecord, RefusesPathsThatLeaveTheRecording) {
  record({});
  nlohmann::json session = read_json(path("session/session.json"));
  const auto error_with = [&](const char* key, const nlohmann::json& value) {
    nlohmann::json changed = session;
    changed[key] = value;
    write("session/session.json", changed.dump());
    last_ = penumbra({"replay", path("session"), "--no-window"});
    EXPECT_EQ(last_.exit_code, 1);
    return last_.err;
  };
  EXPECT_THAT(error_with("scene", "../scene.json"),
              AllOf(HasSubstr("session.json: scene"), HasSubstr("inside the recording")));
  EXPECT_THAT(error_with("scene", "/etc/passwd"), HasSubstr("session.json: scene"));
  EXPECT_THAT(error_with("files", {{{"file", "a/../../b"}, {"sha256", ""}}}),
              HasSubstr("session.json: files"));
  EXPECT_THAT(error_with("files", 3), HasSubstr("session.json: files"));
  EXPECT_THAT(error_with("options", {{"--shadow", "round"}}),
              AllOf(HasSubstr("session.json: options"), HasSubstr("--shadow")));
  session["options"] = {
      {"--output", "/tmp/x"}, {"--kernels", path("other.json")}, {"--shadow", "simple"}};
  write("session/session.json", session.dump());
  replay("other");
  EXPECT_THAT(last_.err, AllOf(HasSubstr("session.json: options: --output is ignored"),
                               HasSubstr("session.json: options: --kernels is ignored")));
}

}  // namespace
}  // namespace penumbra::test
