// Skinned glTF meshes in their rest pose: joints, weights and inverse bind matrices.
#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <random>

#include "support/gltf_builder.hpp"
#include "support/model_case.hpp"

namespace penumbra {
namespace {

using test::GltfBuilder;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class GltfSkin : public test::ModelCase {};

const std::vector<float> kIdentity = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

// A square of 0.1 m whose four vertices follow the only joint of its skin, node 1.
GltfBuilder skinned_square(const nlohmann::json& mesh_node, const nlohmann::json& joint) {
  GltfBuilder file;
  const std::size_t mesh = file.square(0.1F);
  file.primitive()["attributes"]["JOINTS_0"] =
      file.accessor(std::vector<std::uint8_t>(16, 0), "VEC4");
  std::vector<float> weights;
  for (int i = 0; i < 4; ++i) weights.insert(weights.end(), {1, 0, 0, 0});
  file.primitive()["attributes"]["WEIGHTS_0"] = file.accessor(weights, "VEC4");
  file.json["skins"] = {
      {{"joints", {1}}, {"inverseBindMatrices", file.accessor(kIdentity, "MAT4")}}};
  nlohmann::json node = mesh_node;
  node["mesh"] = mesh;
  node["skin"] = 0;
  file.node(node);
  file.node(joint);
  return file;
}

const nlohmann::json kNoFields = nlohmann::json::object();

TEST_F(GltfSkin, ScalesVerticesOfScaledJoint) {
  const auto model = loaded(
      skinned_square(kNoFields, {{"scale", {2, 2, 2}}, {"translation", {0.2, 0.05, 0}}}).gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 0.04, 1e-8);
  EXPECT_NEAR(model->min_corner.x, 0.2F, 1e-6F);
  EXPECT_NEAR(model->max_corner.x, 0.4F, 1e-6F);
  EXPECT_NEAR(model->min_corner.z, 0.05F, 1e-6F);
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(GltfSkin, IgnoresTransformOfMeshNodeAndParents) {
  GltfBuilder file = skinned_square({{"scale", {3, 3, 3}}, {"translation", {5, 0, 0}}},
                                    {{"translation", {0.2, 0, 0}}});
  file.json["nodes"].push_back({{"children", {0}}, {"scale", {7, 7, 7}}});
  file.json["scenes"][0]["nodes"] = {2, 1};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 0.01, 1e-8);
  EXPECT_NEAR(model->min_corner.x, 0.2F, 1e-6F);
}

TEST_F(GltfSkin, AppliesScaleAboveArmature) {
  GltfBuilder file = skinned_square({{"scale", {1, 1, 1}}}, {{"translation", {10, 0, 0}}});
  file.json["nodes"].push_back({{"children", {1}}, {"scale", {0.01, 0.01, 0.01}}});
  file.json["scenes"][0]["nodes"] = {0, 2};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 1e-6, 1e-11);
  EXPECT_NEAR(model->origin.x() + static_cast<double>(model->min_corner.x), 0.1, 1e-7);
}

TEST_F(GltfSkin, PlacesJointsOutsideSceneByAncestors) {
  GltfBuilder file = skinned_square(kNoFields, {{"translation", {0.5, 0, 0}}});
  file.json["nodes"].push_back({{"children", {1}}, {"translation", {0, 0.25, 0}}});
  file.json["scenes"][0]["nodes"] = {0};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->min_corner.x, 0.5F);
  EXPECT_EQ(model->min_corner.z, 0.25F);
}

TEST_F(GltfSkin, TreatsMissingInverseBindMatricesAsIdentity) {
  GltfBuilder file = skinned_square(kNoFields, {{"translation", {0.5, 0, 0}}});
  file.json["skins"][0].erase("inverseBindMatrices");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->min_corner.x, 0.5F);
}

TEST_F(GltfSkin, ReportsIgnoredInstancesOfSkinnedMesh) {
  GltfBuilder file = skinned_square(kNoFields, kNoFields);
  file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] =
      file.accessor(std::vector<float>{0, 0, 0, 1, 0, 0}, "VEC3");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->triangle_count(), 2U);
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("nodes/0: is skinned; its instances "
                                                     "(EXT_mesh_gpu_instancing) are ignored")));
}

