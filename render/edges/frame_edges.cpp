#include "render/edges/frame_edges.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <iterator>
#include <optional>
#include <set>
#include <tuple>
#include <utility>

#include "render/model/shadow_mesh.hpp"
#include "render/model/to_eigen.hpp"
#include "render/scene/plane_outline.hpp"
#include "render/shadow/projected/projected_shadow.hpp"

namespace penumbra {
namespace {

// Edges of a caster's outline times vertices and faces of a receiver; more take over 10 ms.
constexpr std::size_t kMaxWallTests = 4'000'000;
constexpr int kMaxPieces = 64;         // of an edge that the lens bends
constexpr double kPlaneDepth = 1.001;  // planes are drawn this much farther away (lens.glsl)

// A homogeneous point or direction of the table frame in an object's frame.
glm::vec4 in_object(const Placement& T_table_object, const Eigen::Vector4d& point) {
  const Eigen::Vector3d moved = point.head<3>() - point.w() * T_table_object.position;
  const Eigen::Vector3d p = T_table_object.rotation.conjugate() * moved / T_table_object.scale;
  return {to_glm(p), static_cast<float>(point.w())};
}

// Direction from the light through a point.
Eigen::Vector3d away_from(const Eigen::Vector4d& light, const Eigen::Vector3d& p) {
  return light.w() != 0.0 ? Eigen::Vector3d(p - light.head<3>() / light.w())
                          : Eigen::Vector3d(-light.head<3>());
}

// Clips a -> b to the heights of `range`; false if nothing is left. Points: (u, v, h).
bool clip_to_range(Eigen::Vector3d& a, Eigen::Vector3d& b, const HeightRange& range) {
  const auto at = [&](double h) { return a + (b - a) * ((h - a.z()) / (b.z() - a.z())); };
  for (const auto& [limit, sign] : {std::pair(range.low, 1.0), std::pair(range.high, -1.0)}) {
    const bool a_in = sign * (a.z() - limit) >= 0.0;
    const bool b_in = sign * (b.z() - limit) >= 0.0;
    if (!a_in && !b_in) return false;
    if (!a_in)
      a = at(limit);
    else if (!b_in)
      b = at(limit);
  }
  return true;
}

// A receiver of shadow volumes: its faces, table frame.
struct Receiver {
  std::vector<Eigen::Vector3f> positions;
  std::vector<std::array<std::uint32_t, 3>> faces;  // that may face the eye
  std::vector<Eigen::Vector3f> normals;
  Eigen::Vector3f middle = Eigen::Vector3f::Zero();
  float radius = 0.0F;
};

Receiver receiver_of(const EdgeMesh& mesh, const ObjectDraw& draw, const Eigen::Vector3d& eye) {
  Receiver receiver;
  Eigen::AlignedBox3f box;
  for (const glm::vec3& p : mesh.positions()) {
    receiver.positions.emplace_back((draw.T_table_object * to_eigen(p)).cast<float>());
    box.extend(receiver.positions.back());
  }
  if (!box.isEmpty()) {
    receiver.middle = box.center();
    receiver.radius = 0.5F * box.diagonal().norm();
  }
  const Eigen::Vector3f from = eye.cast<float>();
  const std::span<const std::uint32_t> indices = mesh.indices();
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const Eigen::Vector3f& a = receiver.positions[indices[i]];
    const Eigen::Vector3f n =
        (receiver.positions[indices[i + 1]] - a).cross(receiver.positions[indices[i + 2]] - a);
    if (mesh.outward() != 0 && static_cast<float>(mesh.outward()) * n.dot(from - a) <= 0.0F)
      continue;
    receiver.faces.push_back({indices[i], indices[i + 1], indices[i + 2]});
    receiver.normals.push_back(n);
  }
  return receiver;
}

// The surface between an edge of a caster and its shadow: the half-plane strip behind the edge.
struct ShadowWall {
  ShadowWall(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const Eigen::Vector4d& light)
      : a(from.cast<float>()), b(to.cast<float>()) {
    const Eigen::Vector3f along = b - a;
    const Eigen::Vector3f away_a = away_from(light, from).cast<float>();
    const Eigen::Vector3f away_b = away_from(light, to).cast<float>();
    dark_side = along.cross(away_a).normalized();
    after_a = dark_side.cross(away_a);
    if (after_a.dot(along) < 0.0F) after_a = -after_a;
    before_b = dark_side.cross(away_b);
    if (before_b.dot(along) > 0.0F) before_b = -before_b;
    behind = along.cross(dark_side);
    if (behind.dot(away_a) < 0.0F) behind = -behind;
    behind.normalize();
  }
  // Returns false if no point of the sphere can be on the wall.
  [[nodiscard]] bool may_meet(const Eigen::Vector3f& middle, float radius) const {
    return std::abs(dark_side.dot(middle - a)) <= radius && behind.dot(middle - a) >= -radius;
  }
  // Clips a line in the wall's plane to the wall; false if nothing is left.
  [[nodiscard]] bool clip(Eigen::Vector3f& p, Eigen::Vector3f& q) const {
    for (const auto& [inwards, at] :
         {std::pair(&after_a, &a), std::pair(&before_b, &b), std::pair(&behind, &a)}) {
      const float p_in = inwards->dot(p - *at);
      const float q_in = inwards->dot(q - *at);
      if (!(p_in >= 0.0F) && !(q_in >= 0.0F)) return false;
      const Eigen::Vector3f cut = p + (q - p) * (p_in / (p_in - q_in));
      if (!(p_in >= 0.0F)) p = cut;
      if (!(q_in >= 0.0F)) q = cut;
    }
    return true;
  }

