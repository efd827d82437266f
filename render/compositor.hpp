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
// Adds up two frames. Without gpu_ms: those of two compositors are not of the same frames.
void add(CompositeStats& to, const CompositeStats& stats);

struct CompositorOptions {
  // The video without its lens's distortion (rectified_video.hpp). Plans are then made for a camera
  // without_distortion().
  bool rectified = false;
  // Samples of each pixel; 0: no multisampling; none: multisampling_for() the renderer. The driver
  // may give more than requested.
  std::optional<int> msaa = std::nullopt;
  // Transfers the video to the GPU, and images of ask_for_picture() from it, through pixel buffers,
  // so that neither the GPU nor this thread waits for the other. None: true but on a CPU
  // rasteriser, which pays for the copies. The images are the same.
  std::optional<bool> pixel_buffers = std::nullopt;
  // Times frames by the GPU's clock, where the driver has one (gpu_timer.hpp). None: true but on a
  // CPU rasteriser, whose time is the process's.
  std::optional<bool> gpu_time = std::nullopt;
};

// The default number of samples: 4 on a GPU (tiling ones, as a Raspberry Pi's, keep them on the
// chip), none on a CPU rasteriser, which pays for each (BENCHMARKS.md). At most what the driver
// has.
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
  // Reads the last image: RGBA8, rows top to bottom, width * height * 4 bytes. Returns the last
  // stats with the read-back time added.
  [[nodiscard]] Result<CompositeStats> read_back(std::span<std::uint8_t> rgba);

  // Whether ask_for_picture() may be called, and the video goes through pixel buffers.
  [[nodiscard]] bool pixel_buffers() const;
  // Starts an asynchronous read_back(): the image goes into a pixel buffer once it is drawn. At
  // most two may be pending. Returns the last stats with the time added, as take_picture() does.
  // Where it fails nothing is pending for it.
  [[nodiscard]] Result<CompositeStats> ask_for_picture();
  // Number of pending images.
  [[nodiscard]] std::size_t pictures_asked_for() const;
  // Takes the oldest pending image; waits until it is drawn. Where it fails all pending ones are
  // dropped.
  [[nodiscard]] Result<CompositeStats> take_picture(std::span<std::uint8_t> rgba);
  // Takes the GPU's times that are known by now and that no stats had [ms]; never waits.
  [[nodiscard]] std::vector<double> take_gpu_times();
  // Copies the last picture to the context's window, letterboxed.
  void present();
  // Samples of each pixel; 0 without multisampling.
  [[nodiscard]] int samples() const;
  // Clears the image to black and forgets the GPU's times of earlier frames.
  void clear();
  // For the debug view: the kernels of the last image's shadows, and how many faces turn over for
  // them.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const;

 private:
  struct Impl;
  explicit Compositor(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
