// Consistency of the predicted overlay error: ratio of actual to predicted error on random
// synthetic sessions.
//
//   honesty_benchmark [sessions=N] [first=SEED] [frames=N] [near] [moved=SHARE] [csv]
//
// near: distances down to 6 cm, within the overlay's cube.
// moved: before the third frame, a fraction SHARE of the tags (rounded) is moved together by up to
// the size of a tag.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "support/random_session.hpp"
#include "tracking/group_tracker.hpp"

namespace {

using namespace penumbra;
using namespace penumbra::test;

double quantile(std::vector<double> values, double fraction) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1,
                         static_cast<std::size_t>(fraction * static_cast<double>(values.size())))];
}

struct Group {
  int frames = 0, tracked = 0, uncertain = 0, over_1px = 0, over_4_sigma = 0;
  std::vector<double> ratios, errors;
};

}  // namespace

int main(int argc, char** argv) {
  int sessions = 40;
  int first = 1;
  int frames = 16;
  bool csv = false;
  bool near = false;
  double moved_share = 0.0;
  for (int i = 1; i < argc; ++i) {
    if (std::strncmp(argv[i], "sessions=", 9) == 0) sessions = std::atoi(argv[i] + 9);
    if (std::strncmp(argv[i], "first=", 6) == 0) first = std::atoi(argv[i] + 6);
    if (std::strncmp(argv[i], "frames=", 7) == 0) frames = std::atoi(argv[i] + 7);
    if (std::strcmp(argv[i], "csv") == 0) csv = true;
    if (std::strcmp(argv[i], "near") == 0) near = true;
    if (std::strncmp(argv[i], "moved=", 6) == 0) moved_share = std::atof(argv[i] + 6);
  }
  std::map<std::string, Group> groups;
  for (int s = first; s < first + sessions; ++s) {
    SessionKind kind;
    Session session = random_session(static_cast<std::uint64_t>(s), kind);
    if (near) move_near_table(static_cast<std::uint64_t>(s), session);
    PatternRenderer renderer = PatternRenderer::create(session.camera, session.tags).value();
    const std::vector<MappedTag> moved_tags =
        with_displaced_tags(static_cast<std::uint64_t>(s), session.tags, moved_share);
    PatternRenderer moved_renderer = PatternRenderer::create(session.camera, moved_tags).value();
    GroupTracker tracker =
        GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < frames; ++f) {
      const Frame frame = session.image(f >= 2 && moved_share > 0.0 ? moved_renderer : renderer, f);
      const PoseEstimate pose = tracker.track(frame).pose;
      const CameraPose truth = session.truth(f);
      const double error =
          pose.has_pose() ? overlay_difference(session.camera, pose.T_table_camera, truth).rms_px()
                          : -1.0;
      const double motion_px =
          corner_distance_px(session.camera, session.tags, session.motion.at(f * session.frame_s),
                             session.motion.at(f * session.frame_s + session.exposure_s));
      if (csv) {
        std::printf(
            "R,%d,%d,%s,%d,%d,%d,%.2f,%.4f,%.2f,%.2f,%.2f,%s,%d,%.5f,%.5f,%.5f,%.5f,%.5f,%s\n", s,
            f, kLayoutNames[static_cast<std::size_t>(kind.layout)], static_cast<int>(kind.lens),
            kind.haste, kind.tone_known ? 1 : 0, session.light.gamma, session.exposure_s, motion_px,
            session.light.noise_grey, session.light.lens_blur_px,
            std::string(to_string(pose.status)).c_str(), pose.tags_used, error,
            pose.predicted_overlay_error_px, pose.reprojection_rms_px,
            pose.has_pose()
                ? corner_distance_px(session.camera, session.tags, pose.T_table_camera, truth)
                : -1.0,
            1e3 * (pose.T_table_camera.translation() - truth.translation()).norm(),
            text_of(pose.reason).c_str());
        std::fflush(stdout);
      }
      const std::string blur = motion_px < 0.5   ? "<0.5"
                               : motion_px < 2.0 ? "<2"
                               : motion_px < 6.0 ? "<6"
                                                 : ">6";
      for (const std::string& name :
           {std::string("all"),
            "layout " + std::string(kLayoutNames[static_cast<std::size_t>(kind.layout)]),
            "blur px " + blur, std::string(kind.tone_known ? "tone known" : "tone unknown")}) {
        Group& group = groups[name];
        ++group.frames;
        if (pose.status == TrackStatus::uncertain) ++group.uncertain;
        if (pose.status != TrackStatus::tracked) continue;
        ++group.tracked;
        group.errors.push_back(error);
        group.ratios.push_back(error / pose.predicted_overlay_error_px);
        if (error > 1.0) ++group.over_1px;
        if (error > 1.0 && error > 4.0 * pose.predicted_overlay_error_px) ++group.over_4_sigma;
      }
    }
  }
  std::printf(
      "%-20s %6s %7s %9s | error px %7s %7s %7s | error/expected %6s %6s %6s %6s | >1px >1px&>4s\n",
      "", "frames", "tracked", "uncertain", "median", "p95", "max", "p50", "p68", "p95", "max");
  for (const auto& [name, g] : groups) {
    std::printf(
        "%-20s %6d %7d %9d |          %7.3f %7.3f %7.3f |                %6.2f %6.2f %6.2f %6.2f | "
        "%4d %4d\n",
        name.c_str(), g.frames, g.tracked, g.uncertain, quantile(g.errors, 0.5),
        quantile(g.errors, 0.95), quantile(g.errors, 1.0), quantile(g.ratios, 0.5),
        quantile(g.ratios, 0.68), quantile(g.ratios, 0.95), quantile(g.ratios, 1.0), g.over_1px,
        g.over_4_sigma);
  }
  return 0;
}
