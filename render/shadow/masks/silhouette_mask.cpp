#include "render/shadow/masks/silhouette_mask.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

#include "core/assert.hpp"
#include "core/vector_clones.hpp"
#include "render/shadow/casters/caster.hpp"

namespace penumbra {
namespace {

constexpr int kPlaceBits = 8;
constexpr int kPlaces = 1 << kPlaceBits;                // that a cell is told into, along each side
constexpr std::int32_t kWhole = 2 * kPlaces * kPlaces;  // a covered cell
constexpr std::size_t kFlagsAtOnce = sizeof(std::uint64_t);
// Places from the object's origin, so that products of their differences fit into 64 bits.
constexpr float kFarthest = 1 << 29;
// Cells along a side, so that those of differences and kPlaces fit into 32.
constexpr int kMostOfPicture = 1 << 14;
// That a sum can hold; and what it is cut to to make room for more, which is many times a cell,
// lest what edges are rounded to should count.
constexpr std::size_t kMostSheets = std::numeric_limits<std::int32_t>::max() / kWhole;
constexpr std::size_t kSettledSheets = 512;
constexpr std::size_t kSheetsAtOnce = kMostSheets - kSettledSheets;
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
    // A layer lies within the next lighter one, and where they are in contact with the plane their
    // edges are one: shares are of the same part of the cell.
    const float dark = share(umbra[i]);
    const float half = std::max(dark, share(middle[i]));
    const float any = std::max(half, share(penumbra[i]));
    const float left = 1.0F + any * (penumbra_light - 1.0F) +
                       half * (middle_light - penumbra_light) + dark * (umbra_light - middle_light);
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
std::int64_t quotient(std::int64_t value, std::int64_t by) {
  const std::int64_t towards_0 = value / by;
  return towards_0 * by > value ? towards_0 - 1 : towards_0;
}
Quotient divide(int value, int by) {
  const Quotient towards_0{value / by, value % by};
  return towards_0.rest < 0 ? Quotient{towards_0.whole - 1, towards_0.rest + by} : towards_0;
}

}  // namespace

void MaskCaster::begin(const OwnFrame& own, double cell) {
  wanted_ = {};
  bounds_.setEmpty();
  for (std::vector<Place>& faces : faces_) faces.clear();
  for (std::vector<Place>& sides : sides_) sides.clear();
  T_plane_own_ = own.T_plane_own;
  cell_ = cell;
  const Eigen::Vector2d slide = T_plane_own_.slide / cell;
  first_u_ = static_cast<std::int64_t>(std::floor(slide.x()));
  first_v_ = static_cast<std::int64_t>(std::floor(slide.y()));
}

// Nothing where it is no number.
std::optional<MaskCaster::Place> MaskCaster::place_of(const PlanePoint& p) const {
  const Eigen::Vector2d first(static_cast<double>(first_u_), static_cast<double>(first_v_));
  const Eigen::Vector2d on_plane =
      T_plane_own_ * Eigen::Vector2d(static_cast<double>(p.u), static_cast<double>(p.v));
  Eigen::Vector2d at = kPlaces * (on_plane / cell_ - first);
  constexpr double kMost = kFarthest;
  if (!(std::abs(at.x()) <= kMost && std::abs(at.y()) <= kMost)) {
    if (!at.allFinite()) return std::nullopt;
    at = at.cwiseMax(-kMost).cwiseMin(kMost);
  }
  return Place{std::llround(at.x()), std::llround(at.y())};
}

void MaskCaster::extend_bounds(const Place& place) {
  bounds_.extend(Place(first_u_ + (place.x() >> kPlaceBits), first_v_ + (place.y() >> kPlaceBits)));
}

void MaskCaster::project_faces(ShadowLayer layer, std::span<const PlanePoint> triangles) {
  std::vector<Place>& places = faces_[static_cast<std::size_t>(layer)];
  places.clear();
  places.reserve(triangles.size());
  for (std::size_t i = 0; i + 2 < triangles.size(); i += 3) {
    const std::array<std::optional<Place>, 3> face = {
        place_of(triangles[i]), place_of(triangles[i + 1]), place_of(triangles[i + 2])};
    if (!face[0] || !face[1] || !face[2]) continue;
    for (const std::optional<Place>& place : face) {
      places.push_back(*place);
      extend_bounds(*place);
    }
  }
}

void MaskCaster::project_outline(ShadowLayer layer, std::span<const OutlineSide> sides) {
  std::vector<Place>& places = sides_[static_cast<std::size_t>(layer)];
  places.clear();
  places.reserve(2 * sides.size());
  for (const OutlineSide& side : sides) {
    const std::optional<Place> from = place_of(side.from);
    const std::optional<Place> to = place_of(side.to);
    if (!from || !to) {  // a line that isn't closed bounds nothing
      places.clear();
      return;
    }
    places.push_back(*from);
    places.push_back(*to);
  }
  for (const Place& place : places) extend_bounds(place);
}

void MaskCaster::project(std::span<const glm::vec3> positions, std::span<const glm::vec3> kernels,
                         const OwnFrame& own, const LayeredConstants& constants,
                         const std::array<bool, 3>& wanted, double cell) {
  PENUMBRA_ASSERT(kernels.size() >= positions.size());
  begin(own, cell);
  wanted_ = wanted;
  if (positions.empty()) return;
  // Turned on the plane, in cells, from the cell under the object's origin.
  const PlaneMap map = plane_map(own.T_own_object, PlaneFrame());
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  turn.topLeftCorner<2, 2>() << own.T_plane_own.cosine, -own.T_plane_own.sine, own.T_plane_own.sine,
      own.T_plane_own.cosine;
  const Eigen::Matrix3d linear = turn * map.linear;
  Eigen::Vector3d offset = turn * map.offset;
  const Eigen::Vector2d slide = own.T_plane_own.slide / cell;
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
  const auto cell_of = [](float at, std::int64_t first) {
    return first + (static_cast<std::int64_t>(at) >> kPlaceBits);
  };
  for (std::size_t layer = 0; layer < 3; ++layer) {
    if (!wanted_[layer]) continue;
    const std::array<float, 2> lowest = {low.u[layer], low.v[layer]};
    const std::array<float, 2> highest = {high.u[layer], high.v[layer]};
    for (std::size_t axis = 0; axis < 2; ++axis) {
      // Where nothing is a number, the lowest is higher than the highest.
      if (lowest[axis] >= -kFarthest && highest[axis] <= kFarthest && lowest[axis] <= highest[axis])
        continue;
      bring_near();
      return;
    }
    bounds_.extend(Place(cell_of(low.u[layer], first_u_), cell_of(low.v[layer], first_v_)));
    bounds_.extend(Place(cell_of(high.u[layer], first_u_), cell_of(high.v[layer], first_v_)));
  }
}

// A face with a place that is not a number turns neither way, so that none of its edges counts.
void MaskCaster::bring_near() {
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
      u = std::clamp(u, -kFarthest, kFarthest);
      v = std::clamp(v, -kFarthest, kFarthest);
      bounds_.extend(Place(first_u_ + (static_cast<std::int64_t>(u) >> kPlaceBits),
                           first_v_ + (static_cast<std::int64_t>(v) >> kPlaceBits)));
    }
  }
}

