#include "calib/target/target.hpp"

#include <algorithm>
#include <cmath>

#include "calib/target/tag_board.hpp"
#include "core/propagate.hpp"
#include "core/text/yaml_fields.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {
namespace {

constexpr double kMinLength_m = 0.0005;  // [m] edge of a tag or a square
constexpr double kMaxLength_m = 2.0;     // [m] edge of a tag or a square
constexpr int kMaxPerSide = 100;

Result<void> check_length(double metres, std::string_view what) {
  if (metres >= kMinLength_m && metres <= kMaxLength_m) return {};
  if (metres > kMaxLength_m && metres <= kMaxLength_m * 1000.0) {
    return fail("{} is {} m; lengths are metres: did you mean {}?", what, metres, metres / 1000.0);
  }
  return fail("{} is {} m; give metres, {} to {}", what, metres, kMinLength_m, kMaxLength_m);
}

Result<void> check_count(int count, std::string_view what) {
  if (count >= 2 && count <= kMaxPerSide) return {};
  return fail("{} is {}; give 2 to {}", what, count, kMaxPerSide);
}

void add_grid(Target& target) {
  for (int j = 0; j < target.rows; ++j) {
    for (int i = 0; i < target.columns; ++i) {
      const int index = j * target.columns + i;
      target.points.emplace_back((i - 0.5 * (target.columns - 1)) * target.square_m,
                                 (0.5 * (target.rows - 1) - j) * target.square_m, 0.0);
      if (i + 1 < target.columns) target.edges.emplace_back(index, index + 1);
      if (j + 1 < target.rows) target.edges.emplace_back(index, index + target.columns);
    }
  }
}

Result<TagFamily> read_family(const YamlFields& fields, const char* key, const char* remedy) {
  PENUMBRA_TRY(const std::string name, fields.text(key, remedy));
  const auto family = tag_family_from_string(name);
  if (!family) return fail("{}: {}", fields.place_of(key), unknown_tag_family(name));
  return *family;
}

Result<Target> read_aprilgrid(const YamlFields& fields) {
  AprilGrid grid;
  PENUMBRA_TRY(grid.columns, fields.integer("tagCols", "give the number of tags across"));
  PENUMBRA_TRY(grid.rows, fields.integer("tagRows", "give the number of tags down"));
  PENUMBRA_TRY(grid.tag_size_m,
               fields.number("tagSize", "give the edge of a tag's black square in metres"));
  PENUMBRA_TRY(
      grid.spacing,
      fields.number("tagSpacing", "give the gap between tags over their size, such as 0.3"));
  for (const char* key : {"family", "tagFamily"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(grid.family, read_family(fields, key, "name a family of tags"));
    break;
  }
  // codeOffset is Kalibr's key.
  for (const char* key : {"first_id", "codeOffset"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(grid.first_id, fields.integer(key, "give the id of the bottom left tag"));
    break;
  }
  PENUMBRA_TRY(Target target, with_place(fields.place(), tag_map_of(grid).and_then(tag_target)));
  target.may_have_squares = true;
  target.description =
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
    PENUMBRA_TRY(const double row_m, fields.number("rowSpacingMeters", "give a square's edge"));
    if (std::abs(row_m - square) > 1e-9) {
      return fail("{}: is {}, but colSpacingMeters is {}; the squares must be square",
                  fields.place_of("rowSpacingMeters"), row_m, square);
    }
  }
  return with_place(fields.place(), chessboard_target(columns, rows, square));
}

Result<Target> read_charuco(const YamlFields& fields) {
  CharucoBoard board;
  PENUMBRA_TRY(board.columns, fields.integer("columns", "give the number of squares across"));
  PENUMBRA_TRY(board.rows, fields.integer("rows", "give the number of squares down"));
  PENUMBRA_TRY(board.square_m, fields.number("square_m", "give a square's edge in metres"));
  PENUMBRA_TRY(board.tag_m, fields.number("tag_m", "give the edge of a tag's black border"));
  PENUMBRA_TRY(board.family,
               read_family(fields, fields.has("dictionary") ? "dictionary" : "family",
                           "name a dictionary such as DICT_4X4_50, or a family such as tag36h11"));
  if (fields.has("legacy")) {
    // OpenCV before 4.6: the bottom row starts with black, thus with even rows the top with white.
    PENUMBRA_TRY(const std::string legacy, fields.text("legacy", "give true or false"));
    if (legacy != "true" && legacy != "false")
      return fail("{}: is '{}'; give true or false", fields.place_of("legacy"), legacy);
    board.first_white = legacy == "true" && board.rows % 2 == 0;
  }
  if (fields.has("first_id")) {
    PENUMBRA_TRY(board.first_id, fields.integer("first_id", "give the id of the first tag"));
  }
  return with_place(fields.place(), charuco_target(board));
}

}  // namespace

Result<Target> tag_target(TagMap map) {
  Target target;
  target.kind = TargetKind::tags;
  double smallest = kMaxLength_m;
  double largest = 0.0;
  for (const MappedTag& tag : map.tags()) {
    PENUMBRA_TRY_VOID(check_length(tag.size_m, fmt::format("size_m of tag {}", tag.id)));
    if (!tag.curvature.is_flat()) {
      return fail(
          "surface of tag {}: a target must be flat; glue the sheet to a board, and name the "
          "tags.yaml that was printed with it",
          tag.id);
    }
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
  // The detector needs half a cell of white around the tag's border.
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
      PENUMBRA_TRY(tags.emplace_back(),
                   flat_tag(board.family, board.first_id + static_cast<int>(tags.size()),
                            board.tag_m, (i - 0.5 * (board.columns - 1)) * board.square_m,
                            (0.5 * (board.rows - 1) - j) * board.square_m));
    }
  }
  PENUMBRA_TRY(target.tags, TagMap::make(std::move(tags)));
  target.description = fmt::format("ChArUco board of {} x {} squares of {:g} mm", board.columns,
                                   board.rows, board.square_m * 1e3);
  return target;
}

