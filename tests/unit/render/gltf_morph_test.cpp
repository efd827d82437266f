// Morph targets of glTF meshes at their default weights.
#include <gmock/gmock.h>

#include "support/gltf_builder.hpp"
#include "support/model_case.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

using test::GltfBuilder;
using testing::HasSubstr;
using testing::IsEmpty;

class GltfMorph : public test::ModelCase {};

// A square of 0.1 m with a morph target that stretches it to 0.2 m in x.
GltfBuilder morphed_square() {
  GltfBuilder file;
  const std::size_t mesh = file.square(0.1F);
  const std::size_t deltas =
      file.accessor(std::vector<float>{0, 0, 0, 0, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0}, "VEC3");
  file.primitive()["targets"].push_back({{"POSITION", deltas}});
  file.node({{"mesh", mesh}});
  return file;
}

double area(const Result<Model>& model) {
  return model ? test::measure_projected_area(*model).front : -1.0;
}

TEST_F(GltfMorph, UsesMeshWeightsByDefault) {
  GltfBuilder file = morphed_square();
  EXPECT_NEAR(area(loaded(file.gltf())), 0.01, 1e-9) << "missing weights are 0";
  file.json["meshes"][0]["weights"] = {1.0};
  EXPECT_NEAR(area(loaded(file.gltf())), 0.02, 1e-9);
  file.json["meshes"][0]["weights"] = {0.25};
  EXPECT_NEAR(area(loaded(file.gltf())), 0.0125, 1e-9);
}

