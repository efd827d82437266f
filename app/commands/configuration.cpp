#include "app/commands/configuration.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdlib>
#include <set>
#include <string_view>
#include <system_error>

#include "app/commands/options.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kCommand = "live";

// An option on the command line that takes the place of several in the file: the calibration of one
// camera is wrong for another.
struct Replacement {
  std::string_view given;
  std::array<std::string_view, 13> replaced;
};
constexpr std::array kReplacements = {
    Replacement{"--camera",
                {"--calibration", "--tags", "--camera-name", "--scale-calibration", "--fov",
                 "--size", "--fps", "--format", "--exposure", "--gain", "--white-balance",
                 "--focus", "--no-dma-buf"}},
    Replacement{"--calibration", {"--camera-name", "--scale-calibration", "--fov"}},
    Replacement{"--fov", {"--calibration", "--camera-name", "--scale-calibration"}},
    Replacement{"--camera-name", {"--fov"}},
    Replacement{"--scale-calibration", {"--fov"}},
    Replacement{"--no-window", {"--fullscreen", "--kiosk", "--reset-after"}},
    Replacement{"--kiosk", {"--no-window"}},
};
// These choose what is read, so they can't be in the file.
constexpr std::array<std::string_view, 3> kCommandLineOnly = {"--config", "--help", "--version"};

// Returns the position of the command's name; words.size() if there is none.
std::size_t command_at(const CLI::App& program, const std::vector<std::string>& words) {
  for (std::size_t i = 0; i < words.size(); ++i) {
    if (!words[i].starts_with('-')) return i;
    const CLI::Option* option = program.get_option_no_throw(words[i]);
    if (option != nullptr && option->get_expected_min() > 0) ++i;  // skips its value
  }
  return words.size();
}

std::string name_in(const std::string& word) {
  return word.substr(0, word.find('='));
}

// Returns the names of the options on the command line.
std::set<std::string> given_options(const std::vector<std::string>& words) {
  std::set<std::string> names;
  for (const std::string& word : words) {
    if (word == "--") break;
    if (word.starts_with("--")) names.insert(name_in(word));
  }
  return names;
}

// Returns the value of an option on the command line; nullopt if it is missing or has no value.
std::optional<std::string> value_of(const std::vector<std::string>& words,
                                    const std::string& option) {
  const std::string assigned = option + "=";
  for (std::size_t i = 0; i < words.size() && words[i] != "--"; ++i) {
    if (words[i].starts_with(assigned)) return words[i].substr(assigned.size());
    if (words[i] == option && i + 1 < words.size()) return words[i + 1];
  }
  return std::nullopt;
}

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : "";
}

// Replaces a leading "~/", as a shell does on a command line, also of "recording:~/...".
std::string with_home(const std::string& text) {
  constexpr std::string_view kRecording = "recording:";
  const std::string home = variable("HOME");
  const std::size_t at = text.starts_with(kRecording) ? kRecording.size() : 0;
  const bool replaces = text.substr(at).starts_with("~/") && !home.empty();
  return replaces ? text.substr(0, at) + home + text.substr(at + 1) : text;
}

// Returns true for a value with an explicit tag, which changes its meaning ("!!binary ...").
bool has_tag(const YAML::Node& value) {
  if (value.IsSequence() && std::ranges::any_of(value, has_tag)) return true;
  const std::string& tag = value.Tag();
  return !tag.empty() && tag != "?" && tag != "!" && tag != "tag:yaml.org,2002:str";
}

std::optional<bool> truth(const YAML::Node& value) {
  if (!value.IsScalar()) return std::nullopt;
  const std::string text = in_lower_case(value.Scalar());
  if (text == "true" || text == "yes" || text == "on") return true;
  if (text == "false" || text == "no" || text == "off") return false;
  return std::nullopt;
}

// Reads the options of one command from its section of the file.
class OptionReader {
 public:
  OptionReader(const CLI::App& command, std::filesystem::path file)
      : command_(command), file_(std::move(file)) {}

