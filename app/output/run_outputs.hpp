// Outputs and drawing context of a run, shared by replay and live.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "app/output/background_writer.hpp"
#include "app/output/output_file.hpp"
#include "app/output/pose_writer.hpp"
#include "app/recording/recording_source.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct OutputRequest {
  std::optional<std::filesystem::path> output;  // composited frames
  std::optional<std::filesystem::path> poses;
  bool poses_all = false;                            // uncertain and held ones too
  std::optional<std::filesystem::path> group_poses;  // folder for NAME.tum of each tag group
  std::optional<std::filesystem::path> report;
};

// Fails if an output would replace another one or a file in `taken`, which the run reads.
[[nodiscard]] Result<void> check_output_paths(const OutputRequest& request,
                                              std::vector<std::filesystem::path> taken);

// The files of a recording except its images; they may be links.
[[nodiscard]] std::vector<std::filesystem::path> files_of(const Recording& recording);
// Fails if an output would lie in the recording's folder, or where its images lie. `more`: another
// output.
[[nodiscard]] Result<void> check_apart_from(
    const Recording& recording, const OutputRequest& request,
    const std::optional<std::filesystem::path>& more = std::nullopt);

struct RunOutputs {
  std::unique_ptr<BackgroundWriter> frames;
  std::optional<PoseWriter> poses;
  std::map<std::string, PoseWriter> group_poses;  // by name
  std::optional<OutputFile> report;

  // Writes one frame; encoding times since the last call go to `run`. `pixels`: empty without
  // `frames`. An output that fails (a full disk) is closed with its content so far, the others
  // continue; returns the first error.
  [[nodiscard]] Result<void> write(const TrackedFrame& frame, std::span<const std::uint8_t> pixels,
                                   RunRecorder& run);
  // The same for a frame whose image is lost.
  [[nodiscard]] Result<void> write_without_picture(const TrackedFrame& frame);
  // Puts frames and poses under their names; a failure does not affect the others.
  [[nodiscard]] Result<void> finish(RunRecorder& run);
  [[nodiscard]] Result<void> write_report(const RunReport& measured);
  // Returns true if any output takes frames.
  [[nodiscard]] bool any() const { return frames || poses || !group_poses.empty(); }
};
// `groups`: written to `group_poses`. `encode_ahead`: number of composited frames that may wait for
// the encoder's thread; 0: no thread.
[[nodiscard]] Result<RunOutputs> open_outputs(const OutputRequest& request,
                                              const FrameFormat& format,
                                              const std::vector<std::string>& groups,
                                              int encode_ahead);

// A run's outputs if composited images come one frame late: the last frame is written while the
// next one is drawn.
class LateOutputs {
 public:
  // All outlive this. `session`: null if images are never late.
  LateOutputs(Session* session, RunOutputs& outputs, RunRecorder& run)
      : session_(session), outputs_(outputs), run_(run) {}

  // Writes a frame, or keeps it for the next call if its image is late (SessionFrame::picture).
  // `pixels`: the frame's image, or the last frame's if this one is late. Fails as
  // RunOutputs::write().
  [[nodiscard]] Result<void> write(const SessionFrame& frame, std::span<const std::uint8_t> pixels);
  // Writes the late frame: before the outputs are finished, or if no frame follows soon. Fails also
  // if its image is lost.
  [[nodiscard]] Result<void> write_rest();

 private:
  Session* session_;
  RunOutputs& outputs_;
  RunRecorder& run_;
  std::optional<TrackedFrame> waiting_;  // without pixels: the camera needs its buffer
  std::vector<std::uint8_t> pixels_;     // of write_rest()
};

// Logs the warnings of the scene file, and those about shadows that the plan draws.
void log_scene_warnings(const Scene& scene, const PlanOptions& plan);
// The same for several plans side by side.
void log_scene_warnings(const Scene& scene, std::span<const PlanOptions> plans);

// Warns of tag groups that the scene uses and the tag file lacks; `consequence` ends the message.
void warn_of_unknown_groups(const Scene& scene, const TagMap& tags,
                            const std::filesystem::path& tags_file, std::string_view consequence);

// The tag groups to track: those that the scene needs; empty for all, if their poses are written or
// `skip` is false. Warns of unknown groups.
[[nodiscard]] std::optional<std::vector<std::string>> wanted_groups(
    const Scene& scene, const TagMap& tags, const std::filesystem::path& tags_file,
    const OutputRequest& request, bool skip);

// Loads the scene; the kernel file replaces the kernels of casters with its vertex counts.
[[nodiscard]] Result<Scene> load_run_scene(const std::filesystem::path& scene,
                                           const std::optional<std::filesystem::path>& kernel_file);

// A window for an image of this size [px].
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_window(GlContext::Size picture, bool vsync);

struct WindowChoice {
  bool window = true;  // if there is a display
  bool vsync = true;
};
// Without a display it prints a line and continues offscreen. `picture`: size of the image and of
// the new window [px].
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_run_context(const WindowChoice& choice,
                                                                  GlContext::Size picture);
// The error of a run that ended because its window's display was lost; else empty.
[[nodiscard]] std::optional<Error> display_loss(const GlContext& context);

}  // namespace penumbra
