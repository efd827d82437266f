// LD_PRELOAD library that simulates a reset of the graphics driver: from call number
// PENUMBRA_TEST_RESET_AT on, every query of the reset status reports a reset.
#include <epoxy/gl.h>

#include <atomic>
#include <cstdlib>

namespace {

std::atomic<int> calls_left{0};

GLenum status() {
  return calls_left.fetch_sub(1) > 1 ? GL_NO_ERROR : GL_UNKNOWN_CONTEXT_RESET;
}

[[gnu::constructor]] void replace() {
  const char* at = std::getenv("PENUMBRA_TEST_RESET_AT");
  if (at == nullptr) return;
  calls_left = std::atoi(at);
  epoxy_glGetGraphicsResetStatus = status;
}

}  // namespace
