// Whether a solved pose holds: the noise around it, how much its samples are worth, and the cells
// read at it.

#include "tracking/alignment/tag_alignment_state.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>
#include <vector>

#include "core/assert.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

using Two = double __attribute__((vector_size(16)));
using Pair = float __attribute__((vector_size(8), may_alias));

// What share of the variance of a tag's cells in the picture the model has.
class Explained {
 public:
  void add(double model, double value) {
    count_ += 1.0;
    model_ += model;
    value_ += value;
    model2_ += model * model;
    value2_ += value * value;
    both_ += model * value;
  }
  // 0 where the model is no better than its negative, negative where too few cells were seen.
  [[nodiscard]] double share() const {
    constexpr double kFewest = 16.0;
    if (count_ < kFewest) return -1.0;
    const double both = count_ * both_ - model_ * value_;
    const double alone =
        (count_ * model2_ - model_ * model_) * (count_ * value2_ - value_ * value_);
    return both > 0.0 && alone > 0.0 ? std::min(both * both / alone, 1.0) : 0.0;
  }

 private:
  double count_ = 0.0, model_ = 0.0, value_ = 0.0;
  double model2_ = 0.0, value2_ = 0.0, both_ = 0.0;
};

// The same, of the cells that nothing covers: a line through the three fifths of them that are
// nearest to one (least trimmed squares). Negative where too few are seen.
double explained_by_most(const float* models, const float* values, int count) {
  constexpr int kFewest = 16;
  if (count < kFewest) return -1.0;
  constexpr double kShare = 0.6;
  // The variance of the middle three fifths of a normal distribution.
  constexpr double kOfNormal = 0.2145;
  constexpr int kSteps = 5;
  const auto n = static_cast<std::size_t>(count);
  const auto most = static_cast<std::size_t>(kShare * count + 0.5);
  std::vector<std::size_t> order(n);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::vector<double> squares(n);
  double gain = 0.0;
  double spread = 0.0;  // of the models, of all cells
  double rest = 0.0;    // what is not explained, of those on the line
  for (int step = 0; step < kSteps; ++step) {
    const std::size_t used = step == 0 ? n : most;
    double m = 0.0;
    double v = 0.0;
    for (std::size_t k = 0; k < used; ++k) {
      m += static_cast<double>(models[order[k]]) / static_cast<double>(used);
      v += static_cast<double>(values[order[k]]) / static_cast<double>(used);
    }
    double mm = 0.0;
    double mv = 0.0;
    for (std::size_t k = 0; k < used; ++k) {
      const double of_model = static_cast<double>(models[order[k]]) - m;
      mm += of_model * of_model;
      mv += of_model * (static_cast<double>(values[order[k]]) - v);
    }
    if (step == 0) spread = mm / static_cast<double>(n);
    if (!(mm > 0.0)) return 0.0;
    gain = mv / mm;
    for (std::size_t i = 0; i < n; ++i) {
      const double residual =
          static_cast<double>(values[i]) - v - gain * (static_cast<double>(models[i]) - m);
      squares[i] = residual * residual;
    }
    std::ranges::nth_element(order, order.begin() + static_cast<std::ptrdiff_t>(most), {},
                             [&squares](std::size_t i) { return squares[i]; });
    rest = 0.0;
    for (std::size_t k = 0; k < most; ++k) rest += squares[order[k]] / static_cast<double>(most);
  }
  const double explained = gain * gain * spread;
  if (!(gain > 0.0) || !(explained > 0.0)) return 0.0;
  return explained / (explained + rest / kOfNormal);
}

// Calls each(tag, k) for about `count` of the samples that the last equations are of, evenly over
// all tags' together.
template <class Tags, class Each>
void visit_evenly(const Tags& tags, int count, const Each& each) {
  int total = 0;
  for (const auto* tag : tags) total += tag->used;
  const int stride = std::max(1, (total + count - 1) / count);
  int next = 0;
  for (const auto* tag : tags) {
    if (tag->used < kFewestSamples || !(tag->gain > 1.5)) continue;  // not in them
    for (; next < tag->used; next += stride) each(*tag, next);
    next -= tag->used;
  }
}

}  // namespace

