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

float decimation(SearchResolution resolution) {
  switch (resolution) {
    case SearchResolution::quarter:
      return 4.0F;
    case SearchResolution::half:
      return 2.0F;
    case SearchResolution::full:
      break;
  }
  return 1.0F;
}

}  // namespace

Result<TagSearch> TagSearch::create(std::span<const TagFamily> families,
                                    const TagDetectorOptions& options,
                                    std::optional<double> tone_exponent) {
  Result<TagDetector> detector = TagDetector::create(families, options);
  if (!detector) return tl::unexpected(detector.error());
  TagSearch search(std::move(*detector), options.quad_decimate);
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

const std::vector<TagDetection>& TagSearch::tags(SearchResolution resolution) {
  if (searched(resolution)) return found_;
  searched_at_ = resolution;
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
  found_ = detector_.detect(image, std::max(least_decimate_, decimation(resolution)));
  return found_;
}

}  // namespace penumbra
