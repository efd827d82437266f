// A flat picture of a shadow: its layers, the object's outline and, if wanted, the kernels.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/shadow/layers/layer_polygons.hpp"

namespace penumbra {

struct ShadowPicture {
  struct Layer {
    std::string name;  // "umbra", "middle", "penumbra", "shadow"
    LayerOutline outline;
  };
  std::string title;
  std::string subtitle;                  // below it, smaller; may be empty
  std::vector<Layer> layers;             // in the order of painting: the largest first
  LayerOutline object;                   // seen straight down
  std::vector<Eigen::Vector2d> kernels;  // dots [m]
};

// SVG 1.1: a group for each layer, named after it; metres become millimetres on paper, so that
// lengths can be measured in it.
[[nodiscard]] std::string shadow_svg(const ShadowPicture& picture);
// The same picture as a PNG of about 1200 pixels across.
[[nodiscard]] Result<void> write_shadow_png(const std::filesystem::path& file,
                                            const ShadowPicture& picture);

}  // namespace penumbra
