// Layered and simple shadows that climb by nested volumes: every pixel against the points that lie
// under the imaginary meshes, wherever the eye is; and what may be kept or left out.
#include "render/shadow/layers/layer_volume.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <tuple>

#include "render/passes/shadow_pass.hpp"
#include "render/shadow/caster.hpp"
#include "render/shadow/kernels/kernel_direction.hpp"
#include "support/beside_no_edge.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::layer_volume_test {
namespace {

using test::box;
using test::Picture;
using test::SceneBuilder;
using test::ShapeBuilder;
using test::Studio;

constexpr int kSide = 240;

Frame white() {
  return test::plain_frame(kSide, kSide, 255);
}
PlanOptions by_volumes(Translucency way = Translucency::blend) {
  PlanOptions options;
  options.climbing = Climbing::volumes;
  options.translucency = way;
  return options;
}
std::shared_ptr<const Model> l_shape() {
  ShapeBuilder shape;
  shape.box(-0.05, -0.05, 0.0, 0.06, -0.02, 0.02);
  shape.box(-0.05, -0.02, 0.0, -0.02, 0.05, 0.02);
  return test::finished(shape.build(), glm::vec4(1.0F));
}
SceneBuilder builder_with(ShadowTechnique technique) {
  SceneBuilder builder;
  ShadowNode& node = builder.scene().shadows[0];
  node.technique = technique;
  node.layered = make_layered_constants(0.6, 2.5, 0.0).value();
  node.fractions = {0.1, 0.3, 0.7};
  return builder;
}

// Upright, of a table frame's axes.
struct Block {
  Eigen::Vector3d low, high;
  [[nodiscard]] double hit(const Eigen::Vector3d& p, const Eigen::Vector3d& d) const {
    double enter = -std::numeric_limits<double>::infinity();
    double leave = -enter;
    for (int i = 0; i < 3; ++i) {
      const double a = (low[i] - p[i]) / d[i];
      const double b = (high[i] - p[i]) / d[i];
      enter = std::max(enter, std::min(a, b));
      leave = std::min(leave, std::max(a, b));
    }
    if (enter > leave || leave <= kNear) return std::numeric_limits<double>::infinity();
    return enter > kNear ? enter : leave;
  }
  int add_to(SceneBuilder& builder, bool phantom) const {
    const Eigen::Vector3d size = high - low;
    const Eigen::Vector3d middle = 0.5 * (low + high);
    return builder.add(box(size.x(), size.y(), size.z()),
                       test::at(middle.x(), middle.y(), middle.z()), false, phantom);
  }
};

// Of a caster that is turned about the vertical only, over the table: the imaginary triangles of a
// layer, with their heights.
class Imaginary {
 public:
  Imaginary(const Model& model, const Placement& placement, const ShadowNode& node) {
    const ShadowMesh mesh = make_shadow_mesh(model);
    const ShadowKernels kernels = generate_kernels(
        mesh, KernelDirection::nearest(Eigen::Vector3d::UnitZ()).up(), KernelSource::automatic);
    const auto vertices = place_caster(mesh, kernels, placement, PlaneFrame());
    for (std::size_t layer = 0; layer < 3; ++layer) {
      if (node.technique == ShadowTechnique::simple && layer != 1) continue;
      const bool simple = node.technique == ShadowTechnique::simple;
      const HeightRange range =
          simple ? HeightRange{0.0, 10.0} : layer_height_range(node.layered, kShadowLayers[layer]);
      for (const CasterVertex& vertex : clip_to_heights(vertices, mesh.indices, range)) {
        const PlanePoint image = simple
                                     ? PlanePoint{vertex.u, vertex.v}
                                     : project_to_layer(vertex, node.layered, kShadowLayers[layer]);
        layers_[layer].push_back({static_cast<double>(image.u), static_cast<double>(image.v),
                                  static_cast<double>(vertex.h)});
      }
    }
  }
  // The darkest layer that the point is under; 3: none.
  [[nodiscard]] std::size_t layer_over(const Eigen::Vector3d& p) const {
    for (std::size_t layer = 0; layer < 3; ++layer) {
      const auto& points = layers_[layer];
      for (std::size_t t = 0; t + 2 < points.size(); t += 3) {
        Eigen::Matrix3d corners;
        for (int k = 0; k < 3; ++k) {
          const Eigen::Vector3d& corner = points[t + static_cast<std::size_t>(k)];
          corners.col(k) = Eigen::Vector3d(corner.x(), corner.y(), 1.0);
        }
        if (std::abs(corners.determinant()) < 1e-14) continue;
        const Eigen::Vector3d weights = corners.inverse() * Eigen::Vector3d(p.x(), p.y(), 1.0);
        if (weights.minCoeff() < 0.0) continue;
        const double height = weights.x() * points[t].z() + weights.y() * points[t + 1].z() +
                              weights.z() * points[t + 2].z();
        if (height > p.z()) return layer;
      }
    }
    return 3;
  }

