#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "render/scene.hpp"
#include "render/shapes.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

json good_scene() {
  return json::parse(R"({
    "objects": [
      {"name": "body", "shape": {"box": [0.1, 0.05, 0.02]}, "position": [0, 0, 0.1],
       "animation": {"keyframes": [{"time": 0}, {"time": 1, "position": [0.1, 0, 0.2]}, {"time": 3}]}},
      {"name": "rotor", "shape": {"cylinder": [0.05, 0.002]}, "parent": "body", "position": [0, 0, 0.03],
       "animation": {"spin": {"turns_per_second": 0.25}}}
    ],
    "phantoms": [{"name": "mug", "shape": {"cylinder": [0.04, 0.09]}, "position": [0.2, 0.1, 0]}],
    "planes": [{"name": "table"}, {"name": "wall", "normal": [0, -2, 0], "point": [0, 0.2, 0], "outline": [[0, 0], [1, 0], [1, 1]]}],
    "lights": [{"name": "lamp", "type": "point", "position": [0, 0, 1]}, {"name": "sky", "type": "directional", "towards": [0, 3, 4]}],
    "shadows": [{"name": "all", "workspace_height": 0.3, "magnification": 1.5}]
  })");
}

class SceneFile : public testing::Test {
 protected:
  Result<Scene> load(const std::string& text) {
    std::ofstream(folder_.path() / "scene.json") << text;
    return load_scene(folder_.path() / "scene.json");
  }
  Result<Scene> load(const json& document) { return load(document.dump()); }
  // The message, which always names the file.
  std::string error_of(const json& document) {
    const Result<Scene> scene = load(document);
    if (scene) return "accepted";
    EXPECT_THAT(scene.error().message, HasSubstr("scene.json"));
    EXPECT_EQ(scene.error().message.find('\n'), std::string::npos) << scene.error().message;
    return scene.error().message;
  }

  test::TemporaryFolder folder_;
};

TEST_F(SceneFile, ReadsEverything) {
  const Result<Scene> scene = load(good_scene());
  ASSERT_TRUE(scene) << scene.error().message;
  ASSERT_EQ(scene->objects.size(), 3U);
  EXPECT_EQ(scene->objects[1].parent, 0);
  EXPECT_TRUE(scene->objects[2].phantom);
  EXPECT_FALSE(scene->objects[2].casts_shadow);
  EXPECT_TRUE(scene->planes[1].normal.isApprox(Eigen::Vector3d(0, -1, 0)));
  EXPECT_EQ(scene->planes[1].outline.size(), 3U);
  EXPECT_TRUE(scene->lights[1].direction.isApprox(Eigen::Vector3d(0, 0.6, 0.8)));
  ASSERT_EQ(scene->shadows.size(), 1U);
  EXPECT_EQ(scene->shadows[0].casters, (std::vector<int>{0, 1})) << "phantoms cast no shadow";
  EXPECT_EQ(scene->shadows[0].planes, std::vector<int>{0});
  EXPECT_EQ(scene->shadows[0].technique, ShadowTechnique::layered);
  EXPECT_NEAR(scene->shadows[0].layered.light_ratio, 3.0, 1e-12);
  EXPECT_NEAR(scene->shadows[0].layered.light_height, 0.9, 1e-12);
  EXPECT_NEAR(scene->shadows[0].layered.umbra_height, 0.3, 1e-12);
}

TEST_F(SceneFile, LightsAtTheZenithAndPlainConstants) {
  json scene = good_scene();
  scene["shadows"] = json::parse(
      R"([{"name": "a", "light_height": "inf", "umbra_height": 0.4}, {"name": "b", "light_height": 0.6, "light_ratio": 0.5}])");
  const Result<Scene> read = load(scene);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_TRUE(std::isinf(read->shadows[0].layered.light_height));
  EXPECT_EQ(read->shadows[0].layered.umbra_height, 0.4);
  ASSERT_EQ(read->warnings.size(), 1U);
  EXPECT_THAT(read->warnings[0], HasSubstr("never vanishes"));
}

TEST_F(SceneFile, ModelsAreFoundBesideTheScene) {
  std::ofstream(folder_.path() / "triangle.obj") << "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  json scene = good_scene();
  scene["objects"][0].erase("shape");
  scene["objects"][0]["model"] = "triangle.obj";
  const Result<Scene> read = load(scene);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->objects[0].model->triangle_count(), 1U);
}

