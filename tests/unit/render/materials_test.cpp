// glTF materials. A textured square must equal, pixel by pixel, a square with equivalent factors or
// geometry. Further tests cover transparency, back-face culling and rejected materials.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <webp/encode.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <glm/geometric.hpp>
#include <map>
#include <numbers>
#include <random>

#include "render/model/cut_out.hpp"
#include "render/model/shadow_mesh.hpp"
#include "support/paths.hpp"
#include "support/studio.hpp"
#include "support/test_form.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

using test::one_color;
using test::png_bytes;
using test::RenderedImage;
using test::SceneBuilder;
using test::Studio;
using test::TexturedSquare;
using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kSide = 240;
constexpr double kHeight = 0.05;

Result<Model> loaded(const TexturedSquare& square) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "square.glb";
  std::ofstream(file, std::ios::binary) << test::glb_of(square);
  return load_model(file);
}
std::shared_ptr<const Model> model_of(const TexturedSquare& square) {
  auto model = loaded(square);
  if (!model) throw std::runtime_error(model.error().message);
  return std::make_shared<const Model>(std::move(*model));
}
std::string error_of(const TexturedSquare& square) {
  const auto model = loaded(square);
  return model ? "was accepted" : model.error().message;
}

CameraModel camera() {
  return test::camera_of(kSide, kSide, 420.0);
}
const Eigen::Vector3d kEye(0.12, -0.3, 0.45);
PoseEstimate pose() {
  return test::tracked(test::look_at(kEye, {0.0, 0.0, kHeight}));
}
SceneBuilder builder_with(double ambient = 0.3) {
  SceneBuilder builder;
  builder.scene().shadows[0].technique = ShadowTechnique::none;
  builder.scene().ambient = Eigen::Vector3d::Constant(ambient);
  SceneLight lamp;
  lamp.position = {-0.15, 0.25, 0.5};
  lamp.intensity = 0.6;
  builder.scene().lights.push_back(lamp);
  return builder;
}
struct Drawing {
  double ambient = 0.3;
  Translucency mode = Translucency::blend;
  GlApi api = GlApi::gl33;
  bool phantom = false;
};
using AtHeights = std::vector<std::pair<std::shared_ptr<const Model>, double>>;
RenderedImage drawn(const AtHeights& at_heights, const Drawing& drawing = {}) {
  SceneBuilder builder = builder_with(drawing.ambient);
  for (const auto& [model, height] : at_heights)
    builder.add(model, test::at(0, 0, height), false, drawing.phantom);
  Studio studio(builder.build(), camera(), drawing.api);
  PlanOptions options;
  options.translucency = drawing.mode;
  return studio.draw(test::plain_frame(kSide, kSide, 120), studio.plan(pose(), options));
}
RenderedImage drawn(const TexturedSquare& square, const Drawing& drawing = {}) {
  return drawn({{model_of(square), kHeight}}, drawing);
}

// Visits every pixel well inside the square at this height, with the pixel's position on the square
// [m]. Returns the number of pixels.
template <class Action>
int inside(const Action& action, double height = kHeight) {
  int count = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera().unproject({static_cast<double>(x), static_cast<double>(y)});
      const Eigen::Vector3d d = pose().T_table_camera.rotation() * *ray;
      const Eigen::Vector3d p = kEye + (height - kEye.z()) / d.z() * d;
      if (std::max(std::abs(p.x()), std::abs(p.y())) > 0.097) continue;
      action(x, y, p.x(), p.y());
      ++count;
    }
  }
  return count;
}
int largest_difference(const RenderedImage& a, const RenderedImage& b) {
  int largest = 0;
  inside([&](int x, int y, double, double) {
    for (int c = 0; c < 3; ++c)
      largest = std::max(largest, std::abs(int{a.at(x, y)[c]} - int{b.at(x, y)[c]}));
  });
  return largest;
}
TexturedSquare square_of(const std::string& material, std::vector<RgbaImage> images = {}) {
  TexturedSquare square;
  square.material = material;
  for (const RgbaImage& image : images) square.images.push_back(png_bytes(image));
  return square;
}
float linear(int code) {
  const float encoded = static_cast<float>(code) / 255.0F;
  return encoded <= 0.04045F ? encoded / 12.92F : std::pow((encoded + 0.055F) / 1.055F, 2.4F);
}

constexpr const char* kPlain =
    R"("pbrMetallicRoughness":{"baseColorFactor":[0.7,0.5,0.3,1],"metallicFactor":0.2,"roughnessFactor":0.4})";

TEST(Materials, DrawsPlainSquare) {
  const RenderedImage image = drawn(square_of(kPlain));
  int changed = 0;
  EXPECT_GT(inside([&](int x, int y, double, double) { changed += image.red(x, y) != 120; }), 5000);
  EXPECT_GT(changed, 5000);
}

