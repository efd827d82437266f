// Diagnostics of the program and its libraries on standard error.
#pragma once

#include <fmt/core.h>

#include <string_view>

namespace penumbra {

enum class LogLevel { debug, info, warning };

// Sends warnings and above to standard error. libav's messages have the debug level and EGL's are
// off, because their failures are reported as errors of this program.
void set_up_logging();

// Sets the level: trace, debug, info, warning, error or off. Returns false for any other name.
[[nodiscard]] bool set_log_level(std::string_view name);

// Returns true if lines of this level are logged.
[[nodiscard]] bool is_logged(LogLevel level);

// Logs a line. Not a template, because each file that logs would then compile fmt's formatting.
void log_text(LogLevel level, fmt::string_view text, fmt::format_args values);

// Example: log_warning("{}: {}", camera, detail);
template <class... Args>
void log_warning(fmt::format_string<Args...> text, Args&&... args) {
  log_text(LogLevel::warning, text, fmt::make_format_args(args...));
}
template <class... Args>
void log_info(fmt::format_string<Args...> text, Args&&... args) {
  log_text(LogLevel::info, text, fmt::make_format_args(args...));
}
template <class... Args>
void log_debug(fmt::format_string<Args...> text, Args&&... args) {
  log_text(LogLevel::debug, text, fmt::make_format_args(args...));
}

}  // namespace penumbra