// The residuals' size as a share of the gain, by their median: what covers a part of the tags does
// not count. The median is that of a histogram whose classes are the leading bits of the floats
// (16 to an octave), interpolated within its class.
void TagAligner::Impl::measure_noise() {
  constexpr std::uint32_t kShift = 19;                  // leaves 4 bits of the mantissa
  constexpr std::uint32_t kFirst = (127U - 16U) << 4U;  // 2^-16 of the gain and less
  constexpr std::size_t kClasses = 20 * 16;             // up to 2^4
  constexpr float kLeast = 0x1p-16F;
  constexpr float kMost = 0x1.fp3F;  // the last class begins there
  std::array<std::uint16_t, kClasses> histogram{};
  int count = 0;
  visit_evenly(active, 384, [&](const Tag& tag, int k) {
    const auto inverse_gain = static_cast<float>(1.0 / tag.gain);
    const float share = std::min(std::abs(tag.samples.residual[k]) * inverse_gain, kMost);
    ++histogram[(std::bit_cast<std::uint32_t>(std::max(share, kLeast)) >> kShift) - kFirst];
    ++count;
  });
  if (count < 16) return;
  const double middle = 0.5 * count;
  // Octave by octave, then class by class.
  int below = 0;
  std::size_t at = 0;
  for (; at + 16 < kClasses; at += 16) {
    int octave = 0;
    for (std::size_t k = 0; k < 16; ++k) octave += histogram[at + k];
    if (2 * (below + octave) >= count) break;
    below += octave;
  }
  while (at + 1 < kClasses && 2 * (below + histogram[at]) < count) below += histogram[at++];
  const auto edge = [](std::size_t position) {
    return static_cast<double>(
        std::bit_cast<float>((static_cast<std::uint32_t>(position) + kFirst) << kShift));
  };
  const double within = (middle - below) / histogram[at];
  noise_share = 1.4826 * (edge(at) + within * (edge(at + 1) - edge(at)));
}

// The weights fall as the residuals grow, so that a step by them falls short. By what share, in the
// mean over the samples, is known where these are many: the sum of d(w r) / dr over that of w
// (Bickel, "One-Step Huber Estimates in the Linear Model", 1975: from where noise alone is left,
// one such step is as good as many).
void TagAligner::Impl::measure_slope(double cutoff) {
  PENUMBRA_ASSERT(cutoff > 0.0);
  constexpr double kLeast = 0.7;  // 0.83 where residuals are normal
  const double limit = tukey_share(cutoff);
  double slope = 0.0;
  double weight = 0.0;
  visit_evenly(active, 768, [&](const Tag& tag, int k) {
    const double base = static_cast<double>(tag.samples.weight[k]);
    const double t = static_cast<double>(tag.samples.residual[k]) / (limit * tag.gain);
    const double inside = 1.0 - std::min(t * t, 1.0);
    weight += base * inside * inside;
    slope += base * inside * (5.0 * inside - 4.0);
  });
  step_slope = weight > 0.0 ? std::clamp(slope / weight, kLeast, 1.0) : 1.0;
}

