// What the parts of the alignment share: a tag with its samples, and the aligner's state between
// them. The geometry is here, the search in tag_alignment_search.cpp, the choice of pixels in
// tag_alignment_samples.cpp, the steps in tag_alignment_step.cpp, what says whether the result
// holds in tag_alignment_checks.cpp, and their order in tag_alignment.cpp.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "tracking/alignment/simd/alignment_kernel.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/alignment/tag_pattern.hpp"

namespace penumbra {

// floor and ceil of |x| < 2^20, without a call.
inline int floor_of(double x) {
  constexpr int kShift = 1 << 20;
  return static_cast<int>(x + kShift) - kShift;
}

inline int ceil_of(double x) {
  return -floor_of(-x);
}

// Of a tag: with fewer samples it has no equations.
inline constexpr int kFewestSamples = 16;

// The middle of a peak's top in a map of scores [its rows and columns].
struct SearchTop {
  double row = 0.0;
  double column = 0.0;
  bool open = false;  // goes on beyond the map, perhaps
};

struct TagAligner::Impl {
  static constexpr int kSearchReach = 31;  // [px] the code search looks this far to each side
  // Of a tag's samples, after Tukey's weights: with less it says nothing.
  static constexpr double kLeastWeightShare = 0.3;
  static constexpr int kMostMoments = 16;     // that an exposure is seen as
  static constexpr int kMaxSearchCells = 36;  // per tag; sums of so many bytes fit in 16 bits

  // Memory for the samples of all tags, taken tag by tag and given back all at once: what one stage
  // used the next one finds in the near caches. The first part is written to when it is made, so
  // that no frame waits for the system to provide it.
  class SampleArena {
   public:
    explicit SampleArena(std::size_t first_floats) { parts_.emplace_back(first_floats); }
    void give_back() {
      part_ = 0;
      used_ = 0;
    }
    // Arrays of `capacity` samples, 64-byte aligned, but for `levers` and `vertex`; of `c` those
    // that `reach` has.
    void take(int capacity, int reach, kernel::Samples& s) {
      s.count = (capacity + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
      take_each(s.count, s.pixel_x, s.pixel_y, s.ray_x, s.ray_y, s.value, s.weight, s.model,
                s.residual);
      take_anchors(reach, s);
    }
    // The same samples get arrays of their own for what hangs on the anchor.
    void take_anchors(int reach, kernel::Samples& s) {
      take_each(s.count, s.va, s.vb, s.ka, s.kb, s.rho, s.c[0], s.c[1], s.c[2], s.c[3]);
      if (reach > 1)
        take_each(s.count, s.c[4], s.c[5], s.c[6], s.c[7], s.c[8], s.c[9], s.c[10], s.c[11],
                  s.c[12], s.c[13], s.c[14], s.c[15]);
    }
    // So many floats, 64-byte aligned if all that is taken is a multiple of 16.
    [[nodiscard]] float* floats(std::size_t count) {
      while (part_ < parts_.size() && used_ + count > parts_[part_].size) {
        ++part_;
        used_ = 0;
      }
      if (part_ == parts_.size()) parts_.emplace_back(std::max(count, parts_[0].size / 4));
      float* const at = parts_[part_].begin() + used_;
      used_ += count;
#ifdef EIGEN_INITIALIZE_MATRICES_BY_NAN
      // As matrices are: what is read before it is written shows.
      std::fill_n(at, count, std::numeric_limits<float>::quiet_NaN());
#endif
      return at;
    }
    // The same, until something else is taken.
    [[nodiscard]] float* lend(std::size_t count) {
      float* const at = floats(count);
      used_ -= count;
      return at;
    }

   private:
    template <class... Array>
    void take_each(int count, Array&... arrays) {
      const auto each = static_cast<std::size_t>(count);
      float* next = floats(sizeof...(arrays) * each);
      ((arrays = std::exchange(next, next + each)), ...);
    }
    struct Part {
      explicit Part(std::size_t count) : size(count), data(count + 16, 0.0F) {}
      [[nodiscard]] float* begin() {
        const auto address = reinterpret_cast<std::uintptr_t>(data.data());
        return data.data() + ((64 - address % 64) % 64) / sizeof(float);
      }
      std::size_t size = 0;
      std::vector<float> data;
    };
    std::vector<Part> parts_;
    std::size_t part_ = 0, used_ = 0;
  };