// A white metal reflects all light at any roughness: under light of strength 1 from all directions
// its colour is 1. (Without the light between its facets, a rough one is half as bright.)
TEST(Materials, KeepsLightOfRoughMetal) {
  for (const double roughness : {0.7, 1.0}) {
    const auto square = model_of(square_of(fmt::format(
        R"("pbrMetallicRoughness":{{"metallicFactor":1,"roughnessFactor":{}}})", roughness)));
    for (const Eigen::Vector3d& eye : {Eigen::Vector3d(0.02, -0.05, 0.5), {0.1, -0.4, 0.3}}) {
      constexpr int kDirections = 96;
      constexpr int kAtOnce = 8;
      double sum = 0.0;
      for (int first = 0; first < kDirections; first += kAtOnce) {
        SceneBuilder builder;
        builder.scene().shadows[0].technique = ShadowTechnique::none;
        builder.scene().ambient.setZero();
        builder.add(square, test::at(0, 0, kHeight), false);
        for (int i = first; i < first + kAtOnce; ++i) {
          // Evenly over the hemisphere (Fibonacci spiral).
          const double z = (i + 0.5) / kDirections;
          const double turn = 2.0 * std::numbers::pi * 0.6180339887 * i;
          const double r = std::sqrt(1.0 - z * z);
          SceneLight light;
          light.kind = SceneLight::Kind::directional;
          light.direction = {r * std::cos(turn), r * std::sin(turn), z};
          light.intensity = 0.12;  // eight lights stay below the compression of bright light
          builder.scene().lights.push_back(light);
        }
        Studio studio(builder.build(), camera());
        const PoseEstimate from = test::tracked(test::look_at(eye, {0.0, 0.0, kHeight}));
        const RenderedImage image =
            studio.draw(test::plain_frame(kSide, kSide, 0), studio.plan(from, {}));
        sum += static_cast<double>(linear(image.red(kSide / 2, kSide / 2))) / 0.12;
      }
      // A light adds pi times the reflected fraction; the hemisphere is 2 pi.
      EXPECT_NEAR(2.0 * sum / kDirections, 1.0, 0.1) << roughness << ", " << eye.transpose();
    }
  }
}

TEST(Materials, MultipliesMetallicRoughnessTextureByFactors) {
  const auto textured = [](int rough, int metal) {
    return drawn(square_of(
        R"("pbrMetallicRoughness":{"baseColorFactor":[0.7,0.5,0.3,1],"metallicFactor":0.9,"roughnessFactor":0.8,"metallicRoughnessTexture":{"index":0}})",
        {one_color(9, rough, metal)}));
  };
  const auto by_factors = [](int rough, int metal) {
    return drawn(square_of(fmt::format(
        R"("pbrMetallicRoughness":{{"baseColorFactor":[0.7,0.5,0.3,1],"metallicFactor":{},"roughnessFactor":{}}})",
        0.9 * metal / 255.0, 0.8 * rough / 255.0)));
  };
  EXPECT_LE(largest_difference(textured(140, 200), by_factors(140, 200)), 1);
  EXPECT_LE(largest_difference(textured(60, 20), by_factors(60, 20)), 1);
  EXPECT_GT(largest_difference(textured(60, 20), by_factors(140, 200)), 20);
}

TEST(Materials, MultipliesEmissiveTextureByFactor) {
  const auto emissive = [](const std::string& more, std::vector<RgbaImage> images) {
    return drawn(square_of(std::string(kPlain) + "," + more, std::move(images)));
  };
  const RenderedImage textured = emissive(
      R"("emissiveFactor":[0.5,0.2,0.4],"emissiveTexture":{"index":0})", {one_color(188, 90, 255)});
  const RenderedImage by_factor = emissive(
      fmt::format(R"("emissiveFactor":[{},{},{}])", 0.5F * linear(188), 0.2F * linear(90), 0.4F),
      {});
  EXPECT_LE(largest_difference(textured, by_factor), 1);
  EXPECT_GT(largest_difference(textured, drawn(square_of(kPlain))), 20);
}

TEST(Materials, DarkensOnlyAmbientLightByOcclusion) {
  const auto occluded = [](int red, double strength) {
    return drawn(
        square_of(std::string(kPlain) +
                      fmt::format(R"(,"occlusionTexture":{{"index":0,"strength":{}}})", strength),
                  {one_color(red, 255, 0)}),
        {0.6});
  };
  const auto ambient = [](double factor) { return drawn(square_of(kPlain), {0.6 * factor}); };
  EXPECT_LE(largest_difference(occluded(102, 1.0), ambient(0.4)), 1);
  EXPECT_LE(largest_difference(occluded(102, 0.5), ambient(0.7)), 1);
  EXPECT_LE(largest_difference(occluded(102, 0.0), ambient(1.0)), 1);
  EXPECT_GT(largest_difference(occluded(102, 1.0), ambient(1.0)), 10);
}

// Unit normal that a texel of the normal map encodes, in the square's tangent space.
std::array<float, 3> decoded(int r, int g, int b, double scale = 1.0) {
  const Eigen::Vector3d n = Eigen::Vector3d(scale * (2.0 * r / 255.0 - 1.0),
                                            scale * (2.0 * g / 255.0 - 1.0), 2.0 * b / 255.0 - 1.0)
                                .normalized();
  return {static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z())};
}
// Normals in the file's axes: y is up, and the texture's top is at -z.
std::vector<std::array<float, 3>> normals_of(float right, float towards_top, float up) {
  return std::vector<std::array<float, 3>>(4, {right, up, -towards_top});
}
constexpr const char* kBumpy = R"(,"normalTexture":{"index":0})";

TEST(Materials, ShadesNormalTextureLikeVertexNormals) {
  std::vector<std::array<int, 3>> texels = {{60, 90, 220}};  // tilted along both axes
  if (test::nightly()) texels.insert(texels.end(), {{204, 128, 230}, {128, 204, 230}});
  for (const auto& [r, g, b] : texels) {
    SCOPED_TRACE(fmt::format("{} {} {}", r, g, b));
    const auto [x, y, z] = decoded(r, g, b);
    TexturedSquare geometry = square_of(kPlain);
    geometry.normals = normals_of(x, y, z);
    const RenderedImage expected = drawn(geometry);
    TexturedSquare bumpy = square_of(std::string(kPlain) + kBumpy, {one_color(r, g, b)});
    EXPECT_LE(largest_difference(drawn(bumpy), expected), 1) << "derived tangents";
    bumpy.tangents = std::vector<std::array<float, 4>>(4, {1, 0, 0, 1});
    const RenderedImage given = drawn(bumpy);
    EXPECT_LE(largest_difference(given, expected), 1) << "tangents of the file";
    EXPECT_LE(largest_difference(drawn(bumpy, {0.3, Translucency::blend, GlApi::gles30}), expected),
              1);
    EXPECT_GT(largest_difference(given, drawn(square_of(kPlain))), 5);
    // Tangents of the file have priority over the texture layout. Here they are rotated by 90
    // degrees, so that the texture's x axis points to its top.
    bumpy.tangents = std::vector<std::array<float, 4>>(4, {0, 0, -1, 1});
    geometry.normals = normals_of(-y, x, z);
    EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1) << "rotated";
    bumpy.tangents = std::vector<std::array<float, 4>>(4, {1, 0, 0, -1});
    geometry.normals = normals_of(x, -y, z);
    EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1) << "mirrored";
    // Tangents without normals are ignored.
    bumpy.normals.clear();
    EXPECT_LE(largest_difference(drawn(bumpy), expected), 1) << "without normals";
  }
}

