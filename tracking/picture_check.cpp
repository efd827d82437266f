#include "tracking/picture_check.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <set>
#include <utility>
#include <vector>

#include "tracking/tag_detector.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kFewestTags = 2;  // one alone may be chance, unless the map has no more
constexpr int kLargePixels = 500'000;   // above, quads are searched at half the resolution

struct Copy {
  PictureFault fault;
  bool mirrored;
  bool inverted;
};
constexpr std::array kCopies = {Copy{PictureFault::mirrored, true, false},
                                Copy{PictureFault::negative, false, true},
                                Copy{PictureFault::mirrored_negative, true, true}};

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

std::string_view to_string(PictureFault fault) {
  switch (fault) {
    case PictureFault::mirrored:
      return "mirrored";
    case PictureFault::negative:
      return "negative";
    case PictureFault::mirrored_negative:
      break;
  }
  return "mirrored and negative";
}

std::string_view advice(PictureFault fault) {
  switch (fault) {
    case PictureFault::mirrored:
      return "the images are mirrored: switch off the camera's mirror or selfie mode";
    case PictureFault::negative:
      return "the images are negative (white tags on black): print the sheet black on white, or "
             "switch off the camera's inversion";
    case PictureFault::mirrored_negative:
      break;
  }
  return "the images are mirrored and negative (white tags on black): switch off the camera's "
         "mirror mode and its inversion";
}

struct PictureCheck::Impl {
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

PictureCheck::PictureCheck(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PictureCheck::PictureCheck(PictureCheck&&) noexcept = default;
PictureCheck& PictureCheck::operator=(PictureCheck&&) noexcept = default;
PictureCheck::~PictureCheck() = default;

Result<PictureCheck> PictureCheck::create(const TagMap& tags) {
  auto detector = TagDetector::create(tags.families());
  if (!detector) return tl::unexpected(detector.error());
  return PictureCheck(std::make_unique<Impl>(Impl{tags, std::move(*detector)}));
}

std::optional<PictureFault> PictureCheck::nothing_found(ImageView luma) {
  Impl& self = *impl_;
  if (self.done || luma.empty()) return std::nullopt;
  ++self.images_without_tags;
  if (self.images_without_tags >= kLastLook) self.done = true;
  if (!std::has_single_bit(self.images_without_tags)) return std::nullopt;
  for (const Copy& copy : kCopies) {
    const std::vector<std::uint8_t> pixels = copy_of(luma, copy);
    if (!self.finds_tags({pixels.data(), luma.width, luma.height, luma.width})) continue;
    self.done = true;
    return copy.fault;
  }
  return std::nullopt;
}

void PictureCheck::found() {
  impl_->done = true;
}

}  // namespace penumbra
