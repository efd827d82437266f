#include "app/output/run_outputs.hpp"

#include <algorithm>
#include <cstdio>
#include <set>
#include <system_error>
#include <utility>

#include "app/logging.hpp"
#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "render/model/cut_out.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// Creates an OpenGL 3.3 context, or OpenGL ES 3.0 if the driver lacks 3.3 (Raspberry Pi 4). If both
// fail, returns the error of the first.
template <typename Create>
Result<std::unique_ptr<GlContext>> with_either_api(const Create& create) {
  auto context = create(GlApi::gl33);
  if (context) return context;
  auto embedded = create(GlApi::gles30);
  if (!embedded) return context;
  log_info("{}; going on with OpenGL ES", context.error().message);
  return embedded;
}

}  // namespace

Result<void> check_output_paths(const OutputRequest& request, std::vector<fs::path> taken) {
  std::error_code ignored;
  for (const auto& output :
       {request.output, request.poses, request.report, request.group_poses, request.frame_log,
        request.refined_map, request.refined_camera, request.saved_scene}) {
    if (!output) continue;
    if (output == request.group_poses &&
        (is_stream(*output) ||
         (fs::exists(*output, ignored) && !fs::is_directory(*output, ignored)))) {
      return fail("{}: is not a folder; name one for the poses of groups", output->string());
    }
    if (is_stream(*output)) continue;
    for (const fs::path& other : taken) {
      if (same_path(*output, other)) {
        return fail("{}: is read or written by this run already; name another file",
                    output->string());
      }
    }
    if (output != request.output && request.output &&
        output_kind(*request.output) == OutputKind::folder && lies_in(*output, *request.output)) {
      return fail("{}: lies in {}, which holds images and nothing else; name another place",
                  output->string(), request.output->string());
    }
    if (!fs::is_directory(*output, ignored)) taken.push_back(*output);
  }
  return {};
}

std::vector<fs::path> files_of(const Recording& recording) {
  std::vector<fs::path> files;
  for (const char* name : {"camera.yaml", "tags.yaml", "timestamps.csv", "groundtruth.tum"}) {
    files.push_back(recording.folder / name);
  }
  if (!recording.video.empty()) files.push_back(recording.video);
  return files;
}

Result<void> check_apart_from(const Recording& recording, const OutputRequest& request,
                              const std::optional<fs::path>& more) {
  std::error_code ignored;
  std::set<fs::path> frame_folders;  // after following links
  for (const RecordedFrame& frame : recording.frames) {
    if (frame.file.empty()) continue;
    frame_folders.insert(frame.file.parent_path());
    if (fs::is_symlink(frame.file, ignored)) {
      frame_folders.insert(fs::weakly_canonical(frame.file, ignored).parent_path());
    }
  }
  for (const auto& output :
       {request.output, request.poses, request.report, request.group_poses, request.frame_log,
        request.refined_map, request.refined_camera, request.saved_scene, more}) {
    if (!output || is_stream(*output)) continue;
    if (lies_in(*output, recording.folder)) {
      return fail("{}: lies in the recording {}, which is only read; name a place outside it",
                  output->string(), recording.folder.string());
    }
    for (const fs::path& frames : frame_folders) {
      if (lies_in(frames, *output)) {
        return fail("{}: holds frames of the recording {}; name another place", output->string(),
                    recording.folder.string());
      }
    }
  }
  return {};
}

namespace {

// Returns true if one of the plans draws the node's shadows with a technique that has the trait.
bool is_drawn_by(const ShadowNode& node, std::span<const PlanOptions> plans,
                 bool TechniqueTraits::*trait) {
  return std::ranges::any_of(plans, [&](const PlanOptions& plan) {
    return traits_of(plan.technique.value_or(node.technique)).*trait;
  });
}

// Warns about models with alpha cut-outs, because the shadows ignore the cut-outs.
void warn_of_cut_outs(const Scene& scene, std::span<const PlanOptions> plans) {
  std::set<std::string> models;
  for (const ShadowNode& node : scene.shadows) {
    if (!is_drawn_by(node, plans, &TechniqueTraits::ignores_cut_outs)) continue;
    for (const int caster : node.casters) {
      const SceneObject& object = scene.objects[static_cast<std::size_t>(caster)];
      if (!object.model || !object.casts_shadow || !has_cut_outs(*object.model)) continue;
      models.insert(object.model_file);
    }
  }
  for (const std::string& model : models) log_warning("{}", warning_of_cut_outs(model));
}

}  // namespace

void log_scene_warnings(const Scene& scene, std::span<const PlanOptions> plans) {
  for (const std::string& warning : scene.warnings) log_warning("{}", warning);
  for (const LayeredAdvice& advice : scene.layered_advice) {
    const ShadowNode& node = scene.shadows[static_cast<std::size_t>(advice.node)];
    if (is_drawn_by(node, plans, &TechniqueTraits::has_penumbra)) {
      log_warning("{}", advice.text);
    }
  }
  warn_of_cut_outs(scene, plans);
}

