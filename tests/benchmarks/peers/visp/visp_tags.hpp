// ViSP's detector and pose in plain numbers. Its headers are C++17 at most, so nothing here may
// include ours.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

namespace penumbra::peers {

struct VispTag {
  int id = 0;
  std::array<std::array<double, 2>, 4> corners_px;  // as vpDetectorAprilTag gives them
};

class VispTags {
 public:
  explicit VispTags(float quad_decimate);
  VispTags(const VispTags&) = delete;
  VispTags& operator=(const VispTags&) = delete;
  ~VispTags();

  // Rows without padding.
  [[nodiscard]] std::vector<VispTag> detect(const std::uint8_t* luma, int width, int height);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

struct VispPoint {
  std::array<double, 3> object;
  std::array<double, 2> ray;  // x / z, y / z, without distortion
};
// Camera from object, 3x4, row by row.
[[nodiscard]] std::optional<std::array<double, 12>> visp_pose(const std::vector<VispPoint>& points);

}  // namespace penumbra::peers
