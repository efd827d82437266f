// Diagnostics on standard error, ours and the libraries'.
#pragma once

#include <fmt/core.h>

#include <string_view>

namespace penumbra {

enum class LogLevel { debug, info, warning };

// spdlog to standard error, warnings and above; what libav has to say goes to the debug level: its
// failures reach a person as errors of ours, once, and so do those of EGL's drivers.
void set_up_logging();

// What is told from now on: trace, debug, info, warning, error or off. False for any other name.
[[nodiscard]] bool set_log_level(std::string_view name);

// Not a template, as spdlog's are: these would compile all of fmt's formatting into each file that
// logs.
void log_text(LogLevel level, fmt::string_view text, fmt::format_args values);

// log_warning("{}: {}", camera, detail);
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
