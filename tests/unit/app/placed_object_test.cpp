// Size and place of objects that are put on the table.
#include "app/session/placed_object.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck.h>

#include <rapidcheck/gtest.h>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "render/scene/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

const Eigen::AlignedBox2d kSheet(Eigen::Vector2d(-0.1, -0.075), Eigen::Vector2d(0.1, 0.075));

// A box with its lower corner at `low`, or only its bounds if an edge has no length.
Model box_from(const Eigen::Vector3d& low, const Eigen::Vector3d& size) {
  Model model;
  Mesh& mesh = model.meshes.emplace_back();
  for (unsigned corner = 0; corner < 8; ++corner) {
    mesh.positions.emplace_back(low.x() + ((corner & 1U) != 0 ? size.x() : 0.0),
                                low.y() + ((corner & 2U) != 0 ? size.y() : 0.0),
                                low.z() + ((corner & 4U) != 0 ? size.z() : 0.0));
  }
  model.min_corner = mesh.positions.front();
  model.max_corner = mesh.positions.back();
  return model;
}

ObjectRequest request_for(const char* file) {
  ObjectRequest request;
  request.file = file;
  return request;
}

// Returns the bounds of the placed model in the table frame.
Eigen::AlignedBox3d bounds(const Model& model, const Placement& placement) {
  Eigen::AlignedBox3d box;
  for (const Mesh& mesh : model.meshes) {
    for (const glm::vec3& p : mesh.positions) {
      box.extend(placed_model(model, placement) * Eigen::Vector3d(static_cast<double>(p.x),
                                                                  static_cast<double>(p.y),
                                                                  static_cast<double>(p.z)));
    }
  }
  return box;
}

Scene empty_scene() {
  Scene scene;
  scene.planes.emplace_back().name = "table";
  ShadowNode& node = scene.shadows.emplace_back();
  node.name = "shadow";
  node.planes = {0};
  return scene;
}

// Any model, of 1 um to 1 km, anywhere within 100 m of its origin, rests beside the sheet.
RC_GTEST_PROP(PlacedObject, RestsBesideSheetAtSizeOfTable, ()) {
  const auto number = [](double low, double high) {
    return low + (high - low) * *rc::gen::inRange(0, 1'000'001) * 1e-6;
  };
  const double longest = std::pow(10.0, number(-6.0, 3.0));
  Eigen::Vector3d size(number(0.0, 1.0), number(0.0, 1.0), number(0.0, 1.0));
  size[*rc::gen::inRange(0, 3)] = 1.0;
  size *= longest;
  // The origin is near enough that floats keep the shape.
  const Eigen::Vector3d low =
      longest * Eigen::Vector3d(number(-9.0, 9.0), number(-9.0, 9.0), number(-9.0, 9.0));
  const Model model = box_from(low, size);
  const char* file = *rc::gen::element("a.glb", "a.obj");
  const auto place = place_on_table(model, request_for(file), empty_scene(), kSheet);
  RC_ASSERT(place.has_value());
  const Eigen::AlignedBox3d box = bounds(model, place->placement);
  const double edge = box.sizes().maxCoeff();
  RC_ASSERT(edge > 0.995 * kSmallestEdge_m && edge < 1.005 * kLargestEdge_m);
  RC_ASSERT(std::abs(box.min().z() - std::max(0.0, 0.001 - box.sizes().z())) < 1e-5);
  RC_ASSERT(std::abs(place->height_m - box.sizes().z()) < 1e-5);
  const Eigen::AlignedBox2d foot(box.min().head<2>(), box.max().head<2>());
  RC_ASSERT(!foot.intersects(kSheet));
  RC_ASSERT(std::abs(foot.exteriorDistance(kSheet) - 0.055) < 1e-4);
  RC_ASSERT(place->placement.rotation.coeffs() == Eigen::Quaterniond::Identity().coeffs());
}

// Objects that are added one after another touch neither each other nor the sheet.
RC_GTEST_PROP(PlacedObject, SeveralDoNotOverlap, ()) {
  Scene scene = empty_scene();
  std::vector<Eigen::AlignedBox2d> feet = {kSheet};
  const int count = *rc::gen::inRange(2, 12);
  for (int i = 0; i < count; ++i) {
    const auto edge = [] { return 0.01 * *rc::gen::inRange(1, 40); };
    const Eigen::Vector3d size(edge(), edge(), edge());
    const auto model = std::make_shared<const Model>(box_from({0.3, -0.2, 0.7}, size));
    const auto place = place_on_table(*model, request_for("a.glb"), scene, kSheet);
    RC_ASSERT(place.has_value());
    const Eigen::AlignedBox3d box = bounds(*model, place->placement);
    const Eigen::AlignedBox2d foot(box.min().head<2>(), box.max().head<2>());
    for (const Eigen::AlignedBox2d& other : feet) RC_ASSERT(foot.exteriorDistance(other) > 0.0199);
    feet.push_back(foot);
    apply(scene, ObjectAdded{free_object_name(scene, "a"), "a.glb", place->placement, model});
  }
  RC_ASSERT(scene.objects.size() == static_cast<std::size_t>(count));
}

