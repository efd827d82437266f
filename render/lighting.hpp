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
  Eigen::Vector3d gain = Eigen::Vector3d::Ones();    // factor on the scene's lights
  Eigen::Vector3d sky = Eigen::Vector3d::Zero();     // ambient light on a surface that faces up
  Eigen::Vector3d ground = Eigen::Vector3d::Zero();  // ambient light on a surface that faces down
};
// Returns the lighting of a frame. If the light of the video is known, `gain` makes a white matt
// surface on the table as bright as white paper (darker if the scene's lights sum to less than 1),
// and `ground` is the mean of the image. The light fractions of shadows do not depend on it.
[[nodiscard]] Lighting lighting_for(const Scene& scene, const SceneState& state);

// Returns the fractions of light left in umbra, middle layer and penumbra on the plane through
// `place` with the normal `normal`, table frame. Up to the ambient light of a bright room they are
// `fractions`. Casters do not block further ambient light, so it increases the fractions
// (docs/rendering.md#tone).
[[nodiscard]] LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                               const std::vector<PlacedLight>& lights,
                                               const Eigen::Vector3d& normal,
                                               const Eigen::Vector3d& place);

}  // namespace penumbra
