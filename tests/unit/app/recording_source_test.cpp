#include "app/recording/recording_source.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <random>
#include <set>

#include "app/recording/video_reader.hpp"
#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "support/recording_folder.hpp"
#include "support/video_file.hpp"

namespace penumbra {
namespace {

using test::TemporaryFolder;
using test::write_text;
using testing::AllOf;
using testing::HasSubstr;

constexpr int kFrames = 8;
constexpr std::int64_t kStartNs = 1311868164363181000;
constexpr std::int64_t kStepNs = 33333000;

struct Played {
  std::vector<Frame> frames;
  std::string error;  // empty if every frame was played without an error
};

Played play(const Recording& recording, const RecordingSourceOptions& options = {}) {
  Played played;
  auto source = open_recording_source(recording, options);
  if (!source) return {{}, source.error().message};
  while (true) {
    auto frame = (*source)->next();
    if (!frame) {
      played.error = frame.error().message;
      return played;
    }
    if (!*frame) return played;
    played.frames.push_back(std::move(**frame));
  }
}

// Opens and plays the recording; returns the first error, or an empty string.
std::string error_of(const std::filesystem::path& folder) {
  const auto recording = open_recording(folder);
  return recording ? play(*recording).error : recording.error().message;
}

int sample(const Frame& frame, std::size_t plane, int x, int y) {
  return frame.planes[plane].data[y * frame.planes[plane].stride + x];
}

bool same_pixels(const Frame& a, const Frame& b) {
  if (a.format != b.format || a.plane_count != b.plane_count) return false;
  for (std::size_t i = 0; i < static_cast<std::size_t>(a.plane_count); ++i) {
    const int bytes = a.planes[i].width * (a.format == PixelFormat::rgb24 ? 3 : 1);
    if (a.planes[i].width != b.planes[i].width || a.planes[i].height != b.planes[i].height) {
      return false;
    }
    for (int y = 0; y < a.planes[i].height; ++y) {
      if (std::memcmp(a.planes[i].data + y * a.planes[i].stride,
                      b.planes[i].data + y * b.planes[i].stride,
                      static_cast<std::size_t>(bytes)) != 0) {
        return false;
      }
    }
  }
  return true;
}

class FrameFolderRecording : public testing::Test {
 protected:
  FrameFolderRecording() { test::write_recording(folder(), kFrames); }
  [[nodiscard]] std::filesystem::path folder() const { return root_.path() / "small"; }
  [[nodiscard]] std::filesystem::path frame(int number) const {
    return folder() / "frames" / (test::six_digits(number) + ".jpg");
  }
  void replace(const std::string& file, const std::string& from, const std::string& to) const {
    std::string text = test::read_bytes(folder() / file);
    const std::size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    write_text(folder() / file, text.replace(at, from.size(), to));
  }

 private:
  TemporaryFolder root_;
};

TEST_F(FrameFolderRecording, DeliversFramesInOrderWithTimestamps) {
  const auto recording = open_recording(folder() / "");
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ(recording->name, "small");
  EXPECT_TRUE(recording->notices.empty());
  EXPECT_EQ(recording->tags->tags().size(), 2U);
  EXPECT_EQ(recording->groundtruth->poses.size(), std::size_t{kFrames});
  for (const int look_ahead : {0, 1, 4, 100}) {
    RecordingSourceOptions options;
    options.look_ahead = look_ahead;
    const Played played = play(*recording, options);
    ASSERT_EQ(played.error, "");
    ASSERT_EQ(played.frames.size(), std::size_t{kFrames});
    for (int i = 0; i < kFrames; ++i) {
      const Frame& got = played.frames[static_cast<std::size_t>(i)];
      EXPECT_EQ(got.sequence, static_cast<std::uint64_t>(i));
      EXPECT_EQ(got.timestamp_ns, kStartNs + i * kStepNs);
      EXPECT_EQ(got.format, PixelFormat::yuv420p);
      EXPECT_TRUE(same_pixels(got, *load_image(frame(i))));
      // The frame's exact timestamp finds its pose.
      EXPECT_NE(recording->groundtruth->at(got.timestamp_ns, 0), nullptr);
    }
  }
}

TEST_F(FrameFolderRecording, TreatsFrameRangeAsHalfOpen) {
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording);
  RecordingSourceOptions options;
  options.first = 2;
  options.last = 5;
  const auto source = open_recording_source(*recording, options);
  ASSERT_TRUE(source);
  EXPECT_EQ((*source)->frame_count(), 3);
  const Played played = play(*recording, options);
  ASSERT_EQ(played.frames.size(), 3U);
  EXPECT_EQ(played.frames[0].sequence, 2U);
  EXPECT_EQ(played.frames[2].sequence, 4U);
  options.last = 100;
  EXPECT_EQ(play(*recording, options).frames.size(), 6U);
  for (const auto& [first, last] : {std::pair{8, 9}, {-1, 3}, {5, 5}, {5, 2}}) {
    options.first = first;
    options.last = last;
    EXPECT_THAT(play(*recording, options).error, HasSubstr("none of its 8 frames"));
  }
}

TEST_F(FrameFolderRecording, KeepsFrameValidAfterSourceIsClosed) {
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording);
  for (int taken = 0; taken < kFrames; ++taken) {
    auto source = open_recording_source(*recording);
    ASSERT_TRUE(source);
    Frame kept;
    for (int i = 0; i < taken; ++i) kept = **(*source)->next();
    source->reset();
    // A frame must stay valid after its source is destroyed.
    if (taken > 0) {
      EXPECT_TRUE(same_pixels(kept, *load_image(frame(taken - 1))));
    }
  }
}

