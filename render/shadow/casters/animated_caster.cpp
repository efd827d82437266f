#include "render/shadow/casters/animated_caster.hpp"

#include <algorithm>
#include <cmath>
#include <glm/vec3.hpp>
#include <limits>

#include "core/assert.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/layers/coverage.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxKeys = 4 * (kMaxKernelSteps + 1);
// Vertices of all keys of one direction. Their kernels take up to 60 MB, and comparing them a
// second.
constexpr std::size_t kMaxKeyVertices = 200'000;
constexpr std::size_t kMaxAgreements = 256;
constexpr int kMaxComparisons = 10;
constexpr double kComparedHeight = 0.45;  // of the object's middle / umbra height

// Placement of the object over the plane through the origin with the normal `up`.
Placement compared_placement(const ShadowMesh& mesh, const PlaneFrame& plane,
                             const AnimatedCaster::Use& use) {
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const glm::vec3& p : mesh.positions) {
    const double h = plane.height(to_eigen(p));
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  const double lift = std::max(-bottom, kComparedHeight * use.umbra_height - 0.5 * (bottom + top));
  return {lift * plane.n, Eigen::Quaterniond::Identity(), 1.0};
}

// Returns the mean of each part's vertices, object frame [m].
std::vector<glm::vec3> part_means(const ShadowMesh& mesh) {
  std::vector<glm::dvec3> sums(mesh.part_count, glm::dvec3(0.0));
  std::vector<double> counts(mesh.part_count, 0.0);
  for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
    sums[mesh.part[i]] += mesh.positions[i];
    counts[mesh.part[i]] += 1.0;
  }
  std::vector<glm::vec3> means;
  for (std::size_t part = 0; part < sums.size(); ++part)
    means.emplace_back(sums[part] / std::max(counts[part], 1.0));
  return means;
}

}  // namespace

AnimatedCaster::AnimatedCaster(std::shared_ptr<const AnimatedModel> model,
                               std::vector<std::string> groups)
    : model_(std::move(model)) {
  PENUMBRA_ASSERT(model_ != nullptr);
  const double end_s = model_->end_s();
  field_steps_ =
      std::max(static_cast<int>(std::ceil(std::min(end_s, 1e6) / kKernelKeyStep_s - 1e-6)),
               end_s > 0.0 ? 1 : 0);
  field_step_s_ = field_steps_ > 0 ? end_s / field_steps_ : 0.0;
  steps_ = std::min(field_steps_, kMaxKernelSteps);
  step_s_ = steps_ > 0 ? end_s / steps_ : 0.0;
  first_ = model_->at(0.0).value_or(nullptr);
  if (!first_) return;
  mesh_ = make_shadow_mesh(*first_, groups);
  max_gap_ = 2.0 * weld_distance(*first_);
}

std::optional<ShadowMesh> AnimatedCaster::mesh_of(const Model& shape) const {
  if (!first_ || mesh_.positions.empty()) return std::nullopt;
  return moved_to_shape(mesh_, *first_, shape, max_gap_);
}

std::optional<ShadowMesh> AnimatedCaster::mesh_at(double time_s) const {
  const auto shape = model_->at(time_s);
  return shape ? mesh_of(**shape) : std::nullopt;
}

bool AnimatedCaster::has_one_mesh() const {
  if (!one_mesh_) {
    one_mesh_ = true;
    for (int key = 0; key <= steps_ && *one_mesh_; ++key)
      one_mesh_ = mesh_at(time_of(key)).has_value();
  }
  return *one_mesh_;
}

AnimatedCaster::Times AnimatedCaster::times_at(double time_s, int steps, double step_s) {
  if (steps == 0) return {};
  const double at = std::clamp(time_s / step_s, 0.0, static_cast<double>(steps));
  const int before = std::min(static_cast<int>(at), steps - 1);
  return {before, before + 1, at - before};
}

const CarriedKernels& AnimatedCaster::key_kernels(const Kernels& by, int key, int& generated) {
  std::optional<CarriedKernels>& kernels = keys_[{by, key}].kernels;
  if (!kernels) {
    const std::optional<ShadowMesh> mesh = mesh_at(time_of(key));
    PENUMBRA_ASSERT(mesh.has_value());  // has_one_mesh()
    kernels.emplace(*mesh, generate_kernels(*mesh, by.direction.up(), by.source));
    ++generated;
  }
  return *kernels;
}

const std::vector<PartDisc>& AnimatedCaster::key_parts(const Kernels& by, int key, int& generated) {
  std::vector<PartDisc>& parts = keys_[{by, key}].parts;
  if (parts.empty()) {
    const std::optional<ShadowMesh> mesh = mesh_at(time_of(key));
    PENUMBRA_ASSERT(mesh.has_value());  // has_one_mesh()
    parts = part_discs(*mesh, by.direction.up());
    ++generated;
  }
  return parts;
}

ShadowKernels AnimatedCaster::kernels_at(const Kernels& by, double time_s,
                                         std::span<const glm::vec3> positions, int& generated) {
  if (keys_.size() >= kMaxKeys) keys_.clear();
  const Times times = times_at(time_s, steps_, step_s_);
  ShadowKernels before = key_kernels(by, times.before, generated).at(positions);
  if (times.share == 0.0) return before;
  return blended(before, key_kernels(by, times.after, generated).at(positions), times.share);
}

