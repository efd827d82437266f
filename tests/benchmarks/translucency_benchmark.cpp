// Pattern quality of shadows without blending. For each layer, drawn alone, measures the fraction
// of black pixels in windows of 16 x 16 px, and the pixels inside the layer that change when the
// camera moves by 0.37 px.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

constexpr int kSide = 480;
constexpr double kFocal_px = 600.0;
constexpr int kWindow_px = 16;
constexpr double kStep_px = 0.37;

struct Layer {
  const char* name;
  double light;  // fraction of the light that the layer leaves
};
constexpr std::array kLayers = {Layer{"umbra", 0.15}, Layer{"middle", 0.4},
                                Layer{"penumbra", 0.83}};

FramePlan one_layer(FramePlan plan, std::size_t layer) {
  plan.objects.clear();
  for (ShadowDraw& draw : plan.shadows) {
    draw.umbra = layer == 0;
    draw.middle = layer == 1;
    draw.penumbra = layer == 2;
  }
  return plan;
}

// A camera at `height` [m] that looks straight down, and a plate whose shadow fills most of the
// view. `aside_px`: sideways displacement of the camera, seen in the image.
struct View {
  double height = 0.5;
  [[nodiscard]] test::SceneBuilder scene() const {
    test::SceneBuilder builder;
    const double half = 0.3 * height * kSide / kFocal_px;
    test::ShapeBuilder plate;
    plate.box(-half, -half, 0.0, half, half, 0.002);
    builder.add(test::finished(plate.build(), glm::vec4(1.0F)),
                test::at(0, 0, 0.02, {0, 0, 1}, 0.3));
    builder.scene().shadows[0].fractions = {kLayers[0].light, kLayers[1].light, kLayers[2].light};
    return builder;
  }
  [[nodiscard]] PoseEstimate pose(double aside_px) const {
    const double aside = aside_px * height / kFocal_px;
    const Eigen::Vector3d eye(0.02 + aside, -0.03 - 0.6 * aside, height);
    return test::tracked(CameraPose(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0), eye));
  }
};

struct Pattern {
  double mean = 0.0, sd = 0.0, minimum = 1.0, maximum = 0.0;  // fraction of black pixels per window
  double flips = 0.0;                                         // fraction of the pixels inside
  int windows = 0;
};

Pattern pattern_of(const View& view, Translucency mode, std::size_t layer) {
  test::Studio studio(view.scene().build(), test::camera_of(kSide, kSide, kFocal_px));
  const Frame white = test::plain_frame(kSide, kSide, 255);
  const auto draw = [&](Translucency draw_mode, double aside_px) {
    PlanOptions options;
    options.translucency = draw_mode;
    return studio.draw(white, one_layer(studio.plan(view.pose(aside_px), options), layer));
  };
  const test::RenderedImage inside = draw(Translucency::blend, 0.0);
  const test::RenderedImage inside_after = draw(Translucency::blend, kStep_px);
  const test::RenderedImage before = draw(mode, 0.0);
  const test::RenderedImage after = draw(mode, kStep_px);
  Pattern pattern;
  std::vector<double> fractions;
  for (int y = 0; y + kWindow_px <= kSide; y += 5) {
    for (int x = 0; x + kWindow_px <= kSide; x += 5) {
      int black = 0;
      bool is_inside = true;
      for (int dy = 0; dy < kWindow_px && is_inside; ++dy) {
        for (int dx = 0; dx < kWindow_px && is_inside; ++dx) {
          is_inside = inside.red(x + dx, y + dy) != 255;
          black += before.red(x + dx, y + dy) == 0 ? 1 : 0;
        }
      }
      if (is_inside) fractions.push_back(static_cast<double>(black) / (kWindow_px * kWindow_px));
    }
  }
  for (const double fraction : fractions) {
    pattern.mean += fraction / static_cast<double>(fractions.size());
    pattern.minimum = std::min(pattern.minimum, fraction);
    pattern.maximum = std::max(pattern.maximum, fraction);
  }
  for (const double fraction : fractions)
    pattern.sd += (fraction - pattern.mean) * (fraction - pattern.mean) /
                  static_cast<double>(fractions.size());
  pattern.sd = std::sqrt(pattern.sd);
  pattern.windows = static_cast<int>(fractions.size());
  std::size_t inside_both = 0;
  std::size_t flipped = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      if (inside.red(x, y) == 255 || inside_after.red(x, y) == 255) continue;
      ++inside_both;
      flipped += (before.red(x, y) == 0) != (after.red(x, y) == 0) ? 1U : 0U;
    }
  }
  pattern.flips =
      inside_both > 0 ? static_cast<double>(flipped) / static_cast<double>(inside_both) : 0.0;
  return pattern;
}

void print_row(const char* name, const View& view, Translucency mode) {
  for (std::size_t layer = 0; layer < kLayers.size(); ++layer) {
    const Pattern p = pattern_of(view, mode, layer);
    fmt::print("{:<24} {:>6.2f} {:>9} {:>7.4f} {:>7.4f} {:>7.4f} {:>7.4f} {:>7.4f} {:>8.2f} %\n",
               name, view.height, kLayers[layer].name, 1.0 - kLayers[layer].light, p.mean, p.sd,
               p.minimum, p.maximum, 100.0 * p.flips);
  }
}

}  // namespace
}  // namespace penumbra

int main() {
  using namespace penumbra;
  fmt::print("{:<24} {:>6} {:>9} {:>7} {:>7} {:>7} {:>7} {:>7} {:>10}\n", "translucency", "eye [m]",
             "layer", "wanted", "mean", "sd", "min", "max", "flips");
  for (const double height : {0.2, 0.5, 1.2}) {
    print_row("mesh", {height}, Translucency::mesh);
    const std::string strips = fmt::format("geometry-mesh, {:.1f} px", 3e-3 * kFocal_px / height);
    print_row(strips.c_str(), {height}, Translucency::geometry_mesh);
  }
  return 0;
}
