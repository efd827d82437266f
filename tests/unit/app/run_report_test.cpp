#include "app/report/run_report.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <malloc.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

#include "app/progress.hpp"
#include "app/recording/recording_source.hpp"
#include "app/run/session_host.hpp"
#include "support/cameras.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::json;

TEST(StageTimes, SummarisesWallAndCpu) {
  StageTimes times;
  for (int i = 1; i <= 5; ++i) times.add({i == 5 ? 100.0 : i * 1.0, i * 2.0});
  const StageSummary s = times.summary();
  EXPECT_EQ(s.count, 5U);
  EXPECT_DOUBLE_EQ(s.median, 3.0);
  EXPECT_DOUBLE_EQ(s.max, 100.0);
  EXPECT_DOUBLE_EQ(s.cpu_median, 6.0);
  EXPECT_DOUBLE_EQ(s.cpu_mean, 6.0);
  EXPECT_GT(s.p95, 4.0);
  EXPECT_LE(s.p95, 100.0);
  EXPECT_EQ(StageTimes().summary().count, 0U);
}

SessionFrame frame_of(TrackStatus status, std::int64_t timestamp_ns, bool full_detection) {
  SessionFrame frame;
  frame.tracked.frame.timestamp_ns = timestamp_ns;
  frame.tracked.pose.status = status;
  frame.tracked.pose.tags_used =
      status == TrackStatus::tracked || status == TrackStatus::uncertain ? 4 : 0;
  frame.tracked.pose.reprojection_rms_px = 0.25;
  frame.tracked.pose.predicted_overlay_error_px = status == TrackStatus::tracked ? 0.125 : 7.0;
  frame.tracked.times.total_ms = 3.0;
  if (full_detection) frame.tracked.times.detect_ms = 2.0;
  frame.tracked.times.full_detection = full_detection;
  frame.draw_time = {2.5, 2.0};
  frame.composite[Counter::shadow_vertices] = 100;
  frame.composite[Counter::triples_recomputed] = 2;
  frame.composite[Counter::faces_tested] = 50;
  frame.composite[Counter::faces_twisted] = 4;
  frame.composite[Counter::passes_drawn] = 3;
  frame.composite[Counter::draw_calls] = 7;
  frame.composite[Counter::pixel_buffer_uploads] = 1;
  frame.composite[Counter::pixel_buffer_read_backs] = 1;
  frame.composite.kept = {{KeepReason::video}};
  frame.read_back = status != TrackStatus::lost;
  frame.plan.skipped = {{SkipReason::object_out_of_view, 0}};
  return frame;
}

// GPU times arrive some frames late: a frame brings none, one or several, and each time counts
// once. Without timer queries the report has no GPU stage.
TEST(RunReport, ListsGpuStageOnlyWhenMeasured) {
  RunRecorder without;
  without.add_frame(frame_of(TrackStatus::tracked, 0, true));
  EXPECT_FALSE(Json::parse(report_json(without.report()))["time_ms"].contains("gpu"));
  EXPECT_EQ(report_table(without.report()).find("\ngpu "), std::string::npos);
  EXPECT_FALSE(without.recent_ms("gpu"));
  HudState state;
  describe_frame(state, frame_of(TrackStatus::tracked, 0, true), without);
  const auto is_gpu = [](const auto& stage) { return stage.first == "gpu"; };
  EXPECT_EQ(std::ranges::count_if(state.stages, is_gpu), 0);

  RunRecorder run;
  const std::vector<std::vector<double>> gpu_times = {{}, {1.0}, {}, {2.0, 3.0}};
  for (std::size_t i = 0; i < gpu_times.size(); ++i) {
    SessionFrame frame = frame_of(TrackStatus::tracked, static_cast<std::int64_t>(i), false);
    frame.composite.gpu_ms = gpu_times[i];
    run.add_frame(frame);
  }
  SessionFrame again = frame_of(TrackStatus::tracked, 3, false);
  again.composite.gpu_ms = {6.0};
  run.add_work(again.composite);
  run.add_gpu_times(std::vector<double>{8.0});
  const Json json = Json::parse(report_json(run.report()));
  EXPECT_EQ(json["time_ms"]["gpu"]["count"], 5);
  EXPECT_DOUBLE_EQ(json["time_ms"]["gpu"]["mean"], 4.0);
  EXPECT_DOUBLE_EQ(json["time_ms"]["gpu"]["max"], 8.0);
  EXPECT_EQ(json["time_ms"]["render"]["count"], 4);
  EXPECT_NE(report_table(run.report()).find("\ngpu "), std::string::npos);
  state = HudState();
  describe_frame(state, again, run);
  const auto gpu = std::ranges::find_if(state.stages, is_gpu);
  ASSERT_NE(gpu, state.stages.end());
  EXPECT_DOUBLE_EQ(gpu->second, 4.0);
  ASSERT_NE(gpu, state.stages.begin());
  EXPECT_EQ((gpu - 1)->first, "render");
}

