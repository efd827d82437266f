#include "app/output/frame_writer.hpp"

#include <algorithm>
#include <cctype>
#include <string>

#include "app/output/png_writer.hpp"
#include "app/output/video_writer.hpp"

namespace penumbra {

OutputKind output_kind(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension == ".mkv") return OutputKind::ffv1;
  if (extension == ".mp4") return OutputKind::h264;
  return OutputKind::folder;
}

Result<std::unique_ptr<FrameWriter>> create_frame_writer(const std::filesystem::path& path,
                                                         const FrameFormat& format) {
  switch (output_kind(path)) {
    case OutputKind::ffv1:
      return create_video_writer(path, VideoCodec::ffv1, format);
    case OutputKind::h264:
      return create_video_writer(path, VideoCodec::h264, format);
    case OutputKind::folder:
      break;
  }
  return create_png_writer(path, format);
}

}  // namespace penumbra
