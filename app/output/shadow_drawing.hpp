// A drawing of a shadow: its layers, the object's outline and, optionally, the kernels.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/layers/layer_polygons.hpp"

namespace penumbra {

struct ShadowDrawing {
  struct Layer {
    std::string name;  // "umbra", "middle", "penumbra", "shadow"
    LayerOutline outline;
  };
  std::string title;
  std::string subtitle;                  // below it, smaller; may be empty
  std::vector<Layer> layers;             // in drawing order: the largest first
  LayerOutline object;                   // seen straight down
  std::vector<Eigen::Vector2d> kernels;  // dots [m]
};

// SVG 1.1 at full scale: a group per layer, named after it.
[[nodiscard]] std::string shadow_svg(const ShadowDrawing& picture);
// The same as a PNG of about 1200 pixels across.
[[nodiscard]] Result<void> write_shadow_png(const std::filesystem::path& file,
                                            const ShadowDrawing& picture);

}  // namespace penumbra
