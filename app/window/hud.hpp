// State, texts and commands of the window. Overlay draws them; Viewer executes the commands.
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
  menu,
  details,
  help,
  debug,
  panels,
  layout,
  calibrate,
  smooth,  // smoothing of the drawn pose
  undo,
  reset,  // objects back to where they were at the start
  save_scene,
  slide,
  lift,
  reach,
  turn,
  put,
  cursor,  // the scene's 3D cursor starts or stops following the pointer
  next_technique,
  next_translucency,
  walls,      // virtual walls drawn or not
  next_node,  // selects the nodes that the technique keys change: all or one
};

// Names, effects and commands of the drag modes, in the order of DragMode.
struct DragCommand {
  const char* name;
  const char* effect;
  WindowCommand command;
};
inline constexpr std::array<DragCommand, 4> kDragCommands = {
    {{"slide", "along the table", WindowCommand::slide},
     {"lift", "up and sideways", WindowCommand::lift},
     {"reach", "up and away", WindowCommand::reach},
     {"turn", "to turn it", WindowCommand::turn}}};

[[nodiscard]] inline const DragCommand& command_of(DragMode mode) {
  static_assert(kDragCommands.size() == static_cast<std::size_t>(DragMode::turn) + 1);
  return kDragCommands[static_cast<std::size_t>(mode)];
}

struct KeyHelp {
  std::string_view keys;
  std::string_view what;
};
// Returns the keys in the order of the help panel and the documentation.
[[nodiscard]] std::span<const KeyHelp> key_help();
// Returns nullopt for a key without a command, and for the number keys of technique_of_key().
[[nodiscard]] std::optional<WindowCommand> command_of_key(const WindowEvent& event);
[[nodiscard]] bool is_close_key(const WindowEvent& event);   // Esc: closes panels before it quits
[[nodiscard]] bool is_number_key(const WindowEvent& event);  // includes the keypad's digits
// Key 0 is none, 1 the first technique after none, and so on.
[[nodiscard]] std::optional<ShadowTechnique> technique_of_key(const WindowEvent& event);
// Returns the techniques in the order of their keys.
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
  double spill = 0.0;  // fraction of the penumbra outside its boundary
};

struct HudState {
  bool live = false;
  bool has_image = false;
  bool calibrated = true;          // false: the lens is a guess
  bool locked = false;             // the keys of a kiosk are locked
  std::uint64_t frame = 0;         // frame number
  std::optional<int> frame_count;  // number of frames of a recording
  PoseEstimate pose;
  std::vector<GroupEstimate> groups;                   // tag groups other than the table's
  double frames_per_s = 0.0;                           // rate of new frames
  std::vector<std::pair<std::string, double>> stages;  // mean wall time of recent frames [ms]
  std::optional<double> latency_ms;                    // camera timestamp to buffer swap
  std::optional<double> stalled_s;                     // time since the last complete frame
  std::optional<bool> smooth;                          // smoothing is on; nullopt: not available
  std::optional<SmoothedPose> smoothed;                // effect of smoothing on the last frame
  bool walls = true;                                   // virtual walls are shown
  int frames_dropped = 0;                              // frames that came too late to be shown
  std::vector<std::pair<std::string, std::int64_t>> faults;  // camera faults and their counts
  std::optional<std::string> trouble;                        // current fault of the camera
  std::optional<HudRecording> recording;
  std::vector<HudNode> nodes;
  Translucency translucency = Translucency::automatic;        // requested
  Translucency translucency_drawn = Translucency::automatic;  // mode of the last frame

  // Fields of the debug view, filled only while it is open.
  CompositeStats drawn;                                    // work of the last frame
  std::vector<std::pair<std::string, std::int64_t>> work;  // counters since the start
  std::vector<std::string> skipped, kept;                  // with their reasons
  std::vector<HudFoldOver> twists;
  std::vector<Eigen::Vector2d> kernels_px;  // positions in the image
  int image_width = 0, image_height = 0;

  // The viewer sets these.
  bool paused = false;
  std::string selected;  // selected object; empty: none
  DragMode drag = DragMode::slide;
  std::string message;  // result of the last command; empty after some seconds
};

struct HudPanels {
  // Panels that are open, beside the status line.
  bool help = false, debug = false, panels = false, details = false, menu = false;
  bool compact = false;  // large buttons without keys, for small screens
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
  HudColor color;    // green: tracked, amber: uncertain, blue (fades with age): held, red: lost
};
[[nodiscard]] HudStatus status_of(const EstimatedPose& pose);
[[nodiscard]] HudStatus status_of(const GroupEstimate& group);  // "wall: tracked"
// The table's pose, or what prevents it: no image yet, or no calibration.
[[nodiscard]] HudStatus status_of(const HudState& state);

// The line that is always shown.
struct StatusLine {
  HudStatus state;        // "tracked"
  std::string rate;       // "30 frames/s"; empty before the first frame
  std::string recording;  // "REC 512"; empty if nothing is recorded
  std::string next;       // what to do next: "drag an object to move it"
  bool warns = false;     // `next` reports a fault
};
[[nodiscard]] StatusLine status_line_of(const HudState& state);

struct MenuEntry {
  std::string label;    // "Record"
  const char* longest;  // the longest label that this entry can have
  const char* key;      // "R"
  WindowCommand command;
};
[[nodiscard]] std::vector<MenuEntry> menu_of(const HudState& state);

// Returns warnings, which are shown even while the HUD is hidden: a stalled image, a camera fault,
// a failed recording.
[[nodiscard]] std::vector<std::string> warnings_of(const HudState& state);
// Returns "latency 45 ms", or the age of a stalled frame; empty if neither is known.
[[nodiscard]] std::string age_text(const HudState& state);
// Returns "REC folder   26 frames, 3 dropped", or "recording FAILED: ...".
[[nodiscard]] std::string recording_text(const HudRecording& recording);
// Returns lines for the debug view: "skipped: rotor: outside the view", then "kept: video: ...".
// Lists up to kMaxReasons of each kind, then the number of the others.
[[nodiscard]] std::vector<std::string> reason_lines(const HudState& state);
inline constexpr std::size_t kMaxReasons = 10;
// Returns "smoothed: 12 ms late, 0.05 px".
[[nodiscard]] std::string smoothing_text(const SmoothedPose& smoothed);
// Returns "layered", "cocl", ..., or a list if the nodes differ.
[[nodiscard]] std::string technique_text(std::span<const HudNode> nodes);

// Returns "mesh", or "auto (blend)".
[[nodiscard]] std::string translucency_text(Translucency requested, Translucency drawn);
[[nodiscard]] Translucency translucency_after(Translucency mode);

// Workspace from which a node's constants are computed (docs/shadows.md#constants).
struct Workspace {
  double height_m = 0.3;       // height at which the umbra vanishes
  double magnification = 1.5;  // magnification of the middle layer at that height
};
// Returns nullopt if the umbra never vanishes (a <= 1).
[[nodiscard]] std::optional<Workspace> workspace_of(const LayeredConstants& constants);

// Scales the strength of a shadow: opacity 1 keeps its light fractions, 0 removes the shadow.
[[nodiscard]] LightFractions with_opacity(const LightFractions& full, double opacity);

}  // namespace penumbra