void MaskPicture::begin(const MaskCells& cells) {
  cells_ = cells;
  sheets_ = {};
  row_cells_ = (static_cast<std::size_t>(cells.width) + kFlagsAtOnce) / kFlagsAtOnce * kFlagsAtOnce;
  // finish() and take() leave them all 0.
  const std::size_t needed = row_cells_ * static_cast<std::size_t>(cells.height);
  if (steps_.size() >= needed) return;
  steps_.resize(needed);
  touched_.resize(needed);
}

void MaskPicture::cover(MaskCaster& caster, std::span<const std::uint32_t> indices,
                        std::span<const FacePair> edges) {
  const Eigen::AlignedBox<std::int64_t, 2> own(
      MaskCaster::Place(cells_.u, cells_.v),
      MaskCaster::Place(cells_.u + cells_.width - 1, cells_.v + cells_.height - 1));
  // What lies to the left adds up to nothing.
  if (!own.intersects(caster.bounds_)) return;
  const bool clipped =
      !own.contains(caster.bounds_) || std::max(cells_.width, cells_.height) > kMostOfPicture;
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
  // Over any point as many faces are turned as are not; and as many edges of those lead up past it
  // as down.
  std::size_t sheets = (turned.size() + 1) / 2;
  if (sheets > kSheetsAtOnce) {
    const auto outlines = std::ranges::count_if(edges, [&turned](const FacePair& edge) {
      return turned[edge.forward] != turned[edge.back];
    });
    sheets = std::min(sheets, (static_cast<std::size_t>(outlines) + 1) / 2);
  }
  if (sheets > kSheetsAtOnce) {
    clipped ? cover_turned<true>(caster, indices) : cover_turned<false>(caster, indices);
  } else {
    for (int layer = 0; layer < 3; ++layer) {
      if (caster.wanted_[static_cast<std::size_t>(layer)]) make_room(layer, sheets);
    }
    clipped ? cover_outlines<true>(caster, edges) : cover_outlines<false>(caster, edges);
  }
  for (int layer = 0; layer < 3; ++layer) {
    clipped ? cover_faces<true>(caster, layer) : cover_faces<false>(caster, layer);
    clipped ? cover_lines<true>(caster, layer) : cover_lines<false>(caster, layer);
  }
}

