// Measures the corners of all tags in view independently of each other, at a known camera pose.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"
#include "tracking/evaluation/residual_causes.hpp"

namespace penumbra {

class TagCornerMeter {
 public:
  // Fails if a tag's id does not exist in its family.
  [[nodiscard]] static Result<TagCornerMeter> create(const CameraModel& camera,
                                                     std::span<const MappedTag> tags);
  TagCornerMeter(TagCornerMeter&&) noexcept;
  TagCornerMeter& operator=(TagCornerMeter&&) noexcept;
  ~TagCornerMeter();

  // Returns the indices of the tags that face the camera with all corners in the image.
  [[nodiscard]] std::vector<std::size_t> in_view(const MapFromCamera& pose) const;

  // Each tag is aligned alone from `pose`, so it may be displaced from the map by a few cells, and
  // then measured by measure_tag(). Tags that can't be read are omitted. `velocity`: as in
  // FrameCorners.
  [[nodiscard]] FrameCorners measure(ImageView luma, const MapFromCamera& pose,
                                     const Vector6d& velocity);

 private:
  struct Impl;
  explicit TagCornerMeter(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
