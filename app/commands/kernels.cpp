// penumbra kernels: computes the shadow kernels of a model and stores them in a file.

#include <algorithm>
#include <cmath>
#include <memory>
#include <ranges>
#include <span>

#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "core/text/text.hpp"
#include "render/model/model_size.hpp"
#include "render/model/part_groups.hpp"
#include "render/shadow/kernels/kernel_glb.hpp"

namespace penumbra {
namespace {

struct KernelsOptions {
  std::filesystem::path model;
  std::filesystem::path output;
  std::vector<std::string> groups;
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  KernelSource source = KernelSource::automatic;
  double unit_m = 1.0;  // unit of the model's coordinates [m]
  std::optional<ModelPose> pose;
  bool glb = false;
};

Eigen::Vector3d direction_from(const std::string& text) {
  std::vector<double> numbers;
  for (const auto part : std::views::split(text, ',')) {
    const auto number = parse_number(trim(std::string_view(part.begin(), part.end())));
    numbers.push_back(number.value_or(std::nan("")));
  }
  const Eigen::Vector3d direction =
      numbers.size() == 3 ? Eigen::Vector3d(numbers.data()) : Eigen::Vector3d::Zero();
  if (!direction.allFinite() || !(direction.stableNorm() > 0.0)) {
    usage_error("--up", "{}: is not a direction x,y,z", text);
  }
  return direction.stableNormalized();
}

// Returns the KernelStamp `stamp` with the geometry key of the file's coordinates before --unit.
Result<std::string> stamp_in_file_unit(const KernelsOptions& options, const std::string& stamp) {
  if (options.unit_m == 1.0) return stamp;
  PENUMBRA_TRY(const auto model, load_model(options.model, {.stored_kernels = false}));
  return geometry_key(model) + stamp.substr(std::min(stamp.find('-'), stamp.size()));
}

Result<std::vector<std::uint8_t>> encode(const KernelsOptions& options, const Model& model,
                                         KernelFile kernels) {
  if (!options.glb) {
    const std::string text = kernel_file_json(kernels);
    return std::vector<std::uint8_t>(text.begin(), text.end());
  }
  Result<KernelGlb> glb;
  if (lower_extension(options.model) == ".obj") {
    glb = make_glb_with_kernels(model, kernels);
  } else {
    PENUMBRA_TRY(kernels.geometry, stamp_in_file_unit(options, kernels.geometry));
    glb = add_kernels_to_gltf(options.model, kernels, options.unit_m);
  }
  if (!glb) return tl::unexpected(glb.error());
  for (const std::string& warning : glb->warnings) log_warning("{}", warning);
  return std::move(glb->bytes);
}

void warn_of_model(const KernelsOptions& options, const Model& model) {
  std::vector<std::string> warnings = model.warnings;
  if (auto size = warning_of_size(model, {.unit_m = options.unit_m}, options.model.string())) {
    warnings.push_back(std::move(*size));
  }
  for (auto here = warnings.begin(); here != warnings.end(); ++here) {
    if (std::find(warnings.begin(), here, *here) == here) log_warning("{}", *here);
  }
}

Result<ExitCode> run_kernels(const KernelsOptions& options) {
  std::error_code ignored;
  if (std::filesystem::equivalent(options.model, options.output, ignored) && !options.glb) {
    return fail("{}: is the model itself; give another name", options.output.string());
  }
  InterruptWatch interrupt;
  interrupt.hold();
  PENUMBRA_TRY(auto output, OutputFile::create(options.output));
  double time_ms = 0.0;
  Model plain;
  KernelFile kernels;
  KernelProgress progress;
  PENUMBRA_TRY_VOID(with_progress(
      [&]() -> Result<void> {
        // Kernels in the file will be replaced, so they are not read.
        auto model =
            load_model(options.model,
                       {.unit_m = options.unit_m, .stored_kernels = false, .pose = options.pose});
        if (!model) return tl::unexpected(model.error());
        if (const auto checked = check_groups(*model, options.groups); !checked) {
          return fail("{}: {}", options.model.string(), checked.error().message);
        }
        plain = std::move(*model);
        const ShadowMesh mesh = make_shadow_mesh(plain, options.groups);
        const Stopwatch watch;
        const ShadowKernels set =
            generate_kernels(mesh, options.direction, options.source, &progress);
        time_ms = watch.elapsed().wall_ms;
        kernels = make_kernel_file(plain, mesh, set, options.source, options.groups);
        return {};
      },
      progress, "vertices", interrupt, output));
  // A .glb may be replaced by its copy with kernels.
  PENUMBRA_TRY_VOID(check_written_once({&options.output, 1}, std::span(plain.files).subspan(1)));
  warn_of_model(options, plain);
  PENUMBRA_TRY(const auto bytes, encode(options, plain, kernels));
  if (const auto done = write_file(output.partial(), bytes); !done) {
    return output.failed(done.error());
  }
  PENUMBRA_TRY_VOID(output.commit());
  fmt::print("kernels: {} ({} vertices, {:.1f} ms)\n", options.output.string(),
             kernels.kernels.size(), time_ms);
  return ExitCode::success;
}

}  // namespace

void add_kernels_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command =
      add_command(program, "kernels",
                  "Compute the shadow kernels of a model and store them in a file or in the model",
                  "Example:\n"
                  "  penumbra kernels helicopter.glb --output helicopter_kernels.glb\n"
                  "  penumbra kernels helicopter.glb --up 0,0.2,1 --output kernels.json\n"
                  "  penumbra kernels house.glb --group \"brick*\" --output house_kernels.glb");
  const auto options = std::make_shared<KernelsOptions>();
  add_option(command, "MODEL", "FILE", options->model, "The model (.glb, .gltf, .obj)")->required();
  add_text_option(
      command, "--up", "x,y,z",
      [options](const std::string& text) { options->direction = direction_from(text); },
      "The direction they are for, in the object's frame (z up)")
      ->default_str("0,0,1");
  add_unit_option(command, options->unit_m);
  add_pose_options(command, options->pose);
  add_word_option(command, "--kernels", kKernelSourceNames, "kernels", options->source,
                  "How they are computed: auto (from silhouettes), smooth, per-axis or cocl")
      ->type_name("KERNELS")
      ->default_str("auto");
  add_part_group_option(command, options->groups);
  add_option(command, "--output", "FILE", options->output,
             "A kernel file (.json), or a copy of the model with its kernels (.glb)")
      ->required();
  command.callback([&command, options, &chosen] {
    claim_outputs(command, {"--output"});
    const std::string extension = lower_extension(options->output);
    if (extension != ".json" && extension != ".glb" && !is_stream(options->output)) {
      usage_error("--output", "{}: is neither .json nor .glb; choose one of them",
                  options->output.string());
    }
    options->glb = extension == ".glb";
    if (options->glb && options->pose) {
      usage_error("--output", "a .glb has kernels for its rest pose only; give a .json file");
    }
    chosen = [options] { return run_kernels(*options); };
  });
}

}  // namespace penumbra