 private:
  std::array<std::vector<Eigen::Vector3d>, 3> layers_;
};

struct View {
  const char* name;
  Eigen::Vector3d eye, target;
};
struct Case {
  View view;
  ShadowTechnique technique;
  double height;  // of the caster's underside; at 0.23 the end of its umbra cuts it
  bool bent;
};
class LayerVolumeView : public testing::TestWithParam<Case> {};
constexpr double kCutHeight = 0.23;
const View kOutside{"outside", {0.35, -0.5, 0.45}, {0.02, 0.0, 0.03}};
const View kInside{"inside", {0.03, -0.03, 0.12}, {0.09, 0.06, 0.0}};
const View kWall{"wall_in_near_plane", {0.0005, -0.075, 0.11}, {0.05, 0.02, 0.0}};
const View kAbove{"above_the_caster", {-0.1, -0.05, 0.6}, {0.0, 0.0, 0.0}};
INSTANTIATE_TEST_SUITE_P(Of, LayerVolumeView,
                         testing::Values(Case{kOutside, ShadowTechnique::layered, 0.16, false},
                                         Case{kOutside, ShadowTechnique::layered, 0.16, true},
                                         Case{kOutside, ShadowTechnique::layered, kCutHeight,
                                              false},
                                         Case{kOutside, ShadowTechnique::simple, 0.16, false},
                                         Case{kInside, ShadowTechnique::layered, 0.16, false},
                                         Case{kInside, ShadowTechnique::layered, 0.16, true},
                                         Case{kInside, ShadowTechnique::simple, 0.16, false},
                                         Case{kWall, ShadowTechnique::layered, 0.16, false},
                                         Case{kWall, ShadowTechnique::simple, 0.16, false},
                                         Case{kAbove, ShadowTechnique::layered, 0.16, false},
                                         Case{kAbove, ShadowTechnique::layered, kCutHeight, true}),
                         [](const auto& instance) {
                           const Case& c = instance.param;
                           return std::string(c.view.name) + "_" +
                                  std::string(to_string(c.technique)) +
                                  (c.height == kCutHeight ? "_cut" : "") + (c.bent ? "_bent" : "");
                         });

// A phantom box, a virtual one, and a tower beside the caster that is higher than it. An edge may
// fall to either side of a pixel's middle: but where all around is alike, no pixel is wrong.
TEST_P(LayerVolumeView, DarkensWhatIsUnderTheImaginaryMeshes) {
  const auto& [view, technique, height, bent] = GetParam();
  SceneBuilder builder = builder_with(technique);
  const Placement placement = test::at(0.01, 0.0, height, {0, 0, 1}, 0.3);
  builder.add(l_shape(), placement);
  const std::vector<Block> blocks = {{{-0.03, -0.06, 0.0}, {0.06, -0.01, 0.04}},
                                     {{0.01, 0.02, 0.0}, {0.12, 0.08, 0.02}},
                                     {{-0.12, -0.02, 0.0}, {-0.045, 0.03, 0.26}}};
  std::vector<int> of_block;
  for (std::size_t i = 0; i < blocks.size(); ++i) {
    of_block.push_back(blocks[i].add_to(builder, i != 1));
  }
  // From far away through a longer lens.
  const double focal = view.eye.z() > 0.2 ? 520.0 : 220.0;
  const CameraModel camera =
      bent ? test::bent_camera(kSide, focal) : test::camera_of(kSide, kSide, focal);
  Studio studio(builder.build(), camera);
  const PoseEstimate pose = test::tracked(test::look_at(view.eye, view.target));
  FramePlan plan = studio.plan(pose, by_volumes());
  ASSERT_EQ(plan.climbing, Climbing::volumes);
  // The caster's shadow without the caster's picture.
  std::erase_if(plan.objects, [](const ObjectDraw& draw) { return draw.object == 0; });
  const Picture with = studio.draw(white(), plan);
  FramePlan bare = plan;
  bare.received_shadows.clear();
  const Picture without = studio.draw(white(), bare);

  const ShadowNode& node = studio.scene().shadows[0];
  const Imaginary imaginary(*studio.scene().objects[0].model, placement, node);
  const glm::vec3 left = layer_light(plan.shadows.front());
  constexpr int kTable = 100;
  std::vector<int> expected(std::size_t{kSide} * kSide, -1);  // layer and block; -1: unknown
  std::vector<bool> wrong(expected.size());
  std::array<int, 4> seen{};
  int above = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const auto ray = camera.unproject({static_cast<double>(x), static_cast<double>(y)});
      if (!ray) continue;
      const Eigen::Vector3d d = pose.T_table_camera.rotation() * (*ray / ray->z());
      double t = -view.eye.z() / d.z();
      if (!(t > 0.0)) t = 1e9;
      const Block* shown = nullptr;
      for (const Block& block : blocks) {
        const double at = block.hit(view.eye, d);
        if (at >= t) continue;
        shown = &block;
        t = at;
      }
      const auto i = static_cast<std::size_t>(kSide * y + x);
      if (shown == nullptr) {
        // Planes have a pass of their own.
        expected[i] = kTable;
        wrong[i] = with.red(x, y) != without.red(x, y);
        continue;
      }
      const Eigen::Vector3d p = view.eye + t * d;
      const std::size_t layer = imaginary.layer_over(p);
      above += shown == &blocks[2] && p.z() > 0.2 && layer == 3 ? 1 : 0;
      expected[i] = static_cast<int>(layer) + 4 * static_cast<int>(shown - blocks.data());
      ++seen[layer];
      const float factor = layer < 3 ? left[static_cast<glm::length_t>(layer)] : 1.0F;
      wrong[i] = std::abs(static_cast<float>(with.red(x, y)) -
                          factor * static_cast<float>(without.red(x, y))) > 1.5F;
    }
  }
  const auto [beside_no_edge, wrong_there] = test::beside_no_edge(kSide, expected, wrong);
  EXPECT_GT(beside_no_edge, 2000);
  EXPECT_EQ(wrong_there, 0) << "of " << beside_no_edge;
  EXPECT_GT(seen[1], 300);
  EXPECT_GT(seen[3], 300) << "not all of it";
  if (technique == ShadowTechnique::layered) {
    EXPECT_GT(seen[0] + seen[2], 300);
  }
  if (std::string(view.name) == "above_the_caster") {
    EXPECT_GT(above, 20) << "the tower is higher than what casts";
  }
}

