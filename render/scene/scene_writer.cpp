#include "render/scene/scene_writer.hpp"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <vector>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "render/scene/scene_json.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

fs::path absolute_path(const fs::path& path) {
  std::error_code ignored;
  fs::path whole = fs::absolute(path, ignored).lexically_normal();
  return whole.has_filename() ? whole : whole.parent_path();
}

// Returns the path relative to `folder`. Like load_scene(), does not follow links.
std::string relative_path(const fs::path& file, const fs::path& folder) {
  const fs::path whole = absolute_path(file);
  const fs::path relative = whole.lexically_relative(absolute_path(folder));
  return (relative.empty() ? whole : relative).generic_string();
}

Json vector_of(const Eigen::Vector3d& v) {
  return {v.x(), v.y(), v.z()};
}

// Returns the angles about x, then y, then z [degrees]. At y = 90 degrees only x - z matters: z is
// chosen first, and x follows from it.
Eigen::Vector3d angles_of(const Eigen::Quaterniond& rotation) {
  const Eigen::Matrix3d R = rotation.toRotationMatrix();
  const double z = std::atan2(R(1, 0), R(0, 0));
  const double y = std::atan2(-R(2, 0), std::hypot(R(0, 0), R(1, 0)));
  const double x = std::atan2(std::sin(z) * R(0, 2) - std::cos(z) * R(1, 2),
                              std::cos(z) * R(1, 1) - std::sin(z) * R(0, 1));
  return {degrees(x), degrees(y), degrees(z)};
}

void put_placement(Json& object, const Placement& placement) {
  object["position"] = vector_of(placement.position);
  const Eigen::Vector3d angles = angles_of(placement.rotation);
  object.erase("rotation_deg");
  if (!angles.isZero(0.0)) object["rotation_deg"] = vector_of(angles);
  object.erase("scale");
  if (placement.scale != 1.0) object["scale"] = placement.scale;
}

bool is_moved(const SceneObject& now, const SceneObject& start) {
  return !(now.placement == start.placement) || now.tag_group != start.tag_group ||
         now.animation.keyframes.size() != start.animation.keyframes.size() ||
         now.animation.spin_turns_per_s != start.animation.spin_turns_per_s;
}

bool equal(const LayeredConstants& a, const LayeredConstants& b) {
  return a.light_height == b.light_height && a.light_ratio == b.light_ratio &&
         a.umbra_height == b.umbra_height;
}

Json layered_of(const LayeredConstants& constants) {
  Json layered;
  if (std::isinf(constants.light_height)) {
    layered["light_height"] = "inf";
    layered["umbra_height"] = constants.umbra_height;
  } else {
    layered["light_height"] = constants.light_height;
    layered["light_ratio"] = constants.light_ratio;
  }
  return layered;
}

Json plane_of(const ScenePlane& plane) {
  Json tree;
  tree["name"] = plane.name;
  tree["normal"] = vector_of(plane.normal);
  tree["point"] = vector_of(plane.point);
  for (const Eigen::Vector2d& corner : plane.outline) {
    tree["outline"].push_back({corner.x(), corner.y()});
  }
  if (plane.tag_group != kTableGroup) tree["tag_group"] = plane.tag_group;
  return tree;
}

class SceneWriter {
 public:
  SceneWriter(const SceneToWrite& scene, fs::path folder)
      : now_(scene.now), start_(scene.start), options_(scene), folder_(std::move(folder)) {}

  [[nodiscard]] Json write();

 private:
  void move_paths(Json& object) const;
  void write_objects();
  void write_style(Json& entry, const ShadowNode& node, const ShadowNode& start) const;
  void write_casters(Json& entry, const ShadowNode& node) const;
  void write_walls(Json& entry, const ShadowNode& node);
  [[nodiscard]] const SceneObject& object(int index) const {
    return now_.objects[static_cast<std::size_t>(index)];
  }

  const Scene& now_;
  const Scene& start_;
  const SceneToWrite& options_;
  fs::path folder_;
  Json root_;
};

void SceneWriter::move_paths(Json& object) const {
  const fs::path old_folder = fs::path(start_.file).parent_path();
  for (const char* key : {"model", "proxy", "$schema"}) {
    const auto entry = object.find(key);
    if (entry == object.end()) continue;
    const auto text = entry->get<std::string>();
    const bool is_word = key == std::string_view("proxy") && (text == "none" || text == "auto");
    if (is_word || text.find("://") != std::string::npos) continue;
    *entry = relative_path(old_folder / text, folder_);
  }
}

void SceneWriter::write_objects() {
  for (const char* list : {"objects", "phantoms"}) {
    if (!root_.contains(list)) continue;
    for (Json& entry : root_[list]) {
      move_paths(entry);
      const auto name = entry["name"].get<std::string>();
      const auto moved = std::ranges::find(now_.objects, name, &SceneObject::name);
      const auto start = std::ranges::find(start_.objects, name, &SceneObject::name);
      PENUMBRA_ASSERT(moved != now_.objects.end() && start != start_.objects.end());
      if (!is_moved(*moved, *start)) continue;
      // A moved object keeps the animation of its model.
      if (const auto animation = entry.find("animation");
          animation != entry.end() && animation->is_object()) {
        if (animation->contains("model")) {
          *animation = Json((*animation)["model"]);
        } else {
          entry.erase(animation);
        }
      }
      entry.erase("tag_group");
      put_placement(entry, moved->placement);
    }
  }
  for (const SceneObject& added : now_.objects) {
    if (!added.added || added.removed) continue;
    Json entry;
    entry["name"] = added.name;
    entry["model"] = relative_path(added.model_file, folder_);
    if (added.up != UpAxis::by_format) entry["up"] = name_of(kUpAxisNames, added.up);
    if (added.playback.model) entry["animation"] = added.playback.animation;
    put_placement(entry, added.placement);
    root_["objects"].push_back(std::move(entry));
  }
}

