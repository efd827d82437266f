#include "app/output/frame_writer.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <random>

#include "support/paths.hpp"
#include "unit/app/decoded_video.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using test::decode_video;
using test::DecodedVideo;

std::vector<std::vector<std::uint8_t>> noise(int width, int height, int count) {
  std::mt19937 random(11);
  std::uniform_int_distribution<int> byte(0, 255);
  std::vector<std::vector<std::uint8_t>> images(static_cast<std::size_t>(count));
  for (auto& image : images) {
    image.resize(static_cast<std::size_t>(width * height * 4));
    for (std::uint8_t& value : image) value = static_cast<std::uint8_t>(byte(random));
  }
  return images;
}

void write_all(const fs::path& file, OutputKind codec, const FrameFormat& format,
               const std::vector<std::vector<std::uint8_t>>& images,
               const std::vector<std::int64_t>& times_ns) {
  auto writer = create_video_writer(file, codec, format);
  ASSERT_TRUE(writer) << writer.error().message;
  for (std::size_t i = 0; i < images.size(); ++i) {
    const auto written = (*writer)->write(i, times_ns[i], images[i]);
    ASSERT_TRUE(written) << written.error().message;
  }
  const auto finished = (*writer)->finish();
  ASSERT_TRUE(finished) << finished.error().message;
}

std::string bytes_of(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

TEST(VideoWriter, StoresEveryPixelAndTimestampInFfv1) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "a.mkv";
  const auto images = noise(37, 23, 5);
  // The times are irregular and do not start at 0.
  const std::vector<std::int64_t> times = {5'000'000'000, 5'033'333'000, 5'066'667'000,
                                           5'200'000'000, 5'201'000'000};
  write_all(file, OutputKind::ffv1, {37, 23, 1.0 / 30.0}, images, times);

  const DecodedVideo video = decode_video(file);
  ASSERT_TRUE(video.opened);
  EXPECT_EQ(video.codec, AV_CODEC_ID_FFV1);
  EXPECT_THAT(video.container, testing::HasSubstr("matroska"));
  ASSERT_EQ(video.format, AV_PIX_FMT_0RGB32);
  EXPECT_EQ(video.width, 37);
  EXPECT_EQ(video.height, 23);
  ASSERT_EQ(video.images.size(), images.size());
  for (std::size_t i = 0; i < images.size(); ++i) {
    EXPECT_NEAR(video.images[i].time_s, static_cast<double>(times[i] - times[0]) * 1e-9, 0.0006);
    const auto& stored = video.images[i].bytes;
    ASSERT_EQ(stored.size(), images[i].size());
    for (std::size_t p = 0; p < stored.size(); p += 4) {
      ASSERT_EQ(stored[p + 2], images[i][p]) << "red of byte " << p;
      ASSERT_EQ(stored[p + 1], images[i][p + 1]) << "green of byte " << p;
      ASSERT_EQ(stored[p], images[i][p + 2]) << "blue of byte " << p;
    }
  }
}

class VideoWriterCodec : public testing::TestWithParam<OutputKind> {
 protected:
  [[nodiscard]] static std::string extension() {
    return GetParam() == OutputKind::ffv1 ? ".mkv" : ".mp4";
  }
};
INSTANTIATE_TEST_SUITE_P(Codecs, VideoWriterCodec,
                         testing::Values(OutputKind::ffv1, OutputKind::h264), [](const auto& test) {
                           return test.param == OutputKind::ffv1 ? "Ffv1" : "H264";
                         });

TEST_P(VideoWriterCodec, WritesSameBytesForSameFrames) {
  const test::TemporaryFolder folder;
  const auto images = noise(64, 48, 8);
  std::vector<std::int64_t> times;
  for (int i = 0; i < 8; ++i) times.push_back(i * 33'333'333LL);
  const fs::path first = folder.path() / ("a" + extension());
  const fs::path second = folder.path() / ("b" + extension());
  write_all(first, GetParam(), {64, 48, 1.0 / 30.0}, images, times);
  write_all(second, GetParam(), {64, 48, 1.0 / 30.0}, images, times);
  EXPECT_FALSE(bytes_of(first).empty());
  EXPECT_EQ(bytes_of(first), bytes_of(second));
}

TEST_P(VideoWriterCodec, IncreasesEqualTimestamps) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / ("a" + extension());
  write_all(file, GetParam(), {32, 32, 1.0 / 30.0}, noise(32, 32, 3), {7, 7, 7});
  const DecodedVideo video = decode_video(file);
  ASSERT_EQ(video.images.size(), 3U);
  EXPECT_LT(video.images[0].time_s, video.images[1].time_s);
  EXPECT_LT(video.images[1].time_s, video.images[2].time_s);
}