TEST_F(GltfSkin, FollowsSkinOfEachNodeOfSharedMesh) {
  GltfBuilder file = skinned_square(kNoFields, {{"translation", {0.5, 0, 0}}});
  const std::size_t other = file.node({{"translation", {-0.5, 0, 0}}});
  file.json["skins"].push_back({{"joints", {other}}});
  file.node({{"mesh", 0}, {"skin", 1}});
  file.node({{"mesh", 0}});  // not skinned
  const auto model = loaded(file.glb(), "model.glb");
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_EQ(model->vertex_count(), 12U);
  EXPECT_EQ(model->meshes[0].positions[0].x, 0.5F);
  EXPECT_EQ(model->meshes[0].positions[4].x, -0.5F);
  EXPECT_EQ(model->meshes[0].positions[8].x, 0.0F);
}

TEST_F(GltfSkin, KeepsFrontFacesOfMirroredArmature) {
  GltfBuilder file = skinned_square(kNoFields, {{"scale", {-1, 1, 1}}});
  file.primitive()["attributes"]["NORMAL"] =
      file.accessor(std::vector<float>{0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0}, "VEC3");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  const test::ProjectedArea area = test::measure_projected_area(*model);
  EXPECT_NEAR(area.front, 0.01, 1e-8);
  EXPECT_EQ(area.back, 0.0);
  EXPECT_EQ(model->meshes[0].normals[0], glm::vec3(0, 0, 1));
}

TEST_F(GltfSkin, MovesStoredKernelsWithVertices) {
  GltfBuilder file =
      skinned_square(kNoFields, {{"scale", {2, 2, 2}}, {"translation", {0.5, 0, 0}}});
  file.primitive()["attributes"]["_SHADOW_KERNEL"] =
      file.primitive()["attributes"]["POSITION"].get<std::size_t>();
  file.json["meshes"][0]["extras"] = {{"shadow_kernel_up", {0, 1, 0}}};
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  ASSERT_TRUE(model->shadow_kernel_up);
  EXPECT_EQ(model->meshes[0].shadow_kernels, model->meshes[0].positions);
}

TEST_F(GltfSkin, NormalizesWeights) {
  GltfBuilder file = skinned_square(kNoFields, {{"translation", {0.5, 0, 0}}});
  std::vector<float> weights;
  for (int i = 0; i < 4; ++i) weights.insert(weights.end(), {0.25F, 0, 0, 0.25F});
  file.primitive()["attributes"]["WEIGHTS_0"] = file.accessor(weights, "VEC4");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_NEAR(test::measure_projected_area(*model).front, 0.01, 1e-8);
  EXPECT_EQ(model->min_corner.x, 0.5F);
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("do not add up to 1")));
}

TEST_F(GltfSkin, BindsVerticesWithoutWeightsToFirstJoint) {
  GltfBuilder file = skinned_square(kNoFields, {{"translation", {0.5, 0, 0}}});
  file.primitive()["attributes"]["WEIGHTS_0"] =
      file.accessor(std::vector<std::uint8_t>(16, 0), "VEC4", true);
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->min_corner.x, 0.5F);
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("vertices without weights")));
}

TEST_F(GltfSkin, PlacesMeshWithoutJointsAtItsNode) {
  GltfBuilder file = skinned_square({{"translation", {0.3, 0, 0}}}, kNoFields);
  file.primitive()["attributes"].erase("JOINTS_0");
  file.primitive()["attributes"].erase("WEIGHTS_0");
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->min_corner.x, 0.3F);
  EXPECT_THAT(model->warnings, ElementsAre(HasSubstr("no joints and weights for its skin")));
}

