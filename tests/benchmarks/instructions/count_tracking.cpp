// Tracks a recording for callgrind to count: count_tracking RECORDING WARM FRAMES METHOD...
// METHOD: a tracking mode; or libapriltag-1 or -2, which is full-frame detection at that decimation
// plus the pose from its corners. Counts FRAMES frames of each method from frame WARM on, and dumps
// the count under the method's name. Trackers process all frames before; libapriltag, which keeps
// no state between frames, only the last of them. Prints each method's RMS overlay error [px] over
// the counted frames, which must all have a pose. scripts/count-instructions runs this program.
#include <valgrind/callgrind.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/image/frame.hpp"
#include "core/text/text.hpp"
#include "support/replay_tracking.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

using FindPose = std::function<std::optional<CameraPose>(const Frame&)>;
struct Method {
  FindPose pose_of;
  bool needs_earlier_frames = false;
};

std::optional<Method> tracker_of(const test::RecordedSession& session, const std::string& name) {
  TrackerOptions options;
  const auto mode = value_named(kTrackingModeNames, name);
  if (!mode) return std::nullopt;
  options.mode = *mode;
  auto tracker = std::make_shared<GroupTracker>(
      GroupTracker::create(session.camera, session.tags, options).value());
  const FindPose pose_of = [tracker](const Frame& frame) -> std::optional<CameraPose> {
    const PoseEstimate pose = tracker->track(frame).pose;
    if (pose.status != TrackStatus::tracked) return std::nullopt;
    return pose.T_table_camera;
  };
  return Method{pose_of, true};
}

Method libapriltag_of(const test::RecordedSession& session, float quad_decimate) {
  auto detector =
      std::make_shared<TagDetector>(TagDetector::create(session.tags.families()).value());
  auto scratch = std::make_shared<std::vector<std::uint8_t>>();
  const FindPose pose_of = [detector, scratch, quad_decimate,
                            &session](const Frame& frame) -> std::optional<CameraPose> {
    std::vector<TagObservation> observations;
    for (const TagDetection& seen : detector->detect(luma(frame, *scratch), quad_decimate)) {
      const MappedTag* tag = session.tags.find(seen.family, seen.id);
      if (tag != nullptr && tag->group == kTableGroup)
        observations.push_back({tag->id, tag->corners(), seen.corners_px});
    }
    const auto board = estimate_board_pose(session.camera, observations);
    if (!board) return std::nullopt;
    return as_table_pose(board->best.T_map_camera);
  };
  return {pose_of, false};
}

std::optional<Method> method_of(const test::RecordedSession& session, const std::string& name) {
  if (name == "libapriltag-1") return libapriltag_of(session, 1.0F);
  if (name == "libapriltag-2") return libapriltag_of(session, 2.0F);
  return tracker_of(session, name);
}

bool count(const test::RecordedSession& session, const std::vector<Frame>& frames, std::size_t warm,
           const std::string& name) {
  const auto method = method_of(session, name);
  if (!method) {
    std::fprintf(stderr, "count_tracking: no method is called %s\n", name.c_str());
    return false;
  }
  double squares = 0.0;
  const std::size_t first = method->needs_earlier_frames ? 0 : std::max<std::size_t>(warm, 1) - 1;
  for (std::size_t i = first; i < frames.size(); ++i) {
    if (i >= warm) {
      CALLGRIND_START_INSTRUMENTATION;
    }
    const std::optional<CameraPose> pose = method->pose_of(frames[i]);
    CALLGRIND_STOP_INSTRUMENTATION;
    if (i < warm) continue;
    const StampedPose* truth = session.truth.at(frames[i].timestamp_ns);
    if (!pose || truth == nullptr) {
      std::fprintf(stderr, "count_tracking: %s has no pose of frame %zu\n", name.c_str(), i);
      return false;
    }
    squares +=
        std::pow(overlay_difference(session.camera, *pose, truth->T_table_camera).rms_px(), 2.0);
  }
  CALLGRIND_DUMP_STATS_AT(name.c_str());
  std::printf("%s %.4f\n", name.c_str(),
              std::sqrt(squares / static_cast<double>(frames.size() - warm)));
  return true;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  const auto warm = argc < 5 ? -1 : parse_integer(argv[2]).value_or(-1);
  const auto counted = argc < 5 ? -1 : parse_integer(argv[3]).value_or(-1);
  if (warm < 0 || counted < 1) {
    std::fprintf(stderr, "count_tracking RECORDING WARM FRAMES METHOD...\n");
    return 2;
  }
  const auto session = test::load_session(argv[1]);
  if (!session) {
    std::fprintf(stderr, "count_tracking: %s\n", session.error().message.c_str());
    return 1;
  }
  const auto needed = static_cast<std::size_t>(warm + counted);
  if (session->listed.size() < needed) {
    std::fprintf(stderr, "count_tracking: %s has %zu frames\n", argv[1], session->listed.size());
    return 1;
  }
  std::vector<Frame> frames;
  for (std::size_t i = 0; i < needed; ++i)
    frames.push_back(test::load_frame_image(session->listed[i]).value());
  for (int i = 4; i < argc; ++i) {
    if (!count(*session, frames, static_cast<std::size_t>(warm), argv[i])) return 1;
  }
  return 0;
}
