#include "app/window/kiosk_lock.hpp"

#include <gtest/gtest.h>

#include <random>

namespace penumbra {
namespace {

using Kind = WindowEvent::Kind;

WindowEvent event_of(Kind kind, int code = 0, bool control = false, bool shift = false) {
  WindowEvent event;
  event.kind = kind;
  event.code = code;
  event.control = control;
  event.shift = shift;
  return event;
}
const WindowEvent kUnlock = event_of(Kind::key_down, 'K', true, true);

TEST(KioskLock, AdmitsOnlyPointerWhileLocked) {
  KioskLock lock(60.0);
  EXPECT_TRUE(lock.locked());
  for (const Kind kind :
       {Kind::button_down, Kind::button_up, Kind::pointer_moved, Kind::scrolled}) {
    EXPECT_TRUE(lock.admits(event_of(kind), 0.0));
  }
  for (int code = 0; code < 400; ++code) {
    for (const bool control : {false, true}) {
      EXPECT_FALSE(lock.admits(event_of(Kind::key_down, code, control), 0.0)) << code;
      EXPECT_FALSE(lock.admits(event_of(Kind::key_up, code, control), 0.0)) << code;
    }
  }
  EXPECT_FALSE(lock.admits(event_of(Kind::text, 'q'), 0.0));
  EXPECT_FALSE(lock.admits(event_of(Kind::file_dropped), 0.0));
  EXPECT_TRUE(lock.locked());
}

TEST(KioskLock, UnlocksAndLocksByItsKeys) {
  KioskLock lock(60.0);
  EXPECT_FALSE(lock.admits(kUnlock, 0.0))
      << "the keys themselves must have no effect in the window";
  EXPECT_FALSE(lock.locked());
  EXPECT_TRUE(lock.admits(event_of(Kind::key_down, 'Q'), 1.0));
  EXPECT_FALSE(lock.admits(kUnlock, 2.0));
  EXPECT_TRUE(lock.locked());
}

TEST(KioskLock, ResetsOnceAfterEachTimeWithoutInput) {
  KioskLock lock(10.0);
  EXPECT_FALSE(lock.take_reset(1e6)) << "nothing was touched";
  EXPECT_TRUE(lock.admits(event_of(Kind::button_down), 1e6));
  EXPECT_FALSE(lock.take_reset(1e6 + 9'999.0));
  EXPECT_TRUE(lock.admits(event_of(Kind::pointer_moved), 1e6 + 9'999.0));
  EXPECT_FALSE(lock.take_reset(1e6 + 19'998.0));
  EXPECT_TRUE(lock.take_reset(1e6 + 19'999.0));
  EXPECT_FALSE(lock.take_reset(1e6 + 90'000.0));
}

TEST(KioskLock, LocksAgainWhenStaffLeave) {
  KioskLock lock(10.0);
  EXPECT_FALSE(lock.admits(kUnlock, 0.0));
  EXPECT_FALSE(lock.take_reset(9'999.0));
  EXPECT_FALSE(lock.locked());
  EXPECT_TRUE(lock.take_reset(10'000.0));
  EXPECT_TRUE(lock.locked());
}

TEST(KioskLock, NeverResetsWithTimeZero) {
  KioskLock lock(0.0);
  EXPECT_TRUE(lock.admits(event_of(Kind::button_down), 0.0));
  EXPECT_FALSE(lock.take_reset(1e12));
}

TEST(KioskLock, HidesPointerAtRestWhileLocked) {
  KioskLock lock(60.0);
  EXPECT_FALSE(lock.shows_pointer(0.0));
  EXPECT_TRUE(lock.admits(event_of(Kind::pointer_moved), 0.0));
  EXPECT_TRUE(lock.shows_pointer(2'999.0));
  EXPECT_FALSE(lock.shows_pointer(3'000.0));
  EXPECT_FALSE(lock.admits(kUnlock, 3'000.0));
  EXPECT_TRUE(lock.shows_pointer(30'000.0));
}

// Random events: only the unlocking keys change the lock, and keys pass only while it is open.
TEST(KioskLock, StaysLockedUnderRandomInput) {
  std::mt19937 random(39);
  KioskLock lock(0.0);
  bool locked = true;
  for (int i = 0; i < 100'000; ++i) {
    const auto number = [&random](int max) {
      return std::uniform_int_distribution<int>(0, max)(random);
    };
    const WindowEvent event =
        event_of(static_cast<Kind>(number(7)), number(400), number(1) == 1, number(1) == 1);
    const bool by_keys =
        event.kind == Kind::key_down && event.code == 'K' && event.control && event.shift;
    const bool admitted = lock.admits(event, i);
    if (by_keys) locked = !locked;
    ASSERT_EQ(lock.locked(), locked) << i;
    const bool is_key = event.kind == Kind::key_down || event.kind == Kind::key_up ||
                        event.kind == Kind::text || event.kind == Kind::file_dropped;
    if (is_key && locked) {
      ASSERT_FALSE(admitted) << i;
    }
  }
}

}  // namespace
}  // namespace penumbra
