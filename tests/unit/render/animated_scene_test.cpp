// Scenes whose objects play animations of their models: time, drawing and shadows.
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>

#include "render/model/animated_model.hpp"
#include "render/scene/scene_writer.hpp"
#include "support/animated_gltf.hpp"
#include "support/moving_shadow.hpp"
#include "support/paths.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/techniques.hpp"

namespace penumbra {
namespace {

using test::GltfBuilder;
using testing::ElementsAre;
using testing::HasSubstr;

// A column of 0.08 m on the table, whose upper half bends by up to 80 degrees within a second and
// back, about the file's z axis. Its second animation raises it by 0.05 m.
GltfBuilder bending_column() {
  GltfBuilder file;
  constexpr int kSides = 8, kRings = 7;
  std::vector<float> positions, weights;
  std::vector<std::uint8_t> joints;
  std::vector<std::uint16_t> corners;
  for (int ring = 0; ring < kRings; ++ring) {
    const float height = 0.08F * static_cast<float>(ring) / (kRings - 1);
    const float upper = static_cast<float>(ring) / (kRings - 1);
    for (int side = 0; side < kSides; ++side) {
      const float angle = 2.0F * std::numbers::pi_v<float> * static_cast<float>(side) / kSides;
      positions.insert(positions.end(),
                       {0.012F * std::cos(angle), height, -0.012F * std::sin(angle)});
      joints.insert(joints.end(), {0, 1, 0, 0});
      weights.insert(weights.end(), {1.0F - upper, upper, 0, 0});
      if (ring == 0) continue;
      const auto a = static_cast<std::uint16_t>((ring - 1) * kSides + side);
      const auto b = static_cast<std::uint16_t>((ring - 1) * kSides + (side + 1) % kSides);
      const auto c = static_cast<std::uint16_t>(a + kSides),
                 d = static_cast<std::uint16_t>(b + kSides);
      corners.insert(corners.end(), {a, b, d, a, d, c});
    }
  }
  const auto top = static_cast<std::uint16_t>((kRings - 1) * kSides);
  for (std::uint16_t side = 1; side + 1 < kSides; ++side) {
    const auto next = static_cast<std::uint16_t>(side + 1);
    corners.insert(corners.end(), {0, next, side});
    corners.insert(corners.end(), {top, static_cast<std::uint16_t>(top + side),
                                   static_cast<std::uint16_t>(top + next)});
  }
  file.mesh(positions, corners);
  file.primitive()["attributes"]["JOINTS_0"] = file.accessor(joints, "VEC4");
  file.primitive()["attributes"]["WEIGHTS_0"] = file.accessor(weights, "VEC4");
  const std::vector<float> inverse_bind = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0,      0, 1,
                                           1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, -0.04F, 0, 1};
  file.json["skins"] = {
      {{"joints", {1, 2}}, {"inverseBindMatrices", file.accessor(inverse_bind, "MAT4")}}};
  file.json["nodes"] = {
      {{"mesh", 0}, {"skin", 0}}, {{"children", {2}}}, {{"translation", {0, 0.04, 0}}}};
  file.json["scenes"] = {{{"nodes", {0, 1}}}};
  const auto half = static_cast<float>(40.0 * std::numbers::pi / 180.0);
  test::animate(file, 2, "rotation", {0, 1, 2},
                std::vector<float>{0, 0, 0, 1, 0, 0, -std::sin(half), std::cos(half), 0, 0, 0, 1});
  test::animate(file, 1, "translation", {0, 4}, std::vector<float>{0, 0, 0, 0, 0.05F, 0},
                {.animation = 1});
  file.json["animations"][0]["name"] = "Bend";
  file.json["animations"][1]["name"] = "Rise";
  return file;
}

class AnimatedScene : public testing::Test {
 protected:
  AnimatedScene() { write("column.glb", bending_column().glb()); }
  void write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_.path() / name, std::ios::binary) << text;
  }
  Result<Scene> scene_of(const nlohmann::json& object) const {
    write("scene.json",
          nlohmann::json{{"objects", {object}},
                         {"shadows", {{{"name", "shadow"}, {"technique", "layered"}}}}}
              .dump());
    return load_scene(folder_.path() / "scene.json");
  }
  std::string error_of(const nlohmann::json& object) const {
    const auto scene = scene_of(object);
    return scene ? "was accepted" : scene.error().message;
  }
  std::shared_ptr<const AnimatedModel> column(const std::string& animation = "Bend") const {
    return AnimatedModel::load(folder_.path() / "column.glb", animation).value();
  }
  test::TemporaryFolder folder_;
};

