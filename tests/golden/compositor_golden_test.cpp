// Composited frames of recorded video, 320 x 240, at true poses, compared with golden images.
// Further tests show that the comparison detects wrong images.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <set>

#include "core/camera/camera_file.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "render/passes/rectified_video.hpp"
#include "support/golden.hpp"
#include "support/run_program.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using test::compare;
using test::matches_golden;
using test::Studio;

// A recorded frame, its camera and its true pose, at half size.
struct View {
  CameraModel camera;
  Frame frame;
  CameraPose T_table_camera;
};

void halve(const PixelPlane& from, const PixelPlane& to, std::uint8_t* out) {
  for (int y = 0; y < to.height; ++y) {
    for (int x = 0; x < to.width; ++x) {
      const std::uint8_t* a = from.data + 2 * y * from.stride + 2 * x;
      const std::uint8_t* b = a + from.stride;
      out[y * to.stride + x] = static_cast<std::uint8_t>((a[0] + a[1] + b[0] + b[1] + 2) / 4);
    }
  }
}

Result<View> half_size_view(const std::string& recording, int number) {
  const auto folder = test::recordings_dir() / recording;
  const auto camera = load_camera(folder / "camera.yaml");
  if (!camera) return tl::unexpected(camera.error());
  const auto frame = load_image(folder / "frames" / fmt::format("{:06}.jpg", number));
  if (!frame) return tl::unexpected(frame.error());
  const auto truth = load_trajectory(folder / "groundtruth.tum");
  if (!truth) return tl::unexpected(truth.error());

  CameraParameters p = camera->parameters();
  p.width /= 2;
  p.height /= 2;
  p.fx *= 0.5;
  p.fy *= 0.5;
  p.cx = 0.5 * p.cx - 0.25;  // pixel (0, 0) of the half-size image is the mean of four pixels
  p.cy = 0.5 * p.cy - 0.25;
  View view{CameraModel::make(p).value(), {}, {}};
  FrameBuffer buffer = allocate_frame(frame->format, p.width, p.height);
  for (std::size_t i = 0; i < static_cast<std::size_t>(frame->plane_count); ++i)
    halve(frame->planes[i], buffer.frame.planes[i], buffer.plane_data[i]);
  buffer.frame.color_matrix = frame->color_matrix;
  buffer.frame.color_range = frame->color_range;
  view.frame = buffer.frame;
  view.T_table_camera = truth->poses.at(static_cast<std::size_t>(number)).T_table_camera;
  return view;
}

// Solids over the sheet: level and tilted, one of them clipped at the umbra height.
std::shared_ptr<const Scene> solids() {
  test::SceneBuilder builder;
  test::ShapeBuilder ring;
  ring.torus(0.034, 0.011, 24, 64);
  builder.add(test::finished(ring.build(), {0.75F, 0.16F, 0.08F, 1.0F}),
              test::at(0.055, 0.02, 0.075, {1.0, 0.2, 0.0}, 0.35));
  test::ShapeBuilder block;
  block.box(-0.022, -0.022, 0.0, 0.022, 0.022, 0.044);
  builder.add(test::finished(block.build(), {0.1F, 0.32F, 0.62F, 1.0F}),
              test::at(-0.06, 0.035, 0.03, {0, 0, 1}, 0.5));
  test::ShapeBuilder bar;
  bar.box(-0.06, -0.008, -0.008, 0.06, 0.008, 0.008);
  builder.add(test::finished(bar.build(), {0.85F, 0.6F, 0.1F, 1.0F}),
              test::at(-0.01, -0.045, 0.095, {0.1, 1.0, 0.3}, -0.4));
  builder.scene().shadows[0].layered = make_layered_constants(0.36, 3.0, 0.0).value();
  SceneLight lamp;
  lamp.position = {-0.2, -0.1, 0.8};
  lamp.intensity = 0.85;
  builder.scene().lights.push_back(lamp);
  builder.scene().name = "solids";
  return builder.build();
}

// Draws like the program, with smooth edges. `video_on_cpu` as in CompositorOptions.
Studio program_studio(std::shared_ptr<const Scene> scene, const CameraModel& camera,
                      std::optional<bool> video_on_cpu = std::nullopt) {
  return {std::move(scene), camera, GlApi::gl33, {.video_on_cpu = video_on_cpu}};
}

RgbaImage image_of(const test::RenderedImage& image) {
  return {image.width, image.height, image.rgba};
}

