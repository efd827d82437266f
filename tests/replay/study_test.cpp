// penumbra study with a scripted participant.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <tuple>
#include <vector>

#include "app/study/study_plan.hpp"
#include "app/study/study_results.hpp"
#include "app/study/study_statistics.hpp"
#include "core/camera/camera_file.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/stopwatch.hpp"
#include "replay/replay_support.hpp"
#include "support/running_program.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;

StudyDesign design_of(StudyExperiment experiment, int samples,
                      std::initializer_list<const char*> techniques) {
  StudyDesign design;
  design.experiment = experiment;
  design.participant = 2;
  design.seed = 5;
  design.samples = samples;
  for (const char* name : techniques) {
    design.techniques.push_back(*study_technique_from_string(name));
  }
  return design;
}

std::vector<std::string> arguments_of(const StudyDesign& design, const fs::path& results,
                                      const fs::path& script) {
  std::string techniques;
  for (const StudyTechnique& technique : design.techniques) {
    techniques += (techniques.empty() ? "" : ",") + technique.name;
  }
  return {"study",
          "--experiment",
          std::string(to_string(design.experiment)),
          "--techniques",
          techniques,
          "--participant",
          std::to_string(design.participant),
          "--seed",
          std::to_string(design.seed),
          "--trials",
          std::to_string(design.samples),
          "--recording",
          bundled("tabletop"),
          "--pause",
          "0.05",
          "--output",
          results.string(),
          "--script",
          script.string()};
}

std::vector<StudyRow> rows_of(const fs::path& results) {
  std::vector<StudyRow> rows;
  const std::vector<std::string> lines = lines_of(bytes_of(results));
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (i == 0) {
      EXPECT_EQ(lines[0], kStudyHeader);
      continue;
    }
    const auto row = parse_study_row(lines[i]);
    EXPECT_TRUE(row) << lines[i];
    if (row) rows.push_back(*row);
  }
  return rows;
}

struct Expected {
  std::int64_t time_ns = 0;
  int chosen = 0;
};
// Writes the script of a participant of `heights` and returns the expected answers. Each trial has
// one miss, then a click on a sphere, which is the right one in two of three trials.
std::vector<Expected> write_heights_script(const StudyPlan& plan, const fs::path& file) {
  std::vector<Expected> expected;
  std::ofstream script(file);
  for (const StudyTrial& trial : plan.trials) {
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    Expected answer;
    answer.chosen = (highest_of(sample) + (trial.number % 3 == 0 ? 1 : 0)) % 3;
    // The times lie between frames, so that rounding to frame times would be detected.
    answer.time_ns = 103'456'789 + 17'000'001 * trial.number;
    script << trial.number << " 0.05 click pixel 3 470\n"
           << trial.number << " 0." << answer.time_ns << " click sphere " << answer.chosen + 1
           << "\n";
    expected.push_back(answer);
  }
  return expected;
}

void check_heights(const StudyPlan& plan, const std::vector<Expected>& expected,
                   const std::vector<StudyRow>& rows) {
  ASSERT_EQ(rows.size(), plan.trials.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const StudyTrial& trial = plan.trials[i];
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    const StudyRow& row = rows[i];
    EXPECT_EQ(row.study, study_name(plan.design));
    EXPECT_EQ(row.participant, 2);
    EXPECT_EQ(row.block, trial.block);
    EXPECT_EQ(row.trial, trial.trial);
    EXPECT_EQ(row.technique,
              plan.design.techniques[static_cast<std::size_t>(trial.technique)].name);
    EXPECT_EQ(row.sample, sample.number);
    EXPECT_EQ(row.hard, sample.hard);
    EXPECT_EQ(row.places, sample.places);
    EXPECT_EQ(row.response_time_ns, expected[i].time_ns);
    EXPECT_EQ(row.chosen, std::to_string(expected[i].chosen + 1));
    const int best = highest_of(sample);
    EXPECT_EQ(row.correct, best == expected[i].chosen);
    EXPECT_NEAR(row.error_m,
                sample.places[static_cast<std::size_t>(best)].z() -
                    sample.places[static_cast<std::size_t>(expected[i].chosen)].z(),
                5e-7);
    EXPECT_EQ(row.misses, 1);
    // A frame every 1/30 s, from time 0.
    EXPECT_EQ(row.frames, static_cast<int>(expected[i].time_ns / 33'333'333) + 1);
    EXPECT_EQ(row.frames_lost, 0);
  }
}

