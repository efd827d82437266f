// The tags of a frame, searched for once however many groups of tags ask.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "core/frame.hpp"
#include "core/image_view.hpp"
#include "core/tag_map.hpp"
#include "tracking/tag_detector.hpp"

namespace penumbra {

enum class SearchResolution { full, half };  // half: quads are searched at half the resolution

class TagSearch {
 public:
  // `tone_exponent`: linear light = (grey / 255) ^ exponent, where it is known; tags are then
  // searched for in linear light, because a tone curve makes white bleed into black and moves every
  // edge into the tag.
  [[nodiscard]] static Result<TagSearch> create(std::span<const TagFamily> families,
                                                const TagDetectorOptions& options,
                                                std::optional<double> tone_exponent);

  // The frame that is searched from here on; its pixels must outlive the search.
  void begin(const Frame& frame);
  // The frame's luma as it was captured.
  [[nodiscard]] ImageView image() const { return image_; }
  // Whether the frame was searched already: asking again costs nothing.
  [[nodiscard]] bool searched() const { return searched_; }
  // The first who asks says at which resolution; the others get what was found for it.
  [[nodiscard]] const std::vector<TagDetection>& tags(SearchResolution resolution);

 private:
  TagSearch(TagDetector full, TagDetector half) : full_(std::move(full)), half_(std::move(half)) {}

  TagDetector full_;
  TagDetector half_;
  std::optional<std::array<std::uint8_t, 256>> linearise_;
  std::vector<std::uint8_t> luma_scratch_;
  std::vector<std::uint8_t> linear_scratch_;
  ImageView image_;
  bool searched_ = false;
  std::vector<TagDetection> found_;
};

}  // namespace penumbra
