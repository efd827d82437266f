#include "render/shadow/model_shadow.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/text/text.hpp"
#include "render/model/cut_out.hpp"
#include "render/model/model_size.hpp"
#include "render/model/part_groups.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {
namespace {

// The request, and the origin of the model once it is known.
struct ShadowJob : ModelShadowRequest {
  Eigen::Vector3d model_origin = Eigen::Vector3d::Zero();
};

// Result of a shadow, and where its warnings go.
struct ShadowBuild : ModelShadow {
  const std::function<void(const std::string&)>& on_warning;
};

// Reports a warning and adds it to the result, unless the result already contains it.
template <class... Args>
void warn(ShadowBuild& result, fmt::format_string<Args...> text, Args&&... args) {
  std::string line = without_control_characters(fmt::format(text, std::forward<Args>(args)...));
  if (std::ranges::find(result.warnings, line) != result.warnings.end()) return;
  if (result.on_warning) result.on_warning(line);
  result.warnings.push_back(std::move(line));
}

// The casting mesh and where its kernels may come from.
struct Caster {
  ShadowMesh mesh;
  bool kernels_from_file = false;
  std::optional<KernelSource> stored_source;  // source of the kernels stored with the model
};

ShadowKernels choose_kernels(const ModelShadowRequest& request, const Caster& caster,
                             ShadowBuild& result) {
  const ShadowMesh& mesh = caster.mesh;
  const Eigen::Vector3d up = up_in_object(request.placement, request.plane);
  ShadowKernels kernels;
  const Stopwatch watch;
  if (caster.kernels_from_file) {
    kernels = stored_kernels_of(mesh);
    result.kernel_source = request.kernel_file.string();
    if (!has_stored_kernels_for(mesh, up)) {
      warn(result,
           "{}: its kernels are for up {:.3g},{:.3g},{:.3g} and used as they are; the plane's "
           "normal is {:.3g},{:.3g},{:.3g} for the object; a .glb with kernels gets new ones",
           request.kernel_file.string(), kernels.up.x(), kernels.up.y(), kernels.up.z(), up.x(),
           up.y(), up.z());
    }
  } else {
    const bool as_stored = caster.stored_source && request.source == KernelSource::automatic;
    const bool stored = as_stored && has_stored_kernels_for(mesh, up);
    const KernelSource source = as_stored ? *caster.stored_source : request.source;
    kernels = stored ? stored_kernels_of(mesh) : generate_kernels(mesh, up, source);
    result.kernel_source = stored ? "stored" : std::string(to_string(source));
  }
  result.kernel_ms = watch.elapsed().wall_ms;
  return kernels;
}

Result<void> add_layer(ShadowBuild& result, const std::string& name,
                       const std::vector<PlanePoint>& triangles) {
  auto outline = union_of_triangles(triangles);
  if (!outline) return fail_in(name, outline.error());
  result.layers.push_back({name, std::move(*outline)});
  return {};
}

// Returns the minimum and maximum layer factor between the plane and the caster's top.
std::pair<double, double> factors_of(std::span<const CasterVertex> vertices,
                                     const LayeredConstants& constants) {
  double top = 0.0;
  for (const CasterVertex& vertex : vertices) top = std::max(top, static_cast<double>(vertex.h));
  std::pair<double, double> factors = {1.0, 1.0};
  for (const ShadowLayer layer : kShadowLayers) {
    const double s = layer_factor(constants, layer, top);
    factors = {std::min(factors.first, s), std::max(factors.second, s)};
  }
  return factors;
}

// Returns nullopt if no proxy is requested or if reducing the mesh is not worthwhile.
Result<std::optional<ShadowProxy>> make_proxy(const ShadowJob& request, const ShadowMesh& mesh,
                                              ShadowBuild& result) {
  if (request.proxy == ModelShadowRequest::Proxy::simplified) return simplified_caster(mesh);
  if (request.proxy == ModelShadowRequest::Proxy::none) return std::optional<ShadowProxy>();
  PENUMBRA_TRY(auto model,
               load_model(request.proxy_file, {.up = request.up, .unit_m = request.unit_m}));
  for (const std::string& warning : model.warnings) warn(result, "{}", warning);
  result.files.insert(result.files.end(), model.files.begin(), model.files.end());
  move_origin(model, request.model_origin);
  return std::optional<ShadowProxy>(proxy_from_model(mesh, model));
}

// Moves the plane's origin under the caster's centre: floats are most precise near the origin.
PlaneFrame plane_under(const ShadowMesh& mesh, const Placement& placement,
                       const PlaneFrame& plane) {
  Eigen::AlignedBox3d box;
  for (const glm::vec3& p : mesh.positions) box.extend(to_eigen(p));
  if (box.isEmpty()) return plane;
  const Eigen::Vector3d middle = plane.to_plane(placement * box.center());
  PlaneFrame under = plane;
  under.q += middle.x() * plane.e1 + middle.y() * plane.e2;
  return under;
}

// Warns if the shadow has no area, or if the caster extends above the light or the workspace.
void warn_of_heights(const ModelShadowRequest& request, std::span<const CasterVertex> vertices,
                     std::span<const std::uint32_t> indices, ShadowBuild& result) {
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const std::uint32_t index : indices) {
    const auto h = static_cast<double>(vertices[index].h);
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  const std::string name = request.model.string();
  if (indices.empty()) {
    warn(result, "{}: has no face that casts a shadow", name);
    return;
  }
  if (top < 0.0) {  // at 0 the caster touches the plane and still casts
    warn(result, "{}: is under the plane (its top at {:.3g} m), so there is no shadow", name, top);
    return;
  }
  const bool layers = request.has_layers();
  const double max_height = layer_height_range(request.constants, ShadowLayer::penumbra).high;
  if (layers && bottom >= max_height) {
    warn(result,
         "{}: is {:.3g} m above the plane, too high for a light of H = {:.3g} m, so there is no "
         "shadow; raise --light-height",
         name, bottom, request.constants.light_height);
    return;
  }
  if (layers && top > max_height) {
    warn(result,
         "{}: reaches to {:.3g} m above the plane; what is above {:.3g} m is too high for a light "
         "of H = {:.3g} m and casts nothing; raise --light-height",
         name, top, max_height, request.constants.light_height);
  }
  // The tolerance covers float rounding: a top exactly at the workspace height is inside.
  if (layers && request.workspace_height && top > *request.workspace_height * (1.0 + 1e-6)) {
    warn(
        result,
        "{}: reaches to {:.3g} m above the plane, beyond --workspace-height {:g}, and has no umbra "
        "there; give the highest place that objects come to",
        name, top, *request.workspace_height);
  }
  if (request.technique == ModelShadowRequest::Technique::hard && request.light.w() != 0.0) {
    const double light = light_height(request.plane, request.light);
    const double range = hard_shadow_range(request.plane, request.light).high;
    if (light > 0.0 && bottom >= range) {
      warn(result,
           "{}: is {:.3g} m above the plane and the light {:.3g} m, so there is no shadow; raise "
           "--light",
           name, bottom, light);
    } else if (light > 0.0 && top > range) {
      warn(result,
           "{}: reaches to {:.3g} m above the plane, over the light at {:.3g} m; what is above the "
           "light casts nothing; raise --light",
           name, top, light);
    }
  }
  const auto is_empty = [](const auto& layer) { return layer.outline.area <= 0.0; };
  if (request.technique != ModelShadowRequest::Technique::hard &&
      std::all_of(result.layers.begin(), result.layers.end(), is_empty)) {
    warn(result, "{}: no layer of its shadow has an area", name);
  }
}

void slide(LayerOutline& outline, const Eigen::Vector2d& by) {
  for (LayerPolygon& polygon : outline.polygons) {
    for (Eigen::Vector2d& p : polygon.outer) p += by;
    for (auto& hole : polygon.holes) {
      for (Eigen::Vector2d& p : hole) p += by;
    }
  }
}

// Discards stored kernels that do not fit the options, with a warning.
void check_stored_kernels(const ModelShadowRequest& request, const Model& model, Caster& caster,
                          ShadowBuild& result) {
  const std::string name =
      (caster.kernels_from_file ? request.kernel_file : request.model).string();
  const bool automatic = request.source == KernelSource::automatic;
  if (model.shadow_kernel_up && automatic &&
      !stored_kernels_fit(model, caster.mesh, request.groups)) {
    warn(result, "{}: its kernels are for other parts than --group names; they are computed again",
         name);
    caster.kernels_from_file = false;
  }
  if (request.fixed_light && !caster.mesh.stored_kernels.empty() && automatic &&
      !have_radii(stored_kernel_source(model))) {
    warn(result,
         "{}: its kernels (cocl) have no thickness, which a light of one size needs; they are "
         "computed again",
         name);
    caster.kernels_from_file = false;
    caster.stored_source.reset();
  }
}

// Makes the casting mesh and reads its kernels. Adapts the placement to the model's origin.
Result<Caster> make_caster(ShadowJob& request, Model model, ShadowBuild& result) {
  request.model_origin = model.origin;
  request.placement = placed_model(model, request.placement);
  Caster caster;
  if (!request.kernel_file.empty()) {
    if (!request.kernels_read) {
      PENUMBRA_TRY(request.kernels_read, load_kernel_file(request.kernel_file));
    }
    PENUMBRA_TRY(caster.kernels_from_file,
                 attach_kernels(model, *request.kernels_read, request.kernel_file.string()));
  }
  for (const std::string& warning : model.warnings) warn(result, "{}", warning);
  if (const auto size =
          warning_of_size(model, {.unit_m = request.unit_m}, request.model.string())) {
    warn(result, "{}", *size);
  }
  if (const auto checked = check_groups(model, request.groups); !checked) {
    return fail("{}: {}", request.model.string(), checked.error().message);
  }
  caster.stored_source = stored_kernel_source(model);
  if (request.technique != ModelShadowRequest::Technique::layered) {
    caster.mesh = make_shadow_mesh(model, request.groups, CutOuts::visible_regions);
    return caster;
  }
  caster.mesh = make_shadow_mesh(model, request.groups);
  check_stored_kernels(request, model, caster, result);
  if (has_cut_outs(model)) warn(result, "{}", warning_of_cut_outs(request.model.string()));
  return caster;
}

Result<void> add_hard_shadow(const ModelShadowRequest& request,
                             std::span<const CasterVertex> vertices, const ShadowMesh& mesh,
                             const PlaneFrame& plane, ShadowBuild& result) {
  const auto triangles = projected_triangles(vertices, mesh.indices, request.light, plane);
  if (triangles.empty() && light_height(plane, request.light) <= 0.0) {
    warn(result, "the light is in or under the plane, so there is no shadow");
  }
  return add_layer(result, "shadow", triangles);
}

Result<void> add_field_layers(const ModelShadowRequest& request,
                              std::span<const CasterVertex> vertices, const ShadowMesh& mesh,
                              const PlaneFrame& plane, ShadowBuild& result) {
  // kHalfFieldCell gives the discs the resolution that the renderer uses for fields.
  const ShadowField field = power_distance_layers(
      vertices, mesh.indices, mesh.part,
      part_lights(part_discs(mesh, up_in_object(request.placement, plane), kHalfFieldCell, false),
                  request.placement, plane),
      request.constants);
  for (const auto& [layer, name] : kLayerNames) {
    PENUMBRA_TRY_VOID(add_layer(result, std::string(name), field_triangles(field, layer)));
  }
  return {};
}

// Returns the distinct kernels of a shadow, in plane coordinates.
std::vector<Eigen::Vector2d> kernel_positions(std::span<const CasterVertex> vertices) {
  std::vector<Eigen::Vector2d> positions;
  for (const CasterVertex& vertex : vertices) {
    const Eigen::Vector2d k(static_cast<double>(vertex.ku), static_cast<double>(vertex.kv));
    if (k.allFinite()) positions.push_back(k);
  }
  std::ranges::sort(positions, {},
                    [](const Eigen::Vector2d& p) { return std::pair(p.x(), p.y()); });
  positions.erase(std::unique(positions.begin(), positions.end()), positions.end());
  return positions;
}

void judge_proxy(const ModelShadowRequest& request, const ShadowMesh& mesh,
                 const ShadowKernels& at_tilt, std::span<const PartDisc> parts,
                 const ShadowProxy& proxy, ProxyResult& result) {
  const ProxyUse use{request.constants,
                     request.fixed_light ? LightMode::fixed : LightMode::proportional,
                     request.placement.scale};
  result.agreement = compare_with_proxy(mesh, at_tilt, parts, proxy, use, true);
  result.faces = proxy.mesh.indices.size() / 3;
  result.used = result.agreement.is_sufficient();
}

Result<void> add_penumbra_layers(const ShadowJob& request, const ShadowMesh& mesh,
                                 ShadowKernels kernels, const PlaneFrame& plane,
                                 ShadowBuild& result) {
  const Eigen::Vector3d up = up_in_object(request.placement, plane);
  std::vector<PartDisc> parts;
  if (request.fixed_light) {
    add_missing_radii(kernels, mesh, up);
    parts = part_discs(mesh, up);
  }
  // Stored kernels may be for a slightly different up direction; this copy has the exact one.
  const auto at_tilt = [&] {
    ShadowKernels turned = kernels;
    turned.up = up;
    return turned;
  };
  PENUMBRA_TRY(const auto proxy, make_proxy(request, mesh, result));
  if (proxy) judge_proxy(request, mesh, at_tilt(), parts, *proxy, result.proxy);
  const bool reduced = result.proxy.used;
  const ShadowMesh& caster = reduced ? proxy->mesh : mesh;
  if (reduced) kernels = carried_kernels(*proxy, kernels);
  const auto vertices = place_caster(caster, kernels, request.placement, plane);
  std::vector<VertexDisc> discs;
  if (request.fixed_light) {
    discs = vertex_discs(caster, kernels, parts, request.placement.scale);
    result.twists = fixed_light_twists(vertices, discs, caster.indices, request.constants);
  } else {
    const auto [min_factor, max_factor] = factors_of(vertices, request.constants);
    result.twists = find_twists(vertices, caster.indices, min_factor, max_factor);
    result.overshoot_fraction = layer_overshoot(caster, at_tilt(), max_factor);
  }
  result.twisted_faces = result.twists->faces_twisted;
  for (const auto& [layer, name] : kLayerNames) {
    const auto triangles =
        request.fixed_light
            ? fixed_light_triangles(vertices, discs, caster.indices, request.constants, layer)
            : layer_triangles(vertices, caster.indices, request.constants, layer);
    PENUMBRA_TRY_VOID(add_layer(result, std::string(name), triangles));
  }
  if (request.show_kernels) result.kernels = kernel_positions(vertices);
  return {};
}

}  // namespace

