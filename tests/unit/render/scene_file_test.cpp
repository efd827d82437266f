// Scenes from JSON, and the motion of their objects.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "render/scene/scene.hpp"
#include "render/scene/scene_json.hpp"
#include "support/paths.hpp"
#include "support/utf16.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

const std::string kBox = R"({"name":"box","shape":{"kind":"box","size":[0.1,0.1,0.1]}})";

// Returns the warnings and advice for a scene with one shadow node, one per line.
std::string warnings_and_advice(const Scene& scene) {
  std::string all;
  for (const std::string& warning : scene.warnings) all += warning + "\n";
  for (const LayeredAdvice& advice : scene.layered_advice) {
    EXPECT_EQ(advice.node, 0);
    all += advice.text + "\n";
  }
  return all;
}

class SceneFile : public testing::Test {
 protected:
  Result<Scene> load(const std::string& text) {
    const std::filesystem::path file = folder_.path() / "scene.json";
    std::ofstream(file, std::ios::binary) << text;
    return load_scene(file);
  }
  std::string error_of(const std::string& text) {
    const Result<Scene> scene = load(text);
    return scene ? "was accepted" : scene.error().message;
  }
  std::string shadow_error(const std::string& keys) {
    return error_of("{\"objects\":[" + kBox +
                    "],\"shadows\":[{\"name\":\"s\",\"technique\":"
                    "\"layered\"," +
                    keys + "}]}");
  }
  test::TemporaryFolder folder_;
};

TEST_F(SceneFile, AcceptsByteOrderMark) {
  const std::string text = "{\"objects\":[" + kBox + "]}";
  const Result<Scene> scene = load("\xEF\xBB\xBF" + text);
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(scene->objects.size(), 1U);
  for (const bool with_mark : {true, false}) {
    EXPECT_THAT(error_of(test::as_utf16(text, with_mark)),
                HasSubstr("scene.json: is UTF-16 text; save it as UTF-8"));
  }
}

TEST_F(SceneFile, LoadsDefaultSceneWithoutWarnings) {
  const Result<Scene> scene = load_scene(test::source_dir() / "scenes/default.json");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_TRUE(scene->warnings.empty());
  ASSERT_EQ(scene->objects.size(), 4U);
  EXPECT_TRUE(scene->objects[3].phantom);
  EXPECT_EQ(scene->planes.size(), 3U);
  EXPECT_EQ(scene->shadows[0].casters.size(), 3U);
  // a = M / (M - 1), H = a h_max
  EXPECT_NEAR(scene->shadows[0].layered.light_ratio, 3.0, 1e-12);
  EXPECT_NEAR(scene->shadows[0].layered.light_height, 3.0 * 0.24, 1e-12);
  // Within four seconds of the recording, the object rises from near contact to a height where the
  // layers separate.
  EXPECT_LT(evaluate_scene(*scene, 0.0).objects[0].position.z(), 0.02);
  EXPECT_GT(evaluate_scene(*scene, 3.8).objects[0].position.z(), 0.14);
}

