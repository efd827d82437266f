// Searches a frame for tags once and shares the result among all groups of tags.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

// Resolution of the quad search relative to the image, coarse to fine.
enum class SearchResolution { quarter, half, full };

// Region of the image [px].
struct PixelBox {
  int x = 0, y = 0, width = 0, height = 0;
};

class TagSearch {
 public:
  // `tone_exponent`: linear light = (grey / 255) ^ exponent; nullopt: searches the captured luma.
  [[nodiscard]] static Result<TagSearch> create(std::span<const TagFamily> families,
                                                std::optional<double> tone_exponent);

  // Begins a frame. The caller must keep its pixels until the search ends.
  void begin(const Frame& frame);
  void begin(ImageView luma);
  // Returns the captured luma.
  [[nodiscard]] ImageView image() const { return image_; }
  // Returns true if the frame was searched at this resolution or a finer one.
  [[nodiscard]] bool searched(SearchResolution resolution = SearchResolution::quarter) const {
    return searched_at_ && *searched_at_ >= resolution;
  }
  // Returns the tags found at this resolution, or at a finer resolution that was searched already.
  [[nodiscard]] const std::vector<TagDetection>& tags(SearchResolution resolution);
  // Returns the tags completely inside `box`, at half resolution; tags() does not return these.
  [[nodiscard]] std::vector<TagDetection> tags_within(const PixelBox& box);

 private:
  [[nodiscard]] ImageView in_linear_light(ImageView image);

  explicit TagSearch(TagDetector detector) : detector_(std::move(detector)) {}

  TagDetector detector_;
  std::optional<std::array<std::uint8_t, 256>> linearise_;
  std::vector<std::uint8_t> luma_scratch_;
  std::vector<std::uint8_t> linear_scratch_;
  ImageView image_;
  std::optional<SearchResolution> searched_at_;
  std::vector<TagDetection> found_;
};

}  // namespace penumbra