TEST(RunReport, ReportsHowTagsWereRedetected) {
  RunRecorder run;
  run.add_frame(frame_of(TrackStatus::tracked, 0, true));
  auto by_box = frame_of(TrackStatus::tracked, 10, false);
  by_box.tracked.times.roi_detection = true;
  run.add_frame(by_box);
  auto by_pattern = frame_of(TrackStatus::tracked, 20, false);
  by_pattern.tracked.times.pyramid_search = true;
  run.add_frame(by_pattern);
  run.add_frame(frame_of(TrackStatus::tracked, 30, false));
  const Json tracking = Json::parse(report_json(run.report()))["tracking"];
  EXPECT_EQ(tracking["full_detections"], 1);
  EXPECT_EQ(tracking["box_detections"], 1);
  EXPECT_EQ(tracking["tracked_updates"], 2);
  EXPECT_EQ(tracking["coarse_searches"], 1);
}

TEST(RunReport, ReportsWorkSkippedByTracker) {
  RunRecorder run;
  run.add_frame(frame_of(TrackStatus::tracked, 0, true));
  EXPECT_TRUE(Json::parse(report_json(run.report()))["tracking"]["skipped"].empty());
  SessionFrame frame = frame_of(TrackStatus::tracked, 10, false);
  frame.tracked.times.samples = 700;
  SkippedWorkCounts& skipped = frame.tracked.times.skipped;
  skipped[SkippedWork::out_of_view] = 3;
  skipped[SkippedWork::too_small] = 2;
  skipped[SkippedWork::within_budget] = 1;
  run.add_frame(frame);
  skipped[SkippedWork::while_moving] = 1;
  skipped[SkippedWork::wide_stage] = 1;
  skipped[SkippedWork::corner_solve] = 1;
  run.add_frame(frame);
  const Json tracking = Json::parse(report_json(run.report()))["tracking"];
  EXPECT_EQ(tracking["pixels_sampled"], 1400);
  EXPECT_EQ(tracking["skipped"], Json({{"tag_out_of_view", 6},
                                       {"tag_too_small", 4},
                                       {"pixels_within_budget", 2},
                                       {"pixels_while_moving", 1},
                                       {"wide_stage", 1},
                                       {"corner_solve", 1}}));
}

// A background search uses CPU time although no frame waits for it.
TEST(RunReport, ReportsBackgroundSearchAsStageAndDetection) {
  RunRecorder run;
  SessionFrame frame = frame_of(TrackStatus::tracked, 0, false);
  run.add_frame(frame);
  frame.tracked.times.search_used = true;
  frame.tracked.times.search_ms = 12.0;
  frame.tracked.times.search_cpu_ms = 11.0;
  run.add_frame(frame);
  const Json json = Json::parse(report_json(run.report()));
  EXPECT_EQ(json["tracking"]["full_detections"], 1);
  EXPECT_EQ(json["time_ms"]["search"]["count"], 1);
  EXPECT_DOUBLE_EQ(json["time_ms"]["search"]["cpu_mean"], 11.0);
}