// A simple shadow's outline is the same at all heights: both ways show one picture on a top, but
// for edges, which heights smooth; sides are darkened by volumes alone.
TEST(LayerVolume, OfASimpleShadowIsThatOfItsHeights) {
  SceneBuilder builder = builder_with(ShadowTechnique::simple);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
  builder.add(box(0.4, 0.4, 0.06), test::at(0.02, 0.0, 0.03), false, true);
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 300.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.35, 0.6}, {0.0, 0.0, 0.05}));
  const Picture volumes = studio.draw_shadows(white(), studio.plan(pose, by_volumes()));
  const Picture heights = studio.draw_shadows(white(), studio.plan(pose));
  int dark = 0;
  int unlike = 0;
  for (int y = 1; y + 1 < kSide; ++y) {
    for (int x = 1; x + 1 < kSide; ++x) {
      dark += heights.red(x, y) < 250 ? 1 : 0;
      bool edge = false;
      for (int i = 0; i < 9; ++i)
        edge = edge || heights.red(x + i % 3 - 1, y + i / 3 - 1) != heights.red(x, y);
      unlike += !edge && std::abs(volumes.red(x, y) - heights.red(x, y)) > 1 ? 1 : 0;
    }
  }
  EXPECT_GT(dark, 1000);
  EXPECT_EQ(unlike, 0);
}