TEST(PlacedObject, KeepsPlausibleSizeAndSaysSo) {
  const auto place = place_on_table(box_from({0, 0, 0}, {0.1, 0.08, 0.25}), request_for("a.glb"),
                                    empty_scene(), kSheet);
  ASSERT_TRUE(place) << place.error().message;
  EXPECT_EQ(place->placement.scale, 1.0);
  EXPECT_EQ(place->size_source, "its own size");
  EXPECT_NEAR(place->height_m, 0.25, 1e-6);
}

// A print of 80 mm, as slicers export it.
TEST(PlacedObject, TakesObjAsMillimetres) {
  const Model print = box_from({-40, -30, 0}, {80, 60, 45});
  const auto obj = place_on_table(print, request_for("print.OBJ"), empty_scene(), kSheet);
  ASSERT_TRUE(obj);
  EXPECT_EQ(obj->placement.scale, 0.001);
  EXPECT_EQ(obj->size_source, "taken as millimetres");
  const auto glb = place_on_table(print, request_for("print.glb"), empty_scene(), kSheet);
  ASSERT_TRUE(glb);
  EXPECT_NEAR(80.0 * glb->placement.scale, kFittedEdge_m, 0.005 * kFittedEdge_m);
  EXPECT_EQ(glb->size_source, "scaled to fit, from 80 m");
}

TEST(PlacedObject, FollowsRequest) {
  const Model model = box_from({5, 5, 5}, {2, 1, 4});
  ObjectRequest request = request_for("a.glb");
  request.height_m = 0.1;
  request.x_m = 0.02;
  request.y_m = -0.3;
  request.z_m = 0.07;
  auto place = place_on_table(model, request, empty_scene(), kSheet);
  ASSERT_TRUE(place);
  const Eigen::AlignedBox3d box = bounds(model, place->placement);
  EXPECT_NEAR(box.sizes().z(), 0.1, 1e-6);
  EXPECT_NEAR(box.center().x(), 0.02, 1e-6);
  EXPECT_NEAR(box.center().y(), -0.3, 1e-6);
  EXPECT_NEAR(box.min().z(), 0.07, 1e-6);

  request = request_for("a.glb");
  request.unit_m = 0.0254;
  request.scale = 2.0;
  request.y_m = 0.5;
  place = place_on_table(model, request, empty_scene(), kSheet);
  ASSERT_TRUE(place);
  EXPECT_DOUBLE_EQ(place->placement.scale, 0.0508);
  EXPECT_NEAR(bounds(model, place->placement).center().y(), 0.5, 1e-6);
  EXPECT_GT(bounds(model, place->placement).min().x(), kSheet.max().x()) << "x is chosen";
}

TEST(PlacedObject, RejectsModelsWithoutUsableSize) {
  const double inf = std::numeric_limits<double>::infinity();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto error = [](const Model& model, const ObjectRequest& request) {
    const auto place = place_on_table(model, request, empty_scene(), kSheet);
    return place ? "" : place.error().message;
  };
  for (const Eigen::Vector3d& size :
       {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(inf, 1, 1), Eigen::Vector3d(nan, nan, nan)}) {
    Model model = box_from({1, 1, 1}, size);
    EXPECT_THAT(error(model, request_for("a.glb")), HasSubstr("a.glb: has no size"));
  }
  EXPECT_THAT(error(Model(), request_for("a.glb")), HasSubstr("has no size"));
  EXPECT_THAT(error(box_from({0, 0, 0}, {1e6, 1e6, 1e6}), request_for("a.glb")),
              HasSubstr("export it in metres"));
  EXPECT_THAT(error(box_from({0, 0, 0}, {1e-8, 1e-8, 1e-8}), request_for("a.glb")),
              HasSubstr("export it in metres"));
  ObjectRequest request = request_for("flat.glb");
  request.height_m = 0.1;
  EXPECT_THAT(error(box_from({0, 0, 0}, {1, 1, 0}), request),
              HasSubstr("flat.glb: is flat, so height gives it no size; give scale instead"));
  Model far = box_from({0, 0, 0}, {0.1, 0.1, 0.1});
  far.origin = {5e6, 0, 0};
  EXPECT_THAT(error(far, request_for("a.glb")), HasSubstr("too far from the origin"));
}

