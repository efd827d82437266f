#include "core/trajectory.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <string_view>

#include "core/text.hpp"

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

}  // namespace

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
