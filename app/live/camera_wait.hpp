// Waits for a kiosk's camera, in its window.
#pragma once

#include <optional>
#include <string>

#include "app/window/kiosk_lock.hpp"
#include "app/window/overlay.hpp"
#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/context.hpp"
#include "render/gl/framebuffer.hpp"

namespace penumbra {

class CameraWait {
 public:
  // Both must outlive this object. The window's events go to this object until it is destroyed.
  CameraWait(GlContext& window, Overlay& overlay);
  CameraWait(const CameraWait&) = delete;
  CameraWait& operator=(const CameraWait&) = delete;
  ~CameraWait();

  // Calls `open` until it succeeds, every second, and shows its error in the window meanwhile.
  // Fails if the display is lost, or if staff close the window (KioskLock).
  template <class Open>
  auto until_open(const Open& open) -> decltype(open()) {
    while (true) {
      auto opened = open();
      if (opened) return opened;
      if (const auto waited = show(opened.error().message); !waited)
        return tl::unexpected(waited.error());
    }
  }

 private:
  // Shows an error for a second.
  [[nodiscard]] Result<void> show(const std::string& error);

  GlContext& window_;
  Overlay& overlay_;
  KioskLock lock_{0.0};
  Stopwatch clock_;
  std::optional<UploadedImage> black_;  // one pixel, made on demand
  bool quits_ = false;
  std::string logged_;  // the latest error in the log
};

}  // namespace penumbra
