#include "core/text/spelling.hpp"

#include <gtest/gtest.h>

#include <string>

namespace penumbra {
namespace {

TEST(EditDistance, CountsInsertionsDeletionsAndReplacements) {
  EXPECT_EQ(letters_apart("", ""), 0U);
  EXPECT_EQ(letters_apart("", "abc"), 3U);
  EXPECT_EQ(letters_apart("--tracking", "--tracking"), 0U);
  EXPECT_EQ(letters_apart("--traking", "--tracking"), 1U);
  EXPECT_EQ(letters_apart("--trakcing", "--tracking"), 2U) << "two that changed places";
  EXPECT_EQ(letters_apart("kitten", "sitting"), 3U);
  EXPECT_EQ(letters_apart(std::string(300, 'a'), std::string(299, 'b')), 300U);
  for (const char* a : {"group", "grop", "size_m", ""}) {
    for (const char* b : {"groups", "size", "x"})
      EXPECT_EQ(letters_apart(a, b), letters_apart(b, a));
  }
}

}  // namespace
}  // namespace penumbra
