// glTF files of other programs: URIs, buffers, images, extensions, instances, hidden nodes, and
// content that is ignored with a warning.
#include <gmock/gmock.h>

#include <Eigen/Core>
#include <map>

#include "support/gltf_builder.hpp"
#include "support/model_case.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

using test::GltfBuilder;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class GltfModelFile : public test::ModelCase {
 protected:
  // Returns a file with a square of 0.1 m in one node.
  static GltfBuilder square() {
    GltfBuilder file;
    file.node({{"mesh", file.square(0.1F)}});
    return file;
  }
  void expect_square(const GltfBuilder& file) { expect_square(loaded(file.gltf())); }
  void expect_square(const Result<Model>& model) {
    ASSERT_TRUE(model) << error_of(model);
    EXPECT_NEAR(test::measure_projected_area(*model).front, 0.01, 1e-9);
    EXPECT_THAT(model->warnings, IsEmpty());
  }
  void expect_square_with_warning(const GltfBuilder& file, const std::string& warning) {
    const auto model = loaded(file.gltf());
    ASSERT_TRUE(model) << error_of(model);
    EXPECT_NEAR(test::measure_projected_area(*model).front, 0.01, 1e-9);
    EXPECT_THAT(model->warnings, ElementsAre(HasSubstr(warning)));
  }
};

// --- quantised coordinates ---

// KHR_mesh_quantization: positions are integers, scaled by the node.
TEST_F(GltfModelFile, ReadsQuantisedPositions) {
  const auto square_of = [](auto side, int component_type, bool normalized, double scale) {
    using Integer = decltype(side);
    GltfBuilder file;
    // The fourth number pads each vertex to a multiple of four bytes.
    const std::vector<Integer> corners = {0,    0, 0,    0, 0,    0, side, 0,
                                          side, 0, side, 0, side, 0, 0,    0};
    const std::size_t view = file.view(corners);
    file.json["bufferViews"][view]["byteStride"] = 4 * sizeof(Integer);
    file.json["accessors"].push_back({{"bufferView", view},
                                      {"componentType", component_type},
                                      {"count", 4},
                                      {"type", "VEC3"},
                                      {"normalized", normalized}});
    const std::size_t indices =
        file.accessor(std::vector<std::uint16_t>{0, 1, 2, 0, 2, 3}, "SCALAR");
    file.json["meshes"].push_back(
        {{"primitives", {{{"attributes", {{"POSITION", 0}}}, {"indices", indices}}}}});
    file.json["extensionsUsed"] = file.json["extensionsRequired"] = {"KHR_mesh_quantization"};
    file.node({{"mesh", 0}, {"scale", {scale, scale, scale}}});
    return file;
  };
  expect_square(square_of(std::int16_t{32767}, 5122, true, 0.1));
  expect_square(square_of(std::uint16_t{65535}, 5123, true, 0.1));
  expect_square(square_of(std::uint16_t{1000}, 5123, false, 1e-4));
  expect_square(square_of(std::int8_t{127}, 5120, true, 0.1));
  expect_square(square_of(std::uint8_t{200}, 5121, false, 5e-4));
}

// --- buffers ---

TEST_F(GltfModelFile, ReadsDataUrisOfAnyMediaType) {
  GltfBuilder file = square();
  std::string escaped;
  for (const char c : file.binary) {
    escaped += fmt::format("%{:02x}", static_cast<unsigned char>(c));
  }
  std::string half_escaped = test::base64(file.binary);
  for (std::size_t at = 0; (at = half_escaped.find('=', at)) != std::string::npos;) {
    half_escaped.replace(at, 1, "%3D");
  }
  for (const std::string& uri :
       {"data:;base64," + test::base64(file.binary), "data:;BASE64," + test::base64(file.binary),
        "data:application/octet-stream;charset=utf-8;base64," + test::base64(file.binary),
        "DATA:Application/Octet-Stream;Base64," + test::base64(file.binary),
        "data:application/gltf-buffer;name=a%20b;base64," + test::base64(file.binary),
        "data:model/vnd.example;base64," + half_escaped, "data:application/octet-stream," + escaped,
        "data:," + escaped}) {
    file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", uri}}};
    SCOPED_TRACE(uri.substr(0, 60));
    expect_square(file);
  }
  file.json["buffers"][0]["uri"] = "data:application/octet-stream;base64";
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("buffers/0: \"data:application"));
  file.json["buffers"][0]["uri"] = "data:;base64,AA!A";
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("malformed at character 2"));
}

