// Values that several parts of the library share. Each part has them as its own names too:
// penumbra::tracking::Pose is penumbra::types::Pose.
//
// Lengths are metres, angles radians. Frames are right-handed (docs/conventions.md). A name T_a_b
// is a rigid transform from frame b to frame a: p_a = R p_b + t.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <penumbra/api.hpp>

namespace penumbra::types {

using Vector2 = std::array<double, 2>;
using Vector3 = std::array<double, 3>;
using Matrix6 = std::array<double, 36>;  // row by row

// A rigid transform T_a_b: translation t [m] and rotation R as a unit quaternion (x, y, z, w).
struct Pose {
  Vector3 position{0.0, 0.0, 0.0};
  std::array<double, 4> quaternion_xyzw{0.0, 0.0, 0.0, 1.0};
};

// Memory layouts. Chroma planes have half the width (yuyv, nv12, yuv420p, yuv422p) and half the
// height (nv12, yuv420p), rounded up.
enum class PixelFormat {
  grey8,    // one byte per pixel
  rgb24,    // bytes R G B
  yuyv,     // bytes Y0 U Y1 V of two pixels
  nv12,     // a plane of Y, one of U V bytes
  yuv420p,  // planes Y, U, V
  yuv422p,  // planes Y, U, V
  yuv444p,  // planes Y, U, V
};

// Pixels of the caller, which the library reads during the call only. The tracker and the
// calibration use the luma. They don't read the chroma planes of nv12 and yuv4xxp, so these need
// not be given: `data` is the plane Y. rgb24 is converted to luma with the weights of BT.601.
struct ImageView {
  const std::uint8_t* data = nullptr;  // the top left pixel
  int width = 0;                       // [px], up to 32768
  int height = 0;                      // [px], up to 32768
  std::ptrdiff_t stride = 0;           // [bytes] from a row to the next, at least the row's size
  PixelFormat format = PixelFormat::grey8;
};

// An image in memory, decoded from a PNG or JPEG file. Copies share the pixels.
class PENUMBRA_API Image {
 public:
  // Decodes as the program does: no colour conversion, 16-bit samples reduced to 8. Throws if the
  // file is missing, damaged or of another format.
  [[nodiscard]] static Image load(const std::filesystem::path& file);
  Image(const Image&);
  Image& operator=(const Image&);
  ~Image();

  // Valid as long as a copy of the image exists.
  [[nodiscard]] ImageView view() const;

 private:
  struct Impl;
  PENUMBRA_LOCAL explicit Image(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

}  // namespace penumbra::types
