// A table that is written row by row: CSV, or a JSON object on each line.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/output/output_file.hpp"
#include "core/error.hpp"

namespace penumbra {

// A column of a CSV file, or a key of a JSON line. Unknown values (null) are empty in CSV.
struct Cell {
  std::string name;
  nlohmann::ordered_json value;
  std::string csv = {};  // instead of `value` in CSV, if it is more exact
};
using Row = std::vector<Cell>;

// Returns null for an unknown number, or one that is not finite.
[[nodiscard]] nlohmann::ordered_json finite_or_null(const std::optional<double>& value);
// The cells `timestamp_s`, and `wall_time` with the same time as UTC.
[[nodiscard]] Cell time_cell(std::int64_t timestamp_ns);
[[nodiscard]] Cell utc_cell(const std::optional<std::int64_t>& utc_ns);

// Returns true if RowLog can write the file: *.csv, *.jsonl, or a stream.
[[nodiscard]] bool is_row_log(const std::filesystem::path& file);

class RowLog {
 public:
  // The file's extension determines the format; standard output receives CSV. `columns`: a row with
  // the names of the columns; its values are not written.
  [[nodiscard]] static Result<RowLog> create(const std::filesystem::path& file, const Row& columns);

  // Every row has the cells of `columns`. A stream receives them at once.
  [[nodiscard]] Result<void> write(std::span<const Row> rows);
  [[nodiscard]] Result<void> finish() { return file_.commit(); }
  // Call this after an error. Keeps the complete rows written before.
  void rescue();

 private:
  RowLog(OutputFile file, bool is_jsonl) : file_(std::move(file)), is_jsonl_(is_jsonl) {}
  OutputFile file_;
  bool is_jsonl_;
};

}  // namespace penumbra
