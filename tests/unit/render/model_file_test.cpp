// Model files: the formats that are read, and the line that an error message names.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <functional>
#include <glm/geometric.hpp>
#include <map>
#include <string>

#include "render/model/model.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/scene/shapes.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

// A triangle in the file's xy plane. Each test changes a part of the text.
const std::string kTriangle = R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":36},
{"buffer":0,"byteOffset":36,"byteLength":6}],"buffers":[{"byteLength":42,"uri":"data.bin"}]})";

std::string triangle_data(float x = 1.0F, std::uint16_t index = 2) {
  const float positions[] = {0, 0, 0, x, 0, 0, 0, 1, 0};
  const std::uint16_t indices[] = {0, 1, index};
  std::string data(42, '\0');
  std::memcpy(data.data(), positions, 36);
  std::memcpy(data.data() + 36, indices, 6);
  return data;
}

class ModelFile : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& name, const std::string& text) {
    const std::filesystem::path file = folder_.path() / name;
    std::ofstream(file, std::ios::binary) << text;
    return file;
  }
  Result<Model> gltf(const std::string& from = "", const std::string& to = "",
                     const std::string& data = triangle_data()) {
    std::string text = kTriangle;
    if (!from.empty()) {
      EXPECT_NE(text.find(from), std::string::npos) << from;
      text.replace(text.find(from), from.size(), to);
    }
    write("data.bin", data);
    return load_model(write("model.gltf", text));
  }
  Result<Model> obj(const std::string& text) { return load_model(write("model.obj", text)); }
  std::string error_of(const Result<Model>& model) {
    return model ? "was accepted" : model.error().message;
  }
  test::TemporaryFolder folder_;
};

TEST_F(ModelFile, RotatesGltfFromYUpToZUp) {
  const Result<Model> model = gltf();
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_EQ(model->triangle_count(), 1U);
  EXPECT_EQ(model->meshes[0].positions[2], glm::vec3(0, 0, 1));
  // Counter-clockwise about the file's +z axis, which is the -y axis of the object frame.
  EXPECT_EQ(model->meshes[0].normals[0], glm::vec3(0, -1, 0));
  EXPECT_EQ(model->source_vertex_count, 3U);
}

TEST_F(ModelFile, KeepsOutsideOfMirroredNode) {
  const Result<Model> model = gltf(R"({"mesh":0})", R"({"mesh":0,"scale":[-1,1,1]})");
  ASSERT_TRUE(model) << error_of(model);
  const Mesh& mesh = model->meshes[0];
  const auto& p = mesh.positions;
  const auto& i = mesh.indices;
  const glm::vec3 face = glm::cross(p[i[1]] - p[i[0]], p[i[2]] - p[i[0]]);
  EXPECT_EQ(face, glm::vec3(0, -1, 0));
  EXPECT_EQ(mesh.normals[0], glm::vec3(0, -1, 0));
}

TEST_F(ModelFile, RejectsMalformedGltfAndReportsField) {
  const std::string nodes = R"("nodes":[{"mesh":0}])";
  EXPECT_THAT(error_of(gltf("\"byteLength\":36", "\"byteLength\":3600")),
              HasSubstr("bufferViews/0: reaches past the end of its buffer (42 bytes)"));
  EXPECT_THAT(error_of(gltf("\"count\":3,\"type\":\"VEC3\"", "\"count\":4,\"type\":\"VEC3\"")),
              HasSubstr("reaches past the end of its buffer view (36 bytes)"));
  EXPECT_THAT(error_of(gltf("\"byteOffset\":0,", "\"byteOffset\":2,")),
              HasSubstr("not aligned to its components of 4 bytes"));
  EXPECT_THAT(error_of(gltf("", "", triangle_data(1.0F, 3))),
              HasSubstr("names vertex 3, there are 3"));
  EXPECT_THAT(error_of(gltf("", "", triangle_data(std::nanf("")))),
              HasSubstr("has a number that is not finite"));
  EXPECT_THAT(error_of(gltf("", "", triangle_data(2e6F))), HasSubstr("farther than 1000000 units"));
  EXPECT_THAT(error_of(gltf(nodes, R"("nodes":[{"mesh":0,"children":[0]}])")),
              HasSubstr("nodes/0: has two parents or is its own ancestor"));
  EXPECT_THAT(error_of(gltf(R"("mesh":0)", R"("mesh":7)")),
              HasSubstr("nodes/0: names mesh 7, there are 1"));
  EXPECT_THAT(error_of(gltf(R"("indices":1)", R"("indices":1,"mode":1)")),
              HasSubstr("draws points or lines"));
  EXPECT_THAT(error_of(gltf(R"("scene":0)", R"("extensionsRequired":["EXT_of_tomorrow"])")),
              HasSubstr("needs the glTF extension EXT_of_tomorrow"));
  EXPECT_THAT(error_of(gltf("\"POSITION\":0", "\"POSITION\":9")),
              HasSubstr("names accessor 9, there are 2"));
  EXPECT_THAT(error_of(gltf("\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                            "\"indices\":1}]}]",
                            "\"meshes\":[]")),
              HasSubstr("names mesh 0, there are 0"));
}

