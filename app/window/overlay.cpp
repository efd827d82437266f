#include "app/window/overlay.hpp"

#include <fmt/format.h>
#include <imgui.h>

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <system_error>
#include <utility>
#include <vector>

#include "app/window/overlay_renderer.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {
namespace {

constexpr const char* kFontFile = "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf";
constexpr std::array<float, 3> kFontSizes = {15.0F, 18.0F, 24.0F};  // [px]
constexpr float kTouchHeight = 46.0F;  // height of a touch button [px at a font of 15 px]
constexpr float kHelpWidth = 48.0F;    // [em] narrower windows wrap the lines of the help
constexpr float kHelpColumns = 26.0F;  // [em] narrower windows show a key above its text
constexpr float kPanelWidth = 12.0F;   // [em] narrower panels clip their texts
constexpr int kHandheldHeight = 400;   // [px] a smaller width or height shows fewer lines
constexpr std::size_t kMaxDebugLines = 10;

constexpr ImGuiWindowFlags kPlain = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoMove |
                                    ImGuiWindowFlags_NoSavedSettings |
                                    ImGuiWindowFlags_NoFocusOnAppearing | ImGuiWindowFlags_NoNav;
constexpr ImGuiWindowFlags kFitted = kPlain | ImGuiWindowFlags_AlwaysAutoResize;
constexpr ImGuiWindowFlags kScrolled = kFitted & ~ImGuiWindowFlags_NoScrollbar;

ImVec4 to_imgui(const HudColor& color) {
  return {color.red, color.green, color.blue, color.alpha};
}

constexpr HudColor kWhite = {1.0F, 1.0F, 1.0F, 1.0F};
constexpr HudColor kWarning = {1.0F, 0.55F, 0.45F, 1.0F};
constexpr HudColor kKernelDot = {0.25F, 0.85F, 1.0F, 0.9F};
constexpr HudColor kQuiet = {0.72F, 0.76F, 0.80F, 1.0F};

void text(const std::string& line) {
  ImGui::TextUnformatted(line.data(), line.data() + line.size());
}
void text(const HudColor& color, const std::string& line) {
  ImGui::PushStyleColor(ImGuiCol_Text, to_imgui(color));
  text(line);
  ImGui::PopStyleColor();
}

std::string measured_tags(const PoseEstimate& pose) {
  std::string line = fmt::format("tags {}", pose.tags_used);
  if (pose.tags_used > 0) {
    line += fmt::format("   reprojection {:.2f} px", pose.reprojection_rms_px);
  }
  if (pose.status == TrackStatus::tracked || pose.status == TrackStatus::uncertain) {
    line += fmt::format("   predicted error {:.2f} px", pose.predicted_overlay_error_px);
  }
  return line;
}

std::string count_of_faults(const HudState& state) {
  std::string line;
  for (const auto& [fault, count] : state.faults) line += fmt::format("   {} {}", fault, count);
  return line;
}

std::string frame_number_text(const HudState& state) {
  return state.frame_count ? fmt::format("frame {} of {}", state.frame, *state.frame_count)
                           : fmt::format("frame {}", state.frame);
}

std::string stage_times(const HudState& state) {
  std::string times;
  for (const auto& [stage, ms] : state.stages) {
    times += fmt::format("{}{} {:.1f}", times.empty() ? "" : "   ", stage, ms);
  }
  return times.empty() ? times : times + " ms";
}

const char* name_of(DragMode mode) {
  static_assert(kDragCommands.size() == static_cast<std::size_t>(DragMode::turn) + 1);
  return kDragCommands[static_cast<std::size_t>(mode)].name;
}

WindowCommand next_drag(DragMode mode) {
  return kDragCommands[(static_cast<std::size_t>(mode) + 1) % kDragCommands.size()].command;
}

// Draws a drop-down list of named values, labelled `shown`. Returns true if a value was chosen.
bool choose(const char* id, const std::string& shown, const auto& names, auto& value) {
  if (!ImGui::BeginCombo(id, shown.c_str())) return false;
  bool chosen = false;
  for (const auto& entry : names) {
    if (ImGui::Selectable(std::string(entry.name).c_str(), entry.value == value)) {
      value = entry.value;
      chosen = true;
    }
  }
  ImGui::EndCombo();
  return chosen;
}

#if IMGUI_VERSION_NUM >= 18700  // Debian 13
constexpr auto kKeypadEnter = ImGuiKey_KeypadEnter;
#else
constexpr auto kKeypadEnter = ImGuiKey_KeyPadEnter;
#endif

}  // namespace

