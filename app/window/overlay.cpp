#include "app/window/overlay.hpp"

#include <fmt/format.h>
#include <imgui.h>

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "app/window/hud_text.hpp"
#include "app/window/overlay_renderer.hpp"
#include "app/window/settings_panel.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/text/text.hpp"
#include "render/gl/framebuffer.hpp"

namespace penumbra {
namespace {

constexpr const char* kFontFile = "/usr/share/fonts/truetype/dejavu/DejaVuSans.ttf";
// Heights of the fonts [px], and of the smallest windows that use each but the first (16:9).
constexpr std::array<float, 5> kFontSizes = {15.0F, 18.0F, 24.0F, 34.0F, 48.0F};
constexpr std::array<int, 4> kFontWindows = {600, 900, 1300, 1800};
constexpr float kTouchHeight = 46.0F;  // height of a touch button [px at a font of 15 px]
constexpr float kMaxLineShare = 0.1F;  // greatest share of the window's height for the status line
constexpr float kHelpWidth = 48.0F;    // [em] narrower windows wrap the lines of the help
constexpr float kHelpColumns = 26.0F;  // [em] narrower windows show a key above its text
constexpr float kPanelWidth = 12.0F;   // [em] narrower panels clip their texts
constexpr int kHandheldHeight = 400;   // [px] in lower windows the panels cover the status
constexpr std::size_t kMaxDebugLines = 10;

constexpr ImGuiWindowFlags kPlain = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoMove |
                                    ImGuiWindowFlags_NoSavedSettings |
                                    ImGuiWindowFlags_NoFocusOnAppearing | ImGuiWindowFlags_NoNav;
constexpr ImGuiWindowFlags kFitted = kPlain | ImGuiWindowFlags_AlwaysAutoResize;
// A window with settings or buttons that take the keyboard: arrow keys choose, Enter presses.
constexpr ImGuiWindowFlags kFocused =
    kFitted & ~(ImGuiWindowFlags_NoNav | ImGuiWindowFlags_NoFocusOnAppearing);
constexpr ImGuiWindowFlags kScrolled = kFitted & ~ImGuiWindowFlags_NoScrollbar;
constexpr ImGuiWindowFlags kScrolledFocused = kFocused & ~ImGuiWindowFlags_NoScrollbar;

constexpr HudColor kKernelDot = {0.25F, 0.85F, 1.0F, 0.9F};

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
    io.ConfigFlags |= ImGuiConfigFlags_NoMouseCursorChange | ImGuiConfigFlags_NavEnableKeyboard;
    io.KeyMap[ImGuiKey_Backspace] = GLFW_KEY_BACKSPACE;
    io.KeyMap[ImGuiKey_Delete] = GLFW_KEY_DELETE;
    io.KeyMap[ImGuiKey_Enter] = GLFW_KEY_ENTER;
    io.KeyMap[kKeypadEnter] = GLFW_KEY_KP_ENTER;
    io.KeyMap[ImGuiKey_Escape] = GLFW_KEY_ESCAPE;
    io.KeyMap[ImGuiKey_LeftArrow] = GLFW_KEY_LEFT;
    io.KeyMap[ImGuiKey_RightArrow] = GLFW_KEY_RIGHT;
    io.KeyMap[ImGuiKey_UpArrow] = GLFW_KEY_UP;
    io.KeyMap[ImGuiKey_DownArrow] = GLFW_KEY_DOWN;
    io.KeyMap[ImGuiKey_Space] = GLFW_KEY_SPACE;
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
    const auto at = static_cast<std::size_t>(
        std::ranges::count_if(kFontWindows, [&](int least) { return wide_height >= least; }));
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
    style.Colors[ImGuiCol_WindowBg] = {0.05F, 0.06F, 0.08F, 0.58F};
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
    panels_left = width;
    ImGui::NewFrame();
    for (const int code : released) io.KeysDown[code] = false;
    released.clear();
    ImGui::PushFont(font);
  }
  void end_drawing(GlContext::Size size) {
    ImGui::PopFont();
    ImGui::Render();
    renderer->draw(*ImGui::GetDrawData(), size);
  }

