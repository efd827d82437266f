// Runs a program with arguments and returns its exit code and both of its outputs.
#pragma once

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace penumbra::test {

struct ProgramResult {
  int exit_code = -1;  // 128 + signal if a signal killed it
  std::string out;
  std::string err;
};

// How much slower than a release build the program is.
#if defined(__SANITIZE_THREAD__)
inline constexpr int kSlowness = 20;
#elif defined(__SANITIZE_ADDRESS__)
inline constexpr int kSlowness = 5;
#else
inline constexpr int kSlowness = 1;
#endif

// Lengthens short live sessions of a slow program, so that they draw as many frames as those of a
// release build: multiplies --duration and divides --fps.
inline void slow_down(std::vector<std::string>& arguments) {
  constexpr double kLong_s = 10.0;  // longer sessions are ended by an event
  if (kSlowness == 1) return;
  for (std::size_t i = 1; i < arguments.size(); ++i) {
    const double value = std::strtod(arguments[i].c_str(), nullptr);
    if (arguments[i - 1] == "--duration" && value > 0.0 && value < kLong_s)
      arguments[i] = std::to_string(value * kSlowness);
    if (arguments[i - 1] == "--fps" && value > 0.0)
      arguments[i] = std::to_string(value / kSlowness);
  }
}

// Adds `environment` entries ("NAME=value") to this process's environment and removes DISPLAY and
// WAYLAND_DISPLAY, so that no window opens, and the user's configuration. Calls `when_started`
// (optional) with the process id before it reads any output.
inline ProgramResult run_program(const std::filesystem::path& program,
                                 const std::vector<std::string>& arguments,
                                 const std::vector<std::string>& environment = {},
                                 const std::filesystem::path& working_folder = {},
                                 const std::function<void(pid_t)>& when_started = {}) {
  std::vector<std::string> words = {program.string()};
  words.insert(words.end(), arguments.begin(), arguments.end());
  slow_down(words);
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::vector<std::string> variables;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string text = *entry;
    if (text.starts_with("DISPLAY=") || text.starts_with("WAYLAND_DISPLAY=")) continue;
    if (!text.starts_with("XDG_CONFIG_HOME=")) variables.push_back(text);
  }
  variables.emplace_back("XDG_CONFIG_HOME=/dev/null");
  variables.insert(variables.end(), environment.begin(), environment.end());
  std::vector<char*> envp;
  for (std::string& variable : variables) envp.push_back(variable.data());
  envp.push_back(nullptr);

  std::array<std::array<int, 2>, 2> pipes{};
  for (auto& ends : pipes) {
    if (pipe2(ends.data(), O_CLOEXEC) != 0) std::abort();
  }
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, pipes[0][1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, pipes[1][1], STDERR_FILENO);
  if (!working_folder.empty())
    posix_spawn_file_actions_addchdir_np(&actions, working_folder.c_str());
  pid_t child = 0;
  const int error = posix_spawn(&child, argv[0], &actions, nullptr, argv.data(), envp.data());
  posix_spawn_file_actions_destroy(&actions);
  for (auto& ends : pipes) close(ends[1]);
  ProgramResult result;
  if (error == 0) {
    if (when_started) when_started(child);
    std::array<pollfd, 2> waiting{{{pipes[0][0], POLLIN, 0}, {pipes[1][0], POLLIN, 0}}};
    std::array<std::string*, 2> texts{&result.out, &result.err};
    int open_ends = 2;
    while (open_ends > 0) {
      if (poll(waiting.data(), waiting.size(), -1) < 0 && errno != EINTR) break;
      for (std::size_t i = 0; i < waiting.size(); ++i) {
        if ((waiting[i].revents & (POLLIN | POLLHUP | POLLERR)) == 0) continue;
        std::array<char, 4096> block{};
        const ssize_t count = read(waiting[i].fd, block.data(), block.size());
        if (count > 0) {
          texts[i]->append(block.data(), static_cast<std::size_t>(count));
        } else {
          waiting[i].fd = -1;
          --open_ends;
        }
      }
    }
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  } else {
    result.err = "cannot be started";
  }
  for (auto& ends : pipes) close(ends[0]);
  return result;
}

}  // namespace penumbra::test