TEST(StudyCommand, WritesScriptedTimesAndErrors) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const StudyPlan plan = plan_study(design_of(StudyExperiment::heights, 3, {"layered", "walls"}));
  const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
  const auto expected = write_heights_script(plan, script);
  const auto arguments = arguments_of(plan.design, results, script);
  const ProgramResult run = in_window(arguments, folder.path());
  ASSERT_EQ(run.exit_code, 0) << run.err;
  EXPECT_EQ(run.err, "") << "the program ran offscreen, without a window";
  check_heights(plan, expected, rows_of(results));
  // One participant with three answers each: medians, but too few answers for an interval.
  const std::vector<std::string> summary =
      lines_of(bytes_of(folder.path() / "answers-summary.csv"));
  ASSERT_EQ(summary.size(), 3U);
  for (std::size_t t = 0; t < 2; ++t) {
    std::vector<double> times;
    for (const StudyRow& row : rows_of(results)) {
      if (row.technique == plan.design.techniques[t].name) {
        times.push_back(1e-9 * static_cast<double>(row.response_time_ns));
      }
    }
    EXPECT_TRUE(summary[t + 1].starts_with(
        fmt::format("{},{},1,3,{:.6f},,,0.333333,", study_name(plan.design),
                    plan.design.techniques[t].name, median_of(times)->median)))
        << summary[t + 1];
  }
  EXPECT_NE(run.out.find("answers: " + results.string()), std::string::npos) << run.out;
  // Offscreen, the rows must be the same bytes. A second run must be rejected.
  const fs::path offscreen = folder.path() / "offscreen.csv";
  auto no_window = arguments_of(plan.design, offscreen, script);
  no_window.emplace_back("--no-window");
  ASSERT_EQ(penumbra(no_window).exit_code, 0);
  EXPECT_EQ(bytes_of(offscreen), bytes_of(results));
  expect_failure(penumbra(no_window), {"offscreen.csv", "participant 2", "--resume"});
  EXPECT_EQ(bytes_of(offscreen), bytes_of(results));
}

// The display may be lost at any moment: answers given so far are complete, and the participant can
// continue later.
TEST(DisplayLoss, EndsStudyWithCompleteAnswers) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  for (const int number : {SIGKILL, SIGTERM}) {
    SCOPED_TRACE(number);
    const TemporaryFolder folder;
    const StudyPlan plan = plan_study(design_of(StudyExperiment::heights, 4, {"layered", "walls"}));
    const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
    const auto expected = write_heights_script(plan, script);
    auto arguments = arguments_of(plan.design, results, script);
    std::vector<std::string> words = arguments;
    words.insert(words.begin(), program().string());
    VirtualDisplay display;
    RunningProgram running(words, [&] { setenv("DISPLAY", display.name().c_str(), 1); });
    for (int i = 0; i < 6000 && running.runs() && lines_of(bytes_of(results)).size() < 3; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    display.end(number);
    EXPECT_EQ(running.exit_code(), 1);
    const std::size_t answered = rows_of(results).size();
    EXPECT_GE(answered, 2U);
    EXPECT_LT(answered, plan.trials.size());
    EXPECT_TRUE(bytes_of(results).ends_with('\n'));
    EXPECT_EQ(lines_of(bytes_of(folder.path() / "answers-summary.csv")).size(), 3U);
    EXPECT_EQ(contents_of(folder.path()).size(), 3U) << "a partial file was left";
    for (const char* more : {"--no-window", "--resume"}) arguments.emplace_back(more);
    const ProgramResult rest = penumbra(arguments);
    EXPECT_EQ(rest.exit_code, 0) << rest.err;
    check_heights(plan, expected, rows_of(results));
  }
}

