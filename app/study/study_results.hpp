// What participants answered: rows of a CSV file that only ever grows, and what they come to.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/output/output_file.hpp"
#include "app/study/study_plan.hpp"
#include "app/study/study_statistics.hpp"
#include "core/error.hpp"

namespace penumbra {

// One answer: a sphere that was pointed at, or a target that was reached.
struct StudyRow {
  std::string study;  // study_name()
  int participant = 1;
  int block = 1, trial = 1;
  std::string technique;
  int sample = 1;
  int step = 1;       // of a drag: which target; else 1
  bool hard = false;  // of heights
  // Centres [m]: of heights the three spheres, of a drag the target.
  std::vector<Eigen::Vector3d> places;
  // Of heights which sphere, from 1; of a drag where the ball was left [m].
  std::string chosen;
  bool correct = false;               // the highest; within the tolerance
  std::int64_t response_time_ns = 0;  // since it was shown, or since the target before was reached
  // Heights: how much higher the highest is than the chosen one; drag: from ball to target.
  double error_m = 0.0;
  int misses = 0;       // clicks beside all spheres; drags that ended off the target
  int frames = 0;       // shown meanwhile
  int frames_lost = 0;  // of them without a pose: nothing was drawn into them
};

// The columns' names, and a row of them, without line break.
[[nodiscard]] std::string_view study_header();
[[nodiscard]] std::string format_study_row(const StudyRow& row);
[[nodiscard]] std::optional<StudyRow> parse_study_row(std::string_view line);

// A results file, open to be added to.
class StudyFile {
 public:
  // Makes the file, or opens one of the same study. A last line that was cut off (the power failed)
  // is taken away. Fails, naming the file, where it is of another study or no study at all, where
  // another study is writing to it, and where it has rows of this participant already, unless
  // `resume`. A stream (standard output, a pipe) receives the header and this study's rows.
  [[nodiscard]] static Result<StudyFile> open(const std::filesystem::path& file,
                                              const StudyDesign& design, bool resume);
  StudyFile(StudyFile&& other) noexcept;
  StudyFile& operator=(StudyFile&& other) = delete;
  StudyFile(const StudyFile&) = delete;
  StudyFile& operator=(const StudyFile&) = delete;
  ~StudyFile();

  // Every row, those of earlier participants too.
  [[nodiscard]] const std::vector<StudyRow>& rows() const { return rows_; }
  // On the disk when this returns.
  [[nodiscard]] Result<void> append(std::span<const StudyRow> rows);

 private:
  StudyFile(std::filesystem::path file, int handle) : file_(std::move(file)), handle_(handle) {}
  [[nodiscard]] Result<void> write_line(const std::string& text);
  std::filesystem::path file_;
  int handle_ = -1;
  std::optional<OutputFile> stream_;  // in place of the handle
  std::vector<StudyRow> rows_;
};
// The first trial of the plan that has no rows.
[[nodiscard]] std::size_t first_open_trial(const StudyPlan& plan, std::span<const StudyRow> rows);

// Per technique, over all participants. Answers of one participant are no independent sample of
// people: with several participants, each counts with its own median (and share), and the interval
// is over participants.
struct StudySummary {
  std::string technique;
  int participants = 0, answers = 0;
  std::optional<MedianEstimate> response_time_s;
  std::optional<MedianEstimate> error_m;
  double wrong_share = 0.0;  // of several participants: the median of their shares
  std::optional<Interval> wrong_interval;
};
[[nodiscard]] std::vector<StudySummary> summarise(const StudyDesign& design,
                                                  std::span<const StudyRow> rows);
[[nodiscard]] std::string summary_table(StudyExperiment experiment,
                                        std::span<const StudySummary> summary);
[[nodiscard]] std::string summary_csv(const std::string& study,
                                      std::span<const StudySummary> summary);
// "results.csv" -> "results-summary.csv".
[[nodiscard]] std::filesystem::path summary_path(const std::filesystem::path& results);

}  // namespace penumbra
