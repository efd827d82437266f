// Options of live in a configuration file, by their names on the command line.
#pragma once

#include <CLI/App.hpp>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

struct ConfiguredOption {
  std::string name;   // "--fps"
  std::string words;  // "--fps=30", as on the command line
  int line = 0;       // in the file, from 1
};

struct Configuration {
  std::filesystem::path file;
  std::vector<ConfiguredOption> used;
  // Options that another one on the command line replaces: "--calibration" if --camera is given.
  std::vector<std::string> unused;
};

// Returns the path of the user's configuration, whether it exists or not; nullopt without a home
// folder.
[[nodiscard]] std::optional<std::filesystem::path> configuration_file();

// Returns the options that the configuration adds to a command line (without the program's name):
// those of the file of --config, else those of $XDG_CONFIG_HOME/penumbra/config.yaml if it exists.
// Options on the command line have priority. Returns nullopt if there is no file, for commands
// other than live, and for --help. Fails if the file is damaged or has an unknown option.
[[nodiscard]] Result<std::optional<Configuration>> load_configuration(
    const CLI::App& program, const std::vector<std::string>& words);

// Inserts the options behind the command's name.
void insert_options(const CLI::App& program, const Configuration& configuration,
                    std::vector<std::string>& words);

// Returns the configured option that an error of the command line begins with; nullptr for others.
[[nodiscard]] const ConfiguredOption* blamed_option(const Configuration& configuration,
                                                    const std::string& error);

// Returns "configuration: FILE (camera, tags; not used with this command line: calibration)".
[[nodiscard]] std::string configuration_line(const Configuration& configuration);

}  // namespace penumbra
