// Images for windows that are larger than the video.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "app/session/session.hpp"
#include "render/passes/rectified_video.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

// An offscreen context that reports the size of a window.
class WindowOfSize : public GlContext {
 public:
  explicit WindowOfSize(std::unique_ptr<GlContext> context) : context_(std::move(context)) {
    info_ = context_->info();
  }
  void make_current() override { context_->make_current(); }
  [[nodiscard]] Size window_size() const override { return size; }
  Size size;

 private:
  std::unique_ptr<GlContext> context_;
};

constexpr int kWidth = 160;
constexpr int kHeight = 120;

std::shared_ptr<const Scene> ring_scene() {
  test::ShapeBuilder ring;
  ring.torus(0.06, 0.022, 24, 48);
  test::SceneBuilder builder;
  builder.add(test::finished(ring.build(), {0.7F, 0.3F, 0.2F, 1.0F}),
              test::at(0.0, 0.0, 0.08, {1, 0.2, 0}, 0.6));
  return builder.build();
}

class DisplayResolution : public testing::Test {
 protected:
  DisplayResolution() {
    Trajectory poses;
    poses.poses.push_back({0, pose_.T_table_camera, {}});
    session_.emplace(
        Session::create(window_, ring_scene(), camera_, GivenPoses{std::move(poses), {}}, {})
            .value());
  }
  // Draws the frame for the window alone, or also into `rgba`.
  void draw(std::span<std::uint8_t> rgba = {}) {
    const auto drawn =
        session_->draw(session_->track(test::plain_frame(kWidth, kHeight, 210)), rgba);
    ASSERT_TRUE(drawn) << drawn.error().message;
    ASSERT_TRUE(drawn->plan.has_pose);
  }
  [[nodiscard]] std::vector<std::uint8_t> shown() {
    const ImageSize size = session_->shown_size();
    std::vector<std::uint8_t> rgba(std::size_t{4} * static_cast<std::size_t>(size.width) *
                                   static_cast<std::size_t>(size.height));
    EXPECT_TRUE(session_->read_back(rgba));
    return rgba;
  }

  WindowOfSize window_{create_offscreen_context().value()};
  CameraModel camera_ = test::camera_of(kWidth, kHeight, 150.0);
  PoseEstimate pose_ = test::tracked(test::look_at({0.2, -0.4, 0.4}, {0.0, 0.0, 0.03}));
  std::optional<Session> session_;
};

TEST_F(DisplayResolution, AcceptsSlowRollingShutter) {
  CameraParameters parameters = camera_.parameters();
  parameters.rolling_shutter_row_s = 0.19 / kHeight;  // nearly the longest read-out
  const CameraModel slow = CameraModel::make(parameters).value();
  EXPECT_EQ(with_size(slow, 20 * kWidth, 20 * kHeight).height(), 20 * kHeight);
}

TEST_F(DisplayResolution, ImageHasResolutionOfLargerWindow) {
  window_.size = {3 * kWidth, 3 * kHeight + 40};  // letterboxed
  draw();
  ASSERT_EQ(session_->shown_size(), (ImageSize{3 * kWidth, 3 * kHeight}));
  const std::vector<std::uint8_t> image = shown();
  // The same as a camera with as many pixels.
  test::Studio studio(ring_scene(), with_size(camera_, 3 * kWidth, 3 * kHeight), GlApi::gl33, {});
  const test::RenderedImage expected =
      studio.draw(test::plain_frame(3 * kWidth, 3 * kHeight, 210), studio.plan(pose_));
  int largest = 0;
  for (std::size_t i = 0; i < image.size(); ++i)
    largest = std::max(largest, std::abs(image[i] - expected.rgba[i]));
  EXPECT_LE(largest, 2);
}

TEST_F(DisplayResolution, WrittenImageDoesNotDependOnWindow) {
  std::vector<std::uint8_t> without(std::size_t{4} * kWidth * kHeight);
  draw(without);
  EXPECT_EQ(session_->shown_size(), (ImageSize{kWidth, kHeight}));
  window_.size = {2 * kWidth, 2 * kHeight};
  std::vector<std::uint8_t> with(without.size());
  draw(with);
  EXPECT_EQ(session_->shown_size(), (ImageSize{2 * kWidth, 2 * kHeight}));
  EXPECT_EQ(with, without);
  window_.size = {kWidth / 2, kHeight / 2};
  draw();
  EXPECT_EQ(session_->shown_size(), (ImageSize{kWidth, kHeight}));
  EXPECT_EQ(shown(), without);
}

TEST_F(DisplayResolution, KeepsSizeWhileWindowIsResized) {
  window_.size = {2 * kWidth, 2 * kHeight};
  draw();
  window_.size = {3 * kWidth, 3 * kHeight};
  draw();
  EXPECT_EQ(session_->shown_size(), (ImageSize{2 * kWidth, 2 * kHeight}));
}

}  // namespace
}  // namespace penumbra