TEST_F(FrameFolderRecording, RejectsFolderThatIsNoRecording) {
  EXPECT_THAT(error_of(folder() / "none"), HasSubstr("small/none: no such recording"));
  EXPECT_THAT(error_of(folder() / "camera.yaml"), HasSubstr("is not a folder"));
  const TemporaryFolder empty;
  EXPECT_THAT(error_of(empty.path()), HasSubstr("neither frames/ nor video.mkv"));
}

TEST_F(FrameFolderRecording, ReportsMissingFile) {
  for (const char* name : {"camera.yaml", "tags.yaml", "timestamps.csv"}) {
    test::write_recording(folder(), kFrames);
    std::filesystem::remove(folder() / name);
    EXPECT_THAT(error_of(folder()), AllOf(HasSubstr(name), HasSubstr("no such file")));
  }
}

TEST_F(FrameFolderRecording, RequiresOnlyRequestedFiles) {
  std::filesystem::remove(folder() / "camera.yaml");
  std::filesystem::remove(folder() / "tags.yaml");
  std::filesystem::remove(folder() / "groundtruth.tum");
  OpenRecordingOptions options;
  options.require_camera = false;
  options.require_tags = false;
  const auto recording = open_recording(folder(), options);
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_FALSE(recording->camera || recording->tags || recording->groundtruth);
  EXPECT_EQ(play(*recording).frames.size(), std::size_t{kFrames});
}

TEST_F(FrameFolderRecording, ReadsCameraAndTagsFromOtherPaths) {
  const TemporaryFolder elsewhere;
  std::filesystem::rename(folder() / "camera.yaml", elsewhere.path() / "c.yaml");
  std::filesystem::rename(folder() / "tags.yaml", elsewhere.path() / "t.yaml");
  OpenRecordingOptions options;
  options.camera = elsewhere.path() / "c.yaml";
  options.tags = elsewhere.path() / "t.yaml";
  EXPECT_TRUE(open_recording(folder(), options));
  options.tags = elsewhere.path() / "none.yaml";
  const auto missing = open_recording(folder(), options);
  ASSERT_FALSE(missing);
  EXPECT_THAT(missing.error().message, HasSubstr("none.yaml"));
}

TEST_F(FrameFolderRecording, RejectsDuplicateTag) {
  replace("tags.yaml", "{id: 1,", "{id: 0,");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("tags.yaml"), HasSubstr("0")));
}

TEST_F(FrameFolderRecording, RejectsGroundtruthWithNan) {
  replace("groundtruth.tum", "-0.3", "nan");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("groundtruth.tum"), HasSubstr("2")));
}

TEST_F(FrameFolderRecording, RejectsEmptyFrameList) {
  write_text(folder() / "timestamps.csv", "frame,timestamp_s,file\n");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("timestamps.csv"), HasSubstr("0 frames")));
  write_text(folder() / "timestamps.csv", "");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("timestamps.csv"), HasSubstr("empty")));
}

struct BadLine {
  const char* line;
  const char* message;
};

TEST_F(FrameFolderRecording, ReportsInvalidLineAndCause) {
  const std::string good = test::read_bytes(folder() / "timestamps.csv");
  for (const BadLine& bad :
       {BadLine{"3,nan,frames/000003.jpg", "timestamp_s: 'nan'"},
        {"3,inf,frames/000003.jpg", "timestamp_s: 'inf'"},
        {"3,,frames/000003.jpg", "timestamp_s: ''"},
        {"x,1311868164.463180,frames/000003.jpg", "frame: 'x'"},
        {"-1,1311868164.463180,frames/000003.jpg", "frame: '-1'"},
        {"3,1311868164.463180", "has 2 fields"},
        {"3,1311868164.463180,", "not a path inside"},
        {"3,1311868164.463180,/etc/passwd", "not a path inside"},
        {"3,1311868164.463180,../small/frames/000003.jpg", "not a path inside"},
        {"3,1311868164.429847,frames/000003.jpg", "times must grow"},
        {"3,1311868164.2,frames/000003.jpg", "times must grow"},
        {"2,1311868164.463180,frames/000003.jpg", "number frames in order"},
        {"1,1311868164.463180,frames/000003.jpg", "number frames in order"}}) {
    std::string text = good;
    const std::size_t at = text.find("3,1311868164.463180,frames/000003.jpg");
    ASSERT_NE(at, std::string::npos);
    write_text(folder() / "timestamps.csv", text.replace(at, 37, bad.line));
    EXPECT_THAT(error_of(folder()),
                AllOf(HasSubstr("timestamps.csv: line 5"), HasSubstr(bad.message)));
  }
}

// The exposure is an optional column and may be empty in some lines.
TEST_F(FrameFolderRecording, ReadsListedExposures) {
  const std::string good = test::read_bytes(folder() / "timestamps.csv");
  const auto listing = [&](const std::string& third) {
    std::string text;
    int line = 0;
    for (std::size_t begin = 0; begin < good.size(); ++line) {
      const std::size_t end = good.find('\n', begin);
      text += good.substr(begin, end - begin);
      text += line == 0 ? ",exposure_s" : (line == 3 ? "," + third : ",0.0125");
      text += '\n';
      begin = end + 1;
    }
    return text;
  };
  std::string other = listing("");
  other.replace(other.find("exposure_s"), 10, "exposure_ms");
  write_text(folder() / "timestamps.csv", other);
  const auto not_read = open_recording(folder());
  ASSERT_TRUE(not_read) << not_read.error().message;
  EXPECT_THAT(not_read->notices, testing::ElementsAre(HasSubstr("column exposure_ms")));
  write_text(folder() / "timestamps.csv", listing(""));
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_THAT(recording->notices, testing::IsEmpty());
  const auto source = open_recording_source(*recording);
  ASSERT_TRUE(source);
  for (int i = 0; i < 4; ++i) {
    const auto frame = (*source)->next();
    ASSERT_TRUE(frame && *frame);
    EXPECT_EQ((*frame)->exposure_s, i == 2 ? std::nullopt : std::optional(0.0125)) << i;
  }
  for (const char* bad : {"nan", "-1", "0", "61", "1/60"}) {
    write_text(folder() / "timestamps.csv", listing(bad));
    EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("timestamps.csv: line 4: exposure_s: '"),
                                          HasSubstr(std::string("'") + bad + "'")));
  }
}

