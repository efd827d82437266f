// What the window says about the session and what it offers to do: plain data and words. overlay
// draws it, viewer acts on it.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/session/pose_smoother.hpp"
#include "app/session/scene_edit.hpp"
#include "app/window/manipulation.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "render/compositor.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

// What a key or a button of the window does.
enum class WindowCommand {
  quit,
  pause,
  step,
  screenshot,
  record,
  full_screen,
  hud,
  help,
  debug,
  panels,
  layout,
  smooth,  // the pose that is drawn
  slide,
  lift,
  reach,
  turn,
  put,
  cursor,  // the scene's 3D cursor follows the pointer, or rests
  next_technique,
  next_translucency,
  next_node,  // which shadow node the keys for techniques are for: all, or one
};

struct KeyHelp {
  std::string_view keys;
  std::string_view what;
};
// As the help panel and the documentation list them.
[[nodiscard]] std::span<const KeyHelp> key_help();
// Nothing for a key that does nothing, or a number key: that is technique_of_key().
[[nodiscard]] std::optional<WindowCommand> command_of_key(const WindowEvent& event);
// 1 is the first technique after none, and so on; 0 is none.
[[nodiscard]] std::optional<ShadowTechnique> technique_of_key(const WindowEvent& event);
// The techniques in the order of their keys.
[[nodiscard]] std::vector<ShadowTechnique> techniques_by_key();
[[nodiscard]] ShadowTechnique technique_after(ShadowTechnique technique);

struct HudNode {
  std::string name;
  ShadowStyle style;
};

struct HudRecording {
  std::string folder;
  std::uint64_t written = 0, dropped = 0;
  std::optional<std::string> error;
};

struct HudTwist {
  std::string caster;
  TwistReport twist;
  double spill = 0.0;  // share of the penumbra beyond its outline
};

struct HudState {
  bool live = false;
  bool has_picture = false;
  std::uint64_t frame = 0;         // its number
  std::optional<int> frame_count;  // of a recording
  PoseEstimate pose;
  std::vector<GroupEstimate> groups;                   // of tags, beside the table
  double frames_per_s = 0.0;                           // new ones shown
  std::vector<std::pair<std::string, double>> stages;  // wall, mean of the last frames [ms]
  std::optional<double> latency_ms;                    // from the camera's timestamp to the swap
  std::optional<double> silent_s;  // for so long the camera has given no whole picture
  std::optional<bool> smooth;      // whether the pose is smoothed as it is drawn; nothing: can't be
  std::optional<SmoothedPose> smoothed;                      // what that did to the last picture
  int frames_dropped = 0;                                    // too late to be shown
  std::vector<std::pair<std::string, std::int64_t>> faults;  // of the camera, counted
  std::optional<std::string> trouble;                        // of the camera, right now
  std::optional<HudRecording> recording;
  std::vector<HudNode> nodes;
  Translucency translucency = Translucency::automatic;        // asked for
  Translucency translucency_drawn = Translucency::automatic;  // in the last picture

  // For the debug view; filled only where it is open.
  CompositeStats drawn;                                    // of the last picture
  std::vector<std::pair<std::string, std::int64_t>> work;  // since the start
  std::vector<std::string> skipped, kept;                  // what, and why
  std::vector<HudTwist> twists;
  std::vector<Eigen::Vector2d> kernels_px;  // where kernels are in the picture
  int picture_width = 0, picture_height = 0;

  // The viewer's own.
  bool paused = false;
  std::string selected;  // object; empty: none
  DragMode drag = DragMode::slide;
  std::string message;  // what was just done; empty when it is old
};

// What is open and how it is laid out.
struct HudPanels {
  bool help = false, debug = false, panels = false;
  bool compact = false;  // few words and large buttons, for small screens
};

// What was clicked.
struct HudActions {
  std::vector<WindowCommand> commands;
  std::vector<SceneEdit> edits;
  std::optional<Translucency> translucency;
};

struct HudColor {
  float red = 1.0F, green = 1.0F, blue = 1.0F, alpha = 1.0F;
};
struct HudStatus {
  std::string text;  // "held 0.21 s: no tag seen"
  HudColor color;    // green, amber, blue that fades with the age, red
};
[[nodiscard]] HudStatus status_of(const PoseEstimate& pose);
[[nodiscard]] HudStatus status_of(const GroupEstimate& group);  // "wall: tracked"
// What a person must know also where the HUD is hidden: that the picture stands still, and why, and
// that a recording failed. Nothing else.
[[nodiscard]] std::vector<std::string> warnings_of(const HudState& state);
// "latency 45 ms", or how old the picture is by now; empty: neither is known.
[[nodiscard]] std::string age_in_words(const HudState& state);
// "REC folder   26 frames, 3 left out", or that it failed.
[[nodiscard]] std::string recording_in_words(const HudRecording& recording);
// Of the debug view: "left out: rotor: outside the view", then "kept: video: ...", a line each; of
// each kind kMostReasons at most, and then how many more there are.
[[nodiscard]] std::vector<std::string> reasons_in_words(const HudState& state);
inline constexpr std::size_t kMostReasons = 10;
// "smoothed: 12 ms late, 0.05 px".
[[nodiscard]] std::string smoothing_in_words(const SmoothedPose& smoothed);
// "layered", "cocl", or a list where nodes differ.
[[nodiscard]] std::string technique_in_words(std::span<const HudNode> nodes);

// "mesh"; of what was chosen by itself "auto (blend)".
[[nodiscard]] std::string in_words(Translucency asked, Translucency drawn);
[[nodiscard]] Translucency translucency_after(Translucency way);

// What a node's constants come from (docs/shadows.md#constants): the height at which the umbra
// vanishes and the middle layer's magnification there. Nothing where it never vanishes (a <= 1).
struct Workspace {
  double height_m = 0.3;
  double magnification = 1.5;
};
[[nodiscard]] std::optional<Workspace> workspace_of(const LayeredConstants& constants);

// Light fractions with the shadow's strength taken back: 1 leaves them, 0 is no shadow.
[[nodiscard]] LightFractions with_opacity(const LightFractions& full, double opacity);

}  // namespace penumbra
