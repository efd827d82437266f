// Answers of participants: rows of a CSV file that only grows, and their summary.
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
  std::string chosen;                 // heights: the sphere, from 1; drag: the ball's place [m]
  bool correct = false;               // heights: the highest; drag: within the tolerance
  std::int64_t response_time_ns = 0;  // since it was shown, or since the last target was reached
  double error_m = 0.0;  // heights: the highest above the chosen one; drag: from ball to target
  int misses = 0;        // clicks beside all spheres; drags that ended off the target
  int frames = 0;        // shown during the answer
  int frames_lost = 0;   // of these without a pose: nothing was drawn
};

inline constexpr std::string_view kStudyHeader =
    "study,experiment,participant,block,trial,technique,sample,step,difficulty,places_m,chosen,"
    "correct,response_time_s,error_m,misses,frames,frames_lost";
// A row of these columns, without line break.
[[nodiscard]] std::string format_study_row(const StudyRow& row);
[[nodiscard]] std::optional<StudyRow> parse_study_row(std::string_view line);
// "x y z;x y z" [m].
[[nodiscard]] std::string format_places(std::span<const Eigen::Vector3d> places);
// "easy" or "hard" for heights, else "".
[[nodiscard]] std::string_view difficulty_of(bool heights, bool hard);

// A results file that is open for appending.
class StudyFile {
 public:
  // Creates the file, or opens one of the same study. Removes a last line that was cut off. Fails
  // if the file is of another study or of none, if another study is writing to it, and, unless
  // `resume`, if it has rows of this participant. A stream receives the header and this study's
  // rows.
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
  std::optional<OutputFile> stream_;  // in place of the handle
  std::vector<StudyRow> rows_;
};
// The first trial of the plan that has no rows.
[[nodiscard]] std::size_t first_open_trial(const StudyPlan& plan, std::span<const StudyRow> rows);

// Results of a technique. The answers of one participant are not independent: with several
// participants each one counts by its median (and share), and the interval is over participants.
struct StudySummary {
  std::string technique;
  int participants = 0, answers = 0;
  std::optional<MedianEstimate> response_time_s;
  std::optional<MedianEstimate> error_m;
  double wrong_share = 0.0;  // with several participants the median of their shares
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
