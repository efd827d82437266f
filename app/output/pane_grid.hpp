// Arranges images of one size in one image, each below its caption.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace penumbra {

struct GridLayout {
  int columns = 1;
  int rows = 1;
  friend bool operator==(const GridLayout&, const GridLayout&) = default;
};
// One to three panes form one row. More panes form the fewest rows of four or fewer: 4 as 2 x 2, 5
// and 6 as 3 x 2, 7 and 8 as 4 x 2. `panes` > 0.
[[nodiscard]] GridLayout grid_layout(int panes);

struct GridSize {
  int width = 0, height = 0;  // [px], both even, as video encoders require
};
// Returns the size of the grid with captions. All sizes are in [px].
[[nodiscard]] GridSize grid_size(int pane_width, int pane_height, int panes);

// The captions are in a band above each pane and do not cover it.
class PaneGrid {
 public:
  // The panes' size [px], > 0; one caption per pane, at least one.
  PaneGrid(int pane_width, int pane_height, const std::vector<std::string>& captions);

  // Size of the grid [px].
  [[nodiscard]] int width() const { return size_.width; }
  [[nodiscard]] int height() const { return size_.height; }
  struct Corner {
    int x = 0, y = 0;
  };
  // Position of the pane's top left pixel.
  [[nodiscard]] Corner corner_of(std::size_t pane) const;
  // `rgba`: RGBA8 of the pane's size, rows top to bottom.
  void put(std::size_t pane, std::span<const std::uint8_t> rgba);
  // The grid, width * height * 4 bytes.
  [[nodiscard]] std::span<const std::uint8_t> rgba() const { return rgba_; }

 private:
  void draw_captions(const std::vector<std::string>& captions);

  int pane_width_;
  int pane_height_;
  int caption_height_;
  GridLayout layout_;
  GridSize size_;
  std::vector<std::uint8_t> rgba_;
};

}  // namespace penumbra
