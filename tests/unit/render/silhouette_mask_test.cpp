// Masks of shadow layers on a plane: coverage of cells, and agreement with directly drawn faces.
#include "render/shadow/masks/silhouette_mask.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "render/passes/translucent_program.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/casters/caster_geometry.hpp"
#include "support/edge_error.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/test_form.hpp"

namespace penumbra::silhouette_mask_test {
namespace {

using test::edge_error;
using test::EdgeError;
using test::RenderedImage;
using test::ShapeBuilder;
using test::Studio;

const LayeredConstants kConstants = make_layered_constants(0.7, 2.5, 0.0).value();

std::shared_ptr<const Model> torus(int rings = 16, int segments = 32) {
  ShapeBuilder shape;
  shape.torus(0.05, 0.018, rings, segments);
  return test::finished(shape.build(), {0.7F, 0.3F, 0.15F, 1.0F});
}
// A model of two parts, one above the other.
std::shared_ptr<const Model> table_and_ball() {
  ShapeBuilder shape;
  shape.box(-0.05, -0.03, 0.0, 0.05, 0.03, 0.01);
  shape.sphere(0.025, 16, 24, 0.02, 0.03, 0.05);
  return test::finished(shape.build(), {0.2F, 0.3F, 0.7F, 1.0F});
}
std::shared_ptr<const Model> box() {
  ShapeBuilder shape;
  shape.box(-0.04, -0.03, -0.02, 0.04, 0.03, 0.02);
  return test::finished(shape.build(), glm::vec4(0.5F));
}

TEST(PairedEdges, ExistForClosedMeshesOnly) {
  const ShadowMesh cube = make_shadow_mesh(*box());
  const auto edges = paired_edges(cube.indices);
  ASSERT_TRUE(edges);
  EXPECT_EQ(edges->size(), 18U);  // 12 edges and 6 diagonals
  for (const SharedEdge& edge : *edges) {
    const auto has = [&](std::uint32_t face, std::uint32_t a, std::uint32_t b) {
      for (std::size_t i = 0; i < 3; ++i) {
        if (cube.indices[3 * face + i] == a && cube.indices[3 * face + (i + 1) % 3] == b)
          return true;
      }
      return false;
    };
    EXPECT_TRUE(has(edge.forward, edge.from, edge.to));
    EXPECT_TRUE(has(edge.back, edge.to, edge.from));
  }
  for (std::size_t left_out = 0; left_out < cube.indices.size(); left_out += 3) {
    std::vector<std::uint32_t> open = cube.indices;
    open.erase(open.begin() + static_cast<std::ptrdiff_t>(left_out),
               open.begin() + static_cast<std::ptrdiff_t>(left_out) + 3);
    EXPECT_FALSE(paired_edges(open)) << left_out;
    std::vector<std::uint32_t> turned = cube.indices;
    std::swap(turned[left_out], turned[left_out + 1]);
    EXPECT_FALSE(paired_edges(turned)) << left_out;
  }
  EXPECT_TRUE(paired_edges({})->empty());
  // Four faces share one edge, as in two wedges that touch.
  const std::vector<std::uint32_t> wedges = {0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2,
                                             0, 1, 4, 0, 5, 1, 0, 4, 5, 1, 5, 4};
  EXPECT_TRUE(paired_edges(wedges));
}

// Tests if neighbouring faces traverse their shared edge in opposite directions.
bool are_oriented(const std::vector<std::uint32_t>& faces) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> edges;
  for (std::size_t i = 0; i < faces.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      if (!edges.insert({faces[i + corner], faces[i + (corner + 1) % 3]}).second) return false;
    }
  }
  return true;
}

TEST(OrientedFaces, FlipFacesToMatchNeighbours) {
  const ShadowMesh cube = make_shadow_mesh(*box());
  std::mt19937 random(3);
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<std::uint32_t> faces = cube.indices;
    for (std::size_t i = 0; i < faces.size(); i += 3) {
      if ((random() & 1U) != 0) std::swap(faces[i + 1], faces[i + 2]);
    }
    faces.resize(faces.size() - 3 * (random() % 6));
    const auto oriented = oriented_faces(cube.positions, faces);
    ASSERT_TRUE(oriented);
    EXPECT_EQ(oriented->size(), faces.size());
    EXPECT_TRUE(are_oriented(*oriented));
    for (std::size_t i = 0; i < faces.size(); i += 3) {
      const std::set<std::uint32_t> before(&faces[i], &faces[i] + 3);
      EXPECT_EQ(before, std::set<std::uint32_t>(&(*oriented)[i], &(*oriented)[i] + 3));
    }
  }
  const std::vector<glm::vec3> places = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0},
                                         {0, 0, 1}, {1, 1, 1}, {1, 0, 0}};
  // Three faces share one edge. The result is the same if they share only the positions of its
  // vertices.
  EXPECT_FALSE(oriented_faces(places, std::vector<std::uint32_t>{0, 1, 2, 0, 1, 3, 0, 1, 4}));
  EXPECT_FALSE(oriented_faces(places, std::vector<std::uint32_t>{0, 1, 2, 0, 5, 3, 1, 0, 4}));
  const auto two = oriented_faces(places, std::vector<std::uint32_t>{0, 1, 2, 0, 5, 3});
  ASSERT_TRUE(two);
  EXPECT_EQ(*two, (std::vector<std::uint32_t>{0, 1, 2, 0, 3, 5}));
  EXPECT_TRUE(oriented_faces(places, std::vector<std::uint32_t>{0, 0, 2, 1, 5, 3})->empty());
  EXPECT_TRUE(oriented_faces({}, {})->empty());
}

struct Placed {
  ShadowMesh mesh;
  std::vector<glm::vec3> kernels;
  Placement placement;
  OwnFrame own;
};
Placed place(const Model& model, const Placement& placement) {
  Placed placed{make_shadow_mesh(model), {}, placement, {}};
  const PlaneFrame plane;
  const ShadowKernels made =
      generate_kernels(placed.mesh, up_in_object(placement, plane), KernelSource::automatic);
  CasterGeometry geometry;
  geometry.positions = placed.mesh.positions;
  geometry.mesh_positions = placed.mesh.positions.size();
  placed.kernels = level_kernels(geometry, made);
  placed.own = OwnFrame::make(placement, plane, 0.1, 26);
  return placed;
}

struct Mask {
  MaskCells cells;
  std::vector<std::uint8_t> codes;
  [[nodiscard]] int at(std::int64_t u, std::int64_t v) const {
    return codes.at(static_cast<std::size_t>((v - cells.v) * cells.width + (u - cells.u)));
  }
};
Mask draw(const std::vector<const Placed*>& casters, const glm::vec3& light, double cell,
          const std::array<bool, 3>& wanted = {true, true, true}) {
  Eigen::AlignedBox<std::int64_t, 2> bounds;
  std::vector<MaskCaster> projected(casters.size());
  for (std::size_t i = 0; i < casters.size(); ++i) {
    projected[i].project(casters[i]->mesh.positions, casters[i]->kernels, casters[i]->own,
                         kConstants, wanted, cell);
    bounds.extend(projected[i].bounds());
  }
  Mask mask;
  mask.cells = {cell, bounds.min().x() - 1, bounds.min().y() - 1,
                static_cast<int>(bounds.sizes().x()) + 3, static_cast<int>(bounds.sizes().y()) + 3};
  MaskRaster raster;
  // The result of the second pass must not depend on the first.
  for (int again = 0; again < 2; ++again) {
    raster.begin(mask.cells);
    for (std::size_t i = 0; i < casters.size(); ++i) {
      raster.cover(projected[i], casters[i]->mesh.indices, *paired_edges(casters[i]->mesh.indices));
    }
    raster.finish(light, mask.codes);
  }
  return mask;
}

// Fraction of a cell's 8 x 8 sample points that lie in a layer's faces.
double covered_fraction(const std::vector<PlanePoint>& faces, double cell, std::int64_t u,
                        std::int64_t v) {
  int inside = 0;
  for (int i = 0; i < 64; ++i) {
    const double x = cell * (static_cast<double>(u) + (i % 8 + 0.5) / 8.0);
    const double y = cell * (static_cast<double>(v) + (i / 8 + 0.5) / 8.0);
    for (std::size_t f = 0; f + 2 < faces.size(); f += 3) {
      const auto side = [&](const PlanePoint& a, const PlanePoint& b) {
        return static_cast<double>(b.u - a.u) * (y - static_cast<double>(a.v)) -
               static_cast<double>(b.v - a.v) * (x - static_cast<double>(a.u));
      };
      const double a = side(faces[f], faces[f + 1]);
      const double b = side(faces[f + 1], faces[f + 2]);
      const double c = side(faces[f + 2], faces[f]);
      if ((a >= 0 && b >= 0 && c >= 0) || (a <= 0 && b <= 0 && c <= 0)) {
        ++inside;
        break;
      }
    }
  }
  return inside / 64.0;
}

// Compares the coverage of every cell with the layer's faces, for closed bodies in random poses.
TEST(SilhouetteMask, MatchesFacesOfClosedMesh) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const auto small_torus = torus(6, 10);
  const auto two_parts = table_and_ball();
  for (int trial = 0; trial < 9; ++trial) {
    const Eigen::Vector3d axis(uniform(random), uniform(random), uniform(random));
    const Placed placed =
        place(trial % 3 == 0 ? *box() : *(trial % 3 == 1 ? small_torus : two_parts),
              test::at(uniform(random), uniform(random), 0.12 + 0.03 * uniform(random), axis,
                       3.0 * uniform(random), 1.0 + 0.2 * uniform(random)));
    ShadowKernels kernels;
    kernels.kernels = placed.kernels;
    const std::vector<CasterVertex> vertices =
        place_caster(placed.mesh, kernels, placed.placement, PlaneFrame());
    constexpr double kCell = 0.006;
    for (std::size_t layer = 0; layer < 3; ++layer) {
      std::array<bool, 3> only{};
      only[layer] = true;
      glm::vec3 light(1.0F);
      light[static_cast<int>(layer)] = 0.0F;
      const Mask mask = draw({&placed}, light, kCell, only);
      const std::vector<PlanePoint> faces =
          layer_triangles(vertices, placed.mesh.indices, kConstants, kShadowLayers[layer]);
      double max_error = 0.0;
      double sum = 0.0;
      double area = 0.0;
      for (std::int64_t v = mask.cells.v; v < mask.cells.v + mask.cells.height; ++v) {
        for (std::int64_t u = mask.cells.u; u < mask.cells.u + mask.cells.width; ++u) {
          const double coverage = 1.0 - mask.at(u, v) / 255.0;
          const double expected = covered_fraction(faces, kCell, u, v);
          max_error = std::max(max_error, std::abs(coverage - expected));
          sum += coverage - expected;
          area += expected;
        }
      }
      // If a body covers part of a cell twice, the coverages add up, to at most half a cell too
      // much.
      EXPECT_LT(max_error, trial % 3 == 0 ? 0.1 : 0.5) << trial << " layer " << layer;
      EXPECT_GT(area, 5.0) << trial << " layer " << layer;
      EXPECT_LT(std::abs(sum), 0.006 * area + 0.3) << trial << " layer " << layer;
    }
  }
}

