// Which frames of a recording: "A:B", half open.
#pragma once

#include <optional>
#include <string>

namespace penumbra {

// A half-open range of frames by their numbers in the recording.
struct FrameRange {
  int first = 0;
  std::optional<int> last;
};
// "A:B", "A:" or ":B"; nothing where it is none, or empty.
[[nodiscard]] std::optional<FrameRange> parse_frame_range(const std::string& text);

}  // namespace penumbra
