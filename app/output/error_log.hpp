// Writes the errors of each pose for `evaluate --per-frame` (docs/reports.md#errors-of-each-frame).
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <string>
#include <utility>

#include "app/output/row_log.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/evaluation/split_half.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// Writes a row for each pose of the table, each followed by those of the groups at the same time.
[[nodiscard]] Result<void> write_pose_errors(const std::filesystem::path& file,
                                             const Evaluation& table,
                                             const std::map<std::string, Evaluation>& groups);

// Writes a row for each frame and split of the tags, in the order of the calls of add().
class HalfErrorLog {
 public:
  // See RowLog::create().
  [[nodiscard]] static Result<HalfErrorLog> create(const std::filesystem::path& file);

  // `split`: from 0.
  [[nodiscard]] Result<void> add(const Frame& frame, std::size_t split,
                                 const HalfDifference& difference);
  [[nodiscard]] Result<void> finish() { return rows_.finish(); }
  // Call this after an error. Keeps the complete rows, if there are any.
  void rescue();

 private:
  explicit HalfErrorLog(RowLog rows) : rows_(std::move(rows)) {}
  RowLog rows_;
  bool is_empty_ = true;
};

}  // namespace penumbra
