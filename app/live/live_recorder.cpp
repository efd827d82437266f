#include "app/live/live_recorder.hpp"

#include <fmt/format.h>

#include <chrono>
#include <utility>

#include "app/live/live_pipeline.hpp"
#include "app/session/scene_edit.hpp"
#include "core/propagate.hpp"

namespace penumbra {

Result<void> LiveRecorder::start(const std::filesystem::path& folder) {
  PENUMBRA_TRY(auto opened, RecordingWriter::create(folder, head_));
  record_to(std::move(opened));
  return {};
}

void LiveRecorder::begin(const std::filesystem::path& folder) {
  record_to(RecordingWriter::begin(folder, head_));
}

void LiveRecorder::record_to(std::shared_ptr<RecordingWriter> writer) {
  collect_finished();
  writer->add_event(monotonic_ns(), "start", head_.camera);
  scene_recorded_ = false;
  const std::lock_guard lock(mutex_);
  writer_ = std::move(writer);
}

void LiveRecorder::stop() {
  collect_finished();
  std::shared_ptr<RecordingWriter> writer;
  {
    const std::lock_guard lock(mutex_);
    writer = std::exchange(writer_, nullptr);
  }
  if (!writer) return;
  writer->add_event(monotonic_ns(), "end");
  // The task owns the writer, so the files are closed before the future is collected.
  ended_.push_back(std::async(std::launch::async, [writer = std::move(writer)]() mutable {
    Ended ended;
    ended.finished = writer->finish();
    const RecordingCounts counts = writer->counts();
    ended.frames = {static_cast<std::int64_t>(counts.written),
                    static_cast<std::int64_t>(counts.dropped)};
    ended.summary =
        fmt::format("recorded {} frames to {}", counts.written, writer->folder().string());
    if (counts.dropped > 0) {
      ended.summary += fmt::format(
          "; {} dropped, {}", counts.dropped,
          counts.error ? "most after it failed" : "because the disk or the encoder was too slow");
    }
    writer.reset();
    return ended;
  }));
}

void LiveRecorder::collect_finished() {
  std::erase_if(ended_, [this](std::future<Ended>& ended) {
    if (ended.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return false;
    const Ended result = ended.get();
    frames_.written += result.frames.written;
    frames_.left_out += result.frames.left_out;
    summaries_.push_back(result.summary);
    if (!result.finished && !failed_) failed_ = result.finished.error();
    return true;
  });
}

Result<void> LiveRecorder::finish() {
  stop();
  for (const std::future<Ended>& ended : ended_) ended.wait();
  collect_finished();
  if (failed_) return tl::unexpected(*failed_);
  return {};
}

std::shared_ptr<RecordingWriter> LiveRecorder::writer() const {
  const std::lock_guard lock(mutex_);
  return writer_;
}

void LiveRecorder::add(const SessionFrame& frame, const Session& session) {
  const auto to = writer();
  if (!to) return;
  const std::int64_t timestamp_ns = frame.tracked.frame.timestamp_ns;
  if (!scene_recorded_) {
    scene_recorded_ = true;
    std::error_code ignored;
    const auto scene = std::filesystem::absolute(session.view().scene->file, ignored);
    to->add_event(session.scene_start_ns().value_or(timestamp_ns), kSceneStartEvent,
                  scene.lexically_normal().string());
    for (const SceneEdit& edit : session.latest_edits()) to->add_scene_edit({timestamp_ns, edit});
  } else {
    for (const SceneEdit& edit : frame.edits) to->add_scene_edit({timestamp_ns, edit});
  }
  if (frame.video_light) to->add_light({timestamp_ns, *frame.video_light});
  to->add_pose(timestamp_ns, frame.tracked.pose);
  for (const GroupEstimate& group : frame.tracked.groups) to->add_group(timestamp_ns, group);
}

}  // namespace penumbra
