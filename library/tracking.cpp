#include <algorithm>
#include <cmath>
#include <penumbra/tracking.hpp>
#include <utility>

#include "calib/refinement/residual_watch.hpp"
#include "core/geometry/tracking_reasons.hpp"
#include "core/text/text.hpp"
#include "library/support.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra::tracking {
namespace {

penumbra::TagMap checked_map(const std::vector<Tag>& tags) {
  std::vector<MappedTag> mapped;
  for (std::size_t i = 0; i < tags.size(); ++i) {
    const Tag& tag = tags[i];
    const auto family = tag_family_from_string(tag.family);
    if (!family) throw_failure("tags[{}]: family: {}", i, unknown_tag_family(tag.family));
    MappedTag& made = mapped.emplace_back();
    made.id = tag.id;
    made.family = *family;
    made.size_m = tag.size_m;
    made.T_table_tag = checked_transform<frame::Table, frame::Tag>(
        tag.T_table_tag, fmt::format("tags[{}]: T_table_tag", i));
    made.group = tag.group;
    for (const double curvature : tag.curvature) {
      if (!std::isfinite(curvature)) {
        throw_failure("tags[{}]: curvature: {} is not finite; give 0 for flat paper", i, curvature);
      }
    }
    made.curvature = {tag.curvature[0], tag.curvature[1], tag.curvature[2]};
  }
  return value_or_throw(penumbra::TagMap::make(std::move(mapped)));
}

TrackingMode to_internal(Mode mode) {
  switch (mode) {
    case Mode::automatic:
      return TrackingMode::automatic;
    case Mode::fast:
      return TrackingMode::fast;
    case Mode::accurate:
      return TrackingMode::accurate;
    case Mode::detect:
      return TrackingMode::detect;
  }
  throw_failure("mode: {} is no tracking mode", static_cast<int>(mode));
}

SearchTiming to_internal(Search search) {
  switch (search) {
    case Search::next_frame:
      return SearchTiming::next_frame;
    case Search::in_frame:
      return SearchTiming::in_frame;
    case Search::when_done:
      return SearchTiming::when_done;
  }
  throw_failure("search: {} is no time of a search", static_cast<int>(search));
}

TrackerOptions checked_options(const Options& options) {
  TrackerOptions checked;
  checked.mode = to_internal(options.mode);
  if (!(options.pose_budget_px >= 0.0 && std::isfinite(options.pose_budget_px))) {
    throw_failure("pose_budget_px: is {}; give pixels, or 0 for no budget", options.pose_budget_px);
  }
  checked.pose_budget_px = options.pose_budget_px;
  checked.search_timing = to_internal(options.search);
  checked.search_thread = options.search_thread;
  constexpr double kMaxHold_s = 3600.0;
  if (!(options.hold_s >= 0.0 && options.hold_s <= kMaxHold_s)) {
    throw_failure("hold_s: is {}; give 0 to {:g} seconds", options.hold_s, kMaxHold_s);
  }
  checked.hold_s = options.hold_s;
  return checked;
}

void check_groups(const penumbra::TagMap& tags, const Options& options) {
  if (!options.groups) return;
  const std::vector<std::string> known = other_groups(tags);
  for (const std::string& name : *options.groups) {
    if (std::ranges::find(known, name) == known.end()) {
      throw_failure("groups: the tag map has no group '{}' beside the table", name);
    }
  }
}

// Throws unless both maps have the same tags in the same groups.
void check_same_tags(const penumbra::TagMap& before, const penumbra::TagMap& now) {
  for (const MappedTag& tag : now.tags()) {
    const MappedTag* same = before.find(tag.family, tag.id);
    if (same == nullptr || same->group != tag.group) {
      throw_failure("set_tag_map: tag {} of group '{}' is not in the tracker's map", tag.id,
                    tag.group);
    }
  }
  if (now.tags().size() != before.tags().size()) {
    throw_failure("set_tag_map: the map has {} tags, the tracker's {}; give all of them",
                  now.tags().size(), before.tags().size());
  }
}

State to_public(TrackStatus status) {
  switch (status) {
    case TrackStatus::tracked:
      return State::tracked;
    case TrackStatus::uncertain:
      return State::uncertain;
    case TrackStatus::held:
      return State::held;
    case TrackStatus::lost:
      return State::lost;
  }
  return State::lost;
}

void fill(const EstimatedPose& from, Estimate& to) {
  to.state = to_public(from.status);
  to.reason = text_of(from.reason);
  for (Eigen::Index row = 0; row < 6; ++row) {
    for (Eigen::Index column = 0; column < 6; ++column) {
      to.covariance[static_cast<std::size_t>(6 * row + column)] = from.covariance(row, column);
    }
  }
  to.predicted_overlay_px = from.predicted_overlay_error_px;
  to.reprojection_rms_px = from.reprojection_rms_px;
  to.tags_used = from.tags_used;
  for (const penumbra::RejectedTag& tag : from.tags_rejected) {
    to.tags_rejected.push_back({tag.id, std::string(key_of(tag.reason))});
  }
  to.age_s = from.age_s;
}

}  // namespace

struct TagMap::Impl {
  penumbra::TagMap map;
};

