// Writes target sheets for printing at true scale, and their target files.
#pragma once

#include <filesystem>
#include <optional>
#include <string_view>
#include <variant>

#include "calib/target/tag_board.hpp"
#include "calib/target/target.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

struct PageSize {
  double width_m = 0.297;
  double height_m = 0.210;
};

// Accepts "a5" to "a0", "letter", "legal", "tabloid" (any case, portrait), or "210x297" [mm].
[[nodiscard]] Result<PageSize> page_size_from_string(std::string_view name);

// `inner_columns` x `inner_rows` corners between squares; the white margin is half a square wide.
struct ChessboardSheet {
  int inner_columns = 9;
  int inner_rows = 6;
  double square_m = 0.022;
};

using SheetTarget = std::variant<TagBoard, AprilGrid, CharucoBoard, ChessboardSheet>;

// PNG has 600 dots per inch (300 for pages above 100 Mpx), stored in its pHYs chunk.
enum class SheetFormat { pdf, svg, png };
// Returns the format by the extension, in any case; PDF without an extension. Fails if unknown.
[[nodiscard]] Result<SheetFormat> sheet_format_of(const std::filesystem::path& file);

// Fails if the target fits on the page neither in portrait nor in landscape.
[[nodiscard]] Result<void> check_fits(const SheetTarget& target, const PageSize& page);
// Writes the target, a 100 mm ruler, a caption, and marks of the origin and of x and y at the
// page's edges. Rotates the page by 90 degrees if the target fits only then.
[[nodiscard]] Result<void> write_sheet(const std::filesystem::path& file, const SheetTarget& target,
                                       const PageSize& page, SheetFormat format = SheetFormat::pdf);
// Writes a file for load_target(): a tags.yaml for a TagBoard, otherwise target_type and
// dimensions. Multiplies lengths by `printed_scale`.
[[nodiscard]] Result<void> save_target(const std::filesystem::path& file, const SheetTarget& target,
                                       double printed_scale = 1.0);

// Returns the printed scale with which the file was saved, or nullopt if it is not the unmodified
// file of `target`.
[[nodiscard]] std::optional<double> printed_scale_of(const std::filesystem::path& file,
                                                     const SheetTarget& target);

}  // namespace penumbra
