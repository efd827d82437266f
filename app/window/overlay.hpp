// The HUD over the picture, with Dear ImGui: what is measured, panels to change what is drawn,
// buttons. Draws into the window only, never into the picture that is written.
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

  // Pointer and keys, as they happen.
  void handle(const WindowEvent& event);
  // Whether something of the last drawing lies at this pixel of the window, or waits for a click
  // anywhere (an open list).
  [[nodiscard]] bool covers(double x, double y) const;
  // Whether keys are being typed into a field.
  [[nodiscard]] bool typing() const;

  // Over the framebuffer that is bound, which has this size [px]. What was clicked since the last
  // drawing is added to `actions`.
  void draw(const HudState& state, const HudPanels& panels, GlContext::Size size,
            HudActions& actions);
  // Where the HUD is hidden: what a person must know all the same (warnings_of), and what was just
  // done. Mostly nothing. Takes no clicks.
  void draw_hidden(const HudState& state, GlContext::Size size);
  // Only these words, in place of the HUD: in the middle, or in a corner. Takes no clicks.
  void draw_words(const std::string& words, bool in_the_middle, GlContext::Size size);
  // What `lay_out` lays out with Dear ImGui, in place of the HUD; it is given the height of the
  // letters [px].
  void draw_own(GlContext::Size size, const std::function<void(float em)>& lay_out);

 private:
  struct Impl;
  explicit Overlay(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Whether a window is so small that only the compact layout fits [px].
[[nodiscard]] bool is_small(GlContext::Size window);

}  // namespace penumbra
