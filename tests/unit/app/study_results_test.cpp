#include "app/study/study_results.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "app/study/study_statistics.hpp"
#include "support/paths.hpp"
#include "support/utf16.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

TEST(StudyStatistics, ComputesMedianIntervalFromOrderStatistics) {
  EXPECT_FALSE(median_of({}));
  const std::array five = {5.0, 1.0, 4.0, 2.0, 3.0};
  ASSERT_TRUE(median_of(five));
  EXPECT_EQ(median_of(five)->median, 3.0);
  EXPECT_FALSE(median_of(five)->interval) << "for 5 values the error rate of 2 / 32 exceeds 5 %";
  std::vector<double> values;
  for (int i = 1; i <= 6; ++i) values.push_back(i);
  EXPECT_EQ(median_of(values)->median, 3.5);
  ASSERT_TRUE(median_of(values)->interval);
  EXPECT_EQ(median_of(values)->interval->low, 1.0);
  EXPECT_EQ(median_of(values)->interval->high, 6.0);
  // Ranks that bound the median, from tables of the sign test (Conover, Practical Nonparametric
  // Statistics). n = 10: 2nd and 9th; n = 20: 6th and 15th; n = 50: 18th and 33rd.
  struct Known {
    int n, low, high;
  };
  for (const Known known : {Known{10, 2, 9}, Known{20, 6, 15}, Known{50, 18, 33}}) {
    values.clear();
    for (int i = known.n; i >= 1; --i) values.push_back(i);
    ASSERT_TRUE(median_of(values)->interval);
    EXPECT_EQ(median_of(values)->interval->low, known.low);
    EXPECT_EQ(median_of(values)->interval->high, known.high);
  }
  values.assign(100'000, 2.0);
  EXPECT_EQ(median_of(values)->interval->low, 2.0);
}

// Coverage of the interval for a skewed distribution, like that of response times.
TEST(StudyStatistics, CoversMedianAtNominalRate) {
  std::mt19937_64 random(3);
  std::lognormal_distribution<double> times(1.0, 0.8);
  const double truth = std::exp(1.0);
  constexpr int kRuns = 4000;
  int covered = 0;
  for (int run = 0; run < kRuns; ++run) {
    std::array<double, 20> values{};
    for (double& value : values) value = times(random);
    const auto interval = median_of(values)->interval;
    covered += interval->low <= truth && truth <= interval->high ? 1 : 0;
  }
  // The exact coverage for 20 values is 95.86 %; this estimate has a standard deviation of 0.3 %.
  EXPECT_NEAR(static_cast<double>(covered) / kRuns, 0.9586, 0.0130);
}

TEST(StudyStatistics, ComputesWilsonIntervalOfProportion) {
  // Newcombe 1998, Statistics in Medicine 17:857, table I: 81/263, 15/148, 0/20, 1/29.
  struct Known {
    int hits, count;
    double low, high;
  };
  for (const Known known : {Known{81, 263, 0.2553, 0.3662}, Known{15, 148, 0.0624, 0.1605},
                            Known{0, 20, 0.0, 0.1611}, Known{1, 29, 0.0061, 0.1718}}) {
    const FractionEstimate fraction = estimate_fraction(known.hits, known.count);
    EXPECT_NEAR(fraction.interval.low, known.low, 6e-5);
    EXPECT_NEAR(fraction.interval.high, known.high, 6e-5);
  }
  EXPECT_EQ(estimate_fraction(20, 20).interval.high, 1.0);
}

StudyDesign design_of(int participant) {
  StudyDesign design;
  design.techniques = {*study_technique_from_string("layered"),
                       *study_technique_from_string("walls")};
  design.participant = participant;
  design.samples = 3;
  return design;
}

StudyRow row_of(const StudyDesign& design, int block, int trial, double time_s, bool correct) {
  StudyRow row;
  row.study = study_name(design);
  row.participant = design.participant;
  row.block = block;
  row.trial = trial;
  row.technique = design.techniques[static_cast<std::size_t>(block - 1)].name;
  row.sample = 3;
  row.hard = true;
  row.places = {{0.01, -0.02, 0.03}, {0.1, 0.2, 0.125}, {-0.1, 0.0, 0.02}};
  row.chosen = "2";
  row.correct = correct;
  row.response_time_ns = static_cast<std::int64_t>(time_s * 1e9);
  row.error_m = correct ? 0.0 : 0.0125;
  row.misses = 1;
  row.frames = 30;
  row.frames_lost = 2;
  return row;
}

std::string text_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST(StudyRow, RoundTripsThroughText) {
  const StudyRow row = row_of(design_of(4), 2, 1, 1.25, false);
  const std::string line = format_study_row(row);
  EXPECT_EQ(line,
            "heights-seed1-samples3-layered+walls,heights,4,2,1,walls,3,1,hard,"
            "0.0100 -0.0200 0.0300;0.1000 0.2000 0.1250;-0.1000 0.0000 0.0200,2,0,1.250000000,"
            "0.012500,1,30,2");
  const auto read = parse_study_row(line);
  ASSERT_TRUE(read);
  EXPECT_EQ(format_study_row(*read), line);
  EXPECT_EQ(read->response_time_ns, 1'250'000'000);
  EXPECT_FALSE(parse_study_row(""));
  EXPECT_FALSE(parse_study_row(line + ",1"));
  for (const char* wrong : {"nan", "", "x", "-1"}) {
    std::string damaged = line;
    damaged.replace(damaged.find("1.250000000"), 11, wrong);
    EXPECT_FALSE(parse_study_row(damaged)) << wrong;
  }
  const auto commas = [](std::string_view text) { return std::ranges::count(text, ','); };
  EXPECT_EQ(commas(line), commas(kStudyHeader));
}

// Some spreadsheets save CSV files with a byte-order mark.
TEST(StudyFile, AcceptsByteOrderMark) {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "answers.csv";
  const std::string row = format_study_row(row_of(design_of(1), 1, 1, 1.0, true)) + "\n";
  const std::string text = std::string(kStudyHeader) + "\n" + row;
  std::ofstream(path) << "\xEF\xBB\xBF" + text + row.substr(0, 20);
  {
    auto file = StudyFile::open(path, design_of(2), false);
    ASSERT_TRUE(file) << file.error().message;
    EXPECT_EQ(file->rows().size(), 1U);
    ASSERT_TRUE(file->append(std::vector{row_of(design_of(2), 1, 1, 2.0, false)}));
  }
  EXPECT_EQ(text_of(path), "\xEF\xBB\xBF" + text +
                               format_study_row(row_of(design_of(2), 1, 1, 2.0, false)) + "\n");
  for (const bool with_mark : {true, false}) {
    const std::string wide = test::as_utf16(text, with_mark);
    std::ofstream(path, std::ios::binary) << wide;
    const auto file = StudyFile::open(path, design_of(2), false);
    ASSERT_FALSE(file);
    EXPECT_EQ(file.error().message, path.string() + ": is UTF-16 text; save it as UTF-8");
    EXPECT_EQ(text_of(path), wide) << "a UTF-16 file must not be changed";
  }
}

TEST(StudyFile, KeepsExistingRowsAndRejectsOtherStudies) {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "answers.csv";
  const StudyDesign first = design_of(1);
  {
    auto file = StudyFile::open(path, first, false);
    ASSERT_TRUE(file) << file.error().message;
    ASSERT_TRUE(file->append(std::vector{row_of(first, 1, 1, 1.0, true)}));
    EXPECT_EQ(text_of(path), std::string(kStudyHeader) + "\n" +
                                 format_study_row(row_of(first, 1, 1, 1.0, true)) + "\n");
    const auto twice = StudyFile::open(path, design_of(2), false);
    ASSERT_FALSE(twice);
    EXPECT_NE(twice.error().message.find("another study is writing"), std::string::npos);
  }
  const auto again = StudyFile::open(path, first, false);
  ASSERT_FALSE(again);
  EXPECT_NE(again.error().message.find("--resume"), std::string::npos);
  auto other = design_of(2);
  other.seed = 99;
  const auto other_study = StudyFile::open(path, other, false);
  ASSERT_FALSE(other_study);
  EXPECT_NE(other_study.error().message.find("holds the study"), std::string::npos);
  const std::string before = text_of(path);
  {
    auto second = StudyFile::open(path, design_of(2), false);
    ASSERT_TRUE(second) << second.error().message;
    EXPECT_EQ(second->rows().size(), 1U);
    ASSERT_TRUE(second->append(std::vector{row_of(design_of(2), 1, 1, 2.0, false)}));
  }
  EXPECT_TRUE(text_of(path).starts_with(before)) << "rows must only be appended";

  const fs::path no_study = folder.path() / "table.csv";
  std::ofstream(no_study) << "a,b\n1,2\n";
  ASSERT_FALSE(StudyFile::open(no_study, first, false));
  EXPECT_EQ(text_of(no_study), "a,b\n1,2\n");
  ASSERT_FALSE(StudyFile::open(folder.path(), first, false));
  ASSERT_FALSE(StudyFile::open(folder.path() / "nowhere" / "a.csv", first, false));
}

// A power failure during a write loses only the row that is being written.
TEST(StudyFile, LosesOnlyTruncatedLine) {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "answers.csv";
  const StudyDesign design = design_of(1);
  const std::string whole = std::string(kStudyHeader) + "\n" +
                            format_study_row(row_of(design, 1, 1, 1.0, true)) + "\n" +
                            format_study_row(row_of(design, 1, 2, 1.5, true)) + "\n";
  const StudyPlan plan = plan_study(design);
  for (std::size_t cut = 0; cut < whole.size(); cut += 7) {
    fs::remove(path);
    std::ofstream(path, std::ios::binary) << whole.substr(0, cut);
    const auto lines = static_cast<std::size_t>(std::ranges::count(whole.substr(0, cut), '\n'));
    auto file = StudyFile::open(path, design, true);
    ASSERT_TRUE(file) << cut << ": " << file.error().message;
    ASSERT_EQ(file->rows().size(), lines == 0 ? 0 : lines - 1);
    EXPECT_EQ(first_open_trial(plan, file->rows()), file->rows().size());
    ASSERT_TRUE(file->append(std::vector{row_of(design, 2, 1, 9.0, true)}));
    const std::string text = text_of(path);
    ASSERT_EQ(static_cast<std::size_t>(std::ranges::count(text, '\n')),
              std::max<std::size_t>(lines, 1) + 1);
  }
  // A damaged line in the middle is an error.
  fs::remove(path);
  std::string damaged = whole;
  damaged[damaged.find("1.000000000")] = 'x';
  std::ofstream(path, std::ios::binary) << damaged;
  const auto file = StudyFile::open(path, design, true);
  ASSERT_FALSE(file);
  EXPECT_NE(file.error().message.find("line 2"), std::string::npos) << file.error().message;
  EXPECT_EQ(text_of(path), damaged);
}

TEST(StudySummary, SummarisesOneOrSeveralParticipants) {
  std::vector<StudyRow> rows;
  for (int i = 0; i < 10; ++i) rows.push_back(row_of(design_of(1), 1, 1, 1.0 + i, i < 8));
  auto summary = summarise(design_of(1), rows);
  ASSERT_EQ(summary.size(), 2U);
  EXPECT_EQ(summary[0].technique, "layered");
  EXPECT_EQ(summary[0].answers, 10);
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->median, 5.5);
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->interval->low, 2.0);
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->interval->high, 9.0);
  EXPECT_DOUBLE_EQ(summary[0].wrong_fraction, 0.2);
  EXPECT_EQ(summary[1].answers, 0);
  EXPECT_FALSE(summary[1].response_time_s);
  // Adds six participants with different medians, one of whom gave far more answers.
  for (int person = 2; person <= 7; ++person) {
    for (int i = 0; i < (person == 7 ? 1000 : 3); ++i) {
      rows.push_back(row_of(design_of(person), 1, 1, 10.0 * person + i % 3, true));
    }
  }
  summary = summarise(design_of(1), rows);
  EXPECT_EQ(summary[0].participants, 7);
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->median, 41.0);  // median of 5.5, 21, 31, ... 71
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->interval->low, 5.5);
  EXPECT_DOUBLE_EQ(summary[0].response_time_s->interval->high, 71.0);
  EXPECT_DOUBLE_EQ(summary[0].wrong_fraction, 0.0);
  const std::string csv = summary_csv("s", summary);
  EXPECT_NE(csv.find("\ns,layered,7,1025,41.000000,5.500000,71.000000,0.000000,"),
            std::string::npos)
      << csv;
  EXPECT_NE(csv.find("\ns,walls,0,0,,,,,,,,,\n"), std::string::npos) << csv;
  EXPECT_EQ(summary_path("a/b.csv"), fs::path("a/b-summary.csv"));
}

}  // namespace
}  // namespace penumbra
