// The tags on the table, their sizes and poses. File: tags.yaml.
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// Families of libapriltag ("tag36h11" in files) and ArUco dictionaries of OpenCV ("DICT_4X4_50").
enum class TagFamily {
  tag36h11,
  tag36h10,
  tag25h9,
  tag16h5,
  tag_circle21h7,
  tag_circle49h12,
  tag_standard41h12,
  tag_standard52h13,
  tag_custom48h12,
  aruco_4x4_50,
  aruco_4x4_100,
  aruco_4x4_250,
  aruco_4x4_1000,
  aruco_5x5_50,
  aruco_5x5_100,
  aruco_5x5_250,
  aruco_5x5_1000,
  aruco_6x6_50,
  aruco_6x6_100,
  aruco_6x6_250,
  aruco_6x6_1000
};

struct ArucoDictionary {
  int cells = 4;   // data cells across
  int count = 50;  // markers
};
// Returns nullopt for a family of libapriltag.
[[nodiscard]] std::optional<ArucoDictionary> aruco_dictionary_of(TagFamily family);

[[nodiscard]] std::string_view to_string(TagFamily family);
// Returns all families, of ArUco's dictionaries only the largest ones, which contain the others.
[[nodiscard]] std::vector<TagFamily> distinct_tag_families();
// Accepts the names of OpenCV, ROS and AprilTag, in any case, with or without separators:
// "tag36h11", "36h11", "apriltag_36h11", "DICT_APRILTAG_36h11"; "Standard41h12"; "DICT_4X4_50",
// "4x4_50", "aruco_4x4_50"; "t36h11" (Kalibr).
[[nodiscard]] std::optional<TagFamily> tag_family_from_string(std::string_view name);
// Returns the message "'...' is not known; known: ...".
[[nodiscard]] std::string unknown_tag_family(std::string_view name);

// Returns the corners in the tag frame [m], in libapriltag's order:
// (-s/2, -s/2), (s/2, -s/2), (s/2, s/2), (-s/2, s/2).
[[nodiscard]] std::array<Eigen::Vector3d, 4> tag_corners(double size_m);

// Curvature of the paper at a tag, in the tag frame [1/m]. The paper's height over the tag's plane
// is
//   z(x, y) = (xx (x^2 - h^2) + 2 xy x y + yy (y^2 - h^2)) / 2,   h = size / 2 [m],
// zero on average over the corners.
struct TagCurvature {
  double xx = 0.0;
  double xy = 0.0;
  double yy = 0.0;

  friend bool operator==(const TagCurvature&, const TagCurvature&) = default;
  [[nodiscard]] bool is_flat() const { return *this == TagCurvature(); }
  // Returns z(x, y) [m] on a tag of this size.
  [[nodiscard]] double height(double x_m, double y_m, double size_m) const {
    const double h2 = 0.25 * size_m * size_m;
    return 0.5 * (xx * (x_m * x_m - h2) + 2.0 * xy * x_m * y_m + yy * (y_m * y_m - h2));
  }
};

struct MappedTag {
  int id = 0;
  TagFamily family = TagFamily::tag36h11;
  double size_m = 0.0;  // outer edge of the black border, without the white margin
  Transform<frame::Table, frame::Tag> T_table_tag;
  std::string group = "table";  // rigid group; only "table" is fixed to the table frame
  TagCurvature curvature{};

  // Returns the corners of the curved tag in the table frame, in the order of tag_corners().
  [[nodiscard]] std::array<Eigen::Vector3d, 4> corners() const;
};

class TagMap {
 public:
  // Fails on an empty list, a duplicate (family, id), a size that is not positive and finite, a
  // non-finite pose, or a curvature above 1 / size.
  [[nodiscard]] static Result<TagMap> make(std::vector<MappedTag> tags);

  [[nodiscard]] const std::vector<MappedTag>& tags() const { return tags_; }
  [[nodiscard]] const MappedTag* find(TagFamily family, int id) const;
  [[nodiscard]] std::vector<TagFamily> families() const;

 private:
  std::vector<MappedTag> tags_;
  std::map<std::pair<TagFamily, int>, std::size_t> index_;
};

// Reads a tags.yaml: `tags:` is a list of {id, family, size_m, position, quaternion_xyzw, group?,
// surface?: [xx, xy, yy] (TagCurvature)}.
// Errors name file, tag and field.
[[nodiscard]] Result<TagMap> load_tag_map(const std::filesystem::path& file);

// Returns the text of a tags.yaml. Each number reads back to the same double.
[[nodiscard]] std::string tag_map_text(const TagMap& map);

}  // namespace penumbra
