// The test vectors of shadows through the command line: model and kernel file in, JSON out.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include "render/scene/plane_frame.hpp"
#include "support/kernel_quality.hpp"
#include "support/run_program.hpp"
#include "support/shadow_cases.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

// Each vector runs the program, so the short form tests every fourth vector.
constexpr std::size_t kShortFormStep = 4;
std::size_t step_of_form() {
  return nightly() ? 1 : kShortFormStep;
}

class ShadowCommandVectors : public testing::Test {
 protected:
  void SetUp() override {
    if (shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  }
  [[nodiscard]] static std::filesystem::path vectors() { return shared_dir() / "vectors"; }
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }

  // Writes an OBJ file with the JSON's digits, once per mesh of the vectors.
  std::string obj_of(const std::string& mesh) {
    const std::string path = file(std::filesystem::path(mesh).stem().string() + ".obj");
    if (std::filesystem::exists(path)) return path;
    const nlohmann::json json = read_json(vectors() / mesh);
    std::ofstream obj(path);
    const auto xyz = json.at("vertices").get<std::vector<double>>();
    for (std::size_t i = 0; i + 2 < xyz.size(); i += 3)
      obj << fmt::format("v {} {} {}\n", xyz[i], xyz[i + 1], xyz[i + 2]);
    const auto corners = json.at("triangles").get<std::vector<int>>();
    for (std::size_t i = 0; i + 2 < corners.size(); i += 3)
      obj << fmt::format("f {} {} {}\n", corners[i] + 1, corners[i + 1] + 1, corners[i + 2] + 1);
    return path;
  }
  std::string kernels_of(const std::string& mesh, const std::string& kernel_set) {
    const nlohmann::json json = read_json(vectors() / mesh);
    const std::string path = file("kernels.json");
    std::ofstream(path) << nlohmann::json{{"kernels", json.at("kernels").at(kernel_set)},
                                          {"up", {0, 0, 1}}};
    return path;
  }
  // Returns the layers of `penumbra shadow`, or null if it failed.
  nlohmann::json layers(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "shadow");
    arguments.insert(arguments.end(), {"--output", file("layers.json")});
    const ProgramResult result = run_program(program(), arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return result.exit_code == 0 ? read_json(file("layers.json")).at("layers") : nlohmann::json();
  }

  static std::string pose(const nlohmann::json& rotation, const Eigen::Vector3d& t) {
    const Eigen::Quaterniond q(matrix_from(rotation));
    return fmt::format("{} {} {} {} {} {} {}", t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w());
  }
  static std::vector<std::string> light(const nlohmann::json& constants) {
    if (constants.at("H").is_string())
      return {"--light-height", "inf", "--umbra-height",
              fmt::format("{}", constants.at("h_umbra").get<double>())};
    return {"--light-height", fmt::format("{}", constants.at("H").get<double>()), "--light-ratio",
            fmt::format("{}", constants.at("a").get<double>())};
  }

  TemporaryFolder folder_;
};

