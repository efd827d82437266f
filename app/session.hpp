// One frame, all the way: track -> plan -> composite. Live and replay both call this and nothing
// else; live tracks the next frame on another thread meanwhile.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <variant>

#include "core/stopwatch.hpp"
#include "core/trajectory.hpp"
#include "render/compositor.hpp"
#include "render/frame_plan.hpp"
#include "render/scene.hpp"
#include "tracking/table_tracker.hpp"

namespace penumbra {

// Where poses come from: the tracker, or a trajectory that is given (a frame with no pose within
// 1 ms is lost).
using PoseSource = std::variant<TableTracker, Trajectory>;

struct SessionOptions {
  PlanOptions plan;
  // The frames' clock at which the scene's time is 0; nothing: the first frame that is drawn.
  std::optional<std::int64_t> scene_start_ns;
};

struct SessionFrame {
  TrackedFrame tracked;
  FramePlan plan;
  CompositeStats composite;
  StageTime plan_time;
  StageTime draw_time;  // plan, shadows, rendering and read-back together
  bool read_back = false;
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
  // `rgba`, if not empty, receives the picture: RGBA8, width * height * 4 bytes.
  [[nodiscard]] Result<SessionFrame> draw(TrackedFrame tracked, std::span<std::uint8_t> rgba = {});
  [[nodiscard]] Result<SessionFrame> step(const Frame& frame, std::span<std::uint8_t> rgba = {}) {
    return draw(track(frame), rgba);
  }
  // Draws the last picture into the context's window.
  void present() { compositor_.present(); }

 private:
  Session(std::shared_ptr<const Scene> scene, const CameraModel& camera, PoseSource poses,
          const SessionOptions& options, Compositor compositor);

  std::shared_ptr<const Scene> scene_;
  CameraModel camera_;
  PoseSource poses_;
  SessionOptions options_;
  Compositor compositor_;
};

}  // namespace penumbra