TEST(RunReport, HasEveryDocumentedField) {
  RunRecorder run;
  run.add_time("capture", {1.0, 0.5});
  run.add_frame(frame_of(TrackStatus::tracked, 0, true));
  run.add_frame(frame_of(TrackStatus::tracked, 10, false));
  run.add_frame(frame_of(TrackStatus::uncertain, 20, true));
  run.add_frame(frame_of(TrackStatus::held, 30, true));
  run.add_frame(frame_of(TrackStatus::lost, 40, true));
  run.add_time("encode", {2.0, 2.0});
  run.add_time("frame", {9.0, 8.0});
  RunReport report = run.report();
  report.recording = "some\xff/recording";
  report.scene = "scene.json";
  report.accuracy = Evaluation();
  report.accuracy->overlay_px = {0.2, 0.1, 0.4, 0.5};
  report.accuracy->jitter_px = 0.05;
  report.accuracy->jitter_changes = 8;
  report.accuracy->frames_with_ratio = 2;
  report.accuracy->frame_ratio = {0.5, 0.4, 0.8, 0.9};
  report.accuracy->share_above_3 = 0.25;
  report.accuracy->frames_with_truth = 5;
  report.accuracy->frames_estimated = 3;
  report.accuracy->frames_judged = 2;
  report.accuracy->frames_with_pose = 2;
  report.accuracy->frames_not_judged = {1, 0};

  const Json json = Json::parse(report_json(report));
  EXPECT_EQ(json["frames"], 5);
  EXPECT_EQ(json["frames_captured"], 5);
  EXPECT_EQ(json["frames_dropped"], 0);
  EXPECT_EQ(json["frames_tracked"], 2);
  EXPECT_EQ(json["frames_uncertain"], 1);
  EXPECT_EQ(json["frames_held"], 1);
  EXPECT_EQ(json["frames_lost"], 1);
  EXPECT_TRUE(json["versions"].contains("penumbra"));
  EXPECT_TRUE(json["gl"].contains("renderer"));
  EXPECT_TRUE(json["gl"].contains("version"));
  for (const char* stage : {"capture", "track", "detect", "align", "solve", "shadow", "render",
                            "readback", "encode", "frame", "latency"}) {
    ASSERT_TRUE(json["time_ms"].contains(stage)) << stage;
    for (const char* field : {"median", "p95", "max", "cpu_median", "cpu_mean", "count"}) {
      EXPECT_TRUE(json["time_ms"][stage].contains(field)) << stage << " " << field;
    }
  }
  EXPECT_EQ(json["time_ms"]["track"]["count"], 5);
  EXPECT_EQ(json["time_ms"]["track"]["median"], 3.0);
  EXPECT_EQ(json["time_ms"]["detect"]["count"], 4) << "one of five frames had no detection";
  EXPECT_EQ(json["time_ms"]["solve"]["count"], 0) << "the pose solver never ran";
  EXPECT_EQ(json["time_ms"]["readback"]["count"], 4);
  EXPECT_EQ(json["tracking"]["reprojection_rms_px"]["median"], 0.25);
  EXPECT_EQ(json["tracking"]["expected_overlay_px"]["max"], 0.125) << "counts tracked frames only";
  EXPECT_EQ(json["tracking"]["full_detections"], 4);
  EXPECT_EQ(json["tracking"]["tracked_updates"], 1);
  EXPECT_EQ(json["work"]["shadow_vertices"], 500);
  EXPECT_EQ(json["work"]["triples_recomputed"], 10);
  EXPECT_EQ(json["work"]["kernel_faces"], 250);
  EXPECT_EQ(json["work"]["twisted_faces"], 20);
  EXPECT_EQ(json["work"]["passes_drawn"], 15);
  EXPECT_EQ(json["work"]["draw_calls"], 35);
  EXPECT_EQ(json["work"]["pixel_buffer_uploads"], 5);
  EXPECT_EQ(json["work"]["pixel_buffer_read_backs"], 5);
  EXPECT_EQ(json["kept"]["video"], 5);
  EXPECT_EQ(json["gl"]["pixel_buffers"], false);
  for (const char* counter : {"kernel_generations", "reprojections", "triples_recomputed",
                              "passes_skipped", "phantom_masks_drawn", "phantom_masks_kept"}) {
    EXPECT_TRUE(json["work"].contains(counter)) << counter;
  }
  // The source reports 5 captures. The test adds one capture of 1 ms, 5 trackings of 3 ms and one
  // encoding of 2 ms.
  EXPECT_EQ(json["pipeline"]["threads"], 1);
  EXPECT_DOUBLE_EQ(json["pipeline"]["busy_ms_per_frame"]["capture"], 0.2);
  EXPECT_DOUBLE_EQ(json["pipeline"]["busy_ms_per_frame"]["track"], 3.0);
  EXPECT_DOUBLE_EQ(json["pipeline"]["busy_ms_per_frame"]["draw"], 2.5);
  EXPECT_DOUBLE_EQ(json["pipeline"]["busy_ms_per_frame"]["encode"], 0.4);
  EXPECT_EQ(json["pipeline"]["critical_path"], "every stage");
  EXPECT_DOUBLE_EQ(json["pipeline"]["critical_ms_per_frame"], 6.1);
  report.threads = 2;
  const Json side_by_side = Json::parse(report_json(report))["pipeline"];
  EXPECT_EQ(side_by_side["critical_path"], "track");
  EXPECT_DOUBLE_EQ(side_by_side["critical_ms_per_frame"], 3.0);
  EXPECT_EQ(json["skipped"]["object_out_of_view"], 5);
  for (const char* error : {"translation_mm", "rotation_deg", "overlay_px"}) {
    for (const char* field : {"rmse", "median", "p95", "max"}) {
      EXPECT_TRUE(json["accuracy"][error].contains(field)) << error << " " << field;
    }
  }
  EXPECT_EQ(json["accuracy"]["overlay_px"]["p95"], 0.4);
  EXPECT_EQ(json["accuracy"]["jitter_px"], 0.05);
  EXPECT_EQ(json["accuracy"]["frame_ratio"]["median"], 0.4);
  EXPECT_EQ(json["accuracy"]["share_above_3"], 0.25);
  EXPECT_EQ(json["accuracy"]["frames_estimated"], 3);
  EXPECT_EQ(json["accuracy"]["frames_judged"], 2);
  EXPECT_EQ(json["accuracy"]["share_judged"], 2.0 / 3.0);
  EXPECT_EQ(json["accuracy"]["not_judged"], Json({{"outside_truth", 1}}));
  EXPECT_EQ(json["accuracy"]["frames_with_truth"], 5);
  EXPECT_EQ(json["accuracy"]["frames_with_pose"], 2);
  EXPECT_EQ(json["accuracy"]["share_with_pose"], 0.4);
  EXPECT_THAT(
      report_table(report),
      testing::AllOf(testing::HasSubstr("judged frames with a pose: 2 of 3 (66.7 %)\n"),
                     testing::HasSubstr("not judged: 1 outside the time of the ground truth\n")));
  report.accuracy->jitter_changes = 0;
  report.accuracy->frames_with_ratio = 0;
  EXPECT_FALSE(Json::parse(report_json(report))["accuracy"].contains("frame_ratio"));
  EXPECT_TRUE(Json::parse(report_json(report))["accuracy"]["jitter_px"].is_null());

  report.accuracy->frames_judged = 0;
  EXPECT_TRUE(Json::parse(report_json(report))["accuracy"]["overlay_px"].is_null())
      << "a frame without a pose has no error value";
  EXPECT_THAT(
      report_table(report),
      testing::HasSubstr("accuracy: unknown, because no tracked pose has a true pose at its "
                         "time\nnot judged: 1 outside"));
  report.accuracy->frames_estimated = 0;
  EXPECT_THAT(report_table(report),
              testing::HasSubstr("accuracy: unknown, because no frame has a tracked pose\n"));
  report.accuracy.reset();
  EXPECT_FALSE(Json::parse(report_json(report)).contains("accuracy"));
}