// Wall-clock times may be before 1970, go back or repeat, because that clock can be set.
TEST_F(FrameFolderRecording, ReadsListedWallClockTimes) {
  const std::vector<std::string> good = {
      "1790000000000000001", "1790000000033333334", "", "-1", "0", "-9223372036854775808",
      "9223372036854775807", "9223372036854775807"};
  const auto listing = [&](const std::vector<std::string>& times) {
    std::string text = "frame,timestamp_s,file,wall_time_ns\n";
    for (int i = 0; i < kFrames; ++i) {
      const auto number = static_cast<std::size_t>(i);
      text += fmt::format("{0},{0}.5,frames/{0:06}.jpg,{1}\n", i, times[number]);
    }
    return text;
  };
  write_text(folder() / "timestamps.csv", listing(good));
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_THAT(recording->notices, testing::IsEmpty());
  const Played played = play(*recording);
  ASSERT_EQ(played.frames.size(), std::size_t{kFrames});
  for (std::size_t i = 0; i < good.size(); ++i) {
    EXPECT_EQ(played.frames[i].utc_ns, parse_integer(good[i])) << i;
    EXPECT_EQ(played.frames[i].timestamp_ns, static_cast<int>(i) * 1'000'000'000LL + 500'000'000);
  }

  for (const char* bad : {"2026-11-28T04:29:37Z", "1790000000.5", "1.79e18", "nan", "1 2",
                          "9223372036854775808", "99999999999999999999"}) {
    std::vector<std::string> times = good;
    times[3] = bad;
    write_text(folder() / "timestamps.csv", listing(times));
    EXPECT_THAT(error_of(folder()),
                AllOf(HasSubstr("timestamps.csv: line 5: wall_time_ns: '"),
                      HasSubstr("not a whole number of nanoseconds since 1970")))
        << bad;
  }

  std::string other = listing(good);
  other.replace(other.find("wall_time_ns"), 12, "wall_time_s");
  write_text(folder() / "timestamps.csv", other);
  const auto not_read = open_recording(folder());
  ASSERT_TRUE(not_read) << not_read.error().message;
  EXPECT_THAT(not_read->notices, testing::ElementsAre(HasSubstr("column wall_time_s")));
  EXPECT_EQ(not_read->frames[0].utc_ns, std::nullopt);
}

// A crash can cut off the last digits, which are a valid but wrong time.
TEST_F(FrameFolderRecording, IgnoresWallClockTimeThatMayBeCutOff) {
  std::string text = "frame,timestamp_s,file,wall_time_ns\n";
  for (int i = 0; i < kFrames; ++i)
    text += fmt::format("{0},{0}.5,frames/{0:06}.jpg,1790000000000000001\n", i);
  for (std::size_t cut = 1; cut <= 20; ++cut) {
    write_text(folder() / "timestamps.csv", text.substr(0, text.size() - cut));
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording) << recording.error().message;
    ASSERT_EQ(recording->frames.size(), std::size_t{kFrames}) << cut;
    EXPECT_EQ(recording->frames[kFrames - 2].utc_ns, 1'790'000'000'000'000'001);
    EXPECT_EQ(recording->frames[kFrames - 1].utc_ns, std::nullopt) << cut;
  }
}

TEST_F(FrameFolderRecording, RejectsHeaderWithoutRequiredColumns) {
  replace("timestamps.csv", "timestamp_s", "time");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("line 1"), HasSubstr("timestamp_s")));
}

TEST_F(FrameFolderRecording, AcceptsCrlfCommentsAndAnyColumnOrder) {
  std::string text = "\xEF\xBB\xBF# made by hand\r\nfile,frame,exposure,timestamp_s\r\n\r\n";
  for (int i = 0; i < kFrames; ++i) {
    text += "frames/" + test::six_digits(i) + ".jpg, " + std::to_string(2 * i) + ",x, " +
            std::to_string(i) + ".5\r\n";
  }
  write_text(folder() / "timestamps.csv", text);
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  const Played played = play(*recording);
  ASSERT_EQ(played.frames.size(), std::size_t{kFrames});
  EXPECT_EQ(played.frames[3].sequence, 6U);
  EXPECT_EQ(played.frames[3].timestamp_ns, 3'500'000'000);
}

TEST_F(FrameFolderRecording, RejectsMissingFrameInMiddle) {
  std::filesystem::remove(frame(3));
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("frames/000003.jpg"), HasSubstr("missing")));
}

TEST_F(FrameFolderRecording, ReportsMissingFramesAtEnd) {
  std::filesystem::remove(frame(7));
  std::filesystem::remove(frame(6));
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ(recording->frames.size(), 6U);
  ASSERT_EQ(recording->notices.size(), 1U);
  EXPECT_THAT(recording->notices[0], AllOf(HasSubstr("cut off after frame 5"), HasSubstr("6 of 8"),
                                           HasSubstr("000006.jpg: is missing")));
  EXPECT_EQ(play(*recording).frames.size(), 6U);
}

