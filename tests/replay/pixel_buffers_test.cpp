// --pixel-buffers: outputs must be the same, although each frame is read back one frame later.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <filesystem>
#include <thread>

#include "app/recording/video_reader.hpp"
#include "core/geometry/trajectory.hpp"
#include "replay/replay_support.hpp"
#include "support/recording_folder.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

class PixelBufferOption : public testing::Test {
 protected:
  [[nodiscard]] std::string path(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  // Runs the program with outputs in the folder whose names begin with `name`.
  ProgramResult run(const std::string& name, std::vector<std::string> arguments,
                    const std::string& buffers,
                    const std::vector<std::string>& environment = {}) const {
    arguments.insert(arguments.end(),
                     {"--no-window", "--pixel-buffers", buffers, "--output", path(name), "--poses",
                      path(name + ".tum"), "--report", path(name + ".json")});
    return penumbra(arguments, environment);
  }
  static std::vector<std::string> live(const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"live", "--camera", "recording:" + bundled("tabletop"),
                                          "--calibration", bundled("tabletop") + "/camera.yaml"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }
  // Runs the program with a maximum file size [KiB].
  static ProgramResult with_files_up_to(int kib, const std::vector<std::string>& arguments) {
    std::vector<std::string> words = {
        "-c", fmt::format(R"(trap '' XFSZ; ulimit -f {}; exec "$0" "$@")", kib),
        program().string()};
    words.insert(words.end(), arguments.begin(), arguments.end());
    return run_program("/bin/bash", words);
  }
  // Expects each frame of the run in its video and, if tracked, among its poses.
  void expect_all_written(const std::string& name) const {
    const auto report = read_json(path(name + ".json"));
    const int frames = report["frames"].get<int>();
    EXPECT_GT(frames, 2);
    EXPECT_EQ(report["gl"]["pixel_buffers"], true);
    EXPECT_EQ(report["work"]["pixel_buffer_read_backs"], frames);
    EXPECT_EQ(report["time_ms"]["readback"]["count"], frames);
    const auto video = count_video_frames(path(name));
    ASSERT_TRUE(video) << video.error().message;
    EXPECT_EQ(*video, frames);
    const auto poses = load_trajectory(path(name + ".tum"));
    ASSERT_TRUE(poses) << poses.error().message;
    EXPECT_EQ(poses->poses.size(), report["frames_tracked"].get<std::size_t>());
  }

 private:
  TemporaryFolder folder_;
};

// The short form replays fewer frames. It writes videos with two threads only, and the single frame
// with two threads as an image and in one video.
TEST_F(PixelBufferOption, WritesSameFilesInReplay) {
  const char* const several = nightly() ? "20:32" : "20:24";
  for (const std::string threads : {"1", "2"}) {
    for (const char* frames : {several, "57:58"}) {  // a single frame has no successor
      if (!nightly() && threads == "1" && frames != several) continue;
      SCOPED_TRACE(fmt::format("{} threads, frames {}", threads, frames));
      const std::vector<std::string> arguments = {"replay", bundled("tabletop"), "--frames",
                                                  frames,   "--threads",         threads};
      const int count = frames != several ? 1 : nightly() ? 12 : 4;
      for (const std::string kind : {"", ".mkv", ".mp4"}) {
        const bool in_short_form =
            kind.empty() || (threads == "2" && (frames == several || kind == ".mp4"));
        if (!nightly() && !in_short_form) continue;
        std::filesystem::remove_all(path("off"));
        std::filesystem::remove_all(path("on"));
        const std::string off = "off" + kind, on = "on" + kind;
        ASSERT_EQ(run(off, arguments, "off").exit_code, 0);
        ASSERT_EQ(run(on, arguments, "on").exit_code, 0);
        if (kind.empty()) {
          EXPECT_EQ(contents_of(path(off)).size(), static_cast<std::size_t>(count));
          EXPECT_EQ(contents_of(path(on)), contents_of(path(off)));
        } else {
          EXPECT_FALSE(fingerprint_of(path(off)).empty());
          EXPECT_EQ(fingerprint_of(path(on)), fingerprint_of(path(off)));
        }
        EXPECT_EQ(bytes_of(path(on + ".tum")), bytes_of(path(off + ".tum")));
        const auto with = read_json(path(on + ".json")), without = read_json(path(off + ".json"));
        EXPECT_EQ(with["gl"]["pixel_buffers"], true);
        EXPECT_EQ(without["gl"]["pixel_buffers"], false);
        EXPECT_EQ(with["work"]["pixel_buffer_read_backs"], count);
        EXPECT_EQ(without["work"]["pixel_buffer_read_backs"], 0);
        for (const char* stage : {"readback", "encode", "render", "draw"}) {
          EXPECT_EQ(with["time_ms"][stage]["count"], count) << stage;
          EXPECT_EQ(without["time_ms"][stage]["count"], count) << stage;
        }
        EXPECT_EQ(with["work"]["passes_drawn"], without["work"]["passes_drawn"]);
      }
    }
  }
}

TEST_F(PixelBufferOption, WritesSameFramesOnOpenGlEsAndInComparisons) {
  // Shadows that fetch the video upload it on every renderer.
  const std::vector<std::string> arguments = {"replay", bundled("corner"), "--frames",
                                              "0:4",    "--translucency",  "retexture"};
  const std::vector<std::string> embedded = {"MESA_GL_VERSION_OVERRIDE=3.1"};
  ASSERT_EQ(run("off", arguments, "off", embedded).exit_code, 0);
  ASSERT_EQ(run("on", arguments, "on", embedded).exit_code, 0);
  EXPECT_THAT(read_json(path("on.json"))["gl"]["version"].get<std::string>(),
              testing::HasSubstr("OpenGL ES 3"));
  EXPECT_EQ(read_json(path("on.json"))["work"]["pixel_buffer_read_backs"], 4);
  EXPECT_EQ(read_json(path("on.json"))["work"]["pixel_buffer_uploads"], 4);
  EXPECT_EQ(contents_of(path("on")).size(), 4U);
  EXPECT_EQ(contents_of(path("on")), contents_of(path("off")));

  std::vector<std::string> compared = arguments;
  compared.insert(compared.end(), {"--compare", "layered,hard"});
  ASSERT_EQ(run("compared-off", compared, "off").exit_code, 0);
  ASSERT_EQ(run("compared-on", compared, "on").exit_code, 0);
  EXPECT_EQ(read_json(path("compared-on.json"))["work"]["pixel_buffer_uploads"], 8);
  EXPECT_EQ(contents_of(path("compared-on")).size(), 4U);
  EXPECT_EQ(contents_of(path("compared-on")), contents_of(path("compared-off")));
}

TEST_F(PixelBufferOption, DefaultsToOffOnSoftwareRenderers) {
  ASSERT_EQ(run("auto", {"replay", bundled("corner"), "--frames", "0:3"}, "auto").exit_code, 0);
  const auto report = read_json(path("auto.json"));
  const auto renderer = report["gl"]["renderer"].get<std::string>();
  const bool software = renderer.find("llvmpipe") != std::string::npos ||
                        renderer.find("softpipe") != std::string::npos;
  EXPECT_EQ(report["gl"]["pixel_buffers"], !software);
  EXPECT_FALSE(software && report["time_ms"].contains("gpu"));
  const auto wrong = run("maybe", {"replay", bundled("corner")}, "maybe");
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_THAT(wrong.err, testing::HasSubstr("--pixel-buffers"));
}

TEST_F(PixelBufferOption, LeavesSameFilesAfterError) {
  std::filesystem::copy(bundled("tabletop"), path("played"),
                        std::filesystem::copy_options::recursive);
  std::filesystem::remove(path("played/frames/000030.jpg"));
  write_text(path("played/frames/000030.jpg"), "no image");
  for (const char* threads : {"1", "2"}) {
    const std::vector<std::string> arguments = {"replay", path("played"), "--frames",
                                                "26:34",  "--threads",    threads};
    const auto off = run("off", arguments, "off");
    const auto on = run("on", arguments, "on");
    expect_failure(on, {"000030.jpg"});
    EXPECT_EQ(on.err, off.err);
    for (const char* left : {"on", "on.tum", "on.json", "off", "off.tum", "off.json"})
      EXPECT_FALSE(std::filesystem::exists(path(left))) << left;
  }
}

TEST_F(PixelBufferOption, KeepsEveryFrameOnCtrlC) {
  for (const char* threads : {"1", "2"}) {
    std::vector<std::string> arguments = {
        "replay",   bundled("tabletop"), "--threads", threads,     "--realtime", "--pixel-buffers",
        "on",       "--no-window",       "--output",  path("out"), "--poses",    path("out.tum"),
        "--report", path("out.json")};
    const auto done = run_program(program(), arguments, {}, {}, [&](pid_t child) {
      for (int i = 0; i < 6000; ++i) {  // gives up after a minute
        const std::string partial = path("out.partial-" + std::to_string(child) + "-0");
        if (std::filesystem::exists(partial + "/000002.png")) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
      kill(child, SIGINT);
    });
    ASSERT_EQ(done.exit_code, 0) << done.err;
    const auto report = read_json(path("out.json"));
    EXPECT_EQ(report["interrupted"], true);
    EXPECT_LT(report["frames"].get<int>(), 120);
    const auto images = contents_of(path("out"));
    ASSERT_EQ(images.size(), report["frames"].get<std::size_t>());
    // The images must equal those of an uninterrupted run.
    ASSERT_EQ(
        run("whole",
            {"replay", bundled("tabletop"), "--frames", fmt::format("0:{}", images.size())}, "off")
            .exit_code,
        0);
    EXPECT_EQ(images, contents_of(path("whole")));
    EXPECT_EQ(bytes_of(path("out.tum")), bytes_of(path("whole.tum")));
    std::filesystem::remove_all(path("whole"));
    std::filesystem::remove_all(path("out"));
  }
}

TEST_F(PixelBufferOption, ClosesOnlyVideoWhenDiskIsFull) {
  constexpr int kAMomentOfVideo = 1536;  // [KiB]
  const auto done = with_files_up_to(
      kAMomentOfVideo,
      {"replay", bundled("tabletop"), "--no-window", "--frames", "0:15", "--pixel-buffers", "on",
       "--output", path("out.mkv"), "--poses", path("out.tum"), "--report", path("out.json")});
  EXPECT_EQ(done.exit_code, 1);
  EXPECT_EQ(lines_of(done.err).size(), 2U) << done.err;
  const auto report = read_json(path("out.json"));
  EXPECT_EQ(report["frames"], 15);
  EXPECT_THAT(report["failure"].get<std::string>(), testing::HasSubstr("out.mkv"));
  const auto kept = count_video_frames(path("out.mkv"));
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_GT(*kept, 0);
  EXPECT_LT(*kept, 15);
  const auto poses = load_trajectory(path("out.tum"));
  ASSERT_TRUE(poses) << poses.error().message;
  EXPECT_EQ(poses->poses.size(), report["frames_tracked"].get<std::size_t>());
}

TEST_F(PixelBufferOption, WritesEveryDrawnFrameInLive) {
  for (const char* threads : {"1", "2"}) {
    // At 8 frames/s drawing waits for the camera. The last frame before a wait must be written too.
    for (const char* fps : {"30", "8"}) {
      SCOPED_TRACE(fmt::format("{} threads, {} frames/s", threads, fps));
      const auto done =
          run("live.mkv", live({"--duration", "0.6", "--threads", threads, "--fps", fps}), "on");
      ASSERT_EQ(done.exit_code, 0) << done.err;
      expect_all_written("live.mkv");
    }
  }
}

TEST_F(PixelBufferOption, KeepsEveryFrameWhenLiveIsInterrupted) {
  std::thread interrupter;
  std::vector<std::string> arguments =
      live({"--no-window", "--pixel-buffers", "on", "--record", path("session"), "--output",
            path("live.mkv"), "--poses", path("live.mkv.tum"), "--report", path("live.mkv.json")});
  const auto done = run_program(program(), arguments, {}, {}, [&](pid_t child) {
    interrupter = std::thread([this, child] {
      for (int i = 0; i < 6000; ++i) {
        if (lines_of(bytes_of(path("session/timestamps.csv"))).size() > 8 * kSlowness) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
      }
      kill(child, SIGINT);
    });
  });
  interrupter.join();
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_EQ(read_json(path("live.mkv.json"))["interrupted"], true);
  expect_all_written("live.mkv");
}

#ifdef PENUMBRA_RESET_DRIVER
// A driver reset loses the pending image. Its pose must be kept.
TEST_F(PixelBufferOption, LosesOnlyPendingFrameOnDriverReset) {
  const auto done = run("live.mkv", live({"--duration", "30"}), "on",
                        {"LD_PRELOAD=" PENUMBRA_RESET_DRIVER, "PENUMBRA_TEST_RESET_AT=60"});
  EXPECT_EQ(done.exit_code, 1);
  EXPECT_THAT(last_line_of(done.err), testing::HasSubstr("was reset"));
  const auto report = read_json(path("live.mkv.json"));
  const int frames = report["frames"].get<int>();
  EXPECT_GT(frames, 5);
  const auto kept = count_video_frames(path("live.mkv"));
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_EQ(*kept, frames - 1);
  const auto poses = load_trajectory(path("live.mkv.tum"));
  ASSERT_TRUE(poses) << poses.error().message;
  EXPECT_EQ(poses->poses.size(), report["frames_tracked"].get<std::size_t>());
}
#endif

}  // namespace
}  // namespace penumbra::test
