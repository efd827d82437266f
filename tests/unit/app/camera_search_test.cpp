#include "app/capture/camera_search.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace penumbra {
namespace {

// kTwin: another camera of the same model. kMoved, kMovedToo: the lost camera at other ports.
const V4l2Identity kLost = {"uvcvideo", "Webcam", "usb-1"};
const V4l2Identity kTwin = {"uvcvideo", "Webcam", "usb-2"};
const V4l2Identity kOther = {"uvcvideo", "Microscope", "usb-3"};
const V4l2Identity kMoved = {"uvcvideo", "Webcam", "usb-4"};
const V4l2Identity kMovedToo = {"uvcvideo", "Webcam", "usb-5"};

using Devices = std::vector<V4l2Identity>;

TEST(CameraSearch, FindsCameraAtItsOldPort) {
  CameraSearch search(kLost);
  EXPECT_EQ(search.find(Devices{kTwin, kOther, kLost}), 2U);
}

TEST(CameraSearch, IgnoresIdenticalCameraPresentBeforeLoss) {
  CameraSearch search(kLost);
  search.begin();
  for (int i = 0; i < 5; ++i) EXPECT_EQ(search.find(Devices{kOther, kTwin}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kOther, kTwin, kLost}), 2U);
}

TEST(CameraSearch, FindsCameraReconnectedAtOtherPort) {
  CameraSearch search(kLost);
  search.begin();
  EXPECT_EQ(search.find(Devices{kOther, kTwin}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kOther, kTwin, kMoved, kMoved}), 2U);
}

TEST(CameraSearch, WaitsWhenTwoNewCamerasMatch) {
  CameraSearch search(kLost);
  search.begin();
  EXPECT_EQ(search.find(Devices{}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kMoved, kMovedToo}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kMoved, kMovedToo, kLost}), 2U);
}

TEST(CameraSearch, RestartsAtEveryLoss) {
  CameraSearch search(kLost);
  search.begin();
  EXPECT_EQ(search.find(Devices{}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kMoved}), 0U);
  // The camera was found at kMoved, so the next search looks for it at this port.
  search.begin();
  EXPECT_EQ(search.find(Devices{kLost, kTwin}), std::nullopt);
  EXPECT_EQ(search.find(Devices{kLost, kTwin, kMoved}), 2U);
}

}  // namespace
}  // namespace penumbra