// How many times larger the variance of the mean displacement of an edge is than independent
// residuals would make it (the "design effect" of samples that come in clusters): the residuals of
// each run of samples along one edge, projected on what a displacement of that edge would do to
// them, squared, over what the residuals' own variance lets expect. What compression, denoising and
// wrong models of blur do to whole edges shows here. A tone curve or a bright lamp widens all white
// areas: a displacement of every edge towards black, by more where the edge is blurred by motion,
// with which opposite edges of a cell leave the pose where it is; it is taken out first, for each
// of the tag's two directions.
double TagAligner::Impl::design_effect(double cutoff) {
  struct Direction {  // edges along b, and along a
    Two sums{};       // of s and q
    Two squares{};    // of ss and qq
    double products = 0.0;
  };
  std::array<Direction, 2> directions;
  double expected = 0.0;
  double expected_squares = 0.0;  // of the runs
  int runs = 0;
  int parameters = 8;  // the pose and the widenings
  const auto inverse_limit = static_cast<float>(1.0 / tukey_share(cutoff));
  for (const Tag* tag : active) {
    if (tag->used < kFewestSamples || !(tag->gain > 1.5)) continue;
    parameters += 2;
    kernel::Samples s = tag->samples;
    s.levers = arena.lend(3 * static_cast<std::size_t>(s.count));
    kernel::LeverInput in;
    in.inverse_gain = static_cast<float>(1.0 / tag->gain);
    in.offset = static_cast<float>(tag->offset);
    in.inverse_limit = inverse_limit;
    kernel->levers(in, s);
    const auto* const pairs = reinterpret_cast<const Pair*>(s.levers);
    const float* const squares = s.levers + 2 * static_cast<std::ptrdiff_t>(s.count);
    double tag_expected = 0.0;
    double tag_squares = 0.0;
    int begin = 0;
    const std::int32_t* const step_run = tag->step_run.data();
    const int steps = tag->step_count;
    for (int k = 0; k < steps;) {
      const std::int32_t run = step_run[k];
      while (k < steps && step_run[k] == run) ++k;
      const int end = tag->step_end[static_cast<std::size_t>(k - 1)];
      const bool vertical = tag->runs[static_cast<std::size_t>(run)].vertical;
      Pair sums{};
      float square_sum = 0.0F;
#pragma GCC unroll 2
      for (int i = begin; i < end; ++i) {
        sums += pairs[i];
        square_sum += squares[i];
      }
      begin = end;
      if (!(square_sum > 0.0F)) continue;
      const Two both = __builtin_convertvector(sums, Two);
      Direction& direction = directions[vertical ? 0 : 1];
      direction.sums += both;
      direction.squares += both * both;
      direction.products += both[0] * both[1];
      const auto run_expected = static_cast<double>(square_sum);
      tag_expected += run_expected;
      tag_squares += run_expected * run_expected;
      ++runs;
    }
    const double scale = variance / (tag->gain * tag->gain);
    expected += tag_expected * scale;
    expected_squares += tag_squares * scale * scale;
  }
  const int free = runs - parameters;
  if (free < 4 || !(expected > 0.0)) return 1.0;
  double found = 0.0;
  for (const Direction& d : directions) {
    if (!(d.sums[1] > 0.0)) continue;
    const double widening = d.sums[0] / d.sums[1];
    found += d.squares[0] - 2.0 * widening * d.products + widening * widening * d.squares[1];
  }
  // The residuals are those before the last step, and hold the displacements that it took away: of
  // a run in proportion to its expected square, all together as many variances as the step's own.
  // A step by slope, in the part that the weights left of them.
  found -= step_slope * step_slope * last_step.dot(information * last_step) * expected_squares /
           expected;
  return std::max(found, 0.0) / expected * runs / free;
}

// Where tags do not lie to each other as the map says, how far off that may have put the pose. One
// of two or three takes the pose along until all fit to some tenths of a pixel, and it is off by
// many: each by itself says where the camera is, x_k off the pose that was solved, and how well it
// knows that, W_k. What of these differences is more than that leaves is places in the map that are
// wrong by tau in each direction (the estimate of a random effect by its moments: DerSimonian and
// Laird, Meta-analysis in clinical trials, 1986, for several dimensions), and the pose has what the
// equations make of that.
void TagAligner::Impl::check_map() {
  // What lens, tone curve and paper do to each real tag, edge by edge and as a whole: chosen so
  // that those of a real sheet (visp-rbt-sequence) differ by as much as chance has them differ.
  constexpr double kShift_px = 0.05;
  constexpr double kEdge_px = 0.05;
  constexpr double kTilt_rad = 0.005;
  double tags_count = 0.0;
  Matrix6d H = Matrix6d::Zero();
  Matrix6d H_of_places = Matrix6d::Zero();
  Matrix6d W = Matrix6d::Zero();
  Matrix6d W_of_places = Matrix6d::Zero();
  Vector6d asked = Vector6d::Zero();
  double squares = 0.0;
  double trace = 0.0;
  for (const TagEquations& of : agreement) {
    const Tag& tag = tags[static_cast<std::size_t>(of.index)];
    const double half = 0.5 * (tag.side - 1);
    const Eigen::Vector3d centre = tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    const double half_px =
        half *
        std::sqrt(std::abs(tag.along_a.x() * tag.along_b.y() - tag.along_a.y() * tag.along_b.x()));
    const Eigen::LDLT<Matrix6d> solver(of.H);
    // The little that is seen of a tag at the picture's border fixes no pose.
    constexpr double kLeastCondition = 1e-13;
    if (!solver.isPositive() || !(solver.rcond() > kLeastCondition)) continue;
    const Matrix6d own = solver.solve(Matrix6d::Identity());
    const Vector6d x = own * of.g;
    // About its centre.
    Eigen::Matrix<double, 6, 6> paper = Matrix6d::Zero();
    paper.block<3, 1>(0, 0) = kShift_px * of.motions.block<3, 1>(0, 0);
    paper.block<3, 1>(0, 1) = kShift_px * of.motions.block<3, 1>(0, 1);
    paper.block<3, 1>(0, 2) = kEdge_px / half_px * centre;
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d turn = kTilt_rad * Eigen::Vector3d::Unit(axis);
      paper.block<3, 1>(0, 3 + axis) = centre.cross(turn);
      paper.block<3, 1>(3, 3 + axis) = turn;
    }
    const Matrix6d weight =
        inverse_of_spd(variance * variance_inflation(result) * own + paper * paper.transpose());
    if (!weight.allFinite() || !x.allFinite()) continue;
    tags_count += 1.0;
    H += of.H;
    H_of_places += of.H.leftCols<3>() * of.H.topRows<3>();
    W += weight;
    W_of_places += weight.leftCols<3>() * weight.topRows<3>();
    asked += weight * x;
    squares += x.dot(weight * x);
    trace += weight.topLeftCorner<3, 3>().trace();
  }
  if (tags_count < 2.0) return;
  const Eigen::LDLT<Matrix6d> together(W);
  squares -= asked.dot(together.solve(asked));
  trace -= together.solve(W_of_places).trace();
  const double freedoms = 6.0 * (tags_count - 1.0);
  if (!(squares > freedoms) || !(trace > 0.0)) return;
  const Matrix6d inverse = inverse_of_spd(H);
  // One tag that is wrong is so in three directions: what is estimated from three is, with their
  // Student's t, of three times the variance.
  constexpr double kOfThree = 3.0;
  const Matrix6d off = kOfThree * (squares - freedoms) / trace * inverse * H_of_places * inverse;
  if (!off.allFinite()) return;
  result.map_covariance = off;
  // Chi-square's 99 % (Wilson and Hilferty, The distribution of chi-square, 1931).
  constexpr double kNormal99 = 2.326;
  const double ninth = 2.0 / (9.0 * freedoms);
  result.map_contradicted =
      squares > freedoms * std::pow(1.0 - ninth + kNormal99 * std::sqrt(ninth), 3.0);
}

