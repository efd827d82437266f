// Animations of glTF files, compared with an independent evaluation: keys, interpolation, skins and
// morph targets over time.
#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <random>

#include "render/model/animated_model.hpp"
#include "render/model/to_eigen.hpp"
#include "support/animated_gltf.hpp"
#include "support/compressed_gltf.hpp"
#include "support/model_case.hpp"
#include "support/textured_glb.hpp"

namespace penumbra {
namespace {

using test::animate;
using test::GltfBuilder;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class GltfAnimation : public test::ModelCase {
 protected:
  Result<Model> posed(const GltfBuilder& file, const std::string& animation, double time_s) {
    return load_model(write("model.gltf", file.gltf()),
                      {.up = UpAxis::z, .pose = ModelPose{animation, time_s}});
  }
  Result<Model> at(const GltfBuilder& file, double time_s) { return posed(file, "0", time_s); }
  std::string fault(const GltfBuilder& file) { return error_of(at(file, 0.0)); }
  // Returns the origin's position.
  Eigen::Vector3d first_vertex(const GltfBuilder& file, double time_s) {
    const auto model = at(file, time_s);
    EXPECT_TRUE(model) << error_of(model);
    return model ? to_eigen(model->meshes[0].positions[0]) : Eigen::Vector3d::Zero();
  }
};

// A square in one node. Its first vertex is at the node's origin.
GltfBuilder square_in_node() {
  GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  return file;
}

// --- an independent evaluation, straight from the specification ---

struct Track {
  std::string interpolation;
  std::vector<float> times;
  std::vector<float> values;  // CUBICSPLINE: in-tangent, value, out-tangent of each key
  std::size_t width = 3;
  bool rotation = false;

  [[nodiscard]] std::vector<double> element(std::size_t index) const {
    return {values.begin() + static_cast<std::ptrdiff_t>(index * width),
            values.begin() + static_cast<std::ptrdiff_t>((index + 1) * width)};
  }
  [[nodiscard]] std::vector<double> key(std::size_t k) const {
    return element(interpolation == "CUBICSPLINE" ? 3 * k + 1 : k);
  }
  [[nodiscard]] std::vector<double> at(double time_s) const {
    if (time_s <= static_cast<double>(times.front())) return key(0);
    if (time_s >= static_cast<double>(times.back())) return key(times.size() - 1);
    std::size_t k = 0;
    while (static_cast<double>(times[k + 1]) <= time_s) ++k;
    const double span = static_cast<double>(times[k + 1]) - static_cast<double>(times[k]);
    const double t = (time_s - static_cast<double>(times[k])) / span;
    if (interpolation == "STEP") return key(k);
    const std::vector<double> a = key(k), b = key(k + 1);
    if (interpolation == "CUBICSPLINE") {
      // As a Bezier curve, by de Casteljau's algorithm.
      const std::vector<double> out = element(3 * k + 2), in = element(3 * k + 3);
      std::vector<double> value;
      for (std::size_t i = 0; i < width; ++i) {
        std::array<double, 4> p = {a[i], a[i] + span * out[i] / 3.0, b[i] - span * in[i] / 3.0,
                                   b[i]};
        for (int level = 3; level > 0; --level) {
          for (int j = 0; j < level; ++j) {
            const auto at_j = static_cast<std::size_t>(j);
            p[at_j] += t * (p[at_j + 1] - p[at_j]);
          }
        }
        value.push_back(p[0]);
      }
      return value;
    }
    std::vector<double> value;
    if (rotation) {
      // Rotates from a by a fraction of the angle to b.
      const Eigen::Quaterniond from(a[3], a[0], a[1], a[2]), to(b[3], b[0], b[1], b[2]);
      const Eigen::AngleAxisd between(from.normalized().conjugate() * to.normalized());
      const double angle = std::remainder(between.angle(), 2.0 * std::numbers::pi);
      const Eigen::Quaterniond turned =
          from.normalized() * Eigen::AngleAxisd(t * angle, between.axis());
      return {turned.x(), turned.y(), turned.z(), turned.w()};
    }
    for (std::size_t i = 0; i < width; ++i) value.push_back(a[i] + t * (b[i] - a[i]));
    return value;
  }
};

Eigen::Matrix4d matrix_of(const std::vector<double>& translation,
                          const std::vector<double>& rotation, const std::vector<double>& scale) {
  Eigen::Matrix4d matrix = Eigen::Matrix4d::Identity();
  const Eigen::Quaterniond turn(rotation[3], rotation[0], rotation[1], rotation[2]);
  matrix.topLeftCorner<3, 3>() = turn.normalized().toRotationMatrix() *
                                 Eigen::Vector3d(scale.data()).asDiagonal().toDenseMatrix();
  matrix.topRightCorner<3, 1>() = Eigen::Vector3d(translation.data());
  return matrix;
}

class RandomTracks {
 public:
  Track make(const std::string& interpolation, const std::string& path, std::size_t targets = 0) {
    Track track{interpolation, {}, {}, path == "weights" ? targets : 3, path == "rotation"};
    if (track.rotation) track.width = 4;
    float time = 0.25F;
    for (int key = 0; key < 5; ++key) {
      track.times.push_back(time);
      time += number(0.1F, 0.7F);
      const bool cubic = interpolation == "CUBICSPLINE";
      for (int part = cubic ? 0 : 1; part < (cubic ? 3 : 2); ++part) {
        std::vector<float> element;
        for (std::size_t i = 0; i < track.width; ++i) element.push_back(number(-1.0F, 1.0F));
        if (part == 1 && track.rotation) {
          const Eigen::Vector4f unit = Eigen::Map<Eigen::Vector4f>(element.data()).normalized();
          element.assign(unit.begin(), unit.end());
        }
        track.values.insert(track.values.end(), element.begin(), element.end());
      }
    }
    return track;
  }
  float number(float low, float high) {
    return std::uniform_real_distribution<float>(low, high)(random_);
  }

