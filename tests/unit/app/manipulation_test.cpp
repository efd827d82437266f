#include "app/window/manipulation.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "render/scene/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::at;
using test::look_at;

std::shared_ptr<const Model> box(float x, float y, float z) {
  return test::finished(make_box({x, y, z}), glm::vec4(1.0F));
}

// A table seen obliquely through a lens with distortion.
class Manipulation : public testing::Test {
 protected:
  Manipulation() {
    cube = builder.add(box(0.1F, 0.1F, 0.1F), at(0.05, 0.02, 0.25));
    far_cube = builder.add(box(0.1F, 0.1F, 0.1F), at(0.05, 0.4, 0.05));
    wing = builder.add(box(0.3F, 0.02F, 0.02F), at(0.0, 0.0, 0.06));
    builder.scene().objects[static_cast<std::size_t>(wing)].parent = cube;
    wall = builder.add(box(0.1F, 0.1F, 0.1F), at(-0.3, 0.0, 0.05), false, true);
    hidden = builder.add(box(0.02F, 0.02F, 0.02F), at(-0.3, 0.1, 0.02));
  }

  [[nodiscard]] SceneState state() const { return evaluate_scene(*builder.build(), 0.0); }
  [[nodiscard]] Eigen::Vector2d pixel_of(const Eigen::Vector3d& p) const {
    return camera.project(pose.inverse() * p).value();
  }
  [[nodiscard]] PointerView pointer_at(const Eigen::Vector3d& p) const {
    return view_at(camera, pose, pixel_of(p)).value();
  }
  [[nodiscard]] const Scene& scene() { return builder.scene(); }

  test::SceneBuilder builder;
  CameraModel camera = test::camera_of(640, 480, 500.0, DistortionModel::plumb_bob,
                                       {-0.28, 0.09, 0.001, -0.0007, 0.0, 0.0, 0.0, 0.0});
  CameraPose pose = look_at({0.1, -0.8, 0.6}, {0.0, 0.0, 0.05});
  int cube = 0, far_cube = 0, wing = 0, wall = 0, hidden = 0;
};

TEST_F(Manipulation, CastsPixelRayThroughVisiblePoint) {
  for (const Eigen::Vector3d& p : {Eigen::Vector3d(0.0, 0.0, 0.0), Eigen::Vector3d(0.3, 0.2, 0.1),
                                   Eigen::Vector3d(-0.3, -0.1, 0.0)}) {
    const PointerView view = pointer_at(p);
    const Eigen::Vector3d offset = p - view.ray.origin;
    EXPECT_LT(offset.cross(view.ray.direction).norm(), 1e-6);
    EXPECT_GT(offset.dot(view.ray.direction), 0.0);
    EXPECT_NEAR(view.right.z(), 0.0, 1e-12);
    EXPECT_NEAR(view.right.norm(), 1.0, 1e-12);
  }
}

TEST_F(Manipulation, PicksNearestSurface) {
  // One ray meets two cubes; the nearer one is picked.
  const Ray ray{{0.05, -1.0, 0.25}, Eigen::Vector3d(0.0, 1.0, 0.0)};
  const auto picked = pick(scene(), state(), ray);
  ASSERT_TRUE(picked);
  EXPECT_EQ(picked->object, cube);
  EXPECT_NEAR(picked->distance, 1.0 + 0.02 - 0.05, 1e-7);
  EXPECT_FALSE(pick(scene(), state(), {{0.05, -1.0, 0.25}, Eigen::Vector3d(0, -1, 0)}))
      << "the cube is behind the ray";
  EXPECT_FALSE(pick(scene(), state(), {{2.0, -1.0, 0.25}, Eigen::Vector3d(0, 1, 0)}))
      << "the ray passes beside the cube";
}

TEST_F(Manipulation, PicksScaledAndRotatedObjects) {
  test::SceneBuilder turned;
  turned.add(box(0.1F, 0.2F, 0.3F), at(0.3, 0.1, 0.2, {0, 1, 0}, 0.5 * std::numbers::pi, 2.0));
  const SceneState now = evaluate_scene(turned.scene(), 0.0);
  // The box's side of 0.3 m lies along x at scale 2, so half of it is 0.3 m.
  const auto picked = pick(turned.scene(), now, {{-1.0, 0.1, 0.2}, Eigen::Vector3d(1, 0, 0)});
  ASSERT_TRUE(picked);
  EXPECT_NEAR(picked->distance, 1.0, 1e-6);
}

TEST_F(Manipulation, IgnoresObjectsHiddenByPhantom) {
  Manipulator manipulator;
  const Ray ray{{-0.3, -1.0, 0.02}, Eigen::Vector3d(0.0, 1.0, 0.0)};
  PointerView pointer;
  pointer.ray = ray;
  EXPECT_EQ(pick(scene(), state(), ray)->object, wall);
  EXPECT_FALSE(manipulator.take(scene(), state(), pointer, DragMode::slide));
  EXPECT_FALSE(manipulator.holding());
  EXPECT_TRUE(manipulator.selected().empty());
}

