#include "tracking/tag_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>

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

}  // namespace

Result<TagSearch> TagSearch::create(std::span<const TagFamily> families,
                                    const TagDetectorOptions& options,
                                    std::optional<double> tone_exponent) {
  Result<TagDetector> full = TagDetector::create(families, options);
  if (!full) return tl::unexpected(full.error());
  TagDetectorOptions half_options = options;
  half_options.quad_decimate = std::max(options.quad_decimate, 2.0F);
  Result<TagDetector> half = TagDetector::create(families, half_options);
  if (!half) return tl::unexpected(half.error());
  TagSearch search(std::move(*full), std::move(*half));
  if (tone_exponent) search.linearise_ = linearising_table(*tone_exponent);
  return search;
}

void TagSearch::begin(const Frame& frame) {
  image_ = frame.empty() ? ImageView() : luma(frame, luma_scratch_);
  searched_ = false;
  found_.clear();
}

const std::vector<TagDetection>& TagSearch::tags(SearchResolution resolution) {
  if (searched_) return found_;
  searched_ = true;
  ImageView image = image_;
  if (linearise_) {
    const auto width = static_cast<std::size_t>(image.width);
    linear_scratch_.resize(width * static_cast<std::size_t>(image.height));
    for (int y = 0; y < image.height; ++y) {
      const std::uint8_t* in = image.row(y);
      std::uint8_t* out = linear_scratch_.data() + static_cast<std::size_t>(y) * width;
      for (std::size_t x = 0; x < width; ++x) out[x] = (*linearise_)[in[x]];
    }
    image = {linear_scratch_.data(), image.width, image.height, image.width};
  }
  found_ = (resolution == SearchResolution::half ? half_ : full_).detect(image);
  return found_;
}

}  // namespace penumbra
