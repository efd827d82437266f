#include "calib/target/sheet_page.hpp"

#include <cairo-pdf.h>
#include <cairo-svg.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "core/image/image_file.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr double kPointsPerMetre = 72.0 / 0.0254;  // the unit of PDF and SVG is 1/72 inch
constexpr double kThinLine_m = 0.0002;
constexpr double kTextSize_m = 0.0026;
constexpr const char* kOriginText =
    "Origin: the centre of the board. x right, y up, z out of the paper.";

using Surface = std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)>;
using Context = std::unique_ptr<cairo_t, decltype(&cairo_destroy)>;

void draw_ruler(cairo_t* cr, double x, double y) {
  cairo_set_line_width(cr, kThinLine_m);
  cairo_move_to(cr, x, y);
  cairo_line_to(cr, x + kRulerLength, y);
  for (int mm = 0; mm <= 100; mm += 5) {
    const double tick = mm % 50 == 0 ? 0.003 : mm % 10 == 0 ? 0.002 : 0.001;
    cairo_move_to(cr, x + mm * 0.001, y);
    cairo_line_to(cr, x + mm * 0.001, y - tick);
  }
  cairo_stroke(cr);
}

void select_font(cairo_t* cr) {
  cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  cairo_set_font_size(cr, kTextSize_m);
}

// Returns the width of a text [m].
double width_of_text(cairo_t* cr, const std::string& text) {
  select_font(cr);
  cairo_text_extents_t extents;
  cairo_text_extents(cr, text.c_str(), &extents);
  return extents.x_advance;
}

void draw_text(cairo_t* cr, double x, double y, const std::string& text) {
  select_font(cr);
  cairo_move_to(cr, x, y);
  cairo_show_text(cr, text.c_str());
}

constexpr double kMarkLength = 0.003;      // [m] length of an origin mark beside the board
constexpr double kMinMarkLength = 0.0015;  // [m] minimum length if there is little room

// Draws a line from (x, y) to (x + dx, y + dy), with an arrow head for an axis.
void draw_mark(cairo_t* cr, double x, double y, double dx, double dy, bool axis) {
  constexpr double kHead = 0.0008;
  const double end_x = x + dx;
  const double end_y = y + dy;
  const double length = std::hypot(dx, dy);
  dx /= length;
  dy /= length;
  cairo_move_to(cr, x, y);
  cairo_line_to(cr, end_x, end_y);
  if (axis) {
    for (const double side : {-1.0, 1.0}) {
      cairo_move_to(cr, end_x, end_y);
      cairo_line_to(cr, end_x - kHead * (dx + side * dy), end_y - kHead * (dy - side * dx));
    }
  }
  cairo_stroke(cr);
}

// Marks the origin (x, y on the page) by lines between the board and the page's edges, where there
// is room, and by a cross if no tag overlaps it.
void draw_origin(cairo_t* cr, const Sheet& sheet, const PageSize& page, double x, double y) {
  constexpr double kGap = 0.001;  // distance to the board's margin [m]
  const double right = 0.5 * sheet.width + kGap;
  const double top = 0.5 * sheet.height + kGap;
  const double room_beside = 0.5 * page.width_m - kMargin - right;
  const double room_above = y - kMargin - top;
  cairo_set_line_width(cr, kThinLine_m);
  if (room_beside >= kMinMarkLength) {
    const double length = std::min(room_beside, kMarkLength);
    draw_mark(cr, x - right, y, -length, 0.0, false);
    draw_mark(cr, x + right, y, length, 0.0, true);
    draw_text(cr, x + right + 0.0008, y - 0.0012, "x");
  }
  if (room_above >= kMinMarkLength) {
    const double length = std::min(room_above, kMarkLength);
    draw_mark(cr, x, y + top, 0.0, length, false);
    draw_mark(cr, x, y - top, 0.0, -length, true);
    draw_text(cr, x + 0.0014, y - top - 0.0008, "y");
  }
  if (!sheet.free_at_origin) return;
  cairo_move_to(cr, x - kOriginCross_m, y);
  cairo_line_to(cr, x + kOriginCross_m, y);
  cairo_move_to(cr, x, y - kOriginCross_m);
  cairo_line_to(cr, x, y + kOriginCross_m);
  cairo_stroke(cr);
}

// Draws in metres from the page's top left.
void draw_page(cairo_t* cr, const Sheet& sheet, const PageSize& page) {
  const double width = page.width_m;
  const double height = page.height_m;
  const double centre_x = 0.5 * width;
  const double centre_y = 0.5 * (height - kFooter);
  cairo_set_source_rgb(cr, 0.0, 0.0, 0.0);
  sheet.draw(cr, centre_x, centre_y);
  draw_origin(cr, sheet, page, centre_x, centre_y);
  const double footer_y = height - kMargin - 0.002;
  const double ruler_x = std::min(kMargin + 0.004, width - kMargin - kRulerLength);
  draw_ruler(cr, ruler_x, footer_y);
  constexpr double kLine = 0.0045;
  draw_text(cr, ruler_x, footer_y - kLine, "measure this: 100 mm");
  const double text_x = ruler_x + kRulerLength + 0.006;
  const double room = width - kMargin - text_x;
  const std::string caption = sheet.caption + ". Print at 100 %, not fitted to the page.";
  if (width_of_text(cr, caption) <= room) draw_text(cr, text_x, footer_y, caption);
  if (width_of_text(cr, kOriginText) <= room) draw_text(cr, text_x, footer_y - kLine, kOriginText);
}

