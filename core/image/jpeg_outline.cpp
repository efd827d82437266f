#include "core/image/jpeg_outline.hpp"

#include <algorithm>
#include <cstring>
#include <optional>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr std::uint8_t kDefineHuffman = 0xC4;
constexpr std::uint8_t kFirstRestart = 0xD0;
constexpr std::uint8_t kLastRestart = 0xD7;
constexpr std::uint8_t kStartOfImage = 0xD8;
constexpr std::uint8_t kEndOfImage = 0xD9;
constexpr std::uint8_t kStartOfScan = 0xDA;
constexpr std::uint8_t kDefineQuantization = 0xDB;
constexpr std::uint8_t kDefineRestart = 0xDD;
constexpr std::uint8_t kFirstApplication = 0xE0;
constexpr std::uint8_t kLastApplication = 0xEF;
constexpr std::uint8_t kComment = 0xFE;

bool is_frame_header(std::uint8_t marker) {
  return marker >= 0xC0 && marker <= 0xCF && marker != kDefineHuffman && marker != 0xC8 &&
         marker != 0xCC;
}

bool has_no_segment(std::uint8_t marker) {
  return marker == 0x01 || (marker >= kFirstRestart && marker <= kLastRestart);
}

bool is_between_scans(std::uint8_t marker) {
  return marker == kDefineHuffman || marker == kDefineQuantization || marker == kDefineRestart ||
         marker == kStartOfScan || marker == kComment ||
         (marker >= kFirstApplication && marker <= kLastApplication);
}

// Reads markers and their segments in order.
class MarkerWalk {
 public:
  explicit MarkerWalk(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}

  Result<JpegOutline> outline() {
    PENUMBRA_TRY_VOID(read_headers());
    const std::size_t end = find_end();
    out_.bytes = bytes_.subspan(start_, end - start_);
    out_.size_offset -= start_;
    return out_;
  }

 private:
  [[nodiscard]] std::size_t length_at(std::size_t at) const {
    return (std::size_t{bytes_[at]} << 8U) | bytes_[at + 1];
  }
  // Returns the offset after the segment whose length is at `at`.
  [[nodiscard]] std::optional<std::size_t> after_segment(std::size_t at) const {
    if (at + 2 > bytes_.size()) return std::nullopt;
    const std::size_t length = length_at(at);
    if (length < 2 || length > bytes_.size() - at) return std::nullopt;
    return at + length;
  }

  // Advances past the next marker and returns it, or nullopt if there is none.
  std::optional<std::uint8_t> next_marker() {
    std::size_t stray = 0;
    while (at_ + 1 < bytes_.size() && stray <= kMaxStrayBytes) {
      if (bytes_[at_] == 0xFF && bytes_[at_ + 1] == 0xFF) {  // fill byte
        ++at_;
      } else if (bytes_[at_] == 0xFF && bytes_[at_ + 1] != 0x00) {
        at_ += 2;
        return bytes_[at_ - 1];
      } else {
        ++at_;
        ++stray;
      }
    }
    return std::nullopt;
  }

  Result<void> read_headers() {
    if (bytes_.size() < 2 || bytes_[0] != 0xFF || bytes_[1] != kStartOfImage) {
      return fail("has no start mark");
    }
    at_ = 2;
    bool has_tables = false;
    while (true) {
      const std::optional<std::uint8_t> marker = next_marker();
      if (!marker) return fail("ends within its headers");
      if (has_no_segment(*marker)) continue;
      if (*marker == kStartOfImage) {
        if (has_tables) return fail("another image begins within its headers");
        start_ = at_ - 2;
        continue;
      }
      if (*marker == kEndOfImage) return fail("ends before its first block");
      const std::size_t segment = at_;
      const auto after = after_segment(segment);
      if (!after) return fail("ends within its headers");
      at_ = *after;
      if (is_frame_header(*marker) && !read_frame_header(segment, *marker)) {
        return fail("ends within its headers");
      }
      if (*marker == kStartOfScan) {
        if (out_.size_offset == 0) return fail("has no frame header");
        is_single_scan_ =
            is_single_scan_ && *after - segment > 2 && bytes_[segment + 2] == component_count_;
        return {};
      }
      has_tables = has_tables || *marker < kFirstApplication;
    }
  }

