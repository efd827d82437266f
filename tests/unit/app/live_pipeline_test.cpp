// Threads of a live session, fed by a test camera.
#include "app/live/live_pipeline.hpp"

#include <gtest/gtest.h>

#include <deque>
#include <filesystem>
#include <stdexcept>

#include "app/live/live_camera.hpp"
#include "app/live/live_recorder.hpp"
#include "core/text/text.hpp"
#include "support/recording_folder.hpp"

namespace penumbra {
namespace {

using std::chrono::milliseconds;

// A camera that delivers frames when the test passes them.
class ScriptedCamera final : public LiveSource {
 public:
  explicit ScriptedCamera(double interval_s = 1.0 / 30.0) { format_.interval_s = interval_s; }
  void deliver(const std::string& jpeg) {
    auto bytes = std::make_shared<const std::string>(jpeg);
    CapturedImage image;
    image.sequence = next_++;
    image.timestamp_ns = monotonic_ns();
    image.jpeg = {reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size()};
    image.owner = bytes;
    const std::lock_guard lock(mutex_);
    waiting_.push_back(std::move(image));
    changed_.notify_all();
  }
  void deliver(int number) { deliver(test::jpeg_of(number)); }
  void deliver_damaged() {
    std::string bytes = test::jpeg_of(1);
    deliver(bytes.erase(bytes.size() / 2, bytes.size() / 4));
  }
  Result<std::optional<CapturedImage>> next_image() override {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return stopped_ || !waiting_.empty(); });
    if (stopped_) return std::optional<CapturedImage>();
    std::optional<CapturedImage> image = std::move(waiting_.front());
    waiting_.pop_front();
    return image;
  }
  void stop() override {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
    changed_.notify_all();
  }
  [[nodiscard]] StreamFormat format() const override { return format_; }
  [[nodiscard]] std::string description() const override { return "a camera"; }
  [[nodiscard]] FaultCounter& faults() override { return faults_; }
  [[nodiscard]] std::vector<std::pair<std::string, std::int64_t>> controls() const override {
    return {};
  }

 private:
  StreamFormat format_{"MJPEG", 64, 48, 1.0 / 30.0};
  FaultCounter faults_{"a camera"};
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<CapturedImage> waiting_;
  std::uint64_t next_ = 0;
  bool stopped_ = false;
};

TrackedFrame track_nothing(const Frame& frame) {
  TrackedFrame tracked;
  tracked.frame = frame;
  return tracked;
}

void release_object(const CapturedImage& /*image*/) {}

class LivePipelineThreading : public testing::TestWithParam<bool> {};

// A frame becomes stale if only damaged images follow it, even though the camera goes on
// delivering.
TEST_P(LivePipelineThreading, MarksFrameStaleWhenOnlyDamagedImagesFollow) {
  ScriptedCamera camera;
  LivePipeline pipeline(camera, track_nothing, release_object, GetParam());
  camera.deliver(0);
  std::optional<ReadyFrame> ready;
  while (!ready) ready = pipeline.take(milliseconds(50));
  EXPECT_EQ(pipeline.stale_for_ns(), std::nullopt);
  std::optional<std::int64_t> stale_ns;
  const Stopwatch watch;
  while (!stale_ns && watch.elapsed().wall_ms < 10e3) {
    camera.deliver_damaged();
    EXPECT_FALSE(pipeline.take(milliseconds(30)));
    stale_ns = pipeline.stale_for_ns();
  }
  ASSERT_TRUE(stale_ns);
  EXPECT_GE(*stale_ns, 250'000'000);
  EXPECT_GT(camera.faults().stats().of(CaptureFault::damaged), 0U);
  camera.deliver(1);
  ready.reset();
  while (!ready) ready = pipeline.take(milliseconds(50));
  EXPECT_EQ(pipeline.stale_for_ns(), std::nullopt);
}

