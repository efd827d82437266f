// libapriltag's description of a tag family, and of ArUco dictionaries, which it does not have.
#pragma once

#include <apriltag/apriltag.h>

#include <memory>

#include "core/geometry/tag_map.hpp"

namespace penumbra {

using TagFamilyHandle = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

// Null when there is no memory for it.
[[nodiscard]] TagFamilyHandle make_tag_family(TagFamily family);

// Wrong bits that its codes can have and still be told apart, from each other and from chance.
[[nodiscard]] int most_corrected_bits(TagFamily family);

}  // namespace penumbra
