// The shadow of an object that changes its shape, by ray casting, by carried kernels and as a
// field.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/animated_caster.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "support/field_sample.hpp"
#include "support/paths.hpp"
#include "support/ray_cast_layers.hpp"
#include "tools/models/animated_models.hpp"

namespace penumbra::test {

using AnimatedModelPtr = std::shared_ptr<const AnimatedModel>;

// Loads the first animation of a .glb.
inline AnimatedModelPtr loaded(const std::string& bytes) {
  const TemporaryFolder folder;
  std::ofstream(folder.path() / "model.glb", std::ios::binary) << bytes;
  return AnimatedModel::load(folder.path() / "model.glb", "0").value();
}
inline AnimatedModelPtr loaded(const models::MovingModel& moving) {
  const auto bytes = models::encode_glb(moving).value();
  return loaded(std::string(bytes.begin(), bytes.end()));
}

// An object with its middle at 0.45 of the umbra's height, under a light at the zenith. Each part
// has a light as wide as the part is thick in each shape, because layers model this light
// (docs/shadows.md#layers).
class MovingShadow {
 public:
  static constexpr double kUmbraHeight = 0.3;  // [m]

  // `pixels`: of the side of the images; `tilt_rad`: rotation about x.
  MovingShadow(AnimatedModelPtr model, int pixels, double tilt_rad = 0.0)
      : model_(std::move(model)),
        caster_(model_, {}),
        constants_(
            make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, kUmbraHeight)
                .value()) {
    placement_.rotation = Eigen::AngleAxisd(tilt_rad, Eigen::Vector3d::UnitX());
    up_ = up_in_object(placement_, PlaneFrame());
    by_.direction = KernelDirection::nearest(up_);
    Eigen::AlignedBox3d box;
    for (const glm::vec3& p : model_->box().meshes.front().positions)
      box.extend(placement_.rotation * to_eigen(p));
    placement_.position = Eigen::Vector3d(0.0, 0.0, 0.45 * kUmbraHeight) - box.center();
    const double half = 0.65 * box.sizes().head<2>().maxCoeff();
    empty_.emplace(Eigen::Vector2d(-half, -half), 2.0 * half, pixels);
  }

  [[nodiscard]] double end_s() const { return model_->end_s(); }
  [[nodiscard]] ShadowMesh mesh_at(double time_s) const {
    return caster_.mesh_of(*model_->at(time_s).value()).value();
  }
  [[nodiscard]] ShadowKernels generated(const ShadowMesh& mesh) const {
    return generate_kernels(mesh, up_, KernelSource::automatic);
  }
  [[nodiscard]] AnimatedCaster::Agreement agreement() {
    return caster_.agreement(by_, {LightMode::proportional, kUmbraHeight});
  }

  [[nodiscard]] PlaneLayers by_rays(double time_s) const {
    static const auto light = light_points(64, 48);
    const ShadowMesh mesh = mesh_at(time_s);
    std::vector<double> slopes;
    for (const PartDisc& disc : part_discs(mesh, up_))
      slopes.push_back(static_cast<double>(disc.radius) / kUmbraHeight);
    return ray_cast_layers(placed(mesh, {up_, mesh.positions, {}}), mesh.indices, mesh.part, slopes,
                           *empty_, light);
  }
  [[nodiscard]] PlaneLayers layers_of(const ShadowMesh& mesh, const ShadowKernels& kernels) const {
    const std::vector<CasterVertex> vertices = placed(mesh, kernels);
    const auto covered = [&](ShadowLayer layer) {
      PlaneBits bits = *empty_;
      bits.cover(layer_triangles(vertices, mesh.indices, constants_, layer));
      return bits;
    };
    return {covered(ShadowLayer::umbra), covered(ShadowLayer::middle),
            covered(ShadowLayer::penumbra)};
  }
  [[nodiscard]] PlaneLayers by_kernels(double time_s) {
    const ShadowMesh mesh = mesh_at(time_s);
    int count = 0;
    return layers_of(mesh, caster_.kernels_at(by_, time_s, mesh.positions, count));
  }
  [[nodiscard]] PlaneLayers by_field(double time_s) {
    const ShadowMesh mesh = mesh_at(time_s);
    int count = 0;
    const auto parts = caster_.field_parts_at(by_.direction, time_s, mesh, count).value();
    const ShadowField field =
        power_distance_layers(placed(mesh, {up_, mesh.positions, {}}), mesh.indices, mesh.part,
                              part_lights(parts, placement_, PlaneFrame()), constants_);
    const auto covered = [&](ShadowLayer layer) {
      PlaneBits bits = *empty_;
      bits.cover_where([&](const Eigen::Vector2d& p) { return field_at(field, layer, p) > 0.0F; });
      return bits;
    };
    return {covered(ShadowLayer::umbra), covered(ShadowLayer::middle),
            covered(ShadowLayer::penumbra)};
  }

 private:
  [[nodiscard]] std::vector<CasterVertex> placed(const ShadowMesh& mesh,
                                                 const ShadowKernels& kernels) const {
    return place_caster(mesh, kernels, placement_, PlaneFrame());
  }

  AnimatedModelPtr model_;
  AnimatedCaster caster_;
  LayeredConstants constants_;
  Placement placement_;
  Eigen::Vector3d up_ = Eigen::Vector3d::UnitZ();
  AnimatedCaster::Kernels by_;
  std::optional<PlaneBits> empty_;
};

// Greatest change of the area of umbra, middle layer and penumbra between frames at 60 Hz [m^2].
struct AreaChanges {
  std::array<double, 3> by_rays{}, by_kernels{}, by_field{};
};
// `frames` from time 0 on.
inline AreaChanges area_changes(MovingShadow& shadow, int frames) {
  AreaChanges changes;
  std::array<std::array<double, 3>, 3> last{};
  for (int i = 0; i <= frames; ++i) {
    const double time_s = std::min(i / 60.0, shadow.end_s());
    const std::array all = {shadow.by_rays(time_s), shadow.by_kernels(time_s),
                            shadow.by_field(time_s)};
    const std::array greatest = {&changes.by_rays, &changes.by_kernels, &changes.by_field};
    for (std::size_t method = 0; method < 3; ++method) {
      const PlaneLayers& layers = all[method];
      const std::array now = {layers.umbra.area(), layers.middle.area(), layers.penumbra.area()};
      for (std::size_t layer = 0; layer < 3 && i > 0; ++layer) {
        double& change = (*greatest[method])[layer];
        change = std::max(change, std::abs(now[layer] - last[method][layer]));
      }
      last[method] = now;
    }
  }
  return changes;
}

}  // namespace penumbra::test
