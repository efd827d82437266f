// Layers of given meshes and kernels, compared with an independent oracle in double precision.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "support/shadow_cases.hpp"

namespace penumbra {
namespace {

std::filesystem::path vectors_dir() {
  return test::shared_dir().empty() ? std::filesystem::path() : test::shared_dir() / "vectors";
}

// Mesh and kernels exactly as in the vectors, without welding.
struct GivenCaster {
  ShadowMesh mesh;
  ShadowKernels kernels;

  GivenCaster(const std::string& mesh_file, const std::string& kernel_set) {
    const nlohmann::json json = test::read_json(vectors_dir() / mesh_file);
    mesh.positions = points(json.at("vertices"));
    mesh.indices = json.at("triangles").get<std::vector<std::uint32_t>>();
    mesh.part.assign(mesh.positions.size(), 0);
    mesh.part_count = 1;
    kernels.kernels = points(json.at("kernels").at(kernel_set));
  }
  static std::vector<glm::vec3> points(const nlohmann::json& flat) {
    const auto xyz = flat.get<std::vector<float>>();
    std::vector<glm::vec3> result;
    for (std::size_t i = 0; i + 2 < xyz.size(); i += 3)
      result.emplace_back(xyz[i], xyz[i + 1], xyz[i + 2]);
    return result;
  }
};

std::vector<test::Ring> all_rings(const LayerOutline& outline) {
  std::vector<test::Ring> rings;
  for (const LayerPolygon& polygon : outline.polygons) {
    rings.push_back(polygon.outer);
    rings.insert(rings.end(), polygon.holes.begin(), polygon.holes.end());
  }
  return rings;
}

// Returns the signed area of a ring; adds its first moment to `moment`.
double ring_moment(const test::Ring& ring, Eigen::Vector2d& moment) {
  double area = 0.0;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const Eigen::Vector2d& a = ring[i];
    const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
    const double cross = a.x() * b.y() - a.y() * b.x();
    area += 0.5 * cross;
    moment += (a + b) * cross / 6.0;
  }
  return area;
}

// Tests if a point lies on an edge that two triangles share exactly, one on each side. Such a point
// is inside their union, independent of rounding.
bool on_seam(const Eigen::Vector2d& p, const std::vector<PlanePoint>& triangles) {
  constexpr double kNear = 1e-8;  // [m]; layers are float, and samples have ten digits
  const auto in_double = [&](std::size_t i) {
    return Eigen::Vector2d(static_cast<double>(triangles[i].u),
                           static_cast<double>(triangles[i].v));
  };
  struct Seam {
    Eigen::Vector2d from, to;
    bool left = false, right = false;
  };
  std::vector<Seam> seams;
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      Eigen::Vector2d a = in_double(i + corner);
      Eigen::Vector2d b = in_double(i + (corner + 1) % 3);
      if (b.x() < a.x() || (b.x() == a.x() && b.y() < a.y())) std::swap(a, b);
      const Eigen::Vector2d d = b - a;
      const double along = (p - a).dot(d) / d.squaredNorm();
      if (!(along > 1e-3 && along < 1.0 - 1e-3)) continue;
      if (test::distance_to_segment(p, a, b) > kNear) continue;
      const Eigen::Vector2d c = in_double(i + (corner + 2) % 3) - a;
      const double height = (d.x() * c.y() - d.y() * c.x()) / d.norm();
      auto seam = std::find_if(seams.begin(), seams.end(),
                               [&](const Seam& other) { return other.from == a && other.to == b; });
      if (seam == seams.end()) seam = seams.insert(seam, Seam{a, b});
      seam->left = seam->left || height > kNear;
      seam->right = seam->right || height < -kNear;
    }
  }
  return std::any_of(seams.begin(), seams.end(),
                     [](const Seam& seam) { return seam.left && seam.right; });
}

