#include "app/window/hud.hpp"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace penumbra {
namespace {

struct Key {
  int code;
  WindowCommand command;
};
constexpr std::array kKeys = {
    Key{GLFW_KEY_ESCAPE, WindowCommand::quit},
    Key{GLFW_KEY_Q, WindowCommand::quit},
    Key{GLFW_KEY_SPACE, WindowCommand::pause},
    Key{GLFW_KEY_PERIOD, WindowCommand::step},
    Key{GLFW_KEY_S, WindowCommand::screenshot},
    Key{GLFW_KEY_R, WindowCommand::record},
    Key{GLFW_KEY_F11, WindowCommand::full_screen},
    Key{GLFW_KEY_F, WindowCommand::full_screen},
    Key{GLFW_KEY_H, WindowCommand::hud},
    Key{GLFW_KEY_TAB, WindowCommand::menu},
    Key{GLFW_KEY_I, WindowCommand::details},
    Key{GLFW_KEY_F1, WindowCommand::help},
    Key{GLFW_KEY_D, WindowCommand::debug},
    Key{GLFW_KEY_P, WindowCommand::panels},
    Key{GLFW_KEY_C, WindowCommand::layout},
    Key{GLFW_KEY_X, WindowCommand::slide},
    Key{GLFW_KEY_Z, WindowCommand::lift},
    Key{GLFW_KEY_Y, WindowCommand::reach},
    Key{GLFW_KEY_T, WindowCommand::turn},
    Key{GLFW_KEY_B, WindowCommand::put},
    Key{GLFW_KEY_K, WindowCommand::cursor},
    Key{GLFW_KEY_N, WindowCommand::next_technique},
    Key{GLFW_KEY_G, WindowCommand::next_node},
    Key{GLFW_KEY_M, WindowCommand::next_translucency},
    Key{GLFW_KEY_L, WindowCommand::walls},
    Key{GLFW_KEY_J, WindowCommand::smooth},
    Key{GLFW_KEY_V, WindowCommand::calibrate},
    Key{GLFW_KEY_U, WindowCommand::undo},
    Key{GLFW_KEY_O, WindowCommand::reset},
    Key{GLFW_KEY_W, WindowCommand::save_scene},
};
constexpr std::array kControlKeys = {
    Key{GLFW_KEY_Z, WindowCommand::undo},
    Key{GLFW_KEY_S, WindowCommand::save_scene},
};

constexpr std::string_view kNotCalibrated = "not calibrated: press V to calibrate the camera";

constexpr std::array kHelp = {
    KeyHelp{"F1", "this help"},
    KeyHelp{"Tab", "menu; arrow keys and Enter choose in it and in the panels"},
    KeyHelp{"I", "details: pose, tags, times, camera"},
    KeyHelp{"H", "HUD shown or hidden"},
    KeyHelp{"P", "panels: translucency, technique, H and a, strength, kernels"},
    KeyHelp{"C", "compact layout with large buttons, or full"},
    KeyHelp{"D", "debug view: passes, work, kernels, twisted faces"},
    KeyHelp{"1 2 3 ...  0", "shadows: simple, layered, field, walls, hard, volume; none"},
    KeyHelp{"J", "the drawn pose smoothed, or as measured"},
    KeyHelp{"N", "next technique"},
    KeyHelp{"G", "which shadow node these keys are for: all, or one by one"},
    KeyHelp{"M", "next mode of translucency of shadows"},
    KeyHelp{"L", "technique walls: shows or hides its walls"},
    KeyHelp{"space   .", "pause, one frame on"},
    KeyHelp{"S", "screenshot (without HUD)"},
    KeyHelp{"R", "start or stop recording (live)"},
    KeyHelp{"V", "calibrate the camera with this sheet (live)"},
    KeyHelp{"F11  F   Esc  Q", "full screen, quit (Esc first closes menu, panels and help)"},
    KeyHelp{"left drag", "object along the table (or as chosen by X, Z, Y, T)"},
    KeyHelp{"middle drag, Shift + left", "object up and sideways"},
    KeyHelp{"right drag", "object up and away"},
    KeyHelp{"Ctrl + left", "turn object"},
    KeyHelp{"X  Z  Y  T", "left drag slides, lifts, reaches, turns"},
    KeyHelp{"B", "put the selected object on the table at the pointer"},
    KeyHelp{"U, Ctrl + Z", "undo the last move, reset or added object"},
    KeyHelp{"O", "objects back to their original places, added ones removed"},
    KeyHelp{"W, Ctrl + S", "write the arrangement as a scene file"},
    KeyHelp{"drop a file", "puts the model on the table (.glb, .gltf, .obj)"},
    KeyHelp{"K, wheel", "the scene's 3D cursor follows the pointer; higher, lower"},
};

bool is_plain_key(const WindowEvent& event) {
  return event.kind == WindowEvent::Kind::key_down && !event.control && !event.alt;
}

int first_digit(const WindowEvent& event) {
  return event.code >= GLFW_KEY_KP_0 ? GLFW_KEY_KP_0 : GLFW_KEY_0;
}

}  // namespace

