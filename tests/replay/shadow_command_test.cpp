// penumbra shadow and penumbra kernels, run from the command line.

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "replay_support.hpp"
#include "support/animated_gltf.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

// A square of 0.2 m, 0.1 m over the plane.
constexpr const char* kSquare =
    "v -0.1 -0.1 0.1\nv 0.1 -0.1 0.1\nv 0.1 0.1 0.1\nv -0.1 0.1 0.1\nf 1 2 3\nf 1 3 4\n";

class ShadowCommand : public testing::Test {
 protected:
  void SetUp() override { std::ofstream(file("square.obj")) << kSquare; }
  [[nodiscard]] fs::path file(const std::string& name) const { return folder_.path() / name; }
  void write(const std::string& name, const std::string& text) const {
    std::ofstream(file(name), std::ios::binary) << text;
  }
  // Returns the JSON output of `penumbra shadow` with these arguments.
  nlohmann::json layers(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "shadow");
    arguments.insert(arguments.end(), {"--output", file("layers.json")});
    const ProgramResult result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    last_warnings_ = result.err;
    return read_json(file("layers.json"));
  }
  TemporaryFolder folder_;
  std::string last_warnings_;
};
class KernelsCommand : public ShadowCommand {};

TEST_F(ShadowCommand, ScalesSquareByLayerFormula) {
  const auto json = layers({file("square.obj"), "--light-height", "0.9", "--light-ratio", "3"});
  EXPECT_EQ(json["H"], 0.9);
  EXPECT_EQ(json["a"], 3.0);
  EXPECT_NEAR(json["umbra_height"].get<double>(), 0.3, 1e-12);
  // Expected factors s = (H + lambda a h) / (H - h) at h = 0.1.
  const std::map<std::string, double> factors = {
      {"umbra", 0.6 / 0.8}, {"middle", 0.9 / 0.8}, {"penumbra", 1.2 / 0.8}};
  ASSERT_EQ(json["layers"].size(), 3U);
  for (const auto& [name, s] : factors) {
    const auto& layer = json["layers"][name];
    EXPECT_NEAR(layer["area"].get<double>(), 0.04 * s * s, 1e-4 * 0.04 * s * s) << name;
    ASSERT_EQ(layer["polygons"].size(), 1U);
    EXPECT_TRUE(layer["polygons"][0]["holes"].is_array());
    EXPECT_TRUE(layer["polygons"][0]["holes"].empty());
    EXPECT_EQ(layer["polygons"][0]["outer"].size(), 4U);
    EXPECT_EQ(layer["polygons"][0]["outer"][0].size(), 2U);
  }
  EXPECT_EQ(json["kernels"]["source"], "auto");
  EXPECT_GE(json["kernels"]["time_ms"].get<double>(), 0.0);
  EXPECT_EQ(json["twisted_faces"], 0);
  EXPECT_EQ(json["twists"]["faces_tested"], 2);
  EXPECT_EQ(json["twists"]["area_share"], 0.0);
  EXPECT_LT(json["twists"]["spill"], 0.01);
}

TEST_F(ShadowCommand, WarnsOfModelWithoutExtent) {
  write("point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\nf 1 3 4\n");
  layers({file("point.obj")});
  const auto lines = lines_of(last_warnings_);
  EXPECT_EQ(std::count_if(lines.begin(), lines.end(),
                          [](const std::string& line) {
                            return line.find("point.obj: casts no shadow: its 2 faces") !=
                                   std::string::npos;
                          }),
            1)
      << last_warnings_;
}

TEST_F(ShadowCommand, ScalesModelAndKernelsByUnit) {
  write("mm.obj", "v -100 -100 100\nv 100 -100 100\nv 100 100 100\nv -100 100 100\nf 1 2 3 4\n");
  const auto in_metres = layers({file("square.obj")});
  EXPECT_EQ(in_metres["warnings"], nlohmann::json::array());
  const auto computed = layers({file("mm.obj"), "--unit", "mm"});
  EXPECT_EQ(computed["warnings"], nlohmann::json::array());
  for (const char* layer : {"umbra", "middle", "penumbra"}) {
    EXPECT_NEAR(computed["layers"][layer]["area"].get<double>(),
                in_metres["layers"][layer]["area"].get<double>(), 1e-8);
  }
  for (const char* kept : {"k.json", "k.glb"}) {
    ASSERT_EQ(
        penumbra({"kernels", file("mm.obj"), "--unit", "mm", "--output", file(kept)}).exit_code, 0);
  }
  const auto stored = layers({file("mm.obj"), "--unit", "mm", "--kernels", file("k.json")});
  EXPECT_EQ(stored["layers"], computed["layers"]);
  EXPECT_EQ(stored["kernels"]["source"], file("k.json").string());
  // Coordinates of a .glb are in metres.
  const auto glb = layers({file("k.glb")});
  EXPECT_EQ(glb["kernels"]["source"], "stored");
  EXPECT_NEAR(glb["layers"]["umbra"]["area"].get<double>(),
              computed["layers"]["umbra"]["area"].get<double>(), 1e-8);
  const ProgramResult wrong = penumbra({"shadow", file("mm.obj"), "--unit", "furlong"});
  EXPECT_EQ(wrong.exit_code, 2);
  EXPECT_THAT(wrong.err, HasSubstr("--unit"));
}

// A square of 0.2 m that rises from 0.1 m to 0.3 m within two seconds ("rise"), or stretches to
// twice its length ("stretch").
std::string animated_square() {
  GltfBuilder file;
  file.node({{"mesh", file.mesh({-0.1F, 0, 0.1F, 0.1F, 0, 0.1F, 0.1F, 0, -0.1F, -0.1F, 0, -0.1F},
                                {0, 1, 2, 0, 2, 3})},
             {"translation", {0, 0.1, 0}}});
  animate(file, 0, "translation", {0, 2}, std::vector<float>{0, 0.1F, 0, 0, 0.3F, 0});
  animate(file, 0, "scale", {0, 2}, std::vector<float>{1, 1, 1, 2, 1, 1}, {.animation = 1});
  file.json["animations"][0]["name"] = "rise";
  file.json["animations"][1]["name"] = "stretch";
  return file.glb();
}

TEST_F(ShadowCommand, ComputesShapeAtTimeOfAnimation) {
  write("square.glb", animated_square());
  const auto area = [this](const std::vector<std::string>& options) {
    std::vector<std::string> arguments = {file("square.glb"), "--light-height", "0.9"};
    arguments.insert(arguments.end(), options.begin(), options.end());
    return layers(arguments)["layers"]["middle"]["area"].get<double>();
  };
  // The middle layer's factor at a height h is H / (H - h).
  const auto expected = [](double h) {
    const double s = 0.9 / (0.9 - h);
    return 0.04 * s * s;
  };
  EXPECT_NEAR(area({}), expected(0.1), 1e-6);
  EXPECT_THAT(last_warnings_, HasSubstr("its animations (2) are not played"));
  EXPECT_NEAR(area({"--animation", "rise", "--time", "1"}), expected(0.2), 1e-6);
  EXPECT_EQ(last_warnings_, "");
  EXPECT_NEAR(area({"--time", "1"}), expected(0.2), 1e-6);
  EXPECT_NEAR(area({"--animation", "rise", "--time", "-1"}), expected(0.1), 1e-6);
  EXPECT_NEAR(area({"--animation", "0", "--time", "100"}), expected(0.3), 1e-6);
  EXPECT_NEAR(area({"--animation", "stretch"}), expected(0.1), 1e-6);
  const auto simple_area = [this](const std::string& animation) {
    return layers({file("square.glb"), "--technique", "simple", "--animation", animation, "--time",
                   "1"})["layers"]["shadow"]["area"]
        .get<double>();
  };
  EXPECT_NEAR(simple_area("0"), 0.04, 1e-8);
  EXPECT_NEAR(simple_area("1"), 0.06, 1e-8);
  EXPECT_NEAR(simple_area("all"), 0.06, 1e-8);
}

