// The hard shadow of a point or parallel light, compared with the examples of Blinn's paper
// (README.md) and an exact oracle.
#include "render/shadow/projected/projected_shadow.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "render/shadow/layers/layer_polygons.hpp"
#include "support/shadow_cases.hpp"

namespace penumbra {
namespace {

const Eigen::Vector4d kTable(0.0, 0.0, 1.0, 0.0);

// Blinn's formulas. A plane is the covector (n, -n.q); its product with a point or light is a
// signed height.

// Returns M = (L.G) I - G L for row vectors; P' = P M.
Eigen::Matrix4d shadow_matrix(const Eigen::Vector4d& light, const Eigen::Vector4d& plane) {
  return light.dot(plane) * Eigen::Matrix4d::Identity() - plane * light.transpose();
}

// Returns P M, whose w is > 0 if the light projects the point onto the plane.
Eigen::Vector4d project_from_light(const Eigen::Vector4d& light, const Eigen::Vector4d& plane,
                                   const Eigen::Vector3d& point) {
  return (point.homogeneous().transpose() * shadow_matrix(light, plane)).transpose();
}

enum class ShadowOfPoint {
  shadow,             // on the plane, or between plane and light
  at_or_above_light,  // antishadow, or no shadow
  below_plane,        // false shadow: the plane separates the point from the light
};
// Requires a light above the plane.
ShadowOfPoint classify_shadow(const Eigen::Vector4d& light, const Eigen::Vector4d& plane,
                              const Eigen::Vector3d& point) {
  const double d_light = plane.dot(light);
  const double d_point = plane.dot(point.homogeneous());
  // w = d_L w_P - d_P w_L. Points at or above the light are rejected first, because w is also
  // positive below the plane.
  if (d_light - d_point * light.w() <= 0.0) return ShadowOfPoint::at_or_above_light;
  return d_point < 0.0 ? ShadowOfPoint::below_plane : ShadowOfPoint::shadow;
}

// Sudarsky's heuristic that replaces clipping. A vertex at or above a local light is
// replaced by the point Q + c (P_j - Q) on its edge to a neighbour P_j below the light, where Q is
// the intersection of that edge with the level plane through the light. P_j is the first such
// neighbour in `indices`. A vertex without such a neighbour is dropped with its faces.
std::vector<PlanePoint> projected_triangles_as_printed(std::span<const CasterVertex> vertices,
                                                       std::span<const std::uint32_t> indices,
                                                       const Eigen::Vector4d& light,
                                                       const PlaneFrame& plane, double c) {
  const double top =
      light.w() != 0.0 ? light_height(plane, light) : std::numeric_limits<double>::infinity();
  const auto below_light = [&](std::uint32_t i) {
    return static_cast<double>(vertices[i].h) < top;
  };
  std::vector<CasterVertex> replaced(vertices.begin(), vertices.end());
  std::vector<bool> usable(vertices.size());
  for (std::uint32_t i = 0; i < vertices.size(); ++i) usable[i] = below_light(i);
  for (std::size_t face = 0; face + 2 < indices.size(); face += 3) {
    for (std::size_t from = 0; from < 3; ++from) {
      const std::uint32_t i = indices[face + from];
      for (const std::size_t step : {1U, 2U}) {
        const std::uint32_t j = indices[face + (from + step) % 3];
        if (usable[i] || !below_light(j)) continue;
        const CasterVertex& vertex = vertices[i];
        const CasterVertex& neighbour = vertices[j];
        // The replacement lies beyond Q by the fraction c of the distance from Q to the neighbour.
        const double to_q = (static_cast<double>(vertex.h) - top) /
                            (static_cast<double>(vertex.h) - static_cast<double>(neighbour.h));
        const auto t = static_cast<float>(to_q + c * (1.0 - to_q));
        replaced[i] = {vertex.u + t * (neighbour.u - vertex.u),
                       vertex.v + t * (neighbour.v - vertex.v),
                       vertex.h + t * (neighbour.h - vertex.h), 0.0F, 0.0F};
        usable[i] = true;
      }
    }
  }
  std::vector<std::uint32_t> kept;
  for (std::size_t face = 0; face + 2 < indices.size(); face += 3) {
    const auto corners = indices.subspan(face, 3);
    if (std::ranges::all_of(corners, [&](std::uint32_t i) { return usable[i]; })) {
      kept.insert(kept.end(), corners.begin(), corners.end());
    }
  }
  return projected_triangles(replaced, kept, light, plane);
}

// A cube of edge 1 with its centre at a given height; each side is two triangles.
struct Cube {
  std::vector<CasterVertex> vertices;
  std::vector<std::uint32_t> indices = {0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4,
                                        1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7};
  explicit Cube(float middle) {
    for (const float z : {-0.5F, 0.5F}) {
      for (const auto& [x, y] : {std::pair{-0.5F, -0.5F}, std::pair{0.5F, -0.5F},
                                 std::pair{0.5F, 0.5F}, std::pair{-0.5F, 0.5F}}) {
        vertices.push_back({x, y, middle + z, x, y});
      }
    }
  }
};

double shadow_area(const Cube& cube, const Eigen::Vector4d& light) {
  const auto outline =
      union_of_triangles(projected_triangles(cube.vertices, cube.indices, light, PlaneFrame{}));
  return outline ? outline->area : -1.0;
}

TEST(ProjectedShadow, MatchesPrintedExamples) {
  const Eigen::Vector3d p(1.0, 1.0, 2.0);
  const Eigen::Vector4d antishadow = project_from_light({2.25, 0.0, 1.0, 1.0}, kTable, p);
  EXPECT_EQ(antishadow.w(), -1.0);
  EXPECT_LT((antishadow.hnormalized() - Eigen::Vector3d(3.5, -1.0, 0.0)).norm(), 1e-12);
  EXPECT_EQ(classify_shadow({2.25, 0.0, 1.0, 1.0}, kTable, p), ShadowOfPoint::at_or_above_light);
  const Eigen::Vector4d local = project_from_light({2.25, -5.0, 5.0, 1.0}, kTable, p);
  EXPECT_EQ(local.w(), 3.0);
  EXPECT_LT((local.hnormalized() - Eigen::Vector3d(1.0 / 6.0, 5.0, 0.0)).norm(), 1e-12);
  const Eigen::Vector4d parallel = project_from_light({1.45, -0.8, 2.0, 0.0}, kTable, p);
  EXPECT_LT((parallel.hnormalized() - Eigen::Vector3d(-0.45, 1.8, 0.0)).norm(), 1e-12);
}

// Blinn's matrices for z = 0 and row vectors. Two misprints are corrected: x_L and y_L belong to
// the third row, and S = P M.
TEST(ProjectedShadow, MatchesPrintedMatrices) {
  const auto blinn = [](const Eigen::Vector4d& light) {
    Eigen::Matrix4d m;
    m << light.z(), 0.0, 0.0, 0.0,                //
        0.0, light.z(), 0.0, 0.0,                 //
        -light.x(), -light.y(), 0.0, -light.w(),  //
        0.0, 0.0, 0.0, light.z();
    return m;
  };
  for (const Eigen::Vector4d& light :
       {Eigen::Vector4d(2.25, 0.0, 1.0, 1.0), Eigen::Vector4d(2.25, -5.0, 5.0, 1.0),
        Eigen::Vector4d(1.45, -0.8, 2.0, 0.0)}) {
    EXPECT_EQ(shadow_matrix(light, kTable), blinn(light));
  }
  // The parallel light's matrix divided by z_L is the shear.
  Eigen::Matrix4d shear;
  shear << 1.0, 0.0, 0.0, 0.0,           //
      0.0, 1.0, 0.0, 0.0,                //
      -1.45 / 2.0, 0.8 / 2.0, 0.0, 0.0,  //
      0.0, 0.0, 0.0, 1.0;
  EXPECT_LT((shadow_matrix({1.45, -0.8, 2.0, 0.0}, kTable) / 2.0 - shear).norm(), 1e-15);
  // The printed alpha, -z_P / (z_P - z_L), has the wrong sign: the point would not lie on the
  // plane.
  const Eigen::Vector3d p(1.0, 1.0, 2.0);
  const Eigen::Vector3d l(2.25, 0.0, 1.0);
  const double alpha = p.z() / (p.z() - l.z());
  EXPECT_LT((p - alpha * (p - l) - Eigen::Vector3d(3.5, -1.0, 0.0)).norm(), 1e-12);
  EXPECT_LT((p + alpha * (p - l) - Eigen::Vector3d(-1.5, 3.0, 4.0)).norm(), 1e-12);
  // The printed antishadow matrix has z_L in place of x_L, which sends the point elsewhere.
  Eigen::Matrix4d printed = -blinn({2.25, 0.0, 1.0, 1.0});
  printed(2, 0) = l.z();
  const Eigen::Vector4d wrong = (p.homogeneous().transpose() * printed).transpose();
  EXPECT_LT((wrong.hnormalized() - Eigen::Vector3d(1.0, -1.0, 0.0)).norm(), 1e-12);
}

// The commands of figure 3 (TRAN, ROT, SCAL, PERS, ROT, TRAN and a flattening) give the same matrix
// up to the factor sin 45 degrees.
TEST(ProjectedShadow, MatchesPrintedCommandList) {
  const Eigen::Vector3d light(2.25, -5.0, 5.0);
  const auto move = [](const Eigen::Vector3d& offset) {
    Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
    m.block<1, 3>(3, 0) = offset.transpose();
    return m;
  };
  const auto scale = [](double x, double y, double z) {
    return Eigen::Matrix4d(Eigen::Vector4d(x, y, z, 1.0).asDiagonal());
  };
  const Eigen::Matrix4d half_turn = Eigen::Vector4d(-1.0, 1.0, -1.0, 1.0).asDiagonal();
  const double s = std::sqrt(0.5);
  const double near = 1.0;
  const double far = 100000.0;
  const double q = s / (1.0 - near / far);
  Eigen::Matrix4d perspective;
  perspective << s, 0, 0, 0, 0, s, 0, 0, 0, 0, q, s, 0, 0, -q * near, 0;
  // The command printed last is applied to the point first.
  const Eigen::Matrix4d product = move(-light) * half_turn * perspective *
                                  scale(light.z(), light.z(), 1.0) * half_turn * move(light) *
                                  scale(1.0, 1.0, 0.0);
  const Eigen::Matrix4d expected = shadow_matrix({light.x(), light.y(), light.z(), 1.0}, kTable);
  EXPECT_LT((product / s - expected).norm(), 1e-9 * expected.norm());
}

TEST(ProjectedShadow, CastsOnlyBetweenPlaneAndLight) {
  const Eigen::Vector4d light(0.3, 0.2, 3.0, 1.0);
  EXPECT_EQ(shadow_area(Cube(-2.0F), light), 0.0) << "cube below the plane";
  EXPECT_NEAR(shadow_area(Cube(-0.4F), {0.0, 0.0, 3.0, 1.0}), std::pow(3.0 / 2.9, 2), 1e-5);
  EXPECT_EQ(shadow_area(Cube(4.0F), light), 0.0) << "cube above the light";
  EXPECT_EQ(shadow_area(Cube(1.0F), {0.0, 0.0, 0.0, 1.0}), 0.0) << "light in the plane";
  EXPECT_EQ(shadow_area(Cube(1.0F), {0.0, 0.0, -1.0, 0.0}), 0.0) << "light under the horizon";
  EXPECT_NEAR(shadow_area(Cube(1.0F), {0.0, 0.0, 2.0, 0.0}), 1.0, 1e-6);
}

// Half of the cube is above the light. Clipping yields two points on a crossing face's edges; the
// heuristic yields one, for any order of neighbours.
TEST(ProjectedShadow, DiffersFromPrintedHeuristic) {
  struct Mesh {
    std::vector<CasterVertex> vertices;
    std::vector<std::uint32_t> indices;
  };
  // Each side of the cube consists of cells x cells squares.
  const auto cube = [](int cells) {
    Mesh mesh;
    const auto point = [&](float x, float y, float z) {
      for (std::uint32_t i = 0; i < mesh.vertices.size(); ++i) {
        const CasterVertex& v = mesh.vertices[i];
        if (std::abs(v.u - x) + std::abs(v.v - y) + std::abs(v.h - z) < 1e-4F) return i;
      }
      mesh.vertices.push_back({x, y, z, 0.0F, 0.0F});
      return static_cast<std::uint32_t>(mesh.vertices.size() - 1);
    };
    const auto side = [&](int axis, float at) {
      for (int i = 0; i < cells; ++i) {
        for (int j = 0; j < cells; ++j) {
          std::array<std::uint32_t, 4> corner{};
          for (std::size_t k = 0; k < 4; ++k) {
            std::array<float, 3> p{};
            const auto cell = [&](int n) {
              return static_cast<float>(n) / static_cast<float>(cells) - 0.5F;
            };
            p[static_cast<std::size_t>(axis)] = at;
            p[static_cast<std::size_t>(axis + 1) % 3] = cell(i + (k == 1 || k == 2 ? 1 : 0));
            p[static_cast<std::size_t>(axis + 2) % 3] = cell(j + (k >= 2 ? 1 : 0));
            corner[k] = point(1.6F + p[0], 0.2F + p[1], 2.1F + p[2]);
          }
          for (const std::size_t k : {0U, 1U, 2U, 0U, 2U, 3U}) mesh.indices.push_back(corner[k]);
        }
      }
    };
    for (int axis = 0; axis < 3; ++axis) {
      for (const float at : {-0.5F, 0.5F}) side(axis, at);
    }
    return mesh;
  };
  const Eigen::Vector4d light(0.0, 0.0, 2.1, 1.0);
  constexpr int kPixels = 600;  // per side of a receiver of 12 m
  const auto mask_of = [](const std::vector<PlanePoint>& triangles) {
    test::Mask mask({-6.0, -6.0}, 12.0 / kPixels, kPixels);
    mask.cover(triangles);
    return mask.bits;
  };
  const auto similarity = [&](Mesh mesh, std::size_t first_face, double c) {
    const auto exact = mask_of(projected_triangles(mesh.vertices, mesh.indices, light, {}));
    std::rotate(mesh.indices.begin(),
                mesh.indices.begin() + static_cast<std::ptrdiff_t>(3 * first_face),
                mesh.indices.end());
    const auto printed =
        mask_of(projected_triangles_as_printed(mesh.vertices, mesh.indices, light, {}, c));
    return test::iou(exact, printed);
  };
  const Mesh coarse = cube(1);
  for (const double c : {0.02, 0.1, 0.3}) {
    double worst = 1.0;
    double best = 0.0;
    for (std::size_t face = 0; face < 12; ++face) {
      const double iou = similarity(coarse, face, c);
      worst = std::min(worst, iou);
      best = std::max(best, iou);
    }
    EXPECT_LT(worst, 0.95) << "c = " << c << ": must differ from clipping";
    EXPECT_GT(worst, 0.5) << c;
    EXPECT_GT(best, worst + 0.01) << "c = " << c << ": the order of faces should matter";
  }
  EXPECT_GT(similarity(cube(6), 0, 0.02), 0.99) << "small faces hide the difference";
  // If all vertices are below the light, both methods agree exactly.
  Mesh low = coarse;
  for (CasterVertex& vertex : low.vertices) vertex.h -= 1.0F;
  EXPECT_EQ(similarity(low, 0, 0.1), 1.0);
}

TEST(ProjectedShadow, MatchesReferencePoints) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto json = test::read_json(test::shared_dir() / "vectors" / "projection_points.json");
  std::size_t count = 0;
  for (const char* list : {"examples", "points"}) {
    for (const auto& entry : json.at(list)) {
      const auto vector_of = [&entry](const char* key) {
        const auto v = entry.at(key).get<std::vector<double>>();
        return Eigen::Vector4d(v.at(0), v.at(1), v.at(2), v.at(3));
      };
      const Eigen::Vector4d light = vector_of("light");
      const Eigen::Vector4d plane = vector_of("plane");
      const Eigen::Vector3d point = test::vector_from(entry.at("point"));
      const Eigen::Vector4d s = project_from_light(light, plane, point);
      EXPECT_LT((s - vector_of("homogeneous")).norm(), 1e-8);
      EXPECT_NEAR(s.w(), entry.at("w").get<double>(), 1e-8);
      const auto rows = entry.at("matrix_row_vector").get<std::vector<double>>();
      const Eigen::Matrix4d matrix = shadow_matrix(light, plane);
      for (std::size_t i = 0; i < 16; ++i) {
        EXPECT_NEAR(matrix(static_cast<Eigen::Index>(i / 4), static_cast<Eigen::Index>(i % 4)),
                    rows.at(i), 1e-8);
      }
      // The renderer's projection works in plane coordinates and must give the same point.
      const bool throws_shadow = entry.at("classification") == "shadow";
      const Eigen::Vector3d n = plane.head<3>();
      const PlaneFrame frame = PlaneFrame::make(n, -plane.w() / n.squaredNorm() * n);
      const Eigen::Vector3d on_plane = frame.to_plane(point);
      const HeightRange range = hard_shadow_range(frame, light);
      if (throws_shadow && on_plane.z() <= range.high) {
        const Eigen::Vector2d thrown = shadow_point(frame, light, on_plane);
        const Eigen::Vector3d lifted = frame.lift(thrown.x(), thrown.y());
        EXPECT_LT((lifted - s.hnormalized()).norm(), 1e-8 * (1.0 + lifted.norm()));
      } else if (!throws_shadow) {
        EXPECT_TRUE(on_plane.z() < range.low || on_plane.z() > range.high);
      }
      const ShadowOfPoint kind = classify_shadow(light, plane, point);
      const std::string expected = entry.at("classification").get<std::string>();
      EXPECT_EQ(kind, expected == "shadow"        ? ShadowOfPoint::shadow
                      : expected == "below_plane" ? ShadowOfPoint::below_plane
                                                  : ShadowOfPoint::at_or_above_light)
          << expected;
      ++count;
    }
  }
  EXPECT_GT(count, 20U);
}

TEST(ProjectedShadow, MatchesReferenceCubes) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto json = test::read_json(test::shared_dir() / "vectors" / "projective_clip.json");
  for (const auto& entry : json.at("cases")) {
    const auto xyz = entry.at("vertices").get<std::vector<float>>();
    std::vector<CasterVertex> vertices;
    for (std::size_t i = 0; i + 2 < xyz.size(); i += 3) {
      vertices.push_back({xyz[i], xyz[i + 1], xyz[i + 2], 0.0F, 0.0F});
    }
    const Eigen::Vector3d light = test::vector_from(entry.at("light"));
    const auto triangles =
        projected_triangles(vertices, entry.at("triangles").get<std::vector<std::uint32_t>>(),
                            {light.x(), light.y(), light.z(), 1.0}, PlaneFrame{});
    const auto receiver = entry.at("receiver").get<std::vector<double>>();
    const double extent = receiver[2] - receiver[0];
    constexpr int kPixels = 2048;
    test::Mask ours({receiver[0], receiver[1]}, extent / kPixels, kPixels);
    test::Mask theirs = ours;
    ours.cover(triangles);
    for (const auto& polygon : entry.at("polygons")) {
      std::vector<std::vector<Eigen::Vector2d>> rings;
      const auto add = [&](const nlohmann::json& ring) {
        auto& points = rings.emplace_back();
        for (const auto& p : ring) {
          points.push_back(
              (Eigen::Vector2d(p.at(0).get<double>(), p.at(1).get<double>()) - ours.origin) /
              ours.pixel);
        }
      };
      add(polygon.at("outer"));
      for (const auto& hole : polygon.at("holes")) add(hole);
      theirs.cover_rings(rings);
    }
    EXPECT_GE(test::iou(ours.bits, theirs.bits), entry.at("iou_min").get<double>());
  }
}

}  // namespace
}  // namespace penumbra
