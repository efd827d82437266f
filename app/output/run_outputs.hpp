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
#include "app/output/frame_log.hpp"
#include "app/output/output_file.hpp"
#include "app/output/pose_writer.hpp"
#include "app/recording/recording_source.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "core/camera/camera_file.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct OutputRequest {
  std::optional<std::filesystem::path> output;  // composited frames
  std::optional<std::filesystem::path> poses;
  bool poses_all = false;                            // also writes uncertain and held poses
  std::optional<std::filesystem::path> group_poses;  // folder for a file NAME.tum per tag group
  std::optional<std::filesystem::path> frame_log;    // *.csv or *.jsonl
  std::optional<std::filesystem::path> report;
  std::optional<std::filesystem::path> refined_map;     // tags.yaml
  std::optional<std::filesystem::path> refined_camera;  // camera.yaml
  std::optional<std::filesystem::path> saved_scene;     // *.json, at the end of the run
};

// Fails if an output would replace another output or one of `taken`, the files that the run reads.
[[nodiscard]] Result<void> check_output_paths(const OutputRequest& request,
                                              std::vector<std::filesystem::path> taken);

// Returns the files of a recording except its images; the paths may be links.
[[nodiscard]] std::vector<std::filesystem::path> files_of(const Recording& recording);
// Fails if an output would lie in the recording's folder, or would contain a folder of its images.
// `more`: one more output path.
[[nodiscard]] Result<void> check_apart_from(
    const Recording& recording, const OutputRequest& request,
    const std::optional<std::filesystem::path>& more = std::nullopt);

struct RunOutputs {
  std::unique_ptr<BackgroundWriter> frames;
  std::optional<PoseWriter> poses;
  std::map<std::string, PoseWriter> group_poses;  // by name of the tag group
  std::optional<FrameLog> frame_log;
  std::optional<OutputFile> report;
  std::optional<OutputFile> refined_map;
  std::optional<OutputFile> refined_camera;
  std::optional<OutputFile> saved_scene;

  // Writes one frame and adds the encoding times since the previous call to `run`. `pixels`: empty
  // without `frames`. If an output fails (full disk), it is closed with its content so far and the
  // others continue. Returns the first error.
  [[nodiscard]] Result<void> write(const TrackedFrame& frame, std::span<const std::uint8_t> pixels,
                                   RunRecorder& run);
  // Writes the rows of a frame to the frame log. Fails as write().
  [[nodiscard]] Result<void> log(const SessionFrame& frame);
  // Writes a frame whose image could not be read back.
  [[nodiscard]] Result<void> write_without_image(const TrackedFrame& frame);
  // Completes frames and poses. If one output fails, the others are still completed.
  [[nodiscard]] Result<void> finish(RunRecorder& run);
  [[nodiscard]] Result<void> write_report(const RunReport& measured);
  // Writes the refined map and camera, both or neither.
  [[nodiscard]] Result<void> write_refined(const TagMap& map, const CameraModel& camera,
                                           const CalibrationRecord* record);
  // Writes the session's arrangement as a scene file.
  [[nodiscard]] Result<void> write_scene(const Session& session);
  // Returns true if any output is written per frame.
  [[nodiscard]] bool any() const { return frames || poses || !group_poses.empty() || frame_log; }
};
// Opens the requested outputs. `groups`: tag groups for `group_poses`. `encode_ahead`: queue length
// of the encoder's thread [frames]; 0: no thread.
[[nodiscard]] Result<RunOutputs> open_outputs(const OutputRequest& request,
                                              const FrameFormat& format,
                                              const std::vector<std::string>& groups,
                                              int encode_ahead);

// Writes a run's outputs. If images are read back one frame late, writes each frame while the next
// one is drawn.
class LateOutputs {
 public:
  // All arguments must outlive this object. `session`: nullptr if images are never late.
  LateOutputs(Session* session, RunOutputs& outputs, RunRecorder& run)
      : session_(session), outputs_(outputs), run_(run) {}

  // Writes a frame, or keeps it for the next call if its image is late (ReadBackTime::later).
  // `pixels`: the frame's image; if it is late, the previous frame's. Fails as RunOutputs::write().
  [[nodiscard]] Result<void> write(const SessionFrame& frame, std::span<const std::uint8_t> pixels);
  // Writes the pending frame. Call this before the outputs are finished, or if no frame follows
  // soon. Also fails if the frame's image can't be read back.
  [[nodiscard]] Result<void> write_pending();

 private:
  [[nodiscard]] Result<void> write_frame(const SessionFrame& frame,
                                         std::span<const std::uint8_t> pixels);
  Session* session_;
  RunOutputs& outputs_;
  RunRecorder& run_;
  std::optional<TrackedFrame> waiting_;  // pending; without pixels: the camera needs its buffer
  std::vector<std::uint8_t> pixels_;     // buffer for the pending frame's image
};

// Logs the warnings of the scene file and those about the shadows that one or several plans draw.
void log_scene_warnings(const Scene& scene, const PlanOptions& plan);
void log_scene_warnings(const Scene& scene, std::span<const PlanOptions> plans);

// Warns about tag groups that the scene uses but the tag file lacks. `consequence` ends the text.
void warn_of_unknown_groups(const Scene& scene, const TagMap& tags,
                            const std::filesystem::path& tags_file, std::string_view consequence);

// Returns the tag groups to track: those that the scene uses. Returns nullopt for all groups if
// group poses are written or `skip` is false. Warns about unknown groups.
[[nodiscard]] std::optional<std::vector<std::string>> wanted_groups(
    const Scene& scene, const TagMap& tags, const std::filesystem::path& tags_file,
    const OutputRequest& request, bool skip);

// Writes a refined camera to the partial file, in the format of output_format_of(), or in ROS's if
// that can't hold the lens.
[[nodiscard]] Result<void> save_refined_camera(OutputFile& file, const CameraModel& camera,
                                               const CalibrationRecord* record);

// Opens a window for an image of this size [px].
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_window(GlContext::Size size, bool vsync,
                                                             bool full_screen = false);

struct WindowChoice {
  bool window = true;  // opens a window if there is a display
  bool vsync = true;
  bool full_screen = false;
  bool required = false;  // fails without a display, in place of an offscreen context
};
// Opens a window, or an offscreen context instead. Prints why a requested window is not opened.
// `size`: size of the image and of a new window [px].
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_run_context(const WindowChoice& choice,
                                                                  GlContext::Size size);
// Returns the error of a run that ended because its window's display was lost, else nullopt.
[[nodiscard]] std::optional<Error> display_loss(const GlContext& context);

}  // namespace penumbra