TEST_F(GltfSkin, DropsSurfaceOfZeroScaleJoints) {
  GltfBuilder file = skinned_square(kNoFields, {{"scale", {0, 0, 0}}});
  EXPECT_THAT(error_of(loaded(file.gltf())), HasSubstr("leaves no surface"));
  file.node({{"mesh", 0}});
  const auto model = loaded(file.gltf());
  ASSERT_TRUE(model) << error_of(model);
  EXPECT_EQ(model->triangle_count(), 2U);
  EXPECT_THAT(model->warnings, IsEmpty());
}

TEST_F(GltfSkin, RejectsDamageAndReportsField) {
  const auto error_with = [&](const auto& damage) {
    GltfBuilder file = skinned_square(kNoFields, kNoFields);
    damage(file);
    return error_of(loaded(file.gltf()));
  };
  const auto attribute = [](GltfBuilder& file, const char* key) -> nlohmann::json& {
    return file.primitive()["attributes"][key];
  };
  EXPECT_THAT(error_with([](auto& file) { file.json["skins"][0]["joints"] = {9}; }),
              HasSubstr("skins/0/joints: names node 9, there are 2"));
  EXPECT_THAT(error_with([](auto& file) { file.json["skins"][0]["joints"] = "1"; }),
              HasSubstr("skins/0/joints: is \"1\"; a list of whole numbers"));
  EXPECT_THAT(
      error_with([](auto& file) { file.json["skins"][0]["joints"] = nlohmann::json::array(); }),
      HasSubstr("skins/0: has no joints"));
  EXPECT_THAT(error_with([](auto& file) { file.json["nodes"][0]["skin"] = 4; }),
              HasSubstr("nodes/0/skin: names skin 4, there are 1"));
  EXPECT_THAT(error_with([](auto& file) {
                file.json["skins"][0]["joints"] = {1, 1};
              }),
              HasSubstr("skins/0/inverseBindMatrices: are 1 for 2 joints"));
  EXPECT_THAT(error_with([](auto& file) { file.json["skins"][0]["inverseBindMatrices"] = 0; }),
              HasSubstr("skins/0/inverseBindMatrices: are not 4 x 4 matrices"));
  EXPECT_THAT(error_with([](auto& file) {
                std::vector<float> matrix = kIdentity;
                matrix[3] = 1.0F;
                file.json["skins"][0]["inverseBindMatrices"] = file.accessor(matrix, "MAT4");
              }),
              HasSubstr("matrix 0 is not an affine transform"));
  EXPECT_THAT(error_with([](auto& file) {
                std::vector<float> matrix = kIdentity;
                matrix[0] = std::numeric_limits<float>::infinity();
                file.json["skins"][0]["inverseBindMatrices"] = file.accessor(matrix, "MAT4");
              }),
              HasSubstr("inverseBindMatrices (accessors/5): has a number that is not finite"));
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "JOINTS_0") =
                    file.accessor(std::vector<std::uint8_t>(16, 7), "VEC4");
              }),
              HasSubstr("attributes/JOINTS_0: vertex 0 names joint 7, the skin has 1"));
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "JOINTS_0") = file.accessor(std::vector<float>(16, 0), "VEC4");
              }),
              HasSubstr("JOINTS_0: are not unsigned integers"));
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "JOINTS_0") =
                    file.accessor(std::vector<std::uint8_t>(12, 0), "VEC4");
              }),
              HasSubstr("JOINTS_0: has 3 elements for 4 vertices"));
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "WEIGHTS_0") = file.accessor(std::vector<float>(12, 1), "VEC3");
              }),
              HasSubstr("WEIGHTS_0: has 3 components"));
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "WEIGHTS_0") =
                    file.accessor(std::vector<std::uint8_t>(16, 1), "VEC4");
              }),
              HasSubstr("WEIGHTS_0: are neither floats nor normalized unsigned integers"));
  for (const float weight : {std::nanf(""), std::numeric_limits<float>::infinity()}) {
    EXPECT_THAT(error_with([&](auto& file) {
                  attribute(file, "WEIGHTS_0") =
                      file.accessor(std::vector<float>(16, weight), "VEC4");
                }),
                HasSubstr("WEIGHTS_0 (accessors/5): has a number that is not finite"));
  }
  EXPECT_THAT(error_with([&](auto& file) {
                attribute(file, "WEIGHTS_0") = file.accessor(std::vector<float>(16, -1), "VEC4");
              }),
              HasSubstr("WEIGHTS_0: vertex 0 has a weight of -1"));
  EXPECT_THAT(error_with([&](auto& file) { file.primitive()["attributes"].erase("WEIGHTS_0"); }),
              HasSubstr("has JOINTS_0 without WEIGHTS_0"));
  EXPECT_THAT(error_with([&](auto& file) {
                file.json["nodes"][1]["scale"] = {1e300, 1e300, 1};
              }),
              HasSubstr("nodes/0"));
}

