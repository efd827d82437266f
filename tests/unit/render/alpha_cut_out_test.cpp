// Shadows of faces that are partly or fully transparent (cut-outs).
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "render/model/cut_out.hpp"
#include "render/model/model.hpp"
#include "render/model/shadow_mesh.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using Alpha = std::function<int(int, int)>;

// A square of 10 cm in the plane z = 0, covered once by a texture of `size` x `size` texels.
Model textured_square(int size, const Alpha& alpha) {
  Model model;
  Texture texture{size, size, {}};
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      texture.rgba.insert(texture.rgba.end(),
                          {200, 100, 50, static_cast<std::uint8_t>(alpha(x, y))});
    }
  }
  model.textures.push_back(std::make_shared<const Texture>(std::move(texture)));
  Material material;
  material.alpha_mode = AlphaMode::mask;
  material.base_color_texture.image = 0;
  material.base_color_texture.sampling.wrap_s = TextureWrap::clamp;
  material.base_color_texture.sampling.wrap_t = TextureWrap::clamp;
  model.materials.push_back(material);
  Mesh mesh;
  mesh.positions = {{0, 0, 0}, {0.1F, 0, 0}, {0.1F, 0.1F, 0}, {0, 0.1F, 0}};
  mesh.normals.assign(4, {0, 0, 1});
  mesh.texcoords = {{0, 0}, {1, 0}, {1, 1}, {0, 1}};
  mesh.source_vertex = {0, 1, 2, 3};
  mesh.indices = {0, 1, 2, 0, 2, 3};
  model.source_vertex_count = 4;
  model.meshes.push_back(std::move(mesh));
  return model;
}

double area_of(const ShadowMesh& mesh) {
  double area = 0.0;
  for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
    const auto at = [&](std::size_t k) { return glm::dvec3(mesh.positions[mesh.indices[i + k]]); };
    const glm::dvec3 a = at(1) - at(0);
    const glm::dvec3 b = at(2) - at(0);
    area += 0.5 * std::abs(a.x * b.y - a.y * b.x);
  }
  return area;
}

double area_seen(const Model& model) {
  return area_of(make_shadow_mesh(model, {}, CutOuts::visible_regions));
}

TEST(AlphaCutOut, CastsShadowOfVisibleHalfOfFace) {
  const Model model = textured_square(64, [](int x, int) { return x < 32 ? 255 : 0; });
  EXPECT_TRUE(has_cut_outs(model));
  EXPECT_NEAR(area_seen(model), 0.005, 0.005 * 1e-4);
  EXPECT_NEAR(area_of(make_shadow_mesh(model)), 0.01, 1e-9);
}

TEST(AlphaCutOut, FollowsCurvedOutline) {
  const Model model = textured_square(256, [](int x, int y) {
    const double r = std::hypot(x - 127.5, y - 127.5);
    return static_cast<int>(std::lround(255.0 * std::clamp(100.0 - r + 0.5, 0.0, 1.0)));
  });
  const double expected = 3.14159265358979 * std::pow(0.1 * 100.0 / 256.0, 2);
  EXPECT_NEAR(area_seen(model), expected, 3e-3 * expected);
}

TEST(AlphaCutOut, KeepsVisiblePiecesOfFaceInOneComponent) {
  const Model model = textured_square(64, [](int x, int) { return x < 16 || x >= 48 ? 255 : 0; });
  const ShadowMesh mesh = make_shadow_mesh(model, {}, CutOuts::visible_regions);
  ASSERT_FALSE(mesh.indices.empty());
  for (const std::uint32_t index : mesh.indices) {
    EXPECT_EQ(mesh.part[index], mesh.part[mesh.indices[0]]);
  }
  EXPECT_NEAR(area_of(mesh), 0.005, 1e-5);
}

TEST(AlphaCutOut, CastsNoShadowForTransparentTexture) {
  const Model model = textured_square(8, [](int, int) { return 100; });
  EXPECT_TRUE(make_shadow_mesh(model).indices.empty());
  EXPECT_EQ(area_seen(model), 0.0);
  EXPECT_FALSE(has_cut_outs(model));
}

TEST(AlphaCutOut, IgnoresAlphaOfOpaqueMaterial) {
  Model model = textured_square(8, [](int, int) { return 0; });
  model.materials[0].alpha_mode = AlphaMode::opaque;
  EXPECT_NEAR(area_of(make_shadow_mesh(model)), 0.01, 1e-9);
  EXPECT_FALSE(has_cut_outs(model));
}

