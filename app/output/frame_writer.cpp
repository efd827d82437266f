#include "app/output/frame_writer.hpp"

#include <algorithm>
#include <cctype>
#include <string>

namespace penumbra {

OutputKind output_kind(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::ranges::transform(extension, extension.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension == ".mkv") return OutputKind::ffv1;
  return extension == ".mp4" ? OutputKind::h264 : OutputKind::folder;
}

Result<std::unique_ptr<FrameWriter>> create_frame_writer(const std::filesystem::path& path,
                                                         const FrameFormat& format) {
  const OutputKind kind = output_kind(path);
  if (kind == OutputKind::folder) return create_png_writer(path, format);
  return create_video_writer(path, kind == OutputKind::ffv1 ? VideoCodec::ffv1 : VideoCodec::h264,
                             format);
}

}  // namespace penumbra