// Camera 1 m above the table that looks straight down: camera x = table x, camera y = -table y.
const CameraPose kAbove(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), {0.0, 0.0, 1.0});

TEST(RunReport, CountsReasonsOfUntrackedFrames) {
  RunRecorder run;
  const auto add = [&run](TrackStatus status, const PoseReason& reason) {
    SessionFrame frame = frame_of(status, 10 * run.frames(), true);
    frame.tracked.pose.reason = reason;
    run.add_frame(frame);
  };
  add(TrackStatus::uncertain, {PoseCause::large_error, 2.7});
  for (int i = 0; i < 3; ++i)
    add(TrackStatus::lost, {.cause = PoseCause::tags_not_in_map, .tags = 24 + i});
  add(TrackStatus::uncertain, {PoseCause::large_error, 13.1});
  add(TrackStatus::held, {});
  const RunReport none = run.report();
  const Json counts = Json::parse(report_json(none))["tracking"]["not_tracked"];
  EXPECT_EQ(counts, Json({{"N tags in view, none of them of this board (--tags)", 3},
                          {"predicted error N px", 2},
                          {"other", 1}}));
  EXPECT_THAT(report_table(none),
              testing::HasSubstr("not tracked: 24 tags in view, none of them of this board "
                                 "(--tags) (in 3 frames; values of the first)\n"
                                 "not tracked: predicted error 2.7 px (in 2 frames; values of the "
                                 "first)\n"
                                 "not tracked: other (in 1 frame)\n"));
  EXPECT_THAT(report_table(none), testing::HasSubstr("no frame was tracked"));
  add(TrackStatus::tracked, {});
  EXPECT_THAT(report_table(run.report()), testing::Not(testing::HasSubstr("no frame was tracked")));
}