// --- time ---

TEST_F(AnimatedScene, PlaysAtSpeedFromStart) {
  const Playback looping{column(), 1.5, 0.25, true};
  EXPECT_EQ(looping.model->end_s(), 2.0);
  EXPECT_DOUBLE_EQ(looping.time_at(0.0), 0.25);
  EXPECT_DOUBLE_EQ(looping.time_at(1.0), 1.75);
  EXPECT_DOUBLE_EQ(looping.time_at(1.5), 0.5);
  EXPECT_DOUBLE_EQ(looping.time_at(1.5 + 200.0 / 1.5), 0.5);
  EXPECT_DOUBLE_EQ(looping.time_at(-1.0), 0.75);
  const Playback backwards{column(), -1.0, 0.0, true};
  EXPECT_DOUBLE_EQ(backwards.time_at(0.5), 1.5);
  const Playback once{column(), 1.0, -1.0, false};
  EXPECT_EQ(once.time_at(0.5), 0.0);
  EXPECT_EQ(once.time_at(1.25), 0.25);
  EXPECT_EQ(once.time_at(100.0), 2.0);
}

TEST_F(AnimatedScene, EvaluatesShapesOfEachObject) {
  const auto model = column();
  test::SceneBuilder builder;
  for (const double start : {0.0, 0.5}) {
    const int object = builder.add(model->at(start).value(), test::at(start, 0.0, 0.0));
    builder.scene().objects[static_cast<std::size_t>(object)].playback = {model, 1.0, start, true};
  }
  builder.add(test::finished(test::ShapeBuilder().build(), glm::vec4(1.0F)), {});
  const auto scene = builder.build();
  const SceneState state = evaluate_scene(*scene, 0.25);
  EXPECT_THAT(state.poses, ElementsAre(0.25, 0.75, 0.0));
  EXPECT_EQ(shape_of(*scene, state, 0)->meshes[0].positions,
            model->at(0.25).value()->meshes[0].positions);
  EXPECT_EQ(shape_of(*scene, state, 1)->meshes[0].positions,
            model->at(0.75).value()->meshes[0].positions);
  EXPECT_EQ(shape_of(*scene, state, 2), scene->objects[2].model);
  // Heights are those of a box about all shapes.
  float top = 0.0F;
  for (int i = 0; i <= 100; ++i) top = std::max(top, model->at(0.02 * i).value()->max_corner.z);
  const std::vector<double> heights =
      vertex_heights(*scene, Eigen::Vector3d::UnitZ(), Eigen::Vector3d::Zero());
  EXPECT_GT(top, 0.081F);
  EXPECT_NEAR(heights[0], static_cast<double>(top), 2e-4);
}

// --- scene files ---

TEST_F(AnimatedScene, ReadsKeysOfObject) {
  const auto scene = scene_of({{"name", "a"},
                               {"model", "column.glb"},
                               {"animation", "Rise"},
                               {"speed", 0.5},
                               {"loop", false},
                               {"start", 1.5}});
  ASSERT_TRUE(scene) << scene.error().message;
  const Playback& playback = scene->objects[0].playback;
  ASSERT_NE(playback.model, nullptr);
  EXPECT_EQ(playback.model->end_s(), 4.0);
  EXPECT_EQ(playback.speed, 0.5);
  EXPECT_FALSE(playback.loop);
  EXPECT_EQ(playback.start_s, 1.5);
  EXPECT_NEAR(scene->objects[0].model->min_corner.z, 0.05F * 1.5F / 4.0F, 1e-6F);
  EXPECT_THAT(scene->warnings, testing::IsEmpty());
  for (const nlohmann::json& animation : {nlohmann::json("all"), nlohmann::json(1)}) {
    const auto other = scene_of({{"name", "a"}, {"model", "column.glb"}, {"animation", animation}});
    ASSERT_TRUE(other) << other.error().message;
    EXPECT_EQ(other->objects[0].playback.model->end_s(), 4.0);
  }
}

