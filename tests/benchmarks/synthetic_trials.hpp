// Trials of the pattern alignment on exact synthetic images: six tags of 60 mm with cells of about
// 10 px, seen by a 1280x720 camera with lens distortion.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <random>
#include <span>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "core/stopwatch.hpp"
#include "support/synthetic_board.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra::test {

struct TrialScore {
  int runs = 0;
  int found = 0;               // number of verified poses with an error below 3 px
  int wrong = 0;               // number of verified poses with a larger error
  std::vector<double> errors;  // overlay errors of the poses in `found` [px]
  std::vector<double> us;      // CPU time of each run [us]
  double ratio2 = 0.0;         // sum of (error / bound)^2, if the bound was requested

  [[nodiscard]] double found_share() const { return runs > 0 ? 1.0 * found / runs : 0.0; }
  [[nodiscard]] double rms_px() const { return statistics_of(errors).rmse; }
  [[nodiscard]] double over_bound() const { return found > 0 ? std::sqrt(ratio2 / found) : 0.0; }
};

class SyntheticTrials {
 public:
  explicit SyntheticTrials(int samples = PatternRenderOptions().samples) : samples_(samples) {}

  // Images with white noise [grey levels] and start errors of 2 px. Each view is drawn `draws`
  // times with different noise, because the ratio of error to bound varies by about 100 % between
  // single images. The Cramer-Rao bound is optional; it treats gain and offset of each tag as
  // unknown.
  [[nodiscard]] TrialScore noise(AlignmentEffort effort, double noise_grey, int views,
                                 bool with_bound, int draws = 1) {
    TagAligner aligner = make_aligner(effort);
    TrialScore score;
    for_each_noisy_image(noise_grey, views, with_bound, draws,
                         [&](const GreyImage& image, const CameraPose& truth,
                             const CameraPose& start, double bound_px) {
                           run(aligner, image, truth, start, 2.0, Vector6d::Zero(), score,
                               bound_px);
                         });
    return score;
  }

  // Runs the images of noise(), with the bound, for methods without a start pose: find(k, image)
  // returns the camera pose that method k finds, or nullopt. `scores`: one per method.
  template <class Find>
  void noise_by(double noise_grey, int views, int draws, std::vector<TrialScore>& scores,
                Find find) {
    for_each_noisy_image(
        noise_grey, views, true, draws,
        [&](const GreyImage& image, const CameraPose& truth, const CameraPose&, double bound_px) {
          for (std::size_t k = 0; k < scores.size(); ++k) {
            const Stopwatch watch;
            const std::optional<CameraPose> pose = find(k, image);
            scores[k].us.push_back(1e3 * watch.elapsed().cpu_ms);
            count(pose, truth, scores[k], bound_px);
          }
        });
  }

  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  [[nodiscard]] const std::vector<MappedTag>& tags() const { return tags_; }

  // Covers a fraction of every tag; noise of 2 grey levels.
  [[nodiscard]] TrialScore cover(double fraction, int views) {
    TagAligner aligner = make_aligner(AlignmentEffort::fast);
    std::mt19937_64 random(11);
    TrialScore score;
    for (int k = 0; k < views; ++k) {
      const CameraPose truth = random_view(random);
      PatternRenderOptions render = options(k);
      render.noise_grey = 2.0;
      render.covered_fraction = fraction;
      run(aligner, image(truth, render), truth, displaced(camera_, tags_, truth, 2.0, random), 2.0,
          Vector6d::Zero(), score, 0.0);
    }
    return score;
  }

  // Start errors are `start_px` on average at the tags' corners; noise of 2 grey levels.
  [[nodiscard]] TrialScore basin(double start_px, int views, int starts) {
    TagAligner aligner = make_aligner(AlignmentEffort::fast);
    std::mt19937_64 random(13);
    TrialScore score;
    for (int k = 0; k < views; ++k) {
      const CameraPose truth = random_view(random);
      PatternRenderOptions render = options(k);
      render.noise_grey = 2.0;
      render.samples = 256;
      const GreyImage view_image = image(truth, render);
      for (int j = 0; j < starts; ++j)
        run(aligner, view_image, truth, displaced(camera_, tags_, truth, start_px, random),
            start_px, Vector6d::Zero(), score, 0.0);
    }
    return score;
  }

