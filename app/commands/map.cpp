// penumbra map: surveys the tags in a recording and writes their tags.yaml.

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <stop_token>
#include <utility>
#include <vector>

#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"
#include "app/recording/recording_source.hpp"
#include "app/run_inputs.hpp"
#include "calib/refinement/refined_record.hpp"
#include "calib/survey/lens_refinement.hpp"
#include "calib/survey/sweep.hpp"
#include "calib/survey/tag_survey.hpp"
#include "core/camera/camera_file.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"

namespace penumbra {
namespace {

struct MapOptions {
  std::filesystem::path recording;
  std::filesystem::path camera;
  std::string camera_name;
  std::filesystem::path sizes;
  std::filesystem::path output;
  std::string family = "tag36h11";
  std::string plane = "fitted";
  std::filesystem::path refined_camera;
  SurveyOptions survey;
};

// Surveys a recording. Each step fails if the user interrupts the command.
class Sweep {
 public:
  Sweep(const MapOptions& options, const Recording& recording, const SurveyOptions& survey)
      : options_(options), recording_(recording), survey_(survey) {
    interrupt_.hold();
  }

  Result<SweptTags> survey(bool refine_camera) {
    PENUMBRA_TRY(auto frames, detect());
    const SweepSteps steps{[this](const CameraModel& camera, std::span<const SurveyFrame> all,
                                  bool with_lens) { return survey_frames(camera, all, with_lens); },
                           [this](const TagSurvey& at, std::vector<SurveyFrame>& all) {
                             return measure_edges(at, all);
                           }};
    const RowTimeGoal row_time = refine_camera ? RowTimeGoal::estimated : RowTimeGoal::reported;
    return survey_sweep(*recording_.camera, std::move(frames), steps, {row_time, refine_camera});
  }

 private:
  Result<std::vector<SurveyFrame>> detect() {
    PENUMBRA_TRY(auto detector, TagDetector::create(std::array{survey_.family}));
    std::vector<SurveyFrame> frames;
    PENUMBRA_TRY_VOID(
        for_each_frame("frames", [&](const Frame& frame, std::size_t, ImageView luma) {
          frames.push_back({detector.detect(luma), {}, seconds(frame.timestamp_ns)});
        }));
    return frames;
  }
  // Measures the edges at the surveyed tag positions, with the surveyed curvature and lens.
  Result<void> measure_edges(const TagSurvey& at, std::vector<SurveyFrame>& frames) {
    return for_each_frame("edges", [&](const Frame&, std::size_t index, ImageView luma) {
      if (index < frames.size()) frames[index] = measured_frame(at, index, frames[index], luma);
    });
  }
  Result<TagSurvey> survey_frames(const CameraModel& camera, std::span<const SurveyFrame> frames,
                                  bool refine_camera) {
    auto result = run_stoppable(interrupt_, [&](std::stop_token stop) {
      survey_.stop = std::move(stop);
      survey_.refine_camera = refine_camera;
      return survey_tags(camera, frames, survey_);
    });
    if (interrupt_.interrupted()) return ended_early();
    if (!result) return fail_in(options_.recording.string(), result.error());
    return result;
  }
  [[nodiscard]] tl::unexpected<Error> ended_early() const {
    return fail("{}: ended early; no file was written", options_.recording.string());
  }

  // Calls `visit(frame, index, luma)` for every frame.
  template <class Visit>
  Result<void> for_each_frame(const char* what, const Visit& visit) {
    PENUMBRA_TRY(auto source, open_recording_source(recording_));
    ProgressBar progress(source->frame_count().value_or(0), what);
    std::vector<std::uint8_t> scratch;
    for (std::size_t index = 0;; ++index) {
      PENUMBRA_TRY(const auto frame, source->next());
      if (!frame) return {};
      visit(*frame, index, luma(*frame, scratch));
      progress.update(static_cast<int>(index) + 1);
      if (interrupt_.interrupted()) return ended_early();
    }
  }