TEST_F(GltfModelFile, ReportsByteLengthBeyondData) {
  GltfBuilder file = square();
  file.json["buffers"] = {{{"byteLength", file.binary.size() + 1},
                           {"uri", "data:;base64," + test::base64(file.binary)}}};
  EXPECT_THAT(error_of(loaded(file.gltf())),
              HasSubstr("buffers/0/byteLength: is 61, but its data has 60 bytes"));
  file.json["buffers"][0]["byteLength"] = 10;
  EXPECT_THAT(error_of(loaded(file.gltf())),
              HasSubstr("reaches past the end of its buffer (10 bytes)"));
  file.json["buffers"][0]["byteLength"] = -5;
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("buffers/0/byteLength: is -5"));
  // A data URI may contain more bytes than the buffer's byteLength.
  file.json["buffers"][0] = {{"byteLength", file.binary.size()},
                             {"uri", "data:;base64," + test::base64(file.binary + "more")}};
  expect_square(file);
}

TEST_F(GltfModelFile, DecodesFileNamesByRfc3986) {
  GltfBuilder file = square();
  for (const auto& [uri, name] :
       std::map<std::string, std::string>{{"a+b.bin", "a+b.bin"},
                                          {"a%20b%2Bc.bin", "a b+c.bin"},
                                          {"sch%C3%B6n.bin", "schön.bin"},
                                          {"50%.bin", "50%.bin"},
                                          {"half%20kept.bin", "half%20kept.bin"}}) {
    const auto data = write(name, file.binary);
    file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", uri}}};
    SCOPED_TRACE(uri);
    expect_square(file);
    std::filesystem::remove(data);
  }
}

TEST_F(GltfModelFile, IgnoresUnusedBuffers) {
  GltfBuilder file = square();
  file.json["buffers"] = {
      {{"byteLength", file.binary.size()}, {"uri", "data:;base64," + test::base64(file.binary)}},
      {{"byteLength", 4'000'000'000}},
      {{"byteLength", 77}, {"uri", "missing.bin"}}};
  expect_square(file);
  file.json["bufferViews"][0]["buffer"] = 1;
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("buffers/1: has neither a uri nor data"));
  file.json["bufferViews"][0]["buffer"] = 2;
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("missing.bin: not found"));
}

TEST_F(GltfModelFile, ReadsAccessorsWithoutBufferViewAsZeros) {
  GltfBuilder file = square();
  file.json["accessors"].push_back({{"componentType", 5126}, {"count", 4}, {"type", "VEC2"}});
  file.primitive()["attributes"]["TEXCOORD_0"] = file.json["accessors"].size() - 1;
  expect_square(file);
  // Indices without data are zeros, so both faces consist of vertex 0 only.
  file.json["accessors"][1].erase("bufferView");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->meshes[0].indices, testing::Each(0U));
}

TEST_F(GltfModelFile, LimitsElementsWithoutBufferView) {
  GltfBuilder file = square();
  for (const char* attribute : {"NORMAL", "COLOR_0"}) {
    const bool is_color = std::string(attribute) == "COLOR_0";
    file.json["accessors"].push_back(
        {{"componentType", 5126}, {"count", 4}, {"type", is_color ? "VEC4" : "VEC3"}});
    file.primitive()["attributes"][attribute] = file.json["accessors"].size() - 1;
  }
  // Normals and colours take 28 of the 40 numbers that the limit allows.
  file.json["accessors"][1].erase("bufferView");
  const auto with_corners = [&](int count) {
    file.json["accessors"][1]["count"] = count;
    ModelLoadOptions reading;
    reading.limits.max_vertices = 40;
    return load_model(write("model.gltf", file.gltf()), reading);
  };
  EXPECT_TRUE(with_corners(12)) << error_of(with_corners(12));
  EXPECT_THAT(error_of(with_corners(15)),
              HasSubstr("has no buffer view; the file has more than 40 numbers without data"));
  // This short file would need 2 GB of memory.
  file.json["accessors"][1]["count"] = 60'000'000;
  file.json["accessors"][1]["type"] = "VEC4";
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("has no buffer view"));
}