void log_scene_warnings(const Scene& scene, const PlanOptions& plan) {
  log_scene_warnings(scene, std::span(&plan, 1));
}

void warn_of_unknown_groups(const Scene& scene, const TagMap& tags, const fs::path& tags_file,
                            std::string_view consequence) {
  const std::vector<std::string> known = other_groups(tags);
  std::string names(kTableGroup);
  for (const std::string& group : known) names += ", " + group;
  for (const std::string& group : tag_groups_of(scene)) {
    if (std::ranges::find(known, group) != known.end()) continue;
    log_warning(
        "{}: moves something with the tag group \"{}\", which {} does not have (it has {}); {}",
        scene.file, group, tags_file.string(), names, consequence);
  }
}

std::optional<std::vector<std::string>> wanted_groups(const Scene& scene, const TagMap& tags,
                                                      const fs::path& tags_file,
                                                      const OutputRequest& request, bool skip) {
  warn_of_unknown_groups(scene, tags, tags_file, "it is not drawn");
  if (!skip || request.group_poses || request.frame_log) return std::nullopt;
  return tag_groups_of(scene);
}

Result<RunOutputs> open_outputs(const OutputRequest& request, const FrameFormat& format,
                                const std::vector<std::string>& groups, int encode_ahead) {
  RunOutputs outputs;
  if (request.report) {
    PENUMBRA_TRY(outputs.report, OutputFile::create(*request.report));
  }
  if (request.refined_map) {
    PENUMBRA_TRY(outputs.refined_map, OutputFile::create(*request.refined_map));
  }
  if (request.refined_camera) {
    PENUMBRA_TRY(outputs.refined_camera, OutputFile::create(*request.refined_camera));
  }
  if (request.saved_scene) {
    PENUMBRA_TRY(outputs.saved_scene, OutputFile::create(*request.saved_scene));
  }
  if (request.poses) {
    PENUMBRA_TRY(outputs.poses, PoseWriter::create(*request.poses, request.poses_all));
  }
  if (request.frame_log) {
    PENUMBRA_TRY(outputs.frame_log, FrameLog::create(*request.frame_log));
  }
  if (request.group_poses) {
    std::error_code error;
    fs::create_directories(*request.group_poses, error);
    if (error) {
      return fail("{}: cannot be made: {}; choose another place", request.group_poses->string(),
                  error.message());
    }
    for (const std::string& group : groups) {
      const auto file = group_file(group);
      if (!file) {
        return fail("group '{}': its name cannot be the name of a file; rename it in the tag file",
                    group);
      }
      PENUMBRA_TRY(auto writer, PoseWriter::create(*request.group_poses / *file, request.poses_all,
                                                   "T_table_group"));
      outputs.group_poses.emplace(group, std::move(writer));
    }
  }
  if (request.output) {
    PENUMBRA_TRY(auto writer, create_frame_writer(*request.output, format));
    outputs.frames = std::make_unique<BackgroundWriter>(std::move(writer), encode_ahead);
  }
  return outputs;
}

Result<void> RunOutputs::log(const SessionFrame& frame) {
  if (!frame_log) return {};
  auto written = frame_log->write(frame);
  if (!written) {
    frame_log->rescue();
    frame_log.reset();
  }
  return written;
}

Result<void> RunOutputs::write_without_image(const TrackedFrame& frame) {
  const Frame& video = frame.frame;
  Result<void> result;
  const auto done = [&result](const Result<void>& written) {
    if (!written && result) result = written;
    return written.has_value();
  };
  if (poses && !done(poses->write(video.timestamp_ns, frame.pose))) {
    poses->rescue();
    poses.reset();
  }
  for (const GroupEstimate& group : frame.groups) {
    const auto writer = group_poses.find(group.name);
    if (writer == group_poses.end()) continue;
    if (done(writer->second.write(video.timestamp_ns, group))) continue;
    writer->second.rescue();
    group_poses.erase(writer);
  }
  return result;
}

Result<void> RunOutputs::write(const TrackedFrame& frame, std::span<const std::uint8_t> pixels,
                               RunRecorder& run) {
  const Result<void> without_image = write_without_image(frame);
  if (!frames) return without_image;
  const auto written = frames->write(frame.frame.sequence, frame.frame.timestamp_ns, pixels);
  for (const StageTime& time : frames->take_times()) run.add_time("encode", time);
  if (written) return without_image;
  frames->rescue();
  frames.reset();
  return without_image ? written : without_image;
}