TEST_F(AnimatedScene, CombinesAnimationOfModelWithKeyframes) {
  const auto scene =
      scene_of({{"name", "a"},
                {"model", "column.glb"},
                {"animation",
                 {{"model", "Bend"},
                  {"loop", false},
                  {"keyframes", {{{"time_s", 0}}, {{"time_s", 8}, {"position", {0.8, 0, 0}}}}}}}});
  ASSERT_TRUE(scene) << scene.error().message;
  const SceneState state = evaluate_scene(*scene, 5.0);
  EXPECT_DOUBLE_EQ(state.objects[0].position.x(), 0.5);
  EXPECT_DOUBLE_EQ(state.poses.at(0), 1.0);
}

TEST_F(AnimatedScene, IsWrittenWithItsAnimationAfterAMove) {
  const nlohmann::json keyframes = {{{"time_s", 0}}, {{"time_s", 8}, {"position", {0.8, 0, 0}}}};
  for (const nlohmann::json& animation :
       {nlohmann::json("Rise"), nlohmann::json(1),
        nlohmann::json{{"model", "Rise"}, {"keyframes", keyframes}, {"loop", false}}}) {
    const auto start = scene_of(
        {{"name", "a"}, {"model", "column.glb"}, {"animation", animation}, {"speed", 2.0}});
    ASSERT_TRUE(start) << start.error().message;
    Scene moved = *start;
    moved.objects[0].placement.position = {0.1, 0.2, 0.0};
    moved.objects[0].animation = Animation();
    const auto text = scene_text({moved, *start, {}, std::nullopt}, folder_.path());
    ASSERT_TRUE(text) << text.error().message;
    write("written.json", *text);
    const auto read = load_scene(folder_.path() / "written.json");
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_EQ(read->objects[0].placement.position, moved.objects[0].placement.position);
    EXPECT_TRUE(read->objects[0].animation.keyframes.empty());
    ASSERT_TRUE(read->objects[0].playback.model) << *text;
    EXPECT_EQ(read->objects[0].playback.model->end_s(), 4.0);
    EXPECT_EQ(read->objects[0].playback.speed, 2.0);
  }
}

