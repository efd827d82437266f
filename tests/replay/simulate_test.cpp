// penumbra simulate: the recording opens, has the requested content, and is reproducible.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "core/units.hpp"
#include "replay_support.hpp"
#include "support/recording_folder.hpp"
#include "support/replay_tracking.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

class SimulateCommand : public testing::Test {
 protected:
  void SetUp() override {
    write_text(file("camera.yaml"),
               "image_width: 320\nimage_height: 240\ncamera_name: made up\n"
               "camera_matrix:\n  rows: 3\n  cols: 3\n"
               "  data: [270.0, 0.0, 161.0, 0.0, 269.0, 118.0, 0.0, 0.0, 1.0]\n"
               "distortion_model: plumb_bob\n"
               "distortion_coefficients:\n  rows: 1\n  cols: 5\n"
               "  data: [-0.2, 0.06, 0.0008, -0.0006, -0.004]\n"
               "somebody_elses: key\n");
    std::string tags = "tags:\n";
    for (int i = 0; i < 4; ++i) {
      tags += fmt::format(
          "  - {{id: {}, family: tag36h11, size_m: 0.06, position: [{}, {}, 0], quaternion_xyzw: "
          "[0, 0, 0, 1]}}\n",
          i, i % 2 == 0 ? -0.045 : 0.045, i < 2 ? 0.045 : -0.045);
    }
    write_text(file("tags.yaml"), tags);
    write_path(6, 0.003);
  }
  [[nodiscard]] std::string file(const char* name) const {
    return (folder_.path() / name).string();
  }
  // Writes a camera path 0.4 m above the table that moves by `step_m` to the right per frame.
  void write_path(int frames, double step_m) {
    Trajectory path;
    for (int i = 0; i < frames; ++i) {
      path.poses.push_back({1'000'000'000 + i * std::int64_t{33'333'333},
                            CameraPose(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0),
                                       Eigen::Vector3d(step_m * (i - 3), 0.01, 0.4)),
                            {}});
    }
    ASSERT_TRUE(save_trajectory(file("path.tum"), path));
  }
  [[nodiscard]] ProgramResult run(const char* output, std::vector<std::string> more = {},
                                  const std::string& scene = "board") const {
    std::vector<std::string> arguments = {
        "simulate",        scene,          "--camera",       file("camera.yaml"), "--tags",
        file("tags.yaml"), "--trajectory", file("path.tum"), "--output",          file(output)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return penumbra(arguments);
  }
  [[nodiscard]] std::vector<std::uint8_t> pixels(const char* output, int frame) const {
    const auto loaded =
        load_image(folder_.path() / output / fmt::format("frames/{:06}.png", frame)).value();
    std::vector<std::uint8_t> scratch;
    const ImageView image = luma(loaded, scratch);
    std::vector<std::uint8_t> copy;
    for (int y = 0; y < image.height; ++y)
      copy.insert(copy.end(), image.row(y), image.row(y) + image.width);
    return copy;
  }
  TemporaryFolder folder_;
};

