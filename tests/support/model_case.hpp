// Models of tests: written to a folder of the test, and read from the shared cases.
#pragma once

#include <gtest/gtest.h>

#include <fstream>
#include <glm/geometric.hpp>
#include <string>

#include "render/model/model.hpp"
#include "support/paths.hpp"

namespace penumbra::test {

class ModelCase : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& name, const std::string& text) {
    const std::filesystem::path file = folder_.path() / name;
    std::filesystem::remove(file);
    std::ofstream(file, std::ios::binary) << text;
    return file;
  }
  Result<Model> loaded(const std::string& text, const std::string& name = "model.gltf") {
    return load_model(write(name, text));
  }
  static std::string error_of(const Result<Model>& model) {
    return model ? "was accepted" : model.error().message;
  }
  // Reads a model of the shared cases; returns nullopt without shared data beside the checkout.
  static std::optional<Result<Model>> shared_case(const std::string& file,
                                                  UpAxis up = UpAxis::by_format) {
    const std::filesystem::path folder = shared_dir();
    if (folder.empty()) return std::nullopt;
    return load_model(folder / "cases" / file, {.up = up});
  }

  TemporaryFolder folder_;
};

// Projected areas of a model's faces along `direction` (unit): `front` sums the faces towards the
// viewer, `back` the others. If the faces do not overlap, each sum equals the area of their shadow.
struct ProjectedArea {
  double front = 0.0;
  double back = 0.0;
};
inline ProjectedArea measure_projected_area(const Model& model,
                                            const glm::dvec3& direction = {0.0, 0.0, 1.0}) {
  ProjectedArea area;
  for (const Mesh& mesh : model.meshes) {
    for (std::size_t t = 0; t + 2 < mesh.indices.size(); t += 3) {
      const glm::dvec3 a(mesh.positions[mesh.indices[t]]), b(mesh.positions[mesh.indices[t + 1]]),
          c(mesh.positions[mesh.indices[t + 2]]);
      const double seen = 0.5 * glm::dot(glm::cross(b - a, c - a), direction);
      (seen > 0.0 ? area.front : area.back) += std::abs(seen);
    }
  }
  return area;
}

}  // namespace penumbra::test
