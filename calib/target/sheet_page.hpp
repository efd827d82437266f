// Draws a target's page: the target, a ruler, marks of the origin, and a caption.
#pragma once

#include <cairo.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "calib/target/target_sheet.hpp"
#include "core/error.hpp"

namespace penumbra {

inline constexpr double kMargin = 0.006;          // [m] that common printers leave white
inline constexpr double kRulerLength = 0.100;     // [m]
inline constexpr double kFooter = 0.012;          // [m] below the board for ruler and text
inline constexpr double kOriginCross_m = 0.0015;  // half of its width
inline constexpr double kOriginGap_m = 0.0005;    // between it and the tags' white margins

// A target to draw: its size, the function that draws it around a centre on the page, a caption.
struct Sheet {
  double width = 0.0;   // [m]
  double height = 0.0;  // [m]
  std::function<void(cairo_t*, double, double)> draw;
  std::string caption;
  bool free_at_origin = false;  // there is room for a cross
};

// Returns the file's bytes. The page must have room for the sheet with its margins and footer.
[[nodiscard]] Result<std::vector<std::uint8_t>> page_bytes(const Sheet& sheet, const PageSize& page,
                                                           SheetFormat format);

}  // namespace penumbra