bool is_small(GlContext::Size window) {
  return window.width < 800 || window.height < 520;
}

struct Overlay::Impl {
  Impl() : imgui(ImGui::CreateContext(&fonts)) {}
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() { ImGui::DestroyContext(imgui); }

  Result<void> open(const GlContext& context) {
    ImGui::SetCurrentContext(imgui);
    ImGuiIO& io = ImGui::GetIO();
    io.IniFilename = nullptr;  // writes no file beside the program
    io.LogFilename = nullptr;
    io.ConfigFlags |= ImGuiConfigFlags_NoMouseCursorChange;
    io.KeyMap[ImGuiKey_Backspace] = GLFW_KEY_BACKSPACE;
    io.KeyMap[ImGuiKey_Delete] = GLFW_KEY_DELETE;
    io.KeyMap[ImGuiKey_Enter] = GLFW_KEY_ENTER;
    io.KeyMap[kKeypadEnter] = GLFW_KEY_KP_ENTER;
    io.KeyMap[ImGuiKey_Escape] = GLFW_KEY_ESCAPE;
    io.KeyMap[ImGuiKey_LeftArrow] = GLFW_KEY_LEFT;
    io.KeyMap[ImGuiKey_RightArrow] = GLFW_KEY_RIGHT;
    io.KeyMap[ImGuiKey_Home] = GLFW_KEY_HOME;
    io.KeyMap[ImGuiKey_End] = GLFW_KEY_END;
    ImGui::StyleColorsDark();
    std::error_code ignored;
    const bool has_font = std::filesystem::exists(kFontFile, ignored);
    for (std::size_t i = 0; i < kFontSizes.size(); ++i) {
      sized[i] = has_font ? fonts.AddFontFromFileTTF(kFontFile, kFontSizes[i]) : nullptr;
      if (sized[i] == nullptr) {
        ImFontConfig config;
        config.SizePixels = kFontSizes[i];
        sized[i] = fonts.AddFontDefault(&config);
      }
    }
    PENUMBRA_TRY(renderer, OverlayRenderer::create(context, fonts));
    return {};
  }

  // Sets all sizes in proportion to the font.
  void set_style(GlContext::Size size, bool compact) {
    const int wide_height = std::min(size.height, size.width * 9 / 16);  // height of a 16:9 screen
    const std::size_t at = wide_height < 600 ? 0 : wide_height < 900 ? 1 : 2;
    font = sized[at];
    em = kFontSizes[at];
    ImGuiStyle style;
    ImGui::StyleColorsDark(&style);
    style.ScaleAllSizes(em / 15.0F);
    style.WindowRounding = style.FrameRounding = 0.3F * em;
    style.WindowBorderSize = 0.0F;
    style.WindowPadding = {0.6F * em, 0.5F * em};
    style.ItemSpacing = {0.5F * em, 0.3F * em};
    style.FramePadding = {0.5F * em, 0.25F * em};
    if (compact) {
      style.FramePadding = {0.7F * em, 0.7F * em};
      style.GrabMinSize = 2.0F * em;
      style.ScrollbarSize = 1.8F * em;
    }
    style.Colors[ImGuiCol_WindowBg] = {0.05F, 0.06F, 0.08F, 0.72F};
    style.Colors[ImGuiCol_PopupBg] = {0.08F, 0.09F, 0.11F, 0.96F};
    style.Colors[ImGuiCol_Button] = {0.20F, 0.27F, 0.36F, 0.90F};
    ImGui::GetStyle() = style;
  }

