// Camera poses relative to a table with tags, from images. The methods are in docs/tracking.md.
//
// Table frame: origin at the board's centre, x right, y up on the sheet, z out of the table. Tag
// frame: origin at the tag's centre, x right and y up on the upright tag, z out of the paper.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <penumbra/api.hpp>
#include <penumbra/camera.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <vector>

namespace penumbra::tracking {

using types::CameraModel;
using types::CameraParameters;
using types::DistortionModel;
using types::Image;
using types::ImageView;
using types::Matrix6;
using types::PixelFormat;
using types::Pose;
using types::Vector2;
using types::Vector3;

struct Tag {
  int id = 0;
  // "tag36h11" and other families of AprilTag, or a dictionary of OpenCV ("DICT_4X4_50").
  std::string family = "tag36h11";
  double size_m = 0.0;  // outer edge of the black border, without the white margin
  Pose T_table_tag = {};
  // Tags of one group move as a rigid body. Only the group "table" is fixed to the table frame.
  std::string group = "table";
  // Curvature of the paper, xx, xy and yy [1/m] in the tag frame (docs/calibration.md).
  Vector3 curvature{0.0, 0.0, 0.0};
};

// The tags on the table. Immutable; copies are cheap and share their data.
class PENUMBRA_API TagMap {
 public:
  // Throws for an empty list, an unknown family, a repeated tag, a size that is not positive, or a
  // pose that is not finite or whose quaternion is not of unit length (to 1 %).
  explicit TagMap(const std::vector<Tag>& tags);
  // Reads a tags.yaml (docs/files.md).
  [[nodiscard]] static TagMap load(const std::filesystem::path& file);
  TagMap(const TagMap&);
  TagMap& operator=(const TagMap&);
  ~TagMap();

  // Writes a tags.yaml, from which load() reads the same numbers.
  void save(const std::filesystem::path& file) const;
  [[nodiscard]] std::vector<Tag> tags() const;

 private:
  friend struct Access;
  struct Impl;
  PENUMBRA_LOCAL explicit TagMap(std::shared_ptr<const Impl> impl);
  std::shared_ptr<const Impl> impl_;
};

// How a frame is measured once a pose is known. The option --tracking of the program.
enum class Mode {
  automatic,  // fast while the view moves; accurate if it rests or has fewer than three tags
  fast,       // aligns the tag pattern with a limited number of pixels
  accurate,   // aligns the tag pattern with every pixel at an edge, unless motion blurs the image
  detect,     // detects tags in every frame (libapriltag), less accurate
};

// When a frame is searched for tags that were lost.
enum class Search {
  next_frame,  // the next frame waits for it: results don't depend on timing (the program's replay)
  in_frame,    // the frame waits for it
  when_done,   // another thread searches, and a later frame uses the result (the program's live)
};

struct Options {
  Mode mode = Mode::automatic;
  // Samples pixels until the predicted overlay error is below this [px]; 0: no budget.
  double pose_budget_px = 0.0;
  Search search = Search::next_frame;
  // next_frame: searches in a second thread, with the same results. when_done always has one.
  bool search_thread = false;
  double hold_s = 0.5;  // maximum time to extrapolate a pose without a measurement [s]
  // Groups to track beside the table; nullopt: all groups. They don't change the table's poses.
  std::optional<std::vector<std::string>> groups = {};
};

enum class State {
  tracked,    // verified, with a predicted overlay error (1 sigma) below 2 px
  uncertain,  // the predicted error is larger, or two poses are possible
  held,       // not measured in this frame: extrapolated from the latest motion (coasting)
  lost,       // no pose
};

struct RejectedTag {
  int id = 0;
  std::string reason;  // "tags_left_out": inconsistent with the map; keys as in docs/reports.md
};

// Quality of the pose of the table or of a group.
struct Estimate {
  State state = State::lost;
  std::string reason;  // why the state is not tracked; empty if it is
  // Covariance of the right perturbation T * exp([nu; omega]), [m, rad], in the camera frame, of
  // T_table_camera, or of the camera over a group's middle. Translation first. Meaningless if lost.
  Matrix6 covariance{};
  // Predicted overlay error (1 sigma) [px]: RMS over the corners of a cube of 0.2 m that stands on
  // the table's origin or on the group's middle. Includes the uncertainty of the lens. Meaningless
  // if lost.
  double predicted_overlay_px = 0.0;
  // RMS reprojection error of the tags' corners [px], or its equivalent for their edges; 0 if no
  // tags are used.
  double reprojection_rms_px = 0.0;
  int tags_used = 0;  // 0: not measured in this frame
  std::vector<RejectedTag> tags_rejected;
  double age_s = 0.0;  // since the latest measured pose [s]; 0 unless held

  [[nodiscard]] bool has_pose() const { return state != State::lost; }
};

struct TableEstimate : Estimate {
  Pose T_table_camera;  // meaningless if lost
};

struct GroupEstimate : Estimate {
  std::string name;
  // The group frame moves with the group. It is the table frame while the group is at its place in
  // the tag map. Meaningless if lost.
  Pose T_table_group;
  Pose T_group_middle;  // middle of the group's tags, with the axes of its first tag
  bool rests = false;   // at rest on the table, within the measurement noise
};

struct TrackedFrame {
  std::int64_t timestamp_ns = 0;
  TableEstimate table;
  std::vector<GroupEstimate> groups;  // in the order of the tag map
  // Causes of systematic errors that this frame reveals: the tag map, the lens or the row time
  // (docs/tracking.md#systematic-errors). A line each, with size and remedy; each cause only once.
  std::vector<std::string> notices;
};

// Tracks the tags through the frames of one camera. The same frames give the same poses, bit for
// bit, as `penumbra replay` (except with Search::when_done). While it tracks, it tests whether the
// tag map, the lens or the row time is wrong. Such an error is then part of the predicted overlay
// error, and poses become uncertain if that is 2 px or more. Use an object from one thread at a
// time; different objects are independent. A moved-from object can only be assigned to or
// destroyed; its functions throw.
class PENUMBRA_API Tracker {
 public:
  // Throws if no tag belongs to the group "table", or for an option out of range.
  Tracker(const CameraModel& camera, const TagMap& tags, const Options& options = {});
  Tracker(Tracker&&) noexcept;
  Tracker& operator=(Tracker&&) noexcept;
  ~Tracker();

  // Tracks the next frame. `timestamp_ns`: of any clock, at the middle of the exposure where known;
  // it must increase. `exposure_s`: exposure time, if known; it improves motion blur.
  // Throws if the image is empty, its stride is smaller than a row, its size is not that of the
  // camera model, or the time does not increase. The frame is then ignored.
  [[nodiscard]] TrackedFrame track(const ImageView& image, std::int64_t timestamp_ns,
                                   std::optional<double> exposure_s = std::nullopt);

  // Replaces the places of the table's tags from the next frame on, for example by a refined map.
  // The groups keep theirs. Throws unless the map has the same tags in the same groups.
  void set_tag_map(const TagMap& tags);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Returns "tracked", "uncertain", "held" or "lost".
[[nodiscard]] PENUMBRA_API std::string to_string(State state);

}  // namespace penumbra::tracking
