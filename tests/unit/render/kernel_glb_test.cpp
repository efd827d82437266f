// Kernels stored in .glb and .json files are read back as they were written.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>

#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "render/model/model.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "render/shadow/kernels/kernel_glb.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using testing::HasSubstr;
using testing::IsEmpty;

const Eigen::Vector3d kUp = Eigen::Vector3d::UnitZ();

// Writes a .gltf and the binary file that its accessors refer to.
class GltfMaker {
 public:
  Json json = {{"asset", {{"version", "2.0"}}}};

  template <class T>
  std::size_t add(const std::vector<T>& numbers, int component, const char* type,
                  std::size_t count) {
    while (data_.size() % 4 != 0) data_.push_back('\0');
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", data_.size()}, {"byteLength", numbers.size() * sizeof(T)}});
    data_.append(reinterpret_cast<const char*>(numbers.data()), numbers.size() * sizeof(T));
    json["accessors"].push_back({{"bufferView", json["bufferViews"].size() - 1},
                                 {"componentType", component},
                                 {"count", count},
                                 {"type", type}});
    return json["accessors"].size() - 1;
  }
  // A primitive with a box of 4 x 6 x 10 cm beside the origin.
  Json box() {
    std::vector<float> positions;
    for (int i = 0; i < 8; ++i) {
      positions.insert(positions.end(), {0.02F + ((i & 1) != 0 ? 0.04F : 0.0F),
                                         (i & 2) != 0 ? 0.06F : 0.0F, (i & 4) != 0 ? 0.1F : 0.0F});
    }
    const std::vector<std::uint16_t> indices = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6,
                                                0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7,
                                                0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
    const std::size_t position = add(positions, 5126, "VEC3", 8);
    const std::size_t index = add(indices, 5123, "SCALAR", 36);
    return {{"attributes", {{"POSITION", position}}}, {"indices", index}};
  }
  fs::path write(const fs::path& folder, const std::string& name = "model") {
    json["buffers"] = Json::array({{{"byteLength", data_.size()}, {"uri", name + ".bin"}}});
    std::ofstream(folder / (name + ".bin"), std::ios::binary) << data_;
    std::ofstream(folder / (name + ".gltf")) << json.dump();
    return folder / (name + ".gltf");
  }

 private:
  std::string data_;
};

class KernelGlb : public testing::Test {
 protected:
  [[nodiscard]] const fs::path& folder() const { return folder_.path(); }
  fs::path write(const std::string& name, const std::string& text) {
    std::ofstream(folder() / name, std::ios::binary) << text;
    return folder() / name;
  }
  fs::path write(const std::string& name, const std::vector<std::uint8_t>& bytes) {
    return write(name, std::string(bytes.begin(), bytes.end()));
  }

 private:
  test::TemporaryFolder folder_;
};

KernelFile kernels_of(const Model& model) {
  const ShadowMesh mesh = make_shadow_mesh(model);
  return make_kernel_file(model, mesh, generate_kernels(mesh, kUp, KernelSource::automatic),
                          KernelSource::automatic);
}

// Compares the kernels loaded with a model with those generated for it, vertex by vertex.
void expect_kernels_as_made(const Model& model, double tolerance_m = 1e-6) {
  ASSERT_TRUE(model.shadow_kernel_up) << testing::PrintToString(model.warnings);
  EXPECT_NEAR(model.shadow_kernel_up->z, 1.0, 1e-6);
  Model plain = model;
  for (Mesh& mesh : plain.meshes) mesh.shadow_kernels.clear();
  plain.shadow_kernel_up.reset();
  const KernelFile made = kernels_of(plain);
  std::size_t count = 0;
  for (const Mesh& mesh : model.meshes) {
    ASSERT_EQ(mesh.shadow_kernels.size(), mesh.positions.size());
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const glm::vec3 loaded = mesh.shadow_kernels[i];
      const glm::vec3 expected = made.kernels[mesh.source_vertex[i]];
      for (int axis = 0; axis < 3; ++axis) EXPECT_NEAR(loaded[axis], expected[axis], tolerance_m);
      ++count;
    }
  }
  EXPECT_GT(count, 0U);
}