TEST_F(SceneFile, ReportsPathAndAllowedValuesOfViolations) {
  EXPECT_THAT(error_of("{"), HasSubstr("scene.json: is not JSON: parse error at line 1"));
  EXPECT_THAT(error_of("[]"),
              HasSubstr("scene.json: /: is an empty list; give an object that says what is drawn"));
  EXPECT_THAT(error_of("{}"), HasSubstr("/: has no \"objects\"; add it"));
  EXPECT_THAT(error_of(R"({"objects":[],"shadow":[]})"),
              HasSubstr("/shadow: is not a known key; did you mean \"shadows\"?"));
  for (const std::string unit : {"unit", "units", "Unit", "UNITS"}) {
    EXPECT_THAT(error_of(R"({"objects":[{"name":"a",")" + unit + R"(":"mm"}]})"),
                HasSubstr("/objects/0/" + unit +
                          ": is not a known key; for a model in millimetres "
                          "give \"scale\": 0.001"));
  }
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","scale":"big"}]})"),
              HasSubstr("/objects/0/scale: is \"big\"; give a number from 1e-6 to 1e6"));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","scale":-1}]})"),
              HasSubstr("/objects/0/scale: is -1; give a number from 1e-6 to 1e6"));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","position":[1,2]}]})"),
              HasSubstr("/objects/0/position: is a list of 2; give three numbers [x, y, z]"));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a"}]})"),
              HasSubstr("/objects/0: needs a \"model\" or a \"shape\""));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","model":"none.glb"}]})"),
              HasSubstr("/objects/0/model: "));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","position":[1e999,0,0]}]})"),
              HasSubstr("is not JSON"));
  EXPECT_THAT(error_of("{\"objects\":[" + kBox + "," + kBox + "]}"),
              HasSubstr("/objects/1/name: \"box\" is taken"));
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","shape":{"kind":"sphere"}}]})"),
              HasSubstr("/objects/0/shape: has no \"radius\"; a sphere needs it"));
  EXPECT_THAT(error_of(R"({"objects":[],"lights":[{"name":"l","kind":"spot"}]})"),
              HasSubstr("/lights/0/kind: is \"spot\"; give one of point, directional"));
  EXPECT_THAT(error_of(R"({"objects":[],"lights":[{"name":"l","kind":"point"}]})"),
              HasSubstr("/lights/0: has no \"position\""));
  EXPECT_THAT(error_of(R"({"objects":[],"planes":[{"name":"p","normal":[0,0,0]}]})"),
              HasSubstr("/planes/0/normal: has no length"));
}

TEST_F(SceneFile, ReportsPathOfTooLongName) {
  EXPECT_THAT(error_of(R"({"objects":[{"name":")" + std::string(300, 'a') + "\"}]}"),
              HasSubstr("/objects/0/name: is \"aaaa"));
  // The limit of 200 counts characters, not bytes; these characters have two bytes each.
  std::string umlauts;
  for (int i = 0; i < 200; ++i) umlauts += "\u00e4";
  EXPECT_TRUE(load(R"({"name":")" + umlauts + R"(","objects":[]})"));
}

TEST_F(SceneFile, RejectsDuplicateKey) {
  EXPECT_THAT(error_of(R"({"objects":[],"objects":[]})"),
              HasSubstr("scene.json: /objects: is given twice; remove one of them"));
  EXPECT_THAT(
      error_of("{\"objects\":[" + kBox +
               R"(,{"name":"b","position":[0,[1],{}],"shape":{"kind":"box","kind":"ring"}}]})"),
      HasSubstr("/objects/1/shape/kind: is given twice"));
  EXPECT_TRUE(
      load("{\"objects\":[" + kBox + R"(,{"name":"b","shape":{"kind":"box","size":[1,1,1]}}]})"))
      << "different objects may have the same key";
}

// find_violation() implements the schema's keywords itself, so the schema must not use other
// keywords.
void expect_known_keywords(const nlohmann::json& schema, const std::string& pointer) {
  static const std::set<std::string_view> kTypes = {"object",  "array",  "string",
                                                    "boolean", "number", "integer"};
  static const std::set<std::string_view> kDescribing = {"$schema", "title", "description",
                                                         "expected", "definitions"};
  // The keywords that find_violation() in scene_json.cpp checks.
  static const std::set<std::string_view> kChecked = {"$ref",       "additionalProperties",
                                                      "enum",       "exclusiveMinimum",
                                                      "items",      "maxItems",
                                                      "maxLength",  "maximum",
                                                      "minItems",   "minLength",
                                                      "minimum",    "pattern",
                                                      "properties", "required",
                                                      "type"};
  for (const auto& [key, value] : schema.items()) {
    EXPECT_TRUE(kDescribing.contains(key) || kChecked.contains(key)) << pointer << ": " << key;
    if (key == "properties" || key == "definitions") {
      for (const auto& [name, part] : value.items()) {
        const std::string part_pointer = pointer + "/" + key + "/" + name;
        expect_known_keywords(part, part_pointer);
        EXPECT_TRUE(key == "definitions" || part.contains("description"))
            << part_pointer << ": editors show it";
      }
    } else if (key == "items") {
      ASSERT_TRUE(value.is_object()) << pointer;
      expect_known_keywords(value, pointer + "/items");
    } else if (key == "type") {
      for (const auto& type : value.is_array() ? value : nlohmann::json::array({value})) {
        EXPECT_TRUE(kTypes.contains(type.get<std::string>())) << pointer << ": " << type;
      }
    } else if (key == "additionalProperties") {
      EXPECT_EQ(value, false) << pointer;
    } else if (key == "$ref") {
      // Keywords beside a $ref would be ignored, so only a description is allowed.
      EXPECT_EQ(schema.size(), schema.contains("description") ? 2U : 1U) << pointer;
    }
  }
  if (!schema.contains("$ref")) {
    EXPECT_TRUE(schema.contains("expected")) << pointer << ": the message's remedy";
    const nlohmann::json type = schema.value("type", nlohmann::json());
    const bool is_object =
        type.is_array() ? std::ranges::find(type, "object") != type.end() : type == "object";
    EXPECT_EQ(is_object, schema.contains("properties")) << pointer;
  }
}

