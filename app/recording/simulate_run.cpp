#include "app/recording/simulate_run.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "app/output/run_outputs.hpp"
#include "app/progress.hpp"
#include "app/recording/recording_source.hpp"
#include "app/session/session.hpp"
#include "app/tags_in_use.hpp"
#include "core/camera/camera_file.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "core/propagate.hpp"
#include "core/random.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "tracking/alignment/pattern_renderer.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLargestText = std::size_t{16} << 20U;
constexpr int kMostMoments = 64;       // of an exposure, of the tags
constexpr int kMostSceneMoments = 16;  // of the objects: each is drawn in full
constexpr double kMomentApart_px = 0.25;

// A new folder beside the one that is wanted, renamed at the end, removed where there is none.
class RecordingFolder {
 public:
  RecordingFolder() = default;
  RecordingFolder(const RecordingFolder&) = delete;
  RecordingFolder& operator=(const RecordingFolder&) = delete;
  ~RecordingFolder() {
    std::error_code ignored;
    if (!partial_.empty()) fs::remove_all(partial_, ignored);
  }

  Result<void> create(const fs::path& folder) {
    target_ = folder.lexically_normal();
    if (!target_.has_filename()) target_ = target_.parent_path();  // "out/" is "out"
    std::error_code error;
    if (fs::exists(target_, error)) {
      if (!fs::is_directory(target_, error)) {
        return fail("{}: is not a folder; name a new one for the recording", folder.string());
      }
      if (fs::directory_iterator(target_, error) != fs::directory_iterator() || error) {
        return fail("{}: is there already and not empty; name a new folder for the recording",
                    folder.string());
      }
    }
    error.clear();
    if (target_.has_parent_path()) fs::create_directories(target_.parent_path(), error);
    for (int attempt = 0; !error && attempt < kPartialAttempts; ++attempt) {
      const fs::path path = partial_path(target_, attempt);
      if (fs::create_directory(path, error)) {
        partial_ = path;
        break;
      }
    }
    if (!error && !partial_.empty()) fs::create_directory(partial_ / "frames", error);
    if (error || partial_.empty()) {
      return fail("{}: cannot be made: {}; choose another place", folder.string(),
                  error ? error.message() : "every name beside it is taken");
    }
    return {};
  }
  [[nodiscard]] const fs::path& partial() const { return partial_; }
  // What went wrong in the partial folder, told of the one that is wanted.
  [[nodiscard]] tl::unexpected<Error> failed(const Error& cause) const {
    return tl::unexpected(renamed(cause, partial_, target_));
  }

  Result<void> commit() {
    std::error_code error;
    fs::rename(partial_, target_, error);  // over an empty folder too
    if (error) {
      return fail("{}: cannot be made: {}; choose another place", target_.string(),
                  error.message());
    }
    partial_.clear();
    return {};
  }

 private:
  fs::path target_;
  fs::path partial_;
};

Result<Trajectory> load_path(const fs::path& file) {
  auto path = load_trajectory(file);
  if (!path) return path;
  if (path->poses.empty())
    return fail("{}: has no pose; give one line for each frame", file.string());
  return path;
}

// The paths of the groups that move. Each has to begin and end with the camera's: how it goes on is
// nobody's to say.
Result<std::map<std::string, Trajectory>> load_group_paths(const SimulateRequest& request,
                                                           const TagMap& tags,
                                                           const Trajectory& camera) {
  std::map<std::string, Trajectory> paths;
  const std::vector<std::string> there = other_groups(tags);
  for (const auto& [group, file] : request.groups) {
    if (std::ranges::find(there, group) == there.end()) {
      std::string names;
      for (const std::string& name : there) names += (names.empty() ? "" : ", ") + name;
      return fail("--group {}: {} has no such group; it has {}", group, request.tags.string(),
                  names.empty() ? "none beside the table" : names);
    }
    if (!group_file(group)) {
      return fail("--group {}: can be no file's name; give it another in {}", group,
                  request.tags.string());
    }
    PENUMBRA_TRY(auto path, load_path(file));
    if (path.poses.front().timestamp_ns > camera.poses.front().timestamp_ns ||
        path.poses.back().timestamp_ns < camera.poses.back().timestamp_ns) {
      return fail(
          "{}: goes from {} s to {} s, the camera from {} s to {} s; give it for all frames",
          file.string(), format_ns_as_seconds(path.poses.front().timestamp_ns),
          format_ns_as_seconds(path.poses.back().timestamp_ns),
          format_ns_as_seconds(camera.poses.front().timestamp_ns),
          format_ns_as_seconds(camera.poses.back().timestamp_ns));
    }
    paths.emplace(group, std::move(path));
  }
  return paths;
}

