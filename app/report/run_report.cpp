#include "app/report/run_report.hpp"

#include <algorithm>
#include <functional>
#include <nlohmann/json.hpp>
#include <numeric>

#include "app/capture/capture_stats.hpp"
#include "app/report/residual_report.hpp"
#include "app/report/versions.hpp"
#include "core/assert.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

Json json_of(const Statistics& s) {
  return {{"rmse", s.rmse}, {"median", s.median}, {"p95", s.p95}, {"max", s.max}};
}

Json json_of(const StageSummary& s) {
  return {
      {"median", s.median},         {"p95", s.p95},           {"max", s.max},    {"mean", s.mean},
      {"cpu_median", s.cpu_median}, {"cpu_mean", s.cpu_mean}, {"count", s.count}};
}

// Replaces bytes that are not UTF-8, for example in paths.
std::string json_text(const Json& json) {
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

double ratio_of(int part, int whole) {
  return whole > 0 ? static_cast<double>(part) / whole : 0.0;
}

Json json_of(const Evaluation& e) {
  // Without poses there is no error: writes null, because 0 would mean a perfect result.
  const auto known = [&](const Json& value) { return e.frames_judged > 0 ? value : Json(); };
  Json json;
  json["translation_mm"] = known(json_of(e.translation_mm));
  json["rotation_deg"] = known(json_of(e.rotation_deg));
  json["overlay_px"] = known(json_of(e.overlay_px));
  json["overlay_frame_px"] = known(json_of(e.overlay_frame_px));
  if (e.frames_with_ratio > 0) {
    json["frame_ratio"] = json_of(e.frame_ratio);
    json["share_above_3"] = e.share_above_3;
  }
  json["jitter_px"] = e.jitter_changes > 0 ? Json(e.jitter_px) : Json();
  json["frames_estimated"] = e.frames_estimated;
  json["frames_judged"] = e.frames_judged;
  json["share_judged"] = ratio_of(e.frames_judged, e.frames_estimated);
  json["not_judged"] = Json::object();
  for (const NotEvaluated cause : kNotEvaluatedCauses) {
    const int count = e.frames_not_judged[static_cast<std::size_t>(cause)];
    if (count > 0) json["not_judged"][std::string(to_string(cause))] = count;
  }
  json["frames_with_truth"] = e.frames_with_truth;
  json["frames_with_pose"] = e.frames_with_pose;
  json["share_with_pose"] = ratio_of(e.frames_with_pose, e.frames_with_truth);
  json["time_offset_s"] = seconds(e.time_offset_ns);
  return json;
}

template <class Counts>
Json counts_json(const Counts& counts) {
  Json json = Json::object();
  for (const auto& [name, count] : counts) json[name] = count;
  return json;
}

void add_json(Json& json, const TrackingCounts& counts) {
  json["frames_tracked"] = counts.frames_tracked;
  json["frames_uncertain"] = counts.frames_uncertain;
  json["frames_held"] = counts.frames_held;
  json["frames_lost"] = counts.frames_lost;
}

std::string status_text(const TrackingCounts& counts) {
  return fmt::format("tracked {}, uncertain {}, held {}, lost {}\n", counts.frames_tracked,
                     counts.frames_uncertain, counts.frames_held, counts.frames_lost);
}

void add_rejected_tags(Json& json, const TrackingCounts& counts) {
  for (std::size_t i = 0; i < kTagRejections; ++i) {
    json[std::string(key_of(static_cast<TagRejection>(i)))] = counts_json(counts.tags_rejected[i]);
  }
}

Json groups_json(const std::vector<GroupReport>& groups) {
  Json json = Json::object();
  for (const GroupReport& group : groups) {
    Json& of_group = json[group.name];
    add_json(of_group, group);
    of_group["reprojection_rms_px"] =
        group.tags_measured ? json_of(group.reprojection_rms_px) : Json();
    add_rejected_tags(of_group, group);
    if (group.accuracy) of_group["accuracy"] = json_of(*group.accuracy);
  }
  return json;
}

Json times_json(const std::vector<std::pair<std::string, StageSummary>>& time_ms) {
  Json json = Json::object();
  for (const auto& [stage, summary] : time_ms) json[stage] = json_of(summary);
  return json;
}

// Busy time per frame of each thread of the pipeline. The critical path is the busiest thread if
// the threads run in parallel, otherwise the sum of all.
Json pipeline_json(const RunReport& report) {
  constexpr std::array<std::string_view, 4> kStages = {"capture", "track", "draw", "encode"};
  Json busy = Json::object();
  std::string busiest;
  double most_ms = 0.0;
  double sum_ms = 0.0;
  for (const auto& [stage, summary] : report.time_ms) {
    if (std::ranges::count(kStages, stage) == 0 || summary.count == 0 || report.frames == 0)
      continue;
    const double ms = summary.mean * static_cast<double>(summary.count) / report.frames;
    busy[stage] = ms;
    sum_ms += ms;
    if (ms > most_ms) busiest = stage;
    most_ms = std::max(most_ms, ms);
  }
  const bool is_parallel = report.threads > 1;
  return {{"threads", report.threads},
          {"busy_ms_per_frame", busy},
          {"critical_path", is_parallel ? busiest : "every stage"},
          {"critical_ms_per_frame", is_parallel ? most_ms : sum_ms}};
}

Json json_of(const SmoothingReport& smoothing) {
  Json json = {
      {"lag_ms", json_of(smoothing.lag_ms)},
      {"measured_lag_ms", smoothing.measured_lag_ms ? Json(*smoothing.measured_lag_ms) : Json()},
      {"offset_px", json_of(smoothing.offset_px)}};
  if (smoothing.accuracy) json["accuracy"] = json_of(*smoothing.accuracy);
  return json;
}

}  // namespace

