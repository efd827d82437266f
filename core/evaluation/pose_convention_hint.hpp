// Finds the usual mistakes in a file of true poses: units, quaternion order, direction, table
// frame.
#pragma once

#include <optional>
#include <string>

#include "core/evaluation/pairing.hpp"

namespace penumbra {

// Tests whether another convention explains a large difference between two trajectories: positions
// in millimetres, quaternions in the order w x y z, inverse poses (T_camera_table), and
// combinations; else a constant offset between two table frames. Returns one line, with the file's
// name, for the simplest combination that reduces the difference to less than 5 %, or for an offset
// that reduces it to less than 25 %. Returns nullopt if none does or the difference is small.
[[nodiscard]] std::optional<std::string> pose_convention_hint(const NamedTrajectory& estimated,
                                                              const NamedTrajectory& truth,
                                                              const PairingOptions& options);

}  // namespace penumbra
