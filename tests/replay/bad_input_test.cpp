// Bad input: the program exits with code 1 and one line that names the file and the cause, and
// writes no output file.

#include <gmock/gmock.h>
#include <unistd.h>

extern "C" {
#include <libavformat/version.h>
#include <libavutil/macros.h>
}

#include <functional>
#include <random>

#include "replay_support.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;

// Copies the first frames of a bundled recording, so that tests can damage them.
class ReplayInput : public testing::Test {
 protected:
  static constexpr int kFrames = 6;

  void SetUp() override {
    const fs::path source = recordings_dir() / "corner";
    fs::create_directories(recording() / "frames");
    for (const char* file : {"camera.yaml", "tags.yaml", "groundtruth.tum"}) {
      fs::copy_file(source / file, recording() / file);
    }
    std::string listing;
    int count = -1;  // not counting the header
    for (const std::string& line : lines_of(bytes_of(source / "timestamps.csv"))) {
      if (count == kFrames) break;
      listing += line + "\n";
      ++count;
    }
    write(recording() / "timestamps.csv", listing);
    for (int i = 0; i < kFrames; ++i) {
      std::array<char, 32> name{};
      std::snprintf(name.data(), name.size(), "%06d.jpg", i);
      fs::copy_file(source / "frames" / name.data(), recording() / "frames" / name.data());
    }
  }

  [[nodiscard]] fs::path recording() const { return folder_.path() / "recording"; }
  [[nodiscard]] fs::path file(const char* name) const { return folder_.path() / name; }
  static void write(const fs::path& path, const std::string& text) {
    std::ofstream(path, std::ios::binary) << text;
  }