struct Access {
  [[nodiscard]] static const penumbra::TagMap& map_of(const TagMap& tags) {
    return tags.impl_->map;
  }
};

TagMap::TagMap(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
TagMap::TagMap(const TagMap&) = default;
TagMap& TagMap::operator=(const TagMap&) = default;
TagMap::~TagMap() = default;

TagMap::TagMap(const std::vector<Tag>& tags)
    : impl_(std::make_shared<const Impl>(Impl{checked_map(tags)})) {}

TagMap TagMap::load(const std::filesystem::path& file) {
  return guarded([&] {
    return TagMap(std::make_shared<const Impl>(Impl{value_or_throw(load_tag_map(file))}));
  });
}

void TagMap::save(const std::filesystem::path& file) const {
  guarded([&] { throw_if_failed(write_text_file(file, tag_map_text(impl_->map))); });
}

std::vector<Tag> TagMap::tags() const {
  std::vector<Tag> tags;
  for (const MappedTag& tag : impl_->map.tags()) {
    tags.push_back({tag.id,
                    std::string(to_string(tag.family)),
                    tag.size_m,
                    penumbra::to_public(tag.T_table_tag),
                    tag.group,
                    {tag.curvature.xx, tag.curvature.xy, tag.curvature.yy}});
  }
  return tags;
}

struct Tracker::Impl {
  GroupTracker tracker;
  penumbra::CameraModel camera;
  penumbra::TagMap map;
  std::unique_ptr<ResidualWatch> residual_watch;
  std::uint64_t frames = 0;
  std::int64_t last_ns = 0;  // meaningful once a frame was tracked
};

Tracker::Tracker(Tracker&&) noexcept = default;
Tracker& Tracker::operator=(Tracker&&) noexcept = default;
Tracker::~Tracker() = default;

Tracker::Tracker(const CameraModel& camera, const TagMap& tags, const Options& options)
    : impl_(guarded([&] {
        const penumbra::CameraModel& model = types::Access::model_of(camera);
        const penumbra::TagMap& map = Access::map_of(tags);
        check_groups(map, options);
        return std::make_unique<Impl>(
            Impl{value_or_throw(
                     GroupTracker::create(model, map, checked_options(options), options.groups)),
                 model, map, value_or_throw(ResidualWatch::create(model, map))});
      })) {}

TrackedFrame Tracker::track(const ImageView& image, std::int64_t timestamp_ns,
                            std::optional<double> exposure_s) {
  if (!impl_) throw_failure("tracker: was moved from; make another one");
  Impl& m = *impl_;
  Frame frame = checked_frame(image, "image");
  if (frame.width != m.camera.width() || frame.height != m.camera.height()) {
    throw_failure(
        "image: is {} x {} px, but the camera model is of {} x {}; give a model of this size",
        frame.width, frame.height, m.camera.width(), m.camera.height());
  }
  if (timestamp_ns > kMaxTime_ns || timestamp_ns < -kMaxTime_ns) {
    throw_failure("the time of {} ns is out of range; give nanoseconds up to 2^61", timestamp_ns);
  }
  if (m.frames > 0 && timestamp_ns <= m.last_ns) {
    throw_failure("the time of {} ns is not after {} ns; give the frames in the order of time",
                  timestamp_ns, m.last_ns);
  }
  if (exposure_s && !(*exposure_s > 0.0 && std::isfinite(*exposure_s))) {
    throw_failure("exposure_s: is {}; give seconds above 0, or nothing", *exposure_s);
  }
  frame.timestamp_ns = timestamp_ns;
  frame.exposure_s = exposure_s;
  frame.sequence = m.frames;
  return guarded([&] {
    penumbra::TrackedFrame tracked = m.tracker.track(frame);
    ++m.frames;
    m.last_ns = timestamp_ns;
    TrackedFrame result;
    result.notices = m.residual_watch->observe(tracked);
    m.tracker.set_map_sigma(m.residual_watch->map_sigma_m());
    result.timestamp_ns = timestamp_ns;
    fill(tracked.pose, result.table);
    result.table.T_table_camera = penumbra::to_public(tracked.pose.T_table_camera);
    for (const penumbra::GroupEstimate& group : tracked.groups) {
      GroupEstimate& made = result.groups.emplace_back();
      fill(group, made);
      made.name = group.name;
      made.T_table_group = penumbra::to_public(group.T_table_group);
      made.T_group_middle = penumbra::to_public(group.T_group_middle);
      made.rests = group.rests;
    }
    return result;
  });
}

void Tracker::set_tag_map(const TagMap& tags) {
  if (!impl_) throw_failure("tracker: was moved from; make another one");
  guarded([&] {
    const penumbra::TagMap& map = Access::map_of(tags);
    check_same_tags(impl_->map, map);
    auto residual_watch = value_or_throw(ResidualWatch::create(impl_->camera, map));
    throw_if_failed(impl_->tracker.set_map(impl_->camera, map));
    impl_->residual_watch = std::move(residual_watch);
  });
}

std::string to_string(State state) {
  switch (state) {
    case State::tracked:
      return "tracked";
    case State::uncertain:
      return "uncertain";
    case State::held:
      return "held";
    case State::lost:
      break;
  }
  return "lost";
}

}  // namespace penumbra::tracking
