// Time of what shadows need on the CPU: welding, kernels, layers, polygons.
#include <benchmark/benchmark.h>

#include <array>
#include <optional>
#include <string>
#include <utility>

#include "render/shadow/caster.hpp"
#include "render/shadow/layer_polygons.hpp"
#include "render/shadow/layer_update.hpp"
#include "support/kernel_quality.hpp"
#include "support/shapes.hpp"

namespace penumbra {
namespace {

Model shared_model(const char* name) {
  const auto folder = test::shared_dir();
  if (folder.empty()) return {};
  const auto json = test::read_json(folder / "vectors" / "meshes" / name);
  return test::model_of(json.at("vertices").get<std::vector<float>>(),
                        json.at("triangles").get<std::vector<std::uint32_t>>());
}

enum class Shape { hand, torus_3k, torus_104k, tree, bush };
constexpr std::array kShapes = {std::pair{Shape::hand, "hand 3k faces"},
                                std::pair{Shape::torus_3k, "torus 3k faces"},
                                std::pair{Shape::torus_104k, "torus 104k faces"},
                                std::pair{Shape::tree, "tree 23k faces in 1463 parts"},
                                std::pair{Shape::bush, "bush 23k faces in 1463 parts"}};

// Empty for what is not there.
ShadowMesh mesh_of(Shape shape) {
  switch (shape) {
    case Shape::hand:
      return make_shadow_mesh(shared_model("hand.json"));
    case Shape::tree:
      return make_shadow_mesh(shared_model("tree.json"));
    case Shape::torus_3k:
      return make_shadow_mesh(test::torus_model(24, 64));
    case Shape::torus_104k:
      return make_shadow_mesh(test::torus_model(160, 325));
    case Shape::bush:
      return make_shadow_mesh(test::bush_model(1462));
  }
  return {};
}

// A model whose weld gives the mesh again.
Model model_of(const ShadowMesh& mesh) {
  Model model;
  model.meshes.emplace_back();
  model.meshes[0].positions = mesh.positions;
  model.meshes[0].indices = mesh.indices;
  return model;
}

void weld(benchmark::State& state, Shape shape) {
  const Model model = model_of(mesh_of(shape));
  for (auto _ : state) benchmark::DoNotOptimize(make_shadow_mesh(model));
}

void kernels(benchmark::State& state, Shape shape, KernelSource source) {
  const ShadowMesh mesh = mesh_of(shape);
  const Eigen::Vector3d up = Eigen::Vector3d(0.1, 0.2, 1.0);
  for (auto _ : state) benchmark::DoNotOptimize(generate_kernels(mesh, up, source));
}

// Agreement with ray-cast shadows beside the time of all 20 cases: mean IoU of umbra and penumbra.
void agreement(benchmark::State& state, std::optional<KernelSource> kernels) {
  const test::QualityCases all;
  if (all.cases().empty()) {
    state.SkipWithError("no shared data beside the checkout");
    return;
  }
  const auto count = static_cast<double>(all.cases().size());
  double sum[2] = {0.0, 0.0};
  for (auto _ : state) {
    sum[0] = sum[1] = 0.0;
    for (const test::QualityCase& quality : all.cases()) {
      std::size_t which = 0;
      for (const auto& [layer, key] : test::kJudgedLayers) {
        sum[which++] +=
            kernels ? quality.kernel_iou(*kernels, layer, key) : quality.field_iou(layer, key);
      }
    }
  }
  state.counters["umbra_iou"] = sum[0] / count;
  state.counters["penumbra_iou"] = sum[1] / count;
}
BENCHMARK_CAPTURE(agreement, cocl, KernelSource::centroid)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(agreement, per_axis, KernelSource::per_axis)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(agreement, automatic, KernelSource::automatic)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(agreement, smooth, KernelSource::smooth)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(agreement, field, std::nullopt)->Unit(benchmark::kMillisecond);

// Three layers of the paper's tree size, and a plain copy of the same numbers.
ShadowMesh mesh_of_vertices(std::size_t count) {
  ShadowMesh mesh = make_shadow_mesh(test::bush_model(1462));
  mesh.positions.resize(count);
  return mesh;
}
void layer_update(benchmark::State& state) {
  const ShadowMesh mesh = mesh_of_vertices(static_cast<std::size_t>(state.range(0)));
  ShadowKernels kernels;
  kernels.kernels = mesh.positions;
  for (glm::vec3& k : kernels.kernels) k.x += 0.01F;
  const CasterArrays caster = CasterArrays::make(mesh, kernels);
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  Placement placement;
  LayerArrays layers;
  for (auto _ : state) {
    placement.position.z() += 1e-6;
    update_layers(caster, placement, PlaneFrame(), constants, layers);
    benchmark::DoNotOptimize(layers.u[2].data());
    benchmark::ClobberMemory();
  }
}
BENCHMARK(layer_update)->Arg(12581)->Unit(benchmark::kMicrosecond);
void layer_copy(benchmark::State& state) {
  const auto count = static_cast<std::size_t>(state.range(0));
  const std::vector<float> from(6 * count, 1.0F);
  std::vector<float> to(7 * count);
  for (auto _ : state) {
    std::copy(from.begin(), from.end(), to.begin());
    std::copy(from.begin(), from.begin() + static_cast<std::ptrdiff_t>(count),
              to.begin() + static_cast<std::ptrdiff_t>(6 * count));
    benchmark::DoNotOptimize(to.data());
    benchmark::ClobberMemory();
  }
}
BENCHMARK(layer_copy)->Arg(12581)->Unit(benchmark::kMicrosecond);

void field(benchmark::State& state, Shape shape, bool own_lights) {
  const ShadowMesh mesh = mesh_of(shape);
  const PlaneFrame plane;
  const Placement placement = {Eigen::Vector3d(0, 0, 0.12), Eigen::Quaterniond::Identity(), 1.0};
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const ShadowKernels none{plane.n, mesh.positions, {}};
  const auto vertices = place_caster(mesh, none, placement, plane);
  auto lights = part_lights(part_discs(mesh, plane.n), placement, plane);
  std::vector<std::uint32_t> part = mesh.part;
  if (!own_lights) {
    std::fill(part.begin(), part.end(), 0U);
    lights.resize(1);
  }
  for (auto _ : state) {
    benchmark::DoNotOptimize(
        power_distance_layers(vertices, mesh.indices, part, lights, constants));
  }
}
void discs(benchmark::State& state, Shape shape) {
  const ShadowMesh mesh = mesh_of(shape);
  for (auto _ : state) benchmark::DoNotOptimize(part_discs(mesh, Eigen::Vector3d::UnitZ()));
}

void polygons(benchmark::State& state, Shape shape) {
  const ShadowMesh mesh = mesh_of(shape);
  const PlaneFrame plane;
  const Placement placement = {Eigen::Vector3d(0, 0, 0.12), Eigen::Quaterniond::Identity(), 1.0};
  const LayeredConstants constants = make_layered_constants(4.0 / 3.0, 8.0 / 3.0, 0.0).value();
  const auto vertices = place_caster(mesh, generate_kernels(mesh, plane.n, KernelSource::automatic),
                                     placement, plane);
  for (auto _ : state) {
    for (const ShadowLayer layer : kShadowLayers) {
      benchmark::DoNotOptimize(
          union_of_triangles(layer_triangles(vertices, mesh.indices, constants, layer)));
    }
  }
}

// Every shape under every stage, by name.
const bool kRegistered = [] {
  for (const auto& [shape, name] : kShapes) {
    if ((shape == Shape::hand || shape == Shape::tree) && test::shared_dir().empty()) continue;
    const std::string title = name;
    const Shape which = shape;
    const auto add = [](const std::string& label, auto function) {
      benchmark::RegisterBenchmark(label.c_str(), function)->Unit(benchmark::kMillisecond);
    };
    add("weld/" + title, [which](benchmark::State& state) { weld(state, which); });
    add("kernels/auto/" + title,
        [which](benchmark::State& state) { kernels(state, which, KernelSource::automatic); });
    add("kernels/smooth/" + title,
        [which](benchmark::State& state) { kernels(state, which, KernelSource::smooth); });
    add("part lights/" + title, [which](benchmark::State& state) { discs(state, which); });
    add("field 256/one light/" + title,
        [which](benchmark::State& state) { field(state, which, false); });
    add("field 256/a light per part/" + title,
        [which](benchmark::State& state) { field(state, which, true); });
    add("polygons of 3 layers/" + title,
        [which](benchmark::State& state) { polygons(state, which); });
  }
  return true;
}();

}  // namespace
}  // namespace penumbra
