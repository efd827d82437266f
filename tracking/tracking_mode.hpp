// How a frame is measured once a pose is known.
#pragma once

#include <optional>
#include <string_view>

namespace penumbra {

enum class TrackingMode {
  detect,     // tags are detected in every frame: the baseline
  fast,       // the tag pattern is aligned with the image by a limited number of pixels
  accurate,   // by every pixel at an edge, except where motion blurs the image
  automatic,  // fast while the view moves, accurate when it rests or shows fewer than three tags
};

[[nodiscard]] std::string_view to_string(TrackingMode mode);
// "auto" for automatic; nothing for an unknown word.
[[nodiscard]] std::optional<TrackingMode> tracking_mode_from_string(std::string_view name);

}  // namespace penumbra