// Stores a glTF file's kernels as .json and in `glb`, and expects that both load unchanged.
void expect_equal_kernels_in_glb_and_json(const fs::path& file, const fs::path& glb) {
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model) << model.error().message;
  const KernelFile kernels = kernels_of(*model);
  Model with_file = *model;
  const fs::path json = glb.parent_path() / "kernels.json";
  std::ofstream(json) << kernel_file_json(kernels);
  const Result<KernelFile> read = load_kernel_file(json);
  ASSERT_TRUE(read);
  const Result<bool> attached = attach_kernels(with_file, *read, "kernels.json");
  ASSERT_TRUE(attached) << attached.error().message;
  EXPECT_TRUE(*attached);
  expect_kernels_as_made(with_file);
  const auto written = add_kernels_to_gltf(file, kernels);
  ASSERT_TRUE(written) << written.error().message;
  ASSERT_TRUE(write_file(glb, written->bytes));
  const Result<Model> with_kernels = load_model(glb);
  ASSERT_TRUE(with_kernels) << with_kernels.error().message;
  EXPECT_EQ(geometry_key(*with_kernels), geometry_key(*model));
  EXPECT_EQ(with_kernels->source_vertex_count, model->source_vertex_count);
  expect_kernels_as_made(*with_kernels);
}

Json json_of(const fs::path& glb) {
  const auto bytes = read_file(glb);
  std::uint32_t size = 0;
  std::memcpy(&size, bytes->data() + 12, 4);
  return Json::parse(bytes->begin() + 20, bytes->begin() + 20 + size);
}

TEST_F(KernelGlb, StoresSeparateKernelsForCopiesOfMesh) {
  GltfMaker maker;
  maker.json["meshes"] = Json::array();
  const Json wheel = maker.box();
  const Json body = maker.box();
  maker.json["meshes"].push_back({{"name", "wheel"}, {"primitives", {wheel}}});
  maker.json["meshes"].push_back({{"name", "body"}, {"primitives", {body}}});
  maker.json["nodes"] = Json::parse(R"([
    {"mesh": 1, "scale": [2, 1, 1], "children": [1, 2]},
    {"mesh": 0, "translation": [0.3, 0, 0]},
    {"mesh": 0, "translation": [-0.3, 0.1, 0], "rotation": [0.3826834, 0, 0, 0.9238795]},
    {"mesh": 0, "translation": [0, 0, 0.5], "scale": [-1, 1, 1.5]}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0, 3]}])");
  const fs::path glb = folder() / "kept.glb";
  expect_equal_kernels_in_glb_and_json(maker.write(folder()), glb);
  const Json json = json_of(glb);
  ASSERT_EQ(json["meshes"].size(), 4U);
  EXPECT_EQ(json["meshes"][2]["primitives"][0]["attributes"]["POSITION"],
            json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]);
  EXPECT_NE(json["meshes"][2]["primitives"][0]["attributes"]["_SHADOW_KERNEL"],
            json["meshes"][0]["primitives"][0]["attributes"]["_SHADOW_KERNEL"]);
  // Storing kernels again must replace the old ones.
  const std::uintmax_t size = fs::file_size(glb);
  expect_equal_kernels_in_glb_and_json(glb, folder() / "again.glb");
  EXPECT_EQ(fs::file_size(folder() / "again.glb"), size);
}

TEST_F(KernelGlb, ConvertsInstancesToNodesWithSeparateKernels) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  const std::size_t translations =
      maker.add<float>({0.3F, 0, 0, 0, 0.2F, 0, 0, 0, -0.4F}, 5126, "VEC3", 3);
  const std::size_t scales = maker.add<float>({1, 1, 1, 2, 1, 1, 1, 1, 0.5F}, 5126, "VEC3", 3);
  maker.json["nodes"] = Json::parse(
      R"([{"mesh": 0, "rotation": [0, 0.3826834, 0, 0.9238795], "children": [1]},
          {"mesh": 0, "translation": [0, 0.4, 0]}])");
  maker.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"TRANSLATION", translations}, {"SCALE", scales}};
  maker.json["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  const fs::path glb = folder() / "kept.glb";
  expect_equal_kernels_in_glb_and_json(maker.write(folder()), glb);
  const Json json = json_of(glb);
  EXPECT_EQ(json["meshes"].size(), 4U);
  EXPECT_FALSE(json.contains("extensionsUsed"));
}

