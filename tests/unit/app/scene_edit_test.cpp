#include "app/session/scene_edit.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "render/scene/shapes.hpp"
#include "support/recording_folder.hpp"
#include "support/scene_events.hpp"
#include "support/studio.hpp"
#include "support/utf16.hpp"

namespace penumbra {
namespace {

using test::SceneBuilder;

ObjectPlaced placed_somewhere() {
  ObjectPlaced placed;
  placed.object = "object1";
  // These numbers have no short decimal form.
  placed.placement.position = {std::sqrt(0.02), -1.0 / 3.0, 0.1 + 0.2};
  placed.placement.rotation =
      Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()));
  placed.placement.scale = std::exp(0.1);
  return placed;
}

TEST(SceneEdit, EndsAnimationOfPlacedObject) {
  SceneBuilder builder;
  builder.add(nullptr, test::at(0, 0, 0));
  Scene scene = builder.scene();
  scene.objects[0].animation.spin_turns_per_s = 1.0;
  scene.objects[0].animation.keyframes = {{0.0, test::at(1, 0, 0)}, {1.0, test::at(2, 0, 0)}};
  const ObjectPlaced placed = placed_somewhere();
  ASSERT_TRUE(apply(scene, placed));
  for (const double time : {0.0, 0.3, 7.0}) {
    const Placement at = evaluate_scene(scene, time).objects[0];
    EXPECT_EQ(at.position, placed.placement.position);
    EXPECT_TRUE(at.rotation.coeffs().isApprox(placed.placement.rotation.coeffs(), 1e-15));
  }
}

