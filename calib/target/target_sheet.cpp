#include "calib/target/target_sheet.hpp"

#include <cairo.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "calib/target/sheet_page.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

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

// Rotates the page by 90 degrees if the sheet fits only then.
Result<PageSize> rotated_page(const Sheet& sheet, const PageSize& page) {
  const double needed_width = std::max(sheet.width, kRulerLength) + 2.0 * kMargin;
  const double needed_height = sheet.height + 2.0 * kMargin + kFooter;
  double width = page.width_m;
  double height = page.height_m;
  if (needed_width > width || needed_height > height) std::swap(width, height);
  if (needed_width > width || needed_height > height) {
    return fail(
        "the board needs {:.0f} x {:.0f} mm with its margins and the 100 mm ruler, and does not "
        "fit on a page of {:.0f} x {:.0f} mm; use a larger --page or a smaller board",
        needed_width * 1e3, needed_height * 1e3, page.width_m * 1e3, page.height_m * 1e3);
  }
  return PageSize{width, height};
}

void draw_tag(cairo_t* cr, const TagPattern& pattern, double centre_x, double centre_y,
              double size) {
  const double cell = size / pattern.width_at_border();
  const double half = 0.5 * cell * pattern.total_width();
  // Fills all runs of black cells as one path, which avoids hairlines between them.
  for (int j = 0; j < pattern.total_width(); ++j) {
    for (int i = 0; i < pattern.total_width();) {
      if (pattern.white(i, j)) {
        ++i;
        continue;
      }
      const int begin = i;
      while (i < pattern.total_width() && !pattern.white(i, j)) ++i;
      // The page's y axis points down, the tag's j up.
      cairo_rectangle(cr, centre_x - half + cell * begin, centre_y + half - cell * (j + 1),
                      cell * (i - begin), cell);
    }
  }
  cairo_fill(cr);
}

// Draws the squares with (i + j) % 2 == first, centred, as one path, which avoids hairlines.
void draw_squares(cairo_t* cr, int columns, int rows, double square, int first, double centre_x,
                  double centre_y) {
  for (int j = 0; j < rows; ++j) {
    for (int i = (j + first) % 2; i < columns; i += 2) {
      cairo_rectangle(cr, centre_x + (i - 0.5 * columns) * square,
                      centre_y + (j - 0.5 * rows) * square, square, square);
    }
  }
  cairo_fill(cr);
}

void draw_tags(cairo_t* cr, const TagMap& map, double centre_x, double centre_y) {
  for (const MappedTag& tag : map.tags()) {
    const Result<TagPattern> pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) continue;  // can't happen: the map has only known tags
    const Eigen::Vector3d& p_table = tag.T_table_tag.translation();
    draw_tag(cr, *pattern, centre_x + p_table.x(), centre_y - p_table.y(), tag.size_m);
  }
}

// Returns true if a small cross at the origin overlaps no tag (`printed_m` wide with its margin).
bool is_free_at_origin(const TagMap& map, double printed_m) {
  return std::ranges::all_of(map.tags(), [&](const MappedTag& tag) {
    const double away = tag.T_table_tag.translation().head<2>().cwiseAbs().maxCoeff();
    return away - 0.5 * printed_m >= kOriginCross_m + kOriginGap_m;
  });
}

// `printed_m`: width of a tag with its white margin.
Sheet sheet_of_tags(double width, double height, TagMap map, std::string caption,
                    double printed_m) {
  const bool free = is_free_at_origin(map, printed_m);
  return {width, height,
          [map = std::move(map)](cairo_t* cr, double x, double y) { draw_tags(cr, map, x, y); },
          std::move(caption), free};
}

Result<Sheet> sheet_of(const TagBoard& board) {
  PENUMBRA_TRY(const BoardExtent extent, extent_of(board));
  PENUMBRA_TRY(TagMap map, tag_map_of(board));
  return sheet_of_tags(
      extent.width, extent.height, std::move(map),
      fmt::format("{} ids {} to {}, black squares {:g} mm, pitch {:g} mm", to_string(board.family),
                  board.first_id, board.first_id + board.columns * board.rows - 1,
                  board.tag_size_m * 1e3, board.pitch_m * 1e3),
      extent.width - board.pitch_m * (board.columns - 1));
}

