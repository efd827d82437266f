#include "app/capture/clocks.hpp"

#include <chrono>
#include <ctime>

namespace penumbra {
namespace {

constexpr int kMaxReadings = 4;
constexpr std::int64_t kShortInterval_ns = 2'000;  // of an undisturbed reading, also on slow CPUs

}  // namespace

std::int64_t monotonic_ns() {
  using Clock = std::chrono::steady_clock;  // CLOCK_MONOTONIC
  return Clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
}

ClockReading read_clocks() {
  ClockReading reading;
  reading.before_ns = monotonic_ns();
  timespec utc{};
  clock_gettime(CLOCK_REALTIME, &utc);
  reading.after_ns = monotonic_ns();
  reading.utc_ns = std::int64_t{utc.tv_sec} * 1'000'000'000 + utc.tv_nsec;
  return reading;
}

std::int64_t utc_at(std::int64_t time_ns, const std::function<ClockReading()>& read) {
  const auto interval_ns = [](const ClockReading& reading) {
    return reading.after_ns - reading.before_ns;
  };
  ClockReading best = read();
  for (int i = 1; i < kMaxReadings && interval_ns(best) > kShortInterval_ns; ++i) {
    const ClockReading next = read();
    if (interval_ns(next) < interval_ns(best)) best = next;
  }
  const std::int64_t middle_ns = best.before_ns + interval_ns(best) / 2;
  return best.utc_ns + (time_ns - middle_ns);
}

}  // namespace penumbra
