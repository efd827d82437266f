#include "render/gl/gpu_timer.hpp"

#include <epoxy/gl.h>

#include "core/assert.hpp"

namespace penumbra {

GpuTimer::GpuTimer(GlApi api) : api_(api) {
  for (Measured& measured : ring_) measured.query = QueryHandle::create();
}

std::optional<GpuTimer> GpuTimer::create(GlApi api) {
  GLint bits = 0;  // 0: the driver has the query but no clock
  if (api == GlApi::gl33) {
    glGetQueryiv(GL_TIME_ELAPSED, GL_QUERY_COUNTER_BITS, &bits);
  } else if (epoxy_has_gl_extension("GL_EXT_disjoint_timer_query")) {
    glGetQueryivEXT(GL_TIME_ELAPSED_EXT, GL_QUERY_COUNTER_BITS_EXT, &bits);
    GLint disjoint = 0;  // reading it clears it
    glGetIntegerv(GL_GPU_DISJOINT_EXT, &disjoint);
  }
  if (bits == 0) return std::nullopt;
  return GpuTimer(api);
}

void GpuTimer::begin() {
  PENUMBRA_ASSERT(!measuring_);
  measuring_ = count_ < kMaxPending;
  if (!measuring_) return;
  Measured& measured = ring_[(first_ + count_) % kMaxPending];
  measured.dropped = false;
  glBeginQuery(GL_TIME_ELAPSED, measured.query.id());
}

void GpuTimer::end() {
  if (!measuring_) return;
  glEndQuery(GL_TIME_ELAPSED);
  measuring_ = false;
  ++count_;
}

double GpuTimer::result_ms(const Measured& measured) const {
  GLuint64 time_ns = 0;
  if (api_ == GlApi::gl33) {
    glGetQueryObjectui64v(measured.query.id(), GL_QUERY_RESULT, &time_ns);
  } else {
    glGetQueryObjectui64vEXT(measured.query.id(), GL_QUERY_RESULT, &time_ns);
  }
  return static_cast<double>(time_ns) * 1e-6;
}

void GpuTimer::take(std::vector<double>& times_ms) {
  const std::size_t before = times_ms.size();
  while (count_ > 0) {
    const Measured& measured = ring_[first_];
    GLuint available = GL_FALSE;
    glGetQueryObjectuiv(measured.query.id(), GL_QUERY_RESULT_AVAILABLE, &available);
    if (available == GL_FALSE) break;
    if (!measured.dropped) times_ms.push_back(result_ms(measured));
    first_ = (first_ + 1) % kMaxPending;
    --count_;
  }
  if (api_ == GlApi::gl33) return;
  GLint disjoint = 0;
  glGetIntegerv(GL_GPU_DISJOINT_EXT, &disjoint);
  if (disjoint == 0) return;
  times_ms.resize(before);
  drop_pending();
}

void GpuTimer::drop_pending() {
  for (std::size_t i = 0; i < count_; ++i) ring_[(first_ + i) % kMaxPending].dropped = true;
}

}  // namespace penumbra
