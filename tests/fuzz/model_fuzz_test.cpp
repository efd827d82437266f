// Damaged models are rejected with an error of one line, or load as valid models. Deterministic.
#include <gtest/gtest.h>
#include <webp/encode.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <functional>
#include <random>
#include <string>

#include "render/model/model.hpp"
#include "render/scene/scene.hpp"
#include "support/animated_gltf.hpp"
#include "support/compressed_gltf.hpp"
#include "support/gltf_builder.hpp"
#include "support/paths.hpp"
#include "support/test_form.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::string mutated(std::string text, std::mt19937& random) {
  static const std::vector<std::string> kWords = {"nan", "-1", "1e39", "99999999999", "0", "[",
                                                  "}",   "\"", "..",   "4294967295",  "",  "\n"};
  const auto below = [&random](std::size_t n) { return random() % std::max<std::size_t>(n, 1); };
  const std::size_t changes = 1 + below(4);
  for (std::size_t i = 0; i < changes && !text.empty(); ++i) {
    // Half of the changes are near the start, where the headers are.
    const std::size_t at =
        below(below(2) == 0 ? std::min<std::size_t>(text.size(), 3000) : text.size());
    switch (below(6)) {
      case 0:
        text[at] = static_cast<char>(random() & 0xFFU);
        break;
      case 1:
        text[at] = static_cast<char>(text[at] ^ (1 << below(8)));
        break;
      case 2: {
        std::size_t from = at;
        while (from < text.size() && (text[from] < '0' || text[from] > '9')) ++from;
        std::size_t to = from;
        while (to < text.size() && text[to] >= '0' && text[to] <= '9') ++to;
        text.replace(from, to - from, kWords[below(kWords.size())]);
        break;
      }
      case 3:
        text.insert(at, kWords[below(kWords.size())]);
        break;
      case 4:
        text.erase(at, 1 + below(20));
        break;
      default:
        if (below(4) == 0) text.resize(at);
    }
  }
  return text;
}

void expect_sound(const Model& model) {
  for (const Mesh& mesh : model.meshes) {
    ASSERT_EQ(mesh.normals.size(), mesh.positions.size());
    for (const glm::vec3& n : mesh.normals) {
      ASSERT_TRUE(std::abs(n.x) <= 1.01F && std::abs(n.y) <= 1.01F && std::abs(n.z) <= 1.01F);
    }
    for (const glm::vec3& p : mesh.positions) {
      ASSERT_TRUE(std::abs(p.x) <= 1e6F && std::abs(p.y) <= 1e6F && std::abs(p.z) <= 1e6F);
    }
    for (const std::uint32_t index : mesh.indices) ASSERT_LT(index, mesh.positions.size());
    const Material& material = model.materials.at(static_cast<std::size_t>(mesh.material));
    if (material.normal_texture.image >= 0) {
      ASSERT_EQ(mesh.tangents.size(), mesh.positions.size());
    }
    for (const glm::vec4& t : mesh.tangents) {
      ASSERT_TRUE(std::abs(t.x) <= 1.01F && std::abs(t.y) <= 1.01F && std::abs(t.z) <= 1.01F);
      ASSERT_EQ(std::abs(t.w), 1.0F);
    }
  }
}

// Number of mutations; the short form tries a third of them.
int mutations(int nightly) {
  return test::nightly() ? nightly : nightly / 3;
}

// Loads `count` files; returns the number accepted.
int fuzz_model(const std::function<std::string(std::mt19937& random)>& damaged,
               const std::string& extension, int count, unsigned seed,
               const ModelLoadOptions& reading = {}) {
  test::TemporaryFolder folder;
  std::mt19937 random(seed);
  const std::filesystem::path file = folder.path() / ("model" + extension);
  int accepted = 0;
  for (int i = 0; i < count; ++i) {
    // Creates a new file, because some file systems flush a truncated file to the disk.
    std::filesystem::remove(file);
    std::ofstream(file, std::ios::binary) << damaged(random);
    const Result<Model> model = load_model(file, reading);
    if (model) {
      ++accepted;
      expect_sound(*model);
      for (const std::string& warning : model->warnings) {
        EXPECT_EQ(warning.find('\n'), std::string::npos) << warning;
      }
    } else {
      EXPECT_EQ(model.error().message.find('\n'), std::string::npos) << model.error().message;
      EXPECT_NE(model.error().message.find("model" + extension), std::string::npos)
          << model.error().message;
    }
  }
  return accepted;
}

