// Determines the visible regions of faces with alpha-tested textures, such as leaves and fences.
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

// The alpha channel of a texture, with the minimum and maximum of each square of 2^n texels a side.
class AlphaPyramid {
 public:
  AlphaPyramid(const Texture& texture, const TextureSampling& sampling);

  struct Range {
    double min_alpha = 1.0, max_alpha = 1.0;
  };
  // Returns bounds of at() in a rectangle of texture coordinates.
  [[nodiscard]] Range range(const glm::dvec2& low, const glm::dvec2& high) const;
  [[nodiscard]] double at(const glm::dvec2& texcoord) const;  // 0 to 1

  [[nodiscard]] glm::dvec2 size() const { return {width_, height_}; }  // [texels]

 private:
  struct Level {
    std::int64_t width = 0, height = 0;
    std::vector<std::uint8_t> min_alpha, max_alpha;
  };
  std::int64_t width_;
  std::int64_t height_;
  TextureSampling sampling_;
  std::vector<Level> levels_;
};

enum class FaceVisibility { hidden, partial, whole };

// Opacity of the faces of one mesh.
class FaceOpacity {
 public:
  FaceOpacity(const Model& model, const Mesh& mesh);

  // Returns true if all faces of the mesh are known to be whole.
  [[nodiscard]] bool all_whole() const { return all_whole_; }
  // `index`: position of the face's first corner in Mesh::indices. Faces with alpha mode BLEND are
  // hidden if fully transparent, else whole, never partial.
  [[nodiscard]] FaceVisibility visibility(std::size_t index) const;
  // Appends the visible triangles of a face, three corners each. Their resolution is 2^depth steps
  // along an edge of the face, or a quarter of a texel if that is coarser.
  void append_visible(std::size_t index, int depth, std::vector<glm::vec3>& corners) const;

 private:
  struct Corner {
    glm::dvec3 position;
    glm::dvec2 texcoord;
    double factor;  // opacity before multiplication by the texture
  };
  struct Face {
    Corner a, b, c;
    [[nodiscard]] glm::dvec2 min_texcoord() const;
    [[nodiscard]] glm::dvec2 max_texcoord() const;
  };
  [[nodiscard]] Face face(std::size_t index) const;
  [[nodiscard]] FaceVisibility bounds(const Face& face) const;
  [[nodiscard]] double excess(const Corner& corner) const;
  // Calls the function for each visible triangle until it returns false. Then returns false.
  template <class Visitor>
  bool walk(const Face& face, int depth, const Visitor& visit) const;

  const Mesh& mesh_;
  Material material_;
  const std::vector<glm::vec2>* texcoords_ = nullptr;  // the set that the texture uses
  std::optional<AlphaPyramid> alpha_;
  bool all_whole_ = true;
};

// Returns true if some face of the model is partially visible (alpha mode MASK).
[[nodiscard]] bool has_cut_outs(const Model& model);

// Returns the maximum depth for append_visible() at which the model's partial faces have up to
// `max_triangles` visible triangles, or 0.
[[nodiscard]] int cut_out_depth(const Model& model, std::size_t max_triangles);

// Returns the warning that the model `file` has cut-outs but casts shadows of whole faces.
[[nodiscard]] std::string warning_of_cut_outs(const std::string& file);

}  // namespace penumbra
