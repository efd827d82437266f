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
#include "render/render_work.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/translucency.hpp"

namespace penumbra {

struct CompositeStats : RenderWork {
  double shadow_ms = 0.0, render_ms = 0.0,
         readback_ms = 0.0;  // wall; shadow: CPU work on shadow geometry
  double shadow_cpu_ms = 0.0, render_cpu_ms = 0.0,
         readback_cpu_ms = 0.0;  // CPU time of the calling thread
  // The GPU's own times of earlier frames that became known since the frame before, each once.
  // Empty where they are not measured (CompositorOptions).
  std::vector<double> gpu_ms;
  Translucency translucency = Translucency::blend;  // as it was drawn; never automatic
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
