#include "render/shadow/silhouette_mask.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <limits>
#include <tuple>

#include "core/assert.hpp"
#include "render/shadow/caster.hpp"

namespace penumbra {
namespace {

constexpr int kPlaces = 256;                            // that a cell is told into, along each side
constexpr std::int32_t kWhole = 2 * kPlaces * kPlaces;  // a covered cell

std::int64_t floor_div(std::int64_t a, std::int64_t b) {
  const std::int64_t q = a / b;
  return q * b > a ? q - 1 : q;
}

// Whether no layer covers more or less than in the cell before: by two words, not three numbers.
bool is_level(const std::array<std::int32_t, 4>& step) {
  const auto words = std::bit_cast<std::array<std::uint64_t, 2>>(step);
  return (words[0] | words[1]) == 0;
}

}  // namespace

std::optional<std::vector<FacePair>> paired_edges(std::span<const std::uint32_t> indices) {
  struct Half {
    std::uint32_t low, high, face;
    bool forward;  // from low to high
  };
  std::vector<Half> halves;
  halves.reserve(indices.size());
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const std::uint32_t a = indices[i + corner];
      const std::uint32_t b = indices[i + (corner + 1) % 3];
      if (a == b) continue;  // covers nothing
      halves.push_back({std::min(a, b), std::max(a, b), static_cast<std::uint32_t>(i / 3), a < b});
    }
  }
  std::ranges::sort(halves, [](const Half& a, const Half& b) {
    return std::tie(a.low, a.high, a.forward, a.face) < std::tie(b.low, b.high, b.forward, b.face);
  });
  std::vector<FacePair> pairs;
  pairs.reserve(halves.size() / 2);
  for (std::size_t first = 0; first < halves.size();) {
    std::size_t last = first;
    std::size_t backward = 0;
    while (last < halves.size() && halves[last].low == halves[first].low &&
           halves[last].high == halves[first].high) {
      if (!halves[last].forward) ++backward;
      ++last;
    }
    if (2 * backward != last - first) return std::nullopt;
    for (std::size_t i = 0; i < backward; ++i) {
      const Half& back = halves[first + i];
      const Half& forward = halves[first + backward + i];
      pairs.push_back({back.low, back.high, forward.face, back.face});
    }
    first = last;
  }
  return pairs;
}

void MaskCaster::project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
                         const OwnFrame& own, const LayeredConstants& constants,
                         const std::array<bool, 3>& wanted, double cell) {
  PENUMBRA_ASSERT(kernels.size() >= positions.size());
  wanted_ = wanted;
  bounds_.setEmpty();
  if (positions.empty()) return;
  // Turned on the plane, in cells, from the cell under the object's origin.
  const PlaneMap map = plane_map(own.T_own_object, PlaneFrame());
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  turn.topLeftCorner<2, 2>() << own.T_plane_own.cosine, -own.T_plane_own.sine, own.T_plane_own.sine,
      own.T_plane_own.cosine;
  const Eigen::Matrix3d linear = turn * map.linear;
  Eigen::Vector3d offset = turn * map.offset;
  const Eigen::Vector2d slide = own.T_plane_own.slide / cell;
  first_u_ = static_cast<std::int64_t>(std::floor(slide.x()));
  first_v_ = static_cast<std::int64_t>(std::floor(slide.y()));
  offset.x() += cell * (slide.x() - static_cast<double>(first_u_));
  offset.y() += cell * (slide.y() - static_cast<double>(first_v_));
  std::array<float, 9> m{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column)
      m[static_cast<std::size_t>(3 * row + column)] = static_cast<float>(linear(row, column));
  }
  const auto x0 = static_cast<float>(offset.x());
  const auto y0 = static_cast<float>(offset.y());
  const auto h0 = static_cast<float>(offset.z());
  const auto inverse_light = static_cast<float>(1.0 / constants.light_height);
  const auto umbra_height = static_cast<float>(constants.umbra_height);
  const auto inverse_umbra = static_cast<float>(1.0 / constants.umbra_height);
  const auto cap = static_cast<float>(layer_height_range(constants, ShadowLayer::middle).high);
  const auto places = static_cast<float>(kPlaces / cell);

  images_.resize(positions.size());
  constexpr float kMost = std::numeric_limits<float>::max();
  Images low{{kMost, kMost, kMost, kMost}, {kMost, kMost, kMost, kMost}};
  Images high{{-kMost, -kMost, -kMost, -kMost}, {-kMost, -kMost, -kMost, -kMost}};
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
    // As shadow.vert.glsl; all anchored at k, which is exact enough for 1/256 of a cell.
    const float r = 1.0F / (1.0F - h * inverse_light);
    const float t = h * inverse_light * r;
    const float umbra = (umbra_height - h) * inverse_umbra * r;
    const std::array<float, 4> factor = {umbra > 0.0F ? umbra : 0.0F, 1.0F + t,
                                         1.0F + t + h * inverse_umbra * r, 0.0F};
    // Adding it leaves no digits after the point: to nearest, for all that a grid can hold.
    constexpr float kRound = 3 << 22;
    Images& image = images_[i];
    for (std::size_t layer = 0; layer < 4; ++layer) {
      image.u[layer] = (ku + factor[layer] * (u - ku)) * places + kRound - kRound;
      image.v[layer] = (kv + factor[layer] * (v - kv)) * places + kRound - kRound;
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
    const auto cell_of = [](float at, std::int64_t first) {
      return first + floor_div(static_cast<std::int64_t>(at), kPlaces);
    };
    bounds_.extend(Eigen::Vector<std::int64_t, 2>(cell_of(low.u[layer], first_u_),
                                                  cell_of(low.v[layer], first_v_)));
    bounds_.extend(Eigen::Vector<std::int64_t, 2>(cell_of(high.u[layer], first_u_),
                                                  cell_of(high.v[layer], first_v_)));
  }
}