TEST_F(ModelFile, LimitsNodeNesting) {
  std::string nodes = "\"nodes\":[";
  for (int i = 0; i < 100; ++i) nodes += fmt::format("{{\"children\":[{}]}},", i + 1);
  nodes += "{\"mesh\":0}]";
  EXPECT_THAT(error_of(gltf(R"("nodes":[{"mesh":0}])", nodes)), HasSubstr("nested deeper than 64"));
  const std::string deep = std::string(5000, '[') + std::string(5000, ']');
  EXPECT_THAT(error_of(gltf(R"("scene":0)", "\"extras\":" + deep)),
              HasSubstr("JSON is nested deeper than 64"));
}

// A draw call for each node would take seconds per frame.
TEST_F(ModelFile, MergesNodesOfOneMaterialIntoOneMesh) {
  constexpr int kNodes = 20'000;
  std::string nodes = "\"nodes\":[", list;
  for (int i = 0; i < kNodes; ++i) {
    nodes += fmt::format("{}{{\"mesh\":{},\"translation\":[0,0,{}]}}", i == 0 ? "" : ",", i % 3, i);
    list += fmt::format("{}{}", i == 0 ? "" : ",", i);
  }
  nodes += "]";
  std::string text = kTriangle;
  const auto replace = [&text](const std::string& from, const std::string& to) {
    ASSERT_NE(text.find(from), std::string::npos) << from;
    text.replace(text.find(from), from.size(), to);
  };
  replace(R"("nodes":[{"mesh":0}])", nodes);
  replace(R"({"nodes":[0]})", "{\"nodes\":[" + list + "]}");
  const std::string triangle = R"({"attributes":{"POSITION":0},"indices":1})";
  const std::string metal = R"({"attributes":{"POSITION":0},"indices":1,"material":0})";
  // Three primitives: plain material, metal, and plain material with vertex colours.
  replace(R"("meshes":[{"primitives":[)" + triangle + "]}]",
          R"("materials":[{"name":"metal"}],"meshes":[{"name":"a","primitives":[)" + triangle +
              R"(]},{"name":"b","primitives":[)" + metal + R"(]},{"name":"c","primitives":[)" +
              R"({"attributes":{"POSITION":0,"COLOR_0":0},"indices":1})" + "]}]");
  write("data.bin", triangle_data());
  const Result<Model> model = load_model(write("model.gltf", text));
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_EQ(model->meshes.size(), 2U);
  EXPECT_EQ(model->meshes[0].name, "a");
  EXPECT_EQ(model->meshes[1].name, "b");
  EXPECT_EQ(model->triangle_count(), std::size_t{kNodes});
  // Each use of a mesh has separate vertices, in the order of use.
  EXPECT_EQ(model->source_vertex_count, 3U * kNodes);
  const Mesh& plain = model->meshes[0];
  // Every third node is metal, so plain triangle t belongs to node t + ceil(t / 2).
  for (const std::uint32_t t : {0U, 1U, 2U, 9'999U}) {
    const std::uint32_t node = t + t / 2 + t % 2;
    for (std::uint32_t k = 0; k < 3; ++k) {
      const std::uint32_t i = plain.indices[3 * t + k];
      EXPECT_EQ(i, 3 * t + k);
      EXPECT_EQ(plain.source_vertex[i], 3 * node + k);
      EXPECT_EQ(plain.positions[i].y, -static_cast<float>(node)) << t;
    }
    EXPECT_EQ(plain.colors[3 * t], node % 3 == 2 ? glm::vec4(0, 0, 0, 1) : glm::vec4(1.0F));
  }
}

TEST_F(ModelFile, RejectsTooManyMaterials) {
  ModelLimits limits;
  limits.max_meshes = 2;
  std::string text, materials;
  for (int i = 0; i < 3; ++i) {
    text += fmt::format("v {0} 0 0\nv {0} 1 0\nv {0} 0 1\nusemtl m{0}\nf -3 -2 -1\n", i);
    materials += fmt::format("newmtl m{}\nKd 0 0 1\n", i);
  }
  write("m.mtl", materials);
  const auto file = write("model.obj", "mtllib m.mtl\n" + text);
  EXPECT_THAT(error_of(load_model(file, {.limits = limits})),
              HasSubstr("has 3 materials in use, more than the 2 allowed"));
  EXPECT_TRUE(load_model(file));
}

TEST_F(ModelFile, RejectsAndReportsNodesWithoutExtent) {
  EXPECT_THAT(error_of(gltf(R"({"mesh":0})", R"({"mesh":0,"name":"lid","scale":[0,0,0]})")),
              HasSubstr("nodes/0 (\"lid\"): its scale leaves no surface to see"));
  EXPECT_THAT(error_of(gltf(R"({"mesh":0})", R"({"mesh":0,"scale":[0,1,0]})")),
              HasSubstr("nodes/0: its scale leaves no surface to see"));
  EXPECT_TRUE(gltf(R"({"mesh":0})", R"({"mesh":0,"scale":[1,1,0]})")) << "a flat node is kept";
}

TEST_F(ModelFile, ContinuesObjLinesAfterBackslash) {
  const Result<Model> model =
      obj("# from C:\\models\\\nv 0 0 0\nv 1 \\\r\n 0 \\\n 0\nv 0 1 0\nf 1 2\\\n 3\n");
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->triangle_count(), 1U);
  EXPECT_EQ(model->source_vertex_count, 3U);
  EXPECT_EQ(model->max_corner, glm::vec3(1, 1, 0));
  EXPECT_THAT(error_of(obj("v 0 \\\n0 0\nv 1 0 x\nf 1 1 1\n")), HasSubstr("line 3: \"x\""));
  EXPECT_THAT(error_of(obj("v 0 0 \\")), HasSubstr("line 1: \"v\" has 2 numbers"));
}

