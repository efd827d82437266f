#include "app/resources.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <fstream>

#include "app/interrupt.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

void make_resources(const fs::path& folder) {
  fs::create_directories(folder / "scenes");
  std::ofstream(folder / "scenes" / "default.json") << "{}";
}

TEST(Resources, AreFoundAboveProgramInSourceTree) {
  const test::TemporaryFolder root;
  make_resources(root.path());
  const auto found = find_resources_of(root.path() / "build" / "release" / "penumbra", nullptr);
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(*found, root.path());
}

TEST(Resources, AreFoundInShareWhenInstalled) {
  const test::TemporaryFolder root;
  make_resources(root.path());
  make_resources(root.path() / "usr" / "share" / "penumbra");
  const auto found = find_resources_of(root.path() / "usr" / "bin" / "penumbra", nullptr);
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_EQ(*found, root.path() / "usr" / "share" / "penumbra");
}

TEST(Resources, PreferEnvironmentVariableAndRejectInvalidFolder) {
  const test::TemporaryFolder root;
  make_resources(root.path() / "tree");
  make_resources(root.path() / "given");
  const fs::path program = root.path() / "tree" / "penumbra";
  EXPECT_EQ(find_resources_of(program, (root.path() / "given").c_str()), root.path() / "given");
  EXPECT_EQ(find_resources_of(program, ""), root.path() / "tree");
  const auto wrong = find_resources_of(program, (root.path() / "nothing").c_str());
  ASSERT_FALSE(wrong);
  EXPECT_THAT(wrong.error().message, testing::HasSubstr("PENUMBRA_RESOURCES"));
}

TEST(Resources, ReportMissingFolderWithRemedy) {
  const test::TemporaryFolder root;
  const auto found = find_resources_of(root.path() / "bin" / "penumbra", nullptr);
  ASSERT_FALSE(found);
  EXPECT_THAT(found.error().message, testing::HasSubstr("PENUMBRA_RESOURCES"));
}

TEST(Resources, ReportMissingRecordingWithItsPackage) {
  const test::TemporaryFolder root;
  make_resources(root.path());
  const auto missing = find_bundled_recording_in(root.path(), "tabletop");
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, testing::HasSubstr("penumbra-data"));
  fs::create_directories(root.path() / "recordings" / "tabletop");
  EXPECT_EQ(find_bundled_recording_in(root.path(), "tabletop"),
            root.path() / "recordings" / "tabletop");
}

TEST(InterruptWatch, SurvivesRepeatedSignalsAndRestoresMask) {
  sigset_t before;
  pthread_sigmask(SIG_BLOCK, nullptr, &before);
  {
    InterruptWatch watch;
    watch.hold();
    EXPECT_FALSE(watch.interrupted());
    raise(SIGTERM);
    EXPECT_TRUE(watch.interrupted());
    // timeout(1) and a closing terminal send these signals. The process continues.
    raise(SIGTERM);
    raise(SIGHUP);
    EXPECT_TRUE(watch.interrupted());
  }
  sigset_t now;
  pthread_sigmask(SIG_BLOCK, nullptr, &now);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    EXPECT_EQ(sigismember(&now, number), sigismember(&before, number)) << number;
  }
  InterruptWatch next;
  EXPECT_FALSE(next.interrupted());
}

}  // namespace
}  // namespace penumbra
