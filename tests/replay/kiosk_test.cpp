// A kiosk on a virtual display, and the configuration file.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <thread>

#include "core/text/text.hpp"
#include "replay/replay_support.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

// Returns the longest time between two rows of a frame log of `live` [s], and the number of rows.
struct RowTimes {
  std::size_t rows = 0;
  double longest_gap_s = 0.0;
  double last_s = 0.0;  // on the monotonic clock
};
RowTimes times_of(const fs::path& frame_log) {
  RowTimes times;
  const std::vector<std::string> lines = lines_of(bytes_of(frame_log));
  double last = 0.0;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const auto columns = split(lines[i], ',');
    if (columns.size() < 2) continue;
    const double time = parse_number(columns[1]).value_or(0.0);
    if (times.rows++ > 0) times.longest_gap_s = std::max(times.longest_gap_s, time - last);
    last = time;
  }
  times.last_s = last;
  return times;
}

TEST(Kiosk, BeginsWhenItsCameraIsThere) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const fs::path camera = folder.path() / "camera";
  std::thread plug([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(1500));
    fs::create_directory_symlink(bundled("tabletop"), camera);
  });
  const ProgramResult live =
      in_window({"live", "--kiosk", "--camera", "recording:" + camera.string(), "--calibration",
                 bundled("tabletop") + "/camera.yaml", "--tags", bundled("tabletop") + "/tags.yaml",
                 "--duration", "1", "--frame-log", folder.path() / "log.csv"},
                folder.path());
  plug.join();
  ASSERT_EQ(live.exit_code, 0) << live.err;
  EXPECT_THAT(live.err, HasSubstr("waiting for the camera: " + camera.string()));
  EXPECT_EQ(std::ranges::count(lines_of(live.err), true,
                               [](const std::string& line) {
                                 return line.find("waiting for the camera") != std::string::npos;
                               }),
            1)
      << "one line, however long it waits: " << live.err;
  EXPECT_GT(times_of(folder.path() / "log.csv").rows, 2U);
}

// An hour in the nightly form.
TEST(Kiosk, ShowsImagesUnderRandomTouches) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const fs::path log = folder.path() / "log.csv";
  const std::vector<std::string> words = {(source_dir() / "tests/support/touch-at-random").string(),
                                          nightly() ? "3600" : "5",
                                          "39",
                                          program().string(),
                                          "live",
                                          "--kiosk",
                                          "--reset-after",
                                          "2",
                                          "--camera",
                                          "recording:" + bundled("tabletop"),
                                          "--frame-log",
                                          log.string()};
  const ProgramResult live =
      run_program(source_dir() / "tests/support/with-display", words, {}, folder.path());
  EXPECT_EQ(live.exit_code, 0) << live.err;
  const RowTimes times = times_of(log);
  EXPECT_GT(times.rows, 15U);
  const double max_gap_s = nightly() ? 10.0 : 3.0 * kSlowness;
  EXPECT_LT(times.longest_gap_s, max_gap_s);
  const std::chrono::duration<double> end = std::chrono::steady_clock::now().time_since_epoch();
  EXPECT_LT(end.count() - times.last_s, max_gap_s + 2.0) << "frames must come to the end";
  // Keys that save images, scenes and recordings are locked.
  std::set<std::string> files;
  for (const auto& entry : fs::directory_iterator(folder.path()))
    files.insert(entry.path().filename());
  EXPECT_EQ(files, std::set<std::string>{"log.csv"});
}

TEST(Kiosk, FailsWithoutDisplay) {
  const TemporaryFolder folder;
  expect_failure(penumbra({"live", "--kiosk", "--camera", "recording:" + bundled("tabletop")}),
                 {"no window", "DISPLAY"});
}

class ConfigurationFile : public testing::Test {
 protected:
  [[nodiscard]] ProgramResult live(const std::string& text,
                                   const std::vector<std::string>& more = {}) const {
    const fs::path file = folder_.path() / "c.yaml";
    std::ofstream(file) << text;
    std::vector<std::string> words = {"live", "--config", file.string()};
    words.insert(words.end(), more.begin(), more.end());
    return penumbra(words);
  }
  const TemporaryFolder folder_;
};

TEST_F(ConfigurationFile, RunsSessionWithItsOptions) {
  const ProgramResult result = live("live:\n  camera: recording:" + bundled("tabletop") +
                                    "\n  duration: 0.5\n  no-window: true\n  shadow: none\n");
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_THAT(result.out, HasSubstr("c.yaml (camera, duration, no-window, shadow)"));
}

TEST_F(ConfigurationFile, ReportsWrongValueWithFileAndLine) {
  const ProgramResult result =
      live("live:\n  camera: recording:" + bundled("tabletop") + "\n  fps: often\n");
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, HasSubstr("c.yaml: line 3: --fps: "));
}

TEST_F(ConfigurationFile, IsNotReplacedByOutputs) {
  const std::string text =
      "live:\n  camera: recording:" + bundled("tabletop") + "\n  no-window: true\n  duration: 1\n";
  const ProgramResult result = live(text, {"--report", (folder_.path() / "c.yaml").string()});
  EXPECT_EQ(result.exit_code, 1) << result.out;
  EXPECT_EQ(bytes_of(folder_.path() / "c.yaml"), text);
}

TEST_F(ConfigurationFile, ReportsMissingFile) {
  expect_failure(penumbra({"live", "--config", "/nothing/c.yaml"}), {"/nothing/c.yaml"});
}

TEST_F(ConfigurationFile, KeepsJsonOnStandardOutputClean) {
  const ProgramResult result = live("live:\n  camera: recording:" + bundled("tabletop") +
                                        "\n  duration: 0.5\n  no-window: true\n  shadow: none\n",
                                    {"--report", "-"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out.substr(0, 1), "{");
  EXPECT_THAT(result.err, HasSubstr("configuration: "));
}

}  // namespace
}  // namespace penumbra::test