TEST(RunReport, SuggestsCameraFileWhenTagsFitNoPose) {
  for (const PoseReason& reason :
       {PoseReason{PoseCause::misfit, 22.4}, PoseReason{PoseCause::inconsistent_tags}}) {
    RunRecorder run;
    SessionFrame frame = frame_of(TrackStatus::lost, 0, true);
    frame.tracked.pose.reason = reason;
    run.add_frame(frame);
    const std::string table = report_table(run.report());
    EXPECT_THAT(table, testing::HasSubstr(text_of(reason) + " (in 1 frame)\n"
                                                            "no frame was tracked, though tags "
                                                            "of the map were read: check that "
                                                            "the camera file"));
    EXPECT_THAT(table, testing::Not(testing::HasSubstr("is the sheet")));
  }
}

TEST(RunReport, ComputesAccuracyFromTrackedFramesOnly) {
  const CameraModel camera = test::pinhole_camera();
  const CameraPose beside(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), {0.003, 0.0, 1.0});
  Trajectory truth;
  for (int i = 0; i < 10; ++i) truth.poses.push_back({i * 100'000'000LL, kAbove, {}});
  RunRecorder run({.camera = {}, .keep_paths = true});
  for (int i = 2; i < 6; ++i) {
    SessionFrame frame =
        frame_of(i == 5 ? TrackStatus::lost : TrackStatus::tracked, i * 100'000'000LL, true);
    frame.tracked.pose.T_table_camera = i == 4 ? beside : kAbove;
    run.add_frame(frame);
  }
  const Evaluation accuracy = accuracy_of(camera, run, run.tracked(), truth);
  EXPECT_EQ(accuracy.frames_with_truth, 4);
  EXPECT_EQ(accuracy.frames_judged, 3);
  EXPECT_NEAR(accuracy.translation_mm.max, 3.0, 1e-9);
  // An offset of 3 mm: 500 px * 0.003 on the table, 500 px * 0.003 / 0.8 at the cube's top.
  EXPECT_NEAR(accuracy.overlay_px.max, 1.875, 1e-9);
}

