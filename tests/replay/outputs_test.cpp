// Text outputs on standard output and in pipes, and the tag map that a run uses.
#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <future>
#include <map>
#include <thread>

#include "app/study/study_results.hpp"
#include "core/camera/camera_file.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_file.hpp"
#include "replay_support.hpp"
#include "support/deep_png.hpp"
#include "support/recording_folder.hpp"
#include "support/running_program.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using test::bundled;
using test::bytes_of;
using test::penumbra;
using test::TemporaryFolder;
using testing::HasSubstr;
using testing::StartsWith;

std::string cube() {
  return (test::source_dir() / "scenes" / "models" / "cube.glb").string();
}

// Runs a script in a shell, for redirections.
test::ProgramResult in_shell(const std::string& script, const fs::path& folder) {
  return test::run_program("/bin/bash",
                           {"-c", "set -o pipefail; penumbra() { \"" + test::program().string() +
                                      "\" \"$@\"; }; " + script},
                           {}, folder);
}

TEST(StandardOutput, ReceivesOnlyPoses) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "poses.tum";
  ASSERT_EQ(
      penumbra({"replay", bundled("corner"), "--no-window", "--frames", "0:4", "--poses", file})
          .exit_code,
      0);
  for (const char* name : {"-", "/dev/stdout", "/dev/fd/1"}) {
    const auto result =
        penumbra({"replay", bundled("corner"), "--no-window", "--frames", "0:4", "--poses", name});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(result.out, bytes_of(file)) << name;
    EXPECT_THAT(result.err, HasSubstr("tracked 4")) << "the table must be on standard error";
  }
}

TEST(StandardOutput, ReceivesReport) {
  const auto result =
      penumbra({"replay", bundled("corner"), "--no-window", "--frames", "0:2", "--report", "-"});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const auto report = nlohmann::json::parse(result.out, nullptr, false);
  ASSERT_FALSE(report.is_discarded()) << result.out.substr(0, 200);
  EXPECT_EQ(report["frames"], 2);
}

TEST(StandardOutput, ReceivesShadowsKernelsAndTargets) {
  const TemporaryFolder folder;
  const auto same_as_file = [&](std::vector<std::string> arguments, const std::string& option,
                                const std::string& name) {
    SCOPED_TRACE(arguments[0] + " " + name);
    const auto file = folder.path() / name;
    std::vector<std::string> to_file = arguments;
    to_file.insert(to_file.end(), {option, file.string()});
    ASSERT_EQ(penumbra(to_file).exit_code, 0);
    arguments.insert(arguments.end(), {option, "-"});
    const auto result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_FALSE(result.out.empty());
    // Compares the text up to the times, which differ between runs.
    const auto comparable = [](const std::string& text) {
      return text.substr(0, text.find("\"time_ms\""));
    };
    EXPECT_EQ(comparable(result.out), comparable(bytes_of(file)));
  };
  same_as_file({"shadow", cube()}, "--output", "layers.json");
  same_as_file({"kernels", cube()}, "--output", "kernels.json");
  same_as_file({"target", "--output", folder.path() / "sheet.pdf"}, "--tags", "tags-named.yaml");
}

// Runs a command with its output in a file, on standard output and in a named pipe. Expects the
// same text in all three and returns it.
std::string same_in_file_output_and_pipe(const std::vector<std::string>& arguments,
                                         const std::string& option) {
  const TemporaryFolder folder;
  const auto to = [&](const std::string& path) {
    std::vector<std::string> all = arguments;
    all.insert(all.end(), {option, path});
    return penumbra(all);
  };
  const fs::path file = folder.path() / "file";
  const auto written = to(file);
  EXPECT_EQ(written.exit_code, 0) << written.err;
  std::string text = bytes_of(file);
  EXPECT_FALSE(text.empty());
  const auto printed = to("-");
  EXPECT_EQ(printed.exit_code, 0) << printed.err;
  EXPECT_EQ(printed.out, text);
  const fs::path pipe = folder.path() / "pipe";
  EXPECT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  auto reader = std::async(std::launch::async, [&] { return bytes_of(pipe); });
  const auto piped = to(pipe);
  EXPECT_EQ(piped.exit_code, 0) << piped.err;
  // Ends the reader if the program failed before it opened the pipe.
  if (const int writer = open(pipe.c_str(), O_WRONLY | O_NONBLOCK); writer >= 0) close(writer);
  EXPECT_EQ(reader.get(), text);
  EXPECT_TRUE(fs::is_fifo(pipe)) << "the pipe was replaced";
  return text;
}

