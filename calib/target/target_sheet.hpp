// A sheet of tags to print at true scale, and what lies on it.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
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

// Where the tags are. `printed_scale` is true length over nominal length of the sheet as it came
// out of the printer: 0.992 where the 100 mm ruler measures 99.2 mm. Fails when tags (with their
// white margins) overlap or the family has no such ids.
[[nodiscard]] Result<TagMap> tag_map_of(const TagBoard& board, double printed_scale = 1.0);

// Fails, naming both sizes, when the board fits on the page neither upright nor turned.
[[nodiscard]] Result<void> check_fits(const TagBoard& board, const PageSize& page);

// `inner_columns` x `inner_rows` corners between squares, a white margin of half a square around.
struct ChessboardSheet {
  int inner_columns = 9;
  int inner_rows = 6;
  double square_m = 0.022;
};

// Whatever can be printed. An AprilGrid here has tags with a border of one cell and no black
// squares between them: libapriltag finds all of its tags, and Kalibr's own has other ones.
using SheetTarget = std::variant<TagBoard, AprilGrid, CharucoBoard, ChessboardSheet>;

// At true scale: PNG of 600 dots per inch (300 for pages above 100 Mpx), which its pHYs chunk says.
enum class SheetFormat { pdf, svg, png };
// By the file's extension, in any case; PDF where there is none. Fails for any other.
[[nodiscard]] Result<SheetFormat> sheet_format_of(const std::filesystem::path& file);

// As check_fits and write_tag_board, for every kind of sheet.
[[nodiscard]] Result<void> check_fits(const SheetTarget& target, const PageSize& page);
[[nodiscard]] Result<void> write_sheet(const std::filesystem::path& file, const SheetTarget& target,
                                       const PageSize& page, SheetFormat format = SheetFormat::pdf);
// The file that load_target() reads: tags.yaml for a TagBoard, else target_type and its numbers,
// lengths times `printed_scale`.
[[nodiscard]] Result<void> save_target(const std::filesystem::path& file, const SheetTarget& target,
                                       double printed_scale = 1.0);

// The printed scale that the file was saved with; nothing where that is another sheet's file, or
// one that was changed since.
[[nodiscard]] std::optional<double> printed_scale_of(const std::filesystem::path& file,
                                                     const SheetTarget& target);

// The sheet as PDF: tags as vector shapes, a 100 mm ruler ("measure this: 100 mm"), and a line that
// says what it is; marks on the edges show where the origin is and which way x and y run. The page
// is turned to landscape where the board only fits so. Fails, naming both sizes, when it fits
// neither way, and when the file can't be written.
[[nodiscard]] Result<void> write_tag_board(const std::filesystem::path& pdf, const TagBoard& board,
                                           const PageSize& page);

}  // namespace penumbra