TEST_F(ShadowCommand, ListsAnimationsIfNameIsUnknown) {
  write("square.glb", animated_square());
  const ProgramResult unknown =
      penumbra({"shadow", file("square.glb"), "--animation", "rize", "--time", "1"});
  EXPECT_EQ(unknown.exit_code, 1);
  EXPECT_THAT(unknown.err, HasSubstr("square.glb: has no animation \"rize\"; give one of 0 "
                                     "\"rise\", 1 \"stretch\", or all"));
  for (const char* time : {"nan", "inf", "soon", ""}) {
    const ProgramResult wrong = penumbra({"shadow", file("square.glb"), "--time", time});
    EXPECT_EQ(wrong.exit_code, 2) << time;
    EXPECT_THAT(wrong.err, HasSubstr("--time"));
  }
  EXPECT_EQ(penumbra({"shadow", file("square.glb"), "--animation", ""}).exit_code, 2);
  EXPECT_EQ(penumbra({"shadow", file("square.obj"), "--time", "1"}).exit_code, 1);
}

TEST_F(KernelsCommand, MakesKernelsForTimeOfAnimation) {
  write("square.glb", animated_square());
  const std::vector<std::string> pose = {"--animation", "stretch", "--time", "1"};
  std::vector<std::string> kernels = {"kernels", file("square.glb"), "--output", file("k.json")};
  kernels.insert(kernels.end(), pose.begin(), pose.end());
  ASSERT_EQ(penumbra(kernels).exit_code, 0);
  std::vector<std::string> shadow = {file("square.glb"), "--kernels", file("k.json")};
  shadow.insert(shadow.end(), pose.begin(), pose.end());
  const auto stored = layers(shadow);
  EXPECT_EQ(stored["kernels"]["source"], file("k.json").string());
  std::vector<std::string> generated = {file("square.glb")};
  generated.insert(generated.end(), pose.begin(), pose.end());
  EXPECT_EQ(stored["layers"], layers(generated)["layers"]);
  // For another shape, other kernels are computed.
  layers({file("square.glb"), "--kernels", file("k.json")});
  EXPECT_THAT(last_warnings_, HasSubstr("its kernels are computed again"));
  kernels[3] = file("k.glb");
  const ProgramResult glb = penumbra(kernels);
  EXPECT_EQ(glb.exit_code, 2);
  EXPECT_THAT(glb.err, HasSubstr("give a .json file"));
}

TEST_F(ShadowCommand, PrintsWarningsAndWritesThemToJson) {
  write("large.obj", "v 0 0 1\nv 64 0 1\nv 64 64 1\nf 1 2 3\n");
  const auto json = layers({file("large.obj"), "--technique", "simple"});
  ASSERT_EQ(json["warnings"].size(), 1U) << json["warnings"];
  const std::string line = json["warnings"][0];
  EXPECT_THAT(line, HasSubstr("large.obj: is 64 m wide; in millimetres? use --unit mm"));
  EXPECT_THAT(last_warnings_, HasSubstr(line));
  const ProgramResult kernels =
      penumbra({"kernels", file("large.obj"), "--output", file("large.json")});
  EXPECT_EQ(kernels.exit_code, 0);
  EXPECT_THAT(kernels.err, HasSubstr("use --unit mm"));
}

TEST_F(ShadowCommand, PrintsWarningsOfProxy) {
  const std::string square = "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 1 2 3 4\n";
  write("square.obj", square);
  write("proxy.obj", square + "l 1 2\n");
  const auto json = layers({file("square.obj"), "--proxy", file("proxy.obj")});
  EXPECT_THAT(json["warnings"].dump(), HasSubstr("proxy.obj: line 6: lines and points"));
  EXPECT_THAT(last_warnings_, HasSubstr("proxy.obj: line 6: lines and points"));
}

TEST_F(ShadowCommand, ConvertsNamesToUtf8InJson) {
  write("l\xE4tin.obj", "o T\xF6pf\nusemtl gr\xFCn\nv 0 0 1\nv 64 0 1\nv 64 64 1\nf 1 2 3\n");
  const auto json = layers({file("l\xE4tin.obj")});
  ASSERT_FALSE(json["warnings"].empty());
  EXPECT_THAT(json["warnings"].dump(), HasSubstr("l\xC3\xA4tin.obj"));
  for (const char* kept : {"k.json", "k.glb"}) {
    const ProgramResult result =
        penumbra({"kernels", file("l\xE4tin.obj"), "--group", "T*", "--output", file(kept)});
    EXPECT_EQ(result.exit_code, 0) << result.err;
  }
  EXPECT_EQ(layers({file("k.glb")})["kernels"]["source"], "stored");
}

TEST_F(ShadowCommand, CastsShadowsOfVisiblePartsOfCutOuts) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const fs::path cases = shared_dir() / "cases" / "gltf-cut-out-casts-all";
  const auto cut = layers({cases / "alpha_MASK.gltf", "--technique", "simple"});
  EXPECT_NEAR(cut["layers"]["shadow"]["area"].get<double>(), 0.005, 5e-7);
  EXPECT_TRUE(cut["warnings"].empty()) << cut["warnings"];
  const auto field =
      layers({cases / "alpha_MASK.gltf", "--technique", "field", "--pose", "0 0 0.001 0 0 0 1"});
  EXPECT_NEAR(field["layers"]["middle"]["area"].get<double>(), 0.005, 2e-4);
  const auto whole = layers({cases / "alpha_MASK.gltf"});
  EXPECT_THAT(whole["warnings"].dump(), HasSubstr("alphaMode MASK"));
  for (const char* name : {"factor_BLEND.gltf", "factor_MASK.gltf"}) {
    for (const char* technique : {"simple", "layered", "field"}) {
      const auto hidden = layers({cases / name, "--technique", technique});
      for (const auto& layer : hidden["layers"]) EXPECT_EQ(layer["area"], 0.0) << name;
      EXPECT_THAT(last_warnings_, HasSubstr("no face that casts a shadow"));
    }
  }
}

TEST_F(ShadowCommand, DerivesLightConstantsFromAnyOptionPair) {
  EXPECT_EQ(layers({file("square.obj"), "--light-height", "inf", "--umbra-height", "0.3"})["H"],
            "inf");
  auto json = layers({file("square.obj"), "--workspace-height", "0.3", "--magnification", "1.5"});
  EXPECT_NEAR(json["H"].get<double>(), 0.9, 1e-12);
  EXPECT_NEAR(json["a"].get<double>(), 3.0, 1e-12);
  json = layers({file("square.obj"), "--light-height", "1.2", "--umbra-height", "0.4"});
  EXPECT_NEAR(json["a"].get<double>(), 3.0, 1e-12);
  json = layers({file("square.obj"), "--umbra-height", "0.45"});
  EXPECT_EQ(json["H"], 0.9);
  EXPECT_NEAR(json["a"].get<double>(), 2.0, 1e-12);
  json = layers({file("square.obj"), "--light-ratio", "4.5"});
  EXPECT_EQ(json["H"], 0.9);
  EXPECT_NEAR(json["umbra_height"].get<double>(), 0.2, 1e-12);
}

