#include "render/compositor.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/gpu_timer.hpp"
#include "render/gl/pixel_buffer.hpp"
#include "render/passes/contact_pass.hpp"
#include "render/passes/edge_smoother.hpp"
#include "render/passes/hard_pass.hpp"
#include "render/passes/ray_pass.hpp"
#include "render/passes/received_shadow_pass.hpp"
#include "render/passes/rectified_video.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/passes/volume_pass.hpp"
#include "render/passes/wall_pass.hpp"
#include "render/scene/video_rgba.hpp"

namespace penumbra {
namespace {

// Phantoms stand for real things: they write depth only.
class PhantomPass : public Pass {
 public:
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_phantoms(plan, context.lens);
  }
};

class ObjectPass : public Pass {
 public:
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_objects(plan, context.lens, context.framebuffer);
  }
};

// Draws blended surfaces after the shadows, which they don't receive.
class BlendedPass : public Pass {
 public:
  int draw(const DrawContext& context, const FramePlan& plan) override {
    return context.objects.draw_blended(plan, context.lens, context.framebuffer);
  }
};

}  // namespace

struct Compositor::Impl {
  Impl(GlContext& gl, const Scene& shown, const CameraModel& camera, ImageSize of_video,
       bool with_pixel_buffers)
      : context(gl),
        video_size(of_video),
        scene(shown),
        width(camera.width()),
        height(camera.height()),
        lens(make_lens(camera)),
        pixel_buffers(with_pixel_buffers),
        video(gl.info().api, with_pixel_buffers),
        casters(scene, camera),
        geometry(casters, camera) {}

  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  // OpenGL names must be deleted in their context.
  ~Impl() { context.make_current(); }

  GlContext& context;
  ImageSize video_size;
  Scene scene;  // models of objects with an animation: the shapes of the most recent frame
  int width;
  int height;
  LensUniforms lens;
  Framebuffer framebuffer;
  FragmentAbilities abilities;
  bool pixel_buffers;
  ReadBackBuffers read_backs;
  std::optional<GpuTimer> gpu_timer;
  VideoTexture video;
  std::optional<RectifiedVideo> resampled;  // nullopt: the image shows the video 1:1
  std::optional<VideoRgba> converted;       // set if the CPU converts the video
  // Shared by the passes.
  ObjectPainter objects;
  Receivers receivers;
  CasterCache casters;
  ShadowGeometry geometry;
  LayerPainter painter;
  std::vector<std::unique_ptr<Pass>> surfaces;  // passes that write depth, in drawing order
  std::vector<std::unique_ptr<Pass>> overlays;  // passes that read this depth and the planes'
  ShadowPass* shadows = nullptr;                // one of `overlays`
  std::optional<EdgeSmoother> smoother;
  CompositeStats stats;

  Result<void> make_passes(const CameraModel& camera, int samples) {
    const GlApi api = context.info().api;
    PENUMBRA_TRY(framebuffer, Framebuffer::create(width, height, samples));
    PENUMBRA_TRY(abilities, probe_fragment_abilities(api));
    PENUMBRA_TRY(objects, ObjectPainter::create(api, scene, camera, smoother.has_value()));
    PENUMBRA_TRY(receivers, Receivers::create(api, scene, camera));
    PENUMBRA_TRY(painter, LayerPainter::create(api, camera));
    const bool multisampled = framebuffer.samples() > 0;
    surfaces.push_back(std::make_unique<PhantomPass>());
    surfaces.push_back(std::make_unique<ObjectPass>());
    PENUMBRA_TRY(auto on_planes, ShadowPass::create(api, camera, geometry, painter, multisampled));
    shadows = on_planes.get();
    PENUMBRA_TRY(auto hard, HardPass::create(api, camera));
    PENUMBRA_TRY(auto volumes, VolumePass::create(api, camera));
    PENUMBRA_TRY(auto contacts, ContactPass::create(api, camera));
    PENUMBRA_TRY(auto walls, WallPass::create(api, camera));
    PENUMBRA_TRY(auto rays, RayPass::create(api, camera));
    overlays.push_back(std::move(on_planes));
    overlays.push_back(
        std::make_unique<ReceivedShadowPass>(camera, geometry, painter, multisampled));
    overlays.push_back(std::move(hard));
    overlays.push_back(std::move(volumes));
    // In mode retexture, shadows on planes are drawn from the video and would replace what follows.
    overlays.push_back(std::move(contacts));
    overlays.push_back(std::move(walls));
    overlays.push_back(std::make_unique<BlendedPass>());
    overlays.push_back(std::move(rays));
    return {};
  }

