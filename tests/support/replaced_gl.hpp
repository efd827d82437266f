// An OpenGL function that does something else for a while, as a driver might.
#pragma once

#include <epoxy/gl.h>

namespace penumbra::test {

// `place`: the function as epoxy calls it, epoxy_glUnmapBuffer say. It has been called once before:
// the first call looks the driver's up and would end this.
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
