// Writes poses to a TUM file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

#include "app/output/output_file.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/pose_estimate.hpp"

namespace penumbra {

class PoseWriter {
 public:
  // `all`: also writes uncertain and held poses, each after a comment line ("# uncertain: reason"),
  // so that pose lines keep eight columns. `what`: name of the pose in the file's first line.
  [[nodiscard]] static Result<PoseWriter> create(const std::filesystem::path& file, bool all,
                                                 std::string_view what = "T_table_camera");

  // Writes tracked poses; with `all`, also uncertain and held ones. Ignores lost frames.
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, const PoseEstimate& pose);
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, const GroupEstimate& group);
  [[nodiscard]] Result<void> finish();
  // Call this after an error. Keeps the complete lines written before.
  void rescue();

 private:
  PoseWriter(OutputFile file, bool all) : file_(std::move(file)), all_(all) {}
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, TrackStatus status,
                                   const PoseReason& reason, const CameraPose& pose);
  OutputFile file_;
  bool all_ = false;
};

}  // namespace penumbra
