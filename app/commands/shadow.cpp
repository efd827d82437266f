// penumbra shadow: computes the shadow layers of one model on one plane.

#include <chrono>
#include <future>
#include <memory>

#include "app/commands/options.hpp"
#include "app/commands/shadow_job.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/output/shadow_drawing.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

Result<ExitCode> run_shadow(const ShadowJob& given) {
  ShadowJob job = given;
  job.on_warning = [](const std::string& warning) { log_warning("{}", warning); };
  for (const std::string& warning : job.warnings) log_warning("{}", warning);
  if (job.constants.light_ratio <= 1.0 && job.has_layers()) {
    log_warning("light ratio a = {:g}: the umbra never vanishes; the usual light has a > 1",
                job.constants.light_ratio);
  }
  if (job.format == ShadowJob::Format::table) {
    PENUMBRA_TRY(const auto result, compute_shadow(job));
    fmt::print("{}", shadow_table(job, result));
    return ExitCode::success;
  }
  InterruptWatch interrupt;
  interrupt.hold();
  PENUMBRA_TRY(auto output, OutputFile::create(job.output));
  auto computing = std::async(std::launch::async, [&job] { return compute_shadow(job); });
  while (!is_done_within(computing, std::chrono::milliseconds(1000), interrupt, output)) {
  }
  PENUMBRA_TRY(const auto result, computing.get());
  PENUMBRA_TRY_VOID(check_written_once({&job.output, 1}, result.files));
  if (job.format == ShadowJob::Format::png) {
    if (const auto done = write_shadow_png(output.partial(), drawing_of(job, result)); !done) {
      return output.failed(done.error());
    }
    PENUMBRA_TRY_VOID(output.commit());
  } else {
    const std::string text = job.format == ShadowJob::Format::json
                                 ? shadow_json(job, result)
                                 : shadow_svg(drawing_of(job, result));
    PENUMBRA_TRY_VOID(write_text(output, text));
  }
  fmt::print("shadow: {}\n", job.output.string());
  return ExitCode::success;
}

}  // namespace

void add_shadow_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "shadow", "Compute the shadow layers of a model: areas, outlines, an image",
      "Example:\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\"\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\" --workspace-height 0.3 "
      "\\\n    --magnification 1.5 --show-kernels --output layers.svg");
  const auto options = std::make_shared<ShadowOptions>();
  add_option(command, "MODEL", "FILE", options->model, "The model (.glb, .gltf, .obj)")->required();
  start_group(command, "Light");
  add_option(command, "--light-height", "H|inf", options->light_height,
             "Height H of the light over the plane [m] (default: 0.9), or inf with "
             "--umbra-height");
  add_option(command, "--light-ratio", "A", options->light_ratio,
             "Radius of the light over that of the object (default: 3)")
      ->check(any_number());
  add_option(command, "--umbra-height", "HU", options->umbra_height,
             "Height at which the umbra vanishes [m], in place of --light-ratio: A = H / HU")
      ->check(any_number());
  add_option(command, "--workspace-height", "Z", options->workspace_height,
             "Highest point that objects take [m]: chooses H and A, with --magnification")
      ->check(any_number());
  add_option(command, "--magnification", "M", options->magnification,
             "Maximum magnification of the middle layer there (above 1)")
      ->check(any_number());
  add_option(
      command, "--kernels", "KERNELS|FILE.json", options->kernels,
      "Points about which layers grow and shrink: auto, smooth, per-axis, cocl, or a kernel file")
      ->capture_default_str();
  add_option(command, "--light-mode", "proportional|fixed", options->light_mode,
             "Size of the light: proportional to each part's thickness, or fixed")
      ->default_str("proportional");
  add_part_group_option(command, options->groups);
  add_option(command, "--pose", "\"tx ty tz qx qy qz qw\"", options->pose,
             "Pose of the object: metres and a unit quaternion (default: identity)");
  add_option(command, "--plane", "\"nx ny nz px py pz\"", options->plane,
             "Normal, and a point on it (default: 0 0 1 0 0 0)");
  add_option(command, "--technique", "TECHNIQUE", options->technique,
             "layered, cocl, field, simple, or hard")
      ->capture_default_str();
  add_option(command, "--light", "\"x y z w\"", options->light,
             "Light of a hard shadow: position (w = 1) or direction towards it (w = 0)");
  start_group(command, "Model");
  add_option(command, "--proxy", "auto|none|FILE", options->proxy,
             "Reduced mesh that casts if it is exact enough: auto (made), none, or a file")
      ->capture_default_str();
  add_option(command, "--up", "y|z", options->up,
             "Axis of the file that points up (default: y for glTF, z for OBJ)");
  add_unit_option(command, options->unit_m);
  add_pose_options(command, options->model_pose);
  command.add_flag("--show-kernels", options->show_kernels, "Kernels as dots in the image");
  add_option(
      command, "--output", "FILE", options->output,
      "Outlines (.json; - is standard output) or an image (.svg, .png); without it a table is "
      "printed");
  put_first(command,
            {"--output", "--technique", "--pose", "--plane", "--light-height", "--workspace-height",
             "--magnification", "--kernels", "--unit", "--show-kernels"});
  command.callback([&command, options, &chosen] {
    claim_outputs(command, {"--output"});
    chosen = [job = job_from(*options)] { return run_shadow(job); };  // throws for wrong usage
  });
}

}  // namespace penumbra