  Result<void> prepare(const DrawContext& draw_context, const FramePlan& plan) {
    objects.pose(plan.posed);
    PENUMBRA_TRY_VOID(objects.choose(draw_context.mode, draw_context.video_format));
    casters.begin_frame();
    for (const auto* passes : {&surfaces, &overlays}) {
      for (const std::unique_ptr<Pass>& pass : *passes)
        PENUMBRA_TRY_VOID(pass->prepare(draw_context, plan));
    }
    return {};
  }

  // Puts the shapes of the frame in place. Returns the plan with the layered shadows of objects
  // whose kernels are carried.
  [[nodiscard]] FramePlan with_shapes(const FramePlan& plan) {
    for (const PosedModel& posed : plan.posed)
      scene.objects[static_cast<std::size_t>(posed.object)].model = posed.model;
    FramePlan posed = plan;
    const auto choose = [&](ShadowDraw& shadow) {
      if (!shadow.may_carry_kernels) return true;
      if (!casters.carries_kernels(scene, shadow)) return false;
      shadow.technique = ShadowTechnique::layered;
      return true;
    };
    for (ShadowDraw& shadow : posed.shadows) {
      const SkippedPass not_carried{SkipReason::kernels_not_carried, shadow.object};
      if (!choose(shadow) && std::ranges::find(stats.skipped, not_carried) == stats.skipped.end())
        stats.skipped.push_back(not_carried);
    }
    for (ShadowDraw& shadow : posed.skipped_shadows) choose(shadow);
    for (ReceivedShadowDraw& received : posed.received_shadows) choose(received.shadow);
    return posed;
  }

  void draw_passes(const DrawContext& draw_context, const FramePlan& plan) {
    glDepthMask(GL_TRUE);
    glStencilMask(0xFF);
    glClear(GL_DEPTH_BUFFER_BIT | GL_STENCIL_BUFFER_BIT);
    for (const std::unique_ptr<Pass>& pass : surfaces) count(pass->draw(draw_context, plan));
    // Planes may hide phantoms, so planes are drawn later. `receivers` is not a Pass, because later
    // passes use its stencil bits.
    stats[Counter::draw_calls] += receivers.begin_frame(plan, lens, plan.volume_lights > 0);
    for (const std::unique_ptr<Pass>& pass : overlays) count(pass->draw(draw_context, plan));
    if (smoother) stats[Counter::edge_pixels] = smoother->smooth(draw_context, plan);
    framebuffer.invalidate_depth_stencil();
  }

  void count(int draw_calls) {
    stats[Counter::passes_drawn] += draw_calls > 0 ? 1 : 0;
    stats[Counter::draw_calls] += draw_calls;
  }

  void upload(const Frame& frame, bool reuse) {
    const VideoTexture::Upload method = video.upload(frame, reuse);
    const bool buffered = method == VideoTexture::Upload::buffered;
    stats[Counter::video_copies] = method == VideoTexture::Upload::copied || buffered ? 1 : 0;
    stats[Counter::video_imports] = method == VideoTexture::Upload::imported ? 1 : 0;
    stats[Counter::pixel_buffer_uploads] = buffered ? 1 : 0;
    if (method == VideoTexture::Upload::there) stats.kept.push_back({KeepReason::video});
  }

