#include "core/image/sample_depth.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <fstream>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr int kMinBits = 8;
constexpr int kMaxBits = 14;  // no camera uses 15

// Reads only the first bytes of the file.
bool is_sixteen_bit_png(const std::filesystem::path& file) {
  constexpr std::array<char, 4> kPng{'\x89', 'P', 'N', 'G'};
  constexpr std::size_t kBitDepth = 24;  // offset after signature, length, "IHDR", sides
  std::array<char, kBitDepth + 1> start{};
  std::ifstream stream(file, std::ios::binary);
  if (!stream.read(start.data(), start.size())) return false;
  return std::memcmp(start.data(), kPng.data(), kPng.size()) == 0 && start[kBitDepth] == 16;
}

}  // namespace

std::string SampleDepth::text() const {
  return fmt::format("16-bit images hold {0} bits{1} (brightest value {2}): read as {0}-bit", bits,
                     by_chunk ? " by their sBIT chunk" : "", brightest);
}

SampleDepth sample_depth_of(std::span<const std::filesystem::path> images) {
  SampleDepth depth;
  std::optional<int> by_chunk;
  const std::size_t count = images.size();
  const std::size_t sampled = std::min<std::size_t>(count, kMaxSampledImages);
  for (std::size_t i = 0; i < sampled; ++i) {
    // Includes the first and the final image.
    const std::size_t at = sampled > 1 ? i * (count - 1) / (sampled - 1) : 0;
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(images[at], ignored) || !is_sixteen_bit_png(images[at])) {
      continue;
    }
    const auto bytes = read_file(images[at]);
    if (!bytes) continue;
    const auto samples = sixteen_bit_samples(*bytes, images[at].string());
    if (!samples || !*samples) continue;
    depth.brightest = std::max(depth.brightest, (*samples)->brightest);
    if (const auto& bits = (*samples)->significant_bits) {
      by_chunk = std::max(by_chunk.value_or(0), *bits);
    }
    if (depth.brightest >= 1 << kMaxBits) return depth;
  }
  if (depth.brightest == 0) return depth;  // all images are black, or none has 16 bits
  if (by_chunk && *by_chunk >= kMinBits) {
    depth.by_chunk = true;
    if (depth.brightest < 1 << *by_chunk) depth.bits = *by_chunk > kMaxBits ? 16 : *by_chunk;
    return depth;
  }
  const auto needed = static_cast<int>(std::bit_width(static_cast<unsigned>(depth.brightest)));
  depth.bits = std::max(needed, kMinBits);
  return depth;
}

std::optional<std::string> ClampWatch::take_warning(const std::string& name) {
  if (!clamped_ || warned_) return std::nullopt;
  warned_ = true;
  return fmt::format(
      "{}: holds values above the {} bits that 16-bit images are read with; they become white "
      "(reported once)",
      name, sample_bits_);
}

}  // namespace penumbra
