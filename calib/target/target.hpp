// Calibration targets: their points, tags and straight edges.
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

// Coordinates are in the board frame [m]: for a tag map its table frame; otherwise the origin is
// the board's centre, x right, y up on the sheet, z out of the paper.
struct Target {
  TargetKind kind = TargetKind::tags;
  // The corners to detect. Tags: 4 per tag, in the order of TagMap and MappedTag::corners().
  // Chessboard and charuco: the inner corners, row by row from the top left.
  std::vector<Eigen::Vector3d> points;
  // Pairs of points that are joined by a straight edge between black and white.
  std::vector<std::pair<int, int>> edges;
  std::optional<TagMap> tags;  // kinds tags and charuco: their tags
  int columns = 0;             // chessboard, charuco: inner corners across
  int rows = 0;                // inner corners down
  double square_m = 0.0;       // chessboard, charuco
  // True for a grid of tags: Kalibr's sheets have black squares that touch the tags' corners.
  bool may_have_squares = false;
  std::string description;  // "6 x 6 tags of 30 mm"
};

// Reads a target file. Errors name file and field.
// - tags.yaml
// - Kalibr's aprilgrid.yaml: target_type: aprilgrid, tagCols, tagRows, tagSize, tagSpacing.
// - Chessboard: target_type: checkerboard with inner_cols, inner_rows, square_m, or Kalibr's
//   targetCols, targetRows, rowSpacingMeters, colSpacingMeters.
// - ChArUco: target_type: charuco with columns, rows, square_m, tag_m, family or dictionary;
//   optional first_id, legacy (true for boards of OpenCV before 4.6).
[[nodiscard]] Result<Target> load_target(const std::filesystem::path& file);

[[nodiscard]] Result<Target> tag_target(TagMap map);
// Makes a chessboard with `inner_columns` x `inner_rows` corners between squares of `square_m`.
[[nodiscard]] Result<Target> chessboard_target(int inner_columns, int inner_rows, double square_m);
// `columns` x `rows` squares with a tag in each white square; ids count from first_id in reading
// order. The top left square is black, or white if first_white is set (boards of OpenCV before 4.6
// with an even number of rows).
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
// Grid with Kalibr's order of ids: from the bottom left to the right, then up. Unlike Kalibr's
// sheets, the tags have a border of one cell and no black squares between them.
struct AprilGrid {
  int columns = 6;
  int rows = 6;
  double tag_size_m = 0.03;
  double spacing = 0.3;  // gap between tags / tag size
  TagFamily family = TagFamily::tag36h11;
  int first_id = 0;
};
[[nodiscard]] Result<TagMap> tag_map_of(const AprilGrid& grid);
// Returns the default grid of a family: a spacing for the white margins, and tags that are not
// wider with it than those of the default family.
[[nodiscard]] Result<AprilGrid> april_grid_of(TagFamily family, std::optional<double> size_m = {},
                                              std::optional<double> spacing = {});

// Returns a tag in the table's plane. Fails if the family has no such id.
[[nodiscard]] Result<MappedTag> flat_tag(TagFamily family, int id, double size_m, double x_m,
                                         double y_m);

}  // namespace penumbra
