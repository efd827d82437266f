// The program: parses the command line, runs one command, and is the only place that turns an error
// into text and an exit code.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/logging.hpp"
#include "app/standard_streams.hpp"
#include "core/text/spelling.hpp"
#include "core/text/text.hpp"
#include "core/text/text_encoding.hpp"

namespace {

using penumbra::ChosenCommand;
using penumbra::ExitCode;

// One line, whatever the message holds.
void print_error(std::string_view text) {
  std::string message = penumbra::as_printable_line(text);
  while (!message.empty() && message.back() == ' ') message.pop_back();
  // Not fmt's print, which throws where standard error can't be written.
  std::fputs(("penumbra: error: " + message + "\n").c_str(), stderr);
}

// Prints what is wrong with the command line and where to read more.
ExitCode wrong_usage(const CLI::App& program, const std::string& what) {
  const auto commands = program.get_subcommands();
  print_error(fmt::format("{} (see penumbra {}--help)", what,
                          commands.empty() ? "" : commands.front()->get_name() + " "));
  return ExitCode::usage;
}

// What was typed in place of a command, if that is what is wrong.
std::optional<std::string> unknown_command(const CLI::App& program) {
  if (!program.get_subcommands().empty()) return std::nullopt;
  const std::vector<std::string> words = program.remaining();
  if (words.empty() || words.front().starts_with('-')) return std::nullopt;
  std::string known;
  for (const CLI::App* command : program.get_subcommands([](const CLI::App*) { return true; })) {
    known += (known.empty() ? "" : ", ") + command->get_name();
  }
  return fmt::format("'{}' is no command; known: {}", words.front(), known);
}

// The option that was typed and isn't one, with the one that was meant, if that is what is wrong:
// of the program's own, before the command, or of the command's.
std::optional<std::string> unknown_option(const CLI::App& program) {
  std::vector<const CLI::App*> readers = {&program};
  for (const CLI::App* command : program.get_subcommands()) readers.push_back(command);
  for (const CLI::App* reader : readers) {
    for (const std::string& word : reader->remaining()) {
      if (word == "--") break;  // what follows is no option
      if (!word.starts_with('-')) continue;
      const std::string name = word.substr(0, word.find('='));
      constexpr std::size_t kMostTypos = 2;
      std::size_t least = kMostTypos + 1;
      std::string meant;
      for (const CLI::Option* option : reader->get_options()) {
        if (!option->nonpositional() || option->get_name().empty()) continue;
        const std::size_t typos = penumbra::letters_apart(name, option->get_name());
        if (typos >= least) continue;
        least = typos;
        meant = option->get_name();
      }
      return fmt::format("{}: no such option{}", name,
                         meant.empty() ? "" : fmt::format("; did you mean {}?", meant));
    }
  }
  return std::nullopt;
}

// "help COMMAND", as other programs with commands have it: what else stands there is not read.
void ask_for_help(std::vector<std::string>& words) {
  if (words.empty() || words.front() != "help") return;
  std::vector<std::string> asked = {"--help"};
  if (words.size() > 1 && words[1] != "help" && !words[1].starts_with('-'))
    asked.insert(asked.begin(), words[1]);
  words = std::move(asked);
}

// No option of ours means anything when it is empty or no number at all; CLI11's own checks of
// ranges let "nan" through.
std::optional<std::string> meaningless_option(const CLI::App& program) {
  for (const CLI::App* command : program.get_subcommands()) {
    for (const CLI::Option* option : command->get_options()) {
      const std::vector<std::string>& values = option->results();
      if (std::find(values.begin(), values.end(), "") != values.end()) {
        return fmt::format("{}: is empty; give it a value", option->get_name());
      }
      for (const std::string& value : values) {
        char* end = nullptr;
        if (std::isnan(std::strtod(value.c_str(), &end)) && *end == '\0') {
          return fmt::format("{}: {} is no number", option->get_name(), value);
        }
      }
    }
  }
  return std::nullopt;
}

ExitCode run(int argc, char** argv) {
  CLI::App program("Handheld augmented reality over a table with AprilTags, with layered penumbrae",
                   "penumbra");
  penumbra::add_common_options(program);
  program.require_subcommand(1);
  program.footer(
      "Exit codes: 0 success (also when ended by Ctrl-C while frames run), 1 failure, 2 wrong "
      "usage.\n\n"
      "Example:\n"
      "  penumbra demo");
  ChosenCommand chosen;
  penumbra::add_demo_command(program, chosen);
  penumbra::add_replay_command(program, chosen);
  penumbra::add_live_command(program, chosen);
  penumbra::add_devices_command(program, chosen);
  penumbra::add_evaluate_command(program, chosen);
  penumbra::add_shadow_command(program, chosen);
  penumbra::add_target_command(program, chosen);
  penumbra::add_calibrate_command(program, chosen);
  penumbra::add_map_command(program, chosen);
  penumbra::add_kernels_command(program, chosen);
  penumbra::add_simulate_command(program, chosen);
  penumbra::add_study_command(program, chosen);

  std::vector<std::string> words(argv + 1, argv + argc);
  ask_for_help(words);
  std::ranges::reverse(words);  // as CLI11 takes them

  try {
    program.parse(std::move(words));
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0 && !unknown_command(program)) {  // --help, --version
      std::ostringstream text;
      program.exit(error, text, text);
      fmt::print("{}", text.str());
      return ExitCode::success;
    }
    auto wrong = unknown_command(program);
    // What was typed in its place may be why something is missing.
    const bool left_over = dynamic_cast<const CLI::ExtrasError*>(&error) != nullptr ||
                           dynamic_cast<const CLI::RequiredError*>(&error) != nullptr;
    if (!wrong && left_over) wrong = unknown_option(program);
    return wrong_usage(program, wrong ? *wrong : error.what());
  }
  if (const auto wrong = meaningless_option(program)) return wrong_usage(program, *wrong);
  const auto result = chosen();
  if (result) return *result;
  print_error(result.error().message);
  return ExitCode::failure;
}

}  // namespace

int main(int argc, char** argv) {
  penumbra::secure_standard_streams();
  // Modules catch what their libraries throw; what still gets here must not look like a crash.
  try {
    penumbra::set_up_logging();
    penumbra::set_wait_notice([](const std::string& line) { penumbra::log_warning("{}", line); });
    const ExitCode code = run(argc, argv);
    const auto flushed = penumbra::flush_standard_output();
    if (!flushed && code == ExitCode::success) {
      print_error(flushed.error().message);
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
