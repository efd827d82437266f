#include "render/shadow/volumes/shadow_volume.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "render/model/to_eigen.hpp"
#include "render/shadow/layers/split_edges.hpp"

namespace penumbra {
namespace {

// Distance of the volume's far end below a floor, so that rounding does not lift the end above [m].
constexpr double kUnderFloor = 0.02;
// The volume of a caster farther away than this fraction of the reach may be too short.
constexpr double kFarCaster = 0.5;

// A point light, or a parallel one.
struct VolumeLight {
  explicit VolumeLight(const Eigen::Vector4d& light)
      : local(light.w() != 0.0),
        from(local ? Eigen::Vector3d(light.head<3>() / light.w()) : light.head<3>().normalized()) {}
  [[nodiscard]] Eigen::Vector3d away(const Eigen::Vector3d& p) const {
    return local ? Eigen::Vector3d(p - from) : Eigen::Vector3d(-from);
  }

  bool local;
  Eigen::Vector3d from;  // the light's position, or the direction towards the light
};

// Returns t >= 0 with |p + t d| = radius, or 0 if p is outside the sphere.
double sphere_exit(const Eigen::Vector3d& p, const Eigen::Vector3d& d, double radius) {
  const double a = d.squaredNorm();
  const double b = p.dot(d);
  const double c = p.squaredNorm() - radius * radius;
  if (!(c < 0.0) || !(a > 0.0)) return 0.0;
  return (-b + std::sqrt(b * b - a * c)) / a;
}

// Counts the lit faces that overlap as seen from the light, at the points of a grid.
class LightGrid {
 public:
  static constexpr int kSide = 160;
  // The margin allows for overlaps between the grid points.
  static constexpr unsigned kMaxInitialCount = kMaxVolumesCounted - 15U;

  LightGrid(const std::vector<Eigen::Vector3d>& points, const std::vector<bool>& used,
            const VolumeLight& light)
      : counts_(static_cast<std::size_t>(kSide) * kSide, 0U) {
    Eigen::Vector3d middle = Eigen::Vector3d::Zero();
    double count = 0.0;
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (!used[i]) continue;
      middle += points[i];
      count += 1.0;
    }
    if (count > 0.0) middle /= count;
    Eigen::Vector3d forward = light.away(middle).normalized();
    if (!(forward.norm() > 0.5)) forward = Eigen::Vector3d::UnitZ();  // the light is at the centre
    const Eigen::Vector3d right = forward.unitOrthogonal();
    const Eigen::Vector3d up = forward.cross(right);
    Eigen::AlignedBox2d box;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector3d p = light.local ? light.away(points[i]) : points[i];
      Eigen::Vector2d projected(right.dot(p), up.dot(p));
      if (light.local) {
        // Projects by the angle from the axis, which covers all directions. Edges are slightly
        // curved, which changes the counts little: triangles are small or few.
        const double radius = projected.norm();
        projected *= radius > 0.0 ? std::atan2(radius, forward.dot(p)) / radius : 0.0;
      }
      at_.push_back(projected);
      if (used[i]) box.extend(projected);
    }
    if (box.isEmpty()) return;
    const double size = std::max(box.sizes().maxCoeff(), 1e-12);
    for (Eigen::Vector2d& p : at_) p = (p - box.min()) * ((kSide - 1.0) / size);
  }
  void clear() {
    std::ranges::fill(counts_, 0U);
    max_count_ = 0;
  }
  [[nodiscard]] unsigned max_count() const { return max_count_; }