TEST_F(SceneFile, UsesOnlySupportedSchemaKeywords) {
  expect_known_keywords(nlohmann::json::parse(scene_schema()), "#");
}

TEST_F(SceneFile, ListsEveryTechniqueAndKernelKindInSchema) {
  const nlohmann::json schema = nlohmann::json::parse(scene_schema());
  const nlohmann::json& node = schema.at("definitions").at("shadow").at("properties");
  nlohmann::json techniques, kernels;
  for (const auto& entry : kShadowTechniqueNames) techniques.push_back(std::string(entry.name));
  for (const auto& entry : kKernelSourceNames) kernels.push_back(std::string(entry.name));
  EXPECT_EQ(node.at("technique").at("enum"), techniques);
  EXPECT_EQ(node.at("kernels").at("enum"), kernels);
  for (const auto& entry : kKernelSourceNames) {
    const Result<Scene> scene = load(
        "{\"objects\":[" + kBox + R"(],"shadows":[{"name":"s","technique":"layered","kernels":")" +
        std::string(entry.name) + "\"}]}");
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_EQ(scene->shadows[0].kernels, entry.value);
  }
}

TEST_F(SceneFile, AttachesObjectsAndPlanesToTagGroups) {
  const auto scene = load(
      R"({"objects":[{"name":"a","shape":{"kind":"box","size":[1,1,1]},"tag_group":"prop"},
                     {"name":"b","shape":{"kind":"box","size":[1,1,1]},"parent":"a"},
                     {"name":"c","shape":{"kind":"box","size":[1,1,1]},"tag_group":"table"}],
          "phantoms":[{"name":"d","shape":{"kind":"box","size":[1,1,1]},"tag_group":"prop"}],
          "planes":[{"name":"p","tag_group":"wall"},{"name":"q"},{"name":"r","tag_group":"never"}],
          "shadows":[{"name":"s","technique":"simple","planes":["q"],"walls":["p"]}]})");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_EQ(scene->objects[0].tag_group, "prop");
  EXPECT_EQ(scene->objects[1].tag_group, "table") << "inherited from its parent";
  EXPECT_EQ(scene->objects[2].tag_group, "table");
  EXPECT_EQ(scene->objects[3].tag_group, "prop");
  EXPECT_EQ(scene->planes[0].tag_group, "wall");
  EXPECT_EQ(scene->planes[1].tag_group, "table");
  EXPECT_THAT(tag_groups_of(*scene), testing::ElementsAre("prop", "wall"))
      << "nothing falls on the third plane";
  EXPECT_THAT(error_of(R"({"objects":[{"name":"a","shape":{"kind":"box","size":[1,1,1]}},
      {"name":"b","shape":{"kind":"box","size":[1,1,1]},"parent":"a","tag_group":"x"}]})"),
              HasSubstr("/objects/1/tag_group: the parent says"));
  EXPECT_THAT(error_of(R"({"objects":[],"planes":[{"name":"p","tag_group":7}]})"),
              HasSubstr("/planes/0/tag_group: is 7; give the group of tags"));
}

