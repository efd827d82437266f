// Tracked poses -> TUM file.
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
  // `all`: uncertain and held poses too, each after a comment line ("# uncertain: reason"), so that
  // pose lines keep eight columns. `what`: the pose's name in the file's first line.
  [[nodiscard]] static Result<PoseWriter> create(const std::filesystem::path& file, bool all,
                                                 std::string_view what = "T_table_camera");

  // Only tracked poses are written, unless `all`; lost ones never.
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, const PoseEstimate& pose);
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, const GroupEstimate& group);
  [[nodiscard]] Result<void> finish();
  // After an error: keeps the complete lines written before.
  void rescue();

 private:
  PoseWriter(OutputFile file, bool all) : file_(std::move(file)), all_(all) {}
  [[nodiscard]] Result<void> write(std::int64_t timestamp_ns, TrackStatus status,
                                   const std::string& reason, const CameraPose& pose);
  OutputFile file_;
  bool all_ = false;
};

}  // namespace penumbra
