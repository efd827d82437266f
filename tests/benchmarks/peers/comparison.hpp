// One method after the other over the same frames: time and error of each.
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

// Frames in memory, grey levels and times, and what is known of them.
struct Footage {
  std::string name;
  CameraModel camera;
  TagMap tags;
  Trajectory truth;
  std::vector<Frame> frames;
};

struct Found {
  CameraPose T_table_camera;
  bool tracked = true;  // false: our own tracker calls it uncertain or held
};

// Stateful: frames come in order, a new one for each run.
using Method = std::function<std::optional<Found>(const Frame&)>;
struct NamedMethod {
  std::string name;
  bool ours = false;
  std::function<Method()> make;  // null where the library is not there
};

// Our tracker in three modes, libapriltag (decimate 1 and 2, pose by PnP and by our own
// refinement), OpenCV's aruco, ViSP.
[[nodiscard]] std::vector<NamedMethod> all_methods(const CameraModel& camera, const TagMap& tags);

struct Outcome {
  std::string name;
  bool ours = false;
  std::vector<double> ms;          // CPU time of every frame, the least of the repetitions
  std::vector<double> overlay_px;  // of every frame that counts as tracked; negative for the others
  std::vector<CameraPose> poses;   // of every frame; identity where there is none
  std::vector<bool> posed;
  Evaluation evaluation;  // of the tracked frames
  int tracked = 0;
  int wrong = 0;  // tracked, and more than 5 px off
  int flips = 0;  // nearer to the truth mirrored at the line of sight, and more than 1 px off

  [[nodiscard]] double median_ms() const;
  [[nodiscard]] double mean_ms() const;
  [[nodiscard]] int within(double px) const;  // tracked frames that are nearer
  [[nodiscard]] int beyond(double px) const;  // tracked frames that are further off
  // Frames' RMS over the tracked ones.
  [[nodiscard]] double largest_px() const;
};

// Runs all methods `repetitions` times in turn. Error columns need the footage's truth.
[[nodiscard]] std::vector<Outcome> compare(const Footage& footage,
                                           const std::vector<NamedMethod>& methods,
                                           int repetitions);

// The named one; there must be one.
[[nodiscard]] const Outcome& outcome_of(const std::vector<Outcome>& outcomes,
                                        std::string_view name);

inline constexpr std::string_view kFast = "penumbra fast";
inline constexpr std::string_view kAccurate = "penumbra accurate";
inline constexpr std::string_view kAuto = "penumbra auto";
inline constexpr std::string_view kDecimate1 = "libapriltag d1 + PnP";
inline constexpr std::string_view kDecimate1Ours = "libapriltag d1 + our pose";
inline constexpr std::string_view kDecimate2 = "libapriltag d2 + PnP";

// visp-rbt-sequence: a folder of frames/NNNN.png, cam.json, apriltag_data.json. The tags' places
// and the reference's poses, in `truth`, are those of a bundle adjustment over the points inside
// the tags where four cells meet (saddle_points.hpp); libapriltag's corners only say where to look.
struct RealVideo {
  Footage footage;
  std::vector<std::vector<PointObservation>> corners;  // by libapriltag, decimate 1; per frame
  int tags = 0;
  double rms_px = 0.0;  // of the adjustment
};
[[nodiscard]] Result<RealVideo> load_real_video(const std::filesystem::path& folder);

}  // namespace penumbra::peers
