#include "core/text/text.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <rapidcheck/gtest.h>
#include <cmath>
#include <limits>

#include "support/paths.hpp"

namespace penumbra {
namespace {

TEST(Text, ParsesSecondsToExactNanoseconds) {
  EXPECT_EQ(parse_seconds_as_ns("0"), 0);
  EXPECT_EQ(parse_seconds_as_ns("0.033333"), 33333000);
  EXPECT_EQ(parse_seconds_as_ns("1311868164.363181"), 1311868164363181000);
  // A double can't represent these digits; the nearest double is 1403636579763555584.
  EXPECT_EQ(parse_seconds_as_ns("1403636579.763555527"), 1403636579763555527);
  EXPECT_EQ(parse_seconds_as_ns("1.403636579763555527e+09"), 1403636579763555527);
  EXPECT_EQ(parse_seconds_as_ns("-0.5"), -500000000);
  EXPECT_EQ(parse_seconds_as_ns(".25"), 250000000);
  EXPECT_EQ(parse_seconds_as_ns("7."), 7000000000);
  EXPECT_EQ(parse_seconds_as_ns("+3"), 3000000000);
  EXPECT_EQ(parse_seconds_as_ns("0000000000000000000000001"), 1000000000);
}

TEST(Text, RoundsDigitsBeyondNanosecond) {
  EXPECT_EQ(parse_seconds_as_ns("0.0000000004"), 0);
  EXPECT_EQ(parse_seconds_as_ns("0.0000000005"), 1);
  EXPECT_EQ(parse_seconds_as_ns("0.9999999999"), 1000000000);
  EXPECT_EQ(parse_seconds_as_ns("1e-30"), 0);
}

TEST(Text, RejectsInvalidTimes) {
  for (const char* text : {"", "-", ".", "abc", "1.2.3", "nan", "inf", "1e", "1e400", "12 3",
                           "99999999999", "--1", "1,5", "0x10"}) {
    EXPECT_EQ(parse_seconds_as_ns(text), std::nullopt) << text;
  }
}

RC_GTEST_PROP(Text, RoundTripsTimes, ()) {
  const auto time =
      *rc::gen::inRange<std::int64_t>(-4'000'000'000'000'000'000, 4'000'000'000'000'000'000);
  RC_ASSERT(parse_seconds_as_ns(format_ns_as_seconds(time)) == time);
}

TEST(Text, FormatsUtcOfEveryNanosecond) {
  EXPECT_EQ(format_utc(0), "1970-01-01T00:00:00.000000000Z");
  EXPECT_EQ(format_utc(1'582'934'400'000'000'001), "2020-02-29T00:00:00.000000001Z");
  EXPECT_EQ(format_utc(-1), "1969-12-31T23:59:59.999999999Z");
  EXPECT_EQ(format_utc(-1'000'000'000), "1969-12-31T23:59:59.000000000Z");
  EXPECT_EQ(format_utc(std::numeric_limits<std::int64_t>::min()), "1677-09-21T00:12:43.145224192Z");
  EXPECT_EQ(format_utc(std::numeric_limits<std::int64_t>::max()), "2262-04-11T23:47:16.854775807Z");
}

TEST(Text, ParsesOnlyCompleteNumbers) {
  EXPECT_EQ(parse_number("-1.5e3"), -1500.0);
  EXPECT_EQ(parse_number("+2"), 2.0);
  EXPECT_TRUE(std::isnan(parse_number("nan").value()));
  for (const char* text : {"", " 1", "1 ", "1.0abc", "+-1", "e3", "0x1p3"})
    EXPECT_EQ(parse_number(text), std::nullopt) << text;
  EXPECT_EQ(parse_integer("42"), 42);
  EXPECT_EQ(parse_integer("4.0"), std::nullopt);
  EXPECT_EQ(parse_integer("99999999999999999999"), std::nullopt);
}

TEST(Text, ReportsFilesThatCannotBeRead) {
  const test::TemporaryFolder folder;
  const auto missing = read_text_file(folder.path() / "none.txt", 10);
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, testing::HasSubstr("none.txt"));
  EXPECT_FALSE(read_text_file(folder.path(), 10));
  ASSERT_TRUE(write_text_file(folder.path() / "a.txt", "0123456789"));
  EXPECT_EQ(read_text_file(folder.path() / "a.txt", 10).value(), "0123456789");
  EXPECT_FALSE(read_text_file(folder.path() / "a.txt", 9));
  EXPECT_FALSE(write_text_file(folder.path() / "no" / "a.txt", "x"));
}

TEST(Text, EscapesMarkup) {
  EXPECT_EQ(in_markup("<b title=\"a & b\">"), "&lt;b title=&quot;a &amp; b&quot;&gt;");
  EXPECT_EQ(in_markup("0.3 m"), "0.3 m");
}

TEST(TextFile, IsReadWithoutByteOrderMark) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "a.txt";
  ASSERT_TRUE(write_text_file(file, "\xEF\xBB\xBFtext"));
  EXPECT_EQ(read_text_file(file, 100).value(), "text");
  ASSERT_TRUE(write_text_file(file, "\xFE\xFF"));
  const auto wide = read_text_file(file, 100);
  ASSERT_FALSE(wide);
  EXPECT_EQ(wide.error().message, file.string() + ": is UTF-16 text; save it as UTF-8");
}

}  // namespace
}  // namespace penumbra
