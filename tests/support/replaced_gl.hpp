// Replaces an OpenGL function during the object's lifetime, to simulate a driver's behaviour.
#pragma once

#include <epoxy/gl.h>

namespace penumbra::test {

// `place`: epoxy's pointer to the function, such as epoxy_glUnmapBuffer. Call the function once
// before: its first call looks up the driver's function and would overwrite the replacement.
template <class Function>
class ReplacedGl {
 public:
  ReplacedGl(Function& place, Function other) : place_(place), before_(place) { place_ = other; }
  ReplacedGl(const ReplacedGl&) = delete;
  ReplacedGl& operator=(const ReplacedGl&) = delete;
  ~ReplacedGl() { place_ = before_; }

 private:
  Function& place_;
  Function before_;
};

}  // namespace penumbra::test
