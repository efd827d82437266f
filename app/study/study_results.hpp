// Answers of participants: rows of a CSV file that is only appended to, and their summary.
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
  int step = 1;       // drag: the target's number; else 1
  bool hard = false;  // heights
  // Centres [m]. heights: the three spheres; drag: the target.
  std::vector<Eigen::Vector3d> places;
  std::string chosen;                 // heights: the sphere, from 1; drag: the ball's position [m]
  bool correct = false;               // heights: the highest; drag: within the tolerance
  std::int64_t response_time_ns = 0;  // since the trial was shown or the last target reached
  double error_m = 0.0;               // heights: highest minus chosen height; drag: ball to target
  int misses = 0;                     // heights: clicks beside spheres; drag: drags off the target
  int frames = 0;                     // frames shown during the answer
  int frames_lost = 0;                // shown frames without a pose, and thus without objects
};

inline constexpr std::string_view kStudyHeader =
    "study,experiment,participant,block,trial,technique,sample,step,difficulty,places_m,chosen,"
    "correct,response_time_s,error_m,misses,frames,frames_lost";
// Returns a row with these columns, without a line break.
[[nodiscard]] std::string format_study_row(const StudyRow& row);
[[nodiscard]] std::optional<StudyRow> parse_study_row(std::string_view line);
// Returns "x y z;x y z" [m].
[[nodiscard]] std::string format_places(std::span<const Eigen::Vector3d> places);
// Returns "easy" or "hard" for heights, else "".
[[nodiscard]] std::string_view difficulty_of(bool heights, bool hard);

// A results file that is open for appending.
class StudyFile {
 public:
  // Creates the file, or opens a file of the same study and removes an incomplete last line. Fails
  // if the file belongs to another study or is no results file, or if another process is writing to
  // it. Without `resume`, also fails if it contains rows of this participant. A stream receives the
  // header and the new rows.
  [[nodiscard]] static Result<StudyFile> open(const std::filesystem::path& file,
                                              const StudyDesign& design, bool resume);
  StudyFile(StudyFile&& other) noexcept;
  StudyFile& operator=(StudyFile&& other) = delete;
  StudyFile(const StudyFile&) = delete;
  StudyFile& operator=(const StudyFile&) = delete;
  ~StudyFile();

  // All rows, including those of earlier participants.
  [[nodiscard]] const std::vector<StudyRow>& rows() const { return rows_; }
  // The rows are on disk when this returns.
  [[nodiscard]] Result<void> append(std::span<const StudyRow> rows);

 private:
  StudyFile(std::filesystem::path file, int handle) : file_(std::move(file)), handle_(handle) {}
  [[nodiscard]] Result<void> write_line(const std::string& text);
  std::filesystem::path file_;
  int handle_ = -1;
  std::optional<OutputFile> stream_;  // output stream; handle_ is then -1
  std::vector<StudyRow> rows_;
};
// Returns the index of the plan's first trial that has no rows.
[[nodiscard]] std::size_t first_open_trial(const StudyPlan& plan, std::span<const StudyRow> rows);

// Results of a technique. The answers of one participant are not independent. With several
// participants, each one contributes its median (or fraction), and intervals are over participants.
struct StudySummary {
  std::string technique;
  int participants = 0, answers = 0;
  std::optional<MedianEstimate> response_time_s;
  std::optional<MedianEstimate> error_m;
  double wrong_fraction = 0.0;  // with several participants the median of their fractions
  std::optional<Interval> wrong_interval;
};
[[nodiscard]] std::vector<StudySummary> summarise(const StudyDesign& design,
                                                  std::span<const StudyRow> rows);
[[nodiscard]] std::string summary_table(StudyExperiment experiment,
                                        std::span<const StudySummary> summary);
[[nodiscard]] std::string summary_csv(const std::string& study,
                                      std::span<const StudySummary> summary);
// Returns "results-summary.csv" for "results.csv".
[[nodiscard]] std::filesystem::path summary_path(const std::filesystem::path& results);

}  // namespace penumbra
