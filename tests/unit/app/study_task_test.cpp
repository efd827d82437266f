#include "app/study/study_task.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "app/study/scripted_participant.hpp"
#include "app/study/study_script.hpp"
#include "core/text/text.hpp"
#include "support/cameras.hpp"
#include "support/paths.hpp"
#include "support/utf16.hpp"

namespace penumbra {
namespace {

StudyPlan plan_of(StudyExperiment experiment, int samples = 2) {
  StudyDesign design;
  design.experiment = experiment;
  design.techniques = {*study_technique_from_string("layered"),
                       *study_technique_from_string("cocl")};
  design.samples = samples;
  return plan_study(design);
}

// A scene and the participant's pointer. The view is from straight above, where a pixel determines
// x and y, or from the side, for lifting.
class Bench {
 public:
  Bench(StudyExperiment experiment, const Eigen::Vector3d& eye)
      : scene_(study_scene(experiment)), task_(plan_of(experiment), 0) {
    const Eigen::Vector3d forward = -eye.normalized();
    const Eigen::Vector3d right =
        forward.head<2>().norm() < 1e-6
            ? Eigen::Vector3d(Eigen::Vector3d::UnitX())
            : Eigen::Vector3d(forward.cross(Eigen::Vector3d::UnitZ()).normalized());
    Eigen::Matrix3d R;
    R << right, forward.cross(right), forward;
    T_table_camera_ = CameraPose(Eigen::Quaterniond(R), eye);
  }
  [[nodiscard]] PointerView at(const Eigen::Vector3d& point) const {
    const auto pixel = camera_.project(T_table_camera_.inverse() * point);
    return *view_at(camera_, T_table_camera_, *pixel);
  }
  void follow(const StudyTask::Outcome& outcome) {
    for (const SceneEdit& edit : outcome.edits) ASSERT_TRUE(apply(scene_, edit));
    rows_.insert(rows_.end(), outcome.rows.begin(), outcome.rows.end());
  }
  void begin(std::int64_t time_ns) {
    for (const SceneEdit& edit : task_.set_up(scene_)) ASSERT_TRUE(apply(scene_, edit));
    task_.show(time_ns);
  }