class Simulation {
 public:
  Simulation(const SimulateRequest& request, CameraModel camera, Trajectory path,
             std::map<std::string, Trajectory> groups, const TagMap& tags, PatternRenderer renderer)
      : request_(request),
        camera_(std::move(camera)),
        path_(std::move(path)),
        groups_(std::move(groups)),
        renderer_(std::move(renderer)) {
    light_.lens_blur_px = request.lens_blur_px;
    light_.gain = request.gain;
    light_.gamma = request.tone_curve.value_or(camera_.parameters().tone_curve.value_or(1.0));
    light_.threads = request.threads;
    for (const auto& [group, unused] : groups_) {
      middles_.emplace(group, middle_of_group(tags, group));
    }
  }

  [[nodiscard]] int frames() const { return static_cast<int>(path_.poses.size()); }
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  [[nodiscard]] const Trajectory& path() const { return path_; }
  [[nodiscard]] const std::map<std::string, Trajectory>& groups() const { return groups_; }

  Result<void> add_scene(GlContext& context, std::shared_ptr<const Scene> scene) {
    tied_ = tag_groups_of(*scene);
    SessionOptions options;
    options.scene_start_ns = path_.poses.front().timestamp_ns;
    PENUMBRA_TRY(auto session, Session::create(context, std::move(scene), camera_,
                                               PoseSource(GivenPoses{}), options));
    session_.emplace(std::move(session));
    return {};
  }

  Result<void> write_frame(int number, const fs::path& file) {
    const std::int64_t middle_ns = path_.poses[static_cast<std::size_t>(number)].timestamp_ns;
    const std::vector<std::int64_t> times = moments(middle_ns, kMostMoments);
    std::vector<CameraPose> poses;
    for (const std::int64_t time : times) poses.push_back(pose_between(path_, time));
    std::vector<GroupPlacement> placements;
    for (const auto& [group, path] : groups_) {
      GroupPlacement& placement = placements.emplace_back();
      placement.group = group;
      for (const std::int64_t time : times) {
        const CameraPose place = pose_between(path, time);
        placement.path.emplace_back(place.rotation(), place.translation());
      }
    }
    PatternRenderOptions light = light_;
    light.cover_share = number < request_.cover_from ? 0.0 : request_.cover_share;
    // Each frame's noise is its own, and does not depend on the frames before.
    light.seed = SplitMix64::nth(request_.seed, static_cast<std::uint64_t>(number));
    if (!session_) {
      light.noise_grey = request_.noise_grey;
      const GreyImage image = renderer_.render(poses, light, placements);
      return save_grey_png(file, image.view());
    }
    // The scene is drawn over the blurred tags at several moments, and the pictures' light is
    // averaged: an object's edge is as blurred as its motion makes it. The noise comes last.
    const GreyImage tags = renderer_.render(poses, light, placements);
    PENUMBRA_TRY(auto drawn, draw_scene(tags, moments(middle_ns, kMostSceneMoments)));
    add_noise(drawn, request_.noise_grey, light.seed);
    return save_png(file, camera_.width(), camera_.height(), drawn);
  }

 private:
  // Moments of an exposure, each standing for the same share of it: close enough for the image to
  // move by a fraction of a pixel from one to the next.
  [[nodiscard]] std::vector<std::int64_t> moments(std::int64_t middle_ns, int most) const {
    const std::int64_t exposure_ns = nanoseconds(request_.exposure_s);
    int count = 1;
    if (exposure_ns > 0) {
      const std::int64_t begin_ns = middle_ns - exposure_ns / 2;
      const std::int64_t end_ns = middle_ns + exposure_ns / 2;
      double moved_px =
          overlay_difference(camera_, pose_between(path_, begin_ns), pose_between(path_, end_ns))
              .rms_px();
      for (const auto& [group, path] : groups_) {
        const auto over_group = [&](std::int64_t time_ns) {
          const CameraPose place = pose_between(path, time_ns);
          const GroupPose T_table_group(place.rotation(), place.translation());
          const auto T_middle_camera =
              (T_table_group * middles_.at(group)).inverse() * pose_between(path_, time_ns);
          return CameraPose(T_middle_camera.rotation(), T_middle_camera.translation());
        };
        const double of_group =
            overlay_difference(camera_, over_group(begin_ns), over_group(end_ns)).rms_px();
        moved_px = std::isfinite(of_group) ? std::max(moved_px, of_group) : of_group;
      }
      // Where the table's middle is not seen nothing says how far the image moves.
      count = std::isfinite(moved_px) && moved_px > 0.0 && moved_px < kMostMoments * kMomentApart_px
                  ? static_cast<int>(std::ceil(2.0 * moved_px / kMomentApart_px)) + 1
                  : kMostMoments;
      count = std::clamp(count, 2, most);
    }
    std::vector<std::int64_t> times;
    for (int k = 0; k < count; ++k) {
      times.push_back(middle_ns +
                      std::llround(static_cast<double>(exposure_ns) * ((k + 0.5) / count - 0.5)));
    }
    return times;
  }

