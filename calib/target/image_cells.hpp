// Divides an image into equal cells and names them.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <string>

namespace penumbra {

struct ImageCells {
  int columns = 3;
  int rows = 3;
  int width = 0;   // image width [px]
  int height = 0;  // image height [px]

  // Returns the index (row by row) of the cell that contains, or is nearest to, the pixel.
  [[nodiscard]] std::size_t at(const Eigen::Vector2d& pixel) const {
    const int i = std::clamp(static_cast<int>(columns * pixel.x() / width), 0, columns - 1);
    const int j = std::clamp(static_cast<int>(rows * pixel.y() / height), 0, rows - 1);
    return static_cast<std::size_t>(j * columns + i);
  }
  // Returns the centre of a cell [px].
  [[nodiscard]] Eigen::Vector2d middle(std::size_t cell) const {
    const auto i = static_cast<double>(cell % static_cast<std::size_t>(columns));
    const auto j = static_cast<double>(cell / static_cast<std::size_t>(columns));
    return {(i + 0.5) * width / columns - 0.5, (j + 0.5) * height / rows - 0.5};
  }
  [[nodiscard]] std::size_t count() const { return static_cast<std::size_t>(columns * rows); }
  // Returns "top left", "top", "left", ..., or "middle" for cells away from the border.
  [[nodiscard]] std::string name(std::size_t cell) const {
    const int i = static_cast<int>(cell) % columns;
    const int j = static_cast<int>(cell) / columns;
    const std::string vertical = j == 0 ? "top" : j == rows - 1 ? "bottom" : "";
    const std::string horizontal = i == 0 ? "left" : i == columns - 1 ? "right" : "";
    if (vertical.empty() && horizontal.empty()) return "middle";
    return vertical + (vertical.empty() || horizontal.empty() ? "" : " ") + horizontal;
  }
};

}  // namespace penumbra
