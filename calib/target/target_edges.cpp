#include "calib/target/target_edges.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <vector>

namespace penumbra {
namespace {

constexpr double kMinNormalsDet = 0.2;  // minimum |determinant| of a corner's two unit normals

// Offsets of a straight board edge from its predicted curve, along the normals [px].
struct FollowedEdge {
  double at_begin = 0.0;
  double at_middle = 0.0;
  double at_end = 0.0;
  Eigen::Vector2d normal_begin;
  Eigen::Vector2d normal_middle;
  Eigen::Vector2d normal_end;
};

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  return a.x() * b.y() - a.y() * b.x();
}

// Follows the edge from a to b [m, board frame] within `reach` px of its curve. A straight line
// would ignore the distortion (0.1 px for the tags of a webcam). Normals point away from
// `away_from` [px]. `alternates`: black and white swap sides in the middle, so that an edge shift
// moves the halves in opposite directions; otherwise normals point to white. Returns nullopt if
// less than half of the edge is found.
std::optional<FollowedEdge> follow_edge(ImageView luma, const CameraModel& camera,
                                        const CameraFromBoard& T_camera_board,
                                        const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                        const Eigen::Vector2d& away_from, double reach,
                                        bool alternates) {
  struct EdgePoint {
    double t = 0.0;  // -0.5 at a, 0.5 at b
    Eigen::Vector2d p;
    Eigen::Vector2d normal;
  };
  const auto point_at = [&](double t) -> std::optional<EdgePoint> {
    const auto p = camera.project(T_camera_board * Eigen::Vector3d(a + (t + 0.5) * (b - a)));
    const auto q = camera.project(T_camera_board * Eigen::Vector3d(a + (t + 0.51) * (b - a)));
    if (!p || !q || !((*q - *p).norm() > 1e-6)) return std::nullopt;
    Eigen::Vector2d normal(-(*q - *p).y(), (*q - *p).x());
    normal.normalize();
    if (normal.dot(*p - away_from) < 0.0) normal = -normal;
    return EdgePoint{t, *p, normal};
  };
  const auto begin = point_at(-0.5);
  const auto middle = point_at(0.0);
  const auto end = point_at(0.49);
  if (!begin || !middle || !end) return std::nullopt;
  const double length = (end->p - begin->p).norm();
  if (reach < 1.2 || length < 8.0) return std::nullopt;
  const double corner = std::clamp(1.5 * reach / length, 0.04, 0.2);  // blur rounds the corners
  const int count = std::clamp(static_cast<int>(length), 10, 80);
  std::vector<EdgePoint> points;
  for (int k = 0; k < count; ++k) {
    const double t = (k + 0.5) / count - 0.5;
    if (std::abs(t) > 0.5 - corner || (alternates && std::abs(t) < corner)) continue;
    const auto point = point_at(t);
    if (!point) return std::nullopt;
    points.push_back(*point);
  }
  // Robust line fit: offset = x0 + x1 t + x2 sign(t).
  Eigen::Vector3d x = Eigen::Vector3d::Zero();
  for (int round = 0; round < 5; ++round) {
    Eigen::Matrix3d A = Eigen::Vector3d(0.0, 1e-9, alternates ? 1e-9 : 1.0).asDiagonal();
    Eigen::Vector3d rhs = Eigen::Vector3d::Zero();
    std::size_t used = 0;
    for (const EdgePoint& point : points) {
      const Eigen::Vector3d basis(1.0, point.t, !alternates ? 0.0 : point.t < 0.0 ? -1.0 : 1.0);
      const double expected = basis.dot(x);
      const auto offset = find_edge(luma, {point.p, point.normal, expected, reach,
                                           round < 2 ? 0.6 * reach : std::min(0.6 * reach, 1.2),
                                           alternates ? std::nullopt : std::optional(1.0), 10.0});
      if (!offset) continue;
      const double weight = round == 0 ? 1.0 : 1.0 / (1.0 + 4.0 * *offset * *offset);
      A += weight * basis * basis.transpose();
      rhs += weight * (expected + *offset) * basis;
      ++used;
    }
    if (2 * used < points.size() || used < 6) return std::nullopt;
    x = A.ldlt().solve(rhs);
    if (!x.allFinite() || x.cwiseAbs().maxCoeff() > 6.0) return std::nullopt;
  }
  return FollowedEdge{x[0] - 0.5 * x[1], x[0],           x[0] + 0.5 * x[1],
                      begin->normal,     middle->normal, end->normal};
}

}  // namespace

bool is_inside(ImageView luma, const Eigen::Vector2d& p, double margin) {
  return p.x() >= margin && p.y() >= margin && p.x() <= luma.width - 1 - margin &&
         p.y() <= luma.height - 1 - margin;
}

std::array<Eigen::Vector2d, 4> edge_spreads(const std::array<Eigen::Vector2d, 4>& corners) {
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
    spreads[i] = std::abs(normals.determinant()) < kMinNormalsDet
                     ? Eigen::Vector2d(Eigen::Vector2d::Zero())
                     : Eigen::Vector2d(normals.inverse() * Eigen::Vector2d::Ones());
  }
  return spreads;
}

