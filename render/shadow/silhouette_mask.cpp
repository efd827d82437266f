#include "render/shadow/silhouette_mask.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <tuple>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/shadow/caster.hpp"

namespace penumbra {
namespace {

constexpr int kPlaceBits = 8;
constexpr int kPlaces = 1 << kPlaceBits;                // that a cell is told into, along each side
constexpr std::int32_t kWhole = 2 * kPlaces * kPlaces;  // a covered cell
constexpr std::size_t kFlagsAtOnce = sizeof(std::uint64_t);

// What is left of the picture's value where so much of a cell is covered by each layer.
PENUMBRA_VECTOR_CLONES
void codes_of(const std::int32_t* umbra, const std::int32_t* middle, const std::int32_t* penumbra,
              std::size_t count, float umbra_light, float middle_light, float penumbra_light,
              std::uint8_t* codes) {
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC ivdep  // four arrays
#endif
  for (std::size_t i = 0; i < count; ++i) {
    const auto share = [](std::int32_t covered) {
      const std::int32_t area = covered < 0 ? -covered : covered;
      return static_cast<float>(area < kWhole ? area : kWhole) * (1.0F / kWhole);
    };
    float left = 1.0F;
    left += share(penumbra[i]) * (penumbra_light - left);
    left += share(middle[i]) * (middle_light - left);
    left += share(umbra[i]) * (umbra_light - left);
    codes[i] = static_cast<std::uint8_t>(static_cast<std::int32_t>(255.0F * left + 0.5F));
  }
}

struct Quotient {
  int whole, rest;  // 0 <= rest < by

  void add(const Quotient& other, int by) {
    whole += other.whole;
    rest += other.rest;
    if (rest < by) return;
    rest -= by;
    ++whole;
  }
};
// Rounded down; by > 0.
Quotient divide(int value, int by) {
  const Quotient towards_0{value / by, value % by};
  return towards_0.rest < 0 ? Quotient{towards_0.whole - 1, towards_0.rest + by} : towards_0;
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
      return first + (static_cast<std::int64_t>(at) >> kPlaceBits);
    };
    bounds_.extend(Eigen::Vector<std::int64_t, 2>(cell_of(low.u[layer], first_u_),
                                                  cell_of(low.v[layer], first_v_)));
    bounds_.extend(Eigen::Vector<std::int64_t, 2>(cell_of(high.u[layer], first_u_),
                                                  cell_of(high.v[layer], first_v_)));
  }
}

void MaskPicture::begin(const MaskCells& cells) {
  cells_ = cells;
  row_cells_ = (static_cast<std::size_t>(cells.width) + kFlagsAtOnce) / kFlagsAtOnce * kFlagsAtOnce;
  // finish() leaves them all 0.
  const std::size_t needed = row_cells_ * static_cast<std::size_t>(cells.height);
  if (steps_.size() >= needed) return;
  steps_.resize(needed);
  touched_.resize(needed);
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
  const auto u0 = static_cast<int>(kPlaces * (caster.first_u_ - cells_.u));
  const auto v0 = static_cast<int>(kPlaces * (caster.first_v_ - cells_.v));
  for (const FacePair& edge : edges) {
    const unsigned differ = turned[edge.forward] ^ turned[edge.back];
    if (differ == 0) continue;
    for (unsigned layer = 0; layer < 3; ++layer) {
      if ((differ >> layer & 1U) == 0) continue;
      // Along the face that is turned.
      const bool forward = (turned[edge.forward] >> layer & 1U) != 0;
      const MaskCaster::Images& a = images[forward ? edge.from : edge.to];
      const MaskCaster::Images& b = images[forward ? edge.to : edge.from];
      const auto whole = [](float at) { return static_cast<int>(at); };
      add_edge(static_cast<int>(layer), u0 + whole(a.u[layer]), v0 + whole(a.v[layer]),
               u0 + whole(b.u[layer]), v0 + whole(b.v[layer]));
    }
  }
}

// Cut at the rows' borders. All divisions are of differences along the edge, so that where the
// picture begins changes nothing; and what is cut off goes to the next piece, so that the rows of a
// closed line add up to 0.
void MaskPicture::add_edge(int layer, int u0, int v0, int u1, int v1) {
  if (v0 == v1) return;
  const bool down = v1 > v0;
  // Of a point on a border, the row that the edge goes on in.
  int row = (down ? v0 : v0 - 1) >> kPlaceBits;
  const int last = (down ? v1 - 1 : v1) >> kPlaceBits;
  PENUMBRA_ASSERT(std::min(row, last) >= 0 && std::max(row, last) < cells_.height);
  const int step = down ? 1 : -1;
  const int border = down ? kPlaces : 0;
  const int rise = down ? v1 - v0 : v0 - v1;
  int u = u0;
  int v = v0 - kPlaces * row;
  Quotient along{0, 0};
  Quotient a_row{0, 0};
  if (row != last) along = divide((u1 - u0) * (down ? kPlaces - v : v), rise);
  if (row + step != last) a_row = divide((u1 - u0) * kPlaces, rise);
  while (true) {
    const bool at_end = row == last;
    const int next_u = at_end ? u1 : u0 + along.whole;
    const std::ptrdiff_t begin = row * static_cast<std::ptrdiff_t>(row_cells_);
    add_in_row(layer, begin, u, v, next_u, at_end ? v1 - kPlaces * row : border);
    if (at_end) return;
    along.add(a_row, rise);
    u = next_u;
    v = kPlaces - border;
    row += step;
  }
}

