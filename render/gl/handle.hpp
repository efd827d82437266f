// Owners of OpenGL names: move-only, four bytes, deleted by their destructor. The context that made
// the name must be current then.
#pragma once

#include <utility>

namespace penumbra {

template <class Traits>
class GlHandle {
 public:
  GlHandle() = default;
  [[nodiscard]] static GlHandle create() { return GlHandle(Traits::create()); }
  explicit GlHandle(unsigned id) : id_(id) {}
  GlHandle(GlHandle&& other) noexcept : id_(std::exchange(other.id_, 0U)) {}
  GlHandle& operator=(GlHandle&& other) noexcept {
    if (this != &other) {
      reset();
      id_ = std::exchange(other.id_, 0U);
    }
    return *this;
  }
  GlHandle(const GlHandle&) = delete;
  GlHandle& operator=(const GlHandle&) = delete;
  ~GlHandle() { reset(); }

  void reset() {
    if (id_ != 0U) Traits::destroy(std::exchange(id_, 0U));
  }
  [[nodiscard]] unsigned id() const { return id_; }
  [[nodiscard]] explicit operator bool() const { return id_ != 0U; }

 private:
  unsigned id_ = 0U;  // 0: none
};

struct BufferTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct VertexArrayTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct TextureTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct FramebufferTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct RenderbufferTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct QueryTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct ProgramTraits {
  static unsigned create();
  static void destroy(unsigned id);
};
struct ShaderTraits {  // made for a stage, so there is no create()
  static void destroy(unsigned id);
};

}  // namespace penumbra
