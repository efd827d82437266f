// Loads a model: selects the reader of its format, converts the axes and validates the result.
#include <algorithm>
#include <bit>
#include <cctype>
#include <cmath>
#include <glm/common.hpp>
#include <limits>
#include <map>
#include <mutex>
#include <string>
#include <system_error>

#include "core/image/image_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/animated_model.hpp"
#include "render/model/model.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

void drop_kernels(Model& model) {
  for (Mesh& mesh : model.meshes) mesh.shadow_kernels.clear();
  model.shadow_kernel_up.reset();
}

// Drops stored kernels that do not fit the model; kernels are then computed for the same groups.
// `geometry`: geometry_key() of the model in the axes of the stored kernels.
void check_stored_kernels(Model& model, const std::string& geometry, const std::string& name,
                          const ModelLimits& limits) {
  const auto drop = [&](std::string_view cause) {
    drop_kernels(model);
    model.warnings.push_back(fmt::format(
        "{}: its stored shadow kernels are not used but computed again: {}", name, cause));
  };
  bool complete = true;
  bool finite = is_finite(*model.shadow_kernel_up);
  float farthest = 0.0F;
  for (const Mesh& mesh : model.meshes) {
    complete = complete && mesh.shadow_kernels.size() == mesh.positions.size();
    for (const glm::vec3& k : mesh.shadow_kernels) {
      finite = finite && is_finite(k);
      farthest = std::max({farthest, std::abs(k.x), std::abs(k.y), std::abs(k.z)});
    }
  }
  if (!complete) return drop("not every mesh has them");
  if (!finite) return drop("one is not a finite number");
  if (static_cast<double>(farthest) > limits.max_coordinate_m) {
    return drop(
        fmt::format("one is farther away than a model may be ({:g} m)", limits.max_coordinate_m));
  }
  if (!model.shadow_kernel_geometry.empty() &&
      kernel_stamp_from(model.shadow_kernel_geometry).geometry != geometry) {
    return drop("the model has changed since; store them again with penumbra kernels");
  }
}

// Converts y up to z up.
glm::vec3 z_up_from_y_up(const glm::vec3& v) {
  return {v.x, -v.z, v.y};
}

void convert_to_z_up(Model& model) {
  for (Mesh& mesh : model.meshes) {
    for (glm::vec3& p : mesh.positions) p = z_up_from_y_up(p);
    for (glm::vec3& n : mesh.normals) n = z_up_from_y_up(n);
    for (glm::vec4& t : mesh.tangents) t = glm::vec4(z_up_from_y_up(glm::vec3(t)), t.w);
    for (glm::vec3& k : mesh.shadow_kernels) k = z_up_from_y_up(k);
  }
  if (model.shadow_kernel_up) model.shadow_kernel_up = z_up_from_y_up(*model.shadow_kernel_up);
  model.origin = Eigen::Vector3d(model.origin.x(), -model.origin.z(), model.origin.y());
}

void scale_to_metres(Model& model, double unit_m) {
  const auto scaled = [unit_m](const glm::vec3& v) { return glm::vec3(glm::dvec3(v) * unit_m); };
  for (Mesh& mesh : model.meshes) {
    for (glm::vec3& p : mesh.positions) p = scaled(p);
    for (glm::vec3& k : mesh.shadow_kernels) k = scaled(k);
  }
  model.origin *= unit_m;
}

Eigen::AlignedBox3d bounds_of(const Model& model) {
  return {model.origin + to_eigen(model.min_corner), model.origin + to_eigen(model.max_corner)};
}

// Returns the geometry_key() of the model converted from y up, as in a stamp of stored kernels.
std::string stamped_geometry(const Model& model, UpAxis up) {
  if (up != UpAxis::z) return geometry_key(model);
  Model converted = model;
  convert_to_z_up(converted);
  return geometry_key(converted);
}