// Open and clipped meshes are covered face by face. Neighbouring faces must leave no seam, for any
// rounding.
TEST(SilhouetteMask, MatchesFacesOfOpenAndClippedMeshes) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  constexpr double kCell = 0.006;
  for (int trial = 0; trial < 12; ++trial) {
    Placed placed =
        place(trial % 2 == 0 ? *torus(8, 14) : *box(),
              test::at(uniform(random), uniform(random), trial % 3 == 0 ? 0.0 : 0.28,
                       {uniform(random), uniform(random), uniform(random)}, 3.0 * uniform(random)));
    std::vector<std::uint32_t> faces = placed.mesh.indices;
    if (trial % 4 > 1) faces.resize(faces.size() - 15);
    ShadowKernels kernels;
    kernels.kernels = placed.kernels;
    const std::vector<CasterVertex> on_plane =
        place_caster(placed.mesh, kernels, placed.placement, PlaneFrame());
    const std::vector<CasterVertex> own =
        place_caster(placed.mesh, kernels, placed.own.T_own_object, PlaneFrame());
    for (std::size_t layer = 0; layer < 3; ++layer) {
      const std::vector<PlanePoint> expected_faces =
          layer_triangles(on_plane, faces, kConstants, kShadowLayers[layer]);
      MaskCaster caster;
      caster.begin(placed.own, kCell);
      caster.project_faces(kShadowLayers[layer],
                           layer_triangles(own, faces, kConstants, kShadowLayers[layer]));
      if (caster.bounds().isEmpty()) continue;
      Mask mask;
      mask.cells = {kCell, caster.bounds().min().x() - 1, caster.bounds().min().y() - 1,
                    static_cast<int>(caster.bounds().sizes().x()) + 3,
                    static_cast<int>(caster.bounds().sizes().y()) + 3};
      glm::vec3 light(1.0F);
      light[static_cast<int>(layer)] = 0.0F;
      MaskRaster raster;
      MaskCover cover;
      raster.begin(mask.cells);
      raster.cover(caster, {}, {});
      raster.finish(light, mask.codes);
      // A cover stored by one raster gives the same mask in a larger raster.
      MaskCells larger = mask.cells;
      larger.u -= 5;
      larger.v -= 7;
      larger.width += 9;
      larger.height += 11;
      raster.begin(mask.cells);
      raster.cover(caster, {}, {});
      raster.take(cover);
      Mask again;
      again.cells = larger;
      raster.begin(larger);
      raster.cover(cover);
      raster.finish(light, again.codes);
      // Checks the coverage in a window that overlaps only a part of the raster.
      MaskCells part = mask.cells;
      part.u += 3;
      part.v -= 2;
      part.width += 1;
      std::vector<std::uint8_t> shares(std::size_t{4} * static_cast<std::size_t>(part.width) *
                                       static_cast<std::size_t>(part.height));
      raster.begin(mask.cells);
      raster.cover(caster, {}, {});
      raster.finish_coverage(part, shares);
      const std::uint8_t* texel = shares.data();
      for (std::int64_t v = part.v; v < part.v + part.height; ++v) {
        for (std::int64_t u = part.u; u < part.u + part.width; ++u, texel += 4) {
          const bool inside = u < mask.cells.u + mask.cells.width && v >= mask.cells.v;
          for (std::size_t channel = 0; channel < 3; ++channel) {
            const int expected = inside && channel >= layer ? 255 - mask.at(u, v) : 0;
            ASSERT_LE(std::abs(texel[channel] - expected), 1) << channel;
          }
          ASSERT_EQ(texel[3], 0);
        }
      }
      double max_error = 0.0;
      double sum = 0.0;
      double area = 0.0;
      for (std::int64_t v = mask.cells.v; v < mask.cells.v + mask.cells.height; ++v) {
        for (std::int64_t u = mask.cells.u; u < mask.cells.u + mask.cells.width; ++u) {
          ASSERT_EQ(mask.at(u, v), again.at(u, v));
          const double coverage = 1.0 - mask.at(u, v) / 255.0;
          const double expected = covered_fraction(expected_faces, kCell, u, v);
          max_error = std::max(max_error, std::abs(coverage - expected));
          sum += coverage - expected;
          area += expected;
          if (expected == 1.0) {
            ASSERT_GT(coverage, 0.96)
                << trial << " layer " << layer << " a seam at " << u << ", " << v;
          }
        }
      }
      // If only a thin strip of the umbra remains, overlapping sheets add up in more cells.
      EXPECT_LT(std::abs(sum), 0.003 * area + 2.5) << trial << " layer " << layer;
      // If two sheets cover different parts of a cell, only the larger coverage counts.
      EXPECT_LT(max_error, trial % 4 == 1 ? 0.12 : 0.5) << trial << " layer " << layer;
    }
  }
}

// Other casters and the origin of the mask must not change a caster's cells, bit for bit.
TEST(SilhouetteMask, DrawsCasterIndependentlyOfOtherCasters) {
  const glm::vec3 light(0.4F, 0.6F, 0.9F);
  const Placed ring = place(*torus(), test::at(0.31, -0.22, 0.1, {1, 0.3, 0}, 0.5));
  const Placed left = place(*box(), test::at(0.03, -0.2, 0.15, {0, 1, 0.2}, 0.4));
  const Placed below = place(*table_and_ball(), test::at(0.33, -0.6, 0.12));
  constexpr double kCell = 0.0011;
  const Mask alone = draw({&ring}, light, kCell);
  const Mask together = draw({&left, &below, &ring}, light, kCell);
  ASSERT_GT(together.cells.width, alone.cells.width + 50);
  ASSERT_GT(together.cells.height, alone.cells.height + 50);
  int dark = 0;
  for (std::int64_t v = alone.cells.v; v < alone.cells.v + alone.cells.height; ++v) {
    for (std::int64_t u = alone.cells.u; u < alone.cells.u + alone.cells.width; ++u) {
      ASSERT_EQ(alone.at(u, v), together.at(u, v)) << u << " " << v;
      if (alone.at(u, v) < 200) ++dark;
    }
  }
  EXPECT_GT(dark, 1000);
}

TEST(SilhouetteMask, KeepsDarkestLayer) {
  // The box is high above the ring, so that the ring's layers lie in the box's penumbra.
  const Placed ring = place(*torus(), test::at(0, 0, 0.05));
  const Placed high = place(*box(), test::at(0, 0, 0.2));
  const glm::vec3 light(0.1F, 0.5F, 0.9F);
  const Mask a = draw({&ring}, light, 0.001);
  const Mask b = draw({&high}, light, 0.001);
  const Mask both = draw({&ring, &high}, light, 0.001);
  int compared = 0;
  for (std::int64_t v = -30; v < 30; ++v) {
    for (std::int64_t u = -30; u < 30; ++u) {
      const auto flat = [&](int code) {
        return code == 26 || code == 128 || code == 230 || code == 255;
      };
      if (!flat(a.at(u, v)) || !flat(b.at(u, v))) continue;
      EXPECT_EQ(both.at(u, v), std::min(a.at(u, v), b.at(u, v)));
      ++compared;
    }
  }
  EXPECT_GT(compared, 1000);
}

TEST(SilhouetteMask, IsEmptyWithoutCastersAndEqualFarFromOrigin) {
  Placed none = place(*box(), test::at(0, 0, 0.1));
  MaskCaster caster;
  caster.project(none.mesh.positions, none.kernels, none.own, kConstants, {}, 0.001);
  EXPECT_TRUE(caster.bounds().isEmpty());
  caster.project({}, {}, none.own, kConstants, {true, true, true}, 0.001);
  EXPECT_TRUE(caster.bounds().isEmpty());
  // Far from the plane's origin, the mask has the same cells at shifted indices.
  const Mask near = draw({&none}, glm::vec3(0.0F, 0.5F, 0.8F), 0.001);
  Placed far = none;
  far.own.T_plane_own.displacement += Eigen::Vector2d(512.0, -256.0);
  const Mask moved = draw({&far}, glm::vec3(0.0F, 0.5F, 0.8F), 1.0 / 1024.0);
  Placed back = far;
  back.own.T_plane_own.displacement -= Eigen::Vector2d(512.0, -256.0);
  EXPECT_EQ(moved.codes, draw({&back}, glm::vec3(0.0F, 0.5F, 0.8F), 1.0 / 1024.0).codes);
  EXPECT_GT(near.cells.width, 10);
}

ShadowField some_field(int i, std::mt19937& generator) {
  std::uniform_real_distribution<float> noise(-1.0F, 1.0F);
  ShadowField field;
  field.width = 2 + i % 19;
  field.height = 2 + i % 11;
  field.cell = i % 3 == 0 ? 0.0037 : 0.0007;
  field.origin = {-0.02 + 0.013 * i, 0.4 - 0.021 * i};
  const auto count = static_cast<std::size_t>(field.width * field.height);
  for (std::vector<float>* layer : {&field.umbra, &field.middle, &field.penumbra}) {
    layer->resize(count);
    const float lowest = noise(generator);
    // Some layers are positive everywhere; others touch 0.
    for (float& value : *layer) {
      value = i % 7 == 0 ? 1.0F : noise(generator) - lowest;
      if (std::abs(value) < 0.05F) value = 0.0F;
    }
  }
  return field;
}