// Slides along the table, then lifts. Each target is missed once, then reached within a few
// millimetres.
TEST(StudyCommand, WritesScriptedDrags) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  const TemporaryFolder folder;
  const StudyPlan plan = plan_study(design_of(StudyExperiment::drag, 1, {"layered", "walls"}));
  const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
  const Eigen::Vector3d off(0.003, 0.0, 0.004);
  {
    std::ofstream lines(script);
    for (const StudyTrial& trial : plan.trials) {
      const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
      Eigen::Vector3d ball = sample.places[0];
      int tenth = 0;
      const auto at = [&] { return fmt::format("{} {}.{}", trial.number, tenth / 10, tenth % 10); };
      for (std::size_t step = 1; step < sample.places.size(); ++step) {
        const Eigen::Vector3d to = sample.places[step] + off;
        ++tenth;
        lines << at() << " press left ball\n";
        ++tenth;
        lines << at() << fmt::format(" move by {} {} 0\n", to.x() - ball.x(), to.y() - ball.y())
              << at() << " release\n"
              << at() << " press " << (step == 1 ? "middle" : "right") << " ball\n";
        ++tenth;
        lines << at() << fmt::format(" move by 0 0 {}\n", to.z() - ball.z());
        ++tenth;
        lines << at() << " release\n";
        ball = to;
      }
    }
  }
  auto arguments = arguments_of(plan.design, results, script);
  arguments.insert(arguments.end(), {"--poses-from", "groundtruth"});
  const ProgramResult run = in_window(arguments, folder.path());
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const std::vector<StudyRow> rows = rows_of(results);
  std::size_t at = 0;
  for (const StudyTrial& trial : plan.trials) {
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    for (std::size_t step = 1; step < sample.places.size(); ++step, ++at) {
      ASSERT_LT(at, rows.size());
      EXPECT_EQ(rows[at].step, static_cast<int>(step));
      EXPECT_EQ(rows[at].block, trial.block);
      EXPECT_EQ(rows[at].response_time_ns, 400'000'000);
      EXPECT_NEAR(rows[at].error_m, off.norm(), 1e-6) << "step " << step;
      EXPECT_TRUE(rows[at].correct);
      EXPECT_EQ(rows[at].misses, 1);
      EXPECT_EQ(rows[at].places, std::vector{sample.places[step]});
    }
  }
  EXPECT_EQ(at, rows.size());
}