TEST_F(ModelFile, NeverReadsFilesOutsideFolder) {
  std::filesystem::create_directory(folder_.path() / "inner");
  write("inner/model.gltf", kTriangle);
  write("data.bin", triangle_data());
  for (const std::string uri : {"../data.bin", "/etc/../data.bin", "a/../../data.bin"}) {
    std::string text = kTriangle;
    text.replace(text.find("data.bin"), 8, uri);
    EXPECT_THAT(error_of(load_model(write("inner/model.gltf", text))),
                HasSubstr("inner/data.bin: not found"))
        << uri;
  }
  EXPECT_THAT(error_of(gltf("data.bin", "missing.bin")), HasSubstr("missing.bin: not found"));
}

TEST_F(ModelFile, ReplacesElementsBySparseAccessor) {
  // The sparse accessor replaces the second point by the third point of the buffer.
  const Result<Model> model =
      gltf("\"count\":3,\"type\":\"VEC3\"",
           "\"count\":3,\"type\":\"VEC3\",\"sparse\":{\"count\":1,\"indices\":{\"bufferView\":1,"
           "\"byteOffset\":2,\"componentType\":5123},\"values\":{\"bufferView\":0,"
           "\"byteOffset\":24}}");
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->meshes[0].positions[1], glm::vec3(0, 0, 1));
}