// Replaces backslashes by slashes and removes a leading "file:".
std::string plain_path(std::string_view name) {
  constexpr std::string_view kScheme = "file:";
  const bool has_scheme =
      name.size() >= kScheme.size() &&
      std::equal(kScheme.begin(), kScheme.end(), name.begin(),
                 [](char a, char b) { return a == std::tolower(static_cast<unsigned char>(b)); });
  if (has_scheme) name.remove_prefix(kScheme.size());
  std::string path(name);
  std::replace(path.begin(), path.end(), '\\', '/');
  return path;
}

bool has_drive_letter(std::string_view path) {
  return path.size() >= 2 && std::isalpha(static_cast<unsigned char>(path[0])) != 0 &&
         path[1] == ':';
}

}  // namespace

std::size_t Model::vertex_count() const {
  std::size_t count = 0;
  for (const Mesh& mesh : meshes) count += mesh.positions.size();
  return count;
}

std::size_t Model::triangle_count() const {
  std::size_t count = 0;
  for (const Mesh& mesh : meshes) count += mesh.indices.size() / 3;
  return count;
}

std::string geometry_key(const Model& model) {
  std::uint64_t hash = 1469598103934665603ULL;  // FNV-1a over 32-bit words
  const auto add = [&hash](std::uint32_t word) { hash = (hash ^ word) * 1099511628211ULL; };
  for (const Mesh& mesh : model.meshes) {
    add(static_cast<std::uint32_t>(mesh.positions.size()));
    add(static_cast<std::uint32_t>(mesh.indices.size()));
    for (const glm::vec3& p : mesh.positions) {
      // -0 and 0 have the same key.
      for (int i = 0; i < 3; ++i) add(std::bit_cast<std::uint32_t>(p[i] == 0.0F ? 0.0F : p[i]));
    }
    for (const std::uint32_t index : mesh.indices) add(index);
  }
  if (!model.origin.isZero(0.0)) {
    for (const double coordinate : model.origin) {
      const auto bits = std::bit_cast<std::uint64_t>(coordinate);
      add(static_cast<std::uint32_t>(bits));
      add(static_cast<std::uint32_t>(bits >> 32U));
    }
  }
  return fmt::format("{:016x}", hash);
}

Result<std::filesystem::path> model_resource_path(const std::filesystem::path& folder,
                                                  std::string_view name) {
  std::string path = plain_path(name);
  if (leaves_folder(name)) {
    path = path.substr(path.rfind('/') + 1);
    if (has_drive_letter(path)) path = path.substr(2);
  }
  const std::string last = path.substr(path.rfind('/') + 1);
  if (last.empty() || last == "." || last == ".." || path.find('\0') != std::string::npos) {
    return fail("\"{}\": names no file beside the model", name.substr(0, 80));
  }
  // Old programs write file names in Latin-1; the file system may have them in UTF-8.
  std::error_code ignored;
  const std::filesystem::path as_written = folder / path;
  const std::filesystem::path utf8 = folder / as_utf8(path);
  const bool is_utf8 =
      !std::filesystem::exists(as_written, ignored) && std::filesystem::exists(utf8, ignored);
  return is_utf8 ? utf8 : as_written;
}

bool leaves_folder(std::string_view name) {
  const std::string path = plain_path(name);
  // A colon in the first component follows a drive letter or a scheme.
  if (path.starts_with('/') || path.find(':') < path.find('/')) return true;
  const std::filesystem::path parts(path);
  return std::find(parts.begin(), parts.end(), "..") != parts.end();
}

Eigen::Vector3d model_origin(const Eigen::AlignedBox3d& bounds) {
  // At a distance of kFar times the size, floats resolve 1e-5 of the size.
  constexpr double kFar = 64.0;
  if (bounds.isEmpty()) return Eigen::Vector3d::Zero();
  const Eigen::Vector3d middle = bounds.center();
  const bool far = middle.cwiseAbs().maxCoeff() > kFar * bounds.sizes().maxCoeff();
  return far ? middle : Eigen::Vector3d::Zero();
}