// A random skinned file with its expected vertices, computed by the formula of glTF 2.0, 3.7.3.3,
// independently of the reader.
class RandomSkin {
 public:
  explicit RandomSkin(unsigned seed) : random_(seed) {
    make_nodes();
    make_mesh();
  }

  GltfBuilder file;
  std::vector<Eigen::Vector3d> positions, normals;  // expected, in the file's axes
  bool mirrored = false;
  std::size_t set_count = 1;

 private:
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  std::size_t below(std::size_t n) { return random_() % n; }

  void make_nodes() {
    const std::size_t count = 2 + below(8);
    armature_scale_ = below(2) == 0 ? 1.0 : 0.01;
    file.node({{"mesh", 0}, {"skin", 0}, {"scale", {3, 1, 2}}, {"translation", {9, 9, 9}}});
    for (std::size_t j = 0; j < count; ++j) {
      const Eigen::Quaterniond q =
          Eigen::Quaterniond(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1), uniform(-1, 1))
              .normalized();
      const Eigen::Vector3d t(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1));
      const bool root = j == 0;
      const double s = root ? armature_scale_ : uniform(0.5, 2.0);
      nlohmann::json node = {{"translation", {t.x(), t.y(), t.z()}},
                             {"rotation", {q.x(), q.y(), q.z(), q.w()}},
                             {"scale", {s, s, s}}};
      Eigen::Matrix4d local = Eigen::Matrix4d::Identity();
      local.topLeftCorner<3, 3>() = s * q.toRotationMatrix();
      local.topRightCorner<3, 1>() = t;
      file.json["nodes"].push_back(node);
      const std::size_t parent = root ? 0 : below(j);
      T_root_joint_.push_back(root ? local : Eigen::Matrix4d(T_root_joint_[parent] * local));
      if (!root) file.json["nodes"][1 + parent]["children"].push_back(1 + j);
    }
    // In half of the files the armature is part of the scene graph.
    if (below(2) == 0) file.json["scenes"][0]["nodes"].push_back(1);
    std::vector<float> matrices;
    nlohmann::json joints;
    for (std::size_t j = 0; j < count; ++j) {
      // Inverse of a random bind pose that has the armature's scale.
      Eigen::Affine3d bind = Eigen::Affine3d::Identity();
      bind.translate(Eigen::Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1)));
      bind.rotate(Eigen::AngleAxisd(uniform(-3, 3), Eigen::Vector3d::UnitY()));
      bind.scale(armature_scale_ * uniform(0.8, 1.25));
      const Eigen::Matrix4f inverse = bind.inverse().matrix().cast<float>();
      matrices.insert(matrices.end(), inverse.data(), inverse.data() + 16);
      joint_matrices_.emplace_back(T_root_joint_[j] * inverse.cast<double>());
      joints.push_back(1 + j);
    }
    file.json["skins"] = {
        {{"joints", joints}, {"inverseBindMatrices", file.accessor(matrices, "MAT4")}}};
  }

  // Writes one set of four weights in the given encoding and returns the decoded values.
  template <class T>
  std::vector<double> add_weights(const std::string& key, const std::vector<double>& weights,
                                  double largest) {
    std::vector<T> coded;
    std::vector<double> decoded;
    for (const double weight : weights) {
      coded.push_back(static_cast<T>(largest == 1.0 ? weight : std::round(weight * largest)));
      decoded.push_back(static_cast<double>(coded.back()) / largest);
    }
    file.primitive()["attributes"][key] = file.accessor(coded, "VEC4", largest != 1.0);
    return decoded;
  }

  void make_mesh() {
    constexpr std::size_t kVertices = 12;
    std::vector<float> points, directions;
    std::vector<std::uint16_t> corners;
    for (std::size_t i = 0; i < kVertices; ++i) {
      for (int c = 0; c < 3; ++c) points.push_back(static_cast<float>(uniform(-1, 1)));
      const Eigen::Vector3f n = Eigen::Vector3d(uniform(-1, 1), uniform(-1, 1), uniform(-1, 1))
                                    .normalized()
                                    .cast<float>();
      directions.insert(directions.end(), {n.x(), n.y(), n.z()});
      corners.push_back(static_cast<std::uint16_t>(i));
    }
    file.mesh(points, corners);
    file.primitive()["attributes"]["NORMAL"] = file.accessor(directions, "VEC3");
    set_count = 1 + below(3);
    std::vector<std::vector<std::uint16_t>> joints(set_count);
    std::vector<std::vector<double>> weights(set_count);
    for (std::size_t i = 0; i < kVertices; ++i) {
      std::vector<double> of_vertex(4 * set_count);
      double sum = 0.0;
      for (double& weight : of_vertex) sum += weight = below(3) == 0 ? 0.0 : uniform(0, 1);
      if (sum == 0.0) sum = of_vertex[0] = 1.0;
      for (std::size_t k = 0; k < of_vertex.size(); ++k) {
        weights[k / 4].push_back(of_vertex[k] / sum);
        joints[k / 4].push_back(static_cast<std::uint16_t>(below(joint_matrices_.size())));
      }
    }
    const std::size_t encoding = below(3);
    for (std::size_t set = 0; set < set_count; ++set) {
      const std::string key = "WEIGHTS_" + std::to_string(set);
      weights[set] = encoding == 0   ? add_weights<float>(key, weights[set], 1.0)
                     : encoding == 1 ? add_weights<std::uint8_t>(key, weights[set], 255.0)
                                     : add_weights<std::uint16_t>(key, weights[set], 65535.0);
      const std::vector<std::uint8_t> bytes(joints[set].begin(), joints[set].end());
      file.primitive()["attributes"]["JOINTS_" + std::to_string(set)] =
          below(2) == 0 ? file.accessor(bytes, "VEC4") : file.accessor(joints[set], "VEC4");
    }
    for (std::size_t i = 0; i < kVertices; ++i) {
      const Eigen::Vector4d p(points[3 * i], points[3 * i + 1], points[3 * i + 2], 1.0);
      const Eigen::Vector3d n(directions[3 * i], directions[3 * i + 1], directions[3 * i + 2]);
      Eigen::Vector3d moved = Eigen::Vector3d::Zero();
      Eigen::Matrix3d linear = Eigen::Matrix3d::Zero();
      double sum = 0.0;
      for (std::size_t set = 0; set < set_count; ++set) {
        for (std::size_t k = 4 * i; k < 4 * i + 4; ++k) sum += weights[set][k];
      }
      for (std::size_t set = 0; set < set_count; ++set) {
        for (std::size_t k = 4 * i; k < 4 * i + 4; ++k) {
          const Eigen::Matrix4d& M = joint_matrices_[joints[set][k]];
          moved += weights[set][k] / sum * (M * p).head<3>();
          linear += weights[set][k] / sum * M.topLeftCorner<3, 3>();
        }
      }
      positions.push_back(moved);
      const Eigen::Vector3d normal = linear.inverse().transpose() * n;
      // The normal is compared only if the blended matrix does not nearly flatten space.
      const bool comparable = std::abs(linear.determinant()) > 1e-3 * std::pow(linear.norm(), 3);
      normals.push_back(comparable ? normal.normalized()
                                   : Eigen::Vector3d(Eigen::Vector3d::Zero()));
    }
  }

  std::mt19937 random_;
  double armature_scale_ = 1.0;
  std::vector<Eigen::Matrix4d> T_root_joint_, joint_matrices_;
};