// To the left of the edge nothing changes, to the right all; in the cells that it runs through, the
// area beside it.
inline void MaskPicture::add_in_row(int layer, std::ptrdiff_t begin, int u0, int v0, int u1,
                                    int v1) {
  const int first = u0 >> kPlaceBits;
  const int last = u1 >> kPlaceBits;
  const auto at = static_cast<std::size_t>(layer);
  auto* steps = steps_.data() + begin + first;
  std::uint8_t* touched = touched_.data() + begin + first;
  // Twice what lies beside the edge in a cell: of a height, and the sum of two places in the cell.
  const auto add = [&steps, &touched, at](int height, int places) {
    const int area = height * places;
    steps[0][at] += 2 * kPlaces * height - area;
    steps[1][at] += area;
    touched[0] = touched[1] = 1;
  };
  const int from = u0 - kPlaces * first;
  const int to = u1 - kPlaces * last;
  if (first == last) {
    add(v1 - v0, from + to);
    return;
  }
  const bool right = last > first;
  const int step = right ? 1 : -1;
  const int border = right ? kPlaces : 0;
  const int run = right ? u1 - u0 : u0 - u1;
  Quotient along = divide((v1 - v0) * (right ? kPlaces - from : from), run);
  int v = v0 + along.whole;
  add(v - v0, from + border);
  steps += step;
  touched += step;
  int cell = first + step;
  if (cell != last) {
    const Quotient a_cell = divide((v1 - v0) * kPlaces, run);
    for (; cell != last; cell += step, steps += step, touched += step) {
      along.add(a_cell, run);
      const int next_v = v0 + along.whole;
      add(next_v - v, kPlaces);
      v = next_v;
    }
  }
  add(v1 - v, kPlaces - border + to);
}

void MaskPicture::finish(const glm::vec3& light, std::vector<std::uint8_t>& codes) {
  const auto width = static_cast<std::size_t>(cells_.width);
  const auto height = static_cast<std::size_t>(cells_.height);
  codes.resize(width * height);
  changed_.resize(row_cells_);
  for (std::vector<std::int32_t>& covered : covered_) covered.resize(row_cells_);
  changed_codes_.resize(row_cells_);
  std::uint32_t* changed = changed_.data();
  std::int32_t* umbra = covered_[0].data();
  std::int32_t* middle = covered_[1].data();
  std::int32_t* penumbra = covered_[2].data();
  for (std::size_t row = 0; row < height; ++row) {
    std::array<std::int32_t, 4>* steps = &steps_[row * row_cells_];
    std::uint8_t* touched = &touched_[row * row_cells_];
    std::array<std::int32_t, 3> covered{};
    std::size_t count = 0;
    for (std::size_t block = 0; block < row_cells_; block += kFlagsAtOnce) {
      std::uint64_t flags = 0;
      std::memcpy(&flags, touched + block, sizeof(flags));
      if (flags == 0) continue;
      std::memset(touched + block, 0, sizeof(flags));
      do {
        const std::size_t i = block + static_cast<std::size_t>(std::countr_zero(flags)) / 8;
        flags &= flags - 1;
        std::array<std::int32_t, 4>& step = steps[i];
        umbra[count] = covered[0] += step[0];
        middle[count] = covered[1] += step[1];
        penumbra[count] = covered[2] += step[2];
        step = {};
        changed[count++] = static_cast<std::uint32_t>(i);
      } while (flags != 0);
    }
    std::uint8_t* out = codes.data() + row * width;
    std::fill_n(out, width, std::uint8_t{255});
    codes_of(umbra, middle, penumbra, count, light.x, light.y, light.z, changed_codes_.data());
    // What lies between is like the cell before; what lies right of the last is not covered.
    const std::uint8_t* code = changed_codes_.data();
    for (std::size_t i = 0; i < count && changed[i] < width; ++i) {
      out[changed[i]] = code[i];
      if (code[i] == 255 || i + 1 == count) continue;
      const std::size_t next = std::min<std::size_t>(changed[i + 1], width);
      for (std::size_t cell = changed[i] + 1; cell < next; ++cell) out[cell] = code[i];
    }
  }
}

}  // namespace penumbra
