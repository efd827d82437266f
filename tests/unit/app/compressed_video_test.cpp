// Video files as cameras and phones write them.
#include "app/recording/compressed_video.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <limits>

#include "app/output/frame_writer.hpp"
#include "app/recording/recording_source.hpp"
#include "support/paths.hpp"
#include "support/video_file.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr int kVideoWidth = 64;
constexpr int kVideoHeight = 48;
// Irregular, as with a phone's variable rate.
const std::vector<std::int64_t> kTimes_ns = {0,           33'333'333,  66'666'667,  150'000'000,
                                             183'333'333, 400'000'000, 433'333'333, 466'666'667};

std::string video_bytes(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}
void write_video_bytes(const fs::path& file, const std::string& bytes) {
  std::ofstream(file, std::ios::binary) << bytes;
}

// Grey ramps to the right and down, with a white block in the top left corner; brighter with time.
int grey_at(int x, int y, std::size_t frame) {
  if (x < 16 && y < 16) return 235;
  return 40 + x + y / 2 + 4 * static_cast<int>(frame);
}

void write_test_video(const fs::path& file, OutputKind kind,
                      const std::vector<std::int64_t>& times_ns = kTimes_ns) {
  auto writer = create_video_writer(file, kind, {kVideoWidth, kVideoHeight, 1.0 / 30.0});
  ASSERT_TRUE(writer) << writer.error().message;
  for (std::size_t i = 0; i < times_ns.size(); ++i) {
    std::vector<std::uint8_t> image;
    for (int y = 0; y < kVideoHeight; ++y) {
      for (int x = 0; x < kVideoWidth; ++x) {
        const auto grey = static_cast<std::uint8_t>(grey_at(x, y, i));
        image.insert(image.end(), {grey, grey, grey, 255});
      }
    }
    ASSERT_TRUE((*writer)->write(i, times_ns[i], image));
  }
  ASSERT_TRUE((*writer)->finish());
}

// Sets the rotation of an MP4 file: the matrix of its track header (ISO 14496-12, 8.3.2).
void set_matrix(const fs::path& file, const std::array<std::int32_t, 9>& matrix) {
  constexpr std::size_t kMatrixOffset = 44;  // from the box's type, for version 0
  std::string bytes = video_bytes(file);
  const std::size_t track = bytes.find("tkhd");
  ASSERT_NE(track, std::string::npos);
  for (std::size_t i = 0; i < matrix.size(); ++i) {
    const auto value = static_cast<std::uint32_t>(matrix[i]);
    for (std::size_t k = 0; k < 4; ++k) {
      bytes[track + kMatrixOffset + 4 * i + k] =
          static_cast<char>((value >> (24U - 8U * static_cast<unsigned>(k))) & 0xFFU);
    }
  }
  write_video_bytes(file, bytes);
}
constexpr std::int32_t kOne = 1 << 16;
constexpr std::int32_t kUnit = 1 << 30;
constexpr std::array<std::int32_t, 9> kRotated90 = {0, kOne, 0, -kOne, 0, 0, 0, 0, kUnit};
constexpr std::array<std::int32_t, 9> kRotated180 = {-kOne, 0, 0, 0, -kOne, 0, 0, 0, kUnit};
constexpr std::array<std::int32_t, 9> kRotated270 = {0, -kOne, 0, kOne, 0, 0, 0, 0, kUnit};
constexpr std::array<std::int32_t, 9> kMirrored = {-kOne, 0, 0, 0, kOne, 0, 0, 0, kUnit};

struct PlayedVideo {
  std::vector<std::optional<Frame>> frames;  // one per listed frame; nullopt: damaged
  VideoListing listing;
};
PlayedVideo play_video(const fs::path& file) {
  PlayedVideo played;
  auto listing = CompressedVideo::list(file);
  EXPECT_TRUE(listing) << listing.error().message;
  if (!listing) return played;
  played.listing = *listing;
  auto video = CompressedVideo::open(file, *listing);
  EXPECT_TRUE(video) << video.error().message;
  if (!video) return played;
  for (std::size_t i = 0; i < listing->times_ns.size(); ++i) {
    auto frame = video->next();
    played.frames.push_back(frame ? *frame : std::nullopt);
    if (frame) {
      EXPECT_TRUE(*frame);
    }
  }
  const auto end = video->next();
  EXPECT_TRUE(end && !*end);
  return played;
}

