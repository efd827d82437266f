// Scene files: JSON, checked against the published schema and then for what a schema can't say.
#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <numeric>
#include <set>
#include <valijson/adapters/nlohmann_json_adapter.hpp>
#include <valijson/schema.hpp>
#include <valijson/schema_parser.hpp>
#include <valijson/validation_results.hpp>
#include <valijson/validator.hpp>

#include "core/text.hpp"
#include "render/scene.hpp"
#include "render/scene_schema.hpp"
#include "render/shadow/layered_penumbra.hpp"
#include "render/shapes.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxSceneBytes = std::size_t{16} << 20U;

// "<root>", "[objects]", "[2]" -> "/objects/2"
std::string pointer_of(const std::vector<std::string>& context) {
  std::string pointer;
  for (const std::string& step : context) {
    if (step == "<root>") continue;
    std::string name = step;
    if (name.size() >= 2 && name.front() == '[' && name.back() == ']')
      name = name.substr(1, name.size() - 2);
    pointer += "/" + name;
  }
  return pointer.empty() ? "/" : pointer;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t above = row[j];
      row[j] = std::min({above + 1, row[j - 1] + 1, diagonal + (a[i - 1] == b[j - 1] ? 0U : 1U)});
      diagonal = above;
    }
  }
  return row[b.size()];
}

// Every property that the schema knows, with its description where it has one.
void collect_properties(const Json& schema, std::map<std::string, std::string>& properties) {
  if (schema.is_object()) {
    if (const auto found = schema.find("properties"); found != schema.end() && found->is_object()) {
      for (const auto& [name, property] : found->items()) {
        std::string& description = properties[name];
        if (description.empty() && property.is_object())
          description = property.value("description", "");
      }
    }
    for (const auto& child : schema) collect_properties(child, properties);
  }
}

std::string explain(const valijson::ValidationResults::Error& error, const Json& schema) {
  std::map<std::string, std::string> properties;
  collect_properties(schema, properties);
  const std::string pointer = pointer_of(error.context);
  if (error.description.find("'additionalProperties'") != std::string::npos) {
    const std::size_t end = error.description.rfind('\'');
    const std::size_t begin =
        end == std::string::npos ? end : error.description.rfind('\'', end - 1);
    if (begin != std::string::npos && end > begin + 1) {
      const std::string key = error.description.substr(begin + 1, end - begin - 1);
      if (key.size() <= 64) {
        const auto nearest = std::min_element(
            properties.begin(), properties.end(), [&](const auto& a, const auto& b) {
              return edit_distance(key, a.first) < edit_distance(key, b.first);
            });
        if (properties.count(key) != 0)
          return fmt::format("{}: '{}' has no meaning here; remove it", pointer, key);
        if (edit_distance(key, nearest->first) <= 1 + key.size() / 3) {
          return fmt::format("{}: unknown key '{}'; did you mean '{}'?", pointer, key,
                             nearest->first);
        }
        return fmt::format("{}: unknown key '{}'; see scene.schema.json for the keys there are",
                           pointer, key);
      }
    }
  }
  const auto described = properties.find(pointer.substr(pointer.rfind('/') + 1));
  const std::string hint = described != properties.end() && !described->second.empty()
                               ? " (" + described->second + ")"
                               : "";
  return fmt::format("{}: {}{}", pointer, error.description, hint);
}

Result<void> check_against_schema(const Json& document) {
  const Json schema_document = Json::parse(scene_schema());
  valijson::Schema schema;
  valijson::SchemaParser parser;
  parser.populateSchema(valijson::adapters::NlohmannJsonAdapter(schema_document), schema);
  valijson::Validator validator;
  valijson::ValidationResults results;
  if (validator.validate(schema, valijson::adapters::NlohmannJsonAdapter(document), &results))
    return {};
  // The deepest place is the most telling one: the others say that something below them is wrong.
  const auto deepest = std::max_element(
      results.begin(), results.end(),
      [](const auto& a, const auto& b) { return a.context.size() < b.context.size(); });
  if (deepest == results.end()) return fail("/: does not follow scene.schema.json");
  return tl::unexpected(Error{explain(*deepest, schema_document)});
}

// Reads one scene whose document has passed the schema: kinds and ranges of single values are known
// to be right.
class SceneReader {
 public:
  SceneReader(const Json& document, std::filesystem::path folder)
      : document_(document), folder_(std::move(folder)) {}

