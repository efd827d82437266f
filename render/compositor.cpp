#include "render/compositor.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <iterator>
#include <optional>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "render/camera_gl.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/gl/gl_error.hpp"
#include "render/gl/gpu_timer.hpp"
#include "render/gl/picture_probe.hpp"
#include "render/gl/pixel_buffer.hpp"
#include "render/passes/hard_pass.hpp"
#include "render/passes/object_pass.hpp"
#include "render/passes/ray_pass.hpp"
#include "render/passes/received_shadow_pass.hpp"
#include "render/passes/receivers.hpp"
#include "render/passes/rectified_video.hpp"
#include "render/passes/shadow_pass.hpp"
#include "render/passes/video_pass.hpp"
#include "render/passes/volume_pass.hpp"

namespace penumbra {
namespace {

// Whether a plane's shadows may be seen on an object and not on the video: on what lies behind the
// plane, below a table or a wall's own body. Any part of its box counts.
bool objects_lie_behind_planes(const Scene& scene, const FramePlan& plan) {
  constexpr double kContact = 1e-6;  // [m], as of what stands on a plane
  for (const PlaneReceiver& receiver : plan.receivers) {
    if (std::ranges::find(plan.shadows, receiver.plane, &ShadowDraw::plane) == plan.shadows.end())
      continue;
    const double side = receiver.frame.height(plan.T_table_camera.translation()) < 0.0 ? -1.0 : 1.0;
    for (const ObjectDraw& object : plan.objects) {
      const Model* model = scene.objects[static_cast<std::size_t>(object.object)].model.get();
      if (model == nullptr) continue;
      for (unsigned corner = 0; corner < 8; ++corner) {
        const auto at = [&](int axis) {
          const bool high = (corner >> static_cast<unsigned>(axis) & 1U) != 0;
          return static_cast<double>((high ? model->max_corner : model->min_corner)[axis]);
        };
        const Eigen::Vector3d p = object.T_table_object * Eigen::Vector3d(at(0), at(1), at(2));
        if (!(side * receiver.frame.height(p) >= -kContact)) return true;
      }
    }
  }
  return false;
}

}  // namespace

struct Compositor::Impl {
  Impl(GlContext& gl, std::shared_ptr<const Scene> shown, const CameraModel& camera,
       Framebuffer target, const PictureAbilities& found, ObjectPass object_pass,
       Receivers receiving, ShadowPass shadow_pass, HardPass hard_pass, VolumePass volume_pass,
       RayPass ray_pass, bool with_pixel_buffers, std::optional<GpuTimer> timer)
      : context(gl),
        scene(std::move(shown)),
        width(camera.width()),
        height(camera.height()),
        lens(make_lens(camera)),
        framebuffer(std::move(target)),
        abilities(found),
        pixel_buffers(with_pixel_buffers),
        gpu_timer(std::move(timer)),
        video(gl.info().api, with_pixel_buffers),
        objects(std::move(object_pass)),
        receivers(std::move(receiving)),
        shadows(std::move(shadow_pass)),
        hard_shadows(std::move(hard_pass)),
        volumes(std::move(volume_pass)),
        rays(std::move(ray_pass)) {}

  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  // Names are deleted in the context that they were made in.
  ~Impl() { context.make_current(); }

  GlContext& context;
  std::shared_ptr<const Scene> scene;
  int width;
  int height;
  LensUniforms lens;
  Framebuffer framebuffer;
  PictureAbilities abilities;
  bool pixel_buffers;
  ReadBackBuffers pictures;
  std::optional<GpuTimer> gpu_timer;
  VideoPass video;
  std::optional<RectifiedVideo> rectified;
  ObjectPass objects;
  Receivers receivers;
  ShadowPass shadows;
  ReceivedShadowPass received_shadows;
  HardPass hard_shadows;
  VolumePass volumes;
  RayPass rays;
  CompositeStats stats;

