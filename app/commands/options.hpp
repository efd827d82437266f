// Options that several commands share.
#pragma once

#include <filesystem>
#include <functional>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>

#include "app/output/run_outputs.hpp"
#include "app/session/run_request.hpp"
#include "core/evaluation/pairing.hpp"
#include "core/image/image_view.hpp"
#include "render/frame_plan.hpp"
#include "render/scene/technique.hpp"
#include "tracking/tracker_options.hpp"

namespace CLI {
class App;
class Option;
}  // namespace CLI

namespace penumbra {

// --shadow, --kernels, --light-mode, --proxy, --layers, --show-rays and --translucency.
// "cocl" is the layered technique with one kernel per object.
struct ShadowChoice {
  std::optional<ShadowTechnique> technique;
  bool cocl = false;  // by --shadow
  std::optional<KernelSource> kernels;
  std::optional<std::filesystem::path> kernel_file;  // in place of a source
  std::optional<LightMode> light_mode;
  bool proxies = true;
  bool light_rays = false;
  bool asks_for_proxies = false;  // by --proxy auto
  Translucency translucency = Translucency::automatic;
  LayerDrawing layers = LayerDrawing::automatic;
};
// Gives --shadow back.
CLI::Option* add_shadow_options(CLI::App& command, ShadowChoice& choice);
// The technique by a word of --shadow, as `option` has it. Throws CLI::ValidationError.
void set_technique(ShadowChoice& choice, const std::string& option, const std::string& name);
// Logs which of the options the technique that --shadow names has no use for.
void warn_of_no_use(const ShadowChoice& choice);
void warn_of_no_use(const CLI::App& command, const TrackerOptions& tracking);
// Over those of the scene. Throws CLI::ValidationError where the options contradict each other.
void apply(const ShadowChoice& choice, PlanOptions& plan);

// Where kernels come from, by the words of --kernels: a source, or the kernel file in its place.
// Throws CLI::ValidationError.
struct KernelChoice {
  KernelSource source = KernelSource::automatic;
  std::optional<std::filesystem::path> file;
};
[[nodiscard]] KernelChoice kernel_choice_from(const std::string& text);
// Throws CLI::ValidationError.
[[nodiscard]] LightMode light_mode_choice_from(const std::string& text);

// "640x480", as `option` has it. Throws CLI::ValidationError.
[[nodiscard]] ImageSize image_size_from(const std::string& option, std::string_view text);

// --tracking and --pose-budget.
void add_tracking_options(CLI::App& command, TrackerOptions& tracking);

// --smooth. Gives it back.
CLI::Option* add_smooth_option(CLI::App& command, bool& smooth);

// --output, --poses, --poses-all and --report.
void add_output_options(CLI::App& command, OutputRequest& request);

// Options that live and replay share, as parsed; complete() makes a RunRequest of them.
struct RunChoice {
  std::optional<std::filesystem::path> scene;  // default: the program's own
  ShadowChoice shadow;
  bool no_skip = false, no_window = false, no_hud = false;
};
// --scene.
void add_scene_option(CLI::App& command, RunChoice& choice);
// --threads, --rectified, --msaa, --pixel-buffers, --no-video-light and --no-skip. `side_by_side`:
// what more than one thread does, a clause.
void add_frame_options(CLI::App& command, RunRequest& request, RunChoice& choice,
                       const std::string& side_by_side);
// --no-window and --no-hud.
void add_window_options(CLI::App& command, RunChoice& choice);
// Completes the request. Fails if the program's own scene is needed and not found.
[[nodiscard]] Result<void> complete(const RunChoice& choice, RunRequest& request);

// --camera-name: which camera of a file that holds several.
CLI::Option* add_camera_name_option(CLI::App& command, std::string& name);

// --max-gap and --time-offset.
void add_pairing_options(CLI::App& command, PairingOptions& pairing);

// Every word that --shadow takes, from the list in render/scene/technique.hpp.
[[nodiscard]] std::string known_techniques();
// Every word that --kernels takes, from the same place.
[[nodiscard]] std::string known_kernels();
// Every word that --translucency takes, from render/translucency.hpp.
[[nodiscard]] std::string known_translucencies();

// A check for CLI::Option: a length in the unit of this symbol (kLengthUnits), from `least` to
// `most`. Its message names the unit, and what to type for a value that was given in another one.
[[nodiscard]] std::function<std::string(const std::string&)> length_check(std::string_view symbol,
                                                                          double least,
                                                                          double most);

// --unit: the length of a model file's unit [m].
void add_unit_option(CLI::App& command, double& unit_m);

// To be called once the command line is read: where one of these options names standard output
// ("-"), everything else that is printed goes to standard error. Throws CLI::ValidationError where
// two of them do.
void claim_outputs(const CLI::App& command, std::initializer_list<const char*> options);

// --version and --log-level.
void add_common_options(CLI::App& command);

}  // namespace penumbra
