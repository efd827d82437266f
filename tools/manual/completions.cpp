#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <string_view>
#include <vector>

#include "app/commands/options.hpp"
#include "core/text/text.hpp"
#include "tools/manual/manual.hpp"

namespace penumbra {
namespace {

// An option that a shell completes.
struct Completed {
  std::string option;  // "--tags"
  std::string description;
  std::string value;                 // "FILE.yaml"; empty for a flag
  std::vector<std::string> choices;  // the words that the option accepts, if they are listed
};

// Returns the words of a type such as "off|auto|on"; empty for other types.
std::vector<std::string> choices_of(const CLI::Option& option) {
  std::string words = option.get_type_name();
  if (option.check_lname("shadow")) {
    words = known_techniques();
    std::erase(words, ' ');
    std::ranges::replace(words, ',', '|');
  }
  std::vector<std::string> choices;
  for (const std::string_view word : split(words, '|')) {
    const bool is_word = !word.empty() && std::ranges::all_of(word, [](unsigned char c) {
      return std::islower(c) != 0 || std::isdigit(c) != 0 || c == '-' || c == '_';
    });
    if (!is_word) return {};
    choices.emplace_back(word);
  }
  return choices.size() > 1 ? choices : std::vector<std::string>();
}

std::vector<Completed> completed_of(const CLI::App& command) {
  std::vector<Completed> result;
  for (const CLI::Option* option : command.get_options()) {
    if (!option->nonpositional()) continue;
    const bool has_value = option->get_type_size() != 0;
    for (const std::string& name : option->get_lnames()) {
      result.push_back({"--" + name, option->get_description(),
                        has_value ? option->get_type_name() : "",
                        has_value ? choices_of(*option) : std::vector<std::string>()});
    }
  }
  return result;
}

std::string names_of(const std::vector<Completed>& options) {
  std::string names;
  for (const Completed& option : options) names += (names.empty() ? "" : " ") + option.option;
  return names;
}

// Quotes a text for a shell.
std::string in_shell_quotes(std::string_view text) {
  std::string result = "'";
  for (const char c : text) result += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return result + "'";
}

// Escapes a text of zsh's _arguments.
std::string zsh_text(std::string_view text) {
  std::string result;
  for (const char c : text) {
    if (c == ':' || c == '[' || c == ']' || c == '\\') result += '\\';
    result += c;
  }
  return result;
}

std::string zsh_arguments(const CLI::App& command) {
  std::string text;
  for (const Completed& option : completed_of(command)) {
    std::string spec = fmt::format("{}[{}]", option.option, zsh_text(option.description));
    if (!option.value.empty()) {
      spec += fmt::format(
          ":{}:{}", zsh_text(option.value),
          option.choices.empty() ? "_files" : fmt::format("({})", fmt::join(option.choices, " ")));
    }
    text += fmt::format(" \\\n        {}", in_shell_quotes(spec));
  }
  return text;
}

}  // namespace

std::string bash_completion(const CLI::App& program) {
  std::string commands;
  std::string values;
  std::string options;
  for (const CLI::App* command : program.get_subcommands(nullptr)) {
    const auto completed = completed_of(*command);
    commands += (commands.empty() ? "" : " ") + command->get_name();
    options += fmt::format("    {}) options='{}' ;;\n", command->get_name(), names_of(completed));
    for (const Completed& option : completed) {
      if (option.choices.empty()) continue;
      values += fmt::format("    '{} {}') words='{}' ;;\n", command->get_name(), option.option,
                            fmt::join(option.choices, " "));
    }
  }
  return fmt::format(R"(# bash completion for penumbra
_penumbra() {{
  local current=${{COMP_WORDS[COMP_CWORD]}} previous=${{COMP_WORDS[COMP_CWORD - 1]}}
  local command='' options='{}' words='' i
  for ((i = 1; i < COMP_CWORD; i++)); do
    case ${{COMP_WORDS[i]}} in
      -*) ;;
      *) command=${{COMP_WORDS[i]}}; break ;;
    esac
  done
  case $command in
{}  esac
  case "$command $previous" in
{}  esac
  if [[ -n $words ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "$current")
  elif [[ $current == -* ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$options" -- "$current")
  elif [[ -z $command ]]; then
    mapfile -t COMPREPLY < <(compgen -W '{}' -- "$current")
  fi
}}
complete -o default -F _penumbra penumbra
)",
                     names_of(completed_of(program)), options, values, commands);
}

std::string zsh_completion(const CLI::App& program) {
  std::string commands;
  std::string cases;
  for (const CLI::App* command : program.get_subcommands(nullptr)) {
    commands += fmt::format("    {}\n", in_shell_quotes(command->get_name() + ":" +
                                                        zsh_text(command->get_description())));
    cases += fmt::format("      {})\n      _arguments{} \\\n        '*: :_files' ;;\n",
                         command->get_name(), zsh_arguments(*command));
  }
  return fmt::format(R"(#compdef penumbra
# zsh completion for penumbra
_penumbra() {{
  local -a commands
  local context state line
  commands=(
{}  )
  _arguments -C{} \
        '1: :->command' '*:: :->arguments'
  case $state in
    command) _describe command commands ;;
    arguments)
      case $words[1] in
{}      esac ;;
  esac
}}
_penumbra "$@"
)",
                     commands, zsh_arguments(program), cases);
}

std::string fish_completion(const CLI::App& program) {
  std::string text = "# fish completion for penumbra\n";
  const auto add_options = [&](const CLI::App& command, const std::string& condition) {
    for (const Completed& option : completed_of(command)) {
      std::string value;
      if (!option.choices.empty()) {
        value = fmt::format(" -x -a {}",
                            in_shell_quotes(fmt::format("{}", fmt::join(option.choices, " "))));
      } else if (!option.value.empty()) {
        value = " -r";
      }
      text += fmt::format("complete -c penumbra -n '{}' -l {}{} -d {}\n", condition,
                          option.option.substr(2), value, in_shell_quotes(option.description));
    }
  };
  for (const CLI::App* command : program.get_subcommands(nullptr)) {
    text += fmt::format("complete -c penumbra -n __fish_use_subcommand -f -a {} -d {}\n",
                        command->get_name(), in_shell_quotes(command->get_description()));
  }
  add_options(program, "__fish_use_subcommand");
  for (const CLI::App* command : program.get_subcommands(nullptr))
    add_options(*command, "__fish_seen_subcommand_from " + command->get_name());
  return text;
}

}  // namespace penumbra
