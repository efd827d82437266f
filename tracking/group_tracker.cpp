#include "tracking/group_tracker.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "core/assert.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/units.hpp"
#include "tracking/detection/background_search.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/motion/motion_model.hpp"
#include "tracking/pose_confidence.hpp"
#include "tracking/rigid_tag_tracker.hpp"

namespace penumbra {
namespace {

// Of a group that is not where it was: frames after its loss in which its old place is looked at,
// and frames in which the whole image is searched, at half and full resolution in turn; then the
// intervals of both. A search costs as much as twenty frames of tracking and more.
constexpr int kLooksAtFirst = 15;
constexpr int kLooksEvery = 4;
constexpr int kSearchesAtFirst = 2;
constexpr int kSearchesEvery = 8;

// Chi-square of 6 degrees of freedom that 99 % of measurements of a resting group stay under.
constexpr double kRests = 16.8;
// Growth of the covariance of a resting group's place from frame to frame: measurements are
// averaged over about five frames.
constexpr double kForgets = 1.25;
// A place is shown as long as the averaged one is no farther from it than this; and the average
// lags no farther behind a motion that is slower than the measurements' covariance shows.
constexpr double kShownWithin_px = 0.25;
// Two measurements that lie further apart give no velocity.
constexpr double kVelocityLifetime_s = 0.2;

using TableFromMiddle = Transform<frame::Table, frame::GroupMiddle>;
using MiddleFromCamera = Transform<frame::GroupMiddle, frame::Camera>;

// A tracker's poses are over the frame of its tags, which is typed as the table. For a group beside
// the table it is the group's middle.
MiddleFromCamera of_middle(const CameraPose& pose) {
  return {pose.rotation(), pose.translation()};
}
CameraPose as_table(const MiddleFromCamera& pose) {
  return {pose.rotation(), pose.translation()};
}

// T exp(xi), and the xi between two, to first order (pose_refiner.hpp), for places on the table.
TableFromMiddle moved(const TableFromMiddle& place, const Vector6d& xi) {
  const CameraPose pose = perturbed({place.rotation(), place.translation()}, xi);
  return {pose.rotation(), pose.translation()};
}
Vector6d motion_between(const TableFromMiddle& from, const TableFromMiddle& to) {
  return perturbation_between({from.rotation(), from.translation()},
                              {to.rotation(), to.translation()});
}

// xi_a of a motion that is xi_b in frame b: T_a_b exp(xi_b) = exp(xi_a) T_a_b.
template <class A, class B>
Matrix6d adjoint(const Transform<A, B>& T_a_b) {
  const Eigen::Matrix3d R = T_a_b.rotation_matrix();
  const Eigen::Vector3d& t = T_a_b.translation();
  Eigen::Matrix3d cross;
  cross << 0.0, -t.z(), t.y(), t.z(), 0.0, -t.x(), -t.y(), t.x(), 0.0;
  Matrix6d A6 = Matrix6d::Zero();
  A6.topLeftCorner<3, 3>() = R;
  A6.topRightCorner<3, 3>() = cross * R;
  A6.bottomRightCorner<3, 3>() = R;
  return A6;
}

bool measured(TrackStatus status) {
  return status == TrackStatus::tracked || status == TrackStatus::uncertain;
}
TrackStatus worse(TrackStatus a, TrackStatus b) {
  return std::max(a, b);  // in the order of their declaration
}
static_assert(TrackStatus::tracked < TrackStatus::uncertain &&
              TrackStatus::uncertain < TrackStatus::held && TrackStatus::held < TrackStatus::lost);

// Whether the image is searched for a group that has not been seen for `unseen` frames.
bool searches(int unseen) {
  return unseen < kSearchesAtFirst || unseen % kSearchesEvery == 0;
}

void add(const TrackTimes& more, TrackTimes& times) {
  times.detect_ms += more.detect_ms;
  times.detect_cpu_ms += more.detect_cpu_ms;
  times.align_ms += more.align_ms;
  times.align_cpu_ms += more.align_cpu_ms;
  times.solve_ms += more.solve_ms;
  times.solve_cpu_ms += more.solve_cpu_ms;
  times.full_detection = times.full_detection || more.full_detection;
}

// A map of the group's tags alone, with the group's middle as origin.
Result<TagMap> map_of_group(const TagMap& tags, const std::string& group) {
  const auto T_middle_group = middle_of_group(tags, group).inverse();
  std::vector<MappedTag> own;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != group) continue;
    MappedTag& copy = own.emplace_back(tag);
    const Transform<frame::Group, frame::Tag> T_group_tag(tag.T_table_tag.rotation(),
                                                          tag.T_table_tag.translation());
    const auto T_middle_tag = T_middle_group * T_group_tag;
    copy.T_table_tag = {T_middle_tag.rotation(), T_middle_tag.translation()};
    copy.group = kTableGroup;
  }
  return TagMap::make(std::move(own));
}

}  // namespace

