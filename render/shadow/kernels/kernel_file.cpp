#include "render/shadow/kernels/kernel_file.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <utility>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {

namespace {

constexpr std::size_t kMaxKernelFileBytes = std::size_t{1} << 30U;
constexpr double kMaxCoordinate = ModelLimits().max_coordinate_m;

std::optional<double> number_from(const nlohmann::json& json) {
  if (!json.is_number() || !std::isfinite(json.get<double>())) return std::nullopt;
  return json.get<double>();
}

// Returns a hash of the order of the file's vertices, the order of a kernel file's triples.
std::string vertex_order_key(const Model& model) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a over 32-bit words
  for (const Mesh& mesh : model.meshes) {
    for (const std::uint32_t vertex : mesh.source_vertex) {
      hash = (hash ^ vertex) * 1099511628211ULL;
    }
  }
  return fmt::format("{:016x}", hash);
}

// Returns false if the kernel file records another geometry or vertex order.
bool is_for(const KernelFile& kernels, const Model& model) {
  return (kernels.geometry.empty() ||
          kernel_stamp_from(kernels.geometry).geometry == geometry_key(model)) &&
         (kernels.vertex_order.empty() || kernels.vertex_order == vertex_order_key(model));
}

}  // namespace

Result<KernelFile> load_kernel_file(const std::filesystem::path& file) {
  const std::string name = file.string();
  PENUMBRA_TRY(const std::string text, read_text_file(file, kMaxKernelFileBytes));
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, false);
  if (!json.is_object()) {
    return fail("{}: is not a kernel file (a JSON object); make one with penumbra kernels", name);
  }
  const auto list = json.find("kernels");
  if (list == json.end() || !list->is_array() || list->empty() || list->size() % 3 != 0) {
    return fail("{}: kernels: is not a list of three numbers per vertex; give x0, y0, z0, x1, ...",
                name);
  }
  KernelFile result;
  std::vector<Eigen::Vector3d> kernels(list->size() / 3);
  Eigen::AlignedBox3d bounds;
  for (std::size_t i = 0; i < list->size(); ++i) {
    const auto value = number_from((*list)[i]);
    if (!value) return fail("{}: kernels[{}]: is not a finite number; give metres", name, i);
    if (std::abs(*value) > kMaxFileCoordinate) {
      return fail("{}: kernels[{}]: {:g} m is farther away than a model may be ({:g} m)", name, i,
                  *value, kMaxFileCoordinate);
    }
    kernels[i / 3][static_cast<Eigen::Index>(i % 3)] = *value;
    if (i % 3 == 2) bounds.extend(kernels[i / 3]);
  }
  result.origin = model_origin(bounds);
  result.kernels.reserve(kernels.size());
  for (std::size_t i = 0; i < kernels.size(); ++i) {
    const Eigen::Vector3d kernel = kernels[i] - result.origin;
    if (kernel.cwiseAbs().maxCoeff() > kMaxCoordinate) {
      // The message reports the largest coordinate.
      const Eigen::Map<const Eigen::VectorXd> values(kernels.front().data(),
                                                     static_cast<Eigen::Index>(list->size()));
      Eigen::Index farthest = 0;
      values.cwiseAbs().maxCoeff(&farthest);
      return fail("{}: kernels[{}]: is {:g} m, farther away than a model may be ({:g} m)", name,
                  farthest, values[farthest], kMaxCoordinate);
    }
    result.kernels.emplace_back(kernel.x(), kernel.y(), kernel.z());
  }
  const auto up = json.find("up");
  if (up != json.end()) {
    bool usable = up->is_array() && up->size() == 3;
    for (int axis = 0; usable && axis < 3; ++axis) {
      const auto value = number_from((*up)[static_cast<std::size_t>(axis)]);
      usable = value.has_value();
      if (usable) result.up[axis] = *value;
    }
    if (!usable || !(result.up.stableNorm() > 0.0)) {
      return fail("{}: up: is not a direction; give three numbers, such as [0, 0, 1]", name);
    }
    result.up.stableNormalize();
  }
  for (const auto& [key, value] :
       {std::pair("geometry", &result.geometry), std::pair("vertex_order", &result.vertex_order)}) {
    const auto text_of_key = json.find(key);
    if (text_of_key == json.end()) continue;
    if (!text_of_key->is_string())
      return fail("{}: {}: is not a text; leave it out or make the file again", name, key);
    *value = text_of_key->get<std::string>();
  }
  const auto groups = json.find("groups");
  if (groups != json.end()) {
    const auto is_text = [](const nlohmann::json& group) { return group.is_string(); };
    if (!groups->is_array() || groups->size() > kMaxGroups ||
        !std::all_of(groups->begin(), groups->end(), is_text)) {
      return fail("{}: groups: is not a list of names; leave it out or make the file again", name);
    }
    result.groups = groups->get<std::vector<std::string>>();
  }
  return result;
}