TEST_F(FrameFolderRecording, DropsTruncatedLastFrameWithNotice) {
  const std::string whole = test::read_bytes(frame(7));
  for (const std::size_t length : {std::size_t{0}, whole.size() / 2, whole.size() - 8}) {
    write_text(frame(7), whole.substr(0, length));
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_EQ(recording->frames.size(), 7U);
    ASSERT_EQ(recording->notices.size(), 1U);
    EXPECT_THAT(recording->notices[0], HasSubstr("000007.jpg"));
    EXPECT_EQ(play(*recording).error, "");
  }
}

TEST_F(FrameFolderRecording, OpensFrameListTruncatedInLastLine) {
  const std::string whole = test::read_bytes(folder() / "timestamps.csv");
  const std::size_t last_line = whole.rfind("7,1311868164");
  for (std::size_t length = last_line + 1; length < whole.size() - 1; ++length) {
    write_text(folder() / "timestamps.csv", whole.substr(0, length));
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_EQ(recording->frames.size(), 7U) << whole.substr(0, length);
    EXPECT_FALSE(recording->notices.empty());
  }
  // A list without the final line break is complete.
  write_text(folder() / "timestamps.csv", whole.substr(0, whole.size() - 1));
  EXPECT_EQ(open_recording(folder())->frames.size(), 8U);
  // A file system may leave zeros after a crash.
  write_text(folder() / "timestamps.csv", whole.substr(0, last_line) + std::string(100, '\0'));
  EXPECT_EQ(open_recording(folder())->frames.size(), 7U);
}

TEST_F(FrameFolderRecording, ReportsDamagedFrameInItsOrder) {
  const std::string whole = test::read_bytes(frame(3));
  write_text(frame(3), whole.substr(0, whole.size() / 2));
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  for (const int look_ahead : {0, 4}) {
    RecordingSourceOptions options;
    options.look_ahead = look_ahead;
    const Played played = play(*recording, options);
    EXPECT_EQ(played.frames.size(), 3U);
    EXPECT_THAT(played.error,
                AllOf(HasSubstr("000003.jpg"), HasSubstr("damaged JPEG"), HasSubstr("its line")));
  }
}

// A recording keeps every image of the camera. Replay skips the images that live could not decode.
TEST_F(FrameFolderRecording, SkipsAndCountsDamagedCameraFrames) {
  const std::string whole = test::read_bytes(frame(3));
  write_text(frame(0), whole.substr(0, whole.size() / 3));
  write_text(frame(3), whole.substr(0, whole.size() / 2));
  write_text(folder() / "controls.json", "{}\n");
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  for (const int look_ahead : {0, 4}) {
    RecordingSourceOptions options;
    options.look_ahead = look_ahead;
    const auto source = open_recording_source(*recording, options);
    ASSERT_TRUE(source);
    std::vector<std::uint64_t> numbers;
    while (true) {
      const auto next = (*source)->next();
      ASSERT_TRUE(next) << next.error().message;
      if (!*next) break;
      numbers.push_back((*next)->sequence);
      EXPECT_EQ((*next)->timestamp_ns,
                kStartNs + static_cast<std::int64_t>((*next)->sequence) * kStepNs);
    }
    EXPECT_EQ(numbers, (std::vector<std::uint64_t>{1, 2, 4, 5, 6, 7}));
    EXPECT_EQ((*source)->damaged(), 2);
  }
  // A frame that is no file is an error, not damage by the camera.
  std::filesystem::remove(frame(4));
  std::filesystem::create_directory(frame(4));
  EXPECT_THAT(play(*recording).error, HasSubstr("000004.jpg"));
}

TEST_F(FrameFolderRecording, RejectsRecordingWithoutReadableFrame) {
  for (int i = 0; i < kFrames; ++i) write_text(frame(i), "garbage");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("000000.jpg"), HasSubstr("none of the 8")));
}

TEST_F(FrameFolderRecording, RejectsFrameOfOtherSizeAndReportsBothSizes) {
  write_text(frame(2), test::jpeg_of(2, 32, 24));
  EXPECT_THAT(error_of(folder()),
              AllOf(HasSubstr("000002.jpg"), HasSubstr("32x24"), HasSubstr("64x48")));
}

// --- video ---

int value_at(int plane, int x, int y, int index) {
  return (x * 3 + y * 5 + index * 17 + plane * 50 + (x * y * (index + 1)) % 7) & 0xFF;
}

void fill_planes(AVFrame& frame, int index) {
  const auto format = static_cast<AVPixelFormat>(frame.format);
  for (int plane = 0; plane < av_pix_fmt_count_planes(format); ++plane) {
    const AVPixFmtDescriptor* description = av_pix_fmt_desc_get(format);
    const bool chroma = plane > 0 && (description->flags & AV_PIX_FMT_FLAG_RGB) == 0;
    const int rows =
        chroma ? AV_CEIL_RSHIFT(frame.height, description->log2_chroma_h) : frame.height;
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < frame.linesize[plane]; ++x) {
        frame.data[plane][y * frame.linesize[plane] + x] =
            static_cast<std::uint8_t>(value_at(plane, x, y, index));
      }
    }
  }
}

class VideoRecording : public testing::Test {
 protected:
  VideoRecording() {
    EXPECT_TRUE(load_libav());
    test::write_recording(folder(), kFrames, "");
  }
  [[nodiscard]] std::filesystem::path folder() const { return root_.path() / "filmed"; }
  [[nodiscard]] std::filesystem::path video() const { return folder() / "video.mkv"; }

