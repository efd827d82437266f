// Scenes that are written and read back.
#include "render/scene/scene_writer.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>

#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

// Returns the scene that the written text reads to. `folder`: where the text is saved.
Scene written_and_read(const Scene& now, const Scene& start, const fs::path& folder,
                       const ShadowStyle* style = nullptr) {
  SceneToWrite scene{now, start, {}, std::nullopt};
  if (style != nullptr) scene.style_of = [style](const ShadowNode&) { return *style; };
  const auto text = scene_text(scene, folder);
  EXPECT_TRUE(text) << text.error().message;
  fs::create_directories(folder);
  std::ofstream(folder / "written.json") << *text;
  auto read = load_scene(folder / "written.json");
  EXPECT_TRUE(read) << read.error().message;
  return *read;
}

void expect_same_style(const ShadowStyle& a, const ShadowStyle& b) {
  EXPECT_EQ(a.technique, b.technique);
  EXPECT_EQ(a.kernels, b.kernels);
  EXPECT_EQ(a.layered.light_height, b.layered.light_height);
  EXPECT_EQ(a.layered.light_ratio, b.layered.light_ratio);
  EXPECT_EQ(a.layered.umbra_height, b.layered.umbra_height);
  EXPECT_EQ(a.fractions, b.fractions);
  EXPECT_EQ(a.light_rays, b.light_rays);
}

std::vector<std::string> names(const Scene& scene, const std::vector<int>& objects) {
  std::vector<std::string> result;
  for (const int object : objects)
    result.push_back(scene.objects[static_cast<std::size_t>(object)].name);
  return result;
}

void expect_same_arrangement(const Scene& now, const Scene& read) {
  for (const SceneObject& object : now.objects) {
    const auto same = std::ranges::find(read.objects, object.name, &SceneObject::name);
    if (object.removed) {
      EXPECT_EQ(same, read.objects.end()) << object.name;
      continue;
    }
    ASSERT_NE(same, read.objects.end()) << object.name;
    EXPECT_EQ(same->placement.position, object.placement.position) << object.name;
    EXPECT_LT(same->placement.rotation.angularDistance(object.placement.rotation), 1e-14);
    EXPECT_EQ(same->placement.scale, object.placement.scale);
    EXPECT_EQ(same->animation.keyframes.size(), object.animation.keyframes.size());
    EXPECT_EQ(same->tag_group, object.tag_group);
    EXPECT_EQ(same->phantom, object.phantom);
    if (object.model_file.empty()) continue;
    EXPECT_TRUE(fs::equivalent(same->model_file, object.model_file));
  }
  ASSERT_EQ(read.shadows.size(), now.shadows.size());
  for (std::size_t i = 0; i < now.shadows.size(); ++i) {
    expect_same_style(now.shadows[i], read.shadows[i]);
    std::vector<int> casters = now.shadows[i].casters;
    std::erase_if(casters, [&now](int caster) {
      return now.objects[static_cast<std::size_t>(caster)].removed;
    });
    EXPECT_THAT(names(read, read.shadows[i].casters),
                testing::UnorderedElementsAreArray(names(now, casters)));
  }
}

SceneObject toy(const char* name) {
  SceneObject object;
  object.name = name;
  object.model_file = (test::source_dir() / "scenes/models/helicopter.glb").string();
  object.model = std::make_shared<const Model>(load_model(object.model_file).value());
  object.placement.position = {0.123456789012345, -0.2, 1.0 / 3.0};
  object.placement.scale = 0.7;
  return object;
}

// Every bundled scene, unchanged, from another folder.
TEST(SceneWriter, KeepsBundledScenesInOtherFolders) {
  const test::TemporaryFolder folder;
  int count = 0;
  for (const auto& entry : fs::directory_iterator(test::source_dir() / "scenes")) {
    if (entry.path().extension() != ".json" || entry.path().filename() == "scene.schema.json")
      continue;
    SCOPED_TRACE(entry.path().string());
    const Scene start = load_scene(entry.path()).value();
    const Scene read = written_and_read(start, start, folder.path() / "some" / "where");
    expect_same_arrangement(start, read);
    EXPECT_EQ(read.lights.size(), start.lights.size());
    EXPECT_EQ(read.planes.size(), start.planes.size());
    EXPECT_EQ(read.name, start.name);
    ++count;
  }
  EXPECT_GE(count, 9);
}

TEST(SceneWriter, WritesMovedRemovedAndAddedObjects) {
  const test::TemporaryFolder folder;
  const Scene loaded = load_scene(test::source_dir() / "scenes/default.json").value();
  Scene start = loaded;
  add_object(start, toy("toy"));
  add_object(start, toy("gone"));
  Scene now = start;
  SceneObject& moved = now.objects[0];
  moved.animation = Animation();
  moved.placement.position = {0.1, 0.2, 0.05};
  moved.placement.rotation =
      Eigen::Quaterniond(Eigen::AngleAxisd(2.345, Eigen::Vector3d(0.3, -0.5, 0.8).normalized()));
  now.objects.back().removed = true;
  const Scene read = written_and_read(now, start, folder.path());
  expect_same_arrangement(now, read);
  EXPECT_TRUE(read.objects[0].animation.keyframes.empty());
  EXPECT_NE(read.objects[1].animation.spin_turns_per_s, 0.0) << "the rotor was not moved";
}

