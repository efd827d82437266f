#include "core/image/jpeg_file.hpp"

#include <cstddef>
#include <cstdio>
// libjpeg's headers need <cstddef> and <cstdio>.
#include <jerror.h>
#include <jpeglib.h>
#include <turbojpeg.h>

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstring>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/assert.hpp"
#include "core/image/jpeg_outline.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kCheapPixels = 16'000'000;  // larger images must have enough bytes
constexpr int kMaxScans = 500;  // limits the time for a small, malicious progressive file
constexpr int kMaxComponents = 3;

// Wraps libjpeg. Fails on damage; libjpeg would only warn and output grey or shifted blocks. Errors
// of libjpeg return by longjmp, so code called by guarded() must not have objects with a
// destructor.
class JpegDecoder {
 public:
  explicit JpegDecoder(std::span<const std::uint8_t> bytes) {
    info_.err = jpeg_std_error(&errors_);
    info_.client_data = this;
    errors_.error_exit = [](j_common_ptr info) { self(info).leave_with_message(info); };
    errors_.emit_message = [](j_common_ptr info, int level) {
      if (level < 0 && !is_harmless(*info->err)) self(info).leave_with_message(info);
    };
    errors_.output_message = [](j_common_ptr) {};
    source_.next_input_byte = bytes.data();
    source_.bytes_in_buffer = bytes.size();
    source_.init_source = [](j_decompress_ptr) {};
    source_.term_source = [](j_decompress_ptr) {};
    source_.fill_input_buffer = supply_end_mark;
    source_.skip_input_data = skip;
    source_.resync_to_restart = jpeg_resync_to_restart;
    progress_.progress_monitor = [](j_common_ptr info) {
      JpegDecoder& decoder = self(info);
      if (decoder.info_.input_scan_number > kMaxScans) decoder.leave("more than 500 scans");
    };
  }
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;
  ~JpegDecoder() { jpeg_destroy_decompress(&info_); }

  // The following return false if the image is damaged; cause() then describes the damage.
  [[nodiscard]] bool read_header() {
    return guarded([this] {
      jpeg_create_decompress(&info_);
      info_.src = &source_;
      info_.progress = &progress_;
      (void)jpeg_read_header(&info_, TRUE);
    });
  }
  // The planes must have room for complete blocks.
  [[nodiscard]] bool read_planes(const FrameBuffer& buffer) {
    return guarded([&] {
      info_.raw_data_out = TRUE;
      info_.out_color_space = info_.jpeg_color_space;
      (void)jpeg_start_decompress(&info_);
      read_raw_rows(buffer);
      require_every_block();
    });
  }
  // Writes rows of interleaved samples, without padding.
  [[nodiscard]] bool read_pixels(J_COLOR_SPACE space, std::uint8_t* pixels) {
    return guarded([&] {
      info_.out_color_space = space;
      (void)jpeg_start_decompress(&info_);
      const std::size_t pitch = static_cast<std::size_t>(info_.output_width) *
                                static_cast<std::size_t>(info_.output_components);
      while (info_.output_scanline < info_.output_height) {
        JSAMPROW row = pixels + pitch * info_.output_scanline;
        if (jpeg_read_scanlines(&info_, &row, 1) == 0) leave("ends early");
      }
      require_every_block();
    });
  }

  [[nodiscard]] const jpeg_decompress_struct& info() const { return info_; }
  [[nodiscard]] std::string cause() const {
    const bool in_blocks = info_.output_scanline > 0 && info_.output_scanline < info_.output_height;
    return in_blocks ? fmt::format("{}, after line {} of {}", message_.data(),
                                   info_.output_scanline, info_.output_height)
                     : std::string(message_.data());
  }

 private:
  static JpegDecoder& self(j_common_ptr info) {
    return *static_cast<JpegDecoder*>(info->client_data);
  }
  static JpegDecoder& self(j_decompress_ptr info) {
    return *static_cast<JpegDecoder*>(info->client_data);
  }

