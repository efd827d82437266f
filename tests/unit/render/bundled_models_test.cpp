// The files in scenes/models equal the output of make_models, and the models are suitable for
// drawing and for casting shadows.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <glm/geometric.hpp>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "core/text/text.hpp"
#include "render/model/animated_model.hpp"
#include "support/paths.hpp"
#include "tools/models/animated_models.hpp"
#include "tools/models/bundled_models.hpp"
#include "tools/models/glb_writer.hpp"

namespace penumbra {
namespace {

std::filesystem::path models_dir() {
  return test::source_dir() / "scenes" / "models";
}

const std::vector<Model>& bundled_models() {
  static const std::vector<Model> models = models::make_bundled_models();
  return models;
}

std::size_t triangle_count(const Model& model) {
  std::size_t count = 0;
  for (const Mesh& mesh : model.meshes) count += mesh.indices.size() / 3;
  return count;
}

// All meshes of one name form a part. Vertices share positions where two materials meet.
struct Part {
  std::map<std::array<float, 3>, std::size_t> points;
  std::vector<std::array<std::size_t, 3>> faces;
};

std::map<std::string, Part> parts_of(const Model& model) {
  std::map<std::string, Part> parts;
  for (const Mesh& mesh : model.meshes) {
    Part& part = parts[mesh.name];
    for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
      std::array<std::size_t, 3> face{};
      for (std::size_t k = 0; k < 3; ++k) {
        const glm::vec3& p = mesh.positions[mesh.indices[i + k]];
        face[k] = part.points.try_emplace({p.x, p.y, p.z}, part.points.size()).first->second;
      }
      part.faces.push_back(face);
    }
  }
  return parts;
}

// Counts the edges that are not traversed exactly once in each direction.
std::size_t open_edges(const Part& part) {
  std::map<std::pair<std::size_t, std::size_t>, int> runs;
  for (const auto& face : part.faces)
    for (std::size_t k = 0; k < 3; ++k) ++runs[{face[k], face[(k + 1) % 3]}];
  std::size_t open = 0;
  for (const auto& [edge, count] : runs) {
    const auto back = runs.find({edge.second, edge.first});
    if (count != 1 || back == runs.end() || back->second != 1) ++open;
  }
  return open;
}

// Signed volume [m^3] of every connected surface: positive if its faces point outwards.
std::vector<double> volumes(const Part& part) {
  std::vector<std::size_t> root(part.points.size());
  for (std::size_t i = 0; i < root.size(); ++i) root[i] = i;
  const auto find = [&root](std::size_t i) {
    while (root[i] != i) i = root[i] = root[root[i]];
    return i;
  };
  std::vector<glm::dvec3> points(part.points.size());
  for (const auto& [p, i] : part.points) points[i] = {p[0], p[1], p[2]};
  for (const auto& face : part.faces) {
    root[find(face[0])] = find(face[1]);
    root[find(face[1])] = find(face[2]);
  }
  std::map<std::size_t, double> volume;
  for (const auto& face : part.faces) {
    const std::size_t r = find(face[0]);
    volume[r] += glm::dot(points[face[0]] - points[r],
                          glm::cross(points[face[1]] - points[r], points[face[2]] - points[r])) /
                 6.0;
  }
  std::vector<double> all;
  for (const auto& [r, v] : volume) all.push_back(v);
  return all;
}

TEST(BundledModels, MatchFilesWrittenByMakeModels) {
  std::set<std::string> expected;
  const auto check = [&expected](const std::string& model,
                                 const Result<std::vector<std::uint8_t>>& made) {
    const std::string name = model + ".glb";
    expected.insert(name);
    ASSERT_TRUE(made) << made.error().message;
    const test::TemporaryFolder folder;
    ASSERT_TRUE(write_file(folder.path() / name, *made));
    const auto fresh = read_file(folder.path() / name);
    const auto shipped = read_file(models_dir() / name);
    ASSERT_TRUE(fresh) << fresh.error().message;
    ASSERT_TRUE(shipped) << shipped.error().message;
    EXPECT_TRUE(*fresh == *shipped)
        << name << " is not what make_models writes now; run make_models scenes/models";
  };
  for (const Model& model : bundled_models()) check(model.name, models::encode_glb(model));
  for (const models::MovingModel& moving : models::make_moving_models())
    check(moving.model.name, models::encode_glb(moving));
  std::set<std::string> present;
  for (const auto& entry : std::filesystem::directory_iterator(models_dir()))
    if (entry.path().extension() == ".glb") present.insert(entry.path().filename().string());
  EXPECT_EQ(present, expected);
}

TEST(BundledModels, AreGeneratedDeterministically) {
  const std::vector<Model> again = models::make_bundled_models();
  ASSERT_EQ(again.size(), bundled_models().size());
  for (std::size_t i = 0; i < again.size(); ++i) {
    const auto a = models::encode_glb(again[i]);
    const auto b = models::encode_glb(bundled_models()[i]);
    ASSERT_TRUE(a && b);
    EXPECT_TRUE(*a == *b) << again[i].name;
  }
}

TEST(BundledModels, HaveSmallFiles) {
  std::uintmax_t sum = 0;
  for (const auto& entry : std::filesystem::directory_iterator(models_dir())) {
    EXPECT_LT(entry.file_size(), 1'500'000U) << entry.path();
    sum += entry.file_size();
  }
  EXPECT_LT(sum, 4'000'000U);
}

TEST(BundledModels, HaveValidNumbers) {
  for (const Model& model : bundled_models()) {
    for (const Mesh& mesh : model.meshes) {
      SCOPED_TRACE(model.name + ": " + mesh.name);
      ASSERT_EQ(mesh.positions.size(), mesh.normals.size());
      ASSERT_EQ(mesh.indices.size() % 3, 0U);
      ASSERT_FALSE(mesh.indices.empty());
      ASSERT_LT(static_cast<std::size_t>(mesh.material), model.materials.size());
      EXPECT_LT(*std::max_element(mesh.indices.begin(), mesh.indices.end()), mesh.positions.size());
      for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
        for (glm::length_t axis = 0; axis < 3; ++axis) {
          ASSERT_TRUE(std::isfinite(mesh.positions[i][axis]));
          ASSERT_LE(std::abs(mesh.positions[i][axis]), 0.2F);
        }
        ASSERT_NEAR(glm::length(mesh.normals[i]), 1.0F, 2e-5F);
      }
    }
  }
}