std::span<const KeyHelp> key_help() {
  return kHelp;
}

bool is_close_key(const WindowEvent& event) {
  return is_plain_key(event) && event.code == GLFW_KEY_ESCAPE;
}

bool is_number_key(const WindowEvent& event) {
  const int digit = event.code - first_digit(event);
  return is_plain_key(event) && digit >= 0 && digit <= 9;
}

std::optional<WindowCommand> command_of_key(const WindowEvent& event) {
  if (event.kind != WindowEvent::Kind::key_down || event.alt) return std::nullopt;
  const std::span<const Key> keys =
      event.control ? std::span<const Key>(kControlKeys) : std::span<const Key>(kKeys);
  const auto key = std::ranges::find(keys, event.code, &Key::code);
  return key != keys.end() ? std::optional(key->command) : std::nullopt;
}

std::vector<ShadowTechnique> techniques_by_key() {
  std::vector<ShadowTechnique> techniques;
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    if (technique != ShadowTechnique::none) techniques.push_back(technique);
  }
  return techniques;
}

std::optional<ShadowTechnique> technique_of_key(const WindowEvent& event) {
  if (!is_number_key(event)) return std::nullopt;
  const auto digit = static_cast<std::size_t>(event.code - first_digit(event));
  if (digit >= kShadowTechniqueNames.size()) return std::nullopt;
  return kShadowTechniqueNames[digit].value;
}

ShadowTechnique technique_after(ShadowTechnique technique) {
  const std::vector<ShadowTechnique> techniques = techniques_by_key();
  const auto at = std::ranges::find(techniques, technique);
  if (at == techniques.end() || at + 1 == techniques.end()) return techniques.front();
  return *(at + 1);
}

HudStatus status_of(const EstimatedPose& pose) {
  HudStatus status;
  status.text = to_string(pose.status);
  switch (pose.status) {
    case TrackStatus::tracked:
      status.color = {0.45F, 0.92F, 0.45F, 1.0F};
      return status;
    case TrackStatus::uncertain:
      status.color = {1.0F, 0.78F, 0.25F, 1.0F};
      break;
    case TrackStatus::held: {
      // The colour fades with the age, but stays readable.
      const double left = std::clamp(1.0 - pose.age_s / kHoldSeconds, 0.0, 1.0);
      status.color = {0.50F, 0.80F, 1.0F, static_cast<float>(0.45 + 0.55 * left)};
      status.text += fmt::format(" {:.2f} s", pose.age_s);
      break;
    }
    case TrackStatus::lost:
      status.color = {1.0F, 0.45F, 0.40F, 1.0F};
      break;
  }
  if (const std::string reason = text_of(pose.reason); !reason.empty())
    status.text += ": " + reason;
  return status;
}