void move_origin(Model& model, const Eigen::Vector3d& origin) {
  const Eigen::Vector3d by = model.origin - origin;
  if (by.isZero(0.0)) return;
  const auto move = [&by](glm::vec3& p) { p = to_glm(to_eigen(p) + by); };
  for (Mesh& mesh : model.meshes) {
    std::ranges::for_each(mesh.positions, move);
    std::ranges::for_each(mesh.shadow_kernels, move);
  }
  move(model.min_corner);
  move(model.max_corner);
  model.origin = origin;
}

std::optional<std::string> warning_of_distance(const Eigen::AlignedBox3d& bounds, double step,
                                               const std::string& name) {
  constexpr double kCoarse = 1e-4;  // fraction of the size
  if (bounds.isEmpty()) return std::nullopt;
  const double size = bounds.sizes().maxCoeff();
  if (!(size > 0.0) || step <= kCoarse * size) return std::nullopt;
  return fmt::format(
      "{}: lies {:.4g} km from its origin, where coordinates are exact to {:.2g} m only, for a "
      "size of {:.3g} m; move it to the origin and export it again",
      name, 1e-3 * bounds.center().norm(), step, size);
}

float linear_from_srgb(float encoded) {
  return encoded <= 0.04045F ? encoded / 12.92F : std::pow((encoded + 0.055F) / 1.055F, 2.4F);
}

Result<int> add_texture(Model& model, RgbaImage image, const std::string& name,
                        const ModelLimits& limits, std::vector<std::uint8_t> encoded) {
  std::size_t pixels =
      static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height);
  for (const auto& texture : model.textures) pixels += texture->rgba.size() / 4;
  if (pixels > limits.max_texture_pixels) {
    return fail("{}: the model's textures have more than the {} pixels allowed", name,
                limits.max_texture_pixels);
  }
  model.textures.push_back(std::make_shared<const Texture>(
      Texture{image.width, image.height, std::move(image.pixels), std::move(encoded)}));
  return static_cast<int>(model.textures.size()) - 1;
}

namespace {

// Computed in double, because in float the square may overflow or underflow.
double length_of(const glm::vec3& v) {
  return std::hypot(static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z));
}

Result<void> check_attributes(Mesh& mesh, const ModelLimits& limits) {
  for (const glm::vec3& p : mesh.positions) {
    if (!is_finite(p)) return fail("a vertex is not a finite number; export the model again");
    const float largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    if (largest > static_cast<float>(limits.max_coordinate_m)) {
      return fail("a vertex lies {} m from the origin, over the {} m allowed", largest,
                  limits.max_coordinate_m);
    }
  }
  for (glm::vec3& n : mesh.normals) {
    const double length = length_of(n);
    if (!std::isfinite(length)) return fail("a normal is not a finite number");
    n = length > 1e-12 ? glm::vec3(glm::dvec3(n) / length) : glm::vec3(0.0F, 0.0F, 1.0F);
  }
  for (const std::vector<glm::vec2>* texcoords : {&mesh.texcoords, &mesh.texcoords_2}) {
    for (const glm::vec2& t : *texcoords) {
      if (!(std::abs(t.x) <= 1e6F && std::abs(t.y) <= 1e6F)) {
        return fail("a texture coordinate is not a number within +-1e6");
      }
    }
  }
  for (glm::vec4& t : mesh.tangents) {
    const double length = length_of(glm::vec3(t));
    if (!std::isfinite(length) || !std::isfinite(t.w)) {
      return fail("a tangent is not a finite number");
    }
    t = length > 1e-12 ? glm::vec4(glm::vec3(glm::dvec3(t) / length), t.w < 0.0F ? -1.0F : 1.0F)
                       : glm::vec4(1.0F, 0.0F, 0.0F, 1.0F);
  }
  for (glm::vec4& c : mesh.colors) {
    for (int i = 0; i < 4; ++i) {
      if (!std::isfinite(c[i])) return fail("a vertex colour is not a finite number");
      c[i] = std::clamp(c[i], 0.0F, 1.0F);
    }
  }
  return {};
}