// A field's outline must cover the same cells as its triangles up to rounding, at any position.
TEST(SilhouetteMask, MatchesTrianglesOfOutlines) {
  std::mt19937 generator(7);
  for (int i = 0; i < 60; ++i) {
    const ShadowField field = some_field(i, generator);
    OwnFrame own;
    own.T_plane_own = PlanarMotion{std::cos(0.3 * i), std::sin(0.3 * i), {0.31 * i, -0.07 * i}};
    constexpr double kCell = 0.0011;
    const auto mask_codes = [&](bool by_outline) {
      MaskCaster caster;
      caster.begin(own, kCell);
      for (const ShadowLayer layer : kShadowLayers) {
        if (by_outline) {
          caster.project_outline(layer, field_outline(field, layer));
        } else {
          caster.project_faces(layer, field_triangles(field, layer));
        }
      }
      const auto& box = caster.bounds();
      std::vector<std::uint8_t> codes;
      if (box.isEmpty()) return codes;
      MaskRaster raster;
      raster.begin({kCell, box.min().x() - 1, box.min().y() - 1,
                    static_cast<int>(box.sizes().x()) + 3, static_cast<int>(box.sizes().y()) + 3});
      raster.cover(caster, {}, {});
      raster.finish({0.0F, 0.5F, 0.8F}, codes);
      return codes;
    };
    const std::vector<std::uint8_t> outlined = mask_codes(true);
    const std::vector<std::uint8_t> faces = mask_codes(false);
    // In thin faces that fold over, rounding errors of the sums differ.
    ASSERT_EQ(outlined.size(), faces.size()) << i;
    for (std::size_t cell = 0; cell < faces.size(); ++cell)
      ASSERT_NEAR(outlined[cell], faces[cell], 2) << i;
  }
}

TEST(SilhouetteMask, IgnoresOutlinesThatAreNotFinite) {
  const float inf = std::numeric_limits<float>::infinity();
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), inf, -inf}) {
    MaskCaster caster;
    caster.begin(OwnFrame(), 0.001);
    const PlanePoint a{0.0F, 0.0F}, b{0.1F, 0.0F}, c{0.05F, bad};
    const std::vector<OutlineSide> sides = {{a, b}, {b, c}, {c, a}};
    caster.project_outline(ShadowLayer::middle, sides);
    EXPECT_TRUE(caster.bounds().isEmpty());
    MaskRaster raster;
    raster.begin({0.001, 0, 0, 16, 16});
    raster.cover(caster, {}, {});
    std::vector<std::uint8_t> codes;
    raster.finish({0.0F, 0.5F, 0.8F}, codes);
    EXPECT_EQ(std::ranges::count(codes, 255), 256);
  }
}

// ---- windows of a mask, and many sheets ----

constexpr double kUnit = 1.0 / 1024.0;  // cell size [m]; a power of two keeps coordinates exact
using Triangles = std::vector<Eigen::Vector2d>;  // three corners per triangle [cells]
OwnFrame unmoved() {
  return OwnFrame::make(Placement(), PlaneFrame(), 0.1, 26);
}
// Returns a caster that has the same triangles in every layer.
MaskCaster caster_of(const Triangles& corners) {
  std::vector<PlanePoint> points;
  for (const Eigen::Vector2d& corner : corners)
    points.push_back(
        {static_cast<float>(kUnit * corner.x()), static_cast<float>(kUnit * corner.y())});
  MaskCaster caster;
  caster.begin(unmoved(), kUnit);
  for (const ShadowLayer layer : kShadowLayers) caster.project_faces(layer, points);
  return caster;
}
// A closed mesh whose mask is covered by its silhouettes.
struct Body {
  std::vector<glm::vec3> positions;
  std::vector<std::uint32_t> indices;
  [[nodiscard]] MaskCaster projected(double cell) const {
    MaskCaster caster;
    const std::vector<glm::vec3> kernels(positions.size(), glm::vec3(0.002F, 0.001F, 0.05F));
    caster.project(positions, kernels, unmoved(), kConstants, {true, true, true}, cell);
    return caster;
  }
};
using Cover = std::function<void(MaskRaster&)>;
// Rasters `cells` and returns the coverage (0 to 255) of the cells in `part`.
std::vector<std::uint8_t> coverage_in(MaskRaster& raster, const Cover& cover,
                                      const MaskCells& cells, const MaskCells& part) {
  std::vector<std::uint8_t> shares(std::size_t{4} * static_cast<std::size_t>(part.width) *
                                   static_cast<std::size_t>(part.height));
  raster.begin(cells);
  cover(raster);
  raster.finish_coverage(part, shares);
  return shares;
}
MaskCells cells_around(const MaskCaster& caster, double cell) {
  const auto& box = caster.bounds();
  return {cell, box.min().x() - 1, box.min().y() - 1, static_cast<int>(box.sizes().x()) + 3,
          static_cast<int>(box.sizes().y()) + 3};
}

// The coverage in a window must equal the whole raster's bit by bit, including edges through the
// window's corners and along its borders.
TEST(SilhouetteMask, MatchesWholeRasterInWindows) {
  std::mt19937 random(23);
  const auto whole_number = [&random](int low, int high) {
    return std::uniform_int_distribution<int>(low, high)(random);
  };
  int partly = 0;
  int beside = 0;
  MaskRaster of_whole;
  MaskRaster of_part;
  const auto compare = [&](const MaskCaster& caster, const Cover& cover, double cell) {
    if (caster.bounds().isEmpty()) return;
    const MaskCells whole = cells_around(caster, cell);
    for (int i = 0; i < 12; ++i) {
      const auto side = [&](int max_size) {
        return i % 3 == 0 ? whole_number(1, 4) : whole_number(1, max_size);
      };
      MaskCells part{cell, whole.u + whole_number(-8, whole.width + 4),
                     whole.v + whole_number(-8, whole.height + 4), side(whole.width + 8),
                     side(whole.height + 8)};
      if (i == 11) part = whole;
      const auto expected = coverage_in(of_whole, cover, whole, part);
      ASSERT_EQ(coverage_in(of_part, cover, part, part), expected)
          << whole.width << " x " << whole.height << ": " << part.width << " x " << part.height
          << " at " << part.u - whole.u << ", " << part.v - whole.v;
      const bool dark =
          std::ranges::any_of(expected, [](std::uint8_t covered) { return covered > 0; });
      (dark ? partly : beside) += 1;
      // The encoded values are also equal, and no state is left over from earlier masks.
      std::vector<std::uint8_t> all;
      std::vector<std::uint8_t> some;
      of_whole.begin(whole);
      cover(of_whole);
      of_whole.finish({0.2F, 0.5F, 0.8F}, all);
      of_part.begin(part);
      cover(of_part);
      of_part.finish({0.2F, 0.5F, 0.8F}, some);
      for (int v = 0; v < part.height; ++v) {
        for (int u = 0; u < part.width; ++u) {
          const std::int64_t x = part.u + u - whole.u;
          const std::int64_t y = part.v + v - whole.v;
          const bool inside = x >= 0 && y >= 0 && x < whole.width && y < whole.height;
          const int code = inside ? all.at(static_cast<std::size_t>(y * whole.width + x)) : 255;
          ASSERT_EQ(some.at(static_cast<std::size_t>(v * part.width + u)), code);
        }
      }
    }
  };
  for (int trial = 0; trial < 60; ++trial) {
    SCOPED_TRACE(trial);
    // Vertices lie on corners and borders of cells, or anywhere. Triangles are small or large.
    const int extent = trial % 5 == 0 ? 300 : 24;
    const int fine = trial % 2 == 0 ? 1 : 256;
    Triangles corners;
    for (int face = 0; face < 1 + trial % 4; ++face) {
      for (int corner = 0; corner < 3; ++corner) {
        corners.emplace_back(
            whole_number(-extent * fine, extent * fine) / static_cast<double>(fine),
            whole_number(-extent * fine, extent * fine) / static_cast<double>(fine));
      }
    }
    MaskCaster faces = caster_of(corners);
    compare(
        faces, [&](MaskRaster& to) { to.cover(faces, {}, {}); }, kUnit);
    const Placed placed = place(trial % 2 == 0 ? *table_and_ball() : *torus(6, 10),
                                test::at(0.01 * trial, -0.02 * trial, 0.1, {1, 0.2, 0.4}, trial));
    const auto edges = paired_edges(placed.mesh.indices);
    for (const double cell : {0.02, 0.0011}) {
      MaskCaster closed;
      closed.project(placed.mesh.positions, placed.kernels, placed.own, kConstants,
                     {true, trial % 3 != 0, true}, cell);
      compare(
          closed, [&](MaskRaster& to) { to.cover(closed, placed.mesh.indices, *edges); }, cell);
    }
    const ShadowField field = some_field(trial, random);
    MaskCaster lines;
    lines.begin(placed.own, 0.0003);
    for (const ShadowLayer layer : kShadowLayers)
      lines.project_outline(layer, field_outline(field, layer));
    compare(
        lines, [&](MaskRaster& to) { to.cover(lines, {}, {}); }, 0.0003);
  }
  EXPECT_GT(partly, 600);
  EXPECT_GT(beside, 200);
}

