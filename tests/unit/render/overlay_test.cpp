// What the vertex shader makes of the lens, measured in pixels against CameraModel::project.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "render/camera_gl.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::SceneBuilder;
using test::Studio;

struct Lens {
  const char* name;
  DistortionModel model;
  std::array<double, 8> k;
};
std::ostream& operator<<(std::ostream& out, const Lens& lens) {
  return out << lens.name;
}
const std::array kLenses = {
    Lens{"none", DistortionModel::plumb_bob, {}},
    Lens{"plumb_bob", DistortionModel::plumb_bob, {-0.28, 0.09, 0.0012, -0.0009, -0.006}},
    Lens{
        "rational", DistortionModel::rational, {0.5, -0.1, 0.001, -0.0005, 0.02, 0.8, -0.05, 0.03}},
    Lens{"fisheye", DistortionModel::fisheye, {-0.02, 0.004, -0.001, 0.0002}}};

class EveryLens : public testing::TestWithParam<std::tuple<Lens, GlApi>> {};
INSTANTIATE_TEST_SUITE_P(Overlay, EveryLens,
                         testing::Combine(testing::ValuesIn(kLenses),
                                          testing::Values(GlApi::gl33, GlApi::gles30)),
                         [](const auto& instance) {
                           return std::string(std::get<0>(instance.param).name) +
                                  (std::get<1>(instance.param) == GlApi::gl33 ? "_gl33"
                                                                              : "_gles30");
                         });

CameraModel camera_with(const Lens& lens) {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 400.0;  // wide, so that the lens bends a lot
  p.fy = 391.0;
  p.cx = 331.7;
  p.cy = 229.2;
  p.model = lens.model;
  p.distortion = lens.k;
  return CameraModel::make(p).value();
}

// Corners of a disc that faces the camera, camera frame.
std::vector<Eigen::Vector3d> rim(const Eigen::Vector3d& centre, double radius, int corners) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < corners; ++i) {
    const double t = 2.0 * std::numbers::pi * i / corners;
    points.push_back(centre + radius * Eigen::Vector3d(std::cos(t), std::sin(t), 0.0));
  }
  return points;
}

// The disc's exact picture: its closely sampled outline, projected in double.
std::vector<Eigen::Vector2d> exact_outline(const CameraModel& camera, const Eigen::Vector3d& centre,
                                           double radius) {
  const std::vector<Eigen::Vector3d> corners = rim(centre, radius, 64);
  std::vector<Eigen::Vector2d> outline;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d& a = corners[i];
    const Eigen::Vector3d& b = corners[(i + 1) % corners.size()];
    for (int j = 0; j < 8; ++j) outline.push_back(*camera.project(a + (b - a) * (j / 8.0)));
  }
  return outline;
}

// Centroid of the pixels whose centres lie inside: pixels are counted in the exact picture as they
// are in the drawn one, so that only the drawing's error is left.
Eigen::Vector2d counted_centroid(const std::vector<Eigen::Vector2d>& outline, int& count) {
  Eigen::Vector2d low = outline.front();
  Eigen::Vector2d high = outline.front();
  for (const Eigen::Vector2d& p : outline) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  count = 0;
  for (int y = static_cast<int>(std::ceil(low.y())); y <= static_cast<int>(high.y()); ++y) {
    for (int x = static_cast<int>(std::ceil(low.x())); x <= static_cast<int>(high.x()); ++x) {
      bool inside = false;
      for (std::size_t i = 0; i < outline.size(); ++i) {
        const Eigen::Vector2d& a = outline[i];
        const Eigen::Vector2d& b = outline[(i + 1) % outline.size()];
        if ((a.y() > y) != (b.y() > y) &&
            x < a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x())) {
          inside = !inside;
        }
      }
      if (!inside) continue;
      sum += Eigen::Vector2d(x, y);
      ++count;
    }
  }
  return sum / count;
}

TEST_P(EveryLens, DrawsWhereTheCameraModelProjects) {
  const CameraModel camera = camera_with(std::get<0>(GetParam()));
  const CameraPose pose = test::look_at({0.3, -0.2, 0.9}, {0.0, 0.05, 0.0});
  // Discs that face the camera, placed at pixels all over the picture; drawn one model per disc.
  std::vector<std::vector<Eigen::Vector2d>> expected;
  SceneBuilder builder;
  int at = 0;
  for (double v = 28.0; v <= 452.0; v += 53.0) {
    for (double u = 28.0; u <= 612.0; u += 53.09) {
      const auto ray = camera.unproject({u + 3.0 * std::sin(at), v + 3.0 * std::cos(at)});
      ASSERT_TRUE(ray);
      const double depth = 0.3 + 0.04 * (at % 17);
      ++at;
      const Eigen::Vector3d centre = *ray * depth;
      const double radius = 17.0 / 400.0 * depth;
      const auto corners = rim(centre, radius, 64);
      Model disc;
      Mesh& mesh = disc.meshes.emplace_back();
      const auto add = [&](const Eigen::Vector3d& p) {
        mesh.positions.push_back(to_gl(Eigen::Vector3d(pose * p)));
      };
      add(centre);
      for (const auto& corner : corners) add(corner);
      for (std::uint32_t i = 0; i < 64; ++i)
        mesh.indices.insert(mesh.indices.end(), {0U, 1 + i, 1 + (i + 1) % 64});
      builder.add(test::finished(disc, glm::vec4(0.0F), glm::vec3(4.0F)), Placement{}, false);
      expected.push_back(exact_outline(camera, centre, radius));
    }
  }
  Studio studio(builder.build(), camera, std::get<1>(GetParam()));
  const test::Picture picture =
      studio.draw(test::plain_frame(640, 480, 0), studio.plan(test::tracked(pose)));

  double worst = 0.0;
  Eigen::Vector2d bias = Eigen::Vector2d::Zero();
  for (const auto& outline : expected) {
    int expected_count = 0;
    const Eigen::Vector2d e = counted_centroid(outline, expected_count);
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    int count = 0;
    for (int y = std::max(0, static_cast<int>(e.y()) - 25);
         y <= std::min(479, static_cast<int>(e.y()) + 25); ++y) {
      for (int x = std::max(0, static_cast<int>(e.x()) - 25);
           x <= std::min(639, static_cast<int>(e.x()) + 25); ++x) {
        if (picture.red(x, y) < 128) continue;
        sum += Eigen::Vector2d(x, y);
        ++count;
      }
    }
    ASSERT_GT(expected_count, 100);
    ASSERT_NEAR(count, expected_count, 0.05 * expected_count) << e.transpose();
    const Eigen::Vector2d error = sum / count - e;
    worst = std::max(worst, error.norm());
    bias += error / static_cast<double>(expected.size());
  }

  std::printf("overlay error: worst %.3f px, mean (%.4f, %.4f) px over %zu discs\n", worst,
              bias.x(), bias.y(), expected.size());
  EXPECT_LE(worst, 0.15);
  EXPECT_LE(bias.norm(), 0.02) << "half a pixel off would show here";
}

