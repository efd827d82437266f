// Plans what one participant of a study sees, from a seed and the participant's number alone. Pure.
//
// The two experiments of Layered Penumbrae, section 2.1: (1) point at the highest of three spheres,
// (2) drag a sphere onto targets in turn. The paper gives the number of samples, half of them
// difficult in (1), and three to five targets in (2). Sizes, places and heights are ours, for a
// table seen by a handheld camera.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "render/scene/technique.hpp"

namespace penumbra {

enum class StudyExperiment { heights, drag };
[[nodiscard]] std::string_view to_string(StudyExperiment experiment);

struct StudyTechnique {
  std::string name;  // as --shadow names it
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
};
// The technique of a word of --shadow; nothing for an unknown word.
[[nodiscard]] std::optional<StudyTechnique> study_technique_from_string(std::string_view name);

// The paper's number of samples: 20 for heights, 5 for drag.
[[nodiscard]] int usual_samples(StudyExperiment experiment);
inline constexpr int kMostStudySamples = 1000;

struct StudyDesign {
  StudyExperiment experiment = StudyExperiment::heights;
  std::vector<StudyTechnique> techniques;  // each once
  int participant = 1;                     // from 1
  std::uint64_t seed = 1;
  int samples = 20;            // per technique
  double tolerance_m = 0.010;  // drag: a sphere released this near its target is on it
};
// Identifies the results of one study, for all participants, as one word without commas:
// "heights-seed7-samples20-simple+layered".
[[nodiscard]] std::string study_name(const StudyDesign& design);

// Row `row` (modulo the number of rows) of a Williams design for `count` > 0 treatments: over all
// rows each treatment comes at each place equally often, and after each other one equally often.
// Williams 1949, Austral. J. Sci. Res. A 2:149: 0, 1, n-1, 2, n-2, ... and its cyclic shifts; for
// an odd count the mirrored rows too.
[[nodiscard]] std::vector<int> williams_row(int count, std::int64_t row);
[[nodiscard]] int williams_rows(int count);

inline constexpr double kStudySphere_m = 0.020;  // radius of every sphere

// Centres of spheres in the table frame [m], to a tenth of a millimetre.
struct StudySample {
  int number = 1;                       // the same stimulus for every participant and technique
  bool hard = false;                    // heights: the highest two differ by little
  std::vector<Eigen::Vector3d> places;  // heights: three spheres; drag: the ball, then its targets
};
// Index of the highest sphere.
[[nodiscard]] int highest_of(const StudySample& sample);

struct StudyTrial {
  int number = 1;     // from 1, over all blocks
  int block = 1;      // from 1: one per technique
  int trial = 1;      // from 1, within the block
  int technique = 0;  // index into StudyDesign::techniques
  int sample = 0;     // index into StudyPlan::samples
};

struct StudyPlan {
  StudyDesign design;
  std::vector<StudySample> samples;  // the same for every participant
  std::vector<StudyTrial> trials;    // in the order of showing
};
// Every technique is a block in which each sample comes once. The order of techniques is the
// participant's row of a Williams design, and so is that of the samples in each block.
[[nodiscard]] StudyPlan plan_study(const StudyDesign& design);

}  // namespace penumbra
