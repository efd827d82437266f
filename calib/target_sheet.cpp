#include "calib/target_sheet.hpp"

#include <cairo-pdf.h>
#include <cairo.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <cmath>
#include <memory>

#include "tracking/tag_pattern.hpp"

namespace penumbra {
namespace {

constexpr double kPointsPerMetre = 72.0 / 0.0254;  // PDF's unit is 1/72 inch
constexpr double kMargin = 0.006;                  // [m] that common printers leave white
constexpr double kRulerLength = 0.100;             // [m]
constexpr double kFooter = 0.012;                  // [m] below the board for ruler and text

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
  const Result<TagPattern> pattern = TagPattern::make(board.family, board.first_id);
  if (!pattern) return tl::unexpected(pattern.error());
  const double printed = board.tag_size_m * pattern->total_width() / pattern->width_at_border();
  if (!(board.pitch_m >= printed * (1.0 - 1e-9)) || !std::isfinite(board.pitch_m)) {
    return fail("pitch {} m: tags of {} m need {:.4f} m each with their white margin",
                board.pitch_m, board.tag_size_m, printed);
  }
  return BoardExtent{board.pitch_m * (board.columns - 1) + printed,
                     board.pitch_m * (board.rows - 1) + printed};
}

// The page as it must lie for the board.
Result<PageSize> turned_page(const TagBoard& board, const PageSize& page) {
  const Result<BoardExtent> extent = extent_of(board);
  if (!extent) return tl::unexpected(extent.error());
  const double needed_width = extent->width + 2.0 * kMargin;
  const double needed_height = extent->height + 2.0 * kMargin + kFooter;
  double width = page.width_m;
  double height = page.height_m;
  if (needed_width > width || needed_height > height) std::swap(width, height);
  if (needed_width > width || needed_height > height) {
    return fail(
        "the board needs {:.0f} x {:.0f} mm with its margins and does not fit on a page of {:.0f} "
        "x {:.0f} mm; use a larger --page or smaller tags",
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

void draw_ruler(cairo_t* cr, double x, double y) {
  cairo_set_line_width(cr, 0.0002);
  cairo_move_to(cr, x, y);
  cairo_line_to(cr, x + kRulerLength, y);
  for (int mm = 0; mm <= 100; mm += 5) {
    const double tick = mm % 50 == 0 ? 0.003 : mm % 10 == 0 ? 0.002 : 0.001;
    cairo_move_to(cr, x + mm * 0.001, y);
    cairo_line_to(cr, x + mm * 0.001, y - tick);
  }
  cairo_stroke(cr);
}

void draw_text(cairo_t* cr, double x, double y, const std::string& text) {
  cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  cairo_set_font_size(cr, 0.0026);
  cairo_move_to(cr, x, y);
  cairo_show_text(cr, text.c_str());
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
  if (const Result<BoardExtent> extent = extent_of(board); !extent)
    return tl::unexpected(extent.error());
  if (!(printed_scale >= 0.5 && printed_scale <= 2.0)) {
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
      if (const Result<TagPattern> pattern = TagPattern::make(tag.family, tag.id); !pattern)
        return tl::unexpected(pattern.error());
      tag.size_m = board.tag_size_m * printed_scale;
      tag.T_table_tag = {Eigen::Quaterniond::Identity(),
                         {(column - 0.5 * (board.columns - 1)) * board.pitch_m * printed_scale,
                          (0.5 * (board.rows - 1) - row) * board.pitch_m * printed_scale, 0.0}};
      tags.push_back(tag);
    }
  }
  return TagMap::make(std::move(tags));
}

Result<void> check_fits(const TagBoard& board, const PageSize& page) {
  const Result<PageSize> turned = turned_page(board, page);
  if (!turned) return tl::unexpected(turned.error());
  return {};
}

Result<void> write_tag_board(const std::filesystem::path& pdf, const TagBoard& board,
                             const PageSize& page) {
  const Result<PageSize> turned = turned_page(board, page);
  if (!turned) return tl::unexpected(turned.error());
  const Result<TagMap> map = tag_map_of(board);
  if (!map) return tl::unexpected(map.error());
  const double width = turned->width_m;
  const double height = turned->height_m;

  const std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)> surface(
      cairo_pdf_surface_create(pdf.c_str(), width * kPointsPerMetre, height * kPointsPerMetre),
      &cairo_surface_destroy);
  const std::unique_ptr<cairo_t, decltype(&cairo_destroy)> context(cairo_create(surface.get()),
                                                                   &cairo_destroy);
  cairo_t* cr = context.get();
  cairo_scale(cr, kPointsPerMetre, kPointsPerMetre);
  cairo_set_source_rgb(cr, 0.0, 0.0, 0.0);

  const double centre_x = 0.5 * width;
  const double centre_y = 0.5 * (height - kFooter);
  for (const MappedTag& tag : map->tags()) {
    const Result<TagPattern> pattern = TagPattern::make(tag.family, tag.id);
    if (!pattern) return tl::unexpected(pattern.error());
    const Eigen::Vector3d& p_table = tag.T_table_tag.translation();
    draw_tag(cr, *pattern, centre_x + p_table.x(), centre_y - p_table.y(), tag.size_m);
  }
  const double footer_y = height - kMargin - 0.002;
  const double ruler_x = std::min(kMargin + 0.004, width - kRulerLength);
  draw_ruler(cr, ruler_x, footer_y);
  draw_text(cr, ruler_x, footer_y - 0.0045, "measure this: 100 mm");
  if (width > 0.25) {
    draw_text(cr, ruler_x + kRulerLength + 0.006, footer_y,
              fmt::format("{} ids {} to {}, black squares {:g} mm, pitch {:g} mm. Print at 100 %, "
                          "not fitted to the page.",
                          to_string(board.family), board.first_id,
                          board.first_id + board.columns * board.rows - 1, board.tag_size_m * 1e3,
                          board.pitch_m * 1e3));
  }
  cairo_show_page(cr);
  cairo_surface_finish(surface.get());
  if (const cairo_status_t status = cairo_surface_status(surface.get());
      status != CAIRO_STATUS_SUCCESS) {
    return fail("{}: cannot be written: {}; choose a place that can", pdf.string(),
                cairo_status_to_string(status));
  }
  return {};
}

}  // namespace penumbra