TEST_P(EveryLens, FrustumHoldsWhatThePictureShows) {
  const CameraModel camera = camera_with(std::get<0>(GetParam()));
  const ViewFrustum frustum = make_frustum(camera);
  for (double v = -0.5; v <= 479.5; v += 10.0) {
    for (double u = -0.5; u <= 639.5; u += 10.0) {
      const auto ray = camera.unproject({u, v});
      ASSERT_TRUE(ray);
      const std::array<Eigen::Vector3d, 1> point = {*ray * 0.5};
      EXPECT_FALSE(frustum.misses(point)) << u << " " << v;
    }
  }
  const std::array<Eigen::Vector3d, 2> behind = {Eigen::Vector3d(0, 0, -1),
                                                 Eigen::Vector3d(0.1, 0, 0.01)};
  EXPECT_TRUE(frustum.misses(behind));
  const std::array<Eigen::Vector3d, 2> beside = {Eigen::Vector3d(9, 0, 1),
                                                 Eigen::Vector3d(9, 1, 1)};
  EXPECT_TRUE(frustum.misses(beside));
  // Both points are out of view, what is between them is not.
  const std::array<Eigen::Vector3d, 2> across = {Eigen::Vector3d(-9, 0, 1),
                                                 Eigen::Vector3d(9, 0, 1)};
  EXPECT_FALSE(frustum.misses(across));
}

// Beyond the fold the drawing goes on along the chord, as CameraModel::project_extended: nothing
// comes back into the picture.
TEST(Overlay, NothingFoldsBackIntoThePicture) {
  CameraParameters p = camera_with(kLenses[0]).parameters();
  p.distortion = {-0.28, 0.0, 0.0, 0.0, 0.0};
  const CameraModel camera = CameraModel::make(p).value();
  ASSERT_LT(camera.max_radius(), 1.2);
  Model far;
  Mesh& mesh = far.meshes.emplace_back();
  // A plate from 60 to 80 degrees off the axis; folded, it would cover the picture's middle.
  for (int i = 0; i < 40; ++i) {
    for (int j = 0; j < 2; ++j) {
      const double angle = (60.0 + 0.5 * i) * std::numbers::pi / 180.0;
      mesh.positions.emplace_back(static_cast<float>(std::tan(angle) * 0.3), j == 0 ? -0.2F : 0.2F,
                                  0.3F);
    }
  }
  for (std::uint32_t i = 0; i + 3 < 80; i += 2)
    mesh.indices.insert(mesh.indices.end(), {i, i + 1, i + 2, i + 1, i + 3, i + 2});
  SceneBuilder builder;
  builder.add(test::finished(far, glm::vec4(0.0F), glm::vec3(4.0F)), Placement{}, false);
  Studio studio(builder.build(), camera);
  const test::Picture picture =
      studio.draw(test::plain_frame(640, 480, 0), studio.plan(test::tracked(CameraPose())));
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 560; ++x) ASSERT_EQ(picture.red(x, y), 0) << x << " " << y;
  }
}

TEST(Overlay, MapsToThePlaneAndBack) {
  const PlaneFrame plane = PlaneFrame::make({0.2, -0.3, 1.0}, {100.0, -50.0, 20.0});
  const Placement object = test::at(100.1, -50.2, 20.3, {1, 2, 3}, 0.7, 0.5);
  const glm::mat4x3 to_plane = plane_from_object(plane, object);
  const glm::vec3 p = to_plane * glm::vec4(0.1F, -0.2F, 0.3F, 1.0F);
  const Eigen::Vector3d exact = plane.to_plane(object * Eigen::Vector3d(0.1, -0.2, 0.3));
  EXPECT_NEAR(p.x, exact.x(), 1e-6);
  EXPECT_NEAR(p.y, exact.y(), 1e-6);
  EXPECT_NEAR(p.z, exact.z(), 1e-6);
}

}  // namespace
}  // namespace penumbra
