// The light of a frame: on virtual objects, and in shadows.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "render/scene/scene.hpp"

namespace penumbra {

// Returns the lights, or default_light() if there are none.
[[nodiscard]] std::vector<PlacedLight> lights_or_lamp(const std::vector<PlacedLight>& lights);

// The light on virtual objects beside the scene's lights. Linear, by channel.
struct Lighting {
  Eigen::Vector3d gain = Eigen::Vector3d::Ones();  // factor on the scene's lights
  // From the upper half of the room and from below, on a surface that faces it.
  Eigen::Vector3d sky = Eigen::Vector3d::Zero();
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();
};
// If the light of the video is known, a white matt surface on the table is as bright as white paper
// there; darker if the scene's lights together give it less than 1, so that they can be dimmed. The
// light from below is the mean of the image around. Neither changes the fractions of shadows.
[[nodiscard]] Lighting lighting_for(const Scene& scene, const SceneState& state);

// Returns the fractions of light left in the layers on a plane, `normal` up, through `place`, table
// frame. The scene's fractions hold up to Scene::kUsualAmbient. Casters block no ambient light
// beyond it, so the fractions rise (docs/rendering.md#tone).
[[nodiscard]] LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                               const std::vector<PlacedLight>& lights,
                                               const Eigen::Vector3d& normal,
                                               const Eigen::Vector3d& place);

}  // namespace penumbra
