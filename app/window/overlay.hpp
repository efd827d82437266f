// The HUD over the image, with Dear ImGui: measurements, panels, buttons. Draws only into the
// window, never into written images.
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
  // `context` is current on this thread, now and at every later call, and outlives the overlay.
  [[nodiscard]] static Result<std::unique_ptr<Overlay>> create(const GlContext& context);
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;
  ~Overlay();

  void handle(const WindowEvent& event);
  // Returns true if the last drawing covers this pixel of the window, or a list is open, which
  // takes every click.
  [[nodiscard]] bool covers(double x, double y) const;
  // Returns true while keys go to a text field.
  [[nodiscard]] bool typing() const;

  // All draw over the bound framebuffer, which has this size [px].
  // Adds the clicks since the last drawing to `actions`.
  void draw(const HudState& state, const HudPanels& panels, GlContext::Size size,
            HudActions& actions);
  // While the HUD is hidden: warnings_of() and the message. Takes no clicks.
  void draw_hidden(const HudState& state, GlContext::Size size);
  // These words instead of the HUD, in the middle or in a corner. Takes no clicks.
  void draw_text(const std::string& words, bool in_the_middle, GlContext::Size size);
  // The Dear ImGui windows of `lay_out` instead of the HUD; `em`: height of the letters [px].
  void draw_custom(GlContext::Size size, const std::function<void(float em)>& lay_out);

 private:
  struct Impl;
  explicit Overlay(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Returns true if only the compact layout fits into the window [px].
[[nodiscard]] bool is_small(GlContext::Size window);

}  // namespace penumbra