std::optional<double> find_edge(ImageView luma, const EdgeSearch& search) {
  constexpr double kStep = 0.25;  // [px]
  const int steps = static_cast<int>(search.reach / kStep);
  std::array<double, 64> values{};
  for (int s = 0; s <= 2 * steps + 1; ++s) {
    const double across = search.expected + (s - steps - 0.5) * kStep;
    const auto value = sample_luma(luma, search.pixel + across * search.normal);
    if (!value) return std::nullopt;
    values[static_cast<std::size_t>(s)] = *value;
  }
  const double total_change = values[static_cast<std::size_t>(2 * steps + 1)] - values[0];
  const double polarity = search.polarity.value_or(total_change < 0.0 ? -1.0 : 1.0);
  double mass = 0.0;
  double moment = 0.0;
  for (int s = 0; s <= 2 * steps; ++s) {
    const double rise =
        polarity * (values[static_cast<std::size_t>(s + 1)] - values[static_cast<std::size_t>(s)]);
    if (rise <= 0.0) continue;  // a change of opposite sign belongs to another edge
    const double at = (s - steps) * kStep;
    const double weight = rise * std::exp(-0.5 * at * at / (search.width * search.width));
    mass += weight;
    moment += weight * at;
  }
  if (mass < search.min_change) return std::nullopt;
  // The window biases the centroid towards its centre; this corrects it for a blur of sigma 0.8 px.
  const double offset = moment / mass * (1.0 + 0.64 / (search.width * search.width));
  if (!(std::abs(offset) < search.reach)) return std::nullopt;
  return offset;
}

std::optional<std::array<Eigen::Vector2d, 4>> follow_tag(
    ImageView luma, const CameraModel& camera, const CameraFromBoard& T_camera_board,
    const std::array<Eigen::Vector3d, 4>& corners, int cells) {
  std::array<Eigen::Vector2d, 4> predicted;
  for (std::size_t i = 0; i < 4; ++i) {
    const auto pixel = camera.project(T_camera_board * corners[i]);
    if (!pixel || !is_inside(luma, *pixel, kCornerBorder)) return std::nullopt;
    predicted[i] = *pixel;
  }
  const Eigen::Vector2d centre = 0.25 * (predicted[0] + predicted[1] + predicted[2] + predicted[3]);
  std::array<FollowedEdge, 4> sides;
  for (std::size_t i = 0; i < 4; ++i) {
    // The black border is one cell wide.
    const Eigen::Vector2d along = predicted[(i + 1) % 4] - predicted[i];
    double cell = 1e9;
    for (const std::size_t k : {(i + 2) % 4, (i + 3) % 4}) {
      const Eigen::Vector2d d = predicted[k] - predicted[i];
      cell = std::min(cell, std::abs(cross(along, d)) / along.norm() / cells);
    }
    const auto side = follow_edge(luma, camera, T_camera_board, corners[i], corners[(i + 1) % 4],
                                  centre, std::min(0.75 * cell, 4.0), false);
    if (!side) return std::nullopt;
    sides[i] = *side;
  }
  std::array<Eigen::Vector2d, 4> found;
  for (std::size_t i = 0; i < 4; ++i) {
    const FollowedEdge& before = sides[(i + 3) % 4];
    const FollowedEdge& after = sides[i];
    Eigen::Matrix2d normals;
    normals.row(0) = before.normal_end.transpose();
    normals.row(1) = after.normal_begin.transpose();
    if (std::abs(normals.determinant()) < kMinNormalsDet) return std::nullopt;
    found[i] = predicted[i] + normals.inverse() * Eigen::Vector2d(before.at_end, after.at_begin);
  }
  return found;
}

std::optional<Eigen::Vector2d> follow_crossing(ImageView luma, const CameraModel& camera,
                                               const CameraFromBoard& T_camera_board,
                                               const Eigen::Vector3d& corner, double arm_m,
                                               double clearance_m) {
  const auto predicted = camera.project(T_camera_board * corner);
  if (!predicted || !is_inside(luma, *predicted, kCornerBorder)) return std::nullopt;
  Eigen::Matrix2d normals;
  Eigen::Vector2d offsets;
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector3d x = axis == 0 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
    const Eigen::Vector3d y = axis == 0 ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
    const auto away = camera.project(T_camera_board * Eigen::Vector3d(corner - clearance_m * y));
    const auto along = camera.project(T_camera_board * Eigen::Vector3d(corner + arm_m * x));
    if (!away || !along) return std::nullopt;
    const Eigen::Vector2d e = *along - *predicted;
    const double clearance = std::abs(cross(e, *away - *predicted)) / e.norm();
    const auto edge = follow_edge(luma, camera, T_camera_board, corner - arm_m * x,
                                  corner + arm_m * x, *away, std::min(clearance, 4.0), true);
    if (!edge) return std::nullopt;
    normals.row(axis) = edge->normal_middle.transpose();
    offsets[axis] = edge->at_middle;
  }
  if (std::abs(normals.determinant()) < kMinNormalsDet) return std::nullopt;
  const Eigen::Vector2d moved = normals.inverse() * offsets;
  if (!(moved.norm() < 5.0)) return std::nullopt;
  return *predicted + moved;
}

}  // namespace penumbra
