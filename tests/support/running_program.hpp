// A running program whose standard streams and display a test can close.
#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "support/paths.hpp"

namespace penumbra::test {

// A started program. The destructor kills it if it is still running.
class RunningProgram {
 public:
  // `set_up` is called in the new process, before exec. Unless it changes them, standard input,
  // output and error are /dev/null; there is no display.
  explicit RunningProgram(
      const std::vector<std::string>& words, const std::function<void()>& set_up = [] {}) {
    std::vector<std::string> copies = words;
    std::vector<char*> argv;
    for (std::string& word : copies) argv.push_back(word.data());
    argv.push_back(nullptr);
    process_ = fork();
    if (process_ != 0) return;
    const int nothing = open("/dev/null", O_RDWR);
    for (const int descriptor : {0, 1, 2}) dup2(nothing, descriptor);
    close(nothing);
    unsetenv("DISPLAY");
    unsetenv("WAYLAND_DISPLAY");
    // The parent may ignore these signals (nohup, a script's background job).
    for (const int number : {SIGHUP, SIGINT}) ::signal(number, SIG_DFL);
    set_up();
    execv(argv[0], argv.data());
    _exit(127);
  }
  RunningProgram(const RunningProgram&) = delete;
  RunningProgram& operator=(const RunningProgram&) = delete;
  ~RunningProgram() {
    if (process_ <= 0 || ended_) return;
    ::kill(process_, SIGKILL);
    (void)exit_code();
  }

  [[nodiscard]] pid_t process() const { return process_; }
  void signal(int number) const { ::kill(process_, number); }
  [[nodiscard]] bool runs() const {
    siginfo_t info{};
    return waitid(P_PID, static_cast<id_t>(process_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info.si_pid == 0;
  }
  // Waits for the end; returns the exit code, or 128 + signal. After two minutes, kills the
  // program.
  [[nodiscard]] int exit_code() {
    constexpr int kMaxPolls = 12'000;
    for (int i = 0; i < kMaxPolls && runs(); ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    if (runs()) ::kill(process_, SIGKILL);
    int status = 0;
    while (waitpid(process_, &status, 0) < 0 && errno == EINTR) {
    }
    ended_ = true;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

 private:
  pid_t process_ = -1;
  bool ended_ = false;
};

// An X server that a test can terminate.
class VirtualDisplay {
 public:
  VirtualDisplay() {
    int ends[2] = {-1, -1};
    if (pipe2(ends, O_CLOEXEC) != 0) std::abort();
    server_ = fork();
    if (server_ == 0) {
      const int nothing = open("/dev/null", O_RDWR);
      dup2(ends[1], 3);      // no effect if ends[1] is 3
      fcntl(3, F_SETFD, 0);  // clears FD_CLOEXEC, which dup2() keeps in that case
      for (const int descriptor : {0, 1, 2}) dup2(nothing, descriptor);
      execlp("Xvfb", "Xvfb", "-displayfd", "3", "-noreset", "-screen", "0", "1280x1024x24",
             "-nolisten", "tcp", nullptr);
      _exit(127);
    }
    close(ends[1]);
    // Reads one line: the display's number.
    for (char c = 0; read(ends[0], &c, 1) == 1 && c != '\n';) name_ += c;
    close(ends[0]);
  }
  VirtualDisplay(const VirtualDisplay&) = delete;
  VirtualDisplay& operator=(const VirtualDisplay&) = delete;
  ~VirtualDisplay() { end(SIGTERM); }

  // Returns the value of DISPLAY, for example ":7".
  [[nodiscard]] std::string name() const { return ":" + name_; }
  void end(int number) {
    if (server_ <= 0) return;
    kill(server_, number);
    while (waitpid(server_, nullptr, 0) < 0 && errno == EINTR) {
    }
    server_ = -1;
  }

 private:
  pid_t server_ = -1;
  std::string name_;
};

}  // namespace penumbra::test