TEST(Materials, OrientsNormalTextureByItsLayout) {
  const auto [x, y, z] = decoded(204, 160, 230);
  const auto [sx, sy, sz] = decoded(204, 160, 230, 0.5);
  TexturedSquare bumpy = square_of(std::string(kPlain) + kBumpy, {one_color(204, 160, 230)});
  TexturedSquare geometry = square_of(kPlain);
  // A mirrored layout: left becomes right.
  bumpy.texcoords = {{1, 1}, {0, 1}, {0, 0}, {1, 0}};
  geometry.normals = normals_of(-x, y, z);
  EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1);
  // Rotated by 90 degrees: the texture's right is the square's top.
  bumpy.texcoords = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
  geometry.normals = normals_of(-y, x, z);
  EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1);
  // The node mirrors the square.
  bumpy.texcoords = TexturedSquare().texcoords;
  bumpy.node = R"("scale":[-1,1,1])";
  geometry.normals = normals_of(-x, y, z);
  EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1);
  bumpy.tangents = std::vector<std::array<float, 4>>(4, {1, 0, 0, 1});
  EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1);
  // The material halves the normal scale.
  bumpy = square_of(std::string(kPlain) + R"(,"normalTexture":{"index":0,"scale":0.5})",
                    {one_color(204, 160, 230)});
  geometry.normals = normals_of(sx, sy, sz);
  EXPECT_LE(largest_difference(drawn(bumpy), drawn(geometry)), 1);
}

// The texture layout is mirrored at an edge. Vertices on the edge are split, so that each half has
// its own tangents.
TEST(Materials, SplitsTangentsAtMirroredTexture) {
  TexturedSquare bumpy = square_of(std::string(kPlain) + kBumpy, {one_color(204, 128, 230)});
  // The halves are mirrored at the diagonal u = v.
  bumpy.texcoords = {{0, 0}, {1, 0}, {1, 1}, {1, 0}};
  const auto model = model_of(bumpy);
  ASSERT_EQ(model->meshes.size(), 1U);
  const Mesh& mesh = model->meshes[0];
  EXPECT_EQ(mesh.positions.size(), 6U);
  EXPECT_EQ(mesh.tangents.size(), 6U);
  EXPECT_EQ(model->source_vertex_count, 4U);
  for (std::size_t face = 0; face < 2; ++face) {
    const float side = mesh.tangents[mesh.indices[3 * face]].w;
    for (std::size_t k = 0; k < 3; ++k)
      EXPECT_EQ(mesh.tangents[mesh.indices[3 * face + k]].w, side);
  }
  EXPECT_NE(mesh.tangents[mesh.indices[0]].w, mesh.tangents[mesh.indices[3]].w);
}

TEST(Materials, MapsTexturesByTextureCoordinates) {
  const auto halves = [](std::array<int, 4> left, std::array<int, 4> right) {
    return test::image_of(2, 1, [=](int x, int) { return x == 0 ? left : right; });
  };
  constexpr const char* kMaps =
      R"("pbrMetallicRoughness":{"metallicFactor":1,"baseColorTexture":{"index":0},"metallicRoughnessTexture":{"index":1,"texCoord":1}})";
  TexturedSquare square = square_of(kMaps, {halves({200, 90, 60, 255}, {60, 90, 200, 255}),
                                            halves({0, 70, 20, 255}, {0, 180, 230, 255})});
  square.samplers = R"({"magFilter":9728,"minFilter":9728})";
  square.texcoords_1 = {{1, 1}, {0, 1}, {0, 0}, {1, 0}};
  const RenderedImage textured = drawn(square);
  const auto half = [](std::array<int, 3> color, int rough, int metal) {
    return drawn(square_of(fmt::format(
        R"("pbrMetallicRoughness":{{"baseColorFactor":[{},{},{},1],"metallicFactor":{},"roughnessFactor":{}}})",
        linear(color[0]), linear(color[1]), linear(color[2]), metal / 255.0, rough / 255.0)));
  };
  const RenderedImage left = half({200, 90, 60}, 180, 230);
  const RenderedImage right = half({60, 90, 200}, 70, 20);
  int wrong = 0;
  inside([&](int x, int y, double px, double) {
    if (std::abs(px) < 0.002) return;
    const RenderedImage& expected = px < 0.0 ? left : right;
    for (int c = 0; c < 3; ++c)
      wrong += std::abs(int{textured.at(x, y)[c]} - int{expected.at(x, y)[c]}) > 1 ? 1 : 0;
  });
  EXPECT_EQ(wrong, 0);
}

