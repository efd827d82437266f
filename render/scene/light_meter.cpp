#include "render/scene/light_meter.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "core/assert.hpp"
#include "render/scene/yuv_conversion.hpp"

namespace penumbra {
namespace {

constexpr int kCodes = 256;
constexpr int kOverexposed = 250;             // channels with this value or more may be clipped
constexpr double kPaperFrom = 0.95;           // quantile of the luminance of exposed pixels
constexpr double kPaperTo = 0.99;             // brighter pixels are glints
constexpr double kMinExposedFraction = 0.25;  // below, overexposed pixels are used as well
constexpr double kDarkest = 1e-3;             // lower limit of results: the noise level
constexpr double kTimeConstant_s = 0.25;
constexpr double kForgotten_s = 2.0;  // the filter restarts after a longer gap

// Returns the linear light of each 8-bit value.
std::array<double, kCodes> linear_light(std::optional<double> tone_curve) {
  std::array<double, kCodes> linear{};
  for (int code = 0; code < kCodes; ++code) {
    const double v = code / 255.0;
    linear[static_cast<std::size_t>(code)] =
        tone_curve ? std::pow(v, *tone_curve)
                   : (v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4));
  }
  return linear;
}

using Rgb = std::array<int, 3>;  // 8-bit values, as displayed

class PixelReader {
 public:
  explicit PixelReader(const Frame& frame)
      : frame_(frame), conversion_(yuv_conversion(frame.color_matrix, frame.color_range)) {}

  [[nodiscard]] Rgb at(int x, int y) const {
    switch (frame_.format) {
      case PixelFormat::rgb24: {
        const std::uint8_t* p = texel(0, x, y, 3);
        return {p[0], p[1], p[2]};
      }
      case PixelFormat::yuyv: {
        const std::uint8_t* p = texel(0, x / 2, y, 4);
        return shown((x & 1) == 0 ? p[0] : p[2], p[1], p[3]);
      }
      case PixelFormat::nv12: {
        const std::uint8_t* uv = texel(1, x / 2, y / 2, 2);
        return shown(*texel(0, x, y, 1), uv[0], uv[1]);
      }
      case PixelFormat::yuv420p:
      case PixelFormat::yuv422p:
      case PixelFormat::yuv444p: {
        const int u = frame_.format == PixelFormat::yuv444p ? x : x / 2;
        const int v = frame_.format == PixelFormat::yuv420p ? y / 2 : y;
        return shown(*texel(0, x, y, 1), *texel(1, u, v, 1), *texel(2, u, v, 1));
      }
      case PixelFormat::grey8:
        break;
    }
    constexpr int kNoColour = 128;
    return shown(*texel(0, x, y, 1), kNoColour, kNoColour);
  }

 private:
  [[nodiscard]] const std::uint8_t* texel(std::size_t plane, int x, int y, int bytes) const {
    const PixelPlane& p = frame_.planes[plane];
    // The last chroma sample of an odd size may be absent.
    const int column = std::min(x, p.width - 1);
    const int row = std::min(y, p.height - 1);
    return p.data + row * p.stride + std::ptrdiff_t{column} * bytes;
  }
  [[nodiscard]] Rgb shown(int y, int u, int v) const {
    const glm::vec3 yuv(static_cast<float>(y), static_cast<float>(u), static_cast<float>(v));
    const glm::vec3 rgb = conversion_.rgb_from_yuv * (yuv - 255.0F * conversion_.offset);
    const auto code = [&rgb](int c) {
      return std::clamp(static_cast<int>(std::lround(rgb[c])), 0, kCodes - 1);
    };
    return {code(0), code(1), code(2)};
  }

  const Frame& frame_;
  YuvConversion conversion_;
};

// Sums of linear colours per luma.
struct Histogram {
  std::array<int, kCodes> count{};
  std::array<Eigen::Vector3d, kCodes> sum;
  int total = 0;

  Histogram() { sum.fill(Eigen::Vector3d::Zero()); }
  void add(const Rgb& rgb, const Eigen::Vector3d& light) {
    // BT.601 luma, coefficients * 256.
    const auto bin = static_cast<std::size_t>((77 * rgb[0] + 150 * rgb[1] + 29 * rgb[2]) / 256);
    ++count[bin];
    sum[bin] += light;
    ++total;
  }
  // Returns the mean colour between two quantiles of luma. Bins at the limits count partially.
  [[nodiscard]] Eigen::Vector3d mean_between(double from, double to) const {
    const double first = from * total;
    const double last = to * total;
    Eigen::Vector3d light = Eigen::Vector3d::Zero();
    double weight = 0.0;
    double before = 0.0;
    for (std::size_t bin = 0; bin < count.size(); ++bin) {
      if (count[bin] == 0) continue;
      const double after = before + count[bin];
      const double inside = std::min(after, last) - std::max(before, first);
      if (inside > 0.0) {
        light += inside / count[bin] * sum[bin];
        weight += inside;
      }
      before = after;
    }
    return light / weight;
  }
};

}  // namespace

VideoLight measure_light(const Frame& frame, std::optional<double> tone_curve) {
  PENUMBRA_ASSERT(!frame.empty());
  const std::array<double, kCodes> linear = linear_light(tone_curve);
  const PixelReader pixels(frame);
  Histogram exposed;
  Histogram all;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int row = 0; row < kLightRows; ++row) {
    const int y = (2 * row + 1) * frame.height / (2 * kLightRows);
    for (int column = 0; column < kLightColumns; ++column) {
      const Rgb rgb = pixels.at((2 * column + 1) * frame.width / (2 * kLightColumns), y);
      const auto light_of = [&](std::size_t c) { return linear[static_cast<std::size_t>(rgb[c])]; };
      const Eigen::Vector3d light(light_of(0), light_of(1), light_of(2));
      sum += light;
      all.add(rgb, light);
      if (std::ranges::max(rgb) < kOverexposed) exposed.add(rgb, light);
    }
  }
  const Histogram& used = exposed.total >= kMinExposedFraction * all.total ? exposed : all;
  VideoLight light;
  light.around = (sum / all.total).cwiseMax(kDarkest);
  light.on_table = (used.mean_between(kPaperFrom, kPaperTo) / kPaperReflectance).cwiseMax(kDarkest);
  return light;
}

const VideoLight& LightMeter::measure(const Frame& frame) {
  if (last_ns_ == frame.timestamp_ns) return light_;
  const VideoLight now = measure_light(frame, tone_curve_);
  const double elapsed_s =
      last_ns_ ? 1e-9 * static_cast<double>(frame.timestamp_ns - *last_ns_) : kForgotten_s;
  last_ns_ = frame.timestamp_ns;
  if (elapsed_s < 0.0 || elapsed_s >= kForgotten_s) return light_ = now;
  // Filters the logarithm, which follows dark and bright changes equally fast.
  const double share = 1.0 - std::exp(-elapsed_s / kTimeConstant_s);
  const auto follow = [share](Eigen::Vector3d& light, const Eigen::Vector3d& target) {
    light = light.array() * (share * (target.array() / light.array()).log()).exp();
  };
  follow(light_.on_table, now.on_table);
  follow(light_.around, now.around);
  return light_;
}

}  // namespace penumbra