  struct Tag {
    TagPattern pattern;
    Eigen::Isometry3d T_table_tag = Eigen::Isometry3d::Identity();
    double cell_m = 0.0;
    int side = 0;  // lattice vertices per side
    std::vector<float> lattice_a, lattice_b;
    // Of each vertex for 1, 2 and 3 lines per axis, see kernel::Samples.
    std::vector<std::array<float, 4>> coefficients1;
    std::vector<std::array<float, 16>> coefficients2, coefficients3;
    std::vector<kernel::RunWalk::Run> runs;  // the pattern's
    // The runs' cells one behind the other, those of runs along a and then those along b; the last
    // one twice, see kernel::Walk.
    std::array<std::vector<kernel::Walk::Cell>, 2> edge_cells;
    std::vector<DataCell> search_cells;  // as many white as black, the white ones first
    int search_white = 0;
    // Their centres in the lattice, and then its four corners; filled up with the last one.
    std::vector<float> search_a, search_b;

    // Of the current frame.
    bool left_out = false;  // not looked at
    bool visible = false;
    bool too_small = false;    // if not
    bool wholly_seen = false;  // all vertices have a projection
    Eigen::Matrix3d R_lattice_camera = Eigen::Matrix3d::Identity();
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the camera in the lattice [cells]
    Eigen::Matrix3d ray_from_lattice = Eigen::Matrix3d::Identity();
    std::array<float, 9> lattice_from_ray{};
    std::vector<float> ray_x, ray_y, pixel_x, pixel_y, depth, ka, kb, rho;  // of the vertices
    Eigen::Vector2d along_a = Eigen::Vector2d::Zero();  // of a cell at the tag's centre [px]
    Eigen::Vector2d along_b = Eigen::Vector2d::Zero();
    double cell_px = 0.0;  // the smaller side of the central cell, across it
    double cell_max_px = 0.0;
    double correlation = 0.0;
    // With a rolling shutter: from the camera of the picture's middle row to that of the row
    // through the tag's centre, that row, and by how much a row more displaces the tag [px per
    // row].
    Eigen::Isometry3d row_motion = Eigen::Isometry3d::Identity();
    double row = 0.0;
    Eigen::Vector2d row_shear = Eigen::Vector2d::Zero();
    Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();  // during the exposure
    // As how many moments the exposure is seen, and what of the motion falls into each: it is left
    // to the point spread, whose sigma that is along the lattice's directions.
    int moments = 1;
    Eigen::Vector2d smear_px = Eigen::Vector2d::Zero();
    Eigen::Vector2d sigma_cells = Eigen::Vector2d::Zero();
    double gain = 0.0, offset = 0.0;
    int reach = 1;
    bool correlated = false;
    kernel::Samples samples;           // in the arena
    std::vector<std::int32_t> vertex;  // theirs
    // Where an exposure is seen as several moments: the samples as each sees them, and from where.
    std::vector<kernel::Samples> moment_samples;
    std::vector<kernel::AccumulateInput> moment_inputs;
    int capacity = 0;  // [samples]
    int used = 0;      // samples without padding
    // Of the last selection, step by step or run by run: a step's samples end where the next one's
    // begin.
    int step_count = 0;
    bool thinned = false;  // not every pixel at an edge was taken
    std::vector<std::int32_t> step_end, step_run;
    kernel::Sums sums;
    std::vector<std::int16_t> scores;
    int score_points = 0;
    TagAlignment result;
    // Of `search_a`, `search_b`: depth not positive where there is no projection.
    std::vector<float> search_x, search_y, search_depth;
  };

  // What one tag says by itself at the solved pose: left perturbation of T_camera_table, gain and
  // offset eliminated.
  struct TagEquations {
    int index = 0;
    Matrix6d H = Matrix6d::Zero();
    Vector6d g = Vector6d::Zero();
    // Its own motions, as such perturbations, and the inverse of its equations for them.
    Eigen::Matrix<double, 6, 3> motions = Eigen::Matrix<double, 6, 3>::Zero();
    Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
    double squares = 0.0;
  };

  // What all tags say together: of the left perturbation of T_camera_table, gains and offsets
  // eliminated, without the prior.
  struct Equations {
    Matrix6d H;
    Vector6d g;
    double cost = 0.0;    // sum of w r^2, at the gains and offsets as they are
    double weight = 0.0;  // sum of w
  };

  // What is wanted of where the tags lie.
  enum class Projection {
    search,  // the cells that are searched for, alone
    wide,    // the lattice, blurred as the wide stage's model
    fine,    // as the picture is
  };

