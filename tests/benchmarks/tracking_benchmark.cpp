// Detection and pose: CPU time per frame beside the overlay error against exact truth, on the
// bundled recording.
#include <benchmark/benchmark.h>

#include <map>
#include <memory>

#include "app/capture/recording_source.hpp"
#include "core/evaluation.hpp"
#include "support/paths.hpp"
#include "tracking/table_tracker.hpp"
#include "tracking/tag_detector.hpp"

namespace penumbra {
namespace {

constexpr int kFrames = 30;

struct Session {
  Recording recording;
  std::vector<Frame> frames;
};

const Session& session() {
  static const Session session = [] {
    Session s;
    s.recording = open_recording(test::recordings_dir() / "tabletop").value();
    RecordingSourceOptions options;
    options.last = kFrames;
    const auto source = open_recording_source(s.recording, options).value();
    while (std::optional<Frame> frame = source->next().value()) s.frames.push_back(*frame);
    return s;
  }();
  return session;
}

// Detection alone; `detections` is per frame.
void detect(benchmark::State& state, float quad_decimate) {
  TagDetectorOptions options;
  options.quad_decimate = quad_decimate;
  TagDetector detector = TagDetector::create(std::array{TagFamily::tag36h11}, options).value();
  std::vector<std::uint8_t> scratch;
  std::size_t found = 0;
  std::size_t i = 0;
  for (auto _ : state) {
    const Frame& frame = session().frames[i++ % kFrames];
    found += detector.detect(luma(frame, scratch)).size();
  }
  state.counters["tags"] = static_cast<double>(found) / static_cast<double>(state.iterations());
}

// The whole tracker, image in memory -> pose with covariance.
void track(benchmark::State& state, TrackingMode mode, float quad_decimate) {
  TrackerOptions options;
  options.mode = mode;
  options.detector.quad_decimate = quad_decimate;
  Trajectory estimated;
  for (auto _ : state) {
    state.PauseTiming();
    TableTracker tracker =
        TableTracker::create(*session().recording.camera, *session().recording.tags, options)
            .value();
    estimated.poses.clear();
    state.ResumeTiming();
    for (const Frame& frame : session().frames) {
      const TrackedFrame tracked = tracker.track(frame);
      if (tracked.pose.status == TrackStatus::tracked)
        estimated.poses.push_back({frame.timestamp_ns, tracked.pose.T_table_camera, {}});
    }
  }
  state.SetItemsProcessed(state.iterations() * kFrames);
  const Evaluation evaluation =
      evaluate(*session().recording.camera, estimated, *session().recording.groundtruth);
  state.counters["tracked"] = static_cast<double>(estimated.poses.size()) / kFrames;
  state.counters["overlay_rmse_px"] = evaluation.overlay_px.rmse;
  state.counters["overlay_max_px"] = evaluation.overlay_px.max;
}

BENCHMARK_CAPTURE(detect, decimate_1, 1.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(detect, decimate_2, 2.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, decimate_1, TrackingMode::detect, 1.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, decimate_2, TrackingMode::detect, 2.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, fast, TrackingMode::fast, 1.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, accurate, TrackingMode::accurate, 1.0F)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra
