// Compares pattern alignment with full-frame libapriltag and PnP in one run on one thread: time and
// overlay error on recordings with exact truth.
//
//   alignment_benchmark FOLDER_OF_RECORDINGS [name ...] [tone=EXPONENT|estimated] [blur=PX]
//                       [exp=FRACTION] [-n] [-f] [-v]
//
// tone=estimated: estimates the exponent from 30 frames of each recording, aligned without a known
// response.
// blur: lens blur (sigma). exp: exposure time as a fraction of the frame interval (1/30 s).
// -n: runs without libapriltag. -f: first repeats the fast alignment 20 times, for a profiler.
// -v: prints a line per frame.
#include <time.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "core/units.hpp"
#include "tracking/alignment/tag_alignment.hpp"
#include "tracking/alignment/tone_estimator.hpp"
#include "tracking/detection/pose_refiner.hpp"
#include "tracking/detection/pose_solver.hpp"
#include "tracking/detection/tag_detector.hpp"
#include "tracking/motion/motion_model.hpp"

namespace {

using namespace penumbra;

double thread_cpu_us() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e6 * static_cast<double>(now.tv_sec) + 1e-3 * static_cast<double>(now.tv_nsec);
}

struct LoadedFrame {
  std::int64_t timestamp_ns = 0;
  Frame frame;
  std::vector<std::uint8_t> scratch;
  ImageView luma_view;
};

struct Recording {
  std::string name;
  CameraModel camera;
  std::vector<MappedTag> tags;
  Trajectory truth;
  std::vector<LoadedFrame> frames;
};

std::optional<Recording> load(const std::filesystem::path& folder) {
  Recording recording;
  recording.name = folder.filename();
  auto camera = load_camera(folder / "camera.yaml");
  auto tags = load_tag_map(folder / "tags.yaml");
  auto truth = load_trajectory(folder / "groundtruth.tum");
  if (!camera || !tags || !truth) {
    std::fprintf(stderr, "%s: not a recording with truth\n", folder.c_str());
    return std::nullopt;
  }
  recording.camera = *camera;
  for (const MappedTag& tag : tags->tags()) {
    if (tag.group == "table") recording.tags.push_back(tag);
  }
  recording.truth = *truth;
  std::ifstream listing(folder / "timestamps.csv");
  std::string line;
  std::getline(listing, line);
  while (std::getline(listing, line)) {
    std::istringstream fields(line);
    std::string number, time, file;
    std::getline(fields, number, ',');
    std::getline(fields, time, ',');
    std::getline(fields, file, ',');
    auto image = load_image(folder / file);
    if (!image) {
      std::fprintf(stderr, "%s\n", image.error().message.c_str());
      return std::nullopt;
    }
    LoadedFrame frame;
    frame.timestamp_ns = nanoseconds(std::strtod(time.c_str(), nullptr));
    frame.frame = *image;
    recording.frames.push_back(std::move(frame));
  }
  for (LoadedFrame& frame : recording.frames) frame.luma_view = luma(frame.frame, frame.scratch);
  return recording;
}

struct Outcome {
  std::vector<double> us;  // CPU time per frame [us]
  Trajectory poses;        // poses of the frames with a verified pose
  int detections = 0;
  double samples = 0.0;       // sum over all frames
  std::vector<double> ratio;  // actual error divided by predicted error
};

std::vector<PointObservation> observations_of(const Recording& recording,
                                              const std::vector<TagDetection>& detections) {
  std::vector<PointObservation> observations;
  for (const TagDetection& detection : detections) {
    for (const MappedTag& tag : recording.tags) {
      if (tag.family != detection.family || tag.id != detection.id) continue;
      const auto corners = tag.corners();
      for (std::size_t k = 0; k < 4; ++k)
        observations.push_back({corners[k], detection.corners_px[k]});
    }
  }
  return observations;
}

std::optional<MapFromCamera> detect_pose(const Recording& recording, TagDetector& detector,
                                         ImageView image, float decimate) {
  const auto observations = observations_of(recording, detector.detect(image, decimate));
  if (observations.empty()) return std::nullopt;
  const auto starts = solve_pose(recording.camera, observations);
  std::optional<RefinedPose> best;
  for (const MapFromCamera& start : starts) {
    const auto refined = refine_pose(recording.camera, observations, start);
    if (refined && (!best || refined->rms_px < best->rms_px)) best = refined;
  }
  if (!best) return std::nullopt;
  return best->T_map_camera;
}