TEST(Materials, WrapsTexturesBySampler) {
  const auto wrapped = [](int wrap) {
    TexturedSquare square = square_of(
        R"("emissiveFactor":[1,1,1],"emissiveTexture":{"index":0},"pbrMetallicRoughness":{"baseColorFactor":[0,0,0,1]})",
        {test::image_of(2, 1, [](int x, int) {
          return x == 0 ? std::array<int, 4>{0, 0, 0, 255} : std::array<int, 4>{140, 140, 140, 255};
        })});
    square.samplers = fmt::format(R"({{"magFilter":9728,"minFilter":9728,"wrapS":{}}})", wrap);
    square.texcoords = {{-1, 1}, {2, 1}, {2, 0}, {-1, 0}};
    return drawn(square);
  };
  // Each sixth of the square's width is bright or dark.
  const std::map<int, std::array<bool, 6>> expected = {
      {10497, {false, true, false, true, false, true}},
      {33071, {false, false, false, true, true, true}},
      {33648, {true, false, false, true, true, false}}};
  for (const auto& [wrap, bright] : expected) {
    SCOPED_TRACE(wrap);
    const RenderedImage image = wrapped(wrap);
    int wrong = 0;
    inside([&](int x, int y, double px, double) {
      const double sixth = (px + 0.1) / 0.2 * 6.0;
      if (std::abs(sixth - std::round(sixth)) < 0.06) return;
      wrong += (image.red(x, y) > 100) != bright[static_cast<std::size_t>(sixth)] ? 1 : 0;
    });
    EXPECT_EQ(wrong, 0);
  }
}

constexpr const char* kCut =
    R"("pbrMetallicRoughness":{"baseColorFactor":[0.7,0.5,0.3,0.8],"baseColorTexture":{"index":0}},"alphaMode":"MASK","alphaCutoff":0.4)";

TEST(Materials, RemovesPixelsBelowAlphaCutoff) {
  const auto cut = [](int left, int right) {
    TexturedSquare square =
        square_of(kCut, {test::image_of(2, 1, [=](int x, int) {
                    return std::array<int, 4>{255, 255, 255, x == 0 ? left : right};
                  })});
    square.samplers = R"({"magFilter":9728,"minFilter":9728})";
    return square;
  };
  // Alpha at the two texels: 0.8 * 120 / 255 = 0.38 and 0.8 * 135 / 255 = 0.42.
  const RenderedImage image = drawn(cut(120, 135));
  const RenderedImage whole = drawn(cut(255, 255));
  int wrong = 0;
  inside([&](int x, int y, double px, double) {
    if (std::abs(px) < 0.002) return;
    for (int c = 0; c < 3; ++c)
      wrong += image.at(x, y)[c] != (px < 0.0 ? 120 : whole.at(x, y)[c]) ? 1 : 0;
  });
  EXPECT_EQ(wrong, 0);
  // A phantom occludes only where the alpha of its material reaches the cutoff.
  SceneBuilder builder = builder_with();
  builder.add(model_of(cut(120, 135)), test::at(0, 0, 0.1), false, true);
  builder.add(model_of(square_of(kPlain)), test::at(0, 0, kHeight), false);
  Studio studio(builder.build(), camera());
  const RenderedImage behind =
      studio.draw(test::plain_frame(kSide, kSide, 120), studio.plan(pose()));
  int seen = 0;
  int hidden = 0;
  inside([&](int x, int y, double, double) { (behind.red(x, y) == 120 ? hidden : seen) += 1; });
  EXPECT_GT(seen, 2000);
  EXPECT_GT(hidden, 1000);
}

std::string glass(double r, double g, double b, double alpha) {
  return fmt::format(
      R"("alphaMode":"BLEND","pbrMetallicRoughness":{{"baseColorFactor":[{},{},{},{}],"metallicFactor":0}})",
      r, g, b, alpha);
}
std::string solid(double r, double g, double b) {
  return fmt::format(
      R"("pbrMetallicRoughness":{{"baseColorFactor":[{},{},{},1],"metallicFactor":0}})", r, g, b);
}

TEST(Materials, BlendsByOpacity) {
  const RenderedImage opaque = drawn(square_of(solid(0.8, 0.3, 0.1)));
  for (const Translucency mode : {Translucency::blend, Translucency::retexture}) {
    const RenderedImage mixed = drawn(square_of(glass(0.8, 0.3, 0.1, 0.35)), {0.3, mode});
    int wrong = 0;
    inside([&](int x, int y, double, double) {
      for (int c = 0; c < 3; ++c) {
        const double expected = 0.65 * 120.0 + 0.35 * opaque.at(x, y)[c];
        wrong += std::abs(mixed.at(x, y)[c] - expected) > 1.01 ? 1 : 0;
      }
      EXPECT_EQ(mixed.at(x, y)[3], 255);
    });
    EXPECT_EQ(wrong, 0) << to_string(mode);
  }
  // A screen-door pattern covers 6 of 16 pixels.
  const RenderedImage dithered =
      drawn(square_of(glass(0.8, 0.3, 0.1, 0.35)), {0.3, Translucency::mesh});
  int open = 0;
  int wrong = 0;
  const int all = inside([&](int x, int y, double, double) {
    open += dithered.red(x, y) == 120 ? 1 : 0;
    wrong += dithered.red(x, y) != 120 && dithered.red(x, y) != opaque.red(x, y) ? 1 : 0;
  });
  EXPECT_EQ(wrong, 0);
  EXPECT_NEAR(static_cast<double>(open) / all, 10.0 / 16.0, 0.02);
}

