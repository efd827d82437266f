// Settings of the window's panel: smoothing, translucency, and for each shadow node its technique,
// kernels, light and strength.
#pragma once

#include <map>
#include <string>

#include "app/window/hud.hpp"

namespace penumbra {

class SettingsPanel {
 public:
  // Draws the settings into the current Dear ImGui window. Adds changes to `actions`.
  void draw(const HudState& state, HudActions& actions);

 private:
  void node_panel(const HudNode& node, bool walls, HudActions& actions);
  [[nodiscard]] bool strength_panel(const HudNode& node, ShadowStyle& style);

  // Fractions of light at full strength, and the strength that the user chose.
  struct Strength {
    LightFractions full;
    double opacity = 1.0;
  };
  std::map<std::string, Strength> strengths_;  // by node name
};

}  // namespace penumbra