std::vector<PartDisc> AnimatedCaster::parts_at(const Kernels& by, double time_s, int& generated) {
  if (keys_.size() >= kMaxKeys) keys_.clear();
  const Times times = times_at(time_s, steps_, step_s_);
  std::vector<PartDisc> parts = key_parts(by, times.before, generated);
  if (times.share == 0.0) return parts;
  const std::vector<PartDisc>& after = key_parts(by, times.after, generated);
  const auto share = static_cast<float>(times.share);
  for (std::size_t i = 0; i < parts.size(); ++i)
    parts[i].radius = (1.0F - share) * parts[i].radius + share * after[i].radius;
  return parts;
}

const std::vector<PartDisc>& AnimatedCaster::field_key(const KernelDirection& direction, int key,
                                                       double time_s, int& generated) {
  const auto [entry, is_new] = field_keys_.try_emplace({direction, key});
  std::vector<PartDisc>& parts = entry->second;
  if (!is_new) return parts;
  const std::optional<ShadowMesh> mesh = mesh_at(time_s);
  if (!mesh) return parts;
  parts = part_discs(*mesh, direction.up(), kHalfFieldCell, false);
  ++generated;
  const std::vector<glm::vec3> means = part_means(*mesh);
  for (std::size_t part = 0; part < means.size(); ++part) parts[part].centre -= means[part];
  return parts;
}

std::optional<std::vector<PartDisc>> AnimatedCaster::field_parts_at(
    const KernelDirection& direction, double time_s, const ShadowMesh& mesh, int& generated) {
  if (field_keys_.size() >= kMaxKeys) field_keys_.clear();
  const Times times = times_at(time_s, field_steps_, field_step_s_);
  const auto key = [&](int index) -> const std::vector<PartDisc>& {
    return field_key(direction, index, field_step_s_ * index, generated);
  };
  std::vector<PartDisc> parts = key(times.before);
  const std::vector<PartDisc>& after = key(times.after);
  if (parts.size() != mesh.part_count || after.size() != mesh.part_count) return std::nullopt;
  const auto share = static_cast<float>(times.share);
  const std::vector<glm::vec3> means = part_means(mesh);
  for (std::size_t part = 0; part < parts.size(); ++part) {
    PartDisc& disc = parts[part];
    disc.radius = (1.0F - share) * disc.radius + share * after[part].radius;
    disc.centre = means[part] + (1.0F - share) * disc.centre + share * after[part].centre;
  }
  return parts;
}

const AnimatedCaster::Agreement& AnimatedCaster::agreement(const Kernels& by, const Use& use) {
  const auto known = agreements_.find({by, use});
  if (known != agreements_.end()) return known->second;
  if (agreements_.size() >= kMaxAgreements) agreements_.clear();
  return agreements_.emplace(std::pair(by, use), compare(by, use)).first->second;
}

AnimatedCaster::Agreement AnimatedCaster::compare(const Kernels& by, const Use& use) {
  const auto keys = static_cast<std::size_t>(steps_ + 1);
  if (keys * mesh_.positions.size() > kMaxKeyVertices || !has_one_mesh()) return {};
  const auto constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, use.umbra_height);
  if (!constants) return {};
  const Eigen::Vector3d up = by.direction.up();
  const PlaneFrame plane = PlaneFrame::make(up, Eigen::Vector3d::Zero());
  const int comparisons = std::clamp(steps_, 1, kMaxComparisons);
  Agreement sum;
  for (int i = 0; i < comparisons; ++i) {
    // Halfway between two keys, where kernels were carried farthest.
    const double time_s = step_s_ * (0.5 + i * steps_ / comparisons);
    const std::optional<ShadowMesh> mesh = mesh_at(time_s);
    if (!mesh) return {};
    int generated = 0;
    const ShadowKernels kernels = kernels_at(by, time_s, mesh->positions, generated);
    std::vector<VertexDisc> discs;
    if (use.light_mode == LightMode::fixed)
      discs = vertex_discs(*mesh, kernels, parts_at(by, time_s, generated), 1.0);
    const Placement placement = compared_placement(*mesh, plane, use);
    const std::vector<CasterVertex> vertices = place_caster(*mesh, kernels, placement, plane);
    const ShadowField field = power_distance_layers(
        vertices, mesh->indices, mesh->part,
        part_lights(part_discs(*mesh, up, kHalfFieldCell, false), placement, plane), *constants);
    const auto iou_of = [&](ShadowLayer layer) {
      const std::vector<PlanePoint> triangles =
          use.light_mode == LightMode::fixed
              ? fixed_light_triangles(vertices, discs, mesh->indices, *constants, layer)
              : layer_triangles(vertices, mesh->indices, *constants, layer);
      return layer_iou(triangles, field_triangles(field, layer));
    };
    sum.umbra += iou_of(ShadowLayer::umbra) / comparisons;
    sum.penumbra += iou_of(ShadowLayer::penumbra) / comparisons;
  }
  // Makes the other keys now, because making one takes longer than the rest of a frame's update.
  int generated = 0;
  for (int key = 0; key <= steps_ && sum.is_sufficient(); ++key) {
    (void)key_kernels(by, key, generated);
    if (use.light_mode == LightMode::fixed) (void)key_parts(by, key, generated);
  }
  return sum;
}

}  // namespace penumbra