TEST_P(LivePipelineThreading, KeepsSlowCameraFreshBetweenFrames) {
  ScriptedCamera camera(1.0);
  LivePipeline pipeline(camera, track_nothing, release_object, GetParam());
  camera.deliver(0);
  std::optional<ReadyFrame> ready;
  while (!ready) ready = pipeline.take(milliseconds(50));
  for (int i = 0; i < 10; ++i) {
    EXPECT_FALSE(pipeline.take(milliseconds(100)));
    EXPECT_EQ(pipeline.stale_for_ns(), std::nullopt);
  }
}

INSTANTIATE_TEST_SUITE_P(Threading, LivePipelineThreading, testing::Bool(), [](const auto& test) {
  return test.param ? std::string("Threaded") : std::string("SingleThread");
});

TEST(LivePipeline, EndsWithErrorOfThrowingTracker) {
  ScriptedCamera camera;
  LivePipeline pipeline(
      camera,
      [](const Frame& frame) {
        if (frame.sequence == 1) throw std::runtime_error("the tracker's own");
        return track_nothing(frame);
      },
      release_object, true);
  camera.deliver(0);
  while (!pipeline.take(milliseconds(50))) {
  }
  camera.deliver(1);
  const Stopwatch watch;
  while (!pipeline.finished() && watch.elapsed().wall_ms < 10e3) {
    (void)pipeline.take(milliseconds(50));
  }
  ASSERT_TRUE(pipeline.finished());
  ASSERT_TRUE(pipeline.error());
  EXPECT_EQ(pipeline.error()->message, "the tracker's own");
}

// The next frame drawn is the one that was newest when the previous drawing began.
TEST(LivePipeline, TracksNoFrameWhileTrackedFrameWaits) {
  ScriptedCamera camera;
  std::atomic<int> tracked = 0;
  LivePipeline pipeline(
      camera,
      [&](const Frame& frame) {
        ++tracked;
        return track_nothing(frame);
      },
      release_object, true);
  camera.deliver(0);
  while (tracked < 1) std::this_thread::yield();
  for (int i = 1; i < 8; ++i) {
    std::this_thread::sleep_for(milliseconds(20));
    camera.deliver(i);
  }
  std::this_thread::sleep_for(milliseconds(100));
  EXPECT_EQ(tracked, 1);
  EXPECT_EQ(pipeline.take(milliseconds(50))->tracked.frame.sequence, 0U);
  std::optional<ReadyFrame> next;
  while (!next) next = pipeline.take(milliseconds(50));
  EXPECT_EQ(next->tracked.frame.sequence, 7U);
}

// A frame tracked at the start of a drawing would be one drawing old when it is drawn. The test
// requires a frame from the second half of the drawing. It counts frames instead of milliseconds,
// so it does not depend on the machine's speed.
TEST(LivePipeline, BeginsTrackingInSecondHalfOfDraw) {
  ScriptedCamera camera;
  LivePipeline pipeline(camera, track_nothing, release_object, true);
  std::atomic<bool> stop_feed = false;
  std::atomic<int> given = 0;
  std::thread feed([&] {
    for (int i = 0; !stop_feed; ++i) {
      camera.deliver(i);
      given = i;
      std::this_thread::sleep_for(milliseconds(5));
    }
  });
  const auto next = [&] {
    std::optional<ReadyFrame> ready;
    while (!ready) ready = pipeline.take(milliseconds(50));
    return static_cast<int>(ready->tracked.frame.sequence);
  };
  const auto draw = [] { std::this_thread::sleep_for(milliseconds(150)); };
  for (int i = 0; i < 3; ++i) {
    (void)next();
    draw();
  }
  (void)next();
  const int newest_at_begin = given;
  draw();
  const int newest_at_end = given;
  // On a slow machine only a few frames may have arrived, hence the + 2.
  EXPECT_GE(2 * (next() - newest_at_begin) + 2, newest_at_end - newest_at_begin);
  stop_feed = true;
  feed.join();
}