TEST_F(AnimatedScene, ReportsWrongKeys) {
  const nlohmann::json good = {{"name", "a"}, {"model", "column.glb"}, {"animation", "Bend"}};
  const auto with = [&good](const std::string& key, const nlohmann::json& value) {
    nlohmann::json object = good;
    object[key] = value;
    return object;
  };
  EXPECT_THAT(error_of(with("animation", "Run")), HasSubstr("scene.json: /objects/0/animation: "));
  EXPECT_THAT(
      error_of(with("animation", "Run")),
      HasSubstr("column.glb: has no animation \"Run\"; give one of 0 \"Bend\", 1 \"Rise\""));
  EXPECT_THAT(error_of(with("animation", "")), HasSubstr("/objects/0/animation: is \"\"; give"));
  EXPECT_THAT(error_of(with("animation", -1)), HasSubstr("/objects/0/animation: is -1; give"));
  EXPECT_THAT(error_of(with("animation", 0.5)), HasSubstr("/objects/0/animation: is 0.5; give"));
  EXPECT_THAT(error_of(with("animation", true)), HasSubstr("/objects/0/animation: is true; give"));
  EXPECT_THAT(error_of(with("animation", {{"model", 9}})),
              HasSubstr("/objects/0/animation/model: "));
  EXPECT_THAT(error_of(with("speed", "fast")), HasSubstr("/objects/0/speed: is \"fast\"; give"));
  EXPECT_THAT(error_of(with("start", 1e9)), HasSubstr("/objects/0/start: is"));
  EXPECT_THAT(error_of(with("loop", 1)), HasSubstr("/objects/0/loop: is 1; give true or false"));
  EXPECT_THAT(error_of(with("proxy", "column.glb")),
              HasSubstr("/objects/0/proxy: does not follow the animation"));
  nlohmann::json rigid = with("speed", 2);
  rigid.erase("animation");
  EXPECT_THAT(error_of(rigid), HasSubstr("/objects/0/speed: is for an animation of the model"));
  EXPECT_THAT(
      error_of(
          {{"name", "a"}, {"shape", {{"kind", "sphere"}, {"radius", 0.1}}}, {"animation", "Bend"}}),
      HasSubstr("/objects/0/animation: is for animations of a model; a shape has none"));
  write("scene.json", R"({"objects": [], "lights": [{"name": "lamp", "kind": "point",
                          "position": [0, 0, 1], "animation": "Bend"}]})");
  const auto light = load_scene(folder_.path() / "scene.json");
  ASSERT_FALSE(light);
  EXPECT_THAT(light.error().message, HasSubstr("/lights/0/animation: names an animation"));
}

// --- drawing ---

constexpr int kSide = 240;

PoseEstimate oblique() {
  return test::tracked(test::look_at({0.12, -0.35, 0.3}, {0.0, 0.0, 0.02}));
}

std::shared_ptr<const Model> box(double width, double height) {
  test::ShapeBuilder shape;
  shape.box(-width, -width, 0.0, width, width, height);
  return test::finished(shape.build(), glm::vec4(0.7F, 0.7F, 0.6F, 1.0F));
}

// Two columns in different phases, a box and a phantom that receive shadows.
class AnimatedDrawing : public AnimatedScene {
 protected:
  [[nodiscard]] std::shared_ptr<const Scene> animated_scene(ShadowTechnique technique) {
    test::SceneBuilder builder;
    add_columns(builder);
    finish(builder, technique);
    return builder.build();
  }
  // Returns the same scene at a time, with rigid models.
  [[nodiscard]] std::shared_ptr<const Scene> rigid_scene(ShadowTechnique technique, double time_s) {
    test::SceneBuilder builder;
    add_columns(builder);
    for (SceneObject& object : builder.scene().objects) {
      object.model = model_->at(object.playback.time_at(time_s)).value();
      object.playback = {};
    }
    finish(builder, technique);
    return builder.build();
  }

 private:
  void add_columns(test::SceneBuilder& builder) {
    for (const double start : {0.0, 0.7}) {
      const int index =
          builder.add(model_->at(start).value(), test::at(-0.05 + 0.15 * start, 0.0, 0.02));
      builder.scene().objects[static_cast<std::size_t>(index)].playback = {model_, 1.0, start,
                                                                           true};
    }
  }
  static void finish(test::SceneBuilder& builder, ShadowTechnique technique) {
    builder.add(box(0.02, 0.01), test::at(-0.02, 0.02, 0.0), false);
    builder.add(box(0.02, 0.015), test::at(0.09, -0.01, 0.0), false, true);
    Scene& scene = builder.scene();
    scene.shadows[0].technique = technique;
    scene.shadows[0].layered = make_layered_constants(0.5, 2.5, 0.0).value();
    scene.shadows[0].light_rays = true;
    SceneLight& light = scene.lights.emplace_back();
    light.name = "lamp";
    light.position = {-0.3, -0.2, 0.6};
    if (technique == ShadowTechnique::walls) add_default_walls(scene, scene.shadows[0]);
  }

  std::shared_ptr<const AnimatedModel> model_ = column();
};

class AnimatedShadows : public AnimatedDrawing,
                        public testing::WithParamInterface<ShadowTechnique> {};