  void cover(std::uint32_t i, std::uint32_t j, std::uint32_t k) {
    const std::array<Eigen::Vector2d, 3> p = {at_[i], at_[j], at_[k]};
    const auto low = p[0].cwiseMin(p[1]).cwiseMin(p[2]).eval();
    const auto high = p[0].cwiseMax(p[1]).cwiseMax(p[2]).eval();
    const int last_row = std::min(kSide - 1, static_cast<int>(high.y()));
    for (int y = std::max(0, static_cast<int>(std::ceil(low.y()))); y <= last_row; ++y) {
      double begin = high.x();
      double end = low.x();
      for (std::size_t c = 0; c < 3; ++c) {
        const Eigen::Vector2d& a = p[c];
        const Eigen::Vector2d& b = p[(c + 1) % 3];
        if ((a.y() > y) == (b.y() > y)) continue;
        const double x = a.x() + (b.x() - a.x()) * (y - a.y()) / (b.y() - a.y());
        begin = std::min(begin, x);
        end = std::max(end, x);
      }
      const int first = std::max(0, static_cast<int>(std::ceil(begin)));
      const int last = std::min(kSide, static_cast<int>(std::ceil(end))) - 1;
      for (int x = first; x <= last; ++x) {
        unsigned& here = counts_[static_cast<std::size_t>(y * kSide + x)];
        max_count_ = std::max(max_count_, ++here);
      }
    }
  }

 private:
  std::vector<Eigen::Vector2d> at_;  // in grid steps
  std::vector<unsigned> counts_;
  unsigned max_count_ = 0;
};

// The end of the volume: p + t (p - L), or p - t L for a parallel light. A common factor t for all
// points keeps the shape of the light's cone.
struct VolumeEnd {
  double t = 0.0;  // finite and positive, else there is no volume
  bool above_floors = false;
};
VolumeEnd end_of_volume(std::span<const Eigen::Vector3d> near, const std::vector<bool>& used,
                        const VolumeLight& light, std::span<const PlaneFrame> floors,
                        double reach) {
  double to_floors = floors.empty() ? std::numeric_limits<double>::infinity() : 0.0;
  double to_sphere = std::numeric_limits<double>::infinity();
  double farthest = 0.0;  // distance from the table's origin
  for (std::size_t i = 0; i < near.size(); ++i) {
    if (!used[i]) continue;
    const Eigen::Vector3d direction = light.away(near[i]);
    to_sphere = std::min(to_sphere, sphere_exit(near[i], direction, reach));
    farthest = std::max(farthest, near[i].norm());
    for (const PlaneFrame& floor : floors) {
      const double fall = -floor.n.dot(direction);
      const double height = floor.height(near[i]) + kUnderFloor;
      if (height <= 0.0) continue;
      to_floors =
          std::max(to_floors, fall > 0.0 ? height / fall : std::numeric_limits<double>::infinity());
    }
  }
  // Near the table, the sphere may end the volume, because the floor is then outside the sphere.
  const bool above_floors = !floors.empty() && std::isfinite(to_floors) && to_sphere < to_floors &&
                            farthest > kFarCaster * reach;
  return {std::min(to_floors, to_sphere), above_floors};
}

}  // namespace

VolumeCaster::VolumeCaster(const ShadowMesh& mesh) : indices_(mesh.indices) {
  for (const glm::vec3& p : mesh.positions) positions_.push_back(to_eigen(p));
  closed_.assign(mesh.part_count, true);
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> edge_of;
  std::vector<int> balance;
  for (std::size_t i = 0; i + 2 < indices_.size(); i += 3) {
    part_.push_back(mesh.part[indices_[i]]);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t from = indices_[i + k];
      const std::uint32_t to = indices_[i + (k + 1) % 3];
      const auto [found, is_new] =
          edge_of.try_emplace(std::minmax(from, to), static_cast<std::uint32_t>(edges_.size()));
      if (is_new) {
        edges_.push_back({std::min(from, to), std::max(from, to)});
        balance.push_back(0);
      }
      const int sign = from < to ? 1 : -1;
      balance[found->second] += sign;
      sides_.push_back({found->second, sign});
    }
  }
  for (std::size_t i = 0; i < sides_.size(); ++i) {
    if (balance[sides_[i].edge] != 0) closed_[part_[i / 3]] = false;
  }
  faces_by_part_.sort(part_.size(), mesh.part_count, [this](std::size_t i) { return part_[i]; });
  std::vector<Eigen::AlignedBox3d> boxes(mesh.part_count);
  for (std::size_t i = 0; i < indices_.size(); ++i)
    boxes[part_[i / 3]].extend(positions_[indices_[i]]);
  for (const Eigen::AlignedBox3d& box : boxes)
    spheres_.push_back(box.isEmpty() ? BoundingSphere()
                                     : BoundingSphere{box.center(), 0.5 * box.diagonal().norm()});
  std::vector<double> volume(mesh.part_count, 0.0);
  for (std::size_t face = 0; face < part_.size(); ++face) {
    const Eigen::Vector3d& a = positions_[indices_[3 * face]];
    volume[part_[face]] +=
        a.dot(positions_[indices_[3 * face + 1]].cross(positions_[indices_[3 * face + 2]]));
  }
  for (std::size_t part = 0; part < volume.size(); ++part)
    outward_sign_.push_back(closed_[part] && volume[part] < 0.0 ? -1.0 : 1.0);
}

