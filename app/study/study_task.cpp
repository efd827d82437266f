#include "app/study/study_task.hpp"

#include <array>
#include <utility>

#include "core/assert.hpp"

namespace penumbra {
namespace {

SceneEdit placed(std::string object, const Eigen::Vector3d& position) {
  ObjectPlaced edit;
  edit.object = std::move(object);
  edit.placement.position = position;
  return edit;
}

}  // namespace

SceneState pickable_state(const Scene& scene) {
  SceneState state = evaluate_scene(scene, 0.0);
  state.opacities.resize(scene.objects.size(), 1.0);
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    if (scene.objects[i].name == kStudyTarget) state.opacities[i] = 0.0;
  }
  return state;
}

StudyTask::StudyTask(StudyPlan plan, std::size_t first_trial)
    : plan_(std::move(plan)), trial_index_(first_trial) {}

std::vector<SceneEdit> StudyTask::set_up(const Scene& scene) const {
  PENUMBRA_ASSERT(!finished());
  std::vector<SceneEdit> edits;
  const StudyTechnique& technique =
      plan_.design.techniques[static_cast<std::size_t>(trial().technique)];
  for (const ShadowNode& node : scene.shadows) {
    ShadowStyle style = node;
    style.technique = technique.technique;
    style.kernels = technique.kernels;
    edits.emplace_back(ShadowStyled{node.name, style});
  }
  const std::vector<Eigen::Vector3d>& places = sample().places;
  if (plan_.design.experiment == StudyExperiment::heights) {
    for (std::size_t i = 0; i < places.size(); ++i) {
      edits.push_back(placed(study_sphere(static_cast<int>(i)), places[i]));
    }
  } else {
    edits.push_back(placed(kStudyBall, places[0]));
    edits.push_back(placed(kStudyTarget, places[1]));
  }
  return edits;
}

void StudyTask::show(std::int64_t time_ns) {
  PENUMBRA_ASSERT(!finished());
  shown_ = true;
  shown_ns_ = step_ns_ = time_ns;
  step_ = 1;
  misses_ = frames_ = frames_lost_ = 0;
  ball_ = sample().places[0];
  manipulator_.release_object();
  rows_.clear();
}

void StudyTask::count_frame(bool has_pose) {
  if (!shown_) return;
  ++frames_;
  if (!has_pose) ++frames_lost_;
}

StudyTask::Outcome StudyTask::press(const Scene& scene, const PointerView& pointer, bool lift,
                                    std::int64_t time_ns) {
  Outcome outcome;
  if (!shown_ || manipulator_.holding()) return outcome;
  const SceneState state = pickable_state(scene);
  if (plan_.design.experiment == StudyExperiment::drag) {
    const auto held =
        manipulator_.take(scene, state, pointer, lift ? DragMode::lift : DragMode::slide);
    if (held) outcome.edits.emplace_back(*held);
    return outcome;
  }
  const auto picked = pick(scene, state, pointer.ray);
  if (!picked) {
    ++misses_;
    return outcome;
  }
  StudyRow answer = row();
  const int best = highest_of(sample());
  const std::vector<Eigen::Vector3d>& places = sample().places;
  answer.places = places;
  answer.chosen = std::to_string(picked->object + 1);
  answer.correct = picked->object == best;
  answer.response_time_ns = time_ns - step_ns_;
  answer.error_m = places[static_cast<std::size_t>(best)].z() -
                   places[static_cast<std::size_t>(picked->object)].z();
  rows_.push_back(std::move(answer));
  close_trial(outcome);
  return outcome;
}

StudyTask::Outcome StudyTask::move(const PointerView& pointer) {
  Outcome outcome;
  if (!shown_) return outcome;
  if (const auto moved = manipulator_.drag(pointer)) {
    ball_ = moved->placement.position;
    outcome.edits.emplace_back(*moved);
  }
  return outcome;
}

StudyTask::Outcome StudyTask::release(std::int64_t time_ns) {
  Outcome outcome;
  if (!shown_ || !manipulator_.holding()) return outcome;
  manipulator_.release_object();
  if ((ball_ - target()).norm() <= plan_.design.tolerance_m) {
    answer_step(time_ns, outcome);
  } else {
    ++misses_;
  }
  return outcome;
}

StudyTask::Outcome StudyTask::accept(std::int64_t time_ns) {
  Outcome outcome;
  if (!shown_ || plan_.design.experiment != StudyExperiment::drag) return outcome;
  manipulator_.release_object();
  answer_step(time_ns, outcome);
  return outcome;
}

void StudyTask::answer_step(std::int64_t time_ns, Outcome& outcome) {
  StudyRow answer = row();
  answer.step = static_cast<int>(step_);
  answer.places = {target()};
  answer.chosen = format_places(std::array{ball_});
  answer.error_m = (ball_ - target()).norm();
  answer.correct = answer.error_m <= plan_.design.tolerance_m;
  answer.response_time_ns = time_ns - step_ns_;
  rows_.push_back(std::move(answer));
  step_ns_ = time_ns;
  misses_ = frames_ = frames_lost_ = 0;
  if (++step_ < sample().places.size()) {
    outcome.edits.push_back(placed(kStudyTarget, target()));
  } else {
    close_trial(outcome);
  }
}

void StudyTask::close_trial(Outcome& outcome) {
  outcome.rows = std::exchange(rows_, {});
  outcome.over = true;
  shown_ = false;
  ++trial_index_;
}

StudyRow StudyTask::row() const {
  StudyRow answer;
  answer.study = study_name(plan_.design);
  answer.participant = plan_.design.participant;
  answer.block = trial().block;
  answer.trial = trial().trial;
  answer.technique = plan_.design.techniques[static_cast<std::size_t>(trial().technique)].name;
  answer.sample = sample().number;
  answer.hard = sample().hard;
  answer.misses = misses_;
  answer.frames = frames_;
  answer.frames_lost = frames_lost_;
  return answer;
}

}  // namespace penumbra
