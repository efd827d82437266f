#include "app/capture/capture_stats.hpp"

#include <chrono>
#include <utility>

#include "app/logging.hpp"

namespace penumbra {
namespace {

// Limits the queue while no recording reads the events.
constexpr std::size_t kMaxEvents = 256;

// Same order as CaptureFault.
struct FaultText {
  std::string_view name;
  std::string_view description;
};
constexpr std::array<FaultText, kCaptureFaultCount> kFaultTexts = {{
    {"silent", "stream stalls"},
    {"io_error", "I/O errors"},
    {"disconnected", "disconnections"},
    {"refused", "requests refused by the driver"},
    {"busy", "in use by another program"},
    {"forbidden", "no permission"},
    {"wrong_format", "frames of another size or format"},
    {"error_frame", "frames marked as bad by the driver"},
    {"damaged", "damaged frames"},
    {"gap", "frames dropped, by the driver's numbers"},
    {"silent_gap", "frames dropped, by their times"},
    {"bad_time", "impossible timestamps"},
    {"slow_rate", "slower frame rates"},
    {"no_signal", "no signal"},
}};
static_assert(!kFaultTexts.back().name.empty());

}  // namespace

std::string_view name_of(CaptureFault fault) {
  return kFaultTexts[static_cast<std::size_t>(fault)].name;
}

std::string_view description_of(CaptureFault fault) {
  return kFaultTexts[static_cast<std::size_t>(fault)].description;
}

void FaultCounter::count(CaptureFault fault, std::string_view detail, std::uint64_t times) {
  const std::int64_t now_ns =
      std::chrono::steady_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
  bool first = false;
  {
    const std::lock_guard lock(mutex_);
    std::uint64_t& counter = stats_.faults[static_cast<std::size_t>(fault)];
    first = counter == 0;
    counter += times;
    if (events_.size() < kMaxEvents) events_.push_back({now_ns, fault, std::string(detail)});
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
