#include "app/output/pane_grid.hpp"

#include <cairo.h>

#include <algorithm>
#include <memory>

#include "core/assert.hpp"

namespace penumbra {
namespace {

constexpr int kGap = 4;                    // between panes [px]
constexpr std::uint8_t kBackground = 24;   // grey level of captions, gaps and empty panes
constexpr double kTextOpacity = 0.94;      // opacity of the white letters
constexpr int kMinCaption_px = 20;         // [px]
constexpr int kPaneHeightPerCaption = 16;  // ratio of pane height to caption height
constexpr double kFontSizeRatio = 0.66;    // ratio of font size to caption height

int even(int length) {
  return length + length % 2;
}

int caption_height_of(int pane_height) {
  return even(std::max(kMinCaption_px, pane_height / kPaneHeightPerCaption));
}

}  // namespace

GridLayout grid_layout(int panes) {
  PENUMBRA_ASSERT(panes > 0);
  if (panes <= 3) return {panes, 1};
  constexpr int kMaxColumns = 4;
  const int rows = std::max(2, (panes + kMaxColumns - 1) / kMaxColumns);
  return {(panes + rows - 1) / rows, rows};
}

GridSize grid_size(int pane_width, int pane_height, int panes) {
  const GridLayout layout = grid_layout(panes);
  return {even(layout.columns * pane_width + (layout.columns - 1) * kGap),
          even(layout.rows * (caption_height_of(pane_height) + pane_height) +
               (layout.rows - 1) * kGap)};
}

PaneGrid::PaneGrid(int pane_width, int pane_height, const std::vector<std::string>& captions)
    : pane_width_(pane_width),
      pane_height_(pane_height),
      caption_height_(caption_height_of(pane_height)),
      layout_(grid_layout(static_cast<int>(captions.size()))),
      size_(grid_size(pane_width, pane_height, static_cast<int>(captions.size()))) {
  PENUMBRA_ASSERT(pane_width > 0 && pane_height > 0);
  rgba_.assign(std::size_t{4} * static_cast<std::size_t>(size_.width) *
                   static_cast<std::size_t>(size_.height),
               kBackground);
  for (std::size_t i = 3; i < rgba_.size(); i += 4) rgba_[i] = 255;
  draw_captions(captions);
}

PaneGrid::Corner PaneGrid::corner_of(std::size_t pane) const {
  const int column = static_cast<int>(pane) % layout_.columns;
  const int row = static_cast<int>(pane) / layout_.columns;
  PENUMBRA_ASSERT(row < layout_.rows);
  return {column * (pane_width_ + kGap),
          row * (caption_height_ + pane_height_ + kGap) + caption_height_};
}

void PaneGrid::draw_captions(const std::vector<std::string>& captions) {
  const std::unique_ptr<cairo_surface_t, void (*)(cairo_surface_t*)> surface(
      cairo_image_surface_create(CAIRO_FORMAT_A8, pane_width_, caption_height_),
      cairo_surface_destroy);
  const std::unique_ptr<cairo_t, void (*)(cairo_t*)> cairo(cairo_create(surface.get()),
                                                           cairo_destroy);
  cairo_select_font_face(cairo.get(), "sans-serif", CAIRO_FONT_SLANT_NORMAL,
                         CAIRO_FONT_WEIGHT_BOLD);
  for (std::size_t pane = 0; pane < captions.size(); ++pane) {
    cairo_set_operator(cairo.get(), CAIRO_OPERATOR_CLEAR);
    cairo_paint(cairo.get());
    cairo_set_operator(cairo.get(), CAIRO_OPERATOR_OVER);
    cairo_set_source_rgba(cairo.get(), 1.0, 1.0, 1.0, kTextOpacity);
    cairo_set_font_size(cairo.get(), kFontSizeRatio * caption_height_);
    cairo_text_extents_t extents;
    cairo_text_extents(cairo.get(), captions[pane].c_str(), &extents);
    // Shrinks a caption that is too long for the pane.
    const double shrink = 0.96 * pane_width_ / std::max(1.0, extents.width);
    if (shrink < 1.0) {
      cairo_set_font_size(cairo.get(), shrink * kFontSizeRatio * caption_height_);
      cairo_text_extents(cairo.get(), captions[pane].c_str(), &extents);
    }
    cairo_move_to(cairo.get(), 0.5 * (pane_width_ - extents.width) - extents.x_bearing,
                  0.74 * caption_height_);
    cairo_show_text(cairo.get(), captions[pane].c_str());
    cairo_surface_flush(surface.get());

    const Corner corner = corner_of(pane);
    const unsigned char* letters = cairo_image_surface_get_data(surface.get());
    const int stride = cairo_image_surface_get_stride(surface.get());
    PENUMBRA_ASSERT(letters != nullptr);
    for (int y = 0; y < caption_height_; ++y) {
      for (int x = 0; x < pane_width_; ++x) {
        const int ink = letters[y * stride + x];
        const auto level = static_cast<std::uint8_t>(kBackground + (255 - kBackground) * ink / 255);
        const auto at = std::size_t{4} * (static_cast<std::size_t>(corner.y - caption_height_ + y) *
                                              static_cast<std::size_t>(size_.width) +
                                          static_cast<std::size_t>(corner.x + x));
        std::fill_n(rgba_.begin() + static_cast<std::ptrdiff_t>(at), 3, level);
      }
    }
  }
}

void PaneGrid::put(std::size_t pane, std::span<const std::uint8_t> rgba) {
  const std::size_t row = std::size_t{4} * static_cast<std::size_t>(pane_width_);
  PENUMBRA_ASSERT(rgba.size() == row * static_cast<std::size_t>(pane_height_));
  const Corner corner = corner_of(pane);
  for (std::size_t y = 0; y < static_cast<std::size_t>(pane_height_); ++y) {
    const auto at = std::size_t{4} * ((static_cast<std::size_t>(corner.y) + y) *
                                          static_cast<std::size_t>(size_.width) +
                                      static_cast<std::size_t>(corner.x));
    std::ranges::copy(rgba.subspan(y * row, row), rgba_.begin() + static_cast<std::ptrdiff_t>(at));
  }
}

}  // namespace penumbra
