// The shadow vectors through the program, as others judge it: model and kernel file in, JSON out.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <fstream>
#include <string>
#include <vector>

#include "support/kernel_quality.hpp"
#include "support/run_program.hpp"
#include "support/shadow_cases.hpp"

namespace penumbra::test {
namespace {

class ShadowVectorsByProgram : public testing::Test {
 protected:
  void SetUp() override {
    if (shared_dir().empty()) GTEST_SKIP() << "no shared data beside the checkout";
  }
  [[nodiscard]] static std::filesystem::path vectors() { return shared_dir() / "vectors"; }
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }

  // Its own file per mesh of the vectors, written once. Numbers as the JSON has them.
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
  // The layers of `penumbra shadow`; null where it failed.
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

// Area, and agreement with the oracle's polygons on 1024 pixels across.
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

TEST_F(ShadowVectorsByProgram, EveryLayerCase) {
  const nlohmann::json index = read_json(vectors() / "index.json");
  ASSERT_GT(index.at("cases").size(), 10U);
  for (const auto& entry : index.at("cases")) {
    const std::string id = entry.at("id");
    SCOPED_TRACE(id);
    const nlohmann::json json = read_json(vectors() / (id + ".json"));
    const std::string mesh = json.at("mesh");
    const auto& plane = json.at("plane");
    const Eigen::Vector3d n = vector_from(plane.at("normal"));
    const Eigen::Vector3d q = vector_from(plane.at("point"));
    const auto& object = json.at("object_to_world");
    const std::vector<std::string> place = {
        obj_of(mesh), "--pose", pose(object.at("rotation"), vector_from(object.at("translation"))),
        "--plane", fmt::format("{} {} {} {} {} {}", n.x(), n.y(), n.z(), q.x(), q.y(), q.z())};
    const std::string kernels = kernels_of(mesh, json.at("kernel_set"));
    const auto got =
        layers(joined(joined(place, {"--kernels", kernels}), light(json.at("constants"))));
    const auto simple = layers(joined(place, {"--technique", "simple"}));
    for (const char* layer : {"umbra", "middle", "penumbra"}) {
      SCOPED_TRACE(layer);
      expect_layer(got.at(layer), json.at("expected").at(layer), json.at("tolerance"));
    }
    SCOPED_TRACE("orthogonal");
    expect_layer(simple.at("shadow"), json.at("expected").at("orthogonal"), json.at("tolerance"));
  }
}

TEST_F(ShadowVectorsByProgram, HeightSweeps) {
  for (const auto& entry : std::filesystem::directory_iterator(vectors())) {
    if (!entry.path().filename().string().starts_with("sweep_")) continue;
    SCOPED_TRACE(entry.path().filename().string());
    const nlohmann::json json = read_json(entry.path());
    const std::string mesh = json.at("mesh");
    const std::string kernels = kernels_of(mesh, json.at("kernel_set"));
    const double tolerance = json.at("tolerance_area_rel");
    const auto& heights = json.at("translation_z");
    for (std::size_t step = 0; step < heights.size(); ++step) {
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

// A light at infinity, kernels or fields made by the program, ray-cast masks.
TEST_F(ShadowVectorsByProgram, KernelQuality) {
  const QualityCases all;
  ASSERT_FALSE(all.cases().empty());
  double field_mean[2] = {0.0, 0.0};
  for (const QualityCase& quality : all.cases()) {
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
        if (field) field_mean[which++] += reached / static_cast<double>(all.cases().size());
      }
    }
  }
  EXPECT_GE(field_mean[0], 0.95);
  EXPECT_GE(field_mean[1], 0.98);
}

}  // namespace
}  // namespace penumbra::test