// State of the scene at `time_s`, lit by the video as in the program's first frame.
SceneState lit(const Scene& scene, const View& view, double time_s,
               std::span<const GroupEstimate> groups = {}) {
  SceneState state = evaluate_scene(scene, time_s, groups);
  state.video_light = measure_light(view.frame, view.camera.parameters().tone_curve);
  return state;
}

RgbaImage composite(const View& view, ShadowTechnique technique,
                    const std::shared_ptr<const Scene>& scene, double time_s,
                    Translucency translucency = Translucency::automatic,
                    std::optional<bool> video_on_cpu = std::nullopt) {
  Studio studio = program_studio(scene, view.camera, video_on_cpu);
  PlanOptions options;
  options.technique = technique;
  options.translucency = translucency;
  const FramePlan plan = plan_frame(*scene, lit(*scene, view, time_s),
                                    test::tracked(view.T_table_camera), view.camera, options);
  return image_of(studio.draw(view.frame, plan));
}

// Draws the solids with the lights of their scene only, without the video's light.
RgbaImage composite(const View& view, ShadowTechnique technique) {
  Studio studio = program_studio(solids(), view.camera);
  PlanOptions options;
  options.technique = technique;
  return image_of(
      studio.draw(view.frame, studio.plan(test::tracked(view.T_table_camera), options)));
}

struct Case {
  const char* recording;
  ShadowTechnique technique;
  int frame;
};
class SolidsScene : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(Golden, SolidsScene,
                         testing::Values(Case{"tabletop", ShadowTechnique::layered, 0},
                                         Case{"tabletop", ShadowTechnique::layered, 75},
                                         Case{"tabletop", ShadowTechnique::simple, 0},
                                         Case{"corner", ShadowTechnique::layered, 20},
                                         Case{"corner", ShadowTechnique::field, 20}),
                         [](const auto& instance) {
                           return std::string(instance.param.recording) + "_" +
                                  std::string(to_string(instance.param.technique)) + "_" +
                                  std::to_string(instance.param.frame);
                         });

TEST_P(SolidsScene, CompositedFrameMatchesGolden) {
  const Case& c = GetParam();
  const auto view = half_size_view(c.recording, c.frame);
  ASSERT_TRUE(view) << view.error().message;
  EXPECT_TRUE(matches_golden(
      fmt::format("solids__{}__{}__{:06}", c.recording, to_string(c.technique), c.frame),
      composite(*view, c.technique)));
}

// The default scene at the frame's time.
class DefaultScene : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(Golden, DefaultScene,
                         testing::Values(Case{"tabletop", ShadowTechnique::layered, 0},
                                         Case{"tabletop", ShadowTechnique::layered, 60},
                                         Case{"tabletop", ShadowTechnique::layered, 110},
                                         Case{"tabletop", ShadowTechnique::field, 60},
                                         Case{"tabletop", ShadowTechnique::field, 110},
                                         Case{"tabletop", ShadowTechnique::simple, 60},
                                         Case{"tabletop", ShadowTechnique::simple, 110},
                                         Case{"tabletop", ShadowTechnique::walls, 60},
                                         Case{"tabletop", ShadowTechnique::hard, 60},
                                         Case{"tabletop", ShadowTechnique::hard, 110},
                                         Case{"tabletop", ShadowTechnique::volume, 110},
                                         Case{"corner", ShadowTechnique::layered, 30},
                                         Case{"corner", ShadowTechnique::hard, 30}),
                         [](const auto& instance) {
                           return std::string(instance.param.recording) + "_" +
                                  std::string(to_string(instance.param.technique)) + "_" +
                                  std::to_string(instance.param.frame);
                         });

TEST_P(DefaultScene, CompositedFrameMatchesGolden) {
  const Case& c = GetParam();
  const auto view = half_size_view(c.recording, c.frame);
  ASSERT_TRUE(view) << view.error().message;
  const auto loaded = load_scene(test::source_dir() / "scenes" / "default.json");
  ASSERT_TRUE(loaded) << loaded.error().message;
  const auto scene = std::make_shared<const Scene>(*loaded);
  const double time_s = c.frame / 30.0;
  const RgbaImage image = composite(*view, c.technique, scene, time_s);
  EXPECT_TRUE(matches_golden(
      fmt::format("default__{}__{}__{:06}", c.recording, to_string(c.technique), c.frame), image));
  // A shader converts the video if a GPU draws.
  const RgbaImage by_shader =
      composite(*view, c.technique, scene, time_s, Translucency::automatic, false);
  EXPECT_NE(image.pixels, by_shader.pixels);
  EXPECT_TRUE(compare(image, by_shader).acceptable());
}

