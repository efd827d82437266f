// Changes between two states of a scene, as events of Sudarsky's shadow node
// (docs/shadows.md#shadow-nodes). An event has the kind of change but not the new value.
#pragma once

#include <array>
#include <compare>
#include <string_view>
#include <vector>

#include "render/scene/scene.hpp"

namespace penumbra {

enum class ShadowEventKind {
  light_moved,
  object_moved,
  object_resized,
  object_rotated,
  plane_moved,  // must be last
};
inline constexpr auto kShadowEventNames = std::to_array<std::string_view>(
    {"light_moved", "object_moved", "object_resized", "object_rotated", "plane_moved"});
static_assert(kShadowEventNames.size() ==
              static_cast<std::size_t>(ShadowEventKind::plane_moved) + 1);

struct ShadowEvent {
  ShadowEventKind kind = ShadowEventKind::light_moved;
  int index = 0;  // into Scene::lights, Scene::objects or Scene::planes
  friend auto operator<=>(const ShadowEvent&, const ShadowEvent&) = default;
};

// Returns events in the order lights, objects, planes. An object also moves if its parent or tag
// group does. A plane that is absent in both states has not moved.
[[nodiscard]] std::vector<ShadowEvent> shadow_events(const SceneState& before,
                                                     const SceneState& now);

}  // namespace penumbra
