// What a run writes, and what it draws with: the same for replay and live.
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
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct OutputRequest {
  std::optional<std::filesystem::path> output;  // composited frames
  std::optional<std::filesystem::path> poses;
  bool poses_all = false;  // uncertain and held ones too
  // A folder, for where groups of tags beside the table are: NAME.tum of each (T_table_group).
  std::optional<std::filesystem::path> group_poses;
  std::optional<std::filesystem::path> report;
};

// No output may take the place of what is read (`taken`), or of another output.
[[nodiscard]] Result<void> check_output_paths(const OutputRequest& request,
                                              std::vector<std::filesystem::path> taken);

// What of a recording is read beside its frames' pictures; they may be links to elsewhere.
[[nodiscard]] std::vector<std::filesystem::path> files_of(const Recording& recording);
// A recording is only read: fails where an output would lie in its folder, or where its pictures
// lie. `more`: written as well.
[[nodiscard]] Result<void> check_apart_from(
    const Recording& recording, const OutputRequest& request,
    const std::optional<std::filesystem::path>& more = std::nullopt);

struct RunOutputs {
  std::unique_ptr<BackgroundWriter> frames;
  std::optional<PoseWriter> poses;
  std::map<std::string, PoseWriter> group_poses;  // by name
  std::optional<OutputFile> report;

  // What is asked for of one frame; the times of those encoded since the last call go to `run`.
  // `pixels` is empty where no composited frames are wanted. What fails (a full disk) is given up
  // with what it holds until then, and told by the first error that there was; the others go on.
  [[nodiscard]] Result<void> write(const TrackedFrame& frame, std::span<const std::uint8_t> pixels,
                                   RunRecorder& run);
  // The same of a frame whose picture is lost.
  [[nodiscard]] Result<void> write_without_picture(const TrackedFrame& frame);
  // Frames and poses are on disk, under their names, when this returns; one that fails does not
  // keep the others from it.
  [[nodiscard]] Result<void> finish(RunRecorder& run);
  [[nodiscard]] Result<void> write_report(const RunReport& measured);
  // Whether there is anything left to write, frame by frame.
  [[nodiscard]] bool any() const { return frames || poses || !group_poses.empty(); }
};
// `groups`: those whose poses are written, where that is asked for.
// `encode_ahead`: how many composited frames may wait for an encoder on a thread of its own; 0:
// they are encoded as they are written.
[[nodiscard]] Result<RunOutputs> open_outputs(const OutputRequest& request,
                                              const FrameFormat& format,
                                              const std::vector<std::string>& groups,
                                              int encode_ahead);

// Tells what the scene's file says against advice; of layered shadows where they are drawn.
void tell_warnings(const Scene& scene, const PlanOptions& plan);
// The same for shadows that are drawn by several plans side by side.
void tell_warnings(const Scene& scene, std::span<const PlanOptions> plans);

// Warns of what the scene is tied to and the tags (of the file that is named) do not have;
// `consequence`: what becomes of it.
void warn_of_unknown_groups(const Scene& scene, const TagMap& tags,
                            const std::filesystem::path& tags_file, std::string_view consequence);

// The groups of tags to be tracked: those that the scene needs; nothing for all of them, where work
// is not to be skipped or their poses are written. Warns of what the scene is tied to and the tags
// (of the file that is named) do not have.
[[nodiscard]] std::optional<std::vector<std::string>> wanted_groups(
    const Scene& scene, const TagMap& tags, const std::filesystem::path& tags_file,
    const OutputRequest& request, bool skip);

// The scene, with the kernels of a file for those of its casters that have as many vertices.
[[nodiscard]] Result<Scene> load_run_scene(const std::filesystem::path& scene,
                                           const std::optional<std::filesystem::path>& kernel_file);

// A window for a picture of this size [px]. Fails in one line where there is none to be had.
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_window(GlContext::Size picture, bool vsync);

struct WindowChoice {
  bool window = true;  // where there is a display
  bool vsync = true;
};
// Where there is no display, says so in one line and goes on offscreen.
// `picture`: what it shows, and how large a window is at first.
[[nodiscard]] Result<std::unique_ptr<GlContext>> open_run_context(const WindowChoice& choice,
                                                                  GlContext::Size picture);
// The error of a run that ended because its window's display was lost; nothing in any other case.
[[nodiscard]] std::optional<Error> display_loss(const GlContext& context);

}  // namespace penumbra