TEST_P(AnimatedShadows, EqualThoseOfRigidModelOfSameShape) {
  const CameraModel camera = test::camera_of(kSide, kSide, 280.0);
  const Frame white = test::plain_frame(kSide, kSide, 235);
  test::Studio animated(animated_scene(GetParam()), camera);
  // Carried kernels differ from those of a rigid model.
  const bool is_carried = GetParam() == ShadowTechnique::layered;
  std::optional<test::RenderedImage> before;
  double time_before = -1.0;
  for (const double time : {0.0, 0.4, 0.4, 1.3, 2.4, 0.0}) {
    const auto image = animated.draw(white, animated.plan(oblique(), {}, time));
    if (time == time_before) {
      EXPECT_EQ(image, before);
      EXPECT_EQ(animated.stats()[Counter::triples_recomputed], 0) << "nothing has changed";
    }
    test::Studio rigid(rigid_scene(GetParam(), time), camera);
    const auto of_rigid = rigid.draw(white, rigid.plan(oblique()));
    if (!is_carried) {
      EXPECT_EQ(image.rgba, of_rigid.rgba) << time << " s";
    }
    // No image depends on earlier ones.
    test::Studio fresh(animated_scene(GetParam()), camera);
    EXPECT_EQ(image.rgba, fresh.draw(white, fresh.plan(oblique(), {}, time)).rgba) << time << " s";
    if (time == 1.3) {
      EXPECT_NE(image.rgba, before->rgba);
    }
    before = image;
    time_before = time;
  }
}

TEST_P(AnimatedShadows, DrawNothingWhileShapeIsHidden) {
  GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}, {"translation", {0, 0.05, 0}}});
  test::animate(file, 0, "scale", {0, 1}, std::vector<float>{0, 0, 0, 1, 1, 1},
                {.interpolation = "STEP"});
  write("square.glb", file.glb());
  const CameraModel camera = test::camera_of(kSide, kSide, 280.0);
  const Frame white = test::plain_frame(kSide, kSide, 235);
  const auto model = AnimatedModel::load(folder_.path() / "square.glb", "0").value();
  test::SceneBuilder builder;
  builder.add(box(0.02, 0.01), test::at(0.02, 0.02, 0.0), false);
  builder.scene().shadows[0].technique = GetParam();
  builder.scene().lights.emplace_back().position = {-0.3, -0.2, 0.6};
  test::Studio without(builder.build(), camera);
  builder.add(model->at(0.0).value(), {});
  builder.scene().objects[1].playback = {model, 1.0, 0.0, false};
  test::Studio appearing(builder.build(), camera);
  const auto hidden = without.draw(white, without.plan(oblique()));
  const auto at_time = [&](double time_s) {
    return appearing.draw(white, appearing.plan(oblique(), {}, time_s));
  };
  EXPECT_EQ(at_time(0.0), hidden);
  EXPECT_EQ(at_time(0.5), hidden);
  const auto shown = at_time(1.0);
  EXPECT_NE(shown, hidden);
  EXPECT_EQ(at_time(0.5), hidden);
  EXPECT_EQ(at_time(1.5), shown);
}

INSTANTIATE_TEST_SUITE_P(Techniques, AnimatedShadows,
                         testing::ValuesIn(test::techniques_without({ShadowTechnique::walls})),
                         [](const auto& test) { return std::string(to_string(test.param)); });

TEST_F(AnimatedDrawing, FollowsLensAndShape) {
  const CameraModel camera = test::distorted_camera(kSide, 280.0);
  const Frame white = test::plain_frame(kSide, kSide, 235);
  test::Studio animated(animated_scene(ShadowTechnique::field), camera);
  for (const double time : {0.0, 0.9}) {
    const auto image = animated.draw(white, animated.plan(oblique(), {}, time));
    test::Studio rigid(rigid_scene(ShadowTechnique::field, time), camera);
    EXPECT_EQ(image.rgba, rigid.draw(white, rigid.plan(oblique())).rgba) << time << " s";
  }
}

