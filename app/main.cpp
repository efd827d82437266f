// The program: parses the command line and runs one command. Only this file turns an error into
// text and an exit code.

#include <algorithm>
#include <cstdio>
#include <exception>
#include <sstream>

#include "app/commands/configuration.hpp"
#include "app/commands/options.hpp"
#include "app/logging.hpp"
#include "app/standard_streams.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

void print_error(std::string_view text) {
  std::string message = as_printable_line(text);
  while (!message.empty() && message.back() == ' ') message.pop_back();
  // fmt::print() throws if standard error can't be written.
  std::fputs(("penumbra: error: " + message + "\n").c_str(), stderr);
}

ExitCode wrong_usage(const CLI::App& program, const std::string& what) {
  const auto commands = program.get_subcommands();
  print_error(fmt::format("{} (see penumbra {}--help)", what,
                          commands.empty() ? "" : commands.front()->get_name() + " "));
  return ExitCode::usage;
}

// Returns the error message if the first word is no known command, else nullopt.
std::optional<std::string> unknown_command(const CLI::App& program) {
  if (!program.get_subcommands().empty()) return std::nullopt;
  const std::vector<std::string> words = program.remaining();
  if (words.empty() || words.front().starts_with('-')) return std::nullopt;
  std::string known;
  for (const CLI::App* command : program.get_subcommands(nullptr)) {
    known += (known.empty() ? "" : ", ") + command->get_name();
  }
  return fmt::format("'{}' is not a command; known: {}", words.front(), known);
}

// Returns the error message for an unknown option of the program or its command, with the most
// similar known option. Returns nullopt if all options are known.
std::optional<std::string> unknown_option(const CLI::App& program) {
  std::vector<const CLI::App*> readers = {&program};
  for (const CLI::App* command : program.get_subcommands()) readers.push_back(command);
  for (const CLI::App* reader : readers) {
    for (const std::string& word : reader->remaining()) {
      if (word == "--") break;  // the words after it are not options
      if (!word.starts_with('-')) continue;
      const std::string name = word.substr(0, word.find('='));
      const std::string meant = similar_option(*reader, name);
      return fmt::format("{}: no such option{}", name,
                         meant.empty() ? "" : fmt::format("; did you mean {}?", meant));
    }
  }
  return std::nullopt;
}

// Turns "help COMMAND" into "COMMAND --help" and ignores further words.
void rewrite_help_command(std::vector<std::string>& words) {
  if (words.empty() || words.front() != "help") return;
  std::vector<std::string> arguments = {"--help"};
  if (words.size() > 1 && words[1] != "help" && !words[1].starts_with('-'))
    arguments.insert(arguments.begin(), words[1]);
  words = std::move(arguments);
}

// Returns the error message if an option has an empty value.
std::optional<std::string> empty_option(const CLI::App& program) {
  for (const CLI::App* command : program.get_subcommands()) {
    for (const CLI::Option* option : command->get_options()) {
      const bool needs_value = option->get_expected_min() > 0;
      if (needs_value && std::ranges::count(option->results(), "") > 0) {
        return fmt::format("{}: is empty; give it a value", option->get_name());
      }
    }
  }
  return std::nullopt;
}

ExitCode run(int argc, char** argv) {
  ChosenCommand chosen;
  const auto owned = make_program(chosen);
  CLI::App& program = *owned;
  std::vector<std::string> words(argv + 1, argv + argc);
  rewrite_help_command(words);
  const auto configuration = load_configuration(program, words);
  if (!configuration) {
    print_error(configuration.error().message);
    return ExitCode::failure;
  }
  if (*configuration) insert_options(program, **configuration, words);
  std::ranges::reverse(words);  // CLI11 expects the last word first

  try {
    program.parse(std::move(words));
  } catch (const CLI::ParseError& error) {
    auto wrong = unknown_command(program);
    if (error.get_exit_code() == 0 && !wrong) {  // --help, --version
      std::ostringstream text;
      program.exit(error, text, text);
      fmt::print("{}", text.str());
      return ExitCode::success;
    }
    // CLI11 reports a misspelt required option as missing.
    const bool may_be_misspelt = dynamic_cast<const CLI::ExtrasError*>(&error) != nullptr ||
                                 dynamic_cast<const CLI::RequiredError*>(&error) != nullptr;
    if (!wrong && may_be_misspelt) wrong = unknown_option(program);
    const ConfiguredOption* configured =
        *configuration ? blamed_option(**configuration, error.what()) : nullptr;
    if (configured != nullptr) {
      print_error(fmt::format("{}: line {}: {}", (*configuration)->file.string(), configured->line,
                              error.what()));
      return ExitCode::failure;
    }
    std::string what = wrong ? *wrong : error.what();
    // "--calibration is required" needs the hint that the file's calibration was not used.
    if (*configuration && !(*configuration)->unused.empty())
      what += "; " + configuration_line(**configuration);
    return wrong_usage(program, what);
  }
  if (const auto wrong = empty_option(program)) return wrong_usage(program, *wrong);
  if (*configuration) fmt::print("{}\n", configuration_line(**configuration));
  const auto result = chosen();
  if (result) return *result;
  print_error(result.error().message);
  return ExitCode::failure;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  secure_standard_streams();
  // Modules catch their libraries' exceptions. Any other exception becomes an error message here.
  try {
    set_up_logging();
    set_wait_notice([](const std::string& line) { log_warning("{}", line); });
    const ExitCode code = run(argc, argv);
    const auto flushed = flush_standard_output();
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