std::vector<std::string> other_groups(const TagMap& tags) {
  std::vector<std::string> groups;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != kTableGroup && std::ranges::find(groups, tag.group) == groups.end()) {
      groups.push_back(tag.group);
    }
  }
  return groups;
}

Transform<frame::Group, frame::GroupMiddle> middle_of_group(const TagMap& tags,
                                                            const std::string& group) {
  const MappedTag* first = nullptr;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int count = 0;
  for (const MappedTag& tag : tags.tags()) {
    if (tag.group != group) continue;
    if (first == nullptr) first = &tag;
    sum += tag.T_table_tag.translation();
    ++count;
  }
  PENUMBRA_ASSERT(first != nullptr);
  return {first->T_table_tag.rotation(), Eigen::Vector3d(sum / count)};
}

struct GroupTracker::Impl {
  struct Place {
    std::int64_t timestamp_ns = 0;
    TableFromMiddle T_table_middle;
    Matrix6d covariance = Matrix6d::Zero();  // of T_table_middle * exp(xi)
  };
  struct Group {
    std::string name;
    Transform<frame::Group, frame::GroupMiddle> T_group_middle;
    RigidTagTracker tracker;
    std::optional<Place> found;  // averaged while it rests
    TableFromMiddle shown;       // within a quarter of a pixel of it; at first: as the map has it
    TrackStatus last_status = TrackStatus::tracked;  // of the last measured place
    bool rests = false;
    Vector6d velocity = Vector6d::Zero();  // [m/s, rad/s], group's middle
    int unseen = 0;                        // frames since it was tracked
  };

  // Tags of a frame before this one, and where the camera was over the table in it.
  struct Past {
    PastTags found;
    PoseEstimate table_pose;
    bool recent = false;  // not longer ago than a pose is held
  };

  CameraModel camera;
  TrackerOptions options;
  std::shared_ptr<TagSearch> search;
  RigidTagTracker table;
  std::vector<Group> groups;
  int skipped = 0;
  // Beside the tracking; nothing where a frame waits for its search.
  std::unique_ptr<BackgroundSearch> beside;
  PoseEstimate searched_table_pose;  // of the frame that is searched there
  bool search_due = false;
  bool search_full = false;  // at which resolution is searched next

  [[nodiscard]] std::optional<Past> take_search(std::int64_t timestamp_ns);
  void begin_search(const Frame& frame, const PoseEstimate& table_pose);
  [[nodiscard]] TrackedFrame follow_table(const Frame& frame, const Past* past);
  [[nodiscard]] SharedFrame request_for(const Group& group, const PoseEstimate& table_pose) const;
  [[nodiscard]] GroupEstimate follow(Group& group, const Frame& frame, const Past* past,
                                     TrackedFrame& result);
  [[nodiscard]] GroupEstimate place(Group& group, std::int64_t timestamp_ns,
                                    const PoseEstimate& table_pose, const PoseEstimate& seen) const;
  void take(Group& group, const Place& now, bool doubtful, const CameraPose& T_table_camera) const;
  [[nodiscard]] GroupEstimate held(const Group& group, std::int64_t timestamp_ns,
                                   const PoseEstimate& table_pose, std::string reason) const;
};

