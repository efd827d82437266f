// Window of a calibration. Shows the camera's image with the detected target, the image cells that
// no view covers, a bar for each missing quantity, the next step, and finally the grade.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "app/interrupt.hpp"
#include "app/window/overlay.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/report/view_guide.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/context.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/passes/video_texture.hpp"

namespace penumbra {

// Overlay of an image of `width` x `height` px.
struct GuideHud {
  int width = 0;
  int height = 0;
  GuideResult look;
  GuideProgress progress;
  double flash = 0.0;                     // 1 when a view is taken, then decreasing to 0
  std::string words;                      // text in place of the bars: "solving", or the result
  std::optional<CalibrationGrade> grade;  // grade of the calibration
  bool failed = false;                    // `words` is an error message
  std::string after_key = "to end";       // purpose of the key that closes the result
};

class GuideWindow {
 public:
  // Opens a window for images of this size [px].
  [[nodiscard]] static Result<std::unique_ptr<GuideWindow>> open(int width, int height);
  GuideWindow(const GuideWindow&) = delete;
  GuideWindow& operator=(const GuideWindow&) = delete;
  ~GuideWindow();

  [[nodiscard]] Result<void> show(const Frame& frame, GuideResult look, GuideProgress progress);
  // Shows text over the last image.
  void say(std::string words, std::optional<CalibrationGrade> grade = std::nullopt,
           bool failed = false);
  // Draws and handles keys: Esc and Q close the window, S saves it as a PNG in the current folder,
  // F fills the screen.
  void refresh();
  [[nodiscard]] bool closed() const { return closed_; }
  [[nodiscard]] bool display_lost() const { return context_->display_lost(); }
  // Refreshes until a key is pressed, the window is closed or the program interrupted. `purpose`:
  // of the key, "to end" or "to go on".
  void wait(InterruptWatch& interrupt, const std::string& purpose);

 private:
  GuideWindow(std::unique_ptr<GlContext> context, std::unique_ptr<Overlay> overlay,
              Framebuffer framebuffer);
  void take(const WindowEvent& event);
  void save_window_image();

  std::unique_ptr<GlContext> context_;  // declared first: the OpenGL objects below need it
  std::unique_ptr<Overlay> overlay_;
  Framebuffer framebuffer_;
  VideoTexture video_;
  Frame frame_;  // keeps the buffer while the image is shown
  GuideHud hud_;
  Stopwatch since_taken_;
  bool taken_ = false;  // a view has been taken
  bool closed_ = false;
  bool key_pressed_ = false;  // a key was pressed
  bool save_requested_ = false;
};

}  // namespace penumbra
