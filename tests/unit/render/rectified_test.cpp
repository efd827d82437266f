// The image without lens distortion: position of each pixel in the video, and overlay.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "render/passes/rectified_video.hpp"
#include "support/cameras.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::rectified_test {
namespace {

using test::RenderedImage;

constexpr int kWidth = 640;
constexpr int kHeight = 480;

std::vector<CameraModel> lenses() {
  std::vector<CameraModel> all;
  for (const DistortionModel model : kDistortionModels) all.push_back(test::lens_of(model));
  // A lens with outward distortion.
  all.push_back(test::camera_of(kWidth, kHeight, 520.0, DistortionModel::plumb_bob, {0.18, -0.04}));
  return all;
}

// Returns the position in the distorted video that the pixel's ray projects to, computed without
// the grid.
Eigen::Vector2d exact(const CameraModel& camera, const CameraModel& undistorted, double x,
                      double y) {
  return *camera.project_extended(*undistorted.unproject({x, y}));
}

TEST(Rectification, ComputesGridAccurateToTenthOfPixel) {
  for (const CameraModel& camera : lenses()) {
    const CameraModel undistorted = without_distortion(camera);
    EXPECT_FALSE(undistorted.has_distortion());
    EXPECT_EQ(undistorted.parameters().fx, camera.parameters().fx);
    const RectifyingGrid grid = rectifying_grid(camera, without_distortion(camera));
    double worst = 0.0;
    for (int row = 0; row + 1 < grid.rows; ++row) {
      for (int column = 0; column + 1 < grid.columns; ++column) {
        const auto corner = [&](int dx, int dy) {
          return static_cast<std::size_t>((row + dy) * grid.columns + column + dx);
        };
        // The grid's error is largest at the midpoints of the triangles' sides.
        for (const auto& [a, b] :
             {std::pair(corner(0, 0), corner(1, 0)), std::pair(corner(0, 0), corner(0, 1)),
              std::pair(corner(1, 0), corner(0, 1))}) {
          const Eigen::Vector2d middle = 0.5 * (grid.image_px[a] + grid.image_px[b]);
          const Eigen::Vector2d source = 0.5 * (grid.video[a] + grid.video[b]);
          const Eigen::Vector2d truth = exact(camera, undistorted, middle.x(), middle.y());
          // Compares only points that are visible in the video.
          if (truth.x() < -1 || truth.y() < -1 || truth.x() > kWidth || truth.y() > kHeight)
            continue;
          worst = std::max(worst, (source - truth).norm());
        }
      }
    }
    EXPECT_LE(worst, 0.1);
    EXPECT_GT(worst, 0.001) << "the lens must have distortion";
  }
}

// The luma of the video increases from left to right or from top to bottom, so that each grey level
// encodes a source position.
TEST(Rectification, SamplesVideoAlongRayOfEachPixel) {
  for (const GlApi api : {GlApi::gl33, GlApi::gles30}) {
    for (const CameraModel& camera : lenses()) {
      for (const bool horizontal : {true, false}) {
        FrameBuffer buffer = allocate_frame(PixelFormat::grey8, kWidth, kHeight);
        const auto luma = [horizontal](double x, double y) {
          return 20.0 + 0.3 * (horizontal ? x : y);
        };
        for (int y = 0; y < kHeight; ++y) {
          for (int x = 0; x < kWidth; ++x) {
            buffer.plane_data[0][y * buffer.frame.planes[0].stride + x] =
                static_cast<std::uint8_t>(std::lround(luma(x, y)));
          }
        }
        const auto context = create_offscreen_context(api).value();
        context->make_current();
        auto compositor = Compositor::create(*context, test::SceneBuilder().build(), camera,
                                             {.rectified = true, .msaa = 0})
                              .value();
        RenderedImage image{kWidth, kHeight, std::vector<std::uint8_t>(4 * kWidth * kHeight)};
        ASSERT_TRUE(compositor.draw(buffer.frame, FramePlan()));
        ASSERT_TRUE(compositor.read_back(image.rgba));
        const CameraModel undistorted = without_distortion(camera);
        int inside = 0;
        int outside = 0;
        for (int y = 0; y < kHeight; y += 3) {
          for (int x = 0; x < kWidth; x += 3) {
            const Eigen::Vector2d source = exact(camera, undistorted, x, y);
            if (source.x() > 0 && source.y() > 0 && source.x() < kWidth - 1 &&
                source.y() < kHeight - 1) {
              ++inside;
              // Rounding to grey levels occurs twice; the grid's error of 0.1 px corresponds to
              // 0.03 grey levels.
              ASSERT_NEAR(image.red(x, y), luma(source.x(), source.y()), 1.05) << x << " " << y;
            } else if (source.x() < -1 || source.y() < -1 || source.x() > kWidth ||
                       source.y() > kHeight) {
              ++outside;
              ASSERT_EQ(image.red(x, y), 0) << x << " " << y;
            }
          }
        }
        EXPECT_GT(inside, 20'000);
        (void)outside;  // only a lens with outward distortion leaves such pixels
      }
    }
  }
}

// The video contains the object, drawn through the true lens. In the rectified image the overlay
// must cover it.
TEST(Rectification, AlignsOverlayWithVideo) {
  for (const CameraModel& camera : lenses()) {
    const CameraPose pose = test::look_at({0.05, -0.35, 0.4}, {0.0, 0.0, 0.0});
    test::SceneBuilder builder;
    builder.add(test::box(0.08, 0.08, 0.002), test::at(0.06, 0.04, 0.001), false);
    const auto scene = builder.build();
    const auto context = create_offscreen_context().value();
    context->make_current();
    auto distorted = Compositor::create(*context, scene, camera, {.msaa = 0}).value();
    auto rectified =
        Compositor::create(*context, scene, camera, {.rectified = true, .msaa = 0}).value();
    const auto draw = [&](Compositor& compositor, const CameraModel& view, const Frame& frame,
                          bool with_object) {
      FramePlan plan = plan_frame(*scene, evaluate_scene(*scene, 0.0), test::tracked(pose), view);
      if (!with_object) plan.objects.clear();
      RenderedImage image{kWidth, kHeight, std::vector<std::uint8_t>(4 * kWidth * kHeight)};
      EXPECT_TRUE(compositor.draw(frame, plan));
      EXPECT_TRUE(compositor.read_back(image.rgba));
      return image;
    };
    // The video is the object as drawn through the lens.
    const Frame grey = test::plain_frame(kWidth, kHeight, 30);
    const RenderedImage through_lens = draw(distorted, camera, grey, true);
    FrameBuffer video = allocate_frame(PixelFormat::grey8, kWidth, kHeight);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        video.plane_data[0][y * video.frame.planes[0].stride + x] =
            std::equal(through_lens.at(x, y), through_lens.at(x, y) + 3,
                       std::array{30, 30, 30}.data())
                ? 0
                : 200;
      }
    }
    const CameraModel undistorted = without_distortion(camera);
    const RenderedImage resampled = draw(rectified, undistorted, video.frame, false);
    const RenderedImage drawn = draw(rectified, undistorted, grey, true);
    const RenderedImage empty = draw(rectified, undistorted, grey, false);
    const auto weighted_centroid = [](const RenderedImage& image, auto weight) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) sum += weight(image, x, y) * Eigen::Vector3d(x, y, 1.0);
      }
      return Eigen::Vector3d(sum.x() / sum.z(), sum.y() / sum.z(), sum.z());
    };
    const Eigen::Vector3d of_video = weighted_centroid(
        resampled, [](const RenderedImage& p, int x, int y) { return p.red(x, y) / 200.0; });
    const Eigen::Vector3d of_overlay =
        weighted_centroid(drawn, [&](const RenderedImage& p, int x, int y) {
          return std::equal(p.at(x, y), p.at(x, y) + 3, empty.at(x, y)) ? 0.0 : 1.0;
        });
    ASSERT_GT(of_overlay.z(), 2000.0);
    EXPECT_LE((of_video - of_overlay).head<2>().norm(), 0.15);
    EXPECT_NEAR(of_video.z() / of_overlay.z(), 1.0, 0.03);
  }
}