Result<AprilGrid> april_grid_of(TagFamily family, std::optional<double> size_m,
                                std::optional<double> spacing) {
  PENUMBRA_TRY(const double ratio, printed_ratio_of(family));
  AprilGrid grid;
  grid.family = family;
  const double pitch_m = grid.tag_size_m * (1.0 + grid.spacing);
  constexpr double kStepsPerUnit = 20.0;
  const double needed = std::ceil((ratio - 1.0) * kStepsPerUnit - 1e-9) / kStepsPerUnit;
  grid.spacing = spacing.value_or(std::max(grid.spacing, needed));
  grid.tag_size_m =
      size_m.value_or(std::min(grid.tag_size_m, whole_mm_below(pitch_m / (1.0 + grid.spacing))));
  return grid;
}

Result<TagMap> tag_map_of(const AprilGrid& grid) {
  if (grid.columns < 1 || grid.rows < 1 || grid.columns > kMaxPerSide || grid.rows > kMaxPerSide) {
    return fail("an aprilgrid of {} x {} tags; give 1 to {} of each", grid.columns, grid.rows,
                kMaxPerSide);
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
      PENUMBRA_TRY(
          tags.emplace_back(),
          flat_tag(grid.family, grid.first_id + j * grid.columns + i, grid.tag_size_m,
                   (i - 0.5 * (grid.columns - 1)) * pitch, (j - 0.5 * (grid.rows - 1)) * pitch));
    }
  }
  return TagMap::make(std::move(tags));
}

Result<MappedTag> flat_tag(TagFamily family, int id, double size_m, double x_m, double y_m) {
  PENUMBRA_TRY_VOID(TagPattern::make(family, id));
  return MappedTag{id, family, size_m, {Eigen::Quaterniond::Identity(), {x_m, y_m, 0.0}}};
}

Result<Target> load_target(const std::filesystem::path& file) {
  return read_yaml_map(file, "a target", [&](const YAML::Node& root) -> Result<Target> {
    const YamlFields fields(root, file.string());
    if (!fields.has("target_type") && fields.has("tags")) {
      PENUMBRA_TRY(TagMap map, load_tag_map(file));
      return with_place(file.string(), tag_target(std::move(map)));
    }
    constexpr const char* kRemedy =
        "name aprilgrid, checkerboard or charuco, or give a tags.yaml with its list `tags`";
    PENUMBRA_TRY(const std::string type, fields.text("target_type", kRemedy));
    if (type == "aprilgrid") return read_aprilgrid(fields);
    if (type == "checkerboard" || type == "chessboard") return read_chessboard(fields);
    if (type == "charuco") return read_charuco(fields);
    return fail("{}: '{}' is not known; {}", fields.place_of("target_type"), type, kRemedy);
  });
}

}  // namespace penumbra
