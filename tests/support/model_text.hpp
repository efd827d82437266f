// Models from text in temporary folders, and their areas.
#pragma once

#include <fstream>
#include <string>

#include "render/model/model.hpp"
#include "render/model/to_eigen.hpp"
#include "support/paths.hpp"

#include <Eigen/Geometry>

namespace penumbra::test {

// Folder that models are written to and read from.
class ModelFolder {
 public:
  std::filesystem::path write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_.path() / name, std::ios::binary) << text;
    return folder_.path() / name;
  }
  [[nodiscard]] Result<Model> obj(const std::string& text) const {
    return load_model(write("model.obj", text));
  }
  [[nodiscard]] const std::filesystem::path& path() const { return folder_.path(); }

 private:
  TemporaryFolder folder_;
};

// Sum of area times normal over the triangles [m^2]; zero for a closed surface.
[[nodiscard]] inline Eigen::Vector3d area_vector(const Model& model) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Mesh& mesh : model.meshes) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      const auto corner = [&](std::size_t k) {
        return to_eigen(mesh.positions[mesh.indices[i + k]]);
      };
      sum += 0.5 * (corner(1) - corner(0)).cross(corner(2) - corner(0));
    }
  }
  return sum;
}

// Sum of the triangles' areas, for any orientation [m^2].
[[nodiscard]] inline double area_of(const Model& model) {
  double sum = 0.0;
  for (const Mesh& mesh : model.meshes) {
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      const auto corner = [&](std::size_t k) {
        return to_eigen(mesh.positions[mesh.indices[i + k]]);
      };
      sum += 0.5 * (corner(1) - corner(0)).cross(corner(2) - corner(0)).norm();
    }
  }
  return sum;
}

}  // namespace penumbra::test