TEST_F(SceneFile, AllowsOneCursorObject) {
  const auto object = [](const char* name, const char* keys) {
    return std::string(R"({"name":")") + name +
           R"(","shape":{"kind":"box","size":[1,1,1]},"cursor":true)" + keys + "}";
  };
  const Result<Scene> scene = load(R"({"objects":[)" + object("a", "") + "]}");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_TRUE(scene->objects[0].cursor);
  EXPECT_THAT(error_of(R"({"objects":[)" + object("a", "") + "," + object("b", "") + "]}"),
              HasSubstr("/objects/1/cursor: the scene has another 3D cursor"));
  EXPECT_THAT(error_of(R"({"objects":[)" + object("a", R"(,"tag_group":"wall")") + "]}"),
              HasSubstr("/objects/0/cursor: moves freely"));
  EXPECT_THAT(error_of(R"({"objects":[],"phantoms":[)" + object("a", "") + "]}"),
              HasSubstr("/phantoms/0/cursor: is for virtual objects"));
}

TEST_F(SceneFile, ReadsGroupsAndProxiesOfObjects) {
  const auto object = [this](const std::string& keys) {
    return R"({"objects":[{"name":"a","model":")" +
           (test::source_dir() / "scenes/models/helicopter.glb").string() + "\"" + keys + "}]}";
  };
  const Result<Scene> plain = load(object(""));
  ASSERT_TRUE(plain) << plain.error().message;
  EXPECT_TRUE(plain->objects[0].groups.empty());
  EXPECT_EQ(plain->objects[0].proxy_model, nullptr);
  const Result<Scene> one_group = load(object(R"(,"group":"all","proxy":"none")"));
  ASSERT_TRUE(one_group) << one_group.error().message;
  EXPECT_EQ(one_group->objects[0].groups, std::vector<std::string>{"all"});
  EXPECT_EQ(one_group->objects[0].proxy_model, nullptr);
  const Result<Scene> two_groups = load(object(R"(,"group":["*","all"])"));
  ASSERT_TRUE(two_groups) << two_groups.error().message;
  EXPECT_EQ(two_groups->objects[0].groups.size(), 2U);
  EXPECT_THAT(error_of(object(R"(,"group":["all","no such"])")),
              HasSubstr("/objects/0/group: group \"no such\": the model \"helicopter\" has no such "
                        "node, mesh or object; there are: all, "));
  EXPECT_THAT(error_of(object(R"(,"group":7)")),
              HasSubstr("/objects/0/group: is 7; give parts of the model"));
  EXPECT_THAT(error_of(object(R"(,"proxy":"nowhere.glb")")), HasSubstr("/objects/0/proxy: "));
  const Result<Scene> with_proxy = load(
      object(",\"proxy\":\"" + (test::source_dir() / "scenes/models/cube.glb").string() + "\""));
  ASSERT_TRUE(with_proxy) << with_proxy.error().message;
  ASSERT_NE(with_proxy->objects[0].proxy_model, nullptr);
  EXPECT_EQ(with_proxy->objects[0].proxy_model->name, "cube");
}

// A model's warning appears once, for any number of objects that use the model.
TEST_F(SceneFile, ForwardsModelWarningsOnce) {
  std::ofstream(folder_.path() / "thing.obj")
      << "mtllib lost.mtl\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n";
  const Result<Scene> scene =
      load(R"({"objects":[{"name":"a","model":"thing.obj"},{"name":"b","model":"thing.obj"}],)"
           R"("shadows":[]})");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_THAT(scene->warnings,
              testing::ElementsAre(testing::AllOf(HasSubstr("thing.obj"), HasSubstr("lost.mtl"))));
}

TEST_F(SceneFile, WarnsWhenNothingCastsShadow) {
  const auto warnings = [this](const std::string& shadows) {
    const Result<Scene> scene = load(fmt::format(R"({{"objects":[{}]{}}})", kBox, shadows));
    EXPECT_TRUE(scene) << scene.error().message;
    return scene->warnings;
  };
  EXPECT_THAT(warnings(""), testing::ElementsAre(HasSubstr("no shadow node")));
  EXPECT_TRUE(warnings(R"(,"shadows":[])").empty());
  EXPECT_TRUE(warnings(R"(,"shadows":[{"name":"shadow","technique":"layered"}])").empty());
}