TEST(TextOutput, WritesSameCameraToFileStdoutAndPipe) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  const fs::path source = test::shared_dir() / "recordings" / "chessboard";
  const TemporaryFolder folder;
  test::write_thinned_recording(folder.path() / "some", source, 5);
  const std::string text = same_in_file_output_and_pipe(
      {"calibrate", folder.path() / "some", "--target", source / "chessboard.yaml", "--model",
       "plumb_bob", "--board", "rigid", "--views", "8"},
      "--output");
  test::write_text(folder.path() / "camera.yaml", text);
  const auto camera = load_camera(folder.path() / "camera.yaml");
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_EQ(camera->width(), 640);
  EXPECT_NEAR(camera->parameters().fx, 531.7, 3.0);
  EXPECT_TRUE(camera->parameters().overlay_sigma_px);
}

TEST(TextOutput, WritesSameTagMapToFileStdoutAndPipe) {
  const TemporaryFolder folder;
  test::write_thinned_recording(folder.path() / "some", bundled("tabletop"), 12);
  const std::string text = same_in_file_output_and_pipe(
      {"map", folder.path() / "some", "--tag-size", "0.04", "--anchor", "5"}, "--output");
  test::write_text(folder.path() / "tags.yaml", text);
  const auto tags = load_tag_map(folder.path() / "tags.yaml");
  ASSERT_TRUE(tags) << tags.error().message;
  EXPECT_EQ(tags->tags().size(), 12U);
  EXPECT_LT(tags->find(TagFamily::tag36h11, 5)->T_table_tag.translation().norm(), 1e-4);
}

TEST(TextOutput, WritesSameStudyResultsToFileStdoutAndPipe) {
  const TemporaryFolder folder;
  const fs::path script = folder.path() / "script.txt";
  test::write_text(script, "1 0.5 click sphere 2\n2 0.25 click sphere 1\n");
  const std::string text =
      same_in_file_output_and_pipe({"study", "--experiment", "heights", "--techniques", "layered",
                                    "--participant", "1", "--seed", "7", "--trials", "2", "--pause",
                                    "0.05", "--recording", bundled("tabletop"), "--script", script},
                                   "--output");
  const std::vector<std::string> lines = test::lines_of(text);
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[0], kStudyHeader);
  for (const std::size_t trial : {1U, 2U}) {
    const auto row = parse_study_row(lines[trial]);
    ASSERT_TRUE(row) << lines[trial];
    EXPECT_EQ(row->trial, static_cast<int>(trial));
    EXPECT_EQ(row->chosen, trial == 1 ? "2" : "1");
    EXPECT_EQ(row->response_time_ns, trial == 1 ? 500'000'000 : 250'000'000);
  }
}

TEST(WrittenFiles, OmitsFolderOfGroupPosesWithoutGroups) {
  const TemporaryFolder folder;
  const auto done =
      penumbra({"replay", bundled("tabletop"), "--no-window", "--frames", "0:2", "--poses",
                folder.path() / "out.tum", "--group-poses", folder.path() / "groups"});
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_THAT(done.out,
              testing::EndsWith("\nwrote " + (folder.path() / "out.tum").string() + "\n"));
}

