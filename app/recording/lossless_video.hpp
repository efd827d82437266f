// Frames as captured -> Matroska with FFV1, complete after every frame.
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
  // For frames like `first`: its size, format and colours.
  [[nodiscard]] static Result<LosslessVideo> create(const std::filesystem::path& file,
                                                    const Frame& first);
  // The frame is in the file when this returns. YUYV and NV12 are stored as planes, sample by
  // sample.
  [[nodiscard]] Result<void> write(const Frame& frame);
  // Writes the index; a file without it can be read, too.
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
