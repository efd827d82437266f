// Hides differences between libcamera's versions. The code tests which members exist, so that it
// compiles with every version.
#pragma once

namespace penumbra {

// Requests upright images from a camera that is mounted rotated by `rotation_deg`. In libcamera 0.1
// and earlier, `transform` must undo the rotation (`transform_of`: libcamera's
// transformFromRotation). Later versions have an `orientation`, upright by default.
template <class Configuration, class TransformOf>
void show_upright(Configuration& configuration, int rotation_deg, TransformOf transform_of) {
  if constexpr (requires { configuration.transform; }) {
    bool possible = false;
    const auto undone = transform_of(rotation_deg, &possible);
    if (possible) configuration.transform = undone;
  }
}

}  // namespace penumbra
