// Compressed glTF files load as the uncompressed file does. Damaged ones are rejected.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <glm/geometric.hpp>

#include "render/shadow/kernels/kernel_glb.hpp"
#include "support/compressed_gltf.hpp"
#include "support/model_case.hpp"

namespace penumbra {
namespace {

using test::DracoForm;
using test::GltfBuilder;
using test::MeshoptForm;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr const char* kDracoName = "KHR_draco_mesh_compression";
constexpr const char* kMeshoptName = "EXT_meshopt_compression";

struct Tolerance {
  float position_m = 0.0F;
  float normal = 0.0F;
  float texcoord = 0.0F;
};

class GltfCompression : public test::ModelCase {
 protected:
  // Compares the models vertex by vertex. Draco changes their order; texture coordinates are
  // unique.
  static void expect_equal(const Model& model, const Model& plain, const Tolerance& tolerance) {
    ASSERT_EQ(model.vertex_count(), plain.vertex_count());
    ASSERT_EQ(model.triangle_count(), plain.triangle_count());
    ASSERT_EQ(model.meshes.size(), 1U);
    const Mesh& mesh = model.meshes[0];
    const Mesh& expected = plain.meshes[0];
    ASSERT_EQ(mesh.texcoords.size(), expected.texcoords.size());
    ASSERT_EQ(mesh.colors.size(), expected.colors.size());
    std::vector<std::uint32_t> vertex_in_plain;
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const auto near = std::ranges::min_element(expected.texcoords, {}, [&](const glm::vec2& t) {
        return glm::distance(t, mesh.texcoords[i]);
      });
      const auto at = static_cast<std::size_t>(near - expected.texcoords.begin());
      vertex_in_plain.push_back(static_cast<std::uint32_t>(at));
      EXPECT_LE(glm::distance(*near, mesh.texcoords[i]), tolerance.texcoord);
      EXPECT_LE(glm::distance(mesh.positions[i], expected.positions[at]), tolerance.position_m);
      EXPECT_LE(glm::distance(mesh.normals[i], expected.normals[at]), tolerance.normal);
      EXPECT_EQ(mesh.colors[i], expected.colors[at]);
    }
    EXPECT_EQ(triangles_of(mesh, vertex_in_plain), triangles_of(expected, {}));
  }
  // Returns the sorted triangles, each from its smallest vertex.
  static std::vector<std::array<std::uint32_t, 3>> triangles_of(
      const Mesh& mesh, const std::vector<std::uint32_t>& renumbered) {
    std::vector<std::array<std::uint32_t, 3>> triangles;
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
      std::array<std::uint32_t, 3> corners{};
      for (std::size_t c = 0; c < 3; ++c) {
        const std::uint32_t vertex = mesh.indices[i + c];
        corners[c] = renumbered.empty() ? vertex : renumbered[vertex];
      }
      std::ranges::rotate(corners, std::ranges::min_element(corners));
      triangles.push_back(corners);
    }
    std::ranges::sort(triangles);
    return triangles;
  }
  void expect_loads_as_plain(const GltfBuilder& file, const Tolerance& tolerance) {
    const auto plain = loaded(test::plain_gltf(sheet_).gltf(), "plain.gltf");
    ASSERT_TRUE(plain) << error_of(plain);
    for (const bool binary : {false, true}) {
      const auto model =
          binary ? loaded(file.glb(), "model.glb") : loaded(file.gltf(), "model.gltf");
      ASSERT_TRUE(model) << error_of(model);
      EXPECT_THAT(model->warnings, IsEmpty());
      expect_equal(*model, *plain, tolerance);
    }
  }
  void expect_error(const GltfBuilder& file, const std::string& expected) {
    const auto model = loaded(file.gltf());
    EXPECT_THAT(error_of(model), HasSubstr("model.gltf: "));
    EXPECT_THAT(error_of(model), HasSubstr(expected));
  }
  // Stores kernels in a compressed file and loads the result.
  void expect_keeps_kernels(const GltfBuilder& file) {
    const auto path = write("model.gltf", file.gltf());
    const auto model = load_model(path);
    ASSERT_TRUE(model) << error_of(model);
    KernelFile kernels;
    kernels.up = {0.0, 0.0, 1.0};
    kernels.geometry = geometry_key(*model) + "-auto";
    for (std::uint32_t i = 0; i < model->source_vertex_count; ++i) {
      kernels.kernels.emplace_back(0.001F * static_cast<float>(i), 0.0F, 0.5F);
    }
    const auto written = add_kernels_to_gltf(path, kernels);
    ASSERT_TRUE(written) << written.error().message;
    const auto reloaded =
        loaded(std::string(written->bytes.begin(), written->bytes.end()), "kernels.glb");
    ASSERT_TRUE(reloaded) << error_of(reloaded);
    EXPECT_THAT(reloaded->warnings, IsEmpty());
    EXPECT_EQ(geometry_key(*reloaded), geometry_key(*model));
    ASSERT_EQ(reloaded->meshes[0].shadow_kernels.size(), reloaded->meshes[0].positions.size());
    for (std::size_t i = 0; i < reloaded->meshes[0].shadow_kernels.size(); ++i) {
      const auto source = static_cast<float>(reloaded->meshes[0].source_vertex[i]);
      EXPECT_NEAR(reloaded->meshes[0].shadow_kernels[i].x, 0.001F * source, 1e-6F);
    }
    // Storing kernels again must replace them.
    const auto again = add_kernels_to_gltf(folder_.path() / "kernels.glb", kernels);
    ASSERT_TRUE(again) << again.error().message;
    EXPECT_EQ(again->bytes.size(), written->bytes.size());
  }