  // Replays with every output and the options `more`; expects a failure whose message contains
  // `parts`, and no output file.
  void expect_replay_fails(const std::vector<std::string>& more,
                           const std::vector<std::string>& parts) {
    std::vector<std::string> arguments = {"replay",        recording(),        "--output",
                                          file("out.mkv"), "--poses",          file("out.tum"),
                                          "--report",      file("report.json")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    expect_failure(penumbra(arguments), parts);
    for (const auto& entry : fs::directory_iterator(folder_.path())) {
      const std::string name = entry.path().filename().string();
      EXPECT_FALSE(name.starts_with("out") || name.starts_with("report"))
          << "output file left: " << name;
    }
  }

  TemporaryFolder folder_;
};

TEST_F(ReplayInput, AcceptsUndamagedRecording) {
  const ProgramResult result =
      penumbra({"replay", recording(), "--report", file("report.json"), "--output", file("out")});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(read_json(file("report.json"))["frames"], kFrames);
  EXPECT_EQ(contents_of(file("out")).size(), static_cast<std::size_t>(kFrames));
}

TEST_F(ReplayInput, RejectsTagIdOutsideFamily) {
  std::string tags = bytes_of(recording() / "tags.yaml");
  const std::size_t at = tags.find("id: ");
  ASSERT_NE(at, std::string::npos);
  tags.replace(at, tags.find_first_of(",\n}", at) - at, "id: 99999");
  write(recording() / "tags.yaml", tags);
  expect_replay_fails({}, {"tags.yaml", "99999", "0 to 586"});
}

TEST_F(ReplayInput, RejectsDuplicateYamlKey) {
  write(recording() / "camera.yaml",
        bytes_of(recording() / "camera.yaml") + "\nimage_width: 640\n");
  expect_replay_fails({}, {"camera.yaml", "image_width", "twice"});
}

TEST_F(ReplayInput, RejectsImplausiblyFarPosition) {
  write(file("far.tum"), "0.0 1e30 0 0 0 0 0 1\n");
  expect_replay_fails({"--poses-from", file("far.tum")}, {"far.tum", "tx", "1e30"});
}

TEST_F(ReplayInput, RejectsFolderInPlaceOfFrameFile) {
  fs::remove(recording() / "frames" / "000005.jpg");
  fs::create_directory(recording() / "frames" / "000005.jpg");
  expect_replay_fails({}, {"000005.jpg", "is not a file"});
}

TEST_F(ReplayInput, ReportsPermissionDeniedInsteadOfMissing) {
  // Root can read every file, so the program runs as an unprivileged user, in a folder that this
  // user can't enter.
  const fs::path copy = file("penumbra");
  fs::copy_file(program(), copy);
  const bool root = geteuid() == 0;
  const auto as_nobody = [&](const std::vector<std::string>& arguments) {
    if (!root) return penumbra(arguments);
    std::vector<std::string> words = {"--reuid", "65534",          "--regid",
                                      "65534",   "--clear-groups", copy.string()};
    words.insert(words.end(), arguments.begin(), arguments.end());
    return run_program("/usr/bin/setpriv", words);
  };
  fs::permissions(folder_.path(), fs::perms::all);
  for (const auto& entry : fs::recursive_directory_iterator(folder_.path())) {
    fs::permissions(entry.path(), fs::perms::all);
  }
  write(file("scene.json"), "{}");
  ASSERT_EQ(as_nobody({"--version"}).exit_code, 0);
  const auto expect_denied = [&](const char* name) {
    expect_failure(as_nobody({"replay", recording(), "--scene", file("scene.json"), "--report",
                              file("report.json")}),
                   {name, "Permission denied"});
  };
  fs::permissions(recording() / "frames" / "000005.jpg", fs::perms::none);
  expect_denied("000005.jpg");
  fs::permissions(recording() / "frames", fs::perms::none);
  expect_denied("frames");
  fs::permissions(recording() / "frames", fs::perms::all);
  fs::permissions(recording(), fs::perms::none);
  expect_denied("recording");
  fs::permissions(recording(), fs::perms::all);
}

TEST_F(ReplayInput, RejectsTruncatedJpeg) {
  const fs::path image = recording() / "frames" / "000003.jpg";
  fs::resize_file(image, fs::file_size(image) / 2);
  expect_replay_fails({}, {"000003.jpg", "damaged"});
  expect_replay_fails({"--threads", "1"}, {"000003.jpg", "damaged"});
}

TEST_F(ReplayInput, RejectsMissingCameraFile) {
  fs::remove(recording() / "camera.yaml");
  expect_replay_fails({}, {"camera.yaml", "no such file"});
}

TEST_F(ReplayInput, RejectsDuplicateTagId) {
  std::string tags = bytes_of(recording() / "tags.yaml");
  // The second tag gets the id of the first.
  const std::size_t first = tags.find("id:");
  const std::size_t second = tags.find("id:", first + 1);
  ASSERT_NE(second, std::string::npos);
  const auto number_end = [&](std::size_t at) { return tags.find_first_of(",\n}", at); };
  const std::string id = tags.substr(first, number_end(first) - first);
  tags.replace(second, number_end(second) - second, id);
  write(recording() / "tags.yaml", tags);
  expect_replay_fails({}, {"tags.yaml", "twice"});
}

TEST_F(ReplayInput, RejectsSceneThatViolatesSchema) {
  write(file("scene.json"), R"({"nonsense": true})");
  expect_replay_fails({"--scene", file("scene.json")}, {"scene.json", "nonsense"});
  write(file("scene.json"), R"({"objects": 7})");
  expect_replay_fails({"--scene", file("scene.json")}, {"scene.json", "/objects"});
  write(file("scene.json"), "{ this is no JSON");
  expect_replay_fails({"--scene", file("scene.json")}, {"scene.json"});
  expect_replay_fails({"--scene", file("none.json")}, {"none.json", "no such file"});
}

TEST_F(ReplayInput, RejectsInvalidModelFiles) {
  write(file("scene.json"), R"({"objects": [{"name": "thing", "model": "thing.glb"}]})");
  expect_replay_fails({"--scene", file("scene.json")}, {"thing.glb", "no such file"});
  std::mt19937 random(5);
  std::string bytes;
  for (int i = 0; i < 4096; ++i) bytes += static_cast<char>(random());
  write(file("thing.glb"), bytes);
  expect_replay_fails({"--scene", file("scene.json")}, {"thing.glb"});
  write(file("thing.obj"), bytes);
  write(file("scene.json"), R"({"objects": [{"name": "thing", "model": "thing.obj"}]})");
  expect_replay_fails({"--scene", file("scene.json")}, {"thing.obj"});
  // A lenient OBJ reader might read nan as 0.
  write(file("thing.obj"), "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n");
  expect_replay_fails({"--scene", file("scene.json")}, {"thing.obj", "nan"});
  write(file("thing.obj"), "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n");
  EXPECT_EQ(penumbra({"replay", recording(), "--scene", file("scene.json")}).exit_code, 0);
}

TEST_F(ReplayInput, RejectsRecordingWithoutFrames) {
  write(recording() / "timestamps.csv", "frame,timestamp_s,file\n");
  expect_replay_fails({}, {"timestamps.csv", "0 frames"});
}

TEST_F(ReplayInput, RejectsMissingListedFrame) {
  fs::remove(recording() / "frames" / "000002.jpg");
  expect_replay_fails({}, {"000002.jpg"});
}

TEST_F(ReplayInput, ReplaysTruncatedRecordingUpToItsEnd) {
  fs::remove(recording() / "frames" / "000004.jpg");
  fs::remove(recording() / "frames" / "000005.jpg");
  const ProgramResult result = penumbra({"replay", recording(), "--report", file("report.json")});
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(read_json(file("report.json"))["frames"], 4);
  EXPECT_THAT(result.err, testing::HasSubstr("warning"));
}

TEST_F(ReplayInput, RejectsInvalidPoseFiles) {
  write(file("poses.tum"), "0.0 0 0 1 0 0 0 1\n1.0 0 nan 1 0 0 0 1\n");
  expect_replay_fails({"--poses-from", file("poses.tum")}, {"poses.tum", "line 2", "nan"});
  write(file("poses.tum"), "5000.0 0 0 1 0 0 0 1\n");
  expect_replay_fails({"--poses-from", file("poses.tum")}, {"poses.tum"});
  fs::remove(recording() / "groundtruth.tum");
  expect_replay_fails({"--poses-from", "groundtruth"}, {"groundtruth.tum"});
}

TEST_F(ReplayInput, RejectsMissingRecording) {
  expect_failure(penumbra({"replay", file("nowhere")}), {"nowhere"});
}

TEST_F(ReplayInput, NamesVideoLibraryThatCannotBeLoaded) {
  constexpr const char* kLibrary = "libavformat.so." AV_STRINGIFY(LIBAVFORMAT_VERSION_MAJOR);
  write(file(kLibrary), "no library");
  const std::vector<std::string> environment = {"LD_LIBRARY_PATH=" + folder_.path().string()};
  const fs::path video = file("out.mkv");
  expect_failure(penumbra({"replay", recording(), "--output", video}, environment),
                 {kLibrary, "libav (FFmpeg)"});
  EXPECT_FALSE(fs::exists(video));
  const fs::path uncompressed = file("uncompressed");
  fs::create_directory(uncompressed);
  const ProgramResult images =
      penumbra({"replay", recording(), "--output", uncompressed / "frames"}, environment);
  ASSERT_EQ(images.exit_code, 0) << images.err;
  // A camera without compression is recorded as a video.
  std::string listing = "frame,timestamp_s,file\n";
  for (int i = 0; i < kFrames; ++i)
    listing += fmt::format("{},{},frames/{:06}.png\n", i, 0.1 * i, i);
  write(uncompressed / "timestamps.csv", listing);
  fs::copy_file(recording() / "tags.yaml", uncompressed / "tags.yaml");
  const fs::path session = file("session");
  expect_failure(
      penumbra({"live", "--camera", "recording:" + uncompressed.string(), "--calibration",
                recording() / "camera.yaml", "--no-window", "--duration", "5", "--record", session},
               environment),
      {kLibrary, "libav (FFmpeg)"});
  EXPECT_FALSE(fs::exists(session));
}

TEST_F(ReplayInput, RejectsUnwritableOutputs) {
  const std::string missing = file("no") / "out.mkv";
  expect_failure(penumbra({"replay", recording(), "--output", missing}), {missing});
  expect_failure(penumbra({"replay", recording(), "--poses", file("no") / "out.tum"}), {"out.tum"});
  expect_failure(penumbra({"replay", recording(), "--output", recording()}), {"recording"});
  const fs::path truth = recording() / "groundtruth.tum";
  const std::string before = bytes_of(truth);
  expect_failure(penumbra({"replay", recording(), "--poses", truth}), {"groundtruth.tum"});
  EXPECT_EQ(bytes_of(truth), before);
  const auto same =
      penumbra({"replay", recording(), "--poses", file("one"), "--report", file("one")});
  EXPECT_EQ(same.exit_code, 2);
  EXPECT_NE(same.err.find("--report: " + file("one").string()), std::string::npos) << same.err;
}

TEST_F(ReplayInput, RejectsOutputsInsideRecording) {
  const auto before = contents_of(recording() / "frames");
  const std::size_t entries = contents_of(recording()).size();
  for (const fs::path& output :
       {recording() / "frames", recording() / "new", recording() / "out.mkv", folder_.path(),
        recording() / "frames" / ".." / "new"}) {
    expect_failure(penumbra({"replay", recording(), "--output", output}), {"recording"});
  }
  fs::create_directory_symlink(recording(), file("link"));
  expect_failure(penumbra({"replay", recording(), "--output", file("link") / "new"}),
                 {"recording"});
  expect_failure(penumbra({"replay", recording(), "--poses", recording() / "poses.tum"}),
                 {"recording"});
  expect_failure(penumbra({"replay", recording(), "--output", file("out"), "--poses",
                           file("out") / "poses.tum"}),
                 {"out", "images and nothing else"});
  EXPECT_EQ(contents_of(recording() / "frames"), before);
  EXPECT_EQ(contents_of(recording()).size(), entries);
  EXPECT_FALSE(fs::exists(file("out")));
}

// The file names of EuRoC's frames are timestamps, which are all digits. The program must not take
// them for an earlier output.
TEST_F(ReplayInput, RejectsEurocFrameFolderAsOutput) {
  const fs::path euroc = file("euroc");
  const fs::path data = euroc / "mav0" / "cam0" / "data";
  ASSERT_EQ(penumbra({"replay", recording(), "--output", file("pictures")}).exit_code, 0);
  fs::create_directories(data);
  for (const char* name : {"camera.yaml", "tags.yaml"}) {
    fs::copy_file(recording() / name, euroc / name);
  }
  std::string csv = "#timestamp [ns],filename\n";
  for (int i = 0; i < kFrames; ++i) {
    const std::string number = std::to_string(100000 + i);
    csv += number + "," + number + ".png\n";
    fs::copy_file(file("pictures") / ("00000" + std::to_string(i) + ".png"),
                  data / (number + ".png"));
  }
  write(data.parent_path() / "data.csv", csv);
  ASSERT_EQ(penumbra({"replay", euroc, "--frames", "1:2"}).exit_code, 0);
  const auto before = contents_of(data);
  ASSERT_EQ(before.size(), static_cast<std::size_t>(kFrames));
  expect_failure(penumbra({"replay", euroc, "--frames", "1:2", "--output", data}), {"recording"});
  // The folder of another recording is rejected too.
  expect_failure(penumbra({"replay", recording(), "--output", data}), {"recording"});
  EXPECT_EQ(contents_of(data), before);
  EXPECT_EQ(contents_of(data.parent_path()).size(), 2U);
}

}  // namespace
}  // namespace penumbra::test
