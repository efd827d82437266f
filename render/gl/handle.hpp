// Owners of OpenGL object names: move-only, four bytes. The destructor deletes the object; its
// context must be current then.
#pragma once

#include <utility>

namespace penumbra {

enum class GlObject {
  buffer,
  vertex_array,
  texture,
  framebuffer,
  renderbuffer,
  query,
  program,
  shader
};
// Not for shaders: glCreateShader() needs their stage.
[[nodiscard]] unsigned create_gl_object(GlObject kind);
void delete_gl_object(GlObject kind, unsigned name);

template <GlObject kind>
class GlHandle {
 public:
  GlHandle() = default;
  [[nodiscard]] static GlHandle create() { return GlHandle(create_gl_object(kind)); }
  explicit GlHandle(unsigned id) : id_(id) {}
  GlHandle(GlHandle&& other) noexcept : id_(std::exchange(other.id_, 0U)) {}
  GlHandle& operator=(GlHandle&& other) noexcept {
    std::swap(id_, other.id_);
    return *this;
  }
  GlHandle(const GlHandle&) = delete;
  GlHandle& operator=(const GlHandle&) = delete;
  ~GlHandle() {
    if (id_ != 0U) delete_gl_object(kind, id_);
  }

  [[nodiscard]] unsigned id() const { return id_; }
  [[nodiscard]] explicit operator bool() const { return id_ != 0U; }

 private:
  unsigned id_ = 0U;  // 0: none
};

using BufferHandle = GlHandle<GlObject::buffer>;
using VertexArrayHandle = GlHandle<GlObject::vertex_array>;
using TextureHandle = GlHandle<GlObject::texture>;
using FramebufferHandle = GlHandle<GlObject::framebuffer>;
using RenderbufferHandle = GlHandle<GlObject::renderbuffer>;
using QueryHandle = GlHandle<GlObject::query>;
using ProgramHandle = GlHandle<GlObject::program>;
using ShaderHandle = GlHandle<GlObject::shader>;

}  // namespace penumbra
