// Ray-cast shadows of an area light, computed by an independent program, as reference for kernels
// and fields.
#pragma once

#include <limits>
#include <map>
#include <string>

#include "support/field_sample.hpp"
#include "support/shadow_cases.hpp"

namespace penumbra::test {

struct QualityCase {
  nlohmann::json json;
  const VectorMesh* source = nullptr;

  [[nodiscard]] std::string name() const { return json.at("mesh").get<std::string>(); }
  [[nodiscard]] LayeredConstants constants() const {
    return make_layered_constants(std::numeric_limits<double>::infinity(), 0.0,
                                  json.at("h_umbra").get<double>())
        .value();
  }
  [[nodiscard]] Placement placement() const {
    return {vector_from(json.at("translation_after_rotation")),
            Eigen::Quaterniond(matrix_from(json.at("rotation"))), 1.0};
  }
  [[nodiscard]] double number(const char* table, const char* layer) const {
    return json.at(table).at(layer).get<double>();
  }
  [[nodiscard]] double iou_with(const Mask& mask, const char* layer) const {
    return iou(mask.bits,
               decode_mask(json.at("masks").at(layer).get<std::string>(), mask.bits.size()));
  }
  [[nodiscard]] Mask empty_mask() const {
    const auto& grid = json.at("grid");
    return {{grid.at("origin").at(0).get<double>(), grid.at("origin").at(1).get<double>()},
            grid.at("pixel").get<double>(),
            grid.at("size").get<int>()};
  }

  [[nodiscard]] double kernel_iou(KernelSource kernels, ShadowLayer layer, const char* key) const {
    const PlaneFrame plane;
    const ShadowKernels generated =
        generate_kernels(source->mesh, up_in_object(placement(), plane), kernels);
    const auto vertices = place_caster(source->mesh, generated, placement(), plane);
    Mask mask = empty_mask();
    mask.cover(layer_triangles(vertices, source->mesh.indices, constants(), layer));
    return iou_with(mask, key);
  }

  [[nodiscard]] double field_iou(ShadowLayer layer, const char* key) const {
    const PlaneFrame plane;
    const ShadowKernels none{plane.n, source->mesh.positions, {}};
    const ShadowField field = power_distance_layers(
        place_caster(source->mesh, none, placement(), plane), source->mesh.indices,
        source->mesh.part,
        part_lights(part_discs(source->mesh, up_in_object(placement(), plane)), placement(), plane),
        constants());
    Mask mask = empty_mask();
    for (int row = 0; row < mask.size; ++row) {
      for (int column = 0; column < mask.size; ++column) {
        const Eigen::Vector2d p =
            mask.origin + mask.pixel * Eigen::Vector2d(column + 0.5, row + 0.5);
        mask.bits[mask.index(column, row)] = field_at(field, layer, p) > 0.0F ? 1 : 0;
      }
    }
    return iou_with(mask, key);
  }
};

// All cases with their meshes; empty without shared data.
class QualityCases {
 public:
  QualityCases() {
    if (shared_dir().empty()) return;
    const auto folder = shared_dir() / "vectors";
    const nlohmann::json vectors = read_json(folder / "kernel_quality.json");
    for (const auto& json : vectors.at("cases")) {
      const std::string mesh = json.at("mesh").get<std::string>();
      const auto found = meshes_.try_emplace(mesh, folder / mesh).first;
      cases_.push_back({json, &found->second});
    }
  }
  QualityCases(const QualityCases&) = delete;
  QualityCases& operator=(const QualityCases&) = delete;
  [[nodiscard]] const std::vector<QualityCase>& cases() const { return cases_; }

 private:
  std::map<std::string, VectorMesh> meshes_;
  std::vector<QualityCase> cases_;
};

// Layers with reference masks, and their names in the JSON file.
inline constexpr std::array kJudgedLayers = {std::pair{ShadowLayer::umbra, "umbra"},
                                             std::pair{ShadowLayer::penumbra, "penumbra"}};

}  // namespace penumbra::test