  test::Sheet sheet_ = test::wavy_sheet();
};

// --- meshoptimizer ---

TEST_F(GltfCompression, ReadsMeshoptOfBothNamesAndAllModes) {
  for (const char* extension : {kMeshoptName, "KHR_meshopt_compression"}) {
    for (const bool sequence : {false, true}) {
      SCOPED_TRACE(fmt::format("{} {}", extension, sequence));
      MeshoptForm form;
      form.extension = extension;
      form.index_sequence = sequence;
      expect_loads_as_plain(test::meshopt_gltf(sheet_, form), {0.0F, 0.0F, 0.0F});
      form.filters = true;
      expect_loads_as_plain(test::meshopt_gltf(sheet_, form), {0.0F, 2e-3F, 2e-4F});
    }
  }
}

TEST_F(GltfCompression, ReadsMeshoptQuaternions) {
  // Instances turned by quarter turns about y.
  const float half = std::sqrt(0.5F);
  const std::vector<float> turns = {0, 0, 0, 1, 0, half, 0, half};
  GltfBuilder plain;
  plain.node({{"mesh", plain.square(0.1F)}});
  const std::size_t rotation = plain.accessor(turns, "VEC4");
  plain.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"] = {
      {"ROTATION", rotation}};
  GltfBuilder file = plain;
  std::vector<std::int16_t> filtered(8);
  meshopt_encodeFilterQuat(filtered.data(), 2, 8, 16, turns.data());
  meshopt_encodeVertexVersion(0);
  std::vector<unsigned char> coded(meshopt_encodeVertexBufferBound(2, 8));
  coded.resize(meshopt_encodeVertexBuffer(coded.data(), coded.size(), filtered.data(), 2, 8));
  const std::size_t view = file.view(std::vector<std::uint8_t>(coded.begin(), coded.end()));
  nlohmann::json compressed = file.json["bufferViews"][view];
  compressed.update(
      {{"byteStride", 8}, {"count", 2}, {"mode", "ATTRIBUTES"}, {"filter", "QUATERNION"}});
  file.json["bufferViews"][view] = {{"buffer", 0}, {"byteLength", 16}};
  file.json["bufferViews"][view]["extensions"][kMeshoptName] = compressed;
  file.json["accessors"][rotation].update(
      {{"bufferView", view}, {"componentType", 5122}, {"normalized", true}});
  const auto expected = loaded(plain.gltf());
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(expected) << error_of(expected);
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_EQ(model->vertex_count(), expected->vertex_count());
  for (std::size_t i = 0; i < model->meshes[0].positions.size(); ++i) {
    EXPECT_LE(glm::distance(model->meshes[0].positions[i], expected->meshes[0].positions[i]),
              1e-5F);
  }
}