bool may_shadow(const Eigen::Vector4d& light, const BoundingSphere& caster,
                const BoundingSphere& receiver) {
  const double radii = caster.radius + receiver.radius;
  if (light.w() == 0.0) {
    const Eigen::Vector3d towards = light.head<3>().normalized();
    const Eigen::Vector3d apart = caster.middle - receiver.middle;
    const double along = towards.dot(apart);
    return (apart - along * towards).norm() <= radii && along >= -radii;
  }
  const Eigen::Vector3d to_caster = caster.middle - light.head<3>() / light.w();
  const Eigen::Vector3d to_receiver = receiver.middle - light.head<3>() / light.w();
  const double near = to_caster.norm();
  const double far = to_receiver.norm();
  if (near <= caster.radius || far <= receiver.radius) return true;
  if (far + receiver.radius < near - caster.radius) return false;  // nearer to the light
  const double angle = std::atan2(to_caster.cross(to_receiver).norm(), to_caster.dot(to_receiver));
  return angle <= std::asin(caster.radius / near) + std::asin(receiver.radius / far);
}

VolumeCaster::LitFaces VolumeCaster::lit_faces(std::span<const Eigen::Vector3d> near,
                                               const std::vector<bool>& needed,
                                               const Eigen::Vector4d& homogeneous_light) const {
  const VolumeLight light(homogeneous_light);
  const std::size_t faces = indices_.size() / 3;
  LitFaces lit{std::vector<int>(faces, 0), std::vector<int>(closed_.size(), 0)};
  std::vector<int> turned_away(closed_.size(), 0);
  for (std::size_t face = 0; face < faces; ++face) {
    const Eigen::Vector3d& a = near[indices_[3 * face]];
    const Eigen::Vector3d normal =
        (near[indices_[3 * face + 1]] - a).cross(near[indices_[3 * face + 2]] - a);
    const Eigen::Vector3d to_light = -light.away(a);
    const std::uint32_t part = part_[face];
    if (!needed[part]) continue;
    // A light in the plane of the face does not light it.
    const double facing = outward_sign_[part] * normal.dot(to_light);
    const double tolerance = 1e-9 * normal.norm() * to_light.norm();
    if (facing > tolerance) {
      lit.turn[face] = outward_sign_[part] > 0.0 ? 1 : -1;
      ++lit.by_part[part];
    } else if (facing < -tolerance) {
      ++turned_away[part];
      if (!closed_[part]) {
        lit.turn[face] = -1;
        ++lit.by_part[part];
      }
    }
  }
  for (std::size_t part = 0; part < closed_.size(); ++part) {
    if (closed_[part] && lit.by_part[part] == 0 && turned_away[part] > 0) lit.light_inside = true;
  }
  return lit;
}

