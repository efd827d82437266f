#include "calib/target/target.hpp"

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "core/text/yaml_fields.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

constexpr double kSmallest = 0.0005;  // [m] of a tag or a square
constexpr double kLargest = 2.0;      // [m]
constexpr int kMostAcross = 100;

Result<void> check_length(double metres, std::string_view what) {
  if (metres >= kSmallest && metres <= kLargest) return {};
  if (metres > kLargest && metres <= kLargest * 1000.0) {
    return fail("{} is {} m; lengths are metres: did you mean {}?", what, metres, metres / 1000.0);
  }
  return fail("{} is {} m; give metres, {} to {}", what, metres, kSmallest, kLargest);
}

Result<void> check_count(int count, std::string_view what) {
  if (count >= 2 && count <= kMostAcross) return {};
  return fail("{} is {}; give 2 to {}", what, count, kMostAcross);
}

void add_grid(Target& target) {
  for (int j = 0; j < target.rows; ++j) {
    for (int i = 0; i < target.columns; ++i) {
      const int here = j * target.columns + i;
      target.points.emplace_back((i - 0.5 * (target.columns - 1)) * target.square_m,
                                 (0.5 * (target.rows - 1) - j) * target.square_m, 0.0);
      if (i + 1 < target.columns) target.edges.emplace_back(here, here + 1);
      if (j + 1 < target.rows) target.edges.emplace_back(here, here + target.columns);
    }
  }
}

Result<Target> read_aprilgrid(const YamlFields& fields) {
  AprilGrid grid;
  PENUMBRA_TRY(const int columns, fields.integer("tagCols", "give the number of tags across"));
  PENUMBRA_TRY(const int rows, fields.integer("tagRows", "give the number of tags down"));
  PENUMBRA_TRY(const double size,
               fields.number("tagSize", "give the edge of a tag's black square in metres"));
  PENUMBRA_TRY(
      const double spacing,
      fields.number("tagSpacing", "give the gap between tags over their size, such as 0.3"));
  grid.columns = columns;
  grid.rows = rows;
  grid.tag_size_m = size;
  grid.spacing = spacing;
  for (const char* key : {"family", "tagFamily"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(const std::string family, fields.text(key, "name a family of tags"));
    const auto known = tag_family_from_string(family);
    if (!known) return fail("{}: {}", fields.place_of(key), unknown_tag_family(family));
    grid.family = *known;
    break;
  }
  // codeOffset is Kalibr's.
  for (const char* key : {"first_id", "codeOffset"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(const int first, fields.integer(key, "give the id of the bottom left tag"));
    grid.first_id = first;
    break;
  }
  Result<TagMap> map = tag_map_of(grid);
  if (!map) return fail_in(fields.place(), map.error());
  Result<Target> target = tag_target(std::move(*map));
  if (!target) return fail_in(fields.place(), target.error());
  target->may_have_squares = true;
  target->description =
      fmt::format("{} x {} tags of {:g} mm", grid.columns, grid.rows, grid.tag_size_m * 1e3);
  return target;
}

Result<Target> read_chessboard(const YamlFields& fields) {
  const bool kalibr = fields.has("targetCols");
  const char* columns_key = kalibr ? "targetCols" : "inner_cols";
  const char* rows_key = kalibr ? "targetRows" : "inner_rows";
  const char* square_key = kalibr ? "colSpacingMeters" : "square_m";
  PENUMBRA_TRY(const int columns,
               fields.integer(columns_key, "give the number of inner corners across"));
  PENUMBRA_TRY(const int rows, fields.integer(rows_key, "give the number of inner corners down"));
  PENUMBRA_TRY(const double square, fields.number(square_key, "give a square's edge in metres"));
  if (kalibr && fields.has("rowSpacingMeters")) {
    PENUMBRA_TRY(const double other, fields.number("rowSpacingMeters", "give a square's edge"));
    if (std::abs(other - square) > 1e-9) {
      return fail("{}: is {}, but colSpacingMeters is {}; the squares must be square",
                  fields.place_of("rowSpacingMeters"), other, square);
    }
  }
  Result<Target> target = chessboard_target(columns, rows, square);
  if (!target) return fail_in(fields.place(), target.error());
  return target;
}

Result<Target> read_charuco(const YamlFields& fields) {
  CharucoBoard board;
  PENUMBRA_TRY(const int columns, fields.integer("columns", "give the number of squares across"));
  PENUMBRA_TRY(const int rows, fields.integer("rows", "give the number of squares down"));
  PENUMBRA_TRY(const double square, fields.number("square_m", "give a square's edge in metres"));
  PENUMBRA_TRY(const double tag, fields.number("tag_m", "give the edge of a tag's black border"));
  const char* key = fields.has("dictionary") ? "dictionary" : "family";
  PENUMBRA_TRY(
      const std::string family,
      fields.text(key, "name a dictionary such as DICT_4X4_50, or a family such as tag36h11"));
  const auto known = tag_family_from_string(family);
  if (!known) return fail("{}: {}", fields.place_of(key), unknown_tag_family(family));
  board = {columns, rows, square, tag, *known, 0, false};
  if (fields.has("legacy")) {
    // What OpenCV calls its own boards before 4.6: their last row begins with a black square.
    PENUMBRA_TRY(const std::string legacy, fields.text("legacy", "give true or false"));
    if (legacy != "true" && legacy != "false")
      return fail("{}: is '{}'; give true or false", fields.place_of("legacy"), legacy);
    board.first_white = legacy == "true" && board.rows % 2 == 0;
  }
  if (fields.has("first_id")) {
    PENUMBRA_TRY(const int first, fields.integer("first_id", "give the id of the first tag"));
    board.first_id = first;
  }
  Result<Target> target = charuco_target(board);
  if (!target) return fail_in(fields.place(), target.error());
  return target;
}

}  // namespace

double Target::radius() const {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) middle += p;
  middle /= static_cast<double>(std::max<std::size_t>(points.size(), 1));
  double largest = 0.0;
  for (const Eigen::Vector3d& p : points) largest = std::max(largest, (p - middle).norm());
  return largest;
}

