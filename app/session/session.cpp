#include "app/session/session.hpp"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <limits>
#include <utility>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/passes/rectified_video.hpp"
#include "render/scene/scene_writer.hpp"

namespace penumbra {
namespace {

// Looks up the given poses of the camera and the groups at a frame's time.
TrackedFrame look_up(const GivenPoses& given_poses, const std::vector<std::string>& groups,
                     const Frame& frame) {
  const Stopwatch watch;
  TrackedFrame tracked;
  tracked.frame = frame;
  tracked.pose.ambiguity_ratio = std::numeric_limits<double>::infinity();
  if (const StampedPose* given = given_poses.camera.at(frame.timestamp_ns); given != nullptr) {
    tracked.pose.status = TrackStatus::tracked;
    tracked.pose.T_table_camera = given->T_table_camera;
  } else {
    tracked.pose.reason = {PoseCause::no_given_pose};
  }
  for (const std::string& name : groups) {
    GroupEstimate& group = tracked.groups.emplace_back();
    group.name = name;
    group.status = TrackStatus::tracked;
    const auto given = given_poses.groups.find(name);
    if (given == given_poses.groups.end()) continue;
    if (const StampedPose* pose = given->second.at(frame.timestamp_ns); pose != nullptr) {
      group.T_table_group = {pose->T_table_camera.rotation(), pose->T_table_camera.translation()};
    } else {
      group.status = TrackStatus::lost;
      group.reason = {PoseCause::no_given_place};
    }
  }
  const StageTime time = watch.elapsed();
  tracked.times.total_ms = time.wall_ms;
  tracked.times.total_cpu_ms = time.cpu_ms;
  return tracked;
}

// Part of the scene that an edit changes. A later edit of the same part replaces it.
enum class EditedPart { place, style, existence, visibility, view };
using EditSubject = std::pair<EditedPart, std::string>;
EditSubject subject_of(const ObjectPlaced& edit) {
  return {EditedPart::place, edit.object};
}
EditSubject subject_of(const ObjectReset& edit) {
  return {EditedPart::place, edit.object};
}
EditSubject subject_of(const ShadowStyled& edit) {
  return {EditedPart::style, edit.node};
}
EditSubject subject_of(const ObjectAdded& edit) {
  return {EditedPart::existence, edit.object};
}
EditSubject subject_of(const ObjectRemoved& edit) {
  return {EditedPart::visibility, edit.object};
}
EditSubject subject_of(const ViewChanged& /*edit*/) {
  return {EditedPart::view, {}};
}
EditSubject subject_of(const SceneEdit& edit) {
  return std::visit([](const auto& of_kind) { return subject_of(of_kind); }, edit);
}

CompositorOptions compositor_options(const SessionOptions& options) {
  return {
      .rectified = options.rectified, .msaa = options.msaa, .pixel_buffers = options.pixel_buffers};
}

}  // namespace

Session::Session(GlContext& context, std::shared_ptr<const Scene> scene, const CameraModel& camera,
                 PoseSource poses, const SessionOptions& options, Compositor compositor)
    : context_(&context),
      start_(std::move(scene)),
      scene_(*start_),
      video_camera_(camera),
      camera_(options.rectified ? without_distortion(camera) : camera),
      attached_groups_(tag_groups_of(scene_)),
      poses_(std::move(poses)),
      options_(options),
      smoother_(camera_),
      light_meter_(camera_.parameters().tone_curve),
      compositor_(std::move(compositor)) {}

Result<Session> Session::create(GlContext& context, std::shared_ptr<const Scene> scene,
                                const CameraModel& camera, PoseSource poses,
                                const SessionOptions& options) {
  PENUMBRA_TRY(auto compositor,
               Compositor::create(context, scene, camera, compositor_options(options)));
  return Session(context, std::move(scene), camera, std::move(poses), options,
                 std::move(compositor));
}

TrackedFrame Session::track(const Frame& frame) {
  if (auto* tracker = std::get_if<GroupTracker>(&poses_)) return tracker->track(frame);
  return look_up(std::get<GivenPoses>(poses_), attached_groups_, frame);
}

Result<void> Session::warm_up(PixelFormat format) {
  const FrameBuffer grey = allocate_frame(format, camera_.width(), camera_.height());
  constexpr int kMiddle = 128;
  for (int i = 0; i < grey.frame.plane_count; ++i) {
    const auto plane = static_cast<std::size_t>(i);
    const PixelPlane& view = grey.frame.planes[plane];
    std::memset(grey.plane_data[plane], kMiddle,
                static_cast<std::size_t>(view.stride) * static_cast<std::size_t>(view.height));
  }
  // The camera looks straight down at the table's middle.
  constexpr double kHeight_m = 0.6;
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  const Eigen::Quaterniond half_turn_about_x(0.0, 1.0, 0.0, 0.0);
  pose.T_table_camera = CameraPose(half_turn_about_x, Eigen::Vector3d(0.0, 0.0, kHeight_m));
  const SceneState state = evaluate_scene(scene_, 0.0);
  const FramePlan plan = plan_frame(scene_, state, pose, camera_, options_.plan);
  for (Compositor* compositor : {&compositor_, display()}) {
    if (compositor == nullptr) continue;
    PENUMBRA_TRY_VOID(compositor->draw(grey.frame, plan));
    compositor->clear();  // the grey frame is never shown
  }
  return {};
}

Result<SessionFrame> Session::draw(TrackedFrame tracked, std::span<std::uint8_t> rgba,
                                   ReadBackTime read_back_time) {
  auto result = compose(std::move(tracked), rgba, read_back_time);
  if (result) result->edits = std::exchange(edits_, {});
  return result;
}

Result<SessionFrame> Session::redraw(TrackedFrame tracked) {
  return compose(std::move(tracked), {}, ReadBackTime::now);
}

Result<SessionFrame> Session::compose(TrackedFrame tracked, std::span<std::uint8_t> rgba,
                                      ReadBackTime read_back_time) {
  SessionFrame result;
  result.tracked = std::move(tracked);
  const Frame& frame = result.tracked.frame;
  if (!options_.scene_start_ns) options_.scene_start_ns = frame.timestamp_ns;

  const Stopwatch plan_watch;
  SceneState state = evaluate_scene(scene_, seconds(frame.timestamp_ns - *options_.scene_start_ns),
                                    result.tracked.groups);
  if (options_.video_light) {
    const Stopwatch light_watch;
    const VideoLight* recorded = light_at(options_.recorded_light, frame.timestamp_ns);
    state.video_light = recorded != nullptr ? *recorded : light_meter_.measure(frame);
    result.video_light = state.video_light;
    result.light_time = light_watch.elapsed();
  }
  PoseEstimate drawn_pose = result.tracked.pose;
  if (options_.smooth && drawn_pose.has_pose()) {
    result.smoothed = smoother_.smooth(frame.timestamp_ns, drawn_pose.T_table_camera);
    drawn_pose.T_table_camera = result.smoothed->T_table_camera;
  } else {
    smoother_.reset();
  }
  result.plan = plan_frame(scene_, state, drawn_pose, camera_, options_.plan);
  if (result.plan.has_pose) {
    if (state_with_pose_) result.events = shadow_events(*state_with_pose_, state);
    state_with_pose_ = state;
  }
  for (const SkippedPass& skipped : result.plan.skipped) {
    if (skipped.reason == SkipReason::no_light && warned_.insert(skipped).second) {
      log_warning("{}: no shadow: {}", scene_.file, text_of(skipped, scene_));
    }
    if (skipped.reason == SkipReason::shape_missing && warned_.insert(skipped).second)
      log_warning("{}: {}", scene_.file, text_of(skipped, scene_));
  }
  state_ = std::move(state);
  result.plan_time = plan_watch.elapsed();
  drawn_pose_.reset();
  if (result.plan.has_pose) drawn_pose_ = result.plan.T_table_camera;

  PENUMBRA_TRY(auto drawn, draw_plan(frame, result.plan, !rgba.empty()));
  for (const SkippedPass& skipped : drawn.skipped) {
    result.plan.skipped.push_back(skipped);
    if (skipped.reason == SkipReason::light_inside_caster && warned_.insert(skipped).second) {
      log_warning("{}: no shadow of a volume: {}", scene_.file, text_of(skipped, scene_));
    }
  }
  result.composite = std::move(drawn);
  if (!rgba.empty()) {
    result.when_read_back = compositor_.pixel_buffers() ? read_back_time : ReadBackTime::now;
    PENUMBRA_TRY_VOID(read_back_image(rgba, result));
  }
  result.draw_time = plan_watch.elapsed();
  return result;
}

Result<void> Session::read_back_image(std::span<std::uint8_t> rgba, SessionFrame& drawn) {
  const bool later = drawn.when_read_back == ReadBackTime::later;
  const bool has_earlier = compositor_.pending_images() > 0 || !early_image_.empty();
  auto read = later ? compositor_.request_image() : compositor_.read_back(rgba);
  if (read && later && !early_image_.empty()) {
    std::ranges::copy(std::exchange(early_image_, {}), rgba.begin());
  } else if (read && later && has_earlier) {
    read = compositor_.take_image(rgba);
  }
  if (!read) return tl::unexpected(read.error());
  drawn.read_back = !later || has_earlier;
  drawn.composite.readback_ms = read->readback_ms;
  drawn.composite.readback_cpu_ms = read->readback_cpu_ms;
  drawn.composite[Counter::pixel_buffer_read_backs] = (*read)[Counter::pixel_buffer_read_backs];
  return {};
}

Result<StageTime> Session::take_image(std::vector<std::uint8_t>& rgba) {
  if (!early_image_.empty()) {
    rgba = std::exchange(early_image_, {});
    return StageTime();
  }
  rgba.resize(std::size_t{4} * static_cast<std::size_t>(camera_.width()) *
              static_cast<std::size_t>(camera_.height()));
  if (compositor_.pending_images() == 0) return fail("a rendered image was lost");
  const Stopwatch watch;
  PENUMBRA_TRY_VOID(compositor_.take_image(rgba));
  return watch.elapsed();
}

Result<void> Session::read_back(std::span<std::uint8_t> rgba) {
  PENUMBRA_TRY_VOID(shown().read_back(rgba));
  return {};
}

std::vector<double> Session::take_gpu_times() {
  std::vector<double> times = compositor_.take_gpu_times();
  if (display_) std::ranges::copy(display_->take_gpu_times(), std::back_inserter(times));
  return times;
}

Result<CompositeStats> Session::draw_plan(const Frame& frame, const FramePlan& plan,
                                          bool at_video_size) {
  std::optional<CompositeStats> for_window;
  if (Compositor* const at_display = display()) {
    auto drawn = at_display->draw(frame, plan);
    if (drawn) {
      for_window = std::move(*drawn);
    } else {
      note_display_failure(drawn.error());
    }
  }
  shows_display_ = for_window.has_value();
  if (for_window && !at_video_size) return std::move(*for_window);
  auto drawn = compositor_.draw(frame, plan);
  if (drawn && for_window) {
    drawn->shadow_ms += for_window->shadow_ms;
    drawn->shadow_cpu_ms += for_window->shadow_cpu_ms;
    drawn->render_ms += for_window->render_ms;
    drawn->render_cpu_ms += for_window->render_cpu_ms;
  }
  return drawn;
}

void Session::note_display_failure(const Error& error) {
  log_warning("the window shows the video's resolution: {}", error.message);
  failed_size_ = wanted_size_;
  display_.reset();
}

Compositor* Session::display() {
  if (!options_.at_window_size) return nullptr;
  constexpr double kSettled_ms = 250.0;  // while a window is resized, its image is scaled
  const ImageArea area = image_area(camera_.width(), camera_.height(), context_->window_size());
  const ImageSize size{area.width, area.height};
  const bool resized = size != wanted_size_;
  if (resized) since_resize_.restart();
  wanted_size_ = size;
  if (size.width <= camera_.width() || size.height <= camera_.height()) {
    display_.reset();
    shows_display_ = false;
    return nullptr;
  }
  const bool keeps = display_ && (display_->size() == size || resized ||
                                  since_resize_.elapsed().wall_ms < kSettled_ms);
  if (keeps) return &*display_;
  display_.reset();
  shows_display_ = false;
  if (size == failed_size_) return nullptr;
  CompositorOptions options = compositor_options(options_);
  options.size = size;
  auto made = Compositor::create(*context_, start_, video_camera_, options);
  if (!made) {
    note_display_failure(made.error());
    return nullptr;
  }
  return &display_.emplace(std::move(*made));
}

bool Session::edit(const SceneEdit& edit) {
  if (std::holds_alternative<ShadowStyled>(edit) &&
      (options_.plan.technique || options_.plan.kernels || options_.plan.light_rays)) {
    // Copies the options into each node's style, so that single nodes can be edited.
    for (ShadowNode& node : scene_.shadows) {
      static_cast<ShadowStyle&>(node) = style_in_effect(node);
    }
    options_.plan.light_rays = false;
    options_.plan.technique.reset();
    options_.plan.kernels.reset();
  }
  if (const auto* view = std::get_if<ViewChanged>(&edit)) set_view(*view);
  if (!apply_edit(edit)) return false;
  keep_latest(edit);
  edits_.push_back(edit);
  return true;
}

bool Session::replay_edit(const SceneEdit& edit) {
  if (const auto* view = std::get_if<ViewChanged>(&edit)) {
    const ChosenView& chosen = options_.chosen_view;
    ViewChanged changed = drawn_view();
    if (!chosen.translucency) changed.translucency = view->translucency;
    if (!chosen.walls) changed.walls = view->walls;
    if (!chosen.smooth) changed.smooth = view->smooth;
    set_view(changed);
  }
  if (!apply_edit(edit)) return false;
  keep_latest(edit);
  return true;
}

void Session::set_view(const ViewChanged& view) {
  options_.plan.translucency = view.translucency;
  options_.plan.walls = view.walls;
  options_.smooth = view.smooth;
}

void Session::keep_latest(const SceneEdit& edit) {
  std::erase_if(latest_edits_,
                [&](const SceneEdit& earlier) { return subject_of(earlier) == subject_of(edit); });
  latest_edits_.push_back(edit);
}

bool Session::apply_edit(const SceneEdit& edit) {
  const bool needs_start =
      std::holds_alternative<ObjectAdded>(edit) || std::holds_alternative<ObjectReset>(edit);
  if (!needs_start) return apply(scene_, edit);
  Scene start = *start_;
  Scene scene = scene_;
  if (!apply(scene, edit, &start)) return false;
  auto shared = std::make_shared<const Scene>(std::move(start));
  if (shared->objects.size() > start_->objects.size()) {
    if (const auto added = add_to_compositor(shared); !added) {
      log_warning("{}: can't be drawn: {}", std::get<ObjectAdded>(edit).model_file,
                  added.error().message);
      return false;
    }
  }
  start_ = std::move(shared);
  scene_ = std::move(scene);
  return true;
}

// Makes the compositor again, because it uploads all models when it is created.
Result<void> Session::add_to_compositor(std::shared_ptr<const Scene> start) {
  PENUMBRA_TRY(auto compositor, Compositor::create(*context_, std::move(start), video_camera_,
                                                   compositor_options(options_)));
  if (compositor_.pending_images() > 0) {
    std::vector<std::uint8_t> image;
    PENUMBRA_TRY_VOID(take_image(image));
    early_image_ = std::move(image);
  }
  compositor_ = std::move(compositor);
  display_.reset();  // made again for the next image
  shows_display_ = false;
  // These have one entry per object.
  state_.reset();
  state_with_pose_.reset();
  return {};
}

SceneEdit Session::place_of(const std::string& object) const {
  const auto latest = std::ranges::find_if(latest_edits_, [&object](const SceneEdit& edit) {
    return subject_of(edit) == EditSubject(EditedPart::place, object);
  });
  if (latest == latest_edits_.end()) return ObjectReset{object};
  return *latest;
}

Result<std::string> Session::scene_text(const std::filesystem::path& folder) const {
  return penumbra::scene_text(
      {scene_, *start_, [this](const ShadowNode& node) { return style_in_effect(node); },
       options_.plan.light_mode},
      folder);
}

SessionView Session::view() const {
  return {&scene_, state_ ? &*state_ : nullptr, &camera_, drawn_pose_};
}

ShadowStyle Session::style_in_effect(const ShadowNode& node) const {
  ShadowStyle style = node;
  style.technique = options_.plan.technique.value_or(node.technique);
  style.kernels = options_.plan.kernels.value_or(node.kernels);
  style.light_rays = options_.plan.light_rays || node.light_rays;
  return style;
}

}  // namespace penumbra