// Layers by volumes tell the height over the table, by heights that over the box: the umbra is
// smaller, and the penumbra larger, the higher the caster is over what it is seen on.
TEST(LayerVolume, TellsTheHeightOverThePlane) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(box(0.08, 0.08, 0.005), test::at(0.0, 0.0, 0.16));
  builder.add(box(0.4, 0.4, 0.1), test::at(0.0, 0.0, 0.05), false, true);
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 240.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.0, -0.001, 0.6}, {0.0, 0.0, 0.1}));
  const FramePlan plan = studio.plan(pose, by_volumes());
  const auto areas = [&](const Picture& picture) {
    std::array<int, 2> counted{};  // of the umbra, of all layers
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        counted[0] += picture.red(x, y) < 255 * 0.4 ? 1 : 0;
        counted[1] += picture.red(x, y) < 250 ? 1 : 0;
      }
    }
    return counted;
  };
  const auto volumes = areas(studio.draw_shadows(white(), plan));
  const auto heights = areas(studio.draw_shadows(white(), studio.plan(pose)));
  EXPECT_GT(volumes[0], 200);
  EXPECT_LT(volumes[0], 0.7 * heights[0]);
  EXPECT_GT(volumes[1], 1.1 * heights[1]);
}

// Of several casters the darkest layer counts, once, in whatever order they are given; and what
// fades, or what has another light, is darkened by as much as that.
TEST(LayerVolume, IsTheDarkestOfAllCasters) {
  const auto drawn = [](bool turned, bool first, bool second) {
    SceneBuilder builder = builder_with(ShadowTechnique::layered);
    const std::array<Placement, 2> places = {test::at(0.0, 0.0, 0.16),
                                             test::at(0.03, 0.02, 0.2, {0, 0, 1}, 1.0)};
    for (const std::size_t i :
         turned ? std::array<std::size_t, 2>{1, 0} : std::array<std::size_t, 2>{0, 1}) {
      builder.add(l_shape(), places[i], i == 0 ? first : second);
    }
    builder.add(box(0.3, 0.3, 0.06), test::at(0.02, 0.0, 0.03), false, true);
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 300.0));
    const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.35, 0.6}, {0.0, 0.0, 0.05}));
    return studio.draw_shadows(white(), studio.plan(pose, by_volumes()));
  };
  const Picture both = drawn(false, true, true);
  EXPECT_EQ(both, drawn(true, true, true));
  const Picture one = drawn(false, true, false);
  const Picture other = drawn(false, false, true);
  int overlap = 0;
  int wrong = 0;
  for (int y = 60; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      overlap += one.red(x, y) < 250 && other.red(x, y) < 250 ? 1 : 0;
      // (Off the box the table's mask mixes edges.)
      const int darkest = std::min(one.red(x, y), other.red(x, y));
      wrong += std::abs(both.red(x, y) - darkest) > 1 ? 1 : 0;
    }
  }
  EXPECT_GT(overlap, 1000);
  EXPECT_LT(wrong, 0.02 * overlap);
}