void expect_layer(const nlohmann::json& expected, const nlohmann::json& tolerance,
                  const std::vector<PlanePoint>& triangles, const std::string& what) {
  SCOPED_TRACE(what);
  const auto outline = union_of_triangles(triangles);
  ASSERT_TRUE(outline) << outline.error().message;
  const double area = expected.at("area").get<double>();
  EXPECT_NEAR(outline->area, area, tolerance.at("area_rel").get<double>() * area + 1e-12);
  if (area == 0.0) return;
  const auto rings = all_rings(*outline);
  const double boundary = tolerance.at("boundary_m").get<double>();

  const auto bounds = expected.at("bounds").get<std::vector<double>>();
  Eigen::Vector2d low = rings.at(0).at(0);
  Eigen::Vector2d high = low;
  Eigen::Vector2d moment = Eigen::Vector2d::Zero();
  double signed_area = 0.0;
  for (const auto& ring : rings) {
    for (const auto& p : ring) {
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    signed_area += ring_moment(ring, moment);
  }
  EXPECT_NEAR(signed_area, outline->area, 1e-9 * area) << "outer rings turn left, holes right";
  EXPECT_LT((low - Eigen::Vector2d(bounds[0], bounds[1])).norm(), boundary);
  EXPECT_LT((high - Eigen::Vector2d(bounds[2], bounds[3])).norm(), boundary);
  EXPECT_LT((moment / signed_area - test::point_from(expected.at("centroid"))).norm(),
            5.0 * boundary);

  // Compares masks of the triangles and of the oracle's polygons, 1024 pixels wide.
  const double extent = 1.02 * (high - low).maxCoeff();
  const Eigen::Vector2d corner = 0.5 * (low + high) - Eigen::Vector2d::Constant(0.5 * extent);
  test::Mask ours(corner, extent / 1024.0, 1024);
  ours.cover(triangles);
  test::Mask theirs(corner, extent / 1024.0, 1024);
  test::Mask polygons(corner, extent / 1024.0, 1024);
  theirs.cover(test::rings_from(expected.at("polygons")));
  polygons.cover(rings);

  // Rounding leaves zero-width slits in the oracle's union, between faces that share an edge.
  // Samples on such slits, which lie up to 50 mm inside the layer, are skipped.
  for (const auto& sample : expected.at("boundary_samples")) {
    const Eigen::Vector2d p = test::point_from(sample);
    const double distance = test::distance_to_rings(p, rings);
    if (distance > boundary && on_seam(p, triangles)) continue;
    EXPECT_LE(distance, boundary) << p.transpose();
  }
  const double iou_min = tolerance.at("iou_min").get<double>();
  EXPECT_GE(test::iou(ours.bits, theirs.bits), iou_min);
  EXPECT_GE(test::iou(polygons.bits, theirs.bits), iou_min);
}

TEST(ShadowVectors, MatchLayerCases) {
  if (vectors_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const nlohmann::json index = test::read_json(vectors_dir() / "index.json");
  std::size_t cases = 0;
  for (const auto& entry : index.at("cases")) {
    const std::string id = entry.at("id").get<std::string>();
    SCOPED_TRACE(id);
    const nlohmann::json json = test::read_json(vectors_dir() / (id + ".json"));
    const GivenCaster caster(json.at("mesh").get<std::string>(),
                             json.at("kernel_set").get<std::string>());
    const LayeredConstants constants = test::constants_from(json.at("constants"));
    EXPECT_NEAR(constants.umbra_height, json.at("constants").at("h_umbra").get<double>(), 1e-9);
    const auto& plane_json = json.at("plane");
    const PlaneFrame plane = PlaneFrame::make(test::vector_from(plane_json.at("normal")),
                                              test::vector_from(plane_json.at("point")));
    EXPECT_LT((plane.e1 - test::vector_from(plane_json.at("e1"))).norm(), 1e-8);
    EXPECT_LT((plane.e2 - test::vector_from(plane_json.at("e2"))).norm(), 1e-8);
    const auto& pose = json.at("object_to_world");
    const Placement placement = {test::vector_from(pose.at("translation")),
                                 Eigen::Quaterniond(test::matrix_from(pose.at("rotation"))), 1.0};
    const auto vertices = place_caster(caster.mesh, caster.kernels, placement, plane);

    for (const auto& sample : json.at("vertex_samples")) {
      const CasterVertex& vertex = vertices.at(sample.at("vertex").get<std::size_t>());
      const Eigen::Vector3d uvh = test::vector_from(sample.at("uvh"));
      EXPECT_NEAR(vertex.u, uvh.x(), 1e-7);
      EXPECT_NEAR(vertex.v, uvh.y(), 1e-7);
      EXPECT_NEAR(vertex.h, uvh.z(), 1e-7);
      const Eigen::Vector2d k = test::point_from(sample.at("kernel_uv"));
      EXPECT_NEAR(vertex.ku, k.x(), 1e-7);
      EXPECT_NEAR(vertex.kv, k.y(), 1e-7);
      for (const auto& [layer, key] :
           {std::pair{ShadowLayer::umbra, "umbra"}, std::pair{ShadowLayer::middle, "middle"},
            std::pair{ShadowLayer::penumbra, "penumbra"}}) {
        const HeightRange range = layer_height_range(constants, layer);
        if (sample.at(key).is_null()) {
          EXPECT_TRUE(uvh.z() < range.low + 1e-9 || uvh.z() > range.high - 1e-9) << key;
          continue;
        }
        const PlanePoint point = project_to_layer(vertex, constants, layer);
        EXPECT_LT((Eigen::Vector2d(point.u, point.v) - test::point_from(sample.at(key))).norm(),
                  2e-7)
            << key;
      }
    }
    const auto& expected = json.at("expected");
    const auto& tolerance = json.at("tolerance");
    expect_layer(expected.at("umbra"), tolerance,
                 layer_triangles(vertices, caster.mesh.indices, constants, ShadowLayer::umbra),
                 "umbra");
    expect_layer(expected.at("middle"), tolerance,
                 layer_triangles(vertices, caster.mesh.indices, constants, ShadowLayer::middle),
                 "middle");
    expect_layer(expected.at("penumbra"), tolerance,
                 layer_triangles(vertices, caster.mesh.indices, constants, ShadowLayer::penumbra),
                 "penumbra");
    expect_layer(expected.at("orthogonal"), tolerance,
                 orthogonal_triangles(vertices, caster.mesh.indices), "orthogonal");
    ++cases;
  }
  EXPECT_GT(cases, 0U);
}

TEST(ShadowVectors, MatchFactorsWithinFloatBound) {
  if (vectors_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const nlohmann::json json = test::read_json(vectors_dir() / "factors.json");
  ASSERT_GT(json.at("cases").size(), 0U);
  for (const auto& entry : json.at("cases")) {
    const double H = entry.at("H").get<double>();
    const double a = entry.at("a").get<double>();
    const double h = entry.at("h").get<double>();
    const LayeredConstants constants = make_layered_constants(H, a, 0.0).value();
    const bool visible = entry.at("umbra_visible").get<bool>();
    EXPECT_EQ(layer_factor_f(constants, ShadowLayer::umbra, static_cast<float>(h)) > 0.0F, visible);
    for (const auto& [layer, key] :
         {std::pair{ShadowLayer::umbra, "umbra"}, std::pair{ShadowLayer::middle, "middle"},
          std::pair{ShadowLayer::penumbra, "penumbra"}}) {
      const double exact =
          layer == ShadowLayer::umbra && !visible ? 0.0 : entry.at(key).get<double>();
      const double bound = 4e-7 * (1.0 + std::abs(exact)) * H / (H - h);
      EXPECT_NEAR(layer_factor_f(constants, layer, static_cast<float>(h)), exact, bound) << key;
      EXPECT_NEAR(layer_factor(constants, layer, h), exact,
                  1e-13 * (1.0 + std::abs(exact)) * H / (H - h))
          << key;
    }
  }
}

TEST(ShadowVectors, MatchAreasOfCasterAtEachHeight) {
  if (vectors_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  std::size_t sweeps = 0;
  for (const auto& file : std::filesystem::directory_iterator(vectors_dir())) {
    if (file.path().filename().string().rfind("sweep_", 0) != 0) continue;
    ++sweeps;
    SCOPED_TRACE(file.path().filename().string());
    const nlohmann::json json = test::read_json(file.path());
    const GivenCaster caster(json.at("mesh").get<std::string>(),
                             json.at("kernel_set").get<std::string>());
    const LayeredConstants constants = test::constants_from(json.at("constants"));
    const double tolerance = json.at("tolerance_area_rel").get<double>();
    const auto& heights = json.at("translation_z");
    for (std::size_t step = 0; step < heights.size(); ++step) {
      const Placement placement = {Eigen::Vector3d(0.0, 0.0, heights.at(step).get<double>()),
                                   Eigen::Quaterniond(test::matrix_from(json.at("rotation"))), 1.0};
      const auto vertices = place_caster(caster.mesh, caster.kernels, placement, PlaneFrame());
      for (std::size_t i = 0; i < 3; ++i) {
        const auto outline = union_of_triangles(
            layer_triangles(vertices, caster.mesh.indices, constants, kShadowLayers[i]));
        ASSERT_TRUE(outline);
        const double expected = json.at("areas_umbra_middle_penumbra").at(step).at(i).get<double>();
        EXPECT_NEAR(outline->area, expected, tolerance * expected + 1e-12)
            << "step " << step << " layer " << i;
      }
    }
  }
  EXPECT_GT(sweeps, 0U);
}

TEST(ShadowVectors, MatchTwistedFaceCounts) {
  if (vectors_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const nlohmann::json json = test::read_json(vectors_dir() / "twist.json");
  ASSERT_GT(json.at("cases").size(), 0U);
  for (const auto& entry : json.at("cases")) {
    const std::string mesh = entry.at("mesh").get<std::string>();
    const std::string set = entry.at("kernel_set").get<std::string>();
    SCOPED_TRACE(mesh + " " + set);
    const GivenCaster caster(mesh, set);
    const PlaneFrame plane =
        PlaneFrame::make(test::vector_from(entry.at("up")), Eigen::Vector3d::Zero());
    const auto vertices = place_caster(caster.mesh, caster.kernels, Placement(), plane);
    const TwistReport report =
        find_twists(vertices, caster.mesh.indices, entry.at("s_min").get<double>(),
                    entry.at("s_max").get<double>());
    const double slack = entry.at("ambiguous").get<double>() + 1.0;
    EXPECT_NEAR(static_cast<double>(report.faces_twisted), entry.at("twisted").get<double>(),
                slack);
    EXPECT_EQ(report.faces_tested, entry.at("faces_tested").get<std::size_t>());
  }
}

}  // namespace
}  // namespace penumbra