TEST(SceneEdit, IgnoresUnknownTargetsAndInvalidValues) {
  SceneBuilder builder;
  builder.add(nullptr, test::at(1, 2, 3));
  Scene scene = builder.scene();
  ObjectPlaced placed = placed_somewhere();
  placed.object = "unknown";
  EXPECT_FALSE(apply(scene, placed));
  placed = placed_somewhere();
  placed.placement.position.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(apply(scene, placed));
  placed = placed_somewhere();
  placed.placement.rotation.coeffs() *= 2.0;
  EXPECT_FALSE(apply(scene, placed));
  ShadowStyled styled{"shadow", scene.shadows[0]};
  styled.style.fractions.umbra = 1.5;
  EXPECT_FALSE(apply(scene, styled));
  styled.style.fractions.umbra = 0.5;
  styled.node = "unknown";
  EXPECT_FALSE(apply(scene, styled));
  EXPECT_EQ(scene.objects[0].placement.position, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(scene.shadows[0].fractions.umbra, LightFractions().umbra);
}

TEST(SceneEdit, RoundTripsMoveExactly) {
  ObjectPlaced placed = placed_somewhere();
  for (const bool turned : {false, true}) {
    placed.turned = turned;
    const std::string line = event_line({1311868164363181123, placed});
    EXPECT_THAT(line, testing::HasSubstr(turned ? "\"object_rotated\"" : "\"object_moved\""));
    const auto events = test::events_of(line);
    ASSERT_TRUE(events) << events.error().message;
    ASSERT_EQ(events->edits.size(), 1U);
    EXPECT_EQ(events->edits[0].timestamp_ns, 1311868164363181123);
    const auto& read = std::get<ObjectPlaced>(events->edits[0].edit);
    EXPECT_EQ(read.object, placed.object);
    EXPECT_EQ(read.turned, turned);
    EXPECT_EQ(read.placement.position, placed.placement.position);
    EXPECT_EQ(read.placement.rotation.coeffs(), placed.placement.rotation.coeffs());
    EXPECT_EQ(read.placement.scale, placed.placement.scale);
  }
}

TEST(SceneEdit, RoundTripsAddedRemovedAndResetObjects) {
  const ObjectPlaced placed = placed_somewhere();
  ObjectAdded added{"my \"toy\"", "/models/toy.glb", placed.placement, nullptr};
  EXPECT_THAT(event_line({1, added}), testing::AllOf(testing::Not(testing::HasSubstr("animation")),
                                                     testing::Not(testing::HasSubstr("\"up\""))));
  added.playback.animation = "a \"walk\"";
  added.up = UpAxis::y;
  const auto events = test::events_of(event_line({12'345'678'901, added}));
  ASSERT_TRUE(events) << events.error().message;
  ASSERT_EQ(events->edits.size(), 1U);
  EXPECT_TRUE(adds_objects(*events));
  const auto& read = std::get<ObjectAdded>(events->edits[0].edit);
  EXPECT_EQ(read.object, added.object);
  EXPECT_EQ(read.model_file, added.model_file);
  EXPECT_EQ(read.placement, added.placement);
  EXPECT_EQ(read.playback.animation, added.playback.animation);
  EXPECT_EQ(read.up, UpAxis::y);
  EXPECT_EQ(read.model, nullptr);
  for (const bool removed : {true, false}) {
    const auto visibility = test::events_of(event_line({1, ObjectRemoved{"toy", removed}}));
    ASSERT_TRUE(visibility && visibility->edits.size() == 1U);
    EXPECT_EQ(std::get<ObjectRemoved>(visibility->edits[0].edit).object, "toy");
    EXPECT_EQ(std::get<ObjectRemoved>(visibility->edits[0].edit).removed, removed);
  }
  const auto reset = test::events_of(event_line({1, ObjectReset{"toy"}}));
  ASSERT_TRUE(reset && reset->edits.size() == 1U);
  EXPECT_EQ(std::get<ObjectReset>(reset->edits[0].edit).object, "toy");
  EXPECT_FALSE(adds_objects(*reset));
}

TEST(SceneEdit, RemovesOnlyAddedObjects) {
  Scene scene = *test::SceneBuilder().build();
  SceneObject own;
  own.name = "own";
  scene.objects.push_back(own);
  Scene start = scene;
  EXPECT_FALSE(apply(scene, ObjectRemoved{"own", true}, &start));
  EXPECT_FALSE(apply(scene, ObjectAdded{"toy", "toy.glb", {}, nullptr}, &start)) << "not loaded";
  const auto model = std::make_shared<const Model>(make_box({0.1F, 0.1F, 0.1F}));
  ASSERT_TRUE(apply(scene, ObjectAdded{"toy", "toy.glb", {}, model}, &start));
  EXPECT_EQ(start.objects.size(), 2U);
  EXPECT_EQ(scene.shadows[0].casters, start.shadows[0].casters);
  EXPECT_TRUE(apply(scene, ObjectRemoved{"toy", true}, &start));
  EXPECT_EQ(evaluate_scene(scene, 0.0).opacities, (std::vector<double>{1.0, 0.0}));
  EXPECT_TRUE(apply(scene, ObjectRemoved{"toy", false}, &start));
  EXPECT_EQ(evaluate_scene(scene, 0.0).opacities, (std::vector<double>{1.0, 1.0}));
  EXPECT_FALSE(apply(scene, ObjectReset{"unknown"}, &start));
}

TEST(SceneEdit, RoundTripsView) {
  for (const bool shown : {false, true}) {
    const ViewChanged view{Translucency::mesh, shown, !shown};
    const auto events = test::events_of(event_line({5, view}));
    ASSERT_TRUE(events && events->edits.size() == 1U);
    const auto& read = std::get<ViewChanged>(events->edits[0].edit);
    EXPECT_EQ(read.translucency, Translucency::mesh);
    EXPECT_EQ(read.walls, shown);
    EXPECT_EQ(read.smooth, !shown);
  }
  for (const char* damaged :
       {R"("translucency":"glass","walls":true,"smooth":true)", R"("translucency":"mesh")",
        R"("translucency":"mesh","walls":1,"smooth":true)"}) {
    EXPECT_FALSE(test::events_of(R"({"timestamp_s":1.5,"event":"view_changed",)" +
                                 std::string(damaged) + "}"))
        << damaged;
  }
}

TEST(SceneEdit, RoundTripsStyleIncludingZenithLight) {
  ShadowStyled styled{"a \"node\"", {}};
  styled.style.technique = ShadowTechnique::field;
  styled.style.kernels = KernelSource::per_axis;
  styled.style.layered.light_height = styled.style.layered.light_ratio =
      std::numeric_limits<double>::infinity();
  styled.style.layered.umbra_height = 1.0 / 3.0;
  styled.style.fractions = {0.1, 0.3, 0.7};
  const auto events = test::events_of(event_line({5, styled}));
  ASSERT_TRUE(events && events->edits.size() == 1);
  const auto& read = std::get<ShadowStyled>(events->edits[0].edit);
  EXPECT_EQ(read.node, styled.node);
  EXPECT_EQ(read.style.technique, styled.style.technique);
  EXPECT_EQ(read.style.kernels, styled.style.kernels);
  EXPECT_EQ(read.style.layered.light_height, styled.style.layered.light_height);
  EXPECT_EQ(read.style.layered.umbra_height, styled.style.layered.umbra_height);
  EXPECT_EQ(read.style.fractions.middle, 0.3);
  EXPECT_FALSE(read.style.light_rays) << "default for events of older versions without the key";
  styled.style.light_rays = true;
  const auto with_rays = test::events_of(event_line({5, styled}));
  ASSERT_TRUE(with_rays && with_rays->edits.size() == 1);
  EXPECT_TRUE(std::get<ShadowStyled>(with_rays->edits[0].edit).style.light_rays);
}

TEST(SceneEdit, IgnoresEventsWithoutEditAndRejectsDamagedEdits) {
  const auto other = test::events_of(R"({"timestamp_s":1.5,"event":"start"})");
  ASSERT_TRUE(other);
  EXPECT_TRUE(other->edits.empty());
  for (
      const char* bad :
      {"[]", "nonsense", R"({"timestamp_s":1,"event":"object_moved"})",
       R"({"event":"object_moved","object":"a","position":[0,0,0],"quaternion_xyzw":[0,0,0,1],"scale":1})",
       R"({"timestamp_s":1,"event":"object_moved","object":"a","position":[0,0],"quaternion_xyzw":[0,0,0,1],"scale":1})",
       R"({"timestamp_s":1,"event":"object_moved","object":"a","position":[0,0,0],"quaternion_xyzw":[0,0,0,9],"scale":1})",
       R"({"timestamp_s":1,"event":"object_moved","object":"a","position":[0,0,"x"],"quaternion_xyzw":[0,0,0,1],"scale":1})",
       R"({"timestamp_s":1,"event":"object_moved","object":"a","position":[0,0,1e300],"quaternion_xyzw":[0,0,0,1],"scale":1})",
       R"({"timestamp_s":1,"event":"shadow_changed","node":"a","technique":"magic"})"}) {
    EXPECT_FALSE(test::events_of(bad)) << bad;
  }
}

TEST(SceneEdit, ReadsFileTruncatedInLastLine) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "events.jsonl";
  EXPECT_TRUE(load_scene_events(file)->edits.empty()) << "a missing file has no edits";
  const std::string late = event_line({2'000'000'000, placed_somewhere()}) + "\n";
  const std::string early = event_line({1'000'000'000, placed_somewhere()}) + "\n";
  const std::string start = "{\"timestamp_s\":0.500000001,\"event\":\"scene_start\"}\n";
  test::write_text(file, start + late + early + late.substr(0, 40));
  const auto events = load_scene_events(file);
  ASSERT_TRUE(events) << events.error().message;
  ASSERT_EQ(events->edits.size(), 2U);
  EXPECT_EQ(events->edits[0].timestamp_ns, 1'000'000'000) << "edits must be sorted by time";
  EXPECT_EQ(events->scene_start_ns, 500'000'001);
  test::write_text(file, late.substr(0, 40) + "\n" + early);
  const auto damaged = load_scene_events(file);
  ASSERT_FALSE(damaged);
  EXPECT_THAT(damaged.error().message, testing::HasSubstr("line 1"));
}

TEST(SceneEdit, AcceptsByteOrderMark) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "events.jsonl";
  const std::string start = "{\"timestamp_s\":0.5,\"event\":\"scene_start\"}\n";
  test::write_text(file,
                   "\xEF\xBB\xBF" + start + event_line({1'000'000'000, placed_somewhere()}) + "\n");
  const auto events = load_scene_events(file);
  ASSERT_TRUE(events) << events.error().message;
  EXPECT_EQ(events->scene_start_ns, 500'000'000);
  ASSERT_EQ(events->edits.size(), 1U);
  for (const std::string& text : {test::as_utf16(start, true), test::as_utf16(start, false)}) {
    test::write_text(file, text);
    const auto wide = load_scene_events(file);
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().message, file.string() + ": is UTF-16 text; save it as UTF-8");
  }
}

TEST(SceneEdit, RoundTripsVideoLightExactly) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "events.jsonl";
  const VideoLight first = {{1.0 / 3.0, 0.1, 2.5}, {1e-3, 0.7, 1.0 / 7.0}};
  const VideoLight second = {{0.9, 0.8, 0.7}, {0.4, 0.3, 0.2}};
  const std::string good =
      light_line({2'000'000'003, second}) + "\n" + light_line({1'000'000'001, first}) + "\n";
  test::write_text(file, good + light_line({3'000'000'000, first}).substr(0, 60));
  const auto events = load_scene_events(file);
  ASSERT_TRUE(events) << events.error().message;
  EXPECT_TRUE(events->edits.empty());
  ASSERT_EQ(events->lights.size(), 2U) << "the truncated line is skipped";
  const auto has_light = [&](std::int64_t timestamp_ns, const VideoLight& light) {
    const VideoLight* at = light_at(events->lights, timestamp_ns);
    return at != nullptr && at->on_table == light.on_table && at->around == light.around;
  };
  EXPECT_TRUE(has_light(0, first)) << "before the first drawn frame";
  EXPECT_TRUE(has_light(1'000'000'001, first));
  EXPECT_TRUE(has_light(2'000'000'002, first)) << "the frame of the edit was not drawn";
  EXPECT_TRUE(has_light(2'000'000'003, second));
  EXPECT_TRUE(has_light(9'000'000'000, second));
  EXPECT_EQ(light_at({}, 0), nullptr);
  for (const char* bad :
       {R"({"timestamp_s":1,"event":"video_light"})",
        R"({"event":"video_light","on_table":[1,1,1],"around":[1,1,1]})",
        R"({"timestamp_s":1,"event":"video_light","on_table":[1,1,0],"around":[1,1,1]})",
        R"({"timestamp_s":1,"event":"video_light","on_table":[1,1,1],"around":[1,1]})",
        R"({"timestamp_s":1,"event":"video_light","on_table":[1,1,1e9],"around":[1,1,1]})"}) {
    test::write_text(file, std::string(bad) + "\n" + good);
    const auto damaged = load_scene_events(file);
    ASSERT_FALSE(damaged) << bad;
    EXPECT_THAT(damaged.error().message, testing::HasSubstr("line 1: video_light"));
  }
}

}  // namespace
}  // namespace penumbra
