#include "app/study/study_results.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <map>
#include <system_error>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxResultBytes = std::size_t{256} << 20U;
constexpr std::size_t kColumns = 17;

// Parses "x y z" [m].
std::optional<Eigen::Vector3d> point_in(std::string_view text) {
  const auto parts = split(text, ' ');
  if (parts.size() != 3) return std::nullopt;
  Eigen::Vector3d point;
  for (Eigen::Index i = 0; i < 3; ++i) {
    const auto number = parse_number(parts[static_cast<std::size_t>(i)]);
    if (!number || !std::isfinite(*number)) return std::nullopt;
    point[i] = *number;
  }
  return point;
}

tl::unexpected<Error> not_written(const fs::path& file, std::string_view remedy = "") {
  return fail("{}: cannot be written: {}{}", file.string(), system_message(errno), remedy);
}

std::string interval_text(const std::optional<Interval>& interval, double scale, int decimals) {
  if (!interval) return "-";
  return fmt::format("{:.{}f} - {:.{}f}", scale * interval->low, decimals, scale * interval->high,
                     decimals);
}

std::string csv_fields(double value, const std::optional<Interval>& interval) {
  std::string text = fmt::format(",{:.6f}", value);
  return text + (interval ? fmt::format(",{:.6f},{:.6f}", interval->low, interval->high) : ",,");
}

struct Answers {
  std::vector<double> times_s, errors_m;
  int wrong = 0;
};

StudySummary participant_summary(const Answers& answers) {
  StudySummary summary;
  summary.response_time_s = median_of(answers.times_s);
  summary.error_m = median_of(answers.errors_m);
  const FractionEstimate wrong =
      estimate_fraction(answers.wrong, static_cast<int>(answers.times_s.size()));
  summary.wrong_fraction = wrong.proportion;
  summary.wrong_interval = wrong.interval;
  return summary;
}

}  // namespace

std::string format_places(std::span<const Eigen::Vector3d> places) {
  std::string text;
  for (const Eigen::Vector3d& p : places) {
    text += fmt::format("{}{:.4f} {:.4f} {:.4f}", text.empty() ? "" : ";", p.x(), p.y(), p.z());
  }
  return text;
}

std::string_view difficulty_of(bool heights, bool hard) {
  if (!heights) return "";
  return hard ? "hard" : "easy";
}

std::string format_study_row(const StudyRow& row) {
  const bool heights = row.places.size() == 3;
  return fmt::format("{},{},{},{},{},{},{},{},{},{},{},{},{},{:.6f},{},{},{}", row.study,
                     heights ? "heights" : "drag", row.participant, row.block, row.trial,
                     row.technique, row.sample, row.step, difficulty_of(heights, row.hard),
                     format_places(row.places), row.chosen, row.correct ? 1 : 0,
                     format_ns_as_seconds(row.response_time_ns), row.error_m, row.misses,
                     row.frames, row.frames_lost);
}

