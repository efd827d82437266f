#include "calib/target/target_sheet.hpp"

#include <cairo.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <vector>

#include "calib/target/sheet_page.hpp"
#include "core/propagate.hpp"
#include "core/text/file.hpp"
#include "core/text/text.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

// Bounds of the printed scale: true length over nominal length.
constexpr double kSmallestScale = 0.5;
constexpr double kLargestScale = 2.0;

struct NamedPage {
  std::string_view name;
  double width_mm;
  double height_mm;
};
constexpr std::array kPages = {
    NamedPage{"a5", 148, 210},          NamedPage{"a4", 210, 297},
    NamedPage{"a3", 297, 420},          NamedPage{"a2", 420, 594},
    NamedPage{"a1", 594, 841},          NamedPage{"a0", 841, 1189},
    NamedPage{"letter", 215.9, 279.4},  NamedPage{"legal", 215.9, 355.6},
    NamedPage{"tabloid", 279.4, 431.8},
};

// Size of the whole printed board, white margins of the outer tags included [m].
struct BoardExtent {
  double width = 0.0;
  double height = 0.0;
};

Result<BoardExtent> extent_of(const TagBoard& board) {
  if (board.columns < 1 || board.rows < 1 || board.columns > 100 || board.rows > 100) {
    return fail("a board of {} columns and {} rows: give 1 to 100 of each", board.columns,
                board.rows);
  }
  if (!(board.tag_size_m >= 0.001 && board.tag_size_m <= 2.0)) {
    return fail("tag size {} m: give the edge of the black square, 0.001 to 2 m", board.tag_size_m);
  }
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(board.family, board.first_id));
  const double printed = board.tag_size_m * pattern.total_width() / pattern.width_at_border();
  if (!(board.pitch_m >= printed * (1.0 - 1e-9)) || !std::isfinite(board.pitch_m)) {
    return fail("pitch {} m: tags of {} m need {:.4f} m each with their white margin",
                board.pitch_m, board.tag_size_m, printed);
  }
  return BoardExtent{board.pitch_m * (board.columns - 1) + printed,
                     board.pitch_m * (board.rows - 1) + printed};
}

// The page as it must lie for the sheet.
Result<PageSize> turned_page(const Sheet& sheet, const PageSize& page) {
  const double needed_width = std::max(sheet.width, kRulerLength) + 2.0 * kMargin;
  const double needed_height = sheet.height + 2.0 * kMargin + kFooter;
  double width = page.width_m;
  double height = page.height_m;
  if (needed_width > width || needed_height > height) std::swap(width, height);
  if (needed_width > width || needed_height > height) {
    return fail(
        "the board needs {:.0f} x {:.0f} mm with its margins and the 100 mm ruler, and does not "
        "fit on a page of {:.0f} "
        "x {:.0f} mm; use a larger --page or a smaller board",
        needed_width * 1e3, needed_height * 1e3, page.width_m * 1e3, page.height_m * 1e3);
  }
  return PageSize{width, height};
}

void draw_tag(cairo_t* cr, const TagPattern& pattern, double centre_x, double centre_y,
              double size) {
  const double cell = size / pattern.width_at_border();
  const double half = 0.5 * cell * pattern.total_width();
  // All black cells as one path, runs of a row at a time: filled together, neighbours leave no
  // hairline between them.
  for (int j = 0; j < pattern.total_width(); ++j) {
    for (int i = 0; i < pattern.total_width();) {
      if (pattern.white(i, j)) {
        ++i;
        continue;
      }
      const int begin = i;
      while (i < pattern.total_width() && !pattern.white(i, j)) ++i;
      // Page y runs down, the tag's j up.
      cairo_rectangle(cr, centre_x - half + cell * begin, centre_y + half - cell * (j + 1),
                      cell * (i - begin), cell);
    }
  }
  cairo_fill(cr);
}

void draw_square(cairo_t* cr, double left, double top, double size) {
  cairo_rectangle(cr, left, top, size, size);
}