 private:
  std::mt19937 random_{7};
};

void add(GltfBuilder& file, std::size_t node, const std::string& path, const Track& track) {
  animate(file, node, path, track.times, track.values, {.interpolation = track.interpolation});
}

// Times before, at, between and after the keys.
std::vector<double> times_about(const Track& track) {
  std::vector<double> times = {-1.0, 0.0, 1e9};
  for (std::size_t k = 0; k < track.times.size(); ++k) {
    const auto time = static_cast<double>(track.times[k]);
    times.push_back(time);
    if (k == 0) continue;
    const auto before = static_cast<double>(track.times[k - 1]);
    for (const double part : {0.1, 0.5, 0.999}) times.push_back(before + part * (time - before));
  }
  return times;
}

// --- interpolation ---

class GltfInterpolation : public GltfAnimation, public testing::WithParamInterface<const char*> {};

TEST_P(GltfInterpolation, MatchesSpecification) {
  RandomTracks random;
  const Track translation = random.make(GetParam(), "translation");
  const Track rotation = random.make(GetParam(), "rotation");
  const Track scale = random.make(GetParam(), "scale");
  const Track child_rotation = random.make(GetParam(), "rotation");
  GltfBuilder file = square_in_node();
  file.json["nodes"].push_back({{"children", {0}}, {"rotation", {0, 0.6, 0, 0.8}}});
  file.json["scenes"][0]["nodes"] = {1};
  file.json["nodes"][0]["scale"] = {1.5, 1, 2};
  add(file, 1, "translation", translation);
  add(file, 1, "rotation", rotation);
  add(file, 1, "scale", scale);
  add(file, 0, "rotation", child_rotation);
  const std::array<Eigen::Vector3d, 4> corners = {
      {{0, 0, 0}, {0, 0, 0.1}, {0.1, 0, 0.1}, {0.1, 0, 0}}};
  for (const double time : times_about(rotation)) {
    const auto model = at(file, time);
    ASSERT_TRUE(model) << error_of(model);
    const Eigen::Matrix4d T = matrix_of(translation.at(time), rotation.at(time), scale.at(time)) *
                              matrix_of({0, 0, 0}, child_rotation.at(time), {1.5, 1, 2});
    for (std::size_t i = 0; i < 4; ++i) {
      const Eigen::Vector3d expected = (T * corners[i].homogeneous()).head<3>();
      const Eigen::Vector3d actual = model->origin + to_eigen(model->meshes[0].positions[i]);
      EXPECT_LT((actual - expected).norm(), 3e-7) << time << " s, vertex " << i;
    }
    // The winding and the normals follow a mirroring transform.
    Eigen::Vector3d normal =
        T.topLeftCorner<3, 3>().inverse().transpose() * Eigen::Vector3d::UnitY();
    EXPECT_LT((to_eigen(model->meshes[0].normals[0]) - normal.normalized()).norm(), 1e-5);
    EXPECT_THAT(model->warnings, IsEmpty());
  }
}

INSTANTIATE_TEST_SUITE_P(Forms, GltfInterpolation, testing::Values("STEP", "LINEAR", "CUBICSPLINE"),
                         [](const auto& form) { return std::string(form.param); });

TEST_F(GltfAnimation, TurnsOverShorterArc) {
  GltfBuilder file = square_in_node();
  // From 0 to 90 degrees about y; the negated quaternion is the same rotation.
  const float half = std::sqrt(0.5F);
  animate(file, 0, "rotation", {0, 1}, std::vector<float>{0, 0, 0, 1, 0, -half, 0, -half});
  const auto model = at(file, 1.0 / 3.0);
  ASSERT_TRUE(model) << error_of(model);
  const Eigen::Vector3d edge = to_eigen(model->meshes[0].positions[3]);
  EXPECT_LT((edge - 0.1 * Eigen::Vector3d(std::cos(std::numbers::pi / 6), 0, -0.5)).norm(), 1e-7);
}

TEST_F(GltfAnimation, KeepsRotationBetweenOppositeKeysOfSpline) {
  GltfBuilder file = square_in_node();
  // Half-way the spline is zero.
  animate(file, 0, "rotation", {0, 1}, std::vector<float>{0, 0, 0, 0, 0, 0, 0, 1,  0, 0, 0, 0,
                                                          0, 0, 0, 0, 0, 0, 0, -1, 0, 0, 0, 0},
          {.interpolation = "CUBICSPLINE"});
  for (const double time : {0.25, 0.5, 0.75}) {
    const auto model = at(file, time);
    ASSERT_TRUE(model) << error_of(model);
    EXPECT_NEAR(test::measure_projected_area(*model, {0, 1, 0}).front, 0.01, 1e-8);
  }
}

TEST_F(GltfAnimation, ReadsNormalizedIntegers) {
  const float half = std::sqrt(0.5F);
  const auto quantised = [half](auto largest) {
    using T = decltype(largest);
    const auto h = static_cast<T>(std::lround(half * static_cast<float>(largest)));
    return std::vector<T>{0, 0, 0, largest, 0, h, 0, h};
  };
  const auto edge_of = [this](const GltfBuilder& file) {
    const auto model = at(file, 1.0);
    EXPECT_TRUE(model) << error_of(model);
    return model ? to_eigen(model->meshes[0].positions[3]) : Eigen::Vector3d::Zero();
  };
  const Eigen::Vector3d expected(0, 0, -0.1);
  const auto expect = [&](auto largest) {
    GltfBuilder file = square_in_node();
    animate(file, 0, "rotation", {0, 1}, quantised(largest), {.normalized = true});
    EXPECT_LT((edge_of(file) - expected).norm(), 1e-6);
    file.json["accessors"].back().erase("normalized");
    EXPECT_THAT(fault(file), HasSubstr("animations/0/samplers/0/output: are not floats or "
                                       "normalized integers"));
  };
  expect(std::int8_t{127});
  expect(std::uint8_t{255});
  expect(std::int16_t{32767});
  expect(std::uint16_t{65535});
  GltfBuilder file = square_in_node();
  animate(file, 0, "translation", {0, 1}, std::vector<std::int16_t>(6, 0), {.normalized = true});
  EXPECT_THAT(fault(file), HasSubstr("samplers/0/output: are not floats; export"));
}

TEST_F(GltfAnimation, ReadsSparseAndCompressedKeys) {
  GltfBuilder file = square_in_node();
  const std::size_t times = file.accessor(std::vector<float>{0, 1, 2}, "SCALAR");
  test::add_channel(file, 0, "translation", times, file.sparse_accessor(3, {1}, {0.4F, 0, 0}));
  EXPECT_NEAR(first_vertex(file, 0.5).x(), 0.2, 1e-7);
  EXPECT_NEAR(first_vertex(file, 1.75).x(), 0.1, 1e-7);
  // The QUATERNION filter stores normalised 16-bit integers.
  GltfBuilder compressed = square_in_node();
  const float half = std::sqrt(0.5F);
  const std::vector<float> turns = {0, 0, 0, 1, 0, half, 0, half, 0, 1, 0, 0};
  std::vector<std::int16_t> filtered(12);
  meshopt_encodeFilterQuat(filtered.data(), 3, 8, 16, turns.data());
  std::vector<std::uint8_t> coded(meshopt_encodeVertexBufferBound(3, 8));
  coded.resize(meshopt_encodeVertexBuffer(coded.data(), coded.size(), filtered.data(), 3, 8));
  const std::size_t input = compressed.accessor(std::vector<float>{0, 1, 2}, "SCALAR");
  const std::size_t output = compressed.accessor(filtered, "VEC4", true);
  const std::size_t view = compressed.view(coded);
  nlohmann::json& decoded =
      compressed.json["bufferViews"]
                     [compressed.json["accessors"][output]["bufferView"].get<std::size_t>()];
  decoded["extensions"]["EXT_meshopt_compression"] = {
      {"buffer", 0},
      {"byteOffset", compressed.json["bufferViews"][view]["byteOffset"]},
      {"byteLength", coded.size()},
      {"byteStride", 8},
      {"count", 3},
      {"mode", "ATTRIBUTES"},
      {"filter", "QUATERNION"}};
  test::add_channel(compressed, 0, "rotation", input, output);
  const auto model = at(compressed, 1.5);
  ASSERT_TRUE(model) << error_of(model);
  const Eigen::Vector3d edge = to_eigen(model->meshes[0].positions[3]);
  EXPECT_LT((edge - 0.1 * Eigen::Vector3d(-std::sqrt(0.5), 0, -std::sqrt(0.5))).norm(), 1e-5);
}

// --- skins and morph targets ---

TEST_F(GltfAnimation, MovesSkinAndNormalsWithJoints) {
  RandomTracks random;
  const test::Sheet sheet = test::wavy_sheet();
  GltfBuilder file = test::plain_gltf(sheet);
  std::vector<float> inverse_bind;
  std::array<Eigen::Matrix4d, 2> T_joint_bind;
  for (Eigen::Matrix4d& T : T_joint_bind) {
    const Eigen::Vector4f turn =
        Eigen::Vector4f(random.number(-1, 1), random.number(-1, 1), random.number(-1, 1), 1.0F)
            .normalized();
    const auto number = [&random] { return static_cast<double>(random.number(-0.1F, 0.1F)); };
    T = matrix_of({number(), number(), number()},
                  {static_cast<double>(turn[0]), static_cast<double>(turn[1]),
                   static_cast<double>(turn[2]), static_cast<double>(turn[3])},
                  {1, 1, 1});
    const Eigen::Matrix4f written = T.cast<float>();
    T = written.cast<double>();
    inverse_bind.insert(inverse_bind.end(), written.data(), written.data() + 16);
  }
  file.json["skins"][0]["inverseBindMatrices"] = file.accessor(inverse_bind, "MAT4");
  const Track upper = random.make("LINEAR", "rotation");
  const Track lower = random.make("CUBICSPLINE", "rotation");
  const Track shift = random.make("LINEAR", "translation");
  add(file, 1, "rotation", upper);
  add(file, 2, "rotation", lower);
  add(file, 2, "translation", shift);
  add(file, 0, "translation", shift);  // the transform of a skinned node has no effect
  for (const double time : times_about(lower)) {
    const auto model = at(file, time);
    ASSERT_TRUE(model) << error_of(model);
    const Eigen::Matrix4d T_root_1 = matrix_of({0, 0.01, 0}, upper.at(time), {1, 1, 1});
    const std::array<Eigen::Matrix4d, 2> joints = {
        T_root_1 * T_joint_bind[0],
        T_root_1 * matrix_of(shift.at(time), lower.at(time), {1, 1, 1}) * T_joint_bind[1]};
    double farthest = 0.0, most_turned = 0.0;
    for (std::size_t i = 0; i < sheet.count(); ++i) {
      const Eigen::Matrix4d T =
          0.75 * joints[sheet.joints[4 * i]] + 0.25 * joints[sheet.joints[4 * i + 1]];
      const Eigen::Vector3d position =
          Eigen::Map<const Eigen::Vector3f>(&sheet.positions[3 * i]).cast<double>();
      const Eigen::Vector3d normal =
          Eigen::Map<const Eigen::Vector3f>(&sheet.normals[3 * i]).cast<double>();
      const Eigen::Matrix3d linear = T.topLeftCorner<3, 3>();
      const Eigen::Vector3d expected = (T * position.homogeneous()).head<3>();
      const Eigen::Vector3d turned =
          (linear.determinant() * linear.inverse().transpose() * normal).normalized();
      const Mesh& mesh = model->meshes[0];
      farthest =
          std::max(farthest, (model->origin + to_eigen(mesh.positions[i]) - expected).norm());
      // Mirrored where the blended matrices have a negative determinant.
      const double sign = linear.determinant() < 0.0 ? -1.0 : 1.0;
      most_turned = std::max(most_turned, (to_eigen(mesh.normals[i]) - sign * turned).norm());
    }
    EXPECT_LT(farthest, 5e-7) << time << " s";
    EXPECT_LT(most_turned, 2e-5) << time << " s";
  }
}

TEST_F(GltfAnimation, MorphsByAnimatedWeights) {
  for (const char* interpolation : {"STEP", "LINEAR", "CUBICSPLINE"}) {
    RandomTracks random;
    GltfBuilder file = square_in_node();
    const std::vector<float> to_x = {0, 0, 0, 0, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0};
    const std::vector<float> to_y = {0, 0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0};
    file.primitive()["targets"] = {{{"POSITION", file.accessor(to_x, "VEC3")}},
                                   {{"POSITION", file.accessor(to_y, "VEC3")}}};
    file.json["meshes"][0]["weights"] = {0.5, 0.5};
    const Track weights = random.make(interpolation, "weights", 2);
    const Track shift = random.make("LINEAR", "translation");
    add(file, 0, "weights", weights);
    add(file, 0, "translation", shift);
    file.node({{"mesh", 0}, {"translation", {3, 0, 0}}});  // keeps the weights of the mesh
    for (const double time : times_about(weights)) {
      const auto model = at(file, time);
      ASSERT_TRUE(model) << error_of(model);
      const std::vector<double> weight = weights.at(time);
      const Eigen::Vector3d moved(shift.at(time).data());
      const auto vertex = [&](std::size_t i) -> Eigen::Vector3d {
        return model->origin + to_eigen(model->meshes[0].positions[i]);
      };
      const Eigen::Vector3d corner(0.1 + 0.1 * weight[0], 0.1 * weight[1], 0.1);
      EXPECT_LT((vertex(2) - moved - corner).norm(), 5e-7) << interpolation << " " << time;
      EXPECT_LT((vertex(6) - Eigen::Vector3d(3.15, 0.05, 0.1)).norm(), 5e-7);
    }
  }
}

TEST_F(GltfAnimation, ReadsNormalizedWeights) {
  GltfBuilder file = square_in_node();
  const std::vector<float> up = {0, 0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0};
  file.primitive()["targets"] = {{{"POSITION", file.accessor(up, "VEC3")}}};
  animate(file, 0, "weights", {0, 1}, std::vector<std::uint8_t>{0, 255}, {.normalized = true});
  EXPECT_NEAR(first_vertex(file, 0.5).y(), 0.05, 1e-8);
}

TEST_F(GltfAnimation, MorphsBeforeSkin) {
  GltfBuilder file = square_in_node();
  nlohmann::json& attributes = file.primitive()["attributes"];
  attributes["JOINTS_0"] = file.accessor(std::vector<std::uint8_t>(16, 0), "VEC4");
  std::vector<float> weights;
  for (int i = 0; i < 4; ++i) weights.insert(weights.end(), {1, 0, 0, 0});
  attributes["WEIGHTS_0"] = file.accessor(weights, "VEC4");
  const std::vector<float> to_x = {0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0, 0.1F, 0, 0};
  file.primitive()["targets"] = {{{"POSITION", file.accessor(to_x, "VEC3")}}};
  file.json["skins"] = {{{"joints", {1}}}};
  file.json["nodes"][0]["skin"] = 0;
  file.node(nlohmann::json::object());
  animate(file, 0, "weights", {0, 1}, std::vector<float>{0, 1});
  const float half = std::sqrt(0.5F);
  animate(file, 1, "rotation", {0, 1}, std::vector<float>{0, 0, 0, 1, 0, 0, half, half});
  // At 1 s the joint turns the morphed x axis to y.
  EXPECT_LT((first_vertex(file, 1.0) - Eigen::Vector3d(0, 0.1, 0)).norm(), 1e-7);
}

// --- choosing an animation ---

GltfBuilder with_three_animations() {
  GltfBuilder file = square_in_node();
  file.node({{"mesh", 0}});
  animate(file, 0, "translation", {0, 1}, std::vector<float>{0, 0, 0, 0.5F, 0, 0},
          {.animation = 0});
  animate(file, 1, "translation", {0, 4}, std::vector<float>{0, 0, 0, 0, 0.5F, 0},
          {.animation = 1});
  animate(file, 0, "translation", {0, 1}, std::vector<float>{0, 0, 0, 0, 0, 0.5F},
          {.animation = 2});
  file.json["animations"][0]["name"] = "Walk";
  file.json["animations"][1]["name"] = "2";
  file.json["animations"][2]["name"] = "Walk";
  return file;
}

TEST_F(GltfAnimation, IsChosenByNameBeforeIndex) {
  const GltfBuilder file = with_three_animations();
  const auto moved = [&](const std::string& animation) -> Eigen::Vector3d {
    const auto model = posed(file, animation, 1.0);
    EXPECT_TRUE(model) << error_of(model);
    if (!model) return Eigen::Vector3d::Zero();
    return to_eigen(model->meshes[0].positions[0]) + to_eigen(model->meshes[0].positions[4]);
  };
  EXPECT_EQ(moved("Walk"), Eigen::Vector3d(0.5, 0, 0));
  EXPECT_EQ(moved("0"), Eigen::Vector3d(0.5, 0, 0));
  EXPECT_EQ(moved("2"), Eigen::Vector3d(0, 0.125, 0));
  EXPECT_EQ(moved("all"), Eigen::Vector3d(0, 0.125, 0.5)) << "the last channel of a node is used";
  EXPECT_THAT(posed(file, "all", 0.0)->warnings,
              ElementsAre(HasSubstr("nodes/0/translation: is animated by several channels")));
}

TEST_F(GltfAnimation, ListsAnimationsIfNameIsUnknown) {
  const GltfBuilder file = with_three_animations();
  for (const char* unknown : {"Run", "3", "-1", "1.0", "", "walk"}) {
    EXPECT_THAT(
        error_of(posed(file, unknown, 0.0)),
        HasSubstr(fmt::format("model.gltf: has no animation \"{}\"; give one of 0 \"Walk\", "
                              "1 \"2\", 2 \"Walk\", or all",
                              unknown)));
  }
  EXPECT_THAT(error_of(posed(square_in_node(), "0", 0.0)),
              HasSubstr("model.gltf: has no animations"));
  EXPECT_THAT(error_of(load_model(write("model.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
                                  {.pose = ModelPose{}})),
              HasSubstr("model.obj: has no animations"));
}

// --- malformed and unusual animations ---

TEST_F(GltfAnimation, ReportsMalformedFields) {
  using Edit = void (*)(GltfBuilder&);
  struct Case {
    const char* error;
    Edit edit;
  };
  const std::vector<Case> cases = {
      {"animations/0: is 3; an object", [](GltfBuilder& file) { file.json["animations"][0] = 3; }},
      {"animations/0/channels: is \"x\"; a list",
       [](GltfBuilder& file) { file.json["animations"][0]["channels"] = "x"; }},
      {"animations/0/channels/0/sampler: is -1;",
       [](GltfBuilder& file) { file.json["animations"][0]["channels"][0]["sampler"] = -1; }},
      {"animations/0/channels/0/sampler: names sampler 7, there are 1",
       [](GltfBuilder& file) { file.json["animations"][0]["channels"][0]["sampler"] = 7; }},
      {"animations/0/channels/0/target/node: names node 9, there are 1",
       [](GltfBuilder& file) { file.json["animations"][0]["channels"][0]["target"]["node"] = 9; }},
      {"animations/0/channels/0/target/node: node 0 has a matrix",
       [](GltfBuilder& file) {
         file.json["nodes"][0]["matrix"] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
       }},
      {"animations/0/samplers/0/interpolation: \"CUBIC\" is none of",
       [](GltfBuilder& file) {
         file.json["animations"][0]["samplers"][0]["interpolation"] = "CUBIC";
       }},
      {"animations/0/samplers/0/output: are 3 for 3 keys, 9 expected",
       [](GltfBuilder& file) {
         file.json["animations"][0]["samplers"][0]["interpolation"] = "CUBICSPLINE";
       }},
      {"animations/0/samplers/0/input: names accessor -1",
       [](GltfBuilder& file) { file.json["animations"][0]["samplers"][0].erase("input"); }},
      {"animations/0/samplers/0/output: names accessor 99",
       [](GltfBuilder& file) { file.json["animations"][0]["samplers"][0]["output"] = 99; }},
      {"animations/0/samplers/0/output: have 1 components, 3 expected",
       [](GltfBuilder& file) {
         file.json["animations"][0]["samplers"][0]["output"] =
             file.json["animations"][0]["samplers"][0]["input"];
       }},
      {"animations/0/samplers/0/input: are not single numbers",
       [](GltfBuilder& file) {
         file.json["animations"][0]["samplers"][0]["input"] =
             file.json["animations"][0]["samplers"][0]["output"];
       }},
      {"animations/0/samplers/0/output: are 2 for 3 keys, 3 expected",
       [](GltfBuilder& file) { file.json["accessors"].back()["count"] = 2; }},
      {"(accessors/3): reaches past the end of its buffer view",
       [](GltfBuilder& file) { file.json["accessors"].back()["count"] = 4; }},
  };
  for (const Case& malformed : cases) {
    GltfBuilder file = square_in_node();
    animate(file, 0, "translation", {0, 1, 2}, std::vector<float>(9, 0.0F));
    malformed.edit(file);
    EXPECT_THAT(fault(file), HasSubstr(malformed.error));
    EXPECT_THAT(fault(file), HasSubstr("model.gltf: "));
    // The rest pose does not depend on animations.
    const auto rest = loaded(file.gltf());
    ASSERT_TRUE(rest) << error_of(rest);
    EXPECT_NEAR(test::measure_projected_area(*rest).front, 0.01, 1e-9);
    EXPECT_THAT(rest->warnings, ElementsAre(HasSubstr("its animations (1) are not played")));
  }
}

TEST_F(GltfAnimation, ReportsMalformedNumbers) {
  const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
  const auto with_times = [this](const std::vector<float>& times) {
    GltfBuilder file = square_in_node();
    animate(file, 0, "translation", times, std::vector<float>(3 * times.size(), 0.0F));
    return fault(file);
  };
  EXPECT_THAT(with_times({0, 1, 1}),
              HasSubstr("animations/0/samplers/0/input: time 2 is 1 s, not after the one before"));
  EXPECT_THAT(with_times({0, 2, 1}), HasSubstr("time 2 is 1 s"));
  EXPECT_THAT(with_times({-1, 2}), HasSubstr("time 0 is -1 s; give 0 or more"));
  EXPECT_THAT(with_times({0, nan}), HasSubstr("has a number that is not finite"));
  EXPECT_THAT(with_times({0, infinity}), HasSubstr("has a number that is not finite"));
  const auto with_values = [this](const std::string& path, const std::vector<float>& values) {
    GltfBuilder file = square_in_node();
    animate(file, 0, path, {0}, values);
    return fault(file);
  };
  EXPECT_THAT(with_values("translation", {0, nan, 0}), HasSubstr("output (accessors/3): has a"));
  EXPECT_THAT(with_values("scale", {1, 1, infinity}), HasSubstr("is not finite"));
  EXPECT_THAT(with_values("rotation", {0, 0, 0, 0}),
              HasSubstr("output: the rotation of key 0 is not a unit quaternion"));
  EXPECT_THAT(with_values("rotation", {0, 0, 2, 0}), HasSubstr("not a unit quaternion"));
  EXPECT_THAT(with_values("translation", {1e30F, 0, 0}), HasSubstr("a vertex lies farther than"));
  EXPECT_THAT(with_values("scale", {3e38F, 3e38F, 3e38F}), HasSubstr("a vertex lies farther than"));
  GltfBuilder file = square_in_node();
  animate(file, 0, "translation", {1}, std::vector<float>(9, 0.0F),
          {.interpolation = "CUBICSPLINE"});
  EXPECT_THAT(fault(file), HasSubstr("a CUBICSPLINE needs at least 2 keys"));
}

TEST_F(GltfAnimation, IgnoresChannelsOfExtensionsWithOneWarning) {
  GltfBuilder file = square_in_node();
  animate(file, 0, "translation", {0, 1}, std::vector<float>{0, 0, 0, 0.5F, 0, 0});
  animate(file, 0, "pointer", {0, 1}, std::vector<float>(6, 0.0F));
  animate(file, 0, "translation", {0, 1}, std::vector<float>(6, 0.0F));
  file.json["animations"][0]["channels"][2]["target"].erase("node");
  animate(file, 0, "weights", {0, 1}, std::vector<float>(2, 0.0F));
  const auto model = at(file, 1.0);
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->meshes[0].positions[0].x, 0.5F);
  EXPECT_THAT(model->warnings,
              ElementsAre(HasSubstr("animations/0/channels/1 (and 1 more): does not animate"),
                          HasSubstr("animations/0/channels/3: animates weights of a node without "
                                    "morph targets")));
}

TEST_F(GltfAnimation, LimitsNumbersOfKeys) {
  GltfBuilder file = square_in_node();
  const std::size_t input = file.accessor(std::vector<float>{0, 1, 2, 3}, "SCALAR");
  const std::size_t output = file.accessor(std::vector<float>(12, 1.0F), "VEC3");
  for (const char* path : {"translation", "scale"}) {
    test::add_channel(file, 0, path, input, output);
  }
  ModelLoadOptions reading;
  reading.pose = ModelPose{};
  reading.limits.max_vertices = 32;
  EXPECT_TRUE(load_model(write("model.gltf", file.gltf()), reading));
  reading.limits.max_vertices = 31;
  EXPECT_THAT(error_of(load_model(write("model.gltf", file.gltf()), reading)),
              HasSubstr("the animations have more than the 31 numbers allowed"));
}

TEST_F(GltfAnimation, DropsStoredKernelsOfRestPose) {
  GltfBuilder file = square_in_node();
  file.primitive()["attributes"]["_SHADOW_KERNEL"] =
      file.primitive()["attributes"]["POSITION"].get<std::size_t>();
  file.json["meshes"][0]["extras"] = {{"shadow_kernel_up", {0, 1, 0}}};
  animate(file, 0, "translation", {0, 1}, std::vector<float>{0, 0, 0, 0.5F, 0, 0});
  EXPECT_TRUE(loaded(file.gltf())->shadow_kernel_up);
  const auto model = at(file, 1.0);
  EXPECT_FALSE(model->shadow_kernel_up);
  EXPECT_THAT(model->meshes[0].shadow_kernels, IsEmpty());
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("stored shadow kernels are for the rest")));
}