// Mean absolute difference of the luma from that of the written image, rotated clockwise.
double luma_difference(const Frame& frame, std::size_t index, int quarter_turns) {
  std::vector<std::uint8_t> scratch;
  const ImageView image = luma(frame, scratch);
  double sum = 0.0;
  for (int y = 0; y < kVideoHeight; ++y) {
    for (int x = 0; x < kVideoWidth; ++x) {
      const int full = grey_at(x, y, index);
      const double written =
          frame.color_range == ColorRange::full ? full : 16.0 + full * 219.0 / 255.0;
      const std::array<int, 4> columns = {x, kVideoHeight - 1 - y, kVideoWidth - 1 - x, y};
      const std::array<int, 4> rows = {y, x, kVideoHeight - 1 - y, kVideoWidth - 1 - x};
      const auto turn = static_cast<std::size_t>(quarter_turns);
      sum += std::abs(image.row(rows[turn])[columns[turn]] - written);
    }
  }
  return sum / (kVideoWidth * kVideoHeight);
}

TEST(CompressedVideo, ReadsFramesWithTimesOfContainer) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "phone.mp4";
  write_test_video(file, OutputKind::h264);
  const PlayedVideo played = play_video(file);
  ASSERT_EQ(played.listing.times_ns.size(), kTimes_ns.size());
  EXPECT_THAT(played.listing.notices, IsEmpty());
  for (std::size_t i = 0; i < kTimes_ns.size(); ++i) {
    EXPECT_NEAR(static_cast<double>(played.listing.times_ns[i] - kTimes_ns[i]), 0.0, 12'000.0);
    ASSERT_TRUE(played.frames[i]) << i;
    EXPECT_EQ(played.frames[i]->width, kVideoWidth);
    EXPECT_EQ(played.frames[i]->height, kVideoHeight);
    EXPECT_LT(luma_difference(*played.frames[i], i, 0), 2.5) << i;
  }
}

TEST(CompressedVideo, ReadsLosslessRgb) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "a.mkv";
  write_test_video(file, OutputKind::ffv1);
  const PlayedVideo played = play_video(file);
  ASSERT_EQ(played.frames.size(), kTimes_ns.size());
  for (std::size_t i = 0; i < kTimes_ns.size(); ++i) {
    ASSERT_TRUE(played.frames[i]);
    EXPECT_LT(luma_difference(*played.frames[i], i, 0), 0.51) << i;
  }
}

// Phones record 10 bits (HDR).
TEST(CompressedVideo, ReducesDeepSamplesToEightBits) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "deep.mkv";
  for (const auto& [format, depth] :
       {std::pair(AV_PIX_FMT_YUV420P10, 10), std::pair(AV_PIX_FMT_YUV422P10, 10),
        std::pair(AV_PIX_FMT_YUV444P12, 12), std::pair(AV_PIX_FMT_GRAY16, 16)}) {
    SCOPED_TRACE(depth);
    test::VideoSpec spec;
    spec.format = format;
    spec.frames = 2;
    spec.range = AVCOL_RANGE_MPEG;
    const auto grey = [](int x, int y) { return 40 + x + y; };
    test::write_video(file, spec, [&, depth = depth](AVFrame& frame, int) {
      for (int plane = 0; plane < 3 && frame.data[plane] != nullptr; ++plane) {
        const int rows = plane > 0 && frame.format == AV_PIX_FMT_YUV420P10 ? 24 : 48;
        const int columns = plane > 0 && frame.format != AV_PIX_FMT_YUV444P12 ? 32 : 64;
        for (int y = 0; y < rows; ++y) {
          auto* row =
              reinterpret_cast<std::uint16_t*>(frame.data[plane] + y * frame.linesize[plane]);
          for (int x = 0; x < columns; ++x)
            row[x] = static_cast<std::uint16_t>((plane > 0 ? 128 : grey(x, y)) << (depth - 8));
        }
      }
    });
    const PlayedVideo played = play_video(file);
    ASSERT_EQ(played.frames.size(), 2U);
    EXPECT_THAT(
        played.listing.notices,
        ElementsAre(HasSubstr(std::to_string(depth) + " bits per sample are reduced to 8")));
    std::vector<std::uint8_t> scratch;
    const ImageView image = luma(played.frames[1].value(), scratch);
    for (int y = 0; y < kVideoHeight; ++y) {
      for (int x = 0; x < kVideoWidth; ++x)
        ASSERT_NEAR(image.row(y)[x], grey(x, y), 1) << x << ' ' << y;
    }
  }
}

TEST(CompressedVideo, RotatesFramesByDisplayMatrix) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "portrait.mp4";
  int turns = 0;
  for (const auto& matrix : {kRotated90, kRotated180, kRotated270}) {
    write_test_video(file, OutputKind::h264);
    set_matrix(file, matrix);
    ++turns;
    SCOPED_TRACE(turns);
    const PlayedVideo played = play_video(file);
    ASSERT_EQ(played.frames.size(), kTimes_ns.size());
    EXPECT_THAT(played.listing.notices,
                ElementsAre(AllOf(HasSubstr("portrait.mp4: is rotated clockwise by " +
                                            std::to_string(90 * turns) + " degrees"))));
    for (std::size_t i = 0; i < played.frames.size(); ++i) {
      ASSERT_TRUE(played.frames[i]);
      EXPECT_EQ(played.frames[i]->width, turns == 2 ? kVideoWidth : kVideoHeight);
      EXPECT_LT(luma_difference(*played.frames[i], i, turns), 2.5) << i;
    }
  }
  write_test_video(file, OutputKind::h264);
  set_matrix(file, kMirrored);
  const PlayedVideo mirrored = play_video(file);
  EXPECT_THAT(mirrored.listing.notices, ElementsAre(HasSubstr("mirrors the image")));
  EXPECT_LT(luma_difference(mirrored.frames.at(0).value(), 0, 0), 2.5);
}

