// Heights at which a real thing on the table is shadowed: what of it faces a plane's light, cut
// into levels that each receive as a plane of their own does.
#pragma once

#include <vector>

#include "render/model.hpp"
#include "render/scene.hpp"
#include "render/shadow/plane_frame.hpp"

namespace penumbra {

// Heights above the plane [m], ascending, at least 0: the level parts of the surface that face the
// plane's normal to 0.5 mm, and where it is sloped one every few millimetres. No more than `most`
// (> 1): of more they are spaced evenly. None where nothing above the plane faces its normal.
[[nodiscard]] std::vector<double> receiving_levels(const Model& model,
                                                   const Placement& T_table_object,
                                                   const PlaneFrame& plane, std::size_t most);

}  // namespace penumbra
