#include "app/offline_shadow.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "app/stopwatch.hpp"
#include "core/text.hpp"
#include "core/units.hpp"
#include "render/shadow/caster.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxKernelFileBytes = std::size_t{512} << 20U;
constexpr double kUpTolerance = radians(2.0);  // beyond it kernels are made anew

constexpr std::array kLayerNames = {"umbra", "middle", "penumbra"};

// Where the constants go against what Layered Penumbrae advises for this object and pose.
std::vector<std::string> advice(const LayeredConstants& constants,
                                const std::vector<CasterVertex>& vertices) {
  std::vector<std::string> warnings;
  if (constants.light_ratio <= 1.0) {
    warnings.push_back(
        fmt::format("light ratio a = {:.3g}: the umbra never vanishes; 2 to 5 is usual",
                    constants.light_ratio));
  }
  double top = 0.0;
  bool below = false;
  for (const CasterVertex& vertex : vertices) {
    top = std::max(top, static_cast<double>(vertex.h));
    below = below || vertex.h < 0.0F;
  }
  if (below) warnings.emplace_back("part of the object is under the plane and casts nothing");
  const double cap = layer_height_range(constants, ShadowLayer::middle).high;
  if (top > cap) {
    warnings.push_back(fmt::format(
        "the object reaches {:.3g} m, and what is above {:.3g} m is too near the light to cast; "
        "raise --light-height",
        top, cap));
  }
  return warnings;
}

struct Prepared {
  ShadowMesh mesh;
  Eigen::Vector3d up;  // object frame
};

Result<ShadowKernels> kernels_for(const ShadowRequest& request, const Prepared& prepared,
                                  OfflineShadow& shadow) {
  if (request.kernel_file) {
    auto kernels = load_kernel_file(*request.kernel_file, prepared.mesh);
    if (!kernels) return kernels;
    // A set serves both a direction and its opposite.
    const double angle = std::acos(std::min(1.0, std::abs(kernels->up.dot(prepared.up))));
    if (angle > kUpTolerance) {
      shadow.warnings.push_back(fmt::format(
          "{}: is for an up direction {:.0f} degrees from this pose's; make kernels for "
          "--up {:.4g},{:.4g},{:.4g}",
          request.kernel_file->string(), degrees(angle), prepared.up.x(), prepared.up.y(),
          prepared.up.z()));
    }
    shadow.kernel_source = request.kernel_file->string();
    return kernels;
  }
  shadow.kernel_source = std::string(to_string(request.kernels));
  return generate_kernels(prepared.mesh, prepared.up, request.kernels);
}

}  // namespace