TEST_F(ShadowCommand, RejectsContradictoryOptions) {
  using Words = std::vector<std::string>;
  for (const Words& words :
       {Words{"--light-ratio", "3", "--umbra-height", "0.3"},
        Words{"--light-height", "0.9", "--light-ratio", "3", "--umbra-height", "0.3"},
        Words{"--light-height", "inf"}, Words{"--light-height", "inf", "--light-ratio", "3"},
        Words{"--light-height", "0"}, Words{"--light-ratio", "0"}, Words{"--umbra-height", "-1"},
        Words{"--workspace-height", "0.3"}, Words{"--magnification", "1.5"},
        Words{"--workspace-height", "0.3", "--magnification", "1"},
        Words{"--workspace-height", "0.3", "--magnification", "1.5", "--light-ratio", "3"},
        Words{"--technique", "field", "--kernels", "smooth"},
        Words{"--technique", "cocl", "--kernels", "smooth"}, Words{"--light", "0 0 1 1"},
        Words{"--technique", "hard"}, Words{"--technique", "field", "--proxy", "auto"},
        Words{"--technique", "cocl", "--light-mode", "fixed"}}) {
    Words all = {"shadow", file("square.obj")};
    all.insert(all.end(), words.begin(), words.end());
    const ProgramResult result = penumbra(all);
    EXPECT_EQ(result.exit_code, 2) << words[0] << " " << words[1];
    EXPECT_THAT(result.err, HasSubstr("--")) << words[0];
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  }
}

TEST_F(ShadowCommand, WarnsOfOptionsWithoutEffect) {
  using Words = std::vector<std::string>;
  for (const Words& words :
       {Words{"--kernels", "smooth", "--technique", "simple"},
        Words{"--light-mode", "fixed", "--technique", "simple"},
        Words{"--light-mode", "proportional", "--technique", "field"},
        Words{"--light-height", "2", "--technique", "hard", "--light", "0 0 1 1"},
        Words{"--light-height", "inf", "--technique", "simple"},
        Words{"--umbra-height", "0.2", "--technique", "simple"},
        Words{"--show-kernels", "--technique", "field"}, Words{"--show-kernels"}}) {
    Words all = {file("square.obj")};
    all.insert(all.end(), words.begin(), words.end());
    layers(all);
    EXPECT_THAT(last_warnings_, HasSubstr(words[0]));
    EXPECT_EQ(lines_of(last_warnings_).size(), 1U) << last_warnings_;
  }
  for (const Words& words :
       {Words{"--kernels", "smooth"}, Words{"--light-mode", "fixed"},
        Words{"--light-mode", "fixed", "--technique", "field"}, Words{"--light-height", "2"}}) {
    Words all = {file("square.obj")};
    all.insert(all.end(), words.begin(), words.end());
    layers(all);
    EXPECT_EQ(last_warnings_, "") << words[0];
  }
}

TEST_F(ShadowCommand, ReportsOptionOfInvalidLight) {
  for (const auto& [option, number] : {std::pair{"--light-ratio", "inf"},
                                       {"--umbra-height", "inf"},
                                       {"--light-ratio", "1e40"},
                                       {"--umbra-height", "1e-40"},
                                       {"--light-height", "4e38"},
                                       {"--light-height", "1e-300"}}) {
    const ProgramResult result = penumbra({"shadow", file("square.obj"), option, number});
    EXPECT_EQ(result.exit_code, 2) << option << " " << number;
    EXPECT_THAT(result.err, HasSubstr(option)) << number;
  }
}

TEST_F(ShadowCommand, AppliesPoseAndPlane) {
  // First at the height where the umbra vanishes, then rotated together with the plane's normal.
  auto json = layers({file("square.obj"), "--pose", "0 0 0.2 0 0 0 1"});
  EXPECT_EQ(json["layers"]["umbra"]["area"], 0.0);
  EXPECT_EQ(json["layers"]["umbra"]["polygons"], nlohmann::json::array());
  json = layers({file("square.obj"), "--plane", "-1 0 0 0.5 0 0", "--pose",
                 "0.4 0 0 0 -0.7071067811865476 0 0.7071067811865476"});
  EXPECT_NEAR(json["layers"]["middle"]["area"].get<double>(), 0.04 * std::pow(0.9 / 0.7, 2), 1e-5);
}

TEST_F(ShadowCommand, KeepsAreaFarFromOriginAndAtAnySize) {
  // The square's shadow has the same area 100 m from the origin.
  const auto here = layers({file("square.obj")});
  const auto there =
      layers({file("square.obj"), "--plane", "0 0 1 70 -60 100", "--pose", "70 -60 100 0 0 0 1"});
  for (const char* name : {"umbra", "middle", "penumbra"}) {
    EXPECT_NEAR(there["layers"][name]["area"].get<double>(),
                here["layers"][name]["area"].get<double>(), 1e-7)
        << name;
  }
  // A motion along the plane must move the outlines with the model and keep their area.
  const std::string helicopter = (source_dir() / "scenes" / "models" / "helicopter.glb").string();
  for (const std::string technique : {"layered", "field", "simple"}) {
    const auto near = layers({helicopter, "--technique", technique, "--pose", "0 0 0.1 0 0 0 1"});
    for (const double d : {100.0, 1e4}) {
      const auto far = layers({helicopter, "--technique", technique, "--pose",
                               fmt::format("{} {} 0.1 0 0 0 1", d, -3.0 * d)});
      for (const auto& [name, layer] : near["layers"].items()) {
        const auto& other = far["layers"][name];
        EXPECT_NEAR(other["area"].get<double>() / layer["area"].get<double>(), 1.0, 1e-5)
            << technique << " " << name << " " << d;
        ASSERT_EQ(other["polygons"].size(), layer["polygons"].size());
        double low = 1e9, high = -1e9, far_low = 1e9, far_high = -1e9;
        for (std::size_t i = 0; i < layer["polygons"].size(); ++i) {
          for (const auto& p : layer["polygons"][i]["outer"]) {
            low = std::min(low, p[0].get<double>());
            high = std::max(high, p[0].get<double>());
          }
          for (const auto& p : other["polygons"][i]["outer"]) {
            far_low = std::min(far_low, p[0].get<double>());
            far_high = std::max(far_high, p[0].get<double>());
          }
        }
        EXPECT_NEAR(far_low - d, low, 1e-6);
        EXPECT_NEAR(far_high - d, high, 1e-6);
      }
    }
  }
  for (const double size : {1e-3, 1e5}) {  // 0.2 mm, 20 km
    const auto number = [size](double x) { return fmt::format(" {:.9g}", x * size); };
    std::string obj;
    for (const auto& [x, y] : {std::pair{-0.1, -0.1}, {0.1, -0.1}, {0.1, 0.1}, {-0.1, 0.1}})
      obj += "v" + number(x) + number(y) + number(0.1) + "\n";
    write("sized.obj", obj + "f 1 2 3\nf 1 3 4\n");
    const auto sized = layers({file("sized.obj"), "--light-height", fmt::format("{}", 0.9 * size)});
    for (const char* name : {"umbra", "middle", "penumbra"}) {
      EXPECT_NEAR(sized["layers"][name]["area"].get<double>() / (size * size),
                  here["layers"][name]["area"].get<double>(), 1e-4)
          << size << " " << name;
    }
  }
}

TEST_F(ShadowCommand, WritesOneLayerForSimpleAndHard) {
  auto json = layers({file("square.obj"), "--technique", "simple"});
  ASSERT_EQ(json["layers"].size(), 1U);
  EXPECT_NEAR(json["layers"]["shadow"]["area"].get<double>(), 0.04, 1e-8);
  json = layers({file("square.obj"), "--technique", "hard", "--light", "0 0 0.5 1"});
  ASSERT_EQ(json["layers"].size(), 1U);
  EXPECT_NEAR(json["layers"]["shadow"]["area"].get<double>(), 0.04 * std::pow(0.5 / 0.4, 2), 1e-7);
  json = layers({file("square.obj"), "--technique", "hard", "--light", "0 0 -1 1"});
  EXPECT_EQ(json["layers"]["shadow"]["area"], 0.0);
  EXPECT_THAT(last_warnings_, HasSubstr("warn"));
}

