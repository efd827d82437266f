// Draws virtual objects with light and depth, and phantoms with depth alone. Materials with further
// maps besides the base colour use a separate, slower program, and unlit and reflecting materials
// one each.
#pragma once

#include <array>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/edges/edge_mesh.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/texture.hpp"
#include "render/passes/translucent_program.hpp"

namespace penumbra {

// Converts a length [m] to units of a model drawn at this scale. Rounds the scale up to a quarter
// power of two, so that models at similar scales are uploaded once.
[[nodiscard]] float longest_model_edge(double longest_edge_m, double scale);

inline constexpr int kShadowMaskUnit = 1;  // texture unit of masks
inline constexpr std::size_t kMaxReceivingLevels = 64;

// How a shadow is drawn on a surface: alone (none), or as one of several. Several shadows gather
// their darkest value in the framebuffer's alpha (first, further), which then darkens (result).
enum class Gathering { none, first, further, result };

// A shadow along a plane's normal: masks at several heights above the plane, bound at
// kShadowMaskUnit, with one channel per layer.
struct ShadowMask {
  glm::mat4x3 plane_from_table{0.0F};  // -> (u, v, h)
  glm::vec3 normal{0.0F};              // plane normal, table frame
  glm::vec2 origin{0.0F}, extent{1.0F};
  glm::vec3 encoded_factors{1.0F};  // factor on the encoded image, by layer
  int level_count = 0;
  std::array<glm::vec4, kMaxReceivingLevels / 4> levels{};  // heights [m], ascending
};

class ObjectPainter {
 public:
  // Uploads the scene's models, with edges short enough for the lens at the object's largest scale.
  // `with_edges`: edges_of() returns the edges of the objects.
  [[nodiscard]] static Result<ObjectPainter> create(GlApi api, const Scene& scene,
                                                    const CameraModel& camera, bool with_edges);

  // Uploads the shapes of objects with an animation.
  void pose(std::span<const PosedModel> posed);
  // Returns the edges of what is drawn of the object, until the next pose().
  [[nodiscard]] ObjectEdges edges_of(int object) const;
  // Selects the programs of translucent surfaces and shadows.
  [[nodiscard]] Result<void> choose(Translucency mode, std::optional<PixelFormat> video);

  // Draws the depth of the phantoms. Returns the number of draw calls, as the functions below do.
  int draw_phantoms(const FramePlan& plan, const LensUniforms& lens) const;
  // Draws the opaque surfaces. An opacity below 1 (coasting poses) mixes them into the video: depth
  // first, then colour at equal depth, so that hidden surfaces stay invisible.
  int draw_objects(const FramePlan& plan, const LensUniforms& lens, Framebuffer& framebuffer) const;
  // Draws blended surfaces, from the farthest to the nearest mesh, and likewise the triangles of a
  // mesh. Writes no depth, except through a screen-door.
  int draw_blended(const FramePlan& plan, const LensUniforms& lens, Framebuffer& framebuffer) const;
  // Draws one object with the current tests and masks, at the depth of draw_objects().
  int draw_alone(const ObjectDraw& draw, const FramePlan& plan, const LensUniforms& lens) const;
  // Darkens one object by blocking one of plan.lights. `add_up`: adds the blocked fraction of
  // linear light times `opacity` to the sums instead. The caller must have begun Blending::darken
  // (or sum) and, in mode retexture, copied the framebuffer (or the sums).
  int draw_darkened(const ObjectDraw& draw, const FramePlan& plan, const LensUniforms& lens,
                    int light, float opacity, bool add_up) const;

  // Darkens one object by a shadow, with the current blending. Has no effect outside the shadow,
  // below the plane, and on faces turned away from the light.
  int draw_under_shadow(const ObjectDraw& draw, const FramePlan& plan, const LensUniforms& lens,
                        const ShadowMask& mask, Gathering gathering) const;

