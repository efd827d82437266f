#include "app/output/late_outputs.hpp"

#include <utility>

#include "core/assert.hpp"

namespace penumbra {
namespace {

// What is written of a frame, without what it was drawn from.
TrackedFrame without_pixels(const TrackedFrame& tracked) {
  TrackedFrame kept = tracked;
  kept.frame = Frame();
  kept.frame.sequence = tracked.frame.sequence;
  kept.frame.timestamp_ns = tracked.frame.timestamp_ns;
  return kept;
}

}  // namespace

Result<void> LateOutputs::write(const SessionFrame& frame, std::span<const std::uint8_t> pixels) {
  if (frame.picture != PictureTime::later) {
    auto rest = write_rest();
    auto written = outputs_.write(frame.tracked, pixels, run_);
    return rest ? written : rest;
  }
  Result<void> written;
  if (waiting_) {
    PENUMBRA_ASSERT(frame.read_back);
    written = outputs_.write(*waiting_, pixels, run_);
  }
  waiting_ = without_pixels(frame.tracked);
  return written;
}

Result<void> LateOutputs::write_rest() {
  if (!waiting_) return {};
  const TrackedFrame frame = *std::exchange(waiting_, std::nullopt);
  PENUMBRA_ASSERT(session_ != nullptr);
  Result<StageTime> taken = session_->take_picture(pixels_);
  if (taken) {
    run_.add_time("readback", *taken);
    return outputs_.write(frame, pixels_, run_);
  }
  // Its pose is known all the same.
  auto written = outputs_.write_without_picture(frame);
  return written ? tl::unexpected(taken.error()) : written;
}

}  // namespace penumbra
