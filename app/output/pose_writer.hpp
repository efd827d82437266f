// Poses as they are tracked -> TUM file.
#pragma once

#include <fstream>

#include "app/output/output_file.hpp"
#include "core/pose_estimate.hpp"

namespace penumbra {

class PoseWriter {
 public:
  // `all`: uncertain and held poses too, each after a comment line that says so ("# uncertain:
  // reason"): a line of its own, so that every reader of TUM files still finds eight columns.
  [[nodiscard]] static Result<PoseWriter> create(const std::filesystem::path& file, bool all);

  // Only tracked poses are written, unless `all`; lost ones never.
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, const PoseEstimate& pose);
  [[nodiscard]] Result<void> finish();

 private:
  PoseWriter(OutputFile file, bool all);
  OutputFile file_;
  std::ofstream stream_;
  bool all_ = false;
};

}  // namespace penumbra
