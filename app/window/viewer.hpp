// The window: shows each picture with the HUD over it, answers keys, mouse and touch.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <string>

#include "app/interrupt.hpp"
#include "app/report/rate_meter.hpp"
#include "app/session/session.hpp"
#include "app/window/hud.hpp"
#include "app/window/manipulation.hpp"
#include "app/window/overlay.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

// What the window shows and acts on: a run, live or replayed. What a run cannot do, does nothing.
class ViewerHost {
 public:
  ViewerHost() = default;
  ViewerHost(const ViewerHost&) = delete;
  ViewerHost& operator=(const ViewerHost&) = delete;
  virtual ~ViewerHost() = default;

  // Draws the last picture into the window.
  virtual void present() = 0;
  // What it shows; without a scene nothing can be taken.
  [[nodiscard]] virtual SessionView view() const { return {}; }
  [[nodiscard]] virtual std::vector<HudNode> nodes() const { return {}; }
  virtual void edit(const SceneEdit& /*edit*/) {}
  [[nodiscard]] virtual Translucency translucency() const { return Translucency::automatic; }
  virtual void set_translucency(Translucency /*way*/) {}
  // Draws the last picture again with what was edited, while it stands still.
  virtual void redraw() {}
  // Whether the run is to end, also out of a pause.
  [[nodiscard]] virtual bool is_over() const { return false; }
  // Says what became of it, for the person.
  [[nodiscard]] virtual std::string save_screenshot() { return {}; }
  [[nodiscard]] virtual std::string toggle_recording() { return {}; }
  [[nodiscard]] virtual std::string toggle_smoothing() { return {}; }
  // Fills in what was measured; `debug`: for the debug view too.
  virtual void describe(HudState& /*state*/, bool /*debug*/) const {}
};

struct ViewerOptions {
  bool hud = true;  // shown at first
};

class Viewer {
 public:
  // `context` has a window; both outlive the viewer. Without an overlay nothing is drawn over the
  // picture, and keys work all the same.
  Viewer(GlContext& context, ViewerHost& host, std::unique_ptr<Overlay> overlay,
         const ViewerOptions& options = {});
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;
  ~Viewer();

  // What show() shows: the next frame's picture, or the one that is on the screen, perhaps drawn
  // again. The frame rate counts the former.
  enum class Picture { next, same };
  // Shows the last picture and answers what was done; while paused until that ends, a step is asked
  // for, the run is over, or the program is interrupted. False once the window was closed.
  [[nodiscard]] bool show(InterruptWatch& interrupt, Picture picture = Picture::next);
  // How long the pauses were, all together [ms]: time that does not count for pacing.
  [[nodiscard]] double paused_ms() const { return paused_ms_; }
  [[nodiscard]] bool paused() const { return paused_; }
  // How often the HUD was laid out and drawn: not at all while it is hidden.
  [[nodiscard]] int hud_drawings() const { return hud_drawings_; }

 private:
  void draw_hud();
  void take(const WindowEvent& event);
  void take_key(const WindowEvent& event);
  void take_pointer(const WindowEvent& event);
  void act(WindowCommand command);
  void act_on_clicks(HudActions actions);
  void edit(const SceneEdit& edit);
  // Of the nodes that the keys are for.
  void set_technique(ShadowTechnique technique);
  void set_translucency(Translucency way);
  [[nodiscard]] std::vector<HudNode> chosen_nodes() const;
  void say(std::string message);
  // Nothing outside of the picture, or without a pose.
  [[nodiscard]] std::optional<PointerView> pointer_view() const;
  [[nodiscard]] bool over_hud() const;
  void follow_pointer();

  GlContext& context_;
  ViewerHost& host_;
  std::unique_ptr<Overlay> overlay_;
  HudPanels panels_;
  std::optional<bool> compact_;  // as a person chose it; else by the window's size
  bool hud_ = true;
  bool paused_ = false, step_ = false, closed_ = false, edited_ = false;
  double paused_ms_ = 0.0;
  int hud_drawings_ = 0;
  Manipulator manipulator_;
  std::optional<std::string> node_;  // that keys change; none: all
  DragMode drag_ = DragMode::slide;
  int drag_button_ = -1;                               // that holds the object
  Eigen::Vector2d pointer_ = Eigen::Vector2d::Zero();  // [px] of the window
  bool pointer_moved_ = false;
  bool cursor_ = false;   // the scene's 3D cursor follows the pointer
  double raise_m_ = 0.0;  // of the cursor, asked for since the last picture
  std::string message_;
  Stopwatch since_message_;
  RateMeter shown_;
  Stopwatch clock_;
};

}  // namespace penumbra
