// Small recordings for tests: JPEG frames of 64x48 px in a temporary folder.
#pragma once

#include <turbojpeg.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace penumbra::test {

// Creates a new file, because some file systems flush a truncated file to the disk.
inline void write_text(const std::filesystem::path& file, const std::string& text) {
  std::error_code ignored;
  std::filesystem::remove(file, ignored);
  std::ofstream(file, std::ios::binary) << text;
}

// Writes a recording that links to the files of `source` and lists the frames whose row (from 0)
// `accepts` returns true for.
template <class Accepts>
void write_recording_subset(const std::filesystem::path& folder,
                            const std::filesystem::path& source, const Accepts& accepts) {
  std::filesystem::create_directories(folder);
  for (const auto& entry : std::filesystem::directory_iterator(source)) {
    const auto name = entry.path().filename();
    if (name != "timestamps.csv") std::filesystem::create_symlink(entry.path(), folder / name);
  }
  std::ifstream from(source / "timestamps.csv");
  std::ofstream to(folder / "timestamps.csv");
  std::string line;
  for (int row = -1; std::getline(from, line); ++row) {
    if (row < 0 || accepts(row)) to << line << "\n";
  }
}
inline void write_thinned_recording(const std::filesystem::path& folder,
                                    const std::filesystem::path& source, int step) {
  write_recording_subset(folder, source, [step](int row) { return row % step == 0; });
}

inline std::string read_bytes(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

// Returns a JPEG image with colour gradients that depend on `number`.
inline std::string jpeg_of(int number, int width = 64, int height = 48) {
  std::vector<std::uint8_t> rgb;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      rgb.push_back(static_cast<std::uint8_t>(10 * number + x));
      rgb.push_back(static_cast<std::uint8_t>(10 * number + y));
      rgb.push_back(static_cast<std::uint8_t>(100 + number));
    }
  }
  tjhandle encoder = tjInitCompress();
  unsigned char* data = nullptr;
  unsigned long size = 0;
  tjCompress2(encoder, rgb.data(), width, 0, height, TJPF_RGB, &data, &size, TJSAMP_420, 90, 0);
  std::string bytes(reinterpret_cast<const char*>(data), size);
  tjFree(data);
  tjDestroy(encoder);
  return bytes;
}

inline const char* small_camera_yaml() {
  return "image_width: 64\n"
         "image_height: 48\n"
         "camera_name: small\n"
         "camera_matrix:\n  rows: 3\n  cols: 3\n"
         "  data: [53.0, 0.0, 31.5, 0.0, 53.0, 23.5, 0.0, 0.0, 1.0]\n"
         "distortion_model: plumb_bob\n"
         "distortion_coefficients:\n  rows: 1\n  cols: 5\n"
         "  data: [-0.2, 0.06, 0.0008, -0.0006, -0.004]\n";
}

inline const char* small_tags_yaml() {
  return "tags:\n"
         "  - {id: 0, family: tag36h11, size_m: 0.04, position: [-0.05, 0, 0], quaternion_xyzw: "
         "[0, 0, 0, 1]}\n"
         "  - {id: 1, family: tag36h11, size_m: 0.04, position: [0.05, 0, 0], quaternion_xyzw: "
         "[0, 0, 0, 1]}\n";
}

// Returns the number with 6 digits: "000012".
inline std::string six_digits(int number) {
  std::string digits = std::to_string(number);
  return std::string(6 - digits.size(), '0') + digits;
}

// Returns a timestamps.csv.
inline std::string listing(int frames, const std::string& extension = ".jpg") {
  std::string text = "frame,timestamp_s,file\n";
  for (int i = 0; i < frames; ++i) {
    text += std::to_string(i) + ",1311868164." + six_digits(363181 + 33333 * i) + ",";
    if (!extension.empty()) text += "frames/" + six_digits(i) + extension;
    text += "\n";
  }
  return text;
}

// Returns a groundtruth.tum with one pose for all frames.
inline std::string truth(int frames) {
  std::string text = "# timestamp tx ty tz qx qy qz qw\n";
  for (int i = 0; i < frames; ++i) {
    text += "1311868164." + six_digits(363181 + 33333 * i) + " 0.1 -0.3 0.4 0.92 0 0 0.39191835\n";
  }
  return text;
}

// Writes camera.yaml, tags.yaml, groundtruth.tum and timestamps.csv, and frames/ unless `extension`
// is empty (for a video).
inline void write_recording(const std::filesystem::path& folder, int frames,
                            const std::string& extension = ".jpg") {
  std::filesystem::create_directories(folder);
  write_text(folder / "camera.yaml", small_camera_yaml());
  write_text(folder / "tags.yaml", small_tags_yaml());
  write_text(folder / "groundtruth.tum", truth(frames));
  write_text(folder / "timestamps.csv", listing(frames, extension));
  if (extension.empty()) return;
  std::filesystem::create_directories(folder / "frames");
  for (int i = 0; i < frames; ++i) {
    write_text(folder / "frames" / (six_digits(i) + extension), jpeg_of(i));
  }
}

}  // namespace penumbra::test
