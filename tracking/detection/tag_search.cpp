#include "tracking/detection/tag_search.hpp"

#include <cmath>
#include <cstddef>

#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

std::array<std::uint8_t, 256> linearising_table(double exponent) {
  std::array<std::uint8_t, 256> table{};
  for (std::size_t i = 0; i < table.size(); ++i) {
    table[i] = static_cast<std::uint8_t>(
        std::lround(255.0 * std::pow(static_cast<double>(i) / 255.0, exponent)));
  }
  return table;
}

float decimation(SearchResolution resolution) {
  return resolution == SearchResolution::quarter ? 4.0F
         : resolution == SearchResolution::half  ? 2.0F
                                                 : 1.0F;
}

}  // namespace

Result<TagSearch> TagSearch::create(std::span<const TagFamily> families,
                                    std::optional<double> tone_exponent) {
  PENUMBRA_TRY(TagDetector detector, TagDetector::create(families));
  TagSearch search(std::move(detector));
  if (tone_exponent) search.linearise_ = linearising_table(*tone_exponent);
  return search;
}

void TagSearch::begin(const Frame& frame) {
  begin(frame.empty() ? ImageView() : penumbra::luma(frame, luma_scratch_));
}

void TagSearch::begin(ImageView luma) {
  image_ = luma;
  searched_at_.reset();
  found_.clear();
}

ImageView TagSearch::in_linear_light(ImageView image) {
  if (!linearise_) return image;
  const auto width = static_cast<std::size_t>(image.width);
  linear_scratch_.resize(width * static_cast<std::size_t>(image.height));
  for (int y = 0; y < image.height; ++y) {
    const std::uint8_t* in = image.row(y);
    std::uint8_t* out = linear_scratch_.data() + static_cast<std::size_t>(y) * width;
    for (std::size_t x = 0; x < width; ++x) out[x] = (*linearise_)[in[x]];
  }
  return {linear_scratch_.data(), image.width, image.height, image.width};
}

const std::vector<TagDetection>& TagSearch::tags(SearchResolution resolution) {
  if (searched(resolution)) return found_;
  searched_at_ = resolution;
  found_ = detector_.detect(in_linear_light(image_), decimation(resolution));
  return found_;
}

std::vector<TagDetection> TagSearch::tags_within(const PixelBox& box) {
  PENUMBRA_ASSERT(box.x >= 0 && box.y >= 0 && box.width > 0 && box.height > 0 &&
                  box.x + box.width <= image_.width && box.y + box.height <= image_.height);
  const ImageView part = {image_.row(box.y) + box.x, box.width, box.height, image_.stride};
  std::vector<TagDetection> tags =
      detector_.detect(in_linear_light(part), decimation(SearchResolution::half));
  for (TagDetection& tag : tags) {
    for (Eigen::Vector2d& corner : tag.corners_px) corner += Eigen::Vector2d(box.x, box.y);
  }
  return tags;
}

}  // namespace penumbra