TEST_F(AnimatedDrawing, PlansWithBoundsOfCurrentShape) {
  const auto scene = animated_scene(ShadowTechnique::layered);
  const CameraModel camera = test::camera_of(kSide, kSide, 280.0);
  const auto plan_at = [&](double time) {
    return plan_frame(*scene, evaluate_scene(*scene, time), oblique(), camera);
  };
  const FramePlan start = plan_at(0.0), later = plan_at(1.0);
  ASSERT_EQ(start.posed.size(), 2U);
  EXPECT_EQ(start.posed[1].object, 1);
  EXPECT_EQ(later.posed[0].model->min_corner,
            scene->objects[0].playback.model->at(1.0).value()->min_corner);
  ASSERT_FALSE(later.shadows.empty());
  EXPECT_EQ(later.shadows[0].technique, ShadowTechnique::field);
  EXPECT_EQ(later.shadows[0].pose_s, 1.0);
  EXPECT_GT((start.shadows[0].centre - later.shadows[0].centre).norm(), 0.005);
}

// --- layered shadows ---

class AnimatedLayers : public AnimatedScene {
 protected:
  // A scene of one object that plays an animation.
  [[nodiscard]] static test::SceneBuilder scene_with(const models::MovingModel& moving,
                                                     ShadowTechnique technique,
                                                     const Placement& placement = {}) {
    const auto model = test::loaded(moving);
    test::SceneBuilder builder;
    builder.add(model->at(0.0).value(), placement);
    Scene& scene = builder.scene();
    scene.objects[0].playback = {model, 1.0, 0.0, true};
    scene.shadows[0].technique = technique;
    scene.shadows[0].layered = make_layered_constants(0.9, 3.0, 0.0).value();
    return builder;
  }
  struct Drawn {
    test::RenderedImage image;
    CompositeStats stats;
    [[nodiscard]] bool is_field() const {
      return std::ranges::count(stats.skipped, SkipReason::kernels_not_carried,
                                &SkippedPass::reason) == 1;
    }
  };
  [[nodiscard]] static Drawn draw(test::SceneBuilder builder, double time_s) {
    test::Studio studio(builder.build(), test::camera_of(kSide, kSide, 280.0));
    const auto image =
        studio.draw(test::plain_frame(kSide, kSide, 235), studio.plan(oblique(), {}, time_s));
    return {image, studio.stats()};
  }
};

TEST_F(AnimatedLayers, UseCarriedKernelsThatSuitTheObject) {
  const auto figure = models::make_figure();
  const Drawn layered = draw(scene_with(figure, ShadowTechnique::layered), 0.33);
  EXPECT_FALSE(layered.is_field());
  EXPECT_EQ(layered.stats[Counter::kernels_carried], 1);
  EXPECT_NE(layered.image.rgba, draw(scene_with(figure, ShadowTechnique::field), 0.33).image.rgba);
}

// At a key of the kernels, carried kernels are those of the shape.
TEST_F(AnimatedLayers, EqualThoseOfRigidModelAtKeyOfKernels) {
  const auto figure = models::make_figure();
  const Drawn layered = draw(scene_with(figure, ShadowTechnique::layered), 0.0);
  test::SceneBuilder rigid = scene_with(figure, ShadowTechnique::layered);
  rigid.scene().objects[0].playback = {};
  EXPECT_EQ(layered.image.rgba, draw(rigid, 0.0).image.rgba);
}

TEST_F(AnimatedLayers, FollowLightOfOneSize) {
  test::SceneBuilder builder = scene_with(models::make_figure(), ShadowTechnique::layered);
  const Drawn proportional = draw(builder, 0.33);
  builder.scene().shadows[0].light_mode = LightMode::fixed;
  const Drawn fixed = draw(builder, 0.33);
  EXPECT_FALSE(fixed.is_field());
  EXPECT_NE(fixed.image.rgba, proportional.image.rgba);
}

