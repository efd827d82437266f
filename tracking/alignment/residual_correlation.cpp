#include "tracking/alignment/pose_solver.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

namespace penumbra {
namespace {

using Two = double __attribute__((vector_size(16)));
using Pair = float __attribute__((vector_size(8), may_alias));

// Sums over the edges in one lattice direction. The camera response and bright light widen all
// white areas; squares_without_widening() removes this common displacement of the edges.
struct Direction {
  Two sums{};     // sums of s (an edge's leverage * residual) and q (leverage * slope)
  Two squares{};  // sums of s^2 and q^2
  double products = 0.0;

  void add(const Two& both) {
    sums += both;
    squares += both * both;
    products += both[0] * both[1];
  }
  // Returns the sum of squares without the widening.
  [[nodiscard]] double squares_without_widening() const {
    if (!(sums[1] > 0.0)) return 0.0;
    const double widening = sums[0] / sums[1];
    return squares[0] - 2.0 * widening * products + widening * widening * squares[1];
  }
};

// Sums over the edges of the variances of s that independent residuals would have.
struct Expected {
  double sum = 0.0;
  double squares = 0.0;  // sum of the squared variances
  int edges = 0;
};

void add_edges(const AlignedTag& tag, const simd::Samples& s, double variance,
               std::array<Direction, 2>& directions, Expected& expected) {
  const auto* const pairs = reinterpret_cast<const Pair*>(s.leverage);
  const float* const squares = s.leverage + 2 * static_cast<std::ptrdiff_t>(s.count);
  double tag_expected = 0.0;
  double tag_squares = 0.0;
  int begin = 0;
  const std::int32_t* const step_run = tag.step_run.data();
  const int steps = tag.step_count;
  for (int k = 0; k < steps;) {
    const std::int32_t run = step_run[k];
    while (k < steps && step_run[k] == run) ++k;
    const int end = tag.step_end[static_cast<std::size_t>(k - 1)];
    const bool vertical = tag.runs[static_cast<std::size_t>(run)].vertical;
    Pair sums{};
    float square_sum = 0.0F;
#pragma GCC unroll 2
    for (int i = begin; i < end; ++i) {
      sums += pairs[i];
      square_sum += squares[i];
    }
    begin = end;
    if (!(square_sum > 0.0F)) continue;
    directions[vertical ? 0 : 1].add(__builtin_convertvector(sums, Two));
    const auto run_expected = static_cast<double>(square_sum);
    tag_expected += run_expected;
    tag_squares += run_expected * run_expected;
    ++expected.edges;
  }
  const double scale = variance / (tag.gain * tag.gain);
  expected.sum += tag_expected * scale;
  expected.squares += tag_squares * scale * scale;
}

}  // namespace

double design_effect(const AlignmentProblem& problem, const PoseSolver& solver, SampleArena& arena,
                     double cutoff) {
  std::array<Direction, 2> directions;  // edges along b, edges along a
  Expected expected;
  int parameters = 8;  // 6 of the pose, 2 widenings
  const auto inverse_limit = static_cast<float>(1.0 / solver.tukey_share(cutoff));
  for (const AlignedTag* tag : problem.active) {
    if (tag->used < kMinSamples || !(tag->gain > 1.5)) continue;
    parameters += 2;
    simd::Samples s = tag->samples;
    s.leverage = arena.temporary_floats(3 * static_cast<std::size_t>(s.count));
    simd::LeverageInput in;
    in.inverse_gain = static_cast<float>(1.0 / tag->gain);
    in.offset = static_cast<float>(tag->offset);
    in.inverse_limit = inverse_limit;
    problem.loops->leverage(in, s);
    add_edges(*tag, s, solver.variance(), directions, expected);
  }
  const int freedom = expected.edges - parameters;
  if (freedom < 4 || !(expected.sum > 0.0)) return 1.0;
  double observed = 0.0;
  for (const Direction& direction : directions) observed += direction.squares_without_widening();
  // The residuals are from before the latest step. Subtracts the part that the step removed.
  observed -= solver.slope() * solver.slope() * solver.last_step_squares() * expected.squares /
              expected.sum;
  return std::max(observed, 0.0) / expected.sum * expected.edges / freedom;
}

}  // namespace penumbra