TEST_F(ShadowCommand, ReportsWhyShadowIsMissing) {
  const std::string cube = (source_dir() / "scenes" / "models" / "cube.glb").string();
  const auto lifted = [&](const char* z, const char* technique = "layered") {
    return layers({cube, "--technique", technique, "--pose", fmt::format("0 0 {} 0 0 0 1", z)});
  };
  for (const char* technique : {"layered", "field"}) {
    lifted("0.1", technique);
    EXPECT_EQ(last_warnings_, "") << technique;
    lifted("0.28", technique);  // the umbra is missing, so its number is empty
    EXPECT_EQ(last_warnings_, "") << technique;
    EXPECT_EQ(lifted("2", technique)["layers"]["penumbra"]["area"], 0.0);
    EXPECT_THAT(last_warnings_, HasSubstr("too high")) << technique;
    EXPECT_GT(lifted("0.76", technique)["layers"]["penumbra"]["area"], 0.0);
    EXPECT_THAT(last_warnings_, HasSubstr("reaches to")) << technique;
  }
  for (const char* technique : {"layered", "field", "simple"}) {
    lifted("-1", technique);
    EXPECT_THAT(last_warnings_, HasSubstr("under the plane")) << technique;
  }
  lifted("2", "simple");
  EXPECT_EQ(last_warnings_, "");
  // Far away along the plane, the shadow is the same.
  EXPECT_GT(layers({cube, "--pose", "1e8 0 0.1 0 0 0 1"})["layers"]["umbra"]["area"], 0.0);
  EXPECT_EQ(last_warnings_, "");
  // The light is between the object's bottom and top, or below both.
  const auto lit = [&](const char* light) {
    return layers({cube, "--technique", "hard", "--light", light, "--pose", "0 0 0.2 0 0 0 1"});
  };
  EXPECT_GT(lit("0 0 0.8 1")["layers"]["shadow"]["area"], 0.0);
  EXPECT_EQ(last_warnings_, "");
  EXPECT_GT(lit("0.3 0 0.22 1")["layers"]["shadow"]["area"], 0.0);
  EXPECT_THAT(last_warnings_, HasSubstr("above the light casts nothing"));
  EXPECT_EQ(lit("0.3 0 0.1 1")["layers"]["shadow"]["area"], 0.0);
  EXPECT_THAT(last_warnings_, HasSubstr("no shadow"));
  lit("0 0 1 0");  // a light at infinity is above every object
  EXPECT_EQ(last_warnings_, "");
  // A card that is edge-on to the plane.
  write("card.obj", "v 0 0 0.1\nv 0 0.1 0.1\nv 0 0.1 0.2\nf 1 2 3\n");
  layers({file("card.obj")});
  EXPECT_THAT(last_warnings_, HasSubstr("no layer"));
}

// In contact the layers coincide and the shadow is complete, so there is no warning.
TEST_F(ShadowCommand, AcceptsContactShadowWithoutWarning) {
  const std::string square = file("square.obj");
  for (const char* technique : {"layered", "simple"}) {
    const auto json = layers({square, "--technique", technique, "--pose", "0 0 -0.1 0 0 0 1"});
    EXPECT_EQ(last_warnings_, "") << technique;
    for (const auto& [name, layer] : json["layers"].items()) {
      EXPECT_NEAR(layer["area"].get<double>(), 0.04, 1e-6) << name;
    }
  }
  layers({square, "--pose", "0 0 -0.11 0 0 0 1"});
  EXPECT_THAT(last_warnings_, HasSubstr("under the plane"));
}

TEST_F(ShadowCommand, WarnsOfObjectAboveWorkspace) {
  const auto at = [this](const char* height) {
    layers({file("square.obj"), "--workspace-height", "0.3", "--magnification", "1.5", "--pose",
            std::string("0 0 ") + height + " 0 0 0 1"});
    return last_warnings_;
  };
  EXPECT_EQ(at("0.2"), "") << "a top at the workspace height needs no warning";
  EXPECT_THAT(at("0.25"), HasSubstr("--workspace-height 0.3"));
  // If the light is no larger than the object, an umbra exists at every height.
  const ProgramResult table = penumbra({"shadow", file("square.obj"), "--light-ratio", "0.5"});
  EXPECT_THAT(table.out, HasSubstr("the umbra never vanishes"));
  EXPECT_THAT(table.out, testing::Not(HasSubstr("vanishes at")));
}

TEST_F(ShadowCommand, WritesSvgAndTable) {
  const std::string ring = (source_dir() / "scenes" / "models" / "ring.glb").string();
  EXPECT_EQ(penumbra({"shadow", ring, "--show-kernels", "--output", file("ring.svg")}).exit_code,
            0);
  const std::string svg = bytes_of(file("ring.svg"));
  for (const char* part : {"<svg", "id=\"umbra\"", "id=\"middle\"", "id=\"penumbra\"",
                           "id=\"object\"", "id=\"kernels\"", "<circle", "</svg>"}) {
    EXPECT_THAT(svg, HasSubstr(part));
  }
  // The SVG's title names model and technique.
  EXPECT_THAT(svg, HasSubstr(">ring, layered shadow<"));
  EXPECT_THAT(svg, HasSubstr(">H = 0.9 m, a = 3<"));
  for (const auto& [words, title] : std::vector<std::pair<std::vector<std::string>, std::string>>{
           {{"--technique", "cocl"}, "ring, COCL shadow"},
           {{"--technique", "field"}, "ring, field shadow"},
           {{"--technique", "simple"}, "ring, simple shadow"},
           {{"--technique", "hard", "--light", "0 0 1 0"}, "ring, hard shadow"},
           {{"--kernels", "smooth"}, "ring, layered shadow, smooth kernels"},
           {{"--light-mode", "fixed"}, "ring, layered shadow, one light"}}) {
    std::vector<std::string> arguments = {"shadow", ring, "--output", file("one.svg")};
    arguments.insert(arguments.end(), words.begin(), words.end());
    EXPECT_EQ(penumbra(arguments).exit_code, 0);
    EXPECT_THAT(bytes_of(file("one.svg")), HasSubstr(">" + title + "<"));
  }
  EXPECT_EQ(penumbra({"shadow", ring, "--output", file("ring.png")}).exit_code, 0);
  EXPECT_TRUE(bytes_of(file("ring.png")).starts_with("\x89PNG"));
  const ProgramResult table = penumbra({"shadow", ring});
  EXPECT_EQ(table.exit_code, 0);
  for (const char* part : {"umbra", "middle", "penumbra", "area", "twisted"}) {
    EXPECT_THAT(table.out, HasSubstr(part));
  }
}