  void begin_drawing(GlContext::Size size, bool compact) {
    ImGui::SetCurrentContext(imgui);
    ImGuiIO& io = ImGui::GetIO();
    width = static_cast<float>(size.width);
    height = static_cast<float>(size.height);
    io.DisplaySize = {width, height};
    io.DeltaTime = std::max(1e-4F, static_cast<float>(since_last.elapsed().wall_ms * 1e-3));
    since_last.restart();
    for (std::size_t i = 0; i < down.size(); ++i) {
      io.MouseDown[i] = down[i] || pressed[i];
      pressed[i] = false;
    }
    set_style(size, compact);
    windows.clear();
    ImGui::NewFrame();
    ImGui::PushFont(font);
  }
  void end_drawing(GlContext::Size size) {
    ImGui::PopFont();
    ImGui::Render();
    renderer->draw(*ImGui::GetDrawData(), size);
  }

  void begin_window(const char* name, ImVec2 at, ImVec2 pivot, ImGuiWindowFlags flags) {
    ImGui::SetNextWindowPos(at, ImGuiCond_Always, pivot);
    ImGui::Begin(name, nullptr, flags);
  }
  // Records the window's rectangle, so that clicks on it do not reach the image.
  void end_window() {
    const ImVec2 at = ImGui::GetWindowPos();
    const ImVec2 size = ImGui::GetWindowSize();
    windows.push_back({at.x, at.y, at.x + size.x, at.y + size.y});
    ImGui::End();
  }

  void button(const std::string& label, WindowCommand command, HudActions& actions,
              ImVec2 size = {}) {
    if (ImGui::Button(label.c_str(), size)) actions.commands.push_back(command);
  }

  // Shows the pose's status; returns the rate and age of the frames.
  static std::string pose_status(const HudState& state, int rate_digits) {
    const HudStatus status = status_of(state);
    text(status.color, status.text);
    if (state.paused) {
      ImGui::SameLine();
      text({1.0F, 0.9F, 0.3F, 1.0F}, "  PAUSED");
    }
    const std::string age = age_text(state);
    return fmt::format("{:.{}f} frames/s{}{}", state.frames_per_s, rate_digits,
                       age.empty() ? "" : "   ", age);
  }

  void status(const HudState& state) {
    text(pose_status(state, 1) + "   " + frame_number_text(state));
    text(measured_tags(state.pose));
    if (state.smoothed) text(kQuiet, smoothing_text(*state.smoothed));
    for (const GroupEstimate& group : state.groups) {
      const HudStatus of_group = status_of(group);
      text(of_group.color, of_group.text);
    }
    text("shadows: " + technique_text(state.nodes));
    if (const std::string times = stage_times(state); !times.empty()) text(kQuiet, times);
    camera_and_recording(state);
  }

  // Draws a strip of measurements; fewer on a handheld's small screen.
  void compact_status(const HudState& state, bool handheld) {
    std::string line = pose_status(state, 0);
    if (handheld) {
      const float right = ImGui::GetItemRectMax().x + ImGui::CalcTextSize(line.c_str()).x;
      if (right + 1.4F * em < width) {
        ImGui::SameLine();
        line.insert(0, "  ");
      }
      text(line);
      text(measured_tags(state.pose));
    } else {
      text(line + "   " + measured_tags(state.pose));
      if (const std::string times = stage_times(state); !times.empty()) text(kQuiet, times);
      if (state.smoothed) text(kQuiet, smoothing_text(*state.smoothed));
    }
    camera_and_recording(state, !handheld);
  }

  void camera_and_recording(const HudState& state, bool selection = true) {
    if (state.live) {
      const std::string faults = count_of_faults(state);
      text(kQuiet, fmt::format("dropped {}{}", state.frames_dropped,
                               faults.empty() ? "" : "   camera:" + faults));
      if (state.trouble) text(kWarning, "camera: " + *state.trouble);
    }
    if (state.recording) {
      const HudRecording& recording = *state.recording;
      text(kWarning, recording_text(recording));
      if (recording.error) text(kWarning, *recording.error);
    }
    if (selection && !state.selected.empty()) {
      text(kQuiet, fmt::format("selected: {}   drag: {}", state.selected, name_of(state.drag)));
    }
  }

