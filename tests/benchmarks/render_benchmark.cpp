// Composited frames at 640 x 480 by technique: upload, video, object and shadow. Measures the CPU
// time of this thread, which includes the software rasteriser (LP_NUM_THREADS=0). Also counts the
// pixels that differ from frames drawn without skipping.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "app/recording/recording_source.hpp"
#include "core/units.hpp"
#include "render/compositor.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

struct Studio {
  std::unique_ptr<GlContext> context;
  std::shared_ptr<const Scene> scene;
  Recording recording;
  std::vector<Frame> frames;
  std::unique_ptr<Compositor> compositor;
};

// Returns the studio of a bundled scene.
Studio& studio(const std::string& scene) {
  // The map is leaked, because a driver may be unloaded before static objects are destroyed.
  static auto& studios = *new std::map<std::string, Studio>;
  const auto [found, is_new] = studios.try_emplace(scene);
  Studio& s = found->second;
  if (is_new) {
    setenv("LP_NUM_THREADS", "0", 1);
    s.context = create_offscreen_context().value();
    s.context->make_current();
    s.scene = std::make_shared<const Scene>(
        load_scene(test::source_dir() / "scenes" / (scene + ".json")).value());
    s.recording = open_recording(test::recordings_dir() / "tabletop").value();
    RecordingSourceOptions options;
    options.first = 60;
    options.last = 90;
    const auto source = open_recording_source(s.recording, options).value();
    while (std::optional<Frame> frame = source->next().value()) s.frames.push_back(*frame);
    s.compositor = std::make_unique<Compositor>(
        Compositor::create(*s.context, s.scene, *s.recording.camera).value());
  }
  s.context->make_current();
  return s;
}

FramePlan plan_at(const Studio& s, const Frame& frame, double scene_s, const PlanOptions& options) {
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  pose.T_table_camera = s.recording.groundtruth->at(frame.timestamp_ns)->T_table_camera;
  return plan_frame(*s.scene, evaluate_scene(*s.scene, scene_s), pose, *s.recording.camera,
                    options);
}
FramePlan plan_of(const Studio& s, const Frame& frame, const PlanOptions& options) {
  return plan_at(s, frame, seconds(frame.timestamp_ns), options);
}

// Number of pixels per frame that skipping changes; must be 0.
double pixels_changed_by_skipping(Studio& s, PlanOptions options) {
  std::vector<std::uint8_t> with(640 * 480 * 4), without(with.size());
  std::size_t changed = 0;
  for (const Frame& frame : s.frames) {
    for (const bool skip : {true, false}) {
      options.skip = skip;
      s.compositor->draw(frame, plan_of(s, frame, options)).value();
      s.compositor->read_back(skip ? with : without).value();
    }
    for (std::size_t i = 0; i < with.size(); i += 4) {
      changed += std::equal(&with[i], &with[i] + 4, &without[i]) ? 0U : 1U;
    }
  }
  return static_cast<double>(changed) / static_cast<double>(s.frames.size());
}

void composite(benchmark::State& state, ShadowTechnique technique,
               std::optional<KernelSource> kernels = {}) {
  Studio& s = studio("default");
  PlanOptions options;
  options.technique = technique;
  options.kernels = kernels;
  std::vector<std::uint8_t> rgba(640 * 480 * 4);
  const double changed = pixels_changed_by_skipping(s, options);
  std::size_t i = 0;
  std::int64_t shadow_vertices = 0;
  double shadow_cpu_ms = 0.0;
  double longest_shadow_cpu_ms = 0.0;
  for (auto _ : state) {
    const Frame& frame = s.frames[i++ % s.frames.size()];
    const CompositeStats drawn = s.compositor->draw(frame, plan_of(s, frame, options)).value();
    shadow_vertices += drawn[Counter::shadow_vertices];
    shadow_cpu_ms += drawn.shadow_cpu_ms;
    longest_shadow_cpu_ms = std::max(longest_shadow_cpu_ms, drawn.shadow_cpu_ms);
    benchmark::DoNotOptimize(s.compositor->read_back(rgba).value());
  }
  state.counters["cpu_shadow_vertices"] =
      static_cast<double>(shadow_vertices) / static_cast<double>(state.iterations());
  state.counters["shadow_cpu_ms"] = shadow_cpu_ms / static_cast<double>(state.iterations());
  state.counters["shadow_cpu_ms_max"] = longest_shadow_cpu_ms;
  state.counters["pixels_changed_by_skipping"] = changed;
}

// Hard shadows of a tree of 26,000 faces from the sun and a lantern. Measures update and frame time
// while only the camera moves, and while the sun moves.
void tree_under_two_lights(benchmark::State& state, ShadowTechnique technique, bool sun_moves) {
  Studio& s = studio("tree");
  PlanOptions options;
  options.technique = technique;
  std::vector<std::uint8_t> rgba(640 * 480 * 4);
  constexpr double kStart_s = 1.0;
  constexpr double kStep_s = 0.001;  // small enough for many steps before sunset
  std::size_t i = 0;
  CompositeStats sum;
  for (auto _ : state) {
    const Frame& frame = s.frames[i % s.frames.size()];
    const double scene_s =
        sun_moves ? kStart_s + kStep_s * static_cast<double>(i % 3000) : kStart_s;
    ++i;
    add(sum, s.compositor->draw(frame, plan_at(s, frame, scene_s, options)).value());
    benchmark::DoNotOptimize(s.compositor->read_back(rgba).value());
  }
  const auto frames = static_cast<double>(state.iterations());
  state.counters["triples_recomputed"] =
      static_cast<double>(sum[Counter::triples_recomputed]) / frames;
  state.counters["triples_reused"] = static_cast<double>(sum[Counter::reprojections]) / frames;
  state.counters["shadow_cpu_ms"] = sum.shadow_cpu_ms / frames;
}
BENCHMARK_CAPTURE(composite, simple, ShadowTechnique::simple)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, none, ShadowTechnique::none)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, layered, ShadowTechnique::layered)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, cocl, ShadowTechnique::layered, KernelSource::centroid)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, field, ShadowTechnique::field)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, walls, ShadowTechnique::walls)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, hard, ShadowTechnique::hard)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(composite, volume, ShadowTechnique::volume)->Unit(benchmark::kMillisecond);

BENCHMARK_CAPTURE(tree_under_two_lights, none, ShadowTechnique::none, false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(tree_under_two_lights, hard still, ShadowTechnique::hard, false)
    ->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(tree_under_two_lights, hard sun moves, ShadowTechnique::hard, true)
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra
