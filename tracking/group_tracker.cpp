#include "tracking/group_tracker.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/units.hpp"
#include "tracking/detection/background_search.hpp"
#include "tracking/group_place.hpp"
#include "tracking/rigid_tag_tracker.hpp"

namespace penumbra {
namespace {

constexpr int kInitialTests = 15;  // number of frames in which a lost group's old pose is tested
constexpr int kTestInterval = 4;   // interval of later tests [frames]
// Searches of the whole image are rarer: they take as long as tracking 20 frames or more.
constexpr int kInitialSearches = 2;  // number of searched frames after a group was lost
constexpr int kSearchInterval = 8;   // interval of later searches [frames]

// Returns true if the image is to be searched for a group that was lost for `unseen` frames.
bool searches(int unseen) {
  return unseen < kInitialSearches || unseen % kSearchInterval == 0;
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

// Returns a map with only the group's tags. Its frame (MappedTag::T_table_tag) is the group's
// middle.
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
  }
  return TagMap::make(std::move(own));
}

Result<RigidTagTracker> tracker_of_group(const CameraModel& camera, const TagMap& tags,
                                         const std::string& group, const TrackerOptions& options,
                                         std::shared_ptr<TagSearch> search) {
  PENUMBRA_TRY(const TagMap own, map_of_group(tags, group));
  return RigidTagTracker::create(camera, own, group, options, std::move(search));
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
  struct Group {
    std::string name;
    RigidTagTracker tracker;  // tracks the camera's pose over the group's middle
    GroupPlace place;
    int unseen = 0;  // number of frames since it was tracked
  };

  // Tags of an earlier frame, and the camera's pose over the table in it.
  struct Past {
    PastTags found;
    PoseEstimate table_pose;
    bool recent = false;  // not older than the maximum time of extrapolation
  };

  CameraModel camera;
  TrackerOptions options;
  std::shared_ptr<TagSearch> search;
  RigidTagTracker table;
  std::vector<Group> groups;
  int skipped = 0;
  std::unique_ptr<BackgroundSearch> beside;  // null if each frame waits for its search
  PoseEstimate searched_table_pose;          // table pose of the frame that `beside` searches
  bool search_due = false;
  bool search_full = false;                           // resolution of the next search
  std::optional<MapFromCamera> last_table_pose = {};  // latest measured one
  std::optional<MapFromCamera> table_hint = {};       // first pose to try after a change of the map

  [[nodiscard]] std::optional<Past> take_search(std::int64_t timestamp_ns);
  void begin_search(const Frame& frame, const PoseEstimate& table_pose);
  [[nodiscard]] TrackedFrame follow_table(const Frame& frame, const Past* past);
  [[nodiscard]] TrackRequest request_for(const Group& group) const;
  [[nodiscard]] GroupEstimate follow(Group& group, const Frame& frame, const Past* past,
                                     TrackedFrame& result);
};

TrackRequest GroupTracker::Impl::request_for(const Group& group) const {
  TrackRequest request;
  // The group can use the result if this frame was searched for the table already.
  request.search = search->searched() || (!beside && searches(group.unseen));
  if (beside && options.search_timing == SearchTiming::when_done) {
    request.finest = SearchResolution::quarter;
  }
  return request;
}

// Returns the result of a background search of an earlier frame.
std::optional<GroupTracker::Impl::Past> GroupTracker::Impl::take_search(std::int64_t timestamp_ns) {
  if (!beside) return std::nullopt;
  std::optional<PastTags> found = beside->take(options.search_timing == SearchTiming::next_frame);
  if (!found) return std::nullopt;
  const double age_s = seconds(timestamp_ns - found->timestamp_ns);
  if (!(age_s > 0.0)) return std::nullopt;
  return Past{std::move(*found), searched_table_pose, age_s <= options.hold_s};
}

// Begins a background search of this frame if one is due and the previous one is done.
void GroupTracker::Impl::begin_search(const Frame& frame, const PoseEstimate& table_pose) {
  if (!beside) return;
  const bool table_seen = is_measured(table_pose.status);
  const bool all_seen = table_seen && std::ranges::all_of(groups, [](const Group& group) {
                          return group.unseen == 0;
                        });
  if (all_seen) search_full = false;
  // The frame was searched for a lost table already, at up to half of the resolution.
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

// Tracks the table's tags, or searches for them if they are lost.
TrackedFrame GroupTracker::Impl::follow_table(const Frame& frame, const Past* past) {
  TrackRequest request;
  request.hint = std::exchange(table_hint, std::nullopt);
  if (beside && options.search_timing == SearchTiming::when_done) {
    request.finest = SearchResolution::half;
    if (past != nullptr && !is_measured(past->table_pose.status)) {
      const MapPoseEstimate then = table.locate(past->found.tags);
      if (is_measured(then.status)) {
        // A search in this frame helps if the tags moved too far to be recognised.
        if (past->recent) request.hint = then.T_map_camera;
        request.hint_seen = past->recent;
        request.finest = SearchResolution::full;
        request.begins_finest = true;
      }
    }
  }
  const auto [seen, times] = table.track(frame, request);
  if (is_measured(seen.status)) last_table_pose = seen.T_map_camera;
  PoseEstimate pose{seen, as_table_pose(seen.T_map_camera), seen.ambiguity_ratio};
  return {.frame = frame, .pose = std::move(pose), .times = times, .groups = {}};
}

// Tracks a group in a frame whose table pose is in `result`.
GroupEstimate GroupTracker::Impl::follow(Group& group, const Frame& frame, const Past* past,
                                         TrackedFrame& result) {
  const PoseEstimate& table_pose = result.pose;
  const int unseen = group.unseen;
  TrackRequest request = request_for(group);
  // Tests the group's last place if this frame is not searched: a search finds every place.
  const bool tests = !search->searched() && (unseen < kInitialTests || unseen % kTestInterval == 0);
  if (tests && is_measured(table_pose.status))
    request.hint = as_map_pose(group.place.shown().inverse() * table_pose.T_table_camera);
  MapPoseEstimate then;  // pose of the group in the past frame
  if (past != nullptr && past->recent && unseen > 0 && is_measured(past->table_pose.status))
    then = group.tracker.locate(past->found.tags);
  const bool was_seen = is_measured(then.status);
  if (was_seen && is_measured(table_pose.status)) {
    // Corrects the past pose by the camera's motion over the table since then.
    request.hint = as_map_pose(over_middle(then) * (past->table_pose.T_table_camera.inverse() *
                                                    table_pose.T_table_camera));
    request.hint_seen = true;
  }
  const auto [seen, times] = group.tracker.track(frame, request);
  add(times, result.times);
  search_due = search_due || (seen.status != TrackStatus::tracked && searches(unseen));
  group.unseen = seen.status == TrackStatus::tracked ? 0 : unseen + 1;
  // If the group is not verified in this frame, extrapolates from the past frame.
  if (was_seen && !is_measured(seen.status) &&
      group.place.is_older_than(past->found.timestamp_ns)) {
    std::ignore = group.place.update(camera, options.hold_s, past->found.timestamp_ns,
                                     past->table_pose, then);
  }
  return group.place.update(camera, options.hold_s, frame.timestamp_ns, table_pose, seen);
}

GroupTracker::GroupTracker(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
GroupTracker::GroupTracker(GroupTracker&&) noexcept = default;
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
        "tag map: no tag belongs to the group 'table', so the table's pose is not defined; leave "
        "out `group` for the tags that are fixed to it");
  }
  const std::optional<double>& tone_curve = camera.parameters().tone_curve;
  PENUMBRA_TRY(TagSearch made, TagSearch::create(families, tone_curve));
  const auto search = std::make_shared<TagSearch>(std::move(made));
  PENUMBRA_TRY(RigidTagTracker table_tracker,
               RigidTagTracker::create(camera, tags, kTableGroup, options, search));
  std::vector<Impl::Group> groups;
  for (const std::string& name : names) {
    Result<RigidTagTracker> tracker = tracker_of_group(camera, tags, name, options, search);
    if (!tracker) return fail_in(fmt::format("group '{}'", name), tracker.error());
    groups.push_back({name, std::move(*tracker), GroupPlace(name, middle_of_group(tags, name))});
  }
  std::unique_ptr<BackgroundSearch> beside;
  const bool needed = options.search_timing == SearchTiming::when_done ||
                      (options.search_timing == SearchTiming::next_frame && !groups.empty());
  if (needed && options.mode != TrackingMode::detect) {
    PENUMBRA_TRY(beside,
                 BackgroundSearch::create(
                     families, tone_curve,
                     options.search_thread || options.search_timing == SearchTiming::when_done));
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
    result.times.search_used = true;
    result.times.search_ms = past->found.time.wall_ms;
    result.times.search_cpu_ms = past->found.time.cpu_ms;
  }
  for (Impl::Group& group : m.groups) {
    result.groups.push_back(m.follow(group, frame, past ? &*past : nullptr, result));
  }
  m.begin_search(frame, result.pose);
  result.groups_skipped = m.skipped;
  total.add_to(result.times.total_ms, result.times.total_cpu_ms);
  // Frames do not wait for the other thread, but its CPU time is included.
  if (past && m.beside->has_thread()) result.times.total_cpu_ms += result.times.search_cpu_ms;
  return result;
}

void GroupTracker::set_map_sigma(double sigma_m) {
  impl_->table.set_map_sigma(sigma_m);
}

Result<void> GroupTracker::set_map(const CameraModel& camera, const TagMap& tags) {
  Impl& m = *impl_;
  const bool is_other_camera =
      camera.parameters().rolling_shutter_row_s != m.camera.parameters().rolling_shutter_row_s;
  PENUMBRA_TRY(auto table, RigidTagTracker::create(camera, tags, kTableGroup, m.options, m.search));
  std::vector<RigidTagTracker> trackers;
  for (const Impl::Group& group : m.groups) {
    if (!is_other_camera) break;
    PENUMBRA_TRY(auto tracker, tracker_of_group(camera, tags, group.name, m.options, m.search));
    trackers.push_back(std::move(tracker));
  }
  m.camera = camera;
  m.table = std::move(table);
  m.table_hint = m.last_table_pose;
  for (std::size_t i = 0; i < trackers.size(); ++i) m.groups[i].tracker = std::move(trackers[i]);
  return {};
}

}  // namespace penumbra