TEST_F(SceneFile, AdvisesWhenPenumbraExceedsPlaneOrUmbraNeverVanishes) {
  // The footprint of the box has a radius r of 0.0707 m; the shadow falls on a sheet of half width
  // W.
  const auto warnings = [this](const std::string& layered, double half_width) {
    const Result<Scene> scene = load(fmt::format(
        R"({{"objects":[{0}],"planes":[{{"name":"sheet","outline":)"
        R"([[{1},-9],[{2},-9],[{2},9],[{1},9]]}}],"shadows":[{{"name":"s","technique":"layered",)"
        R"("layered":{3}}}]}})",
        kBox, -half_width, half_width, layered));
    EXPECT_TRUE(scene) << scene.error().message;
    return warnings_and_advice(*scene);
  };
  const std::string workspace = R"({"workspace_height":0.3,"magnification":1.5})";
  // The limit W / (2 r) = 1.5 is reached at W = 0.2121 m.
  EXPECT_EQ(warnings(workspace, 0.213), "");
  EXPECT_THAT(warnings(workspace, 0.211),
              HasSubstr("/shadows/0: where its umbra vanishes the penumbra of \"box\" is 0.42 m "
                        "wide, and the plane \"sheet\" 0.42 m; give a magnification of 1.49"));
  EXPECT_EQ(warnings(R"({"light_height":0.9,"light_ratio":3})", 0.213), "");
  EXPECT_THAT(warnings(R"({"light_height":0.9,"light_ratio":3})", 0.211), HasSubstr("or less"));
  EXPECT_THAT(warnings(workspace, 0.1), HasSubstr("lower the height"));
  EXPECT_EQ(warnings(R"({"light_height":"inf","umbra_height":0.3})", 0.15), "");
  EXPECT_THAT(warnings(R"({"light_height":0.3,"light_ratio":1})", 5.0),
              HasSubstr("the umbra never vanishes"));
  EXPECT_THAT(warnings(R"({"light_height":0.3,"light_ratio":0.5})", 5.0),
              HasSubstr("the umbra never vanishes"));
  // Both forms of the constants describe the same light (docs/shadows.md#constants).
  const std::vector<std::array<double, 4>> examples = {
      {0.3, 1.25, 1.5, 5.0}, {0.3, 1.5, 0.9, 3.0}, {0.3, 2.0, 0.6, 2.0}};
  for (const auto& [h, m, H, a] : examples) {
    const Result<Scene> scene = load(fmt::format(
        "{{\"objects\":[{}],\"shadows\":[{{\"name\":\"s\",\"technique\":\"layered\",\"layered\":"
        "{{\"workspace_height\":{},\"magnification\":{}}}}}]}}",
        kBox, h, m));
    ASSERT_TRUE(scene) << scene.error().message;
    EXPECT_NEAR(scene->shadows[0].layered.light_height, H, 1e-12);
    EXPECT_NEAR(scene->shadows[0].layered.light_ratio, a, 1e-12);
    EXPECT_NEAR(scene->shadows[0].layered.umbra_height, h, 1e-12);
  }
}

TEST_F(SceneFile, WarnsOfObjectsAboveWorkspaceOrLight) {
  // The box's top is 0.05 m above its centre. The sheet is wide enough for all cases.
  const auto warnings = [this](const std::string& where, const std::string& layered) {
    const Result<Scene> scene = load(fmt::format(
        R"({{"objects":[{{"name":"box","shape":{{"kind":"box","size":[0.1,0.1,0.1]}},{}}}],)"
        R"("shadows":[{{"name":"s","technique":"layered","layered":{}}}]}})",
        where, layered));
    if (!scene) return scene.error().message;
    return warnings_and_advice(*scene);
  };
  const std::string workspace = R"({"workspace_height":0.2,"magnification":1.5})";  // H = 0.6
  EXPECT_EQ(warnings(R"("position":[0,0,0.15])", workspace), "");
  EXPECT_THAT(warnings(R"("position":[0,0,0.16])", workspace),
              HasSubstr("/shadows/0: \"box\" comes to 0.21 m above \"table\", beyond the "
                        "workspace_height of 0.2 m, and has no umbra there"));
  // A rotation by 45 degrees raises the top by 0.0207 m. The warning depends on the highest point
  // of the path, not on its start.
  EXPECT_THAT(warnings(R"("position":[0,0,0.14],"rotation_deg":[0,45,0])", workspace),
              HasSubstr("comes to 0.2107 m"));
  EXPECT_THAT(warnings(R"("position":[0,0,0.05],"animation":{"keyframes":[{"time_s":0},)"
                       R"({"time_s":1,"position":[0,0,0.2]},{"time_s":2}]})",
                       workspace),
              HasSubstr("comes to 0.3 m"));
  // A spin rotates the box in the same way. The height is that of the rotated shape, not of its
  // bounding box.
  EXPECT_THAT(
      warnings(R"("position":[0,0,0.14],"animation":{"spin":{"axis":[0,1,0],"turns_per_s":0.1}})",
               workspace),
      HasSubstr("comes to 0.21"));
  EXPECT_EQ(
      warnings(R"("position":[0,0,0.12],"animation":{"spin":{"axis":[0,1,0],"turns_per_s":0.1}})",
               workspace),
      "");
  // With explicit constants the umbra may vanish, so only the cap at 0.525 m gives a warning.
  const std::string light = R"({"light_height":0.6,"light_ratio":3})";  // cap at 0.525 m
  EXPECT_EQ(warnings(R"("position":[0,0,0.16])", light), "");
  EXPECT_EQ(warnings(R"("position":[0,0,0.47])", light), "");
  EXPECT_THAT(warnings(R"("position":[0,0,0.48])", light),
              HasSubstr("comes to 0.53 m above \"table\"; what is above 0.525 m casts nothing; "
                        "lower it, or raise the light"));
}

