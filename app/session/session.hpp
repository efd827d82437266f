// Processes one frame: track -> plan -> composite. Live and replay share it; live tracks the next
// frame on another thread at the same time.
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

// Given poses of the camera and of groups of tags on the table (T_table_group). A frame with no
// pose within 1 ms is lost. A group without poses stands where the tag map has it.
struct GivenPoses {
  Trajectory camera;
  std::map<std::string, Trajectory> groups;
};
using PoseSource = std::variant<GroupTracker, GivenPoses>;

struct SessionOptions {
  PlanOptions plan;
  bool smooth = false;  // the drawn pose
  // Timestamp of the frame at which the scene's time is 0; default: the first drawn frame's.
  std::optional<std::int64_t> scene_start_ns;
  bool rectified = false;             // images without lens distortion
  std::optional<int> msaa;            // as in CompositorOptions
  std::optional<bool> pixel_buffers;  // as in CompositorOptions
  bool video_light = false;  // virtual objects are lit as the video is, not as the scene says
  std::vector<LitFrame> recorded_light;  // of a recorded session, in order of time; else measured
};

// When an image is read back: as soon as it is drawn, or while the next one is drawn.
enum class PictureTime { now, later };

struct SessionFrame {
  TrackedFrame tracked;                  // with the measured pose
  std::optional<SmoothedPose> smoothed;  // drawn in place of the measured pose
  FramePlan plan;
  std::vector<ShadowEvent> events;        // since the last frame that had a pose
  std::optional<VideoLight> video_light;  // that it is drawn in
  CompositeStats composite;
  StageTime light_time;  // measuring the video's light
  StageTime plan_time;
  StageTime draw_time;  // plan, shadows, rendering and read-back together
  // An image was read back: this one, or (later) the one before it.
  bool read_back = false;
  PictureTime picture = PictureTime::now;
  std::vector<SceneEdit> edits;  // made since the last frame, in effect from this one on
};

// The content of the last image.
struct SessionView {
  const Scene* scene = nullptr;       // with its edits
  const SceneState* state = nullptr;  // nullptr before the first image
  const CameraModel* camera = nullptr;
  std::optional<CameraPose> T_table_camera;  // as drawn
};

class Session {
 public:
  // `context` is current on this thread and outlives the session.
  [[nodiscard]] static Result<Session> create(GlContext& context,
                                              std::shared_ptr<const Scene> scene,
                                              const CameraModel& camera, PoseSource poses,
                                              const SessionOptions& options);

  // Draws a grey frame of this format, so that the driver compiles its shaders before the first
  // real frame.
  [[nodiscard]] Result<void> warm_up(PixelFormat format);
  // Tracks frames in order. One thread at a time calls it, which need not be the one that draws.
  [[nodiscard]] TrackedFrame track(const Frame& frame);
  // `rgba`, if not empty, receives the image: RGBA8, width * height * 4 bytes. With `later`, and if
  // pixel buffers are used, it receives the image of the last such call; this one is for the next
  // call or take_image().
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, std::span<std::uint8_t> rgba = {},
                                          PictureTime picture = PictureTime::now);
  // Reads the image that draw() left for later into `rgba`, which is resized. Returns the time it
  // took. Fails if there is none.
  [[nodiscard]] Result<StageTime> take_image(std::vector<std::uint8_t>& rgba);
  // Draws a frame again, in the scene as it is now.
  [[nodiscard]] Result<SessionFrame> redraw(TrackedFrame tracked);
  // Draws the last image into the context's window.
  void present() { compositor_.present(); }
  // Reads the last image: RGBA8, width * height * 4 bytes.
  [[nodiscard]] Result<void> read_back(std::span<std::uint8_t> rgba);

  // Edits the scene from the next image on. Returns false if the scene has nothing of that name.
  bool edit(const SceneEdit& edit);
  // Repeats a recorded edit: it is not among the edits of a SessionFrame.
  bool replay_edit(const SceneEdit& edit) { return apply(scene_, edit); }
  // The last edit of each edited thing, for a recording that begins now.
  [[nodiscard]] const std::vector<SceneEdit>& edits_so_far() const { return edits_so_far_; }
  // Timestamp at which the scene's time is 0; nothing before the first frame.
  [[nodiscard]] std::optional<std::int64_t> scene_start_ns() const {
    return options_.scene_start_ns;
  }
  // Translucency from the next image on. It depends on the display, so it is no edit.
  void set_translucency(Translucency mode) { options_.plan.translucency = mode; }
  [[nodiscard]] Translucency translucency() const { return options_.plan.translucency; }
  void set_smooth(bool smooth) { options_.smooth = smooth; }
  [[nodiscard]] bool smooth() const { return options_.smooth; }
  [[nodiscard]] SessionView view() const;
  // Camera of the image: without distortion if the image is rectified.
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  // The node's style by the options or the scene.
  [[nodiscard]] ShadowStyle style_in_effect(const ShadowNode& node) const;
  // As Compositor's.
  [[nodiscard]] int samples() const { return compositor_.samples(); }
  [[nodiscard]] bool pixel_buffers() const { return compositor_.pixel_buffers(); }
  [[nodiscard]] std::vector<double> take_gpu_times() { return compositor_.take_gpu_times(); }
  // Kernels of the last image, for the debug view.
  [[nodiscard]] std::vector<CasterKernels> kernels_in_use() const {
    return compositor_.kernels_in_use();
  }

 private:
  Session(const Scene& scene, const CameraModel& camera, PoseSource poses,
          const SessionOptions& options, Compositor compositor);

  [[nodiscard]] Result<SessionFrame> compose(TrackedFrame tracked, std::span<std::uint8_t> rgba,
                                             PictureTime picture);
  [[nodiscard]] Result<void> read_picture(std::span<std::uint8_t> rgba, SessionFrame& drawn);

  Scene scene_;  // shares its models with the compositor's
  CameraModel camera_;
  std::vector<std::string> tied_;  // groups of tags that objects of the scene move with
  PoseSource poses_;
  SessionOptions options_;
  PoseSmoother smoother_;
  LightMeter light_meter_;
  Compositor compositor_;
  std::vector<SceneEdit> edits_;  // since the last frame
  std::vector<SceneEdit> edits_so_far_;
  std::set<SkippedPass> warned_;  // each is logged once
  std::optional<SceneState> state_;
  std::optional<SceneState> state_with_pose_;  // of the last frame with a pose
  std::optional<CameraPose> drawn_pose_;
};

}  // namespace penumbra
