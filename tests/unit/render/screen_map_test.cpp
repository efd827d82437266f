#include "render/edges/screen_map.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>

#include "core/camera/camera_model.hpp"
#include "render/camera_gl.hpp"
#include "support/cameras.hpp"

namespace penumbra {
namespace {

TEST(ScreenMap, MatchesCameraModel) {
  for (const DistortionModel model : kDistortionModels) {
    SCOPED_TRACE(to_string(model));
    const CameraModel camera = test::lens_of(model);
    const ScreenMap map(make_lens(camera), camera.width(), camera.height());
    for (double v = 10.0; v < 480.0; v += 46.0) {
      for (double u = 10.0; u < 640.0; u += 62.0) {
        const auto ray = camera.unproject({u, v});
        ASSERT_TRUE(ray);
        const Eigen::Vector3f p = (0.7 * *ray).cast<float>();
        const glm::vec3 at = map(glm::vec3(p.x(), p.y(), p.z()));
        // The image's corner is (0, 0), and pixel centres are at 0.5.
        EXPECT_NEAR(at.x, u + 0.5, 2e-3);
        EXPECT_NEAR(at.y, v + 0.5, 2e-3);
        const glm::vec2 back = map.ray({at.x, at.y});
        EXPECT_NEAR(back.x, ray->x(), 1e-3);
        EXPECT_NEAR(back.y, ray->y(), 1e-3);
      }
    }
  }
}

}  // namespace
}  // namespace penumbra
