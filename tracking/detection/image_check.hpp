// Detects images in which no tag is found because they are mirrored or negative.
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>
#include <utility>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

enum class ImageFault { mirrored, negative, mirrored_negative };

// "mirrored", ...
[[nodiscard]] std::string_view to_string(ImageFault fault);
// Message for users: the fault and its remedy.
[[nodiscard]] std::string_view advice(ImageFault fault);

// Searches mirrored and inverted copies of images without tags for the map's tags. Checks only the
// 1st, 2nd, 4th, 8th ... such image, up to the kLastLook-th.
class ImageCheck {
 public:
  static constexpr std::uint64_t kLastLook = 1024;

  [[nodiscard]] static Result<ImageCheck> create(const TagMap& tags);

  // Takes an image in which none of the tags was found. Returns a fault once.
  [[nodiscard]] std::optional<ImageFault> nothing_found(ImageView luma);
  // Checks one image; does not count it.
  [[nodiscard]] std::optional<ImageFault> look(ImageView luma);

 private:
  ImageCheck(TagMap tags, TagDetector detector)
      : tags_(std::move(tags)), detector_(std::move(detector)) {}
  [[nodiscard]] bool finds_tags(ImageView luma);

  TagMap tags_;
  TagDetector detector_;
  std::uint64_t images_without_tags_ = 0;
  bool done_ = false;
};

}  // namespace penumbra
