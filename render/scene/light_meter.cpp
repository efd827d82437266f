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
constexpr int kOverexposed = 250;       // from this code on a channel may have been clipped
constexpr double kPaperFrom = 0.95;     // of the pixels that are not overexposed, by luminance
constexpr double kPaperTo = 0.99;       // brighter ones are glints
constexpr double kLeastExposed = 0.25;  // of all pixels; else the overexposed ones count too
constexpr double kDarkest = 1e-3;       // light that noise can't be told from
constexpr double kTimeConstant_s = 0.25;
constexpr double kForgotten_s = 2.0;

// Code -> linear light.
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

struct Codes {
  std::array<int, 3> rgb{};
};

// One pixel's colour as it is shown, in codes.
class PixelReader {
 public:
  explicit PixelReader(const Frame& frame)
      : frame_(frame), conversion_(yuv_conversion(frame.color_matrix, frame.color_range)) {}

  [[nodiscard]] Codes at(int x, int y) const {
    switch (frame_.format) {
      case PixelFormat::rgb24: {
        const std::uint8_t* p = texel(0, x, y, 3);
        return {{p[0], p[1], p[2]}};
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
        return shown(*texel(0, x, y, 1), *texel(1, x / 2, y / 2, 1), *texel(2, x / 2, y / 2, 1));
      case PixelFormat::yuv422p:
        return shown(*texel(0, x, y, 1), *texel(1, x / 2, y, 1), *texel(2, x / 2, y, 1));
      case PixelFormat::yuv444p:
        return shown(*texel(0, x, y, 1), *texel(1, x, y, 1), *texel(2, x, y, 1));
      case PixelFormat::grey8:
        break;
    }
    constexpr int kNoColour = 128;
    return shown(*texel(0, x, y, 1), kNoColour, kNoColour);
  }

 private:
  [[nodiscard]] const std::uint8_t* texel(std::size_t plane, int x, int y, int bytes) const {
    const PixelPlane& p = frame_.planes[plane];
    // Of an odd size the last sample of chroma may be missing.
    const int column = std::min(x, p.width - 1);
    const int row = std::min(y, p.height - 1);
    return p.data + row * p.stride + std::ptrdiff_t{column} * bytes;
  }
  [[nodiscard]] Codes shown(int y, int u, int v) const {
    const glm::vec3 yuv(static_cast<float>(y), static_cast<float>(u), static_cast<float>(v));
    const glm::vec3 rgb = conversion_.rgb_from_yuv * (yuv - 255.0F * conversion_.offset);
    Codes codes;
    for (int c = 0; c < 3; ++c) {
      codes.rgb[static_cast<std::size_t>(c)] =
          std::clamp(static_cast<int>(std::lround(rgb[c])), 0, kCodes - 1);
    }
    return codes;
  }

  const Frame& frame_;
  YuvConversion conversion_;
};

// Colours summed up by how bright they are.
struct Histogram {
  std::array<int, kCodes> count{};
  std::array<Eigen::Vector3d, kCodes> sum;
  int total = 0;

  Histogram() { sum.fill(Eigen::Vector3d::Zero()); }
  void add(const Codes& codes, const Eigen::Vector3d& light) {
    // BT.601's luma, by 256ths.
    const auto bin = static_cast<std::size_t>(
        (77 * codes.rgb[0] + 150 * codes.rgb[1] + 29 * codes.rgb[2]) / 256);
    ++count[bin];
    sum[bin] += light;
    ++total;
  }
  // The mean colour of those between two shares of all, counted from the darkest; bins that are
  // partly in it count in part.
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
      const Codes codes = pixels.at((2 * column + 1) * frame.width / (2 * kLightColumns), y);
      const auto light_of = [&](std::size_t c) {
        return linear[static_cast<std::size_t>(codes.rgb[c])];
      };
      const Eigen::Vector3d light(light_of(0), light_of(1), light_of(2));
      sum += light;
      all.add(codes, light);
      if (*std::ranges::max_element(codes.rgb) < kOverexposed) exposed.add(codes, light);
    }
  }
  const Histogram& told = exposed.total >= kLeastExposed * all.total ? exposed : all;
  VideoLight light;
  light.around = (sum / all.total).cwiseMax(kDarkest);
  light.on_table = (told.mean_between(kPaperFrom, kPaperTo) / kPaperReflectance).cwiseMax(kDarkest);
  return light;
}

const VideoLight& LightMeter::look_at(const Frame& frame) {
  if (last_ns_ == frame.timestamp_ns) return light_;
  const VideoLight now = measure_light(frame, tone_curve_);
  const double elapsed_s =
      last_ns_ ? 1e-9 * static_cast<double>(frame.timestamp_ns - *last_ns_) : kForgotten_s;
  last_ns_ = frame.timestamp_ns;
  if (elapsed_s < 0.0 || elapsed_s >= kForgotten_s) {
    light_ = now;
    return light_;
  }
  // Ratios are what the eye sees: as fast to dark as to bright.
  const double share = 1.0 - std::exp(-elapsed_s / kTimeConstant_s);
  const auto follow = [share](Eigen::Vector3d& light, const Eigen::Vector3d& target) {
    light = light.array() * (share * (target.array() / light.array()).log()).exp();
  };
  follow(light_.on_table, now.on_table);
  follow(light_.around, now.around);
  return light_;
}

}  // namespace penumbra
