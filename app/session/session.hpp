// One frame, all the way: track -> plan -> composite. Live and replay both call this and nothing
// else; live tracks the next frame on another thread meanwhile.
#pragma once

#include <cstdint>
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

// Poses that are given: of the camera, and of groups of tags on the table (T_table_group). A frame
// with no pose within 1 ms is lost; a group that none are given of stands where the tag map has it.
struct GivenPoses {
  Trajectory camera;
  std::map<std::string, Trajectory> groups;
};
// Where poses come from.
using PoseSource = std::variant<GroupTracker, GivenPoses>;

struct SessionOptions {
  PlanOptions plan;
  bool smooth = false;  // the pose that is drawn
  // The frames' clock at which the scene's time is 0; nothing: the first frame that is drawn.
  std::optional<std::int64_t> scene_start_ns;
  bool rectified = false;  // the picture without the lens's distortion
  // As CompositorOptions'.
  std::optional<int> msaa;
  std::optional<bool> pixel_buffers;
  // Virtual objects are lit as the video is; else as the scene says.
  bool video_light = false;
  // As a recorded session had it, in order of time; where there is none it is measured.
  std::vector<LitFrame> recorded_light;
};

// When a picture that is wanted is read back: as soon as it is drawn, or while the next one is.
enum class PictureTime { now, later };

struct SessionFrame {
  TrackedFrame tracked;  // with the pose as it was measured
  // What was drawn in place of the measured pose; nothing where that was drawn itself.
  std::optional<SmoothedPose> smoothed;
  FramePlan plan;
  std::vector<ShadowEvent> events;        // since the frame before that had a pose
  std::optional<VideoLight> video_light;  // that it is drawn in
  CompositeStats composite;
  StageTime light_time;  // measuring the video's light
  StageTime plan_time;
  StageTime draw_time;  // plan, shadows, rendering and read-back together
  // A picture was read back: this one, or (later) the one before it.
  bool read_back = false;
  PictureTime picture = PictureTime::now;
  std::vector<SceneEdit> edits;  // made since the frame before: in effect from this one on
};

// What the last picture shows.
struct SessionView {
  const Scene* scene = nullptr;       // with what was edited
  const SceneState* state = nullptr;  // nullptr before the first picture
  const CameraModel* camera = nullptr;
  std::optional<CameraPose> T_table_camera;  // as it was drawn with
};

class Session {
 public:
  // `context` is current on this thread and outlives the session.
  [[nodiscard]] static Result<Session> create(GlContext& context,
                                              std::shared_ptr<const Scene> scene,
                                              const CameraModel& camera, PoseSource poses,
                                              const SessionOptions& options);

  // Draws a made-up frame of this format, so that the first real one does not wait for the driver
  // to compile its shaders.
  [[nodiscard]] Result<void> warm_up(PixelFormat format);
  // The two halves of a step. Frames are tracked in order, by one thread at a time, which need not
  // be the one that draws: neither touches what the other does.
  [[nodiscard]] TrackedFrame track(const Frame& frame);
  // `rgba`, if not empty, receives the picture: RGBA8, width * height * 4 bytes. `later`, where
  // pixel buffers are used: it receives the picture of the call before, if that was such a call,
  // and this one is for the next call or take_picture().
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, std::span<std::uint8_t> rgba = {},
                                          PictureTime picture = PictureTime::now);
  // The picture that draw() left for later; waits until it is drawn. How long it took to read back.
  // `rgba` is made as large as it needs to be. Fails where there is none.
  [[nodiscard]] Result<StageTime> take_picture(std::vector<std::uint8_t>& rgba);
  [[nodiscard]] Result<SessionFrame> step(const Frame& frame, std::span<std::uint8_t> rgba = {}) {
    return draw(track(frame), rgba);
  }
  // Draws a frame that was drawn before, in the scene as it is now: a picture that stands still.
  [[nodiscard]] Result<SessionFrame> redraw(TrackedFrame tracked);
  // Draws the last picture into the context's window.
  void present() { compositor_.present(); }
  // The last picture: RGBA8, width * height * 4 bytes.
  [[nodiscard]] Result<void> read_back(std::span<std::uint8_t> rgba);

  // Changes the scene from the next picture on; only shadows that depend on it are computed again.
  // False where the scene has nothing of that name.
  bool edit(const SceneEdit& edit);
  // The same, as something that a recording says: not among the edits of a SessionFrame.
  bool replay_edit(const SceneEdit& edit) { return apply(scene_, edit); }
  // The last edit of everything that was edited: what leads from the scene as loaded to the present
  // one, for a recording that begins now.
  [[nodiscard]] const std::vector<SceneEdit>& edits_so_far() const { return edits_so_far_; }
  // The frames' clock at which the scene's time is 0; nothing before the first frame.
  [[nodiscard]] std::optional<std::int64_t> scene_start_ns() const {
    return options_.scene_start_ns;
  }
  // How what is translucent is drawn from the next picture on. A matter of the display and not of
  // the scene: no edit.
  void set_translucency(Translucency way) { options_.plan.translucency = way; }
  [[nodiscard]] Translucency translucency() const { return options_.plan.translucency; }
  // Whether the pose that is drawn is smoothed, from the next picture on.
  void set_smooth(bool smooth) { options_.smooth = smooth; }
  [[nodiscard]] bool smooth() const { return options_.smooth; }
  [[nodiscard]] SessionView view() const;
  // Of the picture: of a rectified one without distortion.
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  // How the node is drawn, by the options or by the scene.
  [[nodiscard]] ShadowStyle style_in_effect(const ShadowNode& node) const;
  // As Compositor's.
  [[nodiscard]] int samples() const { return compositor_.samples(); }
  [[nodiscard]] bool pixel_buffers() const { return compositor_.pixel_buffers(); }
  [[nodiscard]] std::vector<double> take_gpu_times() { return compositor_.take_gpu_times(); }
  // Of the last picture, for a debug view.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const {
    return compositor_.kernels_in_use();
  }

 private:
  Session(const Scene& scene, const CameraModel& camera, PoseSource poses,
          const SessionOptions& options, Compositor compositor);

  [[nodiscard]] Result<SessionFrame> compose(TrackedFrame tracked, std::span<std::uint8_t> rgba,
                                             PictureTime picture);
  // Of the picture that was drawn last.
  [[nodiscard]] Result<void> read_picture(std::span<std::uint8_t> rgba, SessionFrame& drawn);

  Scene scene_;  // models are shared with the compositor's
  CameraModel camera_;
  std::vector<std::string> tied_;  // groups of tags that something in the scene moves with
  PoseSource poses_;
  SessionOptions options_;
  PoseSmoother smoother_;
  LightMeter light_meter_;
  Compositor compositor_;
  std::vector<SceneEdit> edits_;  // since the last frame
  std::vector<SceneEdit> edits_so_far_;
  std::set<SkippedPass> warned_;  // of what would be logged in every frame
  std::optional<SceneState> state_;
  std::optional<SceneState> state_with_pose_;  // the last that was drawn
  std::optional<CameraPose> drawn_pose_;
};

}  // namespace penumbra
