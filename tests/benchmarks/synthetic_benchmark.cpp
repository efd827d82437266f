// The pattern alignment on exact synthetic pictures: error over the Cramer-Rao bound, occlusion,
// basin of convergence, motion blur.
#include <time.h>

#include <Eigen/LU>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <random>

#include "core/evaluation.hpp"
#include "support/synthetic_board.hpp"
#include "tracking/tag_alignment.hpp"

namespace {

using namespace penumbra;
using namespace penumbra::test;

double thread_cpu_us() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e6 * static_cast<double>(now.tv_sec) + 1e-3 * static_cast<double>(now.tv_nsec);
}

struct Score {
  int runs = 0;
  int found = 0;
  std::vector<double> errors;
  std::vector<double> us;
  double ratio2 = 0.0;  // sum of (error / bound)^2

  void print(const char* name) const {
    const Statistics e = statistics_of(errors);
    std::printf("%-34s found %3d/%-3d  overlay rms %.4f med %.4f max %.3f  us %.0f", name, found,
                runs, e.rmse, e.median, e.max, statistics_of(us).median);
    if (ratio2 > 0.0) std::printf("  error/bound %.2f", std::sqrt(ratio2 / found));
    std::printf("\n");
    std::fflush(stdout);
  }
};

}  // namespace