Result<Sheet> sheet_of(const AprilGrid& grid) {
  PENUMBRA_TRY(TagMap map, tag_map_of(grid));
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(grid.family, grid.first_id));
  const double pitch = grid.tag_size_m * (1.0 + grid.spacing);
  const double printed = grid.tag_size_m * pattern.total_width() / pattern.width_at_border();
  if (!(pitch >= printed * (1.0 - 1e-9))) {
    return fail("spacing {}: tags need {:.3f} of their size between them for their white margins",
                grid.spacing, printed / grid.tag_size_m - 1.0);
  }
  return sheet_of_tags(
      pitch * (grid.columns - 1) + printed, pitch * (grid.rows - 1) + printed, std::move(map),
      fmt::format("{} x {} {}, tagSize {:g} mm, tagSpacing {:g}", grid.columns, grid.rows,
                  to_string(grid.family), grid.tag_size_m * 1e3, grid.spacing),
      printed);
}

Result<Sheet> sheet_of(const CharucoBoard& board) {
  auto target = charuco_target(board);
  if (!target) return tl::unexpected(target.error());
  return Sheet{board.columns * board.square_m, board.rows * board.square_m,
               [board, map = std::move(*target->tags)](cairo_t* cr, double x, double y) {
                 draw_squares(cr, board.columns, board.rows, board.square_m,
                              board.first_white ? 1 : 0, x, y);
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
  const int rows = board.inner_rows + 1;  // the white margin adds half a square on each side
  return Sheet{(columns + 1) * board.square_m, (rows + 1) * board.square_m,
               [=](cairo_t* cr, double x, double y) {
                 draw_squares(cr, columns, rows, board.square_m, 0, x, y);
               },
               fmt::format("{} x {} inner corners, squares {:g} mm", board.inner_columns,
                           board.inner_rows, board.square_m * 1e3),
               false};
}

Result<Sheet> sheet_of(const SheetTarget& target) {
  return std::visit([](const auto& board) { return sheet_of(board); }, target);
}

constexpr std::string_view kMeasuredLine = "# The sheet's 100 mm ruler, on paper [mm]: ";

// Returns a comment line about the scale, or "" for a sheet at true scale.
std::string measured_line(double printed_scale) {
  if (printed_scale == 1.0) return {};
  return fmt::format("{}{:.10g}\n", kMeasuredLine, 100.0 * printed_scale);
}

Result<std::string> target_text(const SheetTarget& target, double printed_scale) {
  PENUMBRA_TRY_VOID(check_printed_scale(printed_scale));
  const std::string measured = measured_line(printed_scale);
  if (const auto* tags = std::get_if<TagBoard>(&target)) {
    PENUMBRA_TRY(const TagMap map, tag_map_of(*tags, printed_scale));
    return measured + tag_map_text(map);
  }
  // Rounds lengths to the nanometre, so that 0.03 m * 0.992 is not 0.029759999999999998.
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

Result<PageSize> page_size_from_string(std::string_view name) {
  const std::string lower = in_lower_case(std::string(name));
  for (const NamedPage& page : kPages) {
    if (page.name == lower) return PageSize{page.width_mm * 1e-3, page.height_mm * 1e-3};
  }
  if (const std::size_t cross = lower.find('x'); cross != std::string::npos) {
    const auto width = parse_number(std::string_view(lower).substr(0, cross));
    const auto height = parse_number(std::string_view(lower).substr(cross + 1));
    const auto is_side = [](std::optional<double> mm) {
      return mm && *mm >= 20.0 && *mm <= 5000.0;
    };
    if (is_side(width) && is_side(height)) return PageSize{*width * 1e-3, *height * 1e-3};
  }
  std::array<std::string_view, kPages.size()> known;
  std::ranges::transform(kPages, known.begin(), &NamedPage::name);
  return fail("page size '{}' is not known; use {} or WIDTHxHEIGHT in millimetres (20 to 5000)",
              name, fmt::join(known, ", "));
}

Result<void> check_fits(const SheetTarget& target, const PageSize& page) {
  PENUMBRA_TRY(const Sheet sheet, sheet_of(target));
  PENUMBRA_TRY_VOID(rotated_page(sheet, page));
  return {};
}

Result<void> write_sheet(const std::filesystem::path& file, const SheetTarget& target,
                         const PageSize& page, SheetFormat format) {
  PENUMBRA_TRY(const Sheet sheet, sheet_of(target));
  PENUMBRA_TRY(const PageSize turned, rotated_page(sheet, page));
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes,
               with_place(file.string(), page_bytes(sheet, turned, format)));
  return write_file(file, bytes);
}

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
  const Result<std::string> expected = target_text(target, measured_mm / 100.0);
  if (!expected || *expected != *text) return std::nullopt;
  return measured_mm / 100.0;
}

}  // namespace penumbra
