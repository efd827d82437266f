// Versions of the program and its libraries, for --version and reports.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace penumbra {

[[nodiscard]] std::string program_version();
// Returns name and version of the program, the compiler and the libraries that affect results.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> component_versions();

}  // namespace penumbra