void draw_tags(cairo_t* cr, const TagMap& map, double centre_x, double centre_y) {
  for (const MappedTag& tag : map.tags()) {
    const Result<TagPattern> pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) continue;  // the map was made of known tags only
    const Eigen::Vector3d& p_table = tag.T_table_tag.translation();
    draw_tag(cr, *pattern, centre_x + p_table.x(), centre_y - p_table.y(), tag.size_m);
  }
}

// Returns whether a small cross at the origin stays clear of every tag and its white margin
// (`printed_m` wide).
bool is_free_at_origin(const TagMap& map, double printed_m) {
  return std::ranges::all_of(map.tags(), [&](const MappedTag& tag) {
    const double away = tag.T_table_tag.translation().head<2>().cwiseAbs().maxCoeff();
    return away - 0.5 * printed_m >= kOriginCross_m + kOriginGap_m;
  });
}

Result<Sheet> sheet_of(const TagBoard& board) {
  PENUMBRA_TRY(const BoardExtent extent, extent_of(board));
  Result<TagMap> map = tag_map_of(board);
  if (!map) return tl::unexpected(map.error());
  const double printed = extent.width - board.pitch_m * (board.columns - 1);
  const bool free = is_free_at_origin(*map, printed);
  return Sheet{
      extent.width, extent.height,
      [map = std::move(*map)](cairo_t* cr, double x, double y) { draw_tags(cr, map, x, y); },
      fmt::format("{} ids {} to {}, black squares {:g} mm, pitch {:g} mm", to_string(board.family),
                  board.first_id, board.first_id + board.columns * board.rows - 1,
                  board.tag_size_m * 1e3, board.pitch_m * 1e3),
      free};
}

Result<Sheet> sheet_of(const AprilGrid& grid) {
  Result<TagMap> map = tag_map_of(grid);
  if (!map) return tl::unexpected(map.error());
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(grid.family, grid.first_id));
  const double pitch = grid.tag_size_m * (1.0 + grid.spacing);
  const double printed = grid.tag_size_m * pattern.total_width() / pattern.width_at_border();
  if (!(pitch >= printed * (1.0 - 1e-9))) {
    return fail("spacing {}: tags need {:.3f} of their size between them for their white margins",
                grid.spacing, printed / grid.tag_size_m - 1.0);
  }
  const bool free = is_free_at_origin(*map, printed);
  return Sheet{
      pitch * (grid.columns - 1) + printed, pitch * (grid.rows - 1) + printed,
      [map = std::move(*map)](cairo_t* cr, double x, double y) { draw_tags(cr, map, x, y); },
      fmt::format("{} x {} {}, tagSize {:g} mm, tagSpacing {:g}", grid.columns, grid.rows,
                  to_string(grid.family), grid.tag_size_m * 1e3, grid.spacing),
      free};
}

Result<Sheet> sheet_of(const CharucoBoard& board) {
  auto target = charuco_target(board);
  if (!target) return tl::unexpected(target.error());
  return Sheet{board.columns * board.square_m, board.rows * board.square_m,
               [board, map = std::move(*target->tags)](cairo_t* cr, double x, double y) {
                 // All as one path, so that squares that touch leave no hairline.
                 for (int j = 0; j < board.rows; ++j) {
                   for (int i = (j + (board.first_white ? 1 : 0)) % 2; i < board.columns; i += 2) {
                     draw_square(cr, x + (i - 0.5 * board.columns) * board.square_m,
                                 y + (j - 0.5 * board.rows) * board.square_m, board.square_m);
                   }
                 }
                 cairo_fill(cr);
                 draw_tags(cr, map, x, y);
               },
               fmt::format("ChArUco {} x {}, squares {:g} mm, {} {:g} mm from id {}", board.columns,
                           board.rows, board.square_m * 1e3, to_string(board.family),
                           board.tag_m * 1e3, board.first_id),
               false};
}

