// penumbra map: from a sweep over loose tags to the tags.yaml that says where they are.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "app/capture/recording_source.hpp"
#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"
#include "calib/tag_survey.hpp"
#include "core/camera_file.hpp"
#include "core/tag_map.hpp"

namespace penumbra {
namespace {

struct MapOptions {
  std::filesystem::path recording;
  std::filesystem::path camera;
  std::filesystem::path sizes;
  std::filesystem::path output;
  std::optional<double> tag_size_m;
  std::string family = "tag36h11";
  int anchor = 0;
};

// What cameras and JPEG files encode light with (sRGB), where camera.yaml does not say.
constexpr double kTypicalToneCurve = 2.2;

using Curve = std::array<std::uint8_t, 256>;

Curve linearising_curve(double exponent) {
  Curve curve{};
  for (std::size_t i = 0; i < curve.size(); ++i) {
    curve[i] = static_cast<std::uint8_t>(
        std::lround(255.0 * std::pow(static_cast<double>(i) / 255.0, exponent)));
  }
  return curve;
}

// In encoded light white bleeds into black and tags look smaller than they are, which the distances
// between them would have to make up for: their edges are looked for in linear light.
ImageView in_linear_light(ImageView luma, const Curve& curve, std::vector<std::uint8_t>& light) {
  light.resize(static_cast<std::size_t>(luma.width) * static_cast<std::size_t>(luma.height));
  auto out = light.begin();
  for (int y = 0; y < luma.height; ++y) {
    out = std::transform(luma.row(y), luma.row(y) + luma.width, out,
                         [&](std::uint8_t value) { return curve[value]; });
  }
  return {light.data(), luma.width, luma.height, luma.width};
}

Result<ExitCode> run_map(const MapOptions& options) {
  SurveyOptions survey;
  survey.family = *tag_family_from_string(options.family);
  survey.anchor = options.anchor;
  survey.tag_size_m = options.tag_size_m;
  if (!options.sizes.empty()) {
    auto sizes = load_tag_sizes(options.sizes);
    if (!sizes) return tl::unexpected(sizes.error());
    survey.sizes_m = std::move(*sizes);
  }
  // Where tags lie is what is looked for: a tags.yaml in the recording is not read.
  OpenRecordingOptions open;
  open.surroundings = false;
  auto recording = open_recording(options.recording, open);
  if (!recording) return tl::unexpected(recording.error());
  auto camera =
      load_camera(options.camera.empty() ? options.recording / "camera.yaml" : options.camera);
  if (!camera) return tl::unexpected(camera.error());
  recording->camera = std::move(*camera);
  InterruptWatch interrupt;
  interrupt.hold();
  auto output = OutputFile::create(options.output);
  if (!output) return tl::unexpected(output.error());
  auto source = open_recording_source(*recording);
  if (!source) return tl::unexpected(source.error());
  auto detector = TagDetector::create(std::array{survey.family});
  if (!detector) return tl::unexpected(detector.error());
  std::vector<SurveyFrame> frames;
  {
    ProgressBar progress((*source)->frame_count().value_or(0));
    std::vector<std::uint8_t> scratch;
    std::vector<std::uint8_t> light;
    const auto curve =
        linearising_curve(recording->camera->parameters().tone_curve.value_or(kTypicalToneCurve));
    for (;;) {
      const auto frame = (*source)->next();
      if (!frame) return tl::unexpected(frame.error());
      if (!*frame) break;
      frames.push_back({detector->detect(in_linear_light(luma(**frame, scratch), curve, light))});
      progress.update(static_cast<int>(frames.size()));
      if (interrupt.interrupted()) {
        return fail("{}: ended early; no file was written", options.recording.string());
      }
    }
  }
  const auto result = survey_tags(*recording->camera, frames, survey);
  if (!result) return fail_in(options.recording.string(), result.error());
  if (auto saved = save_tag_survey(output->partial(), *result); !saved)
    return output->failed(saved.error());
  if (auto done = output->commit(); !done) return tl::unexpected(done.error());
  for (const std::string& line : result->left_out) fmt::print("left out: {}\n", line);
  fmt::print("{:>5}{:>9}{:>11}{:>11}{:>11}{:>15}\n", "tag", "frames", "x [mm]", "y [mm]", "z [mm]",
             "1 sigma [mm]");
  for (const SurveyedTag& tag : result->tags) {
    const Eigen::Vector3d p = tag.tag.T_table_tag.translation() * 1e3;
    const double sigma = std::sqrt(tag.covariance.topLeftCorner<3, 3>().trace() / 3.0) * 1e3;
    fmt::print("{:>5}{:>9}{:>11.2f}{:>11.2f}{:>11.2f}{:>15.3f}\n", tag.tag.id, tag.frames, p.x(),
               p.y(), p.z(), sigma);
  }
  fmt::print(
      "{} tags from {} frames, residual {:.3f} px, black squares {:+.2f} px at their edges; {:.2f} "
      "mm (RMS) off one plane, which is tilted "
      "by "
      "{:.2f} degrees against tag {}\ntags: {}\n",
      result->tags.size(), result->frames_used, result->rms_px, result->edge_shift_px,
      result->flatness_m * 1e3, result->plane_tilt_rad * 180.0 / M_PI, options.anchor,
      options.output.string());
  return ExitCode::success;
}

}  // namespace

void add_map_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "map", "Find where loose tags lie, from a recording that sweeps over them");
  add_common_options(*command);
  const auto options = std::make_shared<MapOptions>();
  command->add_option("recording", options->recording, "Recording; a tags.yaml in it is not read")
      ->required()
      ->type_name("RECORDING");
  auto* size =
      command->add_option("--tag-size", options->tag_size_m, "Edge of every tag's black square [m]")
          ->check(CLI::Range(0.001, 10.0));
  auto* sizes = command
                    ->add_option("--sizes", options->sizes,
                                 "Sizes by tag: a YAML file of lines ID: METRES, or a tags.yaml")
                    ->type_name("FILE");
  command->add_option("--anchor", options->anchor, "The tag whose frame becomes the table's")
      ->required()
      ->check(CLI::NonNegativeNumber)
      ->type_name("ID");
  command->add_option("--family", options->family, "Tag family")->capture_default_str();
  command->add_option("--camera", options->camera, "Camera (default: the recording's)")
      ->type_name("camera.yaml");
  command->add_option("--output", options->output, "Where the tags are, with covariance")
      ->required()
      ->type_name("tags.yaml");
  command->footer(
      "See every tag together with others, from several sides.\n\n"
      "Example:\n"
      "  penumbra map sweep --tag-size 0.04 --anchor 5 --output tags.yaml");
  command->callback([options, size, sizes, &chosen] {
    if (size->count() == 0 && sizes->count() == 0)
      throw CLI::ValidationError("--tag-size", "give the tags' size, or --sizes FILE");
    if (!tag_family_from_string(options->family)) {
      throw CLI::ValidationError(
          "--family",
          fmt::format("'{}' is not known; use a family of libapriltag, such as tag36h11",
                      options->family));
    }
    chosen = [options] { return run_map(*options); };
  });
}

}  // namespace penumbra
