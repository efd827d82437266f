// Selects the pixels that an alignment compares with a tag.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "tracking/alignment/alignment_problem.hpp"
#include "tracking/alignment/sample_arena.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

inline constexpr int kEveryPixel = 1'000'000;  // no limit for the samples of a tag

class EdgeSampler {
 public:
  EdgeSampler(AlignmentProblem& problem, std::size_t initial_floats)
      : problem_(problem), arena_(initial_floats) {}

  // Estimates gain and offset of each tag from its data cells in this image.
  void read_levels();
  // Frees the samples of all tags for the next selection.
  void free_samples() { arena_.free_samples(); }
  // Selects about `cap` pixels or fewer at the edges of one tag.
  void select(AlignedTag& tag, bool wide, int cap);
  // Moves the tag's samples to the displacements of its rows at the current velocity.
  void follow_shear(AlignedTag& tag) const;
  // Samples the data cells' centres and evaluates the model for them.
  void read_cells(AlignedTag& tag);
  // Replaces the values that read_cells() set by means over the pixels within 1/6 cell.
  void average_cells(AlignedTag& tag) const;
  // See TagAligner::edge_pixels().
  [[nodiscard]] std::vector<EdgePixel> edge_pixels(std::span<const TagAlignment> seen);

  [[nodiscard]] SampleArena& arena() { return arena_; }

 private:
  // Sampled offsets across an edge [px]; if empty, all pixels within reach.
  struct Band {
    std::array<int, 16> offsets{};
    int count = 0;
    [[nodiscard]] int max_row_count(double reach_px) const;
    // Returns the step length [px] for about `cap` samples on edges that extend by `length` along
    // the nearer and by `tilt` along the other image axis [px].
    [[nodiscard]] double stride(double reach_px, double length, double tilt, int cap) const;
    // Returns the offsets across an edge relative to the first row of a step.
    [[nodiscard]] std::array<float, 20> row_offsets() const;
  };
  // `reach_px`: maximum distance from edges along a, and from edges along b.
  void walk_runs(AlignedTag& tag, const Band& band, const std::array<double, 2>& reach_px, int cap);
  void step_along(AlignedTag& tag, const Band& band, const std::array<double, 2>& reach_px,
                  double stride);
  void fill_plan(const Band& band, const std::array<float, 20>& offsets, int steps, AlignedTag& tag,
                 simd::WalkPlan& plan) const;
  void allocate_samples(AlignedTag& tag, int capacity);
  void locate_samples(AlignedTag& tag) const;
  void finish_samples(AlignedTag& tag);
  void flatten(AlignedTag& tag) const;
  void remove_samples_near_outline(AlignedTag& tag) const;
  void attach(const AlignedTag& tag, const simd::Samples& samples) const;
  void evaluate(AlignedTag& tag) const;

  AlignmentProblem& problem_;
  SampleArena arena_;
  std::vector<simd::RunWalk::Part> run_parts_;  // scratch memory for the runs of one tag
};

// Checks that the active tags' data cells have the expected colours at a solved pose. Sets the
// result's tags, tags_verified, verified and reason.
void decode_tags(AlignmentProblem& problem, EdgeSampler& sampler, AlignmentResult& result);

}  // namespace penumbra
