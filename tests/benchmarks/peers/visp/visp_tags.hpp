// ViSP's detector and pose estimation with plain numbers. ViSP's headers need C++17 or older, so
// this file must not include headers of the project.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace penumbra::peers {

struct VispTag {
  int id = 0;
  std::array<std::array<double, 2>, 4> corners_px;  // in the order of vpDetectorAprilTag
};

class VispTags {
 public:
  explicit VispTags(float quad_decimate);
  VispTags(const VispTags&) = delete;
  VispTags& operator=(const VispTags&) = delete;
  ~VispTags();

  // `luma` has no padding between rows.
  [[nodiscard]] std::vector<VispTag> detect(const std::uint8_t* luma, int width, int height);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct VispPoint {
  std::array<double, 3> object;
  std::array<double, 2> ray;  // x / z and y / z, undistorted
};
// Returns the pose of the object in the camera frame, 3x4, row-major.
[[nodiscard]] std::optional<std::array<double, 12>> visp_pose(const std::vector<VispPoint>& points);

}  // namespace penumbra::peers
