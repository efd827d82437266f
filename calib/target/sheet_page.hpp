// Draws a page with a target, a ruler, origin marks and a caption.
#pragma once

#include <cairo.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "calib/target/target_sheet.hpp"
#include "core/error.hpp"

namespace penumbra {

inline constexpr double kMargin = 0.006;          // [m] not printable on common printers
inline constexpr double kRulerLength = 0.100;     // [m]
inline constexpr double kFooter = 0.012;          // [m] below the board for ruler and text
inline constexpr double kOriginCross_m = 0.0015;  // half of the cross's width
inline constexpr double kOriginGap_m = 0.0005;    // between the cross and the tags' white margins

// A target to draw. `draw` draws it around a centre on the page [m].
struct Sheet {
  double width = 0.0;   // [m]
  double height = 0.0;  // [m]
  std::function<void(cairo_t*, double, double)> draw;
  std::string caption;
  bool free_at_origin = false;  // the origin has room for a cross
};

// Returns the file's bytes. The sheet with margins and footer must fit on the page.
[[nodiscard]] Result<std::vector<std::uint8_t>> page_bytes(const Sheet& sheet, const PageSize& page,
                                                           SheetFormat format);

}  // namespace penumbra