// For example, a flower that grows from a scale of 0.
TEST(PlacedObject, NeedsScaleIfAnimationStartsWithoutSize) {
  const Model start = box_from({0, 0, 0}, {0, 0, 0});
  ObjectRequest request = request_for("flower.glb");
  request.animation = "grow";
  const auto without = place_on_table(start, request, empty_scene(), kSheet);
  ASSERT_FALSE(without);
  EXPECT_THAT(without.error().message,
              HasSubstr("no size at the start of its animation; give scale"));
  request.scale = 0.5;
  const auto place = place_on_table(start, request, empty_scene(), kSheet);
  ASSERT_TRUE(place) << place.error().message;
  EXPECT_EQ(place->placement.scale, 0.5);
}

// Objects above or below the place, and removed ones, do not block it.
TEST(PlacedObject, AvoidsOnlyWhatItWouldTouch) {
  const Model model = box_from({0, 0, 0}, {0.1, 0.1, 0.1});
  const auto middle_with = [&](double bottom, double top, bool removed) {
    Scene scene = empty_scene();
    SceneObject object;
    object.name = "other";
    object.model =
        std::make_shared<const Model>(box_from({-3.0, -3.0, bottom}, {6.0, 6.0, top - bottom}));
    object.removed = removed;
    scene.objects.push_back(object);
    const auto place = place_on_table(model, request_for("a.glb"), scene, kSheet);
    return bounds(model, place->placement).center();
  };
  const Eigen::Vector3d first(0.1 + 0.055 + 0.05, 0.0, 0.05);
  EXPECT_NEAR((middle_with(-0.02, 0.0, false) - first).norm(), 0.0, 1e-6) << "a table top";
  EXPECT_NEAR((middle_with(0.5, 0.6, false) - first).norm(), 0.0, 1e-6) << "a lamp";
  EXPECT_NEAR((middle_with(0.0, 0.1, true) - first).norm(), 0.0, 1e-6) << "a removed object";
  EXPECT_NEAR((middle_with(0.0, 0.1, false) - first).norm(), 0.0, 1e-6)
      << "no free place: the first choice";
}

TEST(PlacedObject, TakesSheetFromTagsOfTable) {
  MappedTag tag;
  tag.size_m = 0.04;
  tag.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.3, 0.1, 0.0)};
  MappedTag wall = tag;
  wall.id = 1;
  wall.group = "wall";
  wall.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(2.0, 0.1, 0.0)};
  const TagMap map = TagMap::make({tag, wall}).value();
  const Eigen::AlignedBox2d area = sheet_area(&map);
  EXPECT_NEAR(area.min().x(), 0.28, 1e-12);
  EXPECT_NEAR(area.max().y(), 0.12, 1e-12);
  EXPECT_NEAR(area.max().x(), 0.32, 1e-12);
  EXPECT_NEAR(sheet_area(nullptr).sizes().x(), 0.297, 1e-12) << "A4";
}

TEST(PlacedObject, CastsOneShadowPerPlane) {
  Scene scene = empty_scene();
  scene.planes.emplace_back().name = "wall";
  scene.shadows[0].technique = ShadowTechnique::hard;
  ShadowNode node;
  node.name = "layers";
  node.planes = {0};
  scene.shadows.push_back(node);
  node.name = "more layers";
  node.planes = {0, 1};
  scene.shadows.push_back(node);
  node.name = "layers on the wall";
  node.planes = {1};
  scene.shadows.push_back(node);
  SceneObject object;
  object.name = "toy";
  object.model = std::make_shared<const Model>(make_box({0.1F, 0.1F, 0.1F}));
  add_object(scene, object);
  EXPECT_TRUE(scene.shadows[0].casters.empty()) << "the layered node is preferred";
  EXPECT_EQ(scene.shadows[1].casters, std::vector<int>{0});
  EXPECT_TRUE(scene.shadows[2].casters.empty());
  EXPECT_EQ(scene.shadows[3].casters, std::vector<int>{0});
  EXPECT_EQ(free_object_name(scene, "toy"), "toy 2");
  EXPECT_EQ(free_object_name(scene, "boat"), "boat");
}

}  // namespace
}  // namespace penumbra