  // Writes a video with `gop` frames from key frame to key frame, and plays it.
  [[nodiscard]] Played play_with_key_frames(int gop) const {
    test::VideoSpec spec;
    spec.gop = gop;
    test::write_video(video(), spec, fill_planes);
    return play(*open_recording(folder()));
  }

 private:
  TemporaryFolder root_;
};

struct Stored {
  AVPixelFormat stored;
  AVCodecID codec;
  PixelFormat format;
};

TEST_F(VideoRecording, DecodesEveryPixelLayoutExactly) {
  for (const Stored& layout : {Stored{AV_PIX_FMT_GRAY8, AV_CODEC_ID_FFV1, PixelFormat::grey8},
                               {AV_PIX_FMT_YUV420P, AV_CODEC_ID_FFV1, PixelFormat::yuv420p},
                               {AV_PIX_FMT_YUV422P, AV_CODEC_ID_FFV1, PixelFormat::yuv422p},
                               {AV_PIX_FMT_YUV444P, AV_CODEC_ID_FFV1, PixelFormat::yuv444p},
                               {AV_PIX_FMT_NV12, AV_CODEC_ID_RAWVIDEO, PixelFormat::nv12},
                               {AV_PIX_FMT_YUYV422, AV_CODEC_ID_RAWVIDEO, PixelFormat::yuyv}}) {
    SCOPED_TRACE(av_get_pix_fmt_name(layout.stored));
    test::VideoSpec spec;
    spec.format = layout.stored;
    spec.codec = layout.codec;
    test::write_video(video(), spec, fill_planes);
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_TRUE(recording->notices.empty());
    const Played played = play(*recording);
    ASSERT_EQ(played.error, "");
    ASSERT_EQ(played.frames.size(), std::size_t{kFrames});
    for (int i = 0; i < kFrames; ++i) {
      const Frame& frame = played.frames[static_cast<std::size_t>(i)];
      ASSERT_EQ(frame.format, layout.format);
      EXPECT_EQ(frame.timestamp_ns, kStartNs + i * kStepNs);
      for (std::size_t p = 0; p < static_cast<std::size_t>(frame.plane_count); ++p) {
        const PixelPlane& plane = frame.planes[p];
        const int group = layout.format == PixelFormat::yuyv             ? 4
                          : layout.format == PixelFormat::nv12 && p == 1 ? 2
                                                                         : 1;
        for (int y = 0; y < plane.height; ++y) {
          for (int x = 0; x < plane.width * group; ++x) {
            ASSERT_EQ(sample(frame, p, x, y), value_at(static_cast<int>(p), x, y, i))
                << "frame " << i << " plane " << p << " at " << x << ", " << y;
          }
        }
      }
    }
  }
}

// Byte c (R, G, B) of a packed pixel is at `offset[c]`.
struct Packed {
  AVPixelFormat stored;
  AVCodecID codec;
  std::array<int, 3> offset;
};

TEST_F(VideoRecording, ConvertsRgbLayoutsToRgb24) {
  for (const Packed& layout : {Packed{AV_PIX_FMT_BGR0, AV_CODEC_ID_FFV1, {2, 1, 0}},
                               {AV_PIX_FMT_BGRA, AV_CODEC_ID_FFV1, {2, 1, 0}},
                               {AV_PIX_FMT_RGBA, AV_CODEC_ID_RAWVIDEO, {0, 1, 2}}}) {
    SCOPED_TRACE(av_get_pix_fmt_name(layout.stored));
    test::VideoSpec spec;
    spec.format = layout.stored;
    spec.codec = layout.codec;
    test::write_video(video(), spec, fill_planes);
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording) << recording.error().message;
    const Played played = play(*recording);
    ASSERT_EQ(played.frames.size(), std::size_t{kFrames}) << played.error;
    const Frame& frame = played.frames[5];
    ASSERT_EQ(frame.format, PixelFormat::rgb24);
    for (int y = 0; y < 48; ++y) {
      for (int x = 0; x < 64; ++x) {
        for (int c = 0; c < 3; ++c) {
          const int expected =
              value_at(0, 4 * x + layout.offset[static_cast<std::size_t>(c)], y, 5);
          ASSERT_EQ(sample(frame, 0, 3 * x + c, y), expected) << x << ", " << y << ", " << c;
        }
      }
    }
  }
}

TEST_F(VideoRecording, ReadsColorRangeAndMatrixFromFile) {
  test::VideoSpec spec;
  test::write_video(video(), spec, fill_planes);
  EXPECT_EQ(play(*open_recording(folder())).frames[0].color_range, ColorRange::limited);
  EXPECT_EQ(play(*open_recording(folder())).frames[0].color_matrix, ColorMatrix::bt601);
  spec.range = AVCOL_RANGE_JPEG;
  spec.matrix = AVCOL_SPC_BT709;
  test::write_video(video(), spec, fill_planes);
  EXPECT_EQ(play(*open_recording(folder())).frames[0].color_range, ColorRange::full);
  EXPECT_EQ(play(*open_recording(folder())).frames[0].color_matrix, ColorMatrix::bt709);
}

