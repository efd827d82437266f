// CPU time and error of the stages of shadows: welding, kernels, layers, fields, polygons.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <fstream>
#include <functional>
#include <glm/geometric.hpp>
#include <limits>
#include <optional>
#include <random>
#include <string>
#include <utility>

#include "models/glb_writer.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "render/shadow/layers/coverage.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
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

// Returns the mesh of a shape; empty if the shape is missing.
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

// Returns a model whose welding gives the mesh.
Model model_of(const ShadowMesh& mesh) {
  Model model;
  model.meshes.emplace_back();
  model.meshes[0].positions = mesh.positions;
  model.meshes[0].indices = mesh.indices;
  return model;
}

// Median CPU time of several runs.
double cpu_ms(const std::function<void()>& work) {
  std::vector<double> times;
  for (int i = 0; i < 7; ++i) {
    timespec from{};
    timespec to{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &from);
    work();
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &to);
    times.push_back(1e3 * static_cast<double>(to.tv_sec - from.tv_sec) +
                    1e-6 * static_cast<double>(to.tv_nsec - from.tv_nsec));
  }
  std::nth_element(times.begin(), times.begin() + 3, times.end());
  return times[3];
}

// A triangle soup whose vertices are displaced by up to 2 um.
Model soup_of(const ShadowMesh& mesh) {
  Model model;
  Mesh& soup = model.meshes.emplace_back();
  std::mt19937 random(3);
  std::uniform_real_distribution<float> off(-1.1e-6F, 1.1e-6F);
  for (const std::uint32_t vertex : mesh.indices) {
    soup.indices.push_back(static_cast<std::uint32_t>(soup.positions.size()));
    soup.positions.push_back(mesh.positions[vertex] +
                             glm::vec3(off(random), off(random), off(random)));
  }
  return model;
}

// Measures welding: time, largest displacement of a vertex (limit: 10 um), and number of surplus or
// missing vertices.
void weld(benchmark::State& state, Shape shape) {
  const ShadowMesh mesh = mesh_of(shape);
  const Model model = soup_of(mesh);
  for (auto _ : state) benchmark::DoNotOptimize(make_shadow_mesh(model));
  const ShadowMesh welded = make_shadow_mesh(model);
  float moved = 0.0F;
  for (std::size_t i = 0; i < welded.indices.size(); ++i) {
    moved = std::max(moved, glm::distance(welded.positions[welded.indices[i]],
                                          model.meshes[0].positions[model.meshes[0].indices[i]]));
  }
  state.counters["moved_um"] = 1e6 * static_cast<double>(moved);
  state.counters["vertices_off"] = std::abs(static_cast<double>(welded.positions.size()) -
                                            static_cast<double>(mesh.positions.size()));
}

// Raster of a layer or field, with 512 cells along the longer side of the penumbra.
struct Canvas {
  Eigen::Vector2f low, high;
  [[nodiscard]] Coverage covered(const std::vector<PlanePoint>& triangles) const {
    const float cell = (high - low).maxCoeff() / 512.0F;
    const Eigen::Vector2f cells = ((high - low) / cell).array().ceil();
    Coverage result(low, cell, static_cast<int>(cells.x()), static_cast<int>(cells.y()));
    result.cover(triangles);
    return result;
  }
};
Canvas canvas_round(const std::vector<PlanePoint>& penumbra) {
  Canvas canvas{Eigen::Vector2f::Constant(std::numeric_limits<float>::infinity()),
                Eigen::Vector2f::Constant(-std::numeric_limits<float>::infinity())};
  for (const PlanePoint& p : penumbra) {
    canvas.low = canvas.low.cwiseMin(Eigen::Vector2f(p.u, p.v));
    canvas.high = canvas.high.cwiseMax(Eigen::Vector2f(p.u, p.v));
  }
  return canvas;
}

