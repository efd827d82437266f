#include <algorithm>
#include <cmath>
#include <penumbra/shadow.hpp>

#include "core/text/text.hpp"
#include "library/support.hpp"
#include "render/model/model.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/part_groups.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/model_shadow.hpp"

namespace penumbra::shadow {

struct Model::Impl {
  penumbra::Model model;
  std::string name;  // in messages: the file, or the mesh's name
  double unit_m = 1.0;
};

struct Kernels::Impl {
  KernelFile file;
  std::string name;  // in messages
};

struct Access {
  using OfModel = Model::Impl;
  using OfKernels = Kernels::Impl;
  [[nodiscard]] static const OfModel& of(const Model& model) { return *model.impl_; }
  [[nodiscard]] static const OfKernels& of(const Kernels& kernels) { return *kernels.impl_; }
};

namespace {

constexpr double kMaxScale = 1e6;

penumbra::UpAxis to_internal(UpAxis up) {
  switch (up) {
    case UpAxis::by_format:
      return penumbra::UpAxis::by_format;
    case UpAxis::y:
      return penumbra::UpAxis::y;
    case UpAxis::z:
      return penumbra::UpAxis::z;
  }
  throw_failure("up: {} is no axis", static_cast<int>(up));
}

penumbra::KernelSource to_internal(KernelSource source) {
  switch (source) {
    case KernelSource::automatic:
      return penumbra::KernelSource::automatic;
    case KernelSource::smooth:
      return penumbra::KernelSource::smooth;
    case KernelSource::per_axis:
      return penumbra::KernelSource::per_axis;
    case KernelSource::centroid:
      return penumbra::KernelSource::centroid;
  }
  throw_failure("kernel_source: {} is no source of kernels", static_cast<int>(source));
}

ModelShadowRequest::Technique to_internal(Technique technique) {
  switch (technique) {
    case Technique::layered:
      return ModelShadowRequest::Technique::layered;
    case Technique::field:
      return ModelShadowRequest::Technique::field;
    case Technique::simple:
      return ModelShadowRequest::Technique::simple;
    case Technique::hard:
      return ModelShadowRequest::Technique::hard;
  }
  throw_failure("technique: {} is no shadow technique", static_cast<int>(technique));
}

bool is_finite(const Vector3& v) {
  return std::ranges::all_of(v, [](double x) { return std::isfinite(x); });
}

// Returns the unit vector, or throws if there is none.
Eigen::Vector3d checked_direction(const Vector3& v, std::string_view place) {
  const Eigen::Vector3d direction = penumbra::to_eigen(v);
  if (!direction.allFinite() || !(direction.stableNorm() > 0.0)) {
    throw_failure("{}: ({}, {}, {}) is no direction; give three finite numbers, not all 0", place,
                  v[0], v[1], v[2]);
  }
  return direction.stableNormalized();
}

penumbra::Model model_from(const Mesh& mesh, const std::string& name) {
  const ModelLimits limits;
  Eigen::AlignedBox3d bounds;
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    const Vector3& p = mesh.positions[i];
    if (!is_finite(p) || penumbra::to_eigen(p).cwiseAbs().maxCoeff() > limits.max_coordinate_m) {
      throw_failure("{}: positions[{}]: ({}, {}, {}) is no point within {:g} m of the origin", name,
                    i, p[0], p[1], p[2], limits.max_coordinate_m);
    }
    bounds.extend(penumbra::to_eigen(p));
  }
  if (mesh.positions.size() > limits.max_vertices) {
    throw_failure("{}: has {} vertices, more than the {} allowed", name, mesh.positions.size(),
                  limits.max_vertices);
  }
  penumbra::Model model;
  model.name = name;
  model.origin = model_origin(bounds);
  model.materials.emplace_back();
  penumbra::Mesh& made = model.meshes.emplace_back();
  made.name = name;
  for (const Vector3& p : mesh.positions) {
    made.positions.push_back(to_glm(penumbra::to_eigen(p) - model.origin));
    made.source_vertex.push_back(static_cast<std::uint32_t>(made.source_vertex.size()));
  }
  for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
    for (const std::uint32_t index : mesh.triangles[i]) {
      if (index >= made.positions.size()) {
        throw_failure("{}: triangles[{}]: vertex {} does not exist; the mesh has {} vertices", name,
                      i, index, made.positions.size());
      }
      made.indices.push_back(index);
    }
  }
  model.source_vertex_count = static_cast<std::uint32_t>(made.positions.size());
  generate_normals(made);
  if (model.triangle_count() == 0) {
    throw_failure("{}: has no triangles; export the model with its faces", name);
  }
  throw_if_failed(check_model(model, name, limits));
  return model;
}

