// Writes the present arrangement of a scene as a scene file.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>

#include "core/error.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct SceneToWrite {
  const Scene& now;    // with all edits
  const Scene& start;  // as loaded, without edits
  // Options of the run that hold in place of a node's own settings.
  std::function<ShadowStyle(const ShadowNode&)> style_of;
  std::optional<LightMode> light_mode;
};

// Returns the text of a scene file for the folder `folder`: the file of `start` with moved objects,
// changed shadows and added objects. load_scene() reads the same arrangement from it. Paths of
// models become relative to `folder` ("": the current one). Fails if `start` has no file, or if the
// schema does not allow the arrangement.
[[nodiscard]] Result<std::string> scene_text(const SceneToWrite& scene,
                                             const std::filesystem::path& folder);

}  // namespace penumbra
