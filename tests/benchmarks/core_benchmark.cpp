// Camera model: projection and its inverse, time beside error. One group per question; the first
// entry of a group is the baseline that the others' ratios refer to.
#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <random>
#include <vector>

#include "core/camera_model.hpp"

namespace penumbra {
namespace {

CameraModel camera_of(DistortionModel model) {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 531.7;
  p.fy = 530.4;
  p.cx = 322.3;
  p.cy = 237.6;
  p.model = model;
  switch (model) {
    case DistortionModel::plumb_bob:
      p.distortion = {-0.215, 0.062, 0.0008, -0.0006, -0.004};
      break;
    case DistortionModel::rational:
      p.distortion = {0.5, -0.1, 0.001, -0.0005, 0.02, 0.8, -0.05, 0.03};
      break;
    case DistortionModel::fisheye:
      p.distortion = {-0.02, 0.004, -0.001, 0.0002};
      break;
  }
  return CameraModel::make(p).value();
}

std::vector<Eigen::Vector2d> pixels() {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(0.0, 639.0);
  std::uniform_real_distribution<double> v(0.0, 479.0);
  std::vector<Eigen::Vector2d> all(1024);
  for (Eigen::Vector2d& pixel : all) pixel = {u(random), v(random)};
  return all;
}

void project(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = camera_of(model);
  std::vector<Eigen::Vector3d> rays;
  for (const Eigen::Vector2d& pixel : pixels()) rays.push_back(camera.unproject(pixel).value());
  for (auto _ : state) {
    for (const Eigen::Vector3d& ray : rays) benchmark::DoNotOptimize(camera.project_unchecked(ray));
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(rays.size()));
}

void unproject(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = camera_of(model);
  const std::vector<Eigen::Vector2d> all = pixels();
  double worst_px = 0.0;
  for (const Eigen::Vector2d& pixel : all) {
    worst_px =
        std::max(worst_px, (camera.project_unchecked(*camera.unproject(pixel)) - pixel).norm());
  }
  for (auto _ : state) {
    for (const Eigen::Vector2d& pixel : all) benchmark::DoNotOptimize(camera.unproject(pixel));
  }
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(all.size()));
  state.counters["error_px"] = worst_px;
}

BENCHMARK_CAPTURE(project, plumb_bob, DistortionModel::plumb_bob);
BENCHMARK_CAPTURE(project, rational, DistortionModel::rational);
BENCHMARK_CAPTURE(project, fisheye, DistortionModel::fisheye);
BENCHMARK_CAPTURE(unproject, plumb_bob, DistortionModel::plumb_bob);
BENCHMARK_CAPTURE(unproject, rational, DistortionModel::rational);
BENCHMARK_CAPTURE(unproject, fisheye, DistortionModel::fisheye);

}  // namespace
}  // namespace penumbra