// Repeats one image, so that objects on the table stay at their pixels.
class StillView {
 public:
  explicit StillView(const fs::path& folder) : folder_(folder / "still") {
    fs::create_directories(folder_ / "frames");
    const fs::path source = bundled("tabletop");
    for (const char* file : {"camera.yaml", "tags.yaml"})
      fs::copy_file(source / file, folder_ / file);
    const std::vector<std::string> poses = lines_of(bytes_of(source / "groundtruth.tum"));
    const auto first = std::ranges::find_if(poses, [](const auto& line) { return line[0] != '#'; });
    if (first == poses.end()) throw std::runtime_error("the recording has no poses");
    const std::string pose = first->substr(first->find(' '));
    constexpr int kFrames = 60;
    {
      std::ofstream truth(folder_ / "groundtruth.tum"), times(folder_ / "timestamps.csv");
      times << "frame,timestamp_s,file\n";
      for (int i = 0; i < kFrames; ++i) {
        fs::copy_file(source / "frames" / "000000.jpg",
                      folder_ / "frames" / fmt::format("{:06}.jpg", i));
        truth << fmt::format("{:.6f}{}\n", 100.0 + i / 30.0, pose);
        times << fmt::format("{},{:.6f},frames/{:06}.jpg\n", i, 100.0 + i / 30.0, i);
      }
    }
    camera_ = load_camera(folder_ / "camera.yaml").value();
    T_table_camera_ =
        load_trajectory(folder_ / "groundtruth.tum").value().poses.front().T_table_camera;
  }
  [[nodiscard]] const fs::path& folder() const { return folder_; }
  [[nodiscard]] Eigen::Vector2d pixel(const Eigen::Vector3d& place) const {
    return camera_->project(T_table_camera_.inverse() * place).value().array().round();
  }
  // Runs the study in a window with a simulated mouse.
  [[nodiscard]] ProgramResult answer(const char* mouse_script, const StudyDesign& design,
                                     const fs::path& results, const std::string& positions,
                                     const std::vector<std::string>& more = {}) const {
    auto arguments = arguments_of(design, results, "");
    arguments.resize(arguments.size() - 2);  // removes the option for the script
    *(std::ranges::find(arguments, "--recording") + 1) = folder_.string();
    arguments.insert(arguments.end(), {"--poses-from", "groundtruth"});
    arguments.insert(arguments.end(), more.begin(), more.end());
    arguments.insert(arguments.begin(), {source_dir() / "tests" / "support" / mouse_script, results,
                                         positions, program().string()});
    return run_program(source_dir() / "tests" / "support" / "with-display", arguments,
                       {fmt::format("PENUMBRA_TEST_PAUSE={}", 0.05 * kSlowness)});
  }

 private:
  fs::path folder_;
  std::optional<CameraModel> camera_;
  CameraPose T_table_camera_;
};

// The X server sends the clicks, and times are real. After two trials the window is closed; a
// second session resumes with the third and fourth trial.
TEST(StudyCommand, AcceptsMouseClicksAsAnswers) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const fs::path results = folder.path() / "answers.csv";
  const StillView view(folder.path());
  const StudyPlan plan = plan_study(design_of(StudyExperiment::heights, 2, {"layered", "walls"}));
  ASSERT_EQ(plan.trials.size(), 4U);
  std::vector<std::string> pixels;
  std::vector<int> chosen;
  for (const StudyTrial& trial : plan.trials) {
    const StudySample& sample = plan.samples[static_cast<std::size_t>(trial.sample)];
    chosen.push_back((highest_of(sample) + (trial.number == 2 ? 1 : 0)) % 3);
    const Eigen::Vector2d pixel =
        view.pixel(sample.places[static_cast<std::size_t>(chosen.back())]);
    pixels.push_back(fmt::format("{},{}", pixel.x(), pixel.y()));
  }
  const auto answer = [&](const std::string& at, const std::vector<std::string>& more) {
    const Stopwatch watch;
    const ProgramResult run = view.answer("answer-by-mouse", plan.design, results, at, more);
    EXPECT_EQ(run.exit_code, 0) << run.err;
    return watch.elapsed().wall_ms;
  };
  double took_ms = answer(pixels[0] + " " + pixels[1], {});
  ASSERT_EQ(rows_of(results).size(), 2U);
  took_ms += answer(pixels[2] + " " + pixels[3], {"--resume"});
  const std::vector<StudyRow> rows = rows_of(results);
  ASSERT_EQ(rows.size(), plan.trials.size());
  double answered_ms = 0.0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    SCOPED_TRACE(i);
    EXPECT_EQ(rows[i].trial, plan.trials[i].trial);
    EXPECT_EQ(rows[i].chosen, std::to_string(chosen[i] + 1));
    EXPECT_EQ(rows[i].correct, i != 1);
    EXPECT_GT(rows[i].response_time_ns, 0);
    EXPECT_GE(rows[i].frames, 1);
    EXPECT_EQ(rows[i].frames_lost, 0);
    answered_ms += 1e-6 * static_cast<double>(rows[i].response_time_ns);
  }
  EXPECT_LT(answered_ms, took_ms);  // no time counts in two answers
}

