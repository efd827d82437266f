// One frame, all the way: track -> plan -> composite. Live and replay both call this and nothing
// else.
#pragma once

#include <cstdint>
#include <memory>
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
  std::int64_t scene_start_ns = 0;  // the frames' clock at which the scene's time is 0
};

struct SessionFrame {
  TrackedFrame tracked;
  FramePlan plan;
  CompositeStats composite;
  StageTime plan_time;
  bool read_back = false;
};

class Session {
 public:
  // `context` is current on this thread and outlives the session.
  [[nodiscard]] static Result<Session> create(GlContext& context,
                                              std::shared_ptr<const Scene> scene,
                                              const CameraModel& camera, PoseSource poses,
                                              const SessionOptions& options);

  // `rgba`, if not empty, receives the picture: RGBA8, width * height * 4 bytes.
  [[nodiscard]] Result<SessionFrame> step(const Frame& frame, std::span<std::uint8_t> rgba = {});
  // Draws the last picture into the context's window.
  void present() { compositor_.present(); }

 private:
  Session(std::shared_ptr<const Scene> scene, const CameraModel& camera, PoseSource poses,
          const SessionOptions& options, Compositor compositor);
  [[nodiscard]] TrackedFrame track(const Frame& frame);

  std::shared_ptr<const Scene> scene_;
  CameraModel camera_;
  PoseSource poses_;
  SessionOptions options_;
  Compositor compositor_;
};

}  // namespace penumbra