  Result<Scene> read() {
    scene_.name = document_.value("name", "");
    if (document_.contains("ambient")) scene_.ambient = vector_of(document_["ambient"]);
    if (auto done = read_objects("objects", false); !done) return tl::unexpected(done.error());
    if (auto done = read_objects("phantoms", true); !done) return tl::unexpected(done.error());
    if (auto done = read_planes(); !done) return tl::unexpected(done.error());
    if (auto done = read_lights(); !done) return tl::unexpected(done.error());
    if (auto done = read_shadows(); !done) return tl::unexpected(done.error());
    return std::move(scene_);
  }

 private:
  static Eigen::Vector3d vector_of(const Json& array) {
    return {array[0].get<double>(), array[1].get<double>(), array[2].get<double>()};
  }

  // A unit vector; a vector of (nearly) no length has no direction.
  static Result<Eigen::Vector3d> direction_of(const Json& array, const std::string& place) {
    const Eigen::Vector3d v = vector_of(array);
    if (!(v.norm() > 1e-9)) return fail("{}: has no length; give a direction", place);
    return Eigen::Vector3d(v.normalized());
  }

  static Result<Placement> placement_of(const Json& node, const std::string& place) {
    Placement placement;
    if (node.contains("position")) placement.position = vector_of(node["position"]);
    if (node.contains("scale")) placement.scale = node["scale"].get<double>();
    if (node.contains("rotation")) {
      const Json& rotation = node["rotation"];
      const Result<Eigen::Vector3d> axis = direction_of(rotation["axis"], place + "/rotation/axis");
      if (!axis) return tl::unexpected(axis.error());
      // Whole turns are taken off exactly before the conversion.
      const double degrees = std::remainder(rotation["degrees"].get<double>(), 720.0);
      placement.rotation =
          Eigen::Quaterniond(Eigen::AngleAxisd(degrees * std::numbers::pi / 180.0, *axis));
    }
    return placement;
  }

  static Result<Animation> animation_of(const Json& node, const std::string& place) {
    Animation animation;
    animation.loop = node.value("loop", true);
    animation.interpolation = node.value("interpolation", "smooth") == "linear"
                                  ? Animation::Interpolation::linear
                                  : Animation::Interpolation::smooth;
    if (node.contains("keyframes")) {
      for (std::size_t i = 0; i < node["keyframes"].size(); ++i) {
        const Json& key = node["keyframes"][i];
        const std::string key_place = fmt::format("{}/keyframes/{}", place, i);
        const Result<Placement> placement = placement_of(key, key_place);
        if (!placement) return tl::unexpected(placement.error());
        const double time_s = key["time"].get<double>();
        if (i > 0 && !(time_s > animation.keyframes.back().time_s)) {
          return fail(
              "{}/time: {} s is not after the keyframe before; put keyframes in order of time",
              key_place, time_s);
        }
        animation.keyframes.push_back({time_s, *placement});
      }
      if (animation.loop && animation.keyframes.size() > 1) {
        const Placement& first = animation.keyframes.front().placement;
        const Placement& last = animation.keyframes.back().placement;
        if ((first.position - last.position).norm() > 1e-6 ||
            std::abs(first.scale - last.scale) > 1e-9 ||
            first.rotation.angularDistance(last.rotation) > 1e-6) {
          return fail(
              "{}/keyframes: a loop must end as it begins; repeat the first keyframe at the end, "
              "or say \"loop\": false",
              place);
        }
      }
    }
    if (node.contains("spin")) {
      const Json& spin = node["spin"];
      animation.spin_turns_per_s = spin["turns_per_second"].get<double>();
      if (spin.contains("axis")) {
        const Result<Eigen::Vector3d> axis = direction_of(spin["axis"], place + "/spin/axis");
        if (!axis) return tl::unexpected(axis.error());
        animation.spin_axis = *axis;
      }
    }
    return animation;
  }

  static Result<Model> model_of_shape(const Json& shape, const std::string& place) {
    const int kinds = static_cast<int>(shape.contains("box")) +
                      static_cast<int>(shape.contains("sphere")) +
                      static_cast<int>(shape.contains("cylinder"));
    if (kinds != 1) return fail("{}: give one of box, sphere and cylinder", place);
    Model model;
    if (shape.contains("box")) {
      model = make_box({shape["box"][0].get<float>(), shape["box"][1].get<float>(),
                        shape["box"][2].get<float>()});
    } else if (shape.contains("sphere")) {
      model = make_sphere(shape["sphere"].get<float>());
    } else {
      model = make_cylinder(shape["cylinder"][0].get<float>(), shape["cylinder"][1].get<float>());
    }
    if (shape.contains("color")) {
      const Eigen::Vector3d color = vector_of(shape["color"]);
      model.materials[0].base_color = {static_cast<float>(color.x()), static_cast<float>(color.y()),
                                       static_cast<float>(color.z()), 1.0F};
    }
    return model;
  }