// The default scene in the translucency modes other than blending.
struct TranslucentCase {
  Translucency translucency;
  ShadowTechnique technique;
  int frame;
};
class TranslucentScene : public testing::TestWithParam<TranslucentCase> {};
INSTANTIATE_TEST_SUITE_P(
    Golden, TranslucentScene,
    testing::Values(TranslucentCase{Translucency::mesh, ShadowTechnique::layered, 60},
                    TranslucentCase{Translucency::mesh, ShadowTechnique::layered, 110},
                    TranslucentCase{Translucency::mesh, ShadowTechnique::field, 60},
                    TranslucentCase{Translucency::mesh, ShadowTechnique::hard, 110},
                    TranslucentCase{Translucency::mesh, ShadowTechnique::volume, 110},
                    TranslucentCase{Translucency::retexture, ShadowTechnique::layered, 110},
                    TranslucentCase{Translucency::geometry_mesh, ShadowTechnique::layered, 60}),
    [](const auto& instance) {
      std::string name = fmt::format("{}_{}_{}", to_string(instance.param.technique),
                                     to_string(instance.param.translucency), instance.param.frame);
      std::ranges::replace(name, '-', '_');
      return name;
    });

TEST_P(TranslucentScene, CompositedFrameMatchesGolden) {
  const TranslucentCase& c = GetParam();
  const auto view = half_size_view("tabletop", c.frame);
  ASSERT_TRUE(view) << view.error().message;
  const auto loaded = load_scene(test::source_dir() / "scenes" / "default.json");
  ASSERT_TRUE(loaded) << loaded.error().message;
  const auto scene = std::make_shared<const Scene>(*loaded);
  const double time_s = c.frame / 30.0;
  const RgbaImage image = composite(*view, c.technique, scene, time_s, c.translucency);
  EXPECT_TRUE(matches_golden(fmt::format("default__tabletop__{}-{}__{:06}", to_string(c.technique),
                                         to_string(c.translucency), c.frame),
                             image));
  const RgbaImage by_shader = composite(*view, c.technique, scene, time_s, c.translucency, false);
  EXPECT_EQ(image.pixels == by_shader.pixels, c.translucency == Translucency::retexture);
  EXPECT_TRUE(compare(image, by_shader).acceptable());
}

// The default scene, drawn without lens distortion.
TEST(RectifiedView, CompositedFrameMatchesGolden) {
  const auto view = half_size_view("tabletop", 60);
  ASSERT_TRUE(view) << view.error().message;
  const auto loaded = load_scene(test::source_dir() / "scenes" / "default.json");
  ASSERT_TRUE(loaded) << loaded.error().message;
  const auto scene = std::make_shared<const Scene>(*loaded);
  const auto context = create_offscreen_context();
  ASSERT_TRUE(context) << context.error().message;
  auto compositor = Compositor::create(**context, scene, view->camera, {.rectified = true});
  ASSERT_TRUE(compositor) << compositor.error().message;
  const FramePlan plan =
      plan_frame(*scene, lit(*scene, *view, 2.0), test::tracked(view->T_table_camera),
                 without_distortion(view->camera));
  const auto drawn = compositor->draw(view->frame, plan);
  ASSERT_TRUE(drawn) << drawn.error().message;
  RgbaImage image{view->camera.width(), view->camera.height(), {}};
  image.pixels.resize(std::size_t{4} * static_cast<std::size_t>(image.width) *
                      static_cast<std::size_t>(image.height));
  ASSERT_TRUE(compositor->read_back(image.pixels));
  EXPECT_TRUE(matches_golden("default__tabletop__layered-rectified__000060", image));
  EXPECT_FALSE(compare(image, composite(*view, ShadowTechnique::layered, scene, 2.0)).acceptable());
}