// Tries `count` mutations; returns the number accepted.
int fuzz_model(const std::string& good, const std::string& extension, int count, unsigned seed,
               const ModelLoadOptions& reading = {}) {
  return fuzz_model([&good](std::mt19937& random) { return mutated(good, random); }, extension,
                    count, seed, reading);
}

TEST(ModelFuzz, LoadsOrRejectsDamagedGlb) {
  const std::string good = contents(test::source_dir() / "scenes/models/helicopter_tail_rotor.glb");
  const int accepted = fuzz_model(good, ".glb", mutations(3000), 1);
  EXPECT_GT(accepted, 0);
  EXPECT_LT(accepted, mutations(3000));
}

TEST(ModelFuzz, LoadsOrRejectsDamagedMaterials) {
  test::TexturedSquare square;
  square.material =
      R"("extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":2.5},"KHR_materials_unlit":{}},)"
      R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0,"extensions":{"KHR_texture_transform":{)"
      R"("offset":[0.1,-0.2],"rotation":0.5,"scale":[2,3],"texCoord":0}}},"metallicRoughnessTexture":{"index":1,)"
      R"("texCoord":1}},"normalTexture":{"index":2,"scale":0.7},"occlusionTexture":{"index":1,)"
      R"("strength":0.5},"emissiveTexture":{"index":0,"texCoord":1},"emissiveFactor":[1,1,1],)"
      R"("alphaMode":"MASK","alphaCutoff":0.3,"doubleSided":true)";
  for (const RgbaImage& image :
       {test::one_color(200, 90, 30), test::one_color(0, 120, 200), test::one_color(150, 120, 230)})
    square.images.push_back(test::png_bytes(image));
  square.samplers = R"({"magFilter":9728,"minFilter":9987,"wrapS":33071,"wrapT":33648})";
  square.texcoords_1 = square.texcoords;
  const int with_derived = fuzz_model(test::glb_of(square), ".glb", mutations(2000), 5);
  EXPECT_GT(with_derived, 0);
  EXPECT_LT(with_derived, mutations(2000));
  square.tangents.assign(4, {1, 0, 0, 1});
  const int with_given = fuzz_model(test::glb_of(square), ".glb", mutations(1000), 6);
  EXPECT_GT(with_given, 0);
  EXPECT_LT(with_given, mutations(1000));
}

TEST(ModelFuzz, LoadsOrRejectsDamagedWebp) {
  const RgbaImage image = test::image_of(30, 20, [](int x, int y) {
    return std::array<int, 4>{8 * x, 12 * y, x * y % 256, 200};
  });
  for (const bool lossless : {false, true}) {
    std::uint8_t* coded = nullptr;
    const std::size_t size = lossless
                                 ? WebPEncodeLosslessRGBA(image.pixels.data(), 30, 20, 120, &coded)
                                 : WebPEncodeRGBA(image.pixels.data(), 30, 20, 120, 70.0F, &coded);
    test::TexturedSquare square;
    square.material = R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}})";
    const std::string good(reinterpret_cast<const char*>(coded), size);
    WebPFree(coded);
    // A damaged image causes a warning, not an error.
    const auto damaged = [&](std::mt19937& random) {
      square.images = {mutated(good, random)};
      return test::glb_of(square);
    };
    EXPECT_EQ(fuzz_model(damaged, ".glb", mutations(1500), lossless ? 60 : 61), mutations(1500));
  }
}

TEST(ModelFuzz, LoadsOrRejectsDamagedGltf) {
  // A glTF file as JSON text, with an embedded buffer.
  const std::string json =
      R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,)"
      R"("scale":[1,2,-1],"children":[1]},{"mesh":0,"rotation":[0,0,0,1]}],"meshes":[{"primitives":)"
      R"([{"attributes":{"POSITION":0},"indices":1,"material":0}]}],"materials":[{)"
      R"("pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0.2,1]}}],"accessors":[{"bufferView":0,)"
      R"("componentType":5126,"count":3,"type":"VEC3"},{"bufferView":1,"componentType":5123,)"
      R"("count":3,"type":"SCALAR"}],"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,)"
      R"("byteOffset":36,"byteLength":6}],"buffers":[{"byteLength":42,"uri":)"
      R"("data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAABAAIA"}]})";
  const int accepted = fuzz_model(json, ".gltf", mutations(4000), 2);
  EXPECT_GT(accepted, 0);
  EXPECT_LT(accepted, mutations(4000));
}

