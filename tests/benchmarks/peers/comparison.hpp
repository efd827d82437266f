// Runs several methods on the same frames and measures the time and error of each.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "benchmarks/peers/peer.hpp"
#include "core/error.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/frame.hpp"

namespace penumbra::peers {

// Frames in memory with grey levels and timestamps, and their reference data.
struct Footage {
  std::string name;
  CameraModel camera;
  TagMap tags;
  Trajectory truth;
  std::vector<Frame> frames;
};

struct Found {
  CameraPose T_table_camera;
  bool tracked = true;  // false if our tracker reports uncertain or coasting (held)
};

// A stateful method that receives frames in order. Each run creates a new method.
using Method = std::function<std::optional<Found>(const Frame&)>;
struct NamedMethod {
  std::string name;
  bool ours = false;
  std::function<Method()> make;  // null if the library is not available
};

// Returns our tracker in three modes, libapriltag (decimate 1 and 2; pose by PnP and by our
// refinement), OpenCV's aruco, and ViSP.
[[nodiscard]] std::vector<NamedMethod> all_methods(const CameraModel& camera, const TagMap& tags);

struct Outcome {
  std::string name;
  bool ours = false;
  std::vector<double> ms;          // CPU time of each frame, minimum of the repetitions
  std::vector<double> overlay_px;  // error of each tracked frame; negative for other frames
  std::vector<CameraPose> poses;   // one per frame; identity without a pose
  std::vector<bool> posed;         // a pose was found for the frame, tracked or not
  Evaluation evaluation;           // over the tracked frames
  int tracked = 0;
  int wrong = 0;  // tracked, with an error above 5 px
  int flips = 0;  // tracked, with the mirrored pose and an error above 1 px

  [[nodiscard]] double median_ms() const;
  [[nodiscard]] double mean_ms() const;
  [[nodiscard]] int within(double px) const;  // number of tracked frames with a smaller error
  [[nodiscard]] int beyond(double px) const;  // number of tracked frames with a larger error
  // Largest RMS error of a tracked frame [px].
  [[nodiscard]] double largest_px() const;
};

// Runs all methods in turn, `repetitions` times. Computes errors only if the footage has truth.
[[nodiscard]] std::vector<Outcome> compare(const Footage& footage,
                                           const std::vector<NamedMethod>& methods,
                                           int repetitions);

// Outcome of the named method, which must exist.
[[nodiscard]] const Outcome& outcome_of(const std::vector<Outcome>& outcomes,
                                        std::string_view name);

inline constexpr std::string_view kFast = "penumbra fast";
inline constexpr std::string_view kAccurate = "penumbra accurate";
inline constexpr std::string_view kAuto = "penumbra auto";
inline constexpr std::string_view kDecimate1 = "libapriltag d1 + PnP";
inline constexpr std::string_view kDecimate1Ours = "libapriltag d1 + our pose";
inline constexpr std::string_view kDecimate2 = "libapriltag d2 + PnP";

// Reads visp-rbt-sequence: a folder with frames/NNNN.png, cam.json and apriltag_data.json. The
// tags' poses and the reference poses in `truth` come from a bundle adjustment over the points
// inside the tags where four cells meet (saddle_points.hpp). libapriltag's corners give only the
// search regions.
struct RealVideo {
  Footage footage;
  std::vector<std::vector<PointObservation>> corners;  // libapriltag's (decimate 1), per frame
  int tags = 0;
  double rms_px = 0.0;  // residual of the bundle adjustment
};
[[nodiscard]] Result<RealVideo> load_real_video(const std::filesystem::path& folder);

}  // namespace penumbra::peers