void VolumeCaster::add_part(std::span<const std::uint32_t> part, const std::vector<int>& turn,
                            const Ends& ends, std::vector<int>& silhouette,
                            std::vector<glm::vec3>& triangles) const {
  const auto& [here, far] = ends;
  const auto add = [&triangles](const glm::vec3& a, const glm::vec3& b, const glm::vec3& c) {
    triangles.insert(triangles.end(), {a, b, c});
  };
  for (const std::uint32_t face : part) {
    if (turn[face] == 0) continue;
    const std::uint32_t a = indices_[3 * face];
    const std::uint32_t b = indices_[3 * face + (turn[face] > 0 ? 1U : 2U)];
    const std::uint32_t c = indices_[3 * face + (turn[face] > 0 ? 2U : 1U)];
    add(here[a], here[b], here[c]);
    add(far[a], far[c], far[b]);
    for (std::size_t k = 0; k < 3; ++k) {
      const Side& side = sides_[3 * face + k];
      silhouette[side.edge] += turn[face] * side.sign;
    }
  }
  for (const std::uint32_t face : part) {
    for (std::size_t k = 0; k < 3; ++k) {
      const std::uint32_t edge = sides_[3 * face + k].edge;
      // The wall traverses an edge opposite to the lit face.
      const auto [a, b] = silhouette[edge] > 0 ? std::pair(edges_[edge].a, edges_[edge].b)
                                               : std::pair(edges_[edge].b, edges_[edge].a);
      for (int n = std::abs(silhouette[edge]); n > 0; --n) {
        add(here[b], here[a], far[a]);
        add(here[b], far[a], far[b]);
      }
      silhouette[edge] = 0;
    }
  }
}

ShadowVolume VolumeCaster::volume(const Placement& T_table_object,
                                  const Eigen::Vector4d& homogeneous_light,
                                  std::span<const PlaneFrame> floors, double reach,
                                  std::span<const BoundingSphere> receivers) const {
  std::vector<Eigen::Vector3d> near(positions_.size());
  for (std::size_t i = 0; i < near.size(); ++i) near[i] = T_table_object * positions_[i];
  std::vector<bool> needed(closed_.size(), receivers.empty());
  for (std::size_t part = 0; part < needed.size() && !receivers.empty(); ++part) {
    const BoundingSphere ball{T_table_object * spheres_[part].middle,
                              T_table_object.scale * spheres_[part].radius};
    needed[part] = std::ranges::any_of(receivers, [&](const BoundingSphere& receiver) {
      return may_shadow(homogeneous_light, ball, receiver);
    });
  }
  ShadowVolume result;
  const VolumeLight light(homogeneous_light);
  const auto finite = [](const Eigen::Vector3d& p) { return p.allFinite(); };
  if (!light.from.allFinite() || !std::ranges::all_of(near, finite)) return result;

  const LitFaces lit = lit_faces(near, needed, homogeneous_light);
  result.light_inside = lit.light_inside;
  std::vector<bool> used(near.size());
  for (std::size_t face = 0; face < lit.turn.size(); ++face) {
    for (std::size_t k = 0; k < 3 && lit.turn[face] != 0; ++k) used[indices_[3 * face + k]] = true;
  }
  const VolumeEnd volume_end = end_of_volume(near, used, light, floors, reach);
  result.ends_above_floors = volume_end.above_floors;
  if (!std::isfinite(volume_end.t) || !(volume_end.t > 0.0)) return result;
  Ends ends;
  ends.near.reserve(near.size());
  ends.far.reserve(near.size());
  for (const Eigen::Vector3d& p : near) {
    const Eigen::Vector3d end = p + volume_end.t * light.away(p);
    ends.near.emplace_back(p.x(), p.y(), p.z());
    ends.far.emplace_back(end.x(), end.y(), end.z());
  }

  std::vector<int> silhouette(edges_.size(), 0);
  // Up to kMaxVolumesCounted lit faces can't overlap too often.
  std::size_t lit_count = 0;
  for (const int count : lit.by_part) lit_count += static_cast<std::size_t>(count);
  std::optional<LightGrid> grid;
  if (lit_count > kMaxVolumesCounted) grid.emplace(near, used, light);
  for (std::size_t part = 0; part < lit.by_part.size(); ++part) {
    if (lit.by_part[part] == 0) continue;
    const std::span<const std::uint32_t> part_faces = faces_by_part_[part];
    if (grid) {
      const auto cover = [&] {
        for (const std::uint32_t face : part_faces) {
          if (lit.turn[face] == 0) continue;
          grid->cover(indices_[3 * face], indices_[3 * face + 1], indices_[3 * face + 2]);
        }
      };
      cover();
      const std::size_t batch = result.batch_ends.empty() ? 0 : result.batch_ends.back();
      if (grid->max_count() > LightGrid::kMaxInitialCount && result.triangles.size() > batch) {
        result.batch_ends.push_back(result.triangles.size());
        grid->clear();
        cover();
      }
    }
    add_part(part_faces, lit.turn, ends, silhouette, result.triangles);
  }
  if (!result.triangles.empty()) result.batch_ends.push_back(result.triangles.size());
  return result;
}

