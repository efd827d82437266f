#include "calib/tag_survey.hpp"

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <set>
#include <vector>

#include "core/text.hpp"
#include "core/yaml_fields.hpp"
#include "tracking/pose_solver.hpp"

namespace penumbra {
namespace {

using TagPose = Transform<frame::Table, frame::Tag>;
using Pose6 = std::array<double, 6>;  // angle-axis, translation

constexpr double kNearest = 1e-6;        // [m] in front of the camera
constexpr double kEdgeShiftPrior = 0.5;  // [px]
constexpr double kTypicalNoise = 0.1;    // [px]
// No tone curve and no blur that leaves a tag readable moves edges by more: what was found instead
// is an error of the model (a sheet that is not flat, a lens) that scale and shift took up
// together.
constexpr double kMostEdgeShift = 0.5;  // [px]
constexpr int kFewestFrames = 2;        // that a tag must be seen in

struct Sighting {
  int id = 0;
  std::array<Eigen::Vector2d, 4> corners_px;
  std::array<Eigen::Vector2d, 4> spread;
};

std::array<Eigen::Vector3d, 4> corners_of(double size) {
  const double h = 0.5 * size;
  return {Eigen::Vector3d(-h, -h, 0.0), Eigen::Vector3d(h, -h, 0.0), Eigen::Vector3d(h, h, 0.0),
          Eigen::Vector3d(-h, h, 0.0)};
}

// How each corner moves when the tag's edges move outwards by 1 px.
std::array<Eigen::Vector2d, 4> spreads_of(const std::array<Eigen::Vector2d, 4>& corners) {
  const Eigen::Vector2d centre = 0.25 * (corners[0] + corners[1] + corners[2] + corners[3]);
  const auto outward = [&](const Eigen::Vector2d& p, const Eigen::Vector2d& q) {
    Eigen::Vector2d n(-(q - p).y(), (q - p).x());
    n.normalize();
    return n.dot(p - centre) < 0.0 ? Eigen::Vector2d(-n) : n;
  };
  std::array<Eigen::Vector2d, 4> spreads;
  for (std::size_t i = 0; i < 4; ++i) {
    Eigen::Matrix2d normals;
    normals.row(0) = outward(corners[(i + 3) % 4], corners[i]).transpose();
    normals.row(1) = outward(corners[i], corners[(i + 1) % 4]).transpose();
    spreads[i] = std::abs(normals.determinant()) < 0.2
                     ? Eigen::Vector2d(Eigen::Vector2d::Zero())
                     : Eigen::Vector2d(normals.inverse() * Eigen::Vector2d::Ones());
  }
  return spreads;
}

template <class To, class From>
Pose6 packed(const Transform<To, From>& pose) {
  const Eigen::AngleAxisd turn(pose.rotation());
  const Eigen::Vector3d axis = turn.angle() * turn.axis();
  const Eigen::Vector3d& t = pose.translation();
  return {axis.x(), axis.y(), axis.z(), t.x(), t.y(), t.z()};
}

template <class To, class From>
Transform<To, From> unpacked(const Pose6& pose) {
  const Eigen::Vector3d axis(pose[0], pose[1], pose[2]);
  const double angle = axis.norm();
  return {angle < 1e-12 ? Eigen::Quaterniond::Identity()
                        : Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis / angle)),
          Eigen::Vector3d(pose[3], pose[4], pose[5])};
}

struct CornerCost {
  const CameraModel* camera;
  Eigen::Vector3d p_tag;
  Eigen::Vector2d pixel;
  Eigen::Vector2d spread;