  void full_layout(const HudState& state, HudActions& actions) {
    const float gap = 0.5F * em;
    begin_window("status", {gap, gap}, {0.0F, 0.0F}, kFitted);
    ImGui::PushTextWrapPos(0.45F * width);
    status(state);
    end_status();
    begin_window("buttons", {gap, height - gap}, {0.0F, 1.0F}, kFitted);
    std::vector<std::pair<std::string, WindowCommand>> buttons = {
        {"Help F1", WindowCommand::help},
        {"Panels P", WindowCommand::panels},
        {"Debug D", WindowCommand::debug},
        {state.paused ? "Go on" : "Pause", WindowCommand::pause},
        {"Screenshot S", WindowCommand::screenshot}};
    if (state.live) {
      buttons.emplace_back(state.recording ? "Stop rec. R" : "Record R", WindowCommand::record);
    }
    buttons.emplace_back(fmt::format("Drag: {}###drag", name_of(state.drag)),
                         next_drag(state.drag));
    buttons.emplace_back("Hide H", WindowCommand::hud);
    for (std::size_t i = 0; i < buttons.size(); ++i) {
      if (i > 0) ImGui::SameLine();
      button(buttons[i].first, buttons[i].second, actions);
    }
    end_buttons();
  }

  void end_status() {
    ImGui::PopTextWrapPos();
    status_bottom = ImGui::GetWindowPos().y + ImGui::GetWindowSize().y;
    end_window();
  }
  void end_buttons() {
    buttons_height = ImGui::GetWindowSize().y;
    end_window();
  }

