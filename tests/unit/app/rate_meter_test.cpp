#include "app/report/rate_meter.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

TEST(RateMeter, MeasuresRateOfReceivedFrames) {
  RateMeter rate;
  EXPECT_EQ(rate.per_s(0.0), 0.0);
  rate.add(0.0);
  EXPECT_EQ(rate.per_s(10.0), 0.0);
  for (int i = 1; i <= 100; ++i) {
    rate.add(400.0 * i);
    // Repeated queries return the same rate until the next frame is overdue.
    for (double later = 0.0; later <= 400.0; later += 50.0) {
      EXPECT_NEAR(rate.per_s(400.0 * i + later), 2.5, 1e-9) << i << " " << later;
    }
  }
  // A faster rate replaces the old one within a few frames.
  for (int i = 1; i <= 30; ++i) rate.add(40'000.0 + 20.0 * i);
  EXPECT_NEAR(rate.per_s(40'600.0), 50.0, 1e-9);
}

TEST(RateMeter, DecreasesWhileNoFrameArrives) {
  RateMeter rate;
  for (int i = 0; i <= 10; ++i) rate.add(100.0 * i);
  EXPECT_NEAR(rate.per_s(1100.0), 10.0, 1e-9);
  EXPECT_NEAR(rate.per_s(2200.0), 5.0, 1e-9);
  EXPECT_LT(rate.per_s(1e6), 0.02);
  rate.restart();
  EXPECT_EQ(rate.per_s(1e6), 0.0);
  // Two frames at the same time determine no rate.
  rate.add(5.0);
  rate.add(5.0);
  EXPECT_EQ(rate.per_s(5.0), 0.0);
}

}  // namespace
}  // namespace penumbra
