// Differences between libcamera's versions, chosen by the members that exist, so that both variants
// compile with either version.
#pragma once

namespace penumbra {

// Requests upright images of a camera that is mounted turned by `rotation_deg`. Up to 0.1 a
// configuration has a `transform`, set to undo the rotation (`transform_of`: libcamera's
// transformFromRotation); later ones have an `orientation` that is upright by default.
template <class Configuration, class TransformOf>
void show_upright(Configuration& configuration, int rotation_deg, TransformOf transform_of) {
  if constexpr (requires { configuration.transform; }) {
    bool possible = false;
    const auto undone = transform_of(rotation_deg, &possible);
    if (possible) configuration.transform = undone;
  }
}

}  // namespace penumbra