void TrackingCounts::add(TrackStatus status, const MeasuredTags& tags) {
  const std::array counts = {&frames_tracked, &frames_uncertain, &frames_held, &frames_lost};
  ++*counts[static_cast<std::size_t>(status)];
  for (const RejectedTag& tag : tags.tags_rejected)
    ++tags_rejected[static_cast<std::size_t>(tag.reason)][std::to_string(tag.id)];
}

void StageTimes::add(StageTime time) {
  recent_ms_[wall_ms_.count() % kRecentFrames] = time.wall_ms;
  wall_ms_.add(time.wall_ms);
  cpu_ms_.add(time.cpu_ms);
}

StageSummary StageTimes::summary() const {
  const Statistics wall = wall_ms_.statistics();
  return {wall.median,    wall.p95,        wall.max, wall_ms_.mean(), cpu_ms_.statistics().median,
          cpu_ms_.mean(), wall_ms_.count()};
}

std::optional<double> StageTimes::recent_ms() const {
  const std::size_t used = std::min(kRecentFrames, wall_ms_.count());
  if (used == 0) return std::nullopt;
  return std::accumulate(recent_ms_.begin(), recent_ms_.begin() + used, 0.0) /
         static_cast<double>(used);
}

RunRecorder::RunRecorder(const RunRecorderOptions& options) : keep_paths_(options.keep_paths) {
  if (options.camera) lag_.emplace(*options.camera);
  // Includes stages that never run, with a count of 0.
  for (const char* stage :
       {"capture", "track", "detect", "search", "align", "solve", "draw", "light", "plan", "shadow",
        "render", "gpu", "readback", "encode", "frame", "latency"}) {
    stages_.emplace_back(stage, StageTimes());
  }
}

void RunRecorder::add_time(std::string_view stage, StageTime time) {
  const auto found = std::ranges::find(stages_, stage, &std::pair<std::string, StageTimes>::first);
  PENUMBRA_ASSERT(found != stages_.end());
  found->second.add(time);
}

void RunRecorder::add_gpu_times(std::span<const double> times_ms) {
  for (const double time_ms : times_ms) add_time("gpu", {time_ms, 0.0});
}