// Whether the tags lie to each other as the map says. A tag that was moved has all of its pixels
// displaced together, by what the pose does not take away: each tag's own equations, at the solved
// pose, say by how much it would rather be shifted in the image, and turned in it. (Not how much
// nearer it would be: a tone curve does that to all of them.) Where that is far more than the
// residuals' own variance leaves, and a small part of it when one tag goes, it is that tag which
// lies elsewhere.
void TagAligner::Impl::check_agreement() {
  constexpr std::size_t kFewest = 3;
  constexpr std::size_t kFew = 4;  // more of them outvote one that is wrong, and cost more
  constexpr double kOfPose = 6.0;
  agreement.clear();
  for (std::size_t k = 0; k < active.size(); ++k) {
    const kernel::TagPack& pack = packs[k / 4];
    const std::size_t lane = k % 4;
    const Tag& tag = *active[k];
    if (!pack.valid[lane] || !(tag.sums.weight > kLeastWeightShare * tag.sums.base_weight))
      continue;
    const double half = 0.5 * (tag.side - 1);
    const Eigen::Vector3d centre = tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0);
    if (!(centre.z() > 0.0)) continue;
    TagEquations& own = agreement.emplace_back();
    own.index = static_cast<int>(&tag - tags.data());
    std::size_t h = 0;
    for (const auto& [row, column] : {std::pair(0, 0), std::pair(0, 3), std::pair(3, 3)}) {
      for (int p = 0; p < 3; ++p) {
        for (int q = row == column ? p : 0; q < 3; ++q, ++h)
          own.H(row + p, column + q) = own.H(column + q, row + p) = pack.H_camera[h][lane];
      }
    }
    for (int i = 0; i < 6; ++i) own.g[i] = pack.g_camera[i][lane];
    own.g -= step_slope * (own.H * last_step);
    // A pixel along each axis at its centre, and a radian about the ray to it.
    own.motions.setZero();
    own.motions(0, 0) = centre.z() / camera.parameters().fx;
    own.motions(1, 1) = centre.z() / camera.parameters().fy;
    own.motions.col(2).tail<3>() = centre.normalized();
    own.inverse = (own.motions.transpose() * own.H * own.motions).inverse();
    if (!own.inverse.allFinite()) agreement.pop_back();
  }
  const std::size_t count = agreement.size();
  if (count > 1 && count <= kFew) check_map();
  if (count < kFewest) return;
  // Sum of squares by which these tags disagree, as far as the residuals' variance counts them.
  const auto own_shift = [](const TagEquations& of, const Vector6d& g) -> Eigen::Vector3d {
    return of.inverse * (of.motions.transpose() * g);
  };
  double squares = 0.0;
  double shifts_px2 = 0.0;
  for (TagEquations& of : agreement) {
    const Eigen::Vector3d asked = of.motions.transpose() * of.g;
    const Eigen::Vector3d shift = of.inverse * asked;
    of.squares = asked.dot(shift);
    squares += of.squares;
    shifts_px2 += shift.head<2>().squaredNorm();
  }
  const auto per_freedom = [](double sum, std::size_t tags_left) {
    return sum / std::max(3.0 * static_cast<double>(tags_left) - kOfPose, 1.0);
  };
  result.displaced_px = std::sqrt(shifts_px2 / static_cast<double>(count));
  result.disagreement = per_freedom(squares, count) / variance;

  // Less than this is what lens, tone curve and paper do to real tags.
  constexpr double kLeast_px = 0.1;
  // What is left without it, per degree of freedom: noise alone falls to a ninth when one of four
  // tags goes, now and then.
  const double small_part = count > 4 ? 1.0 / 9.0 : 1.0 / 16.0;
  if (count <= kFewest || result.displaced_px < kLeast_px || result.disagreement < kDisagree)
    return;
  constexpr std::size_t kMostToTry = 12;  // those that disagree most
  std::vector<std::size_t> order(count);
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::greater<>(),
                           [this](std::size_t k) { return agreement[k].squares; });
  order.resize(std::min(count, kMostToTry));
  Matrix6d H_all = Matrix6d::Zero();
  Vector6d g_all = Vector6d::Zero();
  for (const TagEquations& of : agreement) {
    H_all += of.H;
    g_all += of.g;
  }
  double least = small_part * per_freedom(squares, count);
  for (const std::size_t without : order) {
    const TagEquations& gone = agreement[without];
    const Vector6d motion = solve_spd(H_all - gone.H, g_all - gone.g);
    if (!motion.allFinite()) continue;
    double left = 0.0;
    for (std::size_t k = 0; k < count; ++k) {
      if (k == without) continue;
      const TagEquations& of = agreement[k];
      const Vector6d g = of.g - of.H * motion;
      left += (of.motions.transpose() * g).dot(own_shift(of, g));
    }
    if (!(per_freedom(left, count - 1) < least)) continue;
    least = per_freedom(left, count - 1);
    result.contradicting = gone.index;
  }
}