void check_groups_of(const Access::OfModel& model, const std::vector<std::string>& groups) {
  throw_if_failed(with_place(model.name, penumbra::check_groups(model.model, groups)));
}

LayeredConstants checked_constants(const LightConstants& light) {
  if (light.ratio && light.umbra_height_m) {
    throw_failure("light: has a ratio and an umbra height; give one of the two");
  }
  if (light.ratio && !(*light.ratio > 0.0)) {
    throw_failure("light: ratio: is {}; give a number above 0", *light.ratio);
  }
  if (light.umbra_height_m && !(*light.umbra_height_m > 0.0)) {
    throw_failure("light: umbra_height_m: is {}; give metres above 0", *light.umbra_height_m);
  }
  const bool none = !light.ratio && !light.umbra_height_m && !std::isinf(light.height_m);
  const double ratio = none ? LayeredConstants().light_ratio : light.ratio.value_or(0.0);
  return value_or_throw(with_place(
      "light", make_layered_constants(light.height_m, ratio, light.umbra_height_m.value_or(0.0))));
}

Eigen::Vector4d checked_light(const std::array<double, 4>& light) {
  const Eigen::Vector4d checked(light[0], light[1], light[2], light[3]);
  if (!checked.allFinite() || checked.w() < 0.0 ||
      (checked.head<3>().isZero(0.0) && checked.w() == 0.0)) {
    throw_failure(
        "hard_light: ({}, {}, {}, {}) is no light; give a position (w = 1), or a direction towards "
        "the light (w = 0)",
        light[0], light[1], light[2], light[3]);
  }
  return checked;
}

void choose_kernels(const Options& options, ModelShadowRequest& request) {
  request.source = to_internal(options.kernel_source);
  if (options.kernels) {
    const Access::OfKernels& kernels = Access::of(*options.kernels);
    request.kernels_read = kernels.file;
    request.kernel_file = kernels.name;
    request.source = penumbra::KernelSource::automatic;
  }
  if (options.light_mode != LightMode::fixed && options.light_mode != LightMode::proportional)
    throw_failure("light_mode: {} is no light mode", static_cast<int>(options.light_mode));
  request.fixed_light = options.light_mode == LightMode::fixed;
  if (request.fixed_light && request.technique == ModelShadowRequest::Technique::layered &&
      request.source == penumbra::KernelSource::centroid) {
    throw_failure("light_mode: fixed needs kernels with a thickness; centroid has none");
  }
}

ModelShadowRequest checked_request(const Access::OfModel& model, const Options& options) {
  ModelShadowRequest request;
  request.model = model.name;
  request.unit_m = model.unit_m;
  request.technique = to_internal(options.technique);
  choose_kernels(options, request);
  request.groups = options.groups;
  if (request.has_layers()) request.constants = checked_constants(options.light);
  if (request.technique == ModelShadowRequest::Technique::hard) {
    request.light = checked_light(options.hard_light);
  }
  if (!(options.scale > 0.0 && options.scale <= kMaxScale)) {
    throw_failure("scale: is {}; give a number above 0, up to {:g}", options.scale, kMaxScale);
  }
  const auto T_world_object =
      checked_transform<frame::Map, frame::Object>(options.T_world_object, "T_world_object");
  request.placement = {T_world_object.translation(), T_world_object.rotation(), options.scale};
  if (!is_finite(options.plane.point)) throw_failure("plane: point: is not finite");
  request.plane = PlaneFrame::make(checked_direction(options.plane.normal, "plane: normal"),
                                   penumbra::to_eigen(options.plane.point));
  return request;
}

std::vector<Vector2> to_public(const std::vector<Eigen::Vector2d>& ring) {
  std::vector<Vector2> points;
  points.reserve(ring.size());
  for (const Eigen::Vector2d& p : ring) points.push_back(penumbra::to_public(p));
  return points;
}