TEST_F(GltfModelFile, AcceptsWholeNumbersWrittenWithPoint) {
  GltfBuilder file = square();
  file.json["nodes"][0]["mesh"] = 0.0;
  file.json["bufferViews"][1]["byteOffset"] = 48.0;
  expect_square(file);
}

TEST_F(GltfModelFile, ReportsFieldsOfWrongType) {
  const auto error_with = [&](const nlohmann::json::json_pointer& field,
                              const nlohmann::json& value) {
    GltfBuilder file = square();
    file.json[field] = value;
    return error_of(loaded(file.gltf()));
  };
  using Pointer = nlohmann::json::json_pointer;
  EXPECT_THAT(error_with(Pointer("/nodes/0/mesh"), "0"),
              HasSubstr("nodes/0/mesh: is \"0\"; a whole number from 0 on is expected"));
  EXPECT_THAT(error_with(Pointer("/nodes/0/mesh"), -1), HasSubstr("nodes/0/mesh: is -1"));
  EXPECT_THAT(error_with(Pointer("/nodes/0/mesh"), 1e12), HasSubstr("nodes/0/mesh: is 1"));
  EXPECT_THAT(error_with(Pointer("/nodes/0/scale"), {1, "1", 1}), HasSubstr("nodes/0/scale: is"));
  EXPECT_THAT(error_with(Pointer("/nodes/0/children"), 3), HasSubstr("nodes/0/children: is 3"));
  EXPECT_THAT(error_with(Pointer("/meshes"), 3), HasSubstr("meshes: is 3; a list is expected"));
  EXPECT_THAT(error_with(Pointer("/accessors/0/normalized"), 1),
              HasSubstr("accessors/0/normalized: is 1; true or false is expected"));
  EXPECT_THAT(error_with(Pointer("/bufferViews/0/byteOffset"), 0.5),
              HasSubstr("bufferViews/0/byteOffset: is 0.5"));
}

TEST_F(GltfModelFile, AcceptsByteOrderMark) {
  expect_square(loaded("\xEF\xBB\xBF" + square().gltf()));
}

TEST_F(GltfModelFile, ReadsFilesOutsideFolderFromModelFolder) {
  GltfBuilder file = square();
  write("data.bin", file.binary);
  for (const char* uri : {"..%2Fother/data.bin", "C:%5Cmodels%5Cdata.bin", "/srv/data.bin"}) {
    file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", uri}}};
    expect_square_with_warning(file, "is outside the model's folder");
  }
}

TEST_F(GltfModelFile, KeepsShapeOfModelsFarFromOrigin) {
  GltfBuilder file = square();
  file.json["nodes"][0]["translation"] = {300'000.0, 2.0, -500'000.0};
  file.json["nodes"][0]["scale"] = {0.01, 1, 1};
  file.json["nodes"].push_back({{"children", {0}}, {"translation", {0.25, 0, 0}}});
  file.json["scenes"][0]["nodes"] = {1};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->warnings, IsEmpty());
  EXPECT_NEAR(test::measure_projected_area(*model).front, 1e-4, 1e-9);
  const Eigen::Vector3d corner =
      model->origin + Eigen::Vector3d(model->min_corner.x, model->min_corner.y, 0.0);
  EXPECT_NEAR(corner.x(), 300'000.25, 1e-6);
  EXPECT_NEAR(corner.y(), 499'999.9, 1e-6);
  // A file whose coordinates are too coarse for its shape gives a warning.
  GltfBuilder coarse;
  coarse.node(
      {{"mesh", coarse.mesh({3e5F, 0, 0, 3e5F, 0, 0.1F, 300000.09375F, 0, 0.1F}, {0, 1, 2})}});
  const auto lost = loaded(coarse.gltf());
  ASSERT_TRUE(lost) << error_of(lost);
  EXPECT_THAT(lost->warnings, ElementsAre(HasSubstr("km from its origin")));
}

// --- primitives without a surface ---

TEST_F(GltfModelFile, IgnoresLinesAndPointsBesideFaces) {
  for (int mode = 0; mode < 4; ++mode) {
    GltfBuilder file = square();
    nlohmann::json lines = file.primitive();
    lines["mode"] = mode;
    file.json["meshes"][0]["primitives"].push_back(lines);
    expect_square_with_warning(file, "meshes/0/primitives/1: draws points or lines");
    file.json["meshes"][0]["primitives"].push_back(lines);
    expect_square_with_warning(file, "meshes/0/primitives/1 (and 1 more): draws points or lines");
    file.json["meshes"][0]["primitives"] = {lines};
    EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("draws points or lines"));
  }
  GltfBuilder file = square();
  file.primitive()["mode"] = 7;
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("primitives/0/mode: 7 is none of glTF's"));
}