// Opaque objects are drawn first, then blended objects from back to front.
TEST(Materials, SortsBlendedObjectsBackToFront) {
  const auto red = model_of(square_of(glass(0.9, 0.1, 0.1, 0.5)));
  const auto green = model_of(square_of(glass(0.1, 0.9, 0.1, 0.5)));
  const auto white = model_of(square_of(solid(0.9, 0.9, 0.9)));
  for (const Translucency mode :
       {Translucency::blend, Translucency::retexture, Translucency::mesh}) {
    SCOPED_TRACE(to_string(mode));
    const Drawing drawing{0.3, mode};
    const RenderedImage red_first = drawn({{red, 0.1}, {green, kHeight}, {white, 0.0}}, drawing);
    const RenderedImage white_first = drawn({{white, 0.0}, {green, kHeight}, {red, 0.1}}, drawing);
    EXPECT_EQ(red_first, white_first);
    EXPECT_NE(red_first, drawn({{green, 0.1}, {red, kHeight}, {white, 0.0}}, drawing));
  }
}

TEST(Materials, SortsBlendedTrianglesBackToFront) {
  const auto stack = [](bool reversed) {
    auto model = std::make_shared<Model>();
    Material material;
    material.base_color.a = 0.5F;
    material.alpha_mode = AlphaMode::blend;
    model->materials.push_back(material);
    Mesh& mesh = model->meshes.emplace_back();
    for (int i = 0; i < 5; ++i) {
      const int layer = reversed ? 4 - i : i;
      const float z = 0.02F * static_cast<float>(layer);
      const auto first = static_cast<std::uint32_t>(mesh.positions.size());
      for (const auto& [x, y] :
           {std::pair(-0.1F, -0.1F), {0.1F, -0.1F}, {0.1F, 0.1F}, {-0.1F, 0.1F}}) {
        mesh.positions.emplace_back(x, y, z);
        mesh.normals.emplace_back(0.0F, 0.0F, 1.0F);
        mesh.colors.emplace_back(layer % 2 == 0 ? 1.0F : 0.1F, 0.2F * static_cast<float>(layer),
                                 0.3F, 1.0F);
        mesh.source_vertex.push_back(first);
      }
      for (const std::uint32_t k : {0U, 1U, 2U, 0U, 2U, 3U}) mesh.indices.push_back(first + k);
    }
    model->source_vertex_count = static_cast<std::uint32_t>(mesh.positions.size());
    model->min_corner = {-0.1F, -0.1F, 0.0F};
    model->max_corner = {0.1F, 0.1F, 0.08F};
    return model;
  };
  const RenderedImage bottom_first = drawn({{stack(false), 0.0}});
  EXPECT_EQ(bottom_first, drawn({{stack(true), 0.0}}));
}

// A fading overlay reduces the opacity of blended materials by the same factor.
TEST(Materials, FadesBlendedMaterialsWithOverlay) {
  SceneBuilder builder = builder_with();
  builder.add(model_of(square_of(glass(0.8, 0.3, 0.1, 0.6))), test::at(0, 0, kHeight), false);
  Studio studio(builder.build(), camera());
  FramePlan plan = studio.plan(pose());
  const Frame frame = test::plain_frame(kSide, kSide, 120);
  const RenderedImage full = studio.draw(frame, plan);
  for (ObjectDraw& draw : plan.objects) draw.opacity = 0.5F;
  const RenderedImage faint = studio.draw(frame, plan);
  int wrong = 0;
  inside([&](int x, int y, double, double) {
    wrong += std::abs(faint.red(x, y) - 0.5 * (120 + full.red(x, y))) > 1.01 ? 1 : 0;
  });
  EXPECT_EQ(wrong, 0);
}

TEST(Materials, DrawsBackFacesOnlyWhenDoubleSided) {
  TexturedSquare square = square_of(kPlain);
  square.node = R"("rotation":[1,0,0,0])";  // upside down
  const RenderedImage video = drawn(AtHeights{{nullptr, 0.0}});
  EXPECT_EQ(drawn(square), video);
  square.material += R"(,"doubleSided":true)";
  EXPECT_GT(largest_difference(drawn(square), video), 20);
  // Seen from behind, a normal-mapped face equals its front, rotated by half a turn.
  square = square_of(std::string(kPlain) + R"(,"doubleSided":true,"normalTexture":{"index":0})",
                     {one_color(204, 128, 230)});
  square.node = R"("rotation":[1,0,0,0])";
  const auto [x, y, z] = decoded(204, 128, 230);
  TexturedSquare geometry = square_of(kPlain);
  // Half a turn about the texture's x axis keeps that axis. Seen from behind, the whole tangent
  // frame is reversed.
  geometry.normals = normals_of(-x, y, z);
  EXPECT_LE(largest_difference(drawn(square), drawn(geometry)), 1);
  // A phantom occludes from both sides.
  SceneBuilder builder = builder_with();
  TexturedSquare real = square_of(kPlain);
  real.node = R"("rotation":[1,0,0,0])";
  builder.add(model_of(real), test::at(0, 0, 0.1), false, true);
  builder.add(model_of(square_of(kPlain)), test::at(0, 0, 0.02), false);
  Studio studio(builder.build(), camera());
  const RenderedImage behind =
      studio.draw(test::plain_frame(kSide, kSide, 120), studio.plan(pose()));
  int hidden = 0;
  inside([&](int x2, int y2, double, double) { hidden += behind.red(x2, y2) == 120 ? 1 : 0; }, 0.1);
  EXPECT_GT(hidden, 5000);
}

// --- KHR_materials_unlit, KHR_materials_emissive_strength ---

constexpr const char* kUnlit = R"("extensions":{"KHR_materials_unlit":{}})";

// Compares the square's colour with these encoded values.
void expect_color(const RenderedImage& image, const std::array<int, 3>& color) {
  int wrong = 0;
  inside([&](int x, int y, double, double) {
    for (int c = 0; c < 3; ++c)
      wrong += std::abs(int{image.at(x, y)[c]} - color[static_cast<std::size_t>(c)]) > 1 ? 1 : 0;
  });
  EXPECT_EQ(wrong, 0) << fmt::format("{} instead of {} {} {}", image.red(kSide / 2, kSide / 2),
                                     color[0], color[1], color[2]);
}

