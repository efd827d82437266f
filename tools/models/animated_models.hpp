// Bundled models with an animation, generated from formulas: a walking figure with a skin, and a
// blob with morph targets.
#pragma once

#include <array>
#include <cstdint>
#include <glm/gtc/quaternion.hpp>
#include <glm/vec3.hpp>
#include <numbers>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra::models {

inline constexpr double kFullTurn = 2.0 * std::numbers::pi;  // [rad]
// Keys of a motion over its duration; the last one equals the first.
inline constexpr int kMotionKeys = 25;

struct Bone {
  std::string name;
  int parent = -1;        // index of an earlier bone
  glm::dvec3 joint{0.0};  // about which it rotates, in the rest pose [mm]
};

// The bones that move a vertex.
struct BoneWeights {
  std::array<std::uint8_t, 4> bones{};
  std::array<float, 4> weights{};  // sum 1
};

// Object frame, z up, at times that are equally spaced from 0 to `duration_s`.
struct Motion {
  std::string name;
  double duration_s = 0.0;
  // [key][bone]: rotation relative to the parent bone. Empty if no bone moves.
  std::vector<std::vector<glm::dquat>> rotations;
  std::vector<glm::dvec3> root_offsets;      // [key]: of the first bone [mm]
  std::vector<std::vector<double>> weights;  // [key][morph target]
};

// The model is in its rest pose. Its meshes correspond to the other vectors.
struct MovingModel {
  Model model;
  std::vector<Bone> bones;
  std::vector<std::vector<BoneWeights>> skin;  // [mesh][vertex]; empty if there are no bones
  std::vector<Model> targets;                  // the same meshes, displaced
  Motion motion;
};

// A figure of 0.12 m that walks on the spot, towards +x, in one second.
[[nodiscard]] MovingModel make_figure();
// A ball of 0.05 m whose lobes grow and shrink within two seconds. `lobes`: their size, 1 in the
// bundled model.
[[nodiscard]] MovingModel make_blob(double lobes = 1.0);
[[nodiscard]] std::vector<MovingModel> make_moving_models();

// Returns the bytes of a .glb. The same model always gives the same bytes.
[[nodiscard]] Result<std::vector<std::uint8_t>> encode_glb(const MovingModel& moving);

}  // namespace penumbra::models
