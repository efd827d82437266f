#include "app/recording/simulate_run.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <system_error>
#include <utility>
#include <vector>

#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "app/output/run_outputs.hpp"
#include "app/progress.hpp"
#include "app/recording/recording_folder.hpp"
#include "app/recording/recording_source.hpp"
#include "app/run_inputs.hpp"
#include "app/session/session.hpp"
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

tl::unexpected<Error> cannot_be_made(const fs::path& folder, const std::error_code& error) {
  return fail("{}: cannot be made: {}; choose another place", folder.string(), error.message());
}

constexpr std::size_t kLargestText = std::size_t{16} << 20U;
constexpr int kMaxMoments = 64;           // times sampled within an exposure, for the tags
constexpr int kMaxSceneMoments = 16;      // limit for the objects, which are drawn at each time
constexpr double kMomentApart_px = 0.25;  // limits the image motion between two such times

Result<Trajectory> load_path(const fs::path& file) {
  PENUMBRA_TRY(auto path, load_trajectory(file));
  if (path.poses.empty()) {
    return fail("{}: has no pose; give one line for each frame", file.string());
  }
  return path;
}

// Loads the trajectories of the moving groups. Each must cover the time span of `camera`.
Result<std::map<std::string, Trajectory>> load_group_paths(const SimulateRequest& request,
                                                           const TagMap& tags,
                                                           const Trajectory& camera) {
  std::map<std::string, Trajectory> paths;
  const std::vector<std::string> known = other_groups(tags);
  for (const auto& [group, file] : request.groups) {
    if (std::ranges::find(known, group) == known.end()) {
      return fail(
          "--group {}: {} has no such group; it has {}", group, request.tags.string(),
          known.empty() ? "none beside the table" : fmt::format("{}", fmt::join(known, ", ")));
    }
    if (!group_file(group)) {
      return fail("--group {}: cannot be the name of a file; give it another in {}", group,
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
    attached_groups_ = tag_groups_of(*scene);
    SessionOptions options;
    options.scene_start_ns = path_.poses.front().timestamp_ns;
    PENUMBRA_TRY(auto session, Session::create(context, std::move(scene), camera_,
                                               PoseSource(GivenPoses{}), options));
    session_.emplace(std::move(session));
    return {};
  }

  Result<void> write_frame(int number, const fs::path& file) {
    const std::int64_t middle_ns = path_.poses[static_cast<std::size_t>(number)].timestamp_ns;
    const std::vector<std::int64_t> times = moments(middle_ns, kMaxMoments);
    std::vector<CameraPose> poses;
    for (const std::int64_t time : times) poses.push_back(interpolate_pose(path_, time));
    std::vector<GroupPlacement> placements;
    for (const auto& [group, path] : groups_) {
      GroupPlacement& placement = placements.emplace_back();
      placement.group = group;
      for (const std::int64_t time : times) {
        const CameraPose pose = interpolate_pose(path, time);
        placement.path.emplace_back(pose.rotation(), pose.translation());
      }
    }
    PatternRenderOptions light = light_;
    light.covered_fraction = number < request_.cover_from ? 0.0 : request_.covered_fraction;
    // Seeds each frame by its number, so that its noise does not depend on other frames.
    light.seed = SplitMix64::nth(request_.seed, static_cast<std::uint64_t>(number));
    if (!session_) light.noise_grey = request_.noise_grey;
    const GreyImage tags = renderer_.render(poses, light, placements);
    if (!session_) return save_grey_png(file, tags.view());
    // Draws the scene over the blurred tags at several times and averages the light, which gives
    // the objects motion blur. Noise is added last.
    PENUMBRA_TRY(auto drawn, draw_scene(tags, moments(middle_ns, kMaxSceneMoments)));
    add_noise(drawn, request_.noise_grey, light.seed);
    return save_png(file, camera_.width(), camera_.height(), drawn);
  }

 private:
  static GroupPose group_pose(const Trajectory& path, std::int64_t time_ns) {
    const CameraPose pose = interpolate_pose(path, time_ns);
    return {pose.rotation(), pose.translation()};
  }

  // Returns the centres of equal intervals of an exposure: at most `max_count`, and if possible so
  // close that the image moves by a fraction of a pixel between them.
  [[nodiscard]] std::vector<std::int64_t> moments(std::int64_t middle_ns, int max_count) const {
    const std::int64_t exposure_ns = nanoseconds(request_.exposure_s);
    int count = 1;
    if (exposure_ns > 0) {
      const std::int64_t begin_ns = middle_ns - exposure_ns / 2;
      const std::int64_t end_ns = middle_ns + exposure_ns / 2;
      double moved_px = overlay_difference(camera_, interpolate_pose(path_, begin_ns),
                                           interpolate_pose(path_, end_ns))
                            .rms_px();
      for (const auto& [group, path] : groups_) {
        const auto over_group = [&](std::int64_t time_ns) {
          const auto T_middle_camera = (group_pose(path, time_ns) * middles_.at(group)).inverse() *
                                       interpolate_pose(path_, time_ns);
          return CameraPose(T_middle_camera.rotation(), T_middle_camera.translation());
        };
        const double of_group =
            overlay_difference(camera_, over_group(begin_ns), over_group(end_ns)).rms_px();
        moved_px = std::isfinite(of_group) ? std::max(moved_px, of_group) : of_group;
      }
      // The motion is not finite if the table's middle is outside the image.
      count = std::isfinite(moved_px) && moved_px > 0.0 && moved_px < kMaxMoments * kMomentApart_px
                  ? static_cast<int>(std::ceil(2.0 * moved_px / kMomentApart_px)) + 1
                  : kMaxMoments;
      count = std::clamp(count, 2, max_count);
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
    for (std::size_t i = 0; i < linear.size(); ++i) {
      linear[i] = std::pow(static_cast<double>(i) / 255.0, light_.gamma);
    }
    for (const std::int64_t time : times) {
      TrackedFrame tracked;
      tracked.frame.width = tags.width;
      tracked.frame.height = tags.height;
      tracked.frame.timestamp_ns = time;
      tracked.frame.planes[0] = {tags.pixels.data(), tags.width, tags.height, tags.width};
      tracked.frame.plane_count = 1;
      tracked.pose.status = TrackStatus::tracked;
      tracked.pose.T_table_camera = interpolate_pose(path_, time);
      tracked.pose.ambiguity_ratio = std::numeric_limits<double>::infinity();
      for (const std::string& name : attached_groups_) {
        GroupEstimate& group = tracked.groups.emplace_back();
        group.name = name;
        group.status = TrackStatus::tracked;
        const auto path = groups_.find(name);
        if (path != groups_.end()) group.T_table_group = group_pose(path->second, time);
      }
      PENUMBRA_TRY_VOID(session_->draw(std::move(tracked), rgba));
      if (times.size() == 1) return rgba;
      for (std::size_t i = 0; i < pixels; ++i) {
        for (std::size_t c = 0; c < 3; ++c) sum[3 * i + c] += linear[rgba[4 * i + c]];
      }
    }
    const double fraction = 1.0 / static_cast<double>(times.size());
    for (std::size_t i = 0; i < pixels; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        rgba[4 * i + c] = static_cast<std::uint8_t>(
            std::lround(255.0 * std::pow(fraction * sum[3 * i + c], 1.0 / light_.gamma)));
      }
    }
    return rgba;
  }

  const SimulateRequest& request_;
  CameraModel camera_;
  Trajectory path_;
  std::map<std::string, Trajectory> groups_;  // T_table_group
  std::map<std::string, Transform<frame::Group, frame::GroupMiddle>> middles_;
  std::vector<std::string> attached_groups_;  // groups that the scene needs
  PatternRenderer renderer_;
  PatternRenderOptions light_;
  std::optional<Session> session_;
};

Result<CameraModel> without_rolling_shutter(const CameraModel& camera, const fs::path& file) {
  CameraParameters global_shutter = camera.parameters();
  global_shutter.rolling_shutter_row_s.reset();
  auto made = CameraModel::make(global_shutter);
  if (!made) return fail_in(file.string(), made.error());
  return made;
}

void add_group_poses(const Simulation& simulation, std::int64_t timestamp_ns,
                     std::map<std::string, Trajectory>& group_truth) {
  for (auto& [group, trajectory] : group_truth) {
    const auto moves = simulation.groups().find(group);
    StampedPose& pose = trajectory.poses.emplace_back();
    pose.timestamp_ns = timestamp_ns;
    if (moves != simulation.groups().end())
      pose.T_table_camera = interpolate_pose(moves->second, timestamp_ns);
  }
}

std::string group_poses_text(const Trajectory& trajectory) {
  std::string text = "# timestamp tx ty tz qx qy qz qw: T_table_group, seconds and metres\n";
  for (const StampedPose& pose : trajectory.poses) text += format_tum(pose) + "\n";
  return text;
}

}  // namespace

Result<SimulateSummary> run_simulate(const SimulateRequest& request) {
  InterruptWatch interrupt;  // declared first: OpenGL and the renderer start threads

  PENUMBRA_TRY(auto camera, load_chosen_camera(request.camera, request.camera_name));
  PENUMBRA_TRY(const auto tags, load_tag_map(request.tags));
  PENUMBRA_TRY(auto path, load_path(request.trajectory));
  // The recording contains verbatim copies of the files.
  PENUMBRA_TRY(auto camera_text, request.camera_name.empty()
                                     ? read_text_file(request.camera, kLargestText)
                                     : Result<std::string>(ros_camera_text(camera)));
  PENUMBRA_TRY(const auto tags_text, read_text_file(request.tags, kLargestText));
  if (camera.parameters().rolling_shutter_row_s.value_or(0.0) != 0.0) {
    // Warns, because a replay would correct for a rolling shutter that the images don't have.
    log_warning(
        "{}: rolling_shutter_row_s: the simulation exposes all rows at once; the recording's "
        "camera file omits it",
        request.camera.string());
    PENUMBRA_TRY(camera, without_rolling_shutter(camera, request.camera));
    camera_text = ros_camera_text(camera);
  }
  auto renderer = PatternRenderer::create(camera, tags.tags());
  if (!renderer) return fail_in(request.tags.string(), renderer.error());

  if (request.cover_from >= static_cast<int>(path.poses.size()) && request.cover_from > 0) {
    return fail("--cover-from: {} is beyond the last frame; {} has {} poses", request.cover_from,
                request.trajectory.string(), path.poses.size());
  }
  PENUMBRA_TRY(auto groups, load_group_paths(request, tags, path));

  std::unique_ptr<GlContext> context;
  Simulation simulation(request, std::move(camera), std::move(path), std::move(groups), tags,
                        std::move(*renderer));
  if (request.scene) {
    PENUMBRA_TRY(auto loaded, load_scene(*request.scene));
    auto scene = std::make_shared<const Scene>(std::move(loaded));
    log_scene_warnings(*scene, PlanOptions());
    PENUMBRA_TRY(context, open_run_context({false, false}, {simulation.camera().width(),
                                                            simulation.camera().height()}));
    PENUMBRA_TRY_VOID(simulation.add_scene(*context, std::move(scene)));
  }

  interrupt.hold();
  OutputFolder folder;
  PENUMBRA_TRY_VOID(create_recording_folder(request.output, folder));
  std::error_code error;
  fs::create_directory(folder.partial() / "frames", error);
  if (error) return cannot_be_made(request.output, error);
  const auto write_file = [&folder](const fs::path& name, const std::string& text) {
    return write_text_file(folder.partial() / name, text);
  };
  Result<void> written = write_file("camera.yaml", camera_text);
  if (written) written = write_file("tags.yaml", tags_text);

  SimulateSummary summary;
  const bool exposed = request.exposure_s > 0.0;
  std::string listing = fmt::format("frame,timestamp_s,file{}\n", exposed ? ",exposure_s" : "");
  Trajectory truth;
  std::map<std::string, Trajectory> group_truth;  // T_table_group
  for (const std::string& group : other_groups(tags)) {
    if (group_file(group)) group_truth[group];
  }
  if (!written) return folder.failed(written.error());
  {
    ProgressBar progress(simulation.frames());
    for (int i = 0; i < simulation.frames() && !summary.interrupted; ++i) {
      const std::string name = fmt::format("frames/{:06}.png", i);
      written = simulation.write_frame(i, folder.partial() / name);
      if (!written) return folder.failed(written.error());
      StampedPose pose = simulation.path().poses[static_cast<std::size_t>(i)];
      pose.comment.clear();
      listing += fmt::format("{},{},{}", i, format_ns_as_seconds(pose.timestamp_ns), name);
      listing += exposed ? fmt::format(",{:.7g}\n", request.exposure_s) : std::string("\n");
      add_group_poses(simulation, pose.timestamp_ns, group_truth);
      truth.poses.push_back(std::move(pose));
      progress.update(++summary.frames);
      summary.interrupted = interrupt.interrupted();
    }
  }
  written = save_trajectory(folder.partial() / "groundtruth.tum", truth);
  if (written && !group_truth.empty()) {
    fs::create_directory(folder.partial() / "groups", error);
    if (error) return cannot_be_made(request.output / "groups", error);
  }
  for (const auto& [group, trajectory] : group_truth) {
    if (!written) break;
    written = write_file(fs::path("groups") / *group_file(group), group_poses_text(trajectory));
  }
  if (written) written = write_file("timestamps.csv", listing);
  if (!written) return folder.failed(written.error());
  error = folder.commit();
  if (error) return cannot_be_made(folder.target(), error);
  return summary;
}

}  // namespace penumbra
