#include "app/capture/capture_stats.hpp"

#include <chrono>
#include <utility>

#include "app/logging.hpp"

namespace penumbra {
namespace {

// Limits events that no recording takes.
constexpr std::size_t kMostEvents = 256;

}  // namespace

std::string_view name_of(CaptureFault fault) {
  constexpr std::array<std::string_view, kCaptureFaultCount> kNames = {
      "silent",     "io_error",     "disconnected", "refused",  "busy",
      "forbidden",  "wrong_format", "error_frame",  "damaged",  "gap",
      "silent_gap", "bad_time",     "slow_rate",    "no_signal"};
  return kNames[static_cast<std::size_t>(fault)];
}

std::string_view description_of(CaptureFault fault) {
  constexpr std::array<std::string_view, kCaptureFaultCount> kDescriptions = {
      "stream stalls",
      "I/O errors",
      "disconnections",
      "requests refused by the driver",
      "in use by another program",
      "no permission",
      "frames of another size or format",
      "frames marked as bad by the driver",
      "damaged frames",
      "frames dropped, by the driver's numbers",
      "frames dropped, by their times",
      "impossible timestamps",
      "slower frame rates",
      "no signal"};
  return kDescriptions[static_cast<std::size_t>(fault)];
}

void FaultCounter::count(CaptureFault fault, std::string_view detail, std::uint64_t times) {
  const std::int64_t now_ns = std::chrono::duration_cast<std::chrono::nanoseconds>(
                                  std::chrono::steady_clock::now().time_since_epoch())
                                  .count();
  bool first = false;
  {
    const std::lock_guard lock(mutex_);
    std::uint64_t& counter = stats_.faults[static_cast<std::size_t>(fault)];
    first = counter == 0;
    counter += times;
    if (events_.size() < kMostEvents) events_.push_back({now_ns, fault, std::string(detail)});
  }
  if (first) {
    log_warning("{}: {} (reported once, then counted)", camera_, detail);
  } else {
    log_debug("{}: {}", camera_, detail);
  }
}

void FaultCounter::count_frame() {
  const std::lock_guard lock(mutex_);
  ++stats_.frames;
}

void FaultCounter::count_undecoded(std::string_view detail) {
  count(CaptureFault::damaged, detail);
  const std::lock_guard lock(mutex_);
  ++stats_.undecoded;
}

void FaultCounter::count_restart() {
  const std::lock_guard lock(mutex_);
  ++stats_.restarts;
}

void FaultCounter::set_trouble(std::optional<std::string> trouble) {
  const std::lock_guard lock(mutex_);
  stats_.trouble = std::move(trouble);
}

CaptureStats FaultCounter::stats() const {
  const std::lock_guard lock(mutex_);
  return stats_;
}

std::vector<FaultCounter::Event> FaultCounter::take_events() {
  const std::lock_guard lock(mutex_);
  return std::exchange(events_, {});
}

}  // namespace penumbra
