#include "benchmarks/peers/comparison.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/assert.hpp"
#include "core/stopwatch.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra::peers {
namespace {

NamedMethod ours(std::string_view name, TrackingMode mode, const CameraModel& camera,
                 const TagMap& tags) {
  return {std::string(name), true, [mode, camera, tags] {
            TrackerOptions options;
            options.mode = mode;
            auto tracker =
                std::make_shared<GroupTracker>(GroupTracker::create(camera, tags, options).value());
            return Method([tracker](const Frame& frame) -> std::optional<Found> {
              const PoseEstimate pose = tracker->track(frame).pose;
              if (!pose.has_pose()) return std::nullopt;
              return Found{pose.T_table_camera, pose.status == TrackStatus::tracked};
            });
          }};
}

NamedMethod theirs(std::string name, std::function<std::unique_ptr<Peer>()> make) {
  return {std::move(name), false, [make = std::move(make)]() -> Method {
            const std::shared_ptr<Peer> peer = make();
            if (!peer) return nullptr;
            return [peer, scratch = std::vector<std::uint8_t>()](
                       const Frame& frame) mutable -> std::optional<Found> {
              const auto pose = peer->find(luma(frame, scratch));
              if (!pose) return std::nullopt;
              return Found{*pose, true};
            };
          }};
}

// Returns true if the estimate is the second (mirrored) pose of a planar target: the estimated
// table normal is closer to the true normal mirrored at the line of sight than to the true normal.
bool is_flipped(const CameraPose& estimated, const CameraPose& truth) {
  const auto T_camera_table = truth.inverse();
  const Eigen::Vector3d sight = T_camera_table.translation().normalized();
  const Eigen::Vector3d normal = T_camera_table.rotation() * Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d mirrored = 2.0 * normal.dot(sight) * sight - normal;
  const Eigen::Vector3d found = estimated.inverse().rotation() * Eigen::Vector3d::UnitZ();
  return found.dot(mirrored) > found.dot(normal);
}

}  // namespace

std::vector<NamedMethod> all_methods(const CameraModel& camera, const TagMap& tags) {
  const auto detected = [&](float decimate, PoseBy pose_by) {
    return [=] { return make_libapriltag(camera, tags, decimate, pose_by); };
  };
  const auto aruco = [&](ArucoCorners corners) {
    return [=] { return make_aruco(camera, tags, corners); };
  };
  const auto visp = [&](float decimate) {
    return [=] { return make_visp(camera, tags, decimate); };
  };
  return {ours(kFast, TrackingMode::fast, camera, tags),
          ours(kAccurate, TrackingMode::accurate, camera, tags),
          ours(kAuto, TrackingMode::automatic, camera, tags),
          theirs(std::string(kDecimate1), detected(1.0F, PoseBy::pnp)),
          theirs("libapriltag d1 + our pose", detected(1.0F, PoseBy::refinement)),
          theirs(std::string(kDecimate2), detected(2.0F, PoseBy::pnp)),
          theirs("libapriltag d2 + our pose", detected(2.0F, PoseBy::refinement)),
          theirs("OpenCV SUBPIX + PnP", aruco(ArucoCorners::subpix)),
          theirs("OpenCV APRILTAG + PnP", aruco(ArucoCorners::apriltag)),
          theirs("ViSP d1", visp(1.0F)),
          theirs("ViSP d2", visp(2.0F))};
}

double Outcome::median_ms() const {
  return statistics_of(ms).median;
}
double Outcome::mean_ms() const {
  return std::accumulate(ms.begin(), ms.end(), 0.0) / static_cast<double>(ms.size());
}
int Outcome::within(double px) const {
  return static_cast<int>(std::count_if(overlay_px.begin(), overlay_px.end(),
                                        [px](double e) { return e >= 0.0 && e < px; }));
}
int Outcome::beyond(double px) const {
  return static_cast<int>(
      std::count_if(overlay_px.begin(), overlay_px.end(), [px](double e) { return e > px; }));
}
double Outcome::largest_px() const {
  return overlay_px.empty() ? 0.0 : *std::max_element(overlay_px.begin(), overlay_px.end());
}

std::vector<Outcome> compare(const Footage& footage, const std::vector<NamedMethod>& methods,
                             int repetitions) {
  const std::size_t n = footage.frames.size();
  std::vector<Outcome> outcomes;
  std::vector<const NamedMethod*> present;
  for (const NamedMethod& method : methods) {
    if (!method.make()) continue;
    Outcome outcome;
    outcome.name = method.name;
    outcome.ours = method.ours;
    outcome.ms.assign(n, std::numeric_limits<double>::infinity());
    outcome.overlay_px.assign(n, -1.0);
    outcome.poses.resize(n);
    outcome.posed.assign(n, false);
    outcomes.push_back(std::move(outcome));
    present.push_back(&method);
  }
  for (int repetition = 0; repetition < repetitions; ++repetition) {
    for (std::size_t m = 0; m < present.size(); ++m) {
      const Method method = present[m]->make();
      Outcome& outcome = outcomes[m];
      Trajectory tracked;
      for (std::size_t i = 0; i < n; ++i) {
        const Frame& frame = footage.frames[i];
        const Stopwatch watch;
        const std::optional<Found> found = method(frame);
        outcome.ms[i] = std::min(outcome.ms[i], watch.elapsed().cpu_ms);
        if (repetition > 0 || !found) continue;
        outcome.posed[i] = true;
        outcome.poses[i] = found->T_table_camera;
        if (!found->tracked) continue;
        tracked.poses.push_back({frame.timestamp_ns, found->T_table_camera, {}});
        ++outcome.tracked;
        const StampedPose* truth = footage.truth.at(frame.timestamp_ns);
        if (truth == nullptr) continue;
        const double error =
            overlay_difference(footage.camera, found->T_table_camera, truth->T_table_camera)
                .rms_px();
        outcome.overlay_px[i] = error;
        if (error > 5.0) ++outcome.wrong;
        if (error > 1.0 && is_flipped(found->T_table_camera, truth->T_table_camera))
          ++outcome.flips;
      }
      if (repetition == 0) outcome.evaluation = evaluate(footage.camera, tracked, footage.truth);
    }
  }
  return outcomes;
}

const Outcome& outcome_of(const std::vector<Outcome>& outcomes, std::string_view name) {
  const auto found = std::find_if(outcomes.begin(), outcomes.end(),
                                  [&](const Outcome& outcome) { return outcome.name == name; });
  PENUMBRA_ASSERT(found != outcomes.end());
  return *found;
}

}  // namespace penumbra::peers