// The bundled scenes other than the default, each with the technique of its file or another one.
struct SceneCase {
  const char* scene;
  const char* recording;
  int frame;
  std::optional<ShadowTechnique> technique = std::nullopt;  // nullopt: the scene's own technique
};
constexpr std::array kSceneCases = {
    SceneCase{"boxes", "tabletop", 45},
    SceneCase{"colored_cube", "tabletop", 20},
    SceneCase{"tree", "tabletop", 20},
    SceneCase{"tree", "tabletop", 90},
    SceneCase{"staircase", "tabletop", 40},
    SceneCase{"hand", "tabletop", 30},
    SceneCase{"cursor", "tabletop", 60},
    SceneCase{"cursor", "tabletop", 119},
    SceneCase{"corner", "corner", 12},
    SceneCase{"stack", "tabletop", 30},
    SceneCase{"stack", "tabletop", 100},
    SceneCase{"stack", "tabletop", 60, ShadowTechnique::field},
    SceneCase{"stack", "tabletop", 110, ShadowTechnique::hard},
    SceneCase{"stack", "corner", 20, ShadowTechnique::simple},
    SceneCase{"boxes", "tabletop", 45, ShadowTechnique::volume},
    SceneCase{"boxes", "corner", 30, ShadowTechnique::field},
    SceneCase{"colored_cube", "tabletop", 20, ShadowTechnique::layered},
    SceneCase{"colored_cube", "corner", 10, ShadowTechnique::volume},
    SceneCase{"hand", "tabletop", 30, ShadowTechnique::layered},
    SceneCase{"staircase", "tabletop", 40, ShadowTechnique::layered},
    SceneCase{"tree", "tabletop", 60, ShadowTechnique::layered},
    SceneCase{"corner", "corner", 30, ShadowTechnique::volume},
    SceneCase{"cursor", "tabletop", 90, ShadowTechnique::walls}};
class BundledScene : public testing::TestWithParam<SceneCase> {};
INSTANTIATE_TEST_SUITE_P(Golden, BundledScene, testing::ValuesIn(kSceneCases),
                         [](const auto& instance) {
                           const SceneCase& c = instance.param;
                           const std::string name = std::string(c.scene) + "_" + c.recording + "_" +
                                                    std::to_string(c.frame);
                           return c.technique ? name + "_" + std::string(to_string(*c.technique))
                                              : name;
                         });

TEST_P(BundledScene, CompositedFrameMatchesGolden) {
  const SceneCase& c = GetParam();
  const auto view = half_size_view(c.recording, c.frame);
  ASSERT_TRUE(view) << view.error().message;
  const auto loaded = load_scene(test::source_dir() / "scenes" / (std::string(c.scene) + ".json"));
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_TRUE(loaded->warnings.empty()) << loaded->warnings.front();
  EXPECT_TRUE(loaded->layered_advice.empty()) << loaded->layered_advice.front().text;
  const auto scene = std::make_shared<const Scene>(*loaded);
  // The upright board has the pose of the tag map.
  GroupEstimate wall;
  wall.name = "wall";
  wall.status = TrackStatus::tracked;
  const SceneState state = lit(*scene, *view, c.frame / 30.0, {&wall, 1});
  Studio studio = program_studio(scene, view->camera);
  PlanOptions options;
  options.technique = c.technique;
  const FramePlan plan =
      plan_frame(*scene, state, test::tracked(view->T_table_camera), view->camera, options);
  const ShadowTechnique technique = c.technique.value_or(scene->shadows.at(0).technique);
  EXPECT_TRUE(matches_golden(
      fmt::format("{}__{}__{}__{:06}", c.scene, c.recording, to_string(technique), c.frame),
      image_of(studio.draw(view->frame, plan))));
}

// The empty table, which --object puts models on.
TEST(TableScene, ShowsAddedObjectWithLayeredShadow) {
  const auto view = half_size_view("tabletop", 60);
  ASSERT_TRUE(view) << view.error().message;
  auto scene = load_scene(test::source_dir() / "scenes" / "table.json");
  ASSERT_TRUE(scene) << scene.error().message;
  EXPECT_TRUE(scene->warnings.empty());
  auto model = load_model(test::source_dir() / "scenes" / "models" / "tree.glb");
  ASSERT_TRUE(model) << model.error().message;
  SceneObject tree;
  tree.name = "tree";
  tree.model = std::make_shared<const Model>(std::move(*model));
  tree.placement.position = {0.19, 0.0, 0.0};
  add_object(*scene, std::move(tree));
  const auto shown = std::make_shared<const Scene>(std::move(*scene));
  const SceneState state = lit(*shown, *view, 2.0);
  Studio studio = program_studio(shown, view->camera);
  const FramePlan plan =
      plan_frame(*shown, state, test::tracked(view->T_table_camera), view->camera, {});
  EXPECT_TRUE(
      matches_golden("table__tabletop__layered__000060", image_of(studio.draw(view->frame, plan))));
}