  Result<std::vector<std::uint8_t>> draw_scene(const GreyImage& tags,
                                               const std::vector<std::int64_t>& times) {
    const auto pixels =
        static_cast<std::size_t>(tags.width) * static_cast<std::size_t>(tags.height);
    std::vector<std::uint8_t> rgba(4 * pixels);
    std::vector<double> sum(times.size() > 1 ? 3 * pixels : 0);
    std::array<double, 256> linear{};
    for (std::size_t i = 0; i < linear.size(); ++i)
      linear[i] = std::pow(static_cast<double>(i) / 255.0, light_.gamma);
    for (const std::int64_t time : times) {
      TrackedFrame tracked;
      tracked.frame.width = tags.width;
      tracked.frame.height = tags.height;
      tracked.frame.timestamp_ns = time;
      tracked.frame.planes[0] = {tags.pixels.data(), tags.width, tags.height, tags.width};
      tracked.frame.plane_count = 1;
      tracked.pose.status = TrackStatus::tracked;
      tracked.pose.T_table_camera = pose_between(path_, time);
      tracked.pose.ambiguity_ratio = std::numeric_limits<double>::infinity();
      for (const std::string& name : tied_) {
        GroupEstimate& group = tracked.groups.emplace_back();
        group.name = name;
        group.status = TrackStatus::tracked;
        const auto path = groups_.find(name);
        if (path == groups_.end()) continue;
        const CameraPose place = pose_between(path->second, time);
        group.T_table_group = {place.rotation(), place.translation()};
      }
      PENUMBRA_TRY_VOID(session_->draw(std::move(tracked), rgba));
      if (times.size() == 1) return rgba;
      for (std::size_t i = 0; i < pixels; ++i) {
        for (std::size_t c = 0; c < 3; ++c) sum[3 * i + c] += linear[rgba[4 * i + c]];
      }
    }
    const double share = 1.0 / static_cast<double>(times.size());
    for (std::size_t i = 0; i < pixels; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        rgba[4 * i + c] = static_cast<std::uint8_t>(
            std::lround(255.0 * std::pow(share * sum[3 * i + c], 1.0 / light_.gamma)));
      }
    }
    return rgba;
  }

  const SimulateRequest& request_;
  CameraModel camera_;
  Trajectory path_;
  std::map<std::string, Trajectory> groups_;  // T_table_group
  std::map<std::string, Transform<frame::Group, frame::GroupMiddle>> middles_;
  std::vector<std::string> tied_;  // groups that the scene needs
  PatternRenderer renderer_;
  PatternRenderOptions light_;
  std::optional<Session> session_;
};

}  // namespace

