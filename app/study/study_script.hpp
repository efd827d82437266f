// Script of a simulated participant, to test a study: actions and times in each trial.
//
//   # trial  seconds  action
//   1        1.25     click sphere 2
//   2        0.90     click table 0.05 0.10 0.04
//   3        1.00     press left ball
//   3        1.50     move by 0.03 -0.02 0
//   3        2.00     release
//   4        0.50     accept
//
// Trials are numbered from 1 over all blocks. Seconds count from the time at which the trial's
// spheres are shown. Neither may decrease. A position is `sphere N`, `ball`, `table X Y Z` [m],
// `pixel U V` of the image or, for a held object, `by DX DY DZ` [m] relative to where it was
// grabbed. `accept` is the space bar: the participant ends the attempt to reach the target.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

struct ScriptPlace {
  enum class Kind { object, table, pixel, by };
  Kind kind = Kind::object;
  std::string object;                               // name of the object in the scene
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // table or by: [m]; pixel: x and y [px]
};

struct ScriptAction {
  enum class Kind { click, press, move, release, accept };
  int line = 0;            // line number in the file
  int trial = 1;           // StudyTrial::number
  std::int64_t at_ns = 0;  // time since the trial's spheres are shown, >= 0
  Kind kind = Kind::click;
  int button = 0;  // WindowEvent's code; for click and press
  ScriptPlace place;
};

struct StudyScript {
  std::string name;  // file name, for errors
  std::vector<ScriptAction> actions;
};

// Errors contain the line number and the expected form.
[[nodiscard]] Result<StudyScript> parse_study_script(std::string_view text, std::string name);
[[nodiscard]] Result<StudyScript> load_study_script(const std::filesystem::path& file);

}  // namespace penumbra