  // T_camera_table, T_table_tag, edge shift.
  template <class T>
  bool operator()(const T* camera_pose, const T* tag_pose, const T* shift, T* residual) const {
    const T p[3] = {T(p_tag.x()), T(p_tag.y()), T(p_tag.z())};
    T in_table[3];
    ceres::AngleAxisRotatePoint(tag_pose, p, in_table);
    for (int i = 0; i < 3; ++i) in_table[i] += tag_pose[3 + i];
    T in_camera[3];
    ceres::AngleAxisRotatePoint(camera_pose, in_table, in_camera);
    for (int i = 0; i < 3; ++i) in_camera[i] += camera_pose[3 + i];
    if (!(in_camera[2] > T(kNearest))) return false;
    camera->project_generic<T>(in_camera, residual);
    residual[0] += shift[0] * spread.x() - pixel.x();
    residual[1] += shift[0] * spread.y() - pixel.y();
    return true;
  }
};
using CornerFunction = ceres::AutoDiffCostFunction<CornerCost, 2, 6, 6, 1>;

struct ShiftPrior {
  template <class T>
  bool operator()(const T* shift, T* residual) const {
    residual[0] = shift[0] / kEdgeShiftPrior;
    return true;
  }
};

class Survey {
 public:
  Survey(const CameraModel& camera, const SurveyOptions& options)
      : camera_(camera), options_(options) {}

  std::vector<std::vector<Sighting>> frames;
  std::map<int, Pose6> tags;                  // placed ones: T_table_tag
  std::vector<std::optional<Pose6>> cameras;  // T_camera_table

  [[nodiscard]] double size_of(int id) const {
    const auto named = options_.sizes_m.find(id);
    return named != options_.sizes_m.end() ? named->second : options_.tag_size_m.value_or(0.0);
  }

  // Observations of placed tags in a frame.
  [[nodiscard]] std::vector<PointObservation> placed_in(std::size_t frame) const {
    std::vector<PointObservation> points;
    for (const Sighting& sighting : frames[frame]) {
      const auto placed = tags.find(sighting.id);
      if (placed == tags.end()) continue;
      const auto T_table_tag = unpacked<frame::Table, frame::Tag>(placed->second);
      const auto corners = corners_of(size_of(sighting.id));
      for (std::size_t i = 0; i < 4; ++i)
        points.push_back({T_table_tag * corners[i], sighting.corners_px[i]});
    }
    return points;
  }

