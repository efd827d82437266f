// Draws the shadow layers of a model that floats HEIGHT metres above the table, as SVG in
// millimetres:
//   shadow_to_svg helicopter.glb 0.1 > shadow.svg
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <penumbra/shadow.hpp>
#include <string>
#include <vector>

namespace shadow = penumbra::shadow;

// SVG's y axis points down, and lengths are millimetres.
void print_ring(const std::vector<shadow::Vector2>& ring) {
  char command = 'M';
  for (const auto& [u, v] : ring) {
    std::printf("%c%.3f %.3f", command, 1e3 * u, -1e3 * v);
    command = 'L';
  }
  std::printf("Z");
}

int main(int argc, char** argv) try {
  if (argc != 3) {
    std::fprintf(stderr, "usage: shadow_to_svg MODEL HEIGHT > FILE.svg\n");
    return 2;
  }
  const auto model = shadow::Model::load(argv[1]);
  shadow::Options options;
  options.T_world_object.position = {0.0, 0.0, std::atof(argv[2])};
  // The umbra vanishes 0.3 m above the table, where the middle layer is magnified 1.5 times.
  options.light = shadow::light_for_workspace(0.3, 1.5);
  const shadow::Shadow result = shadow::cast(model, options);
  for (const std::string& warning : result.warnings) std::fprintf(stderr, "%s\n", warning.c_str());

  std::printf("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-200 -200 400 400\">\n");
  for (auto layer = result.layers.rbegin(); layer != result.layers.rend();
       ++layer) {  // the largest first
    std::printf("<path id=\"%s\" fill-opacity=\"0.3\" fill-rule=\"evenodd\" d=\"",
                layer->name.c_str());
    for (const shadow::Polygon& polygon : layer->polygons) {
      print_ring(polygon.outer);
      for (const auto& hole : polygon.holes) print_ring(hole);
    }
    std::printf("\"/>\n");
  }
  std::printf("</svg>\n");
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "shadow_to_svg: %s\n", error.what());
  return 1;
}
