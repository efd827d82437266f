// Detection and pose estimation on the bundled recording: CPU time per frame, and overlay error
// against exact truth. Also measures the time to recover after a jerk, on synthetic images.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "app/recording/recording_source.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/units.hpp"
#include "support/paths.hpp"
#include "support/synthetic_board.hpp"
#include "tracking/alignment/pattern_renderer.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/group_tracker.hpp"

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

// Detection alone. The counter `tags` is the number of detections per frame.
void detect(benchmark::State& state, float quad_decimate) {
  TagDetector detector = TagDetector::create(std::array{TagFamily::tag36h11}).value();
  std::vector<std::uint8_t> scratch;
  std::size_t found = 0;
  std::size_t i = 0;
  for (auto _ : state) {
    const Frame& frame = session().frames[i++ % kFrames];
    found += detector.detect(luma(frame, scratch), quad_decimate).size();
  }
  state.counters["tags"] = static_cast<double>(found) / static_cast<double>(state.iterations());
}

// The whole tracker: from an image in memory to a pose with covariance.
void track(benchmark::State& state, TrackingMode mode) {
  TrackerOptions options;
  options.mode = mode;
  Trajectory estimated;
  for (auto _ : state) {
    state.PauseTiming();
    GroupTracker tracker =
        GroupTracker::create(*session().recording.camera, *session().recording.tags, options)
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

// Views of six tags at 1280 x 720, each followed by a frame of the camera rotated by 50 to 120 px.
// Cells are 10 px wide.
struct Jump {
  CameraPose before, after;
  Frame first, second;
};

Frame render_frame(PatternRenderer& renderer, const CameraPose& pose, int number) {
  PatternRenderOptions options;
  options.noise_grey = 3.0;
  options.samples = 64;
  options.seed = static_cast<std::uint64_t>(number) + 1;
  const std::array<CameraPose, 1> path = {pose};
  const GreyImage image = renderer.render(path, options);
  const ImageView view = image.view();
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, view.width, view.height);
  for (int y = 0; y < view.height; ++y)
    std::copy_n(view.row(y), view.width, buffer.plane_data[0] + y * buffer.frame.planes[0].stride);
  return buffer.frame;
}

const std::vector<Jump>& jumps() {
  static const std::vector<Jump> jumps = [] {
    std::vector<Jump> made;
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> u(0.0, 1.0);
    const CameraModel camera = test::wide_camera();
    PatternRenderer renderer = PatternRenderer::create(camera, test::board(3, 2, 0.06)).value();
    for (int k = 0; k < 24; ++k) {
      Jump& jump = made.emplace_back();
      jump.before = test::random_view(random);
      const double axis_rad = 2.0 * std::numbers::pi * u(random);
      const double angle_rad = (50.0 + 70.0 * u(random)) / camera.parameters().fx;
      Vector6d rotation = Vector6d::Zero();
      rotation.tail<3>() << angle_rad * std::cos(axis_rad), angle_rad * std::sin(axis_rad),
          radians(6.0 * u(random) - 3.0);
      jump.after = perturbed(jump.before, rotation);
      jump.first = render_frame(renderer, jump.before, 2 * k);
      jump.second = render_frame(renderer, jump.after, 2 * k + 1);
    }
    return made;
  }();
  return jumps;
}

// Times only the frame after each jump. The counters `by_pattern` and `by_box` are the fractions of
// frames in which pyramid search and ROI detection ran.
void recover(benchmark::State& state) {
  TrackerOptions options;
  options.mode = TrackingMode::fast;
  const CameraModel camera = test::wide_camera();
  const TagMap tags = TagMap::make(test::board(3, 2, 0.06)).value();
  static_cast<void>(jumps());  // prepares the images outside the timed part
  double by_pattern = 0.0, by_box = 0.0, tracked = 0.0, squares = 0.0;
  for (auto _ : state) {
    by_pattern = by_box = tracked = squares = 0.0;
    for (const Jump& jump : jumps()) {
      state.PauseTiming();
      GroupTracker tracker = GroupTracker::create(camera, tags, options).value();
      Frame frame = jump.first;
      for (int f = 0; f < 2; ++f) {
        frame.timestamp_ns = nanoseconds(f / 30.0);
        static_cast<void>(tracker.track(frame));
      }
      frame = jump.second;
      frame.timestamp_ns = nanoseconds(2 / 30.0);
      state.ResumeTiming();
      const TrackedFrame found = tracker.track(frame);
      state.PauseTiming();
      by_pattern += found.times.pyramid_search ? 1.0 : 0.0;
      by_box += found.times.roi_detection ? 1.0 : 0.0;
      if (found.pose.status == TrackStatus::tracked) {
        tracked += 1.0;
        const double error =
            overlay_difference(camera, found.pose.T_table_camera, jump.after).rms_px();
        squares += error * error;
      }
      state.ResumeTiming();
    }
  }
  const auto count = static_cast<double>(jumps().size());
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(jumps().size()));
  state.counters["by_pattern"] = by_pattern / count;
  state.counters["by_box"] = by_box / count;
  state.counters["tracked"] = tracked / count;
  state.counters["overlay_rmse_px"] = std::sqrt(squares / std::max(tracked, 1.0));
}

BENCHMARK_CAPTURE(detect, decimate_1, 1.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(detect, decimate_2, 2.0F)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, detect, TrackingMode::detect)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, fast, TrackingMode::fast)->Unit(benchmark::kMillisecond);
BENCHMARK_CAPTURE(track, accurate, TrackingMode::accurate)->Unit(benchmark::kMillisecond);
BENCHMARK(recover)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace penumbra
