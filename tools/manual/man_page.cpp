#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <string_view>
#include <vector>

#include "app/report/versions.hpp"
#include "core/text/text.hpp"
#include "tools/manual/manual.hpp"

namespace penumbra {
namespace {

// Escapes a text for roff. Hyphens become minus signs, so that options can be copied.
std::string roff(std::string_view text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '\\') {
      escaped += "\\e";
    } else if (c == '-') {
      escaped += "\\-";
    } else {
      escaped += c;
    }
  }
  // A line that begins so would be a request.
  if (escaped.starts_with('.') || escaped.starts_with('\'')) escaped.insert(0, "\\&");
  return escaped;
}

std::string header(const std::string& page) {
  std::string title = page;
  for (char& c : title) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return fmt::format(".TH {} 1 \"\" \"penumbra {}\" \"User Commands\"\n", roff(title),
                     roff(program_version()));
}

// Returns the options with bold names and italic values.
std::string option_entry(const CLI::Option& option) {
  std::string names;
  for (const std::string& name : option.get_snames())
    names += fmt::format("\\fB{}\\fR, ", roff("-" + name));
  for (const std::string& name : option.get_lnames())
    names += fmt::format("\\fB{}\\fR, ", roff("--" + name));
  names.resize(names.size() - 2);
  if (option.get_type_size() != 0)
    names += fmt::format(" \\fI{}\\fR", roff(option.get_type_name()));
  std::string text = roff(option.get_description());
  if (option.get_required()) text += " (required)";
  if (!option.get_default_str().empty())
    text += fmt::format(" (default: {})", roff(option.get_default_str()));
  return fmt::format(".TP\n{}\n{}\n", names, text);
}

std::string options_section(const CLI::App& command) {
  std::string text = ".SH OPTIONS\n";
  std::vector<std::string> groups = command.get_groups();
  std::ranges::rotate(groups, groups.begin() + 1);  // the common options come last
  for (const std::string& group : groups) {
    const auto options = command.get_options([&](const CLI::Option* option) {
      return option->get_group() == group && option->nonpositional();
    });
    if (options.empty()) continue;
    text += fmt::format(".SS {}\n", roff(group));
    for (const CLI::Option* option : options) text += option_entry(*option);
  }
  return text;
}

// Splits a footer into its sentences and its examples, which begin with a blank.
struct Footer {
  std::string description;
  std::string examples;
};

Footer footer_of(const CLI::App& command) {
  Footer footer;
  const std::string text = command.get_footer();
  for (const std::string_view line : split(text, '\n')) {
    if (line.starts_with(' ')) {
      footer.examples += roff(line.substr(line.find_first_not_of(' '))) + "\n";
    } else if (line.empty()) {
      if (!footer.description.empty()) footer.description += ".PP\n";
    } else if (line != "Example:") {
      footer.description += roff(line) + "\n";
    }
  }
  while (footer.description.ends_with(".PP\n"))
    footer.description.resize(footer.description.size() - 4);
  return footer;
}

std::string examples_section(const Footer& footer) {
  if (footer.examples.empty()) return {};
  return fmt::format(".SH EXAMPLES\n.EX\n{}.EE\n", footer.examples);
}

constexpr std::string_view kExitStatus =
    ".SH EXIT STATUS\n"
    "0: success, also if Ctrl\\-C ended the frames early. 1: failure. 2: wrong usage.\n";

std::string program_page(const CLI::App& program) {
  std::string text = header("penumbra");
  text += fmt::format(".SH NAME\npenumbra \\- {}\n", roff(program.get_description()));
  text += ".SH SYNOPSIS\n.B penumbra\n\\fICOMMAND\\fR [\\fIOPTIONS\\fR]\n";
  text += ".SH COMMANDS\n";
  std::string see_also;
  for (const CLI::App* command : program.get_subcommands(nullptr)) {
    text += fmt::format(".TP\n.B {}\n{}\n", command->get_name(), roff(command->get_description()));
    see_also +=
        fmt::format("{}.BR penumbra\\-{} (1)", see_also.empty() ? "" : ",\n", command->get_name());
  }
  text += options_section(program);
  text += kExitStatus;
  text +=
      ".SH ENVIRONMENT\n.TP\n.B PENUMBRA_RESOURCES\n"
      "Folder with the bundled scenes and recordings, in place of the installed ones\n";
  text += fmt::format(".SH SEE ALSO\n{}\n", see_also);
  return text;
}

std::string command_page(const CLI::App& command) {
  const Footer footer = footer_of(command);
  std::string text = header("penumbra-" + command.get_name());
  text += fmt::format(".SH NAME\npenumbra\\-{} \\- {}\n", command.get_name(),
                      roff(command.get_description()));
  text += fmt::format(".SH SYNOPSIS\n.B penumbra {}\n[\\fIOPTIONS\\fR]", command.get_name());
  std::string arguments;
  for (const CLI::Option* option :
       command.get_options([](const CLI::Option* o) { return o->get_positional(); })) {
    const std::string name = option->get_name(true);
    text += option->get_required() ? fmt::format(" \\fI{}\\fR", roff(name))
                                   : fmt::format(" [\\fI{}\\fR]", roff(name));
    arguments += fmt::format(".TP\n\\fI{}\\fR\n{}\n", roff(name), roff(option->get_description()));
  }
  text += "\n";
  if (!footer.description.empty()) text += ".SH DESCRIPTION\n" + footer.description;
  if (!arguments.empty()) text += ".SH ARGUMENTS\n" + arguments;
  text += options_section(command);
  text += kExitStatus;
  text += examples_section(footer);
  return text + ".SH SEE ALSO\n.BR penumbra (1)\n";
}

}  // namespace

std::map<std::string, std::string> man_pages(const CLI::App& program) {
  std::map<std::string, std::string> pages;
  pages["penumbra.1"] = program_page(program);
  for (const CLI::App* command : program.get_subcommands(nullptr))
    pages[fmt::format("penumbra-{}.1", command->get_name())] = command_page(*command);
  return pages;
}

}  // namespace penumbra