TEST_F(ModelFile, ValidatesGlbContainer) {
  std::ifstream stream(test::source_dir() / "scenes/models/helicopter_rotor.glb", std::ios::binary);
  const std::string good((std::istreambuf_iterator<char>(stream)), {});
  ASSERT_TRUE(load_model(write("good.glb", good)));
  EXPECT_THAT(error_of(load_model(write("cut.glb", good.substr(0, good.size() / 2)))),
              HasSubstr("is cut off"));
  EXPECT_THAT(error_of(load_model(write("noise.glb", std::string(500, 'x')))),
              HasSubstr("does not start with \"glTF\""));
  // The header of the binary chunk claims 8 bytes more than the file has.
  std::string longer = good;
  std::uint32_t json = 0, bin = 0;
  std::memcpy(&json, good.data() + 12, 4);
  std::memcpy(&bin, good.data() + 20 + json, 4);
  bin += 8;
  std::memcpy(longer.data() + 20 + json, &bin, 4);
  EXPECT_THAT(error_of(load_model(write("long.glb", longer))),
              HasSubstr("chunk 1 reaches past the end"));
}

TEST_F(ModelFile, ReadsObjAxesAsWrittenOrRotatedOnRequest) {
  const std::string text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 5\nf 1 2 -2\n";
  const Result<Model> model = obj(text);
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->meshes[0].normals[0], glm::vec3(0, 0, 1));
  EXPECT_EQ(model->source_vertex_count, 4U);
  EXPECT_EQ(model->meshes[0].source_vertex[2], 2U);
  const Result<Model> rotated = load_model(folder_.path() / "model.obj", {.up = UpAxis::y});
  ASSERT_TRUE(rotated);
  EXPECT_EQ(rotated->meshes[0].positions[2], glm::vec3(0, 0, 1));
}

TEST_F(ModelFile, RejectsMalformedObjWithLine) {
  EXPECT_THAT(error_of(obj("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")),
              HasSubstr("line 2: \"nan\" is not a finite number"));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n")),
              HasSubstr("line 2: \"inf\" is not a finite number"));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv 1x 0 0\nv 0 1 0\nf 1 2 3\n")), HasSubstr("\"1x\""));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")),
              HasSubstr("line 4: a face names vertex 4, there are 3"));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n")),
              HasSubstr("line 4: \"0\" is not a corner"));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n")), HasSubstr("has no faces"));
  EXPECT_THAT(error_of(obj("v 0 0 0\nv 1 0 0\nl 1 2\n")),
              HasSubstr("has no faces, but 1 lines and points without a surface"));
  EXPECT_THAT(error_of(obj("v 0 0\nf 1 1 1\n")), HasSubstr("line 1: \"v\" has 2 numbers"));
  EXPECT_THAT(error_of(obj("# nothing\n")), HasSubstr("has no faces"));
}

TEST_F(ModelFile, WarnsOfMissingObjMaterialFile) {
  const Result<Model> model = obj("mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_THAT(model->warnings,
              testing::ElementsAre(testing::AllOf(HasSubstr("line 1"), HasSubstr("lost.mtl"))));
}

TEST_F(ModelFile, ColoursFacesByObjMaterials) {
  write("m.mtl", "newmtl paint\nKd 1 0.5 0\nKe 0 0 1\n");
  const Result<Model> model =
      obj("mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nusemtl paint\nf 1 2 3\nusemtl "
          "none\nf 2 4 3\n");
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_EQ(model->meshes.size(), 2U);
  EXPECT_EQ(model->materials[0].name, "paint");
  EXPECT_NEAR(model->materials[0].base_color.g, 0.21404F, 1e-4F);  // linear value of sRGB 0.5
  EXPECT_EQ(model->materials[0].emissive.b, 1.0F);
}

TEST_F(ModelFile, RejectsMissingEmptyAndUnsupportedFiles) {
  EXPECT_THAT(error_of(load_model(folder_.path() / "no.glb")), HasSubstr("no.glb"));
  EXPECT_THAT(error_of(load_model(write("a.ply", "ply"))), HasSubstr("give a .glb, .gltf or .obj"));
  EXPECT_THAT(error_of(load_model(write("a.glb", ""))), HasSubstr("is empty"));
}