template <bool kClipped>
void MaskPicture::cover_outlines(const MaskCaster& caster, std::span<const FacePair> edges) {
  const std::vector<MaskCaster::Images>& images = caster.images_;
  const std::vector<std::uint8_t>& turned = caster.turned_;
  const auto u0 = static_cast<Offset<kClipped>>(kPlaces * (caster.first_u_ - cells_.u));
  const auto v0 = static_cast<Offset<kClipped>>(kPlaces * (caster.first_v_ - cells_.v));
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
      const auto at = static_cast<int>(layer);
      if constexpr (kClipped) {
        add_clipped_edge(steps_, at, u0 + whole(a.u[layer]), v0 + whole(a.v[layer]),
                         u0 + whole(b.u[layer]), v0 + whole(b.v[layer]));
      } else {
        add_edge(steps_, at, u0 + whole(a.u[layer]), v0 + whole(a.v[layer]), u0 + whole(b.u[layer]),
                 v0 + whole(b.v[layer]));
      }
    }
  }
}

// Faces that are turned one by one, as many at once as the sums can hold: of outlines it can't be
// told which of them belong together.
template <bool kClipped>
void MaskPicture::cover_turned(const MaskCaster& caster, std::span<const std::uint32_t> indices) {
  const auto u0 = static_cast<Offset<kClipped>>(kPlaces * (caster.first_u_ - cells_.u));
  const auto v0 = static_cast<Offset<kClipped>>(kPlaces * (caster.first_v_ - cells_.v));
  for (std::size_t layer = 0; layer < 3; ++layer) {
    for (std::size_t face = 0; face < caster.turned_.size(); ++face) {
      if ((caster.turned_[face] >> layer & 1U) == 0) continue;
      std::array<Place<kClipped>, 3> corners;
      for (std::size_t corner = 0; corner < 3; ++corner) {
        const MaskCaster::Images& at = caster.images_[indices[3 * face + corner]];
        corners[corner] = {u0 + static_cast<int>(at.u[layer]), v0 + static_cast<int>(at.v[layer])};
      }
      make_room(static_cast<int>(layer), 1);
      add_face<kClipped>(steps_, static_cast<int>(layer), corners);
    }
  }
}

template <bool kClipped>
void MaskPicture::cover_faces(const MaskCaster& caster, int layer) {
  const std::vector<MaskCaster::Place>& places = caster.faces_[static_cast<std::size_t>(layer)];
  const MaskCaster::Place first(kPlaces * (caster.first_u_ - cells_.u),
                                kPlaces * (caster.first_v_ - cells_.v));
  std::size_t room_for = 0;
  for (std::size_t i = 0; i + 2 < places.size(); i += 3) {
    if (i == room_for) {
      const std::size_t sheets = std::min(kSheetsAtOnce, (places.size() - i) / 3);
      make_room(layer, sheets);
      room_for += 3 * sheets;
    }
    std::array<Place<kClipped>, 3> p;
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const MaskCaster::Place at = first + places[i + corner];
      p[corner] = {static_cast<Offset<kClipped>>(at.x()), static_cast<Offset<kClipped>>(at.y())};
    }
    const std::int64_t area = static_cast<std::int64_t>(p[1].u - p[0].u) * (p[2].v - p[0].v) -
                              static_cast<std::int64_t>(p[2].u - p[0].u) * (p[1].v - p[0].v);
    if (area == 0) continue;
    if (area < 0) {
      if (back_.size() < steps_.size()) back_.resize(steps_.size());
      has_back_ = true;
      std::swap(p[1], p[2]);
    }
    add_face<kClipped>(area < 0 ? back_ : steps_, layer, p);
  }
}

