#include "render/shadow/masks/mesh_edges.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <tuple>
#include <utility>

namespace penumbra {

std::optional<std::vector<SharedEdge>> paired_edges(std::span<const std::uint32_t> indices) {
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
      if (a == b) continue;  // zero area
      halves.push_back({std::min(a, b), std::max(a, b), static_cast<std::uint32_t>(i / 3), a < b});
    }
  }
  std::ranges::sort(halves, [](const Half& a, const Half& b) {
    return std::tie(a.low, a.high, a.forward, a.face) < std::tie(b.low, b.high, b.forward, b.face);
  });
  std::vector<SharedEdge> pairs;
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

std::optional<std::vector<std::uint32_t>> oriented_faces(std::span<const glm::vec3> positions,
                                                         std::span<const std::uint32_t> indices) {
  std::map<std::tuple<float, float, float>, std::uint32_t> distinct_positions;
  std::vector<std::uint32_t> position_index;
  position_index.reserve(positions.size());
  for (const glm::vec3& p : positions) {
    const auto next = static_cast<std::uint32_t>(distinct_positions.size());
    position_index.push_back(distinct_positions.try_emplace({p.x, p.y, p.z}, next).first->second);
  }
  std::vector<std::uint32_t> faces;
  for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
    const std::array<std::uint32_t, 3> at = {
        position_index[indices[i]], position_index[indices[i + 1]], position_index[indices[i + 2]]};
    if (at[0] == at[1] || at[1] == at[2] || at[2] == at[0]) continue;
    faces.insert(faces.end(), {indices[i], indices[i + 1], indices[i + 2]});
  }
  struct Side {
    std::uint32_t face;
    bool forward;  // from the lower position to the higher
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<Side>> sides;
  const auto edge_of = [&](std::size_t face, std::size_t corner) {
    return std::pair(position_index[faces[3 * face + corner]],
                     position_index[faces[3 * face + (corner + 1) % 3]]);
  };
  const std::size_t count = faces.size() / 3;
  for (std::size_t face = 0; face < count; ++face) {
    for (std::size_t corner = 0; corner < 3; ++corner) {
      const auto [a, b] = edge_of(face, corner);
      std::vector<Side>& of_edge = sides[std::minmax(a, b)];
      if (of_edge.size() == 2) return std::nullopt;
      of_edge.push_back({static_cast<std::uint32_t>(face), a < b});
    }
  }
  enum class Turn : std::uint8_t { unknown, kept, turned };
  std::vector<Turn> turns(count, Turn::unknown);
  std::vector<std::uint32_t> to_visit;
  for (std::size_t first = 0; first < count; ++first) {
    if (turns[first] != Turn::unknown) continue;
    turns[first] = Turn::kept;
    to_visit.push_back(static_cast<std::uint32_t>(first));
    while (!to_visit.empty()) {
      const std::uint32_t face = to_visit.back();
      to_visit.pop_back();
      for (std::size_t corner = 0; corner < 3; ++corner) {
        const auto [a, b] = edge_of(face, corner);
        const std::vector<Side>& of_edge = sides.at(std::minmax(a, b));
        if (of_edge.size() < 2) continue;
        const Side& other = of_edge[of_edge[0].face == face ? 1 : 0];
        const bool agree = of_edge[0].forward != of_edge[1].forward;
        const Turn wanted = (turns[face] == Turn::kept) == agree ? Turn::kept : Turn::turned;
        if (turns[other.face] == Turn::unknown) {
          turns[other.face] = wanted;
          to_visit.push_back(other.face);
        } else if (turns[other.face] != wanted) {
          return std::nullopt;
        }
      }
    }
  }
  for (std::size_t face = 0; face < count; ++face) {
    if (turns[face] == Turn::turned) std::swap(faces[3 * face + 1], faces[3 * face + 2]);
  }
  return faces;
}

}  // namespace penumbra
