#include "app/commands/shadow_job.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <limits>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
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

// Logs a warning and adds it to the result, unless the result already contains it.
template <class... Args>
void warn(ShadowResult& result, fmt::format_string<Args...> text, Args&&... args) {
  std::string line = without_control_characters(fmt::format(text, std::forward<Args>(args)...));
  if (std::ranges::find(result.warnings, line) != result.warnings.end()) return;
  log_warning("{}", line);
  result.warnings.push_back(std::move(line));
}

// The casting mesh and where its kernels may come from.
struct Caster {
  ShadowMesh mesh;
  bool kernels_from_file = false;
  std::optional<KernelSource> stored_source;  // source of the kernels stored with the model
};

ShadowKernels choose_kernels(const ShadowJob& job, const Caster& caster, ShadowResult& result) {
  const ShadowMesh& mesh = caster.mesh;
  const Eigen::Vector3d up = up_in_object(job.placement, job.plane);
  ShadowKernels kernels;
  const Stopwatch watch;
  if (caster.kernels_from_file) {
    kernels = stored_kernels_of(mesh);
    result.kernel_source = job.kernel_file.string();
    if (!has_stored_kernels_for(mesh, up)) {
      warn(result,
           "{}: its kernels are for up {:.3g},{:.3g},{:.3g} and used as they are; the plane's "
           "normal is {:.3g},{:.3g},{:.3g} for the object; a .glb with kernels gets new ones",
           job.kernel_file.string(), kernels.up.x(), kernels.up.y(), kernels.up.z(), up.x(), up.y(),
           up.z());
    }
  } else {
    const bool as_stored = caster.stored_source && job.source == KernelSource::automatic;
    const bool stored = as_stored && has_stored_kernels_for(mesh, up);
    const KernelSource source = as_stored ? *caster.stored_source : job.source;
    kernels = stored ? stored_kernels_of(mesh) : generate_kernels(mesh, up, source);
    result.kernel_source = stored ? "stored" : std::string(to_string(source));
  }
  result.kernel_ms = watch.elapsed().wall_ms;
  return kernels;
}