TEST(Materials, DrawsUnlitMaterialInItsBaseColour) {
  const std::string factor = fmt::format(
      R"("pbrMetallicRoughness":{{"baseColorFactor":[{},{},{},1],"metallicFactor":0.3}},{})",
      linear(240), linear(120), linear(30), kUnlit);
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    for (const double ambient : {0.0, 0.9}) {
      expect_color(drawn(square_of(factor), {ambient, Translucency::blend, api}), {240, 120, 30});
    }
  }
  const std::string textured =
      std::string(R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}},)") + kUnlit;
  expect_color(drawn(square_of(textured, {one_color(255, 200, 9)})), {255, 200, 9});
  // Other properties are for readers without the extension.
  expect_color(
      drawn(square_of(
          R"("emissiveFactor":[1,1,1],"emissiveTexture":{"index":0},"normalTexture":{"index":0},"occlusionTexture":{"index":0},)" +
              textured,
          {one_color(90, 60, 30)})),
      {90, 60, 30});
  // As a phantom, it shows the video.
  Drawing phantom;
  phantom.phantom = true;
  expect_color(drawn(square_of(factor), phantom), {120, 120, 120});
}

TEST(Materials, CutsOutAndBlendsUnlitMaterial) {
  const auto square = [](const std::string& alpha) {
    return square_of(
        R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}},)" + alpha + "," + kUnlit,
        {one_color(200, 100, 50, 127)});
  };
  expect_color(drawn(square(R"("alphaMode":"MASK","alphaCutoff":0.4)")), {200, 100, 50});
  expect_color(drawn(square(R"("alphaMode":"MASK","alphaCutoff":0.6)")), {120, 120, 120});
  expect_color(drawn(square(R"("alphaMode":"BLEND")")), {160, 110, 85});
}

// One lit square above an unlit one, and the other way round: each keeps its own program.
TEST(Materials, DrawsLitAndUnlitMaterialsTogether) {
  const auto lit = model_of(square_of(kPlain));
  const auto unlit = model_of(
      square_of(std::string(R"("pbrMetallicRoughness":{"baseColorFactor":[1,1,1,1]},)") + kUnlit));
  EXPECT_EQ(largest_difference(drawn({{lit, kHeight}, {unlit, 0.01}}), drawn({{lit, kHeight}})), 0);
  expect_color(drawn({{lit, 0.01}, {unlit, kHeight}}), {255, 255, 255});
}

TEST(Materials, MultipliesEmissionByStrength) {
  const auto square = [](double factor, const std::string& strength) {
    return square_of(fmt::format(
        R"("pbrMetallicRoughness":{{"baseColorFactor":[0,0,0,1]}},"emissiveFactor":[{0},{0},{1}]{2})",
        factor, 0.5 * factor,
        strength.empty()
            ? ""
            : fmt::format(
                  R"(,"extensions":{{"KHR_materials_emissive_strength":{{"emissiveStrength":{}}}}})",
                  strength)));
  };
  EXPECT_EQ(largest_difference(drawn(square(0.2, "3")), drawn(square(0.6, ""))), 0);
  const auto strong = model_of(square(1.0, "250.5"));
  EXPECT_EQ(strong->materials[0].emissive, glm::vec3(250.5F, 250.5F, 125.25F));
  EXPECT_TRUE(strong->warnings.empty());
  EXPECT_GE(drawn({{strong, kHeight}}).red(kSide / 2, kSide / 2), 254);
  for (const auto& [strength, emissive] :
       std::map<std::string, float>{{"1e30", kMaxEmissive}, {"-2", 0.0F}}) {
    const auto model = model_of(square(1.0, strength));
    EXPECT_EQ(model->materials[0].emissive.r, emissive);
    EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("materials/0: its emissiveStrength is "
                                                       "outside 0 to 10000 and is clamped")));
  }
  const auto malformed = model_of(square(1.0, "\"4\""));
  EXPECT_THAT(malformed->warnings, ElementsAre(HasSubstr("emissiveStrength: is \"4\"")));
}

// --- EXT_texture_webp ---

// Four colours that differ in every channel.
RgbaImage quarters() {
  return test::image_of(2, 2, [](int x, int y) {
    return std::array<int, 4>{x == 0 ? 40 : 220, y == 0 ? 60 : 230, x == y ? 90 : 200, 255};
  });
}

std::string webp_bytes(const RgbaImage& image) {
  std::uint8_t* coded = nullptr;
  const std::size_t size = WebPEncodeLosslessRGBA(image.pixels.data(), image.width, image.height,
                                                  4 * image.width, &coded);
  const std::string bytes(reinterpret_cast<const char*>(coded), size);
  WebPFree(coded);
  return bytes;
}

TEST(Materials, DecodesWebpTextures) {
  RgbaImage image = quarters();
  image.pixels[3] = 128;
  TexturedSquare png = square_of(
      R"("alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorTexture":{"index":0}})", {image});
  TexturedSquare webp = png;
  webp.images = {webp_bytes(image)};
  const auto model = model_of(webp);
  EXPECT_TRUE(model->warnings.empty());
  ASSERT_EQ(model->textures.size(), 1U);
  EXPECT_EQ(model->textures[0]->rgba, model_of(png)->textures[0]->rgba);
}