void RunRecorder::add_frame(const SessionFrame& frame) {
  const PoseEstimate& pose = frame.tracked.pose;
  const TrackTimes& times = frame.tracked.times;
  const CompositeStats& drawn = frame.composite;
  ++report_.frames;
  report_.translucency = drawn.translucency;
  report_.add(pose.status, pose);
  if (pose.status == TrackStatus::tracked) {
    expected_px_.add(pose.predicted_overlay_error_px);
    add_tracked(frame);
  } else {
    add_reason(pose.reason);
  }
  if (frame.smoothed) {
    lag_ms_.add(frame.smoothed->lag_ms);
    offset_px_.add(frame.smoothed->offset_px);
  }
  report_.pixels_sampled += times.samples;
  for (std::size_t i = 0; i < kSkippedWorkNames.size(); ++i)
    report_.tracking_skipped[i] += times.skipped[kSkippedWorkNames[i].value];
  if (keep_paths_) times_ns_.push_back(frame.tracked.frame.timestamp_ns);
  if (pose.tags_used > 0) reprojection_px_.add(pose.reprojection_rms_px);
  if (times.search_used) ++report_.full_detections;  // counts the background search
  if (times.full_detection) {
    ++report_.full_detections;
  } else if (times.roi_detection) {
    ++report_.box_detections;
  } else if (pose.tags_used > 0) {
    ++report_.tracked_updates;
    if (times.pyramid_search) ++report_.coarse_searches;
  }

  add_time("track", {times.total_ms, times.total_cpu_ms});
  if (times.detect_ms > 0.0) add_time("detect", {times.detect_ms, times.detect_cpu_ms});
  if (times.search_used) add_time("search", {times.search_ms, times.search_cpu_ms});
  if (times.align_ms > 0.0) add_time("align", {times.align_ms, times.align_cpu_ms});
  if (times.solve_ms > 0.0) add_time("solve", {times.solve_ms, times.solve_cpu_ms});
  if (frame.light_time.wall_ms > 0.0) add_time("light", frame.light_time);
  add_time("plan", frame.plan_time);
  add_time("shadow", {drawn.shadow_ms, drawn.shadow_cpu_ms});
  add_time("render", {drawn.render_ms, drawn.render_cpu_ms});
  add_time("draw", frame.draw_time);
  if (frame.read_back) add_time("readback", {drawn.readback_ms, drawn.readback_cpu_ms});

  for (const GroupEstimate& group : frame.tracked.groups) add_group(group, frame.tracked);
  if (frame.tracked.groups_skipped > 0) {
    report_.skipped["group_not_in_scene"] += frame.tracked.groups_skipped;
  }
  add_work(drawn);
  for (const ShadowEvent& event : frame.events) ++events_[static_cast<std::size_t>(event.kind)];
  for (const SkippedPass& pass : frame.plan.skipped) ++skipped_[pass.reason];
  for (const KeptResult& part : drawn.kept) ++kept_[part.reason];
}

void RunRecorder::add_reason(const PoseReason& reason) {
  auto known = std::ranges::find_if(
      reasons_, [&](const ReasonCount& count) { return is_same_kind(count.first, reason); });
  if (known == reasons_.end()) known = reasons_.insert(known, {reason});
  ++known->frames;
}

void RunRecorder::add_tracked(const SessionFrame& frame) {
  const std::int64_t timestamp_ns = frame.tracked.frame.timestamp_ns;
  const CameraPose& measured = frame.tracked.pose.T_table_camera;
  const CameraPose& drawn = frame.smoothed ? frame.smoothed->T_table_camera : measured;
  if (lag_ && frame.smoothed) {
    lag_->add(timestamp_ns, measured, drawn);
  } else if (lag_) {
    lag_->restart();
  }
  if (!keep_paths_) return;
  tracked_.poses.push_back(
      {timestamp_ns, measured, {}, frame.tracked.pose.predicted_overlay_error_px});
  drawn_.poses.push_back({timestamp_ns, drawn, {}});
}

void RunRecorder::add_group(const GroupEstimate& estimate, const TrackedFrame& tracked) {
  const auto name_of_group = [](const Group& group) { return group.report.name; };
  auto found = std::ranges::find(groups_, estimate.name, name_of_group);
  if (found == groups_.end()) {
    groups_.emplace_back().report.name = estimate.name;
    found = groups_.end() - 1;
    found->T_group_middle = estimate.T_group_middle;
  }
  found->report.add(estimate.status, estimate);
  if (estimate.status == TrackStatus::tracked && keep_paths_) {
    const auto T_middle_camera =
        (estimate.T_table_group * estimate.T_group_middle).inverse() * tracked.pose.T_table_camera;
    found->tracked.poses.push_back(
        {tracked.frame.timestamp_ns,
         CameraPose(T_middle_camera.rotation(), T_middle_camera.translation()),
         {},
         estimate.predicted_overlay_error_px});
  }
  if (estimate.tags_used > 0) found->reprojection_px.add(estimate.reprojection_rms_px);
}