TEST_F(GltfModelFile, IgnoresMeshesWithoutNode) {
  GltfBuilder file = square();
  nlohmann::json broken = file.json["meshes"][0];
  broken["primitives"][0]["mode"] = 1;
  file.json["meshes"].push_back(broken);
  broken["primitives"][0] = {{"attributes", {{"POSITION", 99}}}, {"material", 88}};
  file.json["meshes"].push_back(broken);
  expect_square(file);
}

TEST_F(GltfModelFile, IgnoresPrimitiveWithoutPositions) {
  GltfBuilder file = square();
  nlohmann::json& primitives = file.json["meshes"][0]["primitives"];
  primitives.push_back({{"attributes", {{"NORMAL", 0}}}, {"indices", 1}});
  expect_square_with_warning(file, "meshes/0/primitives/1: has no POSITION attribute");
  primitives.push_back(nlohmann::json::object());
  expect_square_with_warning(file, "meshes/0/primitives/1 (and 1 more): has no POSITION");
  const auto model = loaded(file.gltf());
  EXPECT_EQ(model->source_vertex_count, 4U);
}

TEST_F(GltfModelFile, HidesNodesOfZeroScale) {
  GltfBuilder file = square();
  file.node({{"mesh", 0}, {"scale", {0, 0, 0}}, {"children", {3}}});
  file.node({{"mesh", 0}, {"matrix", {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1}}});
  file.json["nodes"].push_back({{"mesh", 0}});
  expect_square(file);
}

TEST_F(GltfModelFile, IgnoresNodesFlattenedToLine) {
  GltfBuilder file = square();
  file.node({{"mesh", 0}, {"name", "lid"}, {"scale", {1, 0, 0}}});
  file.node({{"mesh", 0}, {"scale", {0, 1, 0}}});
  expect_square_with_warning(file, "nodes/1 (\"lid\") (and 1 more): its scale leaves no surface");
}

// A body flattened to a plane casts the same shadow from both sides.
TEST_F(GltfModelFile, KeepsSurfaceOfNodesFlattenedToPlane) {
  GltfBuilder file;
  const std::size_t box =
      file.mesh({0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3});
  file.primitive()["attributes"]["NORMAL"] =
      file.accessor(std::vector<float>{-1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1}, "VEC3");
  file.node({{"mesh", box}, {"scale", {1, 0, 1}}});
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 0.5, 1e-7);
  EXPECT_NEAR(test::measure_projected_area(*model).back, 0.5, 1e-7);
  for (const glm::vec3& n : model->meshes[0].normals) EXPECT_NEAR(glm::length(n), 1.0F, 1e-6F);
}

TEST_F(GltfModelFile, HidesChildrenOfHiddenNodes) {
  const auto visible = [](bool shown) {
    return nlohmann::json{{"KHR_node_visibility", {{"visible", shown}}}};
  };
  GltfBuilder file = square();
  file.json["nodes"][0]["extensions"] = visible(true);
  file.node({{"mesh", 0}, {"extensions", visible(false)}, {"children", {2}}});
  file.json["nodes"].push_back({{"mesh", 0}, {"extensions", visible(true)}});
  file.json["extensionsUsed"] = {"KHR_node_visibility"};
  file.json["extensionsRequired"] = {"KHR_node_visibility"};
  expect_square(file);
}

