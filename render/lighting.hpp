// Computes the light of a frame: on virtual objects, and in shadows.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "render/scene/scene.hpp"

namespace penumbra {

// Returns the lights, or default_light() if there are none.
[[nodiscard]] std::vector<PlacedLight> lights_or_default(const std::vector<PlacedLight>& lights);

// Factor on the scene's lights, and ambient light on virtual objects. Linear RGB.
struct Lighting {
  Eigen::Vector3d gain = Eigen::Vector3d::Ones();  // factor on the scene's lights
  // Hemisphere light from above and from below, on a surface that faces it.
  Eigen::Vector3d sky = Eigen::Vector3d::Zero();
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();
};
// If the light of the video is known, scales the lights such that a white matt surface on the table
// is as bright as white paper; darker if the scene's lights are dimmed to a total below 1. The
// light from below is the image's mean. Neither changes the light fractions of shadows.
[[nodiscard]] Lighting lighting_for(const Scene& scene, const SceneState& state);

// Returns the fractions of light left in the layers on the plane through `place` with the normal
// `normal`, table frame. Up to an ambient light of Scene::kUsualAmbient these are the scene's
// fractions. More ambient light is not blocked by casters, so the fractions increase
// (docs/rendering.md#tone).
[[nodiscard]] LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                               const std::vector<PlacedLight>& lights,
                                               const Eigen::Vector3d& normal,
                                               const Eigen::Vector3d& place);

}  // namespace penumbra