// Errors do not contain the names of the file and the mesh.
Result<void> check_mesh(Mesh& mesh, const Model& model, const ModelLimits& limits) {
  const std::size_t count = mesh.positions.size();
  const auto fits = [count](const auto& list) { return list.empty() || list.size() == count; };
  if (mesh.normals.size() != count || mesh.source_vertex.size() != count || !fits(mesh.texcoords) ||
      !fits(mesh.texcoords_2) || !fits(mesh.tangents) || !fits(mesh.colors) ||
      mesh.indices.size() % 3 != 0) {
    return fail("its attributes have different lengths");
  }
  if (mesh.material < 0 || static_cast<std::size_t>(mesh.material) >= model.materials.size()) {
    return fail("material {} does not exist", mesh.material);
  }
  PENUMBRA_TRY_VOID(check_attributes(mesh, limits));
  for (const std::uint32_t index : mesh.indices) {
    if (index >= count) return fail("a face names vertex {}, there are {}", index, count);
  }
  for (const NodeFaces& run : mesh.node_faces) {
    if (run.node >= model.nodes.size() || run.first_index > mesh.indices.size() ||
        run.index_count > mesh.indices.size() - run.first_index) {
      return fail("faces of node {} of {}", run.node, model.nodes.size());
    }
  }
  for (const std::uint32_t source : mesh.source_vertex) {
    if (source >= model.source_vertex_count) {
      return fail("source vertex {} of {}", source, model.source_vertex_count);
    }
  }
  return {};
}

// Errors do not contain the names of the file and the material.
Result<void> check_material(const Material& material, const Model& model) {
  const auto in_unit = [](float x) { return x >= 0.0F && x <= 1.0F; };  // false for NaN
  bool good = in_unit(material.metallic) && in_unit(material.roughness);
  for (int i = 0; i < 4; ++i) good = good && in_unit(material.base_color[i]);
  for (int i = 0; i < 3; ++i) {
    good = good && material.emissive[i] >= 0.0F && material.emissive[i] <= kMaxEmissive;
  }
  if (!good) return fail("a factor is outside 0 to 1 (emission: {:g})", kMaxEmissive);
  if (!(std::abs(material.normal_scale) <= 1e3F) || !in_unit(material.occlusion_strength) ||
      !(material.alpha_cutoff >= 0.0F && material.alpha_cutoff <= 1e3F)) {
    return fail("normal scale {}, occlusion strength {} or alpha cutoff {} is out of range",
                material.normal_scale, material.occlusion_strength, material.alpha_cutoff);
  }
  for (const MaterialTexture* texture :
       {&material.base_color_texture, &material.metallic_roughness_texture,
        &material.normal_texture, &material.occlusion_texture, &material.emissive_texture}) {
    if (texture->image >= static_cast<int>(model.textures.size())) {
      return fail("texture {} does not exist", texture->image);
    }
  }
  return {};
}

}  // namespace

Result<void> check_model(Model& model, const std::string& name, const ModelLimits& limits) {
  if (model.vertex_count() > limits.max_vertices) {
    return fail("{}: has {} vertices, more than the {} allowed", name, model.vertex_count(),
                limits.max_vertices);
  }
  if (model.triangle_count() > limits.max_triangles) {
    return fail("{}: has {} triangles, more than the {} allowed", name, model.triangle_count(),
                limits.max_triangles);
  }
  if (model.meshes.size() > limits.max_meshes) {
    return fail("{}: has {} materials in use, more than the {} allowed; merge some of them", name,
                model.meshes.size(), limits.max_meshes);
  }
  glm::vec3 low(std::numeric_limits<float>::max());
  glm::vec3 high(std::numeric_limits<float>::lowest());
  for (Mesh& mesh : model.meshes) {
    const Result<void> checked = check_mesh(mesh, model, limits);
    if (!checked) {
      return fail("{}: mesh \"{}\": {}", name, mesh.name, checked.error().message);
    }
    for (const glm::vec3& p : mesh.positions) {
      low = glm::min(low, p);
      high = glm::max(high, p);
    }
  }
  for (const Material& material : model.materials) {
    const Result<void> checked = check_material(material, model);
    if (!checked) {
      return fail("{}: material \"{}\": {}", name, material.name, checked.error().message);
    }
  }
  if (model.triangle_count() == 0) low = high = glm::vec3(0.0F);
  model.min_corner = low;
  model.max_corner = high;
  return {};
}

