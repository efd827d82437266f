// Draws a FramePlan over a video frame with OpenGL. No other class draws images.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

struct CompositeStats : RenderWork {
  // Wall time, and CPU time of the calling thread. shadow_*: work on shadow geometry.
  double shadow_ms = 0.0, render_ms = 0.0, readback_ms = 0.0;
  double shadow_cpu_ms = 0.0, render_cpu_ms = 0.0, readback_cpu_ms = 0.0;
  // GPU times of earlier frames that arrived since the last frame; empty if not measured.
  std::vector<double> gpu_ms;
  Translucency translucency = Translucency::blend;  // never automatic
};
// Adds the statistics of a frame, except gpu_ms, because these times belong to other frames.
void add(CompositeStats& to, const CompositeStats& stats);

struct CompositorOptions {
  // Draws the undistorted video (rectified_video.hpp). Plans must use the camera
  // without_distortion().
  bool rectified = false;
  // Size of the image [px]; nullopt: the video's. Another size shows the video resampled.
  std::optional<ImageSize> size = std::nullopt;
  // Samples per pixel; 0: no multisampling; nullopt: multisampling_for(), and on a CPU rasteriser
  // edges are smoothed afterwards (edge_smoother.hpp). The driver may use more.
  std::optional<int> msaa = std::nullopt;
  // Converts the video on the CPU in place of the shader (VideoRgba), except with `rectified`,
  // another size, multisampling or Translucency::retexture. The video differs by at most 1 code;
  // smoothed edges may differ more. nullopt: true on a CPU rasteriser.
  std::optional<bool> video_on_cpu = std::nullopt;
  // Transfers the video, and images of request_image(), asynchronously through pixel buffers; they
  // do not change the image. nullopt: true, except on a CPU rasteriser, where the copies cost
  // time.
  std::optional<bool> pixel_buffers = std::nullopt;
};

// Returns the default number of samples: 4 on a GPU, limited by `max_samples`; 0 on a CPU
// rasteriser, where each costs time (docs/benchmarks/instructions.md).
[[nodiscard]] int multisampling_for(bool software, int max_samples);

class Compositor {
 public:
  // Uploads the scene's models. The context must be current on this thread, now, at every later
  // call and at the compositor's destruction.
  [[nodiscard]] static Result<Compositor> create(GlContext& context,
                                                 std::shared_ptr<const Scene> scene,
                                                 const CameraModel& camera,
                                                 const CompositorOptions& options = {});
  Compositor(Compositor&&) noexcept;
  Compositor& operator=(Compositor&&) noexcept;
  ~Compositor();

  // Draws into the compositor's framebuffer. The frame has the camera's size.
  [[nodiscard]] Result<CompositeStats> draw(const Frame& frame, const FramePlan& plan);
  // Reads the most recent image: RGBA8, rows top to bottom, width * height * 4 bytes. Returns the
  // stats of its draw() with the read-back time added.
  [[nodiscard]] Result<CompositeStats> read_back(std::span<std::uint8_t> rgba);

  // Returns true if pixel buffers are in use, which request_image() requires.
  [[nodiscard]] bool pixel_buffers() const;
  // Starts an asynchronous read_back(); up to two may be pending. Like take_image(), returns the
  // stats of the most recent draw() with the read-back time added. A failed request is not pending.
  [[nodiscard]] Result<CompositeStats> request_image();
  [[nodiscard]] std::size_t pending_images() const;
  // Reads the oldest pending image; waits until it is drawn. A failure drops all pending images.
  [[nodiscard]] Result<CompositeStats> take_image(std::span<std::uint8_t> rgba);
  // Returns the GPU times [ms] that have arrived and are not in any stats yet; never waits.
  [[nodiscard]] std::vector<double> take_gpu_times();
  // Copies the most recent image to the context's window, letterboxed.
  void present();
  // Samples per pixel; 0 without multisampling.
  [[nodiscard]] int samples() const;
  [[nodiscard]] ImageSize size() const;
  // Clears the image to black and drops the GPU times of earlier frames.
  void clear();
  // For the debug view: returns the kernels and twisted faces of the most recent image's shadows.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const;

 private:
  struct Impl;
  explicit Compositor(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