  Scene scene_;
  StudyTask task_;
  CameraModel camera_ = test::desk_camera();
  CameraPose T_table_camera_;
  std::vector<StudyRow> rows_;
};

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(StudyTask, RecordsFirstHitSphereAsHeightAnswer) {
  Bench bench(StudyExperiment::heights, {0.0, 0.0, 1.0});
  StudyTask& task = bench.task_;
  // Input before the trial is shown must be ignored.
  EXPECT_FALSE(task.press(bench.scene_, bench.at({0, 0, 0}), false, 1).over);
  bench.begin(5 * kSecond);
  EXPECT_EQ(bench.scene_.shadows[0].technique, ShadowTechnique::layered);
  const StudySample sample = task.sample();
  const int best = highest_of(sample);
  bench.follow(task.press(bench.scene_, bench.at({0, 0, 0}), false, 6 * kSecond));
  EXPECT_TRUE(bench.rows_.empty());
  task.count_frame(true);
  task.count_frame(false);
  const int other = (best + 1) % 3;
  const auto outcome =
      task.press(bench.scene_, bench.at(sample.places[static_cast<std::size_t>(other)]), false,
                 7 * kSecond + 250'000'000);
  EXPECT_TRUE(outcome.over);
  bench.follow(outcome);
  ASSERT_EQ(bench.rows_.size(), 1U);
  const StudyRow& row = bench.rows_[0];
  EXPECT_EQ(row.response_time_ns, 2'250'000'000);
  EXPECT_EQ(row.chosen, std::to_string(other + 1));
  EXPECT_FALSE(row.correct);
  EXPECT_DOUBLE_EQ(row.error_m, sample.places[static_cast<std::size_t>(best)].z() -
                                    sample.places[static_cast<std::size_t>(other)].z());
  EXPECT_EQ(row.misses, 1);
  EXPECT_EQ(row.frames, 2);
  EXPECT_EQ(row.frames_lost, 1);
  EXPECT_EQ(row.sample, sample.number);

  EXPECT_FALSE(task.shown());
  bench.begin(20 * kSecond);
  const StudySample second = task.sample();
  const auto top = static_cast<std::size_t>(highest_of(second));
  bench.follow(task.press(bench.scene_, bench.at(second.places[top]), false, 21 * kSecond));
  ASSERT_EQ(bench.rows_.size(), 2U);
  EXPECT_TRUE(bench.rows_[1].correct);
  EXPECT_EQ(bench.rows_[1].error_m, 0.0);
  EXPECT_EQ(bench.rows_[1].misses, 0);
  EXPECT_EQ(task.trial().block, 2);
  bench.begin(30 * kSecond);
  EXPECT_EQ(
      bench.scene_.shadows[0].kernels,
      task.plan().design.techniques[static_cast<std::size_t>(task.trial().technique)].kernels);
}

TEST(StudyTask, RecordsDragWhenBallIsReleasedNearTarget) {
  Bench bench(StudyExperiment::drag, {0.1, -0.7, 0.45});
  StudyTask& task = bench.task_;
  bench.begin(0);
  const StudySample sample = task.sample();
  std::int64_t now = 0;
  Eigen::Vector3d ball = sample.places[0];
  std::vector<Eigen::Vector3d> offsets;
  for (std::size_t step = 1; step < sample.places.size(); ++step) {
    const Eigen::Vector3d& target = sample.places[step];
    const Eigen::Vector3d off(0.003, 0.0, step == 1 ? 0.004 : -0.002);
    offsets.push_back(off);
    // Slides along the table first, where the ball is still far from its target, then lifts.
    const Eigen::Vector3d slide(target.x() + off.x() - ball.x(), target.y() - ball.y(), 0.0);
    const Eigen::Vector3d lift(0.0, 0.0, target.z() + off.z() - ball.z());
    for (const bool up : {false, true}) {
      const PointerView grasp = bench.at(ball);
      const auto picked = pick(bench.scene_, pickable_state(bench.scene_), grasp.ray);
      ASSERT_TRUE(picked);
      const Eigen::Vector3d point =
          grasp.ray.origin + picked->distance * grasp.ray.direction + (up ? lift : slide);
      bench.follow(task.press(bench.scene_, grasp, up, now));
      ASSERT_TRUE(task.holding());
      bench.follow(task.move(bench.at(point)));
      now += kSecond;
      bench.follow(task.release(now));
      EXPECT_FALSE(task.holding());
      ball += up ? lift : slide;
    }
  }
  ASSERT_EQ(bench.rows_.size(), sample.places.size() - 1);
  for (std::size_t i = 0; i < bench.rows_.size(); ++i) {
    const StudyRow& row = bench.rows_[i];
    EXPECT_EQ(row.step, static_cast<int>(i) + 1);
    EXPECT_EQ(row.response_time_ns, 2 * kSecond);
    EXPECT_NEAR(row.error_m, offsets[i].norm(), 1e-9);
    EXPECT_TRUE(row.correct);
    EXPECT_EQ(row.misses, 1) << "the release after the slide must count as a miss";
    ASSERT_EQ(row.places.size(), 1U);
    EXPECT_EQ(row.places[0], sample.places[i + 1]);
  }
  EXPECT_FALSE(task.shown());
}

// A participant who can't move the ball to the target may accept its position. The target between
// eye and ball must not block picking.
TEST(StudyTask, KeepsBallOnAcceptAndIgnoresTargetPicks) {
  Bench bench(StudyExperiment::drag, {0.1, -0.7, 0.45});
  StudyTask& task = bench.task_;
  bench.begin(0);
  const Eigen::Vector3d target = task.sample().places[1];
  bench.follow(task.press(bench.scene_, bench.at(target), false, 0));
  EXPECT_FALSE(task.holding());
  bench.follow(task.accept(3 * kSecond));
  while (task.shown() && task.trial().trial == 1) bench.follow(task.accept(4 * kSecond));
  ASSERT_GE(bench.rows_.size(), 3U);
  EXPECT_EQ(bench.rows_[0].response_time_ns, 3 * kSecond);
  EXPECT_FALSE(bench.rows_[0].correct);
  EXPECT_NEAR(bench.rows_[0].error_m, (target - Eigen::Vector3d(0.0, 0.0, 0.05)).norm(), 1e-12);
  EXPECT_EQ(bench.rows_[1].response_time_ns, kSecond);
  EXPECT_EQ(bench.rows_[2].response_time_ns, 0);
}

TEST(StudyScript, AcceptsByteOrderMark) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "script.txt";
  const std::string text = "1 1.25 click sphere 2\n";
  ASSERT_TRUE(write_text_file(file, "\xEF\xBB\xBF" + text));
  const auto script = load_study_script(file);
  ASSERT_TRUE(script) << script.error().message;
  EXPECT_EQ(script->actions.size(), 1U);
  for (const bool with_mark : {true, false}) {
    ASSERT_TRUE(write_text_file(file, test::as_utf16(text, with_mark)));
    const auto wide = load_study_script(file);
    ASSERT_FALSE(wide);
    EXPECT_EQ(wide.error().message, file.string() + ": is UTF-16 text; save it as UTF-8");
  }
}

TEST(StudyScript, ReadsCommentsAndBlanks) {
  const auto script = parse_study_script(
      "# a participant\n"
      "1\t1.25  click sphere 2   # the highest\r\n"
      "\n"
      "2 0.5 press middle ball\n"
      "2 0.75 move by 0.01 -2e-2 0\n"
      "2 0.75 release\n"
      "3 0 click pixel 12.5 40\n"
      "3 1e-3 click table 0.1 0.2 -0.3\n"
      "3 2 accept",
      "s.txt");
  ASSERT_TRUE(script) << script.error().message;
  ASSERT_EQ(script->actions.size(), 7U);
  const auto& actions = script->actions;
  EXPECT_EQ(actions[0].line, 2);
  EXPECT_EQ(actions[0].at_ns, 1'250'000'000);
  EXPECT_EQ(actions[0].place.object, "sphere 2");
  EXPECT_EQ(actions[1].button, WindowEvent::kMiddle);
  EXPECT_EQ(actions[2].place.kind, ScriptPlace::Kind::by);
  EXPECT_EQ(actions[2].place.point, Eigen::Vector3d(0.01, -0.02, 0.0));
  EXPECT_EQ(actions[4].place.kind, ScriptPlace::Kind::pixel);
  EXPECT_EQ(actions[5].at_ns, 1'000'000);
  EXPECT_EQ(actions[6].kind, ScriptAction::Kind::accept);
}

TEST(StudyScript, ReportsLineOfError) {
  const auto refused = [](const std::string& text, const std::string& line,
                          const std::string& what) {
    const auto script = parse_study_script(text, "s.txt");
    ASSERT_FALSE(script) << text;
    EXPECT_TRUE(script.error().message.starts_with("s.txt: " + line)) << script.error().message;
    EXPECT_NE(script.error().message.find(what), std::string::npos) << script.error().message;
  };
  refused("", "holds no action", "");
  refused("# nothing\n", "holds no action", "");
  for (const char* start : {"x 1 accept", "0 1 accept", "1 -1 accept", "1 x accept", "1 1", "1",
                            "1 nan accept", "99999999999 1 accept", "1 1e9 accept"}) {
    refused(std::string("\n") + start, "line 2", "trial and time");
  }
  for (const char* action :
       {"jump", "click", "click sphere 4", "click sphere", "click table 1 2", "click table 1 2 nan",
        "click table 1 2 1e9", "click pixel 1 2 3", "press ball", "press up ball", "press left",
        "click by 1 2 3", "release now", "accept it", "move", "click sphere 1 1"}) {
    refused(std::string("1 1 ") + action, "line 1", "names no action");
  }
  refused("2 1 accept\n1 1 accept", "line 2", "in order");
  refused("1 1 accept\n1 0.9 accept", "line 2", "in order");
  refused("1 1 release", "line 1", "press before");
  refused("1 1 move by 1 0 0", "line 1", "press before");
  refused("1 1 press left ball\n2 1 release", "line 2", "press before");
  refused("1 1 press left ball\n1 2 press left ball", "line 2", "release before");
}

// Pixels of a script's positions in a window that is larger than the image.
TEST(ScriptedParticipant, PointsAtScriptedPositions) {
  Bench bench(StudyExperiment::drag, {0.1, -0.7, 0.45});
  bench.begin(0);
  SessionView view;
  view.scene = &bench.scene_;
  view.camera = &bench.camera_;
  view.T_table_camera = bench.T_table_camera_;
  const GlContext::Size window{2 * bench.camera_.width() + 100, 2 * bench.camera_.height()};
  auto script = parse_study_script(
      "1 0.5 press right ball\n1 0.6 move by 0.01 0 0\n1 0.7 release\n1 0.8 click sphere 1\n"
      "2 0.1 click pixel -1 5\n2 0.2 accept\n",
      "s.txt");
  ASSERT_TRUE(script);
  ScriptedParticipant participant(std::move(*script));
  EXPECT_EQ(participant.take(1, 400'000'000), nullptr);
  EXPECT_TRUE(participant.has_more(1));
  const ScriptAction* action = participant.take(1, 500'000'000);
  ASSERT_NE(action, nullptr);
  const auto press = participant.events_of(*action, view, window);
  ASSERT_TRUE(press);
  ASSERT_EQ(press->size(), 1U);
  EXPECT_EQ(press->front().kind, WindowEvent::Kind::button_down);
  EXPECT_EQ(press->front().code, WindowEvent::kRight);
  const auto ball =
      bench.camera_.project(bench.T_table_camera_.inverse() * bench.task_.sample().places[0]);
  EXPECT_NEAR(press->front().x, 50.0 + 2.0 * (ball->x() + 0.5), 1e-9);
  EXPECT_NEAR(press->front().y, 2.0 * (ball->y() + 0.5), 1e-9);
  const auto move = participant.events_of(*participant.take(1, kSecond), view, window);
  ASSERT_TRUE(move);
  EXPECT_EQ(move->front().kind, WindowEvent::Kind::pointer_moved);
  EXPECT_GT(move->front().x, press->front().x);
  const auto release = participant.events_of(*participant.take(1, kSecond), view, window);
  ASSERT_TRUE(release);
  EXPECT_EQ(release->front().kind, WindowEvent::Kind::button_up);
  EXPECT_EQ(release->front().code, WindowEvent::kRight);
  EXPECT_EQ(release->front().x, move->front().x);
  const auto missing = participant.events_of(*participant.take(1, kSecond), view, window);
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().message.find("line 4: this experiment has no sphere 1"),
            std::string::npos);
  EXPECT_EQ(participant.take(1, kSecond), nullptr);
  EXPECT_FALSE(participant.has_more(1));
  const auto outside = participant.events_of(*participant.take(2, kSecond), view, window);
  ASSERT_FALSE(outside);
  EXPECT_NE(outside.error().message.find("outside of the image"), std::string::npos);
  const auto accept = participant.events_of(*participant.take(2, kSecond), view, window);
  ASSERT_TRUE(accept);
  EXPECT_EQ(accept->front().kind, WindowEvent::Kind::key_down);
}

}  // namespace
}  // namespace penumbra
