// The tags of a frame, searched for once however many groups of tags ask.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/frame.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

// Quads are searched at so much of the image's resolution, coarse to fine.
enum class SearchResolution { quarter, half, full };

// A part of the image [px].
struct PixelBox {
  int x = 0, y = 0, width = 0, height = 0;
};

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
  void begin(ImageView luma);
  // The frame's luma as it was captured.
  [[nodiscard]] ImageView image() const { return image_; }
  // Whether the frame was searched already.
  [[nodiscard]] bool searched() const { return searched_at_.has_value(); }
  // Whether it was at this resolution or a finer one: asking for it again costs nothing.
  [[nodiscard]] bool searched(SearchResolution resolution) const {
    return searched_at_ && *searched_at_ >= resolution;
  }
  // What was found at this resolution, or at a finer one that somebody asked for before. Valid
  // until a finer one is asked for.
  [[nodiscard]] const std::vector<TagDetection>& tags(SearchResolution resolution);
  // Those that lie wholly within a part of the frame, which must be inside of it, at half of the
  // resolution. Not what tags() then knows.
  [[nodiscard]] std::vector<TagDetection> tags_within(const PixelBox& box);

 private:
  [[nodiscard]] ImageView in_linear_light(ImageView image);

  TagSearch(TagDetector detector, float least_decimate)
      : detector_(std::move(detector)), least_decimate_(least_decimate) {}

  TagDetector detector_;
  float least_decimate_ = 1.0F;
  std::optional<std::array<std::uint8_t, 256>> linearise_;
  std::vector<std::uint8_t> luma_scratch_;
  std::vector<std::uint8_t> linear_scratch_;
  ImageView image_;
  std::optional<SearchResolution> searched_at_;
  std::vector<TagDetection> found_;
};

}  // namespace penumbra
