// Plans the trials of one participant, which depend only on a seed and the participant's number.
//
// The two experiments of Layered Penumbrae, section 2.1: (1) point at the highest of three spheres,
// (2) drag a sphere onto one target after the other. The paper specifies the number of samples
// (half are difficult in (1)) and three to five targets in (2). This program chooses sizes,
// positions and heights for a table that is seen by a handheld camera.
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
  std::string name;  // its name in --shadow
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
};
// Returns the technique for a value of --shadow, or nullopt if the value is unknown.
[[nodiscard]] std::optional<StudyTechnique> study_technique_from_string(std::string_view name);

// Returns the paper's number of samples: 20 for heights, 5 for drag.
[[nodiscard]] int default_samples(StudyExperiment experiment);
inline constexpr int kMaxStudySamples = 1000;

struct StudyDesign {
  StudyExperiment experiment = StudyExperiment::heights;
  std::vector<StudyTechnique> techniques;  // distinct
  int participant = 1;                     // from 1
  std::uint64_t seed = 1;
  int samples = 20;            // per technique
  double tolerance_m = 0.010;  // drag: largest distance that counts as on the target
};
// Returns an identifier for the results of one study (all participants), one word without commas:
// "heights-seed7-samples20-simple+layered".
[[nodiscard]] std::string study_name(const StudyDesign& design);

// Returns row `row` (modulo the number of rows) of a Williams design for `count` > 0 treatments.
// Over all rows, each treatment occurs equally often at each position and equally often after each
// other treatment. Rows: the sequence 0, 1, n-1, 2, n-2, ... and its cyclic shifts; for an odd
// count also the mirrored rows (Williams 1949, Austral. J. Sci. Res. A 2:149).
[[nodiscard]] std::vector<int> williams_row(int count, std::int64_t row);
[[nodiscard]] int williams_rows(int count);

inline constexpr double kStudySphere_m = 0.020;  // radius of every sphere

// The stimulus of a trial: centres of spheres in the table frame [m], rounded to 0.1 mm.
struct StudySample {
  int number = 1;                       // identifies a stimulus across participants
  bool hard = false;                    // heights: the highest two have a small height difference
  std::vector<Eigen::Vector3d> places;  // heights: three spheres; drag: the ball, then its targets
};
// Returns the index of the highest sphere.
[[nodiscard]] int highest_of(const StudySample& sample);

struct StudyTrial {
  int number = 1;     // from 1, over all blocks
  int block = 1;      // from 1; one block per technique
  int trial = 1;      // from 1, within the block
  int technique = 0;  // index into StudyDesign::techniques
  int sample = 0;     // index into StudyPlan::samples
};

struct StudyPlan {
  StudyDesign design;
  std::vector<StudySample> samples;  // the same for all participants
  std::vector<StudyTrial> trials;    // in the order of presentation
};
// Each technique is a block that contains every sample once. Rows of Williams designs determine
// the order of the techniques (row: participant) and of the samples (row: participant and block).
[[nodiscard]] StudyPlan plan_study(const StudyDesign& design);

}  // namespace penumbra
