// How long the GPU works on what is submitted to it, by its own clock: timer queries, whose results
// come some frames later and are not waited for.
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
  // Results on their way, at most. A GPU is behind by two or three frames.
  static constexpr std::size_t kMost = 8;

  // The context is current, now and at every later call. Nothing where the driver can't tell:
  // OpenGL 3.3 can, OpenGL ES with GL_EXT_disjoint_timer_query.
  [[nodiscard]] static std::optional<GpuTimer> create(GlApi api);

  // Around what is measured; not while another one of the context measures. Where kMost results are
  // still on their way, this one is not measured.
  void begin();
  void end();
  // Adds the times [ms] that are known by now, in their order, each once. Where the GPU's clock
  // did not run evenly (GL_GPU_DISJOINT_EXT) none of those begun before counts.
  void take(std::vector<double>& times_ms);
  // What was measured so far is not told.
  void forget();
  [[nodiscard]] std::size_t on_the_way() const { return count_; }

 private:
  struct Measured {
    GlHandle<QueryTraits> query;
    bool forgotten = false;
  };
  explicit GpuTimer(GlApi api);
  [[nodiscard]] double result_ms(const Measured& measured) const;

  GlApi api_;
  std::array<Measured, kMost> ring_;
  std::size_t first_ = 0, count_ = 0;
  bool measures_ = false;
};

}  // namespace penumbra