  // Draws the video as the background.
  [[nodiscard]] Result<void> draw_video(const DrawContext& draw_context, bool reuse) {
    const Frame& frame = draw_context.frame;
    // With `retexture`, shadows fetch the video, so the background has the same conversion.
    if (!converted || draw_context.mode == Translucency::retexture) {
      upload(frame, reuse);
      count(1);
      return resampled ? resampled->draw(video, frame) : video.draw(frame);
    }
    video.release_all();
    const bool same = reuse && converted->holds(frame);
    framebuffer.write_part({0, 0, width, height},
                           same ? converted->bytes() : converted->convert(frame));
    stats[Counter::passes_drawn] += 1;
    if (same) {
      stats.kept.push_back({KeepReason::video});
    } else {
      stats[Counter::video_copies] = 1;
    }
    return {};
  }

  [[nodiscard]] std::size_t image_bytes() const {
    return std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  }

  [[nodiscard]] Result<CompositeStats> read(const Stopwatch& since) {
    since.add_to(stats.readback_ms, stats.readback_cpu_ms);
    if (const auto error = take_gl_error(context.info()))
      return fail("while the image is read back: {}", gl_error_text(*error));
    return stats;
  }
};

void add(CompositeStats& to, const CompositeStats& stats) {
  to.shadow_ms += stats.shadow_ms;
  to.render_ms += stats.render_ms;
  to.readback_ms += stats.readback_ms;
  to.shadow_cpu_ms += stats.shadow_cpu_ms;
  to.render_cpu_ms += stats.render_cpu_ms;
  to.readback_cpu_ms += stats.readback_cpu_ms;
  to.counters += stats.counters;
  to.skipped.insert(to.skipped.end(), stats.skipped.begin(), stats.skipped.end());
  to.kept.insert(to.kept.end(), stats.kept.begin(), stats.kept.end());
}

int multisampling_for(bool software, int max_samples) {
  constexpr int kSamples = 4;
  return software ? 0 : std::clamp(max_samples, 0, kSamples);
}

