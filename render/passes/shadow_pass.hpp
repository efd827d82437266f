// Shadows on planes: layers projected in the vertex shader, or fields as textured rectangles; each
// pixel darkened once with its darkest layer (umbra before middle before penumbra, over all casters
// of a plane together). Blended, the stencil holds the first layer; retextured, the last one drawn
// is seen, so the penumbra comes first; a mesh's pattern is the same in any order.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "render/camera_gl.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/buffer.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/shader.hpp"
#include "render/passes/field_quad.hpp"
#include "render/passes/mask_quad.hpp"
#include "render/passes/mesh_strips.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/translucent_program.hpp"
#include "render/passes/video_pass.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/caster_geometry.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "render/shadow/kernels/shadow_proxy.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"
#include "render/shadow/layers/own_frame.hpp"
#include "render/shadow/layers/twist.hpp"
#include "render/shadow/masks/silhouette_mask.hpp"
#include "render/shadow/shadow_mesh.hpp"

namespace penumbra {

struct ShadowWork {
  std::int64_t layers_drawn = 0;
  std::int64_t vertices = 0;            // that the CPU projected and clipped
  std::int64_t kernel_generations = 0;  // kernel sets, and sets of part lights, for a tilt
  // Shadows of this plan whose geometry is that of a plan before, on its place or slid and turned;
  // and the others.
  std::int64_t reprojections = 0;
  std::int64_t recomputed = 0;
  std::int64_t proxy_shadows = 0;      // shadows that a reduced mesh cast
  std::int64_t proxy_checks = 0;       // comparisons of a reduced mesh with its model
  std::int64_t proxy_faces_saved = 0;  // over the layers drawn
  std::int64_t faces_tested = 0;       // of the kernel sets made: for twists
  std::int64_t faces_twisted = 0;
  // Pictures of the layers on a plane: drawn, and kept as they were.
  std::int64_t layer_masks_drawn = 0;
  std::int64_t layer_masks_kept = 0;
  // Pictures of the shadows on a receiver: drawn, and kept as they were.
  std::int64_t masks_drawn = 0;
  std::int64_t masks_kept = 0;
  std::vector<SkippedPass> skipped;  // what only the geometry can tell
  std::vector<KeptPart> kept;
};

// For each object of the scene: the longest edge [object units] of the caster made of it, so that
// its shadow's edges can follow the lens at the nearest distance expected; 0 (no edge needs
// splitting) for a lens without distortion.
[[nodiscard]] std::vector<float> longest_caster_edges(const Scene& scene,
                                                      const CameraModel& camera);

// What a receiver's shadows are drawn from is given back when so many frames did not need it.
inline constexpr std::uint64_t kFramesKept = 150;

// What of a shadow's layers meets heights above its plane, from one upwards.
struct ShadowReach {
  // In (u, v) of the plane [m], of all layers at all of these heights; empty: nothing casts there.
  Eigen::AlignedBox2d box;
  double low = 0.0;  // of what casts there, above the plane [m]
  // By how much outlines move with the height that they fall on, at most [m / m].
  double rate = 0.0;
};

// What each layer leaves of the video's encoded value.
[[nodiscard]] glm::vec3 layer_light(const ShadowDraw& draw);

class ShadowPass {
 public:
  // `samples` of each pixel of what it draws into; 0: no multisampling.
  [[nodiscard]] static Result<ShadowPass> create(GlApi api, const Scene& scene,
                                                 const CameraModel& camera, int samples);

