// Frames of libav as Frames.
#pragma once

#include "app/libav.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// Returns true for the pixel formats that frame_of() converts: 8-bit grey, YUV and RGB.
[[nodiscard]] bool is_frame_format(AVPixelFormat format);

// Returns true if a plane starts with its last row.
[[nodiscard]] bool has_upward_rows(const AVFrame& decoded);

// The rows must not go upward. Returns a view of the decoder's buffer; RGB is copied to rgb24.
// Sequence and timestamp are 0. `matrix`: used if the file declares none.
[[nodiscard]] Frame frame_of(Av<AVFrame> decoded, ColorMatrix matrix);

}  // namespace penumbra
