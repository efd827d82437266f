// Lens distortion in the vertex shader, compared in pixels with CameraModel::project.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <numbers>

#include "render/camera_gl.hpp"
#include "support/cameras.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::SceneBuilder;
using test::Studio;

struct Lens {
  std::string name;
  DistortionModel model = DistortionModel::plumb_bob;
  std::array<double, 8> k{};
};
std::ostream& operator<<(std::ostream& out, const Lens& lens) {
  return out << lens.name;
}
std::vector<Lens> lenses() {
  std::vector<Lens> all = {Lens{"none"}};
  for (const DistortionModel model : kDistortionModels) {
    all.push_back(
        {std::string(short_name(model)), model, test::lens_of(model).parameters().distortion});
  }
  return all;
}

class OverlayProjection : public testing::TestWithParam<std::tuple<Lens, GlApi>> {};
INSTANTIATE_TEST_SUITE_P(Lenses, OverlayProjection,
                         testing::Combine(testing::ValuesIn(lenses()),
                                          testing::Values(GlApi::gl33, GlApi::gles30)),
                         [](const auto& instance) {
                           return std::get<0>(instance.param).name +
                                  (std::get<1>(instance.param) == GlApi::gl33 ? "_gl33"
                                                                              : "_gles30");
                         });

CameraModel camera_with(const Lens& lens) {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 400.0;  // wide angle: strong distortion
  p.fy = 391.0;
  p.cx = 331.7;
  p.cy = 229.2;
  p.model = lens.model;
  p.distortion = lens.k;
  return CameraModel::make(p).value();
}

// Returns the corners of a disc that faces the camera, in the camera frame.
std::vector<Eigen::Vector3d> rim(const Eigen::Vector3d& centre, double radius, int corners) {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < corners; ++i) {
    const double t = 2.0 * std::numbers::pi * i / corners;
    points.push_back(centre + radius * Eigen::Vector3d(std::cos(t), std::sin(t), 0.0));
  }
  return points;
}

// Returns the exact image of the disc: its densely sampled outline, projected in double precision.
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

// Returns the centroid of the pixels whose centres lie inside the outline. The drawn disc's
// centroid is computed in the same way, so that only the drawing's error remains.
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

TEST_P(OverlayProjection, DrawsWhereCameraModelProjects) {
  const CameraModel camera = camera_with(std::get<0>(GetParam()));
  const CameraPose pose = test::look_at({0.3, -0.2, 0.9}, {0.0, 0.05, 0.0});
  // Discs that face the camera at pixels all over the frame. Each disc is a model.
  std::vector<std::vector<Eigen::Vector2d>> expected;
  SceneBuilder builder;
  int index = 0;
  for (double v = 28.0; v <= 452.0; v += 53.0) {
    for (double u = 28.0; u <= 612.0; u += 53.09) {
      const auto ray = camera.unproject({u + 3.0 * std::sin(index), v + 3.0 * std::cos(index)});
      ASSERT_TRUE(ray);
      const double depth = 0.3 + 0.04 * (index % 17);
      ++index;
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
  const test::RenderedImage image =
      studio.draw(test::plain_frame(640, 480, 0), studio.plan(test::tracked(pose)));

  double worst = 0.0;
  Eigen::Vector2d bias = Eigen::Vector2d::Zero();
  for (const auto& outline : expected) {
    int expected_count = 0;
    const Eigen::Vector2d expected_centroid = counted_centroid(outline, expected_count);
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    int count = 0;
    for (int y = std::max(0, static_cast<int>(expected_centroid.y()) - 25);
         y <= std::min(479, static_cast<int>(expected_centroid.y()) + 25); ++y) {
      for (int x = std::max(0, static_cast<int>(expected_centroid.x()) - 25);
           x <= std::min(639, static_cast<int>(expected_centroid.x()) + 25); ++x) {
        if (image.red(x, y) < 128) continue;
        sum += Eigen::Vector2d(x, y);
        ++count;
      }
    }
    ASSERT_GT(expected_count, 100);
    ASSERT_NEAR(count, expected_count, 0.05 * expected_count) << expected_centroid.transpose();
    const Eigen::Vector2d error = sum / count - expected_centroid;
    worst = std::max(worst, error.norm());
    bias += error / static_cast<double>(expected.size());
  }

  std::printf("overlay error: worst %.3f px, mean (%.4f, %.4f) px over %zu discs\n", worst,
              bias.x(), bias.y(), expected.size());
  EXPECT_LE(worst, 0.15);
  EXPECT_LE(bias.norm(), 0.02) << "a half-pixel offset would show here";
}

TEST_P(OverlayProjection, FrustumContainsAllVisibleRays) {
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
  // Both points are out of view, but the segment between them crosses the view.
  const std::array<Eigen::Vector3d, 2> across = {Eigen::Vector3d(-9, 0, 1),
                                                 Eigen::Vector3d(9, 0, 1)};
  EXPECT_FALSE(frustum.misses(across));
}

// Beyond the maximum of a non-monotonic distortion the projection continues linearly, as in
// CameraModel::project_extended. Objects out there must not appear in the frame.
TEST(Overlay, ExtendsProjectionBeyondNonMonotonicRadius) {
  CameraParameters p = camera_with({}).parameters();
  p.distortion = {-0.28, 0.0, 0.0, 0.0, 0.0};
  const CameraModel camera = CameraModel::make(p).value();
  ASSERT_LT(camera.max_radius(), 1.2);
  Model far;
  Mesh& mesh = far.meshes.emplace_back();
  // A plate from 60 to 80 degrees off the axis. A projection that folded back would draw it in the
  // middle of the frame.
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
  const test::RenderedImage image =
      studio.draw(test::plain_frame(640, 480, 0), studio.plan(test::tracked(CameraPose())));
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 560; ++x) ASSERT_EQ(image.red(x, y), 0) << x << " " << y;
  }
}

