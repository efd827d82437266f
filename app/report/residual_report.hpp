// Text and JSON of the causes of residuals: the tag map, the lens and the row time.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {

// Returns null if nothing was tested.
[[nodiscard]] nlohmann::ordered_json causes_json(const ResidualCauses& causes);
// `given_row_s`: row time in the camera file.
[[nodiscard]] std::string causes_table(const ResidualCauses& causes, double given_row_s);

}  // namespace penumbra
