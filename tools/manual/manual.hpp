// Man pages and shell completions, from the same option definitions as --help.
#pragma once

#include <CLI/App.hpp>
#include <map>
#include <string>

namespace penumbra {

// Returns the text of every man page by file name: penumbra.1 and penumbra-COMMAND.1.
[[nodiscard]] std::map<std::string, std::string> man_pages(const CLI::App& program);

// Return the completion scripts of a shell.
[[nodiscard]] std::string bash_completion(const CLI::App& program);
[[nodiscard]] std::string zsh_completion(const CLI::App& program);
[[nodiscard]] std::string fish_completion(const CLI::App& program);

}  // namespace penumbra
