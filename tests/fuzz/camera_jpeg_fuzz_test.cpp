// Camera JPEG check and decoder together: an image is used if and only if every block was decoded.
#include <gtest/gtest.h>

#include <csetjmp>
#include <cstdio>
#include <cstdlib>
// libjpeg's headers use FILE and size_t without including them.
#include <jerror.h>
#include <jpeglib.h>

#include "app/capture/camera_jpeg.hpp"
#include "core/image/jpeg_outline.hpp"
#include "support/jpeg_images.hpp"
#include "support/mutate.hpp"
#include "support/same_pixels.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

std::span<const std::uint8_t> image_bytes(const std::string& text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

Result<Frame> received(const std::string& buffer, const ImageSize& granted) {
  auto image = receive_camera_jpeg(image_bytes(buffer), granted);
  if (!image) return fail("{}", image.error().message);
  if (image->frame) return std::move(*image->frame);
  return decode_camera_jpeg(image->bytes, "fuzz", granted, kImproveTransfer);
}

// Result of decoding with libjpeg alone, as the reference.
struct Verdict {
  bool has_all_rows = false;
  bool has_all_coefficients = false;
  bool lost_blocks = false;
  int warnings = 0;
  [[nodiscard]] bool is_whole() const {
    return has_all_rows && has_all_coefficients && !lost_blocks;
  }
};

class Oracle {
 public:
  static Verdict judge(std::span<const std::uint8_t> bytes) { return Oracle().run(bytes); }

 private:
  struct Errors : jpeg_error_mgr {
    std::jmp_buf jump;
    Verdict* verdict = nullptr;
  };
  static void count(j_common_ptr info, int level) {
    if (level >= 0) return;
    Verdict& verdict = *static_cast<Errors*>(info->err)->verdict;
    ++verdict.warnings;
    const int code = info->err->msg_code;
    const int max_extraneous_bytes = info->err->msg_parm.i[1] == JPEG_EOI ? 1024 : 16;
    const bool harmless =
        code == JWRN_JPEG_EOF || code == JWRN_JFIF_MAJOR || code == JWRN_ADOBE_XFORM ||
        code == JWRN_NOT_SEQUENTIAL ||
        (code == JWRN_EXTRANEOUS_DATA && info->err->msg_parm.i[0] <= max_extraneous_bytes);
    // An error after the last row can't affect any block.
    if (!harmless && !verdict.has_all_rows) verdict.lost_blocks = true;
  }
  Verdict run(std::span<const std::uint8_t> bytes) {
    info_.err = jpeg_std_error(&errors_);
    errors_.verdict = &verdict_;
    errors_.emit_message = count;
    errors_.error_exit = [](j_common_ptr info) {
      std::longjmp(static_cast<Errors*>(info->err)->jump, 1);
    };
    jpeg_create_decompress(&info_);
    if (setjmp(errors_.jump) == 0) {
      jpeg_mem_src(&info_, bytes.data(), static_cast<unsigned long>(bytes.size()));
      jpeg_read_header(&info_, TRUE);
      jpeg_start_decompress(&info_);
      row_ = static_cast<JSAMPLE*>(std::malloc(std::size_t{info_.output_width} *
                                               static_cast<std::size_t>(info_.output_components)));
      while (info_.output_scanline < info_.output_height) jpeg_read_scanlines(&info_, &row_, 1);
      verdict_.has_all_rows = true;
      verdict_.has_all_coefficients = true;
      for (int i = 0; i < info_.num_components && info_.progressive_mode != FALSE; ++i) {
        for (const int missing : info_.coef_bits[i]) {
          if (missing != 0) verdict_.has_all_coefficients = false;
        }
      }
      jpeg_finish_decompress(&info_);
    }
    jpeg_destroy_decompress(&info_);
    std::free(row_);
    return verdict_;
  }

  jpeg_decompress_struct info_{};
  Errors errors_{};
  JSAMPLE* row_ = nullptr;
  Verdict verdict_;
};

// Returns the number of mutations per kind of JPEG.
int per_kind(int short_form, int nightly) {
  return test::nightly() ? nightly : short_form;
}

class CameraJpegFuzz : public testing::TestWithParam<test::JpegKind> {
 protected:
  const std::string valid_jpeg_ = test::encode_jpeg_kind(GetParam());
  const ImageSize size_{GetParam().width, GetParam().height};
};

TEST_P(CameraJpegFuzz, AcceptsOnlyImagesThatLibjpegDecodesInFull) {
  test::Random random(11);
  const int count = per_kind(300, 3500);
  int used = 0;
  for (int i = 0; i < count; ++i) {
    // A third of the changes are in the headers.
    const std::size_t head = i % 3 == 0 ? test::headers_length(valid_jpeg_) : 0;
    const std::string broken =
        test::mutated(valid_jpeg_.substr(0, head > 0 ? head : valid_jpeg_.size()), random) +
        (head > 0 ? valid_jpeg_.substr(head) : std::string());
    const auto frame = received(broken, size_);
    const Verdict raw = Oracle::judge(image_bytes(broken));
    if (frame) {
      ++used;
      EXPECT_EQ((ImageSize{frame->width, frame->height}), size_);
      const auto outline = outline_jpeg(image_bytes(broken));
      ASSERT_TRUE(outline);
      // Passes only the image's own bytes to libjpeg, which would stop at a marker in the bytes
      // around them.
      const Verdict cut = Oracle::judge(outline->bytes);
      EXPECT_TRUE(cut.is_whole()) << "mutation " << i;
    } else {
      EXPECT_EQ(frame.error().message.find('\n'), std::string::npos);
      const bool is_clean = raw.is_whole() && raw.warnings == 0;
      const auto outline = outline_jpeg(image_bytes(broken));
      const bool has_granted_size = outline && outline->width == size_.width &&
                                    outline->height >= size_.height &&
                                    outline->height < size_.height + 16;
      EXPECT_FALSE(is_clean && has_granted_size)
          << "mutation " << i << ": " << frame.error().message;
    }
  }
  RecordProperty("used", used);
  std::printf("%d mutations, %d used\n", count, used);
}

// Changes bytes outside the entropy-coded blocks.
std::string with_harmless_change(const std::string& valid_jpeg, test::Random& random) {
  const auto fill = [&](std::size_t max_length) {
    std::string bytes(1 + random.below(max_length), '\0');
    for (char& c : bytes) c = static_cast<char>(random.below(255));  // no 0xFF
    return bytes;
  };
  std::string bytes = valid_jpeg;
  const std::size_t headers = test::headers_length(bytes);
  const auto restarts = test::restarts_of(bytes);
  switch (random.below(8)) {
    case 0: {  // changes the content of a segment that does not affect blocks
      const std::size_t at = test::marker_at(bytes, random.below(2) == 0 ? 0xE0 : 0xFE);
      if (at == std::string::npos) break;
      const std::size_t length = test::segment_length(bytes, at);
      for (int i = 0; i < 4; ++i) {
        bytes[at + 4 + random.below(length - 4)] = static_cast<char>(random.below(256));
      }
      break;
    }
    case 1: {  // inserts a segment that does not affect blocks
      const std::string content = fill(300);
      std::string segment("\xFF\xE0");
      segment[1] = static_cast<char>(random.below(2) == 0 ? 0xFE : 0xE1 + random.below(12));
      segment += static_cast<char>((content.size() + 2) >> 8U);
      segment += static_cast<char>((content.size() + 2) & 0xFFU);
      bytes.insert(2, segment + content);
      break;
    }
    case 2:  // inserts fill bytes before the scan header, or after the start marker
      bytes.insert(test::marker_at(bytes, random.below(2) == 0 ? 0xC0 : 0xDA) < headers
                       ? test::marker_at(bytes, 0xDA)
                       : 2,
                   1 + random.below(20), '\xFF');
      break;
    case 3: {  // appends arbitrary bytes after the end marker
      std::string trail = fill(4000);
      for (char& c : trail) c = static_cast<char>(random.below(256));
      bytes += trail;
      break;
    }
    case 4:  // removes the end marker, as in a full buffer
      bytes.resize(bytes.size() - 2);
      if (random.below(2) == 0)
        bytes.append(random.below(3000), random.below(2) == 0 ? '\0' : '\xFF');
      break;
    case 5:  // inserts a second start marker
      bytes.insert(0, "\xFF\xD8");
      break;
    case 6:  // inserts bytes before a restart marker
      if (!restarts.empty()) {
        std::string few = fill(16);
        bytes.insert(restarts[random.below(restarts.size())], few);
      }
      break;
    default:  // inserts bytes before the end marker
      bytes.insert(bytes.size() - 2, fill(1000));
      break;
  }
  return bytes;
}

TEST_P(CameraJpegFuzz, AcceptsCompleteImagesAfterHarmlessChanges) {
  test::Random random(12);
  const auto expected = received(valid_jpeg_, size_);
  ASSERT_TRUE(expected) << expected.error().message;
  const int count = per_kind(100, 1500);
  for (int i = 0; i < count; ++i) {
    const std::string changed = with_harmless_change(valid_jpeg_, random);
    const auto frame = received(changed, size_);
    ASSERT_TRUE(frame) << "change " << i << ": " << frame.error().message;
    ASSERT_TRUE(test::same_pixels(*frame, *expected)) << "change " << i;
    const auto outline = outline_jpeg(image_bytes(changed));
    ASSERT_TRUE(outline);
    const auto stored = normalized_jpeg(*outline, size_.height);
    const Verdict verdict = Oracle::judge(stored);
    ASSERT_TRUE(verdict.is_whole()) << "change " << i;
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, CameraJpegFuzz, testing::ValuesIn(test::jpeg_kinds()),
                         [](const auto& test) { return std::string(test.param.name); });

}  // namespace
}  // namespace penumbra
