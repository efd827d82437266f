#include "app/output/frame_writer.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "core/image/image_file.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

const std::vector<std::uint8_t> kImage = {1, 2, 3, 9, 4, 5, 6, 9};  // 2 x 1

std::set<std::string> names_in(const fs::path& folder) {
  std::set<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) names.insert(entry.path().filename());
  return names;
}

void write(const fs::path& folder, const std::vector<std::uint64_t>& numbers) {
  auto writer = create_png_writer(folder, {2, 1, 0.03});
  ASSERT_TRUE(writer) << writer.error().message;
  for (const std::uint64_t number : numbers) {
    const auto written = (*writer)->write(number, 0, kImage);
    ASSERT_TRUE(written) << written.error().message;
  }
  const auto finished = (*writer)->finish();
  ASSERT_TRUE(finished) << finished.error().message;
}

TEST(PngWriter, WritesOnlyImagesNumberedByFrame) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "new" / "out";
  write(folder, {7, 8, 123456});
  EXPECT_EQ(names_in(folder), (std::set<std::string>{"000007.png", "000008.png", "123456.png"}));
  EXPECT_EQ(names_in(folder.parent_path()), (std::set<std::string>{"out"}));
  const auto image = load_image(folder / "000007.png");
  ASSERT_TRUE(image) << image.error().message;
  ASSERT_EQ(image->format, PixelFormat::rgb24);
  EXPECT_THAT(std::vector<int>(image->planes[0].data, image->planes[0].data + 6),
              testing::ElementsAre(1, 2, 3, 4, 5, 6));
}

TEST(PngWriter, RemovesAllImagesOfEarlierRun) {
  const test::TemporaryFolder temporary;
  write(temporary.path() / "out", {0, 1, 2});
  write(temporary.path() / "out/", {1});
  EXPECT_EQ(names_in(temporary.path() / "out"), (std::set<std::string>{"000001.png"}));
}

TEST(PngWriter, RejectsFolderWithOtherFiles) {
  const test::TemporaryFolder temporary;
  std::ofstream(temporary.path() / "letter.txt") << "dear";
  const auto writer = create_png_writer(temporary.path(), {2, 1, 0.03});
  ASSERT_FALSE(writer);
  EXPECT_THAT(writer.error().message, testing::HasSubstr("letter.txt"));
  EXPECT_EQ(names_in(temporary.path()), (std::set<std::string>{"letter.txt"}));
}

TEST(PngWriter, RejectsFramesFolderOfRecording) {
  const test::TemporaryFolder temporary;
  const fs::path frames = temporary.path() / "frames";
  fs::create_directory(frames);
  std::ofstream(frames / "000000.png") << "precious";
  std::ofstream(temporary.path() / "timestamps.csv") << "frame,timestamp_s,file\n";
  const auto writer = create_png_writer(frames, {2, 1, 0.03});
  ASSERT_FALSE(writer);
  EXPECT_THAT(writer.error().message, testing::HasSubstr("recording"));
  EXPECT_TRUE(fs::exists(frames / "000000.png"));
}

// EuRoC image names are timestamps, which also consist of digits only.
TEST(PngWriter, RejectsFolderOfImagesNamedByTime) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "data";
  fs::create_directory(folder);
  std::ofstream(folder / "1403636579763555584.png") << "precious";
  EXPECT_FALSE(create_png_writer(folder, {2, 1, 0.03}));
  fs::rename(folder / "1403636579763555584.png", folder / "000001.png");
  std::ofstream(temporary.path() / "data.csv") << "#timestamp [ns],filename\n";
  EXPECT_FALSE(create_png_writer(folder, {2, 1, 0.03}));
  EXPECT_EQ(names_in(folder), (std::set<std::string>{"000001.png"}));
}

TEST(PngWriter, WritesThroughSymlink) {
  const test::TemporaryFolder temporary;
  write(temporary.path() / "real", {0, 1});
  fs::create_directory_symlink(temporary.path() / "real", temporary.path() / "link");
  write(temporary.path() / "link", {2});
  EXPECT_TRUE(fs::is_symlink(temporary.path() / "link"));
  EXPECT_EQ(names_in(temporary.path() / "real"), (std::set<std::string>{"000002.png"}));
  EXPECT_EQ(names_in(temporary.path()), (std::set<std::string>{"link", "real"}));
}

TEST(PngWriter, KeepsImagesOfRunThatFinishesLast) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "out";
  auto first = create_png_writer(folder, {2, 1, 0.03});
  auto second = create_png_writer(folder, {2, 1, 0.03});
  ASSERT_TRUE(first && second);
  ASSERT_TRUE((*first)->write(1, 0, kImage));
  ASSERT_TRUE((*second)->write(2, 0, kImage));
  ASSERT_TRUE((*first)->finish());
  EXPECT_EQ(names_in(folder), (std::set<std::string>{"000001.png"}));
  ASSERT_TRUE((*second)->finish());
  EXPECT_EQ(names_in(folder), (std::set<std::string>{"000002.png"}));
  EXPECT_EQ(names_in(temporary.path()), (std::set<std::string>{"out"}));
}

TEST(PngWriter, KeepsOldFolderWhenNotFinished) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "out";
  write(folder, {0, 1});
  {
    auto writer = create_png_writer(folder, {2, 1, 0.03});
    ASSERT_TRUE(writer);
    ASSERT_TRUE((*writer)->write(5, 0, kImage));
  }
  EXPECT_EQ(names_in(folder), (std::set<std::string>{"000000.png", "000001.png"}));
  EXPECT_EQ(names_in(temporary.path()), (std::set<std::string>{"out"}));
}

TEST(PngWriter, RejectsFileAsTargetAndEmptyOutput) {
  const test::TemporaryFolder temporary;
  std::ofstream(temporary.path() / "file") << "x";
  EXPECT_FALSE(create_png_writer(temporary.path() / "file", {2, 1, 0.03}));
  auto writer = create_png_writer(temporary.path() / "out", {2, 1, 0.03});
  ASSERT_TRUE(writer);
  EXPECT_FALSE((*writer)->finish());
  EXPECT_FALSE(create_png_writer(".", {2, 1, 0.03}));
}

}  // namespace
}  // namespace penumbra
