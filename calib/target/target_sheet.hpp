// Target sheets to print at true scale, and their target files.
#pragma once

#include <filesystem>
#include <optional>
#include <string_view>
#include <variant>

#include "calib/target/target.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

struct PageSize {
  double width_m = 0.297;
  double height_m = 0.210;
};

// "a5", "a4", "a3", "a2", "a1", "a0", "letter", "legal", "tabloid" (any case, portrait), or
// "210x297" in millimetres.
[[nodiscard]] Result<PageSize> page_size_from_string(std::string_view name);

// Rows and columns of tags, ids counted in reading order from the top left, centred on the page:
// the table frame's origin is the board's centre, x right, y up on the sheet, z out of the paper.
struct TagBoard {
  TagFamily family = TagFamily::tag36h11;
  int first_id = 0;
  int columns = 4;
  int rows = 3;
  double tag_size_m = 0.04;  // edge of the black border's outer square
  double pitch_m = 0.055;    // from one tag's centre to the next
};

// `printed_scale`: true over nominal length of the printed sheet, 0.992 if the 100 mm ruler
// measures 99.2 mm. Fails if tags (with their white margins) overlap or the family has no such ids.
[[nodiscard]] Result<TagMap> tag_map_of(const TagBoard& board, double printed_scale = 1.0);

// `inner_columns` x `inner_rows` corners between squares, a white margin of half a square around.
struct ChessboardSheet {
  int inner_columns = 9;
  int inner_rows = 6;
  double square_m = 0.022;
};

using SheetTarget = std::variant<TagBoard, AprilGrid, CharucoBoard, ChessboardSheet>;

// At true scale: PNG of 600 dots per inch (300 for pages above 100 Mpx), which its pHYs chunk says.
enum class SheetFormat { pdf, svg, png };
// By the file's extension, in any case; PDF where there is none. Fails for any other.
[[nodiscard]] Result<SheetFormat> sheet_format_of(const std::filesystem::path& file);

// Fails, with both sizes, if the target fits on the page neither upright nor turned.
[[nodiscard]] Result<void> check_fits(const SheetTarget& target, const PageSize& page);
// Writes the target, a 100 mm ruler, a caption, and marks of the origin and of x and y on the
// edges. The page is turned if the target only fits so.
[[nodiscard]] Result<void> write_sheet(const std::filesystem::path& file, const SheetTarget& target,
                                       const PageSize& page, SheetFormat format = SheetFormat::pdf);
// The file that load_target() reads: tags.yaml for a TagBoard, else target_type and its numbers,
// lengths times `printed_scale`.
[[nodiscard]] Result<void> save_target(const std::filesystem::path& file, const SheetTarget& target,
                                       double printed_scale = 1.0);

// The printed scale that the file was saved with; nothing if it is not the unchanged file of
// `target`.
[[nodiscard]] std::optional<double> printed_scale_of(const std::filesystem::path& file,
                                                     const SheetTarget& target);

}  // namespace penumbra
