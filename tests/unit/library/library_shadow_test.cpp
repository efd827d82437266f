#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <penumbra/shadow.hpp>
#include <tuple>

#include "recorded_frames.hpp"
#include "support/run_program.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

std::filesystem::path helicopter() {
  return source_dir() / "scenes" / "models" / "helicopter.glb";
}

// A square plate with a side of 0.1 m, centred on the origin.
shadow::Mesh plate() {
  return {{{-0.05, -0.05, 0.0}, {0.05, -0.05, 0.0}, {0.05, 0.05, 0.0}, {-0.05, 0.05, 0.0}},
          {{0, 1, 2}, {0, 2, 3}}};
}

shadow::Options at_height(double height_m) {
  shadow::Options options;
  options.T_world_object.position = {0.0, 0.0, height_m};
  return options;
}

double area_of(const shadow::Shadow& shadow, const std::string& layer) {
  for (const shadow::Layer& candidate : shadow.layers) {
    if (candidate.name == layer) return candidate.area_m2;
  }
  ADD_FAILURE() << "no layer " << layer;
  return kNan;
}

TEST(LibraryShadow, FollowsTheFormulaOfLayers) {
  const shadow::Model model(plate());
  for (const double h : {0.0, 0.05, 0.1, 0.2}) {
    const shadow::Shadow result = shadow::cast(model, at_height(h));
    // s = (H + lambda a h) / (H - h), H = 0.9, a = 3; the plate's kernel is its centre.
    for (const auto& [name, lambda] :
         {std::pair("umbra", -1.0), std::pair("middle", 0.0), std::pair("penumbra", 1.0)}) {
      const double s = (0.9 + lambda * 3.0 * h) / (0.9 - h);
      EXPECT_NEAR(area_of(result, name), 0.01 * s * s, 0.02 * 0.01 * s * s) << name << " " << h;
    }
    EXPECT_NEAR(result.object.area_m2, 0.01, 1e-7);
  }
}

// Expects the layers of `penumbra shadow`'s JSON, number by number.
void expect_layers(const shadow::Shadow& found, const nlohmann::json& expected) {
  ASSERT_EQ(found.layers.size(), expected["layers"].size());
  for (const shadow::Layer& layer : found.layers) {
    const auto& json = expected["layers"][layer.name];
    EXPECT_EQ(layer.area_m2, json["area"].get<double>());
    ASSERT_EQ(layer.polygons.size(), json["polygons"].size());
    for (std::size_t i = 0; i < layer.polygons.size(); ++i) {
      EXPECT_EQ(layer.polygons[i].outer,
                json["polygons"][i]["outer"].get<std::vector<shadow::Vector2>>());
      EXPECT_EQ(layer.polygons[i].holes,
                json["polygons"][i]["holes"].get<std::vector<std::vector<shadow::Vector2>>>());
    }
  }
  EXPECT_EQ(found.twisted_faces, expected["twisted_faces"].get<std::size_t>());
  EXPECT_EQ(found.kernel_source, expected["kernels"]["source"].get<std::string>());
  EXPECT_EQ(found.warnings, expected["warnings"].get<std::vector<std::string>>());
}

nlohmann::json json_of_command(std::vector<std::string> options) {
  options.insert(options.begin(), {"shadow", helicopter().string(), "--pose",
                                   "0.1 -0.05 0.12 0 0 0.6 0.8", "--output", "-"});
  const ProgramResult command = run_program(program(), options);
  EXPECT_EQ(command.exit_code, 0) << command.err;
  return nlohmann::json::parse(command.out);
}

TEST(LibraryShadow, EqualsShadowCommand) {
  const shadow::Model model = shadow::Model::load(helicopter());
  shadow::Options options;
  options.T_world_object = {{0.1, -0.05, 0.12}, {0.0, 0.0, 0.6, 0.8}};
  const auto expect_as = [&](const std::vector<std::string>& words) {
    SCOPED_TRACE(testing::PrintToString(words));
    expect_layers(shadow::cast(model, options), json_of_command(words));
  };
  expect_as({});
  options.kernel_source = shadow::KernelSource::centroid;
  expect_as({"--kernels", "cocl"});
  options.kernel_source = shadow::KernelSource::automatic;
  options.light_mode = shadow::LightMode::fixed;
  expect_as({"--light-mode", "fixed"});
  options.light_mode = shadow::LightMode::proportional;
  options.light = shadow::light_for_workspace(0.3, 1.5);
  options.plane = {{0.1, 0.0, 1.0}, {0.0, 0.0, -0.02}};
  expect_as(
      {"--workspace-height", "0.3", "--magnification", "1.5", "--plane", "0.1 0 1 0 0 -0.02"});
  options.light = {kInfinity, std::nullopt, 0.3};
  options.plane = {};
  expect_as({"--light-height", "inf", "--umbra-height", "0.3"});
  options.technique = shadow::Technique::simple;
  expect_as({"--technique", "simple"});
  options.technique = shadow::Technique::hard;
  options.hard_light = {0.3, 0.2, 1.0, 1.0};
  expect_as({"--technique", "hard", "--light", "0.3 0.2 1 1"});
  options.technique = shadow::Technique::field;
  options.light = {};
  expect_as({"--technique", "field"});
}