// A glTF file with two joints (weights in three encodings), two morph targets (one sparse), an
// instanced copy of the mesh, and a hidden node.
test::GltfBuilder deforming_gltf() {
  test::GltfBuilder file;
  file.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"weights", {0.5, 0.25}}},
                        {{"children", {2}}, {"translation", {0, 0.5, 0}}},
                        {{"scale", {2, 2, 2}}, {"rotation", {0, 1, 0, 0}}},
                        {{"mesh", 0}, {"weights", {1, 0}}},
                        {{"mesh", 0}, {"weights", {0, 1}}}};
  file.json["scenes"] = {{{"nodes", {0, 1, 3, 4}}}};
  file.square(0.1F);
  nlohmann::json& attributes = file.primitive()["attributes"];
  attributes["NORMAL"] =
      file.accessor(std::vector<float>{0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0}, "VEC3");
  for (int set = 0; set < 2; ++set) {
    attributes[fmt::format("JOINTS_{}", set)] = file.accessor(
        std::vector<std::uint8_t>{0, 1, 0, 0, 0, 1, 1, 0, 1, 0, 0, 0, 0, 0, 0, 1}, "VEC4");
  }
  attributes["WEIGHTS_0"] = file.accessor(
      std::vector<std::uint16_t>{30000, 30000, 0, 0, 65535, 0, 0, 0, 0, 9, 9, 9, 1, 2, 3, 4},
      "VEC4", true);
  attributes["WEIGHTS_1"] = file.accessor(
      std::vector<float>{0, 0.1F, 0, 0, 0, 0, 0, 0, 0.5F, 0, 0, 0, 0, 0, 0, 1}, "VEC4");
  const std::size_t deltas =
      file.accessor(std::vector<float>{0, 0, 0, 0, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0}, "VEC3");
  file.primitive()["targets"] = {
      {{"POSITION", deltas}, {"NORMAL", deltas}},
      {{"POSITION", file.sparse_accessor(4, {1, 3}, {0, 0, 1, 0, 1, 0})}}};
  std::vector<float> matrices;
  for (int i = 0; i < 2; ++i) {
    matrices.insert(matrices.end(), {1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0.5F, 0, 0, 1});
  }
  file.json["skins"] = {
      {{"joints", {1, 2}}, {"inverseBindMatrices", file.accessor(matrices, "MAT4")}}};
  nlohmann::json& instances =
      file.json["nodes"][3]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  instances["TRANSLATION"] = file.accessor(std::vector<float>{0, 0, 0, 1, 0, 0}, "VEC3");
  instances["ROTATION"] = file.accessor(std::vector<float>{0, 0, 0, 1, 0, 0, 1, 0}, "VEC4");
  file.json["nodes"][4]["extensions"]["KHR_node_visibility"]["visible"] = false;
  return file;
}

std::string text_of(const test::GltfBuilder& file, bool binary) {
  return binary ? file.glb() : file.gltf();
}

TEST(ModelFuzz, LoadsOrRejectsDamagedSkinsMorphTargetsAndInstances) {
  for (const bool binary : {false, true}) {
    const char* extension = binary ? ".glb" : ".gltf";
    const int accepted =
        fuzz_model(text_of(deforming_gltf(), binary), extension, mutations(4000), binary ? 7 : 8);
    EXPECT_GT(accepted, 0);
    EXPECT_LT(accepted, mutations(4000));
  }
}