TEST_F(GltfSkin, MatchesFormulaForRandomArmatures) {
  std::size_t normals = 0;
  for (unsigned seed = 0; seed < 200; ++seed) {
    const RandomSkin skin(seed);
    const auto model = loaded(skin.file.glb(), "model.glb");
    ASSERT_TRUE(model) << error_of(model) << " seed " << seed;
    ASSERT_EQ(model->meshes.size(), 1U);
    const Mesh& mesh = model->meshes[0];
    ASSERT_EQ(mesh.positions.size(), skin.positions.size());
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const auto expect_vector = [&](const glm::vec3& got, const Eigen::Vector3d& expected,
                                     double tolerance) {
        // The object frame is (x, -z, y) in the file's axes.
        EXPECT_NEAR(got.x, expected.x(), tolerance) << "seed " << seed << " vertex " << i;
        EXPECT_NEAR(got.y, -expected.z(), tolerance) << "seed " << seed << " vertex " << i;
        EXPECT_NEAR(got.z, expected.y(), tolerance) << "seed " << seed << " vertex " << i;
      };
      expect_vector(mesh.positions[i], skin.positions[i], 1e-6 * (1.0 + skin.positions[i].norm()));
      if (skin.normals[i].isZero()) continue;
      ++normals;
      expect_vector(mesh.normals[i], skin.normals[i], 1e-5);
    }
  }
  EXPECT_GT(normals, 1500U);
}