TEST_F(VideoRecording, DecodesFrameRangesLikeWholeVideo) {
  for (const int gop : {1, 3, 100}) {
    test::VideoSpec spec;
    spec.gop = gop;
    test::write_video(video(), spec, fill_planes);
    const auto recording = open_recording(folder());
    ASSERT_TRUE(recording);
    const Played whole = play(*recording);
    ASSERT_EQ(whole.frames.size(), std::size_t{kFrames});
    for (int first = 0; first < kFrames; ++first) {
      RecordingSourceOptions options;
      options.first = first;
      const Played part = play(*recording, options);
      ASSERT_EQ(part.error, "");
      ASSERT_EQ(part.frames.size(), static_cast<std::size_t>(kFrames - first));
      for (std::size_t i = 0; i < part.frames.size(); ++i) {
        EXPECT_TRUE(same_pixels(part.frames[i], whole.frames[i + static_cast<std::size_t>(first)]));
        EXPECT_EQ(part.frames[i].sequence, i + static_cast<std::size_t>(first));
      }
    }
  }
}

// Seeks to frames between key frames, to a key frame, and after an earlier seek.
TEST_F(VideoRecording, SkipsFramesFromAnyPosition) {
  std::mt19937 random(7);
  for (const int gop : {1, 3, 5, 100}) {
    SCOPED_TRACE(gop);
    const Played whole = play_with_key_frames(gop);
    ASSERT_EQ(whole.frames.size(), std::size_t{kFrames});
    for (int round = 0; round < 40; ++round) {
      auto reader = VideoReader::open(video());
      ASSERT_TRUE(reader) << reader.error().message;
      for (int at = 0; at < kFrames;) {
        const int skipped = static_cast<int>(random() % 4);
        ASSERT_TRUE(reader->skip(skipped));
        at += skipped;
        const auto frame = reader->next();
        ASSERT_TRUE(frame) << frame.error().message;
        ASSERT_EQ(frame->has_value(), at < kFrames);
        if (!*frame) break;
        EXPECT_TRUE(same_pixels(**frame, whole.frames[static_cast<std::size_t>(at)])) << at;
        ++at;
      }
    }
  }
}

// A damaged frame and the frames that depend on it are reported. From the next key frame on, all
// frames are correct.
TEST_F(VideoRecording, ContinuesAfterDamagedFrame) {
  for (const int gop : {1, 4}) {
    SCOPED_TRACE(gop);
    const Played whole = play_with_key_frames(gop);
    ASSERT_EQ(whole.frames.size(), std::size_t{kFrames});
    std::string bytes = test::read_bytes(video());
    bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x10);
    write_text(video(), bytes);
    auto reader = VideoReader::open(video());
    ASSERT_TRUE(reader) << reader.error().message;
    std::set<int> damaged;
    for (int at = 0; at < kFrames; ++at) {
      const auto frame = reader->next();
      if (!frame) {
        damaged.insert(at);
        continue;
      }
      ASSERT_TRUE(frame->has_value());
      EXPECT_TRUE(same_pixels(**frame, whole.frames[static_cast<std::size_t>(at)])) << at;
    }
    ASSERT_FALSE(damaged.empty());
    EXPECT_LT(*damaged.rbegin() - *damaged.begin(), gop);
    if (gop > 1) {
      EXPECT_EQ((*damaged.rbegin() + 1) % gop, 0) << "the damage must end at the next key frame";
    }
    // Skips some frames of the same video.
    auto second_reader = VideoReader::open(video());
    ASSERT_TRUE(second_reader);
    ASSERT_TRUE(second_reader->skip(*damaged.begin() + 1));
    for (int at = *damaged.begin() + 1; at < kFrames; ++at) {
      const auto frame = second_reader->next();
      EXPECT_EQ(frame.has_value(), !damaged.contains(at)) << at;
    }
  }
}

TEST_F(VideoRecording, RejectsGarbageFile) {
  write_text(video(), "this is no video at all");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("video.mkv"), HasSubstr("Matroska")));
  write_text(video(), "");
  EXPECT_THAT(error_of(folder()), HasSubstr("video.mkv"));
}

TEST_F(VideoRecording, RejectsAndReportsLossyCodec) {
  test::VideoSpec spec;
  spec.codec = AV_CODEC_ID_MPEG4;
  spec.gop = 12;
  test::write_video(video(), spec, fill_planes);
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("video.mkv"), HasSubstr("mpeg4")));
}

TEST_F(VideoRecording, RejectsAndReportsTenBitFormat) {
  test::VideoSpec spec;
  spec.format = AV_PIX_FMT_YUV420P10LE;
  test::write_video(video(), spec, [](AVFrame& frame, int) {
    for (int plane = 0; plane < 3; ++plane) {
      for (int i = 0; i < frame.linesize[plane] * (plane > 0 ? 24 : 48); ++i) {
        frame.data[plane][i] = 0;
      }
    }
  });
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("video.mkv"), HasSubstr("yuv420p10le")));
}

TEST_F(VideoRecording, RejectsSizeOtherThanCameras) {
  test::VideoSpec spec;
  spec.width = 32;
  test::write_video(video(), spec, fill_planes);
  EXPECT_THAT(error_of(folder()),
              AllOf(HasSubstr("video.mkv: frame 0"), HasSubstr("32x48"), HasSubstr("64x48")));
}

TEST_F(VideoRecording, OpensTruncatedVideoUpToLastWholeFrame) {
  test::write_video(video(), {}, fill_planes);
  const std::string whole = test::read_bytes(video());
  const Played all = play(*open_recording(folder()));
  ASSERT_EQ(all.frames.size(), std::size_t{kFrames});
  int opened = 0;
  for (std::size_t length = 0; length < whole.size(); length += 97) {
    write_text(video(), whole.substr(0, length));
    const auto recording = open_recording(folder());
    if (!recording) {
      EXPECT_THAT(recording.error().message, HasSubstr("video.mkv"));
      continue;
    }
    ++opened;
    const Played played = play(*recording);
    ASSERT_EQ(played.error, "") << length;
    ASSERT_EQ(played.frames.size(), recording->frames.size());
    EXPECT_EQ(recording->notices.empty(), recording->frames.size() == std::size_t{kFrames});
    for (std::size_t i = 0; i < played.frames.size(); ++i) {
      ASSERT_TRUE(same_pixels(played.frames[i], all.frames[i]));
    }
  }
  EXPECT_GT(opened, 50);
}