Result<Target> tag_target(TagMap map) {
  Target target;
  target.kind = TargetKind::tags;
  double smallest = kLargest;
  double largest = 0.0;
  for (const MappedTag& tag : map.tags()) {
    PENUMBRA_TRY_VOID(check_length(tag.size_m, fmt::format("size_m of tag {}", tag.id)));
    const int first = static_cast<int>(target.points.size());
    for (const Eigen::Vector3d& corner : tag.corners()) target.points.push_back(corner);
    for (int i = 0; i < 4; ++i) target.edges.emplace_back(first + i, first + (i + 1) % 4);
    smallest = std::min(smallest, tag.size_m);
    largest = std::max(largest, tag.size_m);
  }
  target.description = smallest == largest
                           ? fmt::format("{} tags of {:g} mm", map.tags().size(), smallest * 1e3)
                           : fmt::format("{} tags of {:g} to {:g} mm", map.tags().size(),
                                         smallest * 1e3, largest * 1e3);
  target.tags = std::move(map);
  return target;
}

Result<Target> chessboard_target(int inner_columns, int inner_rows, double square_m) {
  PENUMBRA_TRY_VOID(check_count(inner_columns, "the number of inner corners across"));
  PENUMBRA_TRY_VOID(check_count(inner_rows, "the number of inner corners down"));
  if (inner_columns < 3 || inner_rows < 3) {
    return fail("a chessboard of {} x {} inner corners; at least 3 x 3 can be found", inner_columns,
                inner_rows);
  }
  PENUMBRA_TRY_VOID(check_length(square_m, "the edge of a square"));
  Target target;
  target.kind = TargetKind::chessboard;
  target.columns = inner_columns;
  target.rows = inner_rows;
  target.square_m = square_m;
  add_grid(target);
  target.description = fmt::format("chessboard of {} x {} inner corners, squares of {:g} mm",
                                   inner_columns, inner_rows, square_m * 1e3);
  return target;
}

