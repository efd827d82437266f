// Soft shadows by common GPU techniques, for comparison with layered shadows: an object's shadow on
// a plane under a disc light at the zenith. One family of techniques uses a shadow map
// (orthographic, over the shadow's rectangle), read once, by PCF, or by PCSS (Fernando, 2005).
// Another averages hard shadows from many points of the light (Heckbert and Herf, 1997). Each
// technique darkens the rectangle with one blended draw.
#pragma once

#include <epoxy/gl.h>

#include <glm/mat4x3.hpp>
#include <optional>
#include <span>
#include <string_view>

#include "render/camera_gl.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/scene/plane_frame.hpp"

namespace penumbra::counted {

struct SoftTechnique {
  enum class Kind {
    hard,      // the map's nearest texel
    pcf,       // mean of 4 x 4 filtered texels
    pcss,      // `samples` for the search, and again for the filter
    average,   // mean of `samples` hard shadows on an image of the plane, in the map's size
    reference  // like average, in each pixel of the image: the area light
  };
  Kind kind = Kind::hard;
  int samples = 1;
};
[[nodiscard]] std::optional<SoftTechnique> soft_technique(std::string_view name);

struct SoftLight {
  double slope = 0.0;    // the light's radius divided by its height, seen from the plane
  float ambient = 0.0F;  // fraction of the light that is never blocked
};

class SoftShadows {
 public:
  // The context must be current in this call and in all later calls.
  [[nodiscard]] static Result<SoftShadows> create(const ShadowMesh& mesh, SoftTechnique technique,
                                                  const SoftLight& light, GlContext::Size image);
  // Draws the map, or the sum of hard shadows, before the frame.
  void prepare(const Placement& T_table_object, const PlaneFrame& plane, const LensUniforms& lens,
               const glm::mat4x3& camera_from_plane);
  // Draws the shadow into the bound framebuffer, behind the objects in it.
  void draw(const LensUniforms& lens, const glm::mat4x3& camera_from_plane) const;

 private:
  SoftShadows(ShaderProgram caster, ShaderProgram rectangle)
      : caster_(std::move(caster)), rectangle_(std::move(rectangle)) {}
  void draw_map();
  void draw_sum(const LensUniforms& lens, const glm::mat4x3& camera_from_plane);
  void set_caster() const;

  ShaderProgram caster_, rectangle_;
  SoftTechnique technique_;
  SoftLight light_;
  GlContext::Size size_;  // size of the map or of the sum
  std::vector<glm::vec3> positions_;
  VertexArray mesh_layout_, rectangle_layout_;
  GlBuffer mesh_vertices_{BufferUse::vertices}, mesh_indices_{BufferUse::indices};
  GlBuffer rectangle_vertices_{BufferUse::vertices};
  int index_count_ = 0;
  bool faces_outwards_ = true;
  FramebufferHandle target_;
  TextureHandle texture_, stencil_;
  GLuint nearest_ = 0, compared_ = 0;  // samplers; deleted with the context
  // State of the current frame.
  glm::mat4x3 plane_from_caster_{0.0F};
  glm::vec4 bounds_{0.0F};  // lowest (u, v), then the extents [m]
  float top_ = 0.0F;        // height of the caster's top [m]
};

}  // namespace penumbra::counted