TEST_F(ShadowCommand, UsesStoredKernelsUntilModelChanges) {
  for (const std::string& model :
       {file("square.obj").string(),
        (source_dir() / "scenes" / "models" / "helicopter.glb").string()}) {
    SCOPED_TRACE(model);
    const auto fresh = layers({model});
    for (const char* kept : {"kept.json", "kept.glb"}) {
      EXPECT_EQ(penumbra({"kernels", model, "--output", file(kept)}).exit_code, 0);
    }
    const auto from_glb = layers({file("kept.glb")});
    EXPECT_EQ(from_glb["kernels"]["source"], "stored");
    EXPECT_NEAR(from_glb["layers"]["umbra"]["area"].get<double>(),
                fresh["layers"]["umbra"]["area"].get<double>(), 1e-8);
    const auto from_json = layers({model, "--kernels", file("kept.json")});
    EXPECT_NEAR(from_json["layers"]["umbra"]["area"].get<double>(),
                fresh["layers"]["umbra"]["area"].get<double>(), 1e-8);
    // Kernels for another tilt must not be used.
    EXPECT_EQ(
        layers({file("kept.glb"), "--pose", "0 0 0 0.1 0 0 0.99498743710662"})["kernels"]["source"],
        "auto");
  }
  ASSERT_EQ(penumbra({"kernels", file("square.obj"), "--output", file("kept.json")}).exit_code, 0);
  std::string changed = kSquare;
  changed.replace(changed.find("0.1 0.1 0.1"), 11, "0.3 0.1 0.1");
  write("square.obj", changed);
  EXPECT_EQ(layers({file("square.obj"), "--kernels", file("kept.json")})["kernels"]["source"],
            "auto");
  EXPECT_THAT(last_warnings_, HasSubstr("changed"));
}

TEST_F(ShadowCommand, RecomputesKernelsWithoutThicknessForFixedLight) {
  const std::string ring = (source_dir() / "scenes" / "models" / "ring.glb").string();
  const std::vector<std::string> light = {"--pose", "0 0 0.1 0 0 0 1", "--light-mode", "fixed"};
  const auto with = [&](std::vector<std::string> words) {
    words.insert(words.end(), light.begin(), light.end());
    return layers(words);
  };
  const auto fresh = with({ring});
  for (const char* kept : {"kept.glb", "kept.json"}) {
    ASSERT_EQ(penumbra({"kernels", ring, "--kernels", "cocl", "--output", file(kept)}).exit_code,
              0);
  }
  EXPECT_EQ(with({file("kept.glb")})["layers"], fresh["layers"]);
  EXPECT_THAT(last_warnings_, HasSubstr("cocl"));
  EXPECT_EQ(with({ring, "--kernels", file("kept.json")})["layers"], fresh["layers"]);
  EXPECT_THAT(last_warnings_, HasSubstr("cocl"));
  // The proportional light mode needs no thickness, so it uses the stored kernels.
  EXPECT_EQ(layers({file("kept.glb")})["kernels"]["source"], "stored");
  EXPECT_EQ(last_warnings_, "");
}

TEST_F(ShadowCommand, DetectsModelChangedAfterKernelsWereStored) {
  for (const std::string& model :
       {file("square.obj").string(),
        (source_dir() / "scenes" / "models" / "helicopter.glb").string()}) {
    SCOPED_TRACE(model);
    ASSERT_EQ(penumbra({"kernels", model, "--output", file("kept.glb")}).exit_code, 0);
    EXPECT_EQ(layers({file("kept.glb")})["kernels"]["source"], "stored");
    // Simulates an editor that keeps unknown attributes and moves one coordinate by a centimetre.
    std::string glb = bytes_of(file("kept.glb"));
    const auto word = [&glb](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, glb.data() + at, sizeof value);
      return std::size_t{value};
    };
    const std::size_t json_size = word(12);
    const auto json = nlohmann::json::parse(glb.substr(20, json_size));
    const auto& accessor =
        json["accessors"]
            [json["meshes"][0]["primitives"][0]["attributes"]["POSITION"].get<std::size_t>()];
    const auto& view = json["bufferViews"][accessor["bufferView"].get<std::size_t>()];
    const std::size_t at = 20 + json_size + 8 + view.value("byteOffset", std::size_t{0}) +
                           accessor.value("byteOffset", std::size_t{0});
    float x = 0.0F;
    std::memcpy(&x, glb.data() + at, sizeof x);
    x += 0.01F;
    std::memcpy(glb.data() + at, &x, sizeof x);
    write("kept.glb", glb);
    EXPECT_EQ(layers({file("kept.glb")})["kernels"]["source"], "auto");
    EXPECT_THAT(last_warnings_, HasSubstr("kept.glb"));
    EXPECT_THAT(last_warnings_, HasSubstr("changed"));
  }
}

TEST_F(KernelsCommand, PrintsOneLine) {
  const ProgramResult result = penumbra({"kernels", source_dir() / "scenes/models/tree.glb",
                                         "--kernels", "per-axis", "--output", file("k.json")});
  EXPECT_EQ(result.exit_code, 0);
  EXPECT_EQ(result.err, "");
  EXPECT_EQ(lines_of(result.out).size(), 1U) << result.out;
}

// Two nodes use one mesh, so each vertex has two positions, but the file holds one kernel per
// vertex.
TEST_F(KernelsCommand, StoresKernelsForBothNodesOfSharedMesh) {
  const auto scene = [](const std::string& nodes) {
    // Vertices (0 0 0), (0.1 0 0), (0 0 0.1) and their face.
    return R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":)" + nodes +
           R"(}],"nodes":[{"mesh":0},{"mesh":0,"translation":[0.3,0.1,0]}],)"
           R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],)"
           R"("accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3",)"
           R"("min":[0,0,0],"max":[0.1,0,0.1]},)"
           R"({"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],)"
           R"("bufferViews":[{"buffer":0,"byteLength":36},)"
           R"({"buffer":0,"byteOffset":36,"byteLength":6}],)"
           R"("buffers":[{"byteLength":42,"uri":"data:application/octet-stream;base64,)"
           R"(AAAAAAAAAAAAAAAAzczMPQAAAAAAAAAAAAAAAAAAAADNzMw9AAABAAIA"}]})";
  };
  write("once.gltf", scene("[0]"));
  write("twice.gltf", scene("[0,1]"));
  ASSERT_EQ(penumbra({"kernels", file("once.gltf"), "--output", file("k.json")}).exit_code, 0);
  const auto computed = layers({file("twice.gltf")});
  ASSERT_EQ(penumbra({"kernels", file("twice.gltf"), "--output", file("t.json")}).exit_code, 0);
  ASSERT_EQ(penumbra({"kernels", file("twice.gltf"), "--output", file("t.glb")}).exit_code, 0);
  const auto with_file = layers({file("twice.gltf"), "--kernels", file("t.json")});
  const auto stored = layers({file("t.glb")});
  EXPECT_EQ(stored["kernels"]["source"], "stored");
  for (const char* layer : {"umbra", "middle", "penumbra"}) {
    const double area = computed["layers"][layer]["area"];
    EXPECT_NEAR(with_file["layers"][layer]["area"].get<double>(), area, 1e-6 * area) << layer;
    EXPECT_NEAR(stored["layers"][layer]["area"].get<double>(), area, 1e-6 * area) << layer;
  }
  // Kernels for one use of the mesh must be rejected for two uses, even without hashes.
  auto kernels = read_json(file("k.json"));
  kernels.erase("geometry");
  kernels.erase("vertex_order");
  write("k.json", kernels.dump());
  EXPECT_EQ(penumbra({"shadow", file("once.gltf"), "--kernels", file("k.json")}).exit_code, 0);
  expect_failure(penumbra({"shadow", file("twice.gltf"), "--kernels", file("k.json")}),
                 {"k.json", "3 triples", "6 vertices"});
}

TEST_F(ShadowCommand, TreatsGroupAsOnePart) {
  // Two adjacent tiles without a shared vertex.
  write("tiles.obj",
        "o left\nv -0.1 0 0.1\nv 0 0 0.1\nv 0 0.1 0.1\nv -0.1 0.1 0.1\nf 1 2 3\nf 1 3 4\n"
        "o right\nv 0 -0.02 0.1\nv 0.1 -0.02 0.1\nv 0.1 0.08 0.1\nv 0 0.08 0.1\nf 5 6 7\n"
        "f 5 7 8\n");
  const std::string tiles = file("tiles.obj");
  const auto pieces = [](const nlohmann::json& json) {
    return json["layers"]["umbra"]["polygons"].size();
  };
  EXPECT_EQ(pieces(layers({tiles})), 2U);
  EXPECT_EQ(pieces(layers({tiles, "--group", "all"})), 1U);
  EXPECT_EQ(pieces(layers({tiles, "--group", "left", "--group", "right"})), 2U);
  EXPECT_EQ(pieces(layers({tiles, "--group", "*t"})), 1U);
  expect_failure(penumbra({"shadow", tiles, "--group", "tower"}),
                 {"tiles.obj", "tower", "left, right"});
  // Stored kernels must keep the group.
  ASSERT_EQ(penumbra({"kernels", tiles, "--group", "all", "--output", file("tiles.glb")}).exit_code,
            0);
  EXPECT_EQ(pieces(layers({file("tiles.glb")})), 1U);
}

// A grouped wall of bricks with usual joints must count as thick as the wall, not as a brick. Its
// umbra is connected and extends across the joints.
TEST_F(ShadowCommand, MeasuresGroupThicknessAcrossJoints) {
  std::string wall;
  int vertices = 0;
  const auto brick = [&](double x, double y, double width, double height) {
    wall += fmt::format("o brick{}\n", vertices / 4);
    for (const auto& [dx, dy] : {std::pair(0.0, 0.0), {width, 0.0}, {width, height}, {0.0, height}})
      wall += fmt::format("v {} {} 0.1\n", x + dx, y + dy);
    const int v = vertices;
    wall += fmt::format("f {} {} {} {}\n", v + 1, v + 2, v + 3, v + 4);
    vertices += 4;
  };
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 5; ++column) brick(0.021 * column, 0.011 * row, 0.020, 0.010);
  }
  write("wall.obj", wall);
  // Height of the umbra, including the joints.
  const auto height = [&](const std::vector<std::string>& words) {
    double low = 1.0;
    double high = 0.0;
    const auto json = layers(words);
    for (const auto& polygon : json["layers"]["umbra"]["polygons"]) {
      for (const auto& point : polygon["outer"]) {
        low = std::min(low, point[1].get<double>());
        high = std::max(high, point[1].get<double>());
      }
    }
    return high - low;
  };
  // A plate of the wall's size.
  write("plate.obj", "v 0 0 0.1\nv 0.104 0 0.1\nv 0.104 0.043 0.1\nv 0 0.043 0.1\nf 1 2 3 4\n");
  const double plate = height({file("plate.obj")});
  EXPECT_NEAR(height({file("wall.obj"), "--group", "brick*"}), plate, 0.03 * plate);
  EXPECT_GT(height({file("wall.obj")}), 1.1 * plate);
  // A light as wide as the wall would shine through the joints, so a field would have no umbra.
  const auto field = [&](const std::vector<std::string>& more) {
    std::vector<std::string> words = {file("wall.obj"), "--technique", "field"};
    words.insert(words.end(), more.begin(), more.end());
    return height(words);
  };
  EXPECT_GT(field({"--group", "brick*"}), plate);
}

TEST_F(ShadowCommand, RecomputesStoredKernelsOfOtherGroups) {
  write("tiles.obj",
        "o left\nv -0.1 0 0.1\nv 0 0 0.1\nv 0 0.1 0.1\nv -0.1 0.1 0.1\nf 1 2 3\nf 1 3 4\n"
        "o right\nv 0 -0.02 0.1\nv 0.1 -0.02 0.1\nv 0.1 0.08 0.1\nv 0 0.08 0.1\nf 5 6 7\n"
        "f 5 7 8\n");
  const std::string tiles = file("tiles.obj");
  const auto umbra = [](const nlohmann::json& json) {
    return json["layers"]["umbra"]["area"].get<double>();
  };
  const double loose = umbra(layers({tiles}));
  const double whole = umbra(layers({tiles, "--group", "all"}));
  ASSERT_GT(std::abs(loose - whole), 1e-5);
  for (const std::string extension : {"glb", "json"}) {
    const std::string kept = file("kept." + extension);
    const auto with = [&](std::vector<std::string> more) {
      std::vector<std::string> words = {extension == "glb" ? kept : tiles};
      if (extension == "json") words.insert(words.end(), {"--kernels", kept});
      words.insert(words.end(), more.begin(), more.end());
      return layers(words);
    };
    ASSERT_EQ(penumbra({"kernels", tiles, "--output", kept}).exit_code, 0);
    auto json = with({"--group", "all"});
    EXPECT_NEAR(umbra(json), whole, 1e-8);
    EXPECT_EQ(json["kernels"]["source"], "auto");
    EXPECT_THAT(last_warnings_, HasSubstr("other parts"));
    // A group of a single part changes nothing. Storing the model again must keep its names.
    json = with({"--group", "left"});
    EXPECT_NEAR(umbra(json), loose, 1e-8);
    EXPECT_NE(json["kernels"]["source"], "auto");
    EXPECT_EQ(last_warnings_, "");
    ASSERT_EQ(penumbra({"kernels", tiles, "--group", "all", "--output", kept}).exit_code, 0);
    json = with({"--group", "all"});
    EXPECT_NEAR(umbra(json), whole, 1e-8);
    EXPECT_NE(json["kernels"]["source"], "auto");
    EXPECT_EQ(last_warnings_, "");
    EXPECT_NEAR(umbra(with({"--group", "left"})), loose, 1e-8);
    EXPECT_THAT(last_warnings_, HasSubstr("other parts"));
  }
}

// A model with stored kernels keeps their groups and kind: for another tilt, new kernels of the
// same groups and kind are generated.
TEST_F(ShadowCommand, KeepsStoredGroupsAndKindForOtherTilts) {
  write("tiles.obj",
        "o left\nv -0.1 0 0.1\nv 0 0 0.1\nv 0 0.1 0.1\nv -0.1 0.1 0.1\nf 1 2 3\nf 1 3 4\n"
        "o right\nv 0 -0.02 0.1\nv 0.1 -0.02 0.1\nv 0.1 0.08 0.1\nv 0 0.08 0.1\nf 5 6 7\n"
        "f 5 7 8\n");
  const std::string tiles = file("tiles.obj");
  const std::vector<std::string> tilt = {"--pose", "0 0 0.02 0.1 0 0 0.99498743710662"};
  const auto tilted = [&](std::vector<std::string> words) {
    words.insert(words.end(), tilt.begin(), tilt.end());
    return layers(words);
  };
  const auto loose = tilted({tiles});
  const auto whole = tilted({tiles, "--group", "all"});
  ASSERT_NE(loose["layers"], whole["layers"]);
  ASSERT_EQ(penumbra({"kernels", tiles, "--group", "all", "--output", file("kept.glb")}).exit_code,
            0);
  auto kept = tilted({file("kept.glb")});
  EXPECT_EQ(kept["kernels"]["source"], "auto");
  EXPECT_EQ(kept["layers"], whole["layers"]);
  EXPECT_EQ(tilted({file("kept.glb"), "--group", "left"})["layers"], loose["layers"])
      << "--group must replace the stored groups";
  // Storing without --group removes the groups.
  ASSERT_EQ(penumbra({"kernels", file("kept.glb"), "--output", file("kept.glb")}).exit_code, 0);
  EXPECT_EQ(tilted({file("kept.glb")})["layers"], loose["layers"]);

  for (const char* kind : {"smooth", "per-axis", "cocl"}) {
    const auto computed = tilted({tiles, "--group", "all", "--kernels", kind});
    ASSERT_EQ(penumbra({"kernels", tiles, "--group", "all", "--kernels", kind, "--output",
                        file("kept.glb")})
                  .exit_code,
              0);
    kept = tilted({file("kept.glb")});
    EXPECT_EQ(kept["kernels"]["source"], kind);
    EXPECT_EQ(kept["layers"], computed["layers"]) << kind;
  }
}

TEST_F(KernelsCommand, WritesGroupsToKernelFile) {
  const std::string square = file("square.obj");
  ASSERT_EQ(penumbra({"kernels", square, "--group", "all", "--output", file("k.json")}).exit_code,
            0);
  auto json = nlohmann::json::parse(bytes_of(file("k.json")));
  EXPECT_EQ(json["groups"], nlohmann::json({"all"}));
  for (const auto& wrong : {nlohmann::json("all"), nlohmann::json({"all", 3}),
                            nlohmann::json(std::vector<std::string>(1001, "all"))}) {
    json["groups"] = wrong;
    write("wrong.json", json.dump());
    expect_failure(penumbra({"shadow", square, "--kernels", file("wrong.json")}),
                   {"wrong.json", "groups"});
  }
}

// No object on a table has kernels that are a thousand kilometres away. Such kernels come from a
// file in millimetres or from a faulty writer.
TEST_F(ShadowCommand, RejectsImplausiblyFarKernels) {
  const std::string square = file("square.obj");
  ASSERT_EQ(penumbra({"kernels", square, "--output", file("k.json")}).exit_code, 0);
  auto json = nlohmann::json::parse(bytes_of(file("k.json")));
  json["kernels"][4] = -1e9;
  write("far.json", json.dump());
  expect_failure(penumbra({"shadow", square, "--kernels", file("far.json")}),
                 {"far.json", "kernels[4]", "-1e+09 m"});
}

TEST_F(ShadowCommand, ReadsStoredKernelsWithOtherUpAxis) {
  const std::string model = (source_dir() / "scenes" / "models" / "l_shape.glb").string();
  ASSERT_EQ(penumbra({"kernels", model, "--up", "0,-1,0", "--output", file("kept.glb")}).exit_code,
            0);
  EXPECT_EQ(layers({file("kept.glb"), "--up", "z"})["kernels"]["source"], "stored");
  EXPECT_EQ(last_warnings_, "");
}

TEST_F(KernelsCommand, KeepsPartNamesInRewrittenModel) {
  // Two groups that share an edge and alternate in material, and a third group.
  write("house.mtl", "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n");
  write("house.obj",
        "mtllib house.mtl\nv -0.1 0 0.1\nv 0 0 0.1\nv 0 0.1 0.1\nv -0.1 0.1 0.1\n"
        "v 0.1 0 0.1\nv 0.1 0.1 0.1\nv 0.3 0 0.1\nv 0.4 0 0.1\nv 0.4 0.1 0.1\n"
        "o wall 1\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\n"
        "o wall 2\nusemtl red\nf 2 5 6\nusemtl blue\nf 2 6 3\no tower\nf 7 8 9\n");
  const auto same = [this](const std::vector<std::string>& words) {
    std::vector<std::string> of_obj = {file("house.obj")};
    std::vector<std::string> of_glb = {file("house.glb")};
    of_obj.insert(of_obj.end(), words.begin(), words.end());
    of_glb.insert(of_glb.end(), words.begin(), words.end());
    const auto first = layers(of_obj);
    const auto second = layers(of_glb);
    for (const char* layer : {"umbra", "middle", "penumbra"}) {
      EXPECT_NEAR(first["layers"][layer]["area"].get<double>(),
                  second["layers"][layer]["area"].get<double>(), 1e-8)
          << layer;
    }
    return second["kernels"]["source"].get<std::string>();
  };
  ASSERT_EQ(penumbra({"kernels", file("house.obj"), "--output", file("house.glb")}).exit_code, 0);
  EXPECT_EQ(same({}), "stored");
  EXPECT_EQ(last_warnings_, "");
  EXPECT_EQ(same({"--group", "all"}), "auto");
  EXPECT_EQ(same({"--group", "wall *"}), "stored");  // the walls form one part without the option
  EXPECT_EQ(same({"--group", "wall 1", "--group", "tower"}), "stored");
  EXPECT_EQ(same({"--group", "t*", "--group", "wall 2"}), "stored");
  expect_failure(penumbra({"shadow", file("house.glb"), "--group", "roof"}),
                 {"house.glb", "roof", "wall 1, wall 2, tower"});
}

TEST_F(KernelsCommand, ReplacesStoredKernels) {
  const std::string model = (source_dir() / "scenes" / "models" / "helicopter.glb").string();
  ASSERT_EQ(penumbra({"kernels", model, "--output", file("one.glb")}).exit_code, 0);
  ASSERT_EQ(penumbra({"kernels", file("one.glb"), "--kernels", "smooth", "--up", "0,0.3,1",
                      "--output", file("two.glb")})
                .exit_code,
            0);
  ASSERT_EQ(penumbra({"kernels", file("two.glb"), "--output", file("three.glb")}).exit_code, 0);
  EXPECT_GT(bytes_of(file("one.glb")).size(), bytes_of(model).size());
  EXPECT_NE(bytes_of(file("one.glb")), bytes_of(file("two.glb")));
  EXPECT_EQ(bytes_of(file("one.glb")), bytes_of(file("three.glb")));
  EXPECT_EQ(layers({file("three.glb")})["kernels"]["source"], "stored");
}

// Tools that merge equal data may store a position and a kernel in the same bytes. Replacing
// kernels must not change the positions.
TEST_F(KernelsCommand, KeepsSharedDataWhenReplacingKernels) {
  ASSERT_EQ(penumbra({"kernels", file("square.obj"), "--output", file("one.glb")}).exit_code, 0);
  const std::string glb = bytes_of(file("one.glb"));
  const auto word = [](const std::string& bytes, std::size_t at) {
    std::uint32_t value = 0;
    std::memcpy(&value, bytes.data() + at, sizeof value);
    return std::size_t{value};
  };
  const std::size_t json_size = word(glb, 12);
  auto json = nlohmann::json::parse(glb.substr(20, json_size));
  auto& attributes = json["meshes"][0]["primitives"][0]["attributes"];
  attributes["_SHADOW_KERNEL"] = attributes["POSITION"];
  std::string text = json.dump();
  ASSERT_LE(text.size(), json_size);
  text.resize(json_size, ' ');
  write("shared.glb", glb.substr(0, 20) + text + glb.substr(20 + json_size));
  ASSERT_EQ(penumbra({"kernels", file("shared.glb"), "--output", file("again.glb")}).exit_code, 0);
  const auto simple = [this](const char* name) {
    return layers({file(name), "--technique", "simple"})["layers"]["shadow"]["area"].get<double>();
  };
  EXPECT_GT(simple("one.glb"), 0.01);
  EXPECT_EQ(simple("again.glb"), simple("one.glb"));
  EXPECT_EQ(layers({file("again.glb")})["kernels"]["source"], "stored");
  EXPECT_EQ(last_warnings_, "");
}

TEST_F(KernelsCommand, WritesKernelsForSinglePoint) {
  write("point.obj", "v 0.1 0.2 0.3\nf 1 1 1\n");
  ASSERT_EQ(penumbra({"kernels", file("point.obj"), "--output", file("point.json")}).exit_code, 0);
  const auto kernels = read_json(file("point.json"))["kernels"];
  ASSERT_EQ(kernels.size(), 3U);
  EXPECT_NEAR(kernels[0].get<double>(), 0.1, 1e-6);
  EXPECT_NEAR(kernels[1].get<double>(), 0.2, 1e-6);
  EXPECT_NEAR(kernels[2].get<double>(), 0.3, 1e-6);
  ASSERT_EQ(penumbra({"kernels", file("point.obj"), "--output", file("point.glb")}).exit_code, 0);
  EXPECT_EQ(layers({file("point.glb")})["layers"]["penumbra"]["area"].get<double>(), 0.0);
  const auto json = layers({file("point.obj")});
  EXPECT_EQ(json["layers"]["penumbra"]["area"].get<double>(), 0.0);
  EXPECT_THAT(last_warnings_, HasSubstr("casts no shadow: its 1 faces have no area"));
}