TEST_F(GltfModelFile, PlacesCopyOfMeshForEachInstance) {
  GltfBuilder file = square();
  file.json["nodes"][0]["translation"] = {0, 1, 0};
  file.json["nodes"][0]["scale"] = {2, 1, 1};
  const float half = std::sqrt(0.5F);
  nlohmann::json& attributes =
      file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  attributes["TRANSLATION"] =
      file.accessor(std::vector<float>{0, 0, 0, 1, 0, 0, 2, 0.5F, 0}, "VEC3");
  // The second instance is mirrored, the third turned over.
  attributes["ROTATION"] =
      file.accessor(std::vector<float>{0, 0, 0, 1, 0, half, 0, half, 1, 0, 0, 0}, "VEC4");
  attributes["SCALE"] = file.accessor(std::vector<float>{1, 1, 1, 1, 1, -3, 0.5F, 1, 1}, "VEC3");
  attributes["_ID"] = file.accessor(std::vector<std::uint8_t>{1, 2, 3}, "SCALAR");
  file.json["extensionsRequired"] = {"EXT_mesh_gpu_instancing"};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->warnings, IsEmpty());
  EXPECT_EQ(model->triangle_count(), 6U);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 0.02 + 0.06, 1e-8);
  EXPECT_NEAR(test::measure_projected_area(*model).back, 0.01, 1e-8);
  // The third instance: x from 2 to 2.05, doubled by the node.
  EXPECT_NEAR(model->max_corner.x, 4.1F, 1e-6F);
  EXPECT_NEAR(model->max_corner.z, 1.5F, 1e-6F);
  attributes["SCALE"] = file.accessor(std::vector<float>{1, 1, 1}, "VEC3");
  EXPECT_THAT(error_of(loaded(file.gltf())),
              HasSubstr("nodes/0/extensions/EXT_mesh_gpu_instancing/attributes: have 1 and 3"));
}

TEST_F(GltfModelFile, LimitsInstancesBeforeCreatingThem) {
  GltfBuilder file = square();
  const std::vector<float> translations(std::size_t{3} * 6, 0.5F);
  file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] =
      file.accessor(translations, "VEC3");
  const auto limited = [&](std::size_t vertices) {
    ModelLoadOptions reading;
    reading.limits.max_vertices = vertices;
    return load_model(write("model.gltf", file.gltf()), reading);
  };
  EXPECT_TRUE(limited(24)) << error_of(limited(24));
  EXPECT_THAT(error_of(limited(23)),
              HasSubstr("nodes/0: has 6 instances; 5 of this mesh can be read"));
}