std::string kernel_file_json(const KernelFile& kernels) {
  nlohmann::ordered_json json;
  json["up"] = {kernels.up.x(), kernels.up.y(), kernels.up.z()};
  if (!kernels.geometry.empty()) json["geometry"] = kernels.geometry;
  if (!kernels.vertex_order.empty()) json["vertex_order"] = kernels.vertex_order;
  for (const std::string& group : kernels.groups) json["groups"].push_back(as_utf8(group));
  auto& list = json["kernels"] = nlohmann::ordered_json::array();
  for (const glm::vec3& k : kernels.kernels) {
    for (int axis = 0; axis < 3; ++axis) {
      if (kernels.origin.isZero(0.0)) {
        list.push_back(k[axis]);  // as float, which is written with fewer digits
      } else {
        list.push_back(kernels.origin[axis] + static_cast<double>(k[axis]));
      }
    }
  }
  return json.dump() + "\n";
}

Result<bool> attach_kernels(Model& model, const KernelFile& kernels, const std::string& file) {
  if (kernels.kernels.size() != model.source_vertex_count) {
    return fail(
        "{}: kernels: has {} triples, the model \"{}\" has {} vertices; make it again with "
        "penumbra kernels",
        file, kernels.kernels.size(), model.name, model.source_vertex_count);
  }
  if (!is_for(kernels, model)) {
    model.warnings.push_back(
        fmt::format("{}: was made before the model \"{}\" changed; its kernels are computed again",
                    file, model.name));
    // The source and groups of the kernels remain valid.
    model.shadow_kernel_geometry = kernels.geometry;
    model.shadow_kernel_groups = kernels.groups;
    return false;
  }
  const Eigen::Vector3d shift = kernels.origin - model.origin;
  for (Mesh& mesh : model.meshes) {
    mesh.shadow_kernels.resize(mesh.positions.size());
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const glm::vec3& kernel = kernels.kernels[mesh.source_vertex[i]];
      const Eigen::Vector3d m = to_eigen(kernel) + shift;
      mesh.shadow_kernels[i] = shift.isZero(0.0) ? kernel : glm::vec3(m.x(), m.y(), m.z());
    }
  }
  model.shadow_kernel_up = glm::vec3(kernels.up.x(), kernels.up.y(), kernels.up.z());
  model.shadow_kernel_geometry = kernels.geometry;
  model.shadow_kernel_groups = kernels.groups;
  return true;
}

