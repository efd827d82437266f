// Memory for the samples of all tags.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "tracking/alignment/simd/alignment_loops.hpp"

namespace penumbra {

// Rounds the number of samples up to whole blocks.
[[nodiscard]] constexpr int padded(int samples) {
  return (samples + simd::kBlock - 1) / simd::kBlock * simd::kBlock;
}

// Frees all arrays together, so that the next stage reuses memory in the cache. Writes the first
// part on construction, so that no frame waits for a page fault.
class SampleArena {
 public:
  explicit SampleArena(std::size_t initial_floats) { parts_.emplace_back(initial_floats); }
  void free_samples() {
    part_ = 0;
    used_ = 0;
  }
  // Allocates 64-byte aligned arrays of `capacity` samples, except `leverage`, `vertex` and the
  // elements of `c` that `reach` does not use.
  void allocate(int capacity, int reach, simd::Samples& s) {
    s.count = padded(capacity);
    allocate_each(s.count, s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.value, s.weight, s.model,
                  s.residual);
    allocate_anchors(reach, s);
  }
  // Allocates new arrays for the members that depend on the anchor.
  void allocate_anchors(int reach, simd::Samples& s) {
    allocate_each(s.count, s.va, s.vb, s.ka, s.kb, s.rho, s.c[0], s.c[1], s.c[2], s.c[3]);
    if (reach > 1)
      allocate_each(s.count, s.c[4], s.c[5], s.c[6], s.c[7], s.c[8], s.c[9], s.c[10], s.c[11],
                    s.c[12], s.c[13], s.c[14], s.c[15]);
  }
  // Allocates `count` floats, 64-byte aligned if all counts are multiples of 16.
  [[nodiscard]] float* floats(std::size_t count) {
    while (part_ < parts_.size() && used_ + count > parts_[part_].size) {
      ++part_;
      used_ = 0;
    }
    if (part_ == parts_.size()) parts_.emplace_back(std::max(count, parts_[0].size / 4));
    float* const at = parts_[part_].begin() + used_;
    used_ += count;
#ifdef EIGEN_INITIALIZE_MATRICES_BY_NAN
    // Exposes reads of uninitialised memory, as for Eigen's matrices.
    std::fill_n(at, count, std::numeric_limits<float>::quiet_NaN());
#endif
    return at;
  }
  // Allocates floats that are valid only until the next allocation.
  [[nodiscard]] float* temporary_floats(std::size_t count) {
    float* const at = floats(count);
    used_ -= count;
    return at;
  }

 private:
  template <class... Array>
  void allocate_each(int count, Array&... arrays) {
    const auto each = static_cast<std::size_t>(count);
    float* next = floats(sizeof...(arrays) * each);
    ((arrays = std::exchange(next, next + each)), ...);
  }
  struct Part {
    explicit Part(std::size_t count) : size(count), data(count + 16, 0.0F) {}
    [[nodiscard]] float* begin() {
      const auto address = reinterpret_cast<std::uintptr_t>(data.data());
      return data.data() + ((64 - address % 64) % 64) / sizeof(float);
    }
    std::size_t size = 0;
    std::vector<float> data;
  };
  std::vector<Part> parts_;
  std::size_t part_ = 0, used_ = 0;
};

}  // namespace penumbra
