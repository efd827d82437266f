#include "calib/survey/table_plane.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "core/units.hpp"
#include "tracking/math/se3.hpp"

namespace penumbra {
namespace {

constexpr double kMaxTilt = radians(6.0);  // maximum angle between tags of one table
constexpr double kMaxHeightRatio = 0.03;   // maximum height over the plane / tag size

// The plane through the centres of the tags on the table, in the anchor's frame.
struct TablePlane {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();  // rotation from anchor to table axes
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();    // table origin in the anchor's frame [m]
};

TablePlane plane_through(const Eigen::Matrix3Xd& centres) {
  const Eigen::Vector3d middle = centres.rowwise().mean();
  const Eigen::Matrix3Xd d = centres.colwise() - middle;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(d * d.transpose());
  Eigen::Vector3d z = eigen.eigenvectors().col(0);
  if (z.z() < 0.0) z = -z;
  TablePlane plane;
  const Eigen::Vector3d x = (Eigen::Vector3d::UnitX() - z.x() * z).normalized();
  plane.turn.row(0) = x.transpose();
  plane.turn.row(1) = z.cross(x).transpose();
  plane.turn.row(2) = z.transpose();
  plane.origin = z.dot(middle) * z;
  return plane;
}

}  // namespace

std::vector<int> tags_on_table(const std::map<int, TagPose>& tags, const SurveyOptions& options) {
  const int anchor = options.anchor;
  if (options.plane == SurveyPlane::anchor) return {anchor};
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d on_plane = Eigen::Vector3d::Zero();
  double slack = std::tan(kMaxTilt);  // tolerance for the error of the normal
  std::vector<int> members;
  for (int round = 0; round < 4; ++round) {
    members.clear();
    for (const auto& [id, pose] : tags) {
      const Eigen::Vector3d d = pose.translation() - on_plane;
      const double facing = (pose.rotation() * Eigen::Vector3d::UnitZ()).dot(normal);
      const double limit = kMaxHeightRatio * options.size_m(id) + slack * d.norm();
      if (facing > std::cos(kMaxTilt) && std::abs(normal.dot(d)) < limit) members.push_back(id);
    }
    if (members.size() < 3) return {anchor};
    Eigen::Matrix3Xd centres(3, members.size());
    for (std::size_t i = 0; i < members.size(); ++i)
      centres.col(static_cast<Eigen::Index>(i)) = tags.at(members[i]).translation();
    const Eigen::Matrix3Xd around = centres.colwise() - centres.rowwise().mean();
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(around * around.transpose());
    // Collinear tags do not define a plane.
    if (eigen.eigenvalues()[1] < std::pow(0.5 * options.size_m(anchor), 2)) return {anchor};
    const TablePlane plane = plane_through(centres);
    normal = plane.turn.row(2).transpose();
    on_plane = plane.origin;
    slack = 0.0;
  }
  return members;
}

void transform_to_plane(TagSurvey& survey, const std::map<int, TagPose>& tags,
                        const GraphCovariance& found, const std::vector<int>& on_plane,
                        int anchor) {
  const auto n = static_cast<Eigen::Index>(tags.size());
  Eigen::Matrix3Xd centres(3, n);
  std::vector<Eigen::Index> members;  // columns of `centres`
  std::vector<int> ids;
  for (const auto& [id, pose] : tags) {
    const auto column = static_cast<Eigen::Index>(ids.size());
    centres.col(column) = pose.translation();
    if (std::ranges::binary_search(on_plane, id)) members.push_back(column);
    ids.push_back(id);
  }
  const bool is_fitted = on_plane.size() >= 3;
  const auto plane_of = [&](const Eigen::Matrix3Xd& at) {
    return is_fitted ? plane_through(at(Eigen::all, members)) : TablePlane{};
  };
  const TablePlane plane = plane_of(centres);
  const Transform<frame::Table, frame::Table> T_table_anchor(plane.turn,
                                                             -(plane.turn * plane.origin));
  // Derivative of the table frame's [rotation; origin], in its axes, with respect to the centres.
  Eigen::MatrixXd plane_jacobian = Eigen::MatrixXd::Zero(6, 3 * n);
  for (Eigen::Index c = 0; is_fitted && c < 3 * n; ++c) {
    constexpr double kStep = 1e-6;  // [m]
    if (ids[static_cast<std::size_t>(c / 3)] == anchor) continue;
    Eigen::Matrix3Xd after = centres;
    Eigen::Matrix3Xd before = centres;
    after(c % 3, c / 3) += kStep;
    before(c % 3, c / 3) -= kStep;
    const TablePlane a = plane_of(after);
    const TablePlane b = plane_of(before);
    const Eigen::Matrix3d W = (a.turn - b.turn) * plane.turn.transpose() / (2.0 * kStep);
    plane_jacobian.col(c).head<3>() = Eigen::Vector3d(W(2, 1), W(0, 2), W(1, 0));
    plane_jacobian.col(c).tail<3>() = plane.turn * (a.origin - b.origin) / (2.0 * kStep);
  }
  // First row of a tag in the covariance; the anchor has none.
  const auto row_of = [&](int id) -> std::optional<Eigen::Index> {
    const auto at = std::ranges::find(found.ids, id);
    if (at == found.ids.end()) return std::nullopt;
    return 6 * (at - found.ids.begin());
  };
  double heights = 0.0;
  for (Eigen::Index i = 0; i < n; ++i) {
    SurveyedTag& tag = survey.tags[static_cast<std::size_t>(i)];
    tag.tag.T_table_tag = T_table_anchor * tags.at(tag.tag.id);
    const Eigen::Vector3d p = tag.tag.T_table_tag.translation();
    if (std::ranges::binary_search(on_plane, tag.tag.id)) heights += p.z() * p.z();
    // d tag / d positions: motions of the table frame, then the tag's motion in the anchor's frame.
    Eigen::MatrixXd J = Eigen::MatrixXd::Zero(6, found.tags.cols());
    for (Eigen::Index k = 0; k < n; ++k) {
      const auto row = row_of(ids[static_cast<std::size_t>(k)]);
      if (!row) continue;
      const Eigen::MatrixXd turned = plane_jacobian.block(0, 3 * k, 3, 3);
      J.block(0, *row, 3, 3) = -skew(p) * turned - plane_jacobian.block(3, 3 * k, 3, 3);
      J.block(3, *row, 3, 3) = turned;
    }
    if (const auto tag_row = row_of(tag.tag.id)) {
      J.block(0, *tag_row, 3, 3) += plane.turn;
      J.block(3, *tag_row + 3, 3, 3) += plane.turn;
    }
    tag.covariance = J * found.tags * J.transpose();
  }
  for (auto& camera : survey.cameras) {
    if (camera) camera = T_table_anchor * *camera;
  }
  survey.tags_on_plane = static_cast<int>(on_plane.size());
  survey.flatness_m = std::sqrt(heights / static_cast<double>(on_plane.size()));
  survey.plane_tilt_rad = std::acos(std::min(1.0, plane.turn(2, 2)));
}

}  // namespace penumbra