 private:
  struct GpuMesh {
    GlMesh surface{3, 3, 2, 4};  // position, normal, texture coordinates, colour
    int material = 0;
    std::optional<GlBuffer> map_vertices;  // if the material has maps
    // Only for materials that blend.
    std::vector<std::array<std::uint32_t, 3>> faces;
    std::vector<glm::vec3> middles;  // centres of `faces`, object units
    glm::vec3 middle{0.0F};          // mean of `middles`
  };
  struct GpuMaterial {
    // nullptr: none.
    const Texture2d* base_color = nullptr;
    const Texture2d* metallic_roughness = nullptr;
    const Texture2d* normal = nullptr;
    const Texture2d* occlusion = nullptr;
    const Texture2d* emissive = nullptr;
  };
  struct GpuModel {
    std::shared_ptr<const Model> source;
    float max_edge = 0.0F;  // see subdivided()
    std::vector<GpuMesh> meshes;
    std::vector<GpuMaterial> materials;
    bool with_edges = false;
    std::optional<EdgeMesh> opaque_edges, blended_edges;
    // Key: image, whether it holds colours, sampling.
    std::map<std::tuple<int, bool, TextureSampling>, Texture2d> textures;
  };
  struct Programs {
    const ShaderProgram& plain;
    const ShaderProgram* maps = nullptr;    // for materials with maps; nullptr: uses `plain`
    const ShaderProgram* mirror = nullptr;  // for materials that reflect; nullptr: uses `maps`
    const ShaderProgram* unlit = nullptr;   // nullptr: unlit surfaces are not drawn
  };
  struct SurfaceProgram {
    TranslucentProgram plain;
    std::optional<TranslucentProgram> maps;    // if the scene has such materials
    std::optional<TranslucentProgram> mirror;  // likewise; not for shadows
    std::optional<TranslucentProgram> unlit;   // likewise; not for shadows
    [[nodiscard]] Programs opaque() const;
    [[nodiscard]] Programs chosen() const;
  };
  static std::shared_ptr<GpuModel> upload(const std::shared_ptr<const Model>& model, float max_edge,
                                          bool with_edges);
  // Uploads the meshes of gpu.source.
  static void upload_meshes(GpuModel& gpu, BufferLife life);
  // `meshes`: those of gpu.source, as uploaded.
  static void make_edges(GpuModel& gpu, std::span<const Mesh> meshes);
  static const Texture2d* texture_of(GpuModel& gpu, const Model& model, const MaterialTexture& from,
                                     bool color);
  // Returns the program that draws a surface, or nullptr if none does.
  static const ShaderProgram* program_for(const Programs& programs, const Material& material,
                                          bool phantom);
  // Draws the surfaces that do not blend; of phantoms, all surfaces.
  int draw_all(const Programs& programs, std::span<const ObjectDraw> draws,
               const CameraPose& pose) const;
  int draw_surfaces(const ShaderProgram& program, const Programs& programs,
                    std::span<const ObjectDraw> draws, const CameraPose& pose) const;
  static void set_material(const ShaderProgram& program, const GpuModel& gpu, int material,
                           bool maps);
  // Calls `action` for each program, in use.
  template <class Action>
  static void for_each(const Programs& programs, const Action& action);
  // Returns true if an object of the plan has a surface that reflects the video.
  [[nodiscard]] bool any_reflects(const FramePlan& plan) const;
  void begin_lit(const Programs& programs, const FramePlan& plan, const LensUniforms& lens) const;

  SurfaceProgram lit_program_;
  // Separate programs, not branches: some renderers run both sides of a branch.
  SurfaceProgram darkening_program_;
  TranslucentProgram masked_program_;
  bool blends_ = false;  // some material blends
  Translucency mode_ = Translucency::blend;
  // `tone` of object.frag.glsl; the sRGB curve if the camera's response is unknown.
  glm::vec4 tone_{1.0F / 2.4F, 1.055F, 0.055F, 0.0031308F};
  // One per scene object.
  std::vector<std::shared_ptr<GpuModel>> models_;  // may be null
  std::vector<bool> phantoms_;
};

}  // namespace penumbra
