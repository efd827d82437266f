// Shadow layers as JSON, SVG or PNG.
#pragma once

#include <string>

#include "app/offline_shadow.hpp"

namespace penumbra {

[[nodiscard]] std::string layers_json(const OfflineShadow& shadow);

struct DrawingOptions {
  bool kernels = false;  // as dots
};
// Flat layers on paper, the object's outline, a scale bar; millimetres.
[[nodiscard]] std::string layers_svg(const OfflineShadow& shadow, const DrawingOptions& options);

// By the file's extension: .json, .svg or .png.
[[nodiscard]] Result<void> write_layers(const OfflineShadow& shadow,
                                        const std::filesystem::path& file,
                                        const DrawingOptions& options);

}  // namespace penumbra
