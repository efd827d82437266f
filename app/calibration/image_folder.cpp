#include "app/calibration/image_folder.hpp"

#include <algorithm>
#include <system_error>
#include <utility>
#include <vector>

#include "app/recording/recording_source.hpp"
#include "core/image/image_file.hpp"
#include "core/image/sample_depth.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

bool is_image_file(const std::filesystem::path& file) {
  const std::string extension = lower_extension(file);
  return extension == ".png" || extension == ".jpg" || extension == ".jpeg";
}

Result<std::vector<std::filesystem::path>> image_files_in(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  std::error_code error;
  std::error_code ignored;
  for (std::filesystem::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->is_regular_file(ignored) && is_image_file(*entry)) files.push_back(*entry);
  }
  if (error) return fail("{}: cannot be read: {}", folder.string(), error.message());
  std::sort(files.begin(), files.end());
  return files;
}

// Reads the images and passes them to `visit`. `source`: name for messages. `times_ns`: one per
// file, or empty.
Result<void> each_file(const std::filesystem::path& source,
                       const std::vector<std::filesystem::path>& files,
                       const std::vector<std::int64_t>& times_ns,
                       const std::function<Result<bool>(const NamedImage&)>& visit) {
  const SampleDepth depth = sample_depth_of(files);
  ClampWatch clamps(depth.bits);
  std::vector<std::uint8_t> scratch;
  for (std::size_t i = 0; i < files.size(); ++i) {
    NamedImage image;
    if (i == 0 && depth.reduced()) {
      image.notices.push_back(fmt::format("{}: {}", source.string(), depth.text()));
    }
    image.name = files[i].filename().string();
    image.index = static_cast<int>(i);
    image.count = static_cast<int>(files.size());
    if (!times_ns.empty()) image.timestamp_ns = times_ns[i];
    const Result<Frame> frame = load_image(files[i], clamps.options());
    if (auto warning = clamps.take_warning(files[i].string()))
      image.notices.push_back(std::move(*warning));
    if (frame) {
      image.frame = *frame;
      image.luma = luma(*frame, scratch);
    } else {
      image.unreadable = frame.error().message;
    }
    PENUMBRA_TRY(const bool more, visit(image));
    if (!more) return {};
  }
  return {};
}

}  // namespace

Result<void> for_each_image(const std::filesystem::path& source,
                            const std::function<Result<bool>(const NamedImage&)>& visit) {
  std::error_code ignored;
  if (!std::filesystem::exists(source, ignored)) {
    return fail(
        "{}: no such folder; give a recording, a video file or a folder of PNG or JPEG images",
        source.string());
  }
  if (std::filesystem::is_directory(source, ignored) && !is_recording(source)) {
    PENUMBRA_TRY(const auto files, image_files_in(source));
    if (files.empty())
      return fail("{}: holds no PNG or JPEG images; put those of the target there",
                  source.string());
    return each_file(source, files, {}, visit);
  }
  OpenRecordingOptions options;
  options.with_metadata = false;
  PENUMBRA_TRY(const auto recording, open_recording(source, options));
  if (recording.video.empty()) {
    std::vector<std::filesystem::path> files;
    std::vector<std::int64_t> times_ns;
    for (const RecordedFrame& frame : recording.frames) {
      files.push_back(frame.file);
      times_ns.push_back(frame.timestamp_ns);
    }
    return each_file(source, files, times_ns, visit);
  }
  PENUMBRA_TRY(auto frames, open_recording_source(recording));
  std::vector<std::uint8_t> scratch;
  for (int i = 0;; ++i) {
    PENUMBRA_TRY(const auto frame, frames->next());
    if (!frame) return {};
    NamedImage image;
    image.name = fmt::format("frame {}", frame->sequence);
    image.index = i;
    if (i == 0) image.notices = recording.notices;
    image.count = frames->frame_count().value_or(0);
    image.frame = *frame;
    image.timestamp_ns = frame->timestamp_ns;
    image.luma = luma(*frame, scratch);
    PENUMBRA_TRY(const bool more, visit(image));
    if (!more) return {};
  }
}

}  // namespace penumbra
