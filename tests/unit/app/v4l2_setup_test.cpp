#include "app/capture/v4l2/v4l2_setup.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <cerrno>
#include <limits>

#include "app/capture/camera_controls.hpp"
#include "app/capture/camera_trouble.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(V4l2Setup, AcceptsProgressiveFramesOnly) {
  for (const std::uint32_t field : {V4L2_FIELD_NONE, V4L2_FIELD_ANY}) {
    EXPECT_FALSE(field_problem(field)) << field;
  }
  for (const std::uint32_t field : {V4L2_FIELD_TOP, V4L2_FIELD_BOTTOM, V4L2_FIELD_INTERLACED,
                                    V4L2_FIELD_SEQ_TB, V4L2_FIELD_SEQ_BT, V4L2_FIELD_ALTERNATE,
                                    V4L2_FIELD_INTERLACED_TB, V4L2_FIELD_INTERLACED_BT}) {
    ASSERT_TRUE(field_problem(field)) << field;
    EXPECT_THAT(*field_problem(field), HasSubstr("interlaced")) << field;
  }
}

TEST(CameraControls, ReportValueGrantedByDriver) {
  EXPECT_EQ(changed_control_text("exposure", " ms", 500.0, 204.7, ControlRange{0.3, 204.7}),
            "exposure: the camera gives 204.7 ms for 500 ms; it takes 0.3 to 204.7 ms");
  EXPECT_EQ(changed_control_text("focus", "", 999.0, 250.0, std::nullopt),
            "focus: the camera gives 250 for 999");
}

TEST(V4l2Setup, AdvisesWhenNoFormatIsReadable) {
  V4l2Format uyvy;
  uyvy.fourcc = V4L2_PIX_FMT_UYVY;
  EXPECT_THAT(no_format_text("/dev/video3", {uyvy}, ""),
              AllOf(HasSubstr("/dev/video3: gives UYVY"), HasSubstr("libcamera"),
                    HasSubstr("ffmpeg -f v4l2 -i /dev/video3"), HasSubstr("v4l2loopback")));
  EXPECT_EQ(no_format_text("/dev/video3", {uyvy}, "nv12"),
            "/dev/video3: gives no nv12, but UYVY; choose another --format");
  EXPECT_THAT(no_format_text("/dev/video3", {}, ""), HasSubstr("gives no format"));
}

TEST(V4l2Setup, AdvisesLibcameraForMultiPlanarDevices) {
  EXPECT_THAT(multi_planar_error("/dev/video3", "unicam"),
              AllOf(HasSubstr("/dev/video3: "), HasSubstr("multi-planar"), HasSubstr("unicam"),
                    HasSubstr("libcamera:0"), HasSubstr("penumbra devices")));
}

TEST(CameraControls, ClampToRangeWithWarning) {
  const GrantedControl exposure = granted_control("exposure", " ms", 500.0, {0.06, 66.7});
  EXPECT_EQ(exposure.value, 66.7);
  EXPECT_EQ(exposure.warning,
            "exposure: the camera gives 66.7 ms for 500 ms; it takes 0.06 to 66.7 ms");
  EXPECT_EQ(granted_control("gain", "", 0.5, {1.0, 16.0}).warning,
            "gain: the camera gives 1 for 0.5; it takes 1 to 16");
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  for (const ControlRange& range :
       {ControlRange{1.0, 16.0}, ControlRange{8.0, 8.0}, ControlRange{0.0, 0.0},
        ControlRange{9.0, 2.0}, ControlRange{kNan, 1.0}, ControlRange{0.0, kInfinity}}) {
    const GrantedControl gain = granted_control("gain", "", 8.0, range);
    EXPECT_EQ(gain.value, 8.0) << range.lowest << " to " << range.highest;
    EXPECT_FALSE(gain.warning) << range.lowest << " to " << range.highest;
  }
}

TEST(V4l2Setup, AdvisesWhenUsbBandwidthIsExhausted) {
  const std::string text = v4l2_call_error("/dev/video0", "VIDIOC_STREAMON", ENOSPC);
  EXPECT_THAT(text, HasSubstr("bandwidth"));
  EXPECT_THAT(text, HasSubstr("--format mjpeg"));
  EXPECT_THAT(text, Not(HasSubstr("plug")));
  EXPECT_THAT(text, Not(HasSubstr("space")));
  EXPECT_EQ(fault_of(ENOSPC), CaptureFault::busy) << "an immediate retry would not help";
}

TEST(V4l2Setup, GivesAdviceForEachError) {
  const auto help = [](int error) { return v4l2_call_error("/dev/video0", "VIDIOC_S_FMT", error); };
  EXPECT_THAT(help(EINVAL), HasSubstr("choose another --format or --size"));
  EXPECT_THAT(help(EPIPE), HasSubstr("libcamera"));
  EXPECT_THAT(help(EIO), HasSubstr("cable"));
  EXPECT_THAT(help(EBUSY), HasSubstr("another program"));
  EXPECT_THAT(help(ENODEV), HasSubstr("no such camera"));
  for (const int error : {EINVAL, EPIPE, EIO, EBUSY, ENODEV, ENOMEM, EDOM}) {
    EXPECT_THAT(help(error), HasSubstr("/dev/video0: ")) << error;
  }
}

}  // namespace
}  // namespace penumbra