Result<void> RunOutputs::finish(RunRecorder& run) {
  Result<void> result;
  const auto finish_or_rescue = [&result](auto& writer) {
    const Result<void> finished = writer.finish();
    if (finished) return;
    writer.rescue();
    if (result) result = finished;
  };
  if (frames) {
    finish_or_rescue(*frames);
    for (const StageTime& time : frames->take_times()) run.add_time("encode", time);
  }
  for (auto& [unused, writer] : group_poses) finish_or_rescue(writer);
  if (poses) finish_or_rescue(*poses);
  if (frame_log) finish_or_rescue(*frame_log);
  return result;
}

Result<void> RunOutputs::write_report(const RunReport& measured) {
  if (!report) return {};
  return write_text(*report, report_json(measured));
}

Result<void> save_refined_camera(OutputFile& file, const CameraModel& camera,
                                 const CalibrationRecord* record) {
  CameraFileFormat format = output_format_of(file.target());
  if (!can_hold(format, camera)) {
    log_warning("{}: {}'s files can't hold this lens; it is written as a ROS file",
                file.target().string(), to_string(format));
    format = CameraFileFormat::ros;
  }
  if (const auto saved = save_camera(file.partial(), camera, format, record); !saved)
    return file.failed(saved.error());
  return {};
}

Result<void> RunOutputs::write_refined(const TagMap& map, const CameraModel& camera,
                                       const CalibrationRecord* record) {
  std::vector<OutputFile*> files;
  if (refined_map) {
    PENUMBRA_TRY_VOID(write_whole(*refined_map, tag_map_text(map)));
    files.push_back(&*refined_map);
  }
  if (refined_camera) {
    PENUMBRA_TRY_VOID(save_refined_camera(*refined_camera, camera, record));
    files.push_back(&*refined_camera);
  }
  return commit_together(files);
}

Result<void> RunOutputs::write_scene(const Session& session) {
  if (!saved_scene) return {};
  const fs::path& file = saved_scene->target();
  auto text = session.scene_text(is_stream(file) ? fs::path() : file.parent_path());
  if (!text) return fail_in(file.string(), text.error());
  return write_text(*saved_scene, *text);
}

Result<void> LateOutputs::write(const SessionFrame& frame, std::span<const std::uint8_t> pixels) {
  auto logged = outputs_.log(frame);
  auto written = write_frame(frame, pixels);
  return logged ? written : logged;
}

Result<void> LateOutputs::write_frame(const SessionFrame& frame,
                                      std::span<const std::uint8_t> pixels) {
  if (frame.when_read_back != ReadBackTime::later) {
    auto rest = write_pending();
    auto written = outputs_.write(frame.tracked, pixels, run_);
    return rest ? written : rest;
  }
  Result<void> written;
  if (waiting_) {
    PENUMBRA_ASSERT(frame.read_back);
    written = outputs_.write(*waiting_, pixels, run_);
  }
  waiting_ = frame.tracked;
  waiting_->frame = Frame();
  waiting_->frame.sequence = frame.tracked.frame.sequence;
  waiting_->frame.timestamp_ns = frame.tracked.frame.timestamp_ns;
  return written;
}

Result<void> LateOutputs::write_pending() {
  if (!waiting_) return {};
  const TrackedFrame frame = *std::exchange(waiting_, std::nullopt);
  PENUMBRA_ASSERT(session_ != nullptr);
  Result<StageTime> taken = session_->take_image(pixels_);
  if (taken) {
    run_.add_time("readback", *taken);
    return outputs_.write(frame, pixels_, run_);
  }
  // Writes the pose even if the image is lost.
  auto written = outputs_.write_without_image(frame);
  return written ? tl::unexpected(taken.error()) : written;
}

Result<std::unique_ptr<GlContext>> open_window(GlContext::Size size, bool vsync, bool full_screen) {
  return with_either_api([&](GlApi api) {
    return create_window_context({.width = size.width,
                                  .height = size.height,
                                  .api = api,
                                  .vsync = vsync,
                                  .full_screen = full_screen});
  });
}

Result<std::unique_ptr<GlContext>> open_run_context(const WindowChoice& choice,
                                                    GlContext::Size size) {
  if (choice.required || (choice.window && display_available())) {
    auto window = open_window(size, choice.vsync, choice.full_screen);
    if (window || choice.required) return window;
    fmt::print("{}; going on offscreen\n", window.error().message);
  } else if (choice.window) {
    fmt::print("no display; going on offscreen\n");
  }
  std::fflush(stdout);
  return with_either_api([](GlApi api) { return create_offscreen_context(api); });
}

std::optional<Error> display_loss(const GlContext& context) {
  if (!context.display_lost()) return std::nullopt;
  return Error{
      "the connection to the display was lost, which ended the session; outputs are complete up to "
      "then; run with --no-window where the display may go away"};
}

}  // namespace penumbra