  bool read_frame_header(std::size_t segment, std::uint8_t marker) {
    constexpr std::size_t kFixed = 8;
    constexpr std::size_t kPerComponent = 3;
    const std::size_t length = length_at(segment);
    if (length < kFixed) return false;
    out_.size_offset = segment + 3;
    out_.height = static_cast<int>(length_at(segment + 3));
    out_.width = static_cast<int>(length_at(segment + 5));
    component_count_ = bytes_[segment + 7];
    if (length < kFixed + kPerComponent * component_count_) return false;
    int max_factor = 1;
    for (std::size_t i = 0; i < component_count_; ++i) {
      max_factor = std::max(max_factor, bytes_[segment + kFixed + kPerComponent * i + 1] & 0x0F);
    }
    // The sampling factors of a single component have no effect.
    out_.block_height = component_count_ == 1 ? 8 : 8 * max_factor;
    is_single_scan_ = marker == 0xC0 || marker == 0xC1;
    return true;
  }

  // Searches from the first block; returns the offset of the image's end.
  std::size_t find_end() {
    const std::size_t size = bytes_.size();
    std::size_t end = size;
    while (at_ + 1 < size) {
      const void* mark = std::memchr(bytes_.data() + at_, 0xFF, size - 1 - at_);
      if (mark == nullptr) break;
      at_ = static_cast<std::size_t>(static_cast<const std::uint8_t*>(mark) - bytes_.data());
      const std::uint8_t marker = bytes_[at_ + 1];
      if (marker == kEndOfImage) {
        out_.has_end_mark = true;
        return at_ + 2;
      }
      if (marker == kStartOfImage) {  // start of the next image
        end = at_;
        break;
      }
      at_ += marker == 0xFF ? 1 : 2;
      if (!is_single_scan_ && is_between_scans(marker)) {
        const auto after = after_segment(at_);
        if (!after) break;
        at_ = *after;
      }
    }
    return without_padding(end);
  }

  // Strips padding (zeros and 0xFF). Keeps the first zero: it may belong to the final block (a flat
  // chroma block has four zero bits) or be stuffed after a 0xFF.
  [[nodiscard]] std::size_t without_padding(std::size_t end) const {
    while (end > offset_after_height() && bytes_[end - 1] == 0xFF) --end;
    std::size_t last = end;
    while (last > offset_after_height() && bytes_[last - 1] == 0x00) --last;
    const std::size_t zeros = bytes_[last - 1] == 0xFF ? 2 : 1;
    return std::min(end, last + zeros);
  }
  [[nodiscard]] std::size_t offset_after_height() const { return out_.size_offset + 2; }

  const std::span<const std::uint8_t> bytes_;
  JpegOutline out_;
  std::size_t start_ = 0;
  std::size_t at_ = 0;
  std::size_t component_count_ = 0;
  bool is_single_scan_ = false;
};

}  // namespace

Result<JpegOutline> outline_jpeg(std::span<const std::uint8_t> bytes) {
  return MarkerWalk(bytes).outline();
}

std::vector<std::uint8_t> normalized_jpeg(const JpegOutline& outline, int height) {
  std::vector<std::uint8_t> bytes(outline.bytes.begin(), outline.bytes.end());
  if (!outline.has_end_mark) bytes.insert(bytes.end(), {0xFF, kEndOfImage});
  const auto rows = [&](int lines) { return (lines - 1) / outline.block_height; };
  if (height > 0 && height < outline.height && rows(height) == rows(outline.height)) {
    bytes[outline.size_offset] = static_cast<std::uint8_t>(height >> 8);
    bytes[outline.size_offset + 1] = static_cast<std::uint8_t>(height & 0xFF);
  }
  return bytes;
}

}  // namespace penumbra
