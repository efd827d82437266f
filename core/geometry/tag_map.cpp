#include "core/geometry/tag_map.hpp"

#include <cctype>
#include <cmath>
#include <utility>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

// Indexed by TagFamily.
constexpr std::array<std::string_view, 21> kFamilyNames = {
    "tag36h11",       "tag36h10",         "tag25h9",          "tag16h5",        "tagCircle21h7",
    "tagCircle49h12", "tagStandard41h12", "tagStandard52h13", "tagCustom48h12", "DICT_4X4_50",
    "DICT_4X4_100",   "DICT_4X4_250",     "DICT_4X4_1000",    "DICT_5X5_50",    "DICT_5X5_100",
    "DICT_5X5_250",   "DICT_5X5_1000",    "DICT_6X6_50",      "DICT_6X6_100",   "DICT_6X6_250",
    "DICT_6X6_1000"};
static_assert(kFamilyNames.size() == static_cast<std::size_t>(TagFamily::aruco_6x6_1000) + 1);

constexpr std::string_view kDictionary = "DICT_";
constexpr std::string_view kTag = "tag";

Result<MappedTag> read_tag(const YamlFields& fields) {
  MappedTag tag;
  PENUMBRA_TRY(tag.id, fields.integer("id", "give the tag's number in its family"));
  PENUMBRA_TRY(const std::string family,
               fields.text("family", "name a family of libapriltag, such as tag36h11"));
  const std::optional<TagFamily> known = tag_family_from_string(family);
  if (!known) return fail("{}: {}", fields.place_of("family"), unknown_tag_family(family));
  tag.family = *known;

  PENUMBRA_TRY(
      tag.size_m,
      fields.number("size_m", "give the edge of the black border's outer square in metres"));
  if (!(tag.size_m > 0.0)) {
    return fail("{}: is {}; give the edge of the black border's outer square in metres",
                fields.place_of("size_m"), tag.size_m);
  }
  PENUMBRA_TRY(const std::vector<double> position,
               fields.numbers("position", 3, "give [x, y, z] in metres in the table frame"));
  constexpr const char* kRotation = "give [x, y, z, w] of a quaternion of length 1";
  PENUMBRA_TRY(const std::vector<double> q, fields.numbers("quaternion_xyzw", 4, kRotation));
  const Eigen::Quaterniond rotation(q[3], q[0], q[1], q[2]);
  if (!(std::abs(rotation.norm() - 1.0) <= 1e-3)) {
    return fail("{}: has length {:.6g}, so it is not a rotation; {}",
                fields.place_of("quaternion_xyzw"), rotation.norm(), kRotation);
  }
  tag.T_table_tag = Transform<frame::Table, frame::Tag>(
      rotation, Eigen::Vector3d(position[0], position[1], position[2]));

  PENUMBRA_TRY(const bool in_group, fields.has_optional("group"));
  if (in_group) {
    PENUMBRA_TRY(tag.group,
                 fields.text("group", "name the rigid group, or leave it out for 'table'"));
  }
  PENUMBRA_TRY(const bool is_curved, fields.has_optional("surface"));
  if (is_curved) {
    PENUMBRA_TRY(const std::vector<double> c,
                 fields.numbers("surface", 3, "give the curvatures [xx, xy, yy] in 1/m"));
    tag.curvature = {c[0], c[1], c[2]};
  }
  return tag;
}

// Returns the name in lower case without separators.
std::string plain_name(std::string_view name) {
  std::string plain;
  for (const char c : name) {
    if (c == '_' || c == '-' || c == ' ') continue;
    plain += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  return plain;
}

// Returns the family whose plain_name() is the prefix and `key`: "36h11", "standard41h12", "4x450".
std::optional<TagFamily> family_of_key(std::string_view key, bool aruco) {
  for (std::size_t i = 0; i < kFamilyNames.size(); ++i) {
    const std::string_view prefix = kFamilyNames[i].starts_with(kDictionary) ? kDictionary : kTag;
    if ((prefix == kDictionary) == aruco &&
        plain_name(kFamilyNames[i].substr(prefix.size())) == key)
      return static_cast<TagFamily>(i);
  }
  return std::nullopt;
}

}  // namespace