// --- AnimatedModel ---

class AnimatedModelFile : public GltfAnimation {
 protected:
  std::shared_ptr<const AnimatedModel> animated(const GltfBuilder& file) {
    auto model = AnimatedModel::load(write("model.gltf", file.gltf()), "0");
    EXPECT_TRUE(model) << (model ? "" : model.error().message);
    return model.value_or(nullptr);
  }
};

TEST_F(AnimatedModelFile, HasShapesOfLoadedModels) {
  RandomTracks random;
  GltfBuilder file = test::plain_gltf(test::wavy_sheet());
  const Track turn = random.make("LINEAR", "rotation");
  add(file, 2, "rotation", turn);
  const auto model = animated(file);
  ASSERT_NE(model, nullptr);
  EXPECT_EQ(model->end_s(), static_cast<double>(turn.times.back()));
  for (const double time : {0.9, 0.3, 2.0, 0.3}) {
    const auto shape = model->at(time);
    ASSERT_TRUE(shape);
    const auto expected =
        load_model(write("model.gltf", file.gltf()), {.pose = ModelPose{"0", time}});
    ASSERT_TRUE(expected);
    EXPECT_EQ((*shape)->meshes[0].positions, expected->meshes[0].positions);
    EXPECT_EQ((*shape)->meshes[0].normals, expected->meshes[0].normals);
    EXPECT_EQ((*shape)->min_corner, expected->min_corner);
    EXPECT_EQ(model->at(time).value(), *shape) << "the same object while it is in use";
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_LE(model->box().min_corner[axis], (*shape)->min_corner[axis] + 0.02F);
      EXPECT_GE(model->box().max_corner[axis], (*shape)->max_corner[axis] - 0.02F);
    }
  }
}

