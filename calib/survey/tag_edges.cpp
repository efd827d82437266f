#include "calib/survey/tag_edges.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/target/target_edges.hpp"

namespace penumbra {
namespace {

constexpr double kNarrowestCell = 2.4;  // minimum width of a cell [px]
constexpr double kShiftPrior = 0.5;     // sigma of an edge shift [px]
constexpr double kMaxNoise_px = 0.6;    // per sample; more noise means another pattern
constexpr int kUnknowns = 10;           // 8 of a homography and 2 edge shifts
constexpr std::size_t kMinSamples = 40;

using Row = Eigen::Matrix<double, kUnknowns, 1>;
using Normal = Eigen::Matrix<double, kUnknowns, kUnknowns>;

struct EdgeSample {
  Eigen::Vector2d pixel;
  Eigen::Vector2d normal;     // unit vector in the image, towards larger x or y on the tag
  double polarity = 0.0;      // 1: the grey level rises along the normal; -1: it falls
  double search_range = 0.0;  // search range along the normal [px], at most half a cell
  Row row;                    // d offset along the normal / d unknowns
  Eigen::Vector3d by_curvature = Eigen::Vector3d::Zero();  // d offset / d (xx, xy, yy) [px m]
};

// Returns d pixel / d homography (8 parameters) at the point `on_tag`. `on_tag`, `pixel` and
// `depth` are relative to the tag's centre and scaled to about 1.
Eigen::Matrix<double, 2, 8> displacements(const Eigen::Vector2d& on_tag,
                                          const Eigen::Vector2d& pixel, double depth) {
  const double a = on_tag.x();
  const double b = on_tag.y();
  Eigen::Matrix<double, 2, 8> basis;
  basis << a, b, 1.0, 0.0, 0.0, 0.0, pixel.x() * a, pixel.x() * b,  //
      0.0, 0.0, 0.0, a, b, 1.0, pixel.y() * a, pixel.y() * b;
  return basis / depth;
}

class TagFit {
 public:
  TagFit(const CameraModel& camera, const TagPattern& pattern, const MappedTag& tag,
         const Transform<frame::Camera, frame::Tag>& T_camera_tag)
      : camera_(camera),
        T_(T_camera_tag),
        curvature_(tag.curvature),
        cell_m_(tag.size_m / pattern.width_at_border()),
        half_m_(0.5 * tag.size_m),
        total_(pattern.total_width()) {}

  // Returns false if an edge is outside the image or the cells are too narrow.
  bool place_samples(const TagPattern& pattern) {
    const auto centre = project({0.0, 0.0}, 0.0);
    if (!centre) return false;
    centre_px_ = *centre;
    depth_m_ = (T_ * Eigen::Vector3d::Zero()).z();
    constexpr std::array<std::array<int, 2>, 4> kCorners = {{{-1, -1}, {1, -1}, {1, 1}, {-1, 1}}};
    for (std::size_t i = 0; i < 4; ++i) {
      corners_m_[i] = {kCorners[i][0] * half_m_, kCorners[i][1] * half_m_};
      const auto pixel = project(corners_m_[i], 0.0);
      if (!pixel) return false;
      corners_px_[i] = *pixel;
      radius_px_ = std::max(radius_px_, (*pixel - centre_px_).norm());
    }
    for (const EdgeRun& run : pattern.runs()) {
      if (!add_run(run)) return false;
    }
    return samples_.size() >= kMinSamples;
  }