Outcome run_detector(const Recording& recording, float decimate) {
  Outcome outcome;
  const std::vector<TagFamily> families = {TagFamily::tag36h11};
  auto detector = TagDetector::create(families);
  for (const LoadedFrame& frame : recording.frames) {
    const double start = thread_cpu_us();
    const auto pose = detect_pose(recording, *detector, frame.luma_view, decimate);
    outcome.us.push_back(thread_cpu_us() - start);
    if (pose) outcome.poses.poses.push_back({frame.timestamp_ns, as_table_pose(*pose), {}});
  }
  return outcome;
}

bool verbose = false;
bool only_fast = false;
double tone = 1.0;
bool tone_estimated = false;
double blur = 0.58;
double exposure_share = 0.0;

Outcome run_alignment(const Recording& recording, AlignmentEffort effort) {
  Outcome outcome;
  AlignmentOptions options;
  options.effort = effort;
  options.tone_exponent = tone;
  options.blur_px = blur;
  auto aligner = TagAligner::create(recording.camera, recording.tags, options);
  const std::vector<TagFamily> families = {TagFamily::tag36h11};
  auto detector = TagDetector::create(families);
  MotionModel motion;
  for (const LoadedFrame& frame : recording.frames) {
    const double start = thread_cpu_us();
    std::optional<MapFromCamera> pose;
    Matrix6d covariance = Matrix6d::Zero();
    AlignmentCounters counters;
    bool detected = false;
    const auto prior = [](double metres, double radians_) {
      Matrix6d P = Matrix6d::Zero();
      P.diagonal() << metres * metres, metres * metres, metres * metres, radians_ * radians_,
          radians_ * radians_, radians_ * radians_;
      return P;
    };
    if (motion.has_state()) {
      const MotionPrediction prediction = motion.predict(frame.timestamp_ns);
      AlignmentInput input;
      input.luma = frame.luma_view;
      input.predicted = prediction.T_map_camera;
      input.covariance = prediction.covariance;
      input.exposure_motion = exposure_share / 30.0 * prediction.velocity;
      const AlignmentResult result = aligner->align(input);
      counters = result.counters;
      if (result.verified) {
        pose = result.T_map_camera;
        covariance = result.covariance;
        motion.update(frame.timestamp_ns, *pose, covariance);
      }
    }
    if (!pose) {
      ++outcome.detections;
      detected = true;
      if (const auto found = detect_pose(recording, *detector, frame.luma_view, 2.0F)) {
        AlignmentInput input;
        input.luma = frame.luma_view;
        input.predicted = *found;
        input.covariance = prior(0.05, 0.1);
        const AlignmentResult result = aligner->refine(input);
        if (result.verified) {
          pose = result.T_map_camera;
          covariance = result.covariance;
          motion.start(frame.timestamp_ns, *pose, covariance);
        }
      }
      if (!pose) motion.reset();
    }
    outcome.us.push_back(thread_cpu_us() - start);
    outcome.samples += counters.samples;
    if (pose) outcome.poses.poses.push_back({frame.timestamp_ns, as_table_pose(*pose), {}});
    const StampedPose* truth = recording.truth.at(frame.timestamp_ns);
    double error = -1.0;
    double expected = 0.0;
    if (pose && truth != nullptr) {
      error =
          overlay_difference(recording.camera, *pose, as_map_pose(truth->T_table_camera)).rms_px();
      expected = predicted_overlay_error_px(recording.camera, *pose, covariance);
      outcome.ratio.push_back(error / expected);
    }
    if (verbose)
      std::printf("  %4zu %s error %.3f expected %.3f visible %d samples %d us %.0f\n",
                  outcome.us.size() - 1, detected ? "detect" : "align ", error, expected,
                  counters.tags_visible, counters.samples, outcome.us.back());
  }
  return outcome;
}