// Retextured shadows must sample the rectified image, not the distorted video.
TEST(Rectification, PlacesRetexturedShadowsInRectifiedFrame) {
  test::SceneBuilder builder;
  builder.add(test::ring(), test::at(0.0, 0.0, 0.08));
  const auto scene = builder.build();
  const CameraModel camera = lenses().front();
  const CameraModel undistorted = without_distortion(camera);
  FrameBuffer buffer = allocate_frame(PixelFormat::nv12, kWidth, kHeight);
  for (std::size_t plane = 0; plane < 2; ++plane) {
    const PixelPlane& view = buffer.frame.planes[plane];
    for (std::ptrdiff_t i = 0; i < view.stride * view.height; ++i)
      buffer.plane_data[plane][i] = static_cast<std::uint8_t>(i * 2654435761U >> 13U);
  }
  const auto context = create_offscreen_context().value();
  context->make_current();
  auto compositor =
      Compositor::create(*context, scene, camera, {.rectified = true, .msaa = 0}).value();
  const auto draw = [&](Translucency mode) {
    PlanOptions options;
    options.translucency = mode;
    const auto pose = test::tracked(test::look_at({0.05, -0.35, 0.4}, {0.0, 0.0, 0.0}));
    FramePlan plan = plan_frame(*scene, evaluate_scene(*scene, 0.0), pose, undistorted, options);
    plan.objects.clear();
    std::vector<std::uint8_t> pixels(4 * kWidth * kHeight);
    EXPECT_TRUE(compositor.draw(buffer.frame, plan));
    EXPECT_TRUE(compositor.read_back(pixels));
    return pixels;
  };
  const auto blended = draw(Translucency::blend);
  const auto fetched = draw(Translucency::retexture);
  for (std::size_t i = 0; i < blended.size(); ++i) ASSERT_NEAR(blended[i], fetched[i], 1);
  EXPECT_NE(blended, draw(Translucency::mesh));
}

}  // namespace
}  // namespace penumbra::rectified_test