  // All passes draw in one way.
  Result<void> choose(Translucency way, PixelFormat captured, const FramePlan& plan) {
    const auto format = rectified ? std::nullopt : std::optional(captured);
    if (auto chosen = objects.choose(way, format); !chosen) return chosen;
    const bool on_objects =
        way == Translucency::retexture && objects_lie_behind_planes(*scene, plan);
    if (auto chosen = shadows.choose(way, on_objects ? std::nullopt : format); !chosen)
      return chosen;
    if (auto chosen = hard_shadows.choose(way, format); !chosen) return chosen;
    if (auto chosen = volumes.choose(way, format); !chosen) return chosen;
    return rays.choose(way, format);
  }

  [[nodiscard]] std::size_t picture_bytes() const {
    return std::size_t{4} * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  }

  [[nodiscard]] Result<CompositeStats> read(const Stopwatch& since) {
    since.add_to(stats.readback_ms, stats.readback_cpu_ms);
    if (const auto error = noted_gl_error(context.info()))
      return fail("while the picture is read back: {}", gl_error_text(*error));
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
  to.passes_drawn += stats.passes_drawn;
  to.passes_skipped += stats.passes_skipped;
  to.draw_calls += stats.draw_calls;
  to.shadow_vertices += stats.shadow_vertices;
  to.kernel_generations += stats.kernel_generations;
  to.reprojections += stats.reprojections;
  to.triples_recomputed += stats.triples_recomputed;
  to.proxy_shadows += stats.proxy_shadows;
  to.proxy_checks += stats.proxy_checks;
  to.proxy_faces_saved += stats.proxy_faces_saved;
  to.layer_masks_drawn += stats.layer_masks_drawn;
  to.layer_masks_kept += stats.layer_masks_kept;
  to.mask_pieces_skipped += stats.mask_pieces_skipped;
  to.masks_drawn += stats.masks_drawn;
  to.masks_kept += stats.masks_kept;
  to.video_copies += stats.video_copies;
  to.video_imports += stats.video_imports;
  to.pixel_buffer_uploads += stats.pixel_buffer_uploads;
  to.pixel_buffer_read_backs += stats.pixel_buffer_read_backs;
  to.faces_tested += stats.faces_tested;
  to.faces_twisted += stats.faces_twisted;
  to.skipped.insert(to.skipped.end(), stats.skipped.begin(), stats.skipped.end());
  to.kept.insert(to.kept.end(), stats.kept.begin(), stats.kept.end());
}

int multisampling_for(bool software, int most_samples) {
  constexpr int kSamples = 4;
  return software ? 0 : std::clamp(most_samples, 0, kSamples);
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
  const CameraModel camera = rectified ? without_distortion(video_camera) : video_camera;
  GLint most_samples = 0;
  glGetIntegerv(GL_MAX_SAMPLES, &most_samples);
  const int samples =
      options.msaa.value_or(multisampling_for(context.info().software, most_samples));
  PENUMBRA_TRY(auto framebuffer, Framebuffer::create(camera.width(), camera.height(), samples));
  PENUMBRA_TRY(const auto abilities, probe_picture(context.info().api));
  PENUMBRA_TRY(auto objects, ObjectPass::create(context.info().api, *scene, camera));
  PENUMBRA_TRY(auto receivers, Receivers::create(context.info().api, *scene, camera));
  PENUMBRA_TRY(auto shadows,
               ShadowPass::create(context.info().api, *scene, camera, framebuffer.samples()));
  PENUMBRA_TRY(auto hard, HardPass::create(context.info().api, *scene, camera));
  PENUMBRA_TRY(auto volumes, VolumePass::create(context.info().api, camera));
  PENUMBRA_TRY(auto rays, RayPass::create(context.info().api, camera));
  const bool on_gpu = !context.info().software;
  auto timer = options.gpu_time.value_or(on_gpu) ? GpuTimer::create(context.info().api)
                                                 : std::optional<GpuTimer>();
  auto impl = std::make_unique<Impl>(
      context, std::move(scene), camera, std::move(framebuffer), abilities, std::move(objects),
      std::move(receivers), std::move(shadows), std::move(hard), std::move(volumes),
      std::move(rays), options.pixel_buffers.value_or(on_gpu), std::move(timer));
  if (rectified) impl->rectified.emplace(context.info().api, video_camera);
  // Models, textures and programs are there now, or they are not.
  if (const auto error = noted_gl_error(context.info()))
    return fail("{}: {}", impl->scene->file, gl_error_text(*error));
  return Compositor(std::move(impl));
}

Result<CompositeStats> Compositor::draw(const Frame& frame, const FramePlan& plan) {
  Impl& m = *impl_;
  if (frame.empty() || frame.width != m.width || frame.height != m.height) {
    return fail(
        "frame {} is {} x {} px, the camera model's {} x {}; give the camera model that "
        "belongs to the video",
        frame.sequence, frame.width, frame.height, m.width, m.height);
  }
  m.stats = {};
  const Translucency way = choose_translucency(plan.translucency, m.abilities);
  PENUMBRA_TRY_VOID(m.choose(way, frame.format, plan));
  const Stopwatch shadow_clock;
  ShadowWork work;
  m.shadows.prepare(*m.scene, plan, work);
  m.hard_shadows.prepare(*m.scene, plan, work);
  m.volumes.prepare(*m.scene, plan, work);
  if (m.gpu_timer) {
    m.gpu_timer->take(m.stats.gpu_ms);
    m.gpu_timer->begin();
  }
  const int received = m.received_shadows.prepare(*m.scene, plan, m.shadows, work);
  shadow_clock.add_to(m.stats.shadow_ms, m.stats.shadow_cpu_ms);

  const Stopwatch render_clock;
  m.framebuffer.bind();
  const VideoPass::Way came = m.video.upload(frame, plan.reuse);
  const bool buffered = came == VideoPass::Way::buffered;
  m.stats.video_copies = came == VideoPass::Way::copied || buffered ? 1 : 0;
  m.stats.video_imports = came == VideoPass::Way::imported ? 1 : 0;
  m.stats.pixel_buffer_uploads = buffered ? 1 : 0;
  if (came == VideoPass::Way::there)
    m.stats.kept.push_back({"video", "video: the frame is on the GPU already"});
  const auto count = [&m](int calls) {
    m.stats.passes_drawn += calls > 0 ? 1 : 0;
    m.stats.draw_calls += calls;
  };
  auto drawn = m.rectified ? m.rectified->draw(m.video, frame) : m.video.draw(frame);
  if (drawn) count(1);
  if (drawn && plan.has_pose) {
    glDepthMask(GL_TRUE);
    glStencilMask(0xFF);
    glClear(GL_DEPTH_BUFFER_BIT | GL_STENCIL_BUFFER_BIT);
    count(m.objects.draw_phantoms(*m.scene, plan, m.lens));
    count(m.objects.draw_objects(*m.scene, plan, m.lens, m.framebuffer));
    // A phantom under a plane is not what its pixels show. No pass of its own: what it marks is for
    // those behind it.
    m.stats.draw_calls += m.receivers.begin_frame(plan, m.lens, plan.volume_lights > 0);
    count(m.shadows.draw(plan, m.lens, m.receivers, m.video, frame, m.framebuffer));
    count(received + m.received_shadows.draw(*m.scene, plan, m.lens, m.objects, way, m.receivers,
                                             m.framebuffer));
    count(m.hard_shadows.draw(plan, m.lens, m.receivers, m.framebuffer));
    count(m.volumes.draw(*m.scene, plan, m.lens, m.objects, m.receivers, m.framebuffer));
    count(m.objects.draw_blended(plan, m.lens, m.framebuffer));
    count(m.rays.draw(*m.scene, plan, m.lens, m.framebuffer));
    m.framebuffer.invalidate_depth_stencil();
  }
  if (m.gpu_timer) m.gpu_timer->end();
  if (!drawn) return tl::unexpected(drawn.error());
  m.video.hold(frame);
  // A CPU rasteriser works in this process: waited for here, so that its time counts here and not
  // in the read-back.
  if (m.context.info().software) glFinish();
  render_clock.add_to(m.stats.render_ms, m.stats.render_cpu_ms);
  if (const auto error = noted_gl_error(m.context.info()))
    return fail("frame {}: {}", frame.sequence, gl_error_text(*error));

  m.stats.translucency = way;
  m.stats.passes_skipped = static_cast<std::int64_t>(plan.skipped.size() + work.skipped.size());
  m.stats.skipped = std::move(work.skipped);
  m.stats.kept.insert(m.stats.kept.end(), std::make_move_iterator(work.kept.begin()),
                      std::make_move_iterator(work.kept.end()));
  m.stats.shadow_vertices = work.vertices;
  m.stats.kernel_generations = work.kernel_generations;
  m.stats.reprojections = work.reprojections;
  m.stats.triples_recomputed = work.recomputed;
  m.stats.proxy_shadows = work.proxy_shadows;
  m.stats.proxy_checks = work.proxy_checks;
  m.stats.proxy_faces_saved = work.proxy_faces_saved;
  m.stats.layer_masks_drawn = work.layer_masks_drawn;
  m.stats.layer_masks_kept = work.layer_masks_kept;
  m.stats.mask_pieces_skipped = plan.has_pose ? m.shadows.mask_pieces_skipped() : 0;
  m.stats.masks_drawn = work.masks_drawn;
  m.stats.masks_kept = work.masks_kept;
  m.stats.faces_tested = work.faces_tested;
  m.stats.faces_twisted = work.faces_twisted;
  return m.stats;
}

Result<CompositeStats> Compositor::read_back(std::span<std::uint8_t> rgba) {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(rgba.size() == m.picture_bytes());
  const Stopwatch clock;
  m.framebuffer.read_rgba(rgba);
  return m.read(clock);
}

bool Compositor::pixel_buffers() const {
  return impl_->pixel_buffers;
}

Result<CompositeStats> Compositor::ask_for_picture() {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(m.pixel_buffers);
  const Stopwatch clock;
  m.pictures.ask(m.framebuffer, m.picture_bytes());
  ++m.stats.pixel_buffer_read_backs;
  auto stats = m.read(clock);
  if (!stats) m.pictures.drop_last();
  return stats;
}

std::size_t Compositor::pictures_asked_for() const {
  return impl_->pictures.asked();
}

Result<CompositeStats> Compositor::take_picture(std::span<std::uint8_t> rgba) {
  Impl& m = *impl_;
  PENUMBRA_ASSERT(rgba.size() == m.picture_bytes());
  const Stopwatch clock;
  const auto taken = m.pictures.take(rgba);
  auto stats = m.read(clock);  // what the driver says of itself comes first
  if (!stats || !taken) m.pictures.drop_all();
  if (stats && !taken) return tl::unexpected(taken.error());
  return stats;
}

std::vector<double> Compositor::take_gpu_times() {
  std::vector<double> times_ms;
  if (impl_->gpu_timer) impl_->gpu_timer->take(times_ms);
  return times_ms;
}

const PictureAbilities& Compositor::abilities() const {
  return impl_->abilities;
}

void Compositor::set_abilities(const PictureAbilities& abilities) {
  impl_->abilities = abilities;
}

std::vector<CasterKernels> Compositor::kernels_in_use() const {
  return impl_->shadows.kernels_in_use();
}

int Compositor::samples() const {
  return impl_->framebuffer.samples();
}

void Compositor::clear() {
  impl_->framebuffer.clear();
  if (impl_->gpu_timer) impl_->gpu_timer->forget();
}

void Compositor::present() {
  impl_->framebuffer.present(impl_->context.window_size());
}

}  // namespace penumbra