Layer to_public(const std::string& name, const LayerOutline& outline) {
  Layer layer;
  layer.name = name;
  layer.area_m2 = outline.area;
  for (const LayerPolygon& polygon : outline.polygons) {
    Polygon& made = layer.polygons.emplace_back();
    made.outer = to_public(polygon.outer);
    for (const auto& hole : polygon.holes) made.holes.push_back(to_public(hole));
  }
  return layer;
}

}  // namespace

Model::Model(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
Model::Model(const Model&) = default;
Model& Model::operator=(const Model&) = default;
Model::~Model() = default;

Model::Model(const Mesh& mesh, const std::string& name)
    : impl_(guarded([&] {
        return std::make_shared<const Impl>(Impl{model_from(mesh, name), name, 1.0});
      })) {}

Model Model::load(const std::filesystem::path& file, const ModelOptions& options) {
  return guarded([&] {
    constexpr double kMinUnit = 1e-9;
    if (!(options.unit_m >= kMinUnit && options.unit_m <= 1.0 / kMinUnit)) {
      throw_failure("unit_m: is {}; give the length of the file's unit in metres", options.unit_m);
    }
    penumbra::Model model =
        value_or_throw(load_model(file, {.up = to_internal(options.up), .unit_m = options.unit_m}));
    return Model(
        std::make_shared<const Impl>(Impl{std::move(model), file.string(), options.unit_m}));
  });
}

std::size_t Model::vertex_count() const {
  return impl_->model.vertex_count();
}
std::size_t Model::triangle_count() const {
  return impl_->model.triangle_count();
}
const std::vector<std::string>& Model::warnings() const {
  return impl_->model.warnings;
}

Kernels::Kernels(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
Kernels::Kernels(const Kernels&) = default;
Kernels& Kernels::operator=(const Kernels&) = default;
Kernels::~Kernels() = default;

Kernels Kernels::make(const Model& model, const Vector3& up, KernelSource source,
                      const std::vector<std::string>& groups) {
  return guarded([&] {
    const Access::OfModel& given = Access::of(model);
    const Eigen::Vector3d direction = checked_direction(up, "up");
    check_groups_of(given, groups);
    const ShadowMesh mesh = make_shadow_mesh(given.model, groups);
    const ShadowKernels made = generate_kernels(mesh, direction, to_internal(source));
    return Kernels(std::make_shared<const Impl>(
        Impl{make_kernel_file(given.model, mesh, made, to_internal(source), groups), "kernels"}));
  });
}

Kernels Kernels::load(const std::filesystem::path& file) {
  return guarded([&] {
    return Kernels(
        std::make_shared<const Impl>(Impl{value_or_throw(load_kernel_file(file)), file.string()}));
  });
}

void Kernels::save(const std::filesystem::path& file) const {
  guarded([&] { throw_if_failed(write_text_file(file, kernel_file_json(impl_->file))); });
}

Vector3 Kernels::up() const {
  return penumbra::to_public(impl_->file.up);
}

std::vector<Vector3> Kernels::points() const {
  std::vector<Vector3> points;
  for (const glm::vec3& kernel : impl_->file.kernels) {
    points.push_back(
        penumbra::to_public(Eigen::Vector3d(impl_->file.origin + penumbra::to_eigen(kernel))));
  }
  return points;
}

LightConstants light_for_workspace(double max_height_m, double magnification) {
  const LayeredConstants constants =
      value_or_throw(layered_constants_for_workspace(max_height_m, magnification));
  return {constants.light_height, constants.light_ratio, std::nullopt};
}

Shadow cast(const Model& model, const Options& options) {
  return guarded([&] {
    const Access::OfModel& given = Access::of(model);
    const ModelShadow computed =
        value_or_throw(compute_shadow(checked_request(given, options), given.model));
    Shadow shadow;
    for (const NamedOutline& layer : computed.layers) {
      shadow.layers.push_back(to_public(layer.name, layer.outline));
    }
    shadow.object = to_public("object", computed.object);
    shadow.kernel_source = computed.kernel_source;
    shadow.twisted_faces = computed.twisted_faces;
    shadow.warnings = computed.warnings;
    return shadow;
  });
}

}  // namespace penumbra::shadow
