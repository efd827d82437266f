#include "app/capture/camera_trouble.hpp"

#include <gtest/gtest.h>

#include <cerrno>

namespace penumbra {
namespace {

TEST(Outage, EachKindOfTroubleIsCountedOnceUntilAFrameComes) {
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

TEST(CameraTrouble, ErrorsAreFaultsWithEitherSign) {
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