TEST(BundledSceneList, HasGoldenImageAndReadmeLineForEveryScene) {
  std::set<std::string> with_golden_image = {"default", "table"};
  for (const SceneCase& c : kSceneCases) with_golden_image.insert(c.scene);
  std::ifstream stream(test::source_dir() / "README.md");
  const std::string readme((std::istreambuf_iterator<char>(stream)),
                           std::istreambuf_iterator<char>());
  for (const auto& entry : std::filesystem::directory_iterator(test::source_dir() / "scenes")) {
    const std::string name = entry.path().filename().string();
    if (entry.path().extension() != ".json" || name == "scene.schema.json") continue;
    EXPECT_TRUE(with_golden_image.contains(entry.path().stem().string())) << name;
    EXPECT_NE(readme.find("scenes/" + name), std::string::npos) << name;
  }
  EXPECT_GE(with_golden_image.size(), 8U);
}

// The shadow falls on the phantom before the recording ends, so the image without the phantom must
// differ.
TEST(DefaultScenePhantom, ReceivesShadowBeforeRecordingEnds) {
  const auto view = half_size_view("tabletop", 116);
  ASSERT_TRUE(view) << view.error().message;
  const auto scene = load_scene(test::source_dir() / "scenes" / "default.json");
  ASSERT_TRUE(scene) << scene.error().message;
  Scene without = *scene;
  std::erase_if(without.objects, [](const SceneObject& object) { return object.phantom; });
  ASSERT_LT(without.objects.size(), scene->objects.size());
  const auto at_frame = [&](const Scene& which) {
    return composite(*view, ShadowTechnique::layered, std::make_shared<const Scene>(which),
                     116 / 30.0);
  };
  EXPECT_NE(at_frame(*scene).pixels, at_frame(without).pixels);
}

// The program must draw what these tests draw: full-size frames written by `replay` are compared
// with frames drawn here.
class ReplayCommand : public testing::TestWithParam<Case> {};
INSTANTIATE_TEST_SUITE_P(Golden, ReplayCommand,
                         testing::Values(Case{"tabletop", ShadowTechnique::layered, 60},
                                         Case{"tabletop", ShadowTechnique::hard, 110},
                                         Case{"corner", ShadowTechnique::layered, 30}),
                         [](const auto& instance) {
                           return std::string(instance.param.recording) + "_" +
                                  std::string(to_string(instance.param.technique)) + "_" +
                                  std::to_string(instance.param.frame);
                         });

TEST_P(ReplayCommand, WritesFrameDrawnByCompositor) {
  const Case& c = GetParam();
  const auto folder = test::recordings_dir() / c.recording;
  const test::TemporaryFolder out;
  const auto ran = test::run_program(
      test::program(), {"replay", folder, "--no-window", "--poses-from", "groundtruth", "--shadow",
                        std::string(to_string(c.technique)), "--frames",
                        fmt::format("{}:{}", c.frame, c.frame + 1), "--output", out.path()});
  ASSERT_EQ(ran.exit_code, 0) << ran.err;
  const auto written = load_rgba(out.path() / fmt::format("{:06}.png", c.frame));
  ASSERT_TRUE(written) << written.error().message;

  const auto camera = load_camera(folder / "camera.yaml");
  const auto frame = load_image(folder / "frames" / fmt::format("{:06}.jpg", c.frame));
  const auto truth = load_trajectory(folder / "groundtruth.tum");
  const auto scene = load_scene(test::source_dir() / "scenes" / "default.json");
  ASSERT_TRUE(camera && frame && truth && scene);
  const auto at = static_cast<std::size_t>(c.frame);
  const double time_s = 1e-9 * static_cast<double>(truth->poses.at(at).timestamp_ns -
                                                   truth->poses.front().timestamp_ns);
  const View view{*camera, *frame, truth->poses.at(at).T_table_camera};
  const auto shared = std::make_shared<const Scene>(*scene);
  EXPECT_TRUE(compare(*written, composite(view, c.technique, shared, time_s)).acceptable());
  // The comparison must distinguish this frame from the next one.
  EXPECT_FALSE(
      compare(*written, composite(view, c.technique, shared, time_s + 1.0 / 30.0)).acceptable());
}

