// Processes one frame: track -> plan -> composite. Used by live and replay. The next frame can be
// tracked on another thread at the same time.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "app/session/pose_smoother.hpp"
#include "app/session/scene_edit.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/stopwatch.hpp"
#include "render/compositor.hpp"
#include "render/frame_plan.hpp"
#include "render/scene/light_meter.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/shadow_events.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {

// Given poses of the camera and of tag groups on the table (T_table_group). A frame is lost if no
// pose is within 1 ms of it. A group without poses has the pose of the tag map.
struct GivenPoses {
  Trajectory camera;
  std::map<std::string, Trajectory> groups;
};
using PoseSource = std::variant<GroupTracker, GivenPoses>;

// View settings that options of replay chose; recorded changes (ViewChanged) leave them as they
// are.
struct ChosenView {
  bool translucency = false, walls = false, smooth = false;
};

struct SessionOptions {
  PlanOptions plan;
  ChosenView chosen_view;
  bool smooth = false;  // smooths the drawn pose
  // Draws images for a window that is larger than the video at the window's resolution.
  bool at_window_size = true;
  // Timestamp at which the scene's time is 0; default: that of the first drawn frame.
  std::optional<std::int64_t> scene_start_ns;
  bool rectified = false;             // removes the lens distortion from the drawn images
  std::optional<int> msaa;            // as in CompositorOptions
  std::optional<bool> pixel_buffers;  // as in CompositorOptions
  bool video_light = false;  // light of virtual objects: the video's instead of the scene file's
  std::vector<LitFrame> recorded_light;  // in order of time; if empty, the light is measured
};

// When an image is read back: immediately, or while the next one is drawn.
enum class ReadBackTime { now, later };

struct SessionFrame {
  TrackedFrame tracked;                  // contains the measured pose
  std::optional<SmoothedPose> smoothed;  // drawn pose; nullopt: the measured pose is drawn
  FramePlan plan;
  std::vector<ShadowEvent> events;        // since the previous frame with a pose
  std::optional<VideoLight> video_light;  // light of the virtual objects
  CompositeStats composite;
  StageTime light_time;    // measuring the video's light
  StageTime plan_time;     // includes light_time
  StageTime draw_time;     // total of plan, shadows, rendering and read-back
  bool read_back = false;  // an image was read back
  ReadBackTime when_read_back = ReadBackTime::now;  // `later`: that image is the previous one
  std::vector<SceneEdit> edits;  // edits since the previous frame, in effect from this one on
};

// The content of the latest image.
struct SessionView {
  const Scene* scene = nullptr;       // includes all edits
  const SceneState* state = nullptr;  // nullptr before the first image
  const CameraModel* camera = nullptr;
  std::optional<CameraPose> T_table_camera;  // drawn pose
};

class Session {
 public:
  // `context` must be current on this thread and outlive the session.
  [[nodiscard]] static Result<Session> create(GlContext& context,
                                              std::shared_ptr<const Scene> scene,
                                              const CameraModel& camera, PoseSource poses,
                                              const SessionOptions& options);