std::optional<StudyRow> parse_study_row(std::string_view line) {
  const auto fields = split(line, ',');
  if (fields.size() != kColumns) return std::nullopt;
  StudyRow row;
  row.study = fields[0];
  row.technique = fields[5];
  row.chosen = fields[10];
  row.hard = fields[8] == "hard";
  for (const std::string_view text : split(fields[9], ';')) {
    const auto point = point_in(text);
    if (!point) return std::nullopt;
    row.places.push_back(*point);
  }
  struct Count {
    std::size_t field;
    int minimum;
    int StudyRow::*value;
  };
  constexpr std::array<Count, 8> kCounts = {{{2, 1, &StudyRow::participant},
                                             {3, 1, &StudyRow::block},
                                             {4, 1, &StudyRow::trial},
                                             {6, 1, &StudyRow::sample},
                                             {7, 1, &StudyRow::step},
                                             {14, 0, &StudyRow::misses},
                                             {15, 0, &StudyRow::frames},
                                             {16, 0, &StudyRow::frames_lost}}};
  for (const auto& [field, minimum, value] : kCounts) {
    const auto count = parse_integer(fields[field]);
    if (!count || *count < minimum || *count > 1'000'000'000) return std::nullopt;
    row.*value = static_cast<int>(*count);
  }
  const auto time = parse_seconds_as_ns(fields[12]);
  const auto error = parse_number(fields[13]);
  const bool known_words = (fields[11] == "0" || fields[11] == "1") &&
                           (fields[1] == "heights" || fields[1] == "drag") &&
                           (fields[8].empty() || fields[8] == "easy" || fields[8] == "hard");
  if (!time || *time < 0 || !error || !std::isfinite(*error) || !known_words || row.study.empty()) {
    return std::nullopt;
  }
  row.correct = fields[11] == "1";
  row.response_time_ns = *time;
  row.error_m = *error;
  return row;
}

Result<StudyFile> StudyFile::open(const fs::path& file, const StudyDesign& design, bool resume) {
  std::error_code ignored;
  if (is_stream(file)) {
    if (resume) return fail("{}: is a stream, which holds no answers to go on with", file.string());
    PENUMBRA_TRY(auto stream, OutputFile::create(file));
    StudyFile results(file, -1);
    results.stream_.emplace(std::move(stream));
    PENUMBRA_TRY_VOID(results.write_line(std::string(kStudyHeader)));
    return results;
  }
  if (fs::exists(file, ignored) && !fs::is_regular_file(file, ignored)) {
    return fail("{}: is not a file that rows can be added to; name another", file.string());
  }
  const int handle = ::open(file.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (handle < 0) return not_written(file, "; choose another place");
  StudyFile results(file, handle);
  if (flock(handle, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    return fail("{}: another study is writing to it; wait for its end, or name another file",
                file.string());
  }
  PENUMBRA_TRY(auto text, read_text_file(file, kMaxResultBytes));
  // The text lacks the file's byte-order mark, if there is one.
  const std::uintmax_t mark_bytes = fs::file_size(file, ignored) - text.size();
  if (kStudyHeader.starts_with(text)) {  // new, or truncated during its creation
    if (ftruncate(handle, 0) != 0) return not_written(file);
    PENUMBRA_TRY_VOID(results.write_line(std::string(kStudyHeader)));
    return results;
  }
  const std::string study = study_name(design);
  const std::size_t line_end = text.rfind('\n') == std::string::npos ? 0 : text.rfind('\n') + 1;
  const auto lines = split(std::string_view(text).substr(0, line_end), '\n');
  if (lines[0] != kStudyHeader) {
    return fail("{}: is not a results file of penumbra study; name another file", file.string());
  }
  for (std::size_t i = 1; i < lines.size(); ++i) {
    if (lines[i].empty() && i + 1 == lines.size()) break;  // after the last line break
    auto row = parse_study_row(lines[i]);
    if (!row) {
      return fail("{}: line {}: is damaged; repair or remove it", file.string(), i + 1);
    }
    if (row->study != study) {
      return fail(
          "{}: holds the study {}, but this one is {}; give the same options, or name another file",
          file.string(), row->study, study);
    }
    results.rows_.push_back(std::move(*row));
  }
  const bool begun = std::ranges::any_of(
      results.rows_, [&](const StudyRow& row) { return row.participant == design.participant; });
  if (begun && !resume) {
    return fail(
        "{}: has answers of participant {} already; give another --participant, or --resume to go "
        "on with the first trial that has no answer",
        file.string(), design.participant);
  }
  if (line_end < text.size()) {
    log_warning("{}: its last line was cut off and is removed", file.string());
    if (ftruncate(handle, static_cast<off_t>(mark_bytes + line_end)) != 0) return not_written(file);
  }
  return results;
}

StudyFile::StudyFile(StudyFile&& other) noexcept
    : file_(std::move(other.file_)),
      handle_(std::exchange(other.handle_, -1)),
      stream_(std::move(other.stream_)),
      rows_(std::move(other.rows_)) {}

StudyFile::~StudyFile() {
  if (handle_ >= 0) close(handle_);  // releases the lock
}

Result<void> StudyFile::write_line(const std::string& text) {
  const std::string line = text + "\n";
  if (stream_) return stream_->append(line);
  constexpr std::string_view kResumeRemedy = "; free some space and go on with --resume";
  std::size_t done = 0;
  while (done < line.size()) {
    const ssize_t count = write(handle_, line.data() + done, line.size() - done);
    if (count >= 0) {
      done += static_cast<std::size_t>(count);
    } else if (errno != EINTR) {
      return not_written(file_, kResumeRemedy);
    }
  }
  if (fdatasync(handle_) != 0 && errno != EINVAL) {  // EINVAL: the file cannot be synchronised
    return not_written(file_, kResumeRemedy);
  }
  return {};
}

Result<void> StudyFile::append(std::span<const StudyRow> rows) {
  std::string lines;
  for (const StudyRow& row : rows) {
    lines += (lines.empty() ? "" : "\n") + format_study_row(row);
  }
  if (lines.empty()) return {};
  PENUMBRA_TRY_VOID(write_line(lines));
  rows_.insert(rows_.end(), rows.begin(), rows.end());
  return {};
}

std::size_t first_open_trial(const StudyPlan& plan, std::span<const StudyRow> rows) {
  std::size_t first = 0;
  for (std::size_t i = 0; i < plan.trials.size(); ++i) {
    const StudyTrial& trial = plan.trials[i];
    const bool answered = std::ranges::any_of(rows, [&](const StudyRow& row) {
      return row.participant == plan.design.participant && row.block == trial.block &&
             row.trial == trial.trial;
    });
    if (answered) first = i + 1;
  }
  return first;
}

std::vector<StudySummary> summarise(const StudyDesign& design, std::span<const StudyRow> rows) {
  std::vector<StudySummary> all;
  for (const StudyTechnique& technique : design.techniques) {
    std::map<int, Answers> by_participant;
    int count = 0;
    for (const StudyRow& row : rows) {
      if (row.technique != technique.name) continue;
      Answers& answers = by_participant[row.participant];
      answers.times_s.push_back(seconds(row.response_time_ns));
      answers.errors_m.push_back(row.error_m);
      answers.wrong += row.correct ? 0 : 1;
      ++count;
    }
    StudySummary summary;
    if (by_participant.size() == 1) {
      summary = participant_summary(by_participant.begin()->second);
    } else if (!by_participant.empty()) {
      std::vector<double> times, errors, fractions;
      for (const auto& [participant, answers] : by_participant) {
        const StudySummary one = participant_summary(answers);
        times.push_back(one.response_time_s->median);
        errors.push_back(one.error_m->median);
        fractions.push_back(one.wrong_fraction);
      }
      summary.response_time_s = median_of(times);
      summary.error_m = median_of(errors);
      const auto fraction = median_of(fractions);
      summary.wrong_fraction = fraction->median;
      summary.wrong_interval = fraction->interval;
    }
    summary.technique = technique.name;
    summary.participants = static_cast<int>(by_participant.size());
    summary.answers = count;
    all.push_back(std::move(summary));
  }
  return all;
}

std::string summary_table(StudyExperiment experiment, std::span<const StudySummary> summary) {
  const bool drag = experiment == StudyExperiment::drag;
  std::string table =
      fmt::format("{:<10}{:>13}{:>9}{:>11}{:>17}{:>10}{:>15}", "technique", "participants",
                  "answers", "time [s]", "95 %", drag ? "off [%]" : "wrong [%]", "95 %");
  if (drag) table += fmt::format("{:>12}{:>15}", "error [mm]", "95 %");
  for (const StudySummary& one : summary) {
    table += fmt::format("\n{:<10}{:>13}{:>9}", one.technique, one.participants, one.answers);
    if (one.answers == 0) continue;
    table += fmt::format("{:>11.3f}{:>17}{:>10.1f}{:>15}", one.response_time_s->median,
                         interval_text(one.response_time_s->interval, 1.0, 3),
                         100.0 * one.wrong_fraction, interval_text(one.wrong_interval, 100.0, 1));
    if (drag) {
      table += fmt::format("{:>12.2f}{:>15}", 1e3 * one.error_m->median,
                           interval_text(one.error_m->interval, 1e3, 2));
    }
  }
  return table + "\n";
}

std::string summary_csv(const std::string& study, std::span<const StudySummary> summary) {
  std::string text =
      "study,technique,participants,answers,response_time_s,response_time_low_s,"
      "response_time_high_s,wrong_share,wrong_low,wrong_high,error_m,error_low_m,error_high_m\n";
  for (const StudySummary& one : summary) {
    text += fmt::format("{},{},{},{}", study, one.technique, one.participants, one.answers);
    if (one.answers == 0) {
      text += ",,,,,,,,,\n";
      continue;
    }
    text += csv_fields(one.response_time_s->median, one.response_time_s->interval) +
            csv_fields(one.wrong_fraction, one.wrong_interval) +
            csv_fields(one.error_m->median, one.error_m->interval) + "\n";
  }
  return text;
}

fs::path summary_path(const fs::path& results) {
  fs::path path = results;
  path.replace_filename(results.stem().string() + "-summary.csv");
  return path;
}

}  // namespace penumbra