TEST(LayerVolume, IsKeptWhileOnlyTheCameraMoves) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
  builder.add(box(0.2, 0.2, 0.06), test::at(0.02, 0.0, 0.03), false, true);
  builder.add(box(0.03, 0.03, 0.03), test::at(0.12, 0.1, 0.015), false);
  Studio studio(builder.build(), test::camera_of(kSide, kSide, 300.0));
  Studio anew(builder.build(), test::camera_of(kSide, kSide, 300.0));
  const auto kept = [&] {
    return std::ranges::count(studio.stats().kept, "layer_volume", &KeptPart::what);
  };
  for (int i = 0; i < 4; ++i) {
    const PoseEstimate pose =
        test::tracked(test::look_at({0.1 + 0.02 * i, -0.35, 0.6}, {0.0, 0.0, 0.05}));
    const Picture picture = studio.draw(white(), studio.plan(pose, by_volumes()));
    EXPECT_EQ(kept(), i == 0 ? 0 : 1) << i;
    PlanOptions all = by_volumes();
    all.skip = false;
    EXPECT_EQ(picture, anew.draw(white(), anew.plan(pose, all))) << i;
    EXPECT_EQ(std::ranges::count(anew.stats().kept, "layer_volume", &KeptPart::what), 0);
  }
}

TEST(LayerVolume, IsTheSameWithoutBlending) {
  SceneBuilder builder = builder_with(ShadowTechnique::layered);
  builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
  builder.add(box(0.2, 0.2, 0.06), test::at(0.02, 0.0, 0.03), false);
  const auto scene = builder.build();
  const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.35, 0.6}, {0.0, 0.0, 0.05}));
  const auto drawn = [&](Translucency way, GlApi api) {
    Studio studio(scene, test::camera_of(kSide, kSide, 300.0), api);
    return studio.draw(white(), studio.plan(pose, by_volumes(way)));
  };
  const Picture blended = drawn(Translucency::blend, GlApi::gl33);
  EXPECT_EQ(blended, drawn(Translucency::blend, GlApi::gles30));
  const Picture retextured = drawn(Translucency::retexture, GlApi::gl33);
  const Picture door = drawn(Translucency::mesh, GlApi::gl33);
  PlanOptions none = by_volumes();
  none.technique = ShadowTechnique::none;
  Studio unshadowed(scene, test::camera_of(kSide, kSide, 300.0));
  const Picture lit = unshadowed.draw(white(), unshadowed.plan(pose, none));
  int unlike = 0;
  int dark = 0;
  int black = 0;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      unlike += std::abs(blended.red(x, y) - retextured.red(x, y)) > 1 ? 1 : 0;
      const bool darkened = blended.red(x, y) < lit.red(x, y);
      dark += darkened ? 1 : 0;
      black += door.red(x, y) == 0 && lit.red(x, y) > 0 && darkened ? 1 : 0;
    }
  }
  EXPECT_EQ(unlike, 0);
  EXPECT_GT(dark, 1000);
  EXPECT_GT(black, 0.1 * dark);
  EXPECT_LT(black, 0.9 * dark);
}

