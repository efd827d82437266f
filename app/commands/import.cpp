// penumbra import VIDEO: makes a lossless recording of a video file.

#include <memory>

#include "app/commands/options.hpp"
#include "app/recording/video_import.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

Result<ExitCode> import_recording(const ImportRequest& request) {
  PENUMBRA_TRY(const auto summary, import_video(request));
  fmt::print("frames: {}{}\n", summary.frames, summary.interrupted ? " (interrupted)" : "");
  if (summary.damaged > 0) fmt::print("damaged frames: {}, skipped\n", summary.damaged);
  fmt::print("recording: {}\n", request.output.string());
  return ExitCode::success;
}

}  // namespace

void add_import_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "import", "Make a lossless recording of a video file, such as one of a phone",
      "The recording holds video.mkv, timestamps.csv, and camera.yaml and tags.yaml if given. "
      "Commands that take a recording take the video file itself too. "
      "Ctrl-C ends early; the recording holds the frames up to then.\n\n"
      "Example:\n"
      "  penumbra import phone.mp4 --calibration camera.yaml --tags tags.yaml --output session");
  const auto request = std::make_shared<ImportRequest>();
  add_option(command, "VIDEO", "FILE", request->video, "Video file: MP4, MOV, Matroska, AVI, ...")
      ->required();
  add_option(command, "--output", "FOLDER", request->output, "The recording: a new or empty folder")
      ->required();
  CLI::Option* calibration =
      add_option(command, "--calibration", "camera.yaml", request->camera, "The camera's model");
  add_camera_name_option(command, request->camera_name)->needs(calibration);
  add_option(command, "--tags", "FILE.yaml", request->tags, "Tag map");
  add_frames_option(command, request->frames);
  command.callback(
      [request, &chosen] { chosen = [request] { return import_recording(*request); }; });
}

}  // namespace penumbra