// Requests the group where it would be seen if it had not moved since.
SharedFrame GroupTracker::Impl::request_for(const Group& group,
                                            const PoseEstimate& table_pose) const {
  SharedFrame request;
  const int unseen = group.unseen;
  // A search of the frame finds more: it sees tags in wrong places too.
  const bool looks = !search->searched() && (unseen < kLooksAtFirst || unseen % kLooksEvery == 0);
  if (looks && measured(table_pose.status)) {
    request.hint = as_table(group.shown.inverse() * table_pose.T_table_camera);
  }
  // Where the table was searched for in the frame, what was found is there already.
  request.search = search->searched() || (!beside && searches(unseen));
  if (beside && options.search_timing == SearchTiming::when_done) {
    request.finest = SearchResolution::quarter;
  }
  return request;
}

// Takes the result of a background search, if it is still of use.
std::optional<GroupTracker::Impl::Past> GroupTracker::Impl::take_search(std::int64_t timestamp_ns) {
  if (!beside) return std::nullopt;
  std::optional<PastTags> found = beside->take(options.search_timing == SearchTiming::next_frame);
  if (!found) return std::nullopt;
  const double age_s = seconds(timestamp_ns - found->timestamp_ns);
  if (!(age_s > 0.0)) return std::nullopt;
  return Past{std::move(*found), searched_table_pose, age_s <= options.hold_s};
}

// Begins a background search of this frame if one is due and the one before is done.
void GroupTracker::Impl::begin_search(const Frame& frame, const PoseEstimate& table_pose) {
  if (!beside) return;
  const bool table_seen = measured(table_pose.status);
  const bool all_seen = table_seen && std::ranges::all_of(groups, [](const Group& group) {
                          return group.unseen == 0;
                        });
  if (all_seen) search_full = false;
  // A lost table was searched for in the frame already, up to half of the resolution.
  const bool finely = options.search_timing == SearchTiming::when_done && !table_seen;
  if (!table_seen) search_due = finely;
  if (all_seen || search->searched(finely ? SearchResolution::full : SearchResolution::half))
    search_due = false;
  const bool fits = frame.width == camera.width() && frame.height == camera.height();
  if (!search_due || !beside->idle() || frame.empty() || !fits) return;
  search_due = false;
  searched_table_pose = table_pose;
  const bool full = finely || std::exchange(search_full, !search_full);
  beside->begin(search->image(), frame.timestamp_ns,
                full ? SearchResolution::full : SearchResolution::half);
}

// Tracks the table, lost or not.
TrackedFrame GroupTracker::Impl::follow_table(const Frame& frame, const Past* past) {
  SharedFrame request;
  if (beside && options.search_timing == SearchTiming::when_done) {
    request.finest = SearchResolution::half;
    if (past != nullptr && !measured(past->table_pose.status)) {
      const PoseEstimate then = table.locate(past->found.tags);
      if (measured(then.status)) {
        // How the camera moved since is not known. Where it went too far for the tags to be
        // recognised (on a slow machine, in every frame), what was seen is worth a search here.
        if (past->recent) request.hint = then.T_table_camera;
        request.hint_seen = past->recent;
        request.finest = SearchResolution::full;
        request.begins_finest = true;
      }
    }
  }
  return table.track(frame, request);
}