// Each edge the same way round in both of its faces, so that what they round is the same.
template <bool kClipped>
inline void MaskPicture::add_face(Steps& to, int layer,
                                  const std::array<Place<kClipped>, 3>& corners) {
  const auto add = [&]<int kSign>(std::integral_constant<int, kSign>, const auto& a,
                                  const auto& b) {
    if constexpr (kClipped) {
      add_clipped_edge<kSign>(to, layer, a.u, a.v, b.u, b.v);
    } else {
      add_edge<kSign>(to, layer, a.u, a.v, b.u, b.v);
    }
  };
  for (std::size_t corner = 0; corner < 3; ++corner) {
    const Place<kClipped>& a = corners[corner];
    const Place<kClipped>& b = corners[(corner + 1) % 3];
    if (std::tie(a.v, a.u) < std::tie(b.v, b.u)) {
      add(std::integral_constant<int, 1>(), a, b);
    } else {
      add(std::integral_constant<int, -1>(), b, a);
    }
  }
}

// Closed lines of which none lies within another that turns the same way: a sheet.
template <bool kClipped>
void MaskPicture::cover_lines(const MaskCaster& caster, int layer) {
  const std::vector<MaskCaster::Place>& places = caster.sides_[static_cast<std::size_t>(layer)];
  if (places.empty()) return;
  make_room(layer, 1);
  const MaskCaster::Place first(kPlaces * (caster.first_u_ - cells_.u),
                                kPlaces * (caster.first_v_ - cells_.v));
  for (std::size_t i = 0; i + 1 < places.size(); i += 2) {
    const MaskCaster::Place from = first + places[i];
    const MaskCaster::Place to = first + places[i + 1];
    if constexpr (kClipped) {
      add_clipped_edge(steps_, layer, from.x(), from.y(), to.x(), to.y());
    } else {
      add_edge(steps_, layer, static_cast<int>(from.x()), static_cast<int>(from.y()),
               static_cast<int>(to.x()), static_cast<int>(to.y()));
    }
  }
}

void MaskPicture::make_room(int layer, std::size_t sheets) {
  std::size_t& held = sheets_[static_cast<std::size_t>(layer)];
  if (held + sheets > kMostSheets) settle();
  held += sheets;
  PENUMBRA_ASSERT(held <= kMostSheets);
}

// What is covered more often than kSettledSheets is covered so often: a cell that is covered once
// is so whatever covers it more.
void MaskPicture::settle() {
  static constexpr auto kMost = static_cast<std::int32_t>(kSettledSheets) * kWhole;
  const auto settle_row = [](std::array<std::int32_t, 4>* steps, const std::uint8_t* touched,
                             std::size_t count) {
    std::array<std::int32_t, 3> sum{};
    std::array<std::int32_t, 3> before{};
    for (std::size_t i = 0; i < count; ++i) {
      if (touched[i] == 0) continue;
      for (std::size_t layer = 0; layer < 3; ++layer) {
        sum[layer] += steps[i][layer];
        const std::int32_t held = std::clamp(sum[layer], -kMost, kMost);
        steps[i][layer] = held - before[layer];
        before[layer] = held;
      }
    }
  };
  for (std::size_t row = 0; row < static_cast<std::size_t>(cells_.height); ++row) {
    const std::size_t at = row * row_cells_;
    settle_row(&steps_[at], &touched_[at], row_cells_);
    if (has_back_) settle_row(&back_[at], &touched_[at], row_cells_);
  }
  for (std::size_t& held : sheets_) held = std::min(held, kSettledSheets);
}