HudStatus status_of(const GroupEstimate& group) {
  HudStatus status = status_of(static_cast<const EstimatedPose&>(group));
  status.text = group.name + ": " + status.text;
  return status;
}

HudStatus status_of(const HudState& state) {
  HudStatus status = status_of(state.pose);
  if (!state.has_image) status.text = "waiting for the first frame";
  // The reason is the guessed lens.
  if (state.has_image && !state.calibrated && state.pose.status == TrackStatus::uncertain)
    status.text = kNotCalibrated;
  return status;
}

std::string age_text(const HudState& state) {
  if (state.stalled_s) return fmt::format("the frame is {:.1f} s old", *state.stalled_s);
  return state.latency_ms ? fmt::format("latency {:.0f} ms", *state.latency_ms) : std::string();
}

std::vector<std::string> warnings_of(const HudState& state) {
  std::vector<std::string> warnings;
  if (!state.calibrated && !state.locked) warnings.emplace_back(kNotCalibrated);
  if (state.stalled_s) warnings.push_back(age_text(state));
  if (state.trouble) warnings.push_back("camera: " + *state.trouble);
  if (state.recording && state.recording->error) {
    warnings.push_back(recording_text(*state.recording));
    warnings.push_back(*state.recording->error);
  }
  return warnings;
}

namespace {

// Returns what the user should do about the pose; empty if nothing.
std::string advice_on(const PoseEstimate& pose) {
  switch (pose.status) {
    case TrackStatus::tracked:
      break;
    case TrackStatus::uncertain:
      return pose.reason.cause == PoseCause::two_poses ? "tilt the view: two poses fit the tags"
                                                       : "show more tags, or come closer";
    case TrackStatus::held:
      return "keep the tags in view";
    case TrackStatus::lost:
      return "show the tags to the camera";
  }
  return {};
}

std::string next_step(const HudState& state) {
  if (!state.has_image) return state.live ? "the camera starts" : "the recording opens";
  if (state.paused) return "space: go on";
  if (!state.calibrated) return "V: calibrate the camera";
  if (std::string advice = advice_on(state.pose); !advice.empty()) return advice;
  return state.selected.empty() ? "drag an object to move it"
                                : fmt::format("dragging {} {}: U undoes", state.selected,
                                              command_of(state.drag).effect);
}

}  // namespace

StatusLine status_line_of(const HudState& state) {
  StatusLine line;
  line.state = {std::string(to_string(state.pose.status)), status_of(state.pose).color};
  if (!state.has_image) line.state.text = "no image yet";
  if (state.has_image && !state.calibrated && state.pose.status == TrackStatus::uncertain)
    line.state.text = "not calibrated";
  if (state.paused) line.state.text += ", paused";
  if (state.has_image) {
    const std::string rate = fmt::format("{:.0f}", state.frames_per_s);
    line.rate = rate + (rate == "1" ? " frame/s" : " frames/s");
  }
  if (state.recording && !state.recording->error)
    line.recording = fmt::format("REC {}", state.recording->written);
  line.next = next_step(state);
  if (state.stalled_s) line.next = age_text(state);
  if (state.trouble) line.next = "camera: " + *state.trouble;
  if (state.recording && state.recording->error)
    line.next = "recording FAILED: " + *state.recording->error;
  line.warns = state.stalled_s || state.trouble || (state.recording && state.recording->error);
  return line;
}