TEST(StandardOutput, RejectsSecondOutput) {
  const TemporaryFolder folder;
  using Arguments = std::vector<std::string>;
  for (const Arguments& arguments :
       {Arguments{"replay", "r", "--poses", "-", "--report", "-"},
        Arguments{"replay", "r", "--poses", "-", "--report", "/dev/stdout"},
        Arguments{"live", "--calibration", "c.yaml", "--poses", "-", "--report", "-"},
        Arguments{"calibrate", "p", "--target", "t.yaml", "--output", "-", "--report", "-"},
        Arguments{"map", "r", "--anchor", "1", "--tag-size", "0.04", "--output", "-",
                  "--refine-camera", "-"},
        Arguments{"target", "--output", "-", "--tags", "-"}}) {
    const auto result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 2) << result.err;
    EXPECT_THAT(result.err, HasSubstr("standard output is taken by"));
    EXPECT_EQ(result.out, "");
  }
  const auto frames = penumbra({"replay", "r", "--output", "-"});
  EXPECT_EQ(frames.exit_code, 2);
  EXPECT_THAT(frames.err, HasSubstr("name a video or a folder"));
}

TEST(StandardOutput, AppendsWhenShellRedirectsWithAppend) {
  const TemporaryFolder folder;
  const auto result = in_shell("echo first > log; penumbra shadow '" + cube() +
                                   "' --output /dev/stdout >> log; echo last "
                                   ">> log",
                               folder.path());
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const std::vector<std::string> lines = test::lines_of(bytes_of(folder.path() / "log"));
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines.front(), "first");
  EXPECT_THAT(lines[1], StartsWith("{\"H\":"));
  EXPECT_EQ(lines.back(), "last");
}

// The reader closes the pipe before the first write.
TEST(StandardOutput, FailsInOneLineWhenReaderIsGone) {
  const TemporaryFolder folder;
  for (const std::string& command :
       {"replay '" + bundled("corner") + "' --no-window --frames 0:8 --poses -",
        "shadow '" + cube() + "' --output -", "kernels '" + cube() + "' --output -"}) {
    const auto result = in_shell("penumbra " + command + " | true", folder.path());
    EXPECT_EQ(result.exit_code, 1) << command << result.err;
    EXPECT_THAT(result.err, HasSubstr("penumbra: error: standard output: cannot be written"));
    EXPECT_THAT(result.err, HasSubstr("its reader closed it"));
  }
}

// The reader reads the two pipes in sequence, like a script.
TEST(NamedPipe, CarriesPosesAndReport) {
  const TemporaryFolder folder;
  const fs::path poses = folder.path() / "poses";
  const fs::path report = folder.path() / "report";
  for (const fs::path& pipe : {poses, report}) ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  auto reader = std::async(std::launch::async, [&] {
    return std::pair{bytes_of(poses), bytes_of(report)};
  });
  const auto result = penumbra({"replay", bundled("corner"), "--no-window", "--frames", "0:3",
                                "--poses", poses, "--report", report});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  const auto [poses_text, report_text] = reader.get();
  EXPECT_EQ(test::lines_of(poses_text).size(), 4U);
  EXPECT_EQ(nlohmann::json::parse(report_text)["frames"], 3);
  EXPECT_TRUE(fs::is_fifo(poses) && fs::is_fifo(report)) << "a pipe was replaced";
}

// Reader and writer open their pipes a second after the warnings, which appear after a second. The
// two programs wait at the same time.
TEST(NamedPipe, ReportsWaitOnce) {
  const TemporaryFolder folder;
  for (const char* pipe : {"out-pipe", "in-pipe"})
    ASSERT_EQ(mkfifo((folder.path() / pipe).c_str(), 0600), 0);
  const auto done = in_shell(
      fmt::format(
          "penumbra shadow '{0}' --output out-pipe 2> out-log & writer=$!; penumbra evaluate "
          "--estimated in-pipe --groundtruth '{1}/groundtruth.tum' --camera '{1}/camera.yaml' "
          "--json 2> in-log > errors.json & reader=$!; for i in {{1..1500}}; do [ -s out-log ] && "
          "[ -s in-log ] && break; sleep 0.02; done; sleep 1.1; cat out-pipe > layers.json; cat "
          "'{1}/groundtruth.tum' > in-pipe; wait $writer && wait $reader",
          cube(), bundled("corner")),
      folder.path());
  EXPECT_EQ(done.exit_code, 0) << done.err;
  EXPECT_EQ(bytes_of(folder.path() / "out-log"),
            "penumbra: warning: out-pipe: is a named pipe that nothing reads; waiting for "
            "its reader\n");
  EXPECT_THAT(bytes_of(folder.path() / "layers.json"), StartsWith("{\"H\":"));
  EXPECT_EQ(bytes_of(folder.path() / "in-log"),
            "penumbra: warning: in-pipe: is a named pipe without data; waiting for its writer\n");
  EXPECT_EQ(nlohmann::json::parse(bytes_of(folder.path() / "errors.json"))["translation_mm"]["max"],
            0.0);
}