std::string_view to_string(TagFamily family) {
  return kFamilyNames[static_cast<std::size_t>(family)];
}

std::vector<TagFamily> distinct_tag_families() {
  std::vector<TagFamily> families;
  for (std::size_t i = 0; i < kFamilyNames.size(); ++i) {
    const auto family = static_cast<TagFamily>(i);
    constexpr int kLargest = 1000;
    const auto dictionary = aruco_dictionary_of(family);
    if (!dictionary || dictionary->count == kLargest) families.push_back(family);
  }
  return families;
}

std::optional<TagFamily> tag_family_from_string(std::string_view name) {
  // Strips the scope of "cv2.aruco.DICT_4X4_50" and "cv::aruco::DICT_4X4_50".
  if (const std::size_t scope = name.find_last_of(".:"); scope != std::string_view::npos)
    name.remove_prefix(scope + 1);
  const std::string plain = plain_name(name);
  std::string_view rest = plain;
  const auto strip = [&rest](std::string_view prefix) {
    const bool found = rest.starts_with(prefix);
    if (found) rest.remove_prefix(prefix.size());
    return found;
  };
  const bool dictionary = strip("dict");
  if (strip("aruco")) return family_of_key(rest, true);
  // Kalibr writes "t36h11".
  const bool tag =
      strip("apriltag") || strip("tagcodes") || strip("tag") ||
      (rest.size() > 1 && rest[0] == 't' && rest[1] >= '0' && rest[1] <= '9' && strip("t"));
  if (tag) {
    strip("tag");  // second prefix of "apriltag_tag36h11"
    return family_of_key(rest, false);
  }
  if (const auto aruco = family_of_key(rest, true)) return aruco;
  // OpenCV's dictionaries of AprilTags have "apriltag" in their names.
  return dictionary ? std::nullopt : family_of_key(rest, false);
}

std::string unknown_tag_family(std::string_view name) {
  return fmt::format("'{}' is not known; known: {} (also as DICT_APRILTAG_36h11, 36h11, 4x4_50)",
                     name, fmt::join(kFamilyNames, ", "));
}

std::optional<ArucoDictionary> aruco_dictionary_of(TagFamily family) {
  const auto number = static_cast<int>(family) - static_cast<int>(TagFamily::aruco_4x4_50);
  if (number < 0) return std::nullopt;
  constexpr std::array<int, 4> kCounts = {50, 100, 250, 1000};
  return ArucoDictionary{4 + number / 4, kCounts[static_cast<std::size_t>(number % 4)]};
}

std::array<Eigen::Vector3d, 4> tag_corners(double size_m) {
  const double h = 0.5 * size_m;
  return {Eigen::Vector3d(-h, -h, 0.0), Eigen::Vector3d(h, -h, 0.0), Eigen::Vector3d(h, h, 0.0),
          Eigen::Vector3d(-h, h, 0.0)};
}

std::array<Eigen::Vector3d, 4> MappedTag::corners() const {
  std::array<Eigen::Vector3d, 4> corners = tag_corners(size_m);
  for (Eigen::Vector3d& corner : corners) {
    corner.z() = curvature.height(corner.x(), corner.y(), size_m);
    corner = T_table_tag * corner;
  }
  return corners;
}

