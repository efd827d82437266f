// Which faces of a mesh are seen, by the opacity of its material: textures with alpha cut leaves
// and fences out of plain faces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "render/model/model.hpp"

namespace penumbra {

// The alpha of a texture, with the least and the greatest of every square of 2^n texels.
class AlphaPyramid {
 public:
  AlphaPyramid(const Texture& texture, const TextureSampling& sampling);

  struct Range {
    double least = 1.0;
    double greatest = 1.0;
  };
  // Bounds of at() between two corners of a rectangle of texture coordinates.
  [[nodiscard]] Range range(const glm::dvec2& low, const glm::dvec2& high) const;
  [[nodiscard]] double at(const glm::dvec2& texcoord) const;  // 0 to 1

  [[nodiscard]] glm::dvec2 size() const { return {width_, height_}; }  // [texels]

 private:
  struct Level {
    std::int64_t width = 0;
    std::int64_t height = 0;
    std::vector<std::uint8_t> least;
    std::vector<std::uint8_t> greatest;
  };
  std::int64_t width_;
  std::int64_t height_;
  TextureSampling sampling_;
  std::vector<Level> levels_;
};

enum class FaceSight { hidden, partial, whole };

// The faces of one mesh.
class FaceOpacity {
 public:
  FaceOpacity(const Model& model, const Mesh& mesh);

  // True if no face of the mesh can be transparent anywhere.
  [[nodiscard]] bool all_whole() const { return all_whole_; }
  // `index`: of the face's first corner in Mesh::indices. Faces with alpha mode BLEND are partial
  // nowhere: they are hidden where nothing of them is seen, else whole.
  [[nodiscard]] FaceSight sight(std::size_t index) const;
  // Appends the triangles that are seen of a face, three corners each. Edges of the texture are
  // followed by 2^depth steps along an edge of the face, or by quarters of a texel.
  void append_seen(std::size_t index, int depth, std::vector<glm::vec3>& corners) const;

 private:
  struct Corner {
    glm::dvec3 position;
    glm::dvec2 texcoord;
    double factor;  // opacity without the texture
  };
  struct Face {
    Corner a, b, c;
  };
  [[nodiscard]] Face face(std::size_t index) const;
  [[nodiscard]] FaceSight bounds(const Face& face) const;
  [[nodiscard]] double excess(const Corner& corner) const;
  // Calls `take` for each triangle that is seen until it returns false.
  template <class Take>
  bool walk(const Face& face, int depth, const Take& take) const;

  const Mesh& mesh_;
  Material material_;
  const std::vector<glm::vec2>* texcoords_ = nullptr;  // of the texture
  std::optional<AlphaPyramid> alpha_;
  bool all_whole_ = true;
};

// True if some face of the model is visible in part (alpha mode MASK).
[[nodiscard]] bool has_cut_outs(const Model& model);

// The finest steps, by FaceOpacity::append_seen(), with which what is seen of the model's partial
// faces is at most `most_triangles`; 0 where even those are more.
[[nodiscard]] int cut_out_depth(const Model& model, std::size_t most_triangles);

// A line for the user where whole faces of a model with cut-outs cast. `file`: what the line is
// about.
[[nodiscard]] std::string warning_of_cut_outs(const std::string& file);

}  // namespace penumbra