TEST(LibraryShadow, StoredKernelsGiveSameLayers) {
  const TemporaryFolder folder;
  const shadow::Model model = shadow::Model::load(helicopter());
  const shadow::Kernels made = shadow::Kernels::make(model);
  EXPECT_EQ(made.up(), (shadow::Vector3{0.0, 0.0, 1.0}));
  made.save(folder.path() / "kernels.json");
  shadow::Options options = at_height(0.1);
  const shadow::Shadow expected = shadow::cast(model, options);
  for (const shadow::Kernels& kernels :
       {made, shadow::Kernels::load(folder.path() / "kernels.json")}) {
    options.kernels = kernels;
    const shadow::Shadow found = shadow::cast(model, options);
    for (std::size_t i = 0; i < expected.layers.size(); ++i) {
      EXPECT_EQ(found.layers[i].area_m2, expected.layers[i].area_m2);
    }
  }
  EXPECT_THAT(message_of([&] { std::ignore = shadow::cast(shadow::Model(plate()), options); }),
              HasSubstr("triples"));
  EXPECT_THAT(message_of([&] { std::ignore = shadow::Kernels::load(folder.path() / "none.json"); }),
              HasSubstr("none.json"));
  EXPECT_THAT(message_of([&] {
                std::ignore = shadow::Kernels::make(model, {0.0, 0.0, 0.0});
              }),
              HasSubstr("direction"));
  EXPECT_THAT(message_of([&] {
                std::ignore = shadow::Kernels::make(model, {0.0, kNan, 1.0});
              }),
              HasSubstr("direction"));
  EXPECT_THAT(message_of([&] {
                std::ignore = shadow::Kernels::make(model, {0.0, 0.0, 1.0},
                                                    shadow::KernelSource::automatic, {"none"});
              }),
              HasSubstr("no such node"));
}

TEST(LibraryShadow, RejectsInvalidMeshes) {
  const auto message = [](const shadow::Mesh& mesh) {
    return message_of([&] { shadow::Model model(mesh); });
  };
  EXPECT_EQ(message(plate()), "");
  EXPECT_THAT(message({}), HasSubstr("no triangles"));
  EXPECT_THAT(message({plate().positions, {}}), HasSubstr("no triangles"));
  EXPECT_THAT(message({{}, plate().triangles}), HasSubstr("does not exist"));
  EXPECT_THAT(message({plate().positions, {{0, 1, 4}}}),
              HasSubstr("vertex 4 does not exist; the mesh has 4 vertices"));
  for (const double bad : {kNan, kInfinity, -kInfinity, 1e7, 1e300}) {
    shadow::Mesh mesh = plate();
    mesh.positions[2][1] = bad;
    EXPECT_THAT(message(mesh), HasSubstr("positions[2]"));
  }
  EXPECT_THAT(message_of([] { std::ignore = shadow::Model::load("none.glb"); }),
              HasSubstr("none.glb"));
  EXPECT_THAT(message_of([] { std::ignore = shadow::Model::load(helicopter(), {.unit_m = 0.0}); }),
              HasSubstr("unit_m"));
}