  bool solve(ImageView luma) {
    constexpr int kRounds = 5;
    for (int round = 0; round < kRounds; ++round) {
      Normal A = Normal::Zero();
      Row rhs = Row::Zero();
      Eigen::Matrix<double, kUnknowns, 3> coupling = Eigen::Matrix<double, kUnknowns, 3>::Zero();
      Eigen::Matrix3d curvature_normal = Eigen::Matrix3d::Zero();
      Eigen::Vector3d curvature_rhs = Eigen::Vector3d::Zero();
      double sum = 0.0;
      double weights = 0.0;
      std::size_t found = 0;
      for (const EdgeSample& sample : samples_) {
        const double expected = sample.row.dot(x_);
        const double width =
            round < 2 ? 0.6 * sample.search_range : std::min(0.6 * sample.search_range, 1.2);
        const auto found_at = find_edge(luma, {sample.pixel, sample.normal, expected,
                                               sample.search_range, width, sample.polarity, 8.0});
        if (!found_at) continue;
        ++found;
        const double offset = expected + *found_at;
        const double error = offset - expected;
        const double weight = round == 0 ? 1.0 : 1.0 / (1.0 + std::pow(error / (3.0 * noise_), 2));
        A += weight * sample.row * sample.row.transpose();
        rhs += weight * offset * sample.row;
        coupling += weight * sample.row * sample.by_curvature.transpose();
        curvature_normal += weight * sample.by_curvature * sample.by_curvature.transpose();
        curvature_rhs += weight * offset * sample.by_curvature;
        sum += weight * error * error;
        weights += weight;
      }
      if (found < kMinSamples || 10 * found < 6 * samples_.size()) return false;
      noise_ = std::clamp(std::sqrt(sum / std::max(weights - kUnknowns, 1.0)), 0.02, 2.0);
      for (int i = 8; i < kUnknowns; ++i) A(i, i) += std::pow(noise_ / kShiftPrior, 2);
      const Eigen::LDLT<Normal> factor(A);
      x_ = factor.solve(rhs);
      if (factor.info() != Eigen::Success || !x_.allFinite()) return false;
      if (round < kRounds - 1) continue;
      covariance_ = noise_ * noise_ * factor.solve(Normal::Identity());
      const Eigen::Matrix<double, kUnknowns, 3> across = factor.solve(coupling);
      const double information = 1.0 / (noise_ * noise_);
      equations_.information = information * (curvature_normal - coupling.transpose() * across);
      equations_.gradient = information * (curvature_rhs - across.transpose() * rhs);
      equations_.assumed = curvature_;
    }
    return noise_ < kMaxNoise_px && covariance_.allFinite() && equations_.information.allFinite() &&
           equations_.gradient.allFinite();
  }

  [[nodiscard]] MeasuredTag result() const {
    MeasuredTag tag;
    Eigen::Matrix<double, 8, 8> J;
    for (std::size_t i = 0; i < 4; ++i) {
      const Eigen::Matrix<double, 2, 8> here = basis_at(corners_m_[i], corners_px_[i]);
      J.middleRows<2>(static_cast<Eigen::Index>(2 * i)) = here;
      tag.corners_px[i] = corners_px_[i] + here * x_.head<8>();
    }
    tag.covariance = J * covariance_.topLeftCorner<8, 8>() * J.transpose();
    tag.edge_shift_px = x_.tail<2>();
    tag.curvature = equations_;
    return tag;
  }

 private:
  [[nodiscard]] std::optional<Eigen::Vector2d> project(const Eigen::Vector2d& on_tag,
                                                       double height_m) const {
    return camera_.project(T_ * Eigen::Vector3d(on_tag.x(), on_tag.y(), height_m));
  }
  // Projects a point of the curved paper.
  [[nodiscard]] std::optional<Eigen::Vector2d> project(const Eigen::Vector2d& on_tag) const {
    return project(on_tag, curvature_.height(on_tag.x(), on_tag.y(), 2.0 * half_m_));
  }

  [[nodiscard]] Eigen::Matrix<double, 2, 8> basis_at(const Eigen::Vector2d& on_tag,
                                                     const Eigen::Vector2d& pixel) const {
    const double depth = (T_ * Eigen::Vector3d(on_tag.x(), on_tag.y(), 0.0)).z() / depth_m_;
    return displacements(on_tag / half_m_, (pixel - centre_px_) / radius_px_, depth);
  }