const RunRecorder::Group& RunRecorder::group(const std::string& name) const {
  const auto found =
      std::ranges::find(groups_, name, [](const Group& group) { return group.report.name; });
  PENUMBRA_ASSERT(found != groups_.end());
  return *found;
}

void RunRecorder::add_work(const CompositeStats& drawn) {
  work_ += drawn.counters;
  // GPU times become available with a later frame.
  add_gpu_times(drawn.gpu_ms);
}

std::optional<double> RunRecorder::recent_ms(std::string_view stage) const {
  const auto found = std::ranges::find(stages_, stage, &std::pair<std::string, StageTimes>::first);
  PENUMBRA_ASSERT(found != stages_.end());
  return found->second.recent_ms();
}

RunReport RunRecorder::report() const {
  RunReport report = report_;
  report.frames_captured = report.frames;
  for (const auto& [stage, times] : stages_) {
    if (stage == "gpu" && !times.recent_ms()) continue;  // GPU times are not measured
    report.time_ms.emplace_back(stage, times.summary());
  }
  report.reprojection_rms_px = reprojection_px_.statistics();
  report.tags_measured = !reprojection_px_.empty();
  report.expected_overlay_px = expected_px_.statistics();
  if (!lag_ms_.empty()) {
    report.smoothing.emplace();
    report.smoothing->lag_ms = lag_ms_.statistics();
    report.smoothing->offset_px = offset_px_.statistics();
    if (lag_) report.smoothing->measured_lag_ms = lag_->lag_ms();
  }
  report.reasons = reasons_;
  std::ranges::stable_sort(report.reasons, std::greater(), &ReasonCount::frames);
  report.work = work();
  for (const auto& [reason, count] : skipped_) report.skipped[std::string(key_of(reason))] += count;
  for (const auto& [reason, count] : kept_) report.kept[std::string(key_of(reason))] += count;
  for (const Group& group : groups_) {
    GroupReport& of_group = report.groups.emplace_back(group.report);
    of_group.reprojection_rms_px = group.reprojection_px.statistics();
    of_group.tags_measured = !group.reprojection_px.empty();
  }
  return report;
}

std::vector<std::pair<std::string, std::int64_t>> RunRecorder::work() const {
  std::vector<std::pair<std::string, std::int64_t>> counts;
  for (std::size_t i = 0; i < kCounterNames.size(); ++i)
    counts.emplace_back(kCounterNames[i], work_[static_cast<Counter>(i)]);
  for (std::size_t i = 0; i < events_.size(); ++i) {
    counts.emplace_back(kShadowEventNames[i], events_[i]);
  }
  return counts;
}

Evaluation accuracy_of(const CameraModel& camera, const RunRecorder& run, const Trajectory& poses,
                       const Trajectory& truth, const PairingOptions& options) {
  Trajectory frames;
  for (const std::int64_t time_ns : run.times_ns()) frames.poses.push_back({time_ns, {}, {}});
  Evaluation evaluation = evaluate(camera, poses, truth, options, median_interval_ns(frames));
  const auto has_truth = [&](std::int64_t time_ns) {
    return pose_at(truth, shifted(time_ns, options.time_offset_ns), options.max_gap_ns).has_value();
  };
  evaluation.frames_with_truth = static_cast<int>(std::ranges::count_if(run.times_ns(), has_truth));
  evaluation.frames_with_pose = evaluation.frames_judged;
  return evaluation;
}

Evaluation accuracy_of_group(const CameraModel& camera, const RunRecorder& run,
                             const std::string& group, const GroupTruth& truth,
                             const PairingOptions& options) {
  const RunRecorder::Group& found = run.group(group);
  const Trajectory true_poses =
      relative_to_group(truth.camera, truth.group, found.T_group_middle, options.max_gap_ns);
  return accuracy_of(camera, run, found.tracked, true_poses, options);
}