  // The CPU's part: kernels where the tilt is new, clipping where a caster straddles a height.
  // Adds to `work`.
  void prepare(const Scene& scene, const FramePlan& plan, ShadowWork& work);
  // How the shadows are drawn from here on; `video`: the format of the frames under them, none
  // where the picture is not the video pixel by pixel.
  [[nodiscard]] Result<void> choose(Translucency way, std::optional<PixelFormat> video);
  // The plan must be the one prepared, `receivers` begun for it, and `frame` uploaded to `video`
  // and nothing but that under the planes in `framebuffer`. Number of draw calls.
  int draw(const FramePlan& plan, const LensUniforms& lens, Receivers& receivers,
           const VideoPass& video, const Frame& frame, Framebuffer& framebuffer);
  // Of the planes' masks, in that draw(): pieces that darken nothing.
  [[nodiscard]] std::int64_t mask_pieces_skipped() const { return mask_pieces_skipped_; }
  // One more shadow than the plan's `shadows`, of the same frame: on a plane that is parallel to
  // its own, the `level`th of its receiver. For draw_flat(), until the next prepare().
  std::size_t prepare_flat(const Scene& scene, const ReceivedShadowDraw& draw, int level,
                           const PlaneFrame& plane, ShadowWork& work);
  // Of such a shadow, at heights from `from` upwards; none where that is not known beforehand: of
  // lights of one size, and of fields.
  std::optional<ShadowReach> reach_of(const Scene& scene, const ShadowDraw& draw, double from,
                                      ShadowWork& work);
  // A pixel 1 m from the camera [m].
  [[nodiscard]] double pixel_at_unit_depth() const { return pixel_at_unit_depth_; }
  // One of its layers in white, where the tests and masks as they are let it; with a camera without
  // distortion. Number of draw calls.
  int draw_flat(std::size_t flat, int layer, const LensUniforms& camera,
                const glm::mat4x3& camera_from_plane);
  // Whether cover_flat() can tell what a shadow covers, and is to: as masks of planes are made.
  [[nodiscard]] bool covers_flat(const Scene& scene, const FramePlan& plan, const ShadowDraw& draw);
  // What prepare_flat() and draw_flat() would draw, without OpenGL and exactly: how much of these
  // cells of the plane each layer covers, as MaskPicture::finish_shares() tells it.
  void cover_flat(const Scene& scene, const ReceivedShadowDraw& draw, int level,
                  const PlaneFrame& plane, const MaskCells& cells, std::span<std::uint8_t> rgba,
                  ShadowWork& work);
  // Of those shadows of the last plan that are made with kernels; takes milliseconds for kernels
  // that it was not asked for before.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use();