void SceneWriter::write_style(Json& entry, const ShadowNode& node, const ShadowNode& start) const {
  ShadowStyle style = node;
  if (options_.style_of) style = options_.style_of(node);
  if (style.technique != start.technique) entry["technique"] = to_string(style.technique);
  if (style.kernels != start.kernels) entry["kernels"] = to_string(style.kernels);
  if (style.light_rays != start.light_rays) entry["light_rays"] = style.light_rays;
  if (!equal(style.layered, start.layered)) entry["layered"] = layered_of(style.layered);
  if (style.fractions != start.fractions) {
    entry["light_left"] = {{"umbra", style.fractions.umbra},
                           {"middle", style.fractions.middle},
                           {"penumbra", style.fractions.penumbra}};
  }
  const LightMode mode = options_.light_mode.value_or(node.light_mode);
  if (mode != start.light_mode) entry["light_mode"] = name_of(kLightModeNames, mode);
}

// Lists the casters if the entry would give the node others.
void SceneWriter::write_casters(Json& entry, const ShadowNode& node) const {
  std::set<std::string> all;
  std::vector<std::string> casters;
  for (const SceneObject& object : now_.objects) {
    if (object.casts_shadow && !object.removed) all.insert(object.name);
  }
  for (const int caster : node.casters) {
    if (!object(caster).removed) casters.push_back(object(caster).name);
  }
  std::set<std::string> read = all;
  if (entry.contains("casters")) {
    const auto listed = entry["casters"].get<std::set<std::string>>();
    std::erase_if(read, [&listed](const std::string& name) { return !listed.contains(name); });
  }
  if (read != std::set<std::string>(casters.begin(), casters.end())) entry["casters"] = casters;
}

// Writes walls that come from the casters' places at the start, because these may have changed.
void SceneWriter::write_walls(Json& entry, const ShadowNode& node) {
  const std::string technique = entry["technique"].get<std::string>();
  if (!node.default_walls || node.walls.empty() || technique != to_string(ShadowTechnique::walls)) {
    return;
  }
  Json& planes = root_["planes"];
  const auto write = [this, &planes](int index) {
    const ScenePlane& plane = now_.planes[static_cast<std::size_t>(index)];
    const bool is_written = std::any_of(planes.begin(), planes.end(), [&plane](const Json& known) {
      return known["name"] == plane.name;
    });
    if (!is_written) planes.push_back(plane_of(plane));
    return plane.name;
  };
  if (planes.empty()) (void)write(0);  // the table, which a file without planes has
  entry["walls"] = Json::array();
  for (const int wall : node.walls) entry["walls"].push_back(write(wall));
}

Json SceneWriter::write() {
  root_ = Json::parse(*start_.json);
  move_paths(root_);
  write_objects();
  if (!root_.contains("shadows")) return std::move(root_);
  // Apart from root_, because a new key there moves the values of the others.
  Json shadows = std::move(root_["shadows"]);
  for (std::size_t i = 0; i < shadows.size(); ++i) {
    write_style(shadows[i], now_.shadows[i], start_.shadows[i]);
    write_casters(shadows[i], now_.shadows[i]);
    write_walls(shadows[i], now_.shadows[i]);
  }
  root_["shadows"] = std::move(shadows);
  return std::move(root_);
}

// Returns the members of a list or an object, each written by `write`. Members of an object begin
// with their key.
template <class Write>
std::vector<std::string> members_of(const Json& tree, const Write& write) {
  std::vector<std::string> members;
  for (const auto& [key, value] : tree.items()) {
    const std::string head = tree.is_object() ? Json(key).dump() + ": " : std::string();
    members.push_back(head + write(value, head.size()));
  }
  return members;
}

std::string one_line(const Json& tree) {
  if (!tree.is_structured()) return tree.dump();
  const auto members =
      members_of(tree, [](const Json& value, std::size_t) { return one_line(value); });
  return fmt::format("{}{}{}", tree.is_object() ? '{' : '[', fmt::join(members, ", "),
                     tree.is_object() ? '}' : ']');
}

// Writes lists and objects that fit on one line so. `column`: where the text begins.
std::string layout(const Json& tree, std::size_t indent, std::size_t column) {
  constexpr std::size_t kWidth = 100;
  std::string line = one_line(tree);
  if (column + line.size() <= kWidth || !tree.is_structured()) return line;
  const std::size_t inner = indent + 2;
  const auto members = members_of(tree, [inner](const Json& value, std::size_t head) {
    return layout(value, inner, inner + head);
  });
  const std::string blanks(inner, ' ');
  return fmt::format("{}\n{}{}\n{}{}", tree.is_object() ? '{' : '[', blanks,
                     fmt::join(members, ",\n" + blanks), std::string(indent, ' '),
                     tree.is_object() ? '}' : ']');
}

}  // namespace

Result<std::string> scene_text(const SceneToWrite& scene, const fs::path& folder) {
  if (!scene.start.json) return fail("{}: has no file to write again", scene.start.file);
  try {
    const Json root = SceneWriter(scene, folder.empty() ? "." : folder).write();
    PENUMBRA_TRY_VOID(check_scene_json("the scene to write", nlohmann::json::parse(root.dump())));
    return layout(root, 0, 0) + "\n";
  } catch (const std::exception& error) {
    return fail("the scene can't be written: {}; rename files whose names are not UTF-8",
                error.what());
  }
}

}  // namespace penumbra