namespace {

// A model's file and how it is read.
struct Source {
  std::filesystem::path file;
  ModelLoadOptions reading;

  [[nodiscard]] std::string name() const { return file.string(); }
  [[nodiscard]] bool is_glb() const { return lower_extension(file) == ".glb"; }
  [[nodiscard]] bool is_gltf() const { return is_glb() || lower_extension(file) == ".gltf"; }
  // The readers check coordinates in the file's unit.
  [[nodiscard]] ModelLimits file_limits() const {
    ModelLimits limits = reading.limits;
    limits.max_coordinate_m /= reading.unit_m;
    return limits;
  }
};

Result<std::vector<std::uint8_t>> bytes_of(const Source& source) {
  if (!source.is_gltf() && lower_extension(source.file) != ".obj") {
    return fail("{}: is not a kind of model that can be read; give a .glb, .gltf or .obj file",
                source.name());
  }
  PENUMBRA_TRY(std::vector<std::uint8_t> bytes,
               read_file(source.file, source.reading.limits.max_file_bytes));
  if (bytes.empty()) return fail("{}: is empty; export the model again", source.name());
  return bytes;
}

// Converts a model from the file's axes and unit.
Result<void> convert(Model& model, const Source& source) {
  const ModelLoadOptions& reading = source.reading;
  const std::string name = source.name();
  model.name = source.file.stem().string();
  model.files.insert(model.files.begin(), source.file);
  if (reading.up == UpAxis::y || (reading.up == UpAxis::by_format && source.is_gltf()))
    convert_to_z_up(model);
  if (!reading.stored_kernels) {
    drop_kernels(model);
    model.shadow_kernel_groups.clear();
  }
  // Stored kernels refer to the file's unit.
  std::string geometry;
  if (model.shadow_kernel_up) geometry = stamped_geometry(model, reading.up);
  if (reading.unit_m != 1.0) scale_to_metres(model, reading.unit_m);
  PENUMBRA_TRY_VOID(check_model(model, name, reading.limits));
  if (model.shadow_kernel_up) check_stored_kernels(model, geometry, name, reading.limits);
  return {};
}

// Returns the result of `read`. Catches exceptions of the readers' libraries.
template <class Read>
auto guarded(const Source& source, const Read& read) -> decltype(read()) {
  try {
    return read();
  } catch (const std::bad_alloc&) {
    return fail("{}: needs more memory than there is; give a smaller model", source.name());
  } catch (const std::exception& error) {
    return fail("{}: can't be read: {}", source.name(), error.what());
  }
}

Result<GltfShapes> open_shapes(const Source& source, const std::string& animation) {
  PENUMBRA_TRY(std::vector<std::uint8_t> bytes, bytes_of(source));
  if (!source.is_gltf()) {
    return fail("{}: has no animations, which only glTF files can have", source.name());
  }
  return GltfShapes::open(source.file, std::move(bytes), source.is_glb(), source.file_limits(),
                          animation);
}

Result<Model> read_model(const Source& source, double& file_step) {
  if (const std::optional<ModelPose>& pose = source.reading.pose) {
    PENUMBRA_TRY(GltfShapes shapes, open_shapes(source, pose->animation));
    return shapes.at(pose->time_s, file_step);
  }
  PENUMBRA_TRY(const std::vector<std::uint8_t> bytes, bytes_of(source));
  return source.is_gltf()
             ? read_gltf(source.file, bytes, source.is_glb(), source.file_limits(), file_step)
             : read_obj(source.file, bytes, source.file_limits(), file_step);
}

}  // namespace

