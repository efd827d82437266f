#include "tracking/evaluation/tag_halves.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/random.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMinTags = 4;
constexpr int kStarts = 32;          // random initial splits per result
constexpr double kSimilarity = 0.5;  // penalty of a split that repeats an earlier one
// Widths of the kernels as fractions of the sheet's size: local and global balance.
constexpr std::array kWidths = {0.15, 0.5};

// Kernel matrix of the tags. With signs s (+1 in one half, -1 in the other), s' K s is the squared
// maximum mean discrepancy of the halves, up to a factor.
Eigen::MatrixXd kernel_matrix(std::span<const WeightedTag> tags) {
  const auto n = static_cast<Eigen::Index>(tags.size());
  const auto at = [&](Eigen::Index i) -> const WeightedTag& {
    return tags[static_cast<std::size_t>(i)];
  };
  double size2 = 1e-12;
  Eigen::MatrixXd distance2(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) {
      distance2(i, j) = (at(i).position - at(j).position).squaredNorm();
      size2 = std::max(size2, distance2(i, j));
    }
  }
  Eigen::MatrixXd kernel = Eigen::MatrixXd::Zero(n, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j) {
      for (const double width : kWidths)
        kernel(i, j) += std::exp(-distance2(i, j) / (2.0 * width * width * size2));
      kernel(i, j) *= at(i).weight * at(j).weight;
    }
  }
  return kernel;
}

// Swaps tags between the halves as long as a swap reduces s' K s. Returns the minimum.
double descend(const Eigen::MatrixXd& kernel, Eigen::VectorXd& signs) {
  const Eigen::Index n = signs.size();
  for (;;) {
    const Eigen::VectorXd pull = kernel * signs;
    double best = -1e-12;
    std::pair<Eigen::Index, Eigen::Index> swap{-1, -1};
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = i + 1; j < n; ++j) {
        if (signs[i] == signs[j]) continue;
        // Change of s' K s if both signs are inverted.
        const double change = 4.0 * (kernel(i, i) + kernel(j, j) - 2.0 * kernel(i, j) -
                                     signs[i] * pull[i] - signs[j] * pull[j]);
        if (change < best) {
          best = change;
          swap = {i, j};
        }
      }
    }
    if (swap.first < 0) return signs.dot(pull);
    signs[swap.first] = -signs[swap.first];
    signs[swap.second] = -signs[swap.second];
  }
}

Eigen::VectorXd random_signs(std::size_t count, SplitMix64& random) {
  Eigen::VectorXd signs(static_cast<Eigen::Index>(count));
  for (Eigen::Index i = 0; i < signs.size(); ++i) signs[i] = 2 * i < signs.size() ? 1.0 : -1.0;
  for (std::size_t i = count; i > 1; --i)
    std::swap(signs[static_cast<Eigen::Index>(i - 1)],
              signs[static_cast<Eigen::Index>(random.below(i))]);
  return signs;
}

TagHalves halves_of(const Eigen::VectorXd& signs) {
  TagHalves halves;
  for (Eigen::Index i = 0; i < signs.size(); ++i)
    halves[signs[i] == signs[0] ? 0 : 1].push_back(static_cast<std::size_t>(i));
  return halves;
}

}  // namespace

std::vector<TagHalves> balanced_halves(std::span<const WeightedTag> tags, int count) {
  if (tags.size() < kMinTags) return {};
  Eigen::MatrixXd kernel = kernel_matrix(tags);
  const double similarity =
      kSimilarity * kernel.diagonal().mean() / static_cast<double>(tags.size());
  SplitMix64 random(1);
  std::vector<TagHalves> result;
  for (int split = 0; split < count; ++split) {
    Eigen::VectorXd best;
    double least = std::numeric_limits<double>::infinity();
    for (int start = 0; start < kStarts; ++start) {
      Eigen::VectorXd signs = random_signs(tags.size(), random);
      const double discrepancy = descend(kernel, signs);
      if (discrepancy >= least) continue;
      least = discrepancy;
      best = signs;
    }
    const TagHalves halves = halves_of(best);
    if (std::ranges::find(result, halves) != result.end()) break;
    result.push_back(halves);
    kernel += similarity * best * best.transpose();  // makes later splits differ from this one
  }
  return result;
}

}  // namespace penumbra
