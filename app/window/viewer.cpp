#include "app/window/viewer.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <thread>
#include <utility>

#include "app/logging.hpp"
#include "app/window/pointer.hpp"

namespace penumbra {
namespace {

// Interval between drawings while paused: the window may be resized or uncovered.
constexpr std::chrono::milliseconds kPausedRefresh(30);
constexpr double kMessage_ms = 4000.0;
constexpr double kCorner_px = 48.0;  // a touch here shows a hidden HUD

}  // namespace

Viewer::Viewer(GlContext& context, ViewerHost& host, std::unique_ptr<Overlay> overlay,
               const ViewerOptions& options)
    : context_(context), host_(host), overlay_(std::move(overlay)), hud_(options.hud) {
  if (options.kiosk) {
    kiosk_.emplace(options.reset_after_s);
    hud_ = false;
  }
  context_.on_event([this](const WindowEvent& event) { take(event); });
}

Viewer::~Viewer() {
  context_.on_event({});
}

bool Viewer::show(InterruptWatch& interrupt, ShownFrame which) {
  const Stopwatch pause;
  bool waited = false;
  step_ = false;
  if (which == ShownFrame::next) shown_.add(clock_.elapsed().wall_ms);
  do {
    host_.present();
    draw_hud();
    context_.swap();
    if (!context_.poll_events()) closed_ = true;
    keep_kiosk();
    follow_pointer();
    if (paused_ && !closed_ && !step_) {
      if (std::exchange(edited_, false)) host_.redraw();
      waited = true;
      std::this_thread::sleep_for(kPausedRefresh);
    }
  } while (paused_ && !closed_ && !step_ && !host_.is_over() && !interrupt.interrupted());
  edited_ = false;
  if (waited) {
    paused_ms_ += pause.elapsed().wall_ms;
    shown_.restart();
  }
  return !closed_;
}

void Viewer::keep_kiosk() {
  if (!kiosk_) return;
  const double now_ms = clock_.elapsed().wall_ms;
  if (closed_ && locked() && !context_.display_lost()) {
    context_.keep_open();
    closed_ = false;
  }
  context_.show_pointer(kiosk_->shows_pointer(now_ms));
  if (kiosk_->take_reset(now_ms)) {
    lock_view();
    host_.start_again();
    edited_ = true;
  }
}

void Viewer::lock_view() {
  manipulator_.release_object();
  drag_button_ = -1;
  drag_ = DragMode::slide;
  panels_ = {};
  compact_.reset();
  node_.reset();
  hud_ = paused_ = cursor_ = false;
  context_.fill_screen();
}

void Viewer::draw_hud() {
  if (!overlay_) return;
  HudState state;
  host_.describe(state, hud_ && panels_.debug);
  if (!message_.empty() && since_message_.elapsed().wall_ms < kMessage_ms) {
    state.message = message_;
  }
  const GlContext::Size size = context_.window_size();
  HudActions actions;
  state.locked = locked();
  state.drag = drag_;
  if (state.locked) {
    overlay_->draw_kiosk(state, size, actions);
    return act_on_clicks(std::move(actions));
  }
  if (!hud_) return overlay_->draw_hidden(state, size);
  state.nodes = host_.nodes();
  state.translucency = host_.translucency();
  state.frames_per_s = shown_.per_s(clock_.elapsed().wall_ms);
  state.paused = paused_;
  state.selected = manipulator_.selected();
  panels_.compact = compact_.value_or(is_small(size));
  overlay_->draw(state, panels_, size, actions);
  act_on_clicks(std::move(actions));
}

void Viewer::act_on_clicks(HudActions actions) {
  for (const WindowCommand command : actions.commands) act(command);
  for (const SceneEdit& change : actions.edits) edit(change);
  if (actions.translucency) set_translucency(*actions.translucency);
}

void Viewer::take(const WindowEvent& event) {
  if (kiosk_) {
    const bool was_locked = locked();
    const bool admitted = kiosk_->admits(event, clock_.elapsed().wall_ms);
    if (locked() != was_locked) {
      show_message(locked() ? "locked" : fmt::format("unlocked; {} locks again", kUnlockKeys));
      if (locked()) lock_view();
      hud_ = !locked();
    }
    if (!admitted) return;
  }
  if (overlay_ && takes_clicks()) overlay_->handle(event);
  using Kind = WindowEvent::Kind;
  switch (event.kind) {
    case Kind::key_down:
      handle_key(event);
      break;
    case Kind::pointer_moved:
      pointer_ = {event.x, event.y};
      pointer_moved_ = true;
      break;
    case Kind::button_down:
    case Kind::button_up:
      handle_button(event);
      break;
    case Kind::scrolled:
      if (cursor_ && !pointer_is_over_hud()) {
        constexpr double kStep_m = 0.005;
        cursor_rise_m_ += kStep_m * event.y;
        pointer_moved_ = true;
      }
      break;
    case Kind::file_dropped:
      show_message(host_.add_object(event.file));
      edited_ = true;  // draws a paused frame again
      break;
    case Kind::key_up:
    case Kind::text:
      break;
  }
}

bool Viewer::pointer_is_over_hud() const {
  return overlay_ && takes_clicks() && overlay_->covers(pointer_.x(), pointer_.y());
}

void Viewer::handle_key(const WindowEvent& event) {
  if (overlay_ && hud_ && overlay_->takes_key(event.code)) return;
  if (hud_ && is_close_key(event) && (panels_.help || panels_.panels || panels_.menu)) {
    panels_.help = panels_.panels = panels_.menu = false;
    return;
  }
  if (const auto technique = technique_of_key(event)) return set_technique(*technique);
  if (is_number_key(event)) show_message("no shadow technique has this key; F1 lists them");
  if (const auto command = command_of_key(event)) act(*command);
}

void Viewer::handle_button(const WindowEvent& event) {
  pointer_ = {event.x, event.y};
  if (event.kind == WindowEvent::Kind::button_up) {
    if (event.code != drag_button_) return;
    pointer_moved_ = true;
    follow_pointer();
    manipulator_.release_object();
    drag_button_ = -1;
    return;
  }
  if (!hud_ && !locked() && event.code == WindowEvent::kLeft && event.x < kCorner_px &&
      event.y < kCorner_px) {
    hud_ = true;
    return;
  }
  if (manipulator_.holding() || pointer_is_over_hud()) return;
  DragMode mode = drag_;
  if (event.code == WindowEvent::kMiddle || event.shift) mode = DragMode::lift;
  if (event.code == WindowEvent::kRight) mode = DragMode::reach;
  if (event.control) mode = DragMode::turn;
  const SessionView view = host_.view();
  const auto pointer = pointer_view();
  if (!pointer || view.state == nullptr) return;
  if (const auto held = manipulator_.take(*view.scene, *view.state, *pointer, mode)) {
    drag_button_ = event.code;
    host_.begin_move(held->object);
    edit(*held);
  }
}

std::optional<PointerView> Viewer::pointer_view() const {
  return pointer_in_window(host_.view(), context_.window_size(), pointer_);
}

// Handles all moves since the previous frame at once.
void Viewer::follow_pointer() {
  if (!std::exchange(pointer_moved_, false)) return;
  const double raised = std::exchange(cursor_rise_m_, 0.0);
  const bool holding = manipulator_.holding();
  if (!holding && (!cursor_ || pointer_is_over_hud())) return;
  const auto pointer = pointer_view();
  if (!pointer) return;
  if (holding) {
    if (const auto placed = manipulator_.drag(*pointer)) edit(*placed);
    return;
  }
  const SessionView view = host_.view();
  if (view.state == nullptr) return;
  if (const auto placed = cursor_at(*view.scene, *view.state, *pointer, raised)) edit(*placed);
}

void Viewer::edit(const SceneEdit& edit) {
  host_.edit(edit);
  edited_ = true;
}

void Viewer::set_technique(ShadowTechnique technique) {
  std::vector<HudNode> nodes = chosen_nodes();
  if (nodes.empty()) return show_message("the scene has no shadow node to change");
  for (HudNode& node : nodes) {
    node.style.technique = technique;
    edit(ShadowStyled{node.name, node.style});
  }
  show_message((node_ ? *node_ : std::string("shadows")) + ": " +
               std::string(to_string(technique)));
}

void Viewer::set_translucency(Translucency mode) {
  host_.set_translucency(mode);
  edited_ = true;
  show_message("translucency: " + std::string(to_string(host_.translucency())));
}

std::vector<HudNode> Viewer::chosen_nodes() const {
  std::vector<HudNode> nodes = host_.nodes();
  if (node_) std::erase_if(nodes, [this](const HudNode& node) { return node.name != *node_; });
  return nodes;
}

void Viewer::show_message(std::string message) {
  if (message.empty()) return;
  log_info("{}", message);
  message_ = std::move(message);
  since_message_.restart();
}

void Viewer::act(WindowCommand command) {
  const auto toggle_panel = [this](bool& open) {
    open = !open;
    hud_ = hud_ || open;
  };
  switch (command) {
    case WindowCommand::quit:
      closed_ = true;
      break;
    case WindowCommand::pause:
      paused_ = !paused_;
      break;
    case WindowCommand::step:
      paused_ = step_ = true;
      break;
    case WindowCommand::screenshot:
      show_message(host_.save_screenshot());
      break;
    case WindowCommand::record:
      show_message(host_.toggle_recording());
      break;
    case WindowCommand::full_screen:
      context_.toggle_full_screen();
      break;
    case WindowCommand::hud:
      hud_ = !hud_;
      break;
    case WindowCommand::menu:
      toggle_panel(panels_.menu);
      break;
    case WindowCommand::details:
      toggle_panel(panels_.details);
      break;
    case WindowCommand::help:
      toggle_panel(panels_.help);
      break;
    case WindowCommand::debug:
      toggle_panel(panels_.debug);
      break;
    case WindowCommand::panels:
      toggle_panel(panels_.panels);
      break;
    case WindowCommand::layout:
      compact_ = !compact_.value_or(is_small(context_.window_size()));
      break;
    case WindowCommand::calibrate:
      show_message(kiosk_ ? "calibrate without --kiosk, or with penumbra setup"
                          : host_.calibrate());
      break;
    case WindowCommand::smooth:
      show_message(host_.toggle_smoothing());
      edited_ = true;  // draws a paused frame again
      break;
    case WindowCommand::walls:
      show_message(host_.toggle_walls());
      edited_ = true;
      break;
    case WindowCommand::slide:
    case WindowCommand::lift:
    case WindowCommand::reach:
    case WindowCommand::turn:
      drag_ = static_cast<DragMode>(
          std::ranges::find(kDragCommands, command, &DragCommand::command) - kDragCommands.begin());
      break;
    case WindowCommand::put: {
      const SessionView view = host_.view();
      const auto pointer = pointer_view();
      if (!pointer || view.state == nullptr) break;
      if (const auto placed = manipulator_.put(*view.scene, *view.state, *pointer)) {
        host_.begin_move(placed->object);
        edit(*placed);
      }
      break;
    }
    case WindowCommand::undo:
    case WindowCommand::reset:
      manipulator_.release_object();
      show_message(command == WindowCommand::undo ? host_.undo() : host_.reset());
      edited_ = true;
      break;
    case WindowCommand::save_scene:
      show_message(host_.save_scene());
      break;
    case WindowCommand::cursor: {
      const Scene* scene = host_.view().scene;
      const bool has_one =
          scene != nullptr &&
          std::ranges::find(scene->objects, true, &SceneObject::cursor) != scene->objects.end();
      cursor_ = has_one && !cursor_;
      show_message(!has_one  ? "the scene has no 3D cursor"
                   : cursor_ ? "the 3D cursor follows the pointer; the wheel lifts it"
                             : "the 3D cursor rests");
      break;
    }
    case WindowCommand::next_technique: {
      const std::vector<HudNode> nodes = chosen_nodes();
      set_technique(nodes.empty() ? ShadowTechnique::none
                                  : technique_after(nodes.front().style.technique));
      break;
    }
    case WindowCommand::next_translucency:
      set_translucency(translucency_after(host_.translucency()));
      break;
    case WindowCommand::next_node: {
      const std::vector<HudNode> nodes = host_.nodes();
      const auto at = std::ranges::find_if(
          nodes, [this](const HudNode& node) { return node_ && node.name == *node_; });
      const auto next = node_ && at != nodes.end() ? at + 1 : nodes.begin();
      const bool all = next == nodes.end() || (node_ && at == nodes.end());
      node_ = all ? std::nullopt : std::optional(next->name);
      show_message("keys change the technique of " + (node_ ? *node_ : std::string("all shadows")));
      break;
    }
  }
}

}  // namespace penumbra