TEST_F(SceneFile, WarnsOfMoreLightsThanPlaneSupports) {
  const auto warnings = [this](int count, const std::string& technique) {
    std::string lights;
    std::string names;
    for (int i = 0; i < count; ++i) {
      lights += fmt::format(R"({}{{"name":"l{}","kind":"point","position":[0,0,1]}})",
                            i == 0 ? "" : ",", i);
      names += fmt::format(R"({}"l{}")", i == 0 ? "" : ",", i);
    }
    const Result<Scene> scene = load(fmt::format(
        R"({{"objects":[{}],"lights":[{}],"shadows":[{{"name":"s","technique":"{}","lights":[{}]}}]}})",
        kBox, lights, technique, names));
    EXPECT_TRUE(scene) << scene.error().message;
    return warnings_and_advice(*scene);
  };
  EXPECT_EQ(warnings(7, "hard"), "");
  EXPECT_THAT(warnings(8, "hard"), HasSubstr("8 lights cast projected shadows onto \"table\", "
                                             "which shows those of 7"));
  EXPECT_EQ(warnings(8, "volume"), "");
}

TEST_F(SceneFile, ValidatesLightModes) {
  const auto node = [](const std::string& keys) {
    return "{\"objects\":[" + kBox + R"(],"shadows":[{"name":"s","technique":"layered")" + keys +
           "}]}";
  };
  EXPECT_FALSE(load(node(""))->shadows[0].contact);
  EXPECT_TRUE(load(node(R"(,"contact":true)"))->shadows[0].contact);
  EXPECT_THAT(error_of(node(R"(,"contact":1)")), HasSubstr("/shadows/0/contact: "));
  EXPECT_FALSE(load(node(""))->shadows[0].light_rays);
  EXPECT_TRUE(load(node(R"(,"light_rays":true)"))->shadows[0].light_rays);
  EXPECT_THAT(error_of(node(R"(,"light_rays":"yes")")), HasSubstr("/shadows/0/light_rays: "));
  EXPECT_EQ(load(node(""))->shadows[0].light_mode, LightMode::proportional);
  EXPECT_EQ(load(node(R"(,"light_mode":"fixed")"))->shadows[0].light_mode, LightMode::fixed);
  EXPECT_THAT(error_of(node(R"(,"light_mode":"broken")")),
              HasSubstr("/shadows/0/light_mode: is \"broken\"; give one of proportional, fixed"));
  EXPECT_THAT(error_of(node(R"(,"light_mode":"fixed","kernels":"cocl")")),
              HasSubstr("/shadows/0/light_mode: is \"fixed\", which needs kernels"));
}

