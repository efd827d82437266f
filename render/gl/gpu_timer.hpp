// Measures the GPU time of draw calls by timer queries. Results arrive some frames later.
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "render/gl/context.hpp"
#include "render/gl/handle.hpp"

namespace penumbra {

class GpuTimer {
 public:
  // Maximum number of pending results; a GPU is two or three frames behind.
  static constexpr std::size_t kMaxPending = 8;

  // The context must be current, now and at every later call. Returns nullopt if the driver has no
  // timer: OpenGL 3.3 has one, OpenGL ES needs GL_EXT_disjoint_timer_query.
  [[nodiscard]] static std::optional<GpuTimer> create(GlApi api);

  // Enclose the measured draw calls; not nested. Ignored while kMaxPending results are pending.
  void begin();
  void end();
  // Appends the times [ms] that have arrived since the previous call. An interruption of the GPU's
  // clock (GL_GPU_DISJOINT_EXT) invalidates all pending measurements.
  void take(std::vector<double>& times_ms);
  // Drops the pending results.
  void drop_pending();

 private:
  struct Measured {
    QueryHandle query;
    bool dropped = false;
  };
  explicit GpuTimer(GlApi api);
  [[nodiscard]] double result_ms(const Measured& measured) const;

  GlApi api_;
  std::array<Measured, kMaxPending> ring_;
  std::size_t first_ = 0, count_ = 0;
  bool measuring_ = false;
};

}  // namespace penumbra
