// Starts and ends recordings of a live session while the camera runs.
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
  // `head` is written at the start of each recording.
  explicit LiveRecorder(RecordingHead head) : head_(std::move(head)) {}
  LiveRecorder(const LiveRecorder&) = delete;
  LiveRecorder& operator=(const LiveRecorder&) = delete;
  ~LiveRecorder() = default;  // waits for the writers

  // Creates the folder and starts a recording.
  [[nodiscard]] Result<void> start(const std::filesystem::path& folder);
  // Like start(), but does not wait for the disk: writer()->counts() and finish() report errors.
  void begin(const std::filesystem::path& folder);
  // Ends the recording; another thread writes the remaining data.
  void stop();
  // Ends the recording and waits for all writers. Fails if any recording is incomplete.
  [[nodiscard]] Result<void> finish();

  // Returns the current writer, or nullptr while nothing is recorded. Thread-safe.
  [[nodiscard]] std::shared_ptr<RecordingWriter> writer() const;
  // Adds the data of a drawn frame. In a new recording, first adds the earlier edits of the scene.
  void add(const SessionFrame& frame, const Session& session);
  // Frame counts of the completed recordings; after finish(), of all recordings.
  [[nodiscard]] RecordedFrames frames() const { return frames_; }
  // One line for each completed recording.
  [[nodiscard]] const std::vector<std::string>& summaries() const { return summaries_; }

 private:
  struct Ended {
    RecordedFrames frames;
    std::string summary;
    Result<void> finished;
  };
  void record_to(std::shared_ptr<RecordingWriter> writer);
  // Collects the results of writers that are done.
  void collect_finished();

  const RecordingHead head_;
  mutable std::mutex mutex_;
  std::shared_ptr<RecordingWriter> writer_;  // guarded by mutex_
  std::vector<std::future<Ended>> ended_;
  RecordedFrames frames_;
  std::vector<std::string> summaries_;
  std::optional<Error> failed_;  // error of the first incomplete recording
  bool scene_recorded_ = false;
};

}  // namespace penumbra