TEST_F(KernelGlb, StoresKernelsOfSkinnedMeshInItsAxes) {
  GltfMaker maker;
  Json box = maker.box();
  std::vector<std::uint8_t> joints;
  std::vector<float> weights;
  for (int i = 0; i < 8; ++i) {
    joints.insert(joints.end(), {0, 1, 0, 0});
    const float weight = (i & 4) != 0 ? 1.0F : 0.25F;
    weights.insert(weights.end(), {weight, 1.0F - weight, 0, 0});
  }
  box["attributes"]["JOINTS_0"] = maker.add(joints, 5121, "VEC4", 8);
  box["attributes"]["WEIGHTS_0"] = maker.add(weights, 5126, "VEC4", 8);
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  maker.json["skins"] = Json::parse(R"([{"joints": [1, 2]}])");
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
    {"translation": [0.1, 0.2, 0], "rotation": [0.3826834, 0, 0, 0.9238795], "children": [2]},
    {"scale": [1.5, 1, 0.5], "translation": [0, 0.05, 0]}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0, 1]}])");
  expect_equal_kernels_in_glb_and_json(maker.write(folder()), folder() / "kept.glb");
}

TEST_F(KernelGlb, KeepsMeshOfHiddenNodes) {
  // Nodes hidden by scale 0 on two or three axes, before, between and after visible nodes.
  for (
      const std::string nodes :
      {R"([{"mesh": 0, "scale": [0, 0, 0]}, {"mesh": 0}, {"mesh": 1, "scale": [0, 0, 0]}])",
       R"([{"mesh": 0}, {"mesh": 0, "scale": [1, 0, 0]}, {"mesh": 0, "translation": [0.3, 0, 0]}])",
       R"([{"mesh": 1, "scale": [2, 1, 1]}, {"mesh": 0}, {"mesh": 0, "scale": [0, 0, 0]}])"}) {
    GltfMaker maker;
    maker.json["meshes"] = Json::array();
    for (int i = 0; i < 2; ++i) {
      const Json box = maker.box();
      maker.json["meshes"].push_back({{"primitives", {box}}});
    }
    maker.json["nodes"] = Json::parse(nodes);
    maker.json["scenes"] = Json::parse(R"([{"nodes": [0, 1, 2]}])");
    expect_equal_kernels_in_glb_and_json(maker.write(folder()), folder() / "kept.glb");
    // In the stored file, the hidden nodes' meshes have kernels that belong to other nodes.
    expect_equal_kernels_in_glb_and_json(folder() / "kept.glb", folder() / "again.glb");
  }
}

TEST_F(KernelGlb, DropsHiddenInstance) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  const std::size_t scales = maker.add<float>({0, 0, 0, 2, 1, 1}, 5126, "VEC3", 2);
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0}])");
  maker.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"SCALE", scales}};
  maker.json["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  const fs::path file = maker.write(folder());
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model) << model.error().message;
  const auto written = add_kernels_to_gltf(file, kernels_of(*model));
  ASSERT_TRUE(written) << written.error().message;
  const Result<Model> reloaded = load_model(write("kept.glb", written->bytes));
  ASSERT_TRUE(reloaded) << reloaded.error().message;
  EXPECT_EQ(geometry_key(*reloaded), geometry_key(*model));
  EXPECT_THAT(reloaded->warnings, IsEmpty());
  expect_kernels_as_made(*reloaded);
}

