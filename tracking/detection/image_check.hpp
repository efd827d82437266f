// Detects images in which no tag is found because they are mirrored or negative.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

enum class ImageFault { mirrored, negative, mirrored_negative };

// "mirrored", ...
[[nodiscard]] std::string_view to_string(ImageFault fault);
// Message for users: the fault and its remedy.
[[nodiscard]] std::string_view advice(ImageFault fault);

// Looks for the map's tags in mirrored and inverted copies of images in which nothing was found.
// Only the 1st, 2nd, 4th, 8th ... such image is checked, up to the kLastLook-th. Nothing is tracked
// from such a copy.
class ImageCheck {
 public:
  static constexpr std::uint64_t kLastLook = 1024;

  [[nodiscard]] static Result<ImageCheck> create(const TagMap& tags);
  ImageCheck(ImageCheck&&) noexcept;
  ImageCheck& operator=(ImageCheck&&) noexcept;
  ~ImageCheck();

  // Takes an image in which none of the tags was found. Returns a fault once.
  [[nodiscard]] std::optional<ImageFault> nothing_found(ImageView luma);
  // Checks one image, whatever came before it.
  [[nodiscard]] std::optional<ImageFault> look(ImageView luma);

 private:
  struct Impl;
  explicit ImageCheck(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