// Measures kernel generation: time, difference from kernels of rasters with four times as many
// cells per side (IoU of umbra and penumbra at 0.4 h_u), and time relative to reading the model
// from a .glb.
void kernels(benchmark::State& state, Shape shape, KernelSource source) {
  const ShadowMesh mesh = mesh_of(shape);
  const Eigen::Vector3d up = Eigen::Vector3d(0.1, 0.2, 1.0);
  const auto generate = [&] { benchmark::DoNotOptimize(generate_kernels(mesh, up, source)); };
  for (auto _ : state) generate();
  if (source != KernelSource::automatic) return;

  const test::TemporaryFolder folder;
  Model model = model_of(mesh);
  model.materials.emplace_back();
  model.meshes[0].normals.assign(mesh.positions.size(), {0, 0, 1});
  const auto file = folder.path() / "model.glb";
  const auto bytes = models::encode_glb(model).value();
  std::ofstream(file, std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()),
             static_cast<std::streamsize>(bytes.size()));
  const double read_ms = cpu_ms([&] { benchmark::DoNotOptimize(load_model(file)); });
  state.counters["read_ms"] = read_ms;
  state.counters["kernels / read"] = cpu_ms(generate) / read_ms;

  KernelTuning fine;
  fine.cells_per_root *= 4.0;
  fine.min_side_cells *= 4;
  fine.max_side_cells *= 4;
  const PlaneFrame plane = PlaneFrame::make(up, Eigen::Vector3d::Zero());
  const LayeredConstants constants = make_layered_constants(0.9, 3.0, 0.0).value();
  const Placement placement = {0.4 * constants.umbra_height * plane.n,
                               Eigen::Quaterniond::Identity(), 1.0};
  const auto standard = place_caster(mesh, generate_kernels(mesh, up, source), placement, plane);
  const auto exact = place_caster(
      mesh, generate_kernels(mesh, up, KernelSource::automatic, nullptr, fine), placement, plane);
  const Canvas canvas =
      canvas_round(layer_triangles(exact, mesh.indices, constants, ShadowLayer::penumbra));
  for (const auto& [layer, name] : {std::pair{ShadowLayer::umbra, "umbra_iou"},
                                    std::pair{ShadowLayer::penumbra, "penumbra_iou"}}) {
    state.counters[name] =
        canvas.covered(layer_triangles(standard, mesh.indices, constants, layer))
            .iou(canvas.covered(layer_triangles(exact, mesh.indices, constants, layer)));
  }
}

// Time for all 20 cases, and agreement with ray-cast shadows: mean IoU of umbra and penumbra.
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

// Measures fields: time, and IoU of umbra and penumbra with the layers of a field of 1024 cells.
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
  ShadowFieldOptions fine_options;
  fine_options.cells = 1024;
  const auto standard = power_distance_layers(vertices, mesh.indices, part, lights, constants);
  const auto fine =
      power_distance_layers(vertices, mesh.indices, part, lights, constants, fine_options);
  const Canvas canvas = canvas_round(field_triangles(fine, ShadowLayer::penumbra));
  for (const auto& [layer, name] : {std::pair{ShadowLayer::umbra, "umbra_iou"},
                                    std::pair{ShadowLayer::penumbra, "penumbra_iou"}}) {
    state.counters[name] = canvas.covered(field_triangles(standard, layer))
                               .iou(canvas.covered(field_triangles(fine, layer)));
  }
}

// Measures part discs: time, and mean relative error of the radii against the finest rasters.
void discs(benchmark::State& state, Shape shape) {
  const ShadowMesh mesh = mesh_of(shape);
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  for (auto _ : state) benchmark::DoNotOptimize(part_discs(mesh, up));
  const auto standard = part_discs(mesh, up);
  const auto fine = part_discs(mesh, up, 0.0);
  double sum = 0.0;
  double count = 0.0;
  for (std::size_t i = 0; i < fine.size(); ++i) {
    if (fine[i].radius <= 0.0F) continue;
    sum += static_cast<double>(std::abs(standard[i].radius / fine[i].radius - 1.0F));
    count += 1.0;
  }
  state.counters["radius_error_%"] = 100.0 * sum / std::max(count, 1.0);
}

// Measures layer polygons: time, and mean relative error of the three areas against rasterised
// layers (512 cells along the longer side, exact to about 0.1 %).
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
  const Canvas canvas =
      canvas_round(layer_triangles(vertices, mesh.indices, constants, ShadowLayer::penumbra));
  const double cell = static_cast<double>((canvas.high - canvas.low).maxCoeff()) / 512.0;
  double error = 0.0;
  for (const ShadowLayer layer : kShadowLayers) {
    const auto triangles = layer_triangles(vertices, mesh.indices, constants, layer);
    const double cells = cell * cell * static_cast<double>(canvas.covered(triangles).count());
    error += std::abs(union_of_triangles(triangles).value().area / cells - 1.0) / 3.0;
  }
  state.counters["area_error_%"] = 100.0 * error;
}

// Registers each stage for each shape.
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