  // Returns true for a warning that implies no lost block.
  static bool is_harmless(const jpeg_error_mgr& errors) {
    switch (errors.msg_code) {
      case JWRN_EXTRANEOUS_DATA: {
        const auto count = static_cast<std::size_t>(errors.msg_parm.i[0]);
        return count <= (errors.msg_parm.i[1] == JPEG_EOI ? kMaxFillBytes : kMaxStrayBytes);
      }
      case JWRN_NOT_SEQUENTIAL:  // scan parameters that baseline images ignore
      case JWRN_JFIF_MAJOR:
      case JWRN_ADOBE_XFORM:
        return true;
      default:
        return false;
    }
  }

  static boolean supply_end_mark(j_decompress_ptr info) {
    static constexpr std::array<JOCTET, 2> kEndMark{0xFF, JPEG_EOI};
    info->src->next_input_byte = kEndMark.data();
    info->src->bytes_in_buffer = kEndMark.size();
    return TRUE;
  }
  static void skip(j_decompress_ptr info, long count) {
    const auto wanted = static_cast<std::size_t>(std::max(count, 0L));
    if (wanted > info->src->bytes_in_buffer) {
      (void)supply_end_mark(info);
      return;
    }
    info->src->next_input_byte += wanted;
    info->src->bytes_in_buffer -= wanted;
  }

  template <class Call>
  bool guarded(const Call& call) {
    if (setjmp(on_error_) != 0) return false;
    call();
    return true;
  }
  [[noreturn]] void leave_with_message(j_common_ptr info) {
    info->err->format_message(info, message_.data());
    std::longjmp(on_error_, 1);
  }
  [[noreturn]] void leave(std::string_view message) {
    message_[message.copy(message_.data(), message_.size() - 1)] = '\0';
    std::longjmp(on_error_, 1);
  }

  void read_raw_rows(const FrameBuffer& buffer) {
    constexpr std::size_t kMaxRows = std::size_t{MAX_SAMP_FACTOR} * DCTSIZE;
    std::array<std::array<JSAMPROW, kMaxRows>, kMaxComponents> rows{};
    std::array<JSAMPARRAY, kMaxComponents> planes{};
    const auto lines = static_cast<JDIMENSION>(info_.max_v_samp_factor * DCTSIZE);
    while (info_.output_scanline < info_.output_height) {
      const std::size_t block_row = info_.output_scanline / lines;
      for (std::size_t i = 0; i < static_cast<std::size_t>(info_.num_components); ++i) {
        const auto count = static_cast<std::size_t>(info_.comp_info[i].v_samp_factor * DCTSIZE);
        const auto stride = static_cast<std::size_t>(buffer.frame.planes[i].stride);
        for (std::size_t row = 0; row < count; ++row) {
          rows[i][row] = buffer.plane_data[i] + (block_row * count + row) * stride;
        }
        planes[i] = rows[i].data();
      }
      if (jpeg_read_raw_data(&info_, planes.data(), lines) == 0) leave("ends early");
    }
  }

  // Fails if libjpeg concealed missing blocks. Call after all rows are decoded.
  void require_every_block() {
    for (int i = 0; i < info_.num_components; ++i) {
      if (info_.comp_info[i].quant_table == nullptr) leave("ends before the scan of a component");
    }
    if (jpeg_has_multiple_scans(&info_) == FALSE) {
      if (source_.bytes_in_buffer > kMaxFillBytes + 2) {
        leave("more bytes before the end mark than belong to its blocks");
      }
    } else if (info_.progressive_mode != FALSE) {
      // The end marker may follow any scan. Full precision shows that no scan is missing.
      for (int i = 0; i < info_.num_components; ++i) {
        const auto* bits = info_.coef_bits[i];
        if (std::any_of(bits, bits + DCTSIZE2, [](int missing) { return missing != 0; })) {
          leave("ends before its last scan");
        }
      }
    }
  }