  [[nodiscard]] Result<std::vector<ConfiguredOption>> read(const YAML::Node& section) const {
    std::vector<ConfiguredOption> options;
    for (const auto& entry : section) {
      const std::string key = entry.first.IsScalar() ? entry.first.Scalar() : std::string();
      const std::string name = "--" + key;
      const int line = entry.first.Mark().line + 1;
      PENUMBRA_TRY(const CLI::Option* option, find(key, line));
      if (has_tag(entry.second)) return wrong(line, key, "has a YAML tag (!...); remove it");
      const auto add = [&](const std::string& words) { options.push_back({name, words, line}); };
      if (option->get_expected_max() == 0) {
        const auto on = truth(entry.second);
        if (!on) return wrong(line, key, "is a switch; give it true or false");
        // A switch that is off is listed without words, so that it is known as configured.
        add(*on ? name : std::string());
        continue;
      }
      if (option->get_expected_min() == 0 && truth(entry.second)) {
        add(*truth(entry.second) ? name : std::string());
        continue;
      }
      PENUMBRA_TRY(const auto values, values_of(*option, entry.second, key, line));
      for (const std::string& value : values) add(name + "=" + value);
    }
    return options;
  }

 private:
  [[nodiscard]] tl::unexpected<Error> wrong(int line, const std::string& key,
                                            const std::string& what) const {
    return fail("{}: line {}: {}: {}", file_.string(), line, key, what);
  }

  [[nodiscard]] Result<const CLI::Option*> find(const std::string& key, int line) const {
    const std::string name = "--" + key;
    if (std::ranges::find(kCommandLineOnly, name) != kCommandLineOnly.end())
      return wrong(line, key, "can only be given on the command line; remove it");
    const CLI::Option* found = command_.get_option_no_throw(name);
    if (found != nullptr && !key.empty() && !key.starts_with('-')) return found;
    const std::string meant = similar_option(command_, name);
    const std::string shown = key.empty() ? "?" : shortened(key);
    return wrong(
        line, shown,
        meant.empty()
            ? fmt::format("is no option of {0}; penumbra {0} --help lists them", kCommand)
            : fmt::format("is no option of {}; did you mean {}?", kCommand, meant.substr(2)));
  }

  [[nodiscard]] Result<std::vector<std::string>> values_of(const CLI::Option& option,
                                                           const YAML::Node& value,
                                                           const std::string& key, int line) const {
    std::vector<std::string> values;
    if (value.IsScalar()) {
      values.push_back(with_home(value.Scalar()));
    } else if (value.IsSequence()) {
      for (const auto& one : value) {
        if (!one.IsScalar()) return wrong(line, key, "is a list of something other than values");
        values.push_back(with_home(one.Scalar()));
      }
      if (values.size() > 1 && option.get_expected_max() <= 1)
        return wrong(line, key, "is a list, but the option has one value; give it one");
    } else {
      return wrong(line, key,
                   value.IsMap() ? "is a map; give it a value" : "is empty; give it a value");
    }
    if (values.empty() || std::ranges::count(values, "") > 0)
      return wrong(line, key, "is empty; give it a value");
    return values;
  }

  const CLI::App& command_;
  std::filesystem::path file_;
};

// Returns true if an option on the command line replaces the option of the file.
bool is_replaced(const std::set<std::string>& given, const std::string& name) {
  return std::ranges::any_of(kReplacements, [&](const Replacement& replacement) {
    return given.contains(std::string(replacement.given)) &&
           std::ranges::count(replacement.replaced, name) > 0;
  });
}

// Returns true for a text of blank lines and comments.
bool has_no_line(const std::string& text) {
  return std::ranges::all_of(split(text, '\n'), [](std::string_view line) {
    return trim(line).empty() || trim(line).starts_with('#');
  });
}

// Fails if the text has several documents, because only the first would be read.
Result<void> check_is_one_document(const std::string& text, const std::string& file) {
  try {
    if (YAML::LoadAll(text).size() <= 1) return {};
  } catch (const YAML::Exception&) {
    return {};  // parse_yaml_map() reports it
  }
  return fail("{}: holds several documents (---); write one", file);
}

Result<std::vector<ConfiguredOption>> options_in(const YAML::Node& root, const CLI::App& command,
                                                 const std::filesystem::path& file) {
  std::vector<ConfiguredOption> options;
  for (const auto& entry : root) {
    const std::string section = entry.first.IsScalar() ? entry.first.Scalar() : "?";
    const int line = entry.first.Mark().line + 1;
    if (section != kCommand) {
      return fail(
          "{}: line {}: {}: is not a command with a configuration; write options under `{}:`, "
          "indented",
          file.string(), line, shortened(section), kCommand);
    }
    if (entry.second.IsNull()) continue;
    if (!entry.second.IsMap()) {
      return fail("{}: line {}: {}: holds no options; write lines of the form `  fps: 30`",
                  file.string(), line, section);
    }
    PENUMBRA_TRY(options, OptionReader(command, file).read(entry.second));
  }
  return options;
}

}  // namespace