Result<void> attach_kernels_to_scene(Scene& scene, const KernelFile& kernels,
                                     const std::string& file) {
  std::vector<std::shared_ptr<const Model>> casters;  // each model once
  std::string counts;
  for (const SceneObject& object : scene.objects) {
    if (!object.model || !object.casts_shadow || object.playback.model) continue;
    if (std::find(casters.begin(), casters.end(), object.model) != casters.end()) continue;
    casters.push_back(object.model);
    if (casters.size() <= 12) {
      counts += fmt::format("{}{} {}", casters.size() == 1 ? "" : ", ", object.name,
                            object.model->source_vertex_count);
    }
  }
  if (casters.size() > 12) counts += ", ...";
  std::erase_if(casters, [&](const auto& model) {
    return model->source_vertex_count != kernels.kernels.size();
  });
  if (casters.empty()) {
    return fail(
        "{}: kernels: has {} triples, and no caster of {} has as many vertices ({}); make it again "
        "with penumbra kernels",
        file, kernels.kernels.size(), scene.file, counts.empty() ? "there is none" : counts);
  }
  const auto fits = [&](const auto& model) { return is_for(kernels, *model); };
  if (std::any_of(casters.begin(), casters.end(), fits)) {
    std::erase_if(casters, [&](const auto& model) { return !fits(model); });
  }
  for (const std::shared_ptr<const Model>& model : casters) {
    const auto changed = std::make_shared<Model>(*model);
    changed->warnings.clear();
    PENUMBRA_TRY(const bool attached, attach_kernels(*changed, kernels, file));
    scene.warnings.insert(scene.warnings.end(), changed->warnings.begin(), changed->warnings.end());
    if (!attached) continue;
    for (SceneObject& object : scene.objects) {
      if (object.model != model) continue;
      object.model = changed;
      if (object.groups.empty() || !object.casts_shadow) continue;
      if (!stored_kernels_fit(*changed, make_shadow_mesh(*changed, object.groups), object.groups)) {
        scene.warnings.push_back(fmt::format(
            "{}: was made for other parts than the group of \"{}\"; its kernels are computed again",
            file, object.name));
      }
    }
  }
  return {};
}

KernelFile make_kernel_file(const Model& model, const ShadowMesh& mesh,
                            const ShadowKernels& kernels, KernelSource source,
                            std::span<const std::string> groups) {
  KernelFile result;
  result.groups.assign(groups.begin(), groups.end());
  result.up = kernels.up;
  result.origin = model.origin;
  result.geometry =
      fmt::format("{}-{}-{}", geometry_key(model), parts_key(mesh), to_string(source));
  result.vertex_order = vertex_order_key(model);
  result.kernels.assign(mesh.from_source.size(), glm::vec3(0.0F));
  for (std::size_t i = 0; i < mesh.from_source.size(); ++i) {
    if (mesh.from_source[i] != kNoShadowPosition)
      result.kernels[i] = kernels.kernels[mesh.from_source[i]];
  }
  return result;
}

ShadowKernels stored_kernels_of(const ShadowMesh& mesh) {
  ShadowKernels kernels;
  kernels.up = to_eigen(mesh.stored_up).normalized();
  kernels.kernels = mesh.stored_kernels;
  return kernels;
}

KernelSource stored_kernel_source(const Model& model) {
  return value_named(kKernelSourceNames, kernel_stamp_from(model.shadow_kernel_geometry).source)
      .value_or(KernelSource::automatic);
}

bool has_stored_kernels_for(const ShadowMesh& mesh, const Eigen::Vector3d& up) {
  // Kernels are valid up to this angle from the direction they were made for.
  constexpr double kKernelTiltRad = 2.0 * std::numbers::pi / 180.0;
  if (mesh.stored_kernels.empty()) return false;
  const Eigen::Vector3d stored_up = to_eigen(mesh.stored_up);
  // The sine resolves small angles, which the cosine does not.
  return stored_up.cross(up).norm() <= std::sin(kKernelTiltRad) * stored_up.norm() * up.norm();
}

bool add_missing_radii(ShadowKernels& kernels, const ShadowMesh& mesh, const Eigen::Vector3d& up) {
  if (kernels.radius.size() == mesh.positions.size()) return false;
  kernels.radius = generate_kernels(mesh, up, KernelSource::automatic).radius;
  return true;
}

}  // namespace penumbra