TEST_F(SimulateCommand, WritesRecordingThatTracksToItsTruth) {
  const ProgramResult made = run("made", {"--noise", "2", "--blur", "0.008", "--seed", "3"});
  ASSERT_EQ(made.exit_code, 0) << made.err;
  EXPECT_EQ(made.err, "");
  EXPECT_THAT(made.out, HasSubstr("recording: " + file("made")));
  EXPECT_EQ(bytes_of(folder_.path() / "made" / "camera.yaml"), bytes_of(file("camera.yaml")));
  EXPECT_EQ(bytes_of(folder_.path() / "made" / "tags.yaml"), bytes_of(file("tags.yaml")));
  const ProgramResult replayed = penumbra({"replay", file("made"), "--no-window", "--poses",
                                           file("poses.tum"), "--report", file("report.json")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  const nlohmann::json report = read_json(file("report.json"));
  EXPECT_EQ(report["frames"], 6);
  EXPECT_EQ(report["frames_tracked"], 6);
  EXPECT_LT(report["accuracy"]["overlay_px"]["max"].get<double>(), 0.25);
  const ProgramResult evaluated =
      penumbra({"evaluate", "--estimated", file("poses.tum"), "--groundtruth",
                file("made/groundtruth.tum"), "--camera", file("made/camera.yaml")});
  EXPECT_EQ(evaluated.exit_code, 0) << evaluated.err;
}

// The simulator exposes all rows at once, so the recording must have no rolling shutter.
TEST_F(SimulateCommand, OmitsRollingShutterFromRecording) {
  write_text(file("camera.yaml"),
             bytes_of(file("camera.yaml")) + "rolling_shutter_row_s: 0.00005\n");
  write_path(6, 0.02);
  const ProgramResult made = run("made");
  ASSERT_EQ(made.exit_code, 0) << made.err;
  EXPECT_THAT(made.err, HasSubstr("exposes all rows at once"));
  EXPECT_THAT(bytes_of(file("made/camera.yaml")), testing::Not(HasSubstr("rolling_shutter_row_s")));
  const ProgramResult replayed =
      penumbra({"replay", file("made"), "--no-window", "--report", file("report.json")});
  ASSERT_EQ(replayed.exit_code, 0) << replayed.err;
  EXPECT_LT(read_json(file("report.json"))["accuracy"]["overlay_px"]["max"].get<double>(), 0.5);
}

TEST_F(SimulateCommand, WritesSameBytesForSameSeed) {
  write_path(3, 0.003);
  ASSERT_EQ(run("a", {"--noise", "3", "--blur", "0.01", "--seed", "7"}).exit_code, 0);
  ASSERT_EQ(run("b", {"--noise", "3", "--blur", "0.01", "--seed", "7"}).exit_code, 0);
  ASSERT_EQ(run("c", {"--noise", "3", "--blur", "0.01", "--seed", "8"}).exit_code, 0);
  const auto frames = [&](const char* name) {
    return contents_of(folder_.path() / name / "frames");
  };
  ASSERT_EQ(frames("a").size(), 3U);
  EXPECT_EQ(frames("a"), frames("b"));
  EXPECT_NE(frames("a"), frames("c"));
  EXPECT_EQ(contents_of(folder_.path() / "a"), contents_of(folder_.path() / "b"));
  EXPECT_EQ(bytes_of(file("a/groundtruth.tum")), bytes_of(file("c/groundtruth.tum")));
}

TEST_F(SimulateCommand, AddsIndependentNoiseOfRequestedSigma) {
  write_path(2, 0.0);
  ASSERT_EQ(run("quiet").exit_code, 0);
  ASSERT_EQ(run("loud", {"--noise", "5"}).exit_code, 0);
  EXPECT_EQ(pixels("quiet", 0), pixels("quiet", 1))
      << "without noise, frames of a camera at rest must be equal";
  const auto sigma = [](const std::vector<std::uint8_t>& a, const std::vector<std::uint8_t>& b) {
    double sum = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += std::pow(double{1} * a[i] - b[i], 2);
    return std::sqrt(sum / static_cast<double>(a.size()));
  };
  EXPECT_NEAR(sigma(pixels("quiet", 0), pixels("loud", 0)), 5.0, 0.1);
  EXPECT_NEAR(sigma(pixels("loud", 0), pixels("loud", 1)), 5.0 * std::sqrt(2.0), 0.15);
}

// The blur must be a box along the motion, none across it, and centred on the sharp edge.
TEST_F(SimulateCommand, BlursAlongMotionCentredOnTruth) {
  write_path(4, 0.012);  // 8 px per frame
  ASSERT_EQ(run("sharp").exit_code, 0);
  ASSERT_EQ(run("blurred", {"--blur", "0.0333333"}).exit_code, 0);
  // Profile across the left edge of the left tags' black squares, at the middle of the exposure.
  const auto profile = [&](const char* name) {
    const std::vector<std::uint8_t> image = pixels(name, 3);
    std::vector<double> row(320, 0.0);
    for (std::size_t x = 0; x < 320; ++x) row[x] = image[(118 - 30) * 320 + x];
    return row;
  };
  const std::vector<double> sharp = profile("sharp");
  const std::vector<double> blurred = profile("blurred");
  const auto rise = [](const std::vector<double>& row) {
    std::size_t widest = 0;
    std::size_t length = 0;
    for (const double v : row) {
      length = v > 25.0 && v < 195.0 && std::abs(v - 89.0) > 3.0 ? length + 1 : 0;
      widest = std::max(widest, length);
    }
    return widest;
  };
  EXPECT_LE(rise(sharp), 4U);
  EXPECT_GE(rise(blurred), 7U);
  const double sum_sharp = std::accumulate(sharp.begin(), sharp.end(), 0.0);
  const double sum_blurred = std::accumulate(blurred.begin(), blurred.end(), 0.0);
  EXPECT_NEAR(sum_sharp, sum_blurred, 0.01 * sum_sharp) << "the sum of light is preserved";
  double centre_sharp = 0.0;
  double centre_blurred = 0.0;
  for (std::size_t x = 0; x < 320; ++x) {
    centre_sharp += static_cast<double>(x) * sharp[x] / sum_sharp;
    centre_blurred += static_cast<double>(x) * blurred[x] / sum_blurred;
  }
  EXPECT_NEAR(centre_sharp, centre_blurred, 0.05) << "the truth is the middle of the exposure";
}

TEST_F(SimulateCommand, AppliesCameraResponseGainAndTagCover) {
  write_path(1, 0.003);
  ASSERT_EQ(run("plain").exit_code, 0);
  ASSERT_EQ(run("toned", {"--tone", "2.2"}).exit_code, 0);
  ASSERT_EQ(run("dark", {"--gain", "0.25"}).exit_code, 0);
  ASSERT_EQ(run("covered", {"--cover", "0.5"}).exit_code, 0);
  const auto plain = pixels("plain", 0);
  const auto toned = pixels("toned", 0);
  const auto dark = pixels("dark", 0);
  for (const std::size_t i : {std::size_t{0}, std::size_t{118 * 320 + 140}, plain.size() / 3}) {
    EXPECT_NEAR(toned[i], 255.0 * std::pow(plain[i] / 255.0, 1.0 / 2.2), 1.6);
    EXPECT_NEAR(dark[i], 0.25 * plain[i], 0.7);
  }
  int changed = 0;
  const auto covered = pixels("covered", 0);
  for (std::size_t i = 0; i < plain.size(); ++i) changed += plain[i] != covered[i] ? 1 : 0;
  EXPECT_GT(changed, 2000);
}

// Detection fails for a tag with a hidden edge, but the tracker can align a tag that it already
// tracks.
TEST_F(SimulateCommand, KeepsTagsTrackableWhenCoveredLater) {
  write_path(4, 0.003);
  ASSERT_EQ(run("plain").exit_code, 0);
  ASSERT_EQ(run("covered", {"--cover", "0.4"}).exit_code, 0);
  ASSERT_EQ(run("later", {"--cover", "0.4", "--cover-from", "1"}).exit_code, 0);
  const ProgramResult never = run("never", {"--cover", "0.4", "--cover-from", "1000"});
  EXPECT_EQ(never.exit_code, 1);
  EXPECT_THAT(never.err, HasSubstr("--cover-from: 1000 is beyond the last frame"));
  EXPECT_EQ(pixels("later", 0), pixels("plain", 0));
  EXPECT_EQ(pixels("later", 1), pixels("covered", 1));
  const auto covered = track_recording(folder_.path() / "covered");
  ASSERT_TRUE(covered) << covered.error().message;
  EXPECT_EQ(covered->count_of(TrackStatus::tracked), 0);
  const auto later = track_recording(folder_.path() / "later");
  ASSERT_TRUE(later) << later.error().message;
  EXPECT_EQ(later->count_of(TrackStatus::tracked), static_cast<int>(later->frames.size()));
  EXPECT_EQ(later->wrong, 0);
}

TEST_F(SimulateCommand, DrawsSceneObjectsOverTags) {
  write_path(3, 0.003);
  const std::string scene = (source_dir() / "scenes" / "default.json").string();
  ASSERT_EQ(run("plain").exit_code, 0);
  const ProgramResult made = run("scene", {"--blur", "0.01"}, scene);
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const auto plain = pixels("plain", 2);
  const auto drawn = pixels("scene", 2);
  ASSERT_EQ(plain.size(), drawn.size());
  int changed = 0;
  for (std::size_t i = 0; i < plain.size(); ++i)
    changed += std::abs(int{plain[i]} - int{drawn[i]}) > 20 ? 1 : 0;
  EXPECT_GT(changed, 500);
  EXPECT_LT(changed, 60000);
  const auto tracked = track_recording(folder_.path() / "scene");
  ASSERT_TRUE(tracked) << tracked.error().message;
  EXPECT_EQ(tracked->wrong, 0);
}

TEST_F(SimulateCommand, ReportsErrorsInOneLine) {
  const auto with = [&](const char* option, const std::string& value) {
    std::vector<std::string> arguments = {
        "simulate",        "board",        "--camera",       file("camera.yaml"), "--tags",
        file("tags.yaml"), "--trajectory", file("path.tum"), "--output",          file("never")};
    const auto at = std::find(arguments.begin(), arguments.end(), option);
    if (at == arguments.end()) {
      arguments.insert(arguments.end(), {option, value});
    } else {
      *(at + 1) = value;
    }
    return penumbra(arguments);
  };
  expect_failure(with("--camera", file("none.yaml")), {"none.yaml"});
  expect_failure(with("--tags", file("none.yaml")), {"none.yaml"});
  expect_failure(with("--trajectory", file("none.tum")), {"none.tum"});
  write_text(file("empty.tum"), "# nothing\n");
  expect_failure(with("--trajectory", file("empty.tum")), {"empty.tum", "no pose"});
  write_text(file("twice.tum"), "1 0 0 1 1 0 0 0\n1 0 0 1 1 0 0 0\n");
  expect_failure(with("--trajectory", file("twice.tum")), {"twice.tum", "timestamp"});
  write_text(file("wrong_id.yaml"),
             "tags:\n  - {id: 9999, family: tag36h11, size_m: 0.06, position: [0, 0, 0], "
             "quaternion_xyzw: [0, 0, 0, 1]}\n");
  expect_failure(with("--tags", file("wrong_id.yaml")), {"wrong_id.yaml", "9999"});
  expect_failure(with("--output", file("camera.yaml")), {"camera.yaml"});
  expect_failure(with("--output", folder_.path().string()), {"not empty"});
  expect_failure(run("never", {}, file("none.json")), {"none.json"});
  for (const auto& [option, value] :
       std::vector<std::pair<const char*, std::string>>{{"--noise", "-1"},
                                                        {"--noise", "nan"},
                                                        {"--blur", "-0.1"},
                                                        {"--blur", "inf"},
                                                        {"--seed", "many"},
                                                        {"--seed", "-1"},
                                                        {"--tone", "0"},
                                                        {"--gain", "0"},
                                                        {"--cover", "1.5"},
                                                        {"--lens-blur", "x"}}) {
    EXPECT_EQ(with(option, value).exit_code, 2) << option << " " << value;
  }
  EXPECT_FALSE(std::filesystem::exists(file("never")));
  for (const auto& entry : std::filesystem::directory_iterator(folder_.path()))
    EXPECT_EQ(entry.path().string().find("partial"), std::string::npos) << entry.path();
}

}  // namespace
}  // namespace penumbra::test
