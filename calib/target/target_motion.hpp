// Estimates the row time of a rolling shutter from a moving calibration target.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "calib/survey/row_time.hpp"
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "core/camera/camera_model.hpp"
#include "core/geometry/tag_map.hpp"

namespace penumbra {

class TargetMotion {
 public:
  explicit TargetMotion(const Target& target);

  // Keeps the corners of an image. Images must be in order of time; others, and those after
  // kMaxImages, are ignored.
  void add(std::int64_t timestamp_ns, std::span<const TargetCorner> corners);
  static constexpr std::size_t kMaxImages = 4096;

  // Returns the row time that the images show with this lens; nullopt if they show none. See
  // docs/calibration.md#row-time.
  [[nodiscard]] std::optional<RowTime> row_time(const CameraModel& camera) const;

 private:
  struct Image {
    std::int64_t timestamp_ns = 0;
    std::vector<TargetCorner> corners;
  };
  // Four points of the target that form a square: a tag, or inner corners of a chessboard.
  struct Square {
    MappedTag tag;  // only pose and size
    std::array<int, 4> points{};
  };
  [[nodiscard]] std::optional<MapFromCamera> pose_of(const CameraModel& camera,
                                                     const Image& image) const;
  [[nodiscard]] std::vector<TagCorners> corners_of(const Image& image) const;

  std::vector<Eigen::Vector3d> points_;
  std::vector<Square> squares_;
  std::vector<Image> images_;
};

}  // namespace penumbra
