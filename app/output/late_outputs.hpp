// A run's outputs where pictures come a frame late: while one frame is drawn, the one before it is
// written. In order, and none is lost.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "app/output/run_outputs.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"

namespace penumbra {

class LateOutputs {
 public:
  // All outlive this. `session`: null where every picture is there as soon as it is drawn.
  LateOutputs(Session* session, RunOutputs& outputs, RunRecorder& run)
      : session_(session), outputs_(outputs), run_(run) {}

  // What is asked for of a frame; that of one whose picture comes later is written by the next
  // call. `pixels` is the frame's picture, or where that comes later (SessionFrame::picture) the
  // one of the frame before, if it was asked for. Fails as RunOutputs::write().
  [[nodiscard]] Result<void> write(const SessionFrame& frame, std::span<const std::uint8_t> pixels);
  // What is still to be written: before the outputs are finished, and where no next frame comes
  // soon. Fails also where the picture is lost.
  [[nodiscard]] Result<void> write_rest();

 private:
  Session* session_;
  RunOutputs& outputs_;
  RunRecorder& run_;
  std::optional<TrackedFrame> waiting_;  // without its pixels, which a camera wants back
  std::vector<std::uint8_t> pixels_;     // of write_rest()
};

}  // namespace penumbra
