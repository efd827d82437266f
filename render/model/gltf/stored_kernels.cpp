#include "render/model/gltf/stored_kernels.hpp"

#include <glm/geometric.hpp>

#include "render/model/model_parts.hpp"

namespace penumbra::gltf {

void StoredKernels::take(const tinygltf::Value& extras, const Eigen::Matrix3d& linear,
                         const std::string& what) {
  if (!extras.IsObject() || !extras.Has(std::string(kKernelUpKey))) return;
  const tinygltf::Value& up = extras.Get(std::string(kKernelUpKey));
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  bool usable = up.IsArray() && up.ArrayLen() == 3;
  for (int i = 0; usable && i < 3; ++i) {
    usable = up.Get(i).IsNumber();
    if (usable) direction[i] = up.Get(i).GetNumberAsDouble();
  }
  direction = (linear * direction).stableNormalized();
  if (!usable || !direction.allFinite() || !(direction.norm() > 0.5)) {
    model_.warnings.push_back(
        fmt::format("{}: {}: {} is no direction; its stored shadow kernels are not used", name_,
                    what, kKernelUpKey));
    return;
  }
  const glm::vec3 turned(static_cast<float>(direction.x()), static_cast<float>(direction.y()),
                         static_cast<float>(direction.z()));
  if (model_.shadow_kernel_up && glm::dot(turned, *model_.shadow_kernel_up) < 0.99999F &&
      !disagree_) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: its shadow kernels are for another direction than those of other meshes", name_,
        what));
    disagree_ = true;
  }
  model_.shadow_kernel_up = turned;
  if (extras.Has(std::string(kKernelGeometryKey)) &&
      extras.Get(std::string(kKernelGeometryKey)).IsString()) {
    model_.shadow_kernel_geometry = extras.Get(std::string(kKernelGeometryKey)).Get<std::string>();
  }
  if (extras.Has(std::string(kKernelGroupsKey))) take_groups(extras, what);
}

void StoredKernels::take_groups(const tinygltf::Value& extras, const std::string& what) {
  const tinygltf::Value& groups = extras.Get(std::string(kKernelGroupsKey));
  std::vector<std::string> names;
  for (std::size_t i = 0; groups.IsArray() && i < groups.ArrayLen(); ++i) {
    const tinygltf::Value& group = groups.Get(static_cast<int>(i));
    if (group.IsString()) names.push_back(group.Get<std::string>());
  }
  if (!groups.IsArray() || names.size() != groups.ArrayLen() || names.size() > kMaxGroups) {
    model_.warnings.push_back(fmt::format(
        "{}: {}: {} is no list of names; its parts are not joined", name_, what, kKernelGroupsKey));
    return;
  }
  model_.shadow_kernel_groups = std::move(names);
}

void StoredKernels::finish() {
  if (disagree_) model_.shadow_kernel_up.reset();
  if (model_.shadow_kernel_up) return;
  for (Mesh& mesh : model_.meshes) mesh.shadow_kernels.clear();
}

}  // namespace penumbra::gltf
