#include "core/text/text.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <fstream>
#include <system_error>
#include <vector>

#include "core/propagate.hpp"
#include "core/text/text_encoding.hpp"

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

// Waits until a named pipe that was opened with O_NONBLOCK has data or its writer closed it.
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
  (void)fcntl(descriptor, F_SETFL, O_RDONLY);  // from here on, reading blocks
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
  // The file system's size is not used: pipes have none.
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

std::string_view trim(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r\n\v\f";
  const std::size_t first = text.find_first_not_of(kBlank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

std::optional<double> parse_number(std::string_view text) {
  return parse_all<double>(text);
}

std::optional<std::int64_t> parse_integer(std::string_view text) {
  return parse_all<std::int64_t>(text);
}

std::optional<std::int64_t> parse_seconds_as_ns(std::string_view text) {
  constexpr std::int64_t kLargest = 4'000'000'000'000'000'000;  // differences fit into 64 bits
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
  const std::uint64_t size = negative ? 0U - bits : bits;
  return fmt::format("{}{}.{:09}", negative ? "-" : "", size / 1'000'000'000U,
                     size % 1'000'000'000U);
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

}  // namespace penumbra
