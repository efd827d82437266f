#include "app/output/frame_writer.hpp"

#include "core/text/text.hpp"

namespace penumbra {

OutputKind output_kind(const std::filesystem::path& path) {
  const std::string extension = lower_extension(path);
  if (extension == ".mkv") return OutputKind::ffv1;
  return extension == ".mp4" ? OutputKind::h264 : OutputKind::folder;
}

Result<std::unique_ptr<FrameWriter>> create_frame_writer(const std::filesystem::path& path,
                                                         const FrameFormat& format) {
  const OutputKind kind = output_kind(path);
  return kind == OutputKind::folder ? create_png_writer(path, format)
                                    : create_video_writer(path, kind, format);
}

}  // namespace penumbra
