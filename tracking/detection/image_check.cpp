#include "tracking/detection/image_check.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <set>
#include <vector>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMinTags = 2;    // 1 if the map has only one tag; one detection may be false
constexpr int kLargePixels = 500'000;  // larger images are searched at half resolution

struct Copy {
  ImageFault fault;
  bool mirrored;
  bool inverted;
};
constexpr std::array kCopies = {Copy{ImageFault::mirrored, true, false},
                                Copy{ImageFault::negative, false, true},
                                Copy{ImageFault::mirrored_negative, true, true}};

std::vector<std::uint8_t> copy_of(ImageView luma, const Copy& copy) {
  const auto width = static_cast<std::size_t>(luma.width);
  std::vector<std::uint8_t> pixels(width * static_cast<std::size_t>(luma.height));
  for (int y = 0; y < luma.height; ++y) {
    std::uint8_t* out = pixels.data() + width * static_cast<std::size_t>(y);
    if (copy.mirrored) {
      std::reverse_copy(luma.row(y), luma.row(y) + width, out);
    } else {
      std::copy_n(luma.row(y), width, out);
    }
  }
  if (copy.inverted) {
    for (std::uint8_t& value : pixels) value = static_cast<std::uint8_t>(255 - value);
  }
  return pixels;
}

}  // namespace

std::string_view to_string(ImageFault fault) {
  return fault == ImageFault::mirrored   ? "mirrored"
         : fault == ImageFault::negative ? "negative"
                                         : "mirrored and negative";
}

std::string_view advice(ImageFault fault) {
  switch (fault) {
    case ImageFault::mirrored:
      return "the images are mirrored: switch off the camera's mirror or selfie mode";
    case ImageFault::negative:
      return "the images are negative (white tags on black): print the sheet black on white, or "
             "switch off the camera's inversion";
    case ImageFault::mirrored_negative:
      break;
  }
  return "the images are mirrored and negative (white tags on black): switch off the camera's "
         "mirror mode and its inversion";
}

Result<ImageCheck> ImageCheck::create(const TagMap& tags) {
  PENUMBRA_TRY(TagDetector detector, TagDetector::create(tags.families()));
  return ImageCheck(tags, std::move(detector));
}

bool ImageCheck::finds_tags(ImageView luma) {
  std::set<std::pair<TagFamily, int>> seen;
  const float decimate = luma.width * luma.height > kLargePixels ? 2.0F : 1.0F;
  for (const TagDetection& detection : detector_.detect(luma, decimate)) {
    if (tags_.find(detection.family, detection.id) != nullptr)
      seen.emplace(detection.family, detection.id);
  }
  return seen.size() >= std::min(kMinTags, tags_.tags().size());
}

std::optional<ImageFault> ImageCheck::check_untagged(ImageView luma) {
  if (done_ || luma.empty()) return std::nullopt;
  ++images_without_tags_;
  done_ = images_without_tags_ >= kMaxImages;
  if (!std::has_single_bit(images_without_tags_)) return std::nullopt;
  const auto fault = find_fault(luma);
  if (fault) done_ = true;
  return fault;
}

std::optional<ImageFault> ImageCheck::find_fault(ImageView luma) {
  if (luma.empty()) return std::nullopt;
  for (const Copy& copy : kCopies) {
    const std::vector<std::uint8_t> pixels = copy_of(luma, copy);
    if (finds_tags({pixels.data(), luma.width, luma.height, luma.width})) return copy.fault;
  }
  return std::nullopt;
}

}  // namespace penumbra