std::vector<std::string> joined(std::vector<std::string> a, const std::vector<std::string>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

// Compares the area, and on a grid of 1024 pixels the overlap with the oracle's polygons.
void expect_layer(const nlohmann::json& layer, const nlohmann::json& expected,
                  const nlohmann::json& tolerance) {
  const double area = expected.at("area").get<double>();
  EXPECT_NEAR(layer.at("area").get<double>(), area,
              tolerance.at("area_rel").get<double>() * area + 1e-12);
  const std::vector<Ring> rings = rings_from(layer.at("polygons"));
  EXPECT_EQ(rings.empty(), area == 0.0);
  if (rings.empty() || area == 0.0) return;
  const auto bounds = expected.at("bounds").get<std::vector<double>>();
  const Eigen::Vector2d low(bounds[0], bounds[1]);
  const Eigen::Vector2d high(bounds[2], bounds[3]);
  const double extent = 1.02 * (high - low).maxCoeff();
  const Mask empty(0.5 * (low + high) - Eigen::Vector2d::Constant(0.5 * extent), extent / 1024.0,
                   1024);
  Mask ours = empty;
  ours.cover(rings);
  Mask theirs = empty;
  theirs.cover(rings_from(expected.at("polygons")));
  EXPECT_GE(iou(ours.bits, theirs.bits), tolerance.at("iou_min").get<double>());
  const double boundary = tolerance.at("boundary_m").get<double>();
  for (const Ring& ring : rings) {
    for (const Eigen::Vector2d& p : ring) {
      EXPECT_GT((p - low).minCoeff(), -boundary);
      EXPECT_GT((high - p).minCoeff(), -boundary);
    }
  }
}

TEST_F(ShadowCommandVectors, MatchLayerCases) {
  const nlohmann::json index = read_json(vectors() / "index.json");
  ASSERT_GT(index.at("cases").size(), 10U);
  for (std::size_t i = 0; i < index.at("cases").size(); i += step_of_form()) {
    const std::string id = index.at("cases").at(i).at("id");
    SCOPED_TRACE(id);
    const nlohmann::json json = read_json(vectors() / (id + ".json"));
    const std::string mesh = json.at("mesh");
    const auto& plane = json.at("plane");
    const Eigen::Vector3d n = vector_from(plane.at("normal"));
    const Eigen::Vector3d q = vector_from(plane.at("point"));
    const auto& object = json.at("object_to_world");
    const std::vector<std::string> placement = {
        obj_of(mesh), "--pose", pose(object.at("rotation"), vector_from(object.at("translation"))),
        "--plane", fmt::format("{} {} {} {} {} {}", n.x(), n.y(), n.z(), q.x(), q.y(), q.z())};
    const std::string kernels = kernels_of(mesh, json.at("kernel_set"));
    const auto got =
        layers(joined(joined(placement, {"--kernels", kernels}), light(json.at("constants"))));
    const auto simple = layers(joined(placement, {"--technique", "simple"}));
    for (const char* layer : {"umbra", "middle", "penumbra"}) {
      SCOPED_TRACE(layer);
      expect_layer(got.at(layer), json.at("expected").at(layer), json.at("tolerance"));
    }
    SCOPED_TRACE("orthogonal");
    expect_layer(simple.at("shadow"), json.at("expected").at("orthogonal"), json.at("tolerance"));
  }
}

TEST_F(ShadowCommandVectors, MatchAreasOfCasterAtEachHeight) {
  for (const auto& entry : std::filesystem::directory_iterator(vectors())) {
    if (!entry.path().filename().string().starts_with("sweep_")) continue;
    SCOPED_TRACE(entry.path().filename().string());
    const nlohmann::json json = read_json(entry.path());
    const std::string mesh = json.at("mesh");
    const std::string kernels = kernels_of(mesh, json.at("kernel_set"));
    const double tolerance = json.at("tolerance_area_rel");
    const auto& heights = json.at("translation_z");
    for (std::size_t step = 0; step < heights.size(); step += step_of_form()) {
      const Eigen::Vector3d t(0.0, 0.0, heights.at(step).get<double>());
      const auto got = layers(
          joined({obj_of(mesh), "--kernels", kernels, "--pose", pose(json.at("rotation"), t)},
                 light(json.at("constants"))));
      std::size_t column = 0;
      for (const char* layer : {"umbra", "middle", "penumbra"}) {
        const double expected =
            json.at("areas_umbra_middle_penumbra").at(step).at(column++).get<double>();
        EXPECT_NEAR(got.at(layer).at("area").get<double>(), expected, tolerance * expected + 1e-12)
            << layer << " at " << t.z();
      }
    }
  }
}

// --- hard shadows ---

std::string joined_numbers(const Eigen::VectorXd& values) {
  std::string text;
  for (const double value : values) text += fmt::format("{}{}", text.empty() ? "" : " ", value);
  return text;
}

void write_obj(const std::string& path, const std::vector<double>& xyz,
               const std::vector<int>& corners) {
  std::ofstream obj(path);
  for (std::size_t i = 0; i + 2 < xyz.size(); i += 3)
    obj << fmt::format("v {} {} {}\n", xyz[i], xyz[i + 1], xyz[i + 2]);
  for (std::size_t i = 0; i + 2 < corners.size(); i += 3)
    obj << fmt::format("f {} {} {}\n", corners[i] + 1, corners[i + 1] + 1, corners[i + 2] + 1);
}

// Cubes that extend below the plane, up to the light and above it. The shadows are polygons on a
// receiver.
TEST_F(ShadowCommandVectors, MatchHardShadowsOfClippedCubes) {
  const nlohmann::json json = read_json(vectors() / "projective_clip.json");
  ASSERT_GE(json.at("cases").size(), 5U);
  std::size_t number = 0;
  for (const auto& entry : json.at("cases")) {
    SCOPED_TRACE(number);
    if (number++ % step_of_form() != 0) continue;
    write_obj(file("cube.obj"), entry.at("vertices").get<std::vector<double>>(),
              entry.at("triangles").get<std::vector<int>>());
    const Eigen::Vector3d at = vector_from(entry.at("light"));
    const auto got = layers({file("cube.obj"), "--technique", "hard", "--light",
                             fmt::format("{} {} {} 1", at.x(), at.y(), at.z())});
    const auto receiver = entry.at("receiver").get<std::vector<double>>();
    constexpr int kPixels = 2048;
    const double pixel = (receiver[2] - receiver[0]) / kPixels;
    Mask ours({receiver[0], receiver[1]}, pixel, kPixels);
    Mask theirs = ours;
    ours.cover(rings_from(got.at("shadow").at("polygons")));
    theirs.cover(rings_from(entry.at("polygons")));
    EXPECT_GE(iou(ours.bits, theirs.bits), entry.at("iou_min").get<double>());
    const double area = entry.at("area").get<double>();
    EXPECT_NEAR(ours.area(), area, 0.002 * area + 4.0 * pixel * pixel);
  }
}

// Each point is a triangle of 0.1 mm. Its shadow must be at the oracle's position, or absent.
TEST_F(ShadowCommandVectors, MatchHardShadowsOfSinglePoints) {
  const nlohmann::json json = read_json(vectors() / "projection_points.json");
  std::size_t number = 0;
  std::size_t shadows = 0;
  std::size_t others = 0;
  for (const char* list : {"examples", "points"}) {
    for (const auto& entry : json.at(list)) {
      if (number++ % step_of_form() != 0) continue;
      SCOPED_TRACE(entry.dump());
      const auto covector = entry.at("plane").get<std::vector<double>>();
      const Eigen::Vector3d n(covector[0], covector[1], covector[2]);
      const Eigen::Vector3d q = -covector[3] / n.squaredNorm() * n;
      const PlaneFrame plane = PlaneFrame::make(n.normalized(), q);
      const Eigen::Vector3d p = vector_from(entry.at("point"));
      constexpr double kSize = 1e-4;
      std::vector<double> xyz;
      for (int i = 0; i < 3; ++i) {
        const double angle = 2.0943951023931953 * i;
        const Eigen::Vector3d corner =
            p + kSize * (std::cos(angle) * plane.e1 + std::sin(angle) * plane.e2);
        xyz.insert(xyz.end(), corner.begin(), corner.end());
      }
      write_obj(file("point.obj"), xyz, {0, 1, 2});
      const auto light = entry.at("light").get<std::vector<double>>();
      Eigen::VectorXd six(6);
      six << n, q;
      const auto got = layers({file("point.obj"), "--technique", "hard", "--light",
                               joined_numbers(Eigen::Map<const Eigen::Vector4d>(light.data())),
                               "--plane", joined_numbers(six)});
      const std::vector<Ring> rings = rings_from(got.at("shadow").at("polygons"));
      const double d_light =
          n.dot(Eigen::Vector3d(light[0], light[1], light[2])) + light[3] * covector[3];
      if (entry.at("classification") != "shadow" || d_light <= 0.0) {
        EXPECT_TRUE(rings.empty()) << "an antishadow, or a false shadow";
        ++others;
        continue;
      }
      ASSERT_EQ(rings.size(), 1U);
      Eigen::Vector2d middle = Eigen::Vector2d::Zero();
      for (const Eigen::Vector2d& corner : rings[0]) {
        middle += corner / static_cast<double>(rings[0].size());
      }
      const auto w = entry.at("homogeneous").get<std::vector<double>>();
      const Eigen::Vector3d expected(w[0] / w[3], w[1] / w[3], w[2] / w[3]);
      const Eigen::Vector2d at = plane.to_plane(expected).head<2>();
      // The triangle is parallel to the plane, so its centre projects to the centre of its shadow.
      // The tolerance is float precision in metres.
      EXPECT_LT((middle - at).norm(), 2e-6 * (1.0 + at.norm() + p.norm() * at.norm()));
      ++shadows;
    }
  }
  EXPECT_GT(step_of_form() * shadows, 8U);
  EXPECT_GT(step_of_form() * others, 8U);
}

// The bitmaps of shadow volumes show a plane. The hard shadow, evaluated along the pixels' rays,
// must be the same for each eye position.
TEST_F(ShadowCommandVectors, MatchShadowVolumesOnPlane) {
  const nlohmann::json json = read_json(vectors() / "shadow_volume.json");
  for (const auto& entry : json.at("cases")) {
    const auto hull = entry.at("caster_hull_points").get<std::vector<double>>();
    Eigen::Vector3d low = Eigen::Vector3d::Constant(1e9);
    Eigen::Vector3d high = -low;
    for (std::size_t i = 0; i + 2 < hull.size(); i += 3) {
      const Eigen::Vector3d p(hull[i], hull[i + 1], hull[i + 2]);
      low = low.cwiseMin(p);
      high = high.cwiseMax(p);
    }
    ASSERT_EQ(hull.size(), 24U) << "the test computes hulls of boxes only";
    std::vector<double> xyz;
    for (unsigned i = 0; i < 8; ++i) {
      for (unsigned axis = 0; axis < 3; ++axis) {
        xyz.push_back((i >> axis & 1U) != 0U ? high[axis] : low[axis]);
      }
    }
    write_obj(file("box.obj"), xyz, {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                     2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5});
    const Eigen::Vector3d at = vector_from(entry.at("light"));
    const auto got = layers({file("box.obj"), "--technique", "hard", "--light",
                             fmt::format("{} {} {} 1", at.x(), at.y(), at.z())});
    constexpr int kPixels = 4096;
    constexpr double kExtent = 40.0;
    Mask shadow(Eigen::Vector2d::Constant(-0.5 * kExtent), kExtent / kPixels, kPixels);
    shadow.cover(rings_from(got.at("shadow").at("polygons")));
    const int size = entry.at("size").get<int>();
    const double tan_half_fov =
        std::tan(entry.at("fov_deg").get<double>() * 0.5 * 0.017453292519943295);
    const Eigen::Vector3d eye = vector_from(entry.at("eye"));
    const auto rows = entry.at("rows").get<std::vector<std::string>>();
    int wrong = 0;
    int dark = 0;
    for (int row = 0; row < size; ++row) {
      for (int column = 0; column < size; ++column) {
        const Eigen::Vector3d ray =
            vector_from(entry.at("forward")) +
            vector_from(entry.at("right")) * ((2.0 * (column + 0.5) / size - 1.0) * tan_half_fov) -
            vector_from(entry.at("up")) * ((2.0 * (row + 0.5) / size - 1.0) * tan_half_fov);
        bool covered = false;
        if (ray.z() < 0.0) {
          const Eigen::Vector2d p = (eye - ray * (eye.z() / ray.z())).head<2>();
          const Eigen::Vector2i cell =
              ((p - shadow.origin) / shadow.pixel).array().floor().cast<int>();
          if (cell.minCoeff() >= 0 && cell.maxCoeff() < kPixels) {
            covered = shadow.bits[shadow.index(cell.x(), cell.y())] != 0;
          }
        }
        const bool expected =
            rows[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)] == '#';
        wrong += covered != expected ? 1 : 0;
        dark += expected ? 1 : 0;
      }
    }
    EXPECT_GT(dark, 20);
    EXPECT_LE(wrong, size * size / 100);
  }
}

