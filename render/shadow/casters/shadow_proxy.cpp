#include "render/shadow/casters/shadow_proxy.hpp"

#include <meshoptimizer.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <numeric>

#include "core/assert.hpp"
#include "render/model/to_eigen.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/layers/coverage.hpp"

namespace penumbra {

namespace {

constexpr std::size_t kManyFaces = 20'000;
constexpr double kShareOfFew = 0.5;        // fraction of the faces to keep, up to kManyFaces
constexpr double kShareOfMany = 0.25;      // above kManyFaces
constexpr double kWorthwhileShare = 0.75;  // a larger fraction of the faces saves too little

// A k-d tree for the nearest of many points.
class PointTree {
 public:
  explicit PointTree(const std::vector<glm::vec3>& points) : points_(points) {
    order_.resize(points.size());
    std::iota(order_.begin(), order_.end(), 0U);
    build(0, order_.size(), 0);
  }
  [[nodiscard]] std::uint32_t nearest(const glm::vec3& p) const {
    Search search{p};
    find(search, 0, order_.size(), 0);
    return search.best;
  }

 private:
  struct Search {
    glm::vec3 p;
    std::uint32_t best = 0;
    float squared = std::numeric_limits<float>::infinity();
  };
  // Splits a range at its median, along x, y and z in turn.
  void build(std::size_t begin, std::size_t end, int axis) {
    if (end - begin < 2) return;
    const std::size_t middle = begin + (end - begin) / 2;
    const auto at = [this](std::size_t i) {
      return order_.begin() + static_cast<std::ptrdiff_t>(i);
    };
    std::nth_element(at(begin), at(middle), at(end), [&](std::uint32_t a, std::uint32_t b) {
      return points_[a][axis] < points_[b][axis] || (points_[a][axis] == points_[b][axis] && a < b);
    });
    build(begin, middle, (axis + 1) % 3);
    build(middle + 1, end, (axis + 1) % 3);
  }
  void find(Search& search, std::size_t begin, std::size_t end, int axis) const {
    if (begin == end) return;
    const std::size_t middle = begin + (end - begin) / 2;
    const std::uint32_t i = order_[middle];
    const glm::vec3 d = points_[i] - search.p;
    const float squared = glm::dot(d, d);
    if (squared < search.squared || (squared == search.squared && i < search.best)) {
      search.squared = squared;
      search.best = i;
    }
    const float across = search.p[axis] - points_[i][axis];
    const int next = (axis + 1) % 3;
    if (across < 0.0F) {
      find(search, begin, middle, next);
      if (across * across <= search.squared) find(search, middle + 1, end, next);
    } else {
      find(search, middle + 1, end, next);
      if (across * across <= search.squared) find(search, begin, middle, next);
    }
  }

  const std::vector<glm::vec3>& points_;
  std::vector<std::uint32_t> order_;
};

struct ComparedMesh {
  const ShadowMesh& mesh;
  std::vector<VertexDisc> discs;  // for a fixed light only

