#include "render/passes/light_uniforms.hpp"

#include <glm/vec4.hpp>

#include "core/assert.hpp"
#include "render/camera_gl.hpp"

namespace penumbra {

void set_light_uniforms(const ShaderProgram& program, const FramePlan& plan,
                        std::span<const float> blocked) {
  const PlacedLight lamp = lamp_of_no_scene();
  const std::span<const PlacedLight> lights =
      plan.lights.empty() ? std::span(&lamp, 1) : std::span(plan.lights);
  PENUMBRA_ASSERT(lights.size() <= kMaxLights);
  std::array<glm::vec4, kMaxLights> places{};
  std::array<glm::vec4, kMaxLights> colors{};
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const Eigen::Vector4d& place = lights[i].place;
    const Eigen::Vector3d color = lights[i].color.cwiseProduct(plan.lighting.gain);
    places[i] = glm::vec4(to_gl(Eigen::Vector3d(place.head<3>())), static_cast<float>(place.w()));
    colors[i] = glm::vec4(to_gl(color), i < blocked.size() ? blocked[i] : 0.0F);
  }
  program.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
  program.set("light_count", static_cast<int>(lights.size()));
  program.set("light_place", std::span<const glm::vec4>(places));
  program.set("light_color", std::span<const glm::vec4>(colors));
  program.set("sky_light", to_gl(plan.lighting.sky));
  program.set("ground_light", to_gl(plan.lighting.ground));
}

}  // namespace penumbra
