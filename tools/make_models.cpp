// make_models FOLDER: writes the bundled models (scenes/models/*.glb).
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <vector>

#include "core/text/text.hpp"
#include "tools/models/animated_models.hpp"
#include "tools/models/bundled_models.hpp"
#include "tools/models/glb_writer.hpp"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: make_models FOLDER\n", stderr);
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  const auto write = [&folder](const penumbra::Model& model,
                               const penumbra::Result<std::vector<std::uint8_t>>& bytes) {
    const auto written =
        bytes ? penumbra::write_file(folder / (model.name + ".glb"), *bytes)
              : penumbra::Result<void>(tl::unexpected<penumbra::Error>(bytes.error()));
    if (!written) {
      std::fprintf(stderr, "make_models: %s\n", written.error().message.c_str());
      return false;
    }
    std::size_t vertices = 0;
    std::size_t triangles = 0;
    for (const penumbra::Mesh& mesh : model.meshes) {
      vertices += mesh.positions.size();
      triangles += mesh.indices.size() / 3;
    }
    std::printf("%-24s %6zu vertices %6zu triangles %8zu bytes\n", model.name.c_str(), vertices,
                triangles, bytes->size());
    return true;
  };
  for (const penumbra::Model& model : penumbra::models::make_bundled_models()) {
    if (!write(model, penumbra::models::encode_glb(model))) return 1;
  }
  for (const penumbra::models::MovingModel& moving : penumbra::models::make_moving_models()) {
    if (!write(moving.model, penumbra::models::encode_glb(moving))) return 1;
  }
  return 0;
}
