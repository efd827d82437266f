// penumbra shadow: the shadow layers of one model on one plane, as numbers or as a picture.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <chrono>
#include <future>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/commands/shadow_job.hpp"
#include "app/commands/shadow_layers.hpp"
#include "app/commands/shadow_text.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/output/shadow_picture.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

Result<ExitCode> run_shadow(const ShadowJob& job) {
  for (const std::string& warning : job.warnings) log_warning("{}", warning);
  if (job.constants.light_ratio <= 1.0 && (job.technique == ShadowJob::Technique::layered ||
                                           job.technique == ShadowJob::Technique::field)) {
    log_warning("a = {:g}: the umbra never vanishes; the usual light has a > 1",
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
  if (job.format == ShadowJob::Format::png) {
    if (const auto done = write_shadow_png(output.partial(), picture_of(job, result)); !done) {
      return output.failed(done.error());
    }
    PENUMBRA_TRY_VOID(output.commit());
  } else {
    const std::string text = job.format == ShadowJob::Format::json
                                 ? shadow_json(job, result)
                                 : shadow_svg(picture_of(job, result));
    PENUMBRA_TRY_VOID(write_text(output, text));
  }
  fmt::print("shadow: {}\n", job.output.string());
  return ExitCode::success;
}

}  // namespace

void add_shadow_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "shadow", "Compute the shadow layers of a model: areas, outlines, a picture");
  add_common_options(*command);
  const auto options = std::make_shared<ShadowOptions>();
  command->add_option("MODEL", options->model, "The model (.glb, .gltf, .obj)")
      ->required()
      ->type_name("FILE");
  command
      ->add_option("--light-height", options->light_height,
                   "Height H of the light over the plane [m] (default: 0.9), or inf together with "
                   "--umbra-height")
      ->type_name("H|inf");
  command
      ->add_option("--light-ratio", options->light_ratio,
                   "Radius of the light over that of the object (default: 3)")
      ->type_name("A");
  command
      ->add_option("--umbra-height", options->umbra_height,
                   "Height at which the umbra vanishes [m], in place of --light-ratio: A = H / HU")
      ->type_name("HU");
  command
      ->add_option("--workspace-height", options->workspace_height,
                   "Highest point that objects take [m]: chooses H and A, with --magnification")
      ->type_name("Z");
  command
      ->add_option("--magnification", options->magnification,
                   "How much larger the middle layer may get there (above 1)")
      ->type_name("M");
  command
      ->add_option("--kernels", options->kernels,
                   "auto (from the silhouette, for each part; those stored in the model where they "
                   "fit), smooth, per-axis, cocl, or a kernel file")
      ->capture_default_str()
      ->type_name("auto|smooth|per-axis|cocl|FILE");
  command
      ->add_option("--light-mode", options->light_mode,
                   "proportional: a light for each part by its thickness; fixed: one size of light")
      ->default_str("proportional")
      ->type_name("proportional|fixed");
  command
      ->add_option("--group", options->groups,
                   "Parts that share one light: all, or a glTF node or mesh or OBJ object by its "
                   "name (* and ? stand for what varies); may be given again for other groups")
      ->allow_extra_args(false)
      ->type_name("all|NAME");
  command
      ->add_option(
          "--proxy", options->proxy,
          "A reduced mesh that casts where its layers agree with the model's to 0.98: auto "
          "(made from the model), none, or a model file")
      ->capture_default_str()
      ->type_name("auto|none|FILE");
  command
      ->add_option("--pose", options->pose,
                   "The object in the world: metres and a unit quaternion (default: as it is)")
      ->type_name("\"tx ty tz qx qy qz qw\"");
  command
      ->add_option("--plane", options->plane,
                   "The plane: its normal, and a point on it (default: 0 0 1 0 0 0)")
      ->type_name("\"nx ny nz px py pz\"");
  command->add_option("--technique", options->technique, "layered, cocl, field, simple, or hard")
      ->capture_default_str()
      ->type_name("TECHNIQUE");
  command
      ->add_option(
          "--light", options->light,
          "The light of a hard shadow: a place (w = 1), or the direction towards it (w = 0)")
      ->type_name("\"x y z w\"");
  command
      ->add_option("--up", options->up,
                   "Which axis of the file points up (default: y for glTF, z for OBJ)")
      ->type_name("y|z");
  add_unit_option(*command, options->unit_m);
  command->add_flag("--show-kernels", options->show_kernels, "Kernels as dots in the picture");
  command
      ->add_option(
          "--output", options->output,
          "Outlines (.json; - is standard output), or a picture (.svg, .png); without it a "
          "table is printed")
      ->type_name("FILE");
  command->footer(
      "Example:\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\"\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\" --workspace-height 0.3 "
      "--magnification 1.5 --show-kernels --output layers.svg");
  command->callback([command, options, &chosen] {
    claim_outputs(*command, {"--output"});
    // Wrong usage ends here.
    const auto job = std::make_shared<ShadowJob>(job_from(*options));
    chosen = [job] { return run_shadow(*job); };
  });
}

}  // namespace penumbra
