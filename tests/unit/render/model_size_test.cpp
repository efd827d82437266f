// Units and sizes of models from files.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "render/model/model.hpp"
#include "render/model/model_size.hpp"
#include "render/scene/scene.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

// A square of 64 by 64 units in the plane z = 32.
constexpr const char* kSquare = "v 0 0 32\nv 64 0 32\nv 64 64 32\nv 0 64 32\nf 1 2 3 4\n";

class ModelSize : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& name, const std::string& text) {
    const std::filesystem::path file = folder_.path() / name;
    std::ofstream(file, std::ios::binary) << text;
    return file;
  }

 private:
  test::TemporaryFolder folder_;
};

TEST_F(ModelSize, ConvertsCoordinatesToMetres) {
  const std::filesystem::path file = write("square.obj", kSquare);
  const Result<Model> model = load_model(file, {.unit_m = 0.001});
  ASSERT_TRUE(model);
  EXPECT_EQ(model->min_corner, glm::vec3(0.0F, 0.0F, 0.032F));
  EXPECT_EQ(model->max_corner, glm::vec3(0.064F, 0.064F, 0.032F));
}

TEST_F(ModelSize, LimitsCoordinatesInMetres) {
  const std::filesystem::path file = write("far.obj", "v 0 0 0\nv 3000000 0 0\nv 0 1 0\nf 1 2 3\n");
  EXPECT_FALSE(load_model(file));
  EXPECT_TRUE(load_model(file, {.unit_m = 0.001}));
}

Model sized(float x, float z) {
  Model model;
  model.min_corner = {-0.5F * x, 0.0F, 0.0F};
  model.max_corner = {0.5F * x, 0.0F, z};
  return model;
}

TEST(SizeWarning, ReportsSizeAndLikelyUnit) {
  using testing::Optional;
  EXPECT_THAT(warning_of_size(sized(64.0F, 1.0F), {}, "m.obj"),
              Optional(std::string("m.obj: is 64 m wide; in millimetres? use --unit mm")));
  EXPECT_THAT(warning_of_size(sized(6.0F, 10.0F), {}, "m.obj"),
              Optional(std::string("m.obj: is 10 m high; in centimetres? use --unit cm")));
  EXPECT_THAT(warning_of_size(sized(64.0F, 1.0F), {.remedy = SizeRemedy::scene_scale}, "m"),
              Optional(std::string("m: is 64 m wide; in millimetres? use scale 0.001")));
  // A model of 1 m in size whose file is read in millimetres.
  EXPECT_THAT(warning_of_size(sized(0.001F, 0.0F), {.unit_m = 0.001}, "m"),
              Optional(std::string("m: is 1 mm wide; in metres? use --unit m")));
  EXPECT_THAT(warning_of_size(sized(0.0005F, 0.0F), {}, "m"),
              Optional(std::string("m: is 0.5 mm wide; export it 100 times larger")));
  EXPECT_THAT(warning_of_size(sized(1e6F, 0.0F), {.remedy = SizeRemedy::scene_scale}, "m"),
              Optional(std::string("m: is 1e+06 m wide; use scale 1e-07")));
}

TEST(SizeWarning, IsAbsentForTableSizes) {
  for (const float size : {0.0021F, 0.1F, 4.99F}) {
    EXPECT_FALSE(warning_of_size(sized(size, 0.0F), {}, "m"));
  }
  EXPECT_FALSE(warning_of_size(sized(0.0F, 0.0F), {}, "point"));
  EXPECT_FALSE(warning_of_size(sized(64.0F, 0.0F), {.scale = 0.001}, "scaled"));
}

TEST(SizeWarning, IsAbsentForBundledScenes) {
  for (const auto& entry : std::filesystem::directory_iterator(test::source_dir() / "scenes")) {
    if (entry.path().extension() != ".json" || entry.path().stem().extension() == ".schema")
      continue;
    const Result<Scene> scene = load_scene(entry.path());
    ASSERT_TRUE(scene) << entry.path();
    for (const std::string& warning : scene->warnings) {
      EXPECT_THAT(warning, testing::Not(testing::HasSubstr("use scale")));
    }
  }
}

TEST_F(ModelSize, AcceptsPhantomOfAnySize) {
  write("square.obj", kSquare);
  const std::filesystem::path file = write("scene.json", R"({"objects": [], "phantoms": [
    {"name": "wall", "model": "square.obj"}], "shadows": []})");
  const Result<Scene> scene = load_scene(file);
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_THAT(scene->warnings, testing::IsEmpty());
}

TEST_F(ModelSize, WarnsOfSceneModelsFarFromTable) {
  write("far.obj", "v 458074 5429380 1\nv 458075 5429380 1\nv 458074 5429381 1\nf 1 2 3\n");
  write("beside.obj", "v 300 400 1\nv 301 400 1\nv 300 401 1\nf 1 2 3\n");
  const std::filesystem::path file = write("scene.json", R"({"objects": [
    {"name": "a", "model": "far.obj"}, {"name": "b", "model": "far.obj"},
    {"name": "c", "model": "beside.obj", "position": [-300.5, -400.5, 0]},
    {"name": "d", "model": "beside.obj", "position": [0, 0, 0.5]}],
    "shadows": []})");
  const Result<Scene> scene = load_scene(file);
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_THAT(
      scene->warnings,
      testing::ElementsAre(
          testing::HasSubstr("far.obj: \"a\": lies 5.449e+06 m from the table's origin; move it to "
                             "the origin in its file and export it again"),
          testing::HasSubstr("beside.obj: \"d\": lies 500.7 m from the table's origin; position "
                             "[-300.5, -400.5, -1] brings its middle there")));
}

TEST_F(ModelSize, WarnsOfOddSizeOncePerModel) {
  write("square.obj", kSquare);
  const std::filesystem::path file = write("scene.json", R"({"objects": [
    {"name": "a", "model": "square.obj"}, {"name": "b", "model": "square.obj"},
    {"name": "c", "model": "square.obj", "scale": 0.001}],
    "shadows": [{"name": "s", "technique": "layered"}]})");
  const Result<Scene> scene = load_scene(file);
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_THAT(scene->warnings,
              testing::ElementsAre(testing::HasSubstr(
                  "square.obj: \"a\": is 64 m wide; in millimetres? use scale 0.001")));
}

}  // namespace
}  // namespace penumbra