TEST_F(SceneFile, ValidatesShadowNodes) {
  EXPECT_THAT(shadow_error(R"("casters":["bax"])"),
              HasSubstr("/shadows/0/casters/0: there is no object \"bax\"; did you mean \"box\"?"));
  EXPECT_THAT(shadow_error(R"("planes":["floor"])"), HasSubstr("there is no plane \"floor\""));
  EXPECT_THAT(shadow_error(R"("layered":{"light_height":1})"),
              HasSubstr("/shadows/0/layered: give light_height with light_ratio or umbra_height"));
  EXPECT_THAT(shadow_error(R"("layered":{"light_height":"high","light_ratio":3})"),
              HasSubstr("/shadows/0/layered/light_height: is \"high\"; give metres above"));
  EXPECT_THAT(shadow_error(R"("layered":{"workspace_height":0.2,"magnification":1})"),
              HasSubstr("/shadows/0/layered/magnification: is 1; give a number over 1"));
  const Result<Scene> zenith = load("{\"objects\":[" + kBox +
                                    R"(],"shadows":[{"name":"s","technique":"layered","layered":)"
                                    R"({"light_height":"inf","umbra_height":0.3}}]})");
  ASSERT_TRUE(zenith) << zenith.error().message;
  EXPECT_TRUE(std::isinf(zenith->shadows[0].layered.light_height));
  EXPECT_EQ(zenith->shadows[0].layered.umbra_height, 0.3);
}

Scene moving(const std::string& interpolation, bool loop) {
  Scene scene;
  SceneObject object;
  object.animation.interpolation = interpolation == "linear" ? Animation::Interpolation::linear
                                                             : Animation::Interpolation::smooth;
  object.animation.loop = loop;
  const double times[] = {1.0, 1.5, 3.0, 4.0};
  const Eigen::Vector3d points[] = {{0, 0, 0}, {0.1, 0, 0.2}, {0.3, -0.1, 0.1}, {0, 0, 0}};
  for (std::size_t i = 0; i < 4; ++i) {
    Keyframe key;
    key.time_s = times[i];
    key.placement.position = points[i];
    key.placement.scale = 1.0 + 0.5 * static_cast<double>(i % 3);
    object.animation.keyframes.push_back(key);
  }
  object.animation.keyframes.back().placement = object.animation.keyframes.front().placement;
  scene.objects.push_back(object);
  return scene;
}

TEST_F(SceneFile, InterpolatesKeyframesExactlyAndContinuously) {
  for (const char* interpolation : {"linear", "smooth"}) {
    const Scene scene = moving(interpolation, true);
    const auto at = [&scene](double t) { return evaluate_scene(scene, t).objects[0]; };
    for (const Keyframe& key : scene.objects[0].animation.keyframes) {
      EXPECT_EQ(at(key.time_s).position, key.placement.position);
      EXPECT_EQ(at(key.time_s).scale, key.placement.scale);
    }
    for (double t = 0.0; t < 8.0; t += 0.001) {
      ASSERT_LT((at(t + 0.001).position - at(t).position).norm(), 0.002) << interpolation << t;
    }
    EXPECT_LT((at(2.2).position - at(2.2 + 3.0 * 7).position).norm(), 1e-12);
  }
}

TEST_F(SceneFile, SmoothsPathAtKeyframesAndLoop) {
  const Scene scene = moving("smooth", true);
  const auto at = [&scene](double t) { return evaluate_scene(scene, t).objects[0].position; };
  for (const double key : {1.5, 3.0, 4.0}) {
    const double h = 1e-6;
    const Eigen::Vector3d before = (at(key) - at(key - h)) / h, after = (at(key + h) - at(key)) / h;
    EXPECT_LT((before - after).norm(), 1e-4) << key;
  }
}

TEST_F(SceneFile, RestsAtEndsOfNonLoopingPath) {
  const Scene scene = moving("smooth", false);
  EXPECT_EQ(evaluate_scene(scene, 0.0).objects[0].position, Eigen::Vector3d(0, 0, 0));
  EXPECT_EQ(evaluate_scene(scene, 99.0).objects[0].position, Eigen::Vector3d(0, 0, 0));
}

