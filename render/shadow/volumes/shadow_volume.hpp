// The space that a caster keeps a light away from, as a closed surface (Hudson, "Casting Fast
// Shadows for a 3D Cursor"; docs/shadows.md#volumes): the faces that the light sees, walls from
// their silhouette away from the light, and the same faces again at the far end. How often a ray
// enters more than it leaves (z-fail counting) says whether a point lies within.
//
// Convex casters give a volume that a ray enters once. Others give one that may overlap itself: the
// count is then more than 1, and still 0 outside. Nothing is replaced by its hull. A stencil counts
// to 63 here, so the parts of a caster come in batches that a ray hardly enters more often (48
// times at the points of a grid, as the light sees it); only one part that lies over itself 64
// times in the light's direction would open.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <glm/vec3.hpp>
#include <span>
#include <vector>

#include "render/model/shadow_mesh.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

inline constexpr unsigned kMostVolumesCounted = 0x3FU;
inline constexpr std::size_t kMostVolumeTriangles = 200'000;  // once they are split for a lens

// Holds a thing.
struct Ball {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double radius = 0.0;
  friend bool operator==(const Ball&, const Ball&) = default;
};
// Whether what is in one ball may keep the light (as for volumes) from something in the other.
[[nodiscard]] bool may_shadow(const Eigen::Vector4d& light, const Ball& caster,
                              const Ball& receiver);

struct ShadowVolume {
  std::vector<glm::vec3> triangles;  // table frame [m], three points each, closed and oriented
  // Where in `triangles` each batch ends: none is empty, and each is closed by itself.
  std::vector<std::size_t> batch_ends;
  // A closed part of the caster has no face that the light sees: the light is in it, and all that
  // is outside would be dark. That part is left out.
  bool light_inside = false;
  // The caster is too large or too far away: its volume ends before it comes to the floors.
  bool ends_above_floors = false;
};

// Faces, and which of them share an edge.
class VolumeCaster {
 public:
  explicit VolumeCaster(const ShadowMesh& mesh);

  // `light`: (x, y, z, w) as in projected_shadow.hpp, table frame. The volume reaches under each of
  // `floors` (planes without an end) where light falls onto them, and otherwise to where it leaves
  // the sphere about the table's origin of radius `reach` [m], beyond which nothing receives.
  // Empty if nothing is finite or the light is under all of the caster's faces.
  // `receivers`: parts that can't throw a shadow onto any of them are left out; none: no part is.
  [[nodiscard]] ShadowVolume volume(const Placement& T_table_object, const Eigen::Vector4d& light,
                                    std::span<const PlaneFrame> floors, double reach,
                                    std::span<const Ball> receivers = {}) const;

 private:
  struct Edge {
    std::uint32_t a = 0, b = 0;  // a < b
  };
  struct Side {
    std::uint32_t edge = 0;
    int sign = 1;  // +1: the face runs from a to b
  };

  std::vector<Eigen::Vector3d> positions_;
  std::vector<std::uint32_t> indices_;
  std::vector<Side> sides_;  // three per face
  std::vector<Edge> edges_;
  std::vector<std::uint32_t> part_;           // of each face
  std::vector<std::uint32_t> faces_by_part_;  // all faces
  // Whether the part's faces are closed and turned the same way: then those that the light sees
  // suffice. Of others every face counts, turned towards the light.
  std::vector<bool> closed_;
  std::vector<Ball> balls_;      // about each part, object frame
  std::vector<double> outside_;  // of each part: -1 where it is closed and turned inside out
};

// Points whose hull holds the volume (of these floors, as far as this) of whatever lies in the hull
// of `points`, all in the table frame [m]; none where that has no end, as where the light may be
// inside.
[[nodiscard]] std::vector<Eigen::Vector3d> hull_of_volume(std::span<const Eigen::Vector3d> points,
                                                          const Eigen::Vector4d& light,
                                                          std::span<const PlaneFrame> floors,
                                                          double reach);

// Cut so that straight edges can follow a lens, as for planes in projected_shadow.hpp; still
// closed.
[[nodiscard]] std::vector<glm::vec3> split_for_lens(
    const std::vector<glm::vec3>& triangles, double longest_edge,
    std::size_t max_triangles = kMostVolumeTriangles);

}  // namespace penumbra
