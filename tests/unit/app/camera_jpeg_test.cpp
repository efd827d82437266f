#include "app/capture/camera_jpeg.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "app/recording/recording_feed.hpp"
#include "app/recording/recording_source.hpp"
#include "app/recording/recording_writer.hpp"
#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "support/jpeg_images.hpp"
#include "support/paths.hpp"
#include "support/recording_folder.hpp"
#include "support/same_pixels.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr ImageSize kTabletop{640, 480};

std::string tabletop_frame(int number) {
  return test::read_bytes(test::recordings_dir() / "tabletop" / "frames" /
                          (test::six_digits(number) + ".jpg"));
}

std::span<const std::uint8_t> view_of(const std::string& text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

// Checks and decodes a camera's buffer as `live` does.
Result<Frame> live_frame(const std::string& buffer, const ImageSize& stream_size) {
  auto received = receive_camera_jpeg(view_of(buffer), stream_size);
  if (!received) return fail("{}", received.error().message);
  if (received->frame) return std::move(*received->frame);
  return decode_camera_jpeg(received->bytes, "a frame", stream_size, kImproveTransfer);
}

// Returns the JPEG with `height` written into its frame header.
std::string with_height(std::string jpeg, int height) {
  const std::size_t header = jpeg.find("\xFF\xC0");
  jpeg[header + 5] = static_cast<char>(height >> 8);
  jpeg[header + 6] = static_cast<char>(height & 0xFF);
  return jpeg;
}

TEST(CameraJpegGate, AcceptsTypicalCameraImages) {
  const std::string valid_jpeg = tabletop_frame(0);
  const std::string older = tabletop_frame(1);
  const std::string unended = valid_jpeg.substr(0, valid_jpeg.size() - 2);
  const auto expected = live_frame(valid_jpeg, kTabletop);
  ASSERT_TRUE(expected) << expected.error().message;
  for (const std::string& buffer :
       {valid_jpeg + older.substr(older.size() - 900), valid_jpeg + std::string(1024, '\xFF'),
        valid_jpeg + std::string(9000, '\0'), unended, unended + std::string(9000, '\0'),
        unended + std::string(512, '\xFF'), "\xFF\xD8" + valid_jpeg, "\xFF\xD8" + unended}) {
    const auto frame = live_frame(buffer, kTabletop);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_TRUE(test::same_pixels(*frame, *expected));
    const auto replayed = decode_recorded_image(view_of(buffer), "000000.jpg", kTabletop);
    ASSERT_TRUE(replayed) << replayed.error().message;
    EXPECT_TRUE(test::same_pixels(*replayed, *expected));
  }
}

TEST(CameraJpegGate, DecodesOnlyImagesWithoutEndMarker) {
  const std::string valid_jpeg = tabletop_frame(0);
  const auto ended = receive_camera_jpeg(view_of(valid_jpeg + "xx"), kTabletop);
  ASSERT_TRUE(ended);
  EXPECT_FALSE(ended->frame);
  EXPECT_EQ(ended->bytes.size(), valid_jpeg.size());
  EXPECT_TRUE(
      receive_camera_jpeg(view_of(valid_jpeg.substr(0, valid_jpeg.size() - 2)), kTabletop)->frame);
}

TEST(CameraJpegGate, RejectsTruncatedImagesWithRemedy) {
  const std::string valid_jpeg = tabletop_frame(0);
  for (const std::size_t length : {std::size_t{0}, std::size_t{2}, std::size_t{300},
                                   valid_jpeg.size() / 2, valid_jpeg.size() - 40}) {
    for (const std::string& buffer :
         {valid_jpeg.substr(0, length), valid_jpeg.substr(0, length) + std::string(5000, '\0'),
          valid_jpeg.substr(0, length) + valid_jpeg}) {
      const auto received = receive_camera_jpeg(view_of(buffer), kTabletop);
      if (length <= 2 && buffer.ends_with(valid_jpeg)) {
        continue;  // complete image, possibly with a doubled start marker
      }
      ASSERT_FALSE(received) << length;
      EXPECT_EQ(received.error().fault, CaptureFault::damaged);
      EXPECT_THAT(received.error().message, HasSubstr("try another USB port"));
    }
  }
  const auto half =
      receive_camera_jpeg(view_of(valid_jpeg.substr(0, valid_jpeg.size() / 2)), kTabletop);
  EXPECT_THAT(half.error().message, AllOf(HasSubstr("after line"), HasSubstr("of 480")));
}

// A progressive image may have an end marker after any scan and still lack coefficients.
TEST(CameraJpegGate, RejectsProgressiveImagesThatLackScans) {
  test::JpegKind kind = test::jpeg_kinds()[0];
  kind.progressive = true;
  const ImageSize size{kind.width, kind.height};
  const std::string valid_jpeg = test::encode_jpeg_kind(kind);
  ASSERT_TRUE(live_frame(valid_jpeg, size));
  ASSERT_TRUE(decode_recorded_image(view_of(valid_jpeg), "a.jpg", size));
  const auto scans = test::scans_of(valid_jpeg);
  for (std::size_t i = 1; i < scans.size(); ++i) {
    for (const char* end : {"", "\xFF\xD9"}) {
      const std::string cut = valid_jpeg.substr(0, scans[i]) + end;
      EXPECT_FALSE(live_frame(cut, size)) << i << " of " << scans.size() << " scans";
      EXPECT_FALSE(decode_recorded_image(view_of(cut), "a.jpg", size))
          << i << " of " << scans.size() << " scans";
    }
  }
}

TEST(CameraJpegGate, CropsPaddedImageToStreamHeight) {
  const std::string valid_jpeg = tabletop_frame(0);
  const auto expected = live_frame(valid_jpeg, kTabletop);
  ASSERT_TRUE(expected);
  for (const int stream_height : {479, 472, 465}) {
    const auto frame = live_frame(valid_jpeg, {640, stream_height});
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(frame->height, stream_height);
    EXPECT_EQ(frame->planes[0].height, stream_height);
    EXPECT_EQ(frame->planes[1].height, (stream_height + 1) / 2);
    EXPECT_EQ(frame->planes[2].height, (stream_height + 1) / 2);
    const auto replayed =
        decode_recorded_image(view_of(valid_jpeg), "a.jpg", ImageSize{640, stream_height});
    ASSERT_TRUE(replayed);
    EXPECT_TRUE(test::same_pixels(*replayed, *frame));
  }
}

TEST(CameraJpegGate, ReportsBothSizesOnMismatch) {
  const std::string valid_jpeg = tabletop_frame(0);
  for (const ImageSize stream_size : {ImageSize{640, 464}, {640, 481}, {632, 480}, {320, 240}}) {
    const auto received = receive_camera_jpeg(view_of(valid_jpeg), stream_size);
    ASSERT_FALSE(received);
    EXPECT_EQ(received.error().fault, CaptureFault::wrong_format);
    EXPECT_THAT(received.error().message,
                AllOf(HasSubstr("640x480"),
                      HasSubstr(fmt::format("{}x{}", stream_size.width, stream_size.height)),
                      HasSubstr("--size")));
  }
}

TEST(CameraJpegGate, DoesNotCropPngToStreamHeight) {
  const test::TemporaryFolder folder;
  const std::vector<std::uint8_t> grey(std::size_t{64} * 48);
  const auto file = folder.path() / "a.png";
  ASSERT_TRUE(save_grey_png(file, {grey.data(), 64, 48, 64}));
  const auto frame = decode_recorded_image(*read_file(file), "a.png", ImageSize{64, 40});
  ASSERT_TRUE(frame);
  EXPECT_EQ(frame->height, 48);
}

// A recording stores images without an end marker in normalized form, so that other programs can
// read them. Replay decodes the same frames as live.
TEST(CameraJpegGate, RecordsNormalizedImages) {
  const test::TemporaryFolder temporary;
  const std::filesystem::path folder = temporary.path() / "session";
  const std::string valid_jpeg = tabletop_frame(0);
  const std::string buffer = "\xFF\xD8" + valid_jpeg.substr(0, valid_jpeg.size() - 2);
  const ImageSize stream_size{640, 472};
  auto received = receive_camera_jpeg(view_of(buffer), stream_size);
  ASSERT_TRUE(received);
  RecordingHead head;
  head.format.name = "MJPEG";
  head.format.width = stream_size.width;
  head.format.height = stream_size.height;
  auto writer = RecordingWriter::create(folder, head);
  ASSERT_TRUE(writer) << writer.error().message;
  CapturedImage image;
  image.jpeg = received->bytes;
  image.frame = *received->frame;
  image.owner = std::make_shared<int>(0);
  (*writer)->add_image(image);
  ASSERT_TRUE((*writer)->finish());
  EXPECT_EQ(test::read_bytes(folder / "frames" / "000000.jpg"), with_height(valid_jpeg, 472));

  OpenRecordingOptions options;
  options.with_metadata = false;
  const auto recording = open_recording(folder, options);
  ASSERT_TRUE(recording) << recording.error().message;
  const auto source = open_recording_source(*recording);
  ASSERT_TRUE(source);
  const auto frame = (*source)->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_TRUE(test::same_pixels(**frame, *received->frame));
}

// A recording played as a camera is checked like a camera, so it may begin with a truncated image.
TEST(CameraJpegGate, SkipsTruncatedImagesOfPlayedRecording) {
  const test::TemporaryFolder temporary;
  const std::filesystem::path folder = temporary.path() / "recording";
  test::write_recording(folder, 4);
  test::write_text(folder / "controls.json", "{}\n");
  const std::string valid_jpeg = test::jpeg_of(0);
  test::write_text(folder / "frames" / "000000.jpg", valid_jpeg.substr(0, valid_jpeg.size() / 2));
  const std::string second = test::jpeg_of(1);
  test::write_text(folder / "frames" / "000001.jpg",
                   "\xFF\xD8" + second.substr(0, second.size() - 2) + std::string(20, '\0'));
  const auto recording = open_recording(folder);
  ASSERT_TRUE(recording) << recording.error().message;
  const auto feed = open_recording_feed(*recording, 200.0);
  ASSERT_TRUE(feed) << feed.error().message;
  const auto frame = (*feed)->next();
  ASSERT_TRUE(frame && *frame);
  EXPECT_NE((*frame)->sequence % 4, 0U);
  EXPECT_THAT((*feed)->faults().take_events(),
              testing::Contains(
                  testing::Field(&FaultCounter::Event::detail,
                                 AllOf(HasSubstr("000000.jpg"), HasSubstr("copy it again")))));
  // On a slow machine the recording may have restarted.
  EXPECT_GE((*feed)->faults().stats().of(CaptureFault::damaged), 1U);
}

struct SharedCase {
  const char* folder;
  ImageSize size;
  int images;
};

class SharedCameraJpegs : public testing::TestWithParam<SharedCase> {};

TEST_P(SharedCameraJpegs, DecodeAlikeLiveAndInReplay) {
  const auto shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const auto folder = shared / "cases" / "capture" / GetParam().folder;
  int images = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (entry.path().extension() != ".jpg") continue;
    ++images;
    const std::string bytes = test::read_bytes(entry.path());
    const auto live = live_frame(bytes, GetParam().size);
    ASSERT_TRUE(live) << entry.path() << ": " << live.error().message;
    EXPECT_EQ((ImageSize{live->width, live->height}), GetParam().size);
    const auto replayed = decode_recorded_image(view_of(bytes), "a.jpg", GetParam().size);
    ASSERT_TRUE(replayed) << replayed.error().message;
    EXPECT_TRUE(test::same_pixels(*live, *replayed));
    // Images in `frames` must have the same pixels as their undamaged originals.
    const auto original = folder / ("clean-" + entry.path().stem().string().substr(5) + ".jpg");
    if (entry.path().parent_path().filename() == "frames") {
      const auto undamaged = load_image(original);
      ASSERT_TRUE(undamaged) << undamaged.error().message;
      EXPECT_TRUE(test::same_pixels(*live, *undamaged));
    }
  }
  EXPECT_EQ(images, GetParam().images);
}

INSTANTIATE_TEST_SUITE_P(Cases, SharedCameraJpegs,
                         testing::Values(SharedCase{"mjpeg-bytes-after-end", kTabletop, 4},
                                         SharedCase{"mjpeg-bytes-before-restart", kTabletop, 6},
                                         SharedCase{"mjpeg-no-end-mark", kTabletop, 3},
                                         SharedCase{"mjpeg-taller-than-granted", {640, 360}, 3},
                                         SharedCase{"mjpeg-two-start-marks", kTabletop, 3}),
                         [](const auto& test) {
                           std::string name = test.param.folder;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

}  // namespace
}  // namespace penumbra