// The volume ends at the sphere or below the floors, as in VolumeCaster::volume(). The distance to
// a floor is a quotient of two linear functions, so its maximum is at a corner of the hull.
std::vector<Eigen::Vector3d> hull_of_volume(std::span<const Eigen::Vector3d> points,
                                            const Eigen::Vector4d& homogeneous_light,
                                            std::span<const PlaneFrame> floors, double reach) {
  const VolumeLight light(homogeneous_light);
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : points) middle += p / static_cast<double>(points.size());
  double farthest = 0.0;  // distance from the table's origin
  double radius = 0.0;
  double to_floors = floors.empty() ? std::numeric_limits<double>::infinity() : 0.0;
  for (const Eigen::Vector3d& p : points) {
    farthest = std::max(farthest, p.norm());
    radius = std::max(radius, (p - middle).norm());
    for (const PlaneFrame& floor : floors) {
      const double fall = -floor.n.dot(light.away(p));
      const double height = floor.height(p) + kUnderFloor;
      to_floors = std::max(to_floors, fall > 0.0 ? std::max(height, 0.0) / fall
                                                 : std::numeric_limits<double>::infinity());
    }
  }
  const double shortest = light.away(middle).norm() - (light.local ? radius : 0.0);
  if (!(shortest > 0.0)) return {};
  constexpr double kRounding = 1.0 + 1e-6;
  const double t = kRounding * std::min(to_floors, (reach + farthest) / shortest);
  if (!std::isfinite(t)) return {};
  std::vector<Eigen::Vector3d> hull;
  for (const Eigen::Vector3d& p : points) {
    hull.push_back(p);
    hull.emplace_back(p + t * light.away(p));
  }
  return hull;
}

std::vector<glm::vec3> split_for_lens(const std::vector<glm::vec3>& triangles, double longest_edge,
                                      std::size_t max_triangles) {
  const auto longest = static_cast<float>(longest_edge);
  constexpr auto kNear_m = static_cast<float>(kSplitNear_m);
  constexpr auto kShare = static_cast<float>(kSplitShare);
  const auto middle = [](const glm::vec3& a, const glm::vec3& b) { return 0.5F * (a + b); };
  const auto never = [](const glm::vec3&, const glm::vec3&, const glm::vec3&) { return false; };
  return split_within_budget(triangles, [&](double factor) {
    const auto coarser = static_cast<float>(factor);
    const auto excess = [&](const glm::vec3& a, const glm::vec3& b) {
      return glm::length(a - b) /
             (coarser * std::max(longest, kShare * (glm::length(middle(a, b)) - kNear_m)));
    };
    return split_triangles(triangles, excess, middle, never, max_triangles);
  });
}

}  // namespace penumbra
