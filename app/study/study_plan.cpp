#include "app/study/study_plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "core/assert.hpp"
#include "core/random.hpp"

namespace penumbra {
namespace {

enum Purpose : std::uint64_t { kTechniqueOrder = 1, kSampleOrder, kStimuli };

std::vector<int> shuffled(int count, SplitMix64 random) {
  std::vector<int> order(static_cast<std::size_t>(count));
  std::iota(order.begin(), order.end(), 0);
  for (std::size_t i = order.size(); i > 1; --i) std::swap(order[i - 1], order[random.below(i)]);
  return order;
}

Eigen::Vector3d to_tenths_of_mm(const Eigen::Vector3d& p) {
  return (p * 1e4).array().round().matrix() / 1e4;
}

// Places three spheres around the table's middle, about 120 degrees apart, so that none occludes
// another sphere or its shadow.
StudySample sample_of_heights(int number, SplitMix64& random) {
  constexpr double kMinRadius_m = 0.060, kMaxRadius_m = 0.090;
  constexpr double kStep = 2.0 * std::numbers::pi / 3.0, kJitter = std::numbers::pi / 12.0;
  constexpr double kMinTop_m = 0.120, kMaxTop_m = 0.200;  // centre height of the highest sphere
  constexpr std::array kEasyGap_m = {0.040, 0.060}, kHardGap_m = {0.008, 0.015};
  constexpr double kThirdGap_m = 0.040;  // largest height difference of the second and the third
  StudySample sample;
  sample.number = number;
  sample.hard = number % 2 == 0;
  const auto& gap = sample.hard ? kHardGap_m : kEasyGap_m;
  const double top = random.between(kMinTop_m, kMaxTop_m);
  const double second = top - random.between(gap[0], gap[1]);
  const double third = second - random.between(0.0, kThirdGap_m);
  std::array heights = {top, second, third};
  for (std::size_t i = heights.size(); i > 1; --i) {
    std::swap(heights[i - 1], heights[random.below(i)]);
  }
  const double start = random.between(0.0, 2.0 * std::numbers::pi);
  for (std::size_t i = 0; i < heights.size(); ++i) {
    const double angle = start + static_cast<double>(i) * kStep + random.between(-kJitter, kJitter);
    const double radius = random.between(kMinRadius_m, kMaxRadius_m);
    sample.places.push_back(to_tenths_of_mm({radius * std::cos(angle), radius * std::sin(angle),
                                             std::max(heights[i], kStudySphere_m)}));
  }
  return sample;
}

// Places a ball over the table's middle and three to five targets, each far from the previous one.
StudySample sample_of_drag(int number, SplitMix64& random) {
  constexpr double kRadius_m = 0.100, kMinZ_m = 0.030, kMaxZ_m = 0.180, kMinGap_m = 0.080;
  StudySample sample;
  sample.number = number;
  sample.places.emplace_back(0.0, 0.0, 0.050);
  const std::size_t targets = 3 + random.below(3);
  while (sample.places.size() < targets + 1) {
    const Eigen::Vector3d at =
        to_tenths_of_mm({random.between(-kRadius_m, kRadius_m),
                         random.between(-kRadius_m, kRadius_m), random.between(kMinZ_m, kMaxZ_m)});
    if (at.head<2>().norm() > kRadius_m || (at - sample.places.back()).norm() < kMinGap_m) continue;
    sample.places.push_back(at);
  }
  return sample;
}

}  // namespace

std::string_view to_string(StudyExperiment experiment) {
  return experiment == StudyExperiment::heights ? "heights" : "drag";
}

std::optional<StudyTechnique> study_technique_from_string(std::string_view name) {
  const bool cocl = name == "cocl";  // layered, with one kernel for the whole object
  const auto technique = value_named(kShadowTechniqueNames, cocl ? "layered" : name);
  if (!technique) return std::nullopt;
  return StudyTechnique{std::string(name), *technique,
                        cocl ? KernelSource::centroid : KernelSource::automatic};
}

int default_samples(StudyExperiment experiment) {
  return experiment == StudyExperiment::heights ? 20 : 5;
}

std::string study_name(const StudyDesign& design) {
  std::string name = fmt::format("{}-seed{}-samples{}-", to_string(design.experiment), design.seed,
                                 design.samples);
  if (design.experiment == StudyExperiment::drag) {
    name += fmt::format("within{:.4f}m-", design.tolerance_m);
  }
  for (std::size_t i = 0; i < design.techniques.size(); ++i) {
    name += (i == 0 ? "" : "+") + design.techniques[i].name;
  }
  return name;
}

int williams_rows(int count) {
  return count % 2 == 0 ? count : 2 * count;
}

std::vector<int> williams_row(int count, std::int64_t row) {
  PENUMBRA_ASSERT(count > 0 && row >= 0);
  const auto r = static_cast<int>(row % williams_rows(count));
  std::vector<int> treatments;
  for (int i = 0; i < count; ++i) {
    const int in_first_row = i % 2 == 1 ? (i + 1) / 2 : (count - i / 2) % count;
    treatments.push_back((in_first_row + r) % count);
  }
  if (r >= count) std::ranges::reverse(treatments);
  return treatments;
}

int highest_of(const StudySample& sample) {
  const auto highest = std::ranges::max_element(
      sample.places, {}, [](const Eigen::Vector3d& place) { return place.z(); });
  return static_cast<int>(highest - sample.places.begin());
}

StudyPlan plan_study(const StudyDesign& design) {
  PENUMBRA_ASSERT(!design.techniques.empty() && design.samples > 0 && design.participant > 0);
  StudyPlan plan;
  plan.design = design;
  SplitMix64 stimuli(design.seed, kStimuli);
  for (int number = 1; number <= design.samples; ++number) {
    plan.samples.push_back(design.experiment == StudyExperiment::heights
                               ? sample_of_heights(number, stimuli)
                               : sample_of_drag(number, stimuli));
  }
  // The design orders symbols 0, 1, ... The shuffles assign a technique or sample to each symbol.
  const auto techniques = static_cast<int>(design.techniques.size());
  const std::vector<int> technique_of =
      shuffled(techniques, SplitMix64(design.seed, kTechniqueOrder));
  const std::vector<int> sample_of =
      shuffled(design.samples, SplitMix64(design.seed, kSampleOrder));
  const std::int64_t participant = design.participant - 1;
  int block = 0;
  for (const int technique_symbol : williams_row(techniques, participant)) {
    int trial = 0;
    for (const int sample_symbol : williams_row(design.samples, participant * techniques + block)) {
      plan.trials.push_back({static_cast<int>(plan.trials.size()) + 1, block + 1, ++trial,
                             technique_of[static_cast<std::size_t>(technique_symbol)],
                             sample_of[static_cast<std::size_t>(sample_symbol)]});
    }
    ++block;
  }
  return plan;
}

}  // namespace penumbra
