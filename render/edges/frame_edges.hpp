// Collects the edges of what a plan draws, as lines in the image.
#pragma once

#include <functional>
#include <map>
#include <vector>

#include "render/edges/edge_blender.hpp"
#include "render/edges/edge_mesh.hpp"
#include "render/edges/screen_map.hpp"
#include "render/frame_plan.hpp"
#include "render/passes/casting_models.hpp"

namespace penumbra {

class FrameEdges {
 public:
  using EdgesOf = std::function<ObjectEdges(int object)>;

  // Returns the edges of objects, and of the hard shadows and shadow volumes if `shadows`.
  [[nodiscard]] std::vector<EdgeGroup> of(const Scene& scene, const FramePlan& plan,
                                          const ScreenMap& screen, const EdgesOf& edges_of,
                                          bool shadows);

 private:
  // A caster seen from a light: edges a -> b in the table frame.
  struct LightEdge {
    Eigen::Vector3d a, b;
  };
  [[nodiscard]] std::vector<LightEdge> seen_from_light(const Scene& scene, const LitCaster& caster);

  CastingModels<EdgeMesh> casters_;
};

}  // namespace penumbra