TEST_F(GltfModelFile, MatchesAreaOfSharedNodeCases) {
  // The expected values are areas of shadows. The bodies overlap in projection, so only the front
  // faces of boxes are summed.
  for (const auto& [file, area] : std::map<std::string, double>{
           {"gltf-hidden-node/scale0_all.gltf", 0.01},
           {"gltf-hidden-node/scale0_two_axes.gltf", 0.01},
           {"gltf-lines-beside-triangles/mixed_lines.gltf", 0.01},
           {"gltf-lines-beside-triangles/mixed_points.gltf", 0.01},
           {"gltf-lines-beside-triangles/unused_lines_mesh.gltf", 0.01},
           {"gltf-factor-rounding/factor_1p0001.gltf", 0.01},
           {"gltf-plus-in-uri/plus.gltf", 0.01},
           {"gltf-accessor-without-buffer-view/no_bufferview_texcoord.gltf", 0.01},
           {"gltf-harmless-required-extension/ext_KHR_lights_punctual_required.gltf", 0.01},
           {"gltf-harmless-required-extension/ext_KHR_materials_unlit_required.gltf", 0.01},
           {"gltf-harmless-required-extension/ext_KHR_texture_transform_required.gltf", 0.01},
           {"model-refused-for-its-pictures/tex_missing_file.gltf", 0.01},
           {"model-refused-for-its-pictures/tex_no_source.gltf", 0.01},
           {"model-refused-for-its-pictures/tex_webp_ext_only.gltf", 0.01},
           {"model-refused-for-its-pictures/tex_webp_file.gltf", 0.01},
           {"gltf-data-uri-forms/data-uri-charset.gltf", 0.0063},
           {"gltf-data-uri-forms/unused-buffer-4GB-without-uri.gltf", 0.0063},
           {"gltf-data-uri-forms/primitive-without-position.gltf", 0.0126},
           {"gltf-instances-and-visibility/visibility-used.gltf", 0.0126}}) {
    const auto model = shared_case(file);
    if (!model) GTEST_SKIP() << "no shared data beside the checkout";
    ASSERT_TRUE(*model) << error_of(*model);
    EXPECT_NEAR(test::measure_projected_area(**model).front, area, 1e-6) << file;
  }
  const auto instances = shared_case("gltf-instances-and-visibility/instances-used.gltf");
  ASSERT_TRUE(*instances) << error_of(*instances);
  EXPECT_EQ((*instances)->triangle_count(), 3 * 24U + 12U);
  // A box of 1 m; a box of 2 m and above it one that is rounded to an octagon.
  for (const auto& [file, area] : std::map<std::string, double>{
           {"BoxDraco-gltf-transform.gltf", 1.0}, {"meshopt-no-fallback.gltf", 6.0469}}) {
    const auto model = shared_case("gltf-draco-meshopt-message/" + file);
    ASSERT_TRUE(*model) << error_of(*model);
    EXPECT_NEAR(test::measure_projected_area(**model).front, area, 1e-3) << file;
    EXPECT_THAT((*model)->warnings, IsEmpty());
  }
}

// --- materials ---

TEST_F(GltfModelFile, ClampsMaterialFactors) {
  GltfBuilder file = square();
  file.primitive()["attributes"]["TEXCOORD_0"] = file.accessor(std::vector<float>(8, 0.0F), "VEC2");
  file.primitive()["material"] = 0;
  file.json["materials"] = {{{"pbrMetallicRoughness",
                              {{"baseColorFactor", {1.0000001192092896, 1.00016, -1e-9, 1}},
                               {"roughnessFactor", 1.0002}}},
                             {"occlusionTexture", {{"index", 0}, {"strength", 1.0000001}}}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["images"] = {
      {{"uri", "data:;base64," + test::base64(test::png_bytes(test::one_color(9, 9, 9)))}}};
  expect_square(file);
  EXPECT_EQ(loaded(file.gltf())->materials[0].base_color, glm::vec4(1, 1, 0, 1));
  file.json["materials"][0]["emissiveFactor"] = {5, 0, 0};
  expect_square_with_warning(file, "materials/0: a factor is outside 0 to 1 and is clamped");
  EXPECT_EQ(loaded(file.gltf())->materials[0].emissive, glm::vec3(1, 0, 0));
}

TEST_F(GltfModelFile, NamesMissingTextureCoordinates) {
  GltfBuilder file = square();
  file.primitive()["material"] = 0;
  file.json["materials"] = {
      {{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}, {"texCoord", 1}}}}}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["images"] = {
      {{"uri", "data:;base64," + test::base64(test::png_bytes(test::one_color(9, 9, 9)))}}};
  expect_square_with_warning(file,
                             "has no TEXCOORD_1, which its textures need; they are drawn in one");
}

