// Shadow volume: the space in which a caster blocks a light, as a closed surface (Hudson, "Adding
// Shadows to a 3D Cursor"; docs/shadows.md#volumes).
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

inline constexpr unsigned kMaxVolumesCounted = 0x3FU;        // limit of the stencil counter
inline constexpr std::size_t kMaxVolumeTriangles = 200'000;  // after split_for_lens()

struct BoundingSphere {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double radius = 0.0;
  friend bool operator==(const BoundingSphere&, const BoundingSphere&) = default;
};
// Returns false if no object in the sphere `caster` can shadow any point of the sphere `receiver`.
[[nodiscard]] bool may_shadow(const Eigen::Vector4d& light, const BoundingSphere& caster,
                              const BoundingSphere& receiver);

struct ShadowVolume {
  std::vector<glm::vec3> triangles;  // table frame [m], three points each, closed and oriented
  // The end of each batch in `triangles`. Each batch is non-empty and closed, and overlaps itself
  // no more often than kMaxVolumesCounted.
  std::vector<std::size_t> batch_ends;
  // The light is inside a closed part of the caster, which is skipped.
  bool light_inside = false;
  // The caster is so large or far away that its volume ends above the floors.
  bool ends_above_floors = false;
};

class VolumeCaster {
 public:
  explicit VolumeCaster(const ShadowMesh& mesh);

  // `homogeneous_light`: (x, y, z, w) as in projected_shadow.hpp, table frame. The volume extends
  // below each of `floors` (infinite planes), but no farther than the sphere of radius `reach` [m]
  // about the table's origin, which contains all receivers. Skips parts that cast no shadow onto
  // any of `receivers`, unless `receivers` is empty. Returns an empty volume if an input is not
  // finite or no face is lit.
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
    // Per face: 1 if it is used unchanged, -1 if it is used with reversed orientation, 0 if unused.
    std::vector<int> turn;
    std::vector<int> by_part;  // number of faces used per part
    bool light_inside = false;
  };
  // The near and the far end of the volume, for each position.
  struct Ends {
    std::vector<glm::vec3> near, far;
  };

  [[nodiscard]] LitFaces lit_faces(std::span<const Eigen::Vector3d> near,
                                   const std::vector<bool>& needed,
                                   const Eigen::Vector4d& homogeneous_light) const;
  // Adds the triangles of one part. `silhouette`: scratch memory, 0 per edge before and after.
  void add_part(std::span<const std::uint32_t> part, const std::vector<int>& turn, const Ends& ends,
                std::vector<int>& silhouette, std::vector<glm::vec3>& triangles) const;

  std::vector<Eigen::Vector3d> positions_;
  std::vector<std::uint32_t> indices_;
  std::vector<Side> sides_;  // three per face
  std::vector<Edge> edges_;
  std::vector<std::uint32_t> part_;  // part of each face
  IndexGroups faces_by_part_;
  // Per part: whether it is closed and consistently oriented. Such a part uses only the faces lit
  // by the light; other parts use every face, oriented towards the light.
  std::vector<bool> closed_;
  std::vector<BoundingSphere> spheres_;  // bounding sphere of each part, object frame
  std::vector<double> outward_sign_;     // sign per part: -1 if closed and inside out, else 1
};

// Returns points whose convex hull contains the volume of any caster in the hull of `points`, table
// frame [m]; floors and reach: see volume(). Empty for unbounded volumes, as with the light inside.
[[nodiscard]] std::vector<Eigen::Vector3d> hull_of_volume(std::span<const Eigen::Vector3d> points,
                                                          const Eigen::Vector4d& homogeneous_light,
                                                          std::span<const PlaneFrame> floors,
                                                          double reach);

// Splits triangles so that they follow the lens distortion, as in projected_shadow.hpp; the surface
// stays closed.
[[nodiscard]] std::vector<glm::vec3> split_for_lens(
    const std::vector<glm::vec3>& triangles, double longest_edge,
    std::size_t max_triangles = kMaxVolumeTriangles);

}  // namespace penumbra
