#include "app/commands/options.hpp"

#include <spdlog/spdlog.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "app/versions.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kCocl = "cocl";

}  // namespace

std::string known_techniques() {
  std::string list;
  for (const ShadowTechniqueName& entry : kShadowTechniqueNames) {
    if (!list.empty()) list += ", ";
    // Beside the technique that it is a case of.
    if (entry.technique == ShadowTechnique::layered) list += std::string(kCocl) + ", ";
    list += entry.name;
  }
  return list;
}

std::string known_kernels() {
  std::string list;
  for (const KernelSourceName& entry : kKernelSourceNames) {
    if (!list.empty()) list += ", ";
    list += entry.name;
  }
  return list;
}

void add_shadow_options(CLI::App& command, ShadowChoice& choice) {
  command
      .add_option_function<std::string>(
          "--shadow",
          [&choice](const std::string& name) {
            const auto technique =
                shadow_technique_from_string(name == kCocl ? "layered" : std::string_view(name));
            if (!technique) {
              throw CLI::ValidationError("--shadow", fmt::format("{}: no such technique; known: {}",
                                                                 name, known_techniques()));
            }
            choice.technique = technique;
            if (name == kCocl) choice.kernels = KernelSource::centroid;
          },
          fmt::format("Technique of every shadow in place of the scene's: {}", known_techniques()))
      ->type_name("TECHNIQUE");
  command
      .add_option_function<std::string>(
          "--kernels",
          [&choice](const std::string& name) {
            choice.kernels = kernel_source_from_string(name);
            if (!choice.kernels) {
              throw CLI::ValidationError("--kernels", fmt::format("{}: no such kernels; known: {}",
                                                                  name, known_kernels()));
            }
          },
          fmt::format("Shadow kernels in place of the scene's: {} (auto: from the silhouette, for "
                      "each part; smooth: the same, blended; per-axis: from the sets of the three "
                      "axes; cocl: one for the whole object)",
                      known_kernels()))
      ->type_name("KERNELS");
}

void add_tracking_option(CLI::App& command, TrackingMode& mode) {
  command
      .add_option_function<std::string>(
          "--tracking",
          [&mode](const std::string& name) {
            const auto known = tracking_mode_from_string(name);
            if (!known) {
              throw CLI::ValidationError(
                  "--tracking",
                  fmt::format("{}: no such way; known: fast, accurate, auto, detect", name));
            }
            mode = *known;
          },
          "fast: a limited number of pixels; accurate: every pixel at an edge; auto: fast while "
          "the view moves, accurate when it rests; detect: every frame by detection, the baseline "
          "to compare with")
      ->type_name("fast|accurate|auto|detect")
      ->default_str("auto");
}

void add_output_options(CLI::App& command, OutputRequest& request) {
  command
      .add_option("--output", request.output,
                  "Composited frames: *.mkv (FFV1, lossless), *.mp4 (H.264), or a folder of "
                  "000000.png ... numbered by frame")
      ->type_name("PATH");
  CLI::Option* poses = command.add_option("--poses", request.poses, "Tracked poses, as a TUM file")
                           ->type_name("FILE.tum");
  command
      .add_flag("--poses-all", request.poses_all,
                "Uncertain and held poses too, each after a comment that says so")
      ->needs(poses);
  command.add_option("--report", request.report, "What was measured, as JSON")
      ->type_name("FILE.json");
}

void add_common_options(CLI::App& command) {
  command.set_version_flag("--version", fmt::format("penumbra {}", program_version()),
                           "Print the version and exit");
  command
      .add_option_function<std::string>(
          "--log-level",
          [](const std::string& name) {
            for (const auto level :
                 {spdlog::level::trace, spdlog::level::debug, spdlog::level::info,
                  spdlog::level::warn, spdlog::level::err, spdlog::level::off}) {
              if (spdlog::level::to_string_view(level) == name) {
                spdlog::set_level(level);
                return;
              }
            }
            throw CLI::ValidationError(
                "--log-level",
                fmt::format("{}: no such level; known: trace, debug, info, warning, error, off",
                            name));
          },
          "What is told on standard error: trace, debug, info, warning, error, off")
      ->type_name("LEVEL")
      ->default_str("warning");
}

}  // namespace penumbra
