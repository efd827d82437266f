// Measures brightness and colour of the light in a video, to light virtual objects. Equal frames
// give bit for bit equal results.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "core/image/frame.hpp"

namespace penumbra {

// Linear light per channel, > 0; 1 is the video's full white.
struct VideoLight {
  // Radiance of a perfect white diffuser on the table. Estimated from the brightest pixels that are
  // not overexposed, which are paper, as tags are in view whenever objects are drawn.
  Eigen::Vector3d on_table = Eigen::Vector3d::Ones();
  // Mean of the image: the light reflected by the table and the objects on it.
  Eigen::Vector3d around = Eigen::Vector3d::Constant(0.5);
};

inline constexpr double kPaperReflectance = 0.8;  // white office paper
// Size of the regular grid of measured pixels.
inline constexpr int kLightColumns = 64;
inline constexpr int kLightRows = 48;

// `tone_curve`: CameraParameters::tone_curve; nullopt: sRGB. The frame must not be empty.
[[nodiscard]] VideoLight measure_light(const Frame& frame, std::optional<double> tone_curve);

// Low-pass filter over a video's frames with a response time of half a second.
class LightMeter {
 public:
  explicit LightMeter(std::optional<double> tone_curve) : tone_curve_(tone_curve) {}

  // Adds a frame and returns the filtered light. Expects ascending times: an earlier or much later
  // frame restarts the filter; a repeated frame has no effect.
  const VideoLight& measure(const Frame& frame);

 private:
  std::optional<double> tone_curve_;
  std::optional<std::int64_t> last_ns_;
  VideoLight light_;
};

}  // namespace penumbra
