// Replaces an OpenGL function during the object's lifetime, to simulate a driver's behaviour.
#pragma once

#include <epoxy/gl.h>

namespace penumbra::test {

// `pointer`: epoxy's pointer to the function, such as epoxy_glUnmapBuffer. Call the function once
// before: its first call looks up the driver's function and would overwrite the replacement.
template <class Function>
class ReplacedGl {
 public:
  ReplacedGl(Function& pointer, Function replacement) : pointer_(pointer), before_(pointer) {
    pointer_ = replacement;
  }
  ReplacedGl(const ReplacedGl&) = delete;
  ReplacedGl& operator=(const ReplacedGl&) = delete;
  ~ReplacedGl() { pointer_ = before_; }

 private:
  Function& pointer_;
  Function before_;
};

}  // namespace penumbra::test