Result<TagMap> TagMap::make(std::vector<MappedTag> tags) {
  constexpr double kLargest = 1e4;  // [m]
  if (tags.empty()) return fail("tags: the list is empty; list at least one tag");
  TagMap map;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const MappedTag& tag = tags[i];
    const std::string place = fmt::format("tags[{}]: {} {}", i, to_string(tag.family), tag.id);
    if (tag.id < 0) return fail("{}: id: is negative; tag numbers start at 0", place);
    if (!(std::isfinite(tag.size_m) && tag.size_m > 0.0 && tag.size_m <= kLargest)) {
      return fail("{}: size_m: is {}; give the edge of the black square in metres", place,
                  tag.size_m);
    }
    if (!tag.T_table_tag.is_finite() ||
        tag.T_table_tag.translation().cwiseAbs().maxCoeff() > kLargest) {
      return fail("{}: position, quaternion_xyzw: are not a pose in the table frame; give metres",
                  place);
    }
    const Eigen::Vector3d curvature(tag.curvature.xx, tag.curvature.xy, tag.curvature.yy);
    if (!(curvature.array().abs() * tag.size_m <= 1.0).all()) {
      return fail(
          "{}: surface: has a curvature above {:.4g} 1/m (1 / size_m); measure it again with "
          "penumbra map, or remove it",
          place, 1.0 / tag.size_m);
    }
    if (const auto [where, added] = map.index_.emplace(std::pair(tag.family, tag.id), i); !added) {
      return fail("{}: id: is listed twice (also as tags[{}]); every id may lie there once", place,
                  where->second);
    }
  }
  map.tags_ = std::move(tags);
  return map;
}

const MappedTag* TagMap::find(TagFamily family, int id) const {
  const auto found = index_.find(std::pair(family, id));
  return found == index_.end() ? nullptr : &tags_[found->second];
}

std::vector<TagFamily> TagMap::families() const {
  std::vector<TagFamily> families;
  for (const auto& [key, unused] : index_) {
    if (families.empty() || families.back() != key.first) families.push_back(key.first);
  }
  return families;
}

Result<TagMap> load_tag_map(const std::filesystem::path& file) {
  return read_yaml_map(file, "a tag map", [&](const YAML::Node& root) -> Result<TagMap> {
    const YamlFields fields(root, file.string());
    constexpr const char* kRemedy =
        "list the tags as {id, family, size_m, position, quaternion_xyzw}";
    PENUMBRA_TRY(const YAML::Node list, fields.node("tags", kRemedy));
    if (!list.IsSequence()) return fail("{}: is not a list; {}", fields.place_of("tags"), kRemedy);
    std::vector<MappedTag> tags;
    for (const YAML::Node& item : list) {
      const std::string place = fmt::format("{}: tags[{}]", file.string(), tags.size());
      if (!item.IsMap()) return fail("{}: is not a map; {}", place, kRemedy);
      PENUMBRA_TRY(tags.emplace_back(), read_tag(YamlFields(item, place)));
    }
    return with_place(file.string(), TagMap::make(std::move(tags)));
  });
}

std::string tag_map_text(const TagMap& map) {
  std::string text =
      "# Tag frame: origin at the tag's centre, x right and y up on the upright printed tag, z out "
      "of\n# the paper. size_m: edge of the black border's outer square. position, "
      "quaternion_xyzw: the tag\n# frame in the table frame. surface: curvatures [xx, xy, yy] of "
      "the paper in the tag frame [1/m].\ntags:\n";
  for (const MappedTag& tag : map.tags()) {
    const Eigen::Vector3d& p = tag.T_table_tag.translation();
    const Eigen::Quaterniond& q = tag.T_table_tag.rotation();
    // {} formats the shortest decimal that reads back to the same double.
    text += fmt::format(
        "  - {{id: {}, family: {}, size_m: {}, position: [{}, {}, {}], "
        "quaternion_xyzw: [{}, {}, {}, {}]",
        tag.id, to_string(tag.family), tag.size_m, p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w());
    if (tag.group != "table") text += fmt::format(", group: {}", in_quotes(tag.group));
    if (const TagCurvature& c = tag.curvature; !c.is_flat())
      text += fmt::format(", surface: [{}, {}, {}]", c.xx, c.xy, c.yy);
    text += "}\n";
  }
  return text;
}

}  // namespace penumbra
