#include "render/scene/video_rgba.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>

#include "render/scene/yuv_conversion.hpp"

namespace penumbra {
namespace {

// The loops below use 16-bit fixed point, because SSE2 and NEON multiply 8 such numbers at once and
// keep the upper halves of the products. A sum has kFraction fractional bits:
// (luma << kLumaShift) * luma coefficient >> 16, plus the same of chroma.
constexpr int kFraction = 5;
constexpr int kLumaShift = 7;    // 255 << 7 fits 16 bits
constexpr int kChromaShift = 8;  // -128 << 8 fits 16 bits
// Half a code, and the mean of what two products lose by rounding down. With one or three products
// (red and blue in full range, green in limited range) the mean error is 1/64 of a code.
constexpr std::int16_t kRounding = (1 << (kFraction - 1)) + 1;

YuvCoefficients coefficients_of(const Frame& frame) {
  const YuvConversion conversion = yuv_conversion(frame.color_matrix, frame.color_range);
  const auto scaled = [](float value, int shift) {
    return static_cast<std::int16_t>(
        std::lround(value * static_cast<float>(1 << (16 + kFraction - shift))));
  };
  const glm::mat3& m = conversion.rgb_from_yuv;
  return {scaled(m[0].r, kLumaShift),
          scaled(m[2].r, kChromaShift),
          scaled(m[1].g, kChromaShift),
          scaled(m[2].g, kChromaShift),
          scaled(m[1].b, kChromaShift),
          static_cast<std::int16_t>(std::lround(255.0F * conversion.offset.x))};
}

std::int16_t high_half(std::int16_t a, std::int16_t b) {
  return static_cast<std::int16_t>((static_cast<std::int32_t>(a) * b) >> 16);
}

std::int16_t centred(std::uint8_t chroma) {
  return static_cast<std::int16_t>((chroma - 128) * (1 << kChromaShift));
}

// Computes the contributions of `count` chroma samples to red, green and blue, with the rounding.
void add_chroma(const std::uint8_t* __restrict u, const std::uint8_t* __restrict v, int count,
                const YuvCoefficients& c, std::int16_t* __restrict red,
                std::int16_t* __restrict green, std::int16_t* __restrict blue) {
  const auto [luma, red_v, green_u, green_v, blue_u, offset] = c;
  for (int i = 0; i < count; ++i) {
    const std::int16_t at_u = centred(u[i]);
    const std::int16_t at_v = centred(v[i]);
    red[i] = static_cast<std::int16_t>(high_half(at_v, red_v) + kRounding);
    green[i] =
        static_cast<std::int16_t>(high_half(at_u, green_u) + high_half(at_v, green_v) + kRounding);
    blue[i] = static_cast<std::int16_t>(high_half(at_u, blue_u) + kRounding);
  }
}

void repeat_each(const std::int16_t* __restrict from, int count, std::int16_t* __restrict to) {
  for (int i = 0; i < count; ++i) to[2 * i] = to[2 * i + 1] = from[i];
}

int code_of(std::int16_t sum) {
  return std::min<std::int16_t>(
      255, std::max<std::int16_t>(0, static_cast<std::int16_t>(sum >> kFraction)));
}

// Writes RGBA of a row, two bytes at a time, which compilers vectorise.
void write_row(const std::uint8_t* __restrict luma, const std::int16_t* __restrict red,
               const std::int16_t* __restrict green, const std::int16_t* __restrict blue, int count,
               const YuvCoefficients& c, std::uint16_t* __restrict rgba) {
  constexpr bool kLittle = std::endian::native == std::endian::little;
  constexpr int kFirst = kLittle ? 0 : 8;  // shift of the byte that is first in memory
  constexpr int kSecond = 8 - kFirst;
  const std::int16_t scale = c.luma;
  const std::int16_t offset = c.luma_offset;
  for (int i = 0; i < count; ++i) {
    const std::int16_t grey =
        high_half(static_cast<std::int16_t>((luma[i] - offset) * (1 << kLumaShift)), scale);
    const int r = code_of(static_cast<std::int16_t>(grey + red[i]));
    const int g = code_of(static_cast<std::int16_t>(grey + green[i]));
    const int b = code_of(static_cast<std::int16_t>(grey + blue[i]));
    rgba[2 * i] = static_cast<std::uint16_t>(r << kFirst | g << kSecond);
    rgba[2 * i + 1] = static_cast<std::uint16_t>(b << kFirst | 255 << kSecond);
  }
}

// Copies every `step`-th byte.
void copy_every(const std::uint8_t* __restrict from, int step, int count,
                std::uint8_t* __restrict to) {
  for (int i = 0; i < count; ++i) to[i] = from[static_cast<std::ptrdiff_t>(step) * i];
}

const std::uint8_t* row_of(const PixelPlane& plane, int y) {
  return plane.data + static_cast<std::ptrdiff_t>(y) * plane.stride;
}

void write_rgb_row(const std::uint8_t* from, int count, std::uint8_t* to) {
  for (int i = 0; i < count; ++i) {
    to[4 * i] = from[3 * i];
    to[4 * i + 1] = from[3 * i + 1];
    to[4 * i + 2] = from[3 * i + 2];
    to[4 * i + 3] = 255;
  }
}

}  // namespace

// Computes the contributions of the chroma of row y to each pixel of the row.
void VideoRgba::set_chroma(const Frame& frame, int y, const YuvCoefficients& coefficients) {
  const auto [luma, u_plane, v_plane] = frame.planes;
  const int half = (frame.width + 1) / 2;
  const auto wide = [&](const std::uint8_t* u, const std::uint8_t* v) {
    add_chroma(u, v, frame.width, coefficients, pixel_chroma_[0].data(), pixel_chroma_[1].data(),
               pixel_chroma_[2].data());
  };
  const auto narrow = [&](const std::uint8_t* u, const std::uint8_t* v) {
    add_chroma(u, v, half, coefficients, sample_chroma_[0].data(), sample_chroma_[1].data(),
               sample_chroma_[2].data());
    for (std::size_t i = 0; i < pixel_chroma_.size(); ++i)
      repeat_each(sample_chroma_[i].data(), half, pixel_chroma_[i].data());
  };
  const auto unpacked = [&](const std::uint8_t* first_u, const std::uint8_t* first_v, int step) {
    copy_every(first_u, step, half, u_.data());
    copy_every(first_v, step, half, v_.data());
    narrow(u_.data(), v_.data());
  };
  switch (frame.format) {
    case PixelFormat::grey8:
    case PixelFormat::rgb24:
      return wide(u_.data(), v_.data());
    case PixelFormat::yuyv:
      return unpacked(row_of(luma, y) + 1, row_of(luma, y) + 3, 4);
    case PixelFormat::nv12:
      return unpacked(row_of(u_plane, y / 2), row_of(u_plane, y / 2) + 1, 2);
    case PixelFormat::yuv420p:
      return narrow(row_of(u_plane, y / 2), row_of(v_plane, y / 2));
    case PixelFormat::yuv422p:
      return narrow(row_of(u_plane, y), row_of(v_plane, y));
    case PixelFormat::yuv444p:
      return wide(row_of(u_plane, y), row_of(v_plane, y));
  }
}

std::span<const std::uint8_t> VideoRgba::convert(const Frame& frame) {
  converted_.remember(frame);
  const std::size_t width = static_cast<unsigned>(frame.width);
  rgba_.resize(2 * width * static_cast<std::size_t>(frame.height));
  // The last pair of an odd width has a column beyond the image.
  for (std::vector<std::uint8_t>* samples : {&luma_, &u_, &v_}) samples->assign(width + 1, 128);
  for (std::size_t i = 0; i < pixel_chroma_.size(); ++i) {
    sample_chroma_[i].resize(width + 1);
    pixel_chroma_[i].resize(width + 1);
  }
  const YuvCoefficients coefficients = coefficients_of(frame);
  const bool is_halved = frame.format == PixelFormat::yuv420p || frame.format == PixelFormat::nv12;
  for (int y = 0; y < frame.height; ++y) {
    std::uint16_t* to = rgba_.data() + 2 * width * static_cast<std::size_t>(y);
    const std::uint8_t* from = row_of(frame.planes[0], y);
    if (frame.format == PixelFormat::rgb24) {
      write_rgb_row(from, frame.width, reinterpret_cast<std::uint8_t*>(to));
      continue;
    }
    const bool same_chroma =
        y > 0 && (frame.format == PixelFormat::grey8 || (is_halved && y % 2 > 0));
    if (!same_chroma) set_chroma(frame, y, coefficients);
    if (frame.format == PixelFormat::yuyv) {
      copy_every(from, 2, frame.width, luma_.data());
      from = luma_.data();
    }
    write_row(from, pixel_chroma_[0].data(), pixel_chroma_[1].data(), pixel_chroma_[2].data(),
              frame.width, coefficients, to);
  }
  return bytes();
}

}  // namespace penumbra
