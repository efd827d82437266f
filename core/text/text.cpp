#include "core/text/text.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <memory>
#include <new>
#include <numeric>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

void (*wait_notice)(const std::string& line) = nullptr;

struct Descriptor {
  int number = -1;
  explicit Descriptor(int opened) : number(opened) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (number >= 0) ::close(number);
  }
};

// Waits until a named pipe, opened with O_NONBLOCK, has data or is closed by its writer.
void wait_for_writer(int descriptor, const std::filesystem::path& file) {
  constexpr int kPatience_ms = 1000;
  pollfd waiting{descriptor, POLLIN, 0};
  bool reported = false;
  while (true) {
    const int ready = poll(&waiting, 1, reported ? -1 : kPatience_ms);
    if (ready > 0 || (ready < 0 && errno != EINTR)) break;
    if (ready < 0) continue;
    reported = true;
    if (wait_notice != nullptr) {
      wait_notice(
          fmt::format("{}: is a named pipe without data; waiting for its writer", file.string()));
    }
  }
  (void)fcntl(descriptor, F_SETFL, O_RDONLY);  // makes read() blocking
}

template <class Number>
std::optional<Number> parse_all(std::string_view text) {
  if (text.starts_with('+') && !text.starts_with("+-")) text.remove_prefix(1);
  Number value{};
  const char* end = text.data() + text.size();
  const auto [stopped, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stopped != end) return std::nullopt;
  return value;
}

using namespace std::string_view_literals;

// Returns "UTF-32" or "UTF-16", or "" for another encoding.
std::string_view wide_encoding(std::string_view text) {
  // UTF-32 first, because its little-endian mark starts with that of UTF-16.
  if (text.starts_with("\xFF\xFE\0\0"sv) || text.starts_with("\0\0\xFE\xFF"sv)) return "UTF-32";
  if (text.starts_with("\xFF\xFE"sv) || text.starts_with("\xFE\xFF"sv)) return "UTF-16";
  if (text.size() >= 4 && text[0] != '\0' && text[1] == '\0' && text[2] != '\0' && text[3] == '\0')
    return "UTF-16";
  if (text.size() >= 4 && text[0] == '\0' && text[1] != '\0' && text[2] == '\0' && text[3] != '\0')
    return "UTF-16";
  return {};
}

// Returns the length of the valid UTF-8 sequence at the start of `text`, or 0.
std::size_t utf8_sequence_length(std::string_view text) {
  const auto byte_at = [&](std::size_t i) { return static_cast<std::uint8_t>(text[i]); };
  const std::uint8_t lead = byte_at(0);
  if (lead < 0x80U) return 1;
  const std::size_t length = lead >= 0xF0U ? 4 : lead >= 0xE0U ? 3 : 2;
  if (lead < 0xC2U || lead > 0xF4U || text.size() < length) return 0;
  std::uint32_t code = lead & (0xFFU >> (length + 1));
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte_at(i) & 0xC0U) != 0x80U) return 0;
    code = (code << 6U) | (byte_at(i) & 0x3FU);
  }
  // Overlong forms, surrogates and code points above U+10FFFF are invalid.
  constexpr std::array<std::uint32_t, 5> kMinCodePoint = {0, 0, 0x80, 0x800, 0x10000};
  const bool surrogate = code >= 0xD800U && code <= 0xDFFFU;
  return code < kMinCodePoint[length] || code > 0x10FFFFU || surrogate ? 0 : length;
}

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

}  // namespace

void set_wait_notice(void (*notice)(const std::string& line)) {
  wait_notice = notice;
}