std::string report_json(const RunReport& report) {
  Json json;
  json["recording"] = report.recording;
  json["scene"] = report.scene;
  if (const auto& tags = report.tags) {
    json["tags"] = {{"file", tags->file}, {"count", tags->count}, {"sizes_m", tags->sizes_m}};
  }
  json["frames"] = report.frames;
  json["frames_captured"] = report.frames_captured;
  json["frames_dropped"] = report.frames_dropped;
  json["frames_damaged"] = report.frames_damaged;
  add_json(json, report);
  json["interrupted"] = report.interrupted;
  if (report.failure) json["failure"] = report.failure->message;
  if (report.log_lines_dropped > 0) json["log_lines_dropped"] = report.log_lines_dropped;
  Json versions;
  for (const auto& [name, version] : component_versions()) versions[name] = version;
  json["versions"] = versions;
  json["gl"] = {{"renderer", report.gl_renderer},
                {"version", report.gl_version},
                {"msaa_samples", report.msaa_samples},
                {"pixel_buffers", report.pixel_buffers},
                {"translucency", to_string(report.translucency)}};
  json["time_ms"] = times_json(report.time_ms);
  json["pipeline"] = pipeline_json(report);
  const Json none = {{"rmse", {}}, {"median", {}}, {"p95", {}}, {"max", {}}};
  json["tracking"] = {
      {"reprojection_rms_px", report.tags_measured ? json_of(report.reprojection_rms_px) : none},
      {"expected_overlay_px", report.frames_tracked > 0 && report.tags_measured
                                  ? json_of(report.expected_overlay_px)
                                  : none},
      {"full_detections", report.full_detections},
      {"coarse_searches", report.coarse_searches},
      {"box_detections", report.box_detections},
      {"tracked_updates", report.tracked_updates},
      {"pixels_sampled", report.pixels_sampled},
      {"not_tracked", Json::object()},
      {"skipped", Json::object()}};
  for (std::size_t i = 0; i < kSkippedWorkNames.size(); ++i) {
    if (const std::int64_t count = report.tracking_skipped[i]; count > 0)
      json["tracking"]["skipped"][kSkippedWorkNames[i].name] = count;
  }
  for (const auto& [reason, frames] : report.reasons) {
    const std::string text = general_text_of(reason);
    json["tracking"]["not_tracked"][text.empty() ? "other" : text] = frames;
  }
  add_rejected_tags(json["tracking"], report);
  if (const auto& fault = report.image_fault) {
    json["tracking"]["image_fault"] = to_string(*fault);
  }
  if (report.systematic_error) {
    Json& error = json["tracking"]["systematic_error"] = causes_json(*report.systematic_error);
    error["pose_px"] = report.systematic_error->pose_px;
  }
  if (const auto& refinement = report.map_refinement) {
    json["map_refinement"] = {
        {"keyframes", refinement->keyframes},
        {"refinements", refinement->refinements},
        {"change_mm",
         {{"rmse", refinement->change.rms_m * 1e3}, {"max", refinement->change.max_m * 1e3}}},
        {"file", report.refined_map.empty() ? Json() : Json(report.refined_map)},
        {"camera_file", report.refined_camera.empty() ? Json() : Json(report.refined_camera)}};
    if (const auto& row_time = refinement->row_time) {
      json["map_refinement"]["row_time_us"] = {{"value", row_time->seconds * 1e6},
                                               {"sigma", row_time->sigma_s * 1e6}};
    }
    if (refinement->lens_gain) json["map_refinement"]["lens_gain"] = *refinement->lens_gain;
  }
  if (!report.groups.empty()) json["groups"] = groups_json(report.groups);
  json["work"] = counts_json(report.work);
  json["skipped"] = counts_json(report.skipped);
  json["kept"] = counts_json(report.kept);
  for (const PaneReport& pane : report.panes) {
    json["compare"][pane.technique] = {{"time_ms", times_json(pane.time_ms)},
                                       {"work", counts_json(pane.work)},
                                       {"skipped", counts_json(pane.skipped)},
                                       {"kept", counts_json(pane.kept)}};
  }
  if (report.recorded) {
    json["recorded"] = {{"written", report.recorded->written},
                        {"left_out", report.recorded->left_out}};
  }
  if (!report.camera_faults.empty()) json["camera_faults"] = counts_json(report.camera_faults);
  if (report.accuracy) json["accuracy"] = json_of(*report.accuracy);
  if (report.smoothing) json["smoothing"] = json_of(*report.smoothing);
  return json_text(json);
}