 private:
  struct KernelKey {
    std::optional<KernelSource> source;  // none: of no use to the technique
    KernelDirection direction;
    bool stored = false;  // those that came with the model
    friend auto operator<=>(const KernelKey&, const KernelKey&) = default;
  };
  struct IndexRange {
    std::size_t first = 0, count = 0;
  };
  // An edge of the mesh that was split, between two of its positions; object units.
  struct LongEdge {
    std::uint32_t a = 0, b = 0;
    float length = 0.0F;
  };
  // A mesh that casts, and its faces on the GPU.
  struct Body {
    CasterGeometry geometry;
    std::vector<LongEdge> long_edges;
    GlBuffer indices{BufferUse::indices};
    bool indices_written = false;
    std::vector<IndexRange> ranges;  // of the coarser surfaces, then of the finest
    // Of the mesh before it was split, made when they are asked for: its edges where its faces
    // close up, and else its faces where they can be told apart by the way they turn.
    std::optional<std::vector<FacePair>> edges;
    std::optional<std::vector<std::uint32_t>> oriented;
    bool edges_made = false;
  };
  // A body's vertices with one set of kernels: { position, kernel }.
  struct BodyVertices {
    bool made = false, uploaded = false;
    std::vector<glm::vec3> kernels;
    VertexArray layout;
    GlBuffer vertices{BufferUse::vertices};
  };
  struct KernelSet {
    ShadowKernels made;  // for the full mesh; none where the technique needs none
    BodyVertices whole, reduced;
    TwistReport twist;
    std::optional<double> spill;  // measured where somebody asked
    std::uint64_t last_used = 0;
  };
  // Where the proxy was compared with the full mesh.
  struct ProxyKey {
    KernelKey kernels;
    LightMode light_mode = LightMode::proportional;
    std::array<double, 4> constants{};
    double scale = 1.0;
    friend auto operator<=>(const ProxyKey&, const ProxyKey&) = default;
  };
  struct Caster {
    ShadowMesh mesh;
    // Of the kernels that came with it, and so of those for other tilts.
    KernelSource stored_source = KernelSource::automatic;
    Body whole;
    // A reduced mesh that may cast layers, and where it has been found to be as good.
    std::optional<ShadowProxy> proxy;
    Body reduced;
    std::map<ProxyKey, bool> proxy_kept;
    glm::vec3 min_corner{0.0F};
    glm::vec3 max_corner{0.0F};
    double size = 0.0;  // largest distance of a point from the object's origin, unscaled [m]
    std::map<KernelKey, KernelSet> sets;
    // The size of each part's light, for the same directions as kernels; and whether it is for a
    // field, which is as wide as a body.
    std::map<std::pair<KernelDirection, bool>, std::vector<PartDisc>> part_sets;
  };
  // Whole: projected by the vertex shader. Placed: the mesh's vertices projected here, once for a
  // height and tilt, and those that were added for the lens between them. Clipped: faces that had
  // to be cut at a height, projected here too where a lens needs them split. Masked: in the plane's
  // mask, by its silhouettes, face by face where it does not close up, or by a field's outline.
  enum class LayerSource {
    nothing,
    whole,
    placed,
    clipped,
    field,
    masked,
    masked_faces,
    masked_outline
  };
  using FieldOutlines = std::array<std::vector<OutlineSide>, 3>;  // of each layer, own frame
  struct LayerGeometry {
    LayerSource source = LayerSource::nothing;
    int first = 0;  // vertices in the clipped buffer
    int count = 0;
  };
  // What one shadow was made from, and what of it is on the GPU.
  struct Prepared {
    bool valid = false;
    OwnFrame own;
    LayeredConstants constants;
    ShadowTechnique technique = ShadowTechnique::layered;
    LightMode light_mode = LightMode::proportional;
    bool reduced = false;  // the proxy casts
    bool masked = false;   // in the plane's mask
    std::array<bool, 3> wanted{};
    KernelKey kernel_key;
    std::array<LayerGeometry, 3> layers;
    std::size_t surface = 0;  // which of the caster's ranges is fine enough in this frame
    // Of placed layers: how much longer than a long edge its image is, at most.
    double magnification = 1.0;
    std::array<VertexArray, 3> placed_layouts;
    GlBuffer placed{BufferUse::vertices};
    VertexArray clipped_layout;
    GlBuffer clipped{BufferUse::vertices};
    bool clipped_layout_made = false;
    FieldTexture field;
    std::shared_ptr<const FieldOutlines> outlines;  // in its place, for a mask
    std::uint64_t last_used = 0;                    // of those that are no item of the plan
  };
  // What a plane's mask shows of one caster.
  struct MaskPart {
    Caster* caster = nullptr;
    KernelKey kernels;
    bool reduced = false;
    OwnFrame own;
    LayeredConstants constants;
    LightMode light_mode = LightMode::proportional;
    std::array<bool, 3> layers{};  // by silhouettes
    std::array<bool, 3> faces{};   // face by face
    std::array<bool, 3> sides{};   // by a field's outlines
    std::shared_ptr<const FieldOutlines> outlines;
    glm::vec3 light{0.0F};  // mask_light()
    [[nodiscard]] bool covers_nothing() const {
      constexpr std::array<bool, 3> kNone{};
      return layers == kNone && faces == kNone && sides == kNone;
    }
    [[nodiscard]] bool covers_same_as(const MaskPart& other) const;
    [[nodiscard]] bool same_as(const MaskPart& other) const {
      return light == other.light && covers_same_as(other);
    }
  };
  // What one of several casters covers of a mask's cells: the others may move.
  struct PartCover {
    MaskPart part;
    double cell = 0.0;
    MaskCover cover;
    std::uint64_t last_used = 0;
  };
  struct DrawnMask {
    MaskCells cells;
    std::vector<MaskPart> parts;
    MaskTexture texture;
  };
  // Those of a plane: what they were made for, and they.
  struct DrawnMasks {
    bool made = false;
    std::vector<MaskPart> parts;
    int half_octave = 0;          // of cells
    std::vector<CellBox> bounds;  // of each part, in these
    MaskLayout layout;
    std::vector<std::shared_ptr<DrawnMask>> masks;  // of each of its groups
  };
  struct PlaneMask {
    DrawnMasks now, other;               // of this frame, and those shown before it
    bool in_use = false;                 // in this frame
    double depth = 0.0;                  // of the nearest shadow that counts [m]
    std::vector<MaskPart> drawn_before;  // in the mask that was made last
    std::vector<PartCover> covers;       // of those that rested from one mask to the next
    std::uint64_t times_drawn = 0;
    [[nodiscard]] std::vector<PartCover>::iterator cover_of(const MaskPart& part, double cell);
  };
  ShadowPass(TranslucentProgram shadow, FieldQuad field, MaskQuad mask, MeshStrips strips)
      : shadow_program_(std::move(shadow)),
        field_quad_(std::move(field)),
        mask_quad_(std::move(mask)),
        mesh_strips_(std::move(strips)) {}

