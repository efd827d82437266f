// State of one participant's trials: shown objects, effects of the pointer, and answers. Uses
// neither a window nor a clock; the caller passes the times.
#pragma once

#include <cstdint>
#include <vector>

#include "app/session/scene_edit.hpp"
#include "app/study/study_plan.hpp"
#include "app/study/study_results.hpp"
#include "app/window/manipulation.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

inline constexpr const char* kStudyBall = "ball";
inline constexpr const char* kStudyTarget = "target";
[[nodiscard]] std::string study_sphere(int index);  // index 0 gives "sphere 1"

// The scene has the table, two walls at the far edges of the workspace, a lamp above the middle,
// and one shadow node, "shadows", which every technique can draw. The layers' constants are for a
// workspace up to the highest sphere.
[[nodiscard]] Scene study_scene(StudyExperiment experiment);

class StudyTask {
 public:
  // Starts at this trial of the plan. After the last trial, the task is finished.
  StudyTask(StudyPlan plan, std::size_t first_trial);

  [[nodiscard]] const StudyPlan& plan() const { return plan_; }
  [[nodiscard]] bool finished() const { return trial_index_ >= plan_.trials.size(); }
  // The current trial; must not be called when finished.
  [[nodiscard]] const StudyTrial& trial() const { return plan_.trials[trial_index_]; }
  [[nodiscard]] const StudySample& sample() const {
    return plan_.samples[static_cast<std::size_t>(trial().sample)];
  }
  [[nodiscard]] bool shown() const { return shown_; }
  [[nodiscard]] std::int64_t shown_ns() const { return shown_ns_; }

  // Returns the edits that set up the scene for the current trial.
  [[nodiscard]] std::vector<SceneEdit> set_up(const Scene& scene) const;
  // Marks the trial as shown and starts its clock.
  void show(std::int64_t time_ns);
  void count_frame(bool has_pose);

  // Effects of an action of the participant. Actions have no effect while no trial is shown.
  struct Outcome {
    std::vector<SceneEdit> edits;
    std::vector<StudyRow> rows;  // rows of the trial, set when it is over
    bool over = false;           // the trial is over; the next one is now the current trial
  };
  // `scene` must have all edits so far. `lift`: drags up and sideways instead of along the table.
  [[nodiscard]] Outcome press(const Scene& scene, const PointerView& pointer, bool lift,
                              std::int64_t time_ns);
  [[nodiscard]] Outcome move(const PointerView& pointer);
  [[nodiscard]] Outcome release(std::int64_t time_ns);
  // Ends the step with the ball's current position, whether it is on its target or not.
  [[nodiscard]] Outcome accept(std::int64_t time_ns);
  [[nodiscard]] bool holding() const { return manipulator_.holding(); }

 private:
  [[nodiscard]] const Eigen::Vector3d& target() const { return sample().places[step_]; }
  void answer_step(std::int64_t time_ns, Outcome& outcome);
  void close_trial(Outcome& outcome);
  [[nodiscard]] StudyRow row() const;

  StudyPlan plan_;
  std::size_t trial_index_ = 0;
  bool shown_ = false;
  std::int64_t shown_ns_ = 0;
  std::int64_t step_ns_ = 0;  // start time of the current step
  std::size_t step_ = 1;      // index of the current target in a drag, from 1
  int misses_ = 0, frames_ = 0, frames_lost_ = 0;
  Eigen::Vector3d ball_ = Eigen::Vector3d::Zero();
  Manipulator manipulator_;
  std::vector<StudyRow> rows_;  // rows of the current trial
};

// Returns the scene's current state, including edits that are not drawn yet. The target of a drag
// is excluded, so that it can't be picked.
[[nodiscard]] SceneState pickable_state(const Scene& scene);

}  // namespace penumbra