  // Cameras from what is placed; where two poses explain a frame about as well, none is taken.
  void pose_cameras() {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      const auto points = placed_in(f);
      if (points.size() < 4) continue;
      std::optional<RefinedPose> best;
      double second = std::numeric_limits<double>::infinity();
      for (const CameraPose& start : solve_pose(camera_, points)) {
        const auto refined = refine_pose(camera_, points, start);
        if (!refined) continue;
        if (!best || refined->rms_px < best->rms_px) {
          if (best &&
              perturbation_between(best->T_table_camera, refined->T_table_camera).norm() > 1e-3)
            second = best->rms_px;
          best = refined;
        } else if (perturbation_between(best->T_table_camera, refined->T_table_camera).norm() >
                   1e-3) {
          second = std::min(second, refined->rms_px);
        }
      }
      if (!best || best->rms_px > 5.0) continue;
      if (points.size() == 4 && second < 2.0 * best->rms_px + 0.1) continue;
      cameras[f] = packed(best->T_table_camera.inverse());
    }
  }

  // The tag where it explains what all posed frames show of it best.
  [[nodiscard]] std::optional<Pose6> place(int id) const {
    std::vector<std::pair<std::size_t, const Sighting*>> seen;
    for (std::size_t f = 0; f < frames.size(); ++f) {
      if (!cameras[f]) continue;
      for (const Sighting& sighting : frames[f]) {
        if (sighting.id == id) seen.emplace_back(f, &sighting);
      }
    }
    if (seen.size() < static_cast<std::size_t>(kFewestFrames)) return std::nullopt;
    const auto corners = corners_of(size_of(id));
    std::optional<Pose6> best;
    double least = std::numeric_limits<double>::infinity();
    const std::size_t step = std::max<std::size_t>(1, seen.size() / 10);
    for (std::size_t k = 0; k < seen.size(); k += step) {
      const auto& [frame, sighting] = seen[k];
      std::vector<PointObservation> points;  // "table" is the tag here
      for (std::size_t i = 0; i < 4; ++i) points.push_back({corners[i], sighting->corners_px[i]});
      for (const CameraPose& T_tag_camera : solve_pose(camera_, points)) {
        const auto T_camera_table = unpacked<frame::Camera, frame::Table>(*cameras[frame]);
        const Transform<frame::Camera, frame::Tag> T_camera_tag(
            T_tag_camera.inverse().rotation(), T_tag_camera.inverse().translation());
        const TagPose T_table_tag = T_camera_table.inverse() * T_camera_tag;
        std::vector<double> errors;
        for (const auto& [other, view] : seen) {
          const auto T = unpacked<frame::Camera, frame::Table>(*cameras[other]) * T_table_tag;
          double sum = 0.0;
          for (std::size_t i = 0; i < 4; ++i) {
            const auto pixel = camera_.project(T * corners[i]);
            sum += pixel ? (*pixel - view->corners_px[i]).squaredNorm() : 1e6;
          }
          errors.push_back(sum);
        }
        const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
        std::nth_element(errors.begin(), middle, errors.end());
        if (*middle < least) {
          least = *middle;
          best = packed(T_table_tag);
        }
      }
    }
    return best;
  }

  bool adjust(bool robust) {
    ceres::Problem problem;
    build(problem, robust);
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.max_num_iterations = 60;
    options.num_threads = 1;  // the same sums in the same order, every time
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable();
  }

  // Residuals by corner; sightings whose tag is off in a frame are taken out. True if any was.
  bool drop_outliers(double& rms, int& corners) {
    std::vector<double> all;
    for_each([&](std::size_t, const Sighting&, const std::array<Eigen::Vector2d, 4>& r) {
      for (const Eigen::Vector2d& e : r) all.push_back(e.norm());
    });
    if (all.empty()) return false;
    std::vector<double> sorted = all;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    const double limit = std::max(6.0 * *middle / 1.1774, 0.3);
    std::set<std::pair<std::size_t, int>> bad;
    double sum = 0.0;
    corners = 0;
    for_each([&](std::size_t f, const Sighting& s, const std::array<Eigen::Vector2d, 4>& r) {
      double worst = 0.0;
      for (const Eigen::Vector2d& e : r) worst = std::max(worst, e.norm());
      if (worst > limit) {
        bad.emplace(f, s.id);
        return;
      }
      for (const Eigen::Vector2d& e : r) sum += e.squaredNorm();
      corners += 4;
    });
    rms = std::sqrt(sum / std::max(corners, 1));
    for (std::size_t f = 0; f < frames.size(); ++f) {
      std::erase_if(frames[f], [&](const Sighting& s) { return bad.count({f, s.id}) > 0; });
    }
    return !bad.empty();
  }

  // Covariances of tag poses, scaled by the residuals' spread; nothing where they are not fixed.
  std::optional<std::map<int, Matrix6d>> covariances(double noise_px) {
    ceres::Problem problem;
    build(problem, false);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    options.num_threads = 1;
    ceres::Covariance covariance(options);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (auto& [id, pose] : tags) {
      if (id != options_.anchor) blocks.emplace_back(pose.data(), pose.data());
    }
    if (!covariance.Compute(blocks, &problem)) return std::nullopt;
    std::map<int, Matrix6d> result;
    for (auto& [id, pose] : tags) {
      Matrix6d moved = Matrix6d::Zero();
      if (id != options_.anchor) {
        Eigen::Matrix<double, 6, 6, Eigen::RowMajor> raw;
        if (!covariance.GetCovarianceBlock(pose.data(), pose.data(), raw.data()))
          return std::nullopt;
        // Angle-axis parameters -> turns about table axes, by differences of the rotation itself;
        // and position first.
        const Eigen::Quaterniond q = unpacked<frame::Table, frame::Tag>(pose).rotation();
        Matrix6d J = Matrix6d::Zero();
        J.block<3, 3>(0, 3).setIdentity();
        for (int i = 0; i < 3; ++i) {
          Pose6 step = pose;
          step[static_cast<std::size_t>(i)] += 1e-6;
          const Eigen::Quaterniond d =
              unpacked<frame::Table, frame::Tag>(step).rotation() * q.conjugate();
          J.block<3, 1>(3, i) = 2.0 * (d.w() < 0.0 ? -1.0 : 1.0) * d.vec() / 1e-6;
        }
        moved = J * raw * J.transpose() * noise_px * noise_px;
      }
      result[id] = moved;
    }
    return result;
  }

  double shift = 0.0;
  bool shift_is_free = true;

 private:
  template <class Visit>
  void for_each(const Visit& visit) {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      if (!cameras[f]) continue;
      for (const Sighting& sighting : frames[f]) {
        const auto placed = tags.find(sighting.id);
        if (placed == tags.end()) continue;
        std::array<Eigen::Vector2d, 4> residuals;
        const auto corners = corners_of(size_of(sighting.id));
        for (std::size_t i = 0; i < 4; ++i) {
          const CornerCost cost{&camera_, corners[i], sighting.corners_px[i], sighting.spread[i]};
          if (!cost(cameras[f]->data(), placed->second.data(), &shift, residuals[i].data()))
            residuals[i].setConstant(1e3);
        }
        visit(f, sighting, residuals);
      }
    }
  }

  void build(ceres::Problem& problem, bool robust) {
    for (std::size_t f = 0; f < frames.size(); ++f) {
      if (!cameras[f]) continue;
      for (const Sighting& sighting : frames[f]) {
        const auto placed = tags.find(sighting.id);
        if (placed == tags.end()) continue;
        const auto corners = corners_of(size_of(sighting.id));
        for (std::size_t i = 0; i < 4; ++i) {
          problem.AddResidualBlock(
              new CornerFunction(
                  new CornerCost{&camera_, corners[i], sighting.corners_px[i], sighting.spread[i]}),
              robust ? new ceres::CauchyLoss(0.5) : nullptr, cameras[f]->data(),
              placed->second.data(), &shift);
        }
      }
    }
    // Residuals are pixels of about this noise: the prior counts no more than it should.
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ShiftPrior, 1, 1>(new ShiftPrior),
        new ceres::ScaledLoss(nullptr, kTypicalNoise * kTypicalNoise, ceres::TAKE_OWNERSHIP),
        &shift);
    if (!shift_is_free) problem.SetParameterBlockConstant(&shift);
    Pose6& anchor = tags.at(options_.anchor);
    if (problem.HasParameterBlock(anchor.data())) problem.SetParameterBlockConstant(anchor.data());
  }

  const CameraModel& camera_;
  const SurveyOptions& options_;
};

}  // namespace