  void set_key(int code, bool is_down) {
    ImGuiIO& io = ImGui::GetIO();
    if (code < 0 || code >= IM_ARRAYSIZE(io.KeysDown)) return;
    if (is_down) {
      io.KeysDown[code] = true;
      std::erase(released, code);
    } else {
      released.push_back(code);
    }
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

  // Height of a button for fingers [px]; the status line may not cover more of a low window.
  [[nodiscard]] float touch_height() const {
    return std::max(std::min(kTouchHeight * em / kFontSizes[0], std::floor(kMaxLineShare * height)),
                    1.3F * em);
  }

  // Draws the line that is always shown: the menu's button, the state, the frame rate, and what to
  // do next.
  void status_line(const HudState& state, bool compact, HudActions& actions) {
    const float gap = compact ? 0.0F : 0.5F * em;
    ImGui::PushStyleVar(ImGuiStyleVar_WindowMinSize, ImVec2(1.0F, 1.0F));
    ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, ImVec2(compact ? 0.0F : 0.3F * em, 0.0F));
    ImGui::PushStyleVar(
        ImGuiStyleVar_FramePadding,
        compact ? ImVec2(0.7F * em, 0.5F * (touch_height() - em)) : ImVec2(0.5F * em, 0.35F * em));
    const StatusLine line = status_line_of(state);
    std::vector<std::pair<HudColor, std::string>> parts = {{line.state.color, line.state.text}};
    if (!line.rate.empty()) parts.emplace_back(kHudWhite, line.rate);
    if (!line.recording.empty()) parts.emplace_back(kHudWarning, line.recording);
    parts.emplace_back(line.warns ? kHudWarning : kHudQuiet, line.next);
    const float space = 0.8F * em;
    const ImGuiStyle& style = ImGui::GetStyle();
    const auto total = [&] {
      float sum = ImGui::CalcTextSize("Menu").x + 2.0F * style.FramePadding.x + space;
      for (const auto& [color, words] : parts) sum += ImGui::CalcTextSize(words.c_str()).x + space;
      return sum;
    };
    const float max_width = width - 2.0F * gap;
    // A narrow window has room for the advice, or the fault, in place of the rate.
    if (total() > max_width && !line.rate.empty()) parts.erase(parts.begin() + 1);
    // Sized here: a window that fits itself to its text cuts a longer one for a frame.
    ImGui::SetNextWindowSize({std::min(total(), max_width), em + 2.0F * style.FramePadding.y});
    begin_window("line", {gap, gap}, {0.0F, 0.0F}, kPlain);
    button("Menu", WindowCommand::menu, actions);
    for (auto& [color, words] : parts) {
      ImGui::SameLine(0.0F, space);
      const float left = gap + max_width - 0.3F * em - ImGui::GetCursorScreenPos().x;
      ImGui::AlignTextToFramePadding();
      hud_text(color, that_fits(std::move(words), left));
    }
    line_bottom = status_bottom = ImGui::GetWindowPos().y + ImGui::GetWindowSize().y;
    end_window();
    ImGui::PopStyleVar(3);
  }

  // Cuts the end of a text that is too long.
  static std::string that_fits(std::string words, float max_width) {
    if (ImGui::CalcTextSize(words.c_str()).x <= max_width) return words;
    while (!words.empty() && ImGui::CalcTextSize((words + "...").c_str()).x > max_width)
      words = std::string(first_characters(words, words.size() - 1));
    return words.empty() ? words : words + "...";
  }

  void details(const HudState& state, bool compact) {
    const float gap = compact ? 0.0F : 0.5F * em;
    begin_window("details", {gap, status_bottom + 0.3F * em}, {0.0F, 0.0F}, kFitted);
    ImGui::PushTextWrapPos(compact ? width - em : 0.45F * width);
    const HudStatus status = status_of(state);
    hud_text(status.color, status.text);
    std::string line = fmt::format("{:.1f} frames/s", state.frames_per_s);
    if (const std::string age = age_text(state); !age.empty()) line += "   " + age;
    hud_text(line + "   " + frame_number_text(state));
    hud_text(measured_tags(state.pose));
    if (state.smoothed) hud_text(kHudQuiet, smoothing_text(*state.smoothed));
    for (const GroupEstimate& group : state.groups) {
      const HudStatus of_group = status_of(group);
      hud_text(of_group.color, of_group.text);
    }
    hud_text("shadows: " + technique_text(state.nodes));
    if (const std::string times = stage_times(state); !times.empty()) hud_text(kHudQuiet, times);
    camera_and_recording(state);
    ImGui::PopTextWrapPos();
    status_bottom = ImGui::GetWindowPos().y + ImGui::GetWindowSize().y;
    end_window();
  }