// Mouse pixels that move the ball to each target in turn: along the table to the target's position,
// then up or down.
struct Drags {
  StudyPlan plan;
  std::string pixels;
};
// Chooses a sample whose mouse positions are far apart, so that a press hits the ball only at the
// expected position. The mouse script may then repeat its drags.
Drags separate_drags(const StillView& view) {
  // More than the ball's radius and the rounding of its edge [px].
  constexpr double kMinDistance = 32.0;
  for (std::uint64_t seed = 1; seed < 1000; ++seed) {
    StudyDesign design = design_of(StudyExperiment::drag, 1, {"layered"});
    design.seed = seed;
    Drags drags{plan_study(design), ""};
    const auto& places = drags.plan.samples.front().places;
    std::vector<Eigen::Vector2d> rests;  // pixels of the ball at each position
    std::vector<Eigen::Vector2d> above;  // pixels of it over the next position, at its old height
    for (std::size_t i = 0; i < places.size(); ++i) {
      rests.push_back(view.pixel(places[i]));
      if (i == 0) continue;
      above.push_back(view.pixel({places[i].x(), places[i].y(), places[i - 1].z()}));
      const auto& [p0, p1, p2] = std::tuple(rests[i - 1], above.back(), rests[i]);
      drags.pixels += fmt::format("{}{},{},{},{},{},{}", i == 1 ? "" : " ", p0.x(), p0.y(), p1.x(),
                                  p1.y(), p2.x(), p2.y());
    }
    bool apart = true;
    for (std::size_t i = 0; i < rests.size(); ++i) {
      for (std::size_t k = 0; k < rests.size(); ++k)
        apart = apart && (i == k || (rests[i] - rests[k]).norm() > kMinDistance);
      for (std::size_t k = 0; k < above.size(); ++k) {
        apart = apart && (rests[i] - above[k]).norm() > kMinDistance &&
                (i >= above.size() || i == k || (above[i] - above[k]).norm() > kMinDistance);
      }
    }
    if (apart) return drags;
  }
  throw std::runtime_error("no sample has separate positions");
}

// The drag experiment with a simulated mouse.
TEST(StudyCommand, AcceptsMouseDragsAsAnswers) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(std::system("command -v xdotool >/dev/null"), 0) << "scripts/setup installs it";
  const TemporaryFolder folder;
  const StillView view(folder.path());
  const auto [plan, pixels] = separate_drags(view);
  const fs::path results = folder.path() / "answers.csv";
  const ProgramResult run = view.answer("drag-in-study", plan.design, results, pixels);
  EXPECT_EQ(run.exit_code, 0) << run.err;
  const std::vector<StudyRow> rows = rows_of(results);
  const std::vector<Eigen::Vector3d>& places = plan.samples.front().places;
  ASSERT_EQ(rows.size(), places.size() - 1);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    SCOPED_TRACE(i);
    EXPECT_EQ(rows[i].step, static_cast<int>(i) + 1);
    EXPECT_EQ(rows[i].places, std::vector{places[i + 1]});
    EXPECT_TRUE(rows[i].correct);
    // The mouse picks the ball's surface at whole pixels, which is closer to the eye than the
    // ball's centre.
    EXPECT_LT(rows[i].error_m, plan.design.tolerance_m);
    EXPECT_GE(rows[i].misses, 1) << "the release at the old height must be a miss";
    EXPECT_GT(rows[i].response_time_ns, 0);
  }
}

