#include "app/capture/camera_trouble.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <unistd.h>

#include <cerrno>
#include <filesystem>

#include "app/capture/frame_clock.hpp"
#include "app/capture/live_source.hpp"
#include "support/recording_folder.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::HasSubstr;

TEST(Outage, CountsEachFaultOnceUntilNextFrame) {
  FaultCounter faults("camera");
  Outage outage(faults);
  EXPECT_FALSE(outage.end());
  for (int attempt = 0; attempt < 3; ++attempt) {
    outage.begin({CaptureFault::disconnected, "it is gone"});
  }
  EXPECT_EQ(faults.stats().of(CaptureFault::disconnected), 1U);
  EXPECT_EQ(faults.stats().trouble, "it is gone");
  outage.begin({CaptureFault::busy, "another program has it"}, "busy");
  outage.begin({CaptureFault::busy, "another program has it"}, "busy");
  EXPECT_EQ(faults.stats().of(CaptureFault::busy), 1U);
  EXPECT_EQ(faults.stats().trouble, "busy");

  EXPECT_TRUE(outage.end());
  EXPECT_FALSE(faults.stats().trouble);
  EXPECT_FALSE(outage.end());
  outage.begin({CaptureFault::disconnected, "again"});
  EXPECT_EQ(faults.stats().of(CaptureFault::disconnected), 2U);
}

TEST(CountStamp, SuggestsRemedyForEveryFault) {
  FaultCounter faults("camera");
  FrameStamp stamp;
  stamp.lost_counted = 2;
  stamp.lost_by_time = 3;
  stamp.bad_time = true;
  stamp.slower_interval_ns = 66'000'000;
  count_stamp(faults, stamp, StreamFormat());
  EXPECT_EQ(faults.stats().of(CaptureFault::gap), 2U);
  EXPECT_EQ(faults.stats().of(CaptureFault::silent_gap), 3U);
  const auto events = faults.take_events();
  ASSERT_EQ(events.size(), 4U);
  for (const std::size_t gap : {0U, 1U}) {
    EXPECT_THAT(events[gap].detail, AllOf(HasSubstr("frames were dropped"), HasSubstr("--size"),
                                          HasSubstr("--fps"), HasSubstr("USB port")));
  }
  EXPECT_THAT(events[2].detail, AllOf(HasSubstr("timestamp"), HasSubstr("update the kernel")));
  EXPECT_THAT(events[3].detail, HasSubstr("add light"));
}

TEST(CameraTrouble, ReportsDeviceWithoutPermission) {
  const test::TemporaryFolder devices;
  const auto path_of = [&](const char* name) { return devices.path() / name; };
  std::filesystem::permissions(devices.path(), std::filesystem::perms(0755));
  EXPECT_FALSE(forbidden_camera_device(path_of("nowhere")));
  EXPECT_FALSE(forbidden_camera_device(devices.path()));
  for (const char* name : {"media0", "video0", "video1", "mem"}) {
    test::write_text(path_of(name), "");
    std::filesystem::permissions(path_of(name), std::filesystem::perms(0666));
  }
  std::filesystem::permissions(path_of("mem"), std::filesystem::perms(0600));
  // Root may open every file, so the test switches to an unprivileged user.
  const bool is_root = geteuid() == 0;
  const auto find_now = [&] {
    EXPECT_EQ(is_root ? seteuid(65534) : 0, 0);
    auto found = forbidden_camera_device(devices.path());
    EXPECT_EQ(is_root ? seteuid(0) : 0, 0);
    return found;
  };
  EXPECT_FALSE(find_now()) << "/dev/mem is not a camera";
  for (const char* name : {"media0", "video1"}) {
    std::filesystem::permissions(path_of(name), std::filesystem::perms(is_root ? 0600 : 0000));
  }
  const auto found = find_now();
  ASSERT_TRUE(found);
  EXPECT_NE(found->find("media0 and 1 more"), std::string::npos) << *found;
  EXPECT_NE(found->find("video group"), std::string::npos) << *found;
}

TEST(CameraTrouble, MapsErrnoOfEitherSignToFault) {
  for (const int sign : {1, -1}) {
    EXPECT_EQ(fault_of(sign * ENODEV), CaptureFault::disconnected);
    EXPECT_EQ(fault_of(sign * ENXIO), CaptureFault::disconnected);
    EXPECT_EQ(fault_of(sign * EACCES), CaptureFault::forbidden);
    EXPECT_EQ(fault_of(sign * EBUSY), CaptureFault::busy);
    EXPECT_EQ(fault_of(sign * EINVAL), CaptureFault::refused);
    EXPECT_EQ(fault_of(sign * EIO), CaptureFault::io_error);
    EXPECT_EQ(message_of(sign * EIO), message_of(EIO));
  }
}

}  // namespace
}  // namespace penumbra