Result<Sheet> sheet_of(const ChessboardSheet& board) {
  PENUMBRA_TRY_VOID(chessboard_target(board.inner_columns, board.inner_rows, board.square_m));
  const int columns = board.inner_columns + 1;
  const int rows = board.inner_rows + 1;
  return Sheet{(columns + 1) * board.square_m, (rows + 1) * board.square_m,
               [=](cairo_t* cr, double x, double y) {
                 for (int j = 0; j < rows; ++j) {
                   for (int i = j % 2; i < columns; i += 2) {
                     draw_square(cr, x + (i - 0.5 * columns) * board.square_m,
                                 y + (j - 0.5 * rows) * board.square_m, board.square_m);
                   }
                 }
                 cairo_fill(cr);
               },
               fmt::format("{} x {} inner corners, squares {:g} mm", board.inner_columns,
                           board.inner_rows, board.square_m * 1e3),
               false};
}

Result<Sheet> sheet_of(const SheetTarget& target) {
  return std::visit([](const auto& board) { return sheet_of(board); }, target);
}

constexpr std::string_view kMeasuredLine = "# The sheet's 100 mm ruler, on paper [mm]: ";

// A comment, with its line break; empty for a sheet at its true scale.
std::string measured_line(double printed_scale) {
  if (printed_scale == 1.0) return {};
  return fmt::format("{}{:.10g}\n", kMeasuredLine, 100.0 * printed_scale);
}

}  // namespace

