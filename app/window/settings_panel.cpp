#include "app/window/settings_panel.hpp"

#include <fmt/format.h>
#include <imgui.h>

#include <cmath>

#include "app/window/hud_text.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {
namespace {

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
  hud_text(kHudQuiet,
           std::isinf(c.light_height)
               ? fmt::format("light at the zenith, umbra to {:.2f} m", c.umbra_height)
               : fmt::format("H {:.2f} m   a {:.2f}   umbra {}", c.light_height, c.light_ratio,
                             known ? fmt::format("to {:.2f} m", c.umbra_height)
                                   : std::string("never vanishes")));
  return changed;
}

void smoothing_panel(const HudState& state, HudActions& actions) {
  if (!state.smooth) return;
  bool smooth = *state.smooth;
  if (ImGui::Checkbox("smooth the drawn pose (J)", &smooth)) {
    actions.commands.push_back(WindowCommand::smooth);
  }
  if (state.smoothed) hud_text(kHudQuiet, smoothing_text(*state.smoothed));
  ImGui::Separator();
}

}  // namespace

void SettingsPanel::draw(const HudState& state, HudActions& actions) {
  // The first settings, so that a small screen shows them without scrolling.
  smoothing_panel(state, actions);
  Translucency translucency = state.translucency;
  if (choose("##translucency",
             "translucency: " + translucency_text(state.translucency, state.translucency_drawn),
             kTranslucencyNames, translucency)) {
    actions.translucency = translucency;
  }
  for (const HudNode& node : state.nodes) node_panel(node, state.walls, actions);
  if (state.nodes.empty()) hud_text("the scene has no shadows");
}

void SettingsPanel::node_panel(const HudNode& node, bool walls, HudActions& actions) {
  ImGui::PushID(node.name.c_str());
  hud_text(kHudWhite, node.name);
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

bool SettingsPanel::strength_panel(const HudNode& node, ShadowStyle& style) {
  const TechniqueTraits traits = traits_of(style.technique);
  if (style.technique == ShadowTechnique::none || traits.uses_lights) return false;
  Strength& strength = strengths_[node.name];
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

}  // namespace penumbra