// The pipeline also stops while its thread waits for its start time.
TEST(LivePipeline, StopsDuringDraw) {
  ScriptedCamera camera;
  LivePipeline pipeline(camera, track_nothing, release_object, true);
  for (int i = 0; i < 3; ++i) {
    camera.deliver(i);
    while (!pipeline.take(milliseconds(50))) {
    }
    std::this_thread::sleep_for(milliseconds(300));
  }
  camera.deliver(3);
  while (!pipeline.take(milliseconds(50))) {
  }
  camera.deliver(4);
  pipeline.stop();
  EXPECT_TRUE(pipeline.finished());
}

TEST(FaultCounter, StampsFaultWhenItHappens) {
  FaultCounter faults("a camera");
  const std::int64_t before_ns = monotonic_ns();
  faults.count(CaptureFault::gap, "frames are missing");
  const std::int64_t after_ns = monotonic_ns();
  std::this_thread::sleep_for(milliseconds(30));
  const auto events = faults.take_events();
  ASSERT_EQ(events.size(), 1U);
  EXPECT_GE(events[0].timestamp_ns, before_ns);
  EXPECT_LE(events[0].timestamp_ns, after_ns);
}

int open_descriptors() {
  int count = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    ++count;
  }
  return count;
}

TEST(LiveRecorder, ClosesFilesOfEndedRecordings) {
  const test::TemporaryFolder temporary;
  RecordingHead head;
  head.camera = "a camera";
  head.format = {"MJPEG", 64, 48, 1.0 / 30.0};
  head.camera_yaml = test::small_camera_yaml();
  head.tags_yaml = test::small_tags_yaml();
  LiveRecorder recorder(head);
  const auto record = [&](int number) {
    recorder.begin(temporary.path() / std::to_string(number));
    recorder.stop();
  };
  record(0);
  while (recorder.summaries().empty()) {
    recorder.stop();  // releases the finished writer
    std::this_thread::yield();
  }
  const int before = open_descriptors();
  constexpr int kCycles = 40;
  for (int i = 1; i <= kCycles; ++i) record(i);
  // Writers are released without finish(), which a session calls only at its end.
  const Stopwatch watch;
  while (open_descriptors() > before && watch.elapsed().wall_ms < 20e3) {
    std::this_thread::sleep_for(milliseconds(5));
  }
  EXPECT_EQ(open_descriptors(), before);
  EXPECT_TRUE(recorder.finish());
  // finish() reports a recording that could not begin.
  recorder.begin(temporary.path() / "0");
  const auto finished = recorder.finish();
  ASSERT_FALSE(finished);
  EXPECT_NE(finished.error().message.find("not empty"), std::string::npos);
}

TEST(FocusWarning, AppearsOnlyWhenFocusDiffersFromCalibration) {
  const test::TemporaryFolder temporary;
  const auto file = temporary.path() / "camera.yaml";
  const auto with = [&](const std::string& line, std::optional<FocusReading> focus) {
    test::write_text(file, test::small_camera_yaml() + line);
    return focus_warning(file, focus);
  };
  EXPECT_FALSE(with("", FocusReading{30.0, 1.0}));
  EXPECT_FALSE(with("focus_position: 30\n", std::nullopt));
  EXPECT_FALSE(with("focus_position: 30\n", FocusReading{30.0, 1.0}));
  EXPECT_FALSE(with("focus_position: 2.5\n", FocusReading{2.4995, 0.1}));
  EXPECT_FALSE(with("focus_position: [1, 2]\n", FocusReading{30.0, 1.0}));
  const auto warning = with("focus_position: 2.5\n", FocusReading{2.0, 0.1});
  ASSERT_TRUE(warning);
  EXPECT_NE(warning->find("camera.yaml"), std::string::npos);
  EXPECT_NE(warning->find("--focus 2.5"), std::string::npos) << *warning;
  EXPECT_TRUE(with("focus_position: 31\n", FocusReading{30.0, 1.0}));
}

}  // namespace
}  // namespace penumbra
