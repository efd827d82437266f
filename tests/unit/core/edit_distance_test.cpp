#include "core/text/text.hpp"

#include <gtest/gtest.h>

#include <string>

namespace penumbra {
namespace {

TEST(EditDistance, CountsInsertionsDeletionsAndReplacements) {
  EXPECT_EQ(edit_distance("", ""), 0U);
  EXPECT_EQ(edit_distance("", "abc"), 3U);
  EXPECT_EQ(edit_distance("--tracking", "--tracking"), 0U);
  EXPECT_EQ(edit_distance("--traking", "--tracking"), 1U);
  EXPECT_EQ(edit_distance("--trakcing", "--tracking"), 2U) << "two swapped letters";
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3U);
  EXPECT_EQ(edit_distance(std::string(300, 'a'), std::string(299, 'b')), 300U);
  for (const char* a : {"group", "grop", "size_m", ""}) {
    for (const char* b : {"groups", "size", "x"})
      EXPECT_EQ(edit_distance(a, b), edit_distance(b, a));
  }
}

}  // namespace
}  // namespace penumbra