// Meshes larger than any raster are compared with half planes, and windows with the whole raster.
TEST(SilhouetteMask, MatchesReferenceForMeshLargerThanRaster) {
  std::mt19937 random(29);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  const MaskCells cells{kUnit, -20, -15, 40, 30};
  MaskRaster raster;
  int edges = 0;
  for (const double extent : {3e3, 2e5, 1.9e6}) {
    for (int trial = 0; trial < 30; ++trial) {
      // One side of the triangle crosses the raster.
      const Eigen::Vector2d along = Eigen::Vector2d(uniform(random), uniform(random)).normalized();
      const Eigen::Vector2d across(-along.y(), along.x());
      const Eigen::Vector2d through(15.0 * uniform(random), 10.0 * uniform(random));
      const auto rounded = [](const Eigen::Vector2d& p) -> Eigen::Vector2d {
        return (256.0 * p).array().round() / 256.0;
      };
      const Eigen::Vector2d a = rounded(through - extent * along);
      const Eigen::Vector2d b = rounded(through + extent * along);
      const Eigen::Vector2d c = rounded(through + extent * across);
      MaskCaster caster = caster_of(trial % 2 == 0 ? Triangles{a, b, c} : Triangles{a, c, b});
      const Cover cover = [&](MaskRaster& to) { to.cover(caster, {}, {}); };
      const auto shares = coverage_in(raster, cover, cells, cells);
      // Rounds a corner to float, as caster_of() does.
      const auto placed = [](const Eigen::Vector2d& p) -> Eigen::Vector2d {
        return Eigen::Vector2d(static_cast<double>(static_cast<float>(kUnit * p.x())),
                               static_cast<double>(static_cast<float>(kUnit * p.y()))) /
               kUnit;
      };
      const Eigen::Vector2d from = placed(a);
      const Eigen::Vector2d side = placed(b) - from;
      for (int v = 0; v < cells.height; ++v) {
        for (int u = 0; u < cells.width; ++u) {
          // Counts 256 points of a cell, unless all its corners are on one side.
          const auto is_inside = [&](double x, double y) {
            const Eigen::Vector2d d = Eigen::Vector2d(static_cast<double>(cells.u + u) + x,
                                                      static_cast<double>(cells.v + v) + y) -
                                      from;
            return side.x() * d.y() - side.y() * d.x() > 0.0;
          };
          int inside = 0;
          for (const double x : {0.0, 1.0}) {
            for (const double y : {0.0, 1.0}) inside += is_inside(x, y) ? 64 : 0;
          }
          if (inside > 0 && inside < 256) {
            inside = 0;
            for (int i = 0; i < 256; ++i)
              inside += is_inside((i % 16 + 0.5) / 16.0, (i / 16 + 0.5) / 16.0) ? 1 : 0;
          }
          const double expected = 255.0 * inside / 256.0;
          const int covered = shares[static_cast<std::size_t>(4 * (v * cells.width + u))];
          // Tolerance: the mask rounds the crossings of cell borders, and the reference counts
          // points.
          ASSERT_NEAR(covered, expected, 8.0) << extent << " " << trial << ": " << u << ", " << v;
          edges += inside > 0 && inside < 256 ? 1 : 0;
        }
      }
      const MaskCells part{kUnit, cells.u + trial, cells.v + trial % 7, 9, 21};
      ASSERT_EQ(coverage_in(raster, cover, part, part), coverage_in(raster, cover, cells, part));
    }
  }
  EXPECT_GT(edges, 1000);
}

// Vertices that are not finite or out of range must not change the coverage of the other body.
TEST(SilhouetteMask, IgnoresVerticesThatAreNotFinite) {
  const float infinity = std::numeric_limits<float>::infinity();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  Body body;
  ShapeBuilder shape;
  shape.box(-0.04, -0.03, 0.03, 0.0, 0.03, 0.06);
  shape.box(0.05, -0.02, 0.03, 0.08, 0.02, 0.05);
  for (const Mesh& mesh : shape.build().meshes) {
    for (const std::uint32_t index : mesh.indices)
      body.indices.push_back(static_cast<std::uint32_t>(body.positions.size()) + index);
    body.positions.insert(body.positions.end(), mesh.positions.begin(), mesh.positions.end());
  }
  const std::size_t first_box_vertices = body.positions.size() / 2;
  const auto edges = paired_edges(body.indices);
  ASSERT_TRUE(edges);
  MaskRaster raster;
  constexpr double kCell = 0.001;
  const MaskCells cells{kCell, -60, -50, 160, 100};
  const auto shares = [&](const Body& of) {
    MaskCaster caster = of.projected(kCell);
    return coverage_in(
        raster, [&](MaskRaster& to) { to.cover(caster, of.indices, *edges); }, cells, cells);
  };
  const auto all = shares(body);
  for (const float wrong : {nan, infinity, -infinity, 3e38F, -1e30F, 1e9F}) {
    SCOPED_TRACE(wrong);
    for (std::size_t axis = 0; axis < 2; ++axis) {
      Body broken = body;
      for (std::size_t i = first_box_vertices; i < broken.positions.size(); ++i)
        broken.positions[i][static_cast<int>(axis)] = wrong;
      const MaskCaster caster = broken.projected(kCell);
      EXPECT_LT(caster.bounds().sizes().maxCoeff(), std::int64_t{1} << 23);
      const auto remaining = shares(broken);
      int dark = 0;
      for (std::size_t i = 0; i < remaining.size(); ++i) {
        const bool in_second_box = static_cast<int>(i / 4) % cells.width > 80;
        ASSERT_EQ(remaining[i], in_second_box ? 0 : all[i]) << i;
        dark += remaining[i] == 255 ? 1 : 0;
      }
      EXPECT_GT(dark, 2000);
      // If only one vertex is invalid, the coverage of the first box must remain.
      Body pierced = body;
      pierced.positions.back()[static_cast<int>(axis)] = wrong;
      const auto pierced_coverage = shares(pierced);
      for (std::size_t i = 0; i < pierced_coverage.size(); ++i)
        ASSERT_GE(pierced_coverage[i], remaining[i]) << i;
    }
  }
  Body nothing = body;
  for (glm::vec3& p : nothing.positions) p = glm::vec3(nan);
  EXPECT_TRUE(nothing.projected(kCell).bounds().isEmpty());
  const double far = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(caster_of({{0, 0}, {far, 1}, {3, 4}}).bounds().isEmpty());
}

// Any number of sheets may overlap: as open faces, as closed bodies, or from stored covers.
TEST(SilhouetteMask, DoesNotOverflowForManySheets) {
  const Triangles triangle = {{2.3, 1.2}, {30.7, 4.1}, {12.4, 25.9}};
  const auto open = [&](std::size_t count, bool turn_some) {
    Triangles corners;
    for (std::size_t i = 0; i < count; ++i) {
      corners.insert(corners.end(), triangle.begin(), triangle.end());
      if (turn_some && i % 2 == 0) std::swap(corners[3 * i], corners[3 * i + 1]);
    }
    return caster_of(corners);
  };
  // Flat closed bodies of four faces; three of the faces have the same winding.
  const auto closed = [](std::size_t count) {
    Body body;
    for (std::size_t i = 0; i < count; ++i) {
      const auto first = static_cast<std::uint32_t>(body.positions.size());
      for (const glm::vec3& p : {glm::vec3(0.002F, 0.001F, 0.04F), glm::vec3(0.03F, 0.004F, 0.04F),
                                 glm::vec3(0.012F, 0.026F, 0.04F), glm::vec3(0.014F, 0.01F, 0.05F)})
        body.positions.push_back(p);
      for (const std::uint32_t corner : {0U, 2U, 1U, 0U, 1U, 3U, 1U, 2U, 3U, 2U, 0U, 3U})
        body.indices.push_back(first + corner);
    }
    return body;
  };
  const MaskCells cells{kUnit, -2, -2, 40, 34};
  const MaskCells part{kUnit, 10, 6, 11, 9};
  MaskRaster raster;
  const auto check = [&](const Cover& many, const std::vector<std::uint8_t>& few,
                         const std::vector<std::uint8_t>& few_of_part) {
    const auto shares = coverage_in(raster, many, cells, cells);
    int full = 0;
    for (std::size_t i = 0; i < shares.size(); ++i) {
      ASSERT_GE(shares[i], few[i]) << i;
      if (few[i] == 0 && shares[i] > 0) {
        ASSERT_LT(i % 4, 3U);
      }
      full += few[i] == 255 ? 1 : 0;
    }
    EXPECT_GT(full, 600);
    const auto shares_in_part = coverage_in(raster, many, part, part);
    for (std::size_t i = 0; i < shares_in_part.size(); ++i)
      ASSERT_GE(shares_in_part[i], few_of_part[i]) << i;
  };
  constexpr std::size_t kFew = 4000;  // number of faces or bodies
  std::vector<std::size_t> many_of = {16384, 32768, 65536};
  if (test::nightly()) many_of.insert(many_of.end(), {20000, 32767, 40000});
  for (const bool turn_some : {false, true}) {
    MaskCaster few = open(kFew, turn_some);
    const Cover cover_few = [&](MaskRaster& to) { to.cover(few, {}, {}); };
    const auto shares = coverage_in(raster, cover_few, cells, cells);
    const auto of_part = coverage_in(raster, cover_few, part, part);
    for (const std::size_t count : many_of) {
      SCOPED_TRACE(count);
      MaskCaster many = open(turn_some ? 2 * count : count, turn_some);
      check([&](MaskRaster& to) { to.cover(many, {}, {}); }, shares, of_part);
      // The same must hold for several stored covers with fewer faces each.
      MaskRaster of_one;
      MaskCover cover;
      of_one.begin(cells);
      of_one.cover(many, {}, {});
      of_one.take(cover);
      const auto taken = [&](MaskRaster& to) {
        for (int i = 0; i < 3; ++i) to.cover(cover);
      };
      const auto of_taken = coverage_in(raster, taken, cells, cells);
      for (std::size_t i = 0; i < of_taken.size(); ++i) ASSERT_GE(of_taken[i], shares[i]) << i;
    }
  }
  const Body few = closed(kFew);
  MaskCaster few_projected = few.projected(kUnit);
  const auto few_edges = paired_edges(few.indices);
  const Cover cover_few = [&](MaskRaster& to) { to.cover(few_projected, few.indices, *few_edges); };
  const auto shares = coverage_in(raster, cover_few, cells, cells);
  const auto of_part = coverage_in(raster, cover_few, part, part);
  for (const std::size_t count : many_of) {
    SCOPED_TRACE(count);
    const Body many = closed(count);
    MaskCaster projected = many.projected(kUnit);
    const auto edges = paired_edges(many.indices);
    check([&](MaskRaster& to) { to.cover(projected, many.indices, *edges); }, shares, of_part);
  }
}

// ---- drawn masks ----

constexpr int kWidth = 320;
constexpr int kHeight = 240;

CameraModel camera(double scale = 1.0) {
  CameraParameters p;
  p.width = static_cast<int>(kWidth * scale);
  p.height = static_cast<int>(kHeight * scale);
  p.fx = p.fy = 420.0 * scale;
  // Scales the view about the frame's corner, half a pixel before the centre of pixel (0, 0).
  p.cx = (160.0 + 0.5) * scale - 0.5;
  p.cy = (120.0 + 0.5) * scale - 0.5;
  return CameraModel::make(p).value();
}
CameraModel distorted_camera() {
  CameraParameters p = camera().parameters();
  p.model = DistortionModel::plumb_bob;
  p.distortion = {-0.28, 0.08, 0.001, -0.0008, 0.0, 0.0, 0.0, 0.0};
  return CameraModel::make(p).value();
}

