// JPEG images in the forms that cameras send, encoded with libjpeg, and offsets of their segments.
#pragma once

#include <cstddef>
#include <cstdio>
// libjpeg's header uses FILE and size_t without including them.
#include <jpeglib.h>

#include <algorithm>
#include <cstdlib>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra::test {

struct JpegKind {
  const char* name;
  int components = 3;
  int h = 2;  // sampling factors of the luma
  int v = 2;
  int width = 96;
  int height = 72;
  int restart_rows = 0;  // rows of blocks between restart markers; 0: no markers
  bool progressive = false;
  bool separate_scans = false;  // one scan per component
  bool optimized = false;       // Huffman tables optimized for this image
  bool without_tables = false;  // AVI1: no Huffman tables, so the standard ones apply
  bool with_metadata = false;   // Exif, a comment, fill bytes in front of markers
};

inline const std::vector<JpegKind>& jpeg_kinds() {
  static const std::vector<JpegKind> kinds{
      {.name = "Yuv420"},
      {.name = "Yuv422", .v = 1},
      {.name = "Yuv444", .h = 1, .v = 1},
      {.name = "Grey", .components = 1, .h = 1, .v = 1},
      {.name = "Yuv420WithRestarts", .restart_rows = 1},
      {.name = "Yuv422WithRestarts", .v = 1, .width = 128, .height = 40, .restart_rows = 1},
      {.name = "Progressive", .progressive = true},
      {.name = "WithoutHuffmanTables", .v = 1, .without_tables = true},
      {.name = "WithMetadata", .width = 80, .height = 64, .with_metadata = true},
      {.name = "OddSizeOptimized", .width = 61, .height = 47, .optimized = true},
  };
  return kinds;
}

inline void PrintTo(const JpegKind& kind, std::ostream* out) {
  *out << kind.name;
}

// Returns the offset of the first marker with this code in the headers, or npos.
inline std::size_t marker_at(const std::string& jpeg, unsigned char code) {
  std::size_t at = 2;
  while (at + 4 <= jpeg.size()) {
    if (static_cast<unsigned char>(jpeg[at + 1]) == 0xFF) {
      ++at;
      continue;
    }
    const auto found = static_cast<unsigned char>(jpeg[at + 1]);
    if (found == code) return at;
    if (found == 0xDA) break;
    at += 2 + static_cast<unsigned char>(jpeg[at + 2]) * std::size_t{256} +
          static_cast<unsigned char>(jpeg[at + 3]);
  }
  return std::string::npos;
}

inline std::size_t segment_length(const std::string& jpeg, std::size_t at) {
  return 2 + static_cast<unsigned char>(jpeg[at + 2]) * std::size_t{256} +
         static_cast<unsigned char>(jpeg[at + 3]);
}

// Length of the bytes before the first block.
inline std::size_t headers_length(const std::string& jpeg) {
  const std::size_t scan = marker_at(jpeg, 0xDA);
  return scan + segment_length(jpeg, scan);
}

// Offsets of the restart markers.
inline std::vector<std::size_t> restarts_of(const std::string& jpeg) {
  std::vector<std::size_t> found;
  for (std::size_t at = headers_length(jpeg); at + 1 < jpeg.size(); ++at) {
    const auto code = static_cast<unsigned char>(jpeg[at + 1]);
    if (jpeg[at] == '\xFF' && code >= 0xD0 && code <= 0xD7) found.push_back(at);
  }
  return found;
}

// Offsets at which one scan ends and the next begins. The first scan begins with all headers, each
// further scan with its Huffman tables.
inline std::vector<std::size_t> scans_of(const std::string& jpeg) {
  std::vector<std::size_t> found{0};
  bool in_blocks = true;
  for (std::size_t at = headers_length(jpeg); at + 3 < jpeg.size();) {
    const auto code = static_cast<unsigned char>(jpeg[at + 1]);
    if (jpeg[at] != '\xFF' || (code != 0xC4 && code != 0xDA)) {
      ++at;
      continue;
    }
    if (in_blocks) found.push_back(at);
    in_blocks = code == 0xDA;
    at += segment_length(jpeg, at);
  }
  return found;
}

// Encodes an image with detail in every block; each `seed` gives another image.
inline std::string encode_jpeg_kind(const JpegKind& kind, unsigned seed = 0) {
  jpeg_compress_struct info{};
  jpeg_error_mgr errors{};
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* data = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &data, &size);
  info.image_width = static_cast<JDIMENSION>(kind.width);
  info.image_height = static_cast<JDIMENSION>(kind.height);
  info.input_components = kind.components;
  info.in_color_space = kind.components == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, 85, TRUE);
  info.comp_info[0].h_samp_factor = kind.h;
  info.comp_info[0].v_samp_factor = kind.v;
  info.restart_in_rows = kind.restart_rows;
  info.optimize_coding = kind.optimized ? TRUE : FALSE;
  if (kind.progressive) jpeg_simple_progression(&info);
  static constexpr jpeg_scan_info kSeparate[] = {{1, {0, 0, 0, 0}, 0, 63, 0, 0},
                                                 {1, {1, 0, 0, 0}, 0, 63, 0, 0},
                                                 {1, {2, 0, 0, 0}, 0, 63, 0, 0}};
  if (kind.separate_scans) {
    info.scan_info = kSeparate;
    info.num_scans = 3;
  }
  jpeg_start_compress(&info, TRUE);
  std::vector<unsigned char> row(static_cast<std::size_t>(kind.width * kind.components));
  while (info.next_scanline < info.image_height) {
    for (std::size_t i = 0; i < row.size(); ++i) {
      const auto x = static_cast<unsigned>(i);
      const unsigned y = info.next_scanline;
      row[i] = static_cast<unsigned char>((x * x / 5 + y * (7 + seed) + (x ^ y) * 3) & 0xFFU);
    }
    JSAMPROW pixels = row.data();
    jpeg_write_scanlines(&info, &pixels, 1);
  }
  jpeg_finish_compress(&info);
  jpeg_destroy_compress(&info);
  std::string bytes(reinterpret_cast<const char*>(data), size);
  std::free(data);

  if (kind.without_tables) {
    for (std::size_t at; (at = marker_at(bytes, 0xC4)) != std::string::npos;) {
      bytes.erase(at, segment_length(bytes, at));
    }
    const std::size_t jfif = marker_at(bytes, 0xE0);
    bytes.replace(jfif, segment_length(bytes, jfif),
                  std::string("\xFF\xE0\x00\x10"
                              "AVI1\0\0\0\0\0\0\0\0\0\0",
                              18));
  }
  if (kind.with_metadata) {
    std::string metadata(
        "\xFF\xE1\x00\x2A"
        "Exif\0\0",
        10);
    metadata += std::string(0x22, '\x11') + "\xFF\xFF\xFF\xFE";
    metadata += std::string("\x00\x0A", 2) + "a camera";
    bytes.insert(2, metadata);
    bytes.insert(marker_at(bytes, 0xDB), 5, '\xFF');
  }
  return bytes;
}

}  // namespace penumbra::test
