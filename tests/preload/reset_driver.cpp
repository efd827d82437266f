// Loaded before a program (LD_PRELOAD), a graphics driver that is reset: from the call on that
// PENUMBRA_TEST_RESET_AT numbers, it says so for ever.
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