  const MapOptions& options_;
  const Recording& recording_;
  SurveyOptions survey_;
  InterruptWatch interrupt_;
};

void print_tags(const TagSurvey& survey, const MapOptions& options) {
  for (const std::string& line : survey.left_out) fmt::print("rejected: {}\n", line);
  fmt::print("{:>5}{:>9}{:>11}{:>11}{:>11}{:>15}\n", "tag", "frames", "x [mm]", "y [mm]", "z [mm]",
             "1 sigma [mm]");
  for (const SurveyedTag& tag : survey.tags) {
    const Eigen::Vector3d p = tag.tag.T_table_tag.translation() * 1e3;
    const double sigma = std::sqrt(tag.covariance.topLeftCorner<3, 3>().trace() / 3.0) * 1e3;
    fmt::print("{:>5}{:>9}{:>11.2f}{:>11.2f}{:>11.2f}{:>15.3f}\n", tag.tag.id, tag.frames, p.x(),
               p.y(), p.z(), sigma);
  }
  fmt::print("{} tag{} from {} frames, residual {:.3f} px\n", survey.tags.size(),
             survey.tags.size() == 1 ? "" : "s", survey.frames_used, survey.rms_px);
  fmt::print("paper: {}", survey.is_curved ? "curved (surface)" : "each tag is flat");
  if (survey.tags_on_plane >= 3) {
    fmt::print(
        "; the corners of the {} tags on the table's plane are {:.2f} mm off it (RMS), at most "
        "{:.2f} mm",
        survey.tags_on_plane, survey.corner_height_m * 1e3, survey.max_corner_height_m * 1e3);
  }
  fmt::print("\n");
  if (survey.tags_on_plane >= 3) {
    fmt::print(
        "table: plane fitted to {} tags, residual {:.2f} mm (RMS); the plane of tag {} alone is "
        "tilted by {:.2f} degrees against it\n",
        survey.tags_on_plane, survey.flatness_m * 1e3, options.survey.anchor,
        degrees(survey.plane_tilt_rad));
  } else {
    fmt::print("table: the plane of tag {}\n", options.survey.anchor);
  }
}

Eigen::VectorXd lens_parameters(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const int count = coefficient_count(p.model);
  Eigen::VectorXd lens(4 + count);
  lens << p.fx, p.fy, p.cx, p.cy, Eigen::Map<const Eigen::VectorXd>(p.distortion.data(), count);
  return lens;
}

void print_row_time(const RowTime& row_time, const MapOptions& options) {
  const std::string found = fmt::format("shutter: the row time is {:.2f} +- {:.2f} us",
                                        row_time.seconds * 1e6, row_time.sigma_s * 1e6);
  if (options.refined_camera.empty()) {
    fmt::print("{} by this sweep; to use it, repeat with --refine-camera\n", found);
  } else {
    fmt::print("{}: {}\n", found, options.refined_camera.string());
  }
}

void print_lens(const TagSurvey& survey, const CameraModel& given, const MapOptions& options) {
  const std::string file = options.refined_camera.string();
  if (!survey.lens_is_refined()) {
    fmt::print("camera: the given lens, because the sweep does not show a better one: {}\n", file);
    return;
  }
  fmt::print(
      "camera: refined lens, which reduces the squared residuals of other frames by {:.0f} %: {}\n",
      survey.lens_gain * 100.0, file);
  fmt::print("{:>5}{:>14}{:>12}{:>14}{:>12}\n", "", "given", "1 sigma", "refined", "1 sigma");
  const Eigen::VectorXd before = lens_parameters(given);
  const Eigen::VectorXd after = lens_parameters(survey.camera);
  constexpr std::array kNames = {"fx", "fy", "cx", "cy"};
  for (Eigen::Index i = 0; i < after.size(); ++i) {
    const auto index = static_cast<std::size_t>(i);
    const std::string name =
        index < 4 ? kNames[index] : coefficient_name(given.parameters().model, index - 4);
    fmt::print("{:>5}{:>14.5f}{:>12.5f}{:>14.5f}{:>12.5f}\n", name, before[i],
               std::sqrt(survey.lens_prior(i, i)), after[i],
               std::sqrt(survey.lens_covariance(i, i)));
  }
  const Eigen::VectorXd change = after - before;
  const auto moved_px = lens_overlay_px(survey.camera, change * change.transpose());
  const auto prior_px = lens_overlay_px(survey.camera, survey.lens_prior);
  const auto sigma_px = lens_overlay_px(survey.camera, survey.lens_covariance);
  if (!moved_px || !prior_px || !sigma_px) return;
  fmt::print(
      "over the table, objects move by {:.2f} px; 1 sigma of the lens: {:.2f} px before, {:.2f} px "
      "now\n",
      *moved_px, *prior_px, *sigma_px);
}

Result<void> write_files(const SweptTags& swept, const std::optional<CalibrationRecord>& given,
                         OutputFile& tags, std::optional<OutputFile>& camera) {
  if (auto saved = save_tag_survey(tags.partial(), swept.survey); !saved)
    return tags.failed(saved.error());
  std::vector<OutputFile*> files = {&tags};
  if (camera) {
    const auto record =
        refined_record(swept.survey, swept.row_time, given,
                       fmt::format("{} tags of penumbra map", swept.survey.tags.size()));
    if (auto saved = save_refined_camera(*camera, swept.survey.camera, record ? &*record : nullptr);
        !saved)
      return saved;
    files.push_back(&*camera);
  }
  return commit_together(files);
}

Result<ExitCode> run_map(const MapOptions& options) {
  SurveyOptions survey = options.survey;
  survey.family = *tag_family_from_string(options.family);
  survey.plane = options.plane == "anchor" ? SurveyPlane::anchor : SurveyPlane::fitted;
  if (!options.sizes.empty()) {
    PENUMBRA_TRY(survey.sizes_m, load_tag_sizes(options.sizes));
  }
  // Does not read the recording's tags.yaml, which this command computes.
  OpenRecordingOptions open;
  open.with_metadata = false;
  PENUMBRA_TRY(auto recording, open_recording(options.recording, open));
  for (const std::string& notice : recording.notices) log_warning("{}", notice);
  recording.camera_file = options.camera;
  PENUMBRA_TRY(recording.camera, load_chosen_camera(recording.camera_file, options.camera_name));
  PENUMBRA_TRY(const auto record,
               load_calibration_record(recording.camera_file, *recording.camera));
  if (record) survey.lens_sigmas = record->standard_deviations;
  Sweep sweep(options, recording, survey);
  PENUMBRA_TRY(auto output, OutputFile::create(options.output));
  std::optional<OutputFile> refined_camera;
  if (!options.refined_camera.empty()) {
    PENUMBRA_TRY(refined_camera, OutputFile::create(options.refined_camera));
  }
  PENUMBRA_TRY(const auto swept, sweep.survey(refined_camera.has_value()));
  const TagSurvey& result = swept.survey;
  PENUMBRA_TRY_VOID(write_files(swept, record, output, refined_camera));
  print_tags(result, options);
  if (swept.row_time) print_row_time(*swept.row_time, options);
  if (refined_camera) print_lens(result, *recording.camera, options);
  fmt::print("tags: {}{}\n", options.output.string(),
             result.left_out.empty() ? ""
                                     : fmt::format(" ({} tags; {} rejected)", result.tags.size(),
                                                   result.left_out.size()));
  return ExitCode::success;
}

}  // namespace

void add_map_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "map", "Measure the poses of loose tags from a recording that sweeps over them",
      "In the recording, show every tag together with others, from several sides. --tag-size or "
      "--sizes is required.\n"
      "\n"
      "Example:\n"
      "  penumbra map sweep --tag-size 0.04 --anchor 5 --output tags.yaml");
  const auto options = std::make_shared<MapOptions>();
  add_option(command, "RECORDING", "FOLDER|VIDEO", options->recording,
             "Recording or video file; a tags.yaml in it is not read")
      ->required();
  CLI::Option* size = add_option(command, "--tag-size", "METRES", options->survey.tag_size_m,
                                 "Edge of every tag's black square [m]")
                          ->check(length_check("m", 0.001, 10.0));
  CLI::Option* sizes = add_option(command, "--sizes", "FILE", options->sizes,
                                  "Sizes by tag: a YAML file of lines ID: METRES, or a tags.yaml");
  add_option(command, "--anchor", "ID", options->survey.anchor,
             "The tag that is the table's origin and gives its x axis")
      ->required()
      ->check(whole_number());
  add_option(command, "--family", "FAMILY", options->family, "Tag family")->capture_default_str();
  add_option(command, "--camera", "camera.yaml", options->camera,
             "Camera (default: the recording's)");
  add_camera_name_option(command, options->camera_name);
  add_choice_option(command, "--plane", {"fitted", "anchor"}, options->plane,
                    "Plane z = 0: fitted to the tags that lie flat beside the anchor, or the "
                    "anchor's")
      ->capture_default_str();
  add_option(command, "--refine-camera", "camera.yaml", options->refined_camera,
             "Correct lens and row time of the camera file too, and write it here");
  add_option(command, "--output", "tags.yaml", options->output,
             "Poses of the tags, with covariance")
      ->required();
  command.callback([&command, options, size, sizes, &chosen] {
    claim_outputs(command, {"--output", "--refine-camera"});
    if (size->count() == 0 && sizes->count() == 0)
      usage_error("--tag-size", "give the tags' size, or --sizes FILE");
    std::error_code ignored;
    if (options->camera.empty() && std::filesystem::is_regular_file(options->recording, ignored))
      usage_error("--camera", "is required: a video has no camera file");
    if (options->camera.empty()) options->camera = options->recording / "camera.yaml";
    check_camera_output("--refine-camera", options->refined_camera);
    const std::array outputs = {options->output, options->refined_camera};
    const std::array inputs = {options->recording, options->sizes, options->camera};
    if (const auto once = check_written_once(outputs, inputs); !once)
      usage_error("--output", "{}", once.error().message);
    if (!tag_family_from_string(options->family))
      usage_error("--family", "{}", unknown_tag_family(options->family));
    chosen = [options] { return run_map(*options); };
  });
}

}  // namespace penumbra