  void compact_layout(const HudState& state, HudActions& actions) {
    ImGui::SetNextWindowSize({width, 0.0F});
    begin_window("status", {0.0F, 0.0F}, {0.0F, 0.0F}, kPlain);
    ImGui::PushTextWrapPos(width - 0.6F * em);
    compact_status(state, std::min(width, height) < static_cast<float>(kHandheldHeight));
    end_status();

    ImGui::SetNextWindowSize({width, 0.0F});
    ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, ImVec2(0.2F * em, 0.2F * em));
    ImGui::PushStyleVar(ImGuiStyleVar_ItemSpacing, ImVec2(0.2F * em, 0.2F * em));
    ImGui::PushStyleVar(ImGuiStyleVar_FramePadding, ImVec2(0.1F * em, 0.1F * em));
    begin_window("buttons", {0.0F, height}, {0.0F, 1.0F}, kPlain);
    std::vector<std::pair<std::string, WindowCommand>> buttons = {
        {technique_text(state.nodes) + "###technique", WindowCommand::next_technique},
        {fmt::format("{}###drag", name_of(state.drag)), next_drag(state.drag)},
        {state.paused ? "go on###pause" : "pause###pause", WindowCommand::pause},
        {"image", WindowCommand::screenshot}};
    if (state.live) {
      buttons.emplace_back(state.recording ? "stop rec###record" : "record###record",
                           WindowCommand::record);
    } else {
      buttons.emplace_back("step", WindowCommand::step);
    }
    buttons.emplace_back("panels", WindowCommand::panels);
    buttons.emplace_back("help", WindowCommand::help);
    buttons.emplace_back("hide", WindowCommand::hud);
    // The longest text determines the number of rows: no button moves when its text changes.
    float widest = 0.0F;
    for (const char* label : {"layered", "image", "go on", "stop rec", "panels"}) {
      widest = std::max(widest, ImGui::CalcTextSize(label).x + 0.2F * em);
    }
    const auto width_of = [&](std::size_t in_row) {
      const auto count = static_cast<float>(in_row);
      return std::floor((ImGui::GetContentRegionAvail().x - (count - 1.0F) * 0.2F * em) / count);
    };
    std::size_t in_row = buttons.size();
    while (in_row > 2 && width_of(in_row) < widest) in_row = (in_row + 1) / 2;
    const ImVec2 each(width_of(in_row), kTouchHeight * em / kFontSizes[0]);
    for (std::size_t i = 0; i < buttons.size(); ++i) {
      if (i % in_row > 0) ImGui::SameLine();
      button(buttons[i].first, buttons[i].second, actions, each);
    }
    end_buttons();
    ImGui::PopStyleVar(3);
  }

  void node_panel(const HudNode& node, bool walls, HudActions& actions) {
    ImGui::PushID(node.name.c_str());
    text(kWhite, node.name);
    ShadowStyle style = node.style;
    bool changed = choose("##technique", fmt::format("technique: {}", to_string(style.technique)),
                          kShadowTechniqueNames, style.technique);
    if (traits_of(style.technique).uses_kernels) {
      changed |= choose("##kernels", fmt::format("kernels: {}", to_string(style.kernels)),
                        kKernelSourceNames, style.kernels);
    }
    if (traits_of(style.technique).uses_lights) {
      changed |= ImGui::Checkbox("light rays", &style.light_rays);
    }
    if (style.technique == ShadowTechnique::walls) {
      bool shown = walls;
      if (ImGui::Checkbox("walls shown (L)", &shown))
        actions.commands.push_back(WindowCommand::walls);
    }
    changed |= workspace_panel(style);
    changed |= strength_panel(node, style);
    if (changed) actions.edits.emplace_back(ShadowStyled{node.name, style});
    ImGui::Separator();
    ImGui::PopID();
  }

  // Sets H and a from the height of the workspace and the middle layer's magnification there.
  bool workspace_panel(ShadowStyle& style) {
    if (!traits_of(style.technique).has_penumbra) return false;
    const std::optional<Workspace> known = workspace_of(style.layered);
    const Workspace workspace = known.value_or(Workspace());
    auto height_cm = static_cast<float>(100.0 * workspace.height_m);
    auto magnification = static_cast<float>(workspace.magnification);
    bool changed =
        ImGui::SliderFloat("##height", &height_cm, 5.0F, 100.0F, "workspace height %.0f cm",
                           ImGuiSliderFlags_AlwaysClamp | ImGuiSliderFlags_Logarithmic);
    changed |= ImGui::SliderFloat("##magnification", &magnification, 1.05F, 4.0F,
                                  "magnified there x %.2f", ImGuiSliderFlags_AlwaysClamp);
    if (changed) {
      const auto constants = layered_constants_for_workspace(0.01 * static_cast<double>(height_cm),
                                                             static_cast<double>(magnification));
      if (constants) {
        const double cap = style.layered.magnification_cap;
        style.layered = *constants;
        style.layered.magnification_cap = cap;
      }
    }
    const LayeredConstants& c = style.layered;
    text(kQuiet,
         std::isinf(c.light_height)
             ? fmt::format("light at the zenith, umbra to {:.2f} m", c.umbra_height)
             : fmt::format("H {:.2f} m   a {:.2f}   umbra {}", c.light_height, c.light_ratio,
                           known ? fmt::format("to {:.2f} m", c.umbra_height)
                                 : std::string("never vanishes")));
    return changed;
  }

  bool strength_panel(const HudNode& node, ShadowStyle& style) {
    const TechniqueTraits traits = traits_of(style.technique);
    if (style.technique == ShadowTechnique::none || traits.uses_lights) return false;
    Strength& strength = strengths[node.name];
    // If another source changed the fractions, the new fractions have full strength.
    if (with_opacity(strength.full, strength.opacity) != style.fractions) {
      strength = {style.fractions, 1.0};
    }
    const auto slider = [](const char* label, double& value) {
      auto shown = static_cast<float>(value);
      ImGui::PushID(label);
      const bool moved =
          ImGui::SliderFloat("##value", &shown, 0.0F, 1.0F, fmt::format("{} %.2f", label).c_str(),
                             ImGuiSliderFlags_AlwaysClamp);
      ImGui::PopID();
      if (!moved) return false;
      value = static_cast<double>(shown);
      return true;
    };
    bool changed = slider("strength", strength.opacity);
    if (traits.has_penumbra) {
      changed |= slider("light in the umbra", strength.full.umbra);
    }
    changed |= slider("light in the middle layer", strength.full.middle);
    if (traits.has_penumbra) {
      changed |= slider("light in the penumbra", strength.full.penumbra);
    }
    if (changed) style.fractions = with_opacity(strength.full, strength.opacity);
    return changed;
  }

  // This is the first panel, so that a small screen shows it without scrolling.
  void smoothing_panel(const HudState& state, HudActions& actions) {
    if (!state.smooth) return;
    bool smooth = *state.smooth;
    if (ImGui::Checkbox("smooth the drawn pose (J)", &smooth)) {
      actions.commands.push_back(WindowCommand::smooth);
    }
    if (state.smoothed) text(kQuiet, smoothing_text(*state.smoothed));
    ImGui::Separator();
  }

  void panels(const HudState& state, const HudPanels& open, HudActions& actions) {
    const float below = open.compact ? buttons_height + 0.3F * em : 0.5F * em;
    float top = 0.5F * em;
    if (open.compact) {
      // On a handheld the panels cover the status, because the sliders need the height.
      const bool handheld = height < static_cast<float>(kHandheldHeight);
      top = handheld ? 0.0F : status_bottom + 0.3F * em;
    }
    // Uses half of the screen if that is wide enough for the texts.
    const bool narrow = 0.46F * width < kPanelWidth * em;
    const ImVec2 max_size(!open.compact ? 19.0F * em : (narrow ? width : 0.46F * width),
                          height - top - below);
    ImGui::SetNextWindowSizeConstraints({max_size.x, 0.0F}, max_size);
    begin_window("shadows", {width - (open.compact ? 0.0F : 0.5F * em), top}, {1.0F, 0.0F},
                 kScrolled);
    ImGui::PushItemWidth(-1.0F);
    ImGui::PushTextWrapPos(0.0F);  // wraps before the scroll bar
    smoothing_panel(state, actions);
    Translucency translucency = state.translucency;
    if (choose("##translucency",
               "translucency: " + translucency_text(state.translucency, state.translucency_drawn),
               kTranslucencyNames, translucency)) {
      actions.translucency = translucency;
    }
    for (const HudNode& node : state.nodes) node_panel(node, state.walls, actions);
    if (state.nodes.empty()) text("the scene has no shadows");
    ImGui::PopTextWrapPos();
    ImGui::PopItemWidth();
    button("close", WindowCommand::panels, actions, {ImGui::GetContentRegionAvail().x, 0.0F});
    end_window();
  }

  // Draws a dot for each kernel, over the image and below every HUD window.
  void kernel_dots(const HudState& state, GlContext::Size size) const {
    if (state.image_width <= 0 || state.image_height <= 0) return;
    const ImageArea area = image_area(state.image_width, state.image_height, size);
    const double scale = static_cast<double>(area.width) / state.image_width;
    ImDrawList& list = *ImGui::GetBackgroundDrawList();
    const ImU32 dot = ImGui::ColorConvertFloat4ToU32(to_imgui(kKernelDot));
    const float radius = std::max(1.5F, 0.12F * em);
    for (const Eigen::Vector2d& pixel : state.kernels_px) {
      // The centre of pixel 0 is at 0.5 in the window.
      const ImVec2 at(static_cast<float>(area.x + scale * (pixel.x() + 0.5)),
                      static_cast<float>(area.y + scale * (pixel.y() + 0.5)));
      list.AddCircleFilled(at, radius, dot, 8);
    }
  }

  void debug(const HudState& state, const HudPanels& open) {
    const float max_width = (open.compact ? 1.0F : 0.5F) * width - em;
    ImGui::SetNextWindowSizeConstraints({14.0F * em, 0.0F},
                                        {max_width, height - status_bottom - 4.0F * em});
    begin_window("debug", {0.5F * em, status_bottom + 0.5F * em}, {0.0F, 0.0F}, kScrolled);
    const CompositeStats& s = state.drawn;
    ImGui::PushTextWrapPos(max_width - em);
    text(
        fmt::format("this frame: {} passes ({} calls), {} skipped; shadows: {} computed, {} reused",
                    s[Counter::passes_drawn], s[Counter::draw_calls], s[Counter::passes_skipped],
                    s[Counter::triples_recomputed], s[Counter::reprojections]));
    std::string work;
    for (const auto& [name, count] : state.work) {
      work += fmt::format("{}{} {}", work.empty() ? "since the start: " : "   ", name, count);
    }
    text(kQuiet, work);
    for (const std::string& line : reason_lines(state)) text(kQuiet, line);
    for (std::size_t i = 0; i < state.twists.size() && i < kMaxDebugLines; ++i) {
      const HudFoldOver& twist = state.twists[i];
      text(twist.twist.faces_twisted > 0 ? kWarning : kQuiet,
           fmt::format("{}: {} of {} faces twisted, {:.1f} % of the area; overshoot {:.1f} %",
                       twist.caster, twist.twist.faces_twisted, twist.twist.faces_tested,
                       100.0 * twist.twist.area_share, 100.0 * twist.spill));
    }
    ImGui::PopTextWrapPos();
    end_window();
  }

  void help(bool compact, HudActions& actions) {
    const bool narrow = compact && width < kHelpWidth * em;
    ImGui::SetNextWindowSizeConstraints({narrow ? width - em : 0.0F, 0.0F},
                                        {width - em, height - em});
    ImGui::PushStyleColor(ImGuiCol_WindowBg, ImVec4(0.05F, 0.06F, 0.08F, 0.94F));
    ImGui::SetNextWindowFocus();
    begin_window("help", {0.5F * width, 0.5F * height}, {0.5F, 0.5F}, kScrolled);
    float column = 0.0F;
    for (const KeyHelp& key : key_help()) {
      column = std::max(column,
                        ImGui::CalcTextSize(key.keys.data(), key.keys.data() + key.keys.size()).x);
    }
    const auto close = [&] {
      button("close", WindowCommand::help, actions, {ImGui::GetContentRegionAvail().x, 0.0F});
    };
    if (compact) {  // visible without scrolling: commands that have a key but no button
      const float half =
          0.5F * (ImGui::GetContentRegionAvail().x - ImGui::GetStyle().ItemSpacing.x);
      button("full screen", WindowCommand::full_screen, actions, {half, 0.0F});
      ImGui::SameLine();
      button("quit", WindowCommand::quit, actions, {half, 0.0F});
      close();
    }
    if (narrow) ImGui::PushTextWrapPos(0.0F);
    const bool columns = width >= kHelpColumns * em;
    for (const KeyHelp& key : key_help()) {
      text(std::string(key.keys));
      if (columns) {
        ImGui::SameLine(column + (narrow ? 1.5F : 2.0F) * em);
      } else {
        ImGui::Indent();
      }
      text(kQuiet, std::string(key.what));
      if (!columns) ImGui::Unindent();
    }
    if (narrow) ImGui::PopTextWrapPos();
    if (!compact) close();
    end_window();
    ImGui::PopStyleColor();
  }

  void message(const HudState& state) {
    if (state.message.empty()) return;
    const float above = buttons_height + em;
    begin_window("message", {0.5F * width, height - above}, {0.5F, 1.0F},
                 kFitted | ImGuiWindowFlags_NoInputs);
    ImGui::PushTextWrapPos(width - 1.2F * em);
    text(state.message);
    ImGui::PopTextWrapPos();
    ImGui::End();
  }

  // Draws a text window without buttons, in the middle or in a corner.
  void text_window(const char* name, bool in_the_middle, const std::vector<std::string>& lines,
                   const HudColor& color) {
    const float gap = 0.5F * em;
    begin_window(name, in_the_middle ? ImVec2(0.5F * width, 0.5F * height) : ImVec2(gap, gap),
                 in_the_middle ? ImVec2(0.5F, 0.5F) : ImVec2(0.0F, 0.0F),
                 kFitted | ImGuiWindowFlags_NoInputs);
    ImGui::PushTextWrapPos(0.8F * width);
    for (const std::string& line : lines) text(color, line);
    ImGui::PopTextWrapPos();
    end_window();
  }

  ImFontAtlas fonts;  // declared before the context that uses it
  ImGuiContext* imgui;
  std::array<ImFont*, kFontSizes.size()> sized{};
  ImFont* font = nullptr;
  float em = 15.0F;                   // font height [px]
  float width = 0.0F, height = 0.0F;  // size of the window [px]
  std::optional<OverlayRenderer> renderer;
  // `pressed` keeps a press that was released before the next drawing.
  std::array<bool, 3> pressed{}, down{};
  std::vector<std::array<float, 4>> windows;  // left, top, right, bottom
  float status_bottom = 0.0F;                 // [px]
  float buttons_height = 0.0F;                // [px]
  struct Strength {
    LightFractions full;
    double opacity = 1.0;
  };
  std::map<std::string, Strength> strengths;  // by node name
  Stopwatch since_last;
};

