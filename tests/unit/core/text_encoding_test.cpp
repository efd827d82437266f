#include "core/text/text.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace penumbra {
namespace {

using namespace std::string_view_literals;

TEST(ByteOrderMark, IsSkippedInUtf8Text) {
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBFv 0 0 0\n", "a.obj").value(), "v 0 0 0\n");
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBF", "a.obj").value(), "");
}

TEST(ByteOrderMark, LeavesTextWithoutMarkUnchanged) {
  for (const std::string_view text : {""sv, "v"sv, "v 0"sv, "\xEF\xBB"sv, "a\0b"sv}) {
    EXPECT_EQ(without_byte_order_mark(text, "a.obj").value(), text);
  }
}

TEST(ByteOrderMark, IsSkippedOnlyOnce) {
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBF\xEF\xBB\xBFv", "a.obj").value(), "\xEF\xBB\xBFv");
}

TEST(ByteOrderMark, RejectsAndReportsUtf16AndUtf32) {
  for (const std::string_view text :
       {"\xFF\xFE#\0 \0"sv, "\xFE\xFF\0#\0 "sv, "\xFF\xFE"sv, "#\0 \0"sv, "\0#\0 "sv}) {
    const auto result = without_byte_order_mark(text, "a.tum");
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().message, "a.tum: is UTF-16 text; save it as UTF-8");
  }
  for (const std::string_view text : {"\xFF\xFE\0\0#\0\0\0"sv, "\0\0\xFE\xFF\0\0\0#"sv}) {
    const auto result = without_byte_order_mark(text, "a.tum");
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().message, "a.tum: is UTF-32 text; save it as UTF-8");
  }
}

TEST(AsUtf8, KeepsValidUtf8) {
  for (const std::string_view text : {""sv, "red"sv, "gr\xC3\xBCn"sv, "\xE2\x82\xAC"sv,
                                      "\xF0\x9F\x98\x80"sv, "\xF4\x8F\xBF\xBF"sv, "a\0b"sv}) {
    EXPECT_EQ(as_utf8(text), text);
  }
}

TEST(AsUtf8, ReadsOtherBytesAsLatin1) {
  EXPECT_EQ(as_utf8("gr\xFCn"), "gr\xC3\xBCn");
  EXPECT_EQ(as_utf8("T\xF6pfchen"), "T\xC3\xB6pfchen");
  EXPECT_EQ(as_utf8("\xFF\x80"), "\xC3\xBF\xC2\x80");
}

TEST(AsUtf8, KeepsValidPartsBesideOtherBytes) {
  EXPECT_EQ(as_utf8("gr\xC3\xBCn: B\xE4r.png"), "gr\xC3\xBCn: B\xC3\xA4r.png");
}

TEST(AsUtf8, ReadsMalformedUtf8AsLatin1) {
  // Invalid UTF-8: overlong, a surrogate, beyond the last plane, truncated, a lone continuation
  // byte.
  EXPECT_EQ(as_utf8("\xC0\xAF"), "\xC3\x80\xC2\xAF");
  EXPECT_EQ(as_utf8("\xE0\x80\xAF"), "\xC3\xA0\xC2\x80\xC2\xAF");
  EXPECT_EQ(as_utf8("\xED\xA0\x80"), "\xC3\xAD\xC2\xA0\xC2\x80");
  EXPECT_EQ(as_utf8("\xF4\x90\x80\x80"), "\xC3\xB4\xC2\x90\xC2\x80\xC2\x80");
  EXPECT_EQ(as_utf8("\xE2\x82"), "\xC3\xA2\xC2\x82");
  EXPECT_EQ(as_utf8("\xBF"), "\xC2\xBF");
}

TEST(AsPrintableLine, KeepsTextAndReplacesControlCharacters) {
  EXPECT_EQ(as_printable_line("a.obj: line 3: gr\xC3\xBCn"), "a.obj: line 3: gr\xC3\xBCn");
  EXPECT_EQ(as_printable_line("a\nb\tc\x1B[31m\x7F"), "a b c [31m ");
  EXPECT_EQ(as_printable_line("a\0b"sv), "a b");
  EXPECT_EQ(as_printable_line("\xC2\x9B"
                              "31m\xC2\xA0x"),
            " 31m\xC2\xA0x");
}

TEST(AsPrintableLine, IsValidUtf8ForAnyBytes) {
  for (int high = 0; high < 256; ++high) {
    for (int low = 0; low < 256; ++low) {
      const std::string bytes = {static_cast<char>(high), static_cast<char>(low), 'x'};
      const std::string line = as_printable_line(bytes);
      EXPECT_EQ(as_utf8(line), line) << high << ' ' << low;
      EXPECT_TRUE(line.ends_with('x'));
      for (const char c : line) {
        EXPECT_TRUE(static_cast<unsigned char>(c) >= 0x20 && c != 0x7F) << high << ' ' << low;
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
