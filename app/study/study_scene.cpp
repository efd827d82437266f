#include "app/study/study_task.hpp"

#include <memory>
#include <numeric>
#include <utility>

#include "render/scene/shapes.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {
namespace {

void add_sphere(Scene& scene, std::string name, const glm::vec4& color) {
  Model model = make_sphere(static_cast<float>(kStudySphere_m));
  model.materials[0].base_color = color;
  SceneObject object;
  object.name = std::move(name);
  object.model = std::make_shared<const Model>(std::move(model));
  object.placement.position.z() = kStudySphere_m;
  scene.objects.push_back(std::move(object));
}

ScenePlane wall(std::string name, const Eigen::Vector3d& normal, const Eigen::Vector3d& point) {
  constexpr double kHalf_m = 0.25, kHeight_m = 0.30;
  ScenePlane plane;
  plane.name = std::move(name);
  plane.normal = normal;
  plane.point = point;
  plane.outline = {{-kHalf_m, 0.0}, {kHalf_m, 0.0}, {kHalf_m, kHeight_m}, {-kHalf_m, kHeight_m}};
  return plane;
}

}  // namespace

std::string study_sphere(int index) {
  return "sphere " + std::to_string(index + 1);
}

Scene study_scene(StudyExperiment experiment) {
  const glm::vec4 red(0.75F, 0.16F, 0.09F, 1.0F), green(0.10F, 0.50F, 0.20F, 1.0F);
  constexpr double kWalls_m = 0.15;  // distance from the middle, just outside the spheres
  constexpr double kWorkspace_m = 0.24, kMagnification = 1.5, kLamp_m = 0.7;
  Scene scene;
  scene.name = "study";
  scene.file = "the study's scene";
  if (experiment == StudyExperiment::heights) {
    for (int i = 0; i < 3; ++i) add_sphere(scene, study_sphere(i), red);
  } else {
    add_sphere(scene, kStudyBall, red);
    add_sphere(scene, kStudyTarget, green);
  }
  ScenePlane table;
  table.name = "table";
  scene.planes = {table, wall("back wall", -Eigen::Vector3d::UnitY(), {0.0, kWalls_m, 0.0}),
                  wall("left wall", Eigen::Vector3d::UnitX(), {-kWalls_m, 0.0, 0.0})};
  SceneLight lamp;
  lamp.name = "lamp";
  lamp.position = {0.0, 0.0, kLamp_m};
  scene.lights = {lamp};
  ShadowNode node;
  node.name = "shadows";
  node.casters.resize(scene.objects.size());
  std::iota(node.casters.begin(), node.casters.end(), 0);
  node.planes = {0};
  node.walls = {1, 2};
  node.lights = {0};
  if (const auto constants = layered_constants_for_workspace(kWorkspace_m, kMagnification)) {
    node.layered = *constants;
  }
  scene.shadows = {std::move(node)};
  return scene;
}

}  // namespace penumbra