Result<std::string> read_text_file(const std::filesystem::path& file, std::size_t max_bytes) {
  std::error_code code;
  const std::filesystem::file_status status = std::filesystem::status(file, code);
  if (!std::filesystem::exists(status))
    return fail("{}: there is no such file; check the path", file.string());
  if (std::filesystem::is_directory(status))
    return fail("{}: is a folder; a file is needed here", file.string());
  const bool is_pipe = std::filesystem::is_fifo(status);
  const Descriptor opened(::open(file.c_str(), O_RDONLY | O_CLOEXEC | (is_pipe ? O_NONBLOCK : 0)));
  if (opened.number < 0) return fail("{}: cannot be opened; check its permissions", file.string());
  if (is_pipe) wait_for_writer(opened.number, file);
  // Does not use the file's size, because pipes have none.
  std::string text;
  std::string block(1 << 16, '\0');
  while (true) {
    const ssize_t count = ::read(opened.number, block.data(), block.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return fail("{}: reading it failed; check the disk", file.string());
    if (count == 0) break;
    text.append(block, 0, static_cast<std::size_t>(count));
    if (text.size() > max_bytes) {
      return fail("{}: is larger than {} bytes, more than such a file ever needs; check the path",
                  file.string(), max_bytes);
    }
  }
  PENUMBRA_TRY(const std::string_view content, without_byte_order_mark(text, file.string()));
  text.erase(0, text.size() - content.size());
  return text;
}

Result<void> write_text_file(const std::filesystem::path& file, std::string_view text) {
  std::ofstream stream(file, std::ios::binary | std::ios::trunc);
  if (!stream) {
    return fail("{}: cannot be written; check that its folder exists and is writable",
                file.string());
  }
  stream.write(text.data(), static_cast<std::streamsize>(text.size()));
  stream.flush();
  if (!stream) return fail("{}: writing it failed; check the space on the disk", file.string());
  return {};
}

std::string system_message(int error) {
  return std::generic_category().message(error);
}

std::string_view trim(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r\n\v\f";
  const std::size_t first = text.find_first_not_of(kBlank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  while (true) {
    const std::size_t end = text.find(separator);
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return parts;
    text.remove_prefix(end + 1);
  }
}

std::string in_lower_case(std::string text) {
  std::ranges::transform(text, text.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

std::string lower_extension(const std::filesystem::path& file) {
  return in_lower_case(file.extension().string());
}

std::optional<double> parse_number(std::string_view text) {
  return parse_all<double>(text);
}

std::optional<std::int64_t> parse_integer(std::string_view text) {
  return parse_all<std::int64_t>(text);
}

std::optional<std::int64_t> parse_seconds_as_ns(std::string_view text) {
  constexpr std::int64_t kLargest = 4'000'000'000'000'000'000;  // a difference fits into 64 bits
  bool negative = false;
  if (text.starts_with('-') || text.starts_with('+')) {
    negative = text.front() == '-';
    text.remove_prefix(1);
  }
  // The number is `digits` (without leading zeros) times 10^exponent.
  std::string digits;
  std::int64_t exponent = 0;
  bool any_digit = false;
  bool after_point = false;
  std::size_t i = 0;
  for (; i < text.size(); ++i) {
    const char c = text[i];
    if (c >= '0' && c <= '9') {
      any_digit = true;
      if (c != '0' || !digits.empty()) digits.push_back(c);
      if (after_point) --exponent;
    } else if (c == '.' && !after_point) {
      after_point = true;
    } else {
      break;
    }
  }
  if (!any_digit) return std::nullopt;
  if (i < text.size()) {
    if (text[i] != 'e' && text[i] != 'E') return std::nullopt;
    const std::optional<std::int64_t> written = parse_integer(text.substr(i + 1));
    if (!written || *written < -1000 || *written > 1000) return std::nullopt;
    exponent += *written;
  }
  exponent += 9;  // seconds to nanoseconds
  bool round_up = false;
  if (exponent < 0) {
    const auto dropped = static_cast<std::size_t>(-exponent);
    if (dropped > digits.size()) return 0;
    round_up = digits[digits.size() - dropped] >= '5';
    digits.erase(digits.size() - dropped);
    exponent = 0;
  }
  if (!digits.empty()) {
    if (digits.size() + static_cast<std::size_t>(exponent) > 19) return std::nullopt;
    for (; exponent > 0; --exponent) digits.push_back('0');
  }
  std::uint64_t value = 0;
  for (const char c : digits) value = 10 * value + static_cast<std::uint64_t>(c - '0');
  value += round_up ? 1 : 0;
  if (value > static_cast<std::uint64_t>(kLargest)) return std::nullopt;
  const auto result = static_cast<std::int64_t>(value);
  return negative ? -result : result;
}

std::string format_ns_as_seconds(std::int64_t nanoseconds) {
  const bool negative = nanoseconds < 0;
  const auto bits = static_cast<std::uint64_t>(nanoseconds);
  const std::uint64_t magnitude = negative ? 0U - bits : bits;
  return fmt::format("{}{}.{:09}", negative ? "-" : "", magnitude / 1'000'000'000U,
                     magnitude % 1'000'000'000U);
}

std::string format_utc(std::int64_t nanoseconds) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  // Rounds down, also before 1970.
  const std::int64_t fraction = (nanoseconds % kSecond + kSecond) % kSecond;
  const std::chrono::sys_seconds whole{
      std::chrono::seconds(nanoseconds / kSecond - (nanoseconds % kSecond < 0 ? 1 : 0))};
  const auto day = std::chrono::floor<std::chrono::days>(whole);
  const std::chrono::year_month_day date(day);
  const std::chrono::hh_mm_ss time(whole - day);
  return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:09}Z", static_cast<int>(date.year()),
                     static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()),
                     time.hours().count(), time.minutes().count(), time.seconds().count(),
                     fraction);
}

std::string joined(std::span<const double> values, std::string_view format) {
  std::string text;
  for (const double value : values) {
    if (!text.empty()) text += ", ";
    text += fmt::vformat(format, fmt::make_format_args(value));
  }
  return text;
}

std::string joined(std::span<const int> values) {
  const std::vector<double> numbers(values.begin(), values.end());
  return joined(numbers, "{:.0f}");
}

std::string_view first_characters(std::string_view text, std::size_t max_bytes) {
  if (text.size() <= max_bytes) return text;
  std::size_t end = max_bytes;
  const auto continues = [](char byte) {
    return (static_cast<unsigned char>(byte) & 0xC0U) == 0x80U;
  };
  while (end > 0 && continues(text[end])) --end;
  return text.substr(0, end);
}

std::string shortened(std::string_view text, std::size_t max_bytes) {
  constexpr std::string_view kMark = "...";
  if (text.size() <= max_bytes) return std::string(text);
  return fmt::format("{}{}", first_characters(text, max_bytes - kMark.size()), kMark);
}

std::string in_markup(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else if (c == '&') {
      out += "&amp;";
    } else if (c == '"') {
      out += "&quot;";
    } else {
      out += c;
    }
  }
  return out;
}

