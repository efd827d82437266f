// FramePlan + video frame -> composited picture, in OpenGL. The only place that draws.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/translucency.hpp"

namespace penumbra {

struct CompositeStats {
  double shadow_ms = 0.0, render_ms = 0.0,
         readback_ms = 0.0;  // wall; shadow: CPU work on shadow geometry
  double shadow_cpu_ms = 0.0, render_cpu_ms = 0.0,
         readback_cpu_ms = 0.0;  // CPU time of the calling thread
  // Of a GPU's own time: of frames drawn before this one, those that are known since the frame
  // before. Each frame's once; none where it is not measured (CompositorOptions).
  std::vector<double> gpu_ms;
  // Passes that drew anything: video, phantoms, objects, shadows on planes, received shadows, hard
  // shadows, volumes, see-through objects, rays.
  std::int64_t passes_drawn = 0;
  std::int64_t passes_skipped = 0;   // what the plan and the geometry left out
  std::int64_t draw_calls = 0;       // of OpenGL's
  std::int64_t shadow_vertices = 0;  // vertices that the CPU projected or clipped for shadows
  std::int64_t kernel_generations = 0;
  // Shadows drawn from the geometry of an earlier frame: only the camera moved, or the caster slid
  // or turned on the plane. The other casters x planes x lights are recomputed.
  std::int64_t reprojections = 0;
  std::int64_t triples_recomputed = 0;
  std::int64_t proxy_shadows = 0;      // drawn from a reduced mesh
  std::int64_t proxy_checks = 0;       // times that a reduced mesh was compared with its model
  std::int64_t proxy_faces_saved = 0;  // by those drawn, over all their layers
  // Of the layers on a plane as a picture of their own: drawn, and kept from a frame before.
  std::int64_t layer_masks_drawn = 0, layer_masks_kept = 0;
  std::int64_t mask_pieces_skipped = 0;  // of these pictures, where they darken nothing
  // Of the shadows on phantoms and objects, a picture for each level: drawn, and kept from a frame
  // before.
  std::int64_t masks_drawn = 0, masks_kept = 0;
  // The video frame: copied to the GPU, or read by it in the camera's own buffer. Neither for one
  // that was there already.
  std::int64_t video_copies = 0, video_imports = 0;
  // Through pixel buffers: of the copies, and pictures that ask_for_picture() asked for.
  std::int64_t pixel_buffer_uploads = 0, pixel_buffer_read_backs = 0;
  // Faces of the kernel sets made in this frame, and those that turn over in some layer.
  std::int64_t faces_tested = 0, faces_twisted = 0;
  Translucency translucency = Translucency::blend;  // as it was drawn; never automatic
  // What the plan asked for and could not be drawn; counted in passes_skipped.
  std::vector<SkippedPass> skipped;
  std::vector<KeptPart> kept;
};
// Of two pictures together. Without gpu_ms: those of two compositors are not of the same frames.
void add(CompositeStats& to, const CompositeStats& stats);

struct CompositorOptions {
  // The video without its lens's distortion (rectified_video.hpp). Plans are then made for a camera
  // without_distortion().
  bool rectified = false;
  // Samples of each pixel at the edges of what is drawn; 0: no multisampling. Nothing: by the
  // renderer, as multisampling_for() says. The driver may give more than asked.
  std::optional<int> msaa = std::nullopt;
  // The video goes to the GPU, and pictures that ask_for_picture() asks for come from it, through
  // buffers of the driver's, so that neither it nor this thread waits for the other. Nothing: where
  // the renderer is no CPU rasteriser, which has nobody to wait for and pays for the copies. The
  // pictures are the same.
  std::optional<bool> pixel_buffers = std::nullopt;
  // Frames are timed by the GPU's clock, where the driver has one (gpu_timer.hpp). Nothing: where
  // the renderer is no CPU rasteriser, whose time is the process's.
  std::optional<bool> gpu_time = std::nullopt;
};

// What multisampling is worth by itself: on a GPU 4 samples, which tiling ones (a Raspberry Pi's)
// keep on the chip; none with a rasteriser on the CPU, which pays for each (BENCHMARKS.md). At most
// what the driver has.
[[nodiscard]] int multisampling_for(bool software, int most_samples);

class Compositor {
 public:
  // Uploads the scene's models. The context must be current on this thread, now and at every later
  // call, and outlive the compositor.
  [[nodiscard]] static Result<Compositor> create(GlContext& context,
                                                 std::shared_ptr<const Scene> scene,
                                                 const CameraModel& camera,
                                                 const CompositorOptions& options = {});
  Compositor(Compositor&&) noexcept;
  Compositor& operator=(Compositor&&) noexcept;
  ~Compositor();

  // What the context was found to do when this was created, for tests to say otherwise.
  [[nodiscard]] const PictureAbilities& abilities() const;
  void set_abilities(const PictureAbilities& abilities);

  // Draws into a framebuffer of its own, of the camera's size.
  [[nodiscard]] Result<CompositeStats> draw(const Frame& frame, const FramePlan& plan);
  // The last picture: RGBA8, rows top to bottom, width * height * 4 bytes. Adds to the last stats'
  // read-back time, given back.
  [[nodiscard]] Result<CompositeStats> read_back(std::span<std::uint8_t> rgba);

  // Whether pictures can be asked for, and the video goes through pixel buffers.
  [[nodiscard]] bool pixel_buffers() const;
  // What read_back() would give, later: the picture as it is now goes into a pixel buffer once it
  // is drawn, and nothing waits for it. At most two may be on their way. Adds to the last stats, as
  // take_picture() does. Where it fails it was not asked for.
  [[nodiscard]] Result<CompositeStats> ask_for_picture();
  // How many of them are on their way.
  [[nodiscard]] std::size_t pictures_asked_for() const;
  // The one that was asked for first; waits until it is drawn. Where it fails none is on its way
  // any more.
  [[nodiscard]] Result<CompositeStats> take_picture(std::span<std::uint8_t> rgba);
  // The GPU's times that are known by now and no stats had [ms]; never waits.
  [[nodiscard]] std::vector<double> take_gpu_times();
  // Copies the last picture to the context's window, letterboxed.
  void present();
  // Of each pixel; 0 without multisampling.
  [[nodiscard]] int samples() const;
  // Black, until something is drawn. What was drawn before is not among the GPU's times.
  void clear();
  // For a debug view: the kernels that the last picture's shadows were made with, and how many
  // faces turn over for them.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const;

 private:
  struct Impl;
  explicit Compositor(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
