#include "app/run/run_scene.hpp"

#include <fmt/format.h>

#include <cstdio>
#include <utility>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/shadow/kernels/kernel_file.hpp"

namespace penumbra {

Result<RunScene> load_run_scene(const RunRequest& request, const TagMap* tags) {
  PENUMBRA_TRY(Scene scene, load_scene(request.scene));
  RunScene loaded;
  for (const ObjectRequest& object : request.objects) {
    if (request.saved_scene && as_utf8(object.file.string()) != object.file.string()) {
      return fail("{}: its name is not UTF-8, so --save-scene can't write it; rename the file",
                  as_utf8(object.file.string()));
    }
    PENUMBRA_TRY(NewObject added, load_object(object, scene, sheet_area(tags)));
    fmt::print("object: {}: {}\n", object.file.string(), added.description);
    apply(scene, added.edit);
    loaded.added.push_back(std::move(added.edit));
  }
  std::fflush(stdout);
  if (!request.objects.empty() && scene.shadows.empty()) {
    log_warning("{}: has no shadow node, so added objects cast no shadow; add one to \"shadows\"",
                request.scene.string());
  }
  if (request.kernel_file) {
    PENUMBRA_TRY(const KernelFile kernels, load_kernel_file(*request.kernel_file));
    PENUMBRA_TRY_VOID(attach_kernels_to_scene(scene, kernels, request.kernel_file->string()));
  }
  loaded.scene = std::make_shared<const Scene>(std::move(scene));
  return loaded;
}

std::vector<std::filesystem::path> model_files(const Scene& scene) {
  std::vector<std::filesystem::path> files;
  for (const SceneObject& object : scene.objects) {
    for (const Model* model : {object.model.get(), object.proxy_model.get()}) {
      if (model != nullptr) files.insert(files.end(), model->files.begin(), model->files.end());
    }
  }
  return files;
}

}  // namespace penumbra