  // Motion blur of this length at the tags' corners; the motion is known or unknown to the
  // alignment. Noise of 2 grey levels.
  [[nodiscard]] TrialScore blur(double length_px, bool known, int views) {
    TagAligner aligner = make_aligner(AlignmentEffort::fast);
    std::mt19937_64 random(17);
    TrialScore score;
    for (int k = 0; k < views; ++k) {
      const CameraPose truth = random_view(random);
      const CameraPose moved = displaced(camera_, tags_, truth, length_px, random);
      const Vector6d motion = perturbation_between(truth, moved);
      std::vector<CameraPose> path;
      for (int i = 0; i < 32; ++i)
        path.push_back(perturbed(truth, motion * ((i + 0.5) / 32.0 - 0.5)));
      PatternRenderOptions render = options(k);
      render.noise_grey = 2.0;
      run(aligner, renderer_.render(path, render), truth,
          displaced(camera_, tags_, truth, 2.0, random), 2.0,
          known ? motion : Vector6d::Zero().eval(), score, 0.0);
    }
    return score;
  }

 private:
  [[nodiscard]] TagAligner make_aligner(AlignmentEffort effort) const {
    AlignmentOptions alignment;
    alignment.effort = effort;
    return TagAligner::create(camera_, tags_, alignment).value();
  }
  [[nodiscard]] PatternRenderOptions options(int view) const {
    PatternRenderOptions render;
    render.samples = samples_;
    render.seed = static_cast<std::uint64_t>(view) + 1;
    return render;
  }
  [[nodiscard]] GreyImage image(const CameraPose& pose, const PatternRenderOptions& render) {
    return renderer_.render(std::span(&pose, 1), render);
  }
  template <class Visit>
  void for_each_noisy_image(double noise_grey, int views, bool with_bound, int draws, Visit visit) {
    std::mt19937_64 random(7);
    for (int k = 0; k < views; ++k) {
      const CameraPose truth = random_view(random);
      PatternRenderOptions render = options(k);
      render.noise_grey = noise_grey;
      const double bound_px =
          with_bound ? predicted_overlay_error_px(
                           camera_, truth,
                           pose_bound(renderer_, camera_, tags_, truth, render, noise_grey))
                     : 0.0;
      render.noise_grey = 0.0;
      const std::vector<double> light = renderer_.render_light(std::span(&truth, 1), render);
      for (int j = 0; j < draws; ++j) {
        const GreyImage image = noisy(light, noise_grey, random);
        const CameraPose start = displaced(camera_, tags_, truth, 2.0, random);
        visit(image, truth, start, bound_px);
      }
    }
  }
  [[nodiscard]] GreyImage noisy(std::span<const double> light, double noise_grey,
                                std::mt19937_64& random) const {
    std::normal_distribution<double> noise(0.0, 1.0);
    GreyImage image;
    image.width = camera_.width();
    image.height = camera_.height();
    image.pixels.reserve(light.size());
    for (const double l : light) {
      const double grey = 255.0 * l + noise_grey * noise(random);
      image.pixels.push_back(static_cast<std::uint8_t>(std::lround(std::clamp(grey, 0.0, 255.0))));
    }
    return image;
  }
  void run(TagAligner& aligner, const GreyImage& image, const CameraPose& truth,
           const CameraPose& start, double start_px, const Vector6d& motion, TrialScore& score,
           double bound_px) const {
    AlignmentInput input;
    input.luma = image.view();
    input.predicted = as_map_pose(start);
    // The standard deviations of the prior match the start errors.
    input.covariance = loose_prior(0.0007 * start_px, 0.0012 * start_px);
    input.exposure_motion = motion;
    const Stopwatch watch;
    const AlignmentResult result = aligner.align(input);
    score.us.push_back(1e3 * watch.elapsed().cpu_ms);
    count(result.verified ? std::optional(as_table_pose(result.T_map_camera)) : std::nullopt, truth,
          score, bound_px);
  }
  void count(const std::optional<CameraPose>& pose, const CameraPose& truth, TrialScore& score,
             double bound_px) const {
    ++score.runs;
    if (!pose) return;
    const double error = overlay_difference(camera_, *pose, truth).rms_px();
    if (error < 3.0) {
      ++score.found;
      score.errors.push_back(error);
      if (bound_px > 0.0) score.ratio2 += error * error / (bound_px * bound_px);
    } else {
      ++score.wrong;
    }
  }

  int samples_;
  CameraModel camera_ = wide_camera();
  std::vector<MappedTag> tags_ = board(3, 2, 0.06);
  PatternRenderer renderer_ = PatternRenderer::create(camera_, tags_).value();
};

}  // namespace penumbra::test
