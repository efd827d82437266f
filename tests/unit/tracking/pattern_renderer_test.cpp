// The renderer of synthetic images. A second tag at the same place has the same cells, but every
// pixel near both is then looked up sub-sample by sub-sample, without the shortcuts for pixels near
// one tag (uniform pixels, pixels beside it, vectorized look-up).
#include "tracking/alignment/pattern_renderer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

// A small image, so that many can be compared.
CameraModel small_camera() {
  CameraParameters p = test::wide_camera().parameters();
  p.width = 160;
  p.height = 120;
  p.fx = p.fy = 170.0;
  p.cx = 81.0;
  p.cy = 59.0;
  return CameraModel::make(p).value();
}

class PatternRendererTest : public testing::Test {
 protected:
  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  std::mt19937_64 random_{11};
};

TEST_F(PatternRendererTest, ShortcutsDifferByAtMostOneSubSample) {
  const CameraModel camera = small_camera();
  std::size_t seen = 0;  // pixels that show the tag
  std::size_t different = 0;
  for (int i = 0; i < 40; ++i) {
    MappedTag tag;
    tag.id = i;
    tag.size_m = 0.06;
    const auto bend = [&] { return uniform(-3.0, 3.0); };
    if (i % 3 == 0) tag.curvature = {bend(), bend(), bend()};
    // Partly outside the image, grazing, near and far.
    const CameraPose pose = test::looking_at(
        {uniform(-0.05, 0.05), uniform(-0.04, 0.04), 0.0}, std::exp(uniform(std::log(0.08), 0.0)),
        radians(uniform(8.0, 88.0)), radians(uniform(0.0, 360.0)), radians(uniform(-180.0, 180.0)));
    std::vector<CameraPose> path = {pose};
    if (i % 4 == 1) {
      for (int step = 0; step < 3; ++step)
        path.push_back(test::displaced(camera, {&tag, 1}, pose, uniform(0.5, 6.0), random_));
    }
    PatternRenderOptions options;
    options.samples = 32;
    options.lens_blur_px = uniform(0.0, 1.5);
    options.covered_fraction = i % 5 == 2 ? uniform(0.0, 1.0) : 0.0;
    const auto light_of = [&](const std::vector<MappedTag>& tags) {
      return PatternRenderer::create(camera, tags).value().render_light(path, options);
    };
    const std::vector<double> one = light_of({tag});
    const std::vector<double> two = light_of({tag, tag});
    for (std::size_t p = 0; p < one.size(); ++p) {
      ASSERT_TRUE(std::isfinite(one[p]));
      seen += std::abs(two[p] - options.background) > 1e-9;
      // A sub-sample on a cell's edge may fall to either side by rounding.
      ASSERT_NEAR(one[p], two[p], 1.01 * options.white / options.samples)
          << "image " << i << ", pixel " << p % 160 << ' ' << p / 160;
      different += std::abs(one[p] - two[p]) > 1e-9;
    }
  }
  EXPECT_GT(seen, 50'000U);
  EXPECT_LT(different, seen / 10'000);
}

}  // namespace
}  // namespace penumbra
