// Writes one row for each frame and tag group: pose, covariance, state, times
// (docs/files.md#frame-logs).
#pragma once

#include <filesystem>
#include <utility>

#include "app/output/output_file.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"

namespace penumbra {

enum class FrameLogFormat { csv, jsonl };

class FrameLog {
 public:
  // The file's extension determines the format; standard output receives CSV.
  [[nodiscard]] static Result<FrameLog> create(const std::filesystem::path& file);

  // Writes the rows of a frame. A stream receives them at once.
  [[nodiscard]] Result<void> write(const SessionFrame& frame);
  [[nodiscard]] Result<void> finish() { return file_.commit(); }
  // Call this after an error. Keeps the complete rows written before.
  void rescue();

 private:
  FrameLog(OutputFile file, FrameLogFormat format) : file_(std::move(file)), format_(format) {}
  OutputFile file_;
  FrameLogFormat format_;
};

}  // namespace penumbra