Overlay::Overlay(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Overlay::~Overlay() = default;

Result<std::unique_ptr<Overlay>> Overlay::create(const GlContext& context) {
  auto impl = std::make_unique<Impl>();
  PENUMBRA_TRY_VOID(impl->open(context));
  return std::unique_ptr<Overlay>(new Overlay(std::move(impl)));
}

void Overlay::handle(const WindowEvent& event) {
  ImGui::SetCurrentContext(impl_->imgui);
  ImGuiIO& io = ImGui::GetIO();
  using Kind = WindowEvent::Kind;
  const bool has_pointer = event.kind == Kind::button_down || event.kind == Kind::button_up ||
                           event.kind == Kind::pointer_moved;
  if (has_pointer) io.MousePos = {static_cast<float>(event.x), static_cast<float>(event.y)};
  switch (event.kind) {
    case Kind::button_down:
    case Kind::button_up:
      if (event.code >= 0 && event.code < 3) {
        const auto button = static_cast<std::size_t>(event.code);
        impl_->down[button] = event.kind == Kind::button_down;
        if (impl_->down[button]) impl_->pressed[button] = true;
      }
      break;
    case Kind::key_down:
    case Kind::key_up:
      if (event.code >= 0 && event.code < IM_ARRAYSIZE(io.KeysDown)) {
        io.KeysDown[event.code] = event.kind == Kind::key_down;
      }
      io.KeyCtrl = event.control;
      io.KeyShift = event.shift;
      io.KeyAlt = event.alt;
      break;
    case Kind::scrolled:
      io.MouseWheelH += static_cast<float>(event.x);
      io.MouseWheel += static_cast<float>(event.y);
      break;
    case Kind::text:
      if (event.code > 0) io.AddInputCharacter(static_cast<unsigned>(event.code));
      break;
    case Kind::pointer_moved:
    case Kind::file_dropped:
      break;
  }
}

bool Overlay::covers(double x, double y) const {
  ImGui::SetCurrentContext(impl_->imgui);
  if (ImGui::IsPopupOpen("", ImGuiPopupFlags_AnyPopup)) return true;
  return std::ranges::any_of(impl_->windows, [x, y](const std::array<float, 4>& window) {
    return x >= static_cast<double>(window[0]) && y >= static_cast<double>(window[1]) &&
           x < static_cast<double>(window[2]) && y < static_cast<double>(window[3]);
  });
}

bool Overlay::typing() const {
  ImGui::SetCurrentContext(impl_->imgui);
  return ImGui::GetIO().WantTextInput;
}

void Overlay::draw(const HudState& state, const HudPanels& panels, GlContext::Size size,
                   HudActions& actions) {
  if (size.width <= 0 || size.height <= 0) return;
  Impl& m = *impl_;
  m.begin_drawing(size, panels.compact);
  if (panels.compact) {
    m.compact_layout(state, actions);
  } else {
    m.full_layout(state, actions);
  }
  // A small window shows only one of help, panels and debug view.
  const bool panels_fit = !panels.compact || !panels.help;
  const bool debug_fits = panels_fit && (!panels.compact || !panels.panels);
  if (panels.debug) m.kernel_dots(state, size);
  if (panels.debug && debug_fits) m.debug(state, panels);
  if (panels.panels && panels_fit) m.panels(state, panels, actions);
  if (panels.help) m.help(panels.compact, actions);
  m.message(state);
  m.end_drawing(size);
}

void Overlay::draw_hidden(const HudState& state, GlContext::Size size) {
  if (size.width <= 0 || size.height <= 0) return;
  const std::vector<std::string> warnings = warnings_of(state);
  if (warnings.empty() && state.message.empty()) return;
  impl_->begin_drawing(size, false);
  if (!warnings.empty()) impl_->text_window("warnings", false, warnings, kWarning);
  impl_->message(state);
  impl_->end_drawing(size);
}

void Overlay::draw_text(const std::string& words, bool in_the_middle, GlContext::Size size) {
  if (size.width <= 0 || size.height <= 0) return;
  impl_->begin_drawing(size, false);
  impl_->text_window("words", in_the_middle, {words}, kWhite);
  impl_->end_drawing(size);
}

void Overlay::draw_custom(GlContext::Size size, const std::function<void(float em)>& lay_out) {
  if (size.width <= 0 || size.height <= 0) return;
  impl_->begin_drawing(size, false);
  lay_out(impl_->em);
  impl_->end_drawing(size);
}

}  // namespace penumbra
