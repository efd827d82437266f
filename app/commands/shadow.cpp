// penumbra shadow MODEL: shadow layers, offline.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cmath>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/offline_shadow.hpp"
#include "app/output/layer_file.hpp"
#include "core/text.hpp"

namespace penumbra {
namespace {

// "tx ty tz", with blanks or commas between.
std::optional<std::vector<double>> parse_numbers(const std::string& text, std::size_t count) {
  std::vector<double> numbers;
  std::string word;
  for (const char c : text + " ") {
    if (c != ' ' && c != ',' && c != '\t') {
      word += c;
      continue;
    }
    if (word.empty()) continue;
    const auto number = parse_number(word);
    if (!number || !std::isfinite(*number)) return std::nullopt;
    numbers.push_back(*number);
    word.clear();
  }
  if (numbers.size() != count) return std::nullopt;
  return numbers;
}

void add_up_axis_option(CLI::App& command, const std::string& names, UpAxis& up_axis) {
  command
      .add_option_function<std::string>(
          names,
          [&up_axis](const std::string& name) {
            if (name != "y" && name != "z") {
              throw CLI::ValidationError("--up-axis", name + ": is neither y nor z");
            }
            up_axis = name == "y" ? UpAxis::y : UpAxis::z;
          },
          "Axis of the model file that points up (default: y for glTF, z for OBJ)")
      ->type_name("y|z");
}

struct ShadowOptions {
  ShadowRequest request;
  double light_height = 0.0, light_ratio = 0.0, umbra_height = 0.0;
  double workspace_height = 0.0, magnification = 0.0;
  std::optional<std::filesystem::path> output;
  DrawingOptions drawing;
};

Result<LayeredConstants> constants_from(const ShadowOptions& options) {
  if (options.workspace_height > 0.0 || options.magnification > 0.0) {
    return layered_constants_for_workspace(options.workspace_height, options.magnification);
  }
  if (options.light_height == 0.0 && options.light_ratio == 0.0 && options.umbra_height == 0.0) {
    return LayeredConstants();
  }
  const LayeredConstants usual;
  const double height = options.light_height == 0.0 ? usual.light_height : options.light_height;
  const bool no_ratio = options.light_ratio == 0.0 && options.umbra_height == 0.0;
  return make_layered_constants(
      height, no_ratio && !std::isinf(height) ? usual.light_ratio : options.light_ratio,
      options.umbra_height);
}

Result<ExitCode> run_shadow(const ShadowOptions& options) {
  ShadowRequest request = options.request;
  const auto constants = constants_from(options);
  if (!constants) return tl::unexpected(constants.error());
  request.constants = *constants;
  const auto shadow = compute_shadow(request);
  if (!shadow) return tl::unexpected(shadow.error());
  for (const std::string& warning : shadow->warnings) spdlog::warn("{}", warning);
  if (options.output) {
    if (auto written = write_layers(*shadow, *options.output, options.drawing); !written) {
      return tl::unexpected(written.error());
    }
    return ExitCode::success;
  }
  fmt::print("{}", layers_json(*shadow));
  return ExitCode::success;
}

}  // namespace

void add_shadow_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command =
      program.add_subcommand("shadow", "Compute the shadow layers of a model, offline");
  add_common_options(*command);
  const auto options = std::make_shared<ShadowOptions>();
  ShadowRequest& request = options->request;
  command->add_option("MODEL", request.model, "The model")
      ->required()
      ->type_name("FILE.glb|.gltf|.obj");
  add_up_axis_option(*command, "--up,--up-axis", request.up_axis);
  CLI::Option* height =
      command
          ->add_option("--light-height", options->light_height,
                       "H, height of the light above the plane (default 0.9), or inf with "
                       "--umbra-height")
          ->type_name("M");
  CLI::Option* ratio = command
                           ->add_option("--light-ratio", options->light_ratio,
                                        "a, light radius over object radius (default 3)")
                           ->type_name("A");
  CLI::Option* umbra = command
                           ->add_option("--umbra-height", options->umbra_height,
                                        "H / a, the height at which the umbra vanishes")
                           ->type_name("M");
  CLI::Option* workspace =
      command
          ->add_option("--workspace-height", options->workspace_height,
                       "Highest point that the object can take; with --magnification it chooses H "
                       "and a")
          ->type_name("M");
  CLI::Option* magnification =
      command
          ->add_option("--magnification", options->magnification,
                       "Size of the middle layer at that height, in sizes of the object")
          ->type_name("X");
  ratio->excludes(umbra);
  workspace->needs(magnification)->excludes(height)->excludes(ratio)->excludes(umbra);
  magnification->needs(workspace);
  command
      ->add_option_function<std::string>(
          "--technique",
          [&request](const std::string& name) {
            if (name == "layered") {
              request.technique = OfflineTechnique::layered;
            } else if (name == "cocl") {
              request.technique = OfflineTechnique::layered;
              request.kernels = KernelSource::centroid;
            } else if (name == "field") {
              request.technique = OfflineTechnique::field;
            } else if (name == "simple") {
              request.technique = OfflineTechnique::simple;
            } else {
              throw CLI::ValidationError(
                  "--technique", name + ": no such technique; known: layered, field, cocl, simple");
            }
          },
          "layered (default); field (a light of one size, no kernels); cocl (one kernel for the "
          "object); simple (orthogonal)")
      ->type_name("TECHNIQUE");
  command
      ->add_option_function<std::string>(
          "--kernels",
          [&request](const std::string& name) {
            if (const auto source = kernel_source_from_string(name)) {
              request.kernels = *source;
            } else if (name.find('.') != std::string::npos || name.find('/') != std::string::npos) {
              request.kernel_file = name;
            } else {
              throw CLI::ValidationError(
                  "--kernels", fmt::format("{}: no such kernels; known: {}, or a FILE.json", name,
                                           known_kernels()));
            }
          },
          fmt::format("Shadow kernels: {}, or a file of penumbra kernels", known_kernels()))
      ->type_name("KERNELS|FILE.json");
  command
      ->add_option_function<std::string>(
          "--pose",
          [&request](const std::string& text) {
            const auto n = parse_numbers(text, 7);
            const Eigen::Quaterniond rotation =
                n ? Eigen::Quaterniond((*n)[6], (*n)[3], (*n)[4], (*n)[5])
                  : Eigen::Quaterniond(0, 0, 0, 0);
            if (rotation.norm() < 1e-6) {
              throw CLI::ValidationError(
                  "--pose", text + ": give \"tx ty tz qx qy qz qw\", the quaternion not zero");
            }
            request.T_world_object = {{(*n)[0], (*n)[1], (*n)[2]}, rotation.normalized(), 1.0};
          },
          "Where the object is: \"tx ty tz qx qy qz qw\" (default: as in its file)")
      ->type_name("POSE");
  command
      ->add_option_function<std::string>(
          "--plane",
          [&request](const std::string& text) {
            const auto n = parse_numbers(text, 6);
            if (!n || Eigen::Vector3d((*n)[0], (*n)[1], (*n)[2]).norm() < 1e-9) {
              throw CLI::ValidationError(
                  "--plane", text + ": give \"nx ny nz px py pz\", the normal not zero");
            }
            request.plane =
                PlaneFrame::make({(*n)[0], (*n)[1], (*n)[2]}, {(*n)[3], (*n)[4], (*n)[5]});
          },
          "Plane: \"nx ny nz px py pz\", its normal and a point (default \"0 0 1 0 0 0\")")
      ->type_name("PLANE");
  command->add_flag("--show-kernels", options->drawing.kernels, "Kernels as dots in the picture");
  command
      ->add_option("--output", options->output,
                   "Layers as polygons, or a picture (default: JSON on standard output)")
      ->type_name("FILE.json|.svg|.png");
  command->footer(
      "Layers are unions of projected faces, as the live renderer paints them. (u, v) [m] are the "
      "plane's own\ncoordinates.\n\nExample:\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\" --output layers.svg "
      "--show-kernels");
  command->callback([options, &chosen] { chosen = [options] { return run_shadow(*options); }; });
}

}  // namespace penumbra