std::string in_quotes(std::string_view text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') result += '\\';
    result += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return result + "\"";
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i + 1);
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i] == b[j] ? 0 : 1);
      diagonal = row[j + 1];
      row[j + 1] = std::min({replaced, diagonal + 1, row[j] + 1});
    }
  }
  return row.back();
}

Result<std::string_view> without_byte_order_mark(std::string_view text, std::string_view name) {
  if (const std::string_view encoding = wide_encoding(text); !encoding.empty()) {
    return fail("{}: is {} text; save it as UTF-8", name, encoding);
  }
  if (text.starts_with("\xEF\xBB\xBF"sv)) text.remove_prefix(3);
  return text;
}

std::string as_utf8(std::string_view text) {
  std::string converted;
  while (!text.empty()) {
    const std::size_t length = utf8_sequence_length(text);
    if (length > 0) {
      converted += text.substr(0, length);
      text.remove_prefix(length);
      continue;
    }
    const auto byte = static_cast<std::uint8_t>(text.front());
    converted += static_cast<char>(0xC0U | (byte >> 6U));
    converted += static_cast<char>(0x80U | (byte & 0x3FU));
    text.remove_prefix(1);
  }
  return converted;
}

std::string as_printable_line(std::string_view text) {
  std::string line = as_utf8(text);
  for (std::size_t i = 0; i < line.size(); ++i) {
    const auto byte = static_cast<std::uint8_t>(line[i]);
    if (byte < 0x20U || byte == 0x7FU) line[i] = ' ';
    // U+0080 to U+009F are control characters.
    if (byte == 0xC2U && i + 1 < line.size() && static_cast<std::uint8_t>(line[i + 1]) < 0xA0U) {
      line[i] = ' ';
      line.erase(i + 1, 1);
    }
  }
  return line;
}

Result<std::vector<std::uint8_t>> read_file(const std::filesystem::path& path,
                                            std::size_t max_bytes) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (status.type() == std::filesystem::file_type::not_found)
    return fail("{}: no such file", path.string());
  if (!std::filesystem::exists(status))
    return fail("{}: cannot be read: {}", path.string(), error.message());
  if (!std::filesystem::is_regular_file(status))
    return fail("{}: is not a file; give a regular file", path.string());
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  if (error) return fail("{}: cannot be read: {}", path.string(), error.message());
  if (size > max_bytes)
    return fail("{}: has {} bytes; at most {} are read", path.string(), size, max_bytes);
  const File file(std::fopen(path.c_str(), "rb"));
  if (!file) return fail("{}: cannot be opened: {}", path.string(), system_message(errno));
  try {
    std::vector<std::uint8_t> bytes(static_cast<std::size_t>(size));
    if (size > 0 && std::fread(bytes.data(), 1, bytes.size(), file.get()) != bytes.size())
      return fail("{}: cannot be read to its end", path.string());
    return bytes;
  } catch (const std::bad_alloc&) {
    return fail("{}: not enough memory for its {} bytes", path.string(), size);
  }
}

Result<void> write_file(const std::filesystem::path& path, std::span<const std::uint8_t> bytes) {
  File file(std::fopen(path.c_str(), "wb"));
  if (!file) return fail("{}: cannot be written: {}", path.string(), system_message(errno));
  if ((!bytes.empty() && std::fwrite(bytes.data(), 1, bytes.size(), file.get()) != bytes.size()) ||
      std::fclose(file.release()) != 0) {
    return fail("{}: cannot be written: {}", path.string(), system_message(errno));
  }
  return {};
}

}  // namespace penumbra
