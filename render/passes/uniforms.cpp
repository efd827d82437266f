#include "render/passes/uniforms.hpp"

#include <array>

#include "core/assert.hpp"

namespace penumbra {

void set_lens(const ShaderProgram& program, const LensUniforms& lens) {
  program.set("lens_scale_offset", lens.scale_offset);
  program.set("lens_k_low", lens.k_low);
  program.set("lens_k_high", lens.k_high);
  program.set("lens_model", lens.model);
  program.set("lens_max_radius", lens.max_radius);
  program.set("lens_depth", lens.depth);
}

void set_lights(const ShaderProgram& program, const FramePlan& plan,
                std::span<const float> blocked) {
  const std::vector<PlacedLight> lights = lights_or_default(plan.lights);
  PENUMBRA_ASSERT(lights.size() <= kMaxLights);
  std::array<glm::vec4, kMaxLights> places{};
  std::array<glm::vec4, kMaxLights> colors{};
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const Eigen::Vector4d& place = lights[i].position;
    const Eigen::Vector3d color = lights[i].color.cwiseProduct(plan.lighting.gain);
    places[i] = glm::vec4(to_gl(Eigen::Vector3d(place.head<3>())), static_cast<float>(place.w()));
    colors[i] = glm::vec4(to_gl(color), i < blocked.size() ? blocked[i] : 0.0F);
  }
  program.set("eye", to_gl(plan.T_table_camera.translation()));
  program.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
  program.set("light_count", static_cast<int>(lights.size()));
  program.set("light_place", std::span<const glm::vec4>(places));
  program.set("light_color", std::span<const glm::vec4>(colors));
  program.set("sky_light", to_gl(plan.lighting.sky));
  program.set("ground_light", to_gl(plan.lighting.ground));
}

}  // namespace penumbra
