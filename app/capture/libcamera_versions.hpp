// Where libcamera's versions differ in what a program says to them. Chosen by what there is, not by
// a number, so that both ways compile with either.
#pragma once

namespace penumbra {

// Asks for upright pictures of a camera that is mounted turned by `rotation_deg`. Up to 0.1 a
// configuration has a `transform`, which is to undo the rotation (`transform_of`: libcamera's
// transformFromRotation); later ones have an `orientation`, and start upright.
template <class Configuration, class TransformOf>
void show_upright(Configuration& configuration, int rotation_deg, TransformOf transform_of) {
  if constexpr (requires { configuration.transform; }) {
    bool possible = false;
    const auto undone = transform_of(rotation_deg, &possible);
    if (possible) configuration.transform = undone;
  }
}

}  // namespace penumbra