  CameraModel camera;
  AlignmentOptions options;
  const kernel::Variant* kernel = nullptr;
  kernel::Lens lens;
  std::array<float, 256> tone{};
  std::vector<Tag> tags;
  std::vector<Tag*> active;
  // For the samples until the next stage begins.
  SampleArena arena{0};
  AlignmentResult result;
  // Places across an edge that are sampled, in pixels from the edge's own one; none: all within
  // reach.
  struct Band {
    std::array<int, 16> offsets{};
    int count = 0;
  };
  // Of the current frame.
  ImageView image;
  Eigen::Isometry3d T_camera_table = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_predicted = Eigen::Isometry3d::Identity();
  Matrix6d prior_information = Matrix6d::Zero();
  Matrix6d prior_covariance = Matrix6d::Zero();
  double variance = 0.0;     // of a residual [grey^2]
  double noise_share = 0.0;  // sigma of a residual over the gain, by the median; 0: unknown
  Matrix6d information = Matrix6d::Zero();
  Vector6d last_step = Vector6d::Zero();  // left perturbation of T_camera_table
  double step_sigmas = 0.0;               // how far that was [standard deviations]
  double step_slope = 1.0;                // the share of the equations' H that it was solved with
  SampleNeed sample_need;
  double seen_contrast = 0.0;  // [grey]
  // How far the search left the tags from where they are, by how they agree; infinite: unknown.
  double search_error_px = std::numeric_limits<double>::infinity();
  double moved_since_projection_px = 0.0;  // how far the tags went at most
  int first_samples = 0;
  bool starts_far = false;
  Vector6d row_velocity = Vector6d::Zero();     // the camera's, per row [m, rad]
  Vector6d exposure_motion = Vector6d::Zero();  // the camera's [m, rad]
  // For so many moments, what takes T_camera_table to each of them; empty: not asked for yet.
  std::array<std::vector<Eigen::Isometry3d>, kMostMoments + 1> paths;
  std::vector<kernel::TagPack> packs;            // of the active tags in a step
  std::vector<kernel::RunWalk::Part> run_parts;  // in select, of a tag
  std::vector<TagEquations> agreement;
  std::vector<std::int32_t> score_sum;
  // Where a search saw a tag.
  struct DisplacedTag {
    Eigen::Vector3d p;  // its centre, in the table frame
    Eigen::Vector2d z;  // that in the image
    double sigma_px = 0.0;
    double cell_px = 0.0;
    bool open = false;
  };
  std::vector<DisplacedTag> displaced;
  std::vector<std::int32_t> cell_places;  // of a tag
  std::vector<std::uint8_t> search_scratch;
  // What is searched: the image, or one a whole number of times smaller.
  struct SearchedPicture {
    ImageView view;
    int scale = 1;
  };
  SearchedPicture searched;
  std::vector<std::uint8_t> small_picture;
  std::vector<std::uint16_t> column_sums;

  void set_tone(double exponent) {
    options.tone_exponent = exponent;
    for (int i = 0; i < 256; ++i)
      tone[static_cast<std::size_t>(i)] = static_cast<float>(255.0 * std::pow(i / 255.0, exponent));
  }

  // --- geometry of one tag at the current pose
  void place(Tag& tag) const;
  void read_out(Tag& tag) const;
  // `added_variance_px2` blurs the model beyond what the lens does.
  void project_lattice(Tag& tag, double added_variance_px2) const;
  void project_search(Tag& tag) const;
  void project(Tag& tag, double added_variance_px2, kernel::Vertices& vertices) const;
  // Of a tag that is seen at several moments: where the camera is then.
  void place_moments(Tag& tag);

  // Whether the tag can be used at the current pose; its size in the image.
  // How a motion during the exposure blurs a tag.
  enum class MotionBlur {
    point_spread,  // as a Gaussian point spread, one for each tag
    moments,       // as the mean of what is seen at some moments of the exposure
  };
  [[nodiscard]] bool measure(Tag& tag, MotionBlur blur = MotionBlur::point_spread) const;
  void measure_motion(Tag& tag, const Eigen::Vector3d& centre, const Eigen::Matrix<double, 2, 3>& J,
                      MotionBlur blur) const;

  void find_visible(Projection projection);