TEST_F(SceneFile, SaysWhatIsWrongAndWhere) {
  const auto with = [](const std::string& pointer, const json& value) {
    json scene = good_scene();
    scene[json::json_pointer(pointer)] = value;
    return scene;
  };
  EXPECT_THAT(error_of(with("/objects/0/scael", 2)),
              AllOf(HasSubstr("/objects/0"), HasSubstr("did you mean 'scale'")));
  EXPECT_THAT(error_of(with("/objects/0/scale", -1)), HasSubstr("/objects/0/scale"));
  EXPECT_THAT(error_of(with("/objects/0/scale", "big")), HasSubstr("/objects/0/scale"));
  EXPECT_THAT(error_of(with("/objects/0/position", json::array({1, 2}))),
              HasSubstr("/objects/0/position"));
  EXPECT_THAT(error_of(with("/objects/1/name", "body")),
              AllOf(HasSubstr("/objects/1/name"), HasSubstr("is taken")));
  EXPECT_THAT(error_of(with("/objects/1/parent", "nobody")),
              AllOf(HasSubstr("/objects/1/parent"), HasSubstr("nobody")));
  EXPECT_THAT(error_of(with("/objects/1/parent", "rotor")), HasSubstr("list parents before"));
  EXPECT_THAT(error_of(with("/objects/0/model", "no-such.glb")),
              HasSubstr("either a model file or a shape"));
  EXPECT_THAT(error_of(with("/objects/0/animation/keyframes/1/time", 0)),
              HasSubstr("/objects/0/animation/keyframes/1/time"));
  EXPECT_THAT(error_of(with("/objects/0/animation/keyframes/2/position", json::array({1, 0, 0}))),
              HasSubstr("a loop must end as it begins"));
  EXPECT_THAT(error_of(with("/planes/1/normal", json::array({0, 0, 0}))),
              AllOf(HasSubstr("/planes/1/normal"), HasSubstr("no length")));
  EXPECT_THAT(error_of(with("/lights/0/towards", json::array({0, 0, 1}))),
              HasSubstr("/lights/0/towards"));
  EXPECT_THAT(error_of(with("/lights/0/type", "laser")), HasSubstr("/lights/0/type"));
  EXPECT_THAT(error_of(with("/shadows/0/technique", "raytraced")),
              AllOf(HasSubstr("/shadows/0/technique"), HasSubstr("layered")));
  EXPECT_THAT(error_of(with("/shadows/0/kernels", "magic")),
              AllOf(HasSubstr("/shadows/0/kernels"), HasSubstr("cocl")));
  EXPECT_THAT(error_of(with("/shadows/0/casters", json::array({"mug"}))),
              HasSubstr("is a phantom"));
  EXPECT_THAT(error_of(with("/shadows/0/planes", json::array({"ceiling"}))),
              AllOf(HasSubstr("/shadows/0/planes/0"), HasSubstr("ceiling")));
  EXPECT_THAT(error_of(with("/shadows/0/light_height", 1)),
              HasSubstr("either workspace_height and magnification"));
  EXPECT_THAT(error_of(with("/shadows/0/magnification", 1)), HasSubstr("/shadows/0/magnification"));
  EXPECT_THAT(error_of(with("/shadows/0/light_left", {{"umbra", 0.9}})),
              HasSubstr("/shadows/0/light_left"));
  json missing = good_scene();
  missing["objects"][0].erase("name");
  EXPECT_THAT(error_of(missing), AllOf(HasSubstr("/objects/0"), HasSubstr("name")));
  json no_model = good_scene();
  no_model["objects"][0].erase("shape");
  no_model["objects"][0]["model"] = "no-such.glb";
  EXPECT_THAT(error_of(no_model), AllOf(HasSubstr("/objects/0/model"), HasSubstr("no-such.glb")));
}

TEST_F(SceneFile, RefusesWhatIsNoJson) {
  for (const std::string text : {"", "{", "[]", "3", "{\"objects\": [}", "{\"objects\": 1e999}",
                                 "\xff\xfe", "{\"objects\": [], \"ambient\": [NaN, 0, 0]}"}) {
    const Result<Scene> scene = load(text);
    ASSERT_FALSE(scene) << text;
    EXPECT_THAT(scene.error().message, HasSubstr("scene.json"));
  }
  EXPECT_FALSE(load_scene(folder_.path() / "absent.json"));
  EXPECT_FALSE(load_scene(folder_.path()));
  // Deep nesting neither overflows a stack nor is accepted.
  EXPECT_FALSE(load("{\"objects\":" + std::string(100000, '[') + std::string(100000, ']') + "}"));
}

