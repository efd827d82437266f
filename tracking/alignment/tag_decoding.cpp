#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "tracking/alignment/edge_samples.hpp"

namespace penumbra {
namespace {

// Computes the fraction of the variance of a tag's cells that the model explains.
class Explained {
 public:
  void add(double model, double value) {
    count_ += 1.0;
    model_ += model;
    value_ += value;
    model2_ += model * model;
    value2_ += value * value;
    model_value_ += model * value;
  }
  // Returns 0 if the correlation is not positive; negative for too few cells.
  [[nodiscard]] double share() const {
    constexpr double kMinCells = 16.0;
    if (count_ < kMinCells) return -1.0;
    const double cross = count_ * model_value_ - model_ * value_;
    const double variances =
        (count_ * model2_ - model_ * model_) * (count_ * value2_ - value_ * value_);
    return cross > 0.0 && variances > 0.0 ? std::min(cross * cross / variances, 1.0) : 0.0;
  }

 private:
  double count_ = 0.0, model_ = 0.0, value_ = 0.0;
  double model2_ = 0.0, value2_ = 0.0, model_value_ = 0.0;
};

struct Cells {
  int decidable = 0;        // inside the image, and clearly black or white in the model
  int read = 0;             // decidable cells that are neither occluded nor too blurred
  int wrong = 0;            // read cells with the wrong colour
  double explained = -1.0;  // as TagAlignment::explained
};

// Returns true if the model is within 1/20 of each cell's printed colour at the pixel nearest to
// the cell's centre, up to sqrt(1/2) px away. Uses the smallest cell at the tag's corners.
// Beyond 1.96 sigmas, each of the two nearest lines changes the model by less than 1/40; kSigmas
// adds a margin for distortion.
bool reads_clearly(const AlignedTag& tag, double blur_px) {
  constexpr double kSigmas = 2.2;
  if (tag.reach != 1 || !tag.fully_projected) return false;
  const auto last = static_cast<std::size_t>(tag.side - 1);
  const auto top = last * static_cast<std::size_t>(tag.side);
  float min_k = std::numeric_limits<float>::infinity();
  for (const std::size_t v : {std::size_t{0}, last, top, top + last})
    min_k = std::min({min_k, tag.ka[v], tag.kb[v]});
  return 0.5 * static_cast<double>(min_k) >= kSigmas + std::sqrt(0.5) / blur_px;
}

// Compares the cells with their printed colours.
Cells read_by_colour(AlignmentProblem& problem, const AlignedTag& tag) {
  const double middle = tag.offset + 0.5 * tag.gain;
  const double covered = 0.25 * tag.gain;
  Cells cells;
  Explained explained;
  const std::int32_t* const places = problem.find_cell_pixels(tag);
  for (const DataCell& cell : tag.pattern.data_cells()) {
    const std::int32_t place = places[cell.j * tag.side + cell.i];
    if (place == simd::kNowhere) continue;
    const double read = static_cast<double>(problem.tone[problem.image.data[place]]) - middle;
    explained.add(cell.white ? 1.0 : 0.0, read);
    ++cells.decidable;
    // A cell between black and white is occluded.
    const bool decided = std::abs(read) >= covered;
    cells.read += decided ? 1 : 0;
    cells.wrong += decided && (cell.white ? read < 0.0 : read > 0.0) ? 1 : 0;
  }
  cells.explained = explained.share();
  return cells;
}

// Compares the cells with the blurred model at their centres.
Cells read_by_model(EdgeSampler& sampler, AlignedTag& tag) {
  const double middle = tag.offset + 0.5 * tag.gain;
  const double covered = 0.25 * tag.gain;
  Cells cells;
  Explained explained;
  sampler.free_samples();
  sampler.read_cells(tag);
  const simd::Samples& s = tag.samples;
  for (int i = 0; i < tag.used; ++i) {
    const double expected = static_cast<double>(s.model[i]) - 0.5;
    const double read = static_cast<double>(s.value[i]) - middle;
    explained.add(expected, read);
    if (std::abs(expected) < 0.15) continue;  // too blurred to decide
    ++cells.decidable;
    if (std::abs(read) < covered && std::abs(expected) > 0.45) continue;
    ++cells.read;
    cells.wrong += expected * read < 0.0 ? 1 : 0;
  }
  cells.explained = explained.share();
  return cells;
}

}  // namespace

void decode_tags(AlignmentProblem& problem, EdgeSampler& sampler, AlignmentResult& result) {
  result.tags.clear();
  result.tags_verified = 0;
  int in_image = 0;
  // Cells are read at integer pixels, so smaller motions need no new projection.
  constexpr double kSamePixels_px = 0.1;
  const bool projected = problem.moved_since_projection_px < kSamePixels_px;
  for (AlignedTag* tag : problem.active) {
    if (!projected) problem.project_lattice(*tag, 0.0);
    const Cells cells = reads_clearly(*tag, problem.options.blur_px) ? read_by_colour(problem, *tag)
                                                                     : read_by_model(sampler, *tag);
    TagAlignment check;
    check.index = problem.index_of(*tag);
    check.cell_px = tag->cell_px;
    check.gain = tag->gain;
    check.weight_share =
        tag->sums.base_weight > 0.0 ? tag->sums.weight / tag->sums.base_weight : 0.0;
    check.explained = cells.explained;
    const int min_cells = std::max(8, static_cast<int>(tag->pattern.data_cells().size()) / 4);
    const int right = cells.read - cells.wrong;
    check.verified = cells.read >= min_cells && 4 * cells.wrong <= cells.read &&
                     20 * right >= 9 * cells.decidable && check.gain > 12.0 &&
                     check.weight_share > kMinWeightFraction;
    // Most cells of an occluded tag are undecided.
    check.inconsistent = check.weight_share <= kMinWeightFraction && cells.decidable >= min_cells &&
                         5 * right >= 4 * cells.decidable;
    in_image += cells.decidable >= min_cells ? 1 : 0;
    result.tags_verified += check.verified ? 1 : 0;
    result.tags.push_back(check);
  }
  result.verified = result.tags_verified > 0 && 10 * result.tags_verified >= 4 * in_image;
  problem.counters.tags_in_image = in_image;
  if (!result.verified) result.reason = "the cells do not read as these tags";
}

}  // namespace penumbra