// Tracks a group in a frame whose table pose is in `result`.
GroupEstimate GroupTracker::Impl::follow(Group& group, const Frame& frame, const Past* past,
                                         TrackedFrame& result) {
  SharedFrame request = request_for(group, result.pose);
  PoseEstimate then;  // where the group was seen in the past
  if (past != nullptr && past->recent && group.unseen > 0 && measured(past->table_pose.status)) {
    then = group.tracker.locate(past->found.tags);
  }
  if (measured(then.status) && measured(result.pose.status)) {
    // Brought forward by the camera's motion over the table.
    request.hint = then.T_table_camera *
                   (past->table_pose.T_table_camera.inverse() * result.pose.T_table_camera);
    request.hint_seen = true;
  }
  const TrackedFrame seen = group.tracker.track(frame, request);
  add(seen.times, result.times);
  search_due = search_due || (seen.pose.status != TrackStatus::tracked && searches(group.unseen));
  group.unseen = seen.pose.status == TrackStatus::tracked ? 0 : group.unseen + 1;
  // Not verified any more: it is extrapolated from where it was seen.
  const bool newer = !group.found || (past && group.found->timestamp_ns < past->found.timestamp_ns);
  if (measured(then.status) && !measured(seen.pose.status) && newer) {
    static_cast<void>(place(group, past->found.timestamp_ns, past->table_pose, then));
  }
  return place(group, frame.timestamp_ns, result.pose, seen.pose);
}

// Takes a new measurement, averaged with those before while they agree.
void GroupTracker::Impl::take(Group& group, const Place& now, bool doubtful,
                              const CameraPose& T_table_camera) const {
  const auto apart_px = [&](const TableFromMiddle& a, const TableFromMiddle& b) {
    return overlay_difference(camera, as_table(a.inverse() * T_table_camera),
                              as_table(b.inverse() * T_table_camera))
        .rms_px();
  };
  bool agrees = false;
  if (group.found) {
    Place& found = *group.found;
    const Vector6d away = motion_between(found.T_table_middle, now.T_table_middle);
    const Matrix6d before = kForgets * found.covariance;
    const Matrix6d total = before + now.covariance;
    const Vector6d weighed = total.ldlt().solve(away);
    agrees = away.dot(weighed) < kRests &&
             apart_px(found.T_table_middle, now.T_table_middle) <= kShownWithin_px;
    if (!agrees && doubtful) return;  // what was surer stays
    if (agrees) {
      const Matrix6d gain = total.ldlt().solve(before).transpose();  // before total^-1
      found.T_table_middle = moved(found.T_table_middle, before * weighed);
      found.covariance = before - gain * before;
      found.covariance = 0.5 * (found.covariance + found.covariance.transpose()).eval();
      found.timestamp_ns = now.timestamp_ns;
      group.velocity.setZero();
    } else {
      const double step_s = seconds(now.timestamp_ns - found.timestamp_ns);
      group.velocity = step_s > 0.0 && step_s <= kVelocityLifetime_s ? Vector6d(away / step_s)
                                                                     : Vector6d::Zero();
    }
  }
  if (!agrees) group.found = now;
  const bool same_view =
      agrees && apart_px(group.shown, group.found->T_table_middle) <= kShownWithin_px;
  if (!same_view) group.shown = group.found->T_table_middle;
  group.rests = agrees;
}

GroupEstimate GroupTracker::Impl::held(const Group& group, std::int64_t timestamp_ns,
                                       const PoseEstimate& table_pose, std::string reason) const {
  GroupEstimate estimate;
  estimate.name = group.name;
  estimate.T_group_middle = group.T_group_middle;
  estimate.reason = std::move(reason);
  if (!group.found || !table_pose.has_pose()) return estimate;
  const double age_s = seconds(timestamp_ns - group.found->timestamp_ns);
  if (!(age_s >= 0.0) || age_s > options.hold_s) return estimate;
  const TableFromMiddle at = moved(group.shown, group.velocity * age_s);
  if (!at.is_finite()) return estimate;
  estimate.status = TrackStatus::held;
  estimate.held_from = group.last_status;
  estimate.age_s = age_s;
  estimate.rests = group.rests;
  estimate.T_table_group = at * group.T_group_middle.inverse();
  const CameraPose T_middle_camera = as_table(at.inverse() * table_pose.T_table_camera);
  const Matrix6d A = adjoint(T_middle_camera.inverse());
  const Matrix6d of_group = group.found->covariance + unforeseen_motion(age_s);
  estimate.covariance = table_pose.covariance + A * of_group * A.transpose();
  estimate.expected_overlay_error_px = with_lens_error_px(
      camera, expected_overlay_error_px(camera, T_middle_camera, estimate.covariance));
  return estimate;
}