  jpeg_decompress_struct info_{};
  jpeg_error_mgr errors_{};
  jpeg_source_mgr source_{};
  jpeg_progress_mgr progress_{};
  std::jmp_buf on_error_{};
  std::array<char, JMSG_LENGTH_MAX> message_{};
};

struct JpegSource {
  const std::string& name;
  std::string_view remedy;
  [[nodiscard]] tl::unexpected<Error> failure(std::string_view cause) const {
    return fail("{}: damaged JPEG ({}); {}", name, cause, remedy);
  }
};

Result<void> check_header(const jpeg_decompress_struct& info, std::size_t bytes,
                          const JpegSource& source) {
  PENUMBRA_TRY_VOID(check_image_size(info.image_width, info.image_height, source.name));
  // A block of 64 pixels needs at least one bit of Huffman code.
  const std::size_t pixels = std::size_t{info.image_width} * info.image_height;
  if (pixels > kCheapPixels && pixels / 512 > bytes) {
    return source.failure(
        fmt::format("{} bytes cannot hold {}x{} px", bytes, info.image_width, info.image_height));
  }
  switch (info.jpeg_color_space) {
    case JCS_GRAYSCALE:
    case JCS_YCbCr:
    case JCS_RGB:
      return {};
    case JCS_CMYK:
    case JCS_YCCK:
      return fail("{}: is a CMYK JPEG; convert it to RGB", source.name);
    default:
      return fail("{}: is a JPEG of {} components; convert it to RGB", source.name,
                  info.num_components);
  }
}

// Returns the pixel format with the same planes, or nullopt if the image must be converted.
std::optional<PixelFormat> stored_format(const jpeg_decompress_struct& info) {
  if (info.jpeg_color_space == JCS_GRAYSCALE) return PixelFormat::grey8;
  if (info.jpeg_color_space != JCS_YCbCr) return std::nullopt;
  const jpeg_component_info* components = info.comp_info;
  const int h = info.max_h_samp_factor;
  const int v = info.max_v_samp_factor;
  if (components[0].h_samp_factor != h || components[0].v_samp_factor != v ||
      components[1].h_samp_factor != components[2].h_samp_factor ||
      components[1].v_samp_factor != components[2].v_samp_factor) {
    return std::nullopt;
  }
  const bool same_columns = components[1].h_samp_factor == h;
  const bool same_rows = components[1].v_samp_factor == v;
  const bool half_columns = 2 * components[1].h_samp_factor == h;
  const bool half_rows = 2 * components[1].v_samp_factor == v;
  if (same_columns && same_rows) return PixelFormat::yuv444p;
  if (half_columns && same_rows) return PixelFormat::yuv422p;
  if (half_columns && half_rows) return PixelFormat::yuv420p;
  return std::nullopt;
}

Result<Frame> decode_planes(JpegDecoder& decoder, PixelFormat format, const JpegSource& source) {
  const jpeg_decompress_struct& info = decoder.info();
  const auto whole_blocks = [](JDIMENSION size, int factor) {
    const int block = factor * DCTSIZE;
    return (static_cast<int>(size) + block - 1) / block * block;
  };
  FrameBuffer buffer =
      allocate_frame(format, whole_blocks(info.image_width, info.max_h_samp_factor),
                     whole_blocks(info.image_height, info.max_v_samp_factor));
  if (!decoder.read_planes(buffer)) return source.failure(decoder.cause());
  Frame frame = std::move(buffer.frame);
  frame.width = static_cast<int>(info.image_width);
  frame.height = static_cast<int>(info.image_height);
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame.plane_count); ++i) {
    const jpeg_component_info& component = info.comp_info[i];
    PENUMBRA_ASSERT(static_cast<int>(component.downsampled_width) <= frame.planes[i].width &&
                    static_cast<int>(component.downsampled_height) <= frame.planes[i].height);
    frame.planes[i].width = static_cast<int>(component.downsampled_width);
    frame.planes[i].height = static_cast<int>(component.downsampled_height);
  }
  return frame;
}