  Result<std::shared_ptr<const Model>> model_of(const Json& node, const std::string& place,
                                                std::string& file_name) {
    if (node.contains("model") == node.contains("shape"))
      return fail("{}: give either a model file or a shape", place);
    if (node.contains("shape")) {
      Result<Model> model = model_of_shape(node["shape"], place + "/shape");
      if (!model) return tl::unexpected(model.error());
      return std::make_shared<const Model>(std::move(*model));
    }
    UpAxis up = UpAxis::by_format;
    if (node.contains("up")) up = node["up"] == "y" ? UpAxis::y : UpAxis::z;
    const std::filesystem::path named(node["model"].get<std::string>());
    const std::filesystem::path file = named.is_absolute() ? named : folder_ / named;
    file_name = file.string();
    std::shared_ptr<const Model>& model = models_[{file_name, up}];
    if (!model) {
      Result<Model> loaded = load_model(file, up);
      if (!loaded) return fail_in(place + "/model", loaded.error());
      model = std::make_shared<const Model>(std::move(*loaded));
    }
    return model;
  }

  Result<void> read_objects(const char* key, bool phantom) {
    if (!document_.contains(key)) return {};
    for (std::size_t i = 0; i < document_[key].size(); ++i) {
      const Json& node = document_[key][i];
      const std::string place = fmt::format("/{}/{}", key, i);
      SceneObject object;
      object.name = node["name"].get<std::string>();
      object.phantom = phantom;
      object.casts_shadow = !phantom && node.value("casts", true);
      if (!object_index_.emplace(object.name, static_cast<int>(scene_.objects.size())).second) {
        return fail("{}/name: '{}' is taken; give every object a name of its own", place,
                    object.name);
      }
      if (node.contains("parent")) {
        const std::string parent = node["parent"].get<std::string>();
        const auto found = object_index_.find(parent);
        if (found == object_index_.end() || parent == object.name) {
          return fail(
              "{}/parent: there is no object '{}' before this one; list parents before their "
              "children",
              place, parent);
        }
        object.parent = found->second;
      }
      Result<std::shared_ptr<const Model>> model = model_of(node, place, object.model_file);
      if (!model) return tl::unexpected(model.error());
      object.model = std::move(*model);
      const Result<Placement> placement = placement_of(node, place);
      if (!placement) return tl::unexpected(placement.error());
      object.placement = *placement;
      if (node.contains("animation")) {
        Result<Animation> animation = animation_of(node["animation"], place + "/animation");
        if (!animation) return tl::unexpected(animation.error());
        object.animation = std::move(*animation);
      }
      scene_.objects.push_back(std::move(object));
    }
    return {};
  }

  Result<void> read_planes() {
    if (!document_.contains("planes") || document_["planes"].empty()) {
      scene_.planes.emplace_back();
      scene_.planes.back().name = "table";
      plane_index_.emplace("table", 0);
      return {};
    }
    for (std::size_t i = 0; i < document_["planes"].size(); ++i) {
      const Json& node = document_["planes"][i];
      const std::string place = fmt::format("/planes/{}", i);
      ScenePlane plane;
      plane.name = node["name"].get<std::string>();
      if (!plane_index_.emplace(plane.name, static_cast<int>(i)).second)
        return fail("{}/name: '{}' is taken; give every plane a name of its own", place,
                    plane.name);
      if (node.contains("normal")) {
        const Result<Eigen::Vector3d> normal = direction_of(node["normal"], place + "/normal");
        if (!normal) return tl::unexpected(normal.error());
        plane.normal = *normal;
      }
      if (node.contains("point")) plane.point = vector_of(node["point"]);
      plane.tag_group = node.value("tag_group", "table");
      if (node.contains("outline")) {
        for (const Json& corner : node["outline"])
          plane.outline.emplace_back(corner[0].get<double>(), corner[1].get<double>());
      }
      scene_.planes.push_back(std::move(plane));
    }
    return {};
  }

