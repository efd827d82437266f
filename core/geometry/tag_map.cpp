#include "core/geometry/tag_map.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <utility>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

constexpr std::array<std::pair<TagFamily, std::string_view>, 21> kFamilies = {{
    {TagFamily::tag36h11, "tag36h11"},
    {TagFamily::tag36h10, "tag36h10"},
    {TagFamily::tag25h9, "tag25h9"},
    {TagFamily::tag16h5, "tag16h5"},
    {TagFamily::tag_circle21h7, "tagCircle21h7"},
    {TagFamily::tag_circle49h12, "tagCircle49h12"},
    {TagFamily::tag_standard41h12, "tagStandard41h12"},
    {TagFamily::tag_standard52h13, "tagStandard52h13"},
    {TagFamily::tag_custom48h12, "tagCustom48h12"},
    {TagFamily::aruco_4x4_50, "DICT_4X4_50"},
    {TagFamily::aruco_4x4_100, "DICT_4X4_100"},
    {TagFamily::aruco_4x4_250, "DICT_4X4_250"},
    {TagFamily::aruco_4x4_1000, "DICT_4X4_1000"},
    {TagFamily::aruco_5x5_50, "DICT_5X5_50"},
    {TagFamily::aruco_5x5_100, "DICT_5X5_100"},
    {TagFamily::aruco_5x5_250, "DICT_5X5_250"},
    {TagFamily::aruco_5x5_1000, "DICT_5X5_1000"},
    {TagFamily::aruco_6x6_50, "DICT_6X6_50"},
    {TagFamily::aruco_6x6_100, "DICT_6X6_100"},
    {TagFamily::aruco_6x6_250, "DICT_6X6_250"},
    {TagFamily::aruco_6x6_1000, "DICT_6X6_1000"},
}};

constexpr std::string_view kDictionary = "DICT_";
constexpr std::string_view kTag = "tag";

Result<MappedTag> read_tag(const YamlFields& fields) {
  MappedTag tag;
  PENUMBRA_TRY(const int id, fields.integer("id", "give the tag's number in its family"));
  tag.id = id;

  PENUMBRA_TRY(const std::string family,
               fields.text("family", "name a family of libapriltag, such as tag36h11"));
  const std::optional<TagFamily> known = tag_family_from_string(family);
  if (!known) return fail("{}: {}", fields.place_of("family"), unknown_tag_family(family));
  tag.family = *known;

  PENUMBRA_TRY(
      const double size,
      fields.number("size_m", "give the edge of the black border's outer square in metres"));
  if (!(size > 0.0)) {
    return fail("{}: is {}; give the edge of the black border's outer square in metres",
                fields.place_of("size_m"), size);
  }
  tag.size_m = size;

  constexpr const char* kPosition = "give [x, y, z] in metres in the table frame";
  PENUMBRA_TRY(const std::vector<double> position, fields.numbers("position", kPosition));
  if (position.size() != 3)
    return fail("{}: has {} numbers; {}", fields.place_of("position"), position.size(), kPosition);

  constexpr const char* kRotation = "give [x, y, z, w] of a quaternion of length 1";
  PENUMBRA_TRY(const std::vector<double> q, fields.numbers("quaternion_xyzw", kRotation));
  if (q.size() != 4)
    return fail("{}: has {} numbers; {}", fields.place_of("quaternion_xyzw"), q.size(), kRotation);
  const Eigen::Quaterniond rotation(q[3], q[0], q[1], q[2]);
  if (!(std::abs(rotation.norm() - 1.0) <= 1e-3)) {
    return fail("{}: has length {:.6g}, so it is no rotation; {}",
                fields.place_of("quaternion_xyzw"), rotation.norm(), kRotation);
  }
  tag.T_table_tag = Transform<frame::Table, frame::Tag>(
      rotation, Eigen::Vector3d(position[0], position[1], position[2]));

  PENUMBRA_TRY(const bool in_group, fields.has_optional("group"));
  if (in_group) {
    PENUMBRA_TRY(const std::string group,
                 fields.text("group", "name the rigid group, or leave it out for 'table'"));
    tag.group = group;
  }
  return tag;
}

// The family whose name is `key` without prefix and separators, in small letters: "36h11",
// "standard41h12", "4x450".
std::optional<TagFamily> family_of_key(std::string_view key, bool aruco) {
  for (const auto& [value, name] : kFamilies) {
    const bool is_aruco = name.starts_with(kDictionary);
    if (is_aruco != aruco) continue;
    std::string known;
    for (const char c : name.substr(is_aruco ? kDictionary.size() : kTag.size())) {
      if (c != '_') known += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    }
    if (known == key) return value;
  }
  return std::nullopt;
}

}  // namespace

std::string_view to_string(TagFamily family) {
  for (const auto& [value, name] : kFamilies) {
    if (value == family) return name;
  }
  return "tag36h11";
}

