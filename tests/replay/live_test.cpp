// penumbra live with a recording played as a camera.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <thread>

#include "app/recording/video_reader.hpp"
#include "core/camera/camera_file.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "replay/replay_support.hpp"
#include "support/animated_gltf.hpp"
#include "support/recording_folder.hpp"

namespace penumbra {
namespace {

using test::bundled;
using test::penumbra;
using testing::HasSubstr;

std::string calibration() {
  return bundled("tabletop") + "/camera.yaml";
}

std::vector<std::string> live(const std::vector<std::string>& more) {
  std::vector<std::string> arguments = {
      "live",          "--camera",    "recording:" + bundled("tabletop"),
      "--calibration", calibration(), "--no-window"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return arguments;
}

// Runs the program with a maximum file size [KiB], which simulates a full disk.
test::ProgramResult with_files_up_to(int kib, const std::vector<std::string>& arguments) {
  std::vector<std::string> words = {
      "-c", fmt::format(R"(trap '' XFSZ; ulimit -f {}; exec "$0" "$@")", kib),
      test::program().string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  return test::run_program("/bin/bash", words);
}

TEST(LiveCommand, RecordsSessionThatReplaysToSamePoses) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const auto done = penumbra(live({"--duration", "0.8", "--record", path("session"), "--poses",
                                   path("live.tum"), "--report", path("report.json")}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(path("report.json"));
  const int frames = report["frames"];
  EXPECT_GT(frames, 0);
  EXPECT_EQ(report["frames_captured"].get<int>(), frames + report["frames_dropped"].get<int>());
  EXPECT_GE(report["frames_tracked"].get<int>(), frames * 95 / 100);
  EXPECT_EQ(report["time_ms"]["latency"]["count"], frames);
  EXPECT_GT(report["time_ms"]["latency"]["median"].get<double>(), 0.0);

  // Each captured frame must be stored or counted as not recorded.
  const std::string listed = test::read_bytes(temporary.path() / "session" / "timestamps.csv");
  const auto rows = std::count(listed.begin(), listed.end(), '\n') - 1;
  EXPECT_EQ(report["recorded"]["written"], rows);
  EXPECT_GE(rows + report["recorded"]["left_out"].get<int>(), frames);

  // The stored files must equal the camera's bytes.
  const auto recorded = test::contents_of(temporary.path() / "session" / "frames");
  const auto played = test::contents_of(test::recordings_dir() / "tabletop" / "frames");
  ASSERT_FALSE(recorded.empty());
  EXPECT_EQ(recorded.begin()->second, played.begin()->second);

  const auto replayed =
      penumbra({"replay", path("session"), "--no-window", "--poses", path("replay.tum")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const auto a = load_trajectory(path("live.tum"));
  const auto b = load_trajectory(path("replay.tum"));
  const auto camera = load_camera(calibration());
  ASSERT_TRUE(a && b && camera);
  Trajectory both;
  for (const StampedPose& pose : a->poses) {
    if (const StampedPose* same = b->at(pose.timestamp_ns)) both.poses.push_back(*same);
  }
  ASSERT_GT(both.poses.size(), 0U);
  const Evaluation difference = evaluate(*camera, *a, both);
  EXPECT_LT(difference.overlay_px.max, 0.2);
}

TEST(LiveCommand, ShowsAnimatedModelsAsReplayOfRecording) {
  const test::TemporaryFolder folder;
  const auto path = [&](const char* name) { return (folder.path() / name).string(); };
  std::ofstream(path("square.glb"), std::ios::binary) << test::moving_square().glb();
  std::ofstream(path("scene.json"))
      << R"({"objects": [{"name": "square", "model": "square.glb", "animation": "all"}],)"
         R"( "shadows": [{"name": "shadow", "technique": "layered"}]})";
  const auto shown = penumbra(live({"--duration", "0.8", "--record", path("session"), "--scene",
                                    path("scene.json"), "--output", path("shown")}));
  ASSERT_EQ(shown.exit_code, 0) << shown.err;
  const auto replayed =
      penumbra({"replay", path("session"), "--scene", path("scene.json"), "--poses-from",
                path("session") + "/poses.tum", "--no-window", "--output", path("replayed")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const auto images = test::contents_of(folder.path() / "shown");
  const auto again = test::contents_of(folder.path() / "replayed");
  EXPECT_GT(images.size(), 1U);
  for (const auto& [name, bytes] : images) {
    ASSERT_TRUE(again.contains(name)) << name;
    EXPECT_TRUE(bytes == again.at(name)) << name;
  }
}

// Some images are truncated but have both start and end marker. The recording keeps them.
TEST(LiveCommand, RecordsDamagedFramesForIdenticalReplay) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const std::filesystem::path camera = temporary.path() / "camera";
  std::filesystem::copy(bundled("tabletop"), camera, std::filesystem::copy_options::recursive);
  const auto damage = [](const std::filesystem::path& file) {
    std::string bytes = test::bytes_of(file);
    bytes.erase(bytes.size() / 2, bytes.size() / 4);
    std::filesystem::remove(file);
    std::ofstream(file, std::ios::binary) << bytes;
  };
  for (const char* name : {"000001.jpg", "000004.jpg"}) damage(camera / "frames" / name);
  const auto done =
      penumbra({"live", "--camera", "recording:" + camera.string(), "--calibration", calibration(),
                "--no-window", "--fps", "8", "--duration", "1.1", "--threads", "1", "--record",
                path("session"), "--poses", path("live.tum"), "--report", path("live.json")});
  ASSERT_EQ(done.exit_code, 0) << done.err;
  EXPECT_EQ(test::read_json(path("live.json"))["camera_faults"]["damaged"], 2) << done.err;

  const auto replayed = penumbra({"replay", path("session"), "--no-window", "--poses",
                                  path("replay.tum"), "--report", path("replay.json")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  EXPECT_EQ(test::lines_of(replayed.err).size(), 1U) << replayed.err;
  EXPECT_NE(replayed.err.find("frames/000001.jpg: damaged JPEG"), std::string::npos)
      << replayed.err;
  const auto report = test::read_json(path("replay.json"));
  EXPECT_EQ(report["camera_faults"]["damaged"], 2);
  EXPECT_EQ(report["frames_damaged"], 2);
  EXPECT_EQ(report["frames_captured"], report["frames"].get<int>() + 2);
  const auto live_poses = load_trajectory(path("live.tum"));
  const auto replay_poses = load_trajectory(path("replay.tum"));
  ASSERT_TRUE(live_poses && replay_poses);
  ASSERT_FALSE(live_poses->poses.empty());
  for (const StampedPose& pose : live_poses->poses) {
    EXPECT_NE(replay_poses->at(pose.timestamp_ns, 0), nullptr) << pose.timestamp_ns;
  }
}

TEST(LiveCommand, TracksWithOneThread) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const auto done = penumbra(live({"--duration", "0.4", "--threads", "1", "--fps", "15", "--poses",
                                   path("live.tum"), "--report", path("report.json")}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(path("report.json"));
  const int frames = report["frames"];
  EXPECT_GT(frames, 0);
  EXPECT_GE(report["frames_tracked"].get<int>(), frames * 95 / 100);
  EXPECT_EQ(report["pipeline"]["threads"], 1);
}

TEST(LiveCommand, ScalesCalibrationOnlyWhenExact) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const CameraModel camera = load_camera(calibration()).value();
  const auto save_at = [&](const char* name, double width_scale, double height_scale) {
    CameraParameters p = camera.parameters();
    p.width = static_cast<int>(std::lround(p.width * width_scale));
    p.height = static_cast<int>(std::lround(p.height * height_scale));
    p.fx *= width_scale;
    p.fy *= height_scale;
    p.cx = (p.cx + 0.5) * width_scale - 0.5;
    p.cy = (p.cy + 0.5) * height_scale - 0.5;
    ASSERT_TRUE(save_camera(path(name), CameraModel::make(p).value()));
  };
  save_at("twice.yaml", 2.0, 2.0);
  save_at("half.yaml", 0.5, 0.5);
  save_at("wide.yaml", 1.5, 1.0);
  save_at("odd.yaml", 1.5, 1.5);
  const auto live_with = [&](const char* name, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "live",       "--camera", "recording:" + bundled("tabletop"), "--calibration",
        path(name),   "--tags",   bundled("tabletop") + "/tags.yaml", "--no-window",
        "--duration", "0.3"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return penumbra(arguments);
  };
  // The program suggests --scale-calibration if scaling would be exact, and never scales without
  // the option.
  for (const char* name : {"twice.yaml", "half.yaml"}) {
    test::expect_failure(live_with(name, {}), {name, "2x2", "--scale-calibration"});
  }
  for (const char* name : {"wide.yaml", "odd.yaml"}) {
    const auto refused = live_with(name, {});
    test::expect_failure(refused, {name, "penumbra calibrate"});
    EXPECT_EQ(refused.err.find("--scale-calibration"), std::string::npos) << refused.err;
    test::expect_failure(live_with(name, {"--scale-calibration"}),
                         {name, "no whole number", "penumbra calibrate"});
  }
  for (const char* name : {"twice.yaml", "half.yaml"}) {
    SCOPED_TRACE(name);
    const std::string session = path(name) + "-session";
    const auto done = live_with(
        name, {"--scale-calibration", "--record", session, "--report", path("report.json")});
    ASSERT_EQ(done.exit_code, 0) << done.err;
    const auto report = test::read_json(path("report.json"));
    EXPECT_GT(report["frames"].get<int>(), 0);
    EXPECT_GE(report["frames_tracked"].get<int>(), report["frames"].get<int>() * 95 / 100);
    // The stored calibration has the size of the recorded images.
    const CameraModel stored = load_camera(session + "/camera.yaml").value();
    EXPECT_EQ(stored.width(), camera.width());
    EXPECT_EQ(stored.height(), camera.height());
    EXPECT_NEAR(stored.parameters().fx, camera.parameters().fx, 1e-9);
    EXPECT_NEAR(stored.parameters().cx, camera.parameters().cx, 1e-9);
    EXPECT_NEAR(stored.parameters().cy, camera.parameters().cy, 1e-9);
    EXPECT_EQ(stored.parameters().distortion, camera.parameters().distortion);
  }
}

TEST(LiveCommand, SelectsNamedCameraFromMultiCameraFile) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const CameraModel camera = load_camera(calibration()).value();
  CameraParameters of_chain = camera.parameters();
  of_chain.distortion[4] = 0.0;  // Kalibr's format has no k3
  ASSERT_TRUE(save_camera(path("right.yaml"), CameraModel::make(of_chain).value(),
                          CameraFileFormat::kalibr));
  std::string left = test::bytes_of(path("right.yaml"));
  std::string right = left;
  left.replace(left.find("cam0"), 4, "left");
  left.replace(left.find("640"), 3, "1280");
  right.replace(right.find("cam0"), 4, "right");
  std::ofstream(path("chain.yaml")) << left << right;
  const auto with = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"live",
                                          "--camera",
                                          "recording:" + bundled("tabletop"),
                                          "--calibration",
                                          path("chain.yaml"),
                                          "--no-window",
                                          "--duration",
                                          "0.2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return penumbra(arguments);
  };
  test::expect_failure(with({}), {"chain.yaml", "left, right", "--camera-name"});
  test::expect_failure(with({"--camera-name", "up"}), {"chain.yaml", "'up'", "left, right"});
  test::expect_failure(with({"--camera-name", "left"}), {"chain.yaml", "1280x480"});
  const auto done = with({"--camera-name", "right", "--record", path("session")});
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const CameraParameters stored = load_camera(path("session") + "/camera.yaml")->parameters();
  EXPECT_EQ(stored.width, 640);
  EXPECT_EQ(stored.fx, of_chain.fx);
  EXPECT_EQ(stored.cy, of_chain.cy);
  EXPECT_EQ(stored.distortion, of_chain.distortion);
}

// Damaged frames must not be counted as late.
TEST(LiveCommand, CountsDamagedFramesSeparatelyFromLateFrames) {
  const test::TemporaryFolder temporary;
  const auto camera = temporary.path() / "camera";
  std::filesystem::create_directories(camera / "frames");
  int frames = 0;
  for (const char* file : {"timestamps.csv", "camera.yaml", "tags.yaml"}) {
    std::filesystem::copy(bundled("tabletop") + "/" + file, camera / file);
  }
  for (const auto& entry : std::filesystem::directory_iterator(bundled("tabletop") + "/frames")) {
    const auto name = entry.path().filename();
    if (std::stoi(name.string()) % 2 == 0) {
      std::filesystem::copy(entry.path(), camera / "frames" / name);
    } else {
      std::ofstream(camera / "frames" / name) << "no image";
    }
    ++frames;
  }
  ASSERT_GT(frames, 10);
  const std::string report_file = (temporary.path() / "report.json").string();
  const auto done =
      penumbra({"live", "--camera", "recording:" + camera.string(), "--calibration", calibration(),
                "--no-window", "--fps", "20", "--duration", "0.5", "--report", report_file});
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(report_file);
  const int damaged = report["frames_damaged"];
  EXPECT_GT(damaged, 0);
  EXPECT_EQ(damaged, report["camera_faults"]["damaged"].get<int>());
  EXPECT_LE(damaged, report["frames_dropped"].get<int>());
  EXPECT_EQ(report["frames_captured"].get<int>(),
            report["frames"].get<int>() + report["frames_dropped"].get<int>());
  EXPECT_NE(done.out.find(fmt::format("{} damaged", damaged)), std::string::npos) << done.out;
}

// A camera's driver would reject these frames too. The recording has several of each kind in
// sequence, so that even a slow machine receives one of them.
TEST(LiveCommand, RejectsFramesOfOtherSizeOrFormat) {
  for (const bool jpeg : {false, true}) {
    SCOPED_TRACE(jpeg ? "JPEG" : "PNG");
    const test::TemporaryFolder temporary;
    const auto camera = temporary.path() / "camera";
    std::filesystem::create_directories(camera / "frames");
    for (const char* file : {"camera.yaml", "tags.yaml"}) {
      std::filesystem::copy(bundled("tabletop") + "/" + file, camera / file);
    }
    const auto image = [](const std::filesystem::path& file, int width) {
      if (file.extension() == ".jpg") {
        const std::string bytes = test::jpeg_of(0, width, 480);
        return static_cast<bool>(std::ofstream(file, std::ios::binary) << bytes);
      }
      const std::vector<std::uint8_t> grey(std::size_t{4} * 480 * static_cast<std::size_t>(width),
                                           128);
      return save_png(file, width, 480, grey).has_value();
    };
    const std::string ending = jpeg ? ".jpg" : ".png";
    ASSERT_TRUE(image(temporary.path() / "camera" / ("right" + ending), 640));
    ASSERT_TRUE(image(temporary.path() / "camera" / ("narrow" + ending), 320));
    std::ofstream listing(camera / "timestamps.csv");
    listing << "frame,timestamp_s,file\n";
    for (int i = 0; i < 16; ++i) {
      const std::string name = fmt::format("frames/{:06}{}", i, ending);
      listing << fmt::format("{},{:.6f},{}\n", i, 0.05 * i, name);
      const bool narrow = i >= 3 && i < 7;
      std::filesystem::copy(camera / ((narrow ? "narrow" : "right") + ending), camera / name);
      if (i >= 10 && i < 14) std::ofstream(camera / name) << "no image";
    }
    listing.close();
    const auto session = temporary.path() / "session";
    const auto report_file = temporary.path() / "report.json";
    const auto done = penumbra({"live", "--camera", "recording:" + camera.string(), "--calibration",
                                calibration(), "--no-window", "--fps", "20", "--duration", "0.9",
                                "--record", session.string(), "--report", report_file.string()});
    ASSERT_EQ(done.exit_code, 0) << done.err;
    const auto report = test::read_json(report_file);
    EXPECT_GE(report["camera_faults"]["wrong_format"].get<int>(), 1) << done.err;
    EXPECT_GE(report["camera_faults"]["damaged"].get<int>(), 1) << done.err;
    EXPECT_GE(report["recorded"]["written"].get<int>(), 5);
    const auto replayed = penumbra({"replay", session.string(), "--no-window"});
    EXPECT_EQ(replayed.exit_code, 0) << replayed.err;
  }
}

TEST(LiveCommand, NeverWritesToPlayedRecording) {
  const test::TemporaryFolder temporary;
  const auto camera = temporary.path() / "camera";
  std::filesystem::copy(bundled("tabletop"), camera, std::filesystem::copy_options::recursive);
  const auto before = test::contents_of(camera);
  const auto images = test::contents_of(camera / "frames");
  for (const auto& [option, name] :
       std::vector<std::pair<std::string, std::string>>{{"--poses", "groundtruth.tum"},
                                                        {"--report", "timestamps.csv"},
                                                        {"--report", "frames/000003.jpg"},
                                                        {"--output", "pictures"},
                                                        {"--record", "session"}}) {
    SCOPED_TRACE(option + " " + name);
    test::expect_failure(penumbra({"live", "--camera", "recording:" + camera.string(),
                                   "--calibration", calibration(), "--no-window", "--duration", "1",
                                   option, (camera / name).string()}),
                         {name, "only read"});
  }
  EXPECT_EQ(test::contents_of(camera), before);
  EXPECT_EQ(test::contents_of(camera / "frames"), images);
}

TEST(LiveCommand, ReportsLagOfSmoothedPoses) {
  const test::TemporaryFolder temporary;
  const std::string report_file = (temporary.path() / "report.json").string();
  const auto done = penumbra(live({"--duration", "0.6", "--smooth", "--report", report_file}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(report_file);
  EXPECT_GT(report["smoothing"]["lag_ms"]["max"].get<double>(), 0.0);
  EXPECT_LE(report["smoothing"]["offset_px"]["max"].get<double>(), 0.25);
}

TEST(LiveCommand, KeepsReadableFilesOnCtrlC) {
  const test::TemporaryFolder temporary;
  const auto session = temporary.path() / "session";
  std::thread interrupter;
  const auto done = test::run_program(
      test::program(), live({"--record", session.string()}), {}, {}, [&](pid_t child) {
        interrupter = std::thread([&session, child] {
          // Waits until the session records frames.
          while (test::lines_of(test::bytes_of(session / "timestamps.csv")).size() < 8) {
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
          }
          kill(child, SIGINT);
        });
      });
  interrupter.join();
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_EQ(done.err, "");
  const std::string last = test::lines_of(test::bytes_of(session / "events.jsonl")).back();
  EXPECT_NE(last.find("\"end\""), std::string::npos) << last;
  const auto replayed = penumbra({"replay", session.string(), "--no-window"});
  EXPECT_EQ(replayed.exit_code, 0) << replayed.err;
  EXPECT_EQ(replayed.err, "");
}

TEST(LiveCommand, ContinuesThenFailsWhenRecordingCannotBeWritten) {
  const test::TemporaryFolder temporary;
  const std::string session = (temporary.path() / "session").string();
  const std::string scene = (temporary.path() / "empty.json").string();
  std::ofstream(scene) << R"({"objects": [], "shadows": []})";
  constexpr int kLessThanAFrame = 8;  // [KiB]
  const auto done = with_files_up_to(
      kLessThanAFrame, live({"--duration", "0.4", "--record", session, "--scene", scene}));
  EXPECT_EQ(done.exit_code, 1);
  EXPECT_NE(done.err.find("the recording is closed, the session continues"), std::string::npos)
      << done.err;
  const std::string last = test::last_line_of(done.err);
  EXPECT_NE(last.find(session), std::string::npos) << done.err;
  EXPECT_NE(last.find("free some space"), std::string::npos) << done.err;
}

// If writing the video fails, only the video ends.
TEST(LiveCommand, KeepsOtherOutputsWhenVideoCannotBeWritten) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  constexpr int kAMomentOfVideo = 1536;  // [KiB]
  const auto check = [&](const test::ProgramResult& done, const std::string& poses) {
    EXPECT_EQ(done.exit_code, 1);
    const std::string last = test::last_line_of(done.err);
    EXPECT_NE(last.find(path("out.mkv")), std::string::npos) << done.err;
    EXPECT_NE(done.err.find("this output is closed"), std::string::npos) << done.err;
    const auto kept = count_video_frames(path("out.mkv"));
    ASSERT_TRUE(kept) << "the video must keep its earlier frames: " << kept.error().message;
    EXPECT_GT(*kept, 0);
    const auto report = test::read_json(path("report.json"));
    EXPECT_LT(*kept, report["frames"].get<int>());
    EXPECT_NE(report["failure"].get<std::string>().find("out.mkv"), std::string::npos);
    const auto written = load_trajectory(poses);
    ASSERT_TRUE(written) << written.error().message;
    EXPECT_GT(written->poses.size(), 0U);
    EXPECT_EQ(written->poses.size(), report["frames_tracked"].get<std::size_t>());
    EXPECT_NE(done.out.find("tracked "), std::string::npos) << done.out;
  };
  {
    SCOPED_TRACE("live");
    const auto done = with_files_up_to(
        kAMomentOfVideo, live({"--duration", "1", "--output", path("out.mkv"), "--poses",
                               path("live.tum"), "--report", path("report.json")}));
    check(done, path("live.tum"));
    EXPECT_GT(test::read_json(path("report.json"))["frames"].get<int>(), 10);
  }
  {
    SCOPED_TRACE("replay");
    const auto done =
        with_files_up_to(kAMomentOfVideo, {"replay", bundled("tabletop"), "--frames", "0:15",
                                           "--no-window", "--output", path("out.mkv"), "--poses",
                                           path("replay.tum"), "--report", path("report.json")});
    check(done, path("replay.tum"));
    EXPECT_EQ(test::lines_of(done.err).size(), 2U) << done.err;
  }
}

// If no further pose can be written, the file keeps the earlier poses in complete lines.
TEST(LiveCommand, EndsPoseFileWithCompleteLineWhenDiskIsFull) {
  const test::TemporaryFolder temporary;
  const std::string poses = (temporary.path() / "live.tum").string();
  const auto done = with_files_up_to(1, live({"--duration", "1.2", "--poses", poses}));
  EXPECT_EQ(done.exit_code, 1);
  EXPECT_NE(test::last_line_of(done.err).find(poses), std::string::npos) << done.err;
  const std::string text = test::bytes_of(poses);
  EXPECT_TRUE(text.ends_with('\n'));
  const auto written = load_trajectory(poses);
  ASSERT_TRUE(written) << written.error().message;
  EXPECT_GT(written->poses.size(), 3U);
}

#ifdef PENUMBRA_RESET_DRIVER
// After a driver reset no OpenGL call succeeds. Outputs written before the reset are kept.
TEST(LiveCommand, KeepsOutputsWhenGraphicsDriverIsReset) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  const auto environment = [](int at) {
    return std::vector<std::string>{"LD_PRELOAD=" PENUMBRA_RESET_DRIVER,
                                    fmt::format("PENUMBRA_TEST_RESET_AT={}", at)};
  };
  const auto done =
      penumbra(live({"--duration", "30", "--output", path("out.mkv"), "--poses", path("live.tum"),
                     "--record", path("session"), "--report", path("report.json")}),
               environment(30));
  EXPECT_EQ(done.exit_code, 1);
  const std::string last = test::last_line_of(done.err);
  EXPECT_NE(last.find("was reset"), std::string::npos) << done.err;
  const auto report = test::read_json(path("report.json"));
  const int frames = report["frames"].get<int>();
  EXPECT_GT(frames, 5);
  EXPECT_LT(frames, 30);
  EXPECT_NE(report["failure"].get<std::string>().find("was reset"), std::string::npos);
  const auto kept = count_video_frames(path("out.mkv"));
  ASSERT_TRUE(kept) << kept.error().message;
  EXPECT_EQ(*kept, frames);
  const auto poses = load_trajectory(path("live.tum"));
  ASSERT_TRUE(poses) << poses.error().message;
  EXPECT_EQ(poses->poses.size(), report["frames_tracked"].get<std::size_t>());
  const auto replayed =
      penumbra({"replay", path("session"), "--no-window", "--poses", path("replay.tum")});
  EXPECT_EQ(replayed.exit_code, 0) << replayed.err;

  // A reset before the first frame also ends a replay, which keeps the outputs of an earlier one.
  const std::string before = test::bytes_of(path("replay.tum"));
  for (const int at : {5, 1}) {
    const auto again = penumbra(
        {"replay", path("session"), "--no-window", "--poses", path("replay.tum")}, environment(at));
    test::expect_failure(again, {"was reset"});
    EXPECT_EQ(test::bytes_of(path("replay.tum")), before);
  }
}
#endif

// A replay that ends early because its recording is damaged must not replace earlier outputs.
TEST(ReplayCommand, KeepsEarlierOutputsWhenRecordingIsDamaged) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  std::filesystem::copy(bundled("tabletop"), path("played"),
                        std::filesystem::copy_options::recursive);
  std::ofstream(path("out.tum")) << "1 0 0 0 0 0 0 1\n";
  const std::string before = test::bytes_of(path("out.tum"));
  std::filesystem::remove(path("played/frames/000030.jpg"));
  std::ofstream(path("played/frames/000030.jpg")) << "no image";
  const auto done = penumbra({"replay", path("played"), "--no-window", "--poses", path("out.tum"),
                              "--report", path("report.json")});
  test::expect_failure(done, {"000030.jpg"});
  EXPECT_EQ(test::bytes_of(path("out.tum")), before);
  EXPECT_FALSE(std::filesystem::exists(path("report.json")));
}

TEST(LiveCommand, PlaysVideoRecordingAsCamera) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  std::filesystem::create_directory(path("video"));
  // The bundled images as a video, like the recording of an uncompressed camera.
  std::ofstream(path("nothing.json")) << R"({"objects": [], "shadows": []})";
  const auto made =
      penumbra({"replay", bundled("tabletop"), "--no-window", "--frames", "0:6", "--scene",
                path("nothing.json"), "--output", path("video/video.mkv")});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  for (const char* file : {"camera.yaml", "tags.yaml"}) {
    std::filesystem::copy(bundled("tabletop") + "/" + file, path("video") + "/" + file);
  }
  std::ofstream listing(path("video/timestamps.csv"));
  listing << "frame,timestamp_s,file\n";
  for (int i = 0; i < 6; ++i) listing << fmt::format("{},{:.6f},video.mkv\n", i, i / 30.0);
  listing.close();
  // Slow enough that no frame is dropped, and long enough that the recording restarts.
  const auto done =
      penumbra({"live", "--camera", "recording:" + path("video"), "--calibration", calibration(),
                "--no-window", "--fps", "8", "--duration", "1.1", "--poses", path("live.tum"),
                "--record", path("session"), "--report", path("report.json")});
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const auto report = test::read_json(path("report.json"));
  EXPECT_GE(report["frames"].get<int>(), 5);
  EXPECT_EQ(report["frames_tracked"], report["frames"]);
  EXPECT_FALSE(report.contains("camera_faults") && report["camera_faults"].contains("damaged"));
  EXPECT_TRUE(std::filesystem::exists(path("session/video.mkv")));
  const auto replayed = penumbra({"replay", path("session"), "--no-window"});
  EXPECT_EQ(replayed.exit_code, 0) << replayed.err;
}

TEST(LiveCommand, ReportsWhyNoFrameIsTracked) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  // A sheet of the same family with other ids.
  const auto sheet = penumbra(
      {"target", "--first-id", "300", "--output", path("other.pdf"), "--tags", path("other.yaml")});
  ASSERT_EQ(sheet.exit_code, 0) << sheet.err;
  const auto done = penumbra(
      live({"--duration", "0.5", "--tags", path("other.yaml"), "--report", path("report.json")}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  EXPECT_NE(done.out.find("none of them of this board (--tags)"), std::string::npos) << done.out;
  EXPECT_NE(done.out.find("no frame was tracked"), std::string::npos) << done.out;
  EXPECT_FALSE(test::read_json(path("report.json"))["tracking"]["not_tracked"].empty());
}

TEST(LiveCommand, ReportsMissingInputsInOneLine) {
  const auto without_calibration = penumbra({"live", "--no-window"});
  EXPECT_EQ(without_calibration.exit_code, 2) << without_calibration.err;
  EXPECT_NE(without_calibration.err.find("--calibration"), std::string::npos);
  EXPECT_NE(without_calibration.err.find("penumbra calibrate"), std::string::npos);
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "v4l2:/dev/no-such-camera",
                                 "--calibration", calibration()}),
                       {"/dev/no-such-camera", "no such camera", "penumbra devices"});
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "v4l2:/dev/null",
                                 "--calibration", calibration()}),
                       {"/dev/null", "not a camera"});
  test::expect_failure(penumbra({"live", "--no-window", "--calibration", "nowhere/camera.yaml"}),
                       {"nowhere/camera.yaml", "no such file"});
  test::expect_failure(penumbra({"live", "--no-window", "--camera", "libcamera:no-such-camera",
                                 "--calibration", calibration()}),
                       {"libcamera"});
  const test::TemporaryFolder full;
  std::filesystem::create_directory(full.path() / "old");
  test::expect_failure(penumbra(live({"--record", full.path().string()})), {"not empty"});
}

TEST(LiveCommand, RejectsOutputsInsideRecordedSession) {
  const test::TemporaryFolder temporary;
  const auto path = [&](const char* name) { return (temporary.path() / name).string(); };
  for (const auto& [option, place] : std::vector<std::pair<std::string, std::string>>{
           {"--output", "session/frames"}, {"--poses", "session/poses.tum"}}) {
    test::expect_failure(penumbra(live({"--record", path("session"), option, path(place.c_str())})),
                         {place, "--record"});
  }
  test::expect_failure(
      penumbra(live({"--output", path("pictures"), "--record", path("pictures/session")})),
      {"pictures/session", "images and nothing else"});
  EXPECT_TRUE(std::filesystem::is_empty(temporary.path()));
}

TEST(LiveCommand, TakesCalibrationAndTagsOfPlayedRecording) {
  const auto done = penumbra(
      {"live", "--camera", "recording:" + bundled("tabletop"), "--no-window", "--duration", "0.2"});
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_TRUE(done.out.starts_with("calibration: " + calibration() + "\n")) << done.out;
  EXPECT_NE(done.out.find("tags: " + bundled("tabletop")), std::string::npos) << done.out;
}

// Poses with a guessed lens are drawn, but never called tracked; nor are those of the recording.
TEST(LiveCommand, NeverTracksWithoutCalibration) {
  const test::TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  for (const char* fov : {"50", "75"}) {  // the camera's is 62
    SCOPED_TRACE(fov);
    const std::string session = path("session") + fov;
    const auto done = penumbra({"live", "--camera", "recording:" + bundled("tabletop"), "--fov",
                                fov, "--no-window", "--duration", "0.5", "--record", session,
                                "--frame-log", path("log.csv")});
    ASSERT_EQ(done.exit_code, 0) << done.err;
    EXPECT_THAT(done.out, testing::StartsWith("calibration: none; poses stay uncertain"));
    EXPECT_THAT(done.out, testing::HasSubstr("tracked 0, uncertain "));
    EXPECT_THAT(test::bytes_of(path("log.csv")), testing::Not(testing::HasSubstr(",tracked,")));
    EXPECT_THAT(test::bytes_of(path("log.csv")), testing::HasSubstr(",uncertain,"));
    const auto replayed = penumbra({"replay", session, "--no-window"});
    ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
    EXPECT_THAT(replayed.out, testing::HasSubstr("tracked 0, uncertain "));
  }
  // A camera without a calibration is offered the start.
  const auto missing = penumbra({"live", "--camera", "v4l2:/dev/video0"});
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_THAT(missing.err, testing::HasSubstr("--fov"));
  EXPECT_EQ(penumbra(live({"--fov", "60"})).exit_code, 2) << "beside --calibration";
  EXPECT_EQ(penumbra({"live", "--fov", "5"}).exit_code, 2);
}

TEST(LiveCommand, RejectsWrongUsageWithExitCode2) {
  for (const std::string& camera : {std::string("telescope"), bundled("tabletop")}) {
    const auto no_camera =
        penumbra({"live", "--no-window", "--camera", camera, "--calibration", calibration()});
    EXPECT_EQ(no_camera.exit_code, 2) << camera;
    EXPECT_NE(no_camera.err.find("--camera: " + camera), std::string::npos) << no_camera.err;
  }
  const auto much = penumbra(live({"--gain", "1e9"}));
  EXPECT_EQ(much.exit_code, 2);
  EXPECT_EQ(penumbra(live({"--size", "640"})).exit_code, 2);
  EXPECT_EQ(penumbra(live({"--format", "bayer"})).exit_code, 2);
  // These options are not supported for a recording.
  for (const std::vector<std::string>& option : std::vector<std::vector<std::string>>{
           {"--size", "640x480"}, {"--format", "grey"}, {"--exposure", "4"}, {"--focus", "1"}}) {
    const auto done = penumbra(live(option));
    EXPECT_EQ(done.exit_code, 2) << option[0];
    EXPECT_NE(done.err.find(option[0]), std::string::npos) << done.err;
  }
  EXPECT_EQ(penumbra(live({"--exposure", "long"})).exit_code, 2);
  EXPECT_EQ(penumbra(live({"--duration", "-1"})).exit_code, 2);
}

// scripts/test-live skips camera tests only if the virtual machine can't start. Without shared data
// it must not build a software camera.
TEST(TestLiveScript, SkipsWithoutVirtualMachineAndFailsWithoutSetup) {
  const test::TemporaryFolder temporary;
  const auto machine = [&](const char* name, const std::string& script) {
    const auto file = temporary.path() / name;
    std::ofstream(file) << "#!/bin/bash\n" << script << "\n";
    std::filesystem::permissions(file, std::filesystem::perms::owner_all);
    return test::run_program(
        test::source_dir() / "scripts" / "test-live", {test::program().string()},
        {"PENUMBRA_CAMERA_VM=" + file.string(), "PENUMBRA_SHARED=" + temporary.path().string()});
  };
  const auto never = machine("never", "exit 125");
  EXPECT_EQ(never.exit_code, 77) << never.err;
  EXPECT_NE(never.err.find("does not start"), std::string::npos) << never.err;
  const auto without_feed = machine("without-feed", R"([[ "$*" != *--feed* ]] || exit 125)");
  EXPECT_EQ(without_feed.exit_code, 1) << without_feed.err;
  EXPECT_NE(without_feed.err.find("not with these cameras"), std::string::npos) << without_feed.err;
  const auto no_setup = machine("no-setup", "exit 2");
  EXPECT_EQ(no_setup.exit_code, 77) << no_setup.err;
  EXPECT_NE(no_setup.err.find("can't be set up"), std::string::npos) << no_setup.err;
  const auto failing = machine("failing", R"([[ "$*" == *--prepare* ]] || exit 2)");
  EXPECT_EQ(failing.exit_code, 2) << failing.err;
  const auto no_command = machine("no-command", "exit 127");
  EXPECT_EQ(no_command.exit_code, 127) << no_command.err;
}

TEST(DevicesCommand, ListsCameraBackends) {
  const auto done = penumbra({"devices"});
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_NE(done.out.find("libcamera"), std::string::npos) << done.out;
}

}  // namespace
}  // namespace penumbra