TEST_F(SceneFile, MovesAndSpinsChildrenWithParents) {
  const Result<Scene> scene =
      load("{\"objects\":[" + kBox +
           R"(,{"name":"child","parent":"box","shape":{"kind":"sphere","radius":0.1},)"
           R"("position":[1,0,0],"animation":{"spin":{"axis":[0,0,2],"turns_per_s":0.25}}}]})");
  ASSERT_TRUE(scene) << scene.error().message;
  Scene raised = *scene;
  raised.objects[0].placement.position = {0, 0, 1};
  raised.objects[0].placement.scale = 2.0;
  const Placement child = evaluate_scene(raised, 1.0).objects[1];
  EXPECT_LT((child.position - Eigen::Vector3d(2, 0, 1)).norm(), 1e-12);
  EXPECT_LT((child * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(2, 2, 1)).norm(), 1e-12);
}

TEST_F(SceneFile, MovesLightsAndFollowsSunCalendar) {
  const auto sun = [](const std::string& keys) {
    return R"({"objects":[],"lights":[{"name":"l","kind":"sun")" + keys + "}]}";
  };
  const std::string location = R"("latitude_deg":48,"longitude_deg":11)";
  const Result<Scene> scene = load(sun(
      R"(,"sun":{)" + location + R"(,"date":"2026-06-21","time_utc":"10:30","hours_per_s":2})"));
  ASSERT_TRUE(scene) << scene.error().message;
  ASSERT_TRUE(scene->lights[0].sun);
  EXPECT_EQ(scene->lights[0].sun->start_utc_s, 1782000000.0 + 10.5 * 3600.0);
  EXPECT_EQ(scene->lights[0].kind, SceneLight::Kind::directional);
  EXPECT_THAT(error_of(sun("")), HasSubstr("/lights/0: has no \"sun\"; a sun light needs it"));
  EXPECT_THAT(
      error_of(sun(R"(,"sun":{)" + location + R"(,"date":"2026-02-30","time_utc":"10:30"})")),
      HasSubstr("/lights/0/sun/date: is \"2026-02-30\", not a day of the calendar"));
  EXPECT_THAT(
      error_of(sun(R"(,"sun":{)" + location + R"(,"date":"2026-02-03","time_utc":"24:30"})")),
      HasSubstr("/lights/0/sun/time_utc"));
  EXPECT_THAT(
      error_of(sun(R"(,"sun":{)" + location + R"(,"date":"yesterday","time_utc":"24:30"})")),
      HasSubstr("/lights/0/sun/date"));
  EXPECT_THAT(error_of(sun(R"(,"direction":[0,0,1],"sun":{)" + location +
                           R"(,"date":"2026-02-03","time_utc":"04:30"})")),
              HasSubstr("/lights/0/direction: a sun light has none"));
  const Result<Scene> moving =
      load(R"({"objects":[],"lights":[{"name":"l","kind":"point","position":[0,0,1],"animation":)"
           R"({"loop":false,"keyframes":[{"time_s":0},{"time_s":1,"position":[0.5,0,0]}]}}]})");
  ASSERT_TRUE(moving) << moving.error().message;
  EXPECT_EQ(evaluate_scene(*moving, 2.0).lights[0].position, Eigen::Vector4d(0.5, 0, 1, 1));
}

TEST_F(SceneFile, UsesNamedWallsOrCreatesDefaults) {
  const std::string wall = R"("planes":[{"name":"table"},{"name":"wall","normal":[0,-1,0]}],)";
  const std::string node = R"("shadows":[{"name":"s","technique":"walls","planes":["table"])";
  const Result<Scene> named =
      load("{\"objects\":[" + kBox + "]," + wall + node + R"(,"walls":["wall"]}]})");
  ASSERT_TRUE(named) << named.error().message;
  EXPECT_EQ(named->shadows[0].walls, std::vector<int>{1});
  EXPECT_EQ(named->planes.size(), 2U);
  const Result<Scene> defaults = load("{\"objects\":[" + kBox + "]," + wall + node + "}]}");
  ASSERT_TRUE(defaults) << defaults.error().message;
  EXPECT_EQ(defaults->planes.size(), 4U);
  EXPECT_EQ(defaults->shadows[0].walls, (std::vector<int>{2, 3}));
  EXPECT_THAT(error_of("{\"objects\":[" + kBox + "]," + wall + node + R"(,"walls":["w"]}]})"),
              HasSubstr("/shadows/0/walls"));
}

}  // namespace
}  // namespace penumbra
