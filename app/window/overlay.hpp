// Draws the HUD (measurements, panels, buttons) over the image with Dear ImGui. It appears only in
// the window, not in written images.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "app/window/hud.hpp"
#include "core/error.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

class Overlay {
 public:
  // `context` must be current on this thread at this and every later call, and outlive the overlay.
  [[nodiscard]] static Result<std::unique_ptr<Overlay>> create(const GlContext& context);
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;
  ~Overlay();

  void handle(const WindowEvent& event);
  // Returns true if the HUD covers this pixel of the window, or if an open list receives all
  // clicks.
  [[nodiscard]] bool covers(double x, double y) const;
  // Returns true if a text field receives the keys, or the control that has the keyboard focus
  // receives this one. `code`: GLFW's.
  [[nodiscard]] bool takes_key(int code) const;

  // All draw functions draw over the bound framebuffer of `size` [px].
  // Adds the clicks since the previous drawing to `actions`.
  void draw(const HudState& state, const HudPanels& panels, GlContext::Size size,
            HudActions& actions);
  // Draws warnings_of(), the message and the button of a locked kiosk.
  void draw_kiosk(const HudState& state, GlContext::Size size, HudActions& actions);
  // Draws warnings_of() and the message while the HUD is hidden. Receives no clicks.
  void draw_hidden(const HudState& state, GlContext::Size size);
  // Draws `words` instead of the HUD, in the middle or in a corner. Receives no clicks.
  void draw_text(const std::string& words, bool in_the_middle, GlContext::Size size);
  // Draws the Dear ImGui windows of `lay_out` instead of the HUD. `em`: font height [px].
  void draw_custom(GlContext::Size size, const std::function<void(float em)>& lay_out);

 private:
  struct Impl;
  explicit Overlay(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Returns true if only the compact layout fits into a window of this size [px].
[[nodiscard]] bool is_small(GlContext::Size window);

}  // namespace penumbra