// Expects that each edge is traversed equally often in both directions, that no face has zero area,
// and that the faces enclose a positive volume.
void expect_closed(const Model& model, const std::string& name) {
  const ShadowMesh mesh = make_shadow_mesh(model);
  EXPECT_EQ(mesh.indices.size() / 3, model.triangle_count()) << name << ": faces collapsed";
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  double volume = 0.0;
  for (std::size_t t = 0; t < mesh.indices.size(); t += 3) {
    const glm::dvec3 a(mesh.positions[mesh.indices[t]]), b(mesh.positions[mesh.indices[t + 1]]),
        c(mesh.positions[mesh.indices[t + 2]]);
    EXPECT_GT(glm::length(glm::cross(b - a, c - a)), 0.0) << name << ": face " << t / 3;
    volume += glm::dot(a, glm::cross(b, c)) / 6.0;
    for (std::size_t k = 0; k < 3; ++k) {
      ++edges[{mesh.indices[t + k], mesh.indices[t + (k + 1) % 3]}];
    }
  }
  EXPECT_GT(volume, 0.0) << name;
  for (const auto& [edge, count] : edges) {
    const auto back = edges.find({edge.second, edge.first});
    ASSERT_TRUE(back != edges.end() && back->second == count) << name << ": an open edge";
  }
}

TEST(BundledModelFiles, AreClosed) {
  for (const char* name : {"helicopter", "helicopter_rotor", "helicopter_tail_rotor"}) {
    const Result<Model> model =
        load_model(test::source_dir() / "scenes/models" / (std::string(name) + ".glb"));
    ASSERT_TRUE(model) << model.error().message;
    expect_closed(*model, name);
  }
}

TEST(BundledModelFiles, MatchOutputOfMakeModels) {
  test::TemporaryFolder folder;
  const std::string command = std::string(PENUMBRA_MAKE_MODELS) + " " + folder.path().string() +
                              " > " + (folder.path() / "log").string();
  ASSERT_EQ(std::system(command.c_str()), 0);
  for (const char* name : {"helicopter.glb", "helicopter_rotor.glb", "helicopter_tail_rotor.glb"}) {
    const auto bytes = [name](const std::filesystem::path& in) {
      std::ifstream stream(in / name, std::ios::binary);
      return std::string((std::istreambuf_iterator<char>(stream)), {});
    };
    const std::string written = bytes(folder.path());
    ASSERT_FALSE(written.empty());
    EXPECT_TRUE(written == bytes(test::source_dir() / "scenes/models"))
        << name << ": run make_models again";
  }
}

TEST(Shapes, AreClosedAndOfRequestedSize) {
  expect_closed(make_box({0.1F, 0.2F, 0.3F}), "box");
  expect_closed(make_sphere(0.1F), "sphere");
  expect_closed(make_cylinder(0.1F, 0.3F), "cylinder");
  expect_closed(make_ring(0.1F, 0.03F), "ring");
  EXPECT_EQ(make_box({0.1F, 0.2F, 0.3F}).max_corner, glm::vec3(0.05F, 0.1F, 0.15F));
}

TEST(Subdivision, LeavesNoLongEdgeAndNoCrack) {
  Model box = make_box({0.1F, 0.2F, 0.3F});
  const Mesh fine = subdivided(box.meshes[0], 0.03F);
  for (std::size_t t = 0; t < fine.indices.size(); t += 3) {
    for (std::size_t k = 0; k < 3; ++k) {
      EXPECT_LE(glm::length(fine.positions[fine.indices[t + k]] -
                            fine.positions[fine.indices[t + (k + 1) % 3]]),
                0.0301F);
    }
  }
  box.meshes[0] = fine;
  expect_closed(box, "subdivided box");
  const Mesh limited = subdivided(make_sphere(1.0F).meshes[0], 0.001F, 5000);
  EXPECT_LE(limited.indices.size() / 3, 5000U);
  EXPECT_GT(limited.indices.size() / 3, 3000U);
}

}  // namespace
}  // namespace penumbra
