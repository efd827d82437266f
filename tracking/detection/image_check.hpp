// Detects mirrored or negative images. A tag detector finds no tags in such images.
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

// Returns the name of the fault, for example "mirrored".
[[nodiscard]] std::string_view to_string(ImageFault fault);
// Returns a message for users: the fault and its remedy.
[[nodiscard]] std::string_view advice(ImageFault fault);

// Searches for the map's tags in mirrored and inverted copies of images without tags. To limit the
// cost, checks only the 1st, 2nd, 4th, 8th ... image without tags, up to number kMaxImages.
class ImageCheck {
 public:
  static constexpr std::uint64_t kMaxImages = 1024;

  [[nodiscard]] static Result<ImageCheck> create(const TagMap& tags);

  // Call for each image in which no tag was found. Returns a fault once.
  [[nodiscard]] std::optional<ImageFault> check_untagged(ImageView luma);
  // Checks an image without counting it.
  [[nodiscard]] std::optional<ImageFault> find_fault(ImageView luma);

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