TEST_F(AnimatedModelFile, ShowsObjectsThatAppearLater) {
  GltfBuilder file = square_in_node();
  animate(file, 0, "scale", {0, 1}, std::vector<float>{0, 0, 0, 1, 1, 1},
          {.interpolation = "STEP"});
  const auto model = animated(file);
  ASSERT_NE(model, nullptr);
  EXPECT_EQ(model->at(0.5).value()->triangle_count(), 0U);
  EXPECT_EQ(model->at(1.0).value()->triangle_count(), 2U);
  EXPECT_THAT(error_of(at(file, 0.5)), HasSubstr("has no triangles at this time"));
  file.json["accessors"].back()["count"] = 1;
  file.json["accessors"][file.json["accessors"].size() - 2]["count"] = 1;
  const auto hidden = AnimatedModel::load(write("model.gltf", file.gltf()), "0");
  ASSERT_FALSE(hidden);
  EXPECT_THAT(hidden.error().message, HasSubstr("shows no triangles in its animation"));
}

TEST_F(AnimatedModelFile, SharesTexturesBetweenShapes) {
  GltfBuilder file = square_in_node();
  file.primitive()["material"] = 0;
  file.primitive()["attributes"]["TEXCOORD_0"] = file.accessor(std::vector<float>(8, 0.0F), "VEC2");
  file.json["materials"] = {{{"pbrMetallicRoughness", {{"baseColorTexture", {{"index", 0}}}}}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["images"] = {{{"uri", "data:image/png;base64," +
                                      test::base64(test::png_bytes(test::one_color(1, 2, 3)))}}};
  animate(file, 0, "translation", {0, 1}, std::vector<float>{0, 0, 0, 0.5F, 0, 0});
  const auto model = animated(file);
  ASSERT_NE(model, nullptr);
  const auto first = model->at(0.0).value(), second = model->at(1.0).value();
  EXPECT_NE(first, second);
  EXPECT_EQ(first->textures.at(0), second->textures.at(0));
}

}  // namespace
}  // namespace penumbra
