// The space that a caster keeps a light away from, as a closed surface (Hudson, "Casting Fast
// Shadows for a 3D Cursor"; docs/shadows.md#volumes).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "render/model/shadow_mesh.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/casters/index_groups.hpp"

namespace penumbra {

inline constexpr unsigned kMaxVolumesCounted = 0x3FU;        // by the stencil
inline constexpr std::size_t kMaxVolumeTriangles = 200'000;  // once they are split for a lens

struct BoundingSphere {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double radius = 0.0;
  friend bool operator==(const BoundingSphere&, const BoundingSphere&) = default;
};
// Returns false if no caster in one ball can keep the light from a receiver in the other.
[[nodiscard]] bool may_shadow(const Eigen::Vector4d& light, const BoundingSphere& caster,
                              const BoundingSphere& receiver);

struct ShadowVolume {
  std::vector<glm::vec3> triangles;  // table frame [m], three points each, closed and oriented
  // The end of each batch in `triangles`. No batch is empty; each is closed and overlaps itself no
  // more often than the stencil counts.
  std::vector<std::size_t> batch_ends;
  // The light is inside a closed part of the caster. That part is skipped.
  bool light_inside = false;
  // The caster is so large or far away that its volume ends above the floors.
  bool ends_above_floors = false;
};

class VolumeCaster {
 public:
  explicit VolumeCaster(const ShadowMesh& mesh);

  // `light`: (x, y, z, w) as in projected_shadow.hpp, table frame. The volume reaches under each of
  // `floors` (infinite planes), at most to the sphere of radius `reach` [m] about the table's
  // origin, beyond which nothing receives. Parts that throw no shadow onto any of `receivers` are
  // skipped, unless there are no receivers. Empty where an input is not finite or the light is
  // under all faces.
  [[nodiscard]] ShadowVolume volume(const Placement& T_table_object,
                                    const Eigen::Vector4d& homogeneous_light,
                                    std::span<const PlaneFrame> floors, double reach,
                                    std::span<const BoundingSphere> receivers = {}) const;

 private:
  struct Edge {
    std::uint32_t a = 0, b = 0;  // a < b
  };
  struct Side {
    std::uint32_t edge = 0;
    int sign = 1;  // +1: the face runs from a to b
  };

  struct LitFaces {
    // One per face: 0 if it does not count, +1 if it is turned towards the light, -1 if it counts
    // the other way round.
    std::vector<int> turn;
    std::vector<int> by_part;  // number of faces that count
    bool light_inside = false;
  };
  // Both ends of the volume, for each position.
  struct Ends {
    std::vector<glm::vec3> near, far;
  };

  [[nodiscard]] LitFaces lit_faces(std::span<const Eigen::Vector3d> near,
                                   const std::vector<bool>& needed,
                                   const Eigen::Vector4d& homogeneous_light) const;
  // Adds the triangles of one part's faces. `silhouette`: 0 for each edge, before and after.
  void add_part(std::span<const std::uint32_t> part, const std::vector<int>& turn, const Ends& ends,
                std::vector<int>& silhouette, std::vector<glm::vec3>& triangles) const;

  std::vector<Eigen::Vector3d> positions_;
  std::vector<std::uint32_t> indices_;
  std::vector<Side> sides_;  // three per face
  std::vector<Edge> edges_;
  std::vector<std::uint32_t> part_;  // of each face
  IndexGroups faces_by_part_;
  // True for parts whose faces are closed and turned the same way: then those that the light sees
  // suffice. In other parts every face counts, turned towards the light.
  std::vector<bool> closed_;
  std::vector<BoundingSphere> spheres_;  // about each part, object frame
  std::vector<double> outside_;  // of each part: -1 where it is closed and turned inside out
};

// Points whose hull holds the volume of any caster in the hull of `points`, table frame [m]; floors
// and reach as above. Empty where that has no end, as with the light inside.
[[nodiscard]] std::vector<Eigen::Vector3d> hull_of_volume(std::span<const Eigen::Vector3d> points,
                                                          const Eigen::Vector4d& homogeneous_light,
                                                          std::span<const PlaneFrame> floors,
                                                          double reach);

// Cuts triangles so that straight edges can follow a lens, as in projected_shadow.hpp; the surface
// stays closed.
[[nodiscard]] std::vector<glm::vec3> split_for_lens(
    const std::vector<glm::vec3>& triangles, double longest_edge,
    std::size_t max_triangles = kMaxVolumeTriangles);

}  // namespace penumbra
