// Draws virtual objects with light and depth, and phantoms with depth alone. Materials with more
// maps than a base colour have a separate program, so that the others pay nothing for them.
#pragma once

#include <array>
#include <glm/mat4x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <glm/vec4.hpp>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Converts a length [m] into the units of a model drawn at this scale, rounded down by quarter
// powers of two, so that models at similar scales are uploaded once.
[[nodiscard]] float longest_model_edge(double longest_edge_m, double scale);

inline constexpr int kShadowMaskUnit = 1;  // of a MaskStack that is read
inline constexpr std::size_t kMostReceivingLevels = 64;

// How a shadow on a surface is drawn: alone, or as one of several whose darkest counts, which are
// gathered in the framebuffer's alpha first.
enum class Gathering { none, first, further, result };

// A shadow that falls along a plane's normal, at several heights above it: its layers are channels
// of the masks bound to kShadowMaskUnit.
struct ShadowMask {
  glm::mat4x3 plane_from_table{0.0F};  // -> (u, v, h)
  glm::vec3 normal{0.0F};              // of the plane, table frame
  glm::vec2 origin{0.0F}, extent{1.0F};
  glm::vec3 light_left{1.0F};  // of the encoded picture, by layer
  int level_count = 0;
  std::array<glm::vec4, kMostReceivingLevels / 4> levels{};  // heights [m], ascending
};

class ObjectPainter {
 public:
  // Uploads every model of the scene, with edges short enough for the camera's lens at the largest
  // scale that the object is drawn at.
  [[nodiscard]] static Result<ObjectPainter> create(GlApi api, const Scene& scene,
                                                    const CameraModel& camera);

  // Selects how translucent surfaces and shadows are drawn from here on.
  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);

  // Draws the depth of the phantoms. Returns the number of draw calls, as the functions below do.
  int draw_phantoms(const Scene& scene, const FramePlan& plan, const LensUniforms& lens) const;
  // An opacity under 1 (held poses) mixes the objects' surface into the video: depth first, then
  // colour where the depth is equal, so that their insides do not show.
  int draw_objects(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                   Framebuffer& framebuffer) const;
  // Draws surfaces that blend, after everything behind them: from the farthest to the nearest, by
  // mesh and in a mesh by triangle. They neither hide what is behind them nor get shadows; through
  // a screen-door, whose pixels are opaque or absent, they do hide it.
  int draw_blended(const FramePlan& plan, const LensUniforms& lens, Framebuffer& framebuffer) const;
  // Draws one object with the current tests and masks, at the same depths as above.
  int draw_alone(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                 const LensUniforms& lens) const;
  // Darkens one object, after begin_darkening(), as where one of plan.lights does not reach it; or
  // with `add_up`, after begin_summing(), adds the blocked share of its light, linear, times
  // `opacity`. Retextured, a copy of the framebuffer, or of the sums, is bound.
  int draw_darkened(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                    const LensUniforms& lens, int light, float opacity, bool add_up) const;

  // Darkens one object, after begin_darkening(), by a shadow; not where it is outside the shadow,
  // under the plane, or faces away from the light. While several shadows are gathered the caller
  // sets blending and the colour mask.
  int draw_under_shadow(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                        const LensUniforms& lens, const ShadowMask& mask,
                        Gathering gathering) const;

 private:
  struct GpuMesh {
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
    GlBuffer indices{BufferUse::indices};
    int index_count = 0;
    int material = 0;
    std::optional<GlBuffer> map_vertices;  // where the material has maps
    // Of one that blends: its triangles and their middles, and its own; object units.
    std::vector<std::array<std::uint32_t, 3>> faces;
    std::vector<glm::vec3> middles;
    glm::vec3 middle{0.0F};
  };
  struct GpuMaterial {
    // As Material's; null: none.
    const Texture2d* base_color = nullptr;
    const Texture2d* metallic_roughness = nullptr;
    const Texture2d* normal = nullptr;
    const Texture2d* occlusion = nullptr;
    const Texture2d* emissive = nullptr;
  };
  struct GpuModel {
    std::vector<GpuMesh> meshes;
    std::vector<GpuMaterial> materials;
    // By picture, whether it is of colours, and how it is looked up.
    std::map<std::tuple<int, bool, TextureSampling>, Texture2d> textures;
  };
  // For plain materials, and for those with maps; null: the first for all.
  struct Programs {
    const ShaderProgram& plain;
    const ShaderProgram* maps = nullptr;
  };
  ObjectPainter(GlApi api, TranslucentProgram program, std::optional<TranslucentProgram> maps,
                TranslucentProgram masked)
      : api_(api),
        program_(std::move(program)),
        maps_program_(std::move(maps)),
        masked_program_(std::move(masked)) {}

  static std::shared_ptr<GpuModel> upload(const Model& model, float max_edge);
  static const Texture2d* texture_of(GpuModel& gpu, const Model& model, const MaterialTexture& from,
                                     bool color);
  [[nodiscard]] Programs plain_programs() const;
  [[nodiscard]] Programs chosen_programs() const;
  [[nodiscard]] Programs darkening_programs() const;
  // All but what blends; of phantoms that too.
  int draw_all(const Programs& programs, const Scene& scene, std::span<const ObjectDraw> draws,
               const CameraPose& pose) const;
  int draw_some(const ShaderProgram& program, bool maps, const Programs& programs,
                const Scene& scene, std::span<const ObjectDraw> draws,
                const CameraPose& pose) const;
  static void set_material(const ShaderProgram& program, const Model& model, const GpuModel& gpu,
                           int material, bool maps);
  // Those of them that there are, each in use.
  template <class Action>
  static void for_each(const Programs& programs, const Action& action);
  void begin_lit(const Programs& programs, const FramePlan& plan, const LensUniforms& lens) const;

  GlApi api_;
  TranslucentProgram program_;
  std::optional<TranslucentProgram> maps_program_;  // where the scene has such materials
  // Of draw_darkened(), apart from the lit ones: some renderers run both sides of a branch.
  std::optional<TranslucentProgram> darkening_program_, maps_darkening_program_;
  bool blends_ = false;  // some material does
  Translucency mode_ = Translucency::blend;
  // Of object.frag.glsl: sRGB's, where the camera's own is not known.
  glm::vec4 tone_{1.0F / 2.4F, 1.055F, 0.055F, 0.0031308F};
  // Of shadows by masks: light alone would cost many times as much.
  TranslucentProgram masked_program_;
  std::vector<std::shared_ptr<GpuModel>> models_;           // one per scene object; null: no model
  std::vector<std::shared_ptr<const Model>> descriptions_;  // their materials
};

}  // namespace penumbra
