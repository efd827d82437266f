// Pattern alignment on exact synthetic images: error relative to the Cramer-Rao bound, occlusion,
// basin of convergence, motion blur.
//
//   synthetic_benchmark [bias] [noise] [cover] [basin] [blur] [samples=N]
#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "benchmarks/synthetic_trials.hpp"

namespace {

using namespace penumbra;
using namespace penumbra::test;

void print(const std::string& name, const TrialScore& score) {
  const Statistics e = statistics_of(score.errors);
  std::printf("%-34s found %3d/%-3d  overlay rms %.4f med %.4f max %.3f  us %.0f", name.c_str(),
              score.found, score.runs, e.rmse, e.median, e.max, statistics_of(score.us).median);
  if (score.ratio2 > 0.0) std::printf("  error/bound %.2f", score.over_bound());
  if (score.wrong > 0) std::printf("  WRONG POSES VERIFIED %d", score.wrong);
  std::printf("\n");
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  bool all = true;
  int samples = PatternRenderOptions().samples;
  for (int i = 1; i < argc; ++i) {
    if (std::strncmp(argv[i], "samples=", 8) == 0) {
      samples = std::atoi(argv[i] + 8);
    } else {
      all = false;
    }
  }
  const auto wants = [&](const char* what) {
    for (int i = 1; i < argc; ++i) {
      if (std::strcmp(argv[i], what) == 0) return true;
    }
    return all;
  };
  SyntheticTrials trials(samples);
  if (wants("bias"))
    print("accurate, no noise", trials.noise(AlignmentEffort::accurate, 0.0, 12, false));
  if (wants("noise")) {
    for (const AlignmentEffort effort : {AlignmentEffort::fast, AlignmentEffort::accurate}) {
      for (const double noise : {0.0, 1.0, 2.0, 5.0})
        print(fmt::format("{}, noise {}", effort == AlignmentEffort::fast ? "fast" : "accurate",
                          noise),
              trials.noise(effort, noise, 12, noise == 2.0));
    }
  }
  if (wants("cover")) {
    for (const double fraction : {0.15, 0.30, 0.50})
      print(fmt::format("fast, {:.0f} % covered", 100.0 * fraction), trials.cover(fraction, 16));
  }
  if (wants("basin")) {
    for (const double start : {4.0, 8.0, 12.0, 16.0, 24.0})
      print(fmt::format("fast, start error {} px", start), trials.basin(start, 10, 10));
  }
  if (wants("blur")) {
    for (const double length : {4.0, 8.0, 16.0, 24.0}) {
      for (const bool known : {false, true})
        print(fmt::format("fast, blur {} px, {}", length, known ? "known" : "unknown"),
              trials.blur(length, known, 12));
    }
  }
  return 0;
}