void MaskPicture::cover(const MaskCover& cover) {
  const auto u = static_cast<int>(cover.u_ - cells_.u);
  const auto v = static_cast<int>(cover.v_ - cells_.v);
  for (int layer = 0; layer < 3; ++layer)
    make_room(layer, cover.sheets_[static_cast<std::size_t>(layer)]);
  if (!cover.back_.empty()) {
    if (back_.size() < steps_.size()) back_.resize(steps_.size());
    has_back_ = true;
  }
  for (std::size_t i = 0; i < cover.steps_.size(); ++i) {
    const MaskCover::Step& step = cover.steps_[i];
    PENUMBRA_ASSERT(u + step.u >= 0 && v + step.v >= 0 && v + step.v < cells_.height);
    const std::size_t at =
        static_cast<std::size_t>(v + step.v) * row_cells_ + static_cast<std::size_t>(u + step.u);
    for (std::size_t layer = 0; layer < 4; ++layer) steps_[at][layer] += step.front[layer];
    touched_[at] = 1;
    if (cover.back_.empty()) continue;
    for (std::size_t layer = 0; layer < 4; ++layer) back_[at][layer] += cover.back_[i][layer];
  }
}

void MaskPicture::take(MaskCover& cover) {
  cover.u_ = cells_.u;
  cover.v_ = cells_.v;
  cover.steps_.clear();
  cover.back_.clear();
  for (const std::size_t held : sheets_) {
    if (held <= kSheetsAtOnce) continue;
    settle();  // so that another picture has room for it
    break;
  }
  cover.sheets_ = sheets_;
  for (int v = 0; v < cells_.height; ++v) {
    const std::size_t row = static_cast<std::size_t>(v) * row_cells_;
    for (std::size_t u = 0; u < row_cells_; ++u) {
      if (touched_[row + u] == 0) continue;
      touched_[row + u] = 0;
      cover.steps_.push_back({static_cast<int>(u), v, std::exchange(steps_[row + u], {})});
      if (has_back_) cover.back_.push_back(std::exchange(back_[row + u], {}));
    }
  }
  has_back_ = false;
}

// Cut at the rows' borders. All divisions are of differences along the edge, so that where the
// picture begins changes nothing; and what is cut off goes to the next piece, so that the rows of a
// closed line add up to 0.
template <int kSign>
void MaskPicture::add_edge(Steps& sums, int layer, int u0, int v0, int u1, int v1) {
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
    add_in_row<kSign>(sums, layer, begin, u, v, next_u, at_end ? v1 - kPlaces * row : border);
    if (at_end) return;
    along.add(a_row, rise);
    u = next_u;
    v = kPlaces - border;
    row += step;
  }
}

