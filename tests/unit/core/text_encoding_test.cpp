#include "core/text_encoding.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace penumbra {
namespace {

using namespace std::string_view_literals;

TEST(ByteOrderMark, Utf8MarkIsSkipped) {
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBFv 0 0 0\n", "a.obj").value(), "v 0 0 0\n");
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBF", "a.obj").value(), "");
}

TEST(ByteOrderMark, TextWithoutMarkIsUnchanged) {
  for (const std::string_view text : {""sv, "v"sv, "v 0"sv, "\xEF\xBB"sv, "a\0b"sv}) {
    EXPECT_EQ(without_byte_order_mark(text, "a.obj").value(), text);
  }
}

TEST(ByteOrderMark, OnlyTheFirstMarkIsSkipped) {
  EXPECT_EQ(without_byte_order_mark("\xEF\xBB\xBF\xEF\xBB\xBFv", "a.obj").value(),
            "\xEF\xBB\xBFv");
}

TEST(ByteOrderMark, WideEncodingsAreRefusedByName) {
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

}  // namespace
}  // namespace penumbra
