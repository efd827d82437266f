// Compares our tracker with its peers on the same frames, in one run on one thread: CPU time and
// error. Also prints each tracking goal with the value reached. Output is Markdown.
//
//   peers_benchmark FOLDER_OF_RECORDINGS [REAL_VIDEO|-] [RESULTS.json] [repetitions=N]
//                   [only=NAME,...] [quick]
//
// REAL_VIDEO: folder of visp-rbt-sequence (peers/comparison.hpp). quick: fewer synthetic images.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/recording/recording_source.hpp"
#include "benchmarks/peers/comparison.hpp"
#include "benchmarks/synthetic_trials.hpp"
#include "support/visibility.hpp"

namespace penumbra::peers {
namespace {

struct Options {
  std::filesystem::path recordings;
  std::filesystem::path video;
  std::filesystem::path results;
  int repetitions = 3;
  std::vector<std::string> only;
  bool quick = false;
};

struct Goal {
  std::string on, measure, goal, reached;
  bool met = false;
};

Footage load(const std::filesystem::path& folder) {
  const Recording recording = open_recording(folder).value();
  Footage footage{recording.name, *recording.camera, *recording.tags, *recording.groundtruth, {}};
  const auto source = open_recording_source(recording).value();
  while (std::optional<Frame> frame = source->next().value()) footage.frames.push_back(*frame);
  return footage;
}

std::string number(double value) {
  return std::isfinite(value) ? fmt::format("{:.3g}", value) : "-";
}

void print_row(const std::vector<std::string>& cells) {
  std::string line = "|";
  for (const std::string& cell : cells) line += " " + cell + " |";
  std::printf("%s\n", line.c_str());
}

void print_comparison(const Footage& footage, const std::vector<Outcome>& outcomes,
                      nlohmann::ordered_json& results) {
  std::printf("**%s**, %zu frames of %dx%d\n\n", footage.name.c_str(), footage.frames.size(),
              footage.camera.width(), footage.camera.height());
  std::printf(
      "| method | median [CPU ms] | mean | d2 / median | posed | wrong | overlay rms [px] | p95 | "
      "max | jitter |\n|---|---|---|---|---|---|---|---|---|---|\n");
  const double d2 = outcome_of(outcomes, kDecimate2).median_ms();
  for (const Outcome& o : outcomes) {
    const Evaluation& e = o.evaluation;
    const bool any_tracked = o.tracked > 0;
    print_row({o.name, number(o.median_ms()), number(o.mean_ms()),
               fmt::format("{:.1f}", d2 / o.median_ms()), std::to_string(o.tracked),
               std::to_string(o.wrong), any_tracked ? number(e.overlay_px.rmse) : "",
               any_tracked ? number(e.overlay_px.p95) : "",
               any_tracked ? number(e.overlay_px.max) : "",
               e.jitter_changes > 0 ? number(e.jitter_px) : ""});
    results["recordings"][footage.name].push_back({{"name", o.name},
                                                   {"ours", o.ours},
                                                   {"median_ms", o.median_ms()},
                                                   {"mean_ms", o.mean_ms()},
                                                   {"frames", footage.frames.size()},
                                                   {"posed", o.tracked},
                                                   {"wrong", o.wrong},
                                                   {"overlay_rms_px", e.overlay_px.rmse}});
  }
  std::printf("\n");
  std::fflush(stdout);
}

// Formats the values of all modes: "fast 0.123, accurate 0.056, auto 0.056".
template <class Value>
std::string of_three(const std::vector<Outcome>& outcomes, Value value) {
  return fmt::format("fast {}, accurate {}, auto {}", value(outcome_of(outcomes, kFast)),
                     value(outcome_of(outcomes, kAccurate)), value(outcome_of(outcomes, kAuto)));
}

// Returns whether the default mode meets a goal; goals without a mode in their names use this.
template <class Holds>
bool by_default(const std::vector<Outcome>& outcomes, Holds holds) {
  return holds(outcome_of(outcomes, kAuto));
}

void add_speed_goals(const std::string& name, const std::vector<Outcome>& outcomes,
                     std::vector<Goal>& goals) {
  const Outcome& fast = outcome_of(outcomes, kFast);
  const Outcome& accurate = outcome_of(outcomes, kAccurate);
  const Outcome& d1 = outcome_of(outcomes, kDecimate1);
  const Outcome& d2 = outcome_of(outcomes, kDecimate2);
  const auto time = [&](const std::string& mode, double ratio, double min_ratio,
                        const std::string& other) {
    goals.push_back({name, fmt::format("{}: median time against {} + PnP", mode, other),
                     fmt::format("<= 1/{:.0f}", min_ratio), fmt::format("1/{:.1f}", ratio),
                     ratio >= min_ratio});
  };
  const auto error = [&](const std::string& mode, const Outcome& outcome, double max_ratio) {
    const double ratio = outcome.evaluation.overlay_px.rmse / d1.evaluation.overlay_px.rmse;
    goals.push_back({name, mode + ": overlay RMS against decimate 1",
                     fmt::format("<= {:.2f}", max_ratio), fmt::format("{:.2f}", ratio),
                     ratio <= max_ratio});
  };
  time("fast", d2.median_ms() / fast.median_ms(), 20.0, "decimate 2");
  time("fast", d1.median_ms() / fast.median_ms(), 60.0, "decimate 1");
  error("fast", fast, 0.55);
  time("accurate", d1.median_ms() / accurate.median_ms(), 30.0, "decimate 1");
  error("accurate", accurate, 0.42);
}

void add_goals(const Footage& footage, const std::filesystem::path& folder,
               const std::vector<Outcome>& outcomes, std::vector<Goal>& goals) {
  const std::string& name = footage.name;
  const auto frames = static_cast<int>(footage.frames.size());
  const Outcome& d1 = outcome_of(outcomes, kDecimate1);
  const auto add = [&](const std::string& measure, const std::string& goal, auto value,
                       auto holds) {
    goals.push_back({name, measure, goal, of_three(outcomes, value), by_default(outcomes, holds)});
  };
  const auto rms_over_d1 = [&](const Outcome& o) {
    return o.evaluation.overlay_px.rmse / d1.evaluation.overlay_px.rmse;
  };
  const auto wrong = [&] {
    add(
        "wrong frames among those reported as tracked", "0",
        [](const Outcome& o) { return o.wrong; }, [](const Outcome& o) { return o.wrong == 0; });
  };
  if (name == "tabletop" || name == "still") add_speed_goals(name, outcomes, goals);
  if (name == "tabletop") {
    add(
        "tracked frames beyond 1 px", "0", [](const Outcome& o) { return o.beyond(1.0); },
        [](const Outcome& o) { return o.beyond(1.0) == 0; });
  } else if (name == "still") {
    const auto jitter = [&](const Outcome& o) {
      return o.evaluation.jitter_px / d1.evaluation.jitter_px;
    };
    add(
        "jitter against decimate 1", "<= 0.75",
        [&](const Outcome& o) { return fmt::format("{:.2f}", jitter(o)); },
        [&](const Outcome& o) { return jitter(o) <= 0.75; });
  } else if (name == "grazing") {
    add(
        "tracked frames", std::to_string(frames), [](const Outcome& o) { return o.tracked; },
        [&](const Outcome& o) { return o.tracked == frames; });
    add(
        "largest error of a frame [px]", "< 0.5",
        [](const Outcome& o) { return fmt::format("{:.3f}", o.largest_px()); },
        [](const Outcome& o) { return o.largest_px() < 0.5; });
    add(
        "overlay RMS against decimate 1", "<= 0.1",
        [&](const Outcome& o) { return fmt::format("{:.3f}", rms_over_d1(o)); },
        [&](const Outcome& o) { return rms_over_d1(o) <= 0.1; });
  } else if (name == "shake") {
    add(
        "frames under 5 px", ">= 81", [](const Outcome& o) { return o.within(5.0); },
        [](const Outcome& o) { return o.within(5.0) >= 81; });
    wrong();
  } else if (name == "single") {
    add(
        "frames tracked under 5 px", ">= 88", [](const Outcome& o) { return o.within(5.0); },
        [](const Outcome& o) { return o.within(5.0) >= 88; });
    wrong();
    add(
        "flips", "0", [](const Outcome& o) { return o.flips; },
        [](const Outcome& o) { return o.flips == 0; });
    add(
        "overlay RMS against decimate 1", "<= 0.4",
        [&](const Outcome& o) { return fmt::format("{:.2f}", rms_over_d1(o)); },
        [&](const Outcome& o) { return rms_over_d1(o) <= 0.4; });
  } else if (name == "reentry") {
    const std::vector<int> corners = test::max_corners_in_view(folder, footage.frames.size());
    if (corners.empty()) return;
    std::size_t back = 0;  // frame in which a whole tag is in view again
    for (std::size_t i = 1; i < corners.size(); ++i) {
      if (corners[i] == 4 && corners[i - 1] < 4) back = i;
    }
    const auto until_tracked = [&](const Outcome& o) {
      std::size_t i = back;
      while (i < o.overlay_px.size() && o.overlay_px[i] < 0.0) ++i;
      return static_cast<int>(i - back);
    };
    const auto reported_away = [&](const Outcome& o) {
      int count = 0;
      for (std::size_t i = 0; i < corners.size(); ++i)
        count += corners[i] == 0 && o.overlay_px[i] >= 0.0 ? 1 : 0;
      return count;
    };
    add("frames until tracked again, once a whole tag is back", "<= 3", until_tracked,
        [&](const Outcome& o) { return until_tracked(o) <= 3; });
    add("frames reported as tracked with the board away", "0", reported_away,
        [&](const Outcome& o) { return reported_away(o) == 0; });
  }
}

// Distances [px] of the tags' corners, reprojected with a method's pose.
struct Reprojection {
  std::vector<double> to_reference;  // RMS per frame, to the corners reprojected with the reference
  std::vector<double> to_detected;   // RMS per frame, with the pose from libapriltag's corners
  std::vector<double> to_corners;    // distance of each corner to libapriltag's corner (decimate 1)
};
Reprojection reprojection(const RealVideo& video, const Outcome& outcome, const Outcome& detected) {
  Reprojection result;
  const CameraModel& camera = video.footage.camera;
  for (std::size_t i = 0; i < video.corners.size(); ++i) {
    const StampedPose* reference = video.footage.truth.at(video.footage.frames[i].timestamp_ns);
    if (reference == nullptr || outcome.overlay_px[i] < 0.0 || video.corners[i].empty()) continue;
    const auto T_reference = reference->T_table_camera.inverse();
    const auto T_found = outcome.poses[i].inverse();
    const auto T_detected = detected.poses[i].inverse();
    double to_reference = 0.0;
    double to_detected = 0.0;
    for (const PointObservation& corner : video.corners[i]) {
      const auto a = camera.project(T_reference * corner.p_map);
      const auto b = camera.project(T_found * corner.p_map);
      const auto c = camera.project(T_detected * corner.p_map);
      const double far = camera.width();
      to_reference += a && b ? (*a - *b).squaredNorm() : far * far;
      to_detected += b && c ? (*b - *c).squaredNorm() : far * far;
      result.to_corners.push_back(b ? (*b - corner.pixel).norm() : far);
    }
    const auto count = static_cast<double>(video.corners[i].size());
    result.to_reference.push_back(std::sqrt(to_reference / count));
    if (detected.posed[i]) result.to_detected.push_back(std::sqrt(to_detected / count));
  }
  return result;
}

void compare_on_video(const Options& options, nlohmann::ordered_json& results,
                      std::vector<Goal>& goals) {
  const auto video = load_real_video(options.video);
  if (!video) {
    std::fprintf(stderr, "%s\n", video.error().message.c_str());
    std::exit(1);
  }
  const Footage& footage = video->footage;
  const std::vector<Outcome> outcomes =
      compare(footage, all_methods(footage.camera, footage.tags), options.repetitions);
  std::printf(
      "**%s**, a real video of %zu frames of %dx%d, %d tags; reference: bundle adjustment over "
      "points "
      "inside the tags, %.2f px RMS\n\n",
      footage.name.c_str(), footage.frames.size(), footage.camera.width(), footage.camera.height(),
      video->tags, video->rms_px);
  std::printf(
      "| method | median [CPU ms] | mean | d2's mean / mean | posed | to the reference, rms [px] | "
      "p95 | max | to d1 + our pose, p95 | to d1's corners, p95 "
      "|\n|---|---|---|---|---|---|---|---|---|---|\n");
  const double d2_mean = outcome_of(outcomes, kDecimate2).mean_ms();
  const Outcome& detected = outcome_of(outcomes, kDecimate1Ours);
  std::map<std::string, double> p95;
  for (const Outcome& o : outcomes) {
    const Reprojection r = reprojection(*video, o, detected);
    const Statistics s = statistics_of(r.to_reference);
    p95[o.name] = s.p95;
    print_row({o.name, number(o.median_ms()), number(o.mean_ms()),
               fmt::format("{:.1f}", d2_mean / o.mean_ms()), std::to_string(o.tracked),
               number(s.rmse), number(s.p95), number(s.max),
               number(statistics_of(r.to_detected).p95), number(statistics_of(r.to_corners).p95)});
    results["video"].push_back({{"name", o.name},
                                {"ours", o.ours},
                                {"median_ms", o.median_ms()},
                                {"mean_ms", o.mean_ms()},
                                {"frames", footage.frames.size()},
                                {"posed", o.tracked},
                                {"reprojection_rms_px", s.rmse}});
  }
  std::printf("\n");
  const auto ratio = [&](const Outcome& o) { return d2_mean / o.mean_ms(); };
  goals.push_back(
      {footage.name, "mean time, recoveries included, against decimate 2", "<= 1/25",
       of_three(outcomes, [&](const Outcome& o) { return fmt::format("1/{:.1f}", ratio(o)); }),
       by_default(outcomes, [&](const Outcome& o) { return ratio(o) >= 25.0; })});
  const double limit = p95[std::string(kDecimate2)];
  goals.push_back(
      {footage.name, "reprojection p95 against the bundle-adjusted reference",
       fmt::format("<= {:.3f} px, decimate 2's", limit),
       of_three(outcomes, [&](const Outcome& o) { return fmt::format("{:.3f}", p95[o.name]); }),
       by_default(outcomes, [&](const Outcome& o) { return p95[o.name] <= limit; })});
}

void add_synthetic_goals(bool quick, std::vector<Goal>& goals) {
  test::SyntheticTrials trials;
  const int views = quick ? 4 : 24;
  const auto bound = [&](AlignmentEffort effort, const std::string& name, double limit) {
    const double ratio = trials.noise(effort, 2.0, views, true, 8).over_bound();
    goals.push_back(
        {"synthetic, noise 2 grey levels", name + ": overlay error over the Cramer-Rao bound",
         fmt::format("<= {:.1f}", limit), fmt::format("{:.2f}", ratio), ratio <= limit});
  };
  bound(AlignmentEffort::fast, "fast", 4.0);
  bound(AlignmentEffort::accurate, "accurate", 1.7);
  const test::TrialScore covered = trials.cover(0.3, views);
  goals.push_back({"synthetic, 30 % of every tag covered", "kept; overlay RMS [px]",
                   "100 %; <= 0.035",
                   fmt::format("{:.0f} %; {:.4f}", 100.0 * covered.found_share(), covered.rms_px()),
                   covered.found == covered.runs && covered.rms_px() <= 0.035});
  // Cells are about 10 px wide.
  for (const auto& [cells, min_fraction] : {std::pair(0.8, 0.98), std::pair(1.6, 0.90)}) {
    const test::TrialScore score = trials.basin(10.0 * cells, quick ? 2 : 12, 12);
    goals.push_back({"synthetic, start error",
                     fmt::format("converged from {} cells at the tags' corners", cells),
                     fmt::format(">= {:.0f} %", 100.0 * min_fraction),
                     fmt::format("{:.1f} % of {}", 100.0 * score.found_share(), score.runs),
                     score.found_share() >= min_fraction && score.wrong == 0});
  }
}

Frame frame_of(const GreyImage& image) {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, image.width, image.height);
  for (int y = 0; y < image.height; ++y) {
    std::copy_n(image.view().row(y), image.width,
                buffer.plane_data[0] + y * buffer.frame.planes[0].stride);
  }
  return buffer.frame;
}

// Compares all methods on the same noisy exact images: error relative to the Cramer-Rao bound.
void compare_with_bound(bool quick) {
  test::SyntheticTrials trials;
  const int views = quick ? 4 : 24;
  const int draws = 2;
  std::vector<NamedMethod> peers;
  for (const NamedMethod& method :
       all_methods(trials.camera(), TagMap::make(trials.tags()).value())) {
    if (!method.ours && method.make) peers.push_back(method);
  }
  std::printf(
      "**synthetic**, %d views of six tags at %d x %d, each twice with other noise; ours from a "
      "start 2 px off, as within a session\n\n",
      views, trials.camera().width(), trials.camera().height());
  std::printf(
      "| method | noise [grey levels] | median [CPU ms] | found | overlay rms [px] | error over "
      "the "
      "Cramer-Rao bound |\n|---|---|---|---|---|---|\n");
  const auto print = [&](const std::string& name, double noise, const test::TrialScore& score) {
    print_row({name, fmt::format("{:.0f}", noise), number(1e-3 * statistics_of(score.us).median),
               fmt::format("{} of {}", score.found, score.runs),
               score.found > 0 ? number(score.rms_px()) : "",
               score.found > 0 ? number(score.over_bound()) : ""});
  };
  for (const double noise : {1.0, 2.0, 5.0}) {
    print("penumbra fast, alignment", noise,
          trials.noise(AlignmentEffort::fast, noise, views, true, draws));
    print("penumbra accurate, alignment", noise,
          trials.noise(AlignmentEffort::accurate, noise, views, true, draws));
    std::vector<test::TrialScore> scores(peers.size());
    std::vector<Method> methods;
    for (const NamedMethod& peer : peers) methods.push_back(peer.make());
    trials.noise_by(noise, views, draws, scores, [&](std::size_t k, const GreyImage& image) {
      const std::optional<Found> found = methods[k](frame_of(image));
      return found ? std::optional(found->T_table_camera) : std::nullopt;
    });
    for (std::size_t k = 0; k < peers.size(); ++k) print(peers[k].name, noise, scores[k]);
  }
  std::printf("\n");
  std::fflush(stdout);
}

int run(const Options& options) {
  nlohmann::ordered_json results;
  std::vector<Goal> goals;
  const auto wanted = [&](const std::string& name) {
    return options.only.empty() ||
           std::find(options.only.begin(), options.only.end(), name) != options.only.end();
  };
  for (const char* name : {"tabletop", "still", "grazing", "shake", "single", "reentry"}) {
    const std::filesystem::path folder = options.recordings / name;
    if (!wanted(name) || !std::filesystem::exists(folder / "groundtruth.tum")) continue;
    const Footage footage = load(folder);
    const std::vector<Outcome> outcomes =
        compare(footage, all_methods(footage.camera, footage.tags), options.repetitions);
    print_comparison(footage, outcomes, results);
    add_goals(footage, folder, outcomes, goals);
  }
  if (wanted("video") && std::filesystem::exists(options.video / "cam.json"))
    compare_on_video(options, results, goals);
  if (wanted("synthetic")) {
    compare_with_bound(options.quick);
    add_synthetic_goals(options.quick, goals);
  }

  std::printf("**Goals**\n\n| on | measure | goal | reached | |\n|---|---|---|---|---|\n");
  for (const Goal& goal : goals) {
    print_row({goal.on, goal.measure, goal.goal, goal.reached, goal.met ? "" : "**missed**"});
    results["goals"].push_back({{"on", goal.on},
                                {"measure", goal.measure},
                                {"goal", goal.goal},
                                {"reached", goal.reached},
                                {"met", goal.met}});
  }
  if (!options.results.empty()) std::ofstream(options.results) << results.dump(1) << "\n";
  return 0;
}

}  // namespace
}  // namespace penumbra::peers

int main(int argc, char** argv) {
  penumbra::peers::Options options;
  std::vector<std::string> paths;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument.starts_with("repetitions=")) {
      options.repetitions = std::max(1, std::atoi(argument.c_str() + 12));
    } else if (argument.starts_with("only=")) {
      std::string rest = argument.substr(5);
      while (!rest.empty()) {
        const std::size_t comma = std::min(rest.find(','), rest.size());
        options.only.push_back(rest.substr(0, comma));
        rest.erase(0, comma + 1);
      }
    } else if (argument == "quick") {
      options.quick = true;
    } else {
      paths.push_back(argument);
    }
  }
  if (paths.empty() || paths.size() > 3) {
    std::fprintf(stderr,
                 "usage: peers_benchmark FOLDER_OF_RECORDINGS [REAL_VIDEO|-] [RESULTS.json] "
                 "[repetitions=N] [only=NAME,...] [quick]\n");
    return 2;
  }
  options.recordings = paths[0];
  if (paths.size() > 1) options.video = paths[1];
  if (paths.size() > 2) options.results = paths[2];
  return penumbra::peers::run(options);
}