TEST(LibraryShadow, RejectsValuesOutOfRange) {
  const shadow::Model model(plate());
  const auto message = [&](auto change) {
    shadow::Options options = at_height(0.1);
    change(options);
    return message_of([&] { std::ignore = shadow::cast(model, options); });
  };
  EXPECT_EQ(message([](shadow::Options&) {}), "");
  for (const double bad : {kNan, kInfinity, -kInfinity}) {
    EXPECT_THAT(message([&](auto& o) { o.T_world_object.position[0] = bad; }),
                HasSubstr("position"));
    EXPECT_THAT(message([&](auto& o) { o.T_world_object.quaternion_xyzw[1] = bad; }),
                HasSubstr("quaternion"));
    EXPECT_THAT(message([&](auto& o) { o.plane.normal[2] = bad; }), HasSubstr("plane: normal"));
    EXPECT_THAT(message([&](auto& o) { o.plane.point[2] = bad; }), HasSubstr("plane: point"));
    EXPECT_THAT(message([&](auto& o) { o.scale = bad; }), HasSubstr("scale"));
    EXPECT_THAT(message([&](auto& o) { o.light.ratio = bad; }), HasSubstr("ratio"));
    EXPECT_THAT(message([&](auto& o) { o.light.height_m = bad; }), HasSubstr("light"));
    EXPECT_THAT(message([&](auto& o) {
                  o.technique = shadow::Technique::hard;
                  o.hard_light[0] = bad;
                }),
                HasSubstr("hard_light"));
  }
  EXPECT_THAT(message([](auto& o) { o.plane.normal = {0.0, 0.0, 0.0}; }), HasSubstr("normal"));
  EXPECT_THAT(message([](auto& o) { o.scale = 0.0; }), HasSubstr("scale"));
  EXPECT_THAT(message([](auto& o) { o.light = {0.9, 3.0, 0.3}; }), HasSubstr("one of the two"));
  EXPECT_THAT(message([](auto& o) { o.light.height_m = 0.0; }), HasSubstr("light height"));
  EXPECT_THAT(message([](auto& o) { o.technique = shadow::Technique{7}; }), HasSubstr("technique"));
  EXPECT_THAT(message([](auto& o) { o.groups = {"none"}; }), HasSubstr("no such node"));
  EXPECT_THAT(message([](auto& o) {
                o.light_mode = shadow::LightMode::fixed;
                o.kernel_source = shadow::KernelSource::centroid;
              }),
              HasSubstr("light_mode"));
  EXPECT_THAT(message_of([] { std::ignore = shadow::light_for_workspace(0.3, 1.0); }),
              HasSubstr("magnification"));
  EXPECT_THAT(message_of([] { std::ignore = shadow::light_for_workspace(kNan, 1.5); }),
              HasSubstr("workspace height"));
}

TEST(LibraryShadow, WarnsOfShadowThatDoesNotExist) {
  const shadow::Shadow result = shadow::cast(shadow::Model(plate(), "plate"), at_height(-0.1));
  EXPECT_THAT(result.warnings, testing::Contains(HasSubstr("plate: is under the plane")));
  for (const shadow::Layer& layer : result.layers) EXPECT_EQ(layer.area_m2, 0.0);
}

// Any triangle soup and any height give finite outlines, or one line that says why not.
RC_GTEST_PROP(LibraryShadow, IsFiniteForAnyTriangles, ()) {
  const auto coordinate =
      rc::gen::oneOf(rc::gen::map(rc::gen::inRange(-100, 100), [](int mm) { return 1e-3 * mm; }),
                     rc::gen::element(0.0, 1e-12, 1e5, -1e5));
  const auto count = *rc::gen::inRange<std::uint32_t>(0, 9);
  shadow::Mesh mesh;
  for (std::uint32_t i = 0; i < count; ++i)
    mesh.positions.push_back({*coordinate, *coordinate, *coordinate});
  const auto triangles = *rc::gen::inRange(0, 6);
  for (int i = 0; i < triangles; ++i) {
    const auto index = rc::gen::inRange<std::uint32_t>(0, std::max(count, 1U));
    mesh.triangles.push_back({*index, *index, *index});
  }
  shadow::Options options = at_height(1e-3 * *rc::gen::inRange(-100, 1000));
  options.technique = static_cast<shadow::Technique>(*rc::gen::inRange(0, 4));
  try {
    const shadow::Shadow result = shadow::cast(shadow::Model(mesh), options);
    for (const shadow::Layer& layer : result.layers) {
      RC_ASSERT(std::isfinite(layer.area_m2) && layer.area_m2 >= 0.0);
      for (const shadow::Polygon& polygon : layer.polygons) {
        for (const auto& [u, v] : polygon.outer) RC_ASSERT(std::isfinite(u) && std::isfinite(v));
      }
    }
  } catch (const Exception& error) {
    RC_ASSERT(std::string(error.what()).starts_with("mesh: "));
    RC_ASSERT(triangles == 0 || count == 0);
  }
}

}  // namespace
}  // namespace penumbra::test