TEST_F(GltfSkin, MatchesSizeAndPositionOfSharedCases) {
  const auto scaled = shared_case("gltf-skin-ignored/skin_joint_scaled.gltf");
  if (!scaled) GTEST_SKIP() << "no shared data beside the checkout";
  ASSERT_TRUE(*scaled) << error_of(*scaled);
  EXPECT_NEAR(test::measure_projected_area(**scaled).front, 0.04, 1e-7);
  EXPECT_NEAR((*scaled)->min_corner.x, 0.2F, 1e-6F);
  EXPECT_NEAR((*scaled)->max_corner.x, 0.4F, 1e-6F);
  const auto ignored = shared_case("gltf-skin-ignored/skin_node_transform_ignored.gltf");
  ASSERT_TRUE(ignored && *ignored) << error_of(*ignored);
  EXPECT_NEAR(test::measure_projected_area(**ignored).front, 0.01, 1e-7);
  EXPECT_NEAR((*ignored)->min_corner.x, 0.2F, 1e-6F);
  EXPECT_NEAR((*ignored)->max_corner.x, 0.3F, 1e-6F);
  const auto simple = shared_case("gltf-skin-ignored/simple_skin-khronos.gltf", UpAxis::z);
  ASSERT_TRUE(simple && *simple) << error_of(*simple);
  EXPECT_NEAR((*simple)->min_corner.x, -0.5F, 1e-6F);
  EXPECT_NEAR((*simple)->max_corner.x, 0.5F, 1e-6F);
  // Each of the ten joints maps the 2 m by 2 m plane to 200 m by 200 m. The weights of all three
  // sets sum to 1.
  const auto quad = shared_case("gltf-skin-ignored/quad_skin-assimp.glb");
  ASSERT_TRUE(quad && *quad) << error_of(*quad);
  double area = 0.0;
  for (const glm::dvec3& axis : {glm::dvec3(1, 0, 0), glm::dvec3(0, 1, 0), glm::dvec3(0, 0, 1)}) {
    const test::ProjectedArea seen = test::measure_projected_area(**quad, axis);
    area = std::max({area, seen.front, seen.back});
  }
  EXPECT_NEAR(area, 4e4, 4e4 * 1e-5);
  const auto damaged = shared_case("gltf-damaged-skins/joint-out-of-range.gltf");
  ASSERT_TRUE(damaged);
  EXPECT_THAT(error_of(*damaged), HasSubstr("JOINTS_0: vertex 0 names joint 7, the skin has 3"));
}

}  // namespace
}  // namespace penumbra