Result<ModelShadow> compute_shadow(const ModelShadowRequest& request) {
  PENUMBRA_TRY(auto model,
               load_model(request.model,
                          {.up = request.up, .unit_m = request.unit_m, .pose = request.pose}));
  return compute_shadow(request, std::move(model));
}

Result<ModelShadow> compute_shadow(const ModelShadowRequest& given, Model model) {
  ShadowJob request{given};
  ShadowBuild result{{}, given.on_warning};
  result.files = model.files;
  PENUMBRA_TRY(const auto caster, make_caster(request, std::move(model), result));
  const ShadowMesh& mesh = caster.mesh;
  const PlaneFrame plane = plane_under(mesh, request.placement, request.plane);
  result.faces = mesh.indices.size() / 3;
  result.vertices = mesh.positions.size();
  result.parts = mesh.part_count;
  ShadowKernels kernels;
  if (request.technique == ModelShadowRequest::Technique::layered) {
    kernels = choose_kernels(request, caster, result);
  } else {
    kernels.kernels = mesh.positions;
  }
  const auto vertices = place_caster(mesh, kernels, request.placement, plane);
  PENUMBRA_TRY(auto object, union_of_triangles(orthogonal_triangles(vertices, mesh.indices)));
  result.object = object;
  Result<void> added;
  switch (request.technique) {
    case ModelShadowRequest::Technique::simple:
      result.layers.push_back({"shadow", std::move(object)});
      break;
    case ModelShadowRequest::Technique::hard:
      added = add_hard_shadow(request, vertices, mesh, plane, result);
      break;
    case ModelShadowRequest::Technique::field:
      added = add_field_layers(request, vertices, mesh, plane, result);
      break;
    case ModelShadowRequest::Technique::layered:
      added = add_penumbra_layers(request, mesh, std::move(kernels), plane, result);
      break;
  }
  if (!added) return tl::unexpected(added.error());
  warn_of_heights(request, vertices, mesh.indices, result);
  const Eigen::Vector2d origin = request.plane.to_plane(plane.q).head<2>();
  slide(result.object, origin);
  for (NamedOutline& layer : result.layers) slide(layer.outline, origin);
  for (Eigen::Vector2d& kernel : result.kernels) kernel += origin;
  return ModelShadow(std::move(result));
}

}  // namespace penumbra
