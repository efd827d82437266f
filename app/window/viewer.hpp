// The window: shows each frame with the HUD over it, handles keys, mouse and touch.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "app/interrupt.hpp"
#include "app/report/rate_meter.hpp"
#include "app/session/session.hpp"
#include "app/window/hud.hpp"
#include "app/window/kiosk_lock.hpp"
#include "app/window/manipulation.hpp"
#include "app/window/overlay.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

// The run behind the window, live or replay. The defaults are for features that a run lacks.
class ViewerHost {
 public:
  ViewerHost() = default;
  ViewerHost(const ViewerHost&) = delete;
  ViewerHost& operator=(const ViewerHost&) = delete;
  virtual ~ViewerHost() = default;

  // Draws the latest frame into the window.
  virtual void present() = 0;
  // If the view has no scene, no object can be dragged.
  [[nodiscard]] virtual SessionView view() const { return {}; }
  [[nodiscard]] virtual std::vector<HudNode> nodes() const { return {}; }
  virtual void edit(const SceneEdit& /*edit*/) {}
  // Called before the edits of a move, which undo() reverts as one.
  virtual void begin_move(const std::string& /*object*/) {}
  [[nodiscard]] virtual Translucency translucency() const { return Translucency::automatic; }
  virtual void set_translucency(Translucency /*mode*/) {}
  // Draws the latest frame again with the edits, while paused.
  virtual void redraw() {}
  // Returns true if the run should end, even during a pause.
  [[nodiscard]] virtual bool is_over() const { return false; }
  // These return a message about the result.
  [[nodiscard]] virtual std::string save_screenshot() { return {}; }
  [[nodiscard]] virtual std::string toggle_recording() { return {}; }
  [[nodiscard]] virtual std::string calibrate() { return "only live calibrates its camera"; }
  [[nodiscard]] virtual std::string toggle_smoothing() { return {}; }
  [[nodiscard]] virtual std::string toggle_walls() { return {}; }
  [[nodiscard]] virtual std::string add_object(const std::filesystem::path& /*file*/) {
    return "objects can't be added to a comparison";
  }
  [[nodiscard]] virtual std::string undo() { return {}; }
  [[nodiscard]] virtual std::string reset() { return {}; }
  // Puts objects, styles and the view back to the start of the run, without undo.
  virtual void start_again() {}
  [[nodiscard]] virtual std::string save_scene() { return {}; }
  // Sets the measurements in the HUD state; with `debug`, also those of the debug view.
  virtual void describe(HudState& /*state*/, bool /*debug*/) const {}
};

struct ViewerOptions {
  bool hud = true;  // initially visible
  bool full_screen = false;
  bool kiosk = false;           // keys and panels are locked, and the window stays (KioskLock)
  double reset_after_s = 60.0;  // of a kiosk
};

class Viewer {
 public:
  // `context` must have a window. `context` and `host` must outlive the viewer. If `overlay` is
  // nullptr, there is no HUD.
  Viewer(GlContext& context, ViewerHost& host, std::unique_ptr<Overlay> overlay,
         const ViewerOptions& options = {});
  Viewer(const Viewer&) = delete;
  Viewer& operator=(const Viewer&) = delete;
  ~Viewer();

  // next: a new frame. same: another drawing of the latest frame, not counted for the frame rate.
  enum class ShownFrame { next, same };
  // Shows the latest frame and handles events. During a pause, waits until the pause or the run
  // ends, a step is requested or a signal arrives. Returns false after the window was closed.
  [[nodiscard]] bool show(InterruptWatch& interrupt, ShownFrame which = ShownFrame::next);
  // Total time of the pauses [ms], which does not count for pacing.
  [[nodiscard]] double paused_ms() const { return paused_ms_; }

 private:
  void draw_hud();
  [[nodiscard]] bool takes_clicks() const { return hud_ || locked(); }
  [[nodiscard]] bool locked() const { return kiosk_ && kiosk_->locked(); }
  void keep_kiosk();  // resets a kiosk that is left alone, and keeps its window open
  void lock_view();   // panels closed, the view and the drags as at the start
  void take(const WindowEvent& event);
  void handle_key(const WindowEvent& event);
  void handle_button(const WindowEvent& event);
  void act(WindowCommand command);
  void act_on_clicks(HudActions actions);
  void edit(const SceneEdit& edit);
  void set_technique(ShadowTechnique technique);  // changes chosen_nodes()
  void set_translucency(Translucency mode);
  [[nodiscard]] std::vector<HudNode> chosen_nodes() const;
  void show_message(std::string message);
  // Returns nullopt without a pose, or if the lens has no ray for the pixel.
  [[nodiscard]] std::optional<PointerView> pointer_view() const;
  [[nodiscard]] bool pointer_is_over_hud() const;
  void follow_pointer();

  GlContext& context_;
  ViewerHost& host_;
  std::unique_ptr<Overlay> overlay_;
  HudPanels panels_;
  std::optional<KioskLock> kiosk_;
  std::optional<bool> compact_;  // the user's choice; nullopt: depends on the window's size
  bool hud_ = true;
  bool paused_ = false, step_ = false, closed_ = false, edited_ = false;
  double paused_ms_ = 0.0;
  Manipulator manipulator_;
  std::optional<std::string> node_;  // node that the keys change; nullopt: all
  DragMode drag_ = DragMode::slide;
  int drag_button_ = -1;                               // button of the current drag
  Eigen::Vector2d pointer_ = Eigen::Vector2d::Zero();  // [px] of the window
  bool pointer_moved_ = false;
  bool cursor_ = false;         // the scene's 3D cursor follows the pointer
  double cursor_rise_m_ = 0.0;  // rise of the cursor since the previous frame
  std::string message_;
  Stopwatch since_message_;
  RateMeter shown_;
  Stopwatch clock_;
};

}  // namespace penumbra