TEST_F(KernelGlb, AllowsMissingUnusedBuffers) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  fs::path file = maker.write(folder());
  for (const bool is_first : {false, true}) {
    Json json = maker.json;
    const Json missing = {{"byteLength", 4'000'000'000U}};
    json["buffers"].insert(is_first ? json["buffers"].begin() : json["buffers"].end(), missing);
    for (Json& view : json["bufferViews"]) view["buffer"] = is_first ? 1 : 0;
    std::ofstream(file) << json.dump();
    expect_equal_kernels_in_glb_and_json(file, folder() / "kept.glb");
  }
}

TEST_F(KernelGlb, RejectsFlattenedMeshAndSuggestsJson) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0, "scale": [1, 0, 1]}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  const fs::path file = maker.write(folder());
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model);
  const auto written = add_kernels_to_gltf(file, kernels_of(*model));
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("store the kernels in a .json file"));
}

TEST_F(KernelGlb, EmbedsImagesBesideModel) {
  const std::vector<std::uint8_t> rgba = {255, 0, 0, 255, 0, 255, 0, 255};
  ASSERT_TRUE(save_png(folder() / "red green.png", 2, 1, rgba));
  GltfMaker maker;
  Json box = maker.box();
  box["attributes"]["TEXCOORD_0"] = maker.add(std::vector<float>(16, 0.25F), 5126, "VEC2", 8);
  box["material"] = 0;
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  maker.json["images"] = Json::parse(R"([{"uri": "red%20green.png"}])");
  maker.json["textures"] = Json::parse(R"([{"source": 0}])");
  maker.json["materials"] =
      Json::parse(R"([{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}])");
  const fs::path file = maker.write(folder());
  fs::create_directory(folder() / "elsewhere");
  const fs::path glb = folder() / "elsewhere" / "kept.glb";
  expect_equal_kernels_in_glb_and_json(file, glb);
  const Result<Model> model = load_model(glb);
  ASSERT_TRUE(model);
  EXPECT_THAT(model->warnings, IsEmpty());
  ASSERT_EQ(model->textures.size(), 1U);
  EXPECT_EQ(model->textures[0]->rgba, rgba);
}

TEST_F(KernelGlb, ReportsMissingImage) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  maker.json["images"] = Json::parse(R"([{"uri": "lost.png"}])");
  const fs::path file = maker.write(folder());
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model);
  const auto written = add_kernels_to_gltf(file, kernels_of(*model));
  ASSERT_TRUE(written);
  EXPECT_THAT(written->warnings, testing::ElementsAre(HasSubstr("lost.png")));
}

constexpr const char* kTexturedObj =
    "mtllib m.mtl\no T\xF6pfchen\nusemtl gr\xFCn\nv 0 0 20\nv 64 0 20\nv 64 64 20\nv 0 64 30\n"
    "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";

TEST_F(KernelGlb, ConvertsObjWithLatin1NamesAndImageToMetres) {
  const std::vector<std::uint8_t> rgba = {255, 0, 0, 255, 0, 255, 0, 255};
  ASSERT_TRUE(save_png(folder() / "p.png", 2, 1, rgba));
  write("m.mtl", "newmtl gr\xFCn\nmap_Kd p.png\n");
  const fs::path file = write("model.obj", kTexturedObj);
  const Result<Model> model = load_model(file, {.unit_m = 0.001});
  ASSERT_TRUE(model) << model.error().message;
  const auto written = make_glb_with_kernels(*model, kernels_of(*model));
  ASSERT_TRUE(written) << written.error().message;
  EXPECT_THAT(written->warnings, IsEmpty());
  fs::create_directory(folder() / "elsewhere");
  const fs::path glb = write("elsewhere/kept.glb", written->bytes);
  const Result<Model> reloaded = load_model(glb);
  ASSERT_TRUE(reloaded) << reloaded.error().message;
  EXPECT_THAT(reloaded->warnings, IsEmpty());
  EXPECT_NEAR(reloaded->max_corner.x, 0.064, 1e-7);
  ASSERT_EQ(reloaded->textures.size(), 1U);
  EXPECT_EQ(reloaded->textures[0]->rgba, rgba);
  EXPECT_EQ(reloaded->materials[0].name, "gr\xC3\xBCn");
  expect_kernels_as_made(*reloaded);
  // The embedded image equals the image file byte for byte.
  const Json json = json_of(glb);
  EXPECT_EQ(json["bufferViews"][json["images"][0]["bufferView"].get<std::size_t>()]["byteLength"],
            fs::file_size(folder() / "p.png"));
}