Result<SimulateSummary> run_simulate(const SimulateRequest& request) {
  InterruptWatch interrupt;  // first: OpenGL and the renderer start threads

  auto camera = load_chosen_camera(request.camera, request.camera_name);
  if (!camera) return tl::unexpected(camera.error());
  PENUMBRA_TRY(const auto tags, load_tag_map(request.tags));
  PENUMBRA_TRY(auto path, load_path(request.trajectory));
  // The files go into the recording as they are, with all that they say.
  auto camera_text = request.camera_name.empty() ? read_text_file(request.camera, kLargestText)
                                                 : Result<std::string>(ros_camera_text(*camera));
  if (!camera_text) return tl::unexpected(camera_text.error());
  PENUMBRA_TRY(const auto tags_text, read_text_file(request.tags, kLargestText));
  if (camera->parameters().rolling_shutter_row_s.value_or(0.0) != 0.0) {
    // ... but what would be made up for when it is replayed.
    log_warning(
        "{}: rolling_shutter_row_s: rows are exposed at once here; it is left out of the recording",
        request.camera.string());
    CameraParameters at_once = camera->parameters();
    at_once.rolling_shutter_row_s.reset();
    camera = CameraModel::make(at_once);
    if (!camera) return fail_in(request.camera.string(), camera.error());
    camera_text = ros_camera_text(*camera);
  }
  auto renderer = PatternRenderer::create(*camera, tags.tags());
  if (!renderer) return fail_in(request.tags.string(), renderer.error());

  if (request.cover_from >= static_cast<int>(path.poses.size()) && request.cover_from > 0) {
    return fail("--cover-from: {} is beyond the last frame; {} has {} poses", request.cover_from,
                request.trajectory.string(), path.poses.size());
  }
  PENUMBRA_TRY(auto groups, load_group_paths(request, tags, path));

  std::shared_ptr<const Scene> scene;
  std::unique_ptr<GlContext> context;
  Simulation simulation(request, std::move(*camera), std::move(path), std::move(groups), tags,
                        std::move(*renderer));
  if (request.scene) {
    PENUMBRA_TRY(auto loaded, load_scene(*request.scene));
    scene = std::make_shared<const Scene>(std::move(loaded));
    tell_warnings(*scene, PlanOptions());
    PENUMBRA_TRY(auto opened, open_run_context({false, false}, {simulation.camera().width(),
                                                                simulation.camera().height()}));
    context = std::move(opened);
    PENUMBRA_TRY_VOID(simulation.add_scene(*context, scene));
  }

  interrupt.hold();
  RecordingFolder folder;
  PENUMBRA_TRY_VOID(folder.create(request.output));
  if (auto written = write_text_file(folder.partial() / "camera.yaml", *camera_text); !written)
    return folder.failed(written.error());
  if (auto written = write_text_file(folder.partial() / "tags.yaml", tags_text); !written)
    return folder.failed(written.error());

  SimulateSummary summary;
  // An instant's exposure has no length to tell.
  const bool exposed = request.exposure_s > 0.0;
  std::string listing = fmt::format("frame,timestamp_s,file{}\n", exposed ? ",exposure_s" : "");
  Trajectory truth;
  std::map<std::string, Trajectory> group_truth;
  for (const std::string& group : other_groups(tags)) {
    if (group_file(group)) group_truth[group];
  }
  {
    ProgressBar progress(simulation.frames());
    for (int i = 0; i < simulation.frames() && !summary.interrupted; ++i) {
      const std::string name = fmt::format("frames/{:06}.png", i);
      if (auto written = simulation.write_frame(i, folder.partial() / name); !written)
        return folder.failed(written.error());
      StampedPose pose = simulation.path().poses[static_cast<std::size_t>(i)];
      pose.comment.clear();
      listing += fmt::format("{},{},{}", i, format_ns_as_seconds(pose.timestamp_ns), name);
      listing += exposed ? fmt::format(",{:.7g}\n", request.exposure_s) : std::string("\n");
      for (auto& [group, places] : group_truth) {
        const auto moves = simulation.groups().find(group);
        StampedPose& place = places.poses.emplace_back();
        place.timestamp_ns = pose.timestamp_ns;
        if (moves != simulation.groups().end()) {
          place.T_table_camera = pose_between(moves->second, pose.timestamp_ns);
        }
      }
      truth.poses.push_back(std::move(pose));
      progress.update(++summary.frames);
      summary.interrupted = interrupt.interrupted();
    }
  }
  if (auto written = save_trajectory(folder.partial() / "groundtruth.tum", truth); !written)
    return folder.failed(written.error());
  if (!group_truth.empty()) {
    std::error_code error;
    fs::create_directory(folder.partial() / "groups", error);
    if (error) {
      return fail("{}: cannot be made: {}; choose another place",
                  (request.output / "groups").string(), error.message());
    }
  }
  for (const auto& [group, places] : group_truth) {
    std::string text = "# timestamp tx ty tz qx qy qz qw: T_table_group, seconds and metres\n";
    for (const StampedPose& place : places.poses) text += format_tum(place) + "\n";
    const auto written = write_text_file(folder.partial() / "groups" / *group_file(group), text);
    if (!written) return folder.failed(written.error());
  }
  if (auto written = write_text_file(folder.partial() / "timestamps.csv", listing); !written)
    return folder.failed(written.error());
  PENUMBRA_TRY_VOID(folder.commit());
  return summary;
}

}  // namespace penumbra
