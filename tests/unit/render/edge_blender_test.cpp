// Edges of meshes, and the areas that they cut off from pixels.
#include "render/edges/edge_blender.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <span>
#include <vector>

#include "core/image/frame.hpp"
#include "render/edges/edge_mesh.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

constexpr int kSide = 16;  // of the images [px]
constexpr float kFar = 0.05F;

// A white image of kSide x kSide pixels in which nothing hides the edges; pixels whose centres are
// inside the polygon are black.
EdgeImage image_of(std::span<const glm::vec2> polygon, const auto& inside) {
  EdgeImage image;
  image.rect = {0, 0, kSide, kSide};
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const bool dark =
          inside(polygon, glm::vec2(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F));
      const std::uint8_t code = dark ? 0 : 255;
      image.rgba.insert(image.rgba.end(), {code, code, code, 255});
      image.depth.push_back(dark ? 0x800000U << 8U : 0xFFFFFFU << 8U);
    }
  }
  image.depth_scale = {(kFar - 1.0F) / 16777215.0F * 2.0F, 2.0F - kFar};  // 1 / m at half depth
  image.far = kFar * 1.01F;
  return image;
}
bool is_inside(std::span<const glm::vec2> polygon, const glm::vec2& p) {
  bool inside = false;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const glm::vec2& a = polygon[i];
    const glm::vec2& b = polygon[(i + 1) % polygon.size()];
    if ((a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y))
      inside = !inside;
  }
  return inside;
}
EdgeGroup outline_of(std::span<const glm::vec2> polygon) {
  EdgeGroup group;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    group.edges.push_back(
        {polygon[i], polygon[(i + 1) % polygon.size()], 1.0F, 1.0F, glm::vec2(0.0F)});
  }
  return group;
}

// Corners of convex polygons, with the inside on the left, seen along the edges.
TEST(EdgeBlender, MatchesAreaOfRandomPolygons) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(0.0F, 1.0F);
  constexpr int kSamples = 16;
  double sum = 0.0;
  int count = 0;
  for (int trial = 0; trial < 40; ++trial) {
    const int corners = 3 + trial % 6;
    const float turn = 6.28F * uniform(random);
    const glm::vec2 middle(7.0F + 2.0F * uniform(random), 7.0F + 2.0F * uniform(random));
    const float radius = 3.0F + 3.0F * uniform(random);
    std::vector<glm::vec2> polygon;
    for (int i = corners; i-- > 0;) {
      const float angle = turn + 6.2831853F * static_cast<float>(i) / static_cast<float>(corners);
      polygon.push_back(middle + radius * glm::vec2(std::cos(angle), std::sin(angle)));
    }
    EdgeImage image = image_of(polygon, is_inside);
    const EdgeGroup group = outline_of(polygon);
    EdgeBlender blender;
    EXPECT_GT(blender.blend(image, {&group, 1}), 5);
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        int covered = 0;
        for (int i = 0; i < kSamples * kSamples; ++i) {
          const glm::vec2 sample(static_cast<float>(i % kSamples) + 0.5F,
                                 static_cast<float>(i / kSamples) + 0.5F);
          const glm::vec2 p = glm::vec2(x, y) + sample / static_cast<float>(kSamples);
          covered += is_inside(polygon, p) ? 1 : 0;
        }
        const double expected = 255.0 * (1.0 - covered / static_cast<double>(kSamples * kSamples));
        const double error = image.rgba[4 * static_cast<std::size_t>(y * kSide + x)] - expected;
        if (covered == 0 || covered == kSamples * kSamples) {
          EXPECT_NEAR(error, 0.0, 255.0 / kSamples) << trial << ": " << x << ", " << y;
          continue;
        }
        sum += error * error;
        ++count;
      }
    }
  }
  // A pixel at a sharp corner may have no neighbour inside; all others are exact.
  EXPECT_LT(std::sqrt(sum / count), 4.0) << count;
}

