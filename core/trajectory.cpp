#include "core/trajectory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>

#include "core/assert.hpp"
#include "core/text.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kLargestFile = std::size_t{256} << 20U;

constexpr std::array<std::string_view, 8> kColumns = {"timestamp", "tx", "ty", "tz",
                                                      "qx",        "qy", "qz", "qw"};

// "timestamp tx ty tz qx qy qz qw"; the error has no place in front yet.
Result<StampedPose> parse_pose(std::string_view text) {
  std::array<std::string_view, 8> fields;
  std::size_t count = 0;
  constexpr std::string_view kBlank = " \t\r\v\f";
  while (true) {
    const std::size_t start = text.find_first_not_of(kBlank);
    if (start == std::string_view::npos) break;
    text.remove_prefix(start);
    const std::size_t length = std::min(text.find_first_of(kBlank), text.size());
    if (count < fields.size()) fields[count] = text.substr(0, length);
    ++count;
    text.remove_prefix(length);
  }
  if (count != fields.size()) {
    return fail("has {} values; write the 8 of a TUM line, timestamp tx ty tz qx qy qz qw", count);
  }
  StampedPose pose;
  const std::optional<std::int64_t> time = parse_seconds_as_ns(fields[0]);
  if (!time)
    return fail("timestamp: '{}' is no time; give it in seconds, as a decimal number", fields[0]);
  pose.timestamp_ns = *time;
  std::array<double, 8> values{};
  for (std::size_t i = 1; i < fields.size(); ++i) {
    const std::optional<double> value = parse_number(fields[i]);
    if (!value || !std::isfinite(*value)) {
      return fail("{}: '{}' is no finite number; leave out frames that have no pose", kColumns[i],
                  fields[i]);
    }
    // Farther than the Moon is a slip of units, and its squares leave the range of numbers.
    constexpr double kFarthest_m = 1e9;
    if (i <= 3 && std::abs(*value) > kFarthest_m) {
      return fail("{}: {} is no position in metres; give metres in the table's frame", kColumns[i],
                  fields[i]);
    }
    values[i] = *value;
  }
  const Eigen::Quaterniond rotation(values[7], values[4], values[5], values[6]);
  const double norm = rotation.norm();
  if (!(std::abs(norm - 1.0) <= 1e-3)) {
    return fail("qx qy qz qw: the quaternion has length {:.6g}, so it is no rotation; it must be 1",
                norm);
  }
  pose.T_table_camera = CameraPose(rotation, Eigen::Vector3d(values[1], values[2], values[3]));
  return pose;
}

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& rotation) {
  const Eigen::AngleAxisd turn(rotation.w() < 0.0 ? Eigen::Quaterniond(-rotation.coeffs())
                                                  : rotation);
  return turn.angle() * turn.axis();
}

Eigen::Quaterniond turned_by(const Eigen::Vector3d& vector) {
  const double angle = vector.norm();
  if (angle < 1e-12) return Eigen::Quaterniond::Identity();
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, vector / angle));
}

// Change of the rotation vector v while exp(v) turns at the body's rate `omega`: the inverse of the
// right Jacobian of SO(3) (Chirikjian, Stochastic Models II, 10.86).
Eigen::Vector3d rate_of_vector(const Eigen::Vector3d& v, const Eigen::Vector3d& omega) {
  const double angle = v.norm();
  const double factor = angle < 1e-4 ? 1.0 / 12.0
                                     : 1.0 / (angle * angle) - (1.0 + std::cos(angle)) /
                                                                   (2.0 * angle * std::sin(angle));
  const Eigen::Matrix3d W = skew(v);
  return omega + 0.5 * (W * omega) + factor * (W * (W * omega));
}

struct Velocity {
  Eigen::Vector3d linear = Eigen::Vector3d::Zero();   // [m/s], table frame
  Eigen::Vector3d angular = Eigen::Vector3d::Zero();  // [rad/s], camera frame
};

// Between the neighbours of a pose, or between an end and its only one.
Velocity velocity_at(const std::vector<StampedPose>& poses, std::size_t i) {
  const StampedPose& before = poses[i > 0 ? i - 1 : i];
  const StampedPose& after = poses[std::min(i + 1, poses.size() - 1)];
  const double gap_s = seconds(after.timestamp_ns - before.timestamp_ns);
  if (!(gap_s > 0.0)) return {};
  return {(after.T_table_camera.translation() - before.T_table_camera.translation()) / gap_s,
          rotation_vector(before.T_table_camera.rotation().conjugate() *
                          after.T_table_camera.rotation()) /
              gap_s};
}

CameraPose continued(const CameraPose& pose, const Velocity& velocity, double ahead_s) {
  return {pose.rotation() * turned_by(ahead_s * velocity.angular),
          pose.translation() + ahead_s * velocity.linear};
}

}  // namespace