class DrawnMask : public testing::Test {
 protected:
  static std::shared_ptr<const Scene> scene(
      const std::vector<std::pair<std::shared_ptr<const Model>, Placement>>& objects) {
    test::SceneBuilder builder;
    for (const auto& [model, placement] : objects) builder.add(model, placement);
    builder.scene().shadows[0].layered = kConstants;
    return builder.build();
  }
  static std::shared_ptr<const Scene> ring() {
    return scene({{torus(), test::at(0.0, 0.0, 0.1, {1, 0.2, 0}, 0.4)}});
  }
  static PoseEstimate pose() {
    return test::tracked(test::look_at({0.1, -0.45, 0.4}, {0.0, 0.0, 0.03}));
  }
  static PlanOptions by(LayerDrawing layers, Translucency translucency = Translucency::blend) {
    PlanOptions options;
    options.layers = layers;
    options.translucency = translucency;
    return options;
  }
  static RenderedImage shadows(Studio& studio, const PlanOptions& options) {
    return studio.draw_shadows(
        test::plain_frame(studio.camera().width(), studio.camera().height(), 255),
        studio.plan(pose(), options));
  }
};

TEST_F(DrawnMask, SmoothsEdgesOnly) {
  for (const auto& objects :
       {ring(), scene({{table_and_ball(), test::at(0.02, 0.01, 0.06, {0, 1, 0.3}, 0.3)},
                       {torus(), test::at(-0.04, -0.02, 0.15)}})}) {
    Studio coarse(objects, camera());
    Studio fine(objects, camera(4.0));
    const RenderedImage reference = shadows(fine, by(LayerDrawing::direct));
    const EdgeError mask = edge_error(shadows(coarse, by(LayerDrawing::mask)), reference, 4);
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 1);
    const EdgeError direct = edge_error(shadows(coarse, by(LayerDrawing::direct)), reference, 4);
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 0);
    std::printf("edge error [grey levels RMS]: mask %.2f, direct %.2f, over %d pixels\n", mask.rms,
                direct.rms, mask.edges);
    EXPECT_GT(mask.edges, 500);
    EXPECT_LT(mask.rms, 6.0);
    EXPECT_GT(direct.rms, 1.5 * mask.rms);
    EXPECT_LE(mask.largest_elsewhere, 1);
    EXPECT_EQ(direct.largest_elsewhere, 0);
  }
}

TEST_F(DrawnMask, FollowsLensDistortion) {
  Studio studio(ring(), distorted_camera());
  const RenderedImage direct = shadows(studio, by(LayerDrawing::direct));
  const RenderedImage mask = shadows(studio, by(LayerDrawing::mask));
  EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
  // At a misplaced edge, pixels would differ by a layer's step along the whole edge.
  int off = 0;
  int dark = 0;
  for (int y = 2; y + 2 < kHeight; ++y) {
    for (int x = 2; x + 2 < kWidth; ++x) {
      const int value = direct.red(x, y);
      if (value < 255) ++dark;
      bool flat = true;
      for (int i = 0; i < 25 && flat; ++i) flat = direct.red(x + i % 5 - 2, y + i / 5 - 2) == value;
      if (flat && std::abs(mask.red(x, y) - value) > 1) ++off;
    }
  }
  EXPECT_GT(dark, 1000);
  EXPECT_EQ(off, 0);
}

// Frames with and without skipping must agree bit for bit: in every mode, for any lens, and for a
// mask that was drawn for another view.
TEST_F(DrawnMask, IsUnchangedBySkippingEmptyPieces) {
  const auto objects = scene({{torus(), test::at(-0.15, 0.02, 0.1, {1, 0.2, 0}, 0.4)},
                              {table_and_ball(), test::at(0.12, 0.1, 0.05)}});
  const PoseEstimate near = test::tracked(test::look_at({0.05, -0.2, 0.25}, {0.0, 0.05, 0.0}));
  const PoseEstimate far = test::tracked(test::look_at({0.1, -0.8, 0.9}, {0.0, 0.05, 0.0}));
  for (const bool lens : {false, true}) {
    const CameraModel by_camera = lens ? distorted_camera() : camera();
    Studio some(objects, by_camera);
    Studio all(objects, by_camera);
    for (const Translucency mode :
         {Translucency::blend, Translucency::retexture, Translucency::mesh}) {
      for (const PoseEstimate& at : {far, near, far, pose()}) {
        FramePlan plan = some.plan(at, by(LayerDrawing::mask, mode));
        plan.objects.clear();
        ASSERT_TRUE(plan.reuse);
        const Frame frame = test::plain_frame(kWidth, kHeight, 200);
        const RenderedImage image = some.draw(frame, plan);
        ASSERT_EQ(
            some.stats()[Counter::layer_masks_drawn] + some.stats()[Counter::layer_masks_kept], 1);
        // More than half of the rectangle around both casters is empty. Without lens distortion the
        // mask is a single piece.
        if (lens) {
          EXPECT_GT(some.stats()[Counter::mask_pieces_skipped], 128);
        } else {
          EXPECT_EQ(some.stats()[Counter::mask_pieces_skipped], 0);
        }
        plan.reuse = false;
        EXPECT_EQ(image, all.draw(frame, plan)) << to_string(mode) << " lens " << lens;
        EXPECT_EQ(all.stats()[Counter::mask_pieces_skipped], 0);
        EXPECT_EQ(image, some.draw(frame, plan));
        EXPECT_EQ(some.stats()[Counter::mask_pieces_skipped], 0);
      }
    }
  }
}

// The caster slides and rotates, so that its edges cross the borders of pieces at many positions.
TEST_F(DrawnMask, DrawsPiecesOfCurrentMask) {
  const auto objects = ring();
  Studio some(objects, distorted_camera());
  Studio all(objects, distorted_camera());
  SceneState state = evaluate_scene(*objects, 0.0);
  const Frame frame = test::plain_frame(kWidth, kHeight, 200);
  for (int i = 0; i < 60; ++i) {
    state.objects[0].position.x() += 0.00037;
    state.objects[0].rotation =
        Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitZ()) * state.objects[0].rotation;
    FramePlan plan =
        plan_frame(*objects, state, pose(), distorted_camera(), by(LayerDrawing::mask));
    plan.objects.clear();
    const RenderedImage image = some.draw(frame, plan);
    EXPECT_GT(some.stats()[Counter::mask_pieces_skipped], 0);
    plan.reuse = false;
    ASSERT_EQ(image, all.draw(frame, plan)) << i;
  }
}

TEST_F(DrawnMask, IsEqualInEveryModeAndApi) {
  const auto objects = scene({{torus(), test::at(0.0, 0.0, 0.1, {1, 0.2, 0}, 0.4)},
                              {torus(), test::at(0.9, 2.0, 0.1)}});  // this torus is out of view
  Studio studio(objects, camera());
  const RenderedImage blended = shadows(studio, by(LayerDrawing::mask));
  PlanOptions all = by(LayerDrawing::mask);
  all.skip = false;
  EXPECT_EQ(shadows(studio, all), blended);
  Studio fresh(objects, camera());
  EXPECT_EQ(shadows(fresh, all), blended);
  Studio es(objects, camera(), GlApi::gles30);
  EXPECT_EQ(shadows(es, by(LayerDrawing::mask)), blended);
  const RenderedImage retextured = shadows(studio, by(LayerDrawing::mask, Translucency::retexture));
  for (std::size_t i = 0; i < blended.rgba.size(); ++i)
    ASSERT_NEAR(retextured.rgba[i], blended.rgba[i], 1);
  // The automatic choice is a mask, because the casters have at least 1024 faces.
  EXPECT_EQ(shadows(studio, by(LayerDrawing::automatic)), blended);
  // Geometry strips are drawn with the stencil, without a mask.
  EXPECT_EQ(shadows(studio, by(LayerDrawing::mask, Translucency::geometry_mesh)),
            shadows(studio, by(LayerDrawing::direct, Translucency::geometry_mesh)));
}

// Index of a pixel within the 16-pixel screen-door pattern (translucency.glsl).
int screen_door_index(int x, int y) {
  const int either = x ^ y;
  return ((either & 1) << 3) | ((y & 1) << 2) | (either & 2) | ((y & 2) >> 1);
}

// Over white video, masks and direct drawing darken the same pixels, except near the edges of
// layers. Near an edge, a pixel must be dark if the pattern of the lightest neighbouring layer
// darkens it. It must be light if the pattern of the darkest neighbouring layer leaves it light.
TEST_F(DrawnMask, CoversSamePixelsAsDirectScreenDoor) {
  for (const LightFractions& fractions :
       {LightFractions(), LightFractions{0.0, 0.28, 0.83}, LightFractions{0.41, 0.62, 0.95}}) {
    for (const bool lens : {false, true}) {
      Scene of_ring = *ring();
      of_ring.shadows[0].fractions = fractions;
      Studio studio(std::make_shared<const Scene>(of_ring), lens ? distorted_camera() : camera());
      const RenderedImage layers = shadows(studio, by(LayerDrawing::direct));
      const RenderedImage direct = shadows(studio, by(LayerDrawing::direct, Translucency::mesh));
      EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 0);
      const RenderedImage mask = shadows(studio, by(LayerDrawing::mask, Translucency::mesh));
      EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
      // Each translucency mode has a separate mask, so a change of mode redraws it.
      const RenderedImage blended = shadows(studio, by(LayerDrawing::mask));
      EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
      EXPECT_NE(blended, mask);
      int inside = 0;
      int off = 0;
      int outside = 0;
      for (int y = 2; y + 2 < kHeight; ++y) {
        for (int x = 2; x + 2 < kWidth; ++x) {
          int darkest = 255;
          int lightest = 0;
          for (int i = 0; i < 25; ++i) {
            const int beside = layers.red(x + i % 5 - 2, y + i / 5 - 2);
            darkest = std::min(darkest, beside);
            lightest = std::max(lightest, beside);
          }
          const int shown = mask.red(x, y);
          EXPECT_TRUE(shown == 0 || shown == 255);
          const auto black = [&](int value) {
            return static_cast<float>(screen_door_index(x, y)) <
                   opaque_screen_door_pixels(static_cast<float>(value) / 255.0F);
          };
          if (shown == 0 ? !black(darkest) : black(lightest)) ++outside;
          if (darkest != lightest) continue;
          if (darkest < 255) ++inside;
          if (shown != direct.red(x, y)) ++off;
        }
      }
      EXPECT_GT(inside, 1000);
      EXPECT_EQ(off, 0);
      EXPECT_EQ(outside, 0);
    }
  }
}

