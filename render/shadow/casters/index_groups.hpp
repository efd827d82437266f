// Indices sorted by a key, such as the faces of each part of a mesh.
#pragma once

#include <cstdint>
#include <numeric>
#include <span>
#include <vector>

namespace penumbra {

// Keeps its memory from one use to the next.
class IndexGroups {
 public:
  // Sorts the indices 0 to count - 1 by key_of(index) < `groups`; stable.
  template <class KeyOf>
  void sort(std::size_t count, std::size_t groups, const KeyOf& key_of) {
    begin_.assign(groups + 1, 0);
    for (std::size_t i = 0; i < count; ++i) ++begin_[key_of(i) + 1];
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    next_.assign(begin_.begin(), begin_.end() - 1);
    indices_.resize(count);
    for (std::size_t i = 0; i < count; ++i)
      indices_[next_[key_of(i)]++] = static_cast<std::uint32_t>(i);
  }
  [[nodiscard]] std::size_t size() const { return begin_.empty() ? 0 : begin_.size() - 1; }
  [[nodiscard]] std::size_t begin(std::size_t group) const { return begin_[group]; }
  [[nodiscard]] std::span<const std::uint32_t> operator[](std::size_t group) const {
    return std::span(indices_).subspan(begin_[group], begin_[group + 1] - begin_[group]);
  }
  [[nodiscard]] const std::vector<std::uint32_t>& indices() const { return indices_; }

 private:
  std::vector<std::uint32_t> begin_, next_, indices_;
};

}  // namespace penumbra