// A group's errors are measured at its centre, where its objects are drawn.
TEST(RunReport, ReportsGroupCountsAndErrors) {
  const CameraModel camera = test::pinhole_camera();
  Trajectory truth;
  Trajectory group_poses;
  RunRecorder run({.camera = {}, .keep_paths = true});
  const std::array<TrackStatus, 5> statuses = {TrackStatus::tracked, TrackStatus::tracked,
                                               TrackStatus::uncertain, TrackStatus::held,
                                               TrackStatus::lost};
  for (std::size_t i = 0; i < statuses.size(); ++i) {
    const auto time_ns = static_cast<std::int64_t>(i) * 100'000'000;
    truth.poses.push_back({time_ns, kAbove, {}});
    group_poses.poses.push_back(
        {time_ns, CameraPose(Eigen::Quaterniond::Identity(), {0.1, 0.02, 0.0}), {}});
    SessionFrame frame = frame_of(TrackStatus::tracked, time_ns, true);
    frame.tracked.pose.T_table_camera = kAbove;
    frame.tracked.groups_skipped = 2;
    GroupEstimate& group = frame.tracked.groups.emplace_back();
    group.name = "prop";
    group.status = statuses[i];
    group.T_group_middle = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(-0.1, 0.0, 0.0)};
    group.T_table_group = {Eigen::Quaterniond::Identity(),
                           Eigen::Vector3d(i == 1 ? 0.104 : 0.1, 0.02, 0.0)};
    group.tags_used = i < 3 ? 2 : 0;
    group.reprojection_rms_px = 0.1;
    if (i < 2) group.tags_rejected = {{41, TagRejection::inconsistent}};
    run.add_frame(frame);
  }
  RunReport report = run.report();
  ASSERT_EQ(report.groups.size(), 1U);
  EXPECT_EQ(report.groups[0].frames_tracked, 2);
  EXPECT_EQ(report.groups[0].frames_uncertain, 1);
  EXPECT_EQ(report.groups[0].frames_held, 1);
  EXPECT_EQ(report.groups[0].frames_lost, 1);
  EXPECT_EQ(report.skipped["group_not_in_scene"], 10);
  const Evaluation accuracy = accuracy_of_group(camera, run, "prop", {truth, group_poses});
  EXPECT_EQ(accuracy.frames_with_truth, 5);
  EXPECT_EQ(accuracy.frames_judged, 2);
  EXPECT_NEAR(accuracy.translation_mm.max, 4.0, 1e-9);
  EXPECT_NEAR(accuracy.overlay_px.max, 500.0 * 0.004 / 0.8, 1e-9);
  EXPECT_NEAR(accuracy.translation_mm.median, 2.0, 1e-9);
  report.groups[0].accuracy = accuracy;
  const Json json = Json::parse(report_json(report))["groups"]["prop"];
  EXPECT_EQ(json["frames_uncertain"], 1);
  EXPECT_NEAR(json["reprojection_rms_px"]["median"].get<double>(), 0.1, 1e-12);
  EXPECT_NEAR(json["accuracy"]["translation_mm"]["max"].get<double>(), 4.0, 1e-9);
  EXPECT_THAT(
      report_table(report),
      testing::HasSubstr("tag group prop: tracked 2, uncertain 1, held 1, lost 1\n"
                         "tag 41 is inconsistent with the map of its group: rejected in 2 frames"));
  EXPECT_EQ(json["tags_left_out"], Json({{"41", 2}}));
}