std::vector<MenuEntry> menu_of(const HudState& state) {
  const auto next_drag =
      kDragCommands[(static_cast<std::size_t>(state.drag) + 1) % kDragCommands.size()].command;
  std::vector<MenuEntry> entries = {
      {"Shadow: " + technique_text(state.nodes), "Shadow: layered", "N",
       WindowCommand::next_technique},
      {"Drag: " + std::string(command_of(state.drag).effect), "Drag: up and sideways", "X Z Y T",
       next_drag},
      {state.paused ? "Go on" : "Pause", "Pause", "space", WindowCommand::pause},
      {"Next frame", "Next frame", ".", WindowCommand::step},
      {"Save image", "Save image", "S", WindowCommand::screenshot}};
  if (state.live) {
    entries.push_back({state.recording ? "Stop recording" : "Record", "Stop recording", "R",
                       WindowCommand::record});
    entries.push_back({"Calibrate", "Calibrate", "V", WindowCommand::calibrate});
  }
  const MenuEntry rest[] = {{"Undo", "Undo", "U", WindowCommand::undo},
                            {"Reset", "Reset", "O", WindowCommand::reset},
                            {"Save scene", "Save scene", "W", WindowCommand::save_scene},
                            {"Settings", "Settings", "P", WindowCommand::panels},
                            {"Details", "Details", "I", WindowCommand::details},
                            {"Debug", "Debug", "D", WindowCommand::debug},
                            {"Help", "Help", "F1", WindowCommand::help},
                            {"Hide all", "Hide all", "H", WindowCommand::hud},
                            {"Full screen", "Full screen", "F11", WindowCommand::full_screen},
                            {"Quit", "Quit", "Q", WindowCommand::quit}};
  entries.insert(entries.end(), std::begin(rest), std::end(rest));
  return entries;
}

std::string recording_text(const HudRecording& recording) {
  std::string text = fmt::format("{} {}   {} frames", recording.error ? "recording FAILED:" : "REC",
                                 recording.folder, recording.written);
  if (recording.dropped > 0) text += fmt::format(", {} dropped", recording.dropped);
  return text;
}

std::string smoothing_text(const SmoothedPose& smoothed) {
  return fmt::format("smoothed: {:.{}f} ms late, {:.2f} px", smoothed.lag_ms,
                     smoothed.lag_ms < 10.0 ? 1 : 0, smoothed.offset_px);
}

std::string technique_text(std::span<const HudNode> nodes) {
  std::vector<std::string_view> names;
  for (const HudNode& node : nodes) {
    const bool cocl = node.style.technique == ShadowTechnique::layered &&
                      node.style.kernels == KernelSource::centroid;
    const std::string_view name = cocl ? "cocl" : to_string(node.style.technique);
    if (std::ranges::find(names, name) == names.end()) names.push_back(name);
  }
  return names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "));
}

std::vector<std::string> reason_lines(const HudState& state) {
  std::vector<std::string> lines;
  const auto add = [&lines](std::string_view head, const auto& parts) {
    const std::size_t shown = std::min(parts.size(), kMaxReasons);
    for (std::size_t i = 0; i < shown; ++i) {
      lines.push_back(fmt::format("{}: {}", head, parts[i]));
    }
    if (parts.size() > shown) {
      lines.push_back(fmt::format("{}: {} more", head, parts.size() - shown));
    }
  };
  add("skipped", state.skipped);
  add("kept", state.kept);
  return lines;
}

std::string translucency_text(Translucency requested, Translucency drawn) {
  if (requested != Translucency::automatic || drawn == Translucency::automatic) {
    return std::string(to_string(requested));
  }
  return fmt::format("{} ({})", to_string(requested), to_string(drawn));
}

Translucency translucency_after(Translucency mode) {
  const auto at = std::ranges::find(kTranslucencyNames, mode, &EnumName<Translucency>::value);
  return at + 1 == kTranslucencyNames.end() ? kTranslucencyNames.front().value : (at + 1)->value;
}

std::optional<Workspace> workspace_of(const LayeredConstants& constants) {
  if (std::isinf(constants.light_height)) return Workspace{constants.umbra_height, 1.0};
  if (!(constants.light_ratio > 1.0)) return std::nullopt;
  return Workspace{constants.umbra_height, constants.light_ratio / (constants.light_ratio - 1.0)};
}

LightFractions with_opacity(const LightFractions& full, double opacity) {
  const auto weaker = [opacity](double fraction) { return 1.0 - opacity * (1.0 - fraction); };
  return {weaker(full.umbra), weaker(full.middle), weaker(full.penumbra)};
}

}  // namespace penumbra