TEST(EdgeBlender, IgnoresEdgesOutOfRange) {
  const std::vector<glm::vec2> square = {{4, 4}, {4, 12}, {12, 12}, {12, 4}};
  const EdgeImage before = image_of(square, is_inside);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  EdgeGroup group;
  for (const float bad : {nan, infinity, -infinity, 1e30F, -1e9F, 3e38F}) {
    group.edges.push_back({{bad, 3.0F}, {8.0F, 5.0F}, 1.0F, 1.0F, {}});
    group.edges.push_back({{8.0F, 5.0F}, {3.0F, bad}, 1.0F, 1.0F, {}});
    group.edges.push_back({{bad, bad}, {bad, bad}, bad, bad, {bad, bad}});
  }
  group.edges.push_back({{5.0F, 5.0F}, {5.0F, 5.0F}, 1.0F, 1.0F, {}});      // no length
  group.edges.push_back({{-9.0F, -9.0F}, {-1.0F, 40.0F}, 1.0F, 1.0F, {}});  // beside the image
  EdgeImage image = before;
  EdgeBlender blender;
  EXPECT_EQ(blender.blend(image, {&group, 1}), 0);
  EXPECT_EQ(image.rgba, before.rgba);
  // Depths that are not finite hide no edge or all edges, but change nothing else.
  for (const float bad : {nan, infinity}) {
    group = outline_of(square);
    for (ScreenEdge& edge : group.edges) edge.near_from = edge.near_slope.x = bad;
    image = before;
    blender.blend(image, {&group, 1});
    EXPECT_EQ(image.rgba[3], 255);
  }
}

TEST(EdgeBlender, LeavesHiddenEdgesAsDrawn) {
  const std::vector<glm::vec2> square = {
      {4.3F, 4.3F}, {4.3F, 11.6F}, {11.6F, 11.6F}, {11.6F, 4.3F}};
  EdgeImage image = image_of(square, is_inside);
  std::ranges::fill(image.depth, 0x100000U << 8U);  // in front of the square
  const std::vector<std::uint8_t> before = image.rgba;
  const EdgeGroup group = outline_of(square);
  EdgeBlender blender;
  EXPECT_EQ(blender.blend(image, {&group, 1}), 0);
  EXPECT_EQ(image.rgba, before);
}

EdgeMesh mesh_of(const Model& model) {
  std::vector<EdgeMeshPart> parts;
  for (const Mesh& mesh : model.meshes)
    parts.push_back({mesh.positions, mesh.normals, mesh.indices, mesh.material, false});
  return EdgeMesh(parts);
}

TEST(EdgeMesh, FindsOutlineAndCreasesOfBox) {
  const auto box = test::finished(test::box_model(0.1), glm::vec4(1.0F));
  const EdgeMesh mesh = mesh_of(*box);
  EXPECT_EQ(mesh.positions().size(), 8U);
  EXPECT_EQ(mesh.outward(), 1);
  const auto count = [&mesh](const glm::vec4& eye, bool crease) {
    return std::ranges::count(mesh.seen_from(eye, true), crease, &SeenEdge::crease);
  };
  EXPECT_EQ(count({1, 1, 1, 1}, false), 6);  // a corner: a hexagon around three edges
  EXPECT_EQ(count({1, 1, 1, 1}, true), 3);
  EXPECT_EQ(count({0, 0, 1, 1}, false), 4);  // a face
  EXPECT_EQ(count({0, 0, 1, 1}, true), 0);
  EXPECT_EQ(count({1, 1, 0, 0}, false), 6);  // an edge, from infinity
  EXPECT_EQ(count({1, 1, 0, 0}, true), 1);
  // The outline runs around the box with the box on its left.
  for (const SeenEdge& edge : mesh.seen_from({0, 0, 1, 1}, false)) {
    const glm::vec3 a = mesh.positions()[edge.from];
    const glm::vec3 b = mesh.positions()[edge.to];
    EXPECT_GT(a.x * b.y - a.y * b.x, 0.0F);
  }
}