// Whether the model is within a twentieth of each cell's own colour at the pixel nearest to its
// centre. That pixel is at most sqrt(1/2) px off, which is so many sigmas of the lens's blur or
// fewer in either direction of the lattice, and half a cell is 0.5 / ka; the model is then as far
// from the colour as the two nearest lines leave of it, each less than a fortieth beyond 1.96
// sigmas. The scale of a tag in the image is least at one of its corners; what a lens bends it by
// beyond that, and what the middle of four corners is off the centre, is left room for.
bool TagAligner::Impl::reads_clearly(const Tag& tag) const {
  constexpr double kSigmas = 2.2;
  if (tag.reach != 1 || tag.moments > 1 || !tag.wholly_seen) return false;
  const auto last = static_cast<std::size_t>(tag.side - 1);
  const auto top = last * static_cast<std::size_t>(tag.side);
  float least = std::numeric_limits<float>::infinity();
  for (const std::size_t v : {std::size_t{0}, last, top, top + last})
    least = std::min({least, tag.ka[v], tag.kb[v]});
  return 0.5 * static_cast<double>(least) >= kSigmas + std::sqrt(0.5) / options.blur_px;
}

// The picture and the model at cells' centres.
void TagAligner::Impl::read_cells(Tag& tag) {
  const std::vector<DataCell>& cells = tag.pattern.data_cells();
  take_samples(tag, static_cast<int>(cells.size()));
  kernel::Samples& s = tag.samples;
  tag.used = 0;
  tag.step_count = 0;
  for (const DataCell& cell : cells) {
    int px = 0;
    int py = 0;
    if (!nearest_cell_pixel(tag, cell, px, py)) continue;
    const auto v = static_cast<std::size_t>(cell.j * tag.side + cell.i);
    s.pixel_x[tag.used] = static_cast<float>(px);
    s.pixel_y[tag.used] = static_cast<float>(py);
    s.ray_x[tag.used] = tag.ray_x[v];
    s.ray_y[tag.used] = tag.ray_y[v];
    ++tag.used;
  }
  locate_samples(tag);
  finish_samples(tag);
  evaluate(tag);
}