// Estimates the camera response from frames that are aligned without a known response.
void estimate_tone(const Recording& recording) {
  tone = 1.0;
  const Outcome aligned = run_alignment(recording, AlignmentEffort::accurate);
  ToneEstimator estimator = ToneEstimator::create(recording.camera, recording.tags).value();
  const std::size_t every = std::max<std::size_t>(1, recording.frames.size() / 30);
  const double start = thread_cpu_us();
  int frames_with_pose = 0;
  for (std::size_t i = 0; i < recording.frames.size(); i += every) {
    const StampedPose* pose = aligned.poses.at(recording.frames[i].timestamp_ns);
    if (pose == nullptr) continue;
    ++frames_with_pose;
    estimator.add(recording.frames[i].luma_view, pose->T_table_camera);
  }
  const double us = thread_cpu_us() - start;
  const Result<ToneEstimate> estimate = estimator.estimate();
  if (!estimate) {
    std::printf("%-10s tone curve: %s\n", recording.name.c_str(), estimate.error().message.c_str());
    return;
  }
  tone = estimate->exponent;
  std::printf("%-10s tone curve %.2f +- %.2f, blur %.2f px, by %d of %d frames, %.0f us each\n",
              recording.name.c_str(), tone, estimate->sigma, estimate->blur_px, estimate->images,
              frames_with_pose, us / std::max(frames_with_pose, 1));
}

double median(std::vector<double> values) {
  return statistics_of(std::move(values)).median;
}

void print(const Recording& recording, const char* method, const Outcome& outcome) {
  const Evaluation e = evaluate(recording.camera, outcome.poses, recording.truth);
  std::vector<double> errors;
  int under5 = 0;
  int over1 = 0;
  for (const StampedPose& pose : outcome.poses.poses) {
    const StampedPose* truth = recording.truth.at(pose.timestamp_ns);
    if (truth == nullptr) continue;
    errors.push_back(
        overlay_difference(recording.camera, pose.T_table_camera, truth->T_table_camera).rms_px());
    under5 += errors.back() < 5.0 ? 1 : 0;
    over1 += errors.back() > 1.0 ? 1 : 0;
  }
  const Statistics frame = statistics_of(errors);
  double mean = 0.0;
  for (const double us : outcome.us) mean += us;
  const auto n = static_cast<double>(outcome.us.size());
  mean /= n;
  double ratio = 0.0;
  for (const double r : outcome.ratio) ratio += r * r;
  std::printf(
      "%-10s %-16s %3zu/%-3zu <5px %3d >1px %3d  rms %7.4f med %6.4f p95 %7.4f max %8.3f  jit "
      "%6.4f  "
      "us %7.0f mean %7.0f",
      recording.name.c_str(), method, errors.size(), outcome.us.size(), under5, over1, frame.rmse,
      frame.median, frame.p95, frame.max, e.jitter_px, median(outcome.us), mean);
  if (outcome.samples > 0.0)
    std::printf(
        "  det %d smp %.0f err/exp %.2f", outcome.detections, outcome.samples / n,
        std::sqrt(ratio / static_cast<double>(std::max<std::size_t>(1, outcome.ratio.size()))));
  std::printf("\n");
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: alignment_benchmark FOLDER_OF_RECORDINGS [name ...]\n");
    return 2;
  }
  std::vector<std::string> names;
  bool detectors = true;
  for (int i = 2; i < argc; ++i) {
    if (std::strcmp(argv[i], "-v") == 0) {
      verbose = true;
    } else if (std::strcmp(argv[i], "-n") == 0) {
      detectors = false;
    } else if (std::strcmp(argv[i], "-f") == 0) {
      only_fast = true;
    } else if (std::strncmp(argv[i], "tone=", 5) == 0) {
      tone_estimated = std::strcmp(argv[i] + 5, "estimated") == 0;
      if (!tone_estimated) tone = std::strtod(argv[i] + 5, nullptr);
    } else if (std::strncmp(argv[i], "blur=", 5) == 0) {
      blur = std::strtod(argv[i] + 5, nullptr);
    } else if (std::strncmp(argv[i], "exp=", 4) == 0) {
      exposure_share = std::strtod(argv[i] + 4, nullptr);
    } else {
      names.emplace_back(argv[i]);
    }
  }
  if (names.empty())
    names = {"tabletop", "still", "grazing", "single", "shake", "reentry", "corner"};
  for (const std::string& name : names) {
    const auto recording = load(std::filesystem::path(argv[1]) / name);
    if (!recording) return 1;
    if (tone_estimated) estimate_tone(*recording);
    if (detectors) {
      print(*recording, "libapriltag d1", run_detector(*recording, 1.0F));
      print(*recording, "libapriltag d2", run_detector(*recording, 2.0F));
    }
    if (only_fast) {
      for (int k = 0; k < 20; ++k) run_alignment(*recording, AlignmentEffort::fast);
    }
    print(*recording, "fast", run_alignment(*recording, AlignmentEffort::fast));
    print(*recording, "accurate", run_alignment(*recording, AlignmentEffort::accurate));
  }
  return 0;
}