  [[nodiscard]] std::vector<PlanePoint> layer(std::span<const CasterVertex> vertices,
                                              const ProxyUse& use, ShadowLayer which) const {
    return use.light_mode == LightMode::fixed
               ? fixed_light_triangles(vertices, discs, mesh.indices, use.constants, which)
               : layer_triangles(vertices, mesh.indices, use.constants, which);
  }
};

}  // namespace

std::optional<ShadowProxy> simplified_caster(const ShadowMesh& full) {
  const std::size_t faces = full.indices.size() / 3;
  if (faces <= kMinProxyFaces) return std::nullopt;
  const double share = faces > kManyFaces ? kShareOfMany : kShareOfFew;
  const auto target = 3 * static_cast<std::size_t>(share * static_cast<double>(faces));
  std::vector<std::uint32_t> indices(full.indices.size());
  constexpr float kAnyError = 1.0F;  // no error limit: compare_with_proxy() decides
  indices.resize(meshopt_simplify(indices.data(), full.indices.data(), full.indices.size(),
                                  &full.positions.front().x, full.positions.size(),
                                  sizeof(glm::vec3), target, kAnyError));
  const auto max_faces = static_cast<std::size_t>(kWorthwhileShare * static_cast<double>(faces));
  if (indices.empty() || indices.size() / 3 > max_faces) return std::nullopt;
  ShadowProxy proxy;
  std::vector<std::uint32_t> proxy_index_of(full.positions.size(), kNoShadowPosition);
  for (std::uint32_t& index : indices) {
    std::uint32_t& proxy_index = proxy_index_of[index];
    if (proxy_index == kNoShadowPosition) {
      proxy_index = static_cast<std::uint32_t>(proxy.source_of.size());
      proxy.source_of.push_back(index);
      proxy.mesh.positions.push_back(full.positions[index]);
      proxy.mesh.part.push_back(full.part[index]);
    }
    index = proxy_index;
  }
  proxy.mesh.indices = std::move(indices);
  proxy.mesh.part_count = full.part_count;
  return proxy;
}

ShadowProxy proxy_from_model(const ShadowMesh& full, const Model& model) {
  ShadowProxy proxy;
  proxy.mesh = make_shadow_mesh(model);
  proxy.mesh.from_source.clear();
  proxy.mesh.stored_kernels.clear();
  if (full.positions.empty()) return {};
  const PointTree tree(full.positions);
  for (std::size_t i = 0; i < proxy.mesh.positions.size(); ++i) {
    proxy.source_of.push_back(tree.nearest(proxy.mesh.positions[i]));
    proxy.mesh.part[i] = full.part[proxy.source_of[i]];
  }
  proxy.mesh.part_count = full.part_count;
  return proxy;
}

ShadowKernels carried_kernels(const ShadowProxy& proxy, const ShadowKernels& full) {
  ShadowKernels carried;
  carried.up = full.up;
  carried.kernels.reserve(proxy.source_of.size());
  for (const std::uint32_t source : proxy.source_of) {
    carried.kernels.push_back(full.kernels[source]);
    if (!full.radius.empty()) carried.radius.push_back(full.radius[source]);
  }
  return carried;
}

double ProxyAgreement::min_iou() const {
  double minimum = 1.0;
  for (const auto& layers : iou)
    minimum = std::min(minimum, *std::min_element(layers.begin(), layers.end()));
  return minimum;
}

ProxyAgreement compare_with_proxy(const ShadowMesh& full, const ShadowKernels& kernels,
                                  std::span<const PartDisc> parts, const ShadowProxy& proxy,
                                  const ProxyUse& use, bool thorough) {
  PENUMBRA_ASSERT(kernels.kernels.size() == full.positions.size());
  const ShadowKernels carried = carried_kernels(proxy, kernels);
  ComparedMesh full_mesh{full, {}};
  ComparedMesh reduced_mesh{proxy.mesh, {}};
  if (use.light_mode == LightMode::fixed) {
    full_mesh.discs = vertex_discs(full, kernels, parts, use.scale);
    reduced_mesh.discs = vertex_discs(proxy.mesh, carried, parts, use.scale);
  }
  const PlaneFrame plane = PlaneFrame::make(kernels.up, Eigen::Vector3d::Zero());
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const glm::vec3& p : full.positions) {
    const double h = use.scale * plane.height(to_eigen(p));
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  ProxyAgreement result;
  // Starts at the greatest height, where the umbra, the most sensitive layer, is smallest.
  for (std::size_t at = kProxyHeights.size(); at-- > 0;) {
    // The object's middle is at the height, unless the object would reach below the plane.
    const double lift =
        std::max(-bottom, kProxyHeights[at] * use.constants.umbra_height - 0.5 * (bottom + top));
    const Placement placed{lift * plane.n, Eigen::Quaterniond::Identity(), use.scale};
    const auto full_vertices = place_caster(full, kernels, placed, plane);
    const auto reduced_vertices = place_caster(proxy.mesh, carried, placed, plane);
    for (std::size_t i = 0; i < kShadowLayers.size(); ++i) {
      result.iou[at][i] = layer_iou(full_mesh.layer(full_vertices, use, kShadowLayers[i]),
                                    reduced_mesh.layer(reduced_vertices, use, kShadowLayers[i]));
      if (!thorough && result.iou[at][i] < kMinProxyAgreement) return result;
    }
  }
  return result;
}

}  // namespace penumbra
