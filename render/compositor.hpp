// FramePlan + video frame -> composited image, in OpenGL. The only place that draws.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

struct CompositeStats : RenderWork {
  // Wall time, and CPU time of the calling thread. `shadow`: work on shadow geometry.
  double shadow_ms = 0.0, render_ms = 0.0, readback_ms = 0.0;
  double shadow_cpu_ms = 0.0, render_cpu_ms = 0.0, readback_cpu_ms = 0.0;
  // GPU times of earlier frames that arrived since the last frame; empty if not measured.
  std::vector<double> gpu_ms;
  Translucency translucency = Translucency::blend;  // never automatic
};
// Adds up two frames, without gpu_ms, which belong to other frames.
void add(CompositeStats& to, const CompositeStats& stats);

struct CompositorOptions {
  // Draws the undistorted video (rectified_video.hpp). Plans are then for a camera
  // without_distortion().
  bool rectified = false;
  // Samples per pixel; 0: no multisampling; none: multisampling_for() the renderer. The driver may
  // give more.
  std::optional<int> msaa = std::nullopt;
  // Transfers the video, and images of request_image(), asynchronously through pixel buffers.
  // None: true except on a CPU rasteriser, which pays for the copies. The images are the same.
  std::optional<bool> pixel_buffers = std::nullopt;
};

// Returns the default number of samples: 4 on a GPU, none on a CPU rasteriser, which pays for each
// (docs/benchmarks/instructions.md). At most what the driver has.
[[nodiscard]] int multisampling_for(bool software, int most_samples);

class Compositor {
 public:
  // Uploads the scene's models. The context must outlive the compositor and be current on this
  // thread, now and at every later call.
  [[nodiscard]] static Result<Compositor> create(GlContext& context,
                                                 std::shared_ptr<const Scene> scene,
                                                 const CameraModel& camera,
                                                 const CompositorOptions& options = {});
  Compositor(Compositor&&) noexcept;
  ~Compositor();

  // Draws into its own framebuffer, of the camera's size.
  [[nodiscard]] Result<CompositeStats> draw(const Frame& frame, const FramePlan& plan);
  // Reads the last image: RGBA8, rows top to bottom, width * height * 4 bytes. Returns the last
  // stats with the read-back time added.
  [[nodiscard]] Result<CompositeStats> read_back(std::span<std::uint8_t> rgba);

  // Returns whether pixel buffers are in use; request_image() needs them.
  [[nodiscard]] bool pixel_buffers() const;
  // Starts an asynchronous read_back(). At most two may be pending. Returns the last stats with the
  // time added, as take_image() does. After a failure nothing is pending for it.
  [[nodiscard]] Result<CompositeStats> request_image();
  [[nodiscard]] std::size_t pictures_asked_for() const;
  // Takes the oldest pending image; waits until it is drawn. A failure drops all pending images.
  [[nodiscard]] Result<CompositeStats> take_image(std::span<std::uint8_t> rgba);
  // Takes the GPU times [ms] that have arrived and are in no stats yet; never waits.
  [[nodiscard]] std::vector<double> take_gpu_times();
  // Copies the last image to the context's window, letterboxed.
  void present();
  // Samples per pixel; 0 without multisampling.
  [[nodiscard]] int samples() const;
  // Clears the image to black and drops the GPU times of earlier frames.
  void clear();
  // For the debug view: the kernels of the last image's shadows, and the number of their twisted
  // faces.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const;

 private:
  struct Impl;
  explicit Compositor(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