TEST_F(GltfMorph, PrefersNodeWeights) {
  GltfBuilder file = morphed_square();
  file.json["meshes"][0]["weights"] = {1.0};
  file.json["nodes"][0]["weights"] = {0.5};
  file.node({{"mesh", 0}, {"translation", {1, 0, 0}}});
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(model->meshes[0].positions[2].x, 0.15F, 1e-7F);
  EXPECT_NEAR(model->meshes[0].positions[6].x, 1.2F, 1e-6F);
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(GltfMorph, MovesOnlyVerticesOfSparseTargets) {
  GltfBuilder file = morphed_square();
  // Without a buffer view, the other elements of a sparse accessor are zero.
  const std::size_t alone = file.sparse_accessor(4, {2, 3}, {0.1F, 0, 0, 0.1F, 0, 0});
  file.primitive()["targets"] = {{{"POSITION", alone}}};
  file.json["meshes"][0]["weights"] = {1.0};
  EXPECT_NEAR(area(loaded(file.gltf())), 0.02, 1e-9);
  // With a buffer view, the sparse values replace those of vertices 2 and 3.
  GltfBuilder based = morphed_square();
  const std::size_t sparse = based.sparse_accessor(4, {2, 3}, {0.3F, 0, 0, 0.3F, 0, 0});
  based.json["accessors"][sparse]["bufferView"] =
      based.view(std::vector<float>{-0.1F, 0, 0, -0.1F, 0, 0, 9, 9, 9, 9, 9, 9});
  based.primitive()["targets"] = {{{"POSITION", sparse}}};
  based.json["meshes"][0]["weights"] = {1.0};
  const auto model = loaded(based.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(model->min_corner.x, -0.1F, 1e-7F);
  EXPECT_NEAR(model->max_corner.x, 0.4F, 1e-7F);
}

TEST_F(GltfMorph, SumsTargets) {
  GltfBuilder file = morphed_square();
  file.primitive()["targets"].push_back(file.primitive()["targets"][0]);
  file.primitive()["targets"].push_back(nlohmann::json::object());
  file.json["meshes"][0]["weights"] = {0.5, 0.75, 1.0};
  EXPECT_NEAR(area(loaded(file.gltf())), 0.0225, 1e-8);
}

TEST_F(GltfMorph, MorphsNormalsAndTangents) {
  GltfBuilder file = morphed_square();
  nlohmann::json& attributes = file.primitive()["attributes"];
  std::vector<float> up, to_x, tangents, texcoords;
  for (int i = 0; i < 4; ++i) {
    up.insert(up.end(), {0, 1, 0});
    to_x.insert(to_x.end(), {2, -1, 0});
    tangents.insert(tangents.end(), {1, 0, 0, -1});
    texcoords.insert(texcoords.end(), {0, 0});
  }
  attributes["NORMAL"] = file.accessor(up, "VEC3");
  attributes["TANGENT"] = file.accessor(tangents, "VEC4");
  attributes["TEXCOORD_0"] = file.accessor(texcoords, "VEC2");
  file.primitive()["targets"][0]["NORMAL"] = file.accessor(to_x, "VEC3");
  std::vector<float> tangent_deltas;
  for (int i = 0; i < 4; ++i) tangent_deltas.insert(tangent_deltas.end(), {-1, -3, 0});
  file.primitive()["targets"][0]["TANGENT"] = file.accessor(tangent_deltas, "VEC3");
  file.json["meshes"][0]["weights"] = {1.0};
  file.primitive()["material"] = 0;
  file.json["materials"] = {{{"normalTexture", {{"index", 0}}}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["images"] = {
      {{"uri",
        "data:image/png;base64," + test::base64(test::png_bytes(test::one_color(128, 128, 255)))}}};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->warnings, IsEmpty());
  const Mesh& mesh = model->meshes[0];
  ASSERT_EQ(mesh.tangents.size(), 4U);
  // Normal: (0 1 0) + (2 -1 0), normalised. Tangent: (1 0 0) + (-1 -3 0), normalised. The file's y
  // is the model's z.
  EXPECT_EQ(mesh.normals[1], glm::vec3(1, 0, 0));
  EXPECT_EQ(mesh.tangents[1], glm::vec4(0, 0, -1, -1));
}

TEST_F(GltfMorph, AppliesTargetsBeforeSkin) {
  GltfBuilder file = morphed_square();
  nlohmann::json& attributes = file.primitive()["attributes"];
  attributes["JOINTS_0"] = file.accessor(std::vector<std::uint8_t>(16, 0), "VEC4");
  attributes["WEIGHTS_0"] = file.accessor(std::vector<std::uint8_t>(16, 64), "VEC4", true);
  file.json["nodes"][0]["skin"] = 0;
  file.json["nodes"][0]["weights"] = {1};
  file.node({{"scale", {3, 3, 3}}});
  file.json["skins"] = {{{"joints", {1}}}};
  EXPECT_NEAR(area(loaded(file.gltf())), 0.18, 1e-7);
}

TEST_F(GltfMorph, RejectsDamageAndReportsField) {
  const auto error_with = [&](const auto& damage) {
    GltfBuilder file = morphed_square();
    damage(file);
    return error_of(loaded(file.gltf()));
  };
  const auto target = [](GltfBuilder& file) -> nlohmann::json& {
    return file.primitive()["targets"][0]["POSITION"];
  };
  EXPECT_THAT(error_with([&](auto& file) {
                target(file) = file.accessor(std::vector<float>(9, 0.0F), "VEC3");
              }),
              HasSubstr("meshes/0/primitives/0/targets/0/POSITION: has 3 elements for 4 vertices"));
  EXPECT_THAT(error_with([&](auto& file) {
                target(file) = file.accessor(std::vector<float>(8, 0.0F), "VEC2");
              }),
              HasSubstr("targets/0/POSITION: has 2 components"));
  EXPECT_THAT(error_with([&](auto& file) {
                target(file) = file.accessor(std::vector<float>(12, std::nanf("")), "VEC3");
              }),
              HasSubstr("targets/0/POSITION (accessors/3): has a number that is not finite"));
  EXPECT_THAT(error_with([&](auto& file) { target(file) = 77; }),
              HasSubstr("targets/0/POSITION: names accessor 77, there are 3"));
  EXPECT_THAT(error_with([&](auto& file) { target(file) = "0"; }),
              HasSubstr("meshes/0/primitives/0/targets/0: is"));
  EXPECT_THAT(error_with([&](auto& file) { file.primitive()["targets"] = 3; }),
              HasSubstr("meshes/0/primitives/0/targets: is 3; a list is expected"));
  EXPECT_THAT(
      error_with([&](auto& file) {
        file.json["meshes"][0]["weights"] = {1, 1};
      }),
      HasSubstr("meshes/0/weights: are 2 for the 1 morph targets of meshes/0/primitives/0"));
  EXPECT_THAT(error_with([&](auto& file) {
                file.json["nodes"][0]["weights"] = {1, 1};
              }),
              HasSubstr("nodes/0/weights: are 2 for the 1 morph targets"));
  EXPECT_THAT(error_with([&](auto& file) { file.json["nodes"][0]["weights"] = {"1"}; }),
              HasSubstr("nodes/0/weights: is [\"1\"]; a list of numbers is expected"));
  EXPECT_THAT(error_with([&](auto& file) { file.json["nodes"][0]["weights"] = {1e30}; }),
              HasSubstr("from the origin"));
}

// Targets can share one buffer view, so a small file can have many.
TEST_F(GltfMorph, LimitsVectorsOfAllTargets) {
  GltfBuilder file = morphed_square();
  const nlohmann::json target = file.primitive()["targets"][0];
  for (int i = 1; i < 5; ++i) file.primitive()["targets"].push_back(target);
  ModelLoadOptions reading;
  reading.limits.max_morph_vectors = 20;
  EXPECT_TRUE(load_model(write("model.gltf", file.gltf()), reading));
  reading.limits.max_morph_vectors = 19;
  EXPECT_THAT(
      error_of(load_model(write("model.gltf", file.gltf()), reading)),
      testing::AllOf(HasSubstr("primitives/0/targets/4"), HasSubstr("more than 19 vectors")));
}

TEST_F(GltfMorph, MatchesSizeOfSharedCases) {
  const auto mesh = shared_case("gltf-morph-default-weights/morph_mesh_weights.gltf");
  if (!mesh) GTEST_SKIP() << "no shared data beside the checkout";
  EXPECT_NEAR(area(*mesh), 0.02, 1e-8);
  EXPECT_NEAR(area(*shared_case("gltf-morph-default-weights/morph_node_weights.gltf")), 0.02, 1e-8);
  // The triangle (0 0 0) (1 0 0) (0.5 0.5 0); its tip moves by half of (-1 1 0) and half of (1 1
  // 0).
  EXPECT_NEAR(area(*shared_case("gltf-morph-default-weights/SimpleMorph-khronos.gltf", UpAxis::z)),
              0.75, 1e-6);
  EXPECT_THAT(error_of(*shared_case("gltf-damaged-skins/target-too-short.gltf")),
              HasSubstr("targets/0/POSITION: has 3 elements for 16 vertices"));
}

}  // namespace
}  // namespace penumbra
