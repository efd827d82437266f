// Reference for recomputation: lists the shadows that a change in the scene affects.
#pragma once

#include <algorithm>
#include <compare>
#include <vector>

#include "render/scene/scene.hpp"
#include "render/scene/shadow_events.hpp"

namespace penumbra::test {

// One shadow: a caster on a plane from a light.
struct ShadowTriple {
  int object = 0, plane = 0, light = 0;  // indices into the scene
  friend auto operator<=>(const ShadowTriple&, const ShadowTriple&) = default;
};
// Returns the node's triples that contain an event's object, plane or light, sorted and without
// duplicates. The lights are the node's, or the scene's first light if the node has none.
inline std::vector<ShadowTriple> affected_triples(const Scene& scene, const ShadowNode& node,
                                                  const std::vector<ShadowEvent>& events) {
  std::vector<int> lights = node.lights;
  if (lights.empty() && !scene.lights.empty()) lights = {0};
  std::vector<ShadowTriple> triples;
  for (const int object : node.casters) {
    for (const int plane : node.planes) {
      for (const int light : lights) {
        const bool named = std::ranges::any_of(events, [&](const ShadowEvent& event) {
          switch (event.kind) {
            case ShadowEventKind::light_moved:
              return event.index == light;
            case ShadowEventKind::plane_moved:
              return event.index == plane;
            default:
              return event.index == object;
          }
        });
        if (named) triples.push_back({object, plane, light});
      }
    }
  }
  std::ranges::sort(triples);
  const auto repeated = std::ranges::unique(triples);
  triples.erase(repeated.begin(), repeated.end());
  return triples;
}

}  // namespace penumbra::test
