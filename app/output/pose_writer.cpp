#include "app/output/pose_writer.hpp"

#include <utility>

#include "core/text.hpp"
#include "core/trajectory.hpp"

namespace penumbra {

PoseWriter::PoseWriter(OutputFile file, bool all, std::string_view what)
    : file_(std::move(file)), stream_(file_.partial(), std::ios::out | std::ios::trunc), all_(all) {
  stream_ << "# timestamp tx ty tz qx qy qz qw (" << what << ", seconds and metres)\n";
}

Result<PoseWriter> PoseWriter::create(const std::filesystem::path& file, bool all,
                                      std::string_view what) {
  auto output = OutputFile::create(file);
  if (!output) return tl::unexpected(output.error());
  PoseWriter writer(std::move(*output), all, what);
  writer.stream_.flush();
  if (!writer.stream_) {
    return fail("{}: cannot be written; free some space or choose another place", file.string());
  }
  return writer;
}

Result<void> PoseWriter::write(std::int64_t timestamp_ns, const PoseEstimate& pose) {
  return write(timestamp_ns, pose.status, pose.reason, pose.T_table_camera);
}

Result<void> PoseWriter::write(std::int64_t timestamp_ns, const GroupEstimate& group) {
  return write(timestamp_ns, group.status, group.reason,
               {group.T_table_group.rotation(), group.T_table_group.translation()});
}

Result<void> PoseWriter::write(std::int64_t timestamp_ns, TrackStatus status,
                               const std::string& reason, const CameraPose& pose) {
  const bool tracked = status == TrackStatus::tracked;
  if (status == TrackStatus::lost || (!tracked && !all_)) return {};
  if (!tracked) {
    stream_ << "# " << to_string(status);
    if (!reason.empty()) stream_ << ": " << reason;
    stream_ << '\n';
  }
  stream_ << format_tum({timestamp_ns, pose, {}}) << '\n' << std::flush;
  if (!stream_) {
    return fail("{}: cannot be written; free some space or choose another place",
                file_.target().string());
  }
  return {};
}

void PoseWriter::rescue() {
  stream_.close();
  constexpr std::size_t kMostBytes = 4'000'000'000;
  const auto text = read_text_file(file_.partial(), kMostBytes);
  const std::size_t end = text ? text->rfind('\n') : std::string::npos;
  if (end == std::string::npos) return;
  std::error_code error;
  std::filesystem::resize_file(file_.partial(), end + 1, error);
  if (!error) (void)file_.commit();
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
