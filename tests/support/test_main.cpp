// Runs the tests. Exit code 77: none failed, and some were skipped. ctest then reports a skipped
// test.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

int main(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  const int failed = RUN_ALL_TESTS();
  constexpr int kSkipped = 77;
  const bool any_skipped = testing::UnitTest::GetInstance()->skipped_test_count() > 0;
  return failed == 0 && any_skipped ? kSkipped : failed;
}
