#include "render/lighting.hpp"

#include <algorithm>

namespace penumbra {
namespace {

const Eigen::Vector3d kLuminance(0.2126, 0.7152, 0.0722);

}  // namespace

std::vector<PlacedLight> lights_or_default(const std::vector<PlacedLight>& lights) {
  return lights.empty() ? std::vector<PlacedLight>{default_light()} : lights;
}

Lighting lighting_for(const Scene& scene, const SceneState& state) {
  // Bluish light from above, reddish light reflected by wood and paper below.
  const Eigen::Vector3d sky_tint(1.08, 1.12, 1.18);
  const Eigen::Vector3d ground_tint(0.52, 0.49, 0.45);
  Lighting lighting;
  lighting.sky = scene.ambient.cwiseProduct(sky_tint);
  lighting.ground = scene.ambient.cwiseProduct(ground_tint);
  if (!state.video_light) return lighting;

  Eigen::Vector3d on_table = lighting.sky;
  for (const PlacedLight& light : lights_or_default(state.lights)) {
    const Eigen::Vector3d towards = light.position.head<3>();
    const double length = towards.norm();
    if (length > 0.0) on_table += std::max(towards.z() / length, 0.0) * light.color;
  }
  lighting.gain = state.video_light->on_table / std::max(kLuminance.dot(on_table), 1.0);
  lighting.sky = lighting.sky.cwiseProduct(lighting.gain);
  lighting.ground = state.video_light->around;
  return lighting;
}

LightFractions lifted_by_ambient(const LightFractions& fractions, const Scene& scene,
                                 const std::vector<PlacedLight>& lights,
                                 const Eigen::Vector3d& normal, const Eigen::Vector3d& place) {
  const double ambient = kLuminance.dot(scene.ambient);
  if (!(ambient > Scene::kBrightRoomAmbient)) return fractions;
  double direct = 0.0;
  for (const PlacedLight& light : lights_or_default(lights)) {
    const Eigen::Vector3d towards = light.position.head<3>() - light.position.w() * place;
    const double length = towards.norm();
    if (length > 0.0)
      direct += std::max(towards.dot(normal) / length, 0.0) * kLuminance.dot(light.color);
  }
  const double share = (Scene::kBrightRoomAmbient + direct) / (ambient + direct);
  const auto lifted = [share](double left) { return 1.0 - share * (1.0 - left); };
  return {lifted(fractions.umbra), lifted(fractions.middle), lifted(fractions.penumbra)};
}

}  // namespace penumbra
