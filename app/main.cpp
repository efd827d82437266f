// The program: parses the command line, runs one command, and is the only place that turns an error
// into text and an exit code.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cstdio>
#include <exception>
#include <string>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/logging.hpp"

namespace {

using penumbra::ChosenCommand;
using penumbra::ExitCode;

// One line, whatever the message holds.
void print_error(std::string message) {
  for (char& c : message) {
    if (c == '\n' || c == '\r') c = ' ';
  }
  while (!message.empty() && message.back() == ' ') message.pop_back();
  fmt::print(stderr, "penumbra: error: {}\n", message);
}

ExitCode run(int argc, char** argv) {
  CLI::App program("Handheld augmented reality over a table with AprilTags, with layered penumbrae",
                   "penumbra");
  penumbra::add_common_options(program);
  program.require_subcommand(1);
  program.footer(
      "Exit codes: 0 success, 1 failure, 2 wrong usage, 130 ended early by Ctrl-C.\n\n"
      "Example:\n"
      "  penumbra demo");
  ChosenCommand chosen;
  penumbra::add_demo_command(program, chosen);
  penumbra::add_replay_command(program, chosen);
  penumbra::add_live_command(program, chosen);
  penumbra::add_devices_command(program, chosen);
  penumbra::add_evaluate_command(program, chosen);
  penumbra::add_target_command(program, chosen);

  try {
    program.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) {  // --help, --version
      program.exit(error);
      return ExitCode::success;
    }
    const auto commands = program.get_subcommands();
    print_error(fmt::format("{} (see penumbra {}--help)", error.what(),
                            commands.empty() ? "" : commands.front()->get_name() + " "));
    return ExitCode::usage;
  }
  const auto result = chosen();
  if (result) return *result;
  print_error(result.error().message);
  return ExitCode::failure;
}

}  // namespace

int main(int argc, char** argv) {
  // Modules catch what their libraries throw; what still gets here must not look like a crash.
  try {
    penumbra::set_up_logging();
    const ExitCode code = run(argc, argv);
    if (std::fflush(stdout) != 0 && code == ExitCode::success) {
      print_error("standard output cannot be written");
      return static_cast<int>(ExitCode::failure);
    }
    return static_cast<int>(code);
  } catch (const std::bad_alloc&) {
    print_error("out of memory");
  } catch (const std::exception& error) {
    print_error(error.what());
  }
  return static_cast<int>(ExitCode::failure);
}
