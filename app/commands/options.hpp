// The commands of the program, helpers that add options to them, and options that several share.
#pragma once

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "app/live/live_camera.hpp"
#include "app/recording/recording_source.hpp"
#include "app/run/run_request.hpp"
#include "core/error.hpp"
#include "core/evaluation/pairing.hpp"
#include "render/frame_plan.hpp"
#include "render/scene/technique.hpp"
#include "tracking/tracker_options.hpp"

namespace penumbra {

// Exit code of the process. A command that Ctrl-C or SIGTERM ended early returns success if its
// files are complete. main() returns `failure` for an Error and `usage` for a wrong command line.
enum class ExitCode : int {
  success = 0,
  failure = 1,
  usage = 2,
};

// The chosen command: set while the command line is parsed, called afterwards.
using ChosenCommand = std::function<Result<ExitCode>()>;

// Returns the command line of the program with all commands.
[[nodiscard]] std::unique_ptr<CLI::App> make_program(ChosenCommand& chosen);
void add_demo_command(CLI::App& program, ChosenCommand& chosen);
void add_replay_command(CLI::App& program, ChosenCommand& chosen);
void add_live_command(CLI::App& program, ChosenCommand& chosen);
void add_devices_command(CLI::App& program, ChosenCommand& chosen);
void add_evaluate_command(CLI::App& program, ChosenCommand& chosen);
void add_shadow_command(CLI::App& program, ChosenCommand& chosen);
void add_target_command(CLI::App& program, ChosenCommand& chosen);
void add_calibrate_command(CLI::App& program, ChosenCommand& chosen);
void add_map_command(CLI::App& program, ChosenCommand& chosen);
void add_kernels_command(CLI::App& program, ChosenCommand& chosen);
void add_simulate_command(CLI::App& program, ChosenCommand& chosen);
void add_import_command(CLI::App& program, ChosenCommand& chosen);
void add_study_command(CLI::App& program, ChosenCommand& chosen);
void add_setup_command(CLI::App& program, ChosenCommand& chosen);

struct CalibrationFiles {
  std::filesystem::path target, camera;
  std::filesystem::path report;  // empty: none
};
// Calibrates a camera as penumbra calibrate does, as a step of another command. `window`: opens a
// window if there is a display. Returns false if the user interrupted it after the camera file was
// written.
[[nodiscard]] Result<bool> calibrate_camera(const CameraRequest& camera,
                                            const CalibrationFiles& files, bool window = true);

// Reports wrong usage of an option by throwing CLI::ValidationError.
template <class... Args>
[[noreturn]] void usage_error(const std::string& option, fmt::format_string<Args...> text,
                              Args&&... args) {
  throw CLI::ValidationError(option, fmt::format(text, std::forward<Args>(args)...));
}

// Returns the formatter of every `--help`. It does not wrap footer lines that begin with a blank.
[[nodiscard]] std::shared_ptr<CLI::FormatterBase> make_help_formatter();
// Returns the command's option whose name is most similar ("--fps" for "--fsp"); "" if none is.
[[nodiscard]] std::string similar_option(const CLI::App& command, const std::string& name);
// Sets the help group of the options that are added after this call.
void start_group(CLI::App& command, const std::string& name);
// Moves options to the group that the help shows first.
void put_first(CLI::App& command, std::initializer_list<const char*> options);

// Adds a command with the options --version and --log-level. Its help ends with `footer`.
CLI::App& add_command(CLI::App& program, const std::string& name, const std::string& description,
                      const std::string& footer);
// Adds --version and --log-level.
void add_common_options(CLI::App& command);

// Adds an option that sets a variable. The help shows `type` as the option's value.
template <class T>
CLI::Option* add_option(CLI::App& command, const std::string& name, const std::string& type,
                        T& variable, const std::string& description) {
  return command.add_option(name, variable, description)->type_name(type);
}
// Adds an option that accepts one of `words`.
CLI::Option* add_choice_option(CLI::App& command, const std::string& name,
                               const std::vector<std::string>& words, std::string& variable,
                               const std::string& description);
// Return checks of numbers, whose messages contain the range. CLI11's checks accept "nan".
[[nodiscard]] CLI::Validator any_number();
[[nodiscard]] CLI::Validator in_range(double min_value, double max_value);
[[nodiscard]] CLI::Validator in_range(int min_value, int max_value);
// Returns a check for whole numbers from 0. CLI11 would read "-1" as the largest unsigned number.
[[nodiscard]] CLI::Validator whole_number();
// Adds an option whose text is passed to `set_value`, which may reject it with usage_error().
CLI::Option* add_text_option(CLI::App& command, const std::string& name, const std::string& type,
                             const std::function<void(const std::string&)>& set_value,
                             const std::string& description);
// Adds an option for a file that RowLog writes.
CLI::Option* add_row_log_option(CLI::App& command, const std::string& name,
                                std::optional<std::filesystem::path>& file,
                                const std::string& description);
// Joins the names of a table of EnumName.
[[nodiscard]] std::string joined_names(const auto& names, const char* separator) {
  std::vector<std::string_view> words;
  for (const auto& entry : names) words.push_back(entry.name);
  return fmt::format("{}", fmt::join(words, separator));
}
// Adds an option that accepts a name of a static table. Error messages call its value a `kind`.
CLI::Option* add_word_option(CLI::App& command, const std::string& name, const auto& names,
                             const std::string& kind, auto& variable,
                             const std::string& description) {
  const auto set_value = [=, &names, &variable](const std::string& word) {
    const auto value = value_named(names, word);
    if (!value) {
      usage_error(name, "{}: no such {}; known: {}", word, kind, joined_names(names, ", "));
    }
    variable = *value;
  };
  return add_text_option(command, name, joined_names(names, "|"), set_value, description);
}
// Adds a flag that sets a variable to false.
void add_off_flag(CLI::App& command, const std::string& name, bool& variable,
                  const std::string& description);

// Values of the options that add_shadow_options() adds.
struct ShadowChoice {
  PlanOptions plan;
  bool cocl = false;  // --shadow cocl: the layered technique with one kernel per object
  std::optional<std::filesystem::path> kernel_file;  // used instead of plan.kernels
  bool proxies_requested = false;                    // --proxy auto was given
};
// Adds the shadow options and returns the option --shadow.
CLI::Option* add_shadow_options(CLI::App& command, ShadowChoice& choice);
// Sets the technique called `name`. `option` is the option with this value, for error messages.
void set_technique(ShadowChoice& choice, const std::string& option, const std::string& name);
// Warns of each given option that the technique of --shadow, or the tracking, does not use.
void warn_of_unused_options(const ShadowChoice& choice);
void warn_of_unused_options(const CLI::App& command, const TrackerOptions& tracking);
// Converts the choice to plan options. Rejects options that contradict each other.
[[nodiscard]] PlanOptions plan_of(const ShadowChoice& choice);

// Value of --kernels: a source or a kernel file.
struct KernelChoice {
  KernelSource source = KernelSource::automatic;
  std::optional<std::filesystem::path> file;
};
[[nodiscard]] KernelChoice kernel_choice_from(const std::string& text);

// Add options that several commands share.
void add_tracking_options(CLI::App& command, TrackerOptions& tracking);
// Adds --refine-map, which is returned, and --refine-camera.
CLI::Option* add_refine_map_option(CLI::App& command, RunRequest& request);
CLI::Option* add_smooth_option(CLI::App& command, bool& smooth);
void add_output_options(CLI::App& command, OutputRequest& request);
// Returns the line "wrote A, B" of a successful run, or "" if it wrote no file. `recording`: the
// folder that live recorded.
[[nodiscard]] std::string written_files(const OutputRequest& request,
                                        const std::optional<std::filesystem::path>& recording = {});
void add_scene_option(CLI::App& command, RunRequest& request,
                      const char* description = "Scene to draw (default: the program's own)");
void add_object_option(CLI::App& command, std::vector<ObjectRequest>& objects);
// Reads "FILE[,key=value...]". `option`: the option with this value, for error messages.
[[nodiscard]] ObjectRequest object_from(const std::string& option, const std::string& text);
void add_frame_options(CLI::App& command, RunRequest& request, ShadowChoice& shadow);
void add_window_options(CLI::App& command, RunRequest& request);
// Moves the parsed shadow options into the request. Warns of unused ones, rejects contradictions
// and outputs with the same path.
void set_run_options(const CLI::App& command, const ShadowChoice& shadow, RunRequest& request);
// Returns the scene of runs without --scene: an empty table for objects, else the default scene.
[[nodiscard]] std::filesystem::path bundled_scene(const std::filesystem::path& resources,
                                                  const std::vector<ObjectRequest>& objects);
// Sets the bundled scene if the request has no scene. Fails if the bundled scene is missing.
[[nodiscard]] Result<void> complete(RunRequest& request);

inline constexpr const char* kCalibrationMissing =
    "is required: name the camera.yaml that penumbra calibrate writes for this camera";
// Rejects a name that other programs take for a camera file of a format that is not written.
void check_camera_output(const std::string& option, const std::filesystem::path& file);
// Rejects a value of --camera that is not a camera.
void check_camera_source(const std::string& source);
CLI::Option* add_camera_name_option(CLI::App& command, std::string& name);
void add_frames_option(CLI::App& command, FrameRange& frames);
void add_size_option(CLI::App& command, const std::string& type, std::optional<int>& width,
                     std::optional<int>& height, const std::string& description);
CLI::Option* add_fps_option(CLI::App& command, std::optional<double>& fps);
void add_pairing_options(CLI::App& command, PairingOptions& pairing);
CLI::Option* add_poses_from_option(CLI::App& command, std::optional<std::string>& poses_from);
void add_part_group_option(CLI::App& command, std::vector<std::string>& groups);
void add_unit_option(CLI::App& command, double& unit_m);
// Adds --animation and --time. Without them `pose` remains empty.
void add_pose_options(CLI::App& command, std::optional<ModelPose>& pose);

// Returns the values that --shadow accepts: "none, simple, ...".
[[nodiscard]] std::string known_techniques();

// Returns a check for lengths in the unit with this symbol (kLengthUnits). Its message contains the
// unit and, for a value in another unit, the converted value.
[[nodiscard]] std::function<std::string(const std::string&)> length_check(std::string_view symbol,
                                                                          double min_value,
                                                                          double max_value);

// If one of these options is "-", redirects all messages to standard error. Rejects a second "-".
// Call after the command line was parsed.
void claim_outputs(const CLI::App& command, std::initializer_list<const char*> options);

}  // namespace penumbra
