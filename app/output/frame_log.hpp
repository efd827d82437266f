// Writes one row for each frame and tag group: pose, covariance, state, times
// (docs/files.md#frame-logs).
#pragma once

#include <filesystem>
#include <utility>

#include "app/output/row_log.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"

namespace penumbra {

class FrameLog {
 public:
  // See RowLog::create().
  [[nodiscard]] static Result<FrameLog> create(const std::filesystem::path& file);

  // Writes the rows of a frame. A stream receives them at once.
  [[nodiscard]] Result<void> write(const SessionFrame& frame);
  [[nodiscard]] Result<void> finish() { return rows_.finish(); }
  // Call this after an error. Keeps the complete rows written before.
  void rescue() { rows_.rescue(); }

 private:
  explicit FrameLog(RowLog rows) : rows_(std::move(rows)) {}
  RowLog rows_;
};

}  // namespace penumbra