TEST(BundledModels, HaveNoDegenerateFaces) {
  for (const Model& model : bundled_models()) {
    for (const Mesh& mesh : model.meshes) {
      double thinnest = 1.0;
      for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        const glm::dvec3 a = mesh.positions[mesh.indices[i]];
        const glm::dvec3 b = mesh.positions[mesh.indices[i + 1]];
        const glm::dvec3 c = mesh.positions[mesh.indices[i + 2]];
        const double twice_area = glm::length(glm::cross(b - a, c - a));
        const double longest =
            std::max({glm::distance(a, b), glm::distance(b, c), glm::distance(c, a)});
        ASSERT_GT(longest, 0.0) << model.name << ": " << mesh.name;
        thinnest = std::min(thinnest, twice_area / longest);
      }
      EXPECT_GT(thinnest, 5e-6) << model.name << ": " << mesh.name << " [m]";
    }
  }
}

// Winding and shading normals agree: each normal points to the front of its face.
TEST(BundledModels, HaveNormalsAlignedWithFaces) {
  for (const Model& model : bundled_models()) {
    for (const Mesh& mesh : model.meshes) {
      std::size_t against = 0;
      for (std::size_t i = 0; i < mesh.indices.size(); i += 3) {
        const glm::vec3& a = mesh.positions[mesh.indices[i]];
        const glm::vec3 n = glm::cross(mesh.positions[mesh.indices[i + 1]] - a,
                                       mesh.positions[mesh.indices[i + 2]] - a);
        for (std::size_t k = 0; k < 3; ++k)
          if (glm::dot(n, mesh.normals[mesh.indices[i + k]]) <= 0.0F) ++against;
      }
      EXPECT_EQ(against, 0U) << model.name << ": " << mesh.name;
    }
  }
}

TEST(BundledModels, HaveClosedPartsFacingOutwards) {
  for (const Model& model : bundled_models()) {
    for (const auto& [name, part] : parts_of(model)) {
      EXPECT_EQ(open_edges(part), 0U) << model.name << ": " << name;
      for (const double volume : volumes(part))
        EXPECT_GT(volume, 0.0) << model.name << ": " << name;
    }
  }
}

TEST(ClosednessCheck, DetectsOpenPart) {
  Model sphere = models::make_sphere();
  sphere.meshes.front().indices.resize(sphere.meshes.front().indices.size() - 3);
  EXPECT_EQ(open_edges(parts_of(sphere).begin()->second), 3U);
}

TEST(BundledModels, MatchAnalyticVolumes) {
  const auto volume = [](const Model& model) {
    return volumes(parts_of(model).begin()->second).front() * 1e9;  // [mm^3]
  };
  EXPECT_NEAR(volume(models::make_cube()), 64000.0, 1.0);
  EXPECT_NEAR(volume(models::make_bar()), 17280.0, 1.0);
  EXPECT_NEAR(volume(models::make_l_shape()), 20.0 * (60.0 * 20.0 + 40.0 * 20.0), 1.0);
  // Inscribed facets enclose slightly less than the round body.
  EXPECT_NEAR(volume(models::make_sphere()) / (4.0 / 3.0 * M_PI * std::pow(25.0, 3)), 0.99, 0.01);
  EXPECT_NEAR(volume(models::make_ring()) / (2.0 * M_PI * 40.0 * M_PI * 64.0), 0.98, 0.015);
  EXPECT_NEAR(volume(models::make_tube()) / (M_PI * 60.0 * (400.0 - 225.0)), 0.9972, 0.0005);
}