Result<PageSize> page_size_from_string(std::string_view name) {
  std::string lower(name);
  std::transform(lower.begin(), lower.end(), lower.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  for (const NamedPage& page : kPages) {
    if (page.name == lower) return PageSize{page.width_mm * 1e-3, page.height_mm * 1e-3};
  }
  if (const std::size_t cross = lower.find('x'); cross != std::string::npos) {
    const auto millimetres = [&](std::string_view text) {
      double value = 0.0;
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
      return error == std::errc() && end == text.data() + text.size() && value >= 20.0 &&
                     value <= 5000.0
                 ? value
                 : 0.0;
    };
    const double width = millimetres(std::string_view(lower).substr(0, cross));
    const double height = millimetres(std::string_view(lower).substr(cross + 1));
    if (width > 0.0 && height > 0.0) return PageSize{width * 1e-3, height * 1e-3};
  }
  std::string known;
  for (const NamedPage& page : kPages)
    known += fmt::format("{}{}", known.empty() ? "" : ", ", page.name);
  return fail("page size '{}' is not known; use {} or WIDTHxHEIGHT in millimetres (20 to 5000)",
              name, known);
}

Result<TagMap> tag_map_of(const TagBoard& board, double printed_scale) {
  PENUMBRA_TRY_VOID(extent_of(board));
  if (!(printed_scale >= kSmallestScale && printed_scale <= kLargestScale)) {
    return fail(
        "the sheet's scale is {}; measure the ruler again: 100 mm should come out at 50 to 200 mm",
        printed_scale);
  }
  std::vector<MappedTag> tags;
  for (int row = 0; row < board.rows; ++row) {
    for (int column = 0; column < board.columns; ++column) {
      MappedTag tag;
      tag.id = board.first_id + row * board.columns + column;
      tag.family = board.family;
      PENUMBRA_TRY_VOID(TagPattern::make(tag.family, tag.id));
      tag.size_m = board.tag_size_m * printed_scale;
      tag.T_table_tag = {Eigen::Quaterniond::Identity(),
                         {(column - 0.5 * (board.columns - 1)) * board.pitch_m * printed_scale,
                          (0.5 * (board.rows - 1) - row) * board.pitch_m * printed_scale, 0.0}};
      tags.push_back(tag);
    }
  }
  return TagMap::make(std::move(tags));
}

Result<void> check_fits(const SheetTarget& target, const PageSize& page) {
  PENUMBRA_TRY(const Sheet sheet, sheet_of(target));
  PENUMBRA_TRY_VOID(turned_page(sheet, page));
  return {};
}

Result<void> check_fits(const TagBoard& board, const PageSize& page) {
  return check_fits(SheetTarget(board), page);
}

Result<void> write_tag_board(const std::filesystem::path& pdf, const TagBoard& board,
                             const PageSize& page) {
  return write_sheet(pdf, board, page);
}

Result<void> write_sheet(const std::filesystem::path& file, const SheetTarget& target,
                         const PageSize& page, SheetFormat format) {
  PENUMBRA_TRY(const Sheet sheet, sheet_of(target));
  PENUMBRA_TRY(const PageSize turned, turned_page(sheet, page));
  const Result<std::vector<std::uint8_t>> bytes = page_bytes(sheet, turned, format);
  if (!bytes) return fail_in(file.string(), bytes.error());
  return write_file(file, *bytes);
}

namespace {

// All of the file.
Result<std::string> target_text(const SheetTarget& target, double printed_scale) {
  if (!(printed_scale >= kSmallestScale && printed_scale <= kLargestScale)) {
    return fail(
        "the sheet's scale is {}; measure the ruler again: 100 mm should come out at 50 to 200 mm",
        printed_scale);
  }
  const std::string measured = measured_line(printed_scale);
  if (const auto* tags = std::get_if<TagBoard>(&target)) {
    PENUMBRA_TRY(const TagMap map, tag_map_of(*tags, printed_scale));
    return measured + tag_map_text(map);
  }
  // Lengths to the nanometre: 0.03 m times 0.992 is 0.02976 and not 0.029759999999999998.
  std::string text;
  if (const auto* grid = std::get_if<AprilGrid>(&target)) {
    text = fmt::format(
        "# Tags with a border of one cell, no black squares between them; id {} at the bottom "
        "left,\n# ids to the right, then up. tagSize: metres. tagSpacing: gap between tags over "
        "their size.\n"
        "target_type: aprilgrid\ntagCols: {}\ntagRows: {}\ntagSize: {:.9g}\ntagSpacing: {}\n"
        "family: {}\nfirst_id: {}\n",
        grid->first_id, grid->columns, grid->rows, grid->tag_size_m * printed_scale, grid->spacing,
        to_string(grid->family), grid->first_id);
  } else if (const auto* charuco = std::get_if<CharucoBoard>(&target)) {
    text = fmt::format(
        "# Squares, the top left one {}, a tag in every white one; ids in reading order. Metres.\n"
        "target_type: charuco\ncolumns: {}\nrows: {}\nsquare_m: {:.9g}\ntag_m: {:.9g}\nfamily: {}\n"
        "first_id: {}\n{}",
        charuco->first_white ? "white" : "black", charuco->columns, charuco->rows,
        charuco->square_m * printed_scale, charuco->tag_m * printed_scale,
        to_string(charuco->family), charuco->first_id,
        charuco->first_white ? "legacy: true\n" : "");
  } else if (const auto* chess = std::get_if<ChessboardSheet>(&target)) {
    text = fmt::format(
        "# Corners between squares, across and down. Metres.\n"
        "target_type: checkerboard\ninner_cols: {}\ninner_rows: {}\nsquare_m: {:.9g}\n",
        chess->inner_columns, chess->inner_rows, chess->square_m * printed_scale);
  }
  return measured + text;
}

}  // namespace

Result<void> save_target(const std::filesystem::path& file, const SheetTarget& target,
                         double printed_scale) {
  PENUMBRA_TRY(const std::string text, target_text(target, printed_scale));
  return write_text_file(file, text);
}

std::optional<double> printed_scale_of(const std::filesystem::path& file,
                                       const SheetTarget& target) {
  constexpr std::size_t kMaxBytes = 16'000'000;
  const Result<std::string> text = read_text_file(file, kMaxBytes);
  if (!text) return std::nullopt;
  double measured_mm = 100.0;
  if (text->starts_with(kMeasuredLine)) {
    const std::size_t end = std::min(text->find('\n'), text->size());
    const auto number = parse_number(
        trim(std::string_view(*text).substr(kMeasuredLine.size(), end - kMeasuredLine.size())));
    if (!number) return std::nullopt;
    measured_mm = *number;
  }
  const Result<std::string> made = target_text(target, measured_mm / 100.0);
  if (!made || *made != *text) return std::nullopt;
  return measured_mm / 100.0;
}

}  // namespace penumbra
