#include "render/gl/handle.hpp"

#include <epoxy/gl.h>

namespace penumbra {
namespace {

struct NameFunctions {
  void (*create)(GLsizei, GLuint*);
  void (*destroy)(GLsizei, const GLuint*);
};

NameFunctions functions_of(GlObject kind) {
  switch (kind) {
    case GlObject::buffer:
      return {glGenBuffers, glDeleteBuffers};
    case GlObject::vertex_array:
      return {glGenVertexArrays, glDeleteVertexArrays};
    case GlObject::texture:
      return {glGenTextures, glDeleteTextures};
    case GlObject::framebuffer:
      return {glGenFramebuffers, glDeleteFramebuffers};
    case GlObject::renderbuffer:
      return {glGenRenderbuffers, glDeleteRenderbuffers};
    case GlObject::query:
      return {glGenQueries, glDeleteQueries};
    case GlObject::program:
      return {[](GLsizei, GLuint* name) { *name = glCreateProgram(); },
              [](GLsizei, const GLuint* name) { glDeleteProgram(*name); }};
    case GlObject::shader:
      return {nullptr, [](GLsizei, const GLuint* name) { glDeleteShader(*name); }};
  }
  return {};
}

}  // namespace

unsigned create_gl_object(GlObject kind) {
  GLuint name = 0;
  functions_of(kind).create(1, &name);
  return name;
}

void delete_gl_object(GlObject kind, unsigned name) {
  functions_of(kind).destroy(1, &name);
}

}  // namespace penumbra
