// Recordings of a live session, begun and ended while the camera runs.
#pragma once

#include <filesystem>
#include <future>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "app/recording/recording_writer.hpp"
#include "app/report/run_report.hpp"
#include "app/session/session.hpp"
#include "core/error.hpp"

namespace penumbra {

class LiveRecorder {
 public:
  // `head` begins every recording of the session.
  explicit LiveRecorder(RecordingHead head) : head_(std::move(head)) {}
  LiveRecorder(const LiveRecorder&) = delete;
  LiveRecorder& operator=(const LiveRecorder&) = delete;
  ~LiveRecorder() = default;  // waits for the writers

  // Creates the folder and begins a recording.
  [[nodiscard]] Result<void> start(const std::filesystem::path& folder);
  // The same without waiting for the disk; writer()->counts() and finish() report errors.
  void begin(const std::filesystem::path& folder);
  // Ends the recording; another thread writes the rest.
  void stop();
  // Ends and completes all recordings; fails if one is incomplete.
  [[nodiscard]] Result<void> finish();

  // Thread-safe; null while nothing is recorded.
  [[nodiscard]] std::shared_ptr<RecordingWriter> writer() const;
  // Adds the data of a drawn frame; in a new recording also the earlier edits of the scene.
  void add(const SessionFrame& frame, const Session& session);
  // Frames of the recordings that are complete; after finish(), of all.
  [[nodiscard]] RecordedFrames frames() const { return frames_; }
  // A line for each complete recording.
  [[nodiscard]] const std::vector<std::string>& summaries() const { return summaries_; }

 private:
  struct Ended {
    RecordedFrames frames;
    std::string summary;
    Result<void> finished;
  };
  void record_to(std::shared_ptr<RecordingWriter> writer);
  // Collects the writers that are done.
  void reap();

  const RecordingHead head_;
  mutable std::mutex mutex_;
  std::shared_ptr<RecordingWriter> writer_;  // guarded by mutex_
  std::vector<std::future<Ended>> ended_;
  RecordedFrames frames_;
  std::vector<std::string> summaries_;
  std::optional<Error> failed_;  // of the first incomplete one
  bool scene_recorded_ = false;
};

}  // namespace penumbra
