#include "app/output/pose_writer.hpp"

#include <utility>

#include "core/trajectory.hpp"

namespace penumbra {

PoseWriter::PoseWriter(OutputFile file, bool all)
    : file_(std::move(file)), stream_(file_.partial(), std::ios::out | std::ios::trunc), all_(all) {
  stream_ << "# timestamp tx ty tz qx qy qz qw (T_table_camera, seconds and metres)\n";
}

Result<PoseWriter> PoseWriter::create(const std::filesystem::path& file, bool all) {
  auto output = OutputFile::create(file);
  if (!output) return tl::unexpected(output.error());
  PoseWriter writer(std::move(*output), all);
  writer.stream_.flush();
  if (!writer.stream_) {
    return fail("{}: cannot be written; free some space or choose another place", file.string());
  }
  return writer;
}

Result<void> PoseWriter::write(std::int64_t timestamp_ns, const PoseEstimate& pose) {
  const bool tracked = pose.status == TrackStatus::tracked;
  if (!pose.has_pose() || (!tracked && !all_)) return {};
  if (!tracked) {
    stream_ << "# " << to_string(pose.status);
    if (!pose.reason.empty()) stream_ << ": " << pose.reason;
    stream_ << '\n';
  }
  stream_ << format_tum({timestamp_ns, pose.T_table_camera, {}}) << '\n' << std::flush;
  if (!stream_) {
    return fail("{}: cannot be written; free some space or choose another place",
                file_.target().string());
  }
  return {};
}

Result<void> PoseWriter::finish() {
  stream_.close();
  if (!stream_) {
    return fail("{}: cannot be written; free some space or choose another place",
                file_.target().string());
  }
  return file_.commit();
}

}  // namespace penumbra
