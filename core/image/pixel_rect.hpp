#pragma once

namespace penumbra {

// A rectangle of an image [px], from its top left pixel.
struct PixelRect {
  int x = 0, y = 0, width = 0, height = 0;
};

}  // namespace penumbra
