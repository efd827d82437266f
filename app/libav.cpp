#include "app/libav.hpp"

#include <dlfcn.h>
#include <spdlog/spdlog.h>

#include <cstdarg>
#include <string_view>

#include "app/logging.hpp"
#include "core/propagate.hpp"

extern "C" {
#include <libavutil/log.h>
}

namespace penumbra {

#define PENUMBRA_DEFINE(library, name) decltype(&::name) name = nullptr;
PENUMBRA_LIBAV_FUNCTIONS(PENUMBRA_DEFINE)
#undef PENUMBRA_DEFINE

namespace {

void log_libav(void* source, int level, const char* format, va_list arguments) {
  if (level > AV_LOG_INFO || !spdlog::should_log(spdlog::level::debug)) return;
  std::array<char, 512> line{};
  int print_prefix = 1;
  av_log_format_line2(source, level, format, arguments, line.data(), static_cast<int>(line.size()),
                      &print_prefix);
  std::string_view text(line.data());
  while (!text.empty() && text.back() == '\n') text.remove_suffix(1);
  log_debug("libav: {}", text);
}

// Stays loaded until the program ends.
Result<void*> load_library(const char* file) {
  void* const library = dlopen(file, RTLD_LAZY | RTLD_LOCAL);
  if (library == nullptr)
    return fail("video: {}; install this library of libav (FFmpeg)", dlerror());
  return library;
}

template <class F>
Result<void> find_function(void* library, const char* name, F& function) {
  void* const found = dlsym(library, name);
  if (found == nullptr) {
    return fail("video: {}; install the release of libav with libavcodec.so.{}", dlerror(),
                AV_STRINGIFY(LIBAVCODEC_VERSION_MAJOR));
  }
  function = reinterpret_cast<F>(found);
  return {};
}

Result<void> load() {
  PENUMBRA_TRY(void* const avutil,
               load_library("libavutil.so." AV_STRINGIFY(LIBAVUTIL_VERSION_MAJOR)));
  PENUMBRA_TRY(void* const avcodec,
               load_library("libavcodec.so." AV_STRINGIFY(LIBAVCODEC_VERSION_MAJOR)));
  PENUMBRA_TRY(void* const avformat,
               load_library("libavformat.so." AV_STRINGIFY(LIBAVFORMAT_VERSION_MAJOR)));
  PENUMBRA_TRY(void* const swscale,
               load_library("libswscale.so." AV_STRINGIFY(LIBSWSCALE_VERSION_MAJOR)));
#define PENUMBRA_FIND(library, name) PENUMBRA_TRY_VOID(find_function(library, #name, name));
  PENUMBRA_LIBAV_FUNCTIONS(PENUMBRA_FIND)
#undef PENUMBRA_FIND
  av_log_set_callback(&log_libav);
  return {};
}

}  // namespace

Result<void> load_libav() {
  static const Result<void> loaded = load();
  return loaded;
}

}  // namespace penumbra