  static void camera_and_recording(const HudState& state) {
    if (state.live) {
      const std::string faults = count_of_faults(state);
      hud_text(kHudQuiet, fmt::format("dropped {}{}", state.frames_dropped,
                                      faults.empty() ? "" : "   camera:" + faults));
      if (state.trouble) hud_text(kHudWarning, "camera: " + *state.trouble);
    }
    if (state.recording) {
      const HudRecording& recording = *state.recording;
      hud_text(kHudWarning, recording_text(recording));
      if (recording.error) hud_text(kHudWarning, *recording.error);
    }
    if (!state.selected.empty()) {
      hud_text(kHudQuiet,
               fmt::format("selected: {}   drag: {}", state.selected, command_of(state.drag).name));
    }
  }

  // Draws the menu's buttons along the lower edge: all of one size for fingers in the compact
  // layout, else each as wide as its label, which names the key.
  void menu(const HudState& state, bool compact, HudActions& actions) {
    const std::vector<MenuEntry> entries = menu_of(state);
    const float gap = compact ? 0.0F : 0.5F * em;
    ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, ImVec2(0.2F * em, 0.2F * em));
    ImGui::PushStyleVar(ImGuiStyleVar_ItemSpacing, ImVec2(0.2F * em, 0.2F * em));
    ImGui::PushStyleVar(ImGuiStyleVar_FramePadding,
                        compact ? ImVec2(0.1F * em, 0.1F * em) : ImVec2(0.5F * em, 0.35F * em));
    ImGui::SetNextWindowSize({width - 2.0F * gap, 0.0F});
    begin_window("menu", {gap, height - gap}, {0.0F, 1.0F},
                 kFocused & ~ImGuiWindowFlags_AlwaysAutoResize);
    if (compact) {
      button_grid(entries, actions);
    } else {
      const float right = ImGui::GetCursorScreenPos().x + ImGui::GetContentRegionAvail().x;
      for (std::size_t i = 0; i < entries.size(); ++i) {
        const std::string label = fmt::format("{} ({})###{}", entries[i].label, entries[i].key,
                                              static_cast<int>(entries[i].command));
        const float wide = ImGui::CalcTextSize(label.c_str(), nullptr, true).x +
                           2.0F * ImGui::GetStyle().FramePadding.x;
        if (i > 0 && ImGui::GetItemRectMax().x + 0.2F * em + wide <= right) ImGui::SameLine();
        button(label, entries[i].command, actions);
      }
    }
    buttons_height = ImGui::GetWindowSize().y;
    end_window();
    ImGui::PopStyleVar(3);
  }

  void button_grid(const std::vector<MenuEntry>& entries, HudActions& actions) {
    // The longest label determines the number of rows: no button moves when its label changes.
    float widest = 0.0F;
    for (const MenuEntry& entry : entries)
      widest = std::max(widest, ImGui::CalcTextSize(entry.longest).x + 0.4F * em);
    const auto width_of = [&](std::size_t in_row) {
      const auto count = static_cast<float>(in_row);
      return std::floor((ImGui::GetContentRegionAvail().x - (count - 1.0F) * 0.2F * em) / count);
    };
    std::size_t in_row = entries.size();
    while (in_row > 2 && width_of(in_row) < widest) --in_row;
    const std::size_t rows = (entries.size() + in_row - 1) / in_row;
    in_row = (entries.size() + rows - 1) / rows;
    constexpr float kMaxMenuShare = 0.55F;  // of the window's height
    const float high = std::min(kTouchHeight * em / kFontSizes[0],
                                kMaxMenuShare * height / static_cast<float>(rows));
    const ImVec2 each(width_of(in_row), std::max(std::floor(high), 1.5F * em));
    for (std::size_t i = 0; i < entries.size(); ++i) {
      if (i % in_row > 0) ImGui::SameLine();
      button(fmt::format("{}###{}", that_fits(entries[i].label, each.x - 0.2F * em),
                         static_cast<int>(entries[i].command)),
             entries[i].command, actions, each);
    }
  }

  // Draws the only button of a locked kiosk, which chooses what a finger's drag does.
  void kiosk_button(const HudState& state, HudActions& actions) {
    const bool slides = state.drag == DragMode::slide;
    ImGui::PushStyleVar(ImGuiStyleVar_WindowPadding, ImVec2(0.2F * em, 0.2F * em));
    begin_window("kiosk", {width, height}, {1.0F, 1.0F}, kFitted);
    button(slides ? "Drag objects: along the table###drag" : "Drag objects: up and sideways###drag",
           slides ? WindowCommand::lift : WindowCommand::slide, actions,
           {17.0F * em, kTouchHeight * em / kFontSizes[0]});
    end_window();
    ImGui::PopStyleVar();
  }

  void panels(const HudState& state, const HudPanels& open, HudActions& actions) {
    const float below = open.menu ? buttons_height + 0.3F * em : 0.5F * em;
    // On a handheld the panels cover the status, because the sliders need the height.
    const bool handheld = open.compact && height < static_cast<float>(kHandheldHeight);
    const float top = handheld ? 0.0F : line_bottom + 0.3F * em;
    // Uses half of the screen if that is wide enough for the texts.
    const bool narrow = 0.46F * width < kPanelWidth * em;
    const ImVec2 max_size(!open.compact ? 19.0F * em : (narrow ? width : 0.46F * width),
                          height - top - below);
    ImGui::SetNextWindowSizeConstraints({max_size.x, 0.0F}, max_size);
    begin_window("shadows", {width - (open.compact ? 0.0F : 0.5F * em), top}, {1.0F, 0.0F},
                 kScrolledFocused);
    ImGui::PushItemWidth(-1.0F);
    ImGui::PushTextWrapPos(0.0F);  // wraps before the scroll bar
    settings.draw(state, actions);
    ImGui::PopTextWrapPos();
    ImGui::PopItemWidth();
    button("close", WindowCommand::panels, actions, {ImGui::GetContentRegionAvail().x, 0.0F});
    panels_left = ImGui::GetWindowPos().x;
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
                                        {max_width, height - status_bottom - buttons_height - em});
    begin_window("debug", {0.5F * em, status_bottom + 0.5F * em}, {0.0F, 0.0F}, kScrolled);
    const CompositeStats& s = state.drawn;
    ImGui::PushTextWrapPos(max_width - em);
    hud_text(
        fmt::format("this frame: {} passes ({} calls), {} skipped; shadows: {} computed, {} reused",
                    s[Counter::passes_drawn], s[Counter::draw_calls], s[Counter::passes_skipped],
                    s[Counter::triples_recomputed], s[Counter::reprojections]));
    std::string work;
    for (const auto& [name, count] : state.work) {
      work += fmt::format("{}{} {}", work.empty() ? "since the start: " : "   ", name, count);
    }
    hud_text(kHudQuiet, work);
    for (const std::string& line : reason_lines(state)) hud_text(kHudQuiet, line);
    for (std::size_t i = 0; i < state.twists.size() && i < kMaxDebugLines; ++i) {
      const HudFoldOver& twist = state.twists[i];
      hud_text(twist.twist.faces_twisted > 0 ? kHudWarning : kHudQuiet,
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
    ImGui::PushStyleColor(ImGuiCol_WindowBg, ImVec4(0.05F, 0.06F, 0.08F, 0.98F));
    ImGui::SetNextWindowFocus();
    begin_window("help", {0.5F * width, 0.5F * height}, {0.5F, 0.5F}, kScrolledFocused);
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
      hud_text(std::string(key.keys));
      if (columns) {
        ImGui::SameLine(column + (narrow ? 1.5F : 2.0F) * em);
      } else {
        ImGui::Indent();
      }
      hud_text(kHudQuiet, std::string(key.what));
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
    // Beside the panels if there is room.
    const float room = panels_left > 12.0F * em ? panels_left : width;
    const float wrap = room - 2.4F * em;
    const ImVec2 text = ImGui::CalcTextSize(state.message.c_str(), nullptr, false, wrap);
    const ImVec2 padding = ImGui::GetStyle().WindowPadding;
    ImGui::SetNextWindowSize({text.x + 2.0F * padding.x + 1.0F, text.y + 2.0F * padding.y});
    begin_window("message", {0.5F * room, height - above}, {0.5F, 1.0F},
                 kPlain | ImGuiWindowFlags_NoInputs);
    ImGui::PushTextWrapPos(padding.x + wrap);
    hud_text(state.message);
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
    for (const std::string& line : lines) hud_text(color, line);
    ImGui::PopTextWrapPos();
    ImGui::End();
  }

  ImFontAtlas fonts;  // declared before the context that uses it
  ImGuiContext* imgui;
  std::array<ImFont*, kFontSizes.size()> sized{};
  ImFont* font = nullptr;
  float em = 15.0F;                   // font height [px]
  float width = 0.0F, height = 0.0F;  // size of the window [px]
  std::optional<OverlayRenderer> renderer;
  // `pressed` and `released` keep presses that end before the next drawing: of buttons, and of keys
  // by their codes.
  std::array<bool, 3> pressed{}, down{};
  std::vector<int> released;
  std::vector<std::array<float, 4>> windows;  // left, top, right, bottom
  float line_bottom = 0.0F;                   // of the status line [px]
  float status_bottom = 0.0F;                 // of the line or the details [px]
  float panels_left = 0.0F;                   // [px]; the window's width if no panel is open
  float buttons_height = 0.0F;                // [px]
  SettingsPanel settings;
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
      impl_->set_key(event.code, event.kind == Kind::key_down);
      // Enter presses the button that has the keyboard focus, as the space bar does.
      if (event.code == GLFW_KEY_ENTER || event.code == GLFW_KEY_KP_ENTER) {
        const bool presses = event.kind == Kind::key_down && !io.WantTextInput;
        if (presses || event.kind == Kind::key_up) impl_->set_key(GLFW_KEY_SPACE, presses);
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

bool Overlay::takes_key(int code) const {
  ImGui::SetCurrentContext(impl_->imgui);
  const ImGuiIO& io = ImGui::GetIO();
  constexpr std::array kFocusKeys = {GLFW_KEY_UP,      GLFW_KEY_DOWN,  GLFW_KEY_LEFT,
                                     GLFW_KEY_RIGHT,   GLFW_KEY_SPACE, GLFW_KEY_ENTER,
                                     GLFW_KEY_KP_ENTER};
  if (code == GLFW_KEY_ESCAPE) {
    return io.WantTextInput || ImGui::IsPopupOpen("", ImGuiPopupFlags_AnyPopup);  // closes the list
  }
  return io.WantTextInput ||
         (io.NavVisible && std::ranges::find(kFocusKeys, code) != kFocusKeys.end());
}

void Overlay::draw(const HudState& state, const HudPanels& panels, GlContext::Size size,
                   HudActions& actions) {
  if (size.width <= 0 || size.height <= 0) return;
  Impl& m = *impl_;
  m.begin_drawing(size, panels.compact);
  m.status_line(state, panels.compact, actions);
  if (panels.details) m.details(state, panels.compact);
  m.buttons_height = 0.0F;
  if (panels.menu) m.menu(state, panels.compact, actions);
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

void Overlay::draw_kiosk(const HudState& state, GlContext::Size size, HudActions& actions) {
  if (size.width <= 0 || size.height <= 0) return;
  impl_->begin_drawing(size, true);
  impl_->buttons_height = 0.0F;
  std::vector<std::string> lines = warnings_of(state);
  const bool warns = !lines.empty();
  // A visitor who sees no objects learns how to get them back.
  if (!warns && state.has_image && state.pose.status == TrackStatus::lost)
    lines.emplace_back("point the camera at the sheet of tags");
  if (!lines.empty()) impl_->text_window("warnings", false, lines, warns ? kHudWarning : kHudWhite);
  if (state.has_image) impl_->kiosk_button(state, actions);
  impl_->message(state);
  impl_->end_drawing(size);
}

void Overlay::draw_hidden(const HudState& state, GlContext::Size size) {
  if (size.width <= 0 || size.height <= 0) return;
  const std::vector<std::string> warnings = warnings_of(state);
  if (warnings.empty() && state.message.empty()) return;
  impl_->begin_drawing(size, false);
  if (!warnings.empty()) impl_->text_window("warnings", false, warnings, kHudWarning);
  impl_->message(state);
  impl_->end_drawing(size);
}

void Overlay::draw_text(const std::string& words, bool in_the_middle, GlContext::Size size) {
  if (size.width <= 0 || size.height <= 0) return;
  impl_->begin_drawing(size, false);
  impl_->text_window("words", in_the_middle, {words}, kHudWhite);
  impl_->end_drawing(size);
}

void Overlay::draw_custom(GlContext::Size size, const std::function<void(float em)>& lay_out) {
  if (size.width <= 0 || size.height <= 0) return;
  impl_->begin_drawing(size, false);
  lay_out(impl_->em);
  impl_->end_drawing(size);
}

}  // namespace penumbra