TEST_F(GltfModelFile, FallsBackToPlainColourWithoutImage) {
  GltfBuilder file = square();
  file.primitive()["material"] = 0;
  file.json["materials"] = {
      {{"pbrMetallicRoughness",
        {{"baseColorFactor", {1, 0, 0, 1}}, {"baseColorTexture", {{"index", 0}}}}},
       {"emissiveTexture", {{"index", 0}}}}};
  file.json["textures"] = {{{"source", 0}}};
  const auto expect_plain = [&](const std::string& warning) {
    expect_square_with_warning(file, warning);
    const auto model = loaded(file.gltf());
    EXPECT_EQ(model->materials[0].base_color_texture.image, -1);
    EXPECT_EQ(model->materials[0].base_color, glm::vec4(1, 0, 0, 1));
  };
  const auto image = [&](const std::string& uri) { file.json["images"] = {{{"uri", uri}}}; };
  image("gone.png");
  expect_plain("images/0: " + (folder_.path() / "gone.png").string() + ": not found");
  image("data:image/webp;base64,UklGRg==");
  expect_plain("images/0: is neither JPEG nor PNG");
  image("data:image/png;base64,");
  expect_plain("images/0");
  const auto png = test::png_bytes(test::one_color(9, 9, 9));
  const std::string half(png.begin(), png.begin() + static_cast<std::ptrdiff_t>(png.size() / 2));
  image("data:image/png;base64," + test::base64(half));
  expect_plain("images/0");
  image(std::string(5000, 'x'));
  expect_plain("not found");
  image("%00.png");
  expect_plain("names no file beside the model");
  file.json["images"] = {nlohmann::json::object()};
  expect_plain("images/0: has neither a uri nor a bufferView");
  file.json["images"] = {{{"bufferView", 77}}};
  expect_plain("images/0: names buffer view 77");
  file.json["textures"] = {{{"source", 9}}};
  expect_plain("names image 9, there are 1");
  file.json["textures"] = {nlohmann::json::object()};
  file.json["materials"][0].erase("emissiveTexture");
  expect_plain("textures/0: has no source; drawn in plain colour");
  file.json["textures"] = {{{"extensions", {{"EXT_texture_webp", {{"source", 0}}}}}}};
  expect_plain("images/0: names buffer view 77");
  file.json["textures"] = {{{"extensions", {{"KHR_texture_basisu", {{"source", 0}}}}}}};
  expect_plain("textures/0: has only an image of the glTF extension KHR_texture_basisu");
}

TEST_F(GltfModelFile, ReadsFallbackImage) {
  GltfBuilder file = square();
  file.primitive()["attributes"]["TEXCOORD_0"] = file.accessor(std::vector<float>(8, 0.0F), "VEC2");
  file.primitive()["material"] = 0;
  file.json["materials"] = {{{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}}}}}}};
  file.json["images"] = {
      {{"uri", "gone.webp"}},
      {{"uri", "data:;base64," + test::base64(test::png_bytes(test::one_color(9, 9, 9)))}}};
  file.json["textures"] = {
      {{"source", 1}, {"extensions", {{"EXT_texture_webp", {{"source", 0}}}}}}};
  file.json["extensionsUsed"] = {"EXT_texture_webp"};
  expect_square(file);
}

