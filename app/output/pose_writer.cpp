#include "app/output/pose_writer.hpp"

#include "core/geometry/trajectory.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {

Result<PoseWriter> PoseWriter::create(const std::filesystem::path& file, bool all,
                                      std::string_view what) {
  PENUMBRA_TRY(auto output, OutputFile::create(file));
  PoseWriter writer(std::move(output), all);
  PENUMBRA_TRY_VOID(writer.file_.append(
      fmt::format("# timestamp tx ty tz qx qy qz qw ({}, seconds and metres)\n", what)));
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
                               const PoseReason& reason, const CameraPose& pose) {
  const bool tracked = status == TrackStatus::tracked;
  if (status == TrackStatus::lost || (!tracked && !all_)) return {};
  std::string text;
  if (!tracked) {
    const std::string why = text_of(reason);
    text = fmt::format("# {}{}{}\n", to_string(status), why.empty() ? "" : ": ", why);
  }
  return file_.append(text + format_tum({timestamp_ns, pose, {}}) + "\n");
}

void PoseWriter::rescue() {
  keep_complete_lines(file_);
}

Result<void> PoseWriter::finish() {
  return file_.commit();
}

}  // namespace penumbra
