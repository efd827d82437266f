// What the parts of the alignment share: a tag with its samples, and the aligner's state between
// them. The geometry is here, the search in tag_alignment_search.cpp, the choice of pixels in
// tag_alignment_samples.cpp, the steps in tag_alignment_step.cpp, what says whether the result
// holds in tag_alignment_checks.cpp, and their order in tag_alignment.cpp.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "tracking/alignment_kernel.hpp"
#include "tracking/tag_alignment.hpp"
#include "tracking/tag_pattern.hpp"

namespace penumbra {

// floor and ceil of |x| < 2^20, without a call.
inline int floor_of(double x) {
  constexpr int kShift = 1 << 20;
  return static_cast<int>(x + kShift) - kShift;
}

inline int ceil_of(double x) {
  return -floor_of(-x);
}

struct TagAligner::Impl {
  static constexpr int kSearchReach = 31;     // [px] the code search looks this far to each side
  static constexpr int kMaxSearchCells = 36;  // per tag; sums of so many bytes fit in 16 bits

  // 64-byte aligned arrays of floats, one behind the other.
  class SampleStorage {
   public:
    void resize(int capacity) {
      capacity = (capacity + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
      if (capacity <= capacity_) return;
      capacity_ = capacity + capacity / 2;
      capacity_ = (capacity_ + kernel::kBlock - 1) / kernel::kBlock * kernel::kBlock;
      data_.assign(static_cast<std::size_t>(capacity_) * kArrays + 16, 0.0F);
      vertex_.assign(static_cast<std::size_t>(capacity_), 0);
    }
    [[nodiscard]] int capacity() const { return capacity_; }
    [[nodiscard]] kernel::Samples view() {
      auto address = reinterpret_cast<std::uintptr_t>(data_.data());
      float* next = data_.data() + ((64 - address % 64) % 64) / sizeof(float);
      const auto take = [&] {
        float* array = next;
        next += capacity_;
        return array;
      };
      kernel::Samples s;
      for (float** array : {&s.pixel_x, &s.pixel_y, &s.ray_x, &s.ray_y, &s.value, &s.weight, &s.va,
                            &s.vb, &s.ka, &s.kb, &s.rho, &s.model, &s.residual})
        *array = take();
      for (float*& array : s.c) array = take();
      s.vertex = vertex_.data();
      return s;
    }

   private:
    static constexpr std::size_t kArrays = 29;
    std::vector<float> data_;
    std::vector<std::int32_t> vertex_;
    int capacity_ = 0;
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
    struct Run {
      std::uint32_t begin = 0, end = 0;  // vertices
      bool vertical = false;             // in the lattice
    };
    std::vector<Run> runs;               // the pattern's
    std::vector<DataCell> search_cells;  // as many white as black, the white ones first
    int search_white = 0;

    // Of the current frame.
    bool visible = false;
    Eigen::Matrix3d R_lattice_camera = Eigen::Matrix3d::Identity();
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the camera in the lattice [cells]
    Eigen::Matrix3d ray_from_lattice = Eigen::Matrix3d::Identity();
    std::array<float, 9> lattice_from_ray{};
    std::vector<float> ray_x, ray_y, pixel_x, pixel_y, depth, ka, kb, rho;  // of the vertices
    double cell_px = 0.0;  // the smaller side of the central cell, across it
    double cell_max_px = 0.0;
    double correlation = 0.0;
    // With a rolling shutter: from the camera of the picture's middle row to that of the row
    // through the tag's centre, that row, and by how much a row more displaces the tag [px per
    // row].
    Eigen::Isometry3d row_motion = Eigen::Isometry3d::Identity();
    double row = 0.0;
    Eigen::Vector2d row_shear = Eigen::Vector2d::Zero();
    Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();
    double gain = 0.0, offset = 0.0;
    int reach = 1;
    bool correlated = false;
    SampleStorage storage;
    kernel::Samples samples;
    int used = 0;  // samples without padding
    // Of the last selection: a run's samples end where the next begin.
    struct RunSamples {
      int end = 0;
      bool vertical = false;
    };
    std::vector<RunSamples> run_samples;
    kernel::Sums sums;
    std::vector<std::int16_t> scores;
    int score_points = 0;
    TagAlignment result;
  };

  // A tag's gain and offset, solved for in terms of the pose.
  struct Eliminated {
    Eigen::Matrix<double, 6, 2> cross;  // lattice frame
    Eigen::Matrix2d inverse;
    Eigen::Vector2d gradient;
    bool valid = false;
  };

  CameraModel camera;
  AlignmentOptions options;
  const kernel::Variant* kernel = nullptr;
  kernel::Lens lens;
  std::array<float, 256> tone{};
  std::vector<Tag> tags;
  std::vector<Tag*> active;
  AlignmentResult result;
  // Of the current frame.
  ImageView image;
  Eigen::Isometry3d T_camera_table = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_predicted = Eigen::Isometry3d::Identity();
  Matrix6d prior_information = Matrix6d::Zero();
  Matrix6d prior_covariance = Matrix6d::Zero();
  double variance = 0.0;     // of a residual [grey^2]
  double noise_share = 0.0;  // sigma of a residual over the gain, by the median; 0: unknown
  Matrix6d information = Matrix6d::Zero();
  SampleNeed sample_need;
  double seen_contrast = 0.0;              // [grey]
  double moved_since_projection_px = 0.0;  // how far the tags went at most
  int first_samples = 0;
  bool starts_far = false;
  Vector6d row_velocity = Vector6d::Zero();  // the camera's, per row [m, rad]
  std::vector<Eliminated> eliminated;        // of the last step, by place in `active`
  std::vector<double> run_lengths;           // in select, of a tag; negative: not to be walked
  std::vector<std::int32_t> score_sum;
  std::vector<std::uint8_t> search_scratch;

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

  // Whether the tag can be used at the current pose; its size in the image.
  [[nodiscard]] bool measure(Tag& tag, const Vector6d& exposure_motion) const;

  void find_visible(const Vector6d& exposure_motion, bool wide);

  // Pixel of a cell's centre by its corners; nothing where a corner has no projection.
  [[nodiscard]] static bool cell_pixel(const Tag& tag, int i, int j, double& x, double& y) {
    const auto v = static_cast<std::size_t>(j * tag.side + i);
    const std::array<std::size_t, 4> corners = {v, v + 1, v + static_cast<std::size_t>(tag.side),
                                                v + static_cast<std::size_t>(tag.side) + 1};
    float sum_x = 0.0F;
    float sum_y = 0.0F;
    for (const std::size_t c : corners) {
      if (!(tag.depth[c] > 0.0F)) return false;
      sum_x += tag.pixel_x[c];
      sum_y += tag.pixel_y[c];
    }
    x = 0.25 * static_cast<double>(sum_x);
    y = 0.25 * static_cast<double>(sum_y);
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

  [[nodiscard]] bool search(bool independent);
  [[nodiscard]] bool search_within(int search_reach, bool independent, double least_contrast);
  void fetch_ahead(int margin) const;
  void read_levels();
  void select(Tag& tag, bool wide, int cap);
  void finish_samples(Tag& tag);
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();
  bool step(double cutoff, double& moved_px);
  void measure_noise();
  void report_pose();
  [[nodiscard]] double design_effect(double cutoff) const;
  void verify();
  const AlignmentResult& run(const AlignmentInput& input, bool with_search);
  bool attempt(const Vector6d& exposure_motion, bool with_search, bool independent);
};

}  // namespace penumbra