  Eigen::Vector3f a, b;
  Eigen::Vector3f dark_side;                  // unit normal, towards the shadow
  Eigen::Vector3f after_a, before_b, behind;  // normals of the wall's borders, inwards
};

// Adds the line in which a wall meets the receiver, with the shadow on the left.
void add_wall(const ShadowWall& wall, const Receiver& receiver, const Eigen::Vector3f& eye,
              const glm::mat4x3& to_camera, const ScreenMap& screen, std::vector<float>& sides,
              std::vector<ScreenEdge>& edges) {
  if (!wall.may_meet(receiver.middle, receiver.radius)) return;
  sides.resize(receiver.positions.size());
  const float offset = wall.dark_side.dot(wall.a);
  for (std::size_t i = 0; i < sides.size(); ++i)
    sides[i] = wall.dark_side.dot(receiver.positions[i]) - offset;
  const auto in_camera = [&to_camera](const Eigen::Vector3f& p, float w) {
    return to_camera * glm::vec4(p.x(), p.y(), p.z(), w);
  };
  for (std::size_t f = 0; f < receiver.faces.size(); ++f) {
    const auto& face = receiver.faces[f];
    const std::array<bool, 3> dark = {sides[face[0]] > 0.0F, sides[face[1]] > 0.0F,
                                      sides[face[2]] > 0.0F};
    if (dark[0] == dark[1] && dark[1] == dark[2]) continue;
    std::array<Eigen::Vector3f, 2> ends;
    std::size_t found = 0;
    for (std::size_t k = 0; k < 3 && found < 2; ++k) {
      // From the lower index to the higher one, so that neighbouring faces get the same point.
      const auto [i, j] = std::minmax(face[k], face[(k + 1) % 3]);
      if (dark[k] == dark[(k + 1) % 3]) continue;
      const float t = sides[i] / (sides[i] - sides[j]);
      ends[found++] = receiver.positions[i] + t * (receiver.positions[j] - receiver.positions[i]);
    }
    if (found < 2 || !wall.clip(ends[0], ends[1])) continue;
    Eigen::Vector3f normal = receiver.normals[f];
    if (normal.dot(eye - receiver.positions[face[0]]) < 0.0F) normal = -normal;
    if ((ends[1] - ends[0]).dot(wall.dark_side.cross(normal)) < 0.0F) std::swap(ends[0], ends[1]);
    screen.add(in_camera(ends[0], 1.0F), in_camera(ends[1], 1.0F), in_camera(normal, 0.0F),
               kMaxPieces, edges);
  }
}

}  // namespace

