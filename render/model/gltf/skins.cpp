#include "render/model/gltf/skins.hpp"

#include <cmath>

#include "core/propagate.hpp"

namespace penumbra::gltf {

Result<std::vector<Eigen::Matrix4d>> Skins::inverse_bind_matrices(const tinygltf::Skin& skin,
                                                                  const std::string& place) const {
  std::vector<Eigen::Matrix4d> matrices(skin.joints.size(), Eigen::Matrix4d::Identity());
  if (skin.inverseBindMatrices < 0) return matrices;
  const std::string what = place + "/inverseBindMatrices";
  PENUMBRA_TRY(const Elements elements, accessors_.elements(skin.inverseBindMatrices, what));
  const int type = accessors_.find(skin.inverseBindMatrices)->componentType;
  if (elements.width != 16 || type != TINYGLTF_COMPONENT_TYPE_FLOAT) {
    return fail("{}: {}: are not 4 x 4 matrices of floats", name_, what);
  }
  if (elements.count < matrices.size()) {
    return fail("{}: {}: are {} for {} joints", name_, what, elements.count, matrices.size());
  }
  for (std::size_t i = 0; i < matrices.size(); ++i) {
    matrices[i] = Eigen::Map<const Eigen::Matrix4d>(elements.values.data() + 16 * i);
    const Eigen::RowVector4d expected(0.0, 0.0, 0.0, 1.0);
    if ((matrices[i].row(3) - expected).cwiseAbs().maxCoeff() > 1e-4) {
      return fail("{}: {}: matrix {} is not a placement in space (last row 0 0 0 1)", name_, what,
                  i);
    }
    matrices[i].row(3) = expected;
  }
  return matrices;
}

Result<const std::vector<Eigen::Matrix4d>*> Skins::joint_matrices(int index) {
  const std::string place = fmt::format("skins/{}", index);
  if (const auto known = known_.find(index); known != known_.end()) return &known->second;
  const tinygltf::Skin& skin = gltf_.skins[static_cast<std::size_t>(index)];
  if (skin.joints.empty()) return fail("{}: {}: has no joints", name_, place);
  for (const int joint : skin.joints) {
    if (!has(gltf_.nodes, joint)) {
      return fail("{}: {}/joints: names node {}, there are {}", name_, place, joint,
                  gltf_.nodes.size());
    }
  }
  PENUMBRA_TRY(std::vector<Eigen::Matrix4d> matrices, inverse_bind_matrices(skin, place));
  for (std::size_t i = 0; i < matrices.size(); ++i) {
    PENUMBRA_TRY(const Eigen::Matrix4d T_root_joint, nodes_.T_root_node(skin.joints[i]));
    matrices[i] = T_root_joint * matrices[i];
    if (!matrices[i].allFinite()) {
      return fail("{}: {}: the transform of joint {} is not finite", name_, place, i);
    }
  }
  return &(known_[index] = std::move(matrices));
}

Result<void> check_joints(const std::string& name, const Primitive& primitive,
                          std::size_t joint_count) {
  const SkinWeights& skin = primitive.skin;
  for (std::size_t k = 0; k < skin.joints.size(); ++k) {
    // The joint of a weight of 0 has no meaning.
    if (skin.joints[k] >= joint_count && skin.weights[k] > 0.0) {
      return fail("{}: {}/attributes/JOINTS_{}: vertex {} names joint {}, the skin has {}", name,
                  primitive.place, k % skin.per_vertex / 4, k / skin.per_vertex, skin.joints[k],
                  joint_count);
    }
  }
  return {};
}

Eigen::Matrix4d blended(const SkinWeights& skin, std::size_t vertex,
                        const std::vector<Eigen::Matrix4d>& joint_matrices) {
  Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
  for (std::size_t k = vertex * skin.per_vertex; k < (vertex + 1) * skin.per_vertex; ++k) {
    if (skin.weights[k] > 0.0) sum += skin.weights[k] * joint_matrices[skin.joints[k]];
  }
  return sum;
}

}  // namespace penumbra::gltf