TEST(ModelFuzz, LoadsOrRejectsDamagedAnimations) {
  test::GltfBuilder file = deforming_gltf();
  test::animate(file, 2, "rotation", {0, 1}, std::vector<std::int8_t>{0, 0, 0, 127, 0, 90, 0, 90},
                {.normalized = true});
  test::animate(file, 1, "translation", {0, 0.5F, 2}, std::vector<float>(27, 0.1F),
                {.interpolation = "CUBICSPLINE"});
  test::animate(file, 0, "weights", {0.25F, 1}, std::vector<float>{0, 1, 1, 0},
                {.interpolation = "STEP"});
  test::animate(file, 3, "scale", {0, 3}, std::vector<float>{1, 1, 1, 2, 3, 4});
  for (const double time_s : {0.0, 0.6, 5.0}) {
    const auto seed = static_cast<unsigned>(60 + time_s);
    const ModelLoadOptions reading{.pose = ModelPose{"all", time_s}};
    const int accepted = fuzz_model(file.glb(), ".glb", mutations(2000), seed, reading);
    EXPECT_GT(accepted, 0);
    EXPECT_LT(accepted, mutations(2000));
  }
}

// Damages the whole file, and in other runs only the compressed bytes.
void fuzz_compressed(const test::GltfBuilder& file, unsigned seed) {
  const int accepted = fuzz_model(file.glb(), ".glb", mutations(1500), seed);
  EXPECT_GT(accepted, 0);
  EXPECT_LT(accepted, mutations(1500));
  const auto damaged = [&file](std::mt19937& random) {
    test::GltfBuilder copy = file;
    const std::size_t changes = 1 + random() % 4;
    for (std::size_t i = 0; i < changes; ++i) {
      // Half of the changes are in the first bytes, which hold counts and methods.
      const std::size_t end =
          random() % 2 == 0 ? std::min<std::size_t>(60, copy.binary.size()) : copy.binary.size();
      char& byte = copy.binary[random() % end];
      byte = random() % 2 == 0 ? static_cast<char>(random() & 0xFFU)
                               : static_cast<char>(byte ^ (1 << random() % 8));
    }
    return copy.glb();
  };
  EXPECT_LT(fuzz_model(damaged, ".glb", mutations(1500), seed + 1), mutations(1500));
}

TEST(ModelFuzz, LoadsOrRejectsDamagedDraco) {
  const test::Sheet sheet = test::wavy_sheet();
  unsigned seed = 20;
  for (const bool sequential : {false, true}) {
    for (const bool quantized : {false, true}) {
      fuzz_compressed(test::draco_gltf(sheet, {sequential, quantized}), seed += 2);
    }
  }
}

TEST(ModelFuzz, LoadsOrRejectsDamagedMeshopt) {
  const test::Sheet sheet = test::wavy_sheet();
  unsigned seed = 40;
  for (const bool filters : {false, true}) {
    for (const bool index_sequence : {false, true}) {
      test::MeshoptForm form;
      form.filters = filters;
      form.index_sequence = index_sequence;
      fuzz_compressed(test::meshopt_gltf(sheet, form), seed += 2);
    }
  }
}

TEST(ModelFuzz, LoadsOrRejectsDamagedObj) {
  std::string good = "o thing\nusemtl paint\n";
  for (int i = 0; i < 40; ++i) {
    good +=
        fmt::format("v {} {} {}\nvt {} 0.5\nvn 0 0 1\n", 0.1 * i, 0.01 * i * i, i % 3, 0.02 * i);
  }
  for (int i = 1; i < 38; ++i)
    good += fmt::format("f {0}/{0}/{0} {1}//{1} {2} {3}/1\n", i, i + 1, i + 2, i + 3);
  const int accepted = fuzz_model(good, ".obj", mutations(4000), 3);
  EXPECT_GT(accepted, 0);
  EXPECT_LT(accepted, mutations(4000));
}

TEST(ModelFuzz, RejectsRandomBytes) {
  test::TemporaryFolder folder;
  std::mt19937 random(4);
  for (int i = 0; i < 600; ++i) {
    std::string bytes(random() % 4000, '\0');
    for (char& byte : bytes) byte = static_cast<char>(random() & 0xFFU);
    const char* extension = i % 3 == 0 ? ".glb" : i % 3 == 1 ? ".gltf" : ".obj";
    const std::filesystem::path file = folder.path() / (std::string("model") + extension);
    // Creates a new file, because some file systems flush a truncated file to the disk.
    std::filesystem::remove(file);
    std::ofstream(file, std::ios::binary) << bytes;
    EXPECT_FALSE(load_model(file));
  }
}

}  // namespace
}  // namespace penumbra