TEST_P(VideoWriterCodec, KeepsOldFileWhenNotFinished) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / ("a" + extension());
  std::ofstream(file) << "old";
  {
    auto writer = create_video_writer(file, GetParam(), {32, 32, 1.0 / 30.0});
    ASSERT_TRUE(writer) << writer.error().message;
    ASSERT_TRUE((*writer)->write(0, 0, noise(32, 32, 1)[0]));
  }
  EXPECT_EQ(bytes_of(file), "old");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()), 1);
}

TEST_P(VideoWriterCodec, RejectsUnwritablePathBeforeEncoding) {
  const test::TemporaryFolder folder;
  const fs::path missing = folder.path() / "no" / ("a" + extension());
  const auto in_no_folder = create_video_writer(missing, GetParam(), {32, 32, 1.0 / 30.0});
  ASSERT_FALSE(in_no_folder);
  EXPECT_THAT(in_no_folder.error().message, testing::HasSubstr(missing.string()));
  const fs::path taken = folder.path() / ("b" + extension());
  fs::create_directory(taken);
  const auto on_folder = create_video_writer(taken, GetParam(), {32, 32, 1.0 / 30.0});
  ASSERT_FALSE(on_folder);
  EXPECT_THAT(on_folder.error().message, testing::HasSubstr("is a folder"));
}

TEST_P(VideoWriterCodec, FailsForVideoWithoutFrames) {
  const test::TemporaryFolder folder;
  auto writer =
      create_video_writer(folder.path() / ("a" + extension()), GetParam(), {32, 32, 1.0 / 30.0});
  ASSERT_TRUE(writer);
  EXPECT_FALSE((*writer)->finish());
}

// A uniform colour isolates the colour conversion from compression errors.
struct H264Case {
  int width, height;
  AVColorSpace space;
  double kr, kb;  // luma weights of red and blue
};
class H264Colors : public testing::TestWithParam<H264Case> {};
INSTANTIATE_TEST_SUITE_P(Sizes, H264Colors,
                         testing::Values(H264Case{64, 48, AVCOL_SPC_SMPTE170M, 0.299, 0.114},
                                         H264Case{37, 23, AVCOL_SPC_SMPTE170M, 0.299, 0.114},
                                         H264Case{64, 720, AVCOL_SPC_BT709, 0.2126, 0.0722}),
                         [](const auto& test) {
                           return fmt::format("{}x{}", test.param.width, test.param.height);
                         });

TEST_P(H264Colors, MatchColorTagsOfStream) {
  const H264Case& expected = GetParam();
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "a.mp4";
  const double r = 200.0;
  const double g = 60.0;
  const double b = 30.0;
  std::vector<std::uint8_t> image;
  for (int i = 0; i < expected.width * expected.height; ++i) {
    image.insert(image.end(), {200, 60, 30, 255});
  }
  write_all(file, OutputKind::h264, {expected.width, expected.height, 1.0 / 30.0},
            {image, image, image}, {0, 33'000'000, 66'000'000});
  const DecodedVideo video = decode_video(file);
  ASSERT_TRUE(video.opened);
  EXPECT_EQ(video.codec, AV_CODEC_ID_H264);
  EXPECT_EQ(video.format, AV_PIX_FMT_YUV420P);
  EXPECT_EQ(video.width, (expected.width + 1) / 2 * 2);
  EXPECT_EQ(video.height, (expected.height + 1) / 2 * 2);
  EXPECT_EQ(video.color_space, expected.space);
  EXPECT_EQ(video.color_range, AVCOL_RANGE_MPEG);
  ASSERT_EQ(video.images.size(), 3U);
  EXPECT_NEAR(video.images[2].time_s - video.images[0].time_s, 0.066, 1e-4);
  // ITU-R BT.601 or BT.709, limited range.
  const double y = expected.kr * r + (1.0 - expected.kr - expected.kb) * g + expected.kb * b;
  const double luma = 16.0 + 219.0 * y / 255.0;
  const double cb = 128.0 + 224.0 * (b - y) / (2.0 * (1.0 - expected.kb)) / 255.0;
  const double cr = 128.0 + 224.0 * (r - y) / (2.0 * (1.0 - expected.kr)) / 255.0;
  const auto pixels = static_cast<std::size_t>(video.width * video.height);
  for (const auto& decoded : video.images) {
    ASSERT_EQ(decoded.bytes.size(), pixels * 3 / 2);
    for (std::size_t i = 0; i < decoded.bytes.size(); ++i) {
      const double wanted = i < pixels ? luma : i < pixels * 5 / 4 ? cb : cr;
      ASSERT_NEAR(decoded.bytes[i], wanted, 2.0) << i;
    }
  }
}

}  // namespace
}  // namespace penumbra
