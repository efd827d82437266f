// State, words and commands of the window. Overlay draws them, Viewer acts on them.
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
#include "render/gl/context.hpp"

namespace penumbra {

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
  cursor,  // the scene's 3D cursor follows the pointer, or stops
  next_technique,
  next_translucency,
  next_node,  // selects the shadow nodes that the keys for techniques change: all, or one
};

// Modes of a drag in the order of DragMode, and their commands.
struct DragCommand {
  const char* name;
  WindowCommand command;
};
inline constexpr std::array<DragCommand, 4> kDragCommands = {{{"slide", WindowCommand::slide},
                                                              {"lift", WindowCommand::lift},
                                                              {"reach", WindowCommand::reach},
                                                              {"turn", WindowCommand::turn}}};

struct KeyHelp {
  std::string_view keys;
  std::string_view what;
};
// In the order of the help panel and the documentation.
[[nodiscard]] std::span<const KeyHelp> key_help();
// Empty for a key without a command, also for the number keys of technique_of_key().
[[nodiscard]] std::optional<WindowCommand> command_of_key(const WindowEvent& event);
[[nodiscard]] bool is_number_key(const WindowEvent& event);  // also of the keypad
// Key 0 is none, 1 the first technique after none, and so on.
[[nodiscard]] std::optional<ShadowTechnique> technique_of_key(const WindowEvent& event);
// In the order of their keys.
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

struct HudFoldOver {
  std::string caster;
  TwistReport twist;
  double spill = 0.0;  // share of the penumbra beyond its outline
};

struct HudState {
  bool live = false;
  bool has_picture = false;
  std::uint64_t frame = 0;         // number
  std::optional<int> frame_count;  // of a recording
  PoseEstimate pose;
  std::vector<GroupEstimate> groups;                   // of tags, beside the table
  double frames_per_s = 0.0;                           // new frames shown
  std::vector<std::pair<std::string, double>> stages;  // mean wall time of the last frames [ms]
  std::optional<double> latency_ms;                    // from the camera's timestamp to the swap
  std::optional<double> stalled_s;                     // time since the last whole frame
  std::optional<bool> smooth;            // smoothing of the drawn pose; empty: not available
  std::optional<SmoothedPose> smoothed;  // its effect on the last frame
  int frames_dropped = 0;                // too late to be shown
  std::vector<std::pair<std::string, std::int64_t>> faults;  // of the camera, counted
  std::optional<std::string> trouble;                        // current fault of the camera
  std::optional<HudRecording> recording;
  std::vector<HudNode> nodes;
  Translucency translucency = Translucency::automatic;        // requested
  Translucency translucency_drawn = Translucency::automatic;  // in the last frame

  // For the debug view; filled only while it is open.
  CompositeStats drawn;                                    // of the last frame
  std::vector<std::pair<std::string, std::int64_t>> work;  // since the start
  std::vector<std::string> skipped, kept;                  // each with its reason
  std::vector<HudFoldOver> twists;
  std::vector<Eigen::Vector2d> kernels_px;  // in the image
  int picture_width = 0, picture_height = 0;

  // Set by the viewer.
  bool paused = false;
  std::string selected;  // object; empty: none
  DragMode drag = DragMode::slide;
  std::string message;  // about the last command; empty after a while
};

struct HudPanels {
  bool help = false, debug = false, panels = false;  // open
  bool compact = false;  // few words and large buttons, for small screens
};

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
[[nodiscard]] HudStatus status_of(const EstimatedPose& pose);
[[nodiscard]] HudStatus status_of(const GroupEstimate& group);  // "wall: tracked"
// Warnings that are shown even while the HUD is hidden: a stalled image, its cause, a failed
// recording.
[[nodiscard]] std::vector<std::string> warnings_of(const HudState& state);
// "latency 45 ms", or the age of a stalled frame; empty if neither is known.
[[nodiscard]] std::string age_in_words(const HudState& state);
// "REC folder   26 frames, 3 dropped", or "recording FAILED: ...".
[[nodiscard]] std::string recording_in_words(const HudRecording& recording);
// For the debug view, a line each: "skipped: rotor: outside the view", then "kept: video: ...".
// Lists kMostReasons of each kind and the number of the others.
[[nodiscard]] std::vector<std::string> reasons_in_words(const HudState& state);
inline constexpr std::size_t kMostReasons = 10;
// "smoothed: 12 ms late, 0.05 px".
[[nodiscard]] std::string smoothing_in_words(const SmoothedPose& smoothed);
// "layered", "cocl", or a list if nodes differ.
[[nodiscard]] std::string technique_in_words(std::span<const HudNode> nodes);

// "mesh", or "auto (blend)".
[[nodiscard]] std::string in_words(Translucency asked, Translucency drawn);
[[nodiscard]] Translucency translucency_after(Translucency mode);

// The workspace that determines a node's constants (docs/shadows.md#constants).
struct Workspace {
  double height_m = 0.3;       // at which the umbra vanishes
  double magnification = 1.5;  // of the middle layer there
};
// Empty if the umbra never vanishes (a <= 1).
[[nodiscard]] std::optional<Workspace> workspace_of(const LayeredConstants& constants);

// Reduces the strength of a shadow: opacity 1 keeps its light fractions, 0 removes it.
[[nodiscard]] LightFractions with_opacity(const LightFractions& full, double opacity);

}  // namespace penumbra