Result<TagSurvey> survey_tags(const CameraModel& camera, std::span<const SurveyFrame> frames,
                              const SurveyOptions& options) {
  // Ceres says on standard error what it tries in vain; what matters is in the result.
  FLAGS_minloglevel = std::max(FLAGS_minloglevel, static_cast<int>(google::GLOG_ERROR));
  Survey survey(camera, options);
  std::map<int, int> seen;
  std::set<int> without_size;
  const std::size_t step =
      std::max<std::size_t>(1, (frames.size() + static_cast<std::size_t>(options.most_frames) - 1) /
                                   static_cast<std::size_t>(options.most_frames));
  for (std::size_t f = 0; f < frames.size(); f += step) {
    std::map<int, int> times;
    for (const TagDetection& tag : frames[f].tags) ++times[tag.id];
    std::vector<Sighting> sightings;
    for (const TagDetection& tag : frames[f].tags) {
      if (times[tag.id] > 1) continue;  // two of them: nobody knows which is meant
      if (survey.size_of(tag.id) <= 0.0) {
        without_size.insert(tag.id);
        continue;
      }
      bool inside = true;
      for (const Eigen::Vector2d& corner : tag.corners_px) {
        inside = inside && corner.x() > 2.0 && corner.y() > 2.0 &&
                 corner.x() < camera.width() - 3 && corner.y() < camera.height() - 3;
      }
      if (!inside) continue;
      sightings.push_back({tag.id, tag.corners_px, spreads_of(tag.corners_px)});
      ++seen[tag.id];
    }
    survey.frames.push_back(std::move(sightings));
  }
  survey.cameras.resize(survey.frames.size());
  if (seen.empty()) {
    return fail(
        "no tag of the family {} with a known size is seen{}; name the family (--family) "
        "and the sizes",
        to_string(options.family),
        without_size.empty()
            ? ""
            : fmt::format(" (without size: {})",
                          joined(std::vector(without_size.begin(), without_size.end()))));
  }
  if (seen.count(options.anchor) == 0) {
    std::vector<int> ids;
    for (const auto& [id, count] : seen) ids.push_back(id);
    return fail("the anchor, tag {}, is never seen; choose one of {}", options.anchor, joined(ids));
  }

  survey.shift_is_free = options.edge_shift;
  // From the anchor outwards: cameras from placed tags, tags from posed cameras.
  survey.tags[options.anchor] = Pose6{};
  for (bool grew = true; grew;) {
    grew = false;
    survey.pose_cameras();
    for (const auto& [id, count] : seen) {
      if (survey.tags.count(id) > 0) continue;
      if (const auto pose = survey.place(id)) {
        survey.tags[id] = *pose;
        grew = true;
      }
    }
    if (grew && !survey.adjust(true))
      return fail(
          "the tags' places do not settle; sweep slower, and over two or more tags at a time");
  }
  if (std::none_of(survey.cameras.begin(), survey.cameras.end(),
                   [](const auto& pose) { return pose.has_value(); })) {
    return fail("tag {} alone never tells where the camera is; come closer to it, at an angle",
                options.anchor);
  }
  TagSurvey result;
  int corners = 0;
  const auto settle = [&] {
    for (int round = 0; round < 4; ++round) {
      if (!survey.adjust(round == 0)) return false;
      if (!survey.drop_outliers(result.rms_px, corners) && round > 0) break;
    }
    return true;
  };
  bool settled = settle();
  if (settled && std::abs(survey.shift) > kMostEdgeShift) {
    survey.shift = 0.0;
    survey.shift_is_free = false;
    settled = settle();
  }
  if (!settled) return fail("the tags' places do not settle; sweep slower");
  if (result.rms_px > 3.0) {
    return fail(
        "the tags contradict each other by {:.1f} px: did one move, are the sizes right, and "
        "is the camera's file of this camera?",
        result.rms_px);
  }
  result.edge_shift_px = survey.shift;
  int posed = 0;
  for (std::size_t f = 0; f < survey.frames.size(); ++f) {
    if (survey.cameras[f] && !survey.frames[f].empty()) ++posed;
  }
  result.frames_used = posed;
  const double freedom =
      2.0 * corners - 6.0 * posed - 6.0 * (static_cast<double>(survey.tags.size()) - 1.0) - 1.0;
  if (freedom < 4.0) return fail("too few tags and frames to place them; sweep over all of them");
  const double noise = result.rms_px * std::sqrt(corners / freedom);
  const auto covariances = survey.covariances(noise);
  if (!covariances)
    return fail(
        "some tags' places are not fixed; see every tag together with others, in several frames");
  for (const auto& [id, pose] : survey.tags) {
    SurveyedTag tag;
    tag.tag.id = id;
    tag.tag.family = options.family;
    tag.tag.size_m = survey.size_of(id);
    tag.tag.T_table_tag = unpacked<frame::Table, frame::Tag>(pose);
    tag.covariance = covariances->at(id);
    tag.frames = seen[id];
    result.tags.push_back(tag);
  }
  for (const auto& [id, count] : seen) {
    if (survey.tags.count(id) == 0)
      result.left_out.push_back(
          fmt::format("tag {}: seen in {} frames, never with others that are "
                      "placed",
                      id, count));
  }
  for (const int id : without_size)
    result.left_out.push_back(fmt::format("tag {}: has no size", id));
  // The plane that fits the centres best.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const SurveyedTag& tag : result.tags) middle += tag.tag.T_table_tag.translation();
  middle /= static_cast<double>(result.tags.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const SurveyedTag& tag : result.tags) {
    const Eigen::Vector3d d = tag.tag.T_table_tag.translation() - middle;
    scatter += d * d.transpose() / static_cast<double>(result.tags.size());
  }
  if (result.tags.size() >= 3) {
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(scatter);
    result.flatness_m = std::sqrt(std::max(eigen.eigenvalues()[0], 0.0));
    result.plane_tilt_rad = std::acos(std::min(1.0, std::abs(eigen.eigenvectors()(2, 0))));
  }
  return result;
}

