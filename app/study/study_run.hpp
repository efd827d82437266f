// Runs a participant's session: shows trials in the window and writes answers to the results file.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/live/live_camera.hpp"
#include "app/run/run_request.hpp"
#include "app/study/study_plan.hpp"
#include "app/study/study_results.hpp"
#include "core/error.hpp"

namespace penumbra {

// `window`: a person needs one.
struct StudyRequest : SessionRequest {
  StudyDesign design;
  std::filesystem::path results;
  bool resume = false;
  std::optional<std::filesystem::path> script;  // script of a scripted participant
  double pause_s = 1.0;                         // time without spheres between two trials [s]
  bool from_camera = false;                     // uses the camera instead of the recording
  std::filesystem::path recording;
  std::optional<std::filesystem::path> tags;  // replaces the recording's; a camera needs it
  std::optional<std::string> poses_from;      // for a recording: "groundtruth" or a TUM file
  CameraRequest camera;
};

struct StudyReport {
  int trials = 0;                      // trials of the participant
  int answered = 0;                    // number of these answered so far
  std::filesystem::path summary_file;  // empty if the answers went to a stream
  std::vector<StudySummary> summary;   // one per technique, for all participants in the file
};

// Checks all paths before the first trial. If the session ends early (window closed, Ctrl-C), the
// results file contains the trials completed so far.
[[nodiscard]] Result<StudyReport> run_study(const StudyRequest& request);

}  // namespace penumbra