// At a pitch of 90 degrees, yaw and roll turn about the same axis.
TEST(SceneWriter, KeepsRotationsAtGimbalLock) {
  const test::TemporaryFolder folder;
  const Scene start = load_scene(test::source_dir() / "scenes/stack.json").value();
  for (const double pitch : {90.0, -90.0, 89.9999999}) {
    for (const double yaw : {0.0, 30.0, 170.0, -100.0}) {
      Scene now = start;
      const double to_radians = std::numbers::pi / 180.0;
      now.objects[0].placement.rotation =
          Eigen::AngleAxisd(yaw * to_radians, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(pitch * to_radians, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX());
      expect_same_arrangement(now, written_and_read(now, start, folder.path()));
    }
  }
}

TEST(SceneWriter, WritesChangedShadows) {
  const test::TemporaryFolder folder;
  const Scene start = load_scene(test::source_dir() / "scenes/default.json").value();
  Scene now = start;
  ShadowNode& node = now.shadows[0];
  node.kernels = KernelSource::per_axis;
  node.fractions = {0.2, 0.5, 0.9};
  node.layered = make_layered_constants(0.9, 3.1, 0.0).value();
  expect_same_arrangement(now, written_and_read(now, start, folder.path()));
  node.layered = make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, 0.21).value();
  expect_same_arrangement(now, written_and_read(now, start, folder.path()));
  // An option of the run, such as --shadow hard --show-rays.
  ShadowStyle style = start.shadows[0];
  style.technique = ShadowTechnique::hard;
  style.light_rays = true;
  expect_same_style(written_and_read(start, start, folder.path(), &style).shadows[0], style);
}

// The walls follow from the casters at the start, so a moved caster must not move them.
TEST(SceneWriter, KeepsDefaultWalls) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "scene.json")
      << R"({"objects":[{"name":"box","shape":{"kind":"box","size":[0.1,0.1,0.1]}}],)"
      << R"("shadows":[{"name":"s","technique":"walls"}]})";
  const Scene start = load_scene(folder.path() / "scene.json").value();
  Scene now = start;
  now.objects[0].placement.position = {0.3, 0.2, 0.1};
  const Scene read = written_and_read(now, start, folder.path());
  ASSERT_EQ(read.shadows[0].walls.size(), 2U);
  ASSERT_EQ(read.planes.size(), start.planes.size());
  for (std::size_t i = 0; i < read.planes.size(); ++i) {
    EXPECT_EQ(read.planes[i].name, start.planes[i].name);
    EXPECT_EQ(read.planes[i].point, start.planes[i].point);
    EXPECT_EQ(read.planes[i].normal, start.planes[i].normal);
    EXPECT_EQ(read.planes[i].outline, start.planes[i].outline);
  }
}

TEST(SceneWriter, WritesRelativePathsOnReadableLines) {
  const test::TemporaryFolder folder;
  fs::create_directories(folder.path() / "models");
  fs::create_directories(folder.path() / "scenes");
  fs::copy(test::source_dir() / "scenes/models/helicopter.glb", folder.path() / "models/toy.glb");
  fs::copy(test::source_dir() / "scenes/table.json", folder.path() / "scenes/table.json");
  const Scene start = load_scene(folder.path() / "scenes/table.json").value();
  Scene now = start;
  SceneObject object = toy("toy");
  object.model_file = (folder.path() / "models/toy.glb").string();
  add_object(now, object);
  const auto text = scene_text({now, start, {}, std::nullopt}, folder.path() / "scenes");
  ASSERT_TRUE(text) << text.error().message;
  EXPECT_THAT(*text, HasSubstr("\"model\": \"../models/toy.glb\""));
  for (std::size_t at = 0, end = 0; at < text->size(); at = end + 1) {
    end = text->find('\n', at);
    EXPECT_LE(end - at, 120U) << text->substr(at, end - at);
  }
}

TEST(SceneWriter, RejectsWhatSchemaDoesNotAllow) {
  const Scene start = load_scene(test::source_dir() / "scenes/stack.json").value();
  Scene now = start;
  now.objects[0].placement.position.x() = 5000.0;
  const auto text = scene_text({now, start, {}, std::nullopt}, "");
  ASSERT_FALSE(text);
  EXPECT_THAT(text.error().message, HasSubstr("/objects/0/position/0: is 5000"));
  EXPECT_FALSE(scene_text({Scene(), Scene(), {}, std::nullopt}, "")) << "has no file";
}

TEST(AddObject, MovesDefaultWallsToAllCasters) {
  Scene scene = load_scene(test::source_dir() / "scenes/table.json").value();
  ASSERT_EQ(scene.planes.size(), 1U);
  add_object(scene, toy("toy"));
  ASSERT_EQ(scene.planes.size(), 3U);
  EXPECT_EQ(scene.shadows[0].walls, (std::vector<int>{1, 2}));
  const double back = scene.planes[1].point.y();
  SceneObject second = toy("second");
  second.placement.position.y() += 1.0;
  add_object(scene, second);
  EXPECT_EQ(scene.planes.size(), 3U);
  EXPECT_EQ(scene.shadows[0].walls, (std::vector<int>{1, 2}));
  EXPECT_NEAR(scene.planes[1].point.y(), back + 1.0, 1e-9);
  EXPECT_EQ(scene.shadows[0].casters, (std::vector<int>{0, 1}));
}

}  // namespace
}  // namespace penumbra