TEST_F(Manipulation, SelectsParentOfPickedPart) {
  Manipulator manipulator;
  const auto taken =
      manipulator.take(scene(), state(), pointer_at({0.18, 0.0, 0.31}), DragMode::slide);
  ASSERT_TRUE(taken);
  EXPECT_EQ(taken->object, scene().objects[static_cast<std::size_t>(cube)].name);
  EXPECT_EQ(taken->placement.position, Eigen::Vector3d(0.05, 0.02, 0.25))
      << "picking must not move the object";
}

TEST_F(Manipulation, KeepsHeightAndPointUnderPointerInSlideMode) {
  Manipulator manipulator;
  const Eigen::Vector3d top(0.05, -0.02, 0.30);
  ASSERT_TRUE(manipulator.take(scene(), state(), pointer_at(top), DragMode::slide));
  const auto moved = manipulator.drag(pointer_at(top + Eigen::Vector3d(-0.11, 0.07, 0.0)));
  ASSERT_TRUE(moved);
  EXPECT_FALSE(moved->turned);
  EXPECT_LT((moved->placement.position - Eigen::Vector3d(-0.06, 0.09, 0.25)).norm(), 1e-6);
  EXPECT_EQ(moved->placement.position.z(), 0.25) << "the height must be exactly the same";
}

TEST_F(Manipulation, IgnoresSlideWhenPointerIsAboveHorizon) {
  pose = look_at({0.0, -0.8, 0.3}, {0.0, 0.0, 0.28});
  Manipulator manipulator;
  ASSERT_TRUE(manipulator.take(scene(), state(), pointer_at({0.05, -0.03, 0.25}), DragMode::slide));
  EXPECT_FALSE(manipulator.drag(view_at(camera, pose, {320.0, 5.0}).value()));
}

TEST_F(Manipulation, MovesUpAndSidewaysOnlyInLiftMode) {
  Manipulator manipulator;
  const Eigen::Vector3d front(0.05, -0.03, 0.25);
  const PointerView start = pointer_at(front);
  ASSERT_TRUE(manipulator.take(scene(), state(), start, DragMode::lift));
  const Eigen::Vector3d shift = 0.08 * Eigen::Vector3d::UnitZ() - 0.05 * start.right;
  const auto moved = manipulator.drag(pointer_at(front + shift));
  ASSERT_TRUE(moved);
  const Eigen::Vector3d displacement =
      moved->placement.position - Eigen::Vector3d(0.05, 0.02, 0.25);
  EXPECT_LT((displacement - shift).norm(), 1e-6);
}

TEST_F(Manipulation, KeepsObjectsAboveTable) {
  Manipulator manipulator;
  const Eigen::Vector3d front(0.05, -0.03, 0.25);
  ASSERT_TRUE(manipulator.take(scene(), state(), pointer_at(front), DragMode::lift));
  const auto moved = manipulator.drag(pointer_at(front - Eigen::Vector3d(0.0, 0.0, 0.24)));
  ASSERT_TRUE(moved);
  EXPECT_NEAR(moved->placement.position.z(), 0.05, 1e-7) << "the object must stop on the table";
}

TEST_F(Manipulation, LiftsByUpwardDragWhenSeenFromAbove) {
  pose = look_at({0.05, 0.0199, 1.2}, {0.05, 0.02, 0.0});
  Manipulator manipulator;
  const PointerView start = pointer_at({0.05, -0.02, 0.30});
  ASSERT_TRUE(manipulator.take(scene(), state(), start, DragMode::lift));
  const auto up = view_at(camera, pose, start.pixel - Eigen::Vector2d(0.0, 50.0));
  const auto moved = manipulator.drag(up.value());
  ASSERT_TRUE(moved);
  // A vertical drag of 50 px is 50 / 500 rad, seen from 0.9 m.
  EXPECT_NEAR(moved->placement.position.z() - 0.25, 0.9 * 50.0 / 500.0, 1e-3);
  EXPECT_NEAR(moved->placement.position.x(), 0.05, 1e-9);
}

TEST_F(Manipulation, MovesUpAndAwayOnlyInReachMode) {
  Manipulator manipulator;
  const PointerView start = pointer_at({0.05, -0.03, 0.25});
  ASSERT_TRUE(manipulator.take(scene(), state(), start, DragMode::reach));
  PointerView pointer = start;
  pointer.pixel += Eigen::Vector2d(40.0, -25.0);
  const auto moved = manipulator.drag(pointer);
  ASSERT_TRUE(moved);
  EXPECT_FALSE(moved->turned);
  const Eigen::Vector3d displacement =
      moved->placement.position - Eigen::Vector3d(0.05, 0.02, 0.25);
  const double metres_per_px =
      (start.ray.origin - Eigen::Vector3d(0.05, -0.03, 0.25)).norm() / 500.0;
  EXPECT_NEAR(displacement.z(), 25.0 * metres_per_px, 1e-6);
  EXPECT_NEAR(displacement.dot(start.right), 0.0, 1e-12);
  // The object moves at constant height, along the ray's horizontal direction.
  Eigen::Vector3d away = start.ray.direction - start.ray.direction.dot(start.right) * start.right;
  away.z() = 0.0;
  EXPECT_NEAR(displacement.dot(away.normalized()), 40.0 * metres_per_px, 1e-6);
  // The object stays above the table.
  pointer.pixel.y() = start.pixel.y() + 4000.0;
  EXPECT_NEAR(manipulator.drag(pointer)->placement.position.z(), 0.05, 1e-7);
}

