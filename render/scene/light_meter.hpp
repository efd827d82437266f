// Measures brightness and colour of the light in a video, for drawing into it. Equal frames give
// equal light, bit for bit.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "core/image/frame.hpp"

namespace penumbra {

// Linear light per channel, > 0; 1 for the video's full white.
struct VideoLight {
  // Radiance of a perfect white diffuser on the table. Estimated from the brightest exposed pixels,
  // which show paper: a sheet of tags is in view whenever anything is drawn.
  Eigen::Vector3d on_table = Eigen::Vector3d::Ones();
  // Mean of the image: the light reflected by the table and the things on it.
  Eigen::Vector3d around = Eigen::Vector3d::Constant(0.5);
};

inline constexpr double kPaperReflectance = 0.8;  // white office paper
// Even grid of the pixels that are measured.
inline constexpr int kLightColumns = 64;
inline constexpr int kLightRows = 48;

// `tone_curve`: as CameraParameters::tone_curve; without it the video is taken as sRGB. The frame
// is not empty.
[[nodiscard]] VideoLight measure_light(const Frame& frame, std::optional<double> tone_curve);

// Low-pass filter over a video's frames: follows light and exposure within half a second.
class LightMeter {
 public:
  explicit LightMeter(std::optional<double> tone_curve) : tone_curve_(tone_curve) {}

  // Takes frames in order of time. The first frame, an earlier one and a much later one start the
  // filter again; the same frame again changes nothing.
  const VideoLight& look_at(const Frame& frame);

 private:
  std::optional<double> tone_curve_;
  std::optional<std::int64_t> last_ns_;
  VideoLight light_;
};

}  // namespace penumbra
