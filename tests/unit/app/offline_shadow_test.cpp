#include "app/offline_shadow.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>

#include "app/output/layer_file.hpp"
#include "support/paths.hpp"
#include "support/run_program.hpp"

namespace penumbra {
namespace {

// A square plate of 0.1 m, 0.1 m above the plane.
std::filesystem::path plate(const test::TemporaryFolder& folder) {
  const auto file = folder.path() / "plate.obj";
  std::ofstream(file) << "v -0.05 -0.05 0.1\nv 0.05 -0.05 0.1\nv 0.05 0.05 0.1\nv -0.05 0.05 0.1\n"
                         "f 1 2 3\nf 1 3 4\n";
  return file;
}

TEST(OfflineShadow, LayersOfAPlateFollowTheFormula) {
  const test::TemporaryFolder folder;
  ShadowRequest request;
  request.model = plate(folder);
  request.constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const auto shadow = compute_shadow(request);
  ASSERT_TRUE(shadow) << shadow.error().message;
  ASSERT_EQ(shadow->layers.size(), 3U);
  const double factors[] = {(0.9 - 0.3) / 0.8, 0.9 / 0.8, (0.9 + 0.3) / 0.8};
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_NEAR(shadow->layers[i].outline.area, 0.01 * factors[i] * factors[i], 2e-4) << i;
  EXPECT_NEAR(shadow->footprint.area, 0.01, 1e-6);
  EXPECT_EQ(shadow->twists.faces_twisted, 0U);
}

TEST(OfflineShadow, FieldAndSimple) {
  const test::TemporaryFolder folder;
  ShadowRequest request;
  request.model = plate(folder);
  request.constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, 0.4).value();
  request.technique = OfflineTechnique::field;
  const auto field = compute_shadow(request);
  ASSERT_TRUE(field);
  // A light of the plate's own half width: 0.0125 m less on each side, and as much more, with round
  // corners.
  EXPECT_NEAR(field->layers[0].outline.area, 0.075 * 0.075, 1.5e-4);
  EXPECT_NEAR(field->layers[1].outline.area, 0.01, 1e-4);
  EXPECT_NEAR(field->layers[2].outline.area,
              0.01 + 4.0 * 0.1 * 0.0125 + std::numbers::pi * 0.0125 * 0.0125, 2e-4);
  request.technique = OfflineTechnique::simple;
  const auto simple = compute_shadow(request);
  ASSERT_TRUE(simple);
  ASSERT_EQ(simple->layers.size(), 1U);
  EXPECT_EQ(simple->layers[0].name, "shadow");
  EXPECT_NEAR(simple->layers[0].outline.area, 0.01, 1e-6);
}

TEST(OfflineShadow, JsonSvgAndPngFromTheCommand) {
  const test::TemporaryFolder folder;
  const std::string model = plate(folder).string();
  const auto run = [&](const std::vector<std::string>& more) {
    std::vector<std::string> words = {"shadow", model};
    words.insert(words.end(), more.begin(), more.end());
    return test::run_program(test::program(), words);
  };
  const auto json_run = run({"--light-height", "inf", "--umbra-height", "0.4"});
  ASSERT_EQ(json_run.exit_code, 0) << json_run.err;
  const nlohmann::json json = nlohmann::json::parse(json_run.out);
  EXPECT_EQ(json.at("H"), "inf");
  EXPECT_NEAR(json.at("umbra_height").get<double>(), 0.4, 1e-12);
  for (const char* layer : {"umbra", "middle", "penumbra"}) {
    const auto& polygons = json.at("layers").at(layer).at("polygons");
    ASSERT_EQ(polygons.size(), 1U);
    EXPECT_EQ(polygons.at(0).at("outer").at(0).size(), 2U);
    EXPECT_TRUE(polygons.at(0).at("holes").is_array());
  }
  EXPECT_EQ(json.at("kernels").at("source"), "auto");
  EXPECT_EQ(json.at("twisted_faces"), 0);
  for (const char* name : {"layers.svg", "layers.png", "layers.json"}) {
    const auto file = folder.path() / name;
    const auto made = run({"--output", file.string(), "--show-kernels"});
    EXPECT_EQ(made.exit_code, 0) << made.err;
    EXPECT_GT(std::filesystem::file_size(file), 400U);
  }
}

TEST(OfflineShadow, WrongUsageAndWrongFilesSayWhatToDo) {
  const test::TemporaryFolder folder;
  const std::string model = plate(folder).string();
  const auto expect = [](const std::vector<std::string>& words, int code, const char* text) {
    const auto result = test::run_program(test::program(), words);
    EXPECT_EQ(result.exit_code, code) << result.err;
    EXPECT_THAT(result.err, testing::HasSubstr(text));
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  };
  expect({"shadow", "none.obj"}, 1, "none.obj");
  expect({"shadow", model, "--pose", "1 2 3"}, 2, "--pose");
  expect({"shadow", model, "--pose", "0 0 0 0 0 0 0"}, 2, "quaternion");
  expect({"shadow", model, "--plane", "0 0 0 1 1 1"}, 2, "--plane");
  expect({"shadow", model, "--technique", "magic"}, 2, "magic");
  expect({"shadow", model, "--kernels", "magic"}, 2, "magic");
  expect({"shadow", model, "--light-height", "-1"}, 1, "light height");
  expect({"shadow", model, "--light-height", "inf"}, 1, "umbra height");
  expect({"shadow", model, "--output", (folder.path() / "x.bmp").string()}, 1, "x.bmp");
  const auto kernels = folder.path() / "kernels.json";
  for (const char* text : {"", "{", "[]", "{\"kernels\": [0, 0, 0], \"up\": [0, 0, 1]}",
                           "{\"kernels\": [0, 0, \"x\"], \"up\": [0, 0, 1]}",
                           "{\"kernels\": [], \"up\": [0, 0, 0]}"}) {
    std::ofstream(kernels) << text;
    expect({"shadow", model, "--kernels", kernels.string()}, 1, "kernels.json");
  }
}

}  // namespace
}  // namespace penumbra
