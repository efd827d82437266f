#include <cmath>

#include "core/image/image_file.hpp"
#include "library/support.hpp"

namespace penumbra {
namespace {

constexpr int kMaxSide_px = 32768;

// Returns the bytes of a row of plane 0.
std::ptrdiff_t row_bytes(types::PixelFormat format, int width) {
  const std::ptrdiff_t columns = width;
  switch (format) {
    case types::PixelFormat::rgb24:
      return 3 * columns;
    case types::PixelFormat::yuyv:
      return 4 * ((columns + 1) / 2);
    case types::PixelFormat::grey8:
    case types::PixelFormat::nv12:
    case types::PixelFormat::yuv420p:
    case types::PixelFormat::yuv422p:
    case types::PixelFormat::yuv444p:
      return columns;
  }
  return -1;
}

PixelFormat internal_format(types::PixelFormat format) {
  switch (format) {
    case types::PixelFormat::grey8:
      return PixelFormat::grey8;
    case types::PixelFormat::rgb24:
      return PixelFormat::rgb24;
    case types::PixelFormat::yuyv:
      return PixelFormat::yuyv;
    case types::PixelFormat::nv12:
      return PixelFormat::nv12;
    case types::PixelFormat::yuv420p:
      return PixelFormat::yuv420p;
    case types::PixelFormat::yuv422p:
      return PixelFormat::yuv422p;
    case types::PixelFormat::yuv444p:
      return PixelFormat::yuv444p;
  }
  return PixelFormat::grey8;
}

types::PixelFormat public_format(PixelFormat format) {
  switch (format) {
    case PixelFormat::grey8:
      return types::PixelFormat::grey8;
    case PixelFormat::rgb24:
      return types::PixelFormat::rgb24;
    case PixelFormat::yuyv:
      return types::PixelFormat::yuyv;
    case PixelFormat::nv12:
      return types::PixelFormat::nv12;
    case PixelFormat::yuv420p:
      return types::PixelFormat::yuv420p;
    case PixelFormat::yuv422p:
      return types::PixelFormat::yuv422p;
    case PixelFormat::yuv444p:
      return types::PixelFormat::yuv444p;
  }
  return types::PixelFormat::grey8;
}

}  // namespace

void check_pose(const types::Pose& pose, std::string_view place) {
  constexpr double kMaxDistance_m = 1e9;  // a larger position is in a wrong unit
  for (const double coordinate : pose.position) {
    if (!(std::abs(coordinate) <= kMaxDistance_m)) {
      throw_failure("{}: position: {} is not a number of metres", place, coordinate);
    }
  }
  double squares = 0.0;
  for (const double q : pose.quaternion_xyzw) squares += q * q;
  const double length = std::sqrt(squares);
  if (!(std::abs(length - 1.0) < 0.01)) {
    throw_failure("{}: quaternion_xyzw: has length {:.6g}; give a unit quaternion (x, y, z, w)",
                  place, length);
  }
}

Frame checked_frame(const types::ImageView& image, std::string_view place) {
  const int width = image.width;
  const int height = image.height;
  if (image.data == nullptr) throw_failure("{}: data: is null; give the image's pixels", place);
  if (width < 1 || height < 1 || width > kMaxSide_px || height > kMaxSide_px) {
    throw_failure("{}: width, height: are {} x {}; give 1 to {} pixels", place, width, height,
                  kMaxSide_px);
  }
  const std::ptrdiff_t bytes = row_bytes(image.format, width);
  if (bytes < 0) {
    throw_failure("{}: format: {} is no pixel format", place, static_cast<int>(image.format));
  }
  if (image.stride < bytes) {
    throw_failure("{}: stride: is {} bytes; a row of {} pixels in this format has {}", place,
                  image.stride, width, bytes);
  }
  constexpr std::ptrdiff_t kMaxStride = std::ptrdiff_t{1} << 24U;  // 512 MiB of the largest side
  if (image.stride > kMaxStride) {
    throw_failure("{}: stride: is {} bytes; give at most {}", place, image.stride, kMaxStride);
  }
  Frame frame;
  frame.width = width;
  frame.height = height;
  frame.format = internal_format(image.format);
  const int samples = image.format == types::PixelFormat::yuyv ? (width + 1) / 2 : width;
  frame.planes[0] = {image.data, samples, height, image.stride};
  frame.plane_count = 1;
  return frame;
}

namespace types {

struct Image::Impl {
  Frame frame;
};

Image::Image(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
Image::Image(const Image&) = default;
Image& Image::operator=(const Image&) = default;
Image::~Image() = default;

Image Image::load(const std::filesystem::path& file) {
  return guarded(
      [&] { return Image(std::make_shared<const Impl>(Impl{value_or_throw(load_image(file))})); });
}

ImageView Image::view() const {
  const Frame& frame = impl_->frame;
  return {frame.planes[0].data, frame.width, frame.height, frame.planes[0].stride,
          public_format(frame.format)};
}

}  // namespace types
}  // namespace penumbra