  // Draws a grey frame of this format, to compile the shaders before the first real frame.
  [[nodiscard]] Result<void> warm_up(PixelFormat format);
  // Call this for frames in order, by one thread at a time. Another thread may draw meanwhile.
  [[nodiscard]] TrackedFrame track(const Frame& frame);
  // See GroupTracker::set_map(). Call this on the thread that tracks. The session must have a
  // tracker.
  [[nodiscard]] Result<void> set_map(const CameraModel& camera, const TagMap& tags) {
    return std::get<GroupTracker>(poses_).set_map(camera, tags);
  }
  // See GroupTracker::set_map_sigma(); as set_map().
  void set_map_sigma(double sigma_m) { std::get<GroupTracker>(poses_).set_map_sigma(sigma_m); }
  // Draws a frame. `rgba`, if not empty, receives the image: RGBA8, width * height * 4 bytes. With
  // `later` and pixel buffers, `rgba` receives the image of the previous call with `later`. The
  // image of this call is received by the next such call or by take_image().
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, std::span<std::uint8_t> rgba = {},
                                          ReadBackTime read_back_time = ReadBackTime::now);
  // Reads the pending image of draw(..., later) into `rgba`, which is resized. Returns the time
  // that this took. Fails if no image is pending.
  [[nodiscard]] Result<StageTime> take_image(std::vector<std::uint8_t>& rgba);
  // Draws a frame again with the current scene.
  [[nodiscard]] Result<SessionFrame> redraw(TrackedFrame tracked);
  // Draws the latest image into the context's window. In a window that is larger than the video,
  // the image has the window's resolution.
  void present() { shown().present(); }
  // Reads the image that present() shows: RGBA8, width * height * 4 bytes of shown_size().
  [[nodiscard]] Result<void> read_back(std::span<std::uint8_t> rgba);
  [[nodiscard]] ImageSize shown_size() const { return shown().size(); }

  // Edits the scene from the next image on. Returns false if the scene has no such object or node,
  // or if OpenGL can't draw an added object (logged).
  bool edit(const SceneEdit& edit);
  // Repeats a recorded edit, which is not added to SessionFrame::edits.
  bool replay_edit(const SceneEdit& edit);
  // Adds an object that the scene has since its start to the recorded edits.
  void record_added(const ObjectAdded& added) { latest_edits_.emplace_back(added); }
  // Latest edit of each edited object or node, and of the view, for a recording that starts now.
  [[nodiscard]] const std::vector<SceneEdit>& latest_edits() const { return latest_edits_; }
  // Returns the edit that restores the object's present place: its latest one or ObjectReset.
  [[nodiscard]] SceneEdit place_of(const std::string& object) const;
  // Returns the text of a scene file with the present arrangement (scene_text()).
  [[nodiscard]] Result<std::string> scene_text(const std::filesystem::path& folder) const;
  // Timestamp at which the scene's time is 0; nullopt before the first frame.
  [[nodiscard]] std::optional<std::int64_t> scene_start_ns() const {
    return options_.scene_start_ns;
  }
  // How the session draws; edit(ViewChanged) changes it from the next image on.
  [[nodiscard]] ViewChanged drawn_view() const {
    return {options_.plan.translucency, options_.plan.walls, options_.smooth};
  }
  [[nodiscard]] SessionView view() const;
  // Camera of the drawn image; without distortion if the image is rectified.
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  // Returns the node's style in the scene, with the session's options applied.
  [[nodiscard]] ShadowStyle style_in_effect(const ShadowNode& node) const;
  // See Compositor.
  [[nodiscard]] int samples() const { return compositor_.samples(); }
  [[nodiscard]] bool pixel_buffers() const { return compositor_.pixel_buffers(); }
  [[nodiscard]] std::vector<double> take_gpu_times();
  // Kernels of the latest image, for the debug view.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const {
    return shown().kernels_in_use();
  }

 private:
  Session(GlContext& context, std::shared_ptr<const Scene> scene, const CameraModel& camera,
          PoseSource poses, const SessionOptions& options, Compositor compositor);
  bool apply_edit(const SceneEdit& edit);
  void set_view(const ViewChanged& view);
  void keep_latest(const SceneEdit& edit);
  // Returns the compositor that draws at the window's resolution; nullptr if the window is not
  // larger than the video, or if there is none.
  [[nodiscard]] Compositor* display();
  void note_display_failure(const Error& error);
  // Draws at the window's resolution if there is a display(), and at the video's size if there is
  // none or `at_video_size`.
  [[nodiscard]] Result<CompositeStats> draw_plan(const Frame& frame, const FramePlan& plan,
                                                 bool at_video_size);
  [[nodiscard]] Compositor& shown() { return shows_display_ ? *display_ : compositor_; }
  [[nodiscard]] const Compositor& shown() const { return shows_display_ ? *display_ : compositor_; }
  [[nodiscard]] Result<void> add_to_compositor(std::shared_ptr<const Scene> start);

  [[nodiscard]] Result<SessionFrame> compose(TrackedFrame tracked, std::span<std::uint8_t> rgba,
                                             ReadBackTime read_back_time);
  [[nodiscard]] Result<void> read_back_image(std::span<std::uint8_t> rgba, SessionFrame& drawn);

  GlContext* context_;
  std::shared_ptr<const Scene> start_;  // the compositor's scene, without edits of placements
  Scene scene_;                         // shares its models with start_
  CameraModel video_camera_;
  CameraModel camera_;
  std::vector<std::string> attached_groups_;  // tag groups that scene objects are attached to
  PoseSource poses_;
  SessionOptions options_;
  PoseSmoother smoother_;
  LightMeter light_meter_;
  Compositor compositor_;              // draws images of the camera's size
  std::optional<Compositor> display_;  // draws images of the window's size
  bool shows_display_ = false;         // the latest image for the window is display_'s
  ImageSize wanted_size_;              // of display_: the window's latest size
  ImageSize failed_size_;              // OpenGL can't draw images of this size
  Stopwatch since_resize_;
  std::vector<std::uint8_t> early_image_;  // pending image of an earlier compositor; empty: none
  std::vector<SceneEdit> edits_;           // since the previous frame
  std::vector<SceneEdit> latest_edits_;
  std::set<SkippedPass> warned_;  // passes with a logged warning
  std::optional<SceneState> state_;
  std::optional<SceneState> state_with_pose_;  // state at the latest frame with a pose
  std::optional<CameraPose> drawn_pose_;
};

}  // namespace penumbra