  // The model, its longest edge as a caster, what casts in its place, its groups and its cut-outs.
  using CasterKey =
      std::tuple<const Model*, float, const Model*, std::vector<std::string>, CutOuts>;

  Caster& caster_of(const Scene& scene, const ShadowDraw& draw);
  static void set_geometry(Body& body, const ShadowMesh& mesh, float max_edge);
  KernelSet& kernels_of(Caster& caster, const KernelKey& key, ShadowWork& work);
  bool proxy_casts(const ShadowDraw& draw, Caster& caster, const KernelKey& key, KernelSet& set,
                   ShadowWork& work);
  static void complete_set(Caster& caster, KernelSet& set, ShadowWork& work);
  static void write_vertices(Caster& caster, KernelSet& set, bool reduced, bool to_gpu);
  [[nodiscard]] static bool is_imaged(const ShadowDraw& draw, const Body& body);
  [[nodiscard]] std::size_t surface_for(const ShadowDraw& draw, const FramePlan& plan,
                                        const Caster& caster, const Prepared& prepared) const;
  static const std::vector<PartDisc>& parts_of(Caster& caster, const KernelDirection& direction,
                                               bool of_field, ShadowWork& work);
  // What a shadow is made with: nothing of it for a field.
  struct CastWith {
    KernelKey key;
    KernelSet* kernels = nullptr;
    bool reduced = false;  // the proxy casts
  };
  CastWith cast_with(const ShadowDraw& draw, Caster& caster, const OwnFrame& own, bool to_gpu,
                     ShadowWork& work);
  void prepare_one(const ShadowDraw& draw, Caster& caster, Prepared& prepared, bool masked,
                   ShadowWork& work);
  void place_layers(const ShadowDraw& draw, Caster& caster, KernelSet& kernels, Prepared& prepared,
                    ShadowWork& work);
  void clip_layers(const ShadowDraw& draw, const Caster& caster, const KernelSet& kernels,
                   Prepared& prepared, ShadowWork& work);
  void image_layers(const ShadowDraw& draw, Caster& caster, KernelSet& kernels, Prepared& prepared,
                    ShadowWork& work);
  void upload_placed(const std::array<std::vector<PlanePoint>, 3>& images, const Body& body,
                     Prepared& prepared) const;
  static void upload_clipped(std::span<const CasterVertex> faces, Prepared& prepared);
  static std::array<LayerSource, 3> cut_layers(const ShadowDraw& draw, const Caster& caster);
  [[nodiscard]] static bool is_for_masks(Body& body, const ShadowMesh& mesh);
  [[nodiscard]] glm::vec3 mask_light(const ShadowDraw& draw) const;
  [[nodiscard]] std::optional<double> mask_depth(const Scene& scene, const FramePlan& plan,
                                                 int plane, ShadowWork& work);
  void make_mask(const Scene& scene, const FramePlan& plan, int plane, PlaneMask& mask,
                 ShadowWork& work);
  // How masks of parts in these bounds are laid out, for the camera as it is.
  using LayOut = std::function<MaskLayout(std::span<const CellBox>)>;
  void draw_masks(int half_octave, std::vector<MaskPart> of, const LayOut& lay_out, PlaneMask& mask,
                  ShadowWork& work);
  // `noted`: what they cover is known, of the group's parts.
  void draw_mask(const MaskLayout::Group& group, const std::vector<bool>& noted,
                 PlaneMask& plane_mask, DrawnMask& mask);
  // The half octave of cells that are no larger than so many pixels, so far away [m].
  [[nodiscard]] int mask_cell_at(double depth, double pixels) const;
  std::array<std::vector<PlanePoint>, 3> face_images(const MaskPart& part, ShadowWork& work);
  [[nodiscard]] MaskPart mask_part(const ShadowDraw& draw, Caster& caster,
                                   const Prepared& prepared) const;
  static void project_part(const MaskPart& part,
                           const std::array<std::vector<PlanePoint>, 3>& faces, double cell,
                           MaskCaster& caster, ShadowWork& work);
  void cover_part(const MaskPart& part, MaskCaster& caster);
  Prepared& prepare_level(const ReceivedShadowDraw& draw, int level, const ShadowDraw& shadow,
                          Caster& caster, bool masked, ShadowWork& work);
  void make_field(const ShadowDraw& draw, Caster& caster, Prepared& prepared, ShadowWork& work);
  // Where a field has nothing of what it is to have.
  static void note_empty_field(const Scene& scene, const ShadowDraw& draw, const Caster& caster,
                               const Prepared& prepared, ShadowWork& work);
  struct Item;
  // What layers are drawn with.
  struct Brush {
    const ShaderProgram& layers;
    const ShaderProgram& field;
    bool penumbra_first = false;
    bool door = false;  // layers are told by the places of a screen-door, not by the light left
  };
  [[nodiscard]] static glm::vec3 layer_values(const ShadowDraw& draw, const Brush& brush);
  void begin_plane(const Brush& brush, const LensUniforms& lens,
                   const glm::mat4x3& camera_from_plane);
  int draw_plane(const FramePlan& plan, int plane, const Brush& brush) const;
  int draw_strips(const FramePlan& plan, const PlaneReceiver& receiver, const LensUniforms& lens,
                  Receivers& receivers, const Brush& brush);
  int draw_all_layers(const ShadowDraw& draw, const Item& item, const Brush& brush) const;
  int draw_layers(const ShadowDraw& draw, const Item& item, int first_layer, int count,
                  const Brush& brush) const;
  int draw_field(const ShadowDraw& draw, const Item& item, int first_layer, int count,
                 const Brush& brush) const;