Compositor::Compositor(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Compositor::Compositor(Compositor&&) noexcept = default;
Compositor& Compositor::operator=(Compositor&&) noexcept = default;
Compositor::~Compositor() = default;

Result<Compositor> Compositor::create(GlContext& context, std::shared_ptr<const Scene> scene,
                                      const CameraModel& video_camera,
                                      const CompositorOptions& options) {
  PENUMBRA_ASSERT(scene != nullptr);
  const bool rectified = options.rectified && video_camera.has_distortion();
  CameraModel camera = rectified ? without_distortion(video_camera) : video_camera;
  const ImageSize video_size{camera.width(), camera.height()};
  const ImageSize size = options.size.value_or(video_size);
  if (size != video_size) camera = with_size(camera, size.width, size.height);
  GLint max_samples = 0;
  glGetIntegerv(GL_MAX_SAMPLES, &max_samples);
  const int samples =
      options.msaa.value_or(multisampling_for(context.info().software, max_samples));
  const GlApi api = context.info().api;
  const bool on_gpu = !context.info().software;
  auto impl = std::make_unique<Impl>(context, *scene, camera, video_size,
                                     options.pixel_buffers.value_or(on_gpu));
  if (!options.msaa && !on_gpu && can_read_depth()) impl->smoother.emplace();
  PENUMBRA_TRY_VOID(impl->make_passes(camera, samples));
  if (on_gpu) impl->gpu_timer = GpuTimer::create(api);
  if (rectified || size != video_size) {
    impl->resampled.emplace(api, video_camera, camera);
  } else if (options.video_on_cpu.value_or(!on_gpu) && impl->framebuffer.samples() == 0) {
    impl->converted.emplace();
  }
  // Reports errors of creating models, textures and programs.
  if (const auto error = take_gl_error(context.info()))
    return fail("{}: {}", impl->scene.file, gl_error_text(*error));
  return Compositor(std::move(impl));
}

Result<CompositeStats> Compositor::draw(const Frame& frame, const FramePlan& planned) {
  Impl& m = *impl_;
  if (frame.empty() || frame.width != m.video_size.width || frame.height != m.video_size.height) {
    return fail(
        "frame {} is {} x {} px, the camera model's {} x {}; give the camera model that "
        "belongs to the video",
        frame.sequence, frame.width, frame.height, m.video_size.width, m.video_size.height);
  }
  m.stats = {};
  const DrawContext context{m.scene,
                            m.lens,
                            m.framebuffer,
                            m.receivers,
                            m.objects,
                            m.video,
                            frame,
                            m.resampled ? std::nullopt : std::optional(frame.format),
                            choose_translucency(planned.translucency, m.abilities),
                            m.stats};
  const Stopwatch shadow_clock;
  const std::optional<FramePlan> with_shapes =
      planned.posed.empty() ? std::nullopt : std::optional(m.with_shapes(planned));
  const FramePlan& plan = with_shapes ? *with_shapes : planned;
  if (m.gpu_timer) {
    m.gpu_timer->take(m.stats.gpu_ms);
    m.gpu_timer->begin();
  }
  if (auto prepared = m.prepare(context, plan); !prepared) {
    if (m.gpu_timer) m.gpu_timer->end();
    return tl::unexpected(prepared.error());
  }
  shadow_clock.add_to(m.stats.shadow_ms, m.stats.shadow_cpu_ms);

  const Stopwatch render_clock;
  m.framebuffer.bind();
  const auto drawn = m.draw_video(context, plan.reuse);
  if (drawn && plan.has_pose) m.draw_passes(context, plan);
  if (m.gpu_timer) m.gpu_timer->end();
  if (!drawn) return tl::unexpected(drawn.error());
  m.video.hold(frame);
  // Waits for a CPU rasteriser here, so that its time does not count as read-back.
  if (m.context.info().software) glFinish();
  render_clock.add_to(m.stats.render_ms, m.stats.render_cpu_ms);
  if (const auto error = take_gl_error(m.context.info()))
    return fail("frame {}: {}", frame.sequence, gl_error_text(*error));

  m.stats.translucency = context.mode;
  m.stats[Counter::passes_skipped] =
      static_cast<std::int64_t>(plan.skipped.size() + m.stats.skipped.size());
  return m.stats;
}

Result<CompositeStats> Compositor::read_back(std::span<std::uint8_t> rgba) {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(rgba.size() == m.image_bytes());
  const Stopwatch clock;
  m.framebuffer.read_rgba(rgba);
  return m.read(clock);
}

bool Compositor::pixel_buffers() const {
  return impl_->pixel_buffers;
}

Result<CompositeStats> Compositor::request_image() {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(m.pixel_buffers);
  const Stopwatch clock;
  m.read_backs.ask(m.framebuffer, m.image_bytes());
  ++m.stats[Counter::pixel_buffer_read_backs];
  auto stats = m.read(clock);
  if (!stats) m.read_backs.drop_last();
  return stats;
}

std::size_t Compositor::pending_images() const {
  return impl_->read_backs.pending_reads();
}

Result<CompositeStats> Compositor::take_image(std::span<std::uint8_t> rgba) {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(rgba.size() == m.image_bytes());
  const Stopwatch clock;
  const auto taken = m.read_backs.take(rgba);
  auto stats = m.read(clock);  // checked first, because its error is more specific
  if (!stats || !taken) m.read_backs.drop_all();
  if (stats && !taken) return tl::unexpected(taken.error());
  return stats;
}

std::vector<double> Compositor::take_gpu_times() {
  std::vector<double> times_ms;
  if (impl_->gpu_timer) impl_->gpu_timer->take(times_ms);
  return times_ms;
}

std::vector<CasterKernels> Compositor::kernels_in_use() const {
  return impl_->shadows->kernels_in_use();
}

ImageSize Compositor::size() const {
  return {impl_->width, impl_->height};
}

int Compositor::samples() const {
  return impl_->framebuffer.samples();
}

void Compositor::clear() {
  impl_->framebuffer.clear();
  if (impl_->gpu_timer) impl_->gpu_timer->drop_pending();
}

void Compositor::present() {
  impl_->framebuffer.present(impl_->context.window_size());
}

}  // namespace penumbra