TEST_F(KernelGlb, KeepsPositionOfObjFarFromOrigin) {
  const fs::path file =
      write("far.obj", "v 300 500 20\nv 301 500 20\nv 301 501 20.5\nv 300 501 21\nf 1 2 3 4\n");
  const Result<Model> model = load_model(file);
  ASSERT_TRUE(model);
  ASSERT_FALSE(model->origin.isZero(0.0));
  const auto written = make_glb_with_kernels(*model, kernels_of(*model));
  ASSERT_TRUE(written) << written.error().message;
  const Result<Model> reloaded = load_model(write("kept.glb", written->bytes));
  ASSERT_TRUE(reloaded) << reloaded.error().message;
  EXPECT_THAT(reloaded->warnings, IsEmpty());
  EXPECT_LT((reloaded->origin - model->origin).norm(), 1e-6);
  expect_kernels_as_made(*reloaded);
}

TEST_F(KernelGlb, StoresKernelsInUnitOfFile) {
  GltfMaker maker;
  const Json box = maker.box();
  maker.json["meshes"] = Json::array();
  maker.json["meshes"].push_back({{"primitives", {box}}});
  // The scale makes the box as large as in a file in millimetres.
  maker.json["nodes"] = Json::parse(R"([{"mesh": 0, "scale": [1000, 1000, 1000]}])");
  maker.json["scenes"] = Json::parse(R"([{"nodes": [0]}])");
  const fs::path file = maker.write(folder());
  const Result<Model> in_metres = load_model(file);
  const Result<Model> model = load_model(file, {.unit_m = 0.001});
  ASSERT_TRUE(model && in_metres);
  EXPECT_NEAR(model->max_corner.z, 0.06, 1e-6);
  KernelFile kernels = kernels_of(*model);
  kernels.geometry = geometry_key(*in_metres);
  const auto written = add_kernels_to_gltf(file, kernels, 0.001);
  ASSERT_TRUE(written);
  const fs::path glb = write("kept.glb", written->bytes);
  const Result<Model> reloaded = load_model(glb, {.unit_m = 0.001});
  ASSERT_TRUE(reloaded);
  EXPECT_EQ(reloaded->max_corner, model->max_corner);
  expect_kernels_as_made(*reloaded);
  const Result<Model> as_metres = load_model(glb);
  ASSERT_TRUE(as_metres);
  EXPECT_EQ(as_metres->max_corner, in_metres->max_corner);
  EXPECT_TRUE(as_metres->shadow_kernel_up);
}

TEST_F(KernelGlb, WritesModelsWithHiddenNodesAndUnusedBuffers) {
  const fs::path cases = test::shared_dir() / "cases";
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  for (const std::string file :
       {"gltf-hidden-node/scale0_all.gltf", "gltf-hidden-node/scale0_two_axes.gltf",
        "gltf-data-uri-forms/unused-buffer-4GB-without-uri.gltf"}) {
    SCOPED_TRACE(file);
    expect_equal_kernels_in_glb_and_json(cases / file, folder() / "kept.glb");
  }
}

TEST_F(KernelGlb, WritesModelWithLatin1Names) {
  const fs::path shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const Result<Model> model = load_model(shared / "cases" / "kernels-name-not-utf8" / "latin1.obj");
  ASSERT_TRUE(model) << model.error().message;
  const auto written = make_glb_with_kernels(*model, kernels_of(*model));
  ASSERT_TRUE(written) << written.error().message;
  const Result<Model> reloaded = load_model(write("kept.glb", written->bytes));
  ASSERT_TRUE(reloaded) << reloaded.error().message;
  expect_kernels_as_made(*reloaded);
  ASSERT_FALSE(reloaded->nodes.empty());
  EXPECT_EQ(reloaded->nodes[0].name, "T\xC3\xB6pfchen");
}

}  // namespace
}  // namespace penumbra