TEST_F(ShadowCommand, ReportsProxyAgreement) {
  const std::string models = source_dir() / "scenes" / "models";
  const auto plain = layers({models + "/tree.glb", "--pose", "0 0 0.05 0 0 0 1"});
  EXPECT_FALSE(plain.contains("proxy"));
  const auto with = layers({models + "/tree.glb", "--pose", "0 0 0.05 0 0 0 1", "--proxy", "auto"});
  const auto& proxy = with["proxy"];
  EXPECT_LT(proxy["faces"], 0.75 * proxy["of_faces"].get<double>());
  ASSERT_EQ(proxy["heights"].size(), 2U);
  double min_iou = 1.0;
  for (const auto& height : proxy["heights"]) {
    for (const char* layer : {"umbra", "middle", "penumbra"}) {
      min_iou = std::min(min_iou, height["iou"][layer].get<double>());
    }
  }
  EXPECT_EQ(proxy["used"].get<bool>(), min_iou >= 0.98) << min_iou;
  EXPECT_EQ(with["layers"] == plain["layers"], !proxy["used"].get<bool>());
  const auto few = layers({models + "/cube.glb", "--proxy", "auto"});
  EXPECT_FALSE(few["proxy"]["used"]);
  EXPECT_EQ(few["proxy"]["faces"], 0);
  // Kernels of another caster must not be used.
  const auto wrong = layers({models + "/ring.glb", "--proxy", models + "/cube.glb"});
  EXPECT_FALSE(wrong["proxy"]["used"]);
  EXPECT_GT(wrong["proxy"]["faces"], 0);
  EXPECT_EQ(wrong["layers"], layers({models + "/ring.glb"})["layers"]);
  expect_failure(penumbra({"shadow", models + "/ring.glb", "--proxy", file("none.glb")}),
                 {"none.glb"});
}

TEST_F(ShadowCommand, ReportsOvershootOfRingWithOneKernel) {
  const std::string ring = (source_dir() / "scenes" / "models" / "ring.glb").string();
  EXPECT_LT(layers({ring, "--pose", "0 0 0.1 0 0 0 1"})["twists"]["spill"], 0.02);
  const auto fixed = layers({ring, "--pose", "0 0 0.1 0 0 0 1", "--light-mode", "fixed"});
  EXPECT_GT(fixed["twists"]["faces_tested"], 0);
  EXPECT_LT(fixed["twists"]["area_share"], 0.05);
  EXPECT_FALSE(fixed["twists"].contains("spill"));
  EXPECT_EQ(fixed["twisted_faces"].get<int>() > 0,
            fixed["twists"]["area_share"].get<double>() > 0.0);
  EXPECT_GT(layers({ring, "--pose", "0 0 0.1 0 0 0 1", "--technique", "cocl"})["twists"]["spill"],
            0.3);
}

TEST_F(ShadowCommand, LeavesNoPartialFileWhenInterrupted) {
  std::string soup;
  for (int i = 0; i < 60000; ++i) {
    const double x = std::fmod(i * 0.6180339887, 1.0), y = std::fmod(i * 0.7548776662, 1.0);
    soup += fmt::format("v {:.5f} {:.5f} 0.1\nv {:.5f} {:.5f} 0.12\nv {:.5f} {:.5f} 0.11\n", x, y,
                        x + 0.004, y, x, y + 0.004);
    soup += fmt::format("f {} {} {}\n", 3 * i + 1, 3 * i + 2, 3 * i + 3);
  }
  write("soup.obj", soup);
  for (const std::string command : {"shadow", "kernels"}) {
    const std::string output = file(command + "_out.json");
    const ProgramResult result = run_program(
        "/bin/bash", {"-c",
                      "\"$0\" \"$@\" & work=$!; for i in $(seq 1000); do "
                      "compgen -G \"${@: -1}.partial*\" > /dev/null && break; sleep 0.01; done; "
                      "kill -TERM $work; wait $work",
                      program().string(), command, file("soup.obj"), "--output", output});
    EXPECT_EQ(result.exit_code, 1) << command << result.err;
    EXPECT_THAT(result.err, HasSubstr("ended early")) << command;
    for (const auto& entry : fs::directory_iterator(folder_.path())) {
      EXPECT_THAT(entry.path().string(), testing::Not(HasSubstr("_out.json"))) << command;
    }
  }
}

// On a full disk, the message must name the requested file, not the temporary one.
TEST_F(ShadowCommand, ReportsRequestedFileWhenDiskIsFull) {
  const auto on_a_full_disk = [](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(),
                     {"-c", "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\"", program().string()});
    return run_program("/bin/bash", arguments);
  };
  const fs::path tabletop = source_dir() / "recordings" / "tabletop";
  std::ofstream(file("short.tum")) << "0 0 0 0.5 1 0 0 0\n0.04 0 0 0.5 1 0 0 0\n";
  const auto expect_named = [&](const std::vector<std::string>& arguments,
                                const std::string& name) {
    const ProgramResult result = on_a_full_disk(arguments);
    EXPECT_EQ(result.exit_code, 1) << name;
    EXPECT_THAT(result.err, HasSubstr(file(name).string())) << result.err;
    EXPECT_THAT(result.err, testing::Not(HasSubstr("partial"))) << result.err;
  };
  for (const std::string name : {"a.json", "a.svg", "a.png"}) {
    expect_named({"shadow", file("square.obj"), "--output", file(name)}, name);
  }
  for (const std::string name : {"k.json", "k.glb"}) {
    expect_named({"kernels", file("square.obj"), "--output", file(name)}, name);
  }
  expect_named({"target", "--output", file("sheet.pdf")}, "sheet.pdf");
  expect_named(
      {"simulate", "board", "--camera", tabletop / "camera.yaml", "--tags", tabletop / "tags.yaml",
       "--trajectory", file("short.tum"), "--output", file("session")},
      "session");
}

TEST_F(ShadowCommand, FailsInOneLineOnInvalidInput) {
  expect_failure(penumbra({"shadow", file("none.obj")}), {"none.obj"});
  write("bad.glb", "no model");
  expect_failure(penumbra({"shadow", file("bad.glb")}), {"bad.glb"});
  expect_failure(penumbra({"kernels", file("bad.glb"), "--output", file("k.json")}), {"bad.glb"});
  EXPECT_FALSE(fs::exists(file("k.json")));
  expect_failure(penumbra({"shadow", file("square.obj"), "--output", file("no") / "layers.json"}),
                 {"layers.json"});
  const auto with = [&](const std::string& text) {
    write("k.json", text);
    return penumbra({"shadow", file("square.obj"), "--kernels", file("k.json")});
  };
  expect_failure(with("{ no json"), {"k.json"});
  expect_failure(with(R"({"up": [0,0,1]})"), {"k.json", "kernels"});
  expect_failure(with(R"({"kernels": [0,0,0], "up": [0,0,1]})"), {"k.json", "1", "4"});
  expect_failure(with(R"({"kernels": [0,0,"x",0,0,0,0,0,0,0,0,0]})"), {"k.json", "kernels[2]"});
  expect_failure(with(R"({"kernels": [0,0,0,0,0,0,0,0,0,0,0,0], "up": [0,0,0]})"),
                 {"k.json", "up"});
}

}  // namespace
}  // namespace penumbra::test
