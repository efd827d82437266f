// Writes captured frames to a Matroska file with FFV1. The file can be read after every frame.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "app/libav.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

class LosslessVideo {
 public:
  // Creates a file for frames of the size, format and colours of `first`.
  [[nodiscard]] static Result<LosslessVideo> create(const std::filesystem::path& file,
                                                    const Frame& first);
  // The frame is in the file when this returns. YUYV and NV12 are converted losslessly to planes.
  [[nodiscard]] Result<void> write(const Frame& frame);
  // Writes the index. A file without an index is readable, too.
  [[nodiscard]] Result<void> finish();

 private:
  [[nodiscard]] Result<void> open(const Frame& first);
  [[nodiscard]] Result<void> encode();
  [[nodiscard]] tl::unexpected<Error> failed(const char* what, int error) const;

  std::string name_;
  PixelFormat format_ = PixelFormat::grey8;
  AvEncoding av_;
  std::int64_t first_ns_ = 0;
  std::int64_t last_pts_ = -1;
};

}  // namespace penumbra
