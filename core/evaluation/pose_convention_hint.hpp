// Finds the usual mistakes in a file of true poses: units, quaternion order, direction.
#pragma once

#include <optional>
#include <string>

#include "core/evaluation/pairing.hpp"

namespace penumbra {

// Explains a large difference between two trajectories by the conventions of one of them. Tested
// are positions in millimetres and quaternions in the order w x y z, of either trajectory, inverse
// poses (T_camera_table), and combinations of them. Returns one line, with the file's name, for the
// simplest combination that reduces the difference to less than 5 %; nothing where the difference
// is small or no combination does. Changes neither trajectory.
[[nodiscard]] std::optional<std::string> pose_convention_hint(const NamedTrajectory& estimated,
                                                              const NamedTrajectory& truth,
                                                              const PairingOptions& options);

}  // namespace penumbra
