#include "app/logging.hpp"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <array>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <string_view>

extern "C" {
#include <libavutil/log.h>
}

namespace penumbra {
namespace {

void log_libav(void* source, int level, const char* format, va_list arguments) {
  if (level > AV_LOG_INFO || !spdlog::should_log(spdlog::level::debug)) return;
  std::array<char, 512> line{};
  int print_prefix = 1;
  av_log_format_line2(source, level, format, arguments, line.data(), static_cast<int>(line.size()),
                      &print_prefix);
  std::string_view text(line.data());
  while (!text.empty() && text.back() == '\n') text.remove_suffix(1);
  spdlog::debug("libav: {}", text);
}

}  // namespace

void set_up_logging() {
  const auto logger = spdlog::stderr_logger_mt("penumbra");
  logger->set_pattern("penumbra: %l: %v");
  spdlog::set_default_logger(logger);
  spdlog::set_level(spdlog::level::warn);
  av_log_set_callback(&log_libav);
  // Before the first thread and the first display; a person who asks for another level keeps it.
  setenv("EGL_LOG_LEVEL", "fatal", 0);
}

}  // namespace penumbra