TEST(AlphaCutOut, CastsShadowOfBlendedFaceUnlessInvisible) {
  Model model = textured_square(8, [](int, int) { return 1; });
  model.materials[0].alpha_mode = AlphaMode::blend;
  EXPECT_NEAR(area_of(make_shadow_mesh(model)), 0.01, 1e-9);
  model.materials[0].base_color.a = 0.0F;
  EXPECT_TRUE(make_shadow_mesh(model).indices.empty());
}

TEST(AlphaCutOut, AppliesVertexColours) {
  Model model = textured_square(8, [](int, int) { return 255; });
  model.meshes[0].colors = {{1, 1, 1, 1}, {1, 1, 1, 0}, {1, 1, 1, 0}, {1, 1, 1, 1}};
  EXPECT_NEAR(area_seen(model), 0.005, 1e-6);
  model.meshes[0].colors.assign(4, {1, 1, 1, 0.25F});
  EXPECT_TRUE(make_shadow_mesh(model).indices.empty());
}

TEST(AlphaCutOut, ClipsEveryRepetitionOfTexture) {
  for (const TextureWrap wrap : {TextureWrap::repeat, TextureWrap::mirrored}) {
    Model model = textured_square(16, [](int x, int) { return x >= 4 && x < 12 ? 255 : 0; });
    model.materials[0].base_color_texture.sampling.wrap_s = wrap;
    for (glm::vec2& t : model.meshes[0].texcoords) t = t * 3.0F - glm::vec2(7.25F, 0.5F);
    EXPECT_NEAR(area_seen(model), 0.005, 2e-5) << static_cast<int>(wrap);
  }
}

TEST(AlphaCutOut, ClipsNearestTexelsAtTheirBorders) {
  Model model = textured_square(4, [](int x, int y) { return (x + y) % 2 == 0 ? 255 : 0; });
  model.materials[0].base_color_texture.sampling.smooth_near = false;
  EXPECT_NEAR(area_seen(model), 0.005, 2e-4);
}

TEST(AlphaCutOut, KeepsTrianglesWithinBudget) {
  Model model =
      textured_square(512, [](int x, int y) { return (x / 3 + y / 5) % 2 == 0 ? 255 : 0; });
  Mesh& mesh = model.meshes[0];
  const std::vector<std::uint32_t> face = mesh.indices;
  for (int i = 0; i < 200; ++i) mesh.indices.insert(mesh.indices.end(), face.begin(), face.end());
  const ShadowMesh seen = make_shadow_mesh(model, {}, CutOuts::visible_regions);
  EXPECT_LE(seen.indices.size() / 3, 100'000U);
  EXPECT_FALSE(seen.indices.empty());
}

TEST(AlphaCutOut, AcceptsExtremeTextureCoordinates) {
  Model model = textured_square(3, [](int x, int y) { return 85 * ((x + y) % 4); });
  for (const float far : {1e6F, -1e6F}) {
    model.meshes[0].texcoords = {{far, 0}, {-far, far}, {0, far}, {far, far}};
    for (const TextureWrap wrap :
         {TextureWrap::repeat, TextureWrap::mirrored, TextureWrap::clamp}) {
      model.materials[0].base_color_texture.sampling.wrap_s = wrap;
      model.materials[0].base_color_texture.sampling.wrap_t = wrap;
      const double area = area_seen(model);
      EXPECT_TRUE(std::isfinite(area));
      EXPECT_LE(area, 0.0101);
    }
  }
}

TEST(AlphaCutOut, MatchesVisibleAreaInSharedCases) {
  const auto shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto folder = shared / "cases" / "gltf-cut-out-casts-all";
  const Result<Model> mask = load_model(folder / "alpha_MASK.gltf");
  ASSERT_TRUE(mask);
  EXPECT_NEAR(area_of(make_shadow_mesh(*mask)), 0.01, 1e-8);
  for (const char* name : {"factor_BLEND.gltf", "factor_MASK.gltf"}) {
    const Result<Model> model = load_model(folder / name);
    ASSERT_TRUE(model);
    EXPECT_TRUE(make_shadow_mesh(*model).indices.empty()) << name;
  }
  ASSERT_TRUE(has_cut_outs(*mask));
  EXPECT_NEAR(area_seen(*mask), 0.005, 5e-7);
}

}  // namespace
}  // namespace penumbra
