#include "core/image/jpeg_file.hpp"

#include <gtest/gtest.h>

#include "core/image/jpeg_outline.hpp"
#include "support/jpeg_images.hpp"
#include "support/same_pixels.hpp"

namespace penumbra {
namespace {

std::span<const std::uint8_t> jpeg_bytes(const std::string& text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

Result<Frame> decoded(const std::string& jpeg) {
  return decode_jpeg(jpeg_bytes(jpeg), "a.jpg");
}

std::string cause_of(const std::string& jpeg) {
  const auto frame = decoded(jpeg);
  return frame ? std::string() : frame.error().message;
}

class CameraJpegKind : public testing::TestWithParam<test::JpegKind> {
 protected:
  const std::string valid_jpeg_ = test::encode_jpeg_kind(GetParam());
  const Result<Frame> expected_ = decoded(valid_jpeg_);

  void expect_same(const std::string& jpeg) const {
    const auto frame = decoded(jpeg);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_TRUE(test::same_pixels(*frame, *expected_));
  }
};

TEST_P(CameraJpegKind, DecodesInFull) {
  ASSERT_TRUE(expected_) << expected_.error().message;
  EXPECT_EQ(expected_->width, GetParam().width);
  EXPECT_EQ(expected_->height, GetParam().height);
}

TEST_P(CameraJpegKind, IgnoresBytesAfterEndMarker) {
  ASSERT_TRUE(expected_);
  const std::string older = test::encode_jpeg_kind(GetParam(), 5);
  for (const std::string& trail :
       {std::string(700, '\xFF'), std::string(5000, '\0'), std::string("\x12\x34\xFF\xD9"),
        older.substr(older.size() / 2), older, std::string(3000, '\x5A')}) {
    expect_same(valid_jpeg_ + trail);
    const auto outline = outline_jpeg(jpeg_bytes(valid_jpeg_ + trail));
    ASSERT_TRUE(outline);
    EXPECT_EQ(outline->bytes.size(), valid_jpeg_.size());
  }
}

TEST_P(CameraJpegKind, NeedsNoEndMarkerWhenBlocksAreComplete) {
  ASSERT_TRUE(expected_);
  const std::string unended = valid_jpeg_.substr(0, valid_jpeg_.size() - 2);
  expect_same(unended);
  expect_same(unended + '\xFF');
  expect_same(unended + std::string(500, '\xFF'));
  expect_same(unended + std::string(5000, '\0'));
  expect_same(unended + test::encode_jpeg_kind(GetParam(), 3));  // the next image follows
}

TEST_P(CameraJpegKind, IsRejectedWhenBlocksAreMissing) {
  const std::size_t headers = test::headers_length(valid_jpeg_);
  for (std::size_t length = 0; length + 2 < valid_jpeg_.size();
       length += length < headers ? 13 : (length + 40 < valid_jpeg_.size() ? 5 : 1)) {
    const std::string half = valid_jpeg_.substr(0, length);
    ASSERT_FALSE(decoded(half)) << length << " of " << valid_jpeg_.size();
    ASSERT_FALSE(decoded(half + "\xFF\xD9")) << length << " of " << valid_jpeg_.size();
    // Zeros could encode the last missing blocks.
    if (length + 120 < valid_jpeg_.size()) {
      ASSERT_FALSE(decoded(half + std::string(4000, '\0')))
          << length << " of " << valid_jpeg_.size();
    }
  }
}

TEST_P(CameraJpegKind, SkipsDoubledStartMarker) {
  ASSERT_TRUE(expected_);
  expect_same("\xFF\xD8" + valid_jpeg_);
  expect_same("\xFF\xD8\xFF\xD8\xFF" + valid_jpeg_);
  expect_same(std::string("\xFF\xD8\xFF\xE0\x00\x06"
                          "AVI1",
                          10) +
              valid_jpeg_);
}

TEST_P(CameraJpegKind, IgnoresFewBytesBeforeRestartMarkers) {
  ASSERT_TRUE(expected_);
  const auto restarts = test::restarts_of(valid_jpeg_);
  EXPECT_EQ(restarts.empty(), GetParam().restart_rows == 0);
  for (const std::size_t count : {1, 4, 16}) {
    std::string stray = valid_jpeg_;
    for (auto at = restarts.rbegin(); at != restarts.rend(); ++at) stray.insert(*at, count, '\x33');
    expect_same(stray);
  }
  if (restarts.empty()) return;
  std::string excess = valid_jpeg_;
  excess.insert(restarts[1], 200, '\x33');
  EXPECT_NE(cause_of(excess).find("a.jpg: damaged JPEG (Corrupt JPEG data: 200 extraneous bytes"),
            std::string::npos)
      << cause_of(excess);
  std::string swapped = valid_jpeg_;
  std::swap(swapped[restarts[0] + 1], swapped[restarts[1] + 1]);
  EXPECT_NE(cause_of(swapped), "");
}

TEST_P(CameraJpegKind, IsNormalizedForOtherPrograms) {
  const std::string unended = "\xFF\xD8" + valid_jpeg_.substr(0, valid_jpeg_.size() - 2);
  for (const std::string& jpeg : {unended, valid_jpeg_ + "trail", "\xFF\xD8" + valid_jpeg_}) {
    const auto outline = outline_jpeg(jpeg_bytes(jpeg));
    ASSERT_TRUE(outline) << outline.error().message;
    EXPECT_EQ(outline->width, GetParam().width);
    EXPECT_EQ(outline->height, GetParam().height);
    const auto bytes = normalized_jpeg(*outline, GetParam().height);
    EXPECT_EQ(std::string(bytes.begin(), bytes.end()), valid_jpeg_);
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, CameraJpegKind, testing::ValuesIn(test::jpeg_kinds()),
                         [](const auto& test) { return std::string(test.param.name); });

TEST(CameraJpeg, ReportsLineWhereBlocksEnd) {
  const std::string valid_jpeg = test::encode_jpeg_kind(test::jpeg_kinds()[0]);
  const std::string cause = cause_of(valid_jpeg.substr(0, valid_jpeg.size() * 3 / 4));
  EXPECT_NE(cause.find("premature end of data segment, after line 48 of 72"), std::string::npos)
      << cause;
}

TEST(CameraJpeg, RejectsComponentWithoutScan) {
  test::JpegKind kind = test::jpeg_kinds()[0];
  kind.separate_scans = true;
  const std::string valid_jpeg = test::encode_jpeg_kind(kind);
  ASSERT_TRUE(decoded(valid_jpeg)) << cause_of(valid_jpeg);
  const std::size_t last = valid_jpeg.rfind("\xFF\xDA");
  ASSERT_GT(last, test::headers_length(valid_jpeg));
  for (const char* end : {"", "\xFF\xD9"}) {
    EXPECT_NE(
        cause_of(valid_jpeg.substr(0, last) + end).find("ends before the scan of a component"),
        std::string::npos)
        << cause_of(valid_jpeg.substr(0, last) + end);
  }
}

// An image that lacks one or more scans is rejected, with or without an end marker.
TEST(CameraJpeg, RejectsProgressiveImageThatLacksScans) {
  for (const int components : {1, 3}) {
    test::JpegKind kind = test::jpeg_kinds()[0];
    kind.components = components;
    kind.progressive = true;
    const std::string valid_jpeg = test::encode_jpeg_kind(kind);
    EXPECT_TRUE(decoded(valid_jpeg)) << cause_of(valid_jpeg);
    const auto scans = test::scans_of(valid_jpeg);
    ASSERT_GE(scans.size(), 6U);
    for (std::size_t i = 1; i < scans.size(); ++i) {
      for (const char* end : {"", "\xFF\xD9"}) {
        const std::string cut = valid_jpeg.substr(0, scans[i]) + end;
        EXPECT_NE(cause_of(cut).find("ends before its last scan"), std::string::npos)
            << i << " of " << scans.size() << " scans: " << cause_of(cut);
      }
    }
  }
}

TEST(CameraJpeg, CropsPaddingOnlyWithinLastBlockRow) {
  test::JpegKind kind = test::jpeg_kinds()[0];
  kind.width = 64;
  kind.height = 80;
  const std::string padded = test::encode_jpeg_kind(kind);
  const auto outline = outline_jpeg(jpeg_bytes(padded));
  ASSERT_TRUE(outline);
  EXPECT_EQ(outline->block_height, 16);
  const auto full = decoded(padded);
  ASSERT_TRUE(full);
  const auto cut = normalized_jpeg(*outline, 72);
  const auto frame = decode_jpeg(cut, "cut.jpg");
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(frame->height, 72);
  EXPECT_EQ(frame->planes[1].height, 36);
  for (std::size_t i = 0; i < 3; ++i) {
    const PixelPlane& plane = frame->planes[i];
    for (int y = 0; y < plane.height; ++y) {
      EXPECT_TRUE(std::equal(plane.data + y * plane.stride,
                             plane.data + y * plane.stride + plane.width,
                             full->planes[i].data + y * full->planes[i].stride))
          << i << ", row " << y;
    }
  }
  // A crop by a whole block row is refused, because it would leave bytes after the last block.
  EXPECT_EQ(outline_jpeg(normalized_jpeg(*outline, 64))->height, 80);
}

}  // namespace
}  // namespace penumbra