TEST(Materials, ReportsDamagedWebp) {
  TexturedSquare square =
      square_of(R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}})", {quarters()});
  const auto expect_plain = [&](const std::string& bytes, const std::string& cause) {
    square.images = {bytes};
    const auto model = model_of(square);
    EXPECT_EQ(model->materials[0].base_color_texture.image, -1);
    EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("images/0: " + cause)));
  };
  const std::string good = webp_bytes(test::image_of(40, 40, [](int x, int y) {
    return std::array<int, 4>{x * y % 256, 7 * x, 3 * y, 255};
  }));
  expect_plain(good.substr(0, good.size() - 40), "is a damaged or incomplete WebP image");
  expect_plain(good.substr(0, 14), "is a damaged WebP image");
  std::string animated("RIFF\x16\0\0\0WEBPVP8X\x0a\0\0\0\x02\0\0\0\xff\x3f\0\xff\x3f\0", 30);
  expect_plain(animated, "is a WebP animation");
}

// --- KHR_texture_transform ---

struct Transform {
  std::array<double, 2> offset = {0.0, 0.0};
  double rotation = 0.0;
  std::array<double, 2> scale = {1.0, 1.0};

  // JSON fields of a texture reference with this transform.
  [[nodiscard]] std::string json(int texture = 0) const {
    return fmt::format(
        R"("index":{},"extensions":{{"KHR_texture_transform":{{"offset":[{},{}],"rotation":{},"scale":[{},{}]}}}})",
        texture, offset[0], offset[1], rotation, scale[0], scale[1]);
  }
  // A counter-clockwise rotation where v points down, as seen in the texture.
  [[nodiscard]] std::vector<std::array<float, 2>> applied(
      const std::vector<std::array<float, 2>>& texcoords) const {
    std::vector<std::array<float, 2>> result;
    for (const auto& [u, v] : texcoords) {
      const double x = scale[0] * static_cast<double>(u);
      const double up = -scale[1] * static_cast<double>(v);
      const double turned_x = std::cos(rotation) * x - std::sin(rotation) * up;
      const double turned_up = std::sin(rotation) * x + std::cos(rotation) * up;
      result.push_back(
          {static_cast<float>(turned_x + offset[0]), static_cast<float>(-turned_up + offset[1])});
    }
    return result;
  }
};
constexpr Transform kSkewed{{0.1, -0.3}, 0.6, {0.8, 1.3}};
constexpr Transform kMirrored{{0.9, 0.2}, -2.0, {-0.7, 0.4}};

TEST(Materials, TransformsCoordinatesOfEachTexture) {
  const std::string base = R"("pbrMetallicRoughness":{"metallicFactor":0.5,)";
  for (const auto& [before, after] : std::vector<std::pair<std::string, std::string>>{
           {base + R"("baseColorTexture":{)", "}}"},
           {base + R"("metallicRoughnessTexture":{)", "}}"},
           {R"("normalTexture":{)", "}"},
           {R"("occlusionTexture":{)", "}"},
           {R"("emissiveFactor":[1,1,1],"emissiveTexture":{)", "}"}}) {
    for (const Transform& transform : {kSkewed, kMirrored}) {
      SCOPED_TRACE(before);
      TexturedSquare square = square_of(before + transform.json() + after, {quarters()});
      const RenderedImage image = drawn(square);
      TexturedSquare expected = square_of(before + R"("index":0)" + after, {quarters()});
      EXPECT_GT(largest_difference(image, drawn(expected)), 5);
      expected.texcoords = transform.applied(square.texcoords);
      EXPECT_LE(largest_difference(image, drawn(expected)), 1);
    }
  }
}

TEST(Materials, TransformsTexturesOfOneMaterialDifferently) {
  const auto material = [](const std::string& base, const std::string& emissive) {
    return fmt::format(
        R"("pbrMetallicRoughness":{{"baseColorTexture":{{{}}}}},"emissiveFactor":[1,1,1],"emissiveTexture":{{{}}})",
        base, emissive);
  };
  TexturedSquare square =
      square_of(material(kSkewed.json(), kMirrored.json(1)), {quarters(), quarters()});
  TexturedSquare expected =
      square_of(material(R"("index":0)", R"("index":1,"texCoord":1)"), {quarters(), quarters()});
  expected.texcoords = kSkewed.applied(square.texcoords);
  expected.texcoords_1 = kMirrored.applied(square.texcoords);
  EXPECT_LE(largest_difference(drawn(square), drawn(expected)), 1);
}

TEST(Materials, TurnsTangentsWithTransformedNormalTexture) {
  TexturedSquare square = square_of(R"("normalTexture":{)" + kMirrored.json() + "}", {quarters()});
  const RenderedImage derived = drawn(square);
  // The file's tangents are for the untransformed layout.
  square.tangents = std::vector<std::array<float, 4>>(4, {1, 0, 0, 1});
  EXPECT_LE(largest_difference(drawn(square), derived), 1);
  // A transform that does not turn the texture keeps them.
  const Transform wider{{0.2, 0.1}, 0.0, {2.0, 0.5}};
  square.material = R"("normalTexture":{)" + wider.json() + "}";
  square.tangents = std::vector<std::array<float, 4>>(4, {0, 0, -1, 1});
  const auto model = model_of(square);
  ASSERT_EQ(model->meshes[0].tangents.size(), 4U);
  EXPECT_EQ(model->meshes[0].tangents[0], glm::vec4(0, 1, 0, 1));
}

TEST(Materials, MapsExampleOfTransformToLowerLeftQuarter) {
  TexturedSquare square = square_of(
      R"("emissiveTexture":{"index":0,"texCoord":1,"extensions":{"KHR_texture_transform":{"offset":[0,1],"rotation":1.57079632679,"scale":[0.5,0.5],"texCoord":0}}})",
      {quarters()});
  square.texcoords_1 = {{9, 9}, {9, 9}, {9, 9}, {9, 9}};
  const auto model = model_of(square);
  EXPECT_TRUE(model->warnings.empty());
  const std::vector<glm::vec2> expected = {{0.5, 1}, {0.5, 0.5}, {0, 0.5}, {0, 1}};
  ASSERT_EQ(model->meshes[0].texcoords.size(), expected.size());
  for (std::size_t i = 0; i < expected.size(); ++i) {
    EXPECT_LE(glm::distance(model->meshes[0].texcoords[i], expected[i]), 1e-6F) << i;
  }
}