TEST_F(GltfModelFile, IgnoresImagesOfUnusedMaterials) {
  GltfBuilder file = square();
  file.json["materials"] = {{{"emissiveTexture", {{"index", 0}}}, {"alphaMode", "GLOW"}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["images"] = {{{"uri", "gone.png"}}};
  expect_square(file);
}

TEST_F(GltfModelFile, ReportsAndIgnoresMalformedMaterialFields) {
  GltfBuilder file = square();
  file.primitive()["material"] = 0;
  file.json["materials"] = {{{"pbrMetallicRoughness", {{"metallicFactor", "1"}}}}};
  expect_square_with_warning(
      file, "materials/0/pbrMetallicRoughness/metallicFactor: is \"1\"; a number is expected");
}

// --- extensions and unread content ---

TEST_F(GltfModelFile, ReportsRequiredExtensionsThatKeepShape) {
  for (const char* extension :
       {"KHR_materials_clearcoat", "KHR_materials_variants", "KHR_materials_pbrSpecularGlossiness",
        "KHR_texture_basisu", "EXT_texture_avif", "KHR_lights_punctual", "EXT_lights_image_based",
        "KHR_xmp_json_ld", "KHR_animation_pointer", "MSFT_lod", "AGI_articulations"}) {
    GltfBuilder file = square();
    file.json["extensionsRequired"] = {extension};
    expect_square_with_warning(
        file, std::string("needs the glTF extension ") + extension + ", which is not read");
  }
}

TEST_F(GltfModelFile, ReadsRequiredExtensionsWithoutWarning) {
  for (const char* extension :
       {"KHR_materials_unlit", "KHR_materials_emissive_strength", "KHR_texture_transform",
        "EXT_texture_webp", "KHR_draco_mesh_compression", "EXT_meshopt_compression",
        "KHR_meshopt_compression"}) {
    GltfBuilder file = square();
    file.json["extensionsRequired"] = {extension};
    expect_square(file);
  }
}

TEST_F(GltfModelFile, RejectsRequiredExtensionsThatMayChangeShape) {
  for (const char* extension : {"EXT_of_tomorrow", "CESIUM_RTC", "KHR_gaussian_splatting"}) {
    GltfBuilder file = square();
    file.json["extensionsRequired"] = {extension};
    EXPECT_THAT(error_of(loaded(file.gltf())),
                HasSubstr(std::string("needs the glTF extension ") + extension +
                          ", which can't be read; export without it"));
  }
}

TEST_F(GltfModelFile, ReportsUsedExtensionsWithVisibleContent) {
  for (const auto& [extension, consequence] : std::map<std::string, std::string>{
           {"KHR_materials_variants", "the default materials are shown"},
           {"MSFT_lod", "the finest level of detail is shown"},
           {"KHR_animation_pointer", "what only it animates keeps its value"},
           {"CESIUM_primitive_outline", "outlines are not drawn"}}) {
    GltfBuilder file = square();
    // tinygltf 2.9 refuses MSFT_lod without ids.
    file.json["nodes"][0]["extensions"][extension] = {{"ids", {0}}};
    expect_square_with_warning(
        file, "its glTF extension " + extension + " (nodes/0) is not read: " + consequence);
  }
  GltfBuilder file = square();
  file.json["nodes"][0]["extensions"]["KHR_xmp_json_ld"] = {{"packet", 0}};
  expect_square(file);
}

TEST_F(GltfModelFile, ReportsShownSceneAmongSeveral) {
  GltfBuilder file = square();
  file.json["scenes"].push_back({{"name", "night"}, {"nodes", {0}}});
  expect_square_with_warning(file, "has 2 scenes; only scenes/0 is shown");
  file.json["scene"] = 1;
  expect_square_with_warning(file, "has 2 scenes; only scenes/1 (\"night\") is shown");
}

TEST_F(GltfModelFile, ReportsIgnoredContentOncePerKind) {
  GltfBuilder file = square();
  file.json["animations"] = {nlohmann::json::object(), nlohmann::json::object()};
  file.json["cameras"] = {{{"type", "no camera at all"}}};
  file.json["extensions"]["KHR_lights_punctual"]["lights"] = {{{"type", "point"}}};
  file.node({{"extensions", {{"KHR_lights_punctual", {{"light", 0}}}}}});
  file.primitive()["material"] = 0;
  file.json["materials"] = {
      {{"extensions", {{"KHR_materials_clearcoat", nlohmann::json::object()}}}},
      {{"extensions", {{"KHR_materials_clearcoat", nlohmann::json::object()}}}}};
  file.json["nodes"][0]["extensions"]["EXT_of_tomorrow"] = {{"a", 1}};
  file.json["extensionsUsed"] = {"KHR_lights_punctual", "KHR_materials_clearcoat",
                                 "EXT_of_tomorrow", "KHR_materials_sheen"};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(
      model->warnings,
      ElementsAre(
          HasSubstr("its animations (2) are not played: the rest pose is shown"),
          HasSubstr("its cameras (1) are not used"),
          HasSubstr("its glTF extension EXT_of_tomorrow (nodes/0) is not read"),
          HasSubstr("its glTF extension KHR_lights_punctual (the file) is not read: its "
                    "lights are not used"),
          HasSubstr("its glTF extension KHR_materials_clearcoat (materials/0) is not read")));
}

}  // namespace
}  // namespace penumbra
