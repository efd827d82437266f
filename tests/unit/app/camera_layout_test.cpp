// Buffer layouts of cameras, and differences between versions of libcamera.
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include "app/capture/frame_layout.hpp"
#include "app/capture/libcamera_versions.hpp"
#include "app/capture/v4l2/v4l2_source.hpp"

namespace penumbra {
namespace {

TEST(FrameLayout, PlacesPlanesConsecutively) {
  const FrameLayout nv12 = frame_layout(PixelFormat::nv12, 640, 480, 704);
  EXPECT_EQ(nv12.frame.plane_count, 2);
  EXPECT_EQ(nv12.offset[1], 704U * 480U);
  EXPECT_EQ(nv12.frame.planes[1].stride, 704);
  EXPECT_EQ(nv12.frame.planes[1].width, 320);
  EXPECT_EQ(nv12.bytes, 704U * 480U + 704U * 240U);

  const FrameLayout yu12 = frame_layout(PixelFormat::yuv420p, 640, 480, 704);
  EXPECT_EQ(yu12.frame.plane_count, 3);
  EXPECT_EQ(yu12.offset[1], 704U * 480U);
  EXPECT_EQ(yu12.offset[2], 704U * 480U + 352U * 240U);
  EXPECT_EQ(yu12.bytes, 704U * 480U + 2U * 352U * 240U);

  const FrameLayout yuyv = frame_layout(PixelFormat::yuyv, 640, 480, 1280);
  EXPECT_EQ(yuyv.frame.planes[0].width, 320) << "chroma samples are shared by two pixels";
  EXPECT_EQ(yuyv.bytes, 1280U * 480U);

  const FrameLayout rgb = frame_layout(PixelFormat::rgb24, 33, 7, 99);
  EXPECT_EQ(rgb.frame.plane_count, 1);
  EXPECT_EQ(rgb.bytes, 99U * 7U);
}

// Follows the kernel's documentation of colour spaces: a field with its default value follows from
// the colour space; an explicit field overrides it.
TEST(V4l2Colors, FollowColorspaceFieldsOfDriver) {
  constexpr VideoColors kBt601{ColorMatrix::bt601, ColorRange::limited};
  constexpr VideoColors kBt601Full{ColorMatrix::bt601, ColorRange::full};
  constexpr VideoColors kBt709{ColorMatrix::bt709, ColorRange::limited};
  constexpr VideoColors kBt709Full{ColorMatrix::bt709, ColorRange::full};
  const auto of = [](std::uint32_t space, std::uint32_t encoding = V4L2_YCBCR_ENC_DEFAULT,
                     std::uint32_t range = V4L2_QUANTIZATION_DEFAULT) {
    return v4l2_colors(space, encoding, range);
  };
  EXPECT_EQ(of(V4L2_COLORSPACE_DEFAULT), kBt601);
  EXPECT_EQ(of(V4L2_COLORSPACE_SMPTE170M), kBt601);
  EXPECT_EQ(of(V4L2_COLORSPACE_470_SYSTEM_BG), kBt601);
  EXPECT_EQ(of(V4L2_COLORSPACE_SRGB), kBt601) << "usual for webcams";
  EXPECT_EQ(of(V4L2_COLORSPACE_REC709), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_JPEG), kBt601Full);
  EXPECT_EQ(of(V4L2_COLORSPACE_DCI_P3), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_BT2020), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_SMPTE240M), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_SRGB, V4L2_YCBCR_ENC_709), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_REC709, V4L2_YCBCR_ENC_601), kBt601);
  EXPECT_EQ(of(V4L2_COLORSPACE_REC709, V4L2_YCBCR_ENC_XV601), kBt601);
  EXPECT_EQ(of(V4L2_COLORSPACE_SMPTE170M, V4L2_YCBCR_ENC_XV709), kBt709);
  EXPECT_EQ(of(V4L2_COLORSPACE_SRGB, V4L2_YCBCR_ENC_DEFAULT, V4L2_QUANTIZATION_FULL_RANGE),
            kBt601Full);
  EXPECT_EQ(of(V4L2_COLORSPACE_REC709, V4L2_YCBCR_ENC_709, V4L2_QUANTIZATION_FULL_RANGE),
            kBt709Full);
  EXPECT_EQ(of(V4L2_COLORSPACE_JPEG, V4L2_YCBCR_ENC_601, V4L2_QUANTIZATION_LIM_RANGE), kBt601);
}

TEST(FrameLayout, RaisesStrideThatIsTooSmallOrUnknown) {
  EXPECT_EQ(frame_layout(PixelFormat::grey8, 640, 480, 0).frame.planes[0].stride, 640);
  EXPECT_EQ(frame_layout(PixelFormat::yuyv, 640, 480, 640).frame.planes[0].stride, 1280);
  EXPECT_EQ(frame_layout(PixelFormat::rgb24, 640, 480, -1).frame.planes[0].stride, 1920);
}

TEST(FrameLayout, RoundsChromaSizeUpForOddSizes) {
  const FrameLayout odd = frame_layout(PixelFormat::nv12, 641, 481, 704);
  EXPECT_EQ(odd.frame.planes[1].width, 321);
  EXPECT_EQ(odd.frame.planes[1].height, 241);
  EXPECT_EQ(odd.bytes, 704U * (481U + 241U));
}

// Mimic the configurations of libcamera 0.0.3 and of later versions.
struct WithTransform {
  int transform = 0;
};
struct WithOrientation {
  int orientation = 1;
};

TEST(LibcameraRotation, RotatesImageUprightInBothApiVersions) {
  const auto transform_of = [](int angle, bool* possible) {
    *possible = angle % 180 == 0;
    return angle;
  };
  WithTransform with_transform;
  show_upright(with_transform, 180, transform_of);
  EXPECT_EQ(with_transform.transform, 180);
  show_upright(with_transform, 45, transform_of);
  EXPECT_EQ(with_transform.transform, 180) << "an unsupported transform must be kept";
  WithOrientation with_orientation;
  show_upright(with_orientation, 180, transform_of);
  EXPECT_EQ(with_orientation.orientation, 1) << "orientation 1 is upright";
}

}  // namespace
}  // namespace penumbra