Result<OfflineShadow> compute_shadow(const ShadowRequest& request) {
  const auto model = load_model(request.model, request.up_axis);
  if (!model) return tl::unexpected(model.error());
  Prepared prepared;
  prepared.mesh = make_shadow_mesh(*model);
  prepared.up = up_in_object(request.T_world_object, request.plane);
  const ShadowMesh& mesh = prepared.mesh;

  OfflineShadow shadow;
  shadow.constants = request.constants;
  ShadowKernels kernels{prepared.up, mesh.positions, {}};
  if (request.technique == OfflineTechnique::layered) {
    const Stopwatch watch;
    auto made = kernels_for(request, prepared, shadow);
    if (!made) return tl::unexpected(made.error());
    kernels = std::move(*made);
    shadow.kernel_ms = watch.elapsed().wall_ms;
  } else {
    shadow.kernel_source = "none";
  }
  const auto vertices = place_caster(mesh, kernels, request.T_world_object, request.plane);
  for (const CasterVertex& vertex : vertices) {
    if (!std::isfinite(vertex.u) || !std::isfinite(vertex.v) || !std::isfinite(vertex.h)) {
      return fail("{}: is too large or too far away in this pose; give metres",
                  request.model.string());
    }
  }
  const auto footprint = union_of_triangles(orthogonal_triangles(vertices, mesh.indices));
  if (!footprint) return tl::unexpected(footprint.error());
  shadow.footprint = *footprint;
  if (request.technique == OfflineTechnique::simple) {
    shadow.layers.push_back({"shadow", shadow.footprint});
    return shadow;
  }

  const auto warnings = advice(request.constants, vertices);
  shadow.warnings.insert(shadow.warnings.end(), warnings.begin(), warnings.end());
  ShadowField field;
  if (request.technique == OfflineTechnique::field) {
    field = power_distance_layers(
        vertices, mesh.indices, mesh.part,
        part_lights(part_discs(mesh, prepared.up), request.T_world_object, request.plane),
        request.constants, {.cells = 512});
  } else {
    double top = 0.0;
    for (const CasterVertex& vertex : vertices) {
      shadow.kernels.emplace_back(static_cast<double>(vertex.ku), static_cast<double>(vertex.kv));
      top = std::max(top, static_cast<double>(vertex.h));
    }
    shadow.twists = find_twists(vertices, mesh.indices,
                                layer_factor(request.constants, ShadowLayer::umbra, top),
                                layer_factor(request.constants, ShadowLayer::penumbra, top));
  }
  for (std::size_t i = 0; i < kShadowLayers.size(); ++i) {
    auto outline = union_of_triangles(
        request.technique == OfflineTechnique::field
            ? field_triangles(field, kShadowLayers[i])
            : layer_triangles(vertices, mesh.indices, request.constants, kShadowLayers[i]));
    if (!outline) return tl::unexpected(outline.error());
    shadow.layers.push_back({kLayerNames[i], std::move(*outline)});
  }
  return shadow;
}

Result<ShadowKernels> load_kernel_file(const std::filesystem::path& file, const ShadowMesh& mesh) {
  const auto text = read_text_file(file, kMaxKernelFileBytes);
  if (!text) return tl::unexpected(text.error());
  const nlohmann::json json = nlohmann::json::parse(*text, nullptr, false);
  const auto numbers = [&](const char* field) -> Result<std::vector<double>> {
    if (!json.is_object() || !json.contains(field) || !json.at(field).is_array()) {
      return fail("{}: {}: is missing or no list; make the file with penumbra kernels",
                  file.string(), field);
    }
    std::vector<double> values;
    values.reserve(json.at(field).size());
    for (const auto& value : json.at(field)) {
      if (!value.is_number() || !(std::abs(value.get<double>()) < 1e9)) {
        return fail("{}: {}[{}]: is not a number of metres", file.string(), field, values.size());
      }
      values.push_back(value.get<double>());
    }
    return values;
  };
  const auto up = numbers("up");
  if (!up) return tl::unexpected(up.error());
  if (up->size() != 3 || Eigen::Vector3d((*up)[0], (*up)[1], (*up)[2]).norm() < 1e-9) {
    return fail("{}: up: is no direction; give three numbers", file.string());
  }
  const auto flat = numbers("kernels");
  if (!flat) return tl::unexpected(flat.error());
  if (flat->size() != 3 * mesh.from_source.size()) {
    return fail(
        "{}: kernels: has {} numbers, and the model {} vertices; it was made for another model",
        file.string(), flat->size(), mesh.from_source.size());
  }
  ShadowKernels kernels;
  kernels.up = Eigen::Vector3d((*up)[0], (*up)[1], (*up)[2]).normalized();
  kernels.kernels = mesh.positions;
  for (std::size_t i = 0; i < mesh.from_source.size(); ++i) {
    if (mesh.from_source[i] == kNoShadowPosition) continue;
    kernels.kernels[mesh.from_source[i]] =
        glm::vec3(static_cast<float>((*flat)[3 * i]), static_cast<float>((*flat)[3 * i + 1]),
                  static_cast<float>((*flat)[3 * i + 2]));
  }
  return kernels;
}

}  // namespace penumbra
