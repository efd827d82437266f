#include "tracking/alignment/tag_alignment.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/assert.hpp"
#include "tracking/alignment/simd/alignment_kernel.hpp"
#include "tracking/alignment/tag_alignment_state.hpp"
#include "tracking/alignment/tag_pattern.hpp"
#include "tracking/math/spd6.hpp"

namespace penumbra {
namespace {

constexpr double kCornerMoved_px = 0.25;  // a fine stage that moved the tags by more is repeated
constexpr double kConverged_px = 0.03;    // the step after such a one is below a hundredth
constexpr double kNearlyConverged_px = 0.06;
// A step is a quarter to a third of the one before: what follows this one is kConverged_px. A lone
// tag's tilt goes slower than that.
constexpr double kConvergesFrom_px = 0.1;
// The same in standard deviations of the pose, all six numbers in one; 2.4 are what noise does.
constexpr double kConverged_sigmas = 1.0;
constexpr double kNearlyConverged_sigmas = 3.0;
// A step that reckons with the weights leaves a twentieth of itself, more where much is covered.
// What the residuals say of themselves is of before that step, which is to matter little there.
constexpr double kSlopeConverged_sigmas = 8.0;
constexpr int kFineRounds = 3;
constexpr int kFineSteps = 5;        // per round at most
constexpr int kSparseSamples = 640;  // of all tags
constexpr int kFewestBlocks = 1;     // of samples on a tag, where sampling may stop early
// Memory for samples: of every pixel at the edges of tags that fill the picture, or of so many of
// each tag, whichever is less. More is asked for when it is needed.
constexpr std::size_t kPixelsPerSample = 12;
constexpr std::size_t kSamplesPerTag = 4096;
constexpr std::size_t kFloatsPerSample = 17;  // where cells are large against the blur
constexpr double kWideCutoff = 0.8;           // of Tukey's weights, as a share of the gain
constexpr double kFineCutoff = 0.6;           // the same

// What to ask for so that so many of the kernel's blocks come out full: the walk along the edges
// meets its cap within some samples, and a last one over the brim costs a whole block.
constexpr int filled_blocks(int blocks) {
  return (kernel::kBlock - 4) * blocks;
}

}  // namespace

double variance_inflation(const AlignmentResult& result) {
  // Tukey's weights at 4.685 sigma: variance E[psi^2] / E[psi']^2 = 1.053 of that of least squares
  // for normal residuals, while sum(w r^2) / sum(w) and sum(w) say 0.758 / 0.915^2 of it.
  constexpr double kTukeyTimes = 1.16;
  return kTukeyTimes * std::max(result.design_effect, 1.0);
}

// Where a search begins; false where no tag is in view.
bool TagAligner::Impl::look_where_predicted() {
  T_camera_table = T_predicted;
  find_visible(Projection::search);
  return !active.empty();
}

bool TagAligner::Impl::attempt(bool with_search, bool independent, bool may_be_near) {
  // What an attempt before this one found says nothing of where this one goes.
  result.displaced_px = 0.0;
  result.disagreement = 1.0;
  result.map_covariance.setZero();
  result.map_contradicted = false;
  result.contradicting = -1;
  result.counters.far_start = false;
  result.counters.sampling_stopped = false;
  T_camera_table = T_predicted;
  bool near = false;
  if (with_search) {
    const bool any = look_where_predicted();
    result.counters.tags_visible = static_cast<int>(active.size());
    if (!any) {
      result.reason = "no tag in view";
      return false;
    }
    static_cast<void>(search(independent));  // where nothing is found, from where it was predicted
    near = may_be_near && found_near();
  }
  find_visible(near ? Projection::fine : Projection::wide);
  if (!with_search) result.counters.tags_visible = static_cast<int>(active.size());
  if (active.empty()) {
    result.reason = "no tag in view";
    return false;
  }
  read_levels();
  variance = 0.0;
  noise_share = 0.0;
  double moved = 0.0;
  result.counters.wide_stage = !near;
  if (!near) {
    const int wide_cap = filled_blocks(active.size() > 8 ? 1 : 2);
    arena.give_back();
    for (Tag* tag : active) select(*tag, true, wide_cap);
    if (!step(0.0, StepBy::weights, moved) || !step(kWideCutoff, StepBy::weights, moved)) {
      result.reason = "too few pixels on tags";
      return false;
    }
  }
  const int cap = options.effort == AlignmentEffort::accurate
                      ? 1'000'000
                      : filled_blocks(std::clamp(
                            options.samples / (kernel::kBlock * static_cast<int>(active.size())), 2,
                            std::max(2, options.samples_per_tag / kernel::kBlock)));
  noise_share = 0.0;
  const double settled = options.effort == AlignmentEffort::accurate ? 0.85 : 0.7;
  // One block of a tag is enough where there are tags enough.
  const int block_of_each = kernel::kBlock * static_cast<int>(active.size());
  const int sparse_cap = filled_blocks(
      std::clamp(kSparseSamples / block_of_each, block_of_each >= kSparseSamples ? 1 : 2, 4));
  // Of each tag; where sampling may stop early it begins low and grows.
  int now = cap;
  if (sample_need) {
    const int first = first_samples / static_cast<int>(active.size());
    now = std::min(cap, std::max(first, filled_blocks(kFewestBlocks)));
  }
  int samples_before = 0;
  const double near_px = options.effort == AlignmentEffort::fast && active.size() > 2
                             ? kConvergesFrom_px
                             : kNearlyConverged_px;
  // Of few pixels noise leaves more than that.
  const bool within_noise = options.effort == AlignmentEffort::accurate;
  // What is far off is brought near by a few samples first; many are best chosen where they end.
  const bool sparse_rounds = !sample_need;
  bool sparse =
      sparse_rounds && (starts_far || (near && options.effort == AlignmentEffort::accurate));
  for (int round = 0; round < kFineRounds;) {
    ++result.counters.fine_rounds;
    if (round > 0 || !near) find_visible(Projection::fine);
    result.counters.samples = 0;
    arena.give_back();
    for (Tag* tag : active) {
      select(*tag, false, sparse ? std::min(now, sparse_cap) : now);
      result.counters.samples += tag->used;
    }
    double round_moved = 0.0;
    const bool by_slope = within_noise && !sample_need && round > 0 && !sparse;
    const StepBy by = by_slope ? StepBy::slope : StepBy::weights;
    bool far = false;
    for (int i = 0; i < kFineSteps; ++i) {
      // The first step of all is by all samples, wherever they seem to lie.
      if (!step(near && round == 0 && i == 0 ? 0.0 : kFineCutoff, by, moved)) {
        result.reason = "too few pixels on tags";
        return false;
      }
      const double before = noise_share;
      measure_noise();
      round_moved += moved;
      far = round_moved >= kCornerMoved_px;
      // While outliers are still being left behind the pose may yet move, but not from where it
      // stands within what noise does.
      const bool at_rest = noise_share > settled * before || step_sigmas < kConverged_sigmas;
      const double nearly_sigmas = by_slope ? kSlopeConverged_sigmas : kNearlyConverged_sigmas;
      // From near, one step says all.
      if (sparse_rounds && round > 0 && moved < near_px && noise_share > 0.9 * before &&
          (!within_noise || step_sigmas < nearly_sigmas))
        break;
      if (i == 0) continue;
      // What is repeated from nearer need not be brought to its end.
      const bool repeated = sparse_rounds && (sparse || (far && round + 1 < kFineRounds));
      if (repeated && moved < kCornerMoved_px && at_rest) break;
      if (moved < kConverged_px && at_rest) break;
    }
    if (round == 0) result.counters.far_start = far;
    ++round;
    if (std::exchange(sparse, false) || (far && round < kFineRounds)) continue;
    result.design_effect = design_effect(kFineCutoff);
    if (!sample_need || now >= cap || result.counters.samples <= samples_before) break;
    report_pose();
    const double times = sample_need(result);
    if (times <= 1.0) break;
    // A little more than that, so that one more round is enough.
    samples_before = result.counters.samples;
    const double wanted = 1.1 * times * static_cast<double>(now);
    now = wanted < static_cast<double>(cap) ? std::max(static_cast<int>(wanted), 2 * now) : cap;
    now = std::min(now, cap);
    round = kFineRounds - 1;  // near the pose already
  }
  result.counters.sampling_stopped =
      sample_need != nullptr && now < cap &&
      std::ranges::any_of(active, [](const Tag* tag) { return tag->thinned; });
  check_agreement();
  verify();
  return result.verified;
}

void TagAligner::Impl::begin(const AlignmentInput& input) {
  PENUMBRA_ASSERT(input.luma.width == camera.width() && input.luma.height == camera.height() &&
                  !input.luma.empty());
  // Places of pixels in memory are 32 bits.
  PENUMBRA_ASSERT(std::abs(input.luma.stride) * input.luma.height < std::ptrdiff_t{1} << 31);
  PENUMBRA_ASSERT(input.predicted.is_finite() && input.covariance.allFinite());
  result.verified = false;
  result.tags.clear();
  result.tags_verified = 0;
  result.counters = {};
  result.reason = {};
  result.residual_rms = 0.0;
  result.design_effect = 1.0;
  for (Tag& tag : tags) tag.left_out = false;
  for (const int index : input.left_out) tags[static_cast<std::size_t>(index)].left_out = true;
  image = input.luma;
  T_predicted = Eigen::Isometry3d::Identity();
  const CameraPose& pose = input.predicted;
  T_predicted.linear() = pose.rotation().conjugate().toRotationMatrix();
  T_predicted.translation() = -(T_predicted.linear() * pose.translation());
  // A right perturbation of T_table_camera by xi is a left one of T_camera_table by -xi: the same
  // covariance.
  prior_covariance = input.covariance;
  prior_information = inverse_of_spd(prior_covariance);
  PENUMBRA_ASSERT(prior_information.allFinite());

  first_samples = input.first_samples;
  starts_far = input.starts_far;
  seen_contrast = input.seen_contrast;
  PENUMBRA_ASSERT(input.velocity.allFinite());
  row_velocity = camera.parameters().rolling_shutter_row_s.value_or(0.0) * input.velocity;
  PENUMBRA_ASSERT(input.exposure_motion.allFinite());
  exposure_motion = input.exposure_motion;
  if (!exposure_motion.isZero(0.0)) {
    for (auto& path : paths) path.clear();
  }
}

AlignmentResult TagAligner::Impl::run(const AlignmentInput& input, bool with_search) {
  begin(input);
  bool good = attempt(with_search, false, true);
  // From where it seemed near, all the way.
  if (!good && !result.counters.wide_stage) good = attempt(with_search, false, false);
  if (!good && with_search && !active.empty()) {
    result.counters.second_try = true;
    good = attempt(true, true, false);
  }
  report_pose();
  return result;
}

CameraPose TagAligner::Impl::pose() const {
  const Eigen::Isometry3d T_table_camera = T_camera_table.inverse();
  return {Eigen::Matrix3d(T_table_camera.linear()), T_table_camera.translation()};
}

// What is known by now, into the result.
void TagAligner::Impl::report_pose() {
  result.T_table_camera = pose();
  const Matrix6d total = information + prior_information;
  result.covariance = inverse_of_spd(total);
  double gain = 0.0;
  for (const Tag* tag : active) gain += tag->gain;
  if (!active.empty() && gain > 0.0)
    result.residual_rms = std::sqrt(variance) / (gain / static_cast<double>(active.size()));
}

TagAligner::TagAligner(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TagAligner::TagAligner(TagAligner&&) noexcept = default;
TagAligner& TagAligner::operator=(TagAligner&&) noexcept = default;
TagAligner::~TagAligner() = default;

Result<TagAligner> TagAligner::create(const CameraModel& camera, std::span<const MappedTag> tags,
                                      const AlignmentOptions& options) {
  auto impl = std::make_unique<Impl>();
  impl->camera = camera;
  impl->options = options;
  impl->kernel = &kernel::best_variant();
  if (options.instruction_set != nullptr) {
    for (const kernel::Variant* const* v = kernel::available_variants(); *v != nullptr; ++v) {
      if (std::strcmp((*v)->name, options.instruction_set) == 0) impl->kernel = *v;
    }
  }
  const CameraParameters& p = camera.parameters();
  impl->lens = kernel::lens_of(camera);
  const std::size_t pixels =
      static_cast<std::size_t>(camera.width()) * static_cast<std::size_t>(camera.height());
  impl->arena = Impl::SampleArena(
      kFloatsPerSample * std::min(tags.size() * kSamplesPerTag, pixels / kPixelsPerSample));
  impl->set_tone(p.tone_curve ? *p.tone_curve : options.tone_exponent);
  for (const MappedTag& mapped : tags) {
    Result<TagPattern> pattern = TagPattern::make(mapped.family, mapped.id);
    if (!pattern) return tl::unexpected<Error>(pattern.error());
    Impl::Tag tag;
    tag.pattern = std::move(*pattern);
    tag.T_table_tag.linear() = mapped.T_table_tag.rotation_matrix();
    tag.T_table_tag.translation() = mapped.T_table_tag.translation();
    tag.cell_m = mapped.size_m / tag.pattern.width_at_border();
    tag.side = tag.pattern.total_width() + 1;
    for (int j = 0; j < tag.side; ++j) {
      for (int i = 0; i < tag.side; ++i) {
        tag.lattice_a.push_back(static_cast<float>(i));
        tag.lattice_b.push_back(static_cast<float>(j));
        const auto colour = [&](int di, int dj) {
          return tag.pattern.white(i + di, j + dj) ? 1.0F : 0.0F;
        };
        const float c0 = colour(-1, -1);
        const float c1 = colour(0, -1) - c0;
        const float c2 = colour(-1, 0) - c0;
        tag.coefficients1.push_back({c0, c1, c2, colour(0, 0) - c0 - c1 - c2});
        for (const int lines : {2, 3}) {
          const int first = lines == 3 ? -1 : 0;  // of the lines; cells count from first - 1
          std::array<float, 16> c{};
          for (int row = 0; row < lines; ++row) {
            const int dj = first + row;
            for (int column = 0; column < lines; ++column) {
              const int di = first + column;
              c[static_cast<std::size_t>(4 * row + column)] =
                  colour(di, dj) - colour(di - 1, dj) - colour(di, dj - 1) + colour(di - 1, dj - 1);
            }
            c[static_cast<std::size_t>(4 * row + 3)] =
                colour(first - 1, dj) - colour(first - 1, dj - 1);
          }
          for (int column = 0; column < lines; ++column)
            c[static_cast<std::size_t>(12 + column)] =
                colour(first + column, first - 1) - colour(first + column - 1, first - 1);
          c[15] = colour(first - 1, first - 1);
          (lines == 2 ? tag.coefficients2 : tag.coefficients3).push_back(c);
        }
      }
    }
    // Filled up for the kernel with repetitions of the last vertex.
    while (tag.lattice_a.size() % 16 != 0) {
      tag.lattice_a.push_back(tag.lattice_a.back());
      tag.lattice_b.push_back(tag.lattice_b.back());
    }
    const std::size_t vertices = tag.lattice_a.size();
    for (auto* array : {&tag.ray_x, &tag.ray_y, &tag.pixel_x, &tag.pixel_y, &tag.depth, &tag.ka,
                        &tag.kb, &tag.rho})
      array->resize(vertices);
    // As many white as black cells, spread over the tag.
    for (const EdgeRun& run : tag.pattern.runs()) {
      const auto vertex = [&](int along) {
        return static_cast<std::uint32_t>(run.vertical ? along * tag.side + run.position
                                                       : run.position * tag.side + along);
      };
      for (int cell = run.begin; cell < run.end; ++cell) {
        std::vector<kernel::Walk::Cell>& cells = tag.edge_cells[run.vertical ? 1 : 0];
        cells.push_back({static_cast<float>(cell - static_cast<int>(cells.size())),
                         static_cast<float>(run.position),
                         static_cast<std::int32_t>(tag.runs.size())});
      }
      tag.runs.push_back({vertex(run.begin), vertex(run.end), run.vertical});
    }
    for (std::vector<kernel::Walk::Cell>& cells : tag.edge_cells) {
      if (!cells.empty()) cells.push_back(kernel::Walk::Cell(cells.back()));
    }
    std::vector<DataCell> white;
    std::vector<DataCell> black;
    for (const DataCell& cell : tag.pattern.data_cells())
      (cell.white ? white : black).push_back(cell);
    const std::size_t pairs =
        std::min({white.size(), black.size(), static_cast<std::size_t>(Impl::kMaxSearchCells / 2)});
    tag.search_white = static_cast<int>(pairs);
    for (std::vector<DataCell>* cells : {&white, &black}) {
      for (std::size_t k = 0; k < pairs; ++k)
        tag.search_cells.push_back((*cells)[k * cells->size() / pairs]);
    }
    for (const DataCell& cell : tag.search_cells) {
      tag.search_a.push_back(static_cast<float>(cell.i) + 0.5F);
      tag.search_b.push_back(static_cast<float>(cell.j) + 0.5F);
    }
    const auto last = static_cast<float>(tag.side - 1);
    for (const auto& [a, b] : {std::pair(0.0F, 0.0F), std::pair(last, 0.0F), std::pair(0.0F, last),
                               std::pair(last, last)}) {
      tag.search_a.push_back(a);
      tag.search_b.push_back(b);
    }
    while (tag.search_a.size() % 16 != 0) {
      tag.search_a.push_back(last);
      tag.search_b.push_back(last);
    }
    for (auto* array : {&tag.search_x, &tag.search_y, &tag.search_depth})
      array->resize(tag.search_a.size());
    impl->tags.push_back(std::move(tag));
  }
  return TagAligner(std::move(impl));
}

const AlignmentOptions& TagAligner::options() const {
  return impl_->options;
}
void TagAligner::set_effort(AlignmentEffort effort) {
  impl_->options.effort = effort;
}
void TagAligner::set_tone_exponent(double exponent) {
  impl_->set_tone(exponent);
}
void TagAligner::set_blur(double blur_px) {
  impl_->options.blur_px = blur_px;
}
void TagAligner::set_sample_need(SampleNeed need) {
  impl_->sample_need = std::move(need);
}
AlignmentResult TagAligner::align(const AlignmentInput& input) {
  return impl_->run(input, true);
}
AlignmentResult TagAligner::refine(const AlignmentInput& input) {
  return impl_->run(input, false);
}
std::optional<SearchedPose> TagAligner::search(const AlignmentInput& input) {
  Impl& impl = *impl_;
  impl.begin(input);
  if (!impl.look_where_predicted() || !impl.search(false)) return std::nullopt;
  const SearchedPose found = {impl.pose(), impl.search_error_px};
  return found.T_table_camera.is_finite() ? std::optional(found) : std::nullopt;
}
std::optional<CameraPose> TagAligner::search_pyramid(const AlignmentInput& input, bool further) {
  Impl& impl = *impl_;
  impl.begin(input);
  if (!impl.look_where_predicted() || !impl.search_pyramid(further)) return std::nullopt;
  const CameraPose guess = impl.pose();
  return guess.is_finite() ? std::optional(guess) : std::nullopt;
}
MotionBlurError TagAligner::motion_blur_error(const Vector6d& motion, bool known,
                                              double longest_cells) {
  return impl_->motion_blur_error(motion, known, longest_cells);
}
MotionBlurError TagAligner::motion_blur_error(double longest_cells) {
  return impl_->motion_blur_error(std::nullopt, false, longest_cells);
}
std::vector<EdgePixel> TagAligner::edge_pixels() {
  return impl_->edge_pixels();
}

}  // namespace penumbra