std::string evaluation_json(const Evaluation& evaluation,
                            const std::map<std::string, Evaluation>& groups) {
  Json json = json_of(evaluation);
  for (const auto& [name, of_group] : groups) json["groups"][name] = json_of(of_group);
  return json_text(json);
}

std::string evaluation_table(const Evaluation& evaluation) {
  std::string text;
  const auto row = [&](std::string_view name, const Statistics& s) {
    text += fmt::format("{:<22} {:>10.4f} {:>10.4f} {:>10.4f} {:>10.4f}\n", name, s.rmse, s.median,
                        s.p95, s.max);
  };
  if (evaluation.frames_judged > 0) {
    text = fmt::format("{:<22} {:>10} {:>10} {:>10} {:>10}\n", "error", "rmse", "median", "p95",
                       "max");
    row("translation [mm]", evaluation.translation_mm);
    row("rotation [deg]", evaluation.rotation_deg);
    row("overlay [px]", evaluation.overlay_px);
    if (evaluation.jitter_changes > 0) {
      text += fmt::format("{:<22} {:>10.4f}\n", "jitter [px]", evaluation.jitter_px);
    }
    text += fmt::format("judged frames with a pose: {} of {} ({:.1f} %)\n",
                        evaluation.frames_judged, evaluation.frames_estimated,
                        100.0 * ratio_of(evaluation.frames_judged, evaluation.frames_estimated));
  } else {
    text =
        fmt::format("accuracy: unknown, because no {}\n",
                    evaluation.frames_estimated == 0 ? "frame has a tracked pose"
                                                     : "tracked pose has a true pose at its time");
  }
  if (const std::string causes = not_judged_text(evaluation); !causes.empty()) {
    text += fmt::format("not judged: {}\n", causes);
  }
  if (evaluation.time_offset_ns != 0) {
    text += fmt::format("time offset added to the estimate: {} s\n",
                        format_ns_as_seconds(evaluation.time_offset_ns));
  }
  return text;
}

std::string not_judged_text(const Evaluation& evaluation) {
  std::string text;
  for (const NotEvaluated cause : kNotEvaluatedCauses) {
    const int count = evaluation.frames_not_judged[static_cast<std::size_t>(cause)];
    if (count == 0) continue;
    text += fmt::format("{}{} {}", text.empty() ? "" : ", ", count,
                        cause == NotEvaluated::outside_truth
                            ? "outside the time of the ground truth"
                            : "in a gap of the ground truth that is too long (--max-gap)");
  }
  return text;
}

