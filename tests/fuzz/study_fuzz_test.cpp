// Damaged scripts and result rows of a study are rejected (scripts with an error of one line), or
// read as valid. Deterministic.
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "app/study/study_results.hpp"
#include "app/study/study_script.hpp"
#include "support/mutate.hpp"

namespace penumbra {
namespace {

TEST(StudyFuzz, ReadsOrRejectsDamagedScript) {
  const std::string good =
      "# trial seconds action\n1 1.25 click sphere 2\n2 0.9 click table 0.05 0.1 0.04\n"
      "2 1.0 click pixel 320 240\n3 1.0 press left ball\n3 1.5 move by 0.03 -0.02 0\n"
      "3 2.0 release\n4 0.5 accept\n";
  ASSERT_TRUE(parse_study_script(good, "script.txt"));
  test::Random random(11);
  int accepted = 0;
  constexpr int kCount = 20000;
  for (int i = 0; i < kCount; ++i) {
    const std::string text = test::mutated(good, random,
                                           {"nan", "inf", "1e999", "-1", "99999999999999999999",
                                            "by", "press", "release", "\n", " ", "#", "ball"});
    const auto script = parse_study_script(text, "script.txt");
    if (!script) {
      ASSERT_EQ(script.error().message.find('\n'), std::string::npos);
      ASSERT_TRUE(script.error().message.starts_with("script.txt: ")) << script.error().message;
      continue;
    }
    ++accepted;
    const ScriptAction* before = nullptr;
    for (const ScriptAction& action : script->actions) {
      ASSERT_GE(action.trial, 1);
      ASSERT_GE(action.at_ns, 0);
      ASSERT_TRUE(action.place.point.allFinite());
      if (before != nullptr && before->trial == action.trial) {
        ASSERT_LE(before->at_ns, action.at_ns);
      }
      before = &action;
    }
  }
  EXPECT_GT(accepted, kCount / 50);
  EXPECT_LT(accepted, kCount * 9 / 10);
}

TEST(StudyFuzz, ReadsOrRejectsDamagedResultRow) {
  StudyRow row;
  row.study = "heights-seed1-samples3-layered";
  row.technique = "layered";
  row.places = {{0.01, -0.02, 0.03}, {0.1, 0.2, 0.125}, {-0.1, 0.0, 0.02}};
  row.chosen = "2";
  row.response_time_ns = 1'250'000'000;
  const std::string good = format_study_row(row);
  ASSERT_TRUE(parse_study_row(good));
  test::Random random(12);
  int accepted = 0;
  constexpr int kCount = 20000;
  for (int i = 0; i < kCount; ++i) {
    const auto read = parse_study_row(
        test::mutated(good, random, {"nan", "inf", "1e999", "-1", ",", ";", "99999999999999"}));
    if (!read) continue;
    ++accepted;
    ASSERT_TRUE(std::isfinite(read->error_m));
    ASSERT_GE(read->response_time_ns, 0);
    ASSERT_GE(read->participant, 1);
    for (const Eigen::Vector3d& place : read->places) ASSERT_TRUE(place.allFinite());
  }
  EXPECT_GT(accepted, kCount / 50);
  EXPECT_LT(accepted, kCount * 9 / 10);
}

}  // namespace
}  // namespace penumbra
