// Models far from their file's origin.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "render/frame_plan.hpp"
#include "render/model/model_parts.hpp"
#include "render/model/shadow_mesh.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "support/model_text.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/techniques.hpp"

namespace penumbra {
namespace {

using test::area_of;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

Eigen::AlignedBox3d box(const Eigen::Vector3d& middle, double size) {
  const Eigen::Vector3d half = Eigen::Vector3d::Constant(0.5 * size);
  return {Eigen::Vector3d(middle - half), Eigen::Vector3d(middle + half)};
}

TEST(ModelOrigin, IsZeroForModelNearOrigin) {
  EXPECT_TRUE(model_origin({}).isZero(0.0));
  EXPECT_TRUE(model_origin(box({0, 0, 0}, 0.1)).isZero(0.0));
  EXPECT_TRUE(model_origin(box({6, -6, 6}, 0.1)).isZero(0.0));
}

TEST(ModelOrigin, IsCentreOfModelFarAway) {
  EXPECT_EQ(model_origin(box({0, -7, 0}, 0.1)), Eigen::Vector3d(0, -7, 0));
  EXPECT_EQ(model_origin(box({3e5, 5e5, 0}, 1.0)), Eigen::Vector3d(3e5, 5e5, 0));
}

TEST(ModelOrigin, WarnsWhenCoordinatesAreTooCoarse) {
  EXPECT_EQ(warning_of_distance(box({3e5, 5e5, 0}, 1.0), 1e-9, "m"), std::nullopt);
  EXPECT_THAT(warning_of_distance(box({3e5, 4e5, 0}, 1.0), 0.03, "m").value_or(""),
              HasSubstr("m: lies 500 km from its origin, where coordinates are exact to 0.03 m"));
}

class FarModel : public testing::Test {
 protected:
  // A disc of radius 0.5 m with 32 corners.
  static std::string disc(double x, double y, double z) {
    std::string text, face = "f";
    for (int i = 0; i < 32; ++i) {
      const double angle = 2.0 * M_PI * i / 32;
      text += fmt::format("v {:.7f} {:.7f} {:.7f}\n", x + 0.5 * std::cos(angle),
                          y + 0.5 * std::sin(angle), z);
      face += fmt::format(" {}", i + 1);
    }
    return text + face + "\n";
  }
  static constexpr double kArea = 16 * 0.25 * 0.19509032201612825;
  test::ModelFolder folder_;
};

TEST_F(FarModel, KeepsShapeAndPosition) {
  for (const Eigen::Vector3d& position :
       {Eigen::Vector3d(3e5, 5e5, 0), Eigen::Vector3d(1e4, 2e4, 3),
        Eigen::Vector3d(458074.6, 5429380.17, 162.9)}) {
    const Result<Model> model = folder_.obj(disc(position.x(), position.y(), position.z()));
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_NEAR(area_of(*model), kArea, 1e-6 * kArea);
    EXPECT_LT((model->origin - position).norm(), 1e-7);
    EXPECT_NEAR(model->max_corner.x, 0.5F, 1e-6F);
    EXPECT_THAT(model->warnings, IsEmpty());
  }
}

TEST_F(FarModel, IsPlacedInDoublePrecision) {
  const Result<Model> model = folder_.obj(disc(3e5, 5e5, 0));
  ASSERT_TRUE(model) << model.error().message;
  const Placement T{{-6e5, -1e6, 0.25}, Eigen::Quaterniond::Identity(), 2.0};
  EXPECT_LT((placed_model(*model, T).position - Eigen::Vector3d(0, 0, 0.25)).norm(), 1e-6);
  const Result<Model> rotated = load_model(folder_.path() / "model.obj", {.up = UpAxis::y});
  ASSERT_TRUE(rotated);
  EXPECT_LT((rotated->origin - Eigen::Vector3d(3e5, 0, 5e5)).norm(), 1e-6);
  Model near = *model;
  near.origin.setZero();
  const Eigen::Quaterniond rotation(0.1, 0.7, 0.3, 0.64);
  EXPECT_EQ(placed_model(near, {{1, 2, 3}, rotation, 0.7}), (Placement{{1, 2, 3}, rotation, 0.7}));
}

TEST_F(FarModel, KeepsPositionWhenOriginMoves) {
  Result<Model> model = folder_.obj(disc(3e5, 5e5, 0));
  ASSERT_TRUE(model) << model.error().message;
  const float x = model->meshes[0].positions[0].x;
  move_origin(*model, {3e5 - 8.0, 5e5, 0});
  EXPECT_NEAR(model->meshes[0].positions[0].x, x + 8.0F, 1e-5F);
  EXPECT_NEAR(model->max_corner.x, 8.5F, 1e-5F);
  EXPECT_EQ(model->origin.x(), 3e5 - 8.0);
}

TEST_F(FarModel, KeepsFileCoordinatesInKernelFile) {
  Result<Model> model = folder_.obj(disc(3e5, 5e5, 1));
  ASSERT_TRUE(model) << model.error().message;
  const ShadowMesh mesh = make_shadow_mesh(*model);
  const ShadowKernels made =
      generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
  const KernelFile written = make_kernel_file(*model, mesh, made, KernelSource::automatic);
  const auto file = folder_.write("kernels.json", kernel_file_json(written));
  const Result<KernelFile> read = load_kernel_file(file);
  ASSERT_TRUE(read) << read.error().message;
  const Eigen::Vector3d first = read->origin + to_eigen(read->kernels[0]);
  EXPECT_LT((first - Eigen::Vector3d(3e5, 5e5, 1)).norm(), 1e-3);
  const Result<bool> attached = attach_kernels(*model, *read, "kernels.json");
  ASSERT_TRUE(attached) << attached.error().message;
  EXPECT_TRUE(*attached);
  for (std::size_t i = 0; i < 32; ++i) {
    const glm::vec3& kernel = model->meshes[0].shadow_kernels[i];
    EXPECT_LT(
        (to_eigen(kernel) - to_eigen(written.kernels[model->meshes[0].source_vertex[i]])).norm(),
        1e-6);
  }
  EXPECT_NE(geometry_key(*model), [&] {
    Model near = *model;
    near.origin.setZero();
    return geometry_key(near);
  }());
}

TEST_F(FarModel, WarnsOfShapeLostToPrecision) {
  const Result<Model> model =
      folder_.obj("v 583095 583095 0\nv 583095 583095 0\nv 583095 583095 0\nf 1 2 3\n");
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_THAT(model->warnings,
              ElementsAre(testing::AllOf(HasSubstr("lies 824.6 km from its origin"),
                                         HasSubstr("move it there and export it again"))));
  const Result<Model> beyond = folder_.obj("v 1e13 0 0\nv 1e13 1 0\nv 1e13 0 1\nf 1 2 3\n");
  ASSERT_FALSE(beyond);
  EXPECT_THAT(beyond.error().message, HasSubstr("move the model to the origin"));
  const Result<Model> coarse =
      folder_.obj("v 1e11 0 0\nv 1e11 0.1 0\nv 100000000000.0001 0 0.1\nf 1 2 3\n");
  ASSERT_TRUE(coarse) << coarse.error().message;
  EXPECT_THAT(coarse->warnings, ElementsAre(HasSubstr("coordinates are exact to 2.2e-05 m only")));
}

TEST_F(FarModel, WarnsInMetresForOtherUnits) {
  const auto file = folder_.write("model.obj", "v 1e11 0 0\nv 1e11 0.1 0\nv 1e11 0 0.1\nf 1 2 3\n");
  const Result<Model> model = load_model(file, {.unit_m = 0.001});
  ASSERT_TRUE(model) << model.error().message;
  EXPECT_THAT(model->warnings,
              ElementsAre(testing::AllOf(HasSubstr("lies 1e+05 km from its origin"),
                                         HasSubstr("are exact to 2.2e-08 m only, for a size of "
                                                   "0.0001 m"))));
}

// The scene uses one model as caster, as object and as phantom. The model lies at `origin` in its
// file, and the placements compensate for this offset.
FramePlan plan_of_models_at(const Eigen::Vector3d& origin, const PlanOptions& options) {
  test::ShapeBuilder shape;
  shape.box(-0.025, -0.025, -0.025, 0.025, 0.025, 0.025);
  Model model = *test::finished(shape.build(), glm::vec4(1.0F));
  model.origin = origin;
  const auto shared = std::make_shared<const Model>(std::move(model));
  test::SceneBuilder builder;
  const auto add = [&](const Placement& T, bool phantom) {
    const Placement back{T.position - T.rotation * (T.scale * origin), T.rotation, T.scale};
    builder.add(shared, back, true, phantom);
  };
  const Eigen::Quaterniond turned(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ()));
  add({{0.0, 0.0, 0.15}, turned, 1.0}, false);
  add({{0.01, 0.0, 0.025}, Eigen::Quaterniond::Identity(), 1.0}, false);
  add({{-0.03, 0.02, 0.02}, turned, 0.8}, true);
  add({{5.0, 0.0, 0.1}, Eigen::Quaterniond::Identity(), 1.0}, false);
  ScenePlane wall;
  wall.name = "wall";
  wall.normal = -Eigen::Vector3d::UnitY();
  wall.point = {0.0, 0.3, 0.0};
  builder.scene().planes.push_back(wall);
  builder.scene().lights.emplace_back();
  for (ShadowNode& node : builder.scene().shadows) {
    node.walls = {static_cast<int>(builder.scene().planes.size()) - 1};
    node.lights = {static_cast<int>(builder.scene().lights.size()) - 1};
  }
  const auto scene = builder.build();
  return plan_frame(*scene, evaluate_scene(*scene, 0.0),
                    test::tracked(test::look_at({0.0, -0.4, 0.5}, {0.0, 0.0, 0.0})),
                    test::camera_of(320, 240, 300.0), options);
}

// Returns one line of text per draw, rounded to a micrometre.
std::vector<std::string> lines_of(const FramePlan& plan) {
  std::vector<std::string> lines;
  const auto text = [](const auto& numbers) {
    std::string all;
    for (const double number : numbers) {
      all += fmt::format(" {:.6f}", std::round(1e6 * number) / 1e6 + 0.0);  // -0 is 0
    }
    return all;
  };
  const auto add = [&](const char* what, int object, const Placement& T, const std::string& more) {
    lines.push_back(fmt::format("{} {}{}{}", what, object, text(T.position), more));
  };
  const auto shadow = [&](const char* what, const ShadowDraw& draw, const std::string& more) {
    add(what, draw.object, draw.T_table_object,
        fmt::format(" on {}: {}{}{} {:.6f}{}{}", draw.plane, draw.umbra, draw.middle, draw.penumbra,
                    draw.radius, text(draw.centre), more));
  };
  for (const ObjectDraw& draw : plan.objects) add("object", draw.object, draw.T_table_object, "");
  for (const ObjectDraw& draw : plan.phantoms) add("phantom", draw.object, draw.T_table_object, "");
  for (const ShadowDraw& draw : plan.shadows) shadow("shadow", draw, "");
  for (const ShadowDraw& draw : plan.skipped_shadows) shadow("unseen", draw, "");
  for (const ReceivedShadowDraw& draw : plan.received_shadows) {
    shadow("received", draw.shadow, fmt::format(" by {}: {:.6f}", draw.receiver, draw.top));
  }
  lines.push_back(fmt::format("{} pairs may meet", plan.caster_receiver_pairs));
  for (const HardShadowDraw& draw : plan.hard_shadows) {
    add("hard", draw.object, draw.T_table_object, fmt::format(" on {}", draw.plane));
  }
  for (const ShadowVolumeDraw& draw : plan.volumes) {
    std::string balls;
    for (const BoundingSphere& ball : draw.receivers) balls += text(ball.middle);
    add("volume", draw.object, draw.T_table_object, balls);
  }
  for (const LightRayDraw& draw : plan.rays) add("rays", draw.object, draw.T_table_object, "");
  for (const SkippedPass& pass : plan.skipped)
    lines.push_back(fmt::format("{} {} {}", key_of(pass.reason), pass.subject, pass.other));
  return lines;
}

class FarModelPlan : public testing::TestWithParam<ShadowTechnique> {};

TEST_P(FarModelPlan, MatchesPlanOfModelAtOrigin) {
  for (const bool skip : {true, false}) {
    PlanOptions options;
    options.technique = GetParam();
    options.light_rays = true;
    options.skip = skip;
    const FramePlan near = plan_of_models_at({0, 0, 0}, options);
    EXPECT_FALSE(near.objects.empty() || near.phantoms.empty());
    if (GetParam() == ShadowTechnique::layered || GetParam() == ShadowTechnique::simple) {
      EXPECT_GE(near.received_shadows.size(), 2U);
      EXPECT_GE(near.caster_receiver_pairs, 2U);
    }
    const FramePlan far = plan_of_models_at({3e5, 5e5, 0}, options);
    EXPECT_EQ(lines_of(far), lines_of(near));
  }
}

INSTANTIATE_TEST_SUITE_P(Technique, FarModelPlan,
                         testing::ValuesIn(test::techniques_without({ShadowTechnique::none})),
                         [](const auto& technique) {
                           return std::string(to_string(technique.param));
                         });

TEST(FarModelCases, MatchAreaOfSharedFiles) {
  if (test::shared_dir().empty()) GTEST_SKIP() << "no shared cases beside the checkout";
  const std::filesystem::path folder = test::shared_dir() / "cases" / "obj-far-from-origin";
  // Expected areas: shoelace formula on the corners as written in the file.
  for (const auto& [file, area_cm2] : {std::pair{"disc-1m-at-100km.obj", 7803.2848},
                                       {"disc-10cm-at-10km.obj", 78.0584},
                                       {"far.obj", 100.0},
                                       {"utm_coords.obj", 100.0}}) {
    const Result<Model> model = load_model(folder / file);
    ASSERT_TRUE(model) << model.error().message;
    EXPECT_NEAR(1e4 * area_of(*model), area_cm2, 1e-6 * area_cm2) << file;
    EXPECT_THAT(model->warnings, IsEmpty()) << file;
  }
}

}  // namespace
}  // namespace penumbra