  // Pixel of a cell's centre by its corners; nothing where a corner has no projection.
  [[nodiscard]] static bool cell_pixel(const Tag& tag, int i, int j, double& x, double& y) {
    const auto v = static_cast<std::size_t>(j * tag.side + i);
    const std::size_t up = v + static_cast<std::size_t>(tag.side);
    if (!tag.wholly_seen && !(tag.depth[v] > 0.0F && tag.depth[v + 1] > 0.0F &&
                              tag.depth[up] > 0.0F && tag.depth[up + 1] > 0.0F))
      return false;
    const float* px = tag.pixel_x.data();
    const float* py = tag.pixel_y.data();
    x = 0.25 * static_cast<double>(px[v] + px[v + 1] + px[up] + px[up + 1]);
    y = 0.25 * static_cast<double>(py[v] + py[v + 1] + py[up] + py[up + 1]);
    return std::abs(x) < 1e5 && std::abs(y) < 1e5;
  }

  // The nearest pixel of it [px]; nothing outside the image too.
  [[nodiscard]] bool nearest_cell_pixel(const Tag& tag, const DataCell& cell, int& x,
                                        int& y) const {
    double centre_x = 0.0;
    double centre_y = 0.0;
    if (!cell_pixel(tag, cell.i, cell.j, centre_x, centre_y)) return false;
    x = floor_of(centre_x + 0.5);
    y = floor_of(centre_y + 0.5);
    return x >= 0 && y >= 0 && x < image.width && y < image.height;
  }

  // The nearest pixels of all cells into cell_places: that of the cell (i, j) at j * side + i.
  void find_cells(const Tag& tag);

  [[nodiscard]] bool look_where_predicted();
  [[nodiscard]] bool search(bool independent);
  [[nodiscard]] bool found_near() const;
  [[nodiscard]] bool search_pyramid(bool further);
  [[nodiscard]] ImageView shrink(int scale);
  struct SearchWindow;
  struct CellWindows;
  [[nodiscard]] double smallest_cell_px() const;
  [[nodiscard]] static Eigen::Vector3d centre_of(const Tag& tag);
  [[nodiscard]] SearchWindow window_of(int reach) const;
  void find_cell_windows(const Tag& tag, const SearchWindow& window, int pairs,
                         CellWindows& windows);
  [[nodiscard]] int score_tags(const SearchWindow& window);
  [[nodiscard]] bool search_within(const SearchWindow& window, bool independent,
                                   double least_contrast);
  [[nodiscard]] std::optional<SearchTop> own_top(const Tag& tag, const SearchWindow& window,
                                                 int row, int column, int slack,
                                                 double least_contrast);
  [[nodiscard]] bool fit_displaced();
  [[nodiscard]] double fit_error_px() const;
  void fetch_ahead(int margin) const;
  void read_levels();
  void take_samples(Tag& tag, int capacity);
  void select(Tag& tag, bool wide, int cap);
  // `reach_px`: across edges along a, and along b.
  void walk_runs(Tag& tag, const Band& band, const std::array<double, 2>& reach_px, int cap);
  void step_along(Tag& tag, const Band& band, const std::array<double, 2>& reach_px, double stride);
  void locate_samples(Tag& tag) const;
  void finish_samples(Tag& tag);
  void keep_on_paper(Tag& tag);
  void attach(const Tag& tag, const kernel::Samples& samples) const;
  // The model at the samples' pixels.
  void evaluate(Tag& tag);
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();
  // Where Tukey's weights end, as a share of the gain: never cut into the noise itself, and no
  // further out than it asks for.
  [[nodiscard]] double tukey_share(double cutoff) const {
    return noise_share > 0.0 ? std::clamp(4.685 * noise_share, 0.03, cutoff) : cutoff;
  }
  void sum_up(double cutoff, Equations& equations);
  [[nodiscard]] bool take_variance(const Equations& equations);
  void follow_tags(const Vector6d& xi, const Eigen::Isometry3d& motion, double& moved_px);
  enum class StepBy {
    weights,  // as they are
    slope,    // as they change with the step
  };
  [[nodiscard]] bool step(double cutoff, StepBy by, double& moved_px);
  void measure_noise();
  void measure_slope(double cutoff);
  [[nodiscard]] CameraPose pose() const;
  void report_pose();
  [[nodiscard]] double design_effect(double cutoff);
  void check_agreement();
  void check_map();
  [[nodiscard]] bool reads_clearly(const Tag& tag) const;
  void verify();
  void read_cells(Tag& tag);
  void average_cells(Tag& tag) const;
  [[nodiscard]] MotionBlurError motion_blur_error(const std::optional<Vector6d>& motion, bool known,
                                                  double longest_cells);
  void begin(const AlignmentInput& input);
  [[nodiscard]] AlignmentResult run(const AlignmentInput& input, bool with_search);
  bool attempt(bool with_search, bool independent, bool may_be_near);
};

}  // namespace penumbra
