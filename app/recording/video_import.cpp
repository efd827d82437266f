#include "app/recording/video_import.hpp"

#include <system_error>

#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"
#include "app/recording/lossless_video.hpp"
#include "app/recording/recording_folder.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxTextBytes = std::size_t{16} << 20U;

// Writes the frames and returns the lines of timestamps.csv.
Result<std::string> write_frames(FrameSource& source, const std::string& name,
                                 const std::filesystem::path& file, InterruptWatch& interrupt,
                                 ImportSummary& summary) {
  std::string listing = "frame,timestamp_s\n";
  std::optional<LosslessVideo> video;
  ProgressBar progress(source.frame_count().value_or(0));
  while (!summary.interrupted) {
    PENUMBRA_TRY(const std::optional<Frame> frame, source.next());
    if (!frame) break;
    if (!video) {
      PENUMBRA_TRY(video, LosslessVideo::create(file, *frame));
    }
    PENUMBRA_TRY_VOID(video->write(*frame));
    listing += fmt::format("{},{}\n", frame->sequence, format_ns_as_seconds(frame->timestamp_ns));
    progress.update(++summary.frames);
    summary.interrupted = interrupt.interrupted();
  }
  if (!video) return fail("{}: no frame can be decoded; record or copy it again", name);
  PENUMBRA_TRY_VOID(video->finish());
  return listing;
}

}  // namespace

Result<ImportSummary> import_video(const ImportRequest& request) {
  InterruptWatch interrupt;
  OpenRecordingOptions options;
  options.require_camera = options.require_tags = false;
  options.camera = request.camera;
  options.camera_name = request.camera_name;
  options.tags = request.tags;
  PENUMBRA_TRY(const Recording recording, open_recording(request.video, options));
  if (!recording.is_video_file()) {
    return fail("{}: is a recording already; give a video file", request.video.string());
  }
  ImportSummary summary;
  for (const std::string& notice : recording.notices) log_warning("{}", notice);
  RecordingSourceOptions frames;
  static_cast<FrameRange&>(frames) = request.frames;
  PENUMBRA_TRY(auto source, open_recording_source(recording, frames));

  interrupt.hold();
  OutputFolder folder;
  PENUMBRA_TRY_VOID(create_recording_folder(request.output, folder));
  const auto write = [&]() -> Result<void> {
    const auto listing = write_frames(*source, request.video.string(),
                                      folder.partial() / "video.mkv", interrupt, summary);
    if (!listing) return tl::unexpected(listing.error());
    PENUMBRA_TRY_VOID(write_text_file(folder.partial() / "timestamps.csv", *listing));
    if (request.camera) {
      PENUMBRA_TRY(const std::string text,
                   request.camera_name.empty()
                       ? read_text_file(*request.camera, kMaxTextBytes)
                       : Result<std::string>(ros_camera_text(*recording.camera)));
      PENUMBRA_TRY_VOID(write_text_file(folder.partial() / "camera.yaml", text));
    }
    if (!request.tags) return {};
    PENUMBRA_TRY(const std::string text, read_text_file(*request.tags, kMaxTextBytes));
    return write_text_file(folder.partial() / "tags.yaml", text);
  };
  if (const auto written = write(); !written) return folder.failed(written.error());
  summary.damaged = source->damaged();
  if (const std::error_code error = folder.commit()) {
    return fail("{}: cannot be made: {}; choose another place", folder.target().string(),
                error.message());
  }
  return summary;
}

}  // namespace penumbra