Result<void> add_layer(ShadowResult& result, const std::string& name,
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
Result<std::optional<ShadowProxy>> make_proxy(const ShadowJob& job, const ShadowMesh& mesh,
                                              ShadowResult& result) {
  if (job.proxy == ShadowJob::Proxy::simplified) return simplified_caster(mesh);
  if (job.proxy == ShadowJob::Proxy::none) return std::optional<ShadowProxy>();
  PENUMBRA_TRY(auto model, load_model(job.proxy_file, {.up = job.up, .unit_m = job.unit_m}));
  for (const std::string& warning : model.warnings) warn(result, "{}", warning);
  move_origin(model, job.model_origin);
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
void warn_of_heights(const ShadowJob& job, std::span<const CasterVertex> vertices,
                     std::span<const std::uint32_t> indices, ShadowResult& result) {
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const std::uint32_t index : indices) {
    const auto h = static_cast<double>(vertices[index].h);
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  const std::string name = job.model.string();
  if (indices.empty()) {
    warn(result, "{}: has no face that casts a shadow", name);
    return;
  }
  if (top < 0.0) {  // at 0 the caster touches the plane and still casts
    warn(result, "{}: is under the plane (its top at {:.3g} m), so there is no shadow", name, top);
    return;
  }
  const bool layers = job.has_layers();
  const double max_height = layer_height_range(job.constants, ShadowLayer::penumbra).high;
  if (layers && bottom >= max_height) {
    warn(result,
         "{}: is {:.3g} m above the plane, too high for a light of H = {:.3g} m, so there is no "
         "shadow; raise --light-height",
         name, bottom, job.constants.light_height);
    return;
  }
  if (layers && top > max_height) {
    warn(result,
         "{}: reaches to {:.3g} m above the plane; what is above {:.3g} m is too high for a light "
         "of H = {:.3g} m and casts nothing; raise --light-height",
         name, top, max_height, job.constants.light_height);
  }
  // The tolerance covers float rounding: a top exactly at the workspace height is inside.
  if (layers && job.workspace_height && top > *job.workspace_height * (1.0 + 1e-6)) {
    warn(
        result,
        "{}: reaches to {:.3g} m above the plane, beyond --workspace-height {:g}, and has no umbra "
        "there; give the highest place that objects come to",
        name, top, *job.workspace_height);
  }
  if (job.technique == ShadowJob::Technique::hard && job.light.w() != 0.0) {
    const double light = light_height(job.plane, job.light);
    const double range = hard_shadow_range(job.plane, job.light).high;
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
  if (job.technique != ShadowJob::Technique::hard &&
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
void check_stored_kernels(const ShadowJob& job, const Model& model, Caster& caster,
                          ShadowResult& result) {
  const std::string name = (caster.kernels_from_file ? job.kernel_file : job.model).string();
  const bool automatic = job.source == KernelSource::automatic;
  if (model.shadow_kernel_up && automatic && !stored_kernels_fit(model, caster.mesh, job.groups)) {
    warn(result, "{}: its kernels are for other parts than --group names; they are computed again",
         name);
    caster.kernels_from_file = false;
  }
  if (job.fixed_light && !caster.mesh.stored_kernels.empty() && automatic &&
      !have_radii(stored_kernel_source(model))) {
    warn(result,
         "{}: its kernels (cocl) have no thickness, which a light of one size needs; they are "
         "computed again",
         name);
    caster.kernels_from_file = false;
    caster.stored_source.reset();
  }
}

// Loads the model and its kernels. Adapts the job's placement to the model's origin.
Result<Caster> load_caster(ShadowJob& job, ShadowResult& result) {
  PENUMBRA_TRY(auto model, load_model(job.model, {.up = job.up, .unit_m = job.unit_m}));
  job.model_origin = model.origin;
  job.placement = placed_model(model, job.placement);
  Caster caster;
  if (!job.kernel_file.empty()) {
    PENUMBRA_TRY(const auto file, load_kernel_file(job.kernel_file));
    PENUMBRA_TRY(caster.kernels_from_file, attach_kernels(model, file, job.kernel_file.string()));
  }
  for (const std::string& warning : model.warnings) warn(result, "{}", warning);
  if (const auto size = warning_of_size(model, {.unit_m = job.unit_m}, job.model.string())) {
    warn(result, "{}", *size);
  }
  if (const auto checked = check_groups(model, job.groups); !checked) {
    return fail("{}: {}", job.model.string(), checked.error().message);
  }
  caster.stored_source = stored_kernel_source(model);
  if (job.technique != ShadowJob::Technique::layered) {
    caster.mesh = make_shadow_mesh(model, job.groups, CutOuts::visible_regions);
    return caster;
  }
  caster.mesh = make_shadow_mesh(model, job.groups);
  check_stored_kernels(job, model, caster, result);
  if (has_cut_outs(model)) warn(result, "{}", warning_of_cut_outs(job.model.string()));
  return caster;
}

Result<void> add_hard_shadow(const ShadowJob& job, std::span<const CasterVertex> vertices,
                             const ShadowMesh& mesh, const PlaneFrame& plane,
                             ShadowResult& result) {
  const auto triangles = projected_triangles(vertices, mesh.indices, job.light, plane);
  if (triangles.empty() && light_height(plane, job.light) <= 0.0) {
    warn(result, "the light is in or under the plane, so there is no shadow");
  }
  return add_layer(result, "shadow", triangles);
}

Result<void> add_field_layers(const ShadowJob& job, std::span<const CasterVertex> vertices,
                              const ShadowMesh& mesh, const PlaneFrame& plane,
                              ShadowResult& result) {
  // kHalfFieldCell gives the discs the resolution that the renderer uses for fields.
  const ShadowField field = power_distance_layers(
      vertices, mesh.indices, mesh.part,
      part_lights(part_discs(mesh, up_in_object(job.placement, plane), kHalfFieldCell, false),
                  job.placement, plane),
      job.constants);
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

void judge_proxy(const ShadowJob& job, const ShadowMesh& mesh, const ShadowKernels& at_tilt,
                 std::span<const PartDisc> parts, const ShadowProxy& proxy, ProxyResult& result) {
  const ProxyUse use{job.constants, job.fixed_light ? LightMode::fixed : LightMode::proportional,
                     job.placement.scale};
  result.agreement = compare_with_proxy(mesh, at_tilt, parts, proxy, use, true);
  result.faces = proxy.mesh.indices.size() / 3;
  result.used = result.agreement.is_sufficient();
}

Result<void> add_penumbra_layers(const ShadowJob& job, const ShadowMesh& mesh,
                                 ShadowKernels kernels, const PlaneFrame& plane,
                                 ShadowResult& result) {
  const Eigen::Vector3d up = up_in_object(job.placement, plane);
  std::vector<PartDisc> parts;
  if (job.fixed_light) {
    add_missing_radii(kernels, mesh, up);
    parts = part_discs(mesh, up);
  }
  // Stored kernels may be for a slightly different up direction; this copy has the exact one.
  const auto at_tilt = [&] {
    ShadowKernels turned = kernels;
    turned.up = up;
    return turned;
  };
  PENUMBRA_TRY(const auto proxy, make_proxy(job, mesh, result));
  if (proxy) judge_proxy(job, mesh, at_tilt(), parts, *proxy, result.proxy);
  const bool reduced = result.proxy.used;
  const ShadowMesh& caster = reduced ? proxy->mesh : mesh;
  if (reduced) kernels = carried_kernels(*proxy, kernels);
  const auto vertices = place_caster(caster, kernels, job.placement, plane);
  std::vector<VertexDisc> discs;
  if (job.fixed_light) {
    discs = vertex_discs(caster, kernels, parts, job.placement.scale);
    result.twists = fixed_light_twists(vertices, discs, caster.indices, job.constants);
  } else {
    const auto [min_factor, max_factor] = factors_of(vertices, job.constants);
    result.twists = find_twists(vertices, caster.indices, min_factor, max_factor);
    result.overshoot_fraction = layer_overshoot(caster, at_tilt(), max_factor);
  }
  result.twisted_faces = result.twists->faces_twisted;
  for (const auto& [layer, name] : kLayerNames) {
    const auto triangles =
        job.fixed_light
            ? fixed_light_triangles(vertices, discs, caster.indices, job.constants, layer)
            : layer_triangles(vertices, caster.indices, job.constants, layer);
    PENUMBRA_TRY_VOID(add_layer(result, std::string(name), triangles));
  }
  if (job.show_kernels) result.kernels = kernel_positions(vertices);
  return {};
}

}  // namespace

Result<ShadowResult> compute_shadow(const ShadowJob& given) {
  ShadowJob job = given;
  ShadowResult result;
  PENUMBRA_TRY(const auto caster, load_caster(job, result));
  const ShadowMesh& mesh = caster.mesh;
  const PlaneFrame plane = plane_under(mesh, job.placement, job.plane);
  result.faces = mesh.indices.size() / 3;
  result.vertices = mesh.positions.size();
  result.parts = mesh.part_count;
  ShadowKernels kernels;
  if (job.technique == ShadowJob::Technique::layered) {
    kernels = choose_kernels(job, caster, result);
  } else {
    kernels.kernels = mesh.positions;
  }
  const auto vertices = place_caster(mesh, kernels, job.placement, plane);
  PENUMBRA_TRY(auto object, union_of_triangles(orthogonal_triangles(vertices, mesh.indices)));
  result.object = object;
  Result<void> added;
  switch (job.technique) {
    case ShadowJob::Technique::simple:
      result.layers.push_back({"shadow", std::move(object)});
      break;
    case ShadowJob::Technique::hard:
      added = add_hard_shadow(job, vertices, mesh, plane, result);
      break;
    case ShadowJob::Technique::field:
      added = add_field_layers(job, vertices, mesh, plane, result);
      break;
    case ShadowJob::Technique::layered:
      added = add_penumbra_layers(job, mesh, std::move(kernels), plane, result);
      break;
  }
  if (!added) return tl::unexpected(added.error());
  warn_of_heights(job, vertices, mesh.indices, result);
  const Eigen::Vector2d origin = job.plane.to_plane(plane.q).head<2>();
  slide(result.object, origin);
  for (ShadowDrawing::Layer& layer : result.layers) slide(layer.outline, origin);
  for (Eigen::Vector2d& kernel : result.kernels) kernel += origin;
  return result;
}

}  // namespace penumbra