TEST(SceneState, MovesThroughItsKeysSmoothlyAndLoops) {
  Scene scene;
  SceneObject object;
  object.placement.position = {0, 0, 1};
  const auto key = [](double t, double x, double degrees) {
    return Keyframe{
        t,
        {Eigen::Vector3d(x, 0, 0),
         Eigen::Quaterniond(Eigen::AngleAxisd(degrees * M_PI / 180.0, Eigen::Vector3d::UnitZ())),
         1.0}};
  };
  object.animation.keyframes = {key(0, 0, 0), key(1, 1, 90), key(3, -1, -30), key(4, 0, 0)};
  scene.objects.push_back(object);

  for (const double period : {0.0, 4.0, 40.0, -4.0}) {
    EXPECT_NEAR(evaluate_scene(scene, period + 1.0).objects[0].position.x(), 1.0, 1e-9);
    EXPECT_NEAR(evaluate_scene(scene, period + 3.0).objects[0].position.x(), -1.0, 1e-9);
    EXPECT_NEAR(evaluate_scene(scene, period + 1.0).objects[0].position.z(), 1.0, 1e-12);
  }
  // Continuous in position and velocity, across keys and across the seam of the loop.
  const double step = 1e-4;
  double previous_speed = std::numeric_limits<double>::quiet_NaN();
  for (double t = -0.5; t < 9.0; t += step) {
    const Placement a = evaluate_scene(scene, t).objects[0];
    const Placement b = evaluate_scene(scene, t + step).objects[0];
    const double speed = (b.position.x() - a.position.x()) / step;
    ASSERT_LT(std::abs(speed), 5.0) << t;
    if (!std::isnan(previous_speed)) {
      ASSERT_LT(std::abs(speed - previous_speed), 0.01) << t;
    }
    ASSERT_LT(a.rotation.angularDistance(b.rotation), 1e-3) << t;
    previous_speed = speed;
  }
}

TEST(SceneState, WithoutALoopThePathEnds) {
  Scene scene;
  SceneObject object;
  object.animation.loop = false;
  object.animation.keyframes = {{1.0, {Eigen::Vector3d(1, 0, 0)}},
                                {2.0, {Eigen::Vector3d(2, 0, 0)}}};
  scene.objects.push_back(object);
  EXPECT_EQ(evaluate_scene(scene, 0.0).objects[0].position.x(), 1.0);
  EXPECT_EQ(evaluate_scene(scene, 9.0).objects[0].position.x(), 2.0);
}

TEST(SceneState, ChildrenRideOnTheirParents) {
  Scene scene;
  SceneObject body;
  body.placement = {Eigen::Vector3d(1, 2, 3),
                    Eigen::Quaterniond(Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitZ())), 2.0};
  SceneObject rotor;
  rotor.parent = 0;
  rotor.placement.position = {1, 0, 0};
  rotor.animation.spin_turns_per_s = 0.25;
  scene.objects = {body, rotor};
  const SceneState state = evaluate_scene(scene, 1.0);
  EXPECT_TRUE(state.objects[1].position.isApprox(Eigen::Vector3d(1, 4, 3)));
  EXPECT_EQ(state.objects[1].scale, 2.0);
  EXPECT_TRUE(
      (state.objects[1] * Eigen::Vector3d(1, 0, 0)).isApprox(Eigen::Vector3d(-1, 4, 3), 1e-9))
      << "a quarter turn on a quarter turn";
}

TEST(Shapes, AreClosedWithOutwardNormals) {
  for (const Model& model :
       {make_box({0.1F, 0.2F, 0.3F}), make_sphere(0.1F, 16), make_cylinder(0.1F, 0.2F, 12)}) {
    double volume = 0.0;
    std::map<std::pair<std::array<int, 3>, std::array<int, 3>>, int> edges;
    for (const Mesh& mesh : model.meshes) {
      const auto key = [&](std::uint32_t i) {
        const glm::vec3& p = mesh.positions[i];
        return std::array<int, 3>{static_cast<int>(std::lround(p.x * 1e5)),
                                  static_cast<int>(std::lround(p.y * 1e5)),
                                  static_cast<int>(std::lround(p.z * 1e5))};
      };
      for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        const glm::vec3 a = mesh.positions[mesh.indices[i]];
        const glm::vec3 b = mesh.positions[mesh.indices[i + 1]];
        const glm::vec3 c = mesh.positions[mesh.indices[i + 2]];
        volume +=
            static_cast<double>(a.x * (b.y * c.z - b.z * c.y) - a.y * (b.x * c.z - b.z * c.x) +
                                a.z * (b.x * c.y - b.y * c.x)) /
            6.0;
        for (std::size_t e = 0; e < 3; ++e)
          ++edges[{key(mesh.indices[i + e]), key(mesh.indices[i + (e + 1) % 3])}];
      }
    }
    EXPECT_GT(volume, 0.0) << model.name;
    for (const auto& [edge, count] : edges) {
      EXPECT_EQ(count, 1) << model.name;
      EXPECT_EQ(edges.count({edge.second, edge.first}), 1U)
          << model.name << ": every edge has its other side";
    }
  }
}

TEST(BundledScenes, LoadWithoutAWarning) {
  int scenes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(test::source_dir() / "scenes")) {
    if (entry.path().extension() != ".json" || entry.path().filename() == "scene.schema.json")
      continue;
    const Result<Scene> scene = load_scene(entry.path());
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_THAT(scene->warnings, testing::IsEmpty());
    EXPECT_FALSE(scene->shadows.empty());
    ++scenes;
  }
  EXPECT_GE(scenes, 1);
}

}  // namespace
}  // namespace penumbra
