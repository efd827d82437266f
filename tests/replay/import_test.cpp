// Video files in place of recordings, and penumbra import.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/geometry/trajectory.hpp"
#include "replay/replay_support.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::HasSubstr;

class VideoInput : public testing::Test {
 protected:
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  // Writes the camera's images as H.264.
  void SetUp() override {
    const ProgramResult made = penumbra({"replay", bundled("tabletop"), "--no-window", "--scene",
                                         empty_scene_in(folder_.path()), "--frames", "0:40",
                                         "--output", path("phone.mp4")});
    ASSERT_EQ(made.exit_code, 0) << made.err;
  }
  const std::vector<std::string> inputs_ = {"--calibration", bundled("tabletop") + "/camera.yaml",
                                            "--tags", bundled("tabletop") + "/tags.yaml"};
  [[nodiscard]] ProgramResult run(std::vector<std::string> words,
                                  const std::vector<std::string>& more) const {
    words.insert(words.end(), inputs_.begin(), inputs_.end());
    words.insert(words.end(), more.begin(), more.end());
    return penumbra(words);
  }

  TemporaryFolder folder_;
};

TEST_F(VideoInput, IsTrackedLikeRecording) {
  const ProgramResult replayed =
      run({"replay", path("phone.mp4")}, {"--no-window", "--poses", path("poses.tum")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const auto poses = load_trajectory(path("poses.tum"));
  ASSERT_TRUE(poses);
  EXPECT_GT(poses->poses.size(), 35U);
  const auto truth = load_trajectory(bundled("tabletop") + "/groundtruth.tum");
  ASSERT_TRUE(truth);
  // The video begins at time 0.
  const std::int64_t start_ns = truth->poses.front().timestamp_ns;
  for (const StampedPose& pose : poses->poses) {
    const StampedPose* of_truth = truth->at(pose.timestamp_ns + start_ns);
    ASSERT_NE(of_truth, nullptr) << pose.timestamp_ns;
    EXPECT_LT((pose.T_table_camera.translation() - of_truth->T_table_camera.translation()).norm(),
              0.002);
  }
}

// An imported recording shows the same frames and poses as its video.
TEST_F(VideoInput, IsImportedWithoutLoss) {
  const ProgramResult imported =
      run({"import", path("phone.mp4"), "--output", path("session")}, {"--frames", "0:20"});
  ASSERT_EQ(imported.exit_code, 0) << imported.err;
  EXPECT_THAT(imported.out, HasSubstr("frames: 20\n"));
  const auto outputs = [&](const std::string& name) {
    return std::vector<std::string>{"--no-window", "--poses", path(name + ".tum"), "--output",
                                    path(name)};
  };
  std::vector<std::string> frames = outputs("video");
  frames.insert(frames.end(), {"--frames", "0:20"});
  const ProgramResult video = run({"replay", path("phone.mp4")}, frames);
  ASSERT_EQ(video.exit_code, 0) << video.err;
  std::vector<std::string> words = {"replay", path("session")};
  const std::vector<std::string> more = outputs("recording");
  words.insert(words.end(), more.begin(), more.end());
  const ProgramResult recording = penumbra(words);
  ASSERT_EQ(recording.exit_code, 0) << recording.err;
  EXPECT_EQ(bytes_of(path("video.tum")), bytes_of(path("recording.tum")));
  EXPECT_EQ(contents_of(path("video")), contents_of(path("recording")));
  EXPECT_EQ(contents_of(path("video")).size(), 20U);
  EXPECT_EQ(bytes_of(path("session/tags.yaml")), bytes_of(bundled("tabletop") + "/tags.yaml"));
}

TEST_F(VideoInput, PlaysAsCamera) {
  const ProgramResult live = run({"live", "--camera", "recording:" + path("phone.mp4")},
                                 {"--no-window", "--duration", "0.5", "--poses", path("live.tum")});
  ASSERT_EQ(live.exit_code, 0) << live.err;
  EXPECT_GT(load_trajectory(path("live.tum")).value().poses.size(), 3U);
}

TEST_F(VideoInput, ReportsMissingOrWrongInputInOneLine) {
  const auto error = [](const std::vector<std::string>& words) {
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 1) << result.out;
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
    return result.err;
  };
  EXPECT_THAT(error({"replay", path("phone.mp4"), "--no-window"}),
              HasSubstr("phone.mp4: a video has no camera file; name one"));
  EXPECT_THAT(error({"replay", path("phone.mp4"), "--no-window", "--calibration",
                     bundled("tabletop") + "/camera.yaml"}),
              HasSubstr("phone.mp4: a video has no tag map; give one"));
  EXPECT_THAT(error({"import", path("empty.json"), "--output", path("new")}),
              HasSubstr("cannot be read as a video"));
  EXPECT_FALSE(fs::exists(path("new")));
  EXPECT_THAT(error({"import", bundled("tabletop"), "--output", path("new")}),
              HasSubstr("is a recording already"));
  EXPECT_THAT(error({"import", path("phone.mp4"), "--output", folder_.path()}),
              HasSubstr("exists and is not empty"));
  EXPECT_THAT(error({"import", path("phone.mp4"), "--output", path("new"), "--frames", "100:"}),
              HasSubstr("hold none of its 40 frames"));
  EXPECT_THAT(error({"map", path("phone.mp4"), "--camera", bundled("tabletop") + "/camera.yaml",
                     "--tag-size", "0.04", "--anchor", "5", "--output", path("missing/tags.yaml")}),
              HasSubstr("missing"));
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"map", path("phone.mp4"), "--tag-size", "0.04", "--anchor", "5",
                                 "--output", path("tags.yaml")},
        std::vector<std::string>{"map", path("phone.mp4"), "--tag-size", "0.04", "--anchor", "5",
                                 "--camera", bundled("tabletop") + "/camera.yaml", "--output",
                                 path("phone.mp4")},
        std::vector<std::string>{"calibrate", path("phone.mp4"), "--target", path("t.yaml"),
                                 "--output", path("phone.mp4")},
        std::vector<std::string>{"import", path("phone.mp4")},
        std::vector<std::string>{"import", path("phone.mp4"), "--output", path("new"),
                                 "--camera-name", "a"}}) {
    EXPECT_EQ(penumbra(words).exit_code, 2) << words[0] << ' ' << words.back();
  }
  EXPECT_THAT(error({"calibrate", path("empty.json"), "--target", path("empty.json"), "--output",
                     path("camera.yaml")}),
              HasSubstr("empty.json"));
}

}  // namespace
}  // namespace penumbra::test
