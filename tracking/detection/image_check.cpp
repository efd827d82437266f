#include "tracking/detection/image_check.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <set>
#include <utility>
#include <vector>

#include "core/propagate.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kFewestTags = 2;  // one alone may be chance, unless the map has no more
constexpr int kLargePixels = 500'000;   // above, quads are searched at half the resolution

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
  switch (fault) {
    case ImageFault::mirrored:
      return "mirrored";
    case ImageFault::negative:
      return "negative";
    case ImageFault::mirrored_negative:
      break;
  }
  return "mirrored and negative";
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

struct ImageCheck::Impl {
  TagMap tags;
  TagDetector detector;
  std::uint64_t images_without_tags = 0;
  bool done = false;

  [[nodiscard]] bool finds_tags(ImageView luma) {
    std::set<std::pair<TagFamily, int>> seen;
    const float decimate = luma.width * luma.height > kLargePixels ? 2.0F : 1.0F;
    for (const TagDetection& detection : detector.detect(luma, decimate)) {
      if (tags.find(detection.family, detection.id) != nullptr) {
        seen.emplace(detection.family, detection.id);
      }
    }
    return seen.size() >= std::min(kFewestTags, tags.tags().size());
  }
};

ImageCheck::ImageCheck(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ImageCheck::ImageCheck(ImageCheck&&) noexcept = default;
ImageCheck& ImageCheck::operator=(ImageCheck&&) noexcept = default;
ImageCheck::~ImageCheck() = default;

Result<ImageCheck> ImageCheck::create(const TagMap& tags) {
  PENUMBRA_TRY(auto detector, TagDetector::create(tags.families()));
  return ImageCheck(std::make_unique<Impl>(Impl{tags, std::move(detector)}));
}

std::optional<ImageFault> ImageCheck::nothing_found(ImageView luma) {
  Impl& self = *impl_;
  if (self.done || luma.empty()) return std::nullopt;
  ++self.images_without_tags;
  if (self.images_without_tags >= kLastLook) self.done = true;
  if (!std::has_single_bit(self.images_without_tags)) return std::nullopt;
  const auto fault = look(luma);
  if (fault) self.done = true;
  return fault;
}

std::optional<ImageFault> ImageCheck::look(ImageView luma) {
  if (luma.empty()) return std::nullopt;
  for (const Copy& copy : kCopies) {
    const std::vector<std::uint8_t> pixels = copy_of(luma, copy);
    if (impl_->finds_tags({pixels.data(), luma.width, luma.height, luma.width})) return copy.fault;
  }
  return std::nullopt;
}

}  // namespace penumbra