// The picture's noise at cells' centres, taken out of what read_cells read: the mean of all pixels
// within a sixth of a cell.
void TagAligner::Impl::average_cells(Tag& tag) const {
  const kernel::Samples& s = tag.samples;
  const int about = std::min(static_cast<int>(tag.cell_px / 6.0), 3);
  // With a rolling shutter samples are no longer where their pixels are.
  if (about == 0 || !tag.row_shear.isZero(0.0)) return;
  for (int k = 0; k < tag.used; ++k) {
    const int x = static_cast<int>(s.pixel_x[k]);
    const int y = static_cast<int>(s.pixel_y[k]);
    float sum = 0.0F;
    int count = 0;
    for (int v = std::max(y - about, 0); v <= std::min(y + about, image.height - 1); ++v) {
      for (int u = std::max(x - about, 0); u <= std::min(x + about, image.width - 1); ++u) {
        sum += tone[image.data[v * image.stride + u]];
        ++count;
      }
    }
    s.value[k] = sum / static_cast<float>(count);
  }
}

// Cells are black or white by chance: their pattern is like itself, displaced by d along one of its
// axes, by 1 - d / c, c a cell, and no more than by chance from a cell on. What a smear of length L
// shows of it is the mean of that over L:
//   - from one end to the other but for a cell at each it is the same wherever the pattern is put:
//     a pose that shows it there is one of many, spread evenly over L - 2 c;
//   - displaced further it loses what it is like in about c + L / 2. So if the picture is like the
//     model by r, the model may be displaced by (1 - r) (c + L / 2).
// L is not known, but for the motion, which it does not exceed. For the first that share of it is
// taken which explains the picture best, for the second, which asks what is not explained by any,
// the whole. Both want a smear that is long against a cell: one of 1.5 c mixes two thirds of a cell
// with a sixth of each neighbour, and its cells by themselves explain 16 / 18 of what is seen. What
// covers a part of a tag explains nothing either, and is left out.
// Where the motion is not known the picture says the second only, of a smear as long as can be
// read; and so it does where the motion may be another one than it was taken for, and doesn't
// explain the picture: two displaced poses make a motion that neither had.
// No tag holds the others: a pose that turns, and so moves some of them by s and others by -s, is
// hidden as well as one that moves all by s. Of shift and turn whose sum no tag may exceed, evenly
// spread, each has half the variance that it had alone. What turns the pose is taken from tags that
// are off each by itself, by all of the first; of the second by half as far, where a motion is
// there to explain the rest: a tag that is not like the model need not be displaced. Tags that are
// off by themselves turn the pose by less the more they are, what hides a turn is the same for all
// of them: more than twelve count as twelve. (Of random shakes with smears of up to six cells, 7,
// 12 or 48 tags in view, 1 of 4913 tracked frames is off by more than 5 px; with a shift alone it
// was 1 in 100, with every motion taken for the one that was 7 of 5003.)
MotionBlurError TagAligner::Impl::motion_blur_error(const std::optional<Vector6d>& motion,
                                                    bool known, double longest_cells) {
  constexpr int kShares = 8;
  constexpr double kClear = 8.0 / 9.0;
  constexpr double kShared = 0.5;
  constexpr double kOwnAway = 0.25;
  constexpr double kMostOwn = 12.0;  // tags
  std::vector<double> shares;        // explained, of each tag
  const auto median = [&shares] {
    const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
    std::ranges::nth_element(shares, middle);
    return *middle;
  };
  // Those that did not verify, too: most of them may be smeared too far.
  std::vector<Tag*> seen;
  for (const TagAlignment& of : result.tags) {
    if (of.explained < 0.0) continue;
    seen.push_back(&tags[static_cast<std::size_t>(of.index)]);
    shares.push_back(of.explained);
  }
  if (seen.empty() || (motion && !motion->allFinite())) return {};
  // Not by the mean: something may cover some of them.
  if (exposure_motion.isZero(0.0) && median() >= kClear) return {};

  const Vector6d motion_before = exposure_motion;
  const auto smear_by = [this](const Vector6d& smear) {
    exposure_motion = smear;
    for (auto& path : paths) path.clear();
  };
  // Of each tag: the smear along it, and a cell in that direction.
  struct Smear {
    int index = 0;
    double length_px = 0.0;
    double cell_px = 0.0;
    Eigen::Vector2d direction = Eigen::Vector2d::Zero();  // where it is known
  };
  std::vector<Smear> smears;
  std::vector<Smear> others;  // in whatever direction
  if (motion) smear_by(*motion);
  for (Tag* tag : seen) {
    if (!measure(*tag, MotionBlur::moments)) continue;
    const int index = static_cast<int>(tag - tags.data());
    const double length_px = motion ? tag->motion_px.norm() : 0.0;
    if (longest_cells > 0.0) {
      const double cell_px =
          std::sqrt(0.5 * (tag->along_a.squaredNorm() + tag->along_b.squaredNorm()));
      others.push_back(
          {index, std::max(longest_cells * cell_px, length_px), cell_px, Eigen::Vector2d::Zero()});
    }
    if (!motion) continue;
    Eigen::Matrix2d cell_px;
    cell_px << tag->along_a, tag->along_b;
    const double cells = (cell_px.inverse() * tag->motion_px).cwiseAbs().maxCoeff();
    if (cells > 1.0)
      smears.push_back({index, length_px, length_px / cells, tag->motion_px / length_px});
  }
  double best = 0.0;
  int share = 0;  // [1 / kShares]
  const auto explain_by = [&](int part) {
    smear_by(motion ? Vector6d(static_cast<double>(part) / kShares * *motion) : Vector6d::Zero());
    shares.clear();
    for (Tag* tag : seen) {
      if (!measure(*tag, MotionBlur::moments)) continue;
      if (tag->moments > 1) place_moments(*tag);
      project_lattice(*tag, 0.0);
      arena.give_back();
      read_cells(*tag);
      average_cells(*tag);
      const double here = explained_by_most(tag->samples.model, tag->samples.value, tag->used);
      if (here >= 0.0) shares.push_back(here);
    }
    const double here = shares.empty() ? 0.0 : median();
    if (here <= best) return;
    best = here;
    share = part;
  };
  if (!smears.empty() || !others.empty()) explain_by(0);
  if (best >= kClear) {  // whatever moved, this picture is sharp
    smears.clear();
    others.clear();
  }
  if (!smears.empty() && known) {
    explain_by(kShares);
  } else if (!smears.empty() && motion) {
    for (int part = 2; part <= kShares; part += 2) explain_by(part);
    const int about = share;
    if (about > 0) explain_by(about - 1);
    if (about < kShares) explain_by(about + 1);
  }
  smear_by(motion_before);
  for (Tag* tag : seen) static_cast<void>(measure(*tag));
  double squares = 0.0;
  Matrix6d H = variance * Matrix6d::Identity();  // a metre and a radian, where the tags say nothing
  for (const TagEquations& of : agreement) H += of.H;
  const Matrix6d inverse = inverse_of_spd(H);
  const auto count = static_cast<double>(agreement.size());
  const bool turns = agreement.size() > 1;
  const bool along = others.empty();  // the motion, if any, and nowhere else
  const bool is_moved = motion && !smears.empty();
  smears.insert(smears.end(), others.begin(), others.end());
  MotionBlurError error;
  for (const Smear& smear : smears) {
    const bool anywhere = smear.direction.isZero(0.0);
    const double smeared_px = anywhere ? 0.0
                              : known  ? smear.length_px
                                       : smear.length_px * share / kShares;
    const double flat_px = std::max(smeared_px - 2.0 * smear.cell_px, 0.0);
    const double away_px =
        anywhere || along ? (1.0 - std::sqrt(best)) * (smear.cell_px + 0.5 * smear.length_px) : 0.0;
    const double flat2 = flat_px * flat_px / 12.0;
    const double away2 = away_px * away_px;
    squares += (turns ? kShared : 1.0) * (flat2 + away2);
    const auto of = std::ranges::find(agreement, smear.index, &TagEquations::index);
    if (!turns || of == agreement.end()) continue;
    const double own2 =
        std::max(count / kMostOwn, 1.0) * (flat2 + (anywhere ? 1.0 : kOwnAway) * away2);
    // A pixel along each axis, as a motion of the tag's centre.
    const Tag& tag = tags[static_cast<std::size_t>(smear.index)];
    const double half = 0.5 * (tag.side - 1);
    Eigen::Matrix<double, 2, 3> J;
    std::ignore =
        camera.project_unchecked(tag.ray_from_lattice * Eigen::Vector3d(half, half, 1.0), &J);
    Eigen::Matrix<double, 6, 2> motions = Eigen::Matrix<double, 6, 2>::Zero();
    motions.topRows<2>() = J.leftCols<2>().inverse();
    const Eigen::Matrix<double, 6, 2> moved = inverse * of->H * motions;
    if (!anywhere) {
      const Vector6d shift = moved * smear.direction;
      error.covariance += own2 * shift * shift.transpose();
    } else {
      error.covariance += 0.5 * own2 * moved * moved.transpose();
    }
  }
  // Then nothing is known: a metre and a radian.
  if (!error.covariance.allFinite()) error.covariance.setIdentity();
  if (is_moved) error.motion = static_cast<double>(share) / kShares * *motion;
  error.shift_px = std::sqrt(squares / static_cast<double>(seen.size()));
  return error;
}