// Fields and lights of one size have no imaginary mesh with one outline: all is drawn by heights,
// and the plan says so. What is left out of a frame doesn't decide.
TEST(LayerVolume, IsNotOfLightsOfOneSize) {
  for (const bool field : {false, true}) {
    SceneBuilder builder = builder_with(field ? ShadowTechnique::field : ShadowTechnique::layered);
    if (!field) builder.scene().shadows[0].light_mode = LightMode::fixed;
    builder.add(l_shape(), test::at(0.0, 0.0, 0.16));
    builder.add(box(0.2, 0.2, 0.06), test::at(0.02, 0.0, 0.03), false, true);
    Studio studio(builder.build(), test::camera_of(kSide, kSide, 300.0));
    const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.35, 0.6}, {0.0, 0.0, 0.05}));
    const FramePlan plan = studio.plan(pose, by_volumes());
    EXPECT_EQ(plan.climbing, Climbing::heights);
    EXPECT_EQ(std::ranges::count(plan.skipped, "volumes_impossible", &SkippedPass::what), 1);
    EXPECT_EQ(studio.draw(white(), plan), studio.draw(white(), studio.plan(pose)));
    // Of two nodes, the one whose light is of one size casts on nothing.
    Scene two = builder.scene();
    two.shadows.push_back(two.shadows[0]);
    two.shadows[0].technique = ShadowTechnique::layered;
    two.shadows[0].light_mode = LightMode::proportional;
    two.objects.push_back(two.objects[0]);
    two.objects.back().placement = test::at(3.0, 3.0, 0.16);
    two.shadows[1].casters = {static_cast<int>(two.objects.size()) - 1};
    Studio both(std::make_shared<const Scene>(two), test::camera_of(kSide, kSide, 300.0));
    PlanOptions all = by_volumes();
    all.skip = false;
    EXPECT_EQ(both.draw(white(), both.plan(pose, by_volumes())),
              both.draw(white(), both.plan(pose, all)));
  }
}

// Every edge of a batch is run through as often one way as the other, whatever casts, be it cut;
// and nothing that is not finite comes out.
TEST(LayerVolume, IsClosedWhateverCastsIt) {
  std::mt19937 random(11);
  std::uniform_real_distribution<double> place(-0.1, 0.1);
  std::uniform_real_distribution<double> height(-0.05, 0.5);
  const LayeredConstants constants = make_layered_constants(0.6, 2.5, 0.0).value();
  int volumes = 0;
  for (int i = 0; i < 120; ++i) {
    ShapeBuilder shape;
    for (int face = 0; face < 6; ++face) {
      const auto corner = [&] {
        return shape.vertex(place(random), place(random), height(random));
      };
      const std::uint32_t a = corner();
      const std::uint32_t b = corner();
      shape.triangle(a, b, corner());
    }
    if (i % 3 == 0) shape.box(-0.03, -0.03, 0.2, 0.03, 0.03, 0.2 + std::abs(height(random)));
    const ShadowMesh mesh = make_shadow_mesh(shape.build());
    const ShadowKernels kernels =
        generate_kernels(mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
    const PlaneFrame plane = PlaneFrame::make({0.1 * place(random), 0.2, 1.0}, {0.1, 0.0, -0.02});
    CasterOverPlane over{place_caster(mesh, kernels, Placement(), plane), &mesh, constants};
    const LayerVolumeCaster caster(mesh);
    for (const ShadowLayer layer : kShadowLayers) {
      const ShadowVolume volume = caster.volume(over, layer, plane);
      volumes += volume.triangles.empty() ? 0 : 1;
      std::size_t begin = 0;
      for (const std::size_t end : volume.batch_ends) {
        using Point = std::tuple<float, float, float>;
        std::map<std::pair<Point, Point>, int> edges;
        for (std::size_t t = begin; t + 2 < end; t += 3) {
          for (std::size_t k = 0; k < 3; ++k) {
            const glm::vec3& p = volume.triangles[t + k];
            const glm::vec3& q = volume.triangles[t + (k + 1) % 3];
            ASSERT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
            const Point a(p.x, p.y, p.z);
            const Point b(q.x, q.y, q.z);
            if (a < b) ++edges[{a, b}];
            if (b < a) --edges[{b, a}];
          }
        }
        EXPECT_TRUE(std::ranges::all_of(edges, [](const auto& edge) { return edge.second == 0; }));
        begin = end;
      }
    }
    over.vertices[static_cast<std::size_t>(i) % over.vertices.size()].u =
        std::numeric_limits<float>::quiet_NaN();
    for (const ShadowLayer layer : kShadowLayers) {
      for (const glm::vec3& p : caster.volume(over, layer, plane).triangles)
        ASSERT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
    }
  }
  EXPECT_GT(volumes, 250);
}

}  // namespace
}  // namespace penumbra::layer_volume_test
