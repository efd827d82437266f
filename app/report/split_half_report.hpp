// Text and JSON of `evaluate --split-half`. docs/reports.md explains the keys.
#pragma once

#include <string>

#include "app/replay/split_half_run.hpp"

namespace penumbra {

[[nodiscard]] std::string split_half_json(const SplitHalfReport& report);
[[nodiscard]] std::string split_half_table(const SplitHalfReport& report);

}  // namespace penumbra