Result<std::vector<std::uint8_t>> decode_pixels(JpegDecoder& decoder, J_COLOR_SPACE space,
                                                std::size_t samples, const JpegSource& source) {
  const jpeg_decompress_struct& info = decoder.info();
  std::vector<std::uint8_t> pixels(samples * info.image_width * info.image_height);
  if (!decoder.read_pixels(space, pixels.data())) return source.failure(decoder.cause());
  return pixels;
}

// Converts RGB and other chroma layouts to yuv444p.
Result<Frame> decode_converted(JpegDecoder& decoder, const JpegSource& source) {
  PENUMBRA_TRY(const auto rgb, decode_pixels(decoder, JCS_RGB, 3, source));
  struct DestroyTurbo {
    void operator()(void* handle) const { tjDestroy(handle); }
  };
  const std::unique_ptr<void, DestroyTurbo> encoder(tjInitCompress());
  if (!encoder) return fail("{}: the JPEG encoder does not start", source.name);
  const int width = static_cast<int>(decoder.info().image_width);
  const int height = static_cast<int>(decoder.info().image_height);
  FrameBuffer buffer = allocate_frame(PixelFormat::yuv444p, width, height);
  std::array<int, kMaxComponents> strides{};
  for (std::size_t i = 0; i < strides.size(); ++i) {
    strides[i] = static_cast<int>(buffer.frame.planes[i].stride);
  }
  if (tjEncodeYUVPlanes(encoder.get(), rgb.data(), width, width * 3, height, TJPF_RGB,
                        buffer.plane_data.data(), strides.data(), TJSAMP_444, 0) != 0) {
    return source.failure(tjGetErrorStr2(encoder.get()));
  }
  return std::move(buffer.frame);
}

// Finds the image in `bytes` and calls `decode` with a decoder for it.
template <class Decode>
auto with_decoder(std::span<const std::uint8_t> bytes, const JpegSource& source,
                  const Decode& decode) -> decltype(decode(std::declval<JpegDecoder&>())) {
  const auto outline = outline_jpeg(bytes);
  if (!outline) return source.failure(outline.error().message);
  JpegDecoder decoder(outline->bytes);
  if (!decoder.read_header()) return source.failure(decoder.cause());
  PENUMBRA_TRY_VOID(check_header(decoder.info(), outline->bytes.size(), source));
  return decode(decoder);
}

}  // namespace

bool is_jpeg(std::span<const std::uint8_t> bytes) {
  constexpr std::array<std::uint8_t, 3> kMagic{0xFF, 0xD8, 0xFF};
  return bytes.size() >= kMagic.size() && std::equal(kMagic.begin(), kMagic.end(), bytes.begin());
}

Result<Frame> decode_jpeg(std::span<const std::uint8_t> bytes, const std::string& name,
                          std::string_view remedy) {
  const JpegSource source{name, remedy};
  return with_decoder(bytes, source, [&](JpegDecoder& decoder) -> Result<Frame> {
    const std::optional<PixelFormat> format = stored_format(decoder.info());
    return format ? decode_planes(decoder, *format, source) : decode_converted(decoder, source);
  });
}

Result<RgbaImage> decode_jpeg_rgba(std::span<const std::uint8_t> bytes, const std::string& name) {
  const JpegSource source{name, "record or copy it again"};
  return with_decoder(bytes, source, [&](JpegDecoder& decoder) -> Result<RgbaImage> {
    PENUMBRA_TRY(auto pixels, decode_pixels(decoder, JCS_EXT_RGBA, 4, source));
    return RgbaImage{static_cast<int>(decoder.info().image_width),
                     static_cast<int>(decoder.info().image_height), std::move(pixels)};
  });
}

}  // namespace penumbra