TEST_F(DrawnMask, IsReusedUntilCasterMoves) {
  const auto objects = ring();
  Studio studio(objects, camera());
  const Frame frame = test::plain_frame(kWidth, kHeight, 255);
  SceneState state = evaluate_scene(*objects, 0.0);
  const auto draw = [&](const CameraPose& at) {
    const RenderedImage image = studio.draw_shadows(
        frame,
        plan_frame(*objects, state, test::tracked(at), studio.camera(), by(LayerDrawing::mask)));
    return std::pair(studio.stats()[Counter::layer_masks_drawn], image);
  };
  const CameraPose first = test::look_at({0.1, -0.45, 0.4}, {0.0, 0.0, 0.03});
  EXPECT_EQ(draw(first).first, 1);
  EXPECT_EQ(draw(test::look_at({0.1, -0.451, 0.4}, {0.0, 0.01, 0.03})).first, 0);
  EXPECT_EQ(studio.stats()[Counter::layer_masks_kept], 1);
  EXPECT_TRUE(std::ranges::any_of(studio.stats().kept, [](const KeptResult& part) {
    return part.reason == KeepReason::layer_mask;
  }));
  EXPECT_EQ(studio.stats()[Counter::shadow_vertices], 0);
  const RenderedImage before = draw(first).second;
  EXPECT_EQ(draw(test::look_at({0.1, -0.2, 0.2}, {0.0, 0.0, 0.03})).first, 1)
      << "a nearer camera needs a finer mask";
  for (const Eigen::Vector3d& step : {Eigen::Vector3d(1e-3, 0, 0), Eigen::Vector3d(0, 0, 1e-3),
                                      Eigen::Vector3d(-1e-3, 0, -1e-3)}) {
    state.objects[0].position += step;
    EXPECT_EQ(draw(first).first, 1);
  }
  EXPECT_EQ(draw(first).second, before) << "the mask must not depend on the frames in between";
}

// Scenes with clipped layers, open meshes and lights of fixed size.
class MaskByFaces : public DrawnMask {
 protected:
  static std::shared_ptr<const Model> open_torus(bool turn_some = false) {
    ShapeBuilder shape;
    shape.torus(0.05, 0.018, 16, 32);
    Model model = shape.build();
    std::vector<std::uint32_t>& indices = model.meshes[0].indices;
    indices.resize(indices.size() - 3 * std::size_t{150});
    for (std::size_t i = 0; turn_some && i + 2 < indices.size(); i += 21)
      std::swap(indices[i], indices[i + 1]);
    return test::finished(model, glm::vec4(0.5F));
  }
  // A Moebius strip, which has no consistent orientation.
  static std::shared_ptr<const Model> moebius() {
    constexpr int kSteps = 24;
    constexpr double kHalf = 0.015;
    constexpr double kTurn = 2.0 * 3.14159265358979;
    ShapeBuilder shape;
    const auto add = [&shape](int i, double side) {
      const double t = kTurn * i / kSteps;
      const double r = 0.05 + side * std::cos(t / 2);
      shape.vertex(r * std::cos(t), r * std::sin(t), side * std::sin(t / 2));
    };
    for (int i = 0; i < kSteps; ++i) {
      add(i, -kHalf);
      add(i, kHalf);
    }
    // The last vertex of one side is joined to the first vertex of the other.
    const auto at = [](int i, int side) {
      const int turned = i == kSteps ? 1 - side : side;
      return static_cast<std::uint32_t>(2 * (i % kSteps) + turned);
    };
    for (int i = 0; i < kSteps; ++i) {
      shape.triangle(at(i, 0), at(i + 1, 0), at(i, 1));
      shape.triangle(at(i, 1), at(i + 1, 0), at(i + 1, 1));
    }
    return test::finished(shape.build(), glm::vec4(0.5F));
  }
  static std::shared_ptr<const Scene> with_fixed_light(const std::shared_ptr<const Scene>& scene) {
    Scene fixed = *scene;
    fixed.shadows[0].light_mode = LightMode::fixed;
    return std::make_shared<const Scene>(fixed);
  }
  static constexpr double kUmbraEnds = 0.28;
};

TEST_F(MaskByFaces, SmoothsEdgesOnly) {
  ASSERT_NEAR(kConstants.umbra_height, kUmbraEnds, 1e-12);
  const Eigen::Vector3d tilt(1, 0.2, 0);
  const struct {
    const char* what;
    std::shared_ptr<const Scene> of;
    // Maximum edge error relative to direct drawing. Just below the umbra height an umbra is
    // narrower than a cell, which blurs it over the cell.
    double max_ratio;
  } cases[] = {
      {"open", scene({{open_torus(), test::at(0, 0, 0.1, tilt, 0.4)}}), 0.4},
      {"open, faces turned", scene({{open_torus(true), test::at(0, 0, 0.1, tilt, 0.4)}}), 0.4},
      {"cut where the umbra ends", scene({{torus(), test::at(0, 0, kUmbraEnds, tilt, 0.4)}}), 0.6},
      {"cut by the plane", scene({{torus(), test::at(0, 0, 0.0, tilt, 0.4)}}), 0.4},
      {"cut, beside a whole one",
       scene({{torus(), test::at(0, 0, 0.1)},
              {torus(), test::at(0.06, 0, kUmbraEnds, {1, 0, 0}, 0.4)}}),
       0.6},
      {"cut twice, open", scene({{open_torus(), test::at(0, 0, 0.0, {1, 0, 0}, 1.5, 5.0)}}), 0.4},
      {"in a light of one size",
       with_fixed_light(scene({{table_and_ball(), test::at(0, 0, 0.08)}})), 0.4},
      {"in a light of one size, cut",
       with_fixed_light(scene({{table_and_ball(), test::at(0, 0, kUmbraEnds - 0.03, tilt, 0.4)}})),
       0.6},
  };
  for (const auto& c : cases) {
    SCOPED_TRACE(c.what);
    Studio coarse(c.of, camera());
    Studio fine(c.of, camera(4.0));
    const RenderedImage reference = shadows(fine, by(LayerDrawing::direct));
    const EdgeError mask = edge_error(shadows(coarse, by(LayerDrawing::mask)), reference, 4);
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 1);
    const EdgeError direct = edge_error(shadows(coarse, by(LayerDrawing::direct)), reference, 4);
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 0);
    std::printf("%s: edge error [grey levels RMS]: mask %.2f, direct %.2f, over %d pixels\n",
                c.what, mask.rms, direct.rms, mask.edges);
    EXPECT_GT(mask.edges, 300);
    EXPECT_LT(mask.rms, c.max_ratio * direct.rms);
    EXPECT_LE(mask.largest_elsewhere, 1);
    EXPECT_EQ(direct.largest_elsewhere, 0);
  }
}

// The caster rises through the heights where its layers are clipped. Neighbouring faces must leave
// no seam.
TEST_F(MaskByFaces, LeavesNoSeamAtMovingClipHeight) {
  const auto objects = scene({{torus(), test::at(0, 0, 0)}});
  Studio studio(objects, camera());
  Studio fine(objects, camera(4.0));
  SceneState state = evaluate_scene(*objects, 0.0);
  for (int i = 0; i < 12; ++i) {
    state.objects[0] = test::at(0.002 * i, 0, -0.02 + 0.0274 * i, {1, 0.3, 0.1}, 0.2 + 0.06 * i);
    const auto drawn = [&](Studio& by_studio, LayerDrawing layers) {
      const CameraModel& seen_by = by_studio.camera();
      return by_studio.draw_shadows(test::plain_frame(seen_by.width(), seen_by.height(), 255),
                                    plan_frame(*objects, state, pose(), seen_by, by(layers)));
    };
    const RenderedImage mask = drawn(studio, LayerDrawing::mask);
    EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
    EXPECT_LE(edge_error(mask, drawn(fine, LayerDrawing::direct), 4).largest_elsewhere, 1) << i;
  }
}

// If a mesh has no consistent orientation, all shadows of the plane are drawn directly.
TEST_F(MaskByFaces, RejectsMeshWithoutOrientation) {
  const auto objects = scene({{moebius(), test::at(0, 0, 0.1)}, {torus(), test::at(0.1, 0, 0.1)}});
  Studio studio(objects, camera());
  const RenderedImage requested = shadows(studio, by(LayerDrawing::mask));
  EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 0);
  ASSERT_EQ(studio.stats().skipped.size(), 1U);
  const SkippedPass& skipped = studio.stats().skipped[0];
  EXPECT_EQ(skipped.reason, SkipReason::mask_impossible);
  EXPECT_NE(text_of(skipped, *objects).find(objects->objects[0].name), std::string::npos);
  EXPECT_EQ(requested, shadows(studio, by(LayerDrawing::direct)));
  EXPECT_TRUE(studio.stats().skipped.empty()) << "no mask was requested";
}

// Masks and direct drawing must show the darkest layer of all nodes.
TEST_F(MaskByFaces, SharesMaskBetweenNodesOfDifferentLights) {
  Scene two = *scene({{torus(), test::at(0, 0, 0.1, {1, 0.2, 0}, 0.4)},
                      {table_and_ball(), test::at(0.03, 0.02, 0.06)}});
  two.shadows.push_back(two.shadows[0]);
  two.shadows[0].casters = {0};
  two.shadows[1].casters = {1};
  two.shadows[1].fractions = {0.3, 0.35, 0.38};
  const auto objects = std::make_shared<const Scene>(two);
  Studio coarse(objects, camera());
  Studio fine(objects, camera(4.0));
  const RenderedImage reference = shadows(fine, by(LayerDrawing::direct));
  const EdgeError mask = edge_error(shadows(coarse, by(LayerDrawing::mask)), reference, 4);
  EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 1);
  EXPECT_LT(mask.rms, 6.0);
  EXPECT_LE(mask.largest_elsewhere, 1);
  // In direct drawing, each pixel equals the darker one of the two nodes drawn alone.
  const RenderedImage both = shadows(coarse, by(LayerDrawing::direct));
  std::array<RenderedImage, 2> alone;
  for (std::size_t i = 0; i < 2; ++i) {
    Scene one = two;
    one.shadows[1 - i].casters.clear();
    Studio studio(std::make_shared<const Scene>(one), camera());
    alone[i] = shadows(studio, by(LayerDrawing::direct));
  }
  int of_first = 0;
  int of_second = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int a = alone[0].red(x, y);
      const int b = alone[1].red(x, y);
      ASSERT_EQ(both.red(x, y), std::min(a, b)) << x << ", " << y;
      if (a < b && b < 255) ++of_first;
      if (b < a && a < 255) ++of_second;
    }
  }
  EXPECT_GT(of_first, 20);
  EXPECT_GT(of_second, 20);
}

