// Calibration targets: their points and what a detector recognises.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

enum class TargetKind { tags, chessboard, charuco };

// Board frame: that of the file (a tag map's table frame), else origin at the board's centre; x
// right, y up on the sheet, z out of the paper; metres.
struct Target {
  TargetKind kind = TargetKind::tags;
  // The measured corners. Tags: 4 each, in the order of TagMap and MappedTag::corners(). Chessboard
  // and charuco: the inner corners, row by row from the top left.
  std::vector<Eigen::Vector3d> points;
  // Pairs of points with a straight edge between black and white along the whole line between them.
  std::vector<std::pair<int, int>> edges;
  std::optional<TagMap> tags;  // tags, charuco: the markers
  int columns = 0;             // chessboard, charuco: inner corners across
  int rows = 0;                // ... and down
  double square_m = 0.0;       // chessboard, charuco
  // tags in a grid: a Kalibr sheet may have black squares that touch the tags at their corners.
  bool may_have_squares = false;
  std::string description;  // "6 x 6 tags of 30 mm"
};

// tags.yaml, Kalibr's aprilgrid.yaml (target_type: aprilgrid, tagCols, tagRows, tagSize,
// tagSpacing), chessboards (target_type: checkerboard with inner_cols, inner_rows, square_m, or
// Kalibr's targetCols, targetRows, rowSpacingMeters, colSpacingMeters), ChArUco boards as `penumbra
// target` writes them (target_type: charuco with columns, rows, square_m, tag_m, family or
// dictionary, optional first_id, legacy: true for boards of OpenCV before 4.6). Errors name file
// and field.
[[nodiscard]] Result<Target> load_target(const std::filesystem::path& file);

[[nodiscard]] Result<Target> tag_target(TagMap map);
// Inner corners, squares of square_m.
[[nodiscard]] Result<Target> chessboard_target(int inner_columns, int inner_rows, double square_m);
// `columns` x `rows` squares, the top left one black (or white: boards of OpenCV before 4.6 with an
// even number of rows), a tag of `tag_m` in every white one, ids counted in reading order from
// first_id.
struct CharucoBoard {
  int columns = 8;
  int rows = 6;
  double square_m = 0.03;
  double tag_m = 0.022;  // edge of the tag's black border
  TagFamily family = TagFamily::tag36h11;
  int first_id = 0;
  bool first_white = false;
};
[[nodiscard]] Result<Target> charuco_target(const CharucoBoard& board);
// Kalibr's order: id 0 at the bottom left, ids to the right, then up. The tags have a border of one
// cell and no black squares between them, unlike those that Kalibr prints.
struct AprilGrid {
  int columns = 6;
  int rows = 6;
  double tag_size_m = 0.03;
  double spacing = 0.3;  // gap between tags over their size
  TagFamily family = TagFamily::tag36h11;
  int first_id = 0;
};
[[nodiscard]] Result<TagMap> tag_map_of(const AprilGrid& grid);

// A tag in the table's plane. Fails if the family has no such id.
[[nodiscard]] Result<MappedTag> flat_tag(TagFamily family, int id, double size_m, double x_m,
                                         double y_m);

}  // namespace penumbra
