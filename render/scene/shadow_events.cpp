#include "render/scene/shadow_events.hpp"

#include <algorithm>

#include "core/assert.hpp"

namespace penumbra {

std::vector<ShadowEvent> shadow_events(const SceneState& before, const SceneState& now) {
  PENUMBRA_ASSERT(before.objects.size() == now.objects.size());
  PENUMBRA_ASSERT(before.lights.size() == now.lights.size());
  std::vector<ShadowEvent> events;
  const auto add = [&events](ShadowEventKind kind, std::size_t index, bool happened) {
    if (happened) events.push_back({kind, static_cast<int>(index)});
  };
  for (std::size_t i = 0; i < now.lights.size(); ++i) {
    add(ShadowEventKind::light_moved, i, before.lights[i].position != now.lights[i].position);
  }
  for (std::size_t i = 0; i < now.objects.size(); ++i) {
    const Placement& a = before.objects[i];
    const Placement& b = now.objects[i];
    add(ShadowEventKind::object_moved, i, a.position != b.position);
    add(ShadowEventKind::object_resized, i, a.scale != b.scale);
    add(ShadowEventKind::object_rotated, i, a.rotation.coeffs() != b.rotation.coeffs());
  }
  for (std::size_t i = 0; i < std::min(before.planes.size(), now.planes.size()); ++i) {
    const PlacedPlane& a = before.planes[i];
    const PlacedPlane& b = now.planes[i];
    const bool visible = a.opacity > 0.0 || b.opacity > 0.0;
    add(ShadowEventKind::plane_moved, i,
        visible && (a.frame.n != b.frame.n || a.frame.q != b.frame.q || a.frame.e1 != b.frame.e1));
  }
  return events;
}

}  // namespace penumbra