  bool add_run(const EdgeRun& run) {
    const auto metres = [&](double lattice) { return (lattice - 0.5 * total_) * cell_m_; };
    const Eigen::Vector2d along =
        run.vertical ? Eigen::Vector2d::UnitY() : Eigen::Vector2d::UnitX();
    const Eigen::Vector2d across =
        run.vertical ? Eigen::Vector2d::UnitX() : Eigen::Vector2d::UnitY();
    const auto at = [&](double t) {
      return Eigen::Vector2d(metres(run.position) * across + metres(t) * along);
    };
    const auto first = project(at(run.begin));
    const auto last = project(at(run.end));
    if (!first || !last) return false;
    const double length_px = (*last - *first).norm();
    const double cell_px = length_px / (run.end - run.begin);
    // Skips both ends of a run, where blur mixes in other edges (two sigmas).
    const double margin = std::min(1.5 / cell_px, 0.35);
    const double span = run.end - run.begin - 2.0 * margin;
    const int count = std::clamp(static_cast<int>(span * cell_px), 1, 60);
    for (int k = 0; k < count; ++k) {
      const Eigen::Vector2d point = at(run.begin + margin + (k + 0.5) / count * span);
      const double step = 0.05 * cell_m_;
      const auto pixel = project(point);
      const auto next = project(point + step * along);
      const auto beside = project(point + step * across);
      const double height_m = curvature_.height(point.x(), point.y(), 2.0 * half_m_);
      const auto above = project(point, height_m + step);
      if (!pixel || !next || !beside || !above) return false;
      const Eigen::Vector2d tangent = *next - *pixel;
      EdgeSample sample;
      sample.pixel = *pixel;
      sample.normal = Eigen::Vector2d(-tangent.y(), tangent.x()).normalized();
      if (sample.normal.dot(*beside - *pixel) < 0.0) sample.normal = -sample.normal;
      const double width_px = sample.normal.dot(*beside - *pixel) * cell_m_ / step;
      if (width_px < kNarrowestCell) return false;
      sample.search_range = std::min(0.5 * width_px, 3.5);
      sample.polarity = run.polarity;
      sample.row.head<8>() = basis_at(point, *pixel).transpose() * sample.normal;
      const double by_height = sample.normal.dot(*above - *pixel) / step;
      sample.by_curvature =
          by_height * Eigen::Vector3d(0.5 * (point.x() * point.x() - half_m_ * half_m_),
                                      point.x() * point.y(),
                                      0.5 * (point.y() * point.y() - half_m_ * half_m_));
      sample.row[8] = run.vertical ? run.polarity : 0.0;
      sample.row[9] = run.vertical ? 0.0 : run.polarity;
      samples_.push_back(sample);
    }
    return true;
  }

  const CameraModel& camera_;
  Transform<frame::Camera, frame::Tag> T_;
  TagCurvature curvature_;
  double cell_m_;
  double half_m_;
  double total_;
  double depth_m_ = 1.0;
  double radius_px_ = 1.0;
  Eigen::Vector2d centre_px_ = Eigen::Vector2d::Zero();
  std::array<Eigen::Vector2d, 4> corners_m_;
  std::array<Eigen::Vector2d, 4> corners_px_;
  std::vector<EdgeSample> samples_;
  Row x_ = Row::Zero();
  double noise_ = 0.3;
  Normal covariance_ = Normal::Zero();
  CurvatureEquations equations_;
};

}  // namespace

std::optional<MeasuredTag> measure_tag(ImageView luma, const CameraModel& camera,
                                       const TagPattern& pattern, const MappedTag& tag,
                                       const Transform<frame::Camera, frame::Tag>& T_camera_tag) {
  TagFit fit(camera, pattern, tag, T_camera_tag);
  if (!fit.place_samples(pattern) || !fit.solve(luma)) return std::nullopt;
  return fit.result();
}

}  // namespace penumbra