Result<void> save_tag_survey(const std::filesystem::path& file, const TagSurvey& survey) {
  std::string text =
      "# Tag frame: origin at the tag's centre, x right and y up on the upright printed tag, z out "
      "of\n# the paper. size_m: edge of the black border's outer square. position, "
      "quaternion_xyzw: the tag\n# frame in the table frame. covariance: of [position; rotation] "
      "about table axes [m, rad], row by\n# row.\ntags:\n";
  for (const SurveyedTag& tag : survey.tags) {
    const Eigen::Vector3d& p = tag.tag.T_table_tag.translation();
    const Eigen::Quaterniond& q = tag.tag.T_table_tag.rotation();
    const Eigen::Matrix<double, 6, 6, Eigen::RowMajor> covariance = tag.covariance;
    text += fmt::format(
        "  - {{id: {}, family: {}, size_m: {}, position: [{}, {}, {}], "
        "quaternion_xyzw: [{}, {}, {}, {}],\n     covariance: [{}]}}\n",
        tag.tag.id, to_string(tag.tag.family), tag.tag.size_m, p.x(), p.y(), p.z(), q.x(), q.y(),
        q.z(), q.w(),
        joined({covariance.data(), static_cast<std::size_t>(covariance.size())}, "{:.6g}"));
  }
  return write_text_file(file, text);
}

