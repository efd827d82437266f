// The recording of a live session that is being written, if any: begun and ended while the camera
// runs.
#pragma once

#include <cstddef>
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
  // What every recording of the session begins with.
  explicit LiveRecorder(RecordingHead head) : head_(std::move(head)) {}
  LiveRecorder(const LiveRecorder&) = delete;
  LiveRecorder& operator=(const LiveRecorder&) = delete;
  ~LiveRecorder() = default;  // waits for what is still being written

  // Makes the folder.
  [[nodiscard]] Result<void> start(const std::filesystem::path& folder);
  // The same without a wait for the disk; what fails is told by writer()->counts() and finish().
  void begin(const std::filesystem::path& folder);
  // What was given so far is written by a thread of its own: the picture goes on.
  void stop();
  // Ends the last one too; fails where one is incomplete.
  [[nodiscard]] Result<void> finish();

  // By any thread; null while nothing is recorded.
  [[nodiscard]] std::shared_ptr<RecordingWriter> writer() const;
  // What belongs to a frame that was drawn; at first also how the scene came to be as it is.
  void add(const SessionFrame& frame, const Session& session);
  // Frames of all that are written, and those left out; once finish() has returned, of all.
  [[nodiscard]] RecordedFrames frames() const { return frames_; }
  // A line for each recording; once finish() has returned, of all.
  [[nodiscard]] const std::vector<std::string>& summaries() const { return summaries_; }
  // How many that were stopped are still being written.
  [[nodiscard]] std::size_t ending();

 private:
  struct Ended {
    RecordedFrames frames;
    std::string summary;
    Result<void> finished;
  };
  void record_to(std::shared_ptr<RecordingWriter> writer);
  // Lets go of what is written.
  void reap();

  const RecordingHead head_;
  mutable std::mutex mutex_;
  std::shared_ptr<RecordingWriter> writer_;  // guarded by mutex_
  std::vector<std::future<Ended>> ended_;
  RecordedFrames frames_;
  std::vector<std::string> summaries_;
  std::optional<Error> failed_;  // of the first that is incomplete
  bool scene_told_ = false;
};

}  // namespace penumbra