TEST(NamedPipe, StopsWaitingForReaderOnCtrlC) {
  const TemporaryFolder folder;
  const fs::path pipe = folder.path() / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const fs::path log = folder.path() / "log";
  test::RunningProgram running(
      {test::program().string(), "replay", bundled("corner"), "--no-window", "--poses", pipe}, [&] {
        const int file = open(log.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
        dup2(file, STDERR_FILENO);
      });
  // The warning of the wait appears after a second; gives up after a minute.
  for (int i = 0; i < 6000 && running.runs() && bytes_of(log).empty(); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_THAT(bytes_of(log), HasSubstr("waiting for its reader"));
  running.signal(SIGINT);
  EXPECT_EQ(running.exit_code(), 1);
}

// --- the tag map ---

TEST(TagMapInUse, AppearsInOutputAndReport) {
  const TemporaryFolder folder;
  const auto named = folder.path() / "mine.yaml";
  fs::copy_file(bundled("corner") + "/tags.yaml", named);
  const TagMap map = load_tag_map(named).value();
  for (const std::string& file : {named.string(), bundled("corner") + "/tags.yaml"}) {
    std::vector<std::string> arguments = {"replay",
                                          bundled("corner"),
                                          "--no-window",
                                          "--frames",
                                          "0:2",
                                          "--report",
                                          folder.path() / "report.json"};
    if (file == named) arguments.insert(arguments.end(), {"--tags", file});
    const auto result = penumbra(arguments);
    ASSERT_EQ(result.exit_code, 0) << result.err;
    EXPECT_THAT(result.out,
                HasSubstr(fmt::format("tags: {} ({} tags of ", file, map.tags().size())));
    const auto tags = test::read_json(folder.path() / "report.json")["tags"];
    EXPECT_EQ(tags["file"], file);
    EXPECT_EQ(tags["count"], map.tags().size());
    EXPECT_EQ(tags["sizes_m"].front().get<double>(), 0.04);
  }
}

TEST(TagMapInUse, ComesFromRecordingOrCalibrationNeverFromDefault) {
  const TemporaryFolder folder;
  const auto recording = folder.path() / "recording";
  test::write_recording(recording, 2);
  fs::remove(recording / "tags.yaml");
  const auto camera = folder.path() / "camera.yaml";
  fs::copy_file(recording / "camera.yaml", camera);
  const std::string played = "recording:" + recording.string();
  const std::vector<std::string> expected = {"--tags FILE", "penumbra target", "penumbra map",
                                             (recording / "tags.yaml").string()};
  test::expect_failure(penumbra({"replay", recording, "--no-window"}), expected);
  test::expect_failure(
      penumbra({"live", "--camera", played, "--calibration", camera, "--no-window"}), expected);
  test::expect_failure(
      penumbra({"study", "--experiment", "heights", "--output", folder.path() / "a.csv", "--camera",
                played, "--calibration", camera}),
      expected);
  // The map in the recording has priority over the map beside the calibration.
  test::write_text(folder.path() / "tags.yaml", test::small_tags_yaml());
  for (const fs::path& used : {folder.path() / "tags.yaml", recording / "tags.yaml"}) {
    test::write_text(used, test::small_tags_yaml());
    const auto result = penumbra(
        {"live", "--camera", played, "--calibration", camera, "--no-window", "--duration", "0.1"});
    EXPECT_THAT(result.out, HasSubstr("tags: " + used.string() + " (2 tags of 40 mm)"))
        << result.err;
  }
}

// --- images with faults ---

Frame first_frame_of(const char* recording) {
  for (const char* extension : {".jpg", ".png"}) {
    const auto file =
        test::recordings_dir() / recording / "frames" / ("000000" + std::string(extension));
    if (fs::exists(file)) return load_image(file).value();
  }
  ADD_FAILURE() << recording;
  return {};
}

// Writes the first frame of `tabletop` twice: as 8-bit images if `bits` is 8, else as the 16-bit
// images of a camera with `bits` bits. `with_chunk`: stores `bits` in the PNG's sBIT chunk.
void write_deep_recording(const fs::path& folder, int bits, bool with_chunk) {
  const fs::path source = bundled("tabletop");
  fs::create_directories(folder / "frames");
  for (const char* file : {"camera.yaml", "tags.yaml"}) fs::copy_file(source / file, folder / file);
  test::write_text(folder / "timestamps.csv", test::listing(2, ".png"));
  const Frame frame = first_frame_of("tabletop");
  std::vector<std::uint8_t> scratch;
  const ImageView grey = luma(frame, scratch);
  std::vector<std::uint8_t> plain;
  std::vector<std::uint16_t> values;
  for (int y = 0; y < grey.height; ++y) {
    for (int x = 0; x < grey.width; ++x) {
      plain.push_back(grey.row(y)[x]);
      values.push_back(static_cast<std::uint16_t>(plain.back() << (bits - 8)));
    }
  }
  for (int i = 0; i < 2; ++i) {
    const fs::path file = folder / "frames" / (test::six_digits(i) + ".png");
    if (bits == 8) {
      EXPECT_TRUE(save_grey_png(file, {plain.data(), grey.width, grey.height, grey.width}));
    } else {
      test::DeepPng layout;
      if (with_chunk) layout.significant_bits = bits;
      const auto png = test::deep_png(values, grey.width, grey.height, layout);
      test::write_text(file, {png.begin(), png.end()});
    }
  }
}

TEST(DarkSixteenBitImages, TrackLikeEightBitOriginals) {
  const TemporaryFolder folder;
  std::map<std::string, std::string> poses;
  for (const auto& [bits, with_chunk] :
       {std::pair{8, false}, {10, false}, {12, false}, {12, true}, {14, false}, {16, false}}) {
    const std::string name = fmt::format("{}{}", bits, with_chunk ? "-chunk" : "");
    write_deep_recording(folder.path() / name, bits, with_chunk);
    const auto result = penumbra({"replay", folder.path() / name, "--no-window", "--scene",
                                  test::empty_scene_in(folder.path()), "--poses", "-"});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    poses[name] = result.out;
    EXPECT_EQ(test::lines_of(result.out).size(), 3U) << name;
    EXPECT_EQ(result.out, poses["8"]) << name;
    const bool is_reported = result.err.find("16-bit images hold") != std::string::npos;
    EXPECT_EQ(is_reported, bits > 8 && bits < 16) << result.err;
  }
}

TEST(DarkSixteenBitImages, TrackFromTenAndTwelveBitCameras) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto cases = test::shared_dir() / "cases" / "dark-16-bit-pictures";
  const TemporaryFolder folder;
  const auto report = folder.path() / "report.json";
  for (const auto& [name, notice] :
       {std::pair{"r_gray10in16", "read as 10-bit"}, {"r_gray12in16", "read as 12-bit"}}) {
    const auto result = penumbra({"replay", cases / name, "--no-window", "--report", report});
    ASSERT_EQ(result.exit_code, 0) << result.err;
    EXPECT_THAT(result.err, HasSubstr(notice));
    EXPECT_EQ(test::lines_of(result.err).size(), 1U) << "reported once";
    const auto json = test::read_json(report);
    EXPECT_EQ(json["frames_tracked"], 2);
    EXPECT_LT(json["accuracy"]["translation_mm"]["rmse"].get<double>(), 0.2);
  }
}

// Writes the recording's first frame twice, with `change` applied to each row.
template <class Change>
fs::path changed_recording(const fs::path& folder, const Change& change) {
  const fs::path source = bundled("tabletop");
  fs::create_directories(folder / "frames");
  for (const char* file : {"camera.yaml", "tags.yaml"}) fs::copy_file(source / file, folder / file);
  const Frame frame = first_frame_of("tabletop");
  std::vector<std::uint8_t> scratch;
  const ImageView grey = luma(frame, scratch);
  std::vector<std::uint8_t> pixels;
  for (int y = 0; y < grey.height; ++y) {
    std::vector<std::uint8_t> row(grey.row(y), grey.row(y) + grey.width);
    change(row);
    pixels.insert(pixels.end(), row.begin(), row.end());
  }
  for (int i = 0; i < 2; ++i) {
    EXPECT_TRUE(save_grey_png(folder / "frames" / (test::six_digits(i) + ".png"),
                              {pixels.data(), grey.width, grey.height, grey.width}));
  }
  test::write_text(folder / "timestamps.csv", test::listing(2, ".png"));
  return folder;
}

void mirror(std::vector<std::uint8_t>& row) {
  std::ranges::reverse(row);
}
void negate(std::vector<std::uint8_t>& row) {
  for (std::uint8_t& value : row) value = static_cast<std::uint8_t>(255 - value);
}

TEST(ImageFault, IsReportedForMirroredAndNegativeImages) {
  const TemporaryFolder folder;
  const auto mirrored = changed_recording(folder.path() / "mirrored", mirror);
  const auto negative = changed_recording(folder.path() / "negative", negate);
  for (const auto& [recording, what] :
       {std::pair{mirrored, "the images are mirrored"}, {negative, "the images are negative"}}) {
    const auto report = folder.path() / "report.json";
    const auto result = penumbra({"replay", recording, "--no-window", "--report", report});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_THAT(result.err, HasSubstr(what));
    EXPECT_THAT(result.out, HasSubstr(fmt::format("no frame was tracked: {}", what)));
    EXPECT_EQ(test::read_json(report)["frames_tracked"], 0);
    EXPECT_TRUE(test::read_json(report)["tracking"].contains("image_fault"));
    const auto live =
        penumbra({"live", "--camera", "recording:" + recording.string(), "--calibration",
                  recording / "camera.yaml", "--no-window", "--duration", "0.2"});
    EXPECT_EQ(live.exit_code, 0) << live.err;
    EXPECT_THAT(live.err, HasSubstr(what));
  }
  const auto plain = penumbra({"replay", bundled("tabletop"), "--no-window", "--frames", "0:1"});
  EXPECT_EQ(plain.err, "");
}

TEST(ImageFault, IsReportedWhenMirroringBeginsMidSession) {
  const TemporaryFolder folder;
  const auto recording = changed_recording(folder.path() / "mirrored", mirror);
  // One normal frame, then mirrored frames. The pose is first extrapolated for half a second.
  fs::remove(recording / "frames" / "000000.png");
  const Frame frame = first_frame_of("tabletop");
  std::vector<std::uint8_t> scratch;
  ASSERT_TRUE(save_grey_png(recording / "frames" / "000000.png", luma(frame, scratch)));
  constexpr int kFrames = 100;
  std::string listing = "frame,timestamp_s,file\n";
  for (int i = 0; i < kFrames; ++i) {
    const std::string file = fmt::format("frames/{:06}.png", i);
    if (i > 1) fs::copy_file(recording / "frames" / "000001.png", recording / file);
    listing += fmt::format("{},{:.1f},{}\n", i, 0.1 * i, file);
  }
  test::write_text(recording / "timestamps.csv", listing);
  const auto result = penumbra(
      {"replay", recording, "--no-window", "--scene", test::empty_scene_in(folder.path())});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("tracked 1,"));
  EXPECT_THAT(result.err, HasSubstr("the images are mirrored"));
}

TEST(ImageFault, StopsCalibrationFromMirroredTags) {
  const TemporaryFolder folder;
  const auto recording = changed_recording(folder.path() / "mirrored", mirror);
  const auto output = folder.path() / "camera.yaml";
  for (const std::string& source : {recording.string(), "recording:" + recording.string()}) {
    test::expect_failure(penumbra({"calibrate", source, "--no-window", "--target",
                                   recording / "tags.yaml", "--output", output}),
                         {"the images are mirrored"});
    EXPECT_FALSE(fs::exists(output));
  }
}

}  // namespace
}  // namespace penumbra
