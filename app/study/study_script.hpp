// A scripted participant: the actions in each trial and their times. It tests the set-up of a
// study.
//
//   # trial  seconds  action
//   1        1.25     click sphere 2
//   2        0.90     click table 0.05 0.10 0.04
//   3        1.00     press left ball
//   3        1.50     move by 0.03 -0.02 0
//   3        2.00     release
//   4        0.50     accept
//
// Trials are numbered from 1 over all blocks, seconds count from the showing of the trial's
// spheres; both increase. A place is `sphere N`, `ball`, `table X Y Z` [m], `pixel U V` of the
// image or, for a held object, `by DX DY DZ` [m] from where it was taken. `accept` is the space
// bar: the sphere is as near its target as the participant can bring it.
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
  std::string object;                               // its name in the scene
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // [m]; of a pixel: x and y [px]
};

struct ScriptAction {
  enum class Kind { click, press, move, release, accept };
  int line = 0;            // in the file
  int trial = 1;           // StudyTrial::number
  std::int64_t at_ns = 0;  // since the trial's spheres are shown, >= 0
  Kind kind = Kind::click;
  int button = 0;  // WindowEvent's; of click and press
  ScriptPlace place;
};

struct StudyScript {
  std::string name;  // of the file, for errors
  std::vector<ScriptAction> actions;
};

// Errors name the line and the right form.
[[nodiscard]] Result<StudyScript> parse_study_script(std::string_view text, std::string name);
[[nodiscard]] Result<StudyScript> load_study_script(const std::filesystem::path& file);

}  // namespace penumbra
