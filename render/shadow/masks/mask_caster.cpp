#include "render/shadow/masks/mask_caster.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/assert.hpp"
#include "render/shadow/casters/caster.hpp"

namespace penumbra {
namespace {

// Limit of positions relative to the object's origin: products of differences fit into 64 bits.
constexpr float kMaxPosition = 1 << 29;

}  // namespace

void MaskCaster::begin(const OwnFrame& own, double cell) {
  wanted_ = {};
  bounds_.setEmpty();
  for (std::vector<Position>& faces : faces_) faces.clear();
  for (std::vector<Position>& sides : sides_) sides.clear();
  T_plane_own_ = own.T_plane_own;
  cell_ = cell;
  first_ = (T_plane_own_.displacement / cell).array().floor().cast<std::int64_t>();
}

std::optional<MaskCaster::Position> MaskCaster::position_of(const PlanePoint& p) const {
  const Eigen::Vector2d on_plane =
      T_plane_own_ * Eigen::Vector2d(static_cast<double>(p.u), static_cast<double>(p.v));
  Eigen::Vector2d at = kSubcells * (on_plane / cell_ - first_.cast<double>());
  constexpr double kMaxCoordinate = kMaxPosition;
  if (!(std::abs(at.x()) <= kMaxCoordinate && std::abs(at.y()) <= kMaxCoordinate)) {
    if (!at.allFinite()) return std::nullopt;
    at = at.cwiseMax(-kMaxCoordinate).cwiseMin(kMaxCoordinate);
  }
  return Position{std::llround(at.x()), std::llround(at.y())};
}

void MaskCaster::extend_bounds(const Position& position) {
  bounds_.extend(first_ + Position(position.x() >> kSubcellBits, position.y() >> kSubcellBits));
}

void MaskCaster::project_faces(ShadowLayer layer, std::span<const PlanePoint> triangles) {
  std::vector<Position>& corners = faces_[static_cast<std::size_t>(layer)];
  corners.clear();
  corners.reserve(triangles.size());
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    const std::array<std::optional<Position>, 3> face = {
        position_of(triangles[i]), position_of(triangles[i + 1]), position_of(triangles[i + 2])};
    if (!face[0] || !face[1] || !face[2]) continue;
    for (const std::optional<Position>& corner : face) {
      corners.push_back(*corner);
      extend_bounds(*corner);
    }
  }
}

void MaskCaster::project_outline(ShadowLayer layer, std::span<const OutlineSide> sides) {
  std::vector<Position>& ends = sides_[static_cast<std::size_t>(layer)];
  ends.clear();
  ends.reserve(2 * sides.size());
  for (const OutlineSide& side : sides) {
    const std::optional<Position> from = position_of(side.from);
    const std::optional<Position> to = position_of(side.to);
    if (!from || !to) {  // a line that isn't closed bounds no area
      ends.clear();
      return;
    }
    ends.insert(ends.end(), {*from, *to});
  }
  for (const Position& end : ends) extend_bounds(end);
}