TEST_F(Manipulation, RotatesAboutTableNormalAndImageHorizontal) {
  Manipulator manipulator;
  const PointerView start = pointer_at({0.05, -0.03, 0.25});
  ASSERT_TRUE(manipulator.take(scene(), state(), start, DragMode::turn));
  PointerView pointer = start;
  pointer.pixel.x() += 160.0;  // a quarter of the image's width rotates by a quarter turn
  auto turned = manipulator.drag(pointer);
  ASSERT_TRUE(turned);
  EXPECT_TRUE(turned->turned);
  EXPECT_EQ(turned->placement.position, Eigen::Vector3d(0.05, 0.02, 0.25));
  const Eigen::Quaterniond quarter(
      Eigen::AngleAxisd(0.5 * std::numbers::pi, Eigen::Vector3d::UnitZ()));
  EXPECT_LT(turned->placement.rotation.angularDistance(quarter), 1e-9);
  pointer.pixel = start.pixel + Eigen::Vector2d(0.0, 80.0);
  turned = manipulator.drag(pointer);
  const Eigen::Quaterniond tilt(Eigen::AngleAxisd(0.25 * std::numbers::pi, start.right));
  EXPECT_LT(turned->placement.rotation.angularDistance(tilt), 1e-9);
}

TEST_F(Manipulation, KeepsObjectWhenPointerDoesNotMove) {
  for (const DragMode mode : {DragMode::slide, DragMode::lift, DragMode::reach, DragMode::turn}) {
    Manipulator manipulator;
    const PointerView start = pointer_at({0.05, -0.03, 0.25});
    const auto taken = manipulator.take(scene(), state(), start, mode);
    ASSERT_TRUE(taken);
    const auto dragged = manipulator.drag(start);
    ASSERT_TRUE(dragged);
    EXPECT_LT((dragged->placement.position - taken->placement.position).norm(), 1e-12);
    EXPECT_LT(dragged->placement.rotation.angularDistance(taken->placement.rotation), 1e-7);
    manipulator.release_object();
    EXPECT_FALSE(manipulator.drag(start));
    EXPECT_EQ(manipulator.selected(), taken->object) << "still selected";
  }
}

TEST_F(Manipulation, PutsSelectedObjectOnTable) {
  Manipulator manipulator;
  const PointerView target = pointer_at({-0.1, -0.15, 0.0});
  EXPECT_FALSE(manipulator.put(scene(), state(), target)) << "nothing is selected";
  ASSERT_TRUE(manipulator.take(scene(), state(), pointer_at({0.05, -0.03, 0.25}), DragMode::slide));
  manipulator.release_object();
  const auto put = manipulator.put(scene(), state(), target);
  ASSERT_TRUE(put);
  EXPECT_LT((put->placement.position - Eigen::Vector3d(-0.1, -0.15, 0.05)).norm(), 1e-6);
}

TEST_F(Manipulation, PlacesCursorUnderPointer) {
  const PointerView target = pointer_at({-0.1, -0.15, 0.25});
  EXPECT_FALSE(cursor_at(scene(), state(), target, 0.0)) << "the scene has no cursor";
  builder.scene().objects[static_cast<std::size_t>(cube)].cursor = true;
  const auto moved = cursor_at(scene(), state(), target, 0.0);
  ASSERT_TRUE(moved);
  EXPECT_EQ(moved->object, scene().objects[static_cast<std::size_t>(cube)].name);
  EXPECT_LT((moved->placement.position - Eigen::Vector3d(-0.1, -0.15, 0.25)).norm(), 1e-6);
  // Raising the cursor: the object follows the pointer's ray at the new height.
  const auto raised = cursor_at(scene(), state(), pointer_at({-0.1, -0.15, 0.30}), 0.05);
  ASSERT_TRUE(raised);
  EXPECT_LT((raised->placement.position - Eigen::Vector3d(-0.1, -0.15, 0.30)).norm(), 1e-6);
  // Lowering: the attached wing extends below the cube, so it is the wing that stops at the table.
  const auto lowered = cursor_at(scene(), state(), target, -10.0);
  ASSERT_TRUE(lowered);
  const double lowest = lowest_point(scene(), state(), cube);
  EXPECT_NEAR(lowered->placement.position.z(), 0.25 - lowest, 1e-9);
  PointerView up = target;
  up.ray.direction = Eigen::Vector3d(0.0, 0.8, 0.6);
  EXPECT_FALSE(cursor_at(scene(), state(), up, 0.0)) << "the pointer is above the horizon";
  EXPECT_FALSE(cursor_at(scene(), state(), target, std::numeric_limits<double>::quiet_NaN()));
}

}  // namespace
}  // namespace penumbra