  Result<void> read_lights() {
    if (!document_.contains("lights")) return {};
    for (std::size_t i = 0; i < document_["lights"].size(); ++i) {
      const Json& node = document_["lights"][i];
      const std::string place = fmt::format("/lights/{}", i);
      SceneLight light;
      light.name = node["name"].get<std::string>();
      if (!light_index_.emplace(light.name, static_cast<int>(i)).second)
        return fail("{}/name: '{}' is taken; give every light a name of its own", place,
                    light.name);
      const bool point = node["type"] == "point";
      light.kind = point ? SceneLight::Kind::point : SceneLight::Kind::directional;
      const char* needed = point ? "position" : "towards";
      const char* foreign = point ? "towards" : "position";
      if (!node.contains(needed))
        return fail("{}: a {} light needs '{}'", place, node["type"].get<std::string>(), needed);
      if (node.contains(foreign))
        return fail("{}/{}: has no meaning for a {} light; remove it", place, foreign,
                    node["type"].get<std::string>());
      if (point) {
        light.position = vector_of(node["position"]);
      } else {
        const Result<Eigen::Vector3d> direction = direction_of(node["towards"], place + "/towards");
        if (!direction) return tl::unexpected(direction.error());
        light.direction = *direction;
      }
      if (node.contains("color")) light.color = vector_of(node["color"]);
      light.intensity = node.value("intensity", 1.0);
      scene_.lights.push_back(std::move(light));
    }
    return {};
  }

  static Result<std::vector<int>> indices_of(const Json& names,
                                             const std::map<std::string, int>& index,
                                             const std::string& place, const char* kind) {
    std::vector<int> indices;
    for (std::size_t i = 0; i < names.size(); ++i) {
      const std::string name = names[i].get<std::string>();
      const auto found = index.find(name);
      if (found == index.end()) return fail("{}/{}: there is no {} '{}'", place, i, kind, name);
      if (std::find(indices.begin(), indices.end(), found->second) != indices.end())
        return fail("{}/{}: '{}' is listed twice", place, i, name);
      indices.push_back(found->second);
    }
    return indices;
  }

  Result<LayeredConstants> constants_of(const Json& node, const std::string& place) {
    const bool by_workspace = node.contains("workspace_height") || node.contains("magnification");
    const bool by_light = node.contains("light_height") || node.contains("light_ratio") ||
                          node.contains("umbra_height");
    if (by_workspace && by_light) {
      return fail(
          "{}: give either workspace_height and magnification, or light_height with light_ratio or "
          "umbra_height",
          place);
    }
    Result<LayeredConstants> constants = LayeredConstants{};
    if (by_workspace) {
      if (!node.contains("workspace_height") || !node.contains("magnification"))
        return fail("{}: workspace_height and magnification go together", place);
      constants = layered_constants_for_workspace(node["workspace_height"].get<double>(),
                                                  node["magnification"].get<double>());
    } else if (by_light) {
      if (!node.contains("light_height")) return fail("{}: light_height is missing", place);
      if (node.contains("light_ratio") == node.contains("umbra_height"))
        return fail("{}: give one of light_ratio and umbra_height with light_height", place);
      const Json& height = node["light_height"];
      constants = make_layered_constants(
          height.is_string() ? std::numeric_limits<double>::infinity() : height.get<double>(),
          node.value("light_ratio", 0.0), node.value("umbra_height", 0.0));
    }
    if (!constants) return fail_in(place, constants.error());
    if (constants->light_ratio <= 1.0 && std::isfinite(constants->light_height)) {
      scene_.warnings.push_back(
          fmt::format("{}: light_ratio is {}: with 1 or less the umbra never vanishes", place,
                      constants->light_ratio));
    }
    return constants;
  }

