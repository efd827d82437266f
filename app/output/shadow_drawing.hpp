// A vector drawing of a shadow: its layers, the object's outline and, optionally, the kernels.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/layers/layer_polygons.hpp"

namespace penumbra {

struct ShadowDrawing {
  using Layer = NamedOutline;
  std::string title;
  std::string subtitle;                  // smaller text below the title; may be empty
  std::vector<Layer> layers;             // in drawing order: largest first
  LayerOutline object;                   // outline seen from straight above
  std::vector<Eigen::Vector2d> kernels;  // drawn as dots [m]
};

// Returns SVG 1.1 at full scale, with one group per layer that has the layer's name.
[[nodiscard]] std::string shadow_svg(const ShadowDrawing& drawing);
// Writes the drawing as a PNG; its longer side has about 1200 pixels.
[[nodiscard]] Result<void> write_shadow_png(const std::filesystem::path& file,
                                            const ShadowDrawing& drawing);

}  // namespace penumbra