TEST(Materials, CutsOutByTransformedCoordinates) {
  // The left half of the texture is opaque.
  const RgbaImage half = test::image_of(2, 1, [](int x, int) {
    return std::array<int, 4>{200, 200, 200, x == 0 ? 255 : 0};
  });
  const auto area = [&](const Transform& transform) {
    TexturedSquare square =
        square_of(R"("alphaMode":"MASK","pbrMetallicRoughness":{"baseColorTexture":{)" +
                      transform.json() + "}}",
                  {half});
    square.samplers = R"({"magFilter":9728,"minFilter":9728})";
    const auto model = model_of(square);
    const ShadowMesh seen = make_shadow_mesh(*model, {}, CutOuts::visible_regions);
    double sum = 0.0;
    for (std::size_t i = 0; i < seen.indices.size(); i += 3) {
      const glm::dvec3 a(seen.positions[seen.indices[i]]), b(seen.positions[seen.indices[i + 1]]),
          c(seen.positions[seen.indices[i + 2]]);
      sum += 0.5 * glm::length(glm::cross(b - a, c - a));
    }
    return sum;
  };
  // Tolerance: the resolution of visible regions.
  EXPECT_NEAR(area({}), 0.02, 1e-5);
  EXPECT_NEAR(area({{0.0, 0.0}, 0.0, {0.4, 1.0}}), 0.04, 1e-7);
  EXPECT_EQ(area({{0.55, 0.0}, 0.0, {0.4, 1.0}}), 0.0);
  EXPECT_NEAR(area({{0.0, 0.0}, 0.0, {0.75, 1.0}}), 0.04 * 2.0 / 3.0, 3e-5);
}

TEST(Materials, ReportsMalformedTransform) {
  const auto warnings = [](const std::string& transform) {
    const auto model = model_of(square_of(
        R"("emissiveTexture":{"index":0,"extensions":{"KHR_texture_transform":)" + transform + "}}",
        {quarters()}));
    EXPECT_EQ(model->meshes[0].texcoords[0], glm::vec2(0, 1));
    return model->warnings;
  };
  EXPECT_TRUE(warnings("{}").empty());
  for (const char* transform : {R"({"offset":[1]})", R"({"scale":[1,2,3]})",
                                R"({"scale":[1e30,1]})", R"({"rotation":1e9})"}) {
    EXPECT_THAT(warnings(transform),
                ElementsAre(HasSubstr("materials/0/emissiveTexture: its texture transform is "
                                      "malformed and is ignored")))
        << transform;
  }
  EXPECT_THAT(
      warnings(R"({"offset":"far"})"),
      ElementsAre(HasSubstr("KHR_texture_transform/offset: is \"far\"; a list of numbers")));
  EXPECT_THAT(warnings(R"({"texCoord":-1})"), ElementsAre(HasSubstr("texCoord: is -1")));
}

TEST(Materials, ReportsIgnoredMaterialFeatures) {
  TexturedSquare square = square_of(
      R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0},"metallicRoughnessTexture":{"index":0,"texCoord":1}},"emissiveTexture":{"index":0,"texCoord":2})",
      {one_color(200, 100, 50)});
  square.texcoords_1 = square.texcoords;
  const auto model = loaded(square);
  ASSERT_TRUE(model) << model.error().message;
  ASSERT_EQ(model->warnings.size(), 1U);
  EXPECT_THAT(model->warnings[0],
              HasSubstr("materials/0/emissiveTexture: is ignored: it is the third"));
}

TEST(Materials, RejectsInvalidMaterials) {
  const auto material = [](const std::string& fields) {
    return square_of(fields, {one_color(200, 100, 50)});
  };
  for (const char* map : {"normalTexture", "occlusionTexture", "emissiveTexture"}) {
    EXPECT_THAT(error_of(material(fmt::format(R"("{}":{{"index":7}})", map))),
                HasSubstr(fmt::format("materials/0/{}: names texture 7, there are 1", map)));
  }
  EXPECT_THAT(
      error_of(material(R"("pbrMetallicRoughness":{"metallicRoughnessTexture":{"index":3}})")),
      HasSubstr("materials/0/metallicRoughnessTexture: names texture 3, there "
                "are 1"));
  EXPECT_THAT(error_of(material(R"("alphaMode":"GLOW")")),
              HasSubstr("materials/0/alphaMode: \"GLOW\" is none of OPAQUE, MASK and BLEND"));
  EXPECT_THAT(error_of(material(R"("normalTexture":{"index":0,"scale":1e30})")),
              HasSubstr("normal scale"));
  EXPECT_THAT(error_of(material(R"("occlusionTexture":{"index":0,"strength":-3})")),
              HasSubstr("occlusion strength"));
  TexturedSquare square = material(R"("normalTexture":{"index":0})");
  square.samplers = R"({"wrapS":5})";
  EXPECT_THAT(error_of(square), HasSubstr("samplers/0/wrapS: 5 is none of glTF's values"));
  square.samplers = R"({"minFilter":3})";
  EXPECT_THAT(error_of(square), HasSubstr("samplers/0/minFilter: 3 is none of glTF's values"));
  square.samplers = "";
  EXPECT_THAT(error_of(square), HasSubstr("names sampler 0, there are 0"));
  square = material(R"("normalTexture":{"index":0})");
  square.tangents.assign(3, {1, 0, 0, 1});
  EXPECT_THAT(error_of(square), HasSubstr("TANGENT: has 3 elements for 4 vertices"));
}

}  // namespace
}  // namespace penumbra