  TranslucentProgram shadow_program_;
  FieldQuad field_quad_;
  MaskQuad mask_quad_;
  MeshStrips mesh_strips_;
  Translucency way_ = Translucency::blend;
  bool smooth_edges_ = false;        // whatever is drawn: pixels have several samples
  bool fetches_video_ = true;        // retextured, and not from a copy
  std::vector<float> edges_;         // the longest of each scene object's model, as a caster
  std::vector<bool> steady_;         // of each scene object: a proxy may cast
  std::vector<bool> cut_outs_;       // of each scene object: its model has_cut_outs()
  double edge_at_unit_depth_ = 0.0;  // 1 m from the camera, the longest that follows the lens [m]
  // A pixel at the nearest distance expected: finer cells of a field would not be seen [m].
  double finest_field_cell_ = 0.0;
  double pixel_at_unit_depth_ = 0.0;  // 1 m from the camera [m]
  ViewFrustum frustum_;
  std::map<int, PlaneMask> plane_masks_;
  std::int64_t mask_pieces_skipped_ = 0;
  std::int64_t most_mask_side_ = 0;  // cells along a side, of a texture
  std::vector<MaskCaster> mask_casters_;
  MaskPicture mask_picture_;
  std::vector<std::uint8_t> mask_codes_, lighter_codes_;
  std::map<CasterKey, std::unique_ptr<Caster>> casters_;
  // One per shadow of the plan before: (node, object, plane, n-th of these in the plan).
  std::map<std::tuple<int, int, int, int>, Prepared> prepared_;
  struct Item {
    Caster* caster = nullptr;
    Prepared* prepared = nullptr;
    int node = 0, object = 0, plane = 0;
    PlaneFrame plane_frame;
  };
  std::vector<Item> items_;  // one per shadow of the plan
  // (node, object, plane, receiver, level).
  std::map<std::tuple<int, int, int, int, int>, Prepared> flat_prepared_;
  std::vector<std::pair<ShadowDraw, Item>> flats_;  // drawn in white
  std::uint64_t frame_count_ = 0;
};

}  // namespace penumbra