TEST(EdgeMesh, OutlineOfSmoothClosedMeshIsClosed) {
  test::ShapeBuilder shape;
  shape.torus(0.05, 0.02, 12, 20);
  const Model torus = shape.build();  // without normals: no creases
  const EdgeMesh mesh = mesh_of(torus);
  std::mt19937 random(3);
  std::normal_distribution<float> normal;
  for (int i = 0; i < 50; ++i) {
    const glm::vec4 eye(normal(random), normal(random), normal(random), i % 2 == 0 ? 1.0F : 0.0F);
    std::vector<int> balance(mesh.positions().size(), 0);
    const std::vector<SeenEdge> seen = mesh.seen_from(eye, true);
    EXPECT_GT(seen.size(), 10U);
    for (const SeenEdge& edge : seen) {
      EXPECT_FALSE(edge.crease);
      ++balance[edge.from];
      --balance[edge.to];
    }
    EXPECT_TRUE(std::ranges::all_of(balance, [](int sum) { return sum == 0; }));
  }
}

TEST(EdgeMesh, MovesWithTheSameFacesOnly) {
  test::ShapeBuilder shape;
  shape.sphere(0.05, 8, 12);
  const Model sphere = shape.build();
  EdgeMesh mesh = mesh_of(sphere);
  Model moved = sphere;
  for (glm::vec3& p : moved.meshes[0].positions) p *= 2.0F;
  const Mesh& of = moved.meshes[0];
  const EdgeMeshPart part{of.positions, {}, of.indices, 0, false};
  ASSERT_TRUE(mesh.move({&part, 1}));
  const EdgeMesh made = mesh_of(moved);
  ASSERT_EQ(mesh.positions().size(), made.positions().size());
  const glm::vec4 eye(1.0F, 0.3F, 0.5F, 1.0F);
  EXPECT_EQ(mesh.seen_from(eye, false).size(), made.seen_from(eye, false).size());
  const std::vector<std::uint32_t> fewer(of.indices.begin(), of.indices.end() - 3);
  const EdgeMeshPart other{of.positions, {}, fewer, 0, false};
  EXPECT_FALSE(mesh.move({&other, 1}));
}

// Pixels read on the CPU equal those that the renderer draws, in every format.
TEST(EdgeMesh, IsMadeAgainIfTouchingFacesSeparate) {
  std::vector<glm::vec3> corners = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0},
                                    {1, 0, 0}, {1, 1, 0}, {0, 1, 0}};
  const std::vector<std::uint32_t> indices = {0, 1, 2, 3, 4, 5};
  const EdgeMeshPart part{corners, {}, indices, 0, false};
  EdgeMesh mesh({&part, 1});
  ASSERT_EQ(mesh.positions().size(), 4U);
  for (glm::vec3& corner : corners) corner.z += 1.0F;
  EXPECT_TRUE(mesh.move({&part, 1}));
  corners[4].x += 1.0F;
  EXPECT_TRUE(mesh.move({&part, 1}));
  corners[3].x += 1.0F;
  EXPECT_FALSE(mesh.move({&part, 1}));
}

TEST(VideoPixels, MatchDrawnVideo) {
  constexpr int kWidth = 38;
  constexpr int kHeight = 26;
  const CameraModel camera = test::camera_of(kWidth, kHeight, 40.0);
  for (const PixelFormat format :
       {PixelFormat::grey8, PixelFormat::rgb24, PixelFormat::yuyv, PixelFormat::nv12,
        PixelFormat::yuv420p, PixelFormat::yuv422p, PixelFormat::yuv444p}) {
    for (const ColorRange range : {ColorRange::full, ColorRange::limited}) {
      FrameBuffer buffer = allocate_frame(format, kWidth, kHeight);
      std::mt19937 random(5);
      for (int plane = 0; plane < buffer.frame.plane_count; ++plane) {
        const PixelPlane& view = buffer.frame.planes[static_cast<std::size_t>(plane)];
        for (std::ptrdiff_t i = 0; i < view.stride * view.height; ++i)
          buffer.plane_data[static_cast<std::size_t>(plane)][i] =
              static_cast<std::uint8_t>(random() & 0xFFU);
      }
      buffer.frame.color_range = range;
      test::Studio studio(test::SceneBuilder().build(), camera);
      const test::RenderedImage drawn = studio.draw(buffer.frame, FramePlan());
      const VideoPixels pixels(buffer.frame);
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
          const glm::vec3 code = pixels.at(x, y);
          for (int channel = 0; channel < 3; ++channel) {
            ASSERT_NEAR(code[channel], drawn.at(x, y)[channel], 0.6F)
                << static_cast<int>(format) << ": " << x << ", " << y;
          }
        }
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