TEST(StudyCommand, ResumesInterruptedSession) {
  const TemporaryFolder folder;
  const StudyPlan plan = plan_study(design_of(StudyExperiment::heights, 2, {"layered", "walls"}));
  const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
  const auto expected = write_heights_script(plan, script);
  // A script that ends early simulates a participant who leaves.
  const std::vector<std::string> lines = lines_of(bytes_of(script));
  const fs::path half = folder.path() / "half.txt";
  std::ofstream(half) << lines[0] << "\n" << lines[1] << "\n" << lines[2] << "\n";
  expect_failure(penumbra(arguments_of(plan.design, results, half)), {"half.txt", "trial 2"});
  ASSERT_EQ(rows_of(results).size(), 1U);
  auto arguments = arguments_of(plan.design, results, script);
  expect_failure(penumbra(arguments), {"answers.csv", "--resume"});
  arguments.emplace_back("--resume");
  const ProgramResult run = penumbra(arguments);
  ASSERT_EQ(run.exit_code, 0) << run.err;
  check_heights(plan, expected, rows_of(results));
}

// Plays a recording as a camera, in real time and with the timestamps of the frames.
TEST(StudyCommand, RunsOnLiveCamera) {
  const TemporaryFolder folder;
  const StudyPlan plan = plan_study(design_of(StudyExperiment::heights, 1, {"layered"}));
  const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
  std::ofstream(script) << "1 0.123456789 click sphere 2\n";
  const std::string camera_yaml = bundled("tabletop") + "/camera.yaml";
  const ProgramResult run = penumbra(
      {"study", "--experiment", "heights", "--techniques", "layered", "--participant", "2",
       "--seed", "5", "--trials", "1", "--camera", "recording:" + bundled("tabletop"),
       "--calibration", camera_yaml, "--output", results.string(), "--script", script.string()});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const auto rows = rows_of(results);
  ASSERT_EQ(rows.size(), 1U);
  EXPECT_EQ(rows[0].response_time_ns, 123'456'789);
  EXPECT_EQ(rows[0].chosen, "2");
}

TEST(StudyCommand, ReportsErrorsInOneLine) {
  const TemporaryFolder folder;
  const StudyDesign design = design_of(StudyExperiment::heights, 1, {"layered"});
  const fs::path script = folder.path() / "script.txt", results = folder.path() / "answers.csv";
  expect_failure(penumbra(arguments_of(design, results, script)), {"script.txt"});
  std::ofstream(script) << "1 0.5 click sphere 7\n";
  expect_failure(penumbra(arguments_of(design, results, script)), {"script.txt", "line 1"});
  EXPECT_FALSE(fs::exists(results));
  std::ofstream(script) << "1 0.5 click ball\n";
  expect_failure(penumbra(arguments_of(design, results, script)), {"script.txt", "line 1", "ball"});
  expect_failure(penumbra(arguments_of(design, script, script)), {"script.txt", "name another"});
  // A study without a script needs a display.
  expect_failure(penumbra({"study", "--experiment", "heights", "--output", results.string()}),
                 {"DISPLAY", "--script"});
  for (const std::vector<std::string>& wrong :
       {std::vector<std::string>{"study"},
        {"study", "--experiment", "heights"},
        {"study", "--experiment", "size", "--output", "x.csv"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--techniques", "layered,,walls"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--techniques", "walls,walls"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--participant", "0"},
        {"study", "--experiment", "heights", "--output", "x.csv", "--tolerance", "5"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--calibration", "c.yaml"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--camera", "v4l2:/dev/video0"},
        {"study", "--experiment", "drag", "--output", "x.csv", "--camera", "telescope"}}) {
    const ProgramResult result = penumbra(wrong);
    EXPECT_EQ(result.exit_code, 2) << result.err;
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
  }
  const ProgramResult plan = penumbra({"study", "--experiment", "drag", "--trials", "2", "--plan"});
  EXPECT_EQ(plan.exit_code, 0);
  EXPECT_EQ(lines_of(plan.out).size(), 5U);
  for (const char* option : {"--recording", "--tags", "--script", "--poses-from"}) {
    expect_failure(penumbra({"study", "--experiment", "drag", "--plan", option, "nowhere"}),
                   {"nowhere", "no such file"});
  }
}

}  // namespace
}  // namespace penumbra::test
