#include <algorithm>
#include <cstddef>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/commands/options.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kHelpWidth = 80;
constexpr std::size_t kOptionColumn = 28;  // column where the descriptions of options begin
constexpr std::size_t kCommandColumn = 13;

// Wraps a text at blanks. It begins at `column`; continuation lines begin with `indent` blanks.
std::string wrapped(std::string_view text, std::size_t column, std::size_t indent) {
  std::string result;
  for (const std::string_view word : split(text, ' ')) {
    const bool fits = column + word.size() <= kHelpWidth;
    if (!result.empty()) result += fits ? " " : "\n" + std::string(indent, ' ');
    column = (fits ? column : indent) + word.size() + 1;
    result += word;
  }
  return result;
}

// Returns a name and its description, which begins at `column`, or two blanks after a longer name.
std::string help_entry(const std::string& name, const std::string& text, std::size_t column) {
  std::string entry = "  " + std::string(trim(name));
  entry += std::string(std::max(column, entry.size() + 2) - entry.size(), ' ');
  return entry + wrapped(text, entry.size(), column) + "\n";
}

class HelpFormatter final : public CLI::Formatter {
 public:
  std::string make_help(const CLI::App* app, std::string name,
                        CLI::AppFormatMode mode) const override {
    std::string help = wrapped(app->get_description(), 0, 0) + "\n" +
                       make_usage(app, std::move(name)) + make_positionals(app);
    std::vector<std::string> groups = app->get_groups();
    std::ranges::rotate(groups,
                        groups.begin() + 1);  // the group of add_common_options() comes last
    for (const std::string& group : groups) {
      const auto options = app->get_options([&group](const CLI::Option* option) {
        return option->get_group() == group && option->nonpositional();
      });
      if (!options.empty()) help += make_group(group, false, options);
    }
    help += make_subcommands(app, mode) + "\n";
    const std::string footer = app->get_footer();
    for (const std::string_view line : split(footer, '\n'))
      help += (line.starts_with(' ') ? std::string(line) : wrapped(line, 0, 0)) + "\n";
    return help;
  }
  std::string make_option(const CLI::Option* option, bool is_positional) const override {
    return help_entry(make_option_name(option, is_positional) + make_option_opts(option),
                      option->get_description(), kOptionColumn);
  }
  std::string make_option_opts(const CLI::Option* option) const override {
    std::string value = option->get_type_size() == 0 ? "" : " " + option->get_type_name();
    if (!option->get_default_str().empty()) value += "=" + option->get_default_str();
    if (option->get_expected_max() == CLI::detail::expected_max_vector_size) value += " ...";
    return value + (option->get_required() ? " (required)" : "");
  }
  std::string make_subcommand(const CLI::App* command) const override {
    return help_entry(command->get_name(), command->get_description(), kCommandColumn);
  }
};

}  // namespace

std::shared_ptr<CLI::FormatterBase> make_help_formatter() {
  return std::make_shared<HelpFormatter>();
}

}  // namespace penumbra
