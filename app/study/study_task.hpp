// One participant at work: what each trial shows, what a pointer does to it, and what was answered.
// Knows no window and no clock: whoever calls says when things happened.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "app/session/scene_edit.hpp"
#include "app/study/study_plan.hpp"
#include "app/study/study_results.hpp"
#include "app/window/manipulation.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

class StudyTask {
 public:
  // Begins with this trial of the plan, which may be behind the last one.
  StudyTask(StudyPlan plan, std::size_t first_trial);

  [[nodiscard]] const StudyPlan& plan() const { return plan_; }
  [[nodiscard]] bool finished() const { return at_ >= plan_.trials.size(); }
  // Of the present trial; not when finished.
  [[nodiscard]] const StudyTrial& trial() const { return plan_.trials[at_]; }
  [[nodiscard]] const StudySample& sample() const {
    return plan_.samples[static_cast<std::size_t>(trial().sample)];
  }
  // Whether the present trial is on the screen.
  [[nodiscard]] bool shown() const { return shown_; }
  [[nodiscard]] std::int64_t shown_ns() const { return shown_ns_; }

  // What sets the scene up for the present trial.
  [[nodiscard]] std::vector<SceneEdit> set_up(const Scene& scene) const;
  // The trial is on the screen from now on: its time runs.
  void show(std::int64_t time_ns);
  void count_frame(bool has_pose);

  // What a person does; ignored while no trial is shown. The scene is as edited so far.
  struct Outcome {
    std::vector<SceneEdit> edits;
    std::vector<StudyRow> rows;  // of the trial, once it is over
    bool over = false;           // the next trial is the present one
  };
  // `lift`: up and sideways rather than along the table.
  [[nodiscard]] Outcome press(const Scene& scene, const PointerView& pointer, bool lift,
                              std::int64_t time_ns);
  [[nodiscard]] Outcome move(const PointerView& pointer);
  [[nodiscard]] Outcome release(std::int64_t time_ns);
  // The ball is left where it is, on its target or not.
  [[nodiscard]] Outcome accept(std::int64_t time_ns);
  [[nodiscard]] bool holding() const { return hand_.holding(); }

 private:
  [[nodiscard]] const Eigen::Vector3d& target() const { return sample().places[step_]; }
  void answer_step(std::int64_t time_ns, Outcome& outcome);
  void close_trial(Outcome& outcome);
  [[nodiscard]] StudyRow row() const;

  StudyPlan plan_;
  std::size_t at_ = 0;
  bool shown_ = false;
  std::int64_t shown_ns_ = 0;
  std::int64_t step_ns_ = 0;  // when the present step began
  std::size_t step_ = 1;      // of a drag: which target, from 1
  int misses_ = 0, frames_ = 0, frames_lost_ = 0;
  Eigen::Vector3d ball_ = Eigen::Vector3d::Zero();
  Manipulator hand_;
  std::vector<StudyRow> rows_;  // of the present trial
};

// The scene's present state, ahead of the picture where something was edited since; the target of a
// drag can't be taken.
[[nodiscard]] SceneState takeable(const Scene& scene);

}  // namespace penumbra