// Places the group on the table: `table_pose` and `seen` are where the camera is over each.
GroupEstimate GroupTracker::Impl::place(Group& group, std::int64_t timestamp_ns,
                                        const PoseEstimate& table_pose,
                                        const PoseEstimate& seen) const {
  // A clock that jumps back leaves nothing of the past to rely on.
  if (group.found && timestamp_ns <= group.found->timestamp_ns) group.found.reset();
  if (!measured(seen.status)) {
    return held(group, timestamp_ns, table_pose,
                seen.reason.empty() ? std::string("not seen") : seen.reason);
  }
  if (!measured(table_pose.status)) {
    return held(group, timestamp_ns, table_pose,
                fmt::format("the table is {}", to_string(table_pose.status)));
  }
  const MiddleFromCamera T_middle_camera = of_middle(seen.T_table_camera);
  Place now;
  now.timestamp_ns = timestamp_ns;
  now.T_table_middle = table_pose.T_table_camera * T_middle_camera.inverse();
  const Matrix6d A = adjoint(T_middle_camera);
  now.covariance = A * (table_pose.covariance + seen.covariance) * A.transpose();
  if (!now.T_table_middle.is_finite() || !now.covariance.allFinite()) {
    return held(group, timestamp_ns, table_pose, "no finite place");
  }
  const bool doubtful = worse(seen.status, table_pose.status) != TrackStatus::tracked;
  const bool old =
      group.found && seconds(timestamp_ns - group.found->timestamp_ns) > options.hold_s;
  take(group, now, doubtful && !old, table_pose.T_table_camera);
  if (group.found->timestamp_ns != timestamp_ns) {
    return held(group, timestamp_ns, table_pose,
                seen.reason.empty() ? table_pose.reason : seen.reason);
  }

  GroupEstimate estimate;
  estimate.name = group.name;
  estimate.T_group_middle = group.T_group_middle;
  estimate.T_table_group = group.shown * group.T_group_middle.inverse();
  estimate.reprojection_rms_px = seen.reprojection_rms_px;
  estimate.tags_used = seen.tags_used;
  estimate.tags_left_out = seen.tags_left_out;
  estimate.rests = group.rests;
  const CameraPose drawn = as_table(group.shown.inverse() * table_pose.T_table_camera);
  if (group.rests) {
    // Drawn by the table's pose, at a place that more frames than this one know.
    const Matrix6d back = adjoint(drawn.inverse());
    estimate.covariance = table_pose.covariance + back * group.found->covariance * back.transpose();
  } else {
    estimate.covariance = seen.covariance;
  }
  estimate.expected_overlay_error_px =
      with_lens_error_px(camera, expected_overlay_error_px(camera, drawn, estimate.covariance));
  if (group.rests) {
    // Both distances are distributed evenly up to their limit.
    estimate.expected_overlay_error_px =
        std::hypot(estimate.expected_overlay_error_px, kShownWithin_px * std::sqrt(2.0 / 3.0));
  }
  estimate.status = worse(seen.status, table_pose.status);
  if (estimate.status == TrackStatus::tracked &&
      !(estimate.expected_overlay_error_px < kTrackedOverlay_px)) {
    estimate.status = TrackStatus::uncertain;
    estimate.reason = fmt::format("expected error {:.1f} px", estimate.expected_overlay_error_px);
  } else if (estimate.status == TrackStatus::uncertain) {
    estimate.reason = seen.status == TrackStatus::uncertain
                          ? seen.reason
                          : fmt::format("the table is uncertain: {}", table_pose.reason);
  }
  group.last_status = estimate.status;
  return estimate;
}

