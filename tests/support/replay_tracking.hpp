// Tracks every frame of a recording and compares the poses with the ground truth.
#pragma once

#include <algorithm>
#include <array>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra::test {

struct ListedFrame {
  std::int64_t timestamp_ns = 0;
  std::filesystem::path file;
};

inline Result<std::vector<ListedFrame>> list_frames(const std::filesystem::path& recording) {
  const auto text = read_text_file(recording / "timestamps.csv", 1 << 20);
  if (!text) return tl::unexpected(text.error());
  std::vector<ListedFrame> frames;
  std::string_view rest = *text;
  rest.remove_prefix(std::min(rest.find('\n') + 1, rest.size()));  // skips the header line
  while (!rest.empty()) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    const std::string_view line = trim(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (line.empty()) continue;
    const std::size_t first = line.find(',');
    const std::size_t second = line.find(',', first + 1);
    const auto time = parse_seconds_as_ns(line.substr(first + 1, second - first - 1));
    if (!time) return fail("{}: timestamps.csv: no time in '{}'", recording.string(), line);
    const std::string_view file = line.substr(second + 1);  // more columns may follow
    frames.push_back({*time, recording / std::string(file.substr(0, file.find(',')))});
  }
  return frames;
}

struct TrackedRecording {
  std::vector<TrackedFrame> frames;
  std::vector<double> overlay_px;  // per frame: RMS over the corners; negative without a pose
  std::array<int, 4> count{};      // indexed by TrackStatus
  Evaluation tracked;              // over the tracked frames
  int wrong = 0;                   // tracked frames with overlay_px > 5

  [[nodiscard]] int count_of(TrackStatus status) const {
    return count[static_cast<std::size_t>(status)];
  }
};

// A recording's files, and its images in order.
struct RecordedSession {
  CameraModel camera;
  TagMap tags;
  Trajectory truth;
  std::vector<ListedFrame> listed;
};

inline Result<RecordedSession> load_session(const std::filesystem::path& recording) {
  const auto camera = load_camera(recording / "camera.yaml");
  if (!camera) return tl::unexpected(camera.error());
  const auto tags = load_tag_map(recording / "tags.yaml");
  if (!tags) return tl::unexpected(tags.error());
  const auto truth = load_trajectory(recording / "groundtruth.tum");
  if (!truth) return tl::unexpected(truth.error());
  const auto listed = list_frames(recording);
  if (!listed) return tl::unexpected(listed.error());
  return RecordedSession{*camera, *tags, *truth, *listed};
}

inline Result<Frame> load_frame_image(const ListedFrame& entry) {
  auto frame = load_image(entry.file);
  if (frame) frame->timestamp_ns = entry.timestamp_ns;
  return frame;
}

// Runs a tracker over frames in sequence and compares its poses with the truth.
class TrackingTrial {
 public:
  static Result<TrackingTrial> create(const RecordedSession& session, const TagMap& tags,
                                      const TrackerOptions& options = {}) {
    auto tracker = GroupTracker::create(session.camera, tags, options);
    if (!tracker) return tl::unexpected(tracker.error());
    return TrackingTrial(session, std::move(*tracker));
  }

  void add(const Frame& frame) {
    TrackedFrame t = tracker_.track(frame);
    t.frame = {};  // frees the image
    ++result_.count[static_cast<std::size_t>(t.pose.status)];
    const StampedPose* true_pose = session_->truth.at(frame.timestamp_ns);
    double error = -1.0;
    if (true_pose != nullptr && t.pose.has_pose())
      error = overlay_difference(session_->camera, t.pose.T_table_camera, true_pose->T_table_camera)
                  .rms_px();
    result_.overlay_px.push_back(error);
    if (t.pose.status == TrackStatus::tracked) {
      tracked_.poses.push_back({frame.timestamp_ns, t.pose.T_table_camera, {}});
      if (!(error <= 5.0)) ++result_.wrong;
    }
    result_.frames.push_back(std::move(t));
  }

  [[nodiscard]] TrackedRecording result() const {
    TrackedRecording result = result_;
    result.tracked = evaluate(session_->camera, tracked_, session_->truth);
    return result;
  }

 private:
  TrackingTrial(const RecordedSession& session, GroupTracker tracker)
      : session_(&session), tracker_(std::move(tracker)) {}
  const RecordedSession* session_;
  GroupTracker tracker_;
  TrackedRecording result_;
  Trajectory tracked_;
};

// `every`: tracks only each `every`-th frame.
inline Result<TrackedRecording> track_recording(const std::filesystem::path& recording,
                                                const TrackerOptions& options = {},
                                                std::size_t every = 1) {
  const auto session = load_session(recording);
  if (!session) return tl::unexpected(session.error());
  auto trial = TrackingTrial::create(*session, session->tags, options);
  if (!trial) return tl::unexpected(trial.error());
  for (std::size_t i = 0; i < session->listed.size(); i += every) {
    const auto frame = load_frame_image(session->listed[i]);
    if (!frame) return tl::unexpected(frame.error());
    trial->add(*frame);
  }
  return trial->result();
}

}  // namespace penumbra::test