TEST_F(VideoRecording, NeverReturnsWrongPixelsForFlippedBit) {
  for (const AVPixelFormat format : {AV_PIX_FMT_GRAY8, AV_PIX_FMT_YUV420P}) {
    test::VideoSpec spec;
    spec.format = format;
    test::write_video(video(), spec, fill_planes);
    const std::string whole = test::read_bytes(video());
    const Played all = play(*open_recording(folder()));
    ASSERT_EQ(all.frames.size(), std::size_t{kFrames});
    int refused = 0;
    int tried = 0;
    // Flips bits of the pixel data only; the bytes before it are names and sizes.
    for (std::size_t at = 1000; at + 1000 < whole.size(); at += 31, ++tried) {
      std::string broken = whole;
      broken[at] = static_cast<char>(broken[at] ^ 0x10);
      write_text(video(), broken);
      const auto recording = open_recording(folder());
      if (!recording) {
        ++refused;
        continue;
      }
      const Played played = play(*recording);
      refused += played.error.empty() ? 0 : 1;
      for (std::size_t i = 0; i < played.frames.size(); ++i) {
        ASSERT_TRUE(same_pixels(played.frames[i], all.frames[i])) << "byte " << at;
      }
    }
    EXPECT_GT(refused, tried * 95 / 100) << "of " << tried;
  }
}

TEST_F(VideoRecording, ReportsFrameCountMismatch) {
  test::VideoSpec spec;
  spec.frames = kFrames - 2;
  test::write_video(video(), spec, fill_planes);
  auto recording = open_recording(folder());
  ASSERT_TRUE(recording);
  EXPECT_EQ(recording->frames.size(), 6U);
  ASSERT_EQ(recording->notices.size(), 1U);
  EXPECT_THAT(recording->notices[0], HasSubstr("6 of 8"));
  spec.frames = kFrames + 3;
  test::write_video(video(), spec, fill_planes);
  recording = open_recording(folder());
  ASSERT_TRUE(recording);
  EXPECT_EQ(play(*recording).frames.size(), std::size_t{kFrames});
  ASSERT_EQ(recording->notices.size(), 1U);
  EXPECT_THAT(recording->notices[0], HasSubstr("holds 11 frames"));
}

// --- EuRoC ---

class EurocRecording : public testing::Test {
 protected:
  EurocRecording() {
    std::filesystem::create_directories(cam0() / "data");
    std::string list = "#timestamp [ns],filename\n";
    for (int i = 0; i < kFrames; ++i) {
      const std::string time = std::to_string(1403636579763555584 + i * 50'000'001LL);
      list += time + "," + time + ".png\r\n";
      write_text(cam0() / "data" / (time + ".png"), test::jpeg_of(i));
    }
    write_text(cam0() / "data.csv", list);
    write_text(root_.path() / "tags.yaml", test::small_tags_yaml());
    write_sensor("radial-tangential");
  }
  void write_sensor(const std::string& model) const {
    write_text(cam0() / "sensor.yaml",
               "# General sensor definitions.\nsensor_type: camera\nrate_hz: 20\n"
               "resolution: [64, 48]\ncamera_model: pinhole\n"
               "intrinsics: [45.8654, 45.7296, 36.7215, 24.8375] #fu, fv, cu, cv\n"
               "distortion_model: " +
                   model +
                   "\ndistortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, "
                   "1.76187114e-05]\n");
  }
  [[nodiscard]] std::filesystem::path folder() const { return root_.path(); }
  [[nodiscard]] std::filesystem::path cam0() const { return root_.path() / "mav0" / "cam0"; }

 private:
  TemporaryFolder root_;
};

TEST_F(EurocRecording, ReadsCameraFromSensorFile) {
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_EQ(recording->camera->parameters().fx, 45.8654);
  EXPECT_EQ(recording->camera->parameters().cy, 24.8375);
  EXPECT_EQ(recording->camera->parameters().model, DistortionModel::plumb_bob);
  EXPECT_EQ(recording->camera->parameters().distortion[3], 1.76187114e-05);
  EXPECT_EQ(recording->camera->parameters().distortion[4], 0.0);
  const Played played = play(*recording);
  ASSERT_EQ(played.frames.size(), std::size_t{kFrames}) << played.error;
  EXPECT_EQ(played.frames[7].timestamp_ns, 1403636579763555584 + 350'000'007);
  EXPECT_EQ(played.frames[7].sequence, 7U);
}

TEST_F(EurocRecording, MapsEquidistantToFisheyeAndPrefersCameraFile) {
  write_sensor("equidistant");
  EXPECT_EQ(open_recording(folder())->camera->parameters().model, DistortionModel::fisheye);
  write_text(folder() / "camera.yaml", test::small_camera_yaml());
  EXPECT_EQ(open_recording(folder())->camera->parameters().fx, 53.0);
}

TEST_F(EurocRecording, RejectsCameraNameOption) {
  OpenRecordingOptions options;
  options.camera_name = "left";
  const auto recording = open_recording(folder(), options);
  ASSERT_FALSE(recording);
  EXPECT_THAT(recording.error().message,
              AllOf(HasSubstr("sensor.yaml"), HasSubstr("one camera"), HasSubstr("--camera-name")));
}

