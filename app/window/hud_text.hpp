// Text of the window's Dear ImGui panels.
// Include in .cpp files only, because it includes Dear ImGui.
#pragma once

#include <imgui.h>

#include <string>

#include "app/window/hud.hpp"

namespace penumbra {

inline constexpr HudColor kHudWhite = {1.0F, 1.0F, 1.0F, 1.0F};
inline constexpr HudColor kHudQuiet = {0.72F, 0.76F, 0.80F, 1.0F};
inline constexpr HudColor kHudWarning = {1.0F, 0.55F, 0.45F, 1.0F};

inline ImVec4 to_imgui(const HudColor& color) {
  return {color.red, color.green, color.blue, color.alpha};
}

// Draws a line, or several if the text wraps.
inline void hud_text(const std::string& line) {
  ImGui::TextUnformatted(line.data(), line.data() + line.size());
}
inline void hud_text(const HudColor& color, const std::string& line) {
  ImGui::PushStyleColor(ImGuiCol_Text, to_imgui(color));
  hud_text(line);
  ImGui::PopStyleColor();
}

}  // namespace penumbra