// Masks also smooth the edges of fields and simple shadows. A plane with only simple shadows uses a
// mask on request only.
TEST_F(DrawnMask, SupportsEveryTechnique) {
  struct Case {
    const char* what;
    std::vector<ShadowTechnique> of;
    int automatic;     // number of masks in automatic mode
    double max_error;  // [grey levels RMS]; a simple shadow has a single, higher step
  };
  constexpr auto kSimple = ShadowTechnique::simple;
  constexpr auto kField = ShadowTechnique::field;
  constexpr auto kLayered = ShadowTechnique::layered;
  const std::vector<std::pair<std::shared_ptr<const Model>, Placement>> casters = {
      {torus(), test::at(-0.06, 0.0, 0.1, {1, 0.2, 0}, 0.4)},
      {table_and_ball(), test::at(0.06, 0.02, 0.06)},
      {box(), test::at(0.0, 0.1, 0.12, {0.2, 1, 0.3}, 0.5)}};
  for (const Case& c : {Case{"simple", {kSimple, kSimple, kSimple}, 0, 9.5},
                        Case{"field", {kField, kField, kField}, 1, 6.0},
                        Case{"simple and layered", {kSimple, kLayered, kLayered}, 1, 6.0},
                        Case{"simple and field", {kField, kSimple, kField}, 1, 6.0},
                        Case{"all", {kLayered, kField, kSimple}, 1, 6.0}}) {
    SCOPED_TRACE(c.what);
    Scene some = *scene(casters);
    some.shadows.resize(3, some.shadows[0]);
    for (std::size_t i = 0; i < 3; ++i) {
      some.shadows[i].casters = {static_cast<int>(i)};
      some.shadows[i].technique = c.of[i];
    }
    const auto objects = std::make_shared<const Scene>(some);
    Studio coarse(objects, camera());
    Studio fine(objects, camera(4.0));
    const RenderedImage reference = shadows(fine, by(LayerDrawing::direct));
    const RenderedImage mask = shadows(coarse, by(LayerDrawing::mask));
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 1);
    EXPECT_TRUE(coarse.stats().skipped.empty());
    const EdgeError error = edge_error(mask, reference, 4);
    const RenderedImage direct = shadows(coarse, by(LayerDrawing::direct));
    EXPECT_EQ(coarse.stats()[Counter::layer_masks_drawn], 0);
    const EdgeError drawn = edge_error(direct, reference, 4);
    std::printf("%s: edge error [grey levels RMS]: mask %.2f, direct %.2f, over %d pixels\n",
                c.what, error.rms, drawn.rms, error.edges);
    EXPECT_GT(error.edges, 500);
    EXPECT_LT(error.rms, c.max_error);
    EXPECT_GT(drawn.rms, 1.5 * error.rms);
    EXPECT_LE(error.largest_elsewhere, 1);
    Studio recreated(objects, camera());
    EXPECT_EQ(shadows(recreated, by(LayerDrawing::automatic)), c.automatic == 1 ? mask : direct);
    EXPECT_EQ(recreated.stats()[Counter::layer_masks_drawn], c.automatic);
    // Without motion, no mask is drawn again. With reuse disabled, every mask is drawn again and
    // must be the same.
    EXPECT_EQ(shadows(recreated, by(LayerDrawing::mask)), mask);
    EXPECT_EQ(shadows(recreated, by(LayerDrawing::mask)), mask);
    EXPECT_EQ(recreated.stats()[Counter::layer_masks_kept], 1);
    EXPECT_EQ(recreated.stats()[Counter::shadow_vertices], 0);
    PlanOptions without = by(LayerDrawing::mask);
    without.skip = false;
    EXPECT_EQ(shadows(recreated, without), mask);
    EXPECT_GT(recreated.stats()[Counter::shadow_vertices], 0);
    const RenderedImage retextured =
        shadows(recreated, by(LayerDrawing::mask, Translucency::retexture));
    const int rounding = recreated.context().info().software ? 0 : 1;  // a GPU may round
    for (std::size_t i = 0; i < mask.rgba.size(); ++i)
      ASSERT_LE(std::abs(int{retextured.rgba[i]} - int{mask.rgba[i]}), rounding);
  }
}

// Casters at rest since the last mask are neither projected nor covered again. The frame must equal
// one from a new compositor.
TEST_F(DrawnMask, RedrawsOnlyMovingCasters) {
  const auto objects = scene({{torus(), test::at(0.0, 0.0, 0.1, {1, 0.2, 0}, 0.4)},
                              {table_and_ball(), test::at(-0.1, 0.02, 0.05)},
                              {box(), test::at(0.1, 0.0, kConstants.umbra_height)}});
  Studio studio(objects, camera());
  const Frame frame = test::plain_frame(kWidth, kHeight, 255);
  SceneState state = evaluate_scene(*objects, 0.0);
  const auto draw = [&](Studio& by_studio, bool skip) {
    PlanOptions options = by(LayerDrawing::mask);
    options.skip = skip;
    return by_studio.draw_shadows(frame,
                                  plan_frame(*objects, state, pose(), by_studio.camera(), options));
  };
  static_cast<void>(draw(studio, true));
  const std::int64_t all = studio.stats()[Counter::shadow_vertices];
  std::map<std::size_t, std::int64_t> alone;  // number of vertices of each caster
  for (std::size_t i = 0; i < 3; ++i) {
    alone[i] =
        static_cast<std::int64_t>(make_shadow_mesh(*objects->objects[i].model).positions.size());
  }
  ASSERT_GT(alone[0], 2 * alone[2]);
  // Objects that move before each mask: the box, the box, the ring, all, the ring, the ring.
  const std::vector<std::vector<std::size_t>> moves = {{2}, {2}, {0}, {0, 1, 2}, {0}, {0}};
  // A caster that comes to rest is projected once more, to store its cover. The box counts twice
  // because its umbra is clipped: it is projected as a closed mesh for two layers and face by face
  // for the umbra.
  const std::vector<std::int64_t> projected = {all, 2 * alone[2], alone[0] + 2 * alone[2],
                                               all, all,          alone[0]};
  for (std::size_t i = 0; i < moves.size(); ++i) {
    for (const std::size_t moved : moves[i]) state.objects[moved].position.x() += 0.0037;
    const RenderedImage image = draw(studio, true);
    EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
    EXPECT_EQ(studio.stats()[Counter::shadow_vertices], projected[i]) << i;
    EXPECT_EQ(studio.stats()[Counter::triples_recomputed], 0) << "they only slide";
    Studio fresh(objects, camera());
    EXPECT_EQ(image, draw(fresh, true)) << i;
    Studio whole(objects, camera());
    EXPECT_EQ(image, draw(whole, false)) << i;
    EXPECT_GE(whole.stats()[Counter::shadow_vertices], all);
  }
}

// ---- large or spread-out shadows ----

TEST(MaskLayout, GroupsOverlappingShadows) {
  std::mt19937 random(7);
  const auto between = [&random](int low, int high) {
    return std::uniform_int_distribution<int>(low, high)(random);
  };
  constexpr int kSize = -22;  // 0.5 mm
  const Eigen::AlignedBox2d view(Eigen::Vector2d(-0.3, -0.2), Eigen::Vector2d(0.4, 0.5));
  int cut = 0;
  int apart = 0;
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<CellBox> bounds;
    for (int i = between(1, 8); i > 0; --i) {
      const Eigen::Vector<std::int64_t, 2> low(between(-900, 1100), between(-900, 1100));
      const int longest = between(0, 6) == 0 ? 6000 : 300;
      bounds.emplace_back(
          low, low + Eigen::Vector<std::int64_t, 2>(between(0, longest), between(0, longest)));
    }
    bounds.emplace_back();  // an object without a shadow
    const auto seen = [&](const Eigen::AlignedBox2d& box) {
      const Eigen::AlignedBox2d part = box.intersection(view);
      return part.isEmpty() ? VisiblePart{} : VisiblePart{part, kSize + trial % 3 - 1};
    };
    const MaskLayout layout = lay_out_masks(bounds, kSize, 4096, seen);
    EXPECT_EQ(layout, lay_out_masks(bounds, kSize, 4096, seen));
    std::vector<int> shown(bounds.size(), 0);
    double cells = 0.0;
    std::vector<Eigen::AlignedBox2d> rects;
    for (const MaskLayout::Group& group : layout.groups) {
      const MaskCells& of = group.cells;
      EXPECT_LE(std::max(of.width, of.height), 4096);
      cells += 1.0 * of.width * of.height;
      const Eigen::Vector2d low(static_cast<double>(of.u), static_cast<double>(of.v));
      const Eigen::AlignedBox2d rect(of.size * low,
                                     of.size * (low + Eigen::Vector2d(of.width, of.height)));
      for (const std::size_t i : group.parts) {
        ++shown[i];
        Eigen::AlignedBox2d needed(
            cell_size(kSize) * bounds[i].min().cast<double>(),
            cell_size(kSize) * (bounds[i].max().cast<double>() + Eigen::Vector2d::Ones()));
        if (group.cut) needed = needed.intersection(view);
        if (needed.isEmpty()) continue;
        // Tolerance for rounding.
        EXPECT_TRUE((rect.min().array() <= needed.min().array() + 1e-9).all());
        EXPECT_TRUE((rect.max().array() >= needed.max().array() - 1e-9).all());
      }
      for (const Eigen::AlignedBox2d& other : rects) {
        const Eigen::AlignedBox2d both = other.intersection(rect);
        EXPECT_TRUE(both.isEmpty() || both.sizes().minCoeff() < 1e-9);
      }
      rects.push_back(rect);
      if (group.cut) ++cut;
    }
    EXPECT_LE(cells, 8388608.0);
    for (std::size_t i = 0; i < bounds.size(); ++i) {
      EXPECT_LE(shown[i], 1);
      if (bounds[i].isEmpty()) {
        EXPECT_EQ(shown[i], 0);
        continue;
      }
      const Eigen::AlignedBox2d place(
          cell_size(kSize) * bounds[i].min().cast<double>(),
          cell_size(kSize) * (bounds[i].max().cast<double>() + Eigen::Vector2d::Ones()));
      if (!place.intersection(view).isEmpty()) {
        EXPECT_EQ(shown[i], 1) << trial;
      }
    }
    if (layout.groups.size() > 1) ++apart;
  }
  EXPECT_GT(cut, 50);
  EXPECT_GT(apart, 50);
}