// The ground truth is the pose of the body; T_BS is the pose of the camera on the body.
TEST_F(EurocRecording, TransformsGroundtruthFromBodyToCamera) {
  const std::filesystem::path truth = folder() / "mav0" / "state_groundtruth_estimate0";
  std::filesystem::create_directories(truth);
  // Truth: a rotation by 90 degrees about z at (1, 2, 3), and another pose half a second later.
  write_text(truth / "data.csv",
             "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y "
             "[], q_RS_z [], v_RS_R_x [m s^-1]\n"
             "1403636579763555584,1,2,3,0.70710678118654757,0,0,0.70710678118654757,0\n"
             "1403636580263555584,1,2,4,1,0,0,0,0\n");
  const auto without = open_recording(folder());
  ASSERT_TRUE(without) << without.error().message;
  EXPECT_FALSE(without->groundtruth);
  ASSERT_EQ(without->notices.size(), 1U);
  EXPECT_THAT(without->notices[0], AllOf(HasSubstr("T_BS"), HasSubstr("is not read")));

  write_text(cam0() / "sensor.yaml",
             test::read_bytes(cam0() / "sensor.yaml") +
                 "T_BS:\n  cols: 4\n  rows: 4\n  data: [0.0, -1.0, 0.0, 0.1,\n         1.0, 0.0, "
                 "0.0, 0.2,\n         0.0, 0.0, 1.0, 0.3,\n         0.0, 0.0, 0.0, 1.0]\n");
  const auto recording = open_recording(folder());
  ASSERT_TRUE(recording) << recording.error().message;
  ASSERT_TRUE(recording->groundtruth);
  EXPECT_FALSE(recording->groundtruth->of_body);
  ASSERT_EQ(recording->notices.size(), 1U);
  EXPECT_THAT(recording->notices[0], HasSubstr("table's frame"));
  const CameraPose& pose = recording->groundtruth->poses.at(0).T_table_camera;
  // The rotation maps (0.1, 0.2, 0.3) to (-0.2, 0.1, 0.3).
  EXPECT_LT((pose.translation() - Eigen::Vector3d(0.8, 2.1, 3.3)).norm(), 1e-12);
  EXPECT_LT((pose.rotation() * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(-1, 0, 0)).norm(), 1e-12);

  write_text(truth / "sensor.yaml",
             "T_BS:\n  data: [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n");
  const auto mounted = open_recording(folder());
  ASSERT_TRUE(mounted && mounted->groundtruth);
  // The truth's sensor is 1 m along the body's x, so the camera is 1 m back along the rotated x.
  EXPECT_LT((mounted->groundtruth->poses.at(0).T_table_camera.translation() -
             Eigen::Vector3d(0.8, 1.1, 3.3))
                .norm(),
            1e-12);

  write_text(truth / "data.csv", "1,1,2\n");
  const auto damaged = open_recording(folder());
  ASSERT_TRUE(damaged) << "damaged ground truth must not prevent opening: "
                       << damaged.error().message;
  EXPECT_FALSE(damaged->groundtruth);
  EXPECT_THAT(damaged->notices.at(0), AllOf(HasSubstr("data.csv"), HasSubstr("line 1")));
}

TEST_F(EurocRecording, ReportsUnknownDistortionModel) {
  write_sensor("fov");
  EXPECT_THAT(error_of(folder()),
              AllOf(HasSubstr("sensor.yaml"), HasSubstr("distortion_model"), HasSubstr("fov")));
}

TEST_F(EurocRecording, ReportsInvalidLine) {
  write_text(cam0() / "data.csv",
             "#timestamp [ns],filename\n1403636579763555584,1403636579763555584.png\n1e9,b.png\n");
  EXPECT_THAT(error_of(folder()), AllOf(HasSubstr("data.csv: line 3"), HasSubstr("1e9")));
}

// --- bundled and shared recordings ---

TEST(BundledRecordings, OpenAndPlayToTheEnd) {
  for (const auto& [name, frames] : {std::pair{"tabletop", 120}, {"corner", 40}}) {
    const auto recording = open_recording(test::recordings_dir() / name);
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_EQ(recording->name, name);
    EXPECT_TRUE(recording->notices.empty());
    const Played played = play(*recording);
    EXPECT_EQ(played.error, "");
    ASSERT_EQ(played.frames.size(), static_cast<std::size_t>(frames));
    ASSERT_EQ(recording->groundtruth->poses.size(), static_cast<std::size_t>(frames));
    for (std::size_t i = 0; i < played.frames.size(); ++i) {
      EXPECT_EQ(played.frames[i].timestamp_ns, recording->groundtruth->poses[i].timestamp_ns);
    }
  }
}

TEST(SharedRecordings, OpenAndPlayToTheEnd) {
  const auto shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  int opened = 0;
  for (const auto& entry : std::filesystem::directory_iterator(shared / "recordings")) {
    OpenRecordingOptions options;
    options.require_tags = false;  // calibration images of a chessboard have no tags
    const auto recording = open_recording(entry.path(), options);
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_TRUE(recording->notices.empty()) << recording->notices.front();
    const Played played = play(*recording);
    EXPECT_EQ(played.error, "");
    EXPECT_EQ(played.frames.size(), recording->frames.size());
    EXPECT_EQ(recording->groundtruth->poses.size(), recording->frames.size());
    ++opened;
  }
  EXPECT_GE(opened, 10);
}

}  // namespace
}  // namespace penumbra