namespace {

std::string smoothing_table(const SmoothingReport& smoothing) {
  std::string text = fmt::format(
      "\nsmoothed as drawn: {:.1f} ms late in the median, {:.1f} at most; {:.3f} px from the "
      "measured pose, {:.3f} at most\n",
      smoothing.lag_ms.median, smoothing.lag_ms.max, smoothing.offset_px.rmse,
      smoothing.offset_px.max);
  if (smoothing.measured_lag_ms) {
    text += fmt::format("where the view moves: {:.2f} ms late\n", *smoothing.measured_lag_ms);
  }
  if (smoothing.accuracy) text += evaluation_table(*smoothing.accuracy);
  return text;
}

// `map`: name of the map in the text.
std::string rejected_tag_lines(const TrackingCounts& counts, std::string_view map) {
  constexpr std::size_t kMaxNamed = 5;  // tags listed for each reason
  std::string text;
  for (std::size_t i = 0; i < kTagRejections; ++i) {
    std::size_t named = 0;
    for (const auto& [id, frames] : counts.tags_rejected[i]) {
      if (++named > kMaxNamed) break;
      text += text_of(static_cast<TagRejection>(i), id, map, frames) + "\n";
    }
  }
  return text;
}

// Returns a stage's name with the stage that it is a part of: "  render (in draw)".
std::string stage_label(const std::string& stage) {
  constexpr std::array<std::string_view, 3> kPartsOfTrack = {"detect", "align", "solve"};
  constexpr std::array<std::string_view, 5> kPartsOfDraw = {"light", "plan", "shadow", "render",
                                                            "readback"};
  const auto is_in = [&](const auto& parts) {
    return std::ranges::find(parts, stage) != parts.end();
  };
  if (is_in(kPartsOfTrack)) return "  " + stage + " (in track)";
  return is_in(kPartsOfDraw) ? "  " + stage + " (in draw)" : stage;
}

// Returns true if no frame was tracked and the main reason is that no pose fits the detected tags.
bool tags_fit_no_pose(const RunReport& report) {
  if (report.frames_tracked > 0 || report.reasons.empty()) return false;
  const PoseCause cause = report.reasons.front().first.cause;
  return cause == PoseCause::inconsistent_tags || cause == PoseCause::misfit;
}

// Returns lines such as "camera: damaged frames: 3 (damaged)".
std::string camera_fault_lines(const std::map<std::string, std::int64_t>& faults) {
  std::string text;
  const auto add = [&](std::string_view name, std::string_view description) {
    const auto found = faults.find(std::string(name));
    if (found == faults.end()) return;
    text += fmt::format("camera: {}: {} ({})\n", description, found->second, name);
  };
  for (std::size_t i = 0; i < kCaptureFaultCount; ++i) {
    const auto fault = static_cast<CaptureFault>(i);
    add(name_of(fault), description_of(fault));
  }
  add("restarts", "restarts of the stream");
  return text;
}

// Describes what became of the tag map with --refine-map.
std::string map_refinement_line(const MapRefinementReport& refinement, const std::string& file) {
  std::string line = "tag map: ";
  if (refinement.lens_gain) {
    line += fmt::format(
        "refined with the lens from {} keyframes; its corners moved by {:.2f} mm (RMS), at most "
        "{:.2f} mm",
        refinement.keyframes, refinement.change.rms_m * 1e3, refinement.change.max_m * 1e3);
  } else if (refinement.refinements > 0) {
    line += fmt::format("refined {} time{} from {} keyframes; ", refinement.refinements,
                        refinement.refinements == 1 ? "" : "s", refinement.keyframes);
    line += fmt::format("its corners moved by {:.2f} mm (RMS), at most {:.2f} mm",
                        refinement.change.rms_m * 1e3, refinement.change.max_m * 1e3);
  } else if (refinement.keyframes < static_cast<int>(MapKeyframes::kRefinementInterval)) {
    line += fmt::format("not refined: {} keyframe{} from different sides, {} are needed; ",
                        refinement.keyframes, refinement.keyframes == 1 ? "" : "s",
                        MapKeyframes::kRefinementInterval);
    line += "move the camera around tags that are in the map";
  } else {
    line += fmt::format("not refined: no refined map explains the {} keyframes clearly better",
                        refinement.keyframes);
  }
  if (file.empty()) return line + "; not written (--refine-map FILE writes it)\n";
  return line + fmt::format("; {}: {}\n",
                            refinement.refinements > 0 || refinement.lens_gain
                                ? "written to"
                                : "the given map is written to",
                            file);
}

// Describes what became of row time and lens with --refine-map.
std::string camera_refinement_lines(const MapRefinementReport& refinement,
                                    const std::string& file) {
  std::string text;
  if (const auto& row_time = refinement.row_time) {
    text += fmt::format(
        "shutter: the row time is {:.2f} +- {:.2f} us; {}\n", row_time->seconds * 1e6,
        row_time->sigma_s * 1e6,
        file.empty() ? "not written (--refine-camera FILE writes it)" : "written to: " + file);
  }
  if (refinement.lens_gain) {
    text += fmt::format(
        "camera: refined lens, which reduces the squared residuals of other frames by {:.0f} %; "
        "the next run can use it: {}\n",
        *refinement.lens_gain * 100.0, file);
  } else if (!refinement.lens_kept.empty()) {
    text += fmt::format("camera: the given lens, because {}; written to: {}\n",
                        refinement.lens_kept, file);
  }
  return text;
}

}  // namespace

