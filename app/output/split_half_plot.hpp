// Plot of `evaluate --split-half` as SVG.
#pragma once

#include <string>

#include "app/replay/split_half_run.hpp"

namespace penumbra {

// Above: difference of the halves and predicted error over the frames. Below: the parts of the
// squared residuals that each cause explains.
[[nodiscard]] std::string split_half_svg(const SplitHalfReport& report);

}  // namespace penumbra