std::optional<TagFamily> tag_family_from_string(std::string_view name) {
  // "cv2.aruco.DICT_4X4_50" and "cv::aruco::DICT_4X4_50".
  if (const std::size_t scope = name.find_last_of(".:"); scope != std::string_view::npos)
    name.remove_prefix(scope + 1);
  std::string plain;
  for (const char c : name) {
    if (c == '_' || c == '-' || c == ' ') continue;
    plain += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  std::string_view rest = plain;
  const auto without = [&rest](std::string_view prefix) {
    const bool there = rest.starts_with(prefix);
    if (there) rest.remove_prefix(prefix.size());
    return there;
  };
  const bool dictionary = without("dict");
  if (without("aruco")) return family_of_key(rest, true);
  // "t36h11" is Kalibr's.
  const bool tag =
      without("apriltag") || without("tagcodes") || without("tag") ||
      (rest.size() > 1 && rest[0] == 't' && rest[1] >= '0' && rest[1] <= '9' && without("t"));
  if (tag) {
    without("tag");
    return family_of_key(rest, false);
  }
  if (const auto aruco = family_of_key(rest, true)) return aruco;
  // OpenCV's dictionaries of AprilTags have that in their names.
  return dictionary ? std::nullopt : family_of_key(rest, false);
}

std::string unknown_tag_family(std::string_view name) {
  std::string names;
  for (const auto& [unused, known] : kFamilies)
    names += (names.empty() ? "" : ", ") + std::string(known);
  return fmt::format("'{}' is not known; known: {} (also as DICT_APRILTAG_36h11, 36h11, 4x4_50)",
                     name, names);
}

std::optional<ArucoDictionary> aruco_dictionary_of(TagFamily family) {
  const auto number = static_cast<int>(family) - static_cast<int>(TagFamily::aruco_4x4_50);
  if (number < 0) return std::nullopt;
  constexpr std::array<int, 4> kCounts = {50, 100, 250, 1000};
  return ArucoDictionary{4 + number / 4, kCounts[static_cast<std::size_t>(number % 4)]};
}

std::array<Eigen::Vector3d, 4> MappedTag::corners() const {
  const double h = 0.5 * size_m;
  return {T_table_tag * Eigen::Vector3d(-h, -h, 0.0), T_table_tag * Eigen::Vector3d(h, -h, 0.0),
          T_table_tag * Eigen::Vector3d(h, h, 0.0), T_table_tag * Eigen::Vector3d(-h, h, 0.0)};
}

Result<TagMap> TagMap::make(std::vector<MappedTag> tags) {
  constexpr double kLargest = 1e4;  // [m]: nothing on a table is further away
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
      return fail("{}: position, quaternion_xyzw: are no place in the table frame; give metres",
                  place);
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
  PENUMBRA_TRY(const YAML::Node root, load_yaml_map(file));
  try {
    const YamlFields fields(root, file.string());
    constexpr const char* kRemedy =
        "list the tags as {id, family, size_m, position, quaternion_xyzw}";
    const Result<YAML::Node> list = fields.node("tags", kRemedy);
    if (!list) return tl::unexpected(list.error());
    if (!list->IsSequence()) return fail("{}: is no list; {}", fields.place_of("tags"), kRemedy);
    std::vector<MappedTag> tags;
    for (std::size_t i = 0; i < list->size(); ++i) {
      const YAML::Node item = (*list)[i];
      const std::string place = fmt::format("{}: tags[{}]", file.string(), i);
      if (!item.IsMap()) return fail("{}: is no map; {}", place, kRemedy);
      PENUMBRA_TRY(MappedTag tag, read_tag(YamlFields(item, place)));
      tags.push_back(std::move(tag));
    }
    Result<TagMap> map = TagMap::make(std::move(tags));
    if (!map) return fail_in(file.string(), map.error());
    return map;
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as a tag map ({}); correct the file", file.string(),
                error.what());
  }
}

std::string tag_map_text(const TagMap& map) {
  std::string text =
      "# Tag frame: origin at the tag's centre, x right and y up on the upright printed tag, z out "
      "of\n"
      "# the paper. size_m: edge of the black border's outer square. position, quaternion_xyzw: "
      "the tag\n"
      "# frame in the table frame.\ntags:\n";
  for (const MappedTag& tag : map.tags()) {
    const Eigen::Vector3d& p = tag.T_table_tag.translation();
    const Eigen::Quaterniond& q = tag.T_table_tag.rotation();
    // {} writes the shortest digits that read back to the same double.
    text += fmt::format(
        "  - {{id: {}, family: {}, size_m: {}, position: [{}, {}, {}], "
        "quaternion_xyzw: [{}, {}, {}, {}]",
        tag.id, to_string(tag.family), tag.size_m, p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w());
    if (tag.group != "table") text += fmt::format(", group: {}", in_quotes(tag.group));
    text += "}\n";
  }
  return text;
}

Result<void> save_tag_map(const std::filesystem::path& file, const TagMap& map) {
  return write_text_file(file, tag_map_text(map));
}

}  // namespace penumbra