TEST(MaskLayout, UsesOneMaskForModerateSize) {
  const std::vector<CellBox> bounds = {
      {Eigen::Vector<std::int64_t, 2>(-500, 3), Eigen::Vector<std::int64_t, 2>(-400, 20)},
      {Eigen::Vector<std::int64_t, 2>(300, -30), Eigen::Vector<std::int64_t, 2>(500, 7)}};
  const MaskLayout layout = lay_out_masks(bounds, -22, 4096, [](const Eigen::AlignedBox2d&) {
    ADD_FAILURE() << "not requested";
    return VisiblePart{};
  });
  ASSERT_EQ(layout.groups.size(), 1U);
  EXPECT_FALSE(layout.of_view || layout.groups[0].cut);
  EXPECT_EQ(layout.groups[0].parts, (std::vector<std::size_t>{0, 1}));
  EXPECT_EQ(layout.groups[0].cells, (MaskCells{cell_size(-22), -501, -31, 1003, 53}));
}

class LargeMask : public DrawnMask {
 protected:
  static CameraModel camera_of_height(int height, double times = 1.0) {
    CameraParameters p;
    p.width = static_cast<int>(height * times) * 16 / 9;
    p.height = static_cast<int>(height * times);
    p.fx = p.fy = height * 1000.0 / 720.0 * times;
    p.cx = (height * 8.0 / 9.0) * times - 0.5;
    p.cy = (height / 2.0) * times - 0.5;
    return CameraModel::make(p).value();
  }
  static std::shared_ptr<const Model> beam(double length) {
    test::ShapeBuilder shape;
    shape.box(-length / 2, -0.01, -0.01, length / 2, 0.01, 0.01);
    return test::finished(shape.build(), glm::vec4(0.5F));
  }
  static std::shared_ptr<const Scene> two_rings() {
    return scene({{torus(), test::at(-0.22, 0.02, 0.08, {1, 0.2, 0}, 0.3)},
                  {torus(), test::at(0.22, -0.02, 0.08, {1, 0.2, 0}, 0.4)}});
  }
  static std::shared_ptr<const Scene> four_rings() {
    return scene({{torus(), test::at(-0.24, 0.1, 0.08, {1, 0.2, 0}, 0.3)},
                  {torus(), test::at(0.24, -0.1, 0.08, {1, 0.2, 0}, 0.4)},
                  {torus(), test::at(0.0, -0.12, 0.05, {1, 0.2, 0}, 0.2)},
                  {torus(), test::at(0.0, 0.1, 0.1)}});
  }
  // The beam is slanted, so that a mask of its whole shadow would have millions of cells.
  static std::shared_ptr<const Scene> long_beam() {
    return scene({{beam(2.0), test::at(0.0, 0.0, 0.06, {0, 0, 1}, 0.35)},
                  {torus(), test::at(0.1, -0.1, 0.05, {1, 0.2, 0}, 0.2)}});
  }
  static PoseEstimate seen_from(const Eigen::Vector3d& eye, const Eigen::Vector3d& target) {
    return test::tracked(test::look_at(eye, target));
  }
  static RenderedImage drawn(Studio& studio, const PoseEstimate& from, const PlanOptions& options) {
    return studio.draw_shadows(
        test::plain_frame(studio.camera().width(), studio.camera().height(), 255),
        studio.plan(from, options));
  }
};

TEST_F(LargeMask, SmoothsEdgesOnly) {
  const PoseEstimate from_above = seen_from({0.05, -0.38, 0.36}, {0.0, 0.0, 0.0});
  // The beam extends behind the camera.
  const PoseEstimate close = seen_from({0.1, -0.1, 0.15}, {0.0, 0.05, 0.0});
  const struct {
    const char* what;
    std::shared_ptr<const Scene> of;
    int height;
    PoseEstimate from;
  } cases[] = {
      {"two rings, 720", two_rings(), 720, from_above},
      {"four rings, 720", four_rings(), 720, from_above},
      {"four rings, 1080", four_rings(), 1080, from_above},
      {"a beam, 720", long_beam(), 720, from_above},
      {"a beam, 1080", long_beam(), 1080, from_above},
      {"a beam from near, 720", long_beam(), 720, close},
  };
  for (const auto& c : cases) {
    if (c.height > 720 && !test::nightly()) continue;
    SCOPED_TRACE(c.what);
    Studio coarse(c.of, camera_of_height(c.height));
    Studio fine(c.of, camera_of_height(c.height, 4.0));
    const RenderedImage mask = drawn(coarse, c.from, by(LayerDrawing::mask));
    const EdgeError error = edge_error(mask, drawn(fine, c.from, by(LayerDrawing::direct)), 4);
    EXPECT_GE(coarse.stats()[Counter::layer_masks_drawn], 1);
    std::printf("%s: edge error %.2f grey levels RMS over %d pixels, elsewhere at most %d\n",
                c.what, error.rms, error.edges, error.largest_elsewhere);
    EXPECT_GT(error.edges, 1500);
    EXPECT_LE(error.rms, 6.0);
    EXPECT_LE(error.largest_elsewhere, 1);
    PlanOptions all = by(LayerDrawing::mask);
    all.skip = false;
    EXPECT_EQ(mask, drawn(coarse, c.from, all));
  }
}

// The frame must not depend on earlier frames. The nightly form draws every frame in every
// translucency mode; the short form draws each frame in one mode.
TEST_F(LargeMask, DependsOnlyOnCurrentFrame) {
  const std::vector<PoseEstimate> path = {seen_from({0.05, -0.38, 0.36}, {0.0, 0.0, 0.0}),
                                          seen_from({0.06, -0.37, 0.36}, {0.0, 0.02, 0}),
                                          seen_from({0.15, -0.3, 0.3}, {0.1, 0.02, 0.0}),
                                          seen_from({0.1, -0.1, 0.15}, {0.0, 0.05, 0}),
                                          seen_from({0.05, -0.38, 0.36}, {0.0, 0.0, 0.0}),
                                          seen_from({0.8, -0.4, 0.4}, {0.6, 0.3, 0.0}),
                                          seen_from({0.4, -0.9, 0.15}, {0.0, 0.3, 0.0})};
  for (const auto& of : {long_beam(), four_rings()}) {
    const CameraModel by_camera = camera_of_height(720);
    Studio studio(of, by_camera);
    Studio whole(of, by_camera);
    for (std::size_t i = 0; i < path.size(); ++i) {
      constexpr std::array kModes = {Translucency::blend, Translucency::retexture,
                                     Translucency::mesh};
      for (std::size_t k = 0; k < kModes.size(); ++k) {
        if (k != i % kModes.size() && !test::nightly()) continue;
        const Translucency mode = kModes[k];
        SCOPED_TRACE(std::to_string(i) + " " + std::string(to_string(mode)));
        PlanOptions options = by(LayerDrawing::mask, mode);
        const RenderedImage image = drawn(studio, path[i], options);
        Studio fresh(of, by_camera);
        EXPECT_EQ(image, drawn(fresh, path[i], options));
        options.skip = false;
        EXPECT_EQ(image, drawn(whole, path[i], options));
      }
    }
  }
}

TEST_F(LargeMask, IsReusedForSmallCameraMotion) {
  for (const auto& of : {long_beam(), four_rings()}) {
    Studio studio(of, camera_of_height(720));
    static_cast<void>(
        drawn(studio, seen_from({0.05, -0.38, 0.36}, {0, 0, 0}), by(LayerDrawing::mask)));
    const std::int64_t masks = studio.stats()[Counter::layer_masks_drawn];
    EXPECT_GE(masks, 1);
    std::int64_t again = 0;
    constexpr int kSteps = 30;
    for (int i = 0; i < kSteps; ++i) {  // one second of slow hand motion, 6 cm
      static_cast<void>(
          drawn(studio, seen_from({0.05 + 0.001 * i, -0.38 + 0.0015 * i, 0.36}, {0.0005 * i, 0, 0}),
                by(LayerDrawing::mask)));
      again += studio.stats()[Counter::layer_masks_drawn];
      EXPECT_EQ(
          studio.stats()[Counter::layer_masks_drawn] + studio.stats()[Counter::layer_masks_kept],
          masks);
    }
    EXPECT_LT(again, kSteps * masks / 4);
  }
}

TEST_F(LargeMask, RedrawsOnlyGroupOfMovingCaster) {
  const auto objects = four_rings();
  Studio studio(objects, camera_of_height(720));
  const PoseEstimate from = seen_from({0.05, -0.38, 0.36}, {0.0, 0.0, 0.0});
  SceneState state = evaluate_scene(*objects, 0.0);
  const Frame frame = test::plain_frame(studio.camera().width(), studio.camera().height(), 255);
  const auto draw = [&](Studio& by_studio) {
    return by_studio.draw_shadows(
        frame, plan_frame(*objects, state, from, by_studio.camera(), by(LayerDrawing::mask)));
  };
  static_cast<void>(draw(studio));
  const std::int64_t masks = studio.stats()[Counter::layer_masks_drawn];
  EXPECT_EQ(masks, 4);
  for (int i = 0; i < 4; ++i) {
    state.objects[3].position.y() += 0.0037;
    const RenderedImage image = draw(studio);
    EXPECT_EQ(studio.stats()[Counter::layer_masks_drawn], 1);
    EXPECT_EQ(studio.stats()[Counter::layer_masks_kept], 3);
    Studio fresh(objects, studio.camera());
    EXPECT_EQ(image, draw(fresh));
  }
}

}  // namespace
}  // namespace penumbra::silhouette_mask_test