std::optional<std::filesystem::path> configuration_file() {
  std::filesystem::path folder = variable("XDG_CONFIG_HOME");
  if (!folder.is_absolute()) {
    const std::string home = variable("HOME");
    if (home.empty()) return std::nullopt;
    folder = std::filesystem::path(home) / ".config";
  }
  return folder / "penumbra" / "config.yaml";
}

Result<std::optional<Configuration>> load_configuration(const CLI::App& program,
                                                        const std::vector<std::string>& words) {
  const std::size_t at = command_at(program, words);
  if (at == words.size() || words[at] != kCommand) return std::nullopt;
  std::set<std::string> given = given_options(words);
  if (given.contains("--help") || std::ranges::count(words, "-h") > 0 ||
      given.contains("--version"))
    return std::nullopt;
  const std::optional<std::filesystem::path> named = value_of(words, "--config");
  const auto file = named ? named : configuration_file();
  std::error_code ignored;
  // A link to nothing is reported below. The home of another user can't be searched.
  using Type = std::filesystem::file_type;
  const Type type = file ? std::filesystem::symlink_status(*file, ignored).type() : Type::none;
  const bool is_missing = !named && (type == Type::not_found || type == Type::none);
  if (!file || file->empty() || is_missing) return std::nullopt;

  PENUMBRA_TRY(const std::string text, read_text_file(*file, kMaxYamlBytes));
  Configuration configuration;
  configuration.file = *file;
  if (has_no_line(text)) return configuration;
  PENUMBRA_TRY_VOID(check_is_one_document(text, file->string()));
  PENUMBRA_TRY(const YAML::Node root, parse_yaml_map(text, file->string()));
  PENUMBRA_TRY(const auto options,
               options_in(root, *program.get_subcommand(std::string(kCommand)), *file));
  // The camera of the file, named again, keeps its calibration.
  const std::string camera = value_of(words, "--camera").value_or("");
  std::erase_if(given, [&](const std::string& name) {
    return name == "--camera" && std::ranges::find(options, "--camera=" + camera,
                                                   &ConfiguredOption::words) != options.end();
  });
  for (const ConfiguredOption& option : options) {
    if (option.name == "--camera" && !camera.empty()) continue;
    if (given.contains(option.name) || option.words.empty()) continue;
    if (!is_replaced(given, option.name)) {
      configuration.used.push_back(option);
    } else if (std::ranges::count(configuration.unused, option.name) == 0) {
      configuration.unused.push_back(option.name);
    }
  }
  // Without --kiosk, the command line would reject the --reset-after that the file gives kiosks.
  const auto is_kiosk = [](const ConfiguredOption& option) { return option.name == "--kiosk"; };
  if (!given.contains("--kiosk") && std::ranges::none_of(configuration.used, is_kiosk)) {
    const auto removed = std::erase_if(configuration.used, [](const ConfiguredOption& option) {
      return option.name == "--reset-after";
    });
    if (removed > 0) configuration.unused.emplace_back("--reset-after");
  }
  return configuration;
}

void insert_options(const CLI::App& program, const Configuration& configuration,
                    std::vector<std::string>& words) {
  std::vector<std::string> added;
  for (const ConfiguredOption& option : configuration.used) added.push_back(option.words);
  const auto behind = static_cast<std::ptrdiff_t>(command_at(program, words)) + 1;
  words.insert(words.begin() + behind, added.begin(), added.end());
}

const ConfiguredOption* blamed_option(const Configuration& configuration,
                                      const std::string& error) {
  for (const ConfiguredOption& option : configuration.used) {
    if (!error.starts_with(option.name)) continue;
    const char next = error.size() > option.name.size() ? error[option.name.size()] : ' ';
    if (next != '-' && std::isalnum(static_cast<unsigned char>(next)) == 0) return &option;
  }
  return nullptr;
}

std::string configuration_line(const Configuration& configuration) {
  std::vector<std::string> used;
  for (const ConfiguredOption& option : configuration.used) {
    const std::string name = option.name.substr(2);
    if (std::ranges::count(used, name) == 0) used.push_back(name);
  }
  std::vector<std::string> unused;
  for (const std::string& name : configuration.unused) unused.push_back(name.substr(2));
  return fmt::format("configuration: {} ({}{})", configuration.file.string(),
                     used.empty() ? "no option used" : fmt::format("{}", fmt::join(used, ", ")),
                     unused.empty() ? std::string()
                                    : fmt::format("; not used with this command line: {}",
                                                  fmt::join(unused, ", ")));
}

}  // namespace penumbra