TEST_F(GltfCompression, ReadsMeshoptWithoutFileOfFallbackBuffer) {
  GltfBuilder file = test::meshopt_gltf(sheet_);
  file.json["buffers"][1]["uri"] = "was-not-copied.bin";
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(GltfCompression, RejectsMeshoptWithWrongSizes) {
  const std::string at = fmt::format("bufferViews/0/extensions/{}", kMeshoptName);
  const auto changed = [&](const char* key, const nlohmann::json& value, std::size_t view = 0) {
    GltfBuilder file = test::meshopt_gltf(sheet_);
    file.json["bufferViews"][view]["extensions"][kMeshoptName][key] = value;
    return file;
  };
  expect_error(changed("byteStride", 10), at + "/byteStride: is 10; ATTRIBUTES has 4, 8, ");
  expect_error(changed("byteStride", 260), at + "/byteStride: is 260; ");
  expect_error(changed("byteStride", 0), at + "/byteStride: is 0; ");
  expect_error(changed("count", 62), at + ": has 62 elements of 12 bytes for a buffer view of 756");
  expect_error(changed("count", 0), at + "/count: is 0");
  expect_error(changed("count", -1), "count: is -1; a whole number");
  expect_error(changed("mode", "POINTS"), at + "/mode: \"POINTS\" is none of");
  expect_error(changed("filter", "COLOR"), at + "/filter: \"COLOR\" can't be read");
  expect_error(changed("filter", "OCTAHEDRAL"), "/byteStride: is 12; ATTRIBUTES OCTAHEDRAL has 4");
  expect_error(changed("filter", "QUATERNION"), "ATTRIBUTES QUATERNION has 8");
  expect_error(changed("buffer", 7), at + ": names buffer 7, there are 2");
  expect_error(changed("byteLength", 99999), at + ": reaches past the end of its buffer");
  expect_error(changed("byteLength", 0), at + "/byteLength: is 0");
  expect_error(changed("byteLength", 50), at + ": its data is damaged");
  expect_error(changed("filter", "EXPONENTIAL", 6), "EXPONENTIAL is not for mode TRIANGLES");
  expect_error(changed("byteStride", 3, 6), "/byteStride: is 3; TRIANGLES has 2 or 4");
  expect_error(changed("count", 287, 6), "/count: is 287, not a multiple of 3");
  GltfBuilder file = test::meshopt_gltf(sheet_);
  file.json["bufferViews"][0]["extensions"][kMeshoptName].erase("count");
  expect_error(file, at + ": has no count");
}

TEST_F(GltfCompression, RejectsNewerVersionOfMeshopt) {
  GltfBuilder file = test::meshopt_gltf(sheet_);
  file.binary[0] = '\xA7';
  file.json["buffers"][0]["uri"] = "data:;base64," + test::base64(file.binary);
  expect_error(file, "is in version 7 of the format, which can't be read; export it with EXT_");
}

TEST_F(GltfCompression, LimitsDecodedSizeOfMeshopt) {
  // Zeros compress to a 60th.
  GltfBuilder file = test::meshopt_gltf(sheet_);
  file.json["bufferViews"][0]["byteLength"] = std::size_t{256} << 24U;
  nlohmann::json& view = file.json["bufferViews"][0]["extensions"][kMeshoptName];
  view["byteStride"] = 256;
  view["count"] = 1U << 24U;
  expect_error(file, "the compressed data of the file has more than 536870912 bytes");
}

// --- Draco ---

TEST_F(GltfCompression, ReadsDracoOfBothMethods) {
  for (const bool sequential : {false, true}) {
    SCOPED_TRACE(sequential);
    expect_loads_as_plain(test::draco_gltf(sheet_, {.sequential = sequential, .quantized = false}),
                          {1e-7F, 1e-6F, 1e-7F});
    expect_loads_as_plain(test::draco_gltf(sheet_, {.sequential = sequential, .quantized = true}),
                          {2e-5F, 1e-2F, 3e-4F});
  }
}

TEST_F(GltfCompression, PrefersUncompressedDataToDraco) {
  GltfBuilder file = test::plain_gltf(sheet_);
  file.primitive()["extensions"][kDracoName] = {{"bufferView", 0},
                                                {"attributes", {{"POSITION", 0}}}};
  file.json["extensionsUsed"] = {kDracoName};
  expect_loads_as_plain(file, {});
}

TEST_F(GltfCompression, RejectsDracoThatDiffersFromItsAccessors) {
  const std::string at = fmt::format("meshes/0/primitives/0/extensions/{}", kDracoName);
  const auto changed = [&](std::size_t accessor, const char* key, const nlohmann::json& value) {
    GltfBuilder file = test::draco_gltf(sheet_);
    file.json["accessors"][accessor][key] = value;
    return file;
  };
  expect_error(changed(0, "count", 62), at + ": has 96 triangles and 63 vertices, more than its "
                                             "accessors (96 and 62)");
  expect_error(changed(0, "count", 64), at + ": has 63 vertices, its accessors 64");
  expect_error(changed(6, "count", 285), at + ": has 96 triangles and 63 vertices, more than");
  expect_error(changed(6, "count", 291), at + ": has 96 triangles, its accessor 291 indices");
  expect_error(changed(1, "count", 60), at + "/attributes/NORMAL: differs from its accessor");
  expect_error(changed(1, "type", "VEC4"), at + "/attributes/NORMAL: differs from its accessor");
  test::GltfBuilder whole = test::draco_gltf(sheet_);
  for (const auto& attribute : whole.primitive()["attributes"].items()) {
    GltfBuilder other = test::draco_gltf(sheet_);
    other.primitive()["attributes"][attribute.key()] = 255;
    expect_error(other, fmt::format("meshes/0/primitives/0/attributes/{}: names accessor 255, "
                                    "which does not exist",
                                    attribute.key()));
  }
  GltfBuilder file = test::draco_gltf(sheet_);
  file.primitive()["extensions"][kDracoName]["attributes"]["NORMAL"] = 77;
  expect_error(file, at + "/attributes/NORMAL: is 77, which its data does not have");
  file = test::draco_gltf(sheet_);
  file.primitive()["extensions"][kDracoName]["bufferView"] = 5;
  expect_error(file, at + "/bufferView: names buffer view 5, there are 1");
  file.primitive()["extensions"][kDracoName].erase("bufferView");
  expect_error(file, at + ": has no bufferView");
}

TEST_F(GltfCompression, RejectsDamagedDraco) {
  const std::string at = fmt::format("meshes/0/primitives/0/extensions/{}: ", kDracoName);
  const GltfBuilder good = test::draco_gltf(sheet_);
  GltfBuilder file = good;
  file.binary[0] = 'X';
  expect_error(file, at + "its data is damaged: it does not start with \"DRACO\"");
  file = good;
  file.binary[5] = 3;
  expect_error(file, at + "is in version 3.2 of the format; export it in version 2.2");
  file = good;
  file.binary[7] = 0;
  expect_error(file, at + "has no triangles");
  file = good;
  file.json["bufferViews"][0]["byteLength"] = 100;
  expect_error(file, at + "its data is damaged");
  file.json["bufferViews"][0]["byteLength"] = 12;
  expect_error(file, at + "its data is damaged: it is cut short");
}

// --- kernels ---

TEST_F(GltfCompression, KeepsCompressionOfFileWithKernels) {
  expect_keeps_kernels(test::draco_gltf(sheet_));
  MeshoptForm form;
  expect_keeps_kernels(test::meshopt_gltf(sheet_, form));
  form.fallback_is_first = true;
  expect_keeps_kernels(test::meshopt_gltf(sheet_, form));
}

}  // namespace
}  // namespace penumbra