GroupTracker::GroupTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GroupTracker::GroupTracker(GroupTracker&&) noexcept = default;
GroupTracker& GroupTracker::operator=(GroupTracker&&) noexcept = default;
GroupTracker::~GroupTracker() = default;

Result<GroupTracker> GroupTracker::create(const CameraModel& camera, const TagMap& tags,
                                          const TrackerOptions& options,
                                          const std::optional<std::vector<std::string>>& wanted) {
  std::vector<std::string> names = other_groups(tags);
  const std::size_t all = names.size();
  if (wanted) {
    std::erase_if(names, [&](const std::string& name) {
      return std::ranges::find(*wanted, name) == wanted->end();
    });
  }
  std::vector<TagFamily> families;
  bool table = false;
  for (const MappedTag& tag : tags.tags()) {
    table = table || tag.group == kTableGroup;
    if (tag.group == kTableGroup || std::ranges::find(names, tag.group) != names.end()) {
      families.push_back(tag.family);
    }
  }
  if (!table) {
    return fail(
        "tag map: no tag belongs to the group 'table', so nothing says where the table is; leave "
        "out `group` for the tags that are fixed to it");
  }
  PENUMBRA_TRY(TagSearch made,
               TagSearch::create(families, options.detector, camera.parameters().tone_curve));
  const auto search = std::make_shared<TagSearch>(std::move(made));
  PENUMBRA_TRY(RigidTagTracker table_tracker,
               RigidTagTracker::create(camera, tags, options, search));
  std::vector<Impl::Group> groups;
  for (const std::string& name : names) {
    const Result<TagMap> own = map_of_group(tags, name);
    if (!own) return fail_in(fmt::format("group '{}'", name), own.error());
    Result<RigidTagTracker> tracker = RigidTagTracker::create(camera, *own, options, search);
    if (!tracker) return fail_in(fmt::format("group '{}'", name), tracker.error());
    Impl::Group group{name, middle_of_group(tags, name), std::move(*tracker), {}, {}};
    group.shown = GroupPose() * group.T_group_middle;
    groups.push_back(std::move(group));
  }
  std::unique_ptr<BackgroundSearch> beside;
  const bool needed = options.search_timing == SearchTiming::when_done ||
                      (options.search_timing == SearchTiming::next_frame && !groups.empty());
  if (needed && options.mode != TrackingMode::detect) {
    PENUMBRA_TRY(auto begun,
                 BackgroundSearch::create(
                     families, options.detector, camera.parameters().tone_curve,
                     options.search_thread || options.search_timing == SearchTiming::when_done));
    beside = std::move(begun);
  }
  const int skipped = static_cast<int>(all - names.size());
  auto impl = std::make_unique<Impl>(Impl{.camera = camera,
                                          .options = options,
                                          .search = search,
                                          .table = std::move(table_tracker),
                                          .groups = std::move(groups),
                                          .skipped = skipped,
                                          .beside = std::move(beside),
                                          .searched_table_pose = {}});
  return GroupTracker(std::move(impl));
}

TrackedFrame GroupTracker::track(const Frame& frame) {
  Impl& m = *impl_;
  const Stopwatch total;
  m.search->begin(frame);
  const std::optional<Impl::Past> past = m.take_search(frame.timestamp_ns);
  TrackedFrame result = m.follow_table(frame, past ? &*past : nullptr);
  if (past) {
    result.times.search_came = true;
    result.times.search_ms = past->found.time.wall_ms;
    result.times.search_cpu_ms = past->found.time.cpu_ms;
  }
  for (Impl::Group& group : m.groups) {
    result.groups.push_back(m.follow(group, frame, past ? &*past : nullptr, result));
  }
  m.begin_search(frame, result.pose);
  result.groups_skipped = m.skipped;
  total.add_to(result.times.total_ms, result.times.total_cpu_ms);
  // No frame waits for another thread, but what tracking takes is what it takes.
  if (past && m.beside->has_thread()) result.times.total_cpu_ms += result.times.search_cpu_ms;
  return result;
}

}  // namespace penumbra