Result<Model> load_model(const std::filesystem::path& file, const ModelLoadOptions& reading) {
  const Source source{file, reading};
  return guarded(source, [&]() -> Result<Model> {
    double file_step = 0.0;
    PENUMBRA_TRY(Model model, read_model(source, file_step));
    const std::string name = source.name();
    if (model.triangle_count() == 0) {
      return fail("{}: has no triangles{}; export the model with its faces", name,
                  reading.pose ? " at this time of its animation" : "");
    }
    PENUMBRA_TRY_VOID(convert(model, source));
    if (auto coarse = warning_of_distance(bounds_of(model), file_step * reading.unit_m, name)) {
      model.warnings.push_back(std::move(*coarse));
    }
    if (auto lost = warning_of_lost_faces(model, name)) {
      model.warnings.push_back(std::move(*lost));
    }
    return model;
  });
}

struct AnimatedModel::Impl {
  Source source;
  Model box;
  double end_s = 0.0;
  std::mutex mutex;  // protects the members below
  GltfShapes shapes;
  std::map<double, std::weak_ptr<const Model>> in_use;  // shapes by time

  Impl(Source from, GltfShapes opened)
      : source(std::move(from)), end_s(opened.end_s()), shapes(std::move(opened)) {}
  [[nodiscard]] Result<std::shared_ptr<const Model>> at(double time_s);
  [[nodiscard]] Result<void> measure();
};

Result<std::shared_ptr<const Model>> AnimatedModel::Impl::at(double time_s) {
  const std::lock_guard lock(mutex);
  if (const auto known = in_use.find(time_s); known != in_use.end()) {
    if (auto shape = known->second.lock()) return shape;
  }
  std::erase_if(in_use, [](const auto& entry) { return entry.second.expired(); });
  double file_step = 0.0;
  PENUMBRA_TRY(Model model, shapes.at(time_s, file_step));
  PENUMBRA_TRY_VOID(convert(model, source));
  auto shape = std::make_shared<const Model>(std::move(model));
  in_use[time_s] = shape;
  return shape;
}

// Makes the box. Fails if a sampled shape has a vertex that is too far away.
Result<void> AnimatedModel::Impl::measure() {
  constexpr int kSamples = 16;
  Eigen::AlignedBox3d bounds;
  for (int i = 0; i <= kSamples; ++i) {
    PENUMBRA_TRY(const auto shape, at(end_s * i / kSamples));
    if (shape->triangle_count() > 0) bounds.extend(bounds_of(*shape));
  }
  if (bounds.isEmpty()) {
    return fail("{}: shows no triangles in its animation; play another one", source.name());
  }
  Mesh& corners = box.meshes.emplace_back();
  for (int i = 0; i < 8; ++i) {
    const auto corner = static_cast<Eigen::AlignedBox3d::CornerType>(i);
    corners.positions.push_back(to_glm(bounds.corner(corner)));
  }
  box.min_corner = to_glm(bounds.min());
  box.max_corner = to_glm(bounds.max());
  return {};
}

AnimatedModel::AnimatedModel(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
AnimatedModel::~AnimatedModel() = default;

Result<std::shared_ptr<const AnimatedModel>> AnimatedModel::load(const std::filesystem::path& file,
                                                                 const std::string& animation,
                                                                 const ModelLoadOptions& reading) {
  Source source{file, reading};
  source.reading.stored_kernels = false;
  return guarded(source, [&]() -> Result<std::shared_ptr<const AnimatedModel>> {
    PENUMBRA_TRY(GltfShapes shapes, open_shapes(source, animation));
    auto impl = std::make_unique<Impl>(source, std::move(shapes));
    PENUMBRA_TRY_VOID(impl->measure());
    return std::shared_ptr<const AnimatedModel>(new AnimatedModel(std::move(impl)));
  });
}

Result<std::shared_ptr<const Model>> AnimatedModel::at(double time_s) const {
  return guarded(impl_->source, [&] { return impl_->at(time_s); });
}

double AnimatedModel::end_s() const {
  return impl_->end_s;
}

const Model& AnimatedModel::box() const {
  return impl_->box;
}

}  // namespace penumbra
