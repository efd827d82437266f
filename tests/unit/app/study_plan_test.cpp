#include "app/study/study_plan.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "app/study/study_task.hpp"

namespace penumbra {
namespace {

StudyDesign design_of(StudyExperiment experiment, int participant, int samples,
                      std::initializer_list<const char*> techniques) {
  StudyDesign design;
  design.experiment = experiment;
  design.participant = participant;
  design.seed = 7;
  design.samples = samples;
  for (const char* name : techniques) {
    design.techniques.push_back(*study_technique_from_string(name));
  }
  return design;
}

// Property of a Williams design: each treatment occurs equally often at each position, and follows
// each other treatment equally often.
TEST(StudyPlan, BalancesWilliamsDesign) {
  for (int n = 1; n <= 9; ++n) {
    std::map<std::pair<int, int>, int> at_position, after;
    const int rows = williams_rows(n);
    EXPECT_EQ(rows, n % 2 == 0 ? n : 2 * n);
    for (int r = 0; r < rows; ++r) {
      const std::vector<int> row = williams_row(n, r);
      ASSERT_EQ(std::set<int>(row.begin(), row.end()).size(), static_cast<std::size_t>(n));
      for (int i = 0; i < n; ++i) {
        ++at_position[{row[static_cast<std::size_t>(i)], i}];
        if (i > 0)
          ++after[{row[static_cast<std::size_t>(i - 1)], row[static_cast<std::size_t>(i)]}];
      }
    }
    EXPECT_EQ(at_position.size(), static_cast<std::size_t>(n * n));
    for (const auto& [what, count] : at_position) EXPECT_EQ(count, rows / n) << n;
    EXPECT_EQ(after.size(), static_cast<std::size_t>(n * (n - 1)));
    for (const auto& [what, count] : after) EXPECT_EQ(count, rows / n) << n;
    EXPECT_EQ(williams_row(n, rows + 1), williams_row(n, 1 % rows));
  }
}

TEST(StudyPlan, AssignsEverySampleOncePerTechnique) {
  std::map<std::pair<int, int>, int> blocks_of_technique;  // counts per (technique, block)
  for (int participant = 1; participant <= 6; ++participant) {
    const StudyPlan plan = plan_study(
        design_of(StudyExperiment::heights, participant, 20, {"layered", "walls", "simple"}));
    ASSERT_EQ(plan.trials.size(), 60U);
    std::set<std::pair<int, int>> seen;
    std::map<int, std::set<int>> techniques_of_block;
    for (std::size_t i = 0; i < plan.trials.size(); ++i) {
      const StudyTrial& trial = plan.trials[i];
      EXPECT_EQ(trial.number, static_cast<int>(i) + 1);
      EXPECT_EQ(trial.block, static_cast<int>(i) / 20 + 1);
      EXPECT_EQ(trial.trial, static_cast<int>(i) % 20 + 1);
      EXPECT_TRUE(seen.insert({trial.technique, trial.sample}).second);
      techniques_of_block[trial.block].insert(trial.technique);
    }
    for (const auto& [block, techniques] : techniques_of_block) {
      ASSERT_EQ(techniques.size(), 1U);
      ++blocks_of_technique[{*techniques.begin(), block}];
    }
  }
  // Six participants use all rows of the design for three techniques.
  EXPECT_EQ(blocks_of_technique.size(), 9U);
  for (const auto& [what, count] : blocks_of_technique) EXPECT_EQ(count, 2);
}

TEST(StudyPlan, DependsOnlyOnSeedAndParticipant) {
  const auto design = design_of(StudyExperiment::heights, 1, 20, {"layered", "walls"});
  const StudyPlan plan = plan_study(design);
  const StudyPlan again = plan_study(design);
  auto other = design;
  other.participant = 2;
  const StudyPlan second = plan_study(other);
  other.seed = 8;
  const StudyPlan reseeded = plan_study(other);
  bool same_order = true;
  for (std::size_t i = 0; i < plan.trials.size(); ++i) {
    EXPECT_EQ(plan.trials[i].sample, again.trials[i].sample);
    same_order = same_order && plan.trials[i].sample == second.trials[i].sample;
  }
  EXPECT_FALSE(same_order);
  EXPECT_NE(plan.trials[0].technique, second.trials[0].technique);
  for (std::size_t i = 0; i < plan.samples.size(); ++i) {
    EXPECT_EQ(plan.samples[i].places, again.samples[i].places);
    EXPECT_EQ(plan.samples[i].places, second.samples[i].places);  // independent of participant
    EXPECT_NE(plan.samples[i].places, reseeded.samples[i].places);
  }
  // A fixed value: samples must not depend on the build.
  EXPECT_EQ(plan.samples[0].places[0], Eigen::Vector3d(0.0295, -0.0641, 0.0832));
}

TEST(StudyPlan, SeparatesHighestSphereByDifficultyGap) {
  const StudyPlan plan =
      plan_study(design_of(StudyExperiment::heights, 1, 500, {"layered", "walls"}));
  std::map<int, int> highest;
  int hard = 0;
  for (const StudySample& sample : plan.samples) {
    ASSERT_EQ(sample.places.size(), 3U);
    std::vector<double> heights;
    for (std::size_t i = 0; i < 3; ++i) {
      const Eigen::Vector3d& p = sample.places[i];
      heights.push_back(p.z());
      EXPECT_GE(p.z(), kStudySphere_m);
      EXPECT_LE(p.z(), 0.2);
      EXPECT_LE(p.head<2>().norm(), 0.0902);
      // No sphere is above another.
      EXPECT_GT((p - sample.places[(i + 1) % 3]).head<2>().norm(), 3.0 * kStudySphere_m);
    }
    ++highest[highest_of(sample)];
    hard += sample.hard ? 1 : 0;
    std::ranges::sort(heights);
    EXPECT_EQ(heights[2], sample.places[static_cast<std::size_t>(highest_of(sample))].z());
    const double gap = heights[2] - heights[1];
    if (sample.hard) {
      EXPECT_GE(gap, 0.0079);
      EXPECT_LE(gap, 0.0151);
    } else {
      EXPECT_GE(gap, 0.0399);
      EXPECT_LE(gap, 0.0601);
    }
  }
  EXPECT_EQ(hard, 250);
  // Each sphere is the highest equally often: 167 times expected, with a standard deviation of
  // 10.5.
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(highest[i], 500.0 / 3.0, 45.0) << i;
}

TEST(StudyPlan, CreatesThreeToFiveReachableDragTargets) {
  const StudyPlan plan = plan_study(design_of(StudyExperiment::drag, 1, 300, {"layered"}));
  std::map<std::size_t, int> counts;
  for (const StudySample& sample : plan.samples) {
    ++counts[sample.places.size() - 1];
    for (std::size_t i = 1; i < sample.places.size(); ++i) {
      EXPECT_LE(sample.places[i].head<2>().norm(), 0.1001);
      EXPECT_GE(sample.places[i].z(), 0.0299);
      EXPECT_LE(sample.places[i].z(), 0.1801);
      EXPECT_GE((sample.places[i] - sample.places[i - 1]).norm(), 0.0799);
    }
  }
  ASSERT_EQ(counts.size(), 3U);
  EXPECT_EQ(counts.begin()->first, 3U);
  EXPECT_EQ(counts.rbegin()->first, 5U);
}

TEST(StudyPlan, IdentifiesStudyByParameters) {
  auto design = design_of(StudyExperiment::heights, 1, 20, {"layered", "cocl"});
  EXPECT_EQ(study_name(design), "heights-seed7-samples20-layered+cocl");
  design.participant = 5;
  EXPECT_EQ(study_name(design), "heights-seed7-samples20-layered+cocl");
  design.experiment = StudyExperiment::drag;
  design.tolerance_m = 0.0125;
  EXPECT_EQ(study_name(design), "drag-seed7-samples20-within0.0125m-layered+cocl");
  EXPECT_FALSE(study_technique_from_string("soft"));
  EXPECT_EQ(study_technique_from_string("cocl")->kernels, KernelSource::centroid);
}

// The study's scene contains the casters, planes and lights that every technique needs.
TEST(StudyScene, HasCastersPlanesWallsAndLight) {
  for (const StudyExperiment experiment : {StudyExperiment::heights, StudyExperiment::drag}) {
    const Scene scene = study_scene(experiment);
    ASSERT_EQ(scene.shadows.size(), 1U);
    const ShadowNode& node = scene.shadows[0];
    EXPECT_EQ(node.casters.size(), scene.objects.size());
    EXPECT_EQ(node.planes.size(), 1U);
    EXPECT_EQ(node.walls.size(), 2U);
    EXPECT_EQ(node.lights.size(), 1U);
    EXPECT_GT(node.layered.umbra_height, 0.2)
        << "the umbra must exist at every height of the study";
    for (const SceneObject& object : scene.objects) {
      EXPECT_NEAR(static_cast<double>(object.model->max_corner.z), kStudySphere_m, 1e-6);
    }
  }
}

}  // namespace
}  // namespace penumbra