// A live session may run without end, so memory must not grow after the first thousands of frames.
TEST(RunReport, UsesConstantMemoryForManyFrames) {
  RunRecorder run({.camera = test::pinhole_camera(), .keep_paths = false});
  SessionFrame frame = frame_of(TrackStatus::tracked, 0, true);
  frame.tracked.pose.T_table_camera = kAbove;
  GroupEstimate& group = frame.tracked.groups.emplace_back();
  group.name = "prop";
  group.status = TrackStatus::tracked;
  group.tags_used = 2;
  const auto add = [&](int count) {
    for (int i = 0; i < count; ++i) {
      frame.tracked.frame.timestamp_ns += 33'000'000;
      frame.tracked.times.total_ms = 1.0 + 0.001 * (i % 997);
      frame.smoothed = SmoothedPose{kAbove, 1.0, 0.1};
      run.add_time("capture", {0.5, 0.5});
      run.add_frame(frame);
      run.add_time("latency", {20.0, 0.0});
    }
  };
  add(2 * RunningStatistics::kMaxExact);
  const auto before = mallinfo2().uordblks;
  add(20'000);
  // Number of allocated bytes; mallinfo2() counts it exactly.
  EXPECT_LE(mallinfo2().uordblks, before + 1024);
  const RunReport report = run.report();
  EXPECT_EQ(report.frames, 28'192);
  EXPECT_NEAR(report.time_ms[1].second.median, 1.498, 0.01 * 1.498);
  EXPECT_EQ(report.time_ms[1].second.count, 28'192U);
}

// Frames that could not be decoded are not counted as late.
TEST(RunReport, ReportsWhyCapturedFramesWereDropped) {
  RunReport report;
  report.frames = 14;
  report.frames_captured = 249;
  report.frames_dropped = 235;
  const auto words = [&](int damaged) {
    report.frames_damaged = damaged;
    EXPECT_EQ(Json::parse(report_json(report))["frames_damaged"], damaged);
    return report_table(report);
  };
  EXPECT_THAT(words(217), testing::HasSubstr("captured 249, of which 217 damaged and 18 too late "
                                             "to be shown\n"));
  EXPECT_THAT(words(0), testing::HasSubstr("captured 249, of which 235 too late to be shown\n"));
  EXPECT_THAT(words(235), testing::HasSubstr("captured 249, of which 235 damaged\n"));
}

TEST(RunReport, CountsRecordedFrames) {
  RunReport report;
  EXPECT_FALSE(Json::parse(report_json(report)).contains("recorded"));
  report.recorded = {40, 86};
  const Json json = Json::parse(report_json(report));
  EXPECT_EQ(json["recorded"]["written"], 40);
  EXPECT_EQ(json["recorded"]["left_out"], 86);
}

TEST(StageTimes, ReportsMeanOfLastThirtyAsRecentTime) {
  StageTimes times;
  EXPECT_FALSE(times.recent_ms());
  for (int i = 1; i <= 100; ++i) {
    times.add({i * 1.0, 0.0});
    const int first = std::max(1, i - 29);
    EXPECT_NEAR(times.recent_ms().value(), 0.5 * (first + i), 1e-12);
  }
}

TEST(FrameRange, IsHalfOpen) {
  const auto range = parse_frame_range("3:17");
  ASSERT_TRUE(range);
  EXPECT_EQ(range->first, 3);
  EXPECT_EQ(range->last, 17);
  EXPECT_EQ(parse_frame_range(":5")->first, 0);
  EXPECT_FALSE(parse_frame_range("5:")->last);
  for (const char* text :
       {"", "7", "5:5", "6:5", "-1:4", "a:b", "1:2:3", "1.5:3", " 1:2", "0:99999999999"}) {
    EXPECT_FALSE(parse_frame_range(text)) << text;
  }
}

TEST(ProgressText, FillsBarWithProgress) {
  EXPECT_EQ(progress_text(0, 10, 0.0).substr(0, 32), "[" + std::string(30, ' ') + "]");
  EXPECT_EQ(progress_text(5, 10, 500.0),
            "[" + std::string(15, '#') + std::string(15, ' ') + "]    5/10  10.0 frames/s");
  EXPECT_EQ(step_text("solving: this", 1, 3, 0.0),
            "[" + std::string(30, ' ') + "]  solving: this, 0 s");
  EXPECT_EQ(step_text("solving: that", 3, 3, 12300.0),
            "[" + std::string(20, '#') + std::string(10, ' ') + "]  solving: that, 12 s");
  EXPECT_EQ(progress_text(10, 10, 500.0).substr(0, 32), "[" + std::string(30, '#') + "]");
}

TEST(RunReport, DescribesCameraFaultsAndDroppedLogLines) {
  RunReport report;
  report.camera_faults = {{"damaged", 3}, {"gap", 12}, {"restarts", 1}};
  report.log_lines_dropped = 7;
  const std::string table = report_table(report);
  EXPECT_NE(table.find("camera: damaged frames: 3 (damaged)\n"), std::string::npos) << table;
  EXPECT_NE(table.find("camera: frames dropped, by the driver's numbers: 12 (gap)\n"),
            std::string::npos)
      << table;
  EXPECT_NE(table.find("camera: restarts of the stream: 1 (restarts)\n"), std::string::npos);
  EXPECT_NE(table.find("log: 7 lines dropped"), std::string::npos);
}

}  // namespace
}  // namespace penumbra