TEST(BundledModels, StandAtTheirDocumentedOrigin) {
  for (const Model& model : bundled_models()) {
    const bool rotor = model.name.find("rotor") != std::string::npos;
    if (!rotor) {
      EXPECT_NEAR(model.min_corner.z, 0.0F, 1e-6F) << model.name;
      continue;
    }
    // A rotor turns about its origin, so its bounding box is centred there.
    const glm::length_t axis = model.name == "helicopter_rotor" ? 2 : 1;
    EXPECT_LT(model.max_corner[axis] - model.min_corner[axis], 0.006F) << model.name;
    const glm::length_t across = axis == 2 ? 1 : 2;
    EXPECT_NEAR(-model.min_corner[across], model.max_corner[across],
                0.03F * model.max_corner[across])
        << model.name;
  }
}

TEST(BundledModels, IncludeHelicopterOfDocumentedSize) {
  const Model helicopter = models::make_helicopter();
  const Model rotor = models::make_helicopter_rotor();
  const Model tail_rotor = models::make_helicopter_tail_rotor();
  const float length = helicopter.max_corner.x - helicopter.min_corner.x;
  EXPECT_GT(length, 0.125F);
  EXPECT_LT(length, 0.14F);
  EXPECT_GT(triangle_count(helicopter), 2000U);
  EXPECT_LT(triangle_count(helicopter) + triangle_count(rotor) + triangle_count(tail_rotor), 8000U);

  // The mast ends at the main rotor's hub, and the body does not reach the blades.
  const auto parts = parts_of(helicopter);
  double mast_top = 0.0;
  for (const auto& [p, i] : parts.at("mast").points) mast_top = std::max<double>(mast_top, p[2]);
  EXPECT_NEAR(mast_top, models::kMastTop.z, 1e-6);
  float body_radius = 0.0F;
  for (const Mesh& mesh : rotor.meshes)
    for (const glm::vec3& p : mesh.positions)
      body_radius = std::max(body_radius, std::hypot(p.x, p.y));
  const float lowest = static_cast<float>(models::kMastTop.z) + rotor.min_corner.z;
  for (const auto& [name, part] : parts) {
    if (name == "mast") continue;
    for (const auto& [p, i] : part.points)
      EXPECT_FALSE(std::hypot(p[0], p[1]) <= body_radius && p[2] >= lowest) << name;
  }
}

TEST(BundledModels, IncludeTreeAndHandOfRequiredComplexity) {
  const auto welded = [](const Model& model) {
    std::size_t count = 0;
    for (const auto& [name, part] : parts_of(model)) count += part.points.size();
    return count;
  };
  const Model tree = models::make_tree();
  EXPECT_GT(welded(tree), 12'000U);
  EXPECT_GT(triangle_count(tree), 23'000U);
  std::size_t surfaces = 0;
  for (const auto& [name, part] : parts_of(tree)) surfaces += volumes(part).size();
  EXPECT_GT(surfaces, 100U);
  const Model hand = models::make_hand();
  EXPECT_GT(welded(hand), 1'200U);
  EXPECT_LT(welded(hand), 1'800U);
  EXPECT_EQ(volumes(parts_of(hand).begin()->second).size(), 1U);
}

TEST(MovingModels, LoadWithTheirAnimationAndWithoutWarnings) {
  for (const models::MovingModel& moving : models::make_moving_models()) {
    const auto file = models_dir() / (moving.model.name + ".glb");
    const auto rest = load_model(file);
    ASSERT_TRUE(rest) << rest.error().message;
    EXPECT_TRUE(rest->warnings.size() == 1) << "of the animation, which is not chosen";
    const auto animated = AnimatedModel::load(file, moving.motion.name);
    ASSERT_TRUE(animated) << animated.error().message;
    EXPECT_EQ((*animated)->end_s(), moving.motion.duration_s);
    const auto shape = (*animated)->at(0.0).value();
    EXPECT_TRUE(shape->warnings.empty());
    EXPECT_EQ(shape->triangle_count(), triangle_count(moving.model));
    EXPECT_EQ(shape->meshes[0].positions,
              (*animated)->at((*animated)->end_s()).value()->meshes[0].positions)
        << "the motion repeats";
    // On the table, within 3 mm.
    EXPECT_NEAR((*animated)->box().min_corner.z, 0.0F, 0.003F) << moving.model.name;
  }
}

TEST(MovingModels, HaveClosedPartsAndWeightsOfSumOne) {
  for (const models::MovingModel& moving : models::make_moving_models()) {
    std::vector<Model> shapes = moving.targets;
    shapes.push_back(moving.model);
    for (const Model& shape : shapes) {
      for (const auto& [name, part] : parts_of(shape)) {
        EXPECT_EQ(open_edges(part), 0U) << shape.name << ": " << name;
        for (const double volume : volumes(part)) EXPECT_GT(volume, 0.0) << shape.name;
      }
    }
    for (std::size_t mesh = 0; mesh < moving.skin.size(); ++mesh) {
      ASSERT_EQ(moving.skin[mesh].size(), moving.model.meshes[mesh].positions.size());
      for (const models::BoneWeights& of_vertex : moving.skin[mesh]) {
        float sum = 0.0F;
        for (const float weight : of_vertex.weights) sum += weight;
        ASSERT_EQ(sum, 1.0F);
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