// Returns the row of a densely sampled curve at column x.
double row_at(const std::vector<Eigen::Vector2d>& curve, double x) {
  for (std::size_t i = 0; i + 1 < curve.size(); ++i) {
    const Eigen::Vector2d& a = curve[i];
    const Eigen::Vector2d& b = curve[i + 1];
    if (a.x() <= x && x < b.x()) return a.y() + (x - a.x()) / (b.x() - a.x()) * (b.y() - a.y());
  }
  return std::numeric_limits<double>::quiet_NaN();
}

CameraModel strong_lens() {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = p.fy = 600.0;
  p.cx = 319.5;
  p.cy = 239.5;
  p.distortion = {-0.28, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  return CameraModel::make(p).value();
}

// Compares the drawn edges of a strip with the exact rows of its top and bottom edge, one row per
// column (NaN: no edge). `covered`: whether a pixel shows the strip. Returns the largest mean error
// of an edge over a window of columns [px].
double worst_window_px(const CameraModel& camera, const std::vector<double>& top_rows,
                       const std::vector<double>& bottom_rows,
                       const std::function<bool(int, int)>& covered) {
  constexpr int kWindow = 24;
  std::vector<double> top_error, bottom_error;
  for (int x = 0; x < camera.width(); ++x) {
    const double top = top_rows[static_cast<std::size_t>(x)];
    const double bottom = bottom_rows[static_cast<std::size_t>(x)];
    if (!std::isfinite(top) || !std::isfinite(bottom)) continue;
    const int middle = static_cast<int>(0.5 * (top + bottom));
    int first = middle, last = middle;
    while (first > 0 && covered(x, first - 1)) --first;
    while (last + 1 < camera.height() && covered(x, last + 1)) ++last;
    EXPECT_TRUE(covered(x, middle)) << x;
    top_error.push_back(first - std::ceil(top));
    bottom_error.push_back(last - std::floor(bottom));
  }
  double worst = 0.0;
  EXPECT_GT(top_error.size(), 400U);
  for (const auto& errors : {top_error, bottom_error}) {
    for (std::size_t i = 0; i + kWindow <= errors.size(); ++i) {
      double sum = 0.0;
      for (std::size_t j = i; j < i + kWindow; ++j) sum += errors[j];
      worst = std::max(worst, std::abs(sum / kWindow));
    }
  }
  return worst;
}

std::vector<double> rows_of_line(const CameraModel& camera, const Eigen::Vector3d& a,
                                 const Eigen::Vector3d& b) {
  std::vector<Eigen::Vector2d> curve;
  for (int i = 0; i <= 2000; ++i) {
    const auto p = camera.project(a + (b - a) * (i / 2000.0));
    if (p) curve.push_back(*p);
  }
  std::vector<double> rows;
  for (int x = 0; x < camera.width(); ++x) rows.push_back(row_at(curve, x));
  return rows;
}

// An animation enlarges a thin object ten times, near the upper border and at the camera's nearest
// distance. The object's edges must follow the distortion over their whole length.
TEST(Overlay, DrawsLongEdgesWithLensDistortionCloseUp) {
  const CameraModel camera = strong_lens();
  const Eigen::Vector3d a(-0.09, -0.0500, 0.15), b(0.09, -0.0330, 0.15);
  const Eigen::Vector3d down(0.0, 0.006, 0.0);
  Model strip;
  Mesh& mesh = strip.meshes.emplace_back();
  for (const Eigen::Vector3d& p : {a, b, Eigen::Vector3d(b + down), Eigen::Vector3d(a + down)}) {
    mesh.positions.push_back(to_gl(Eigen::Vector3d(0.1 * p)));
  }
  mesh.indices = {0, 1, 2, 0, 2, 3};
  SceneBuilder builder;
  const int index =
      builder.add(test::finished(strip, glm::vec4(0.0F), glm::vec3(4.0F)), Placement{}, false);
  Animation& animation = builder.scene().objects[static_cast<std::size_t>(index)].animation;
  animation.loop = false;
  animation.keyframes.resize(2);
  animation.keyframes[1].time_s = 1.0;
  animation.keyframes[1].placement.scale = 10.0;
  Studio studio(builder.build(), camera);
  const test::RenderedImage image = studio.draw(test::plain_frame(640, 480, 0),
                                                studio.plan(test::tracked(CameraPose()), {}, 1.0));
  const double worst =
      worst_window_px(camera, rows_of_line(camera, a, b), rows_of_line(camera, a + down, b + down),
                      [&](int x, int y) { return image.red(x, y) >= 128; });
  std::printf("long edge close up: worst %.3f px\n", worst);
  EXPECT_LE(worst, 0.15);
}

// The penumbra of a level strip is twice as long as the strip. The test draws it at the nearest
// distance, where it fills the image, and at larger distances, where edges are split into longer
// pieces.
TEST(Overlay, DrawsLongShadowEdgesWithLensDistortion) {
  const CameraModel camera = strong_lens();
  for (const double scale : {1.0, 1.7, 4.0, 11.0}) {
    const double height = 0.1 * scale, light = 0.4 * scale;
    const double ratio = 8.0 / 4.0;  // factor (H + a h) / (H - h) = 2
    SceneBuilder builder;
    builder.scene().shadows[0].layered = make_layered_constants(light, ratio, 0.0).value();
    const double factor =
        layer_factor(builder.scene().shadows[0].layered, ShadowLayer::penumbra, height);
    ASSERT_NEAR(factor, 2.0, 1e-12);
    Model strip;
    Mesh& mesh = strip.meshes.emplace_back();
    const Eigen::Vector2d a(-0.045 * scale, 0.025 * scale), b(0.045 * scale, 0.0165 * scale);
    const Eigen::Vector2d down(0.0, -0.003 * scale);
    const std::array<Eigen::Vector2d, 4> corners = {a, a + down, b + down, b};
    for (const Eigen::Vector2d& p : corners)
      mesh.positions.push_back(to_gl(Eigen::Vector3d(p.x(), p.y(), 0.0)));
    mesh.indices = {0, 1, 2, 0, 2, 3};
    builder.scene().shadows[0].kernels = KernelSource::centroid;
    builder.scene().shadows[0].fractions = {0.0, 0.0, 0.0};
    builder.add(test::finished(strip, glm::vec4(1.0F)), test::at(0, 0, height));
    // The camera looks straight down: its x is the table's x, its y is the table's -y.
    Eigen::Matrix3d R;
    R << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    const CameraPose pose(R, Eigen::Vector3d(0.0, 0.0, 0.15 * scale));
    Studio studio(builder.build(), camera);
    const test::RenderedImage image =
        studio.draw_shadows(test::plain_frame(640, 480, 200), studio.plan(test::tracked(pose)));
    const Eigen::Vector2d kernel = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
    const auto shadow = [&](const Eigen::Vector2d& p) {
      const Eigen::Vector2d at = kernel + factor * (p - kernel);
      return Eigen::Vector3d(pose.inverse() * Eigen::Vector3d(at.x(), at.y(), 0.0));
    };
    const double worst = worst_window_px(camera, rows_of_line(camera, shadow(a), shadow(b)),
                                         rows_of_line(camera, shadow(a + down), shadow(b + down)),
                                         [&](int x, int y) { return image.red(x, y) < 100; });
    std::printf("long shadow at %.2f m: worst %.3f px\n", 0.15 * scale, worst);
    // Far edges are split into pieces in proportion to their distance (kSplitShare), hence the
    // larger error.
    EXPECT_LE(worst, scale < 10.0 ? 0.15 : 0.25);
  }
}

TEST(Overlay, MapsObjectPointsToPlane) {
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