  Result<void> read_shadows() {
    if (!document_.contains("shadows")) return {};
    std::set<std::string> names;
    for (std::size_t i = 0; i < document_["shadows"].size(); ++i) {
      const Json& node = document_["shadows"][i];
      const std::string place = fmt::format("/shadows/{}", i);
      ShadowNode shadow;
      shadow.name = node["name"].get<std::string>();
      if (!names.insert(shadow.name).second)
        return fail("{}/name: '{}' is taken; give every shadow node a name of its own", place,
                    shadow.name);

      if (node.contains("casters")) {
        Result<std::vector<int>> casters =
            indices_of(node["casters"], object_index_, place + "/casters", "object");
        if (!casters) return tl::unexpected(casters.error());
        shadow.casters = std::move(*casters);
        for (std::size_t c = 0; c < shadow.casters.size(); ++c) {
          if (scene_.objects[static_cast<std::size_t>(shadow.casters[c])].phantom) {
            return fail("{}/casters/{}: is a phantom; a real thing casts its own shadow", place, c);
          }
        }
      } else {
        for (std::size_t o = 0; o < scene_.objects.size(); ++o) {
          if (scene_.objects[o].casts_shadow) shadow.casters.push_back(static_cast<int>(o));
        }
      }
      if (node.contains("planes")) {
        Result<std::vector<int>> planes =
            indices_of(node["planes"], plane_index_, place + "/planes", "plane");
        if (!planes) return tl::unexpected(planes.error());
        shadow.planes = std::move(*planes);
      } else {
        shadow.planes = {0};
      }
      if (node.contains("lights")) {
        Result<std::vector<int>> lights =
            indices_of(node["lights"], light_index_, place + "/lights", "light");
        if (!lights) return tl::unexpected(lights.error());
        shadow.lights = std::move(*lights);
      } else {
        shadow.lights.resize(scene_.lights.size());
        std::iota(shadow.lights.begin(), shadow.lights.end(), 0);
      }

      const std::string technique = node.value("technique", "layered");
      const auto known = shadow_technique_from_string(technique);
      if (!known) {
        std::string list;
        for (const ShadowTechniqueName& entry : kShadowTechniqueNames)
          list += fmt::format("{}{}", list.empty() ? "" : ", ", entry.name);
        return fail("{}/technique: '{}' is not known; use {}", place, technique, list);
      }
      shadow.technique = *known;
      if (node.contains("kernels")) {
        const std::string kernels = node["kernels"].get<std::string>();
        const auto source = kernel_source_from_string(kernels);
        if (!source) {
          std::string list;
          for (const KernelSourceName& entry : kKernelSourceNames)
            list += fmt::format("{}{}", list.empty() ? "" : ", ", entry.name);
          return fail("{}/kernels: '{}' is not known; use {}", place, kernels, list);
        }
        shadow.kernels = *source;
      }
      const Result<LayeredConstants> constants = constants_of(node, place);
      if (!constants) return tl::unexpected(constants.error());
      shadow.layered = *constants;
      if (node.contains("light_left")) {
        const Json& left = node["light_left"];
        shadow.fractions.umbra = left.value("umbra", shadow.fractions.umbra);
        shadow.fractions.middle = left.value("middle", shadow.fractions.middle);
        shadow.fractions.penumbra = left.value("penumbra", shadow.fractions.penumbra);
        if (!(shadow.fractions.umbra <= shadow.fractions.middle &&
              shadow.fractions.middle <= shadow.fractions.penumbra)) {
          return fail(
              "{}/light_left: the umbra must be the darkest layer and the penumbra the lightest",
              place);
        }
      }
      scene_.shadows.push_back(std::move(shadow));
    }
    return {};
  }

  const Json& document_;
  std::filesystem::path folder_;
  Scene scene_;
  std::map<std::string, int> object_index_;
  std::map<std::string, int> plane_index_;
  std::map<std::string, int> light_index_;
  std::map<std::pair<std::string, UpAxis>, std::shared_ptr<const Model>> models_;
};

}  // namespace

Result<Scene> load_scene(const std::filesystem::path& file) {
  const Result<std::string> text = read_text_file(file, kMaxSceneBytes);
  if (!text) return tl::unexpected(text.error());
  try {
    const Json document = Json::parse(*text, nullptr, true, true);
    if (const Result<void> checked = check_against_schema(document); !checked)
      return fail_in(file.string(), checked.error());
    Result<Scene> scene = SceneReader(document, file.parent_path()).read();
    if (!scene) return fail_in(file.string(), scene.error());
    scene->file = file.string();
    if (scene->name.empty()) scene->name = file.stem().string();
    return scene;
  } catch (const Json::parse_error& error) {
    // "[json.exception.parse_error.101] parse error at line 3, column 7: ..." -> from the line on
    const std::string what = error.what();
    const std::size_t start = what.find("at line");
    return fail("{}: is not JSON {}; correct it there", file.string(),
                start == std::string::npos ? what : what.substr(start));
  } catch (const std::exception& error) {
    return fail("{}: cannot be read as a scene: {}", file.string(), error.what());
  }
}

}  // namespace penumbra