std::vector<FrameEdges::LightEdge> FrameEdges::seen_from_light(const Scene& scene,
                                                               const LitCaster& caster) {
  const EdgeMesh& mesh = casters_.of(scene, caster.object, caster.proxy, [](const Model& model) {
    const ShadowMesh shadow = make_shadow_mesh(model, {}, CutOuts::visible_regions);
    const EdgeMeshPart part{shadow.positions, {}, shadow.indices, 0, false};
    return EdgeMesh({&part, 1});
  });
  std::vector<LightEdge> edges;
  const auto place = [&](std::uint32_t i) {
    return caster.T_table_object * to_eigen(mesh.positions()[i]);
  };
  for (const SeenEdge& edge :
       mesh.seen_from(in_object(caster.T_table_object, caster.light_position), false))
    edges.push_back({place(edge.from), place(edge.to)});
  return edges;
}

std::vector<EdgeGroup> FrameEdges::of(const Scene& scene, const FramePlan& plan,
                                      const ScreenMap& screen, const EdgesOf& edges_of,
                                      bool shadows) {
  std::vector<EdgeGroup> groups;
  std::vector<EdgeGroup> crease_groups;
  const Eigen::Vector3d& eye = plan.T_table_camera.translation();
  const auto add_mesh = [&](const EdgeMesh* mesh, const ObjectDraw& draw, EdgeKind outline,
                            std::optional<EdgeKind> crease) {
    if (mesh == nullptr) return;
    const glm::mat4x3 to_camera = camera_from_object(plan.T_table_camera, draw.T_table_object);
    const std::vector<SeenEdge> seen =
        mesh->seen_from(in_object(draw.T_table_object, eye.homogeneous()), crease.has_value());
    EdgeGroup outlines{outline, {}};
    EdgeGroup creases{crease.value_or(EdgeKind::crease), {}};
    outlines.edges.reserve(seen.size());
    for (const SeenEdge& edge : seen) {
      const glm::vec3 a = to_camera * glm::vec4(mesh->positions()[edge.from], 1.0F);
      const glm::vec3 b = to_camera * glm::vec4(mesh->positions()[edge.to], 1.0F);
      const glm::vec3 normal = to_camera * glm::vec4(mesh->normal(edge.face), 0.0F);
      // The drawn edges are straight, because the model was subdivided for the lens.
      if (!edge.crease) {
        screen.add(a, b, normal, 1, outlines.edges);
        continue;
      }
      // Which side is called left must not change from one crease to the next.
      const std::size_t before = creases.edges.size();
      screen.add(a, b, normal, 1, creases.edges);
      if (creases.edges.size() == before) continue;
      ScreenEdge& added = creases.edges.back();
      const glm::vec2 along = added.to - added.from;
      if (along.y < 0.0F || (along.y == 0.0F && along.x > 0.0F)) {
        std::swap(added.from, added.to);
        std::swap(added.near_from, added.near_to);
      }
    }
    if (!outlines.edges.empty()) groups.push_back(std::move(outlines));
    if (!creases.edges.empty()) crease_groups.push_back(std::move(creases));
  };
  if (shadows) {
    using Key = std::tuple<int, int, int>;  // object, light, plane
    std::set<Key> seen;
    const auto add_on_plane = [&](const LitCaster& caster, const PlaneFrame& plane, int index,
                                  std::span<const LightEdge> edges) {
      const HeightRange range = hard_shadow_range(plane, caster.light_position);
      if (!(light_height(plane, caster.light_position) > 0.0)) return;
      const glm::mat4x3 to_camera = camera_from_plane(plan.T_table_camera, plane);
      const glm::vec3 normal = to_camera * glm::vec4(0.0F, 0.0F, 1.0F, 0.0F);
      const auto& outline = scene.planes[static_cast<std::size_t>(index)].outline;
      EdgeGroup group{EdgeKind::shadow_on_plane, {}};
      const auto in_camera = [&to_camera](const Eigen::Vector2d& p) {
        return to_camera *
               glm::vec4(static_cast<float>(p.x()), static_cast<float>(p.y()), 0.0F, 1.0F);
      };
      const auto add_line = [&](const PlaneLine& line) {
        screen.add(in_camera(line.from), in_camera(line.to), normal, kMaxPieces, group.edges);
      };
      for (const LightEdge& edge : edges) {
        Eigen::Vector3d a = plane.to_plane(edge.a);
        Eigen::Vector3d b = plane.to_plane(edge.b);
        if (!clip_to_range(a, b, range)) continue;
        const PlaneLine line{shadow_point(plane, caster.light_position, a),
                             shadow_point(plane, caster.light_position, b)};
        if (outline.empty()) {
          add_line(line);
        } else {
          // Beyond the outline there is no shadow, so smoothing must not change the video.
          std::ranges::for_each(parts_inside(line, outline), add_line);
        }
      }
      if (!group.edges.empty()) groups.push_back(std::move(group));
    };
    for (const HardShadowDraw& draw : plan.hard_shadows) {
      if (!seen.insert({draw.object, draw.light, draw.plane}).second) continue;
      add_on_plane(draw, draw.plane_frame, draw.plane, seen_from_light(scene, draw));
    }
    std::map<int, Receiver> receivers;
    std::vector<float> sides;
    const glm::mat4x3 table_to_camera = camera_from_object(plan.T_table_camera, Placement());
    const auto add_on_receivers = [&](const ShadowVolumeDraw& caster,
                                      std::span<const LightEdge> edges,
                                      std::span<const ObjectDraw> draws, EdgeKind kind) {
      for (const ObjectDraw& draw : draws) {
        const EdgeMesh* mesh = edges_of(draw.object).opaque;
        if (mesh == nullptr || draw.object == caster.object) continue;
        auto found = receivers.find(draw.object);
        if (found == receivers.end())
          found = receivers.emplace(draw.object, receiver_of(*mesh, draw, eye)).first;
        const Receiver& receiver = found->second;
        if (edges.size() * (receiver.positions.size() + receiver.faces.size()) > kMaxWallTests)
          continue;
        EdgeGroup group{kind, {}};
        for (const LightEdge& edge : edges) {
          add_wall(ShadowWall(edge.a, edge.b, caster.light_position), receiver, eye.cast<float>(),
                   table_to_camera, screen, sides, group.edges);
        }
        if (!group.edges.empty()) groups.push_back(std::move(group));
      }
    };
    for (const ShadowVolumeDraw& draw : plan.volumes) {
      const std::vector<LightEdge> edges = seen_from_light(scene, draw);
      // The volume darkens the planes where they are in the depth buffer.
      for (const PlaneReceiver& receiver : plan.receivers) {
        if (!draw.on_planes) break;
        PlaneFrame drawn = receiver.frame;
        drawn.q = eye + kPlaneDepth * (drawn.q - eye);
        add_on_plane(draw, drawn, receiver.plane, edges);
      }
      add_on_receivers(draw, edges, plan.phantoms, EdgeKind::shadow_on_phantom);
      if (draw.on_planes) add_on_receivers(draw, edges, plan.objects, EdgeKind::shadow_on_object);
    }
  }
  for (const ObjectDraw& draw : plan.phantoms)
    add_mesh(edges_of(draw.object).opaque, draw, EdgeKind::phantom, std::nullopt);
  for (const ObjectDraw& draw : plan.objects) {
    const ObjectEdges edges = edges_of(draw.object);
    add_mesh(edges.opaque, draw, EdgeKind::surface, EdgeKind::crease);
    add_mesh(edges.blended, draw, EdgeKind::blended, EdgeKind::blended);
  }
  std::ranges::move(crease_groups, std::back_inserter(groups));
  return groups;
}

}  // namespace penumbra