TEST(CompressedVideo, SkipsFrames) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "phone.mp4";
  write_test_video(file, OutputKind::h264);
  auto video = CompressedVideo::open(file, CompressedVideo::list(file).value());
  ASSERT_TRUE(video);
  ASSERT_TRUE(video->skip(5));
  const auto frame = video->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_LT(luma_difference(**frame, 5, 0), 2.5);
  ASSERT_TRUE(video->skip(100));
  const auto end = video->next();
  EXPECT_TRUE(end && !*end);
}

TEST(CompressedVideo, RejectsPlaylistsAndFilesWithoutVideo) {
  const test::TemporaryFolder folder;
  const auto error = [&](const std::string& name, const std::string& content) {
    write_video_bytes(folder.path() / name, content);
    const auto listing = CompressedVideo::list(folder.path() / name);
    return listing ? std::string() : listing.error().message;
  };
  EXPECT_THAT(error("a.mp4", ""), HasSubstr("a.mp4: is not a folder, and cannot be read as a"));
  EXPECT_THAT(error("a.txt", "not a video\n"), HasSubstr("cannot be read as a video"));
  // Lists of other files are not opened.
  const fs::path real = folder.path() / "real.mp4";
  write_test_video(real, OutputKind::h264);
  EXPECT_THAT(error("list.ffconcat", "ffconcat version 1.0\nfile real.mp4\n"),
              HasSubstr("cannot be read as a video"));
  EXPECT_THAT(error("list.m3u8", "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nreal.mp4\n"),
              HasSubstr("cannot be read as a video"));
  EXPECT_THAT(CompressedVideo::list(folder.path()).error().message, HasSubstr("is not a file"));
  EXPECT_FALSE(CompressedVideo::list(folder.path() / "missing.mp4"));
}

TEST(CompressedVideo, SkipsOrRejectsDamagedData) {
  const test::TemporaryFolder folder;
  const fs::path whole = folder.path() / "whole.mp4";
  write_test_video(whole, OutputKind::h264);
  const std::string bytes = video_bytes(whole);
  const fs::path file = folder.path() / "damaged.mp4";
  int read = 0;
  for (std::size_t k = 0; k < 60; ++k) {
    SCOPED_TRACE(k);
    std::string damaged = bytes;
    if (k % 3 == 0) {
      damaged.resize(bytes.size() * (k + 1) / 61);
    } else {
      for (std::size_t n = 0; n < k; ++n)
        damaged[(7919 * (n + 1) * (k + 1)) % damaged.size()] = static_cast<char>(31 * n + k);
    }
    write_video_bytes(file, damaged);
    auto listing = CompressedVideo::list(file);
    if (!listing) {
      EXPECT_THAT(listing.error().message, HasSubstr("damaged.mp4"));
      continue;
    }
    auto video = CompressedVideo::open(file, *listing);
    if (!video) continue;
    for (std::size_t i = 0; i < std::min<std::size_t>(listing->times_ns.size(), 1000); ++i) {
      const auto frame = video->next();
      if (frame && *frame) ++read;
    }
  }
  // 13 to 22, because the encoder's bytes, and so the damage, depend on its instruction set.
  EXPECT_GT(read, 10);
}

TEST(CompressedVideo, OpensAsRecording) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "phone.mp4";
  write_test_video(file, OutputKind::h264);
  EXPECT_THAT(open_recording(file).error().message, HasSubstr("a video has no camera file"));
  OpenRecordingOptions options;
  options.require_camera = options.require_tags = false;
  const auto recording = open_recording(file, options);
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ(recording->name, "phone.mp4");
  EXPECT_TRUE(recording->is_video_file());
  RecordingSourceOptions some;
  some.first = 2;
  some.last = 7;
  auto source = open_recording_source(*recording, some);
  ASSERT_TRUE(source) << source.error().message;
  for (std::uint64_t number = 2; number < 7; ++number) {
    const auto frame = (*source)->next();
    ASSERT_TRUE(frame && *frame);
    EXPECT_EQ((*frame)->sequence, number);
    EXPECT_EQ((*frame)->timestamp_ns, recording->frames[number].timestamp_ns);
  }
  const auto end = (*source)->next();
  EXPECT_TRUE(end && !*end);
}

}  // namespace
}  // namespace penumbra