std::string layer_name(ShadowLayer layer) {
  constexpr std::array kNames = {"umbra", "middle", "penumbra"};
  return kNames[static_cast<std::size_t>(layer)];
}

// The comparison must detect a wrong shadow: a missing layer, or a layer shifted by 2 px.
class GoldenLayerComparison : public testing::TestWithParam<ShadowLayer> {};
INSTANTIATE_TEST_SUITE_P(Golden, GoldenLayerComparison, testing::ValuesIn(kShadowLayers),
                         [](const auto& layer) { return layer_name(layer.param); });

void keep_only(ShadowDraw& draw, ShadowLayer layer) {
  draw.umbra = draw.umbra && layer == ShadowLayer::umbra;
  draw.middle = draw.middle && layer == ShadowLayer::middle;
  draw.penumbra = draw.penumbra && layer == ShadowLayer::penumbra;
}
void reject(ShadowDraw& draw, ShadowLayer layer) {
  draw.umbra = draw.umbra && layer != ShadowLayer::umbra;
  draw.middle = draw.middle && layer != ShadowLayer::middle;
  draw.penumbra = draw.penumbra && layer != ShadowLayer::penumbra;
}

TEST_P(GoldenLayerComparison, DetectsMissingLayer) {
  const auto view = half_size_view("tabletop", 0);
  ASSERT_TRUE(view) << view.error().message;
  const RgbaImage expected = composite(*view, ShadowTechnique::layered);
  Studio studio = program_studio(solids(), view->camera);
  // Only one object's layer changes, which is hardest to detect.
  for (std::size_t object = 0; object < 3; ++object) {
    FramePlan plan = studio.plan(test::tracked(view->T_table_camera));
    reject(plan.shadows.at(object), GetParam());
    EXPECT_FALSE(compare(image_of(studio.draw(view->frame, plan)), expected).acceptable())
        << object;
  }
}

TEST_P(GoldenLayerComparison, DetectsLayerShiftedByTwoPixels) {
  const auto view = half_size_view("tabletop", 0);
  ASSERT_TRUE(view) << view.error().message;
  const RgbaImage expected = composite(*view, ShadowTechnique::layered);
  Studio studio = program_studio(solids(), view->camera);
  const FramePlan plan = studio.plan(test::tracked(view->T_table_camera));
  for (std::size_t object = 0; object < 3; ++object) {
    // Displacement on the table that moves the layer by 2 px in the image.
    const Eigen::Vector3d at = plan.shadows.at(object).T_table_object.position;
    const auto pixel = [&](double dx) {
      return *view->camera.project(plan.T_table_camera.inverse() *
                                   Eigen::Vector3d(at.x() + dx, at.y(), 0.0));
    };
    const double metres = 2.0 / ((pixel(1e-4) - pixel(-1e-4)).norm() / 2e-4);
    FramePlan moved = plan;
    ShadowDraw layer = plan.shadows[object];
    keep_only(layer, GetParam());
    layer.T_table_object.position.x() += metres;
    reject(moved.shadows[object], GetParam());
    moved.shadows.push_back(layer);
    const auto difference = compare(image_of(studio.draw(view->frame, moved)), expected);
    EXPECT_FALSE(difference.acceptable()) << object << ": " << difference.over_tolerance;

    // Without the shift, the separately drawn layer gives the same image.
    moved.shadows.back().T_table_object.position = at;
    EXPECT_TRUE(compare(image_of(studio.draw(view->frame, moved)), expected).exact) << object;
  }
}

TEST(GoldenComparison, AcceptsTwoGreyLevelsAndOneOutlierInTenThousand) {
  RgbaImage a{100, 100, std::vector<std::uint8_t>(40'000, 100)};
  RgbaImage b = a;
  EXPECT_TRUE(compare(a, b).exact);
  for (std::size_t i = 0; i < b.pixels.size(); i += 4) b.pixels[i] = 102;
  EXPECT_FALSE(compare(a, b).exact);
  EXPECT_TRUE(compare(a, b).acceptable()) << "2 grey levels in every pixel";
  b.pixels[0] = 200;
  EXPECT_TRUE(compare(a, b).acceptable()) << "1 of 10 000 pixels";
  b.pixels[4] = 103;
  EXPECT_FALSE(compare(a, b).acceptable()) << "2 of 10 000";
  b.width = 50;
  EXPECT_FALSE(compare(a, b).acceptable()) << "another size";
}

}  // namespace
}  // namespace penumbra