std::string report_table(const RunReport& report) {
  std::string text = fmt::format("{}: {} frame{} of {} x {}{}{}\n", report.recording, report.frames,
                                 report.frames == 1 ? "" : "s", report.width, report.height,
                                 report.panes.empty() ? "" : " (all panes)",
                                 report.interrupted ? " (interrupted)" : "");
  text += status_text(report);
  if (!report.calibrated) {
    text +=
        "the camera is not calibrated, so poses stay uncertain; press V in the window, or use "
        "penumbra calibrate\n";
  }
  const std::size_t shown = report.calibrated ? std::min<std::size_t>(report.reasons.size(), 3) : 0;
  for (std::size_t i = 0; i < shown; ++i) {
    const auto& [first, frames] = report.reasons[i];
    const std::string reason = text_of(first);
    text +=
        fmt::format("not tracked: {} (in {} frame{}{})\n", reason.empty() ? "other" : reason,
                    frames, frames == 1 ? "" : "s",
                    frames > 1 && reason != general_text_of(first) ? "; values of the first" : "");
  }
  const bool misfit = report.calibrated && tags_fit_no_pose(report);
  if (misfit) {
    text +=
        "no frame was tracked, though tags of the map were read: check that the camera file is of "
        "this camera, its focus and its image size; then check the sizes and places in the map\n";
  }
  if (report.calibrated) text += rejected_tag_lines(report, "the map");
  if (report.map_refinement)
    text += map_refinement_line(*report.map_refinement, report.refined_map);
  if (report.map_refinement)
    text += camera_refinement_lines(*report.map_refinement, report.refined_camera);
  // Omitted if most frames are uncertain, because tags were detected in them.
  if (report.calibrated && !misfit && report.frames > 0 && report.frames_tracked == 0 &&
      2 * report.frames_uncertain < report.frames) {
    std::string why =
        "is the sheet that --tags lists in view, whole and sharp? Tags of other families are not "
        "looked for";
    if (report.image_fault) why = advice(*report.image_fault);
    if (report.camera_faults.contains("no_signal")) why = "the camera's input has no signal";
    text += fmt::format("no frame was tracked: {}\n", why);
  }
  if (report.frames_dropped > 0) {
    std::vector<std::string> why;
    if (report.frames_damaged > 0) why.push_back(fmt::format("{} damaged", report.frames_damaged));
    if (const int late = report.frames_dropped - report.frames_damaged; late > 0) {
      why.push_back(fmt::format("{} too late to be shown", late));
    }
    text +=
        fmt::format("captured {}, of which {}\n", report.frames_captured, fmt::join(why, " and "));
  }
  text += camera_fault_lines(report.camera_faults);
  for (const GroupReport& group : report.groups) {
    text += fmt::format("tag group {}: {}", group.name, status_text(group));
    text += rejected_tag_lines(group, "the map of its group");
  }
  if (report.log_lines_dropped > 0) {
    text += fmt::format("log: {} lines dropped, because standard error could not be written\n",
                        report.log_lines_dropped);
  }
  text += fmt::format("OpenGL: {}, {}\n\n", report.gl_renderer, report.gl_version);
  text += fmt::format("{:<22}{:>10}{:>10}{:>10}{:>10}\n", "wall time [ms]", "median", "p95", "max",
                      "mean CPU");
  const auto add_row = [&text](const std::string& stage, const StageSummary& s) {
    text += fmt::format("{:<22}{:>10.3f}{:>10.3f}{:>10.3f}{:>10.3f}\n", stage, s.median, s.p95,
                        s.max, s.cpu_mean);
  };
  for (const auto& [stage, summary] : report.time_ms) {
    if (summary.count > 0) add_row(stage_label(stage), summary);
  }
  for (const PaneReport& pane : report.panes) {
    for (const auto& [stage, summary] : pane.time_ms) {
      if (stage == "shadow" || stage == "render" || stage == "gpu")
        add_row(pane.technique + ": " + stage, summary);
    }
  }
  if (report.accuracy) text += "\n" + evaluation_table(*report.accuracy);
  if (report.smoothing) text += smoothing_table(*report.smoothing);
  for (const GroupReport& group : report.groups) {
    if (!group.accuracy) continue;
    text += fmt::format("\ntag group {}\n{}", group.name, evaluation_table(*group.accuracy));
  }
  return text;
}

}  // namespace penumbra
