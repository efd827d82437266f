#include "app/logging.hpp"

#include <fmt/format.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <string>

#include "calib/solver/silence.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

spdlog::level::level_enum spdlog_level(LogLevel level) {
  return level == LogLevel::debug  ? spdlog::level::debug
         : level == LogLevel::info ? spdlog::level::info
                                   : spdlog::level::warn;
}

}  // namespace

void set_up_logging() {
  const auto logger = spdlog::stderr_logger_mt("penumbra");
  logger->set_pattern("penumbra: %l: %v");
  spdlog::set_default_logger(logger);
  spdlog::set_level(spdlog::level::warn);
  silence_solver();
  // Safe here: no other thread or display exists yet. The 0 keeps a level that the user has set.
  setenv("EGL_LOG_LEVEL", "fatal", 0);
}

bool set_log_level(std::string_view name) {
  for (const auto level : {spdlog::level::trace, spdlog::level::debug, spdlog::level::info,
                           spdlog::level::warn, spdlog::level::err, spdlog::level::off}) {
    if (spdlog::level::to_string_view(level) == name) {
      spdlog::set_level(level);
      return true;
    }
  }
  return false;
}

bool is_logged(LogLevel level) {
  return spdlog::should_log(spdlog_level(level));
}

void log_text(LogLevel level, fmt::string_view text, fmt::format_args values) {
  if (!is_logged(level)) return;
  const std::string line = as_printable_line(fmt::vformat(text, values));
  // spdlog logs a string_view_t verbatim; it would parse a std::string as a format.
  spdlog::log(spdlog_level(level), spdlog::string_view_t(line));
}

}  // namespace penumbra
