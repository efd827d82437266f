// Sessions that lose their terminal, log, display or reader. Outputs written until then must be
// complete.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <csignal>
#include <memory>
#include <optional>
#include <random>
#include <thread>

#include "app/recording/recording_source.hpp"
#include "core/geometry/trajectory.hpp"
#include "replay/replay_support.hpp"
#include "support/running_program.hpp"
#include "support/test_form.hpp"
#include "unit/app/decoded_video.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using std::chrono::milliseconds;

// A live session that records and writes every output.
class LiveSession {
 public:
  [[nodiscard]] std::vector<std::string> words(const std::vector<std::string>& more) const {
    std::vector<std::string> all = {program().string(), "live",
                                    "--camera",         "recording:" + bundled("tabletop"),
                                    "--calibration",    bundled("tabletop") + "/camera.yaml",
                                    "--record",         path("session"),
                                    "--output",         path("out.mp4"),
                                    "--poses",          path("out.tum"),
                                    "--report",         path("report.json"),
                                    "--log-level",      "debug"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  [[nodiscard]] std::string path(const char* name) const {
    return (folder_.path() / name).string();
  }
  // Waits until `count` frames are drawn and recorded. Returns false if the program ends earlier.
  [[nodiscard]] bool wait_for_frames(const RunningProgram& running, std::size_t count) const {
    constexpr int kMaxWaits = 6000;
    for (int i = 0; i < kMaxWaits && running.runs(); ++i) {
      if (lines_of(bytes_of(path("session/poses.tum"))).size() > count) return true;
      std::this_thread::sleep_for(milliseconds(10));
    }
    return false;
  }
  // Expects that each output can be opened, is complete and matches the report.
  void expect_whole_outputs() const {
    const auto report = read_json(path("report.json"));
    ASSERT_TRUE(report.is_object());
    const auto frames = report["frames"].get<std::size_t>();
    EXPECT_GT(frames, 0U);
    const DecodedVideo video = decode_video(path("out.mp4"));
    EXPECT_TRUE(video.opened);
    EXPECT_EQ(video.images.size(), frames);
    EXPECT_TRUE(bytes_of(path("out.tum")).ends_with('\n'));
    const auto poses = load_trajectory(path("out.tum"));
    ASSERT_TRUE(poses) << poses.error().message;
    EXPECT_EQ(poses->poses.size(), report["frames_tracked"].get<std::size_t>());
    const auto recording = open_recording(path("session"));
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_EQ(recording->frames.size(), report["recorded"]["written"].get<std::size_t>());
    EXPECT_NE(lines_of(bytes_of(path("session/events.jsonl"))).back().find("\"end\""),
              std::string::npos);
    auto source = open_recording_source(*recording);
    ASSERT_TRUE(source) << source.error().message;
    std::size_t read = 0;
    while (true) {
      const auto frame = (*source)->next();
      ASSERT_TRUE(frame) << frame.error().message;
      if (!*frame) break;
      ++read;
    }
    EXPECT_EQ(read, recording->frames.size());
    EXPECT_EQ(contents_of(folder_.path()).size(), 4U) << "a partial file was left";
  }

 private:
  TemporaryFolder folder_;
};

enum class Loss { log_reader, stalled_log_reader, output_reader, terminal, display, log_disk };

std::string name_of(const testing::TestParamInfo<Loss>& info) {
  switch (info.param) {
    case Loss::log_reader:
      return "LogReader";
    case Loss::stalled_log_reader:
      return "StalledLogReader";
    case Loss::output_reader:
      return "OutputReader";
    case Loss::terminal:
      return "Terminal";
    case Loss::display:
      return "Display";
    case Loss::log_disk:
      break;
  }
  return "LogDisk";
}

// Returns a non-blocking descriptor for the same pipe.
int open_nonblocking_writer(int pipe_end) {
  return open(fmt::format("/proc/self/fd/{}", pipe_end).c_str(),
              O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
}

// Fills the buffer of a pipe or terminal whose reader has stalled. A terminal forwards
// text and has room again, so the function writes until the buffer stays full.
void fill_pipe(int writer) {
  const std::string line = std::string(127, '-') + '\n';
  for (bool has_room = true; has_room;) {
    has_room = false;
    while (write(writer, line.data(), line.size()) > 0) has_room = true;
    std::this_thread::sleep_for(milliseconds(10));
  }
}

// Terminal, log, display or reader that a session depends on. lose() removes it.
class SessionDependencies {
 public:
  explicit SessionDependencies(Loss loss) : loss_(loss) {
    switch (loss) {
      case Loss::log_reader:
      case Loss::stalled_log_reader:
      case Loss::output_reader: {
        int ends[2] = {-1, -1};
        if (pipe2(ends, O_CLOEXEC) != 0) std::abort();
        test_end_ = ends[0];
        program_end_ = ends[1];
        if (loss == Loss::stalled_log_reader) filler_ = open_nonblocking_writer(program_end_);
        break;
      }
      case Loss::terminal:
        if (openpty(&test_end_, &program_end_, nullptr, nullptr, nullptr) != 0) std::abort();
        fcntl(test_end_, F_SETFD, FD_CLOEXEC);
        break;
      case Loss::display:
        display_.emplace();
        break;
      case Loss::log_disk:
        program_end_ = memfd_create("log", MFD_CLOEXEC | MFD_ALLOW_SEALING);
        break;
    }
  }
  SessionDependencies(const SessionDependencies&) = delete;
  SessionDependencies& operator=(const SessionDependencies&) = delete;
  ~SessionDependencies() {
    if (test_end_ >= 0) close(test_end_);
    if (program_end_ >= 0) close(program_end_);
    if (filler_ >= 0) close(filler_);
  }

  // Connects the program to the dependency. Must be called in the process that becomes the program.
  void set_up() const {
    if (loss_ == Loss::terminal) {
      setsid();
      ioctl(program_end_, TIOCSCTTY, 0);
      dup2(program_end_, STDIN_FILENO);
    }
    if (loss_ == Loss::terminal || loss_ == Loss::output_reader) dup2(program_end_, STDOUT_FILENO);
    if (program_end_ >= 0) dup2(program_end_, STDERR_FILENO);
    if (display_) setenv("DISPLAY", display_->name().c_str(), 1);
  }
  // Closes the test's copy of the program's descriptor. Must be called after the program started.
  void started() {
    if (loss_ == Loss::log_disk) return;
    if (program_end_ >= 0) close(std::exchange(program_end_, -1));
  }
  void lose(int number) {
    if (loss_ == Loss::stalled_log_reader) return fill_pipe(filler_);
    if (display_) display_->end(number);
    if (test_end_ >= 0) close(std::exchange(test_end_, -1));
    if (loss_ == Loss::log_disk) fcntl(program_end_, F_ADD_SEALS, F_SEAL_GROW);
  }

 private:
  Loss loss_;
  int test_end_ = -1;     // the test's end of the pipe or terminal
  int program_end_ = -1;  // the program's end
  int filler_ = -1;       // writes to the log's pipe
  std::optional<VirtualDisplay> display_;
};

class SessionLoss : public testing::TestWithParam<Loss> {};

TEST_P(SessionLoss, LeavesCompleteOutputsWheneverDependencyIsLost) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const Loss loss = GetParam();
  const bool ends_session = loss == Loss::terminal || loss == Loss::display;
  // Without a reader or terminal the final table is lost, and without a display the window: the
  // exit code is 1. A lost log does not change the exit code.
  const bool loses_log =
      loss == Loss::log_reader || loss == Loss::stalled_log_reader || loss == Loss::log_disk;
  const int expected_code = loses_log ? 0 : 1;
  // The display server ends by one of two signals.
  const int times = nightly() ? 50 : loss == Loss::display ? 2 : 1;
  const unsigned latest_frame = nightly() ? 40 : 12;
  for (int i = 0; i < times; ++i) {
    SCOPED_TRACE(fmt::format("moment {}", i));
    std::mt19937 random(static_cast<unsigned>(100 * static_cast<int>(loss) + i));
    const std::size_t frames = 3 + random() % latest_frame;
    const milliseconds delay(random() % 50);
    const LiveSession session;
    SessionDependencies dependencies(loss);
    RunningProgram running(
        session.words(loss == Loss::display ? std::vector<std::string>{"--duration", "60"}
                                            : std::vector<std::string>{"--no-window"}),
        [&] { dependencies.set_up(); });
    dependencies.started();
    ASSERT_TRUE(session.wait_for_frames(running, frames));
    std::this_thread::sleep_for(delay);
    dependencies.lose(i % 2 == 0 ? SIGKILL : SIGTERM);
    if (!ends_session) {
      std::this_thread::sleep_for(milliseconds(random() % 300));
      running.signal(SIGTERM);
    }
    EXPECT_EQ(running.exit_code(), expected_code);
    session.expect_whole_outputs();
    const auto report = read_json(session.path("report.json"));
    EXPECT_EQ(report.contains("failure"), loss == Loss::display);
    EXPECT_EQ(report["interrupted"].get<bool>(), loss != Loss::display);
    // At the debug level, the encoder writes log lines when it ends.
    EXPECT_TRUE(!loses_log || report.contains("log_lines_dropped"));
  }
}

INSTANTIATE_TEST_SUITE_P(Losses, SessionLoss,
                         testing::Values(Loss::log_reader, Loss::stalled_log_reader,
                                         Loss::output_reader, Loss::terminal, Loss::display,
                                         Loss::log_disk),
                         name_of);

// Returns the exit code of the program, run in a shell with this redirection.
int exit_code_with(const std::string& redirection, const std::vector<std::string>& arguments) {
  std::vector<std::string> words = {"/bin/bash", "-c", "exec \"$0\" \"$@\" " + redirection,
                                    program().string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  return RunningProgram(words).exit_code();
}

TEST(StandardStreams, KeepExitCodesWhenStderrIsFullOrClosed) {
  for (const char* redirection : {"2>/dev/full", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"}) {
    SCOPED_TRACE(redirection);
    EXPECT_EQ(exit_code_with(redirection, {"replay", "nothing"}), 1);
    EXPECT_EQ(exit_code_with(redirection, {"replay", "--no-such-option"}), 2);
  }
}

TEST(StandardStreams, MakePrintingCommandsFailWhenStdoutIsFullOrClosed) {
  for (const char* redirection : {">&-", ">/dev/full", ">&- 2>&-", ">/dev/full 2>/dev/full"}) {
    SCOPED_TRACE(redirection);
    EXPECT_EQ(exit_code_with(redirection, {"devices"}), 1);
    EXPECT_EQ(exit_code_with(redirection, {"--help"}), 1);
    const std::string truth = bundled("tabletop") + "/groundtruth.tum";
    EXPECT_EQ(exit_code_with(redirection, {"evaluate", "--estimated", truth, "--groundtruth", truth,
                                           "--camera", bundled("tabletop") + "/camera.yaml"}),
              1);
  }
  const ProgramResult closed =
      run_program("/bin/bash", {"-c", "exec \"$0\" devices >&-", program()});
  expect_failure(closed, {"standard output", "closed"});
}

// A lost log must not change the exit code. An output file must not get the descriptor number of a
// closed standard stream.
TEST(StandardStreams, KeepOutputsOfLiveCompleteWhenClosedOrFull) {
  for (const auto& [redirection, expected_code] : std::vector<std::pair<std::string, int>>{
           {"2>&-", 0}, {"2>/dev/full", 0}, {"<&- >&- 2>&-", 1}, {">/dev/full 2>/dev/full", 1}}) {
    SCOPED_TRACE(redirection);
    const LiveSession session;
    std::vector<std::string> words = session.words({"--no-window", "--duration", "0.25"});
    words.erase(words.begin());
    EXPECT_EQ(exit_code_with(redirection, words), expected_code);
    session.expect_whole_outputs();
  }
}

// Appends to `text` until it contains `word`, or to the end if `word` is empty.
void read_until(int descriptor, std::string& text, const std::string& word) {
  std::array<char, 4096> buffer{};
  while (word.empty() || text.find(word) == std::string::npos) {
    const ssize_t count = read(descriptor, buffer.data(), buffer.size());
    if (count <= 0) return;
    text.append(buffer.data(), static_cast<std::size_t>(count));
  }
}

TEST(StandardStreams, ReportDroppedLinesWhenLogReaderResumes) {
  for (const bool is_terminal : {false, true}) {
    SCOPED_TRACE(is_terminal ? "terminal" : "pipe");
    const TemporaryFolder folder;
    const std::string report_file = (folder.path() / "report.json").string();
    int ends[2] = {-1, -1};
    if (is_terminal) {
      ASSERT_EQ(openpty(&ends[0], &ends[1], nullptr, nullptr, nullptr), 0);
      fcntl(ends[0], F_SETFD, FD_CLOEXEC);
    } else {
      ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
    }
    RunningProgram running(
        {program().string(), "replay", bundled("tabletop"), "--no-window", "--realtime", "--frames",
         "0:45", "--log-level", "debug", "--report", report_file},
        [&] { dup2(ends[1], STDERR_FILENO); });
    std::string log;
    read_until(ends[0], log, "frame 4:");
    const int filler = open_nonblocking_writer(ends[1]);
    ASSERT_GE(filler, 0);
    fill_pipe(filler);
    close(filler);
    close(ends[1]);
    std::this_thread::sleep_for(milliseconds(900));
    read_until(ends[0], log, "");
    close(ends[0]);
    EXPECT_EQ(running.exit_code(), 0);
    const auto report = read_json(report_file);
    EXPECT_EQ(report["frames"], 45);
    ASSERT_TRUE(report.contains("log_lines_dropped"));
    const auto dropped = report["log_lines_dropped"].get<int>();
    EXPECT_GE(dropped, 1);  // how many depends on the speed of the machine
    const std::string notice = fmt::format("{} lines of the log were dropped", dropped);
    const std::size_t first = log.find(notice);
    EXPECT_NE(first, std::string::npos) << log.substr(log.size() - 2000);
    EXPECT_EQ(log.find("of the log were dropped", first + notice.size()), std::string::npos);
    EXPECT_NE(log.find("frame 44:"), std::string::npos);
  }
}

// Messages wait for the terminal, but outputs do not.
TEST(StandardStreams, DoNotBlockOutputsOfLiveWhenTerminalStalls) {
  const LiveSession session;
  int ends[2] = {-1, -1};
  ASSERT_EQ(openpty(&ends[0], &ends[1], nullptr, nullptr, nullptr), 0);
  fcntl(ends[0], F_SETFD, FD_CLOEXEC);
  const int filler = open_nonblocking_writer(ends[1]);
  RunningProgram running(session.words({"--no-window"}), [&] {
    for (const int stream : {STDOUT_FILENO, STDERR_FILENO}) dup2(ends[1], stream);
  });
  close(ends[1]);
  ASSERT_TRUE(session.wait_for_frames(running, 10));
  fill_pipe(filler);
  close(filler);
  running.signal(SIGTERM);
  for (int i = 0; i < 6000 && !fs::exists(session.path("report.json")); ++i) {
    std::this_thread::sleep_for(milliseconds(10));
  }
  session.expect_whole_outputs();
  EXPECT_TRUE(running.runs());
  std::string text;
  read_until(ends[0], text, "");
  close(ends[0]);
  EXPECT_NE(text.find("recorded "), std::string::npos);
  EXPECT_EQ(running.exit_code(), 0);
}

TEST(HangupSignal, IsIgnoredWhenIgnoredAtStart) {
  const TemporaryFolder folder;
  const std::string report_file = (folder.path() / "report.json").string();
  const std::string poses = (folder.path() / "out.tum").string();
  RunningProgram running(
      {program().string(), "replay", bundled("tabletop"), "--no-window", "--realtime", "--frames",
       "0:20", "--poses", poses, "--report", report_file},
      [] { std::signal(SIGHUP, SIG_IGN); });  // like nohup
  for (int i = 0; i < 7; ++i) {
    std::this_thread::sleep_for(milliseconds(100));
    running.signal(SIGHUP);
  }
  EXPECT_EQ(running.exit_code(), 0);
  const auto report = read_json(report_file);
  EXPECT_EQ(report["frames"], 20);
  EXPECT_EQ(report["interrupted"], false);
}

// A closing terminal sends SIGHUP more than once, and timeout(1) sends SIGTERM twice.
TEST(Interrupt, ClosesOutputsDespiteRepeatedSignals) {
  for (const int number : {SIGHUP, SIGTERM, SIGINT}) {
    SCOPED_TRACE(number);
    const LiveSession session;
    RunningProgram running(session.words({"--no-window"}));
    ASSERT_TRUE(session.wait_for_frames(running, 5));
    for (int i = 0; i < 100 && running.runs(); ++i) {
      running.signal(number);
      std::this_thread::sleep_for(milliseconds(5));
      if (fs::exists(session.path("report.json"))) break;
    }
    EXPECT_EQ(running.exit_code(), 0);
    session.expect_whole_outputs();
  }
}

TEST(DisplayLoss, EndsReplayWithCompleteOutputs) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const auto path = [&folder](const char* name) { return (folder.path() / name).string(); };
  for (const char* gl_version : {"", "3.1"}) {  // default: GLX; 3.1: OpenGL ES through EGL
    SCOPED_TRACE(gl_version);
    VirtualDisplay display;
    RunningProgram running({program().string(), "replay", bundled("tabletop"), "--output",
                            path("out.mp4"), "--report", path("report.json")},
                           [&] {
                             setenv("DISPLAY", display.name().c_str(), 1);
                             if (*gl_version != 0)
                               setenv("MESA_GL_VERSION_OVERRIDE", gl_version, 1);
                           });
    const fs::path partial = path("out.mp4") + fmt::format(".partial-{}-0", running.process());
    for (int i = 0; i < 6000 && running.runs() && !fs::exists(partial); ++i)
      std::this_thread::sleep_for(milliseconds(10));
    std::this_thread::sleep_for(milliseconds(200));
    display.end(SIGKILL);
    EXPECT_EQ(running.exit_code(), 1);
    const auto report = read_json(path("report.json"));
    EXPECT_LT(report["frames"].get<int>(), 120);
    EXPECT_NE(report["failure"].get<std::string>().find("--no-window"), std::string::npos);
    EXPECT_EQ(decode_video(path("out.mp4")).images.size(), report["frames"].get<std::size_t>());
    fs::remove(path("report.json"));
  }
}

TEST(DisplayLoss, EndsLiveWithCompleteOutputsWhenWindowIsDestroyed) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null 2>&1"), 0) << "scripts/setup installs it";
  const VirtualDisplay display;
  const LiveSession session;
  RunningProgram running(session.words({"--duration", "60"}),
                         [&] { setenv("DISPLAY", display.name().c_str(), 1); });
  ASSERT_TRUE(session.wait_for_frames(running, 5));
  const std::string destroy =
      fmt::format("export DISPLAY={}; xdotool windowclose $(xdotool search --onlyvisible --pid {})",
                  display.name(), running.process());
  EXPECT_EQ(std::system(destroy.c_str()), 0);
  EXPECT_EQ(running.exit_code(), 1);
  session.expect_whole_outputs();
}

}  // namespace
}  // namespace penumbra::test