cairo_status_t append(void* to, const unsigned char* data, unsigned int length) {
  auto& all = *static_cast<std::vector<std::uint8_t>*>(to);
  all.insert(all.end(), data, data + length);
  return CAIRO_STATUS_SUCCESS;
}

// Draws into memory, because cairo does not report a full disk.
Result<std::vector<std::uint8_t>> vector_bytes(const Sheet& sheet, const PageSize& page,
                                               SheetFormat format) {
  std::vector<std::uint8_t> bytes;
  const double width = page.width_m * kPointsPerMetre;
  const double height = page.height_m * kPointsPerMetre;
  const bool pdf = format == SheetFormat::pdf;
  const Surface surface(pdf ? cairo_pdf_surface_create_for_stream(append, &bytes, width, height)
                            : cairo_svg_surface_create_for_stream(append, &bytes, width, height),
                        &cairo_surface_destroy);
  if (pdf) {
    cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_TITLE, sheet.caption.c_str());
    cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_CREATOR, "penumbra target");
    // Uses a fixed date for reproducible files.
    cairo_pdf_surface_set_metadata(surface.get(), CAIRO_PDF_METADATA_CREATE_DATE,
                                   "2000-01-01T00:00:00Z");
  } else {
    // Some versions of cairo otherwise write a size without a unit, which means pixels.
    cairo_svg_surface_set_document_unit(surface.get(), CAIRO_SVG_UNIT_PT);
  }
  const Context context(cairo_create(surface.get()), &cairo_destroy);
  cairo_scale(context.get(), kPointsPerMetre, kPointsPerMetre);
  draw_page(context.get(), sheet, page);
  cairo_show_page(context.get());
  cairo_surface_finish(surface.get());
  if (const cairo_status_t status = cairo_surface_status(surface.get());
      status != CAIRO_STATUS_SUCCESS) {
    return fail("cannot be drawn: {}", cairo_status_to_string(status));
  }
  return bytes;
}

Result<std::vector<std::uint8_t>> png_page(const Sheet& sheet, const PageSize& page) {
  constexpr double kMaxPixels = 1e8;       // limit for 600 dpi; larger pages get 300 dpi
  constexpr double kMaxSide_px = 32767.0;  // limit of cairo
  double per_metre = 600.0 / 0.0254;
  if (page.width_m * page.height_m * per_metre * per_metre > kMaxPixels) per_metre /= 2.0;
  const double across = std::ceil(page.width_m * per_metre);
  const double down = std::ceil(page.height_m * per_metre);
  if (across > kMaxSide_px || down > kMaxSide_px || across * down > 2.5 * kMaxPixels) {
    return fail("a PNG of {:.0f} x {:.0f} px is too large; name a .pdf or .svg", across, down);
  }
  const auto width = static_cast<int>(across);
  const auto height = static_cast<int>(down);
  // One byte of coverage per pixel, because only black is drawn.
  const Surface surface(cairo_image_surface_create(CAIRO_FORMAT_A8, width, height),
                        &cairo_surface_destroy);
  const Context context(cairo_create(surface.get()), &cairo_destroy);
  cairo_scale(context.get(), per_metre, per_metre);
  draw_page(context.get(), sheet, page);
  cairo_surface_flush(surface.get());
  if (const cairo_status_t status = cairo_status(context.get()); status != CAIRO_STATUS_SUCCESS) {
    return fail("cannot be drawn: {}", cairo_status_to_string(status));
  }
  const int stride = cairo_image_surface_get_stride(surface.get());
  unsigned char* pixels = cairo_image_surface_get_data(surface.get());
  for (std::ptrdiff_t i = 0; i < std::ptrdiff_t{stride} * height; ++i) {
    pixels[i] = static_cast<unsigned char>(255 - pixels[i]);
  }
  return grey_png({pixels, width, height, stride}, per_metre);
}

}  // namespace

Result<SheetFormat> sheet_format_of(const std::filesystem::path& file) {
  const std::string extension = lower_extension(file);
  if (extension.empty() || extension == ".pdf") return SheetFormat::pdf;
  if (extension == ".svg") return SheetFormat::svg;
  if (extension == ".png") return SheetFormat::png;
  return fail("{}: a sheet is a .pdf, .svg or .png; name one of them", file.string());
}

Result<std::vector<std::uint8_t>> page_bytes(const Sheet& sheet, const PageSize& page,
                                             SheetFormat format) {
  return format == SheetFormat::png ? png_page(sheet, page) : vector_bytes(sheet, page, format);
}

}  // namespace penumbra