void MaskCaster::project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
                         const OwnFrame& own, const LayeredConstants& constants,
                         const std::array<bool, 3>& wanted, double cell) {
  PENUMBRA_ASSERT(kernels.size() >= positions.size());
  begin(own, cell);
  wanted_ = wanted;
  if (positions.empty()) return;
  // Maps to cells of the plane, relative to the cell under the object's origin.
  const PlaneMap map = plane_map(own.T_own_object, PlaneFrame());
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  rotation.topLeftCorner<2, 2>() << own.T_plane_own.cosine, -own.T_plane_own.sine,
      own.T_plane_own.sine, own.T_plane_own.cosine;
  const Eigen::Matrix3d linear = rotation * map.linear;
  Eigen::Vector3d offset = rotation * map.offset;
  offset.head<2>() += cell * (own.T_plane_own.displacement / cell - first_.cast<double>());
  std::array<float, 9> m{};
  for (Eigen::Index i = 0; i < 9; ++i)
    m[static_cast<std::size_t>(i)] = static_cast<float>(linear(i / 3, i % 3));
  const auto x0 = static_cast<float>(offset.x());
  const auto y0 = static_cast<float>(offset.y());
  const auto h0 = static_cast<float>(offset.z());
  const auto inverse_light = static_cast<float>(1.0 / constants.light_height);
  const auto umbra_height = static_cast<float>(constants.umbra_height);
  const auto inverse_umbra = static_cast<float>(1.0 / constants.umbra_height);
  const auto cap = static_cast<float>(layer_height_range(constants, ShadowLayer::middle).high);
  const auto subcells_per_m = static_cast<float>(kSubcells / cell);

  images_.resize(positions.size());
  constexpr float kMax = std::numeric_limits<float>::max();
  Images low{{kMax, kMax, kMax, kMax}, {kMax, kMax, kMax, kMax}};
  Images high{{-kMax, -kMax, -kMax, -kMax}, {-kMax, -kMax, -kMax, -kMax}};
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const glm::vec3& p = positions[i];
    const glm::vec3& q = kernels[i];
    const float u = m[0] * p.x + m[1] * p.y + m[2] * p.z + x0;
    const float v = m[3] * p.x + m[4] * p.y + m[5] * p.z + y0;
    float h = m[6] * p.x + m[7] * p.y + m[8] * p.z + h0;
    h = h > 0.0F ? h : 0.0F;
    h = h < cap ? h : cap;
    const float ku = m[0] * q.x + m[1] * q.y + m[2] * q.z + x0;
    const float kv = m[3] * q.x + m[4] * q.y + m[5] * q.z + y0;
    // As in shadow.vert.glsl, but computed from k for all layers; accurate to 1/256 cell.
    const float r = 1.0F / (1.0F - h * inverse_light);
    const float t = h * inverse_light * r;
    const float umbra = (umbra_height - h) * inverse_umbra * r;
    const std::array<float, 4> factor = {umbra > 0.0F ? umbra : 0.0F, 1.0F + t,
                                         1.0F + t + h * inverse_umbra * r, 0.0F};
    constexpr float kRound = 3 << 22;  // adding and subtracting it rounds to integers
    Images& image = images_[i];
    for (std::size_t layer = 0; layer < 4; ++layer) {
      image.u[layer] = (ku + factor[layer] * (u - ku)) * subcells_per_m + kRound - kRound;
      image.v[layer] = (kv + factor[layer] * (v - kv)) * subcells_per_m + kRound - kRound;
    }
    for (std::size_t layer = 0; layer < 4; ++layer) {
      low.u[layer] = image.u[layer] < low.u[layer] ? image.u[layer] : low.u[layer];
      low.v[layer] = image.v[layer] < low.v[layer] ? image.v[layer] : low.v[layer];
      high.u[layer] = image.u[layer] > high.u[layer] ? image.u[layer] : high.u[layer];
      high.v[layer] = image.v[layer] > high.v[layer] ? image.v[layer] : high.v[layer];
    }
  }
  for (std::size_t layer = 0; layer < 3; ++layer) {
    if (!wanted_[layer]) continue;
    // If no position is finite, lowest > highest.
    const auto within = [](float lowest, float highest) {
      return lowest >= -kMaxPosition && highest <= kMaxPosition && lowest <= highest;
    };
    if (!within(low.u[layer], high.u[layer]) || !within(low.v[layer], high.v[layer])) {
      clamp_positions();
      return;
    }
    extend_bounds(low.layer_position(layer));
    extend_bounds(high.layer_position(layer));
  }
}

// Sets non-finite positions to NaN: faces at them have a NaN area and are not counter-clockwise.
void MaskCaster::clamp_positions() {
  bounds_.setEmpty();
  constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
  for (Images& image : images_) {
    for (std::size_t layer = 0; layer < 3; ++layer) {
      if (!wanted_[layer]) continue;
      float& u = image.u[layer];
      float& v = image.v[layer];
      if (!std::isfinite(u) || !std::isfinite(v)) {
        u = v = kNone;
        continue;
      }
      u = std::clamp(u, -kMaxPosition, kMaxPosition);
      v = std::clamp(v, -kMaxPosition, kMaxPosition);
      extend_bounds(image.layer_position(layer));
    }
  }
}

}  // namespace penumbra
