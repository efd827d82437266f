// penumbra map: surveys the tags in a recording and writes their tags.yaml.

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <stop_token>
#include <utility>

#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"
#include "app/recording/recording_source.hpp"
#include "app/run_inputs.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/survey/edge_survey.hpp"
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

tl::unexpected<Error> ended_early(const MapOptions& options) {
  return fail("{}: ended early; no file was written", options.recording.string());
}

// Calls `visit(index, luma)` for every frame. Fails if the user interrupts the command.
template <class Visit>
Result<void> for_each_luma(const MapOptions& options, const Recording& recording, const char* what,
                           InterruptWatch& interrupt, const Visit& visit) {
  PENUMBRA_TRY(auto source, open_recording_source(recording));
  ProgressBar progress(source->frame_count().value_or(0), what);
  std::vector<std::uint8_t> scratch;
  for (std::size_t index = 0;; ++index) {
    PENUMBRA_TRY(const auto frame, source->next());
    if (!frame) return {};
    visit(index, luma(*frame, scratch));
    progress.update(static_cast<int>(index) + 1);
    if (interrupt.interrupted()) return ended_early(options);
  }
}

void print_survey(const TagSurvey& survey, const CameraModel& given, const MapOptions& options) {
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
  if (!options.refined_camera.empty()) {
    const CameraParameters& p = survey.camera.parameters();
    const ProjectionDifference difference = projection_difference(survey.camera, given);
    fmt::print(
        "camera: fx {:.3f} +- {:.3f}  fy {:.3f} +- {:.3f} px, {:.3f} px from the given one on "
        "average: {}\n",
        p.fx, std::sqrt(survey.lens_covariance(0, 0)), p.fy,
        std::sqrt(survey.lens_covariance(1, 1)), difference.mean_px,
        options.refined_camera.string());
  }
  fmt::print("tags: {}{}\n", options.output.string(),
             survey.left_out.empty() ? ""
                                     : fmt::format(" ({} tags; {} rejected)", survey.tags.size(),
                                                   survey.left_out.size()));
}

Result<ExitCode> run_map(const MapOptions& options) {
  SurveyOptions survey = options.survey;
  survey.family = *tag_family_from_string(options.family);
  survey.plane = options.plane == "anchor" ? SurveyPlane::anchor : SurveyPlane::fitted;
  survey.refine_camera = !options.refined_camera.empty();
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
  InterruptWatch interrupt;
  interrupt.hold();
  PENUMBRA_TRY(auto output, OutputFile::create(options.output));
  std::optional<OutputFile> refined_camera;
  if (!options.refined_camera.empty()) {
    PENUMBRA_TRY(refined_camera, OutputFile::create(options.refined_camera));
  }
  PENUMBRA_TRY(auto detector, TagDetector::create(std::array{survey.family}));
  std::vector<SurveyFrame> frames;
  PENUMBRA_TRY_VOID(
      for_each_luma(options, recording, "frames", interrupt, [&](std::size_t, ImageView luma) {
        frames.push_back({detector.detect(luma), {}});
      }));
  const auto survey_all = [&](std::span<const SurveyFrame> all) -> Result<TagSurvey> {
    auto result = run_stoppable(interrupt, [&](std::stop_token stop) {
      survey.stop = std::move(stop);
      return survey_tags(*recording.camera, all, survey);
    });
    if (interrupt.interrupted()) return ended_early(options);
    if (!result) return fail_in(options.recording.string(), result.error());
    return result;
  };
  const auto measure_all = [&](const TagSurvey& surveyed, std::vector<SurveyFrame>& all) {
    return for_each_luma(options, recording, "edges", interrupt,
                         [&](std::size_t index, ImageView luma) {
                           if (index < all.size())
                             all[index] = measured_frame(surveyed, index, all[index], luma);
                         });
  };
  PENUMBRA_TRY(const auto result, survey_by_edges(std::move(frames), survey_all, measure_all));
  if (auto saved = save_tag_survey(output.partial(), result); !saved)
    return output.failed(saved.error());
  if (refined_camera) {
    if (auto saved = save_camera(refined_camera->partial(), result.camera); !saved)
      return refined_camera->failed(saved.error());
  }
  std::vector<OutputFile*> files = {&output};
  if (refined_camera) files.push_back(&*refined_camera);
  PENUMBRA_TRY_VOID(commit_together(files));
  print_survey(result, *recording.camera, options);
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
  add_option(command, "RECORDING", "FOLDER", options->recording,
             "Recording; a tags.yaml in it is not read")
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
             "Solve for the lens too, and write it here");
  add_option(command, "--output", "tags.yaml", options->output,
             "Poses of the tags, with covariance")
      ->required();
  command.callback([&command, options, size, sizes, &chosen] {
    claim_outputs(command, {"--output", "--refine-camera"});
    if (size->count() == 0 && sizes->count() == 0)
      usage_error("--tag-size", "give the tags' size, or --sizes FILE");
    if (options->camera.empty()) options->camera = options->recording / "camera.yaml";
    const std::array outputs = {options->output, options->refined_camera};
    const std::array inputs = {options->sizes, options->camera};
    if (const auto once = check_written_once(outputs, inputs); !once)
      usage_error("--output", "{}", once.error().message);
    if (!tag_family_from_string(options->family))
      usage_error("--family", "{}", unknown_tag_family(options->family));
    chosen = [options] { return run_map(*options); };
  });
}

}  // namespace penumbra
