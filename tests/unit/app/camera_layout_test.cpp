// What cameras' buffers look like, and what differs between versions of libcamera.
#include <gtest/gtest.h>

#include "app/capture/frame_layout.hpp"
#include "app/capture/libcamera_versions.hpp"

namespace penumbra {
namespace {

TEST(FrameLayout, PlanesLieOneBehindTheOther) {
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
  EXPECT_EQ(yuyv.frame.planes[0].width, 320) << "groups of two pixels";
  EXPECT_EQ(yuyv.bytes, 1280U * 480U);

  const FrameLayout rgb = frame_layout(PixelFormat::rgb24, 33, 7, 99);
  EXPECT_EQ(rgb.frame.plane_count, 1);
  EXPECT_EQ(rgb.bytes, 99U * 7U);
}

TEST(FrameLayout, AStrideThatIsTooSmallOrUnknownIsRaised) {
  EXPECT_EQ(frame_layout(PixelFormat::grey8, 640, 480, 0).frame.planes[0].stride, 640);
  EXPECT_EQ(frame_layout(PixelFormat::yuyv, 640, 480, 640).frame.planes[0].stride, 1280);
  EXPECT_EQ(frame_layout(PixelFormat::rgb24, 640, 480, -1).frame.planes[0].stride, 1920);
}

TEST(FrameLayout, OddSizesHaveRoomForTheirLastChroma) {
  const FrameLayout odd = frame_layout(PixelFormat::nv12, 641, 481, 704);
  EXPECT_EQ(odd.frame.planes[1].width, 321);
  EXPECT_EQ(odd.frame.planes[1].height, 241);
  EXPECT_EQ(odd.bytes, 704U * (481U + 241U));
}

// A configuration as of libcamera 0.0.3, and one as of later versions.
struct WithTransform {
  int transform = 0;
};
struct WithOrientation {
  int orientation = 1;
};

TEST(LibcameraVersions, ATurnedCameraIsShownUprightByEither) {
  const auto transform_of = [](int angle, bool* possible) {
    *possible = angle % 180 == 0;
    return angle;
  };
  WithTransform old_one;
  show_upright(old_one, 180, transform_of);
  EXPECT_EQ(old_one.transform, 180);
  show_upright(old_one, 45, transform_of);
  EXPECT_EQ(old_one.transform, 180) << "what can't be undone changes nothing";
  WithOrientation new_one;
  show_upright(new_one, 180, transform_of);
  EXPECT_EQ(new_one.orientation, 1) << "it starts upright";
}

}  // namespace
}  // namespace penumbra