void MaskPicture::begin(const MaskCells& cells) {
  cells_ = cells;
  // finish() leaves them all 0.
  steps_.resize(static_cast<std::size_t>(cells.width + 1) * static_cast<std::size_t>(cells.height));
  rows_.assign(static_cast<std::size_t>(cells.height), {std::numeric_limits<int>::max(), -1});
}

void MaskPicture::cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
                        std::span<const FacePair> edges) {
  const std::vector<MaskCaster::Images>& images = caster.images_;
  std::vector<std::uint8_t>& turned = caster.turned_;
  turned.resize(indices.size() / 3);
  const auto wanted = static_cast<std::uint8_t>(
      (caster.wanted_[0] ? 1 : 0) | (caster.wanted_[1] ? 2 : 0) | (caster.wanted_[2] ? 4 : 0));
  for (std::size_t face = 0; face < turned.size(); ++face) {
    const MaskCaster::Images& a = images[indices[3 * face]];
    const MaskCaster::Images& b = images[indices[3 * face + 1]];
    const MaskCaster::Images& c = images[indices[3 * face + 2]];
    // Any sign will do for what has next to no area: all edges of a face take the same.
    std::array<float, 4> area;
    for (std::size_t layer = 0; layer < 4; ++layer) {
      area[layer] = (b.u[layer] - a.u[layer]) * (c.v[layer] - a.v[layer]) -
                    (c.u[layer] - a.u[layer]) * (b.v[layer] - a.v[layer]);
    }
    const unsigned bits =
        (area[0] > 0.0F ? 1U : 0U) | (area[1] > 0.0F ? 2U : 0U) | (area[2] > 0.0F ? 4U : 0U);
    turned[face] = static_cast<std::uint8_t>(bits & wanted);
  }
  const std::int64_t u0 = kPlaces * (caster.first_u_ - cells_.u);
  const std::int64_t v0 = kPlaces * (caster.first_v_ - cells_.v);
  for (const FacePair& edge : edges) {
    const unsigned differ = turned[edge.forward] ^ turned[edge.back];
    if (differ == 0) continue;
    for (unsigned layer = 0; layer < 3; ++layer) {
      if ((differ >> layer & 1U) == 0) continue;
      // Along the face that is turned.
      const bool forward = (turned[edge.forward] >> layer & 1U) != 0;
      const MaskCaster::Images& a = images[forward ? edge.from : edge.to];
      const MaskCaster::Images& b = images[forward ? edge.to : edge.from];
      const auto whole = [](float at) { return static_cast<std::int64_t>(at); };
      add_edge(static_cast<int>(layer), u0 + whole(a.u[layer]), v0 + whole(a.v[layer]),
               u0 + whole(b.u[layer]), v0 + whole(b.v[layer]));
    }
  }
}

