// Fragment operations that a context supports, as probed by picture_probe.hpp.
#pragma once

namespace penumbra {

struct PictureAbilities {
  bool blends = true;   // a fragment can be multiplied with what is there
  bool fetches = true;  // a fragment can read texels of a texture
};

}  // namespace penumbra