// Reads the data cells at the solved pose against the model's own blurred values.
void TagAligner::Impl::verify() {
  result.tags.clear();
  result.tags_verified = 0;
  int in_picture = 0;
  // Cells are read at whole pixels; what moved by less than this is where it was projected.
  constexpr double kSamePixels_px = 0.1;
  const bool projected = moved_since_projection_px < kSamePixels_px;
  for (Tag* tag : active) {
    if (!projected) project_lattice(*tag, 0.0);
    TagAlignment check;
    check.cell_px = tag->cell_px;
    check.index = static_cast<int>(tag - tags.data());
    check.gain = tag->gain;
    check.offset = tag->offset;
    check.weight_share =
        tag->sums.base_weight > 0.0 ? tag->sums.weight / tag->sums.base_weight : 0.0;
    const std::vector<DataCell>& cells = tag->pattern.data_cells();
    const double middle = tag->offset + 0.5 * tag->gain;
    const double covered = 0.25 * tag->gain;
    int decidable = 0;
    Explained explained;
    if (reads_clearly(*tag)) {
      find_cells(*tag);
      for (const DataCell& cell : cells) {
        const std::int32_t place =
            cell_places[static_cast<std::size_t>(cell.j * tag->side + cell.i)];
        if (place == kernel::kNowhere) continue;
        const double read = static_cast<double>(tone[image.data[place]]) - middle;
        explained.add(cell.white ? 1.0 : 0.0, read);
        ++decidable;
        // What reads as neither black nor white is covered by something.
        const bool decided = std::abs(read) >= covered;
        check.cells_read += decided ? 1 : 0;
        check.cells_wrong += decided && (cell.white ? read < 0.0 : read > 0.0) ? 1 : 0;
      }
    } else {
      // The model at the cells' centres.
      arena.give_back();
      read_cells(*tag);
      const kernel::Samples& s = tag->samples;
      for (int i = 0; i < tag->used; ++i) {
        const double expected = static_cast<double>(s.model[i]) - 0.5;
        const double read = static_cast<double>(s.value[i]) - middle;
        explained.add(expected, read);
        if (std::abs(expected) < 0.15) continue;  // too blurred to be one or the other
        ++decidable;
        if (std::abs(read) < covered && std::abs(expected) > 0.45) continue;
        ++check.cells_read;
        check.cells_wrong += expected * read < 0.0 ? 1 : 0;
      }
    }
    check.explained = explained.share();
    const int least = std::max(8, static_cast<int>(cells.size()) / 4);
    const int right = check.cells_read - check.cells_wrong;
    check.verified = check.cells_read >= least && 4 * check.cells_wrong <= check.cells_read &&
                     20 * right >= 9 * decidable && check.gain > 12.0 &&
                     check.weight_share > kLeastWeightShare;
    // Nearly all of a covered tag's cells are not read.
    check.displaced =
        check.weight_share <= kLeastWeightShare && decidable >= least && 5 * right >= 4 * decidable;
    in_picture += decidable >= least ? 1 : 0;
    result.tags_verified += check.verified ? 1 : 0;
    result.tags.push_back(check);
  }
  result.verified = result.tags_verified > 0 && 10 * result.tags_verified >= 4 * in_picture;
  result.counters.tags_in_picture = in_picture;
  if (!result.verified) result.reason = "the cells do not read as these tags";
}

}  // namespace penumbra