Result<std::map<int, double>> load_tag_sizes(const std::filesystem::path& file) {
  const Result<YAML::Node> root = load_yaml_map(file);
  if (!root) return tl::unexpected(root.error());
  try {
    std::map<int, double> sizes;
    if (YamlFields(*root, file.string()).has("tags")) {
      const Result<TagMap> map = load_tag_map(file);
      if (!map) return tl::unexpected(map.error());
      for (const MappedTag& tag : map->tags()) sizes[tag.id] = tag.size_m;
      return sizes;
    }
    for (const auto& entry : *root) {
      const std::string key = entry.first.IsScalar() ? entry.first.Scalar() : "";
      const std::int64_t id = parse_integer(key).value_or(-1);
      const double size =
          entry.second.IsScalar() ? parse_number(entry.second.Scalar()).value_or(0.0) : 0.0;
      if (id < 0 || id > 1'000'000 || !(size >= 0.001 && size <= 10.0)) {
        return fail("{}: line {}: is no tag's size; give ID: METRES (0.001 to 10)", file.string(),
                    entry.first.Mark().line + 1);
      }
      sizes[static_cast<int>(id)] = size;
    }
    if (sizes.empty()) return fail("{}: names no tag; give lines of ID: METRES", file.string());
    return sizes;
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as sizes of tags ({}); correct the file", file.string(),
                error.what());
  }
}

}  // namespace penumbra
