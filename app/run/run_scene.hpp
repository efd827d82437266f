// The scene of a run: its file and the objects of --object.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "app/run/run_request.hpp"
#include "app/session/placed_object.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

struct RunScene {
  std::shared_ptr<const Scene> scene;
  std::vector<ObjectAdded> added;  // the objects of --object, which the scene contains
};

// Loads the scene and adds the requested objects; prints a line about each. The kernel file
// replaces the kernels of casters that have its vertex count. `tags`: nullptr if there are none.
[[nodiscard]] Result<RunScene> load_run_scene(const RunRequest& request, const TagMap* tags);

// Returns the files of the scene's models.
[[nodiscard]] std::vector<std::filesystem::path> model_files(const Scene& scene);

}  // namespace penumbra
