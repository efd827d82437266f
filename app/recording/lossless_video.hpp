// Frames as captured -> Matroska with FFV1, whole after every frame.
#pragma once

#include <filesystem>
#include <memory>

#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

class LosslessVideo {
 public:
  // For frames like `first`: its size, format and colours.
  [[nodiscard]] static Result<LosslessVideo> create(const std::filesystem::path& file,
                                                    const Frame& first);
  LosslessVideo(LosslessVideo&&) noexcept;
  LosslessVideo& operator=(LosslessVideo&&) noexcept;
  ~LosslessVideo();

  // The frame is in the file when this returns. YUYV and NV12 are sorted into planes: every sample
  // stays as it is.
  [[nodiscard]] Result<void> write(const Frame& frame);
  // Writes the index; a file without it reads as well.
  [[nodiscard]] Result<void> finish();

 private:
  struct Impl;
  explicit LosslessVideo(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