Result<Target> charuco_target(const CharucoBoard& board) {
  PENUMBRA_TRY_VOID(check_count(board.columns, "the number of squares across"));
  PENUMBRA_TRY_VOID(check_count(board.rows, "the number of squares down"));
  if (board.columns < 3 || board.rows < 3)
    return fail("a ChArUco board of {} x {} squares; give at least 3 x 3", board.columns,
                board.rows);
  PENUMBRA_TRY_VOID(check_length(board.square_m, "the edge of a square"));
  PENUMBRA_TRY_VOID(check_length(board.tag_m, "the edge of a tag"));
  PENUMBRA_TRY(const TagPattern pattern, TagPattern::make(board.family, board.first_id));
  if (pattern.total_width() != pattern.width_at_border() + 2) {
    return fail("{}: has data outside its border; a ChArUco board takes a family such as tag36h11",
                to_string(board.family));
  }
  // Half a cell of white on each side is what its border is told by.
  const double needed_m = board.tag_m * (pattern.width_at_border() + 1) / pattern.width_at_border();
  if (needed_m > board.square_m * (1.0 + 1e-9)) {
    return fail("a tag of {} m needs a square of {:.4f} m with its white margin, and it is {} m",
                board.tag_m, needed_m, board.square_m);
  }
  Target target;
  target.kind = TargetKind::charuco;
  target.columns = board.columns - 1;
  target.rows = board.rows - 1;
  target.square_m = board.square_m;
  add_grid(target);
  std::vector<MappedTag> tags;
  for (int j = 0; j < board.rows; ++j) {
    for (int i = 0; i < board.columns; ++i) {
      if ((i + j) % 2 == (board.first_white ? 1 : 0)) continue;  // black
      MappedTag tag;
      tag.id = board.first_id + static_cast<int>(tags.size());
      tag.family = board.family;
      tag.size_m = board.tag_m;
      tag.T_table_tag = {Eigen::Quaterniond::Identity(),
                         {(i - 0.5 * (board.columns - 1)) * board.square_m,
                          (0.5 * (board.rows - 1) - j) * board.square_m, 0.0}};
      PENUMBRA_TRY_VOID(TagPattern::make(tag.family, tag.id));
      tags.push_back(tag);
    }
  }
  PENUMBRA_TRY(TagMap map, TagMap::make(std::move(tags)));
  target.tags = std::move(map);
  target.description = fmt::format("ChArUco board of {} x {} squares of {:g} mm", board.columns,
                                   board.rows, board.square_m * 1e3);
  return target;
}

Result<TagMap> tag_map_of(const AprilGrid& grid) {
  if (grid.columns < 1 || grid.rows < 1 || grid.columns > kMostAcross || grid.rows > kMostAcross) {
    return fail("an aprilgrid of {} x {} tags; give 1 to {} of each", grid.columns, grid.rows,
                kMostAcross);
  }
  PENUMBRA_TRY_VOID(check_length(grid.tag_size_m, "tagSize"));
  if (!(grid.spacing > 0.0 && grid.spacing <= 10.0)) {
    return fail("tagSpacing is {}; give the gap between two tags over their size, such as 0.3",
                grid.spacing);
  }
  const double pitch = grid.tag_size_m * (1.0 + grid.spacing);
  std::vector<MappedTag> tags;
  for (int j = 0; j < grid.rows; ++j) {
    for (int i = 0; i < grid.columns; ++i) {
      MappedTag tag;
      tag.id = grid.first_id + j * grid.columns + i;
      tag.family = grid.family;
      tag.size_m = grid.tag_size_m;
      tag.T_table_tag = {
          Eigen::Quaterniond::Identity(),
          {(i - 0.5 * (grid.columns - 1)) * pitch, (j - 0.5 * (grid.rows - 1)) * pitch, 0.0}};
      PENUMBRA_TRY_VOID(TagPattern::make(tag.family, tag.id));
      tags.push_back(tag);
    }
  }
  return TagMap::make(std::move(tags));
}

Result<Target> load_target(const std::filesystem::path& file) {
  PENUMBRA_TRY(const YAML::Node root, load_yaml_map(file));
  try {
    const YamlFields fields(root, file.string());
    if (!fields.has("target_type") && fields.has("tags")) {
      PENUMBRA_TRY(TagMap map, load_tag_map(file));
      Result<Target> target = tag_target(std::move(map));
      if (!target) return fail_in(file.string(), target.error());
      return target;
    }
    constexpr const char* kRemedy =
        "name aprilgrid, checkerboard or charuco, or give a tags.yaml with its list `tags`";
    PENUMBRA_TRY(const std::string type, fields.text("target_type", kRemedy));
    if (type == "aprilgrid") return read_aprilgrid(fields);
    if (type == "checkerboard" || type == "chessboard") return read_chessboard(fields);
    if (type == "charuco") return read_charuco(fields);
    return fail("{}: '{}' is not known; {}", fields.place_of("target_type"), type, kRemedy);
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as a target ({}); correct the file", file.string(),
                error.what());
  }
}

}  // namespace penumbra