CameraPose pose_between(const Trajectory& trajectory, std::int64_t timestamp_ns) {
  const std::vector<StampedPose>& poses = trajectory.poses;
  PENUMBRA_ASSERT(!poses.empty());
  const auto later = std::upper_bound(
      poses.begin(), poses.end(), timestamp_ns,
      [](std::int64_t time, const StampedPose& pose) { return time < pose.timestamp_ns; });
  if (later == poses.begin() || later == poses.end()) {
    const std::size_t end = later == poses.begin() ? 0 : poses.size() - 1;
    return continued(poses[end].T_table_camera, velocity_at(poses, end),
                     seconds(timestamp_ns - poses[end].timestamp_ns));
  }
  const auto i = static_cast<std::size_t>(later - poses.begin()) - 1;
  const CameraPose& begin = poses[i].T_table_camera;
  const CameraPose& end = poses[i + 1].T_table_camera;
  const double gap_s = seconds(poses[i + 1].timestamp_ns - poses[i].timestamp_ns);
  const double u = seconds(timestamp_ns - poses[i].timestamp_ns) / gap_s;
  const Velocity v0 = velocity_at(poses, i);
  const Velocity v1 = velocity_at(poses, i + 1);
  // Hermite's cubic from 0 to `whole`.
  const auto cubic = [&](const Eigen::Vector3d& whole, const Eigen::Vector3d& rate0,
                         const Eigen::Vector3d& rate1) -> Eigen::Vector3d {
    return u * u * (3.0 - 2.0 * u) * whole +
           gap_s * (u * (1.0 - u) * (1.0 - u) * rate0 - u * u * (1.0 - u) * rate1);
  };
  const Eigen::Vector3d turn = rotation_vector(begin.rotation().conjugate() * end.rotation());
  // Half a turn and more from one pose to the next has no velocity to speak of.
  constexpr double kMostTurn = 2.5;
  const Eigen::Vector3d vector = turn.norm() < kMostTurn
                                     ? cubic(turn, v0.angular, rate_of_vector(turn, v1.angular))
                                     : Eigen::Vector3d(u * turn);
  return {
      begin.rotation() * turned_by(vector),
      begin.translation() + cubic(end.translation() - begin.translation(), v0.linear, v1.linear)};
}

const StampedPose* Trajectory::at(std::int64_t timestamp_ns, std::int64_t tolerance_ns) const {
  const auto after = std::lower_bound(
      poses.begin(), poses.end(), timestamp_ns,
      [](const StampedPose& pose, std::int64_t time) { return pose.timestamp_ns < time; });
  const auto distance = [&](const StampedPose& pose) {
    // unsigned: any two times have a distance
    return pose.timestamp_ns > timestamp_ns ? static_cast<std::uint64_t>(pose.timestamp_ns) -
                                                  static_cast<std::uint64_t>(timestamp_ns)
                                            : static_cast<std::uint64_t>(timestamp_ns) -
                                                  static_cast<std::uint64_t>(pose.timestamp_ns);
  };
  const StampedPose* best = nullptr;
  if (after != poses.end()) best = &*after;
  if (after != poses.begin() && (best == nullptr || distance(*(after - 1)) <= distance(*best)))
    best = &*(after - 1);
  if (best == nullptr || tolerance_ns < 0 ||
      distance(*best) > static_cast<std::uint64_t>(tolerance_ns))
    return nullptr;
  return best;
}

Result<Trajectory> load_trajectory(const std::filesystem::path& file) {
  const Result<std::string> text = read_text_file(file, kLargestFile);
  if (!text) return tl::unexpected(text.error());
  Trajectory trajectory;
  std::string_view rest = *text;
  for (int line = 1; !rest.empty(); ++line) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    std::string_view content = rest.substr(0, end);
    rest.remove_prefix(std::min(end + 1, rest.size()));
    std::string comment;
    if (const std::size_t hash = content.find('#'); hash != std::string_view::npos) {
      comment = trim(content.substr(hash + 1));
      content = content.substr(0, hash);
    }
    content = trim(content);
    if (content.empty()) continue;
    Result<StampedPose> pose = parse_pose(content);
    if (!pose) return fail_in(fmt::format("{}: line {}", file.string(), line), pose.error());
    pose->comment = std::move(comment);
    if (!trajectory.poses.empty() && pose->timestamp_ns < trajectory.poses.back().timestamp_ns) {
      return fail("{}: line {}: timestamp: {} s is before the line above; sort the poses by time",
                  file.string(), line, format_ns_as_seconds(pose->timestamp_ns));
    }
    trajectory.poses.push_back(std::move(*pose));
  }
  return trajectory;
}

std::string format_tum(const StampedPose& pose) {
  const Eigen::Vector3d& t = pose.T_table_camera.translation();
  const Eigen::Quaterniond& q = pose.T_table_camera.rotation();
  std::string line = fmt::format("{} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g} {:.17g}",
                                 format_ns_as_seconds(pose.timestamp_ns), t.x(), t.y(), t.z(),
                                 q.x(), q.y(), q.z(), q.w());
  if (!pose.comment.empty()) {
    std::string comment = pose.comment;
    std::replace_if(
        comment.begin(), comment.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
    line += " # " + comment;
  }
  return line;
}

Result<void> save_trajectory(const std::filesystem::path& file, const Trajectory& trajectory) {
  std::string text = "# timestamp tx ty tz qx qy qz qw: T_table_camera, seconds and metres\n";
  for (const StampedPose& pose : trajectory.poses) text += format_tum(pose) + "\n";
  return write_text_file(file, text);
}

}  // namespace penumbra
