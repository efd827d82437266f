// Runs a participant's session: trials in the window, answers into the results file.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/live/live_camera.hpp"
#include "app/study/study_plan.hpp"
#include "app/study/study_results.hpp"
#include "core/error.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

struct StudyRequest {
  StudyDesign design;
  std::filesystem::path results;
  bool resume = false;
  std::optional<std::filesystem::path> script;  // of a scripted participant
  double pause_s = 1.0;                         // without spheres between two trials [s]
  bool from_camera = false;                     // in place of the recording
  std::filesystem::path recording;
  std::optional<std::filesystem::path> tags;  // instead of the recording's; a camera needs them
  std::optional<std::string> poses_from;      // of a recording: "groundtruth" or a TUM file
  CameraRequest camera;
  TrackerOptions tracking;
  bool window = true;  // if there is a display; a person needs one
};

struct StudyReport {
  int trials = 0;                      // of the participant
  int answered = 0;                    // of them, so far
  std::filesystem::path summary_file;  // empty if the answers went to a stream
  std::vector<StudySummary> summary;   // of everyone in the results file
};

// Every path is checked before the first trial. Ended early (window closed, Ctrl-C), the results
// file holds the trials up to then.
[[nodiscard]] Result<StudyReport> run_study(const StudyRequest& request);

}  // namespace penumbra