TEST_F(AnimatedLayers, AreFieldsWhereKernelsDoNotSuit) {
  const auto is_field = [](const test::SceneBuilder& builder) {
    const Drawn layered = draw(builder, 0.33);
    test::SceneBuilder field = builder;
    field.scene().shadows[0].technique = ShadowTechnique::field;
    EXPECT_EQ(layered.image.rgba, draw(field, 0.33).image.rgba);
    EXPECT_EQ(layered.stats[Counter::kernels_carried], 0);
    EXPECT_EQ(layered.stats[Counter::passes_skipped], 1);
    return layered.is_field();
  };
  EXPECT_TRUE(is_field(scene_with(models::make_blob(2.0), ShadowTechnique::layered)));
  // A changing tilt would need new kernels and a new comparison.
  test::SceneBuilder tilting = scene_with(models::make_figure(), ShadowTechnique::layered);
  tilting.scene().objects[0].animation.spin_axis = Eigen::Vector3d::UnitX();
  tilting.scene().objects[0].animation.spin_turns_per_s = 0.2;
  EXPECT_TRUE(is_field(tilting));
  // Only one of many keyframes is tilted.
  test::SceneBuilder nodding = scene_with(models::make_figure(), ShadowTechnique::layered);
  for (int i = 0; i < 100; ++i) {
    const double tilt = i == 57 ? 0.4 : 0.0;
    nodding.scene().objects[0].animation.keyframes.push_back(
        {0.1 * i, test::at(0.0, 0.0, 0.1, {1, 0, 0}, tilt)});
  }
  EXPECT_TRUE(is_field(nodding));
  // COCL is far from the shadow of a figure.
  test::SceneBuilder cocl = scene_with(models::make_figure(), ShadowTechnique::layered);
  cocl.scene().shadows[0].kernels = KernelSource::centroid;
  EXPECT_TRUE(is_field(cocl));
}

TEST_F(AnimatedLayers, TurnWithTheirObject) {
  test::SceneBuilder builder = scene_with(models::make_figure(), ShadowTechnique::layered);
  builder.scene().objects[0].animation.spin_turns_per_s = 0.2;  // about z, which keeps the tilt
  EXPECT_FALSE(draw(builder, 0.33).is_field());
}

// A spline overshoots its keys and moves a vertex beyond the limit between the sampled times.
TEST_F(AnimatedScene, ReportsTimesWithoutShape) {
  GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  const float far = 1e20F;
  // In-tangent, value and out-tangent of each key. Short segments lie between samples.
  test::animate(file, 0, "translation", {0, 0.01F, 0.02F, 1},
                std::vector<float>{0,    0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, far, 0, 0,
                                   -far, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,   0, 0},
                {.interpolation = "CUBICSPLINE"});
  write("spline.glb", file.glb());
  const auto scene = scene_of({{"name", "leaper"}, {"model", "spline.glb"}, {"animation", 0}});
  ASSERT_TRUE(scene) << scene.error().message;
  const CameraModel camera = test::camera_of(240, 240, 280.0);
  const PoseEstimate pose = test::tracked(test::look_at({0.12, -0.35, 0.3}, {0.0, 0.0, 0.02}));
  const auto plan_at = [&](double time_s) {
    return plan_frame(*scene, evaluate_scene(*scene, time_s), pose, camera);
  };
  EXPECT_EQ(
      std::ranges::count(plan_at(0.0).skipped, SkipReason::shape_missing, &SkippedPass::reason), 0);
  const FramePlan plan = plan_at(0.015);
  ASSERT_EQ(std::ranges::count(plan.skipped, SkipReason::shape_missing, &SkippedPass::reason), 1);
  EXPECT_EQ(plan.posed.at(0).model, scene->objects[0].model);
  EXPECT_THAT(text_of({SkipReason::shape_missing, 0}, *scene),
              HasSubstr("leaper: its animation moves a vertex too far away"));
}

}  // namespace
}  // namespace penumbra