// Cut at the rows' borders. All divisions are of differences along the edge, so that where the
// picture begins changes nothing; and what is cut off goes to the next piece, so that the rows of a
// closed line add up to 0.
void MaskPicture::add_edge(int layer, std::int64_t u0, std::int64_t v0, std::int64_t u1,
                           std::int64_t v1) {
  if (v0 == v1) return;
  const std::int64_t du = u1 - u0;
  const std::int64_t dv = v1 - v0;
  const std::int64_t down = dv > 0 ? 1 : -1;
  std::int64_t u = u0;
  std::int64_t v = v0;
  // Of a point on a border, the row that the edge goes on in.
  std::int64_t row = floor_div(dv > 0 ? v0 : v0 - 1, kPlaces);
  while (v != v1) {
    const std::int64_t border = kPlaces * (dv > 0 ? row + 1 : row);
    const bool last = dv > 0 ? border >= v1 : border <= v1;
    const std::int64_t next_v = last ? v1 : border;
    const std::int64_t next_u = last ? u1 : u0 + floor_div(du * (border - v0), dv);
    add_in_row(layer, row, u, static_cast<int>(v - kPlaces * row), next_u,
               static_cast<int>(next_v - kPlaces * row));
    u = next_u;
    v = next_v;
    row += down;
  }
}

// To the left of the edge nothing changes, to the right all; in the cells that it runs through, the
// area beside it.
void MaskPicture::add_in_row(int layer, std::int64_t row, std::int64_t u0, int v0, std::int64_t u1,
                             int v1) {
  PENUMBRA_ASSERT(row >= 0 && row < cells_.height);
  const auto at = static_cast<std::size_t>(layer);
  auto* steps = &steps_[static_cast<std::size_t>(row) * static_cast<std::size_t>(cells_.width + 1)];
  std::int64_t cell = floor_div(u0, kPlaces);
  const std::int64_t last = floor_div(u1, kPlaces);
  auto& touched = rows_[static_cast<std::size_t>(row)];
  touched[0] = std::min(touched[0], static_cast<int>(std::min(cell, last)));
  touched[1] = std::max(touched[1], static_cast<int>(std::max(cell, last)));
  const auto add = [&](std::int64_t in_cell, std::int64_t from_u, std::int64_t to_u, int height) {
    const auto area = static_cast<std::int32_t>(height * (from_u + to_u - 2 * kPlaces * in_cell));
    auto* step = &steps[in_cell];
    step[0][at] += 2 * kPlaces * height - area;
    step[1][at] += area;
  };
  std::int64_t u = u0;
  int v = v0;
  const std::int64_t du = u1 - u0;
  const int dv = v1 - v0;
  while (cell != last) {
    const std::int64_t border = kPlaces * (du > 0 ? cell + 1 : cell);
    const int next_v = v0 + static_cast<int>(floor_div(dv * (border - u0), du));
    add(cell, u, border, next_v - v);
    u = border;
    v = next_v;
    cell += du > 0 ? 1 : -1;
  }
  add(cell, u, u1, v1 - v);
}

void MaskPicture::finish(const glm::vec3& light, std::vector<std::uint8_t>& codes) {
  const auto width = static_cast<std::size_t>(cells_.width);
  codes.assign(width * static_cast<std::size_t>(cells_.height), 255);
  for (std::size_t row = 0; row < rows_.size(); ++row) {
    if (rows_[row][1] < 0) continue;
    const auto first = static_cast<std::size_t>(rows_[row][0]);
    // What lies right of the last edge is not covered.
    const std::size_t end = std::min(static_cast<std::size_t>(rows_[row][1]) + 2, width + 1);
    std::array<std::int32_t, 4>* steps = &steps_[row * (width + 1)];
    std::uint8_t* out = &codes[row * width];
    std::array<std::int32_t, 4> covered{};
    std::uint8_t code = 255;
    for (std::size_t i = first; i < end; ++i) {
      // Most cells are like the one before.
      std::size_t next = i;
      while (next < end && is_level(steps[next])) ++next;
      std::fill(out + std::min(i, width), out + std::min(next, width), code);
      if (next == end) break;
      i = next;
      std::array<std::int32_t, 4>& step = steps[i];
      float left = 1.0F;
      for (int layer = 2; layer >= 0; --layer) {
        const auto at = static_cast<std::size_t>(layer);
        covered[at] += step[at];
        const std::int32_t whole = std::min(std::abs(covered[at]), kWhole);
        left += static_cast<float>(whole) * (1.0F / kWhole) * (light[layer] - left);
      }
      step = {};
      code = static_cast<std::uint8_t>(255.0F * left + 0.5F);
      if (i < width) out[i] = code;
    }
  }
}

}  // namespace penumbra
