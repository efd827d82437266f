#include "app/live/camera_wait.hpp"

#include <fmt/format.h>

#include <array>
#include <chrono>
#include <cstdint>
#include <thread>

#include "app/logging.hpp"
#include "app/window/hud.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr double kRetry_ms = 1000.0;
constexpr std::chrono::milliseconds kRefresh(30);

}  // namespace

CameraWait::CameraWait(GlContext& window, Overlay& overlay) : window_(window), overlay_(overlay) {
  window_.on_event([this](const WindowEvent& event) {
    if (!lock_.admits(event, clock_.elapsed().wall_ms)) return;
    if (!lock_.locked() && command_of_key(event) == WindowCommand::quit) quits_ = true;
  });
}

CameraWait::~CameraWait() {
  window_.on_event({});
}

Result<void> CameraWait::show(const std::string& error) {
  if (error != logged_) log_warning("waiting for the camera: {}", error);
  logged_ = error;
  if (!black_) {
    PENUMBRA_TRY(black_, UploadedImage::create(1, 1));
  }
  const Stopwatch shown;
  while (shown.elapsed().wall_ms < kRetry_ms) {
    const GlContext::Size size = window_.window_size();
    constexpr std::array<std::uint8_t, 4> kBlack = {0, 0, 0, 255};
    black_->present(kBlack, size);
    overlay_.draw_text(
        "waiting for the camera\n" + error + (lock_.locked() ? "" : "\nunlocked: Q or Esc quits"),
        true, size);
    window_.swap();
    const bool open = window_.poll_events();
    if (window_.display_lost()) return fail("the connection to the display was lost");
    if (!open && lock_.locked()) window_.keep_open();
    if (quits_ || (!open && !lock_.locked())) {
      return fail("the session was ended while it waited for the camera ({})", error);
    }
    window_.show_pointer(lock_.shows_pointer(clock_.elapsed().wall_ms));
    std::this_thread::sleep_for(kRefresh);
  }
  return {};
}

}  // namespace penumbra
