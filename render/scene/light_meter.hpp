// How bright and of what colour the light in a video is, so that what is drawn into it neither
// glows nor drowns. Of the pixels alone; the same frames give the same light, bit for bit.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "core/image/frame.hpp"

namespace penumbra {

// Linear light, 1 where the video is encoded as full white; by channel, all > 0.
struct VideoLight {
  // What white matt paper that lies on the table would show if it reflected all light: the
  // brightest of what is not overexposed, taken for paper. A sheet of tags is in view whenever
  // anything is drawn.
  Eigen::Vector3d on_table = Eigen::Vector3d::Ones();
  // The mean of the picture: what the table and the things on it reflect.
  Eigen::Vector3d around = Eigen::Vector3d::Constant(0.5);
};

// Of white office paper.
inline constexpr double kPaperReflectance = 0.8;
// Pixels that a frame's light is measured from, on an even grid.
inline constexpr int kLightColumns = 64;
inline constexpr int kLightRows = 48;

// `tone_curve`: as CameraParameters::tone_curve; without it the video is taken as sRGB. The frame
// is not empty.
[[nodiscard]] VideoLight measure_light(const Frame& frame, std::optional<double> tone_curve);

// Over the frames of a video: follows a change of light or exposure within half a second, and noise
// not at all.
class LightMeter {
 public:
  explicit LightMeter(std::optional<double> tone_curve) : tone_curve_(tone_curve) {}

  // In order of time. The first frame, and one that is earlier than the one before or much later,
  // is taken as it is; one that was looked at before changes nothing.
  const VideoLight& look_at(const Frame& frame);

 private:
  std::optional<double> tone_curve_;
  std::optional<std::int64_t> last_ns_;
  VideoLight light_;
};

}  // namespace penumbra