int main(int argc, char** argv) {
  const CameraModel camera = wide_camera();
  const std::vector<MappedTag> tags = board(3, 2, 0.06);
  auto renderer = PatternRenderer::create(camera, tags).value();
  const auto wants = [&](const char* what) {
    for (int i = 1; i < argc; ++i) {
      if (std::strcmp(argv[i], what) == 0) return true;
    }
    return argc == 1;
  };
  int samples = PatternRenderOptions().samples;
  for (int i = 1; i < argc; ++i) {
    if (std::strncmp(argv[i], "samples=", 8) == 0) samples = std::atoi(argv[i] + 8);
  }
  const auto run = [&](TagAligner& aligner, const GreyImage& image, const CameraPose& truth,
                       const CameraPose& start, double start_px, const Vector6d& motion,
                       Score& score, double bound_px) {
    AlignmentInput input;
    input.luma = image.view();
    input.predicted = start;
    // The start errors' own size.
    input.covariance = loose_prior(0.0007 * start_px, 0.0012 * start_px);
    input.exposure_motion = motion;
    const double begin = thread_cpu_us();
    const AlignmentResult& result = aligner.align(input);
    score.us.push_back(thread_cpu_us() - begin);
    ++score.runs;
    const double error = overlay_difference(camera, result.T_table_camera, truth).rms_px();
    if (result.verified && error < 3.0) {
      ++score.found;
      score.errors.push_back(error);
      if (bound_px > 0.0) score.ratio2 += error * error / (bound_px * bound_px);
    } else if (result.verified) {
      std::printf("  wrong pose verified: %.2f px from start %.1f px\n", error, start_px);
    }
  };

  if (wants("bias")) {
    AlignmentOptions options;
    options.effort = AlignmentEffort::accurate;
    auto aligner = TagAligner::create(camera, tags, options).value();
    std::mt19937_64 random(7);
    Score score;
    for (int k = 0; k < 12; ++k) {
      const CameraPose truth = random_view(random);
      PatternRenderOptions render;
      render.samples = samples;
      const std::array<CameraPose, 1> path = {truth};
      run(aligner, renderer.render(path, render), truth,
          displaced(camera, tags, truth, 2.0, random), 2.0, Vector6d::Zero(), score, 0.0);
    }
    score.print("accurate, no noise");
  }
  if (wants("noise")) {
    for (const AlignmentEffort effort : {AlignmentEffort::fast, AlignmentEffort::accurate}) {
      for (const double noise : {0.0, 1.0, 2.0, 5.0}) {
        AlignmentOptions options;
        options.effort = effort;
        auto aligner = TagAligner::create(camera, tags, options).value();
        std::mt19937_64 random(7);
        Score score;
        for (int k = 0; k < 12; ++k) {
          const CameraPose truth = random_view(random);
          PatternRenderOptions render;
          render.noise_grey = noise;
          render.samples = samples;
          render.seed = static_cast<std::uint64_t>(k) + 1;
          const std::array<CameraPose, 1> path = {truth};
          const GreyImage image = renderer.render(path, render);
          double bound = 0.0;
          if (noise == 2.0)
            bound = expected_overlay_error_px(
                camera, truth, pose_bound(renderer, camera, tags, truth, render, noise));
          run(aligner, image, truth, displaced(camera, tags, truth, 2.0, random), 2.0,
              Vector6d::Zero(), score, bound);
        }
        char name[64];
        std::snprintf(name, sizeof name, "%s, noise %.0f",
                      effort == AlignmentEffort::fast ? "fast" : "accurate", noise);
        score.print(name);
      }
    }
  }
  if (wants("cover")) {
    for (const double share : {0.15, 0.30, 0.50}) {
      auto aligner = TagAligner::create(camera, tags).value();
      std::mt19937_64 random(11);
      Score score;
      for (int k = 0; k < 16; ++k) {
        const CameraPose truth = random_view(random);
        PatternRenderOptions render;
        render.noise_grey = 2.0;
        render.cover_share = share;
        render.seed = static_cast<std::uint64_t>(k) + 1;
        const std::array<CameraPose, 1> path = {truth};
        run(aligner, renderer.render(path, render), truth,
            displaced(camera, tags, truth, 2.0, random), 2.0, Vector6d::Zero(), score, 0.0);
      }
      char name[64];
      std::snprintf(name, sizeof name, "fast, %.0f %% covered", 100.0 * share);
      score.print(name);
    }
  }
  if (wants("basin")) {
    for (const double start : {4.0, 8.0, 12.0, 16.0, 24.0}) {
      auto aligner = TagAligner::create(camera, tags).value();
      std::mt19937_64 random(13);
      Score score;
      for (int k = 0; k < 10; ++k) {
        const CameraPose truth = random_view(random);
        PatternRenderOptions render;
        render.noise_grey = 2.0;
        render.samples = 256;
        const std::array<CameraPose, 1> path = {truth};
        const GreyImage image = renderer.render(path, render);
        for (int j = 0; j < 10; ++j)
          run(aligner, image, truth, displaced(camera, tags, truth, start, random), start,
              Vector6d::Zero(), score, 0.0);
      }
      char name[64];
      std::snprintf(name, sizeof name, "fast, start error %.0f px", start);
      score.print(name);
    }
  }
  if (wants("blur")) {
    for (const double length : {4.0, 8.0, 16.0, 24.0}) {
      for (const bool known : {false, true}) {
        auto aligner = TagAligner::create(camera, tags).value();
        std::mt19937_64 random(17);
        Score score;
        for (int k = 0; k < 12; ++k) {
          const CameraPose truth = random_view(random);
          const CameraPose moved = displaced(camera, tags, truth, length, random);
          const Vector6d motion = perturbation_between(truth, moved);
          std::vector<CameraPose> path;
          for (int i = 0; i < 32; ++i)
            path.push_back(perturbed(truth, motion * ((i + 0.5) / 32.0 - 0.5)));
          PatternRenderOptions render;
          render.noise_grey = 2.0;
          const GreyImage image = renderer.render(path, render);
          run(aligner, image, truth, displaced(camera, tags, truth, 2.0, random), 2.0,
              known ? motion : Vector6d::Zero().eval(), score, 0.0);
        }
        char name[64];
        std::snprintf(name, sizeof name, "fast, blur %.0f px, %s", length,
                      known ? "known" : "unknown");
        score.print(name);
      }
    }
  }
  return 0;
}