// To the left of the edge nothing changes, to the right all; in the cells that it runs through, the
// area beside it.
template <int kSign>
inline void MaskPicture::add_in_row(Steps& sums, int layer, std::ptrdiff_t begin, int u0, int v0,
                                    int u1, int v1) {
  const int first = u0 >> kPlaceBits;
  const int last = u1 >> kPlaceBits;
  const auto at = static_cast<std::size_t>(layer);
  auto* steps = sums.data() + begin + first;
  std::uint8_t* touched = touched_.data() + begin + first;
  // Twice what lies beside the edge in a cell: of a height, and the sum of two places in the cell.
  const auto add = [&steps, &touched, at](int height, int places) {
    const int area = height * places;
    steps[0][at] += kSign * (2 * kPlaces * height - area);
    steps[1][at] += kSign * area;
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

// Of the rows that it crosses only those of the picture, from the same places on their borders.
template <int kSign>
void MaskPicture::add_clipped_edge(Steps& sums, int layer, std::int64_t u0, std::int64_t v0,
                                   std::int64_t u1, std::int64_t v1) {
  const std::int64_t right = std::int64_t{kPlaces} * cells_.width;
  const std::int64_t bottom = std::int64_t{kPlaces} * cells_.height;
  if (v0 == v1 || std::max(v0, v1) <= 0 || std::min(v0, v1) >= bottom) return;
  if (std::min(u0, u1) >= right) return;
  const bool small = std::max(cells_.width, cells_.height) <= kMostOfPicture;
  if (small && std::min({u0, u1, v0, v1}) >= 0 && std::max(u0, u1) < right &&
      std::max(v0, v1) <= bottom) {
    add_edge<kSign>(sums, layer, static_cast<int>(u0), static_cast<int>(v0), static_cast<int>(u1),
                    static_cast<int>(v1));
    return;
  }
  const bool down = v1 > v0;
  const std::int64_t rise = down ? v1 - v0 : v0 - v1;
  const std::int64_t last_of_all = cells_.height - 1;
  const std::int64_t first =
      std::clamp<std::int64_t>((down ? v0 : v0 - 1) >> kPlaceBits, 0, last_of_all);
  const std::int64_t last =
      std::clamp<std::int64_t>((down ? v1 - 1 : v1) >> kPlaceBits, 0, last_of_all);
  // Where it is when it has come to a row's border; at its ends, there.
  struct Point {
    std::int64_t u, v;
  };
  const auto at = [&](std::int64_t v) {
    if (down ? v <= v0 : v >= v0) return Point{u0, v0};
    if (down ? v >= v1 : v <= v1) return Point{u1, v1};
    return Point{u0 + quotient((u1 - u0) * (down ? v - v0 : v0 - v), rise), v};
  };
  const std::int64_t step = down ? 1 : -1;
  Point from = at(kPlaces * (down ? first : first + 1));
  for (std::int64_t row = first;; row += step) {
    const Point to = at(kPlaces * (down ? row + 1 : row));
    add_clipped_in_row<kSign>(sums, layer, row * static_cast<std::ptrdiff_t>(row_cells_), from.u,
                              static_cast<int>(from.v - kPlaces * row), to.u,
                              static_cast<int>(to.v - kPlaces * row));
    if (row == last) return;
    from = to;
  }
}

template <int kSign>
void MaskPicture::add_clipped_in_row(Steps& sums, int layer, std::ptrdiff_t begin, std::int64_t u0,
                                     int v0, std::int64_t u1, int v1) {
  const auto at = static_cast<std::size_t>(layer);
  const auto add = [&](std::int64_t cell, int height, int places) {
    const std::ptrdiff_t i = begin + cell;
    const int area = height * places;
    auto* steps = sums.data() + i;
    steps[0][at] += kSign * (2 * kPlaces * height - area);
    steps[1][at] += kSign * area;
    touched_[static_cast<std::size_t>(i)] = touched_[static_cast<std::size_t>(i) + 1] = 1;
  };
  const std::int64_t first = u0 >> kPlaceBits;
  const std::int64_t last = u1 >> kPlaceBits;
  const bool right = last >= first;
  const std::int64_t run = right ? u1 - u0 : u0 - u1;
  // How far down it has come at a column's border.
  const auto down_at = [&](std::int64_t u) {
    return v0 + static_cast<int>(quotient((v1 - v0) * (right ? u - u0 : u0 - u),
                                          std::max<std::int64_t>(run, 1)));
  };
  int v = v0;
  std::int64_t cell = first;
  if (right) {
    if (cell < 0) {
      const int next = last < 0 ? v1 : down_at(0);
      add(0, next - v, 0);
      v = next;
      cell = 0;
    }
    const std::int64_t end = std::min<std::int64_t>(last, cells_.width - 1);
    for (; cell <= end; ++cell) {
      const int next = cell == last ? v1 : down_at(kPlaces * (cell + 1));
      const auto from = static_cast<int>(cell == first ? u0 - kPlaces * cell : 0);
      const auto to = static_cast<int>(cell == last ? u1 - kPlaces * cell : kPlaces);
      add(cell, next - v, from + to);
      v = next;
    }
    return;
  }
  if (cell >= cells_.width) {
    cell = cells_.width - 1;
    if (cell < last) return;
    v = down_at(kPlaces * (cell + 1));
  }
  for (; cell >= std::max<std::int64_t>(last, 0); --cell) {
    const int next = cell == last ? v1 : down_at(kPlaces * cell);
    const auto from = static_cast<int>(cell == first ? u0 - kPlaces * cell : kPlaces);
    const auto to = static_cast<int>(cell == last ? u1 - kPlaces * cell : 0);
    add(cell, next - v, from + to);
    v = next;
  }
  if (last < 0) add(0, v1 - v, 0);
}

void MaskPicture::begin_rows() {
  changed_.resize(row_cells_);
  for (std::vector<std::int32_t>& covered : covered_) covered.resize(row_cells_);
}

void MaskPicture::finish(const glm::vec3& light, std::vector<std::uint8_t>& codes) {
  codes.resize(static_cast<std::size_t>(cells_.width) * static_cast<std::size_t>(cells_.height));
  finish(light, std::span<std::uint8_t>(codes));
}

void MaskPicture::finish(const glm::vec3& light, std::span<std::uint8_t> codes) {
  const auto width = static_cast<std::size_t>(cells_.width);
  const auto height = static_cast<std::size_t>(cells_.height);
  PENUMBRA_ASSERT(codes.size() == width * height);
  begin_rows();
  changed_codes_.resize(row_cells_);
  for (std::size_t row = 0; row < height; ++row) {
    std::uint8_t* out = codes.data() + row * width;
    std::fill_n(out, width, std::uint8_t{255});
    const std::size_t count = finish_row(row);
    codes_of(covered_[0].data(), covered_[1].data(), covered_[2].data(), count, light.x, light.y,
             light.z, changed_codes_.data());
    // What lies between is like the cell before, and so is what lies right of the last: not covered
    // but where something reaches beyond the picture.
    const std::uint8_t* code = changed_codes_.data();
    for (std::size_t i = 0; i < count && changed_[i] < width; ++i) {
      out[changed_[i]] = code[i];
      if (code[i] == 255) continue;
      const std::size_t next =
          i + 1 == count ? width : std::min<std::size_t>(changed_[i + 1], width);
      for (std::size_t cell = changed_[i] + 1; cell < next; ++cell) out[cell] = code[i];
    }
  }
  has_back_ = false;
}

void MaskPicture::finish_shares(const MaskCells& part, std::span<std::uint8_t> rgba) {
  PENUMBRA_ASSERT(part.size == cells_.size &&
                  rgba.size() == std::size_t{4} * static_cast<std::size_t>(part.width) *
                                     static_cast<std::size_t>(part.height));
  std::ranges::fill(rgba, std::uint8_t{0});
  begin_rows();
  const auto code = [](std::int32_t covered) {
    const std::int32_t area = std::min(covered < 0 ? -covered : covered, kWhole);
    return static_cast<std::uint8_t>((std::int64_t{255} * area + kWhole / 2) / kWhole);
  };
  for (int row = 0; row < cells_.height; ++row) {
    const std::size_t count = finish_row(static_cast<std::size_t>(row));
    const std::int64_t part_row = cells_.v + row - part.v;
    if (part_row < 0 || part_row >= part.height) continue;
    std::uint8_t* out = rgba.data() + 4 * part_row * part.width;
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint8_t umbra = code(covered_[0][i]);
      const std::uint8_t middle = std::max(umbra, code(covered_[1][i]));
      const std::uint8_t penumbra = std::max(middle, code(covered_[2][i]));
      if (penumbra == 0) continue;
      const auto at = [&](std::int64_t column) {
        return std::clamp<std::int64_t>(cells_.u + column - part.u, 0, part.width);
      };
      const std::int64_t width = cells_.width;
      const std::int64_t end =
          at(i + 1 == count ? width : std::min<std::int64_t>(changed_[i + 1], width));
      for (std::int64_t cell = at(changed_[i]); cell < end; ++cell) {
        out[4 * cell] = umbra;
        out[4 * cell + 1] = middle;
        out[4 * cell + 2] = penumbra;
      }
    }
  }
  has_back_ = false;
}

std::size_t MaskPicture::finish_row(std::size_t row) {
  return has_back_ ? gather_row<true>(row) : gather_row<false>(row);
}

template <bool kBack>
std::size_t MaskPicture::gather_row(std::size_t row) {
  std::uint32_t* changed = changed_.data();
  std::array<std::int32_t*, 3> share = {covered_[0].data(), covered_[1].data(), covered_[2].data()};
  std::array<std::int32_t, 4>* steps = &steps_[row * row_cells_];
  std::array<std::int32_t, 4>* back_steps = kBack ? &back_[row * row_cells_] : nullptr;
  std::uint8_t* touched = &touched_[row * row_cells_];
  std::array<std::int32_t, 3> covered{};
  std::array<std::int32_t, 3> behind{};
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
      for (std::size_t layer = 0; layer < 3; ++layer) {
        share[layer][count] = covered[layer] += step[layer];
        if constexpr (kBack) {
          behind[layer] += back_steps[i][layer];
          if (std::abs(behind[layer]) > std::abs(covered[layer]))
            share[layer][count] = behind[layer];
        }
      }
      step = {};
      if constexpr (kBack) back_steps[i] = {};
      changed[count++] = static_cast<std::uint32_t>(i);
    } while (flags != 0);
  }
  return count;
}

}  // namespace penumbra
