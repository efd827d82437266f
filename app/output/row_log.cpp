#include "app/output/row_log.hpp"

#include <cmath>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kJsonLines = ".jsonl";

std::string csv_text(const Json& value) {
  if (value.is_null()) return {};
  if (value.is_array()) {
    std::string words;
    for (const Json& item : value) words += (words.empty() ? "" : " ") + item.dump();
    return words;
  }
  if (!value.is_string()) return value.dump();
  const std::string& text = value.get_ref<const std::string&>();
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string csv_line(const Row& row, bool names) {
  std::string line;
  for (const Cell& cell : row) {
    if (&cell != &row.front()) line += ',';
    line += names ? cell.name : cell.csv.empty() ? csv_text(cell.value) : cell.csv;
  }
  return line + "\n";
}

std::string json_line(const Row& row) {
  Json json;
  for (const Cell& cell : row) json[cell.name] = cell.value;
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace

Json finite_or_null(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? Json(*value) : Json();
}

Cell time_cell(std::int64_t timestamp_ns) {
  return {"timestamp_s", seconds(timestamp_ns), format_ns_as_seconds(timestamp_ns)};
}

Cell utc_cell(const std::optional<std::int64_t>& utc_ns) {
  return {"wall_time", utc_ns ? Json(format_utc(*utc_ns)) : Json()};
}

bool is_row_log(const std::filesystem::path& file) {
  const std::string extension = lower_extension(file);
  return is_stream(file) || extension == ".csv" || extension == kJsonLines;
}

Result<RowLog> RowLog::create(const std::filesystem::path& file, const Row& columns) {
  PENUMBRA_TRY(auto output, OutputFile::create(file));
  RowLog log(std::move(output), lower_extension(file) == kJsonLines);
  if (!log.is_jsonl_) PENUMBRA_TRY_VOID(log.file_.append(csv_line(columns, true)));
  return log;
}

Result<void> RowLog::write(std::span<const Row> rows) {
  std::string text;
  for (const Row& row : rows) text += is_jsonl_ ? json_line(row) : csv_line(row, false);
  return file_.append(text);
}

void RowLog::rescue() {
  keep_complete_lines(file_);
}

}  // namespace penumbra