// For a light at infinity, compares kernels or fields generated by the program with ray-cast masks.
// The short form tests one of each mesh's two cases.
TEST_F(ShadowCommandVectors, MeetRequiredKernelQuality) {
  const QualityCases all;
  ASSERT_FALSE(all.cases().empty());
  double field_mean[2] = {0.0, 0.0};
  const std::size_t step = nightly() ? 1 : 2;
  const double count =
      std::ceil(static_cast<double>(all.cases().size()) / static_cast<double>(step));
  for (std::size_t i = 0; i < all.cases().size(); i += step) {
    const QualityCase& quality = all.cases()[i];
    SCOPED_TRACE(quality.name() + fmt::format(" at {}", quality.placement().position.z()));
    for (const char* technique : {"layered", "field"}) {
      const auto got =
          layers(joined({obj_of(quality.name()), "--technique", technique, "--pose",
                         pose(quality.json.at("rotation"), quality.placement().position)},
                        light(quality.json)));
      std::size_t which = 0;
      for (const auto& [layer, key] : kJudgedLayers) {
        Mask mask = quality.empty_mask();
        mask.cover(rings_from(got.at(key).at("polygons")));
        const double reached = quality.iou_with(mask, key);
        const bool field = std::string(technique) == "field";
        EXPECT_GE(reached, field ? quality.number("moonshot_iou", key) - 0.02
                                 : quality.number("required_iou", key))
            << technique << " " << key;
        if (field) field_mean[which++] += reached / count;
      }
    }
  }
  EXPECT_GE(field_mean[0], 0.95);
  EXPECT_GE(field_mean[1], 0.98);
}

}  // namespace
}  // namespace penumbra::test
