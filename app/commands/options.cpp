#include "app/commands/options.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "app/live/live_camera.hpp"
#include "app/logging.hpp"
#include "app/output/frame_writer.hpp"
#include "app/output/output_file.hpp"
#include "app/output/row_log.hpp"
#include "app/report/versions.hpp"
#include "app/resources.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "render/model/model_size.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kCocl = "cocl";
constexpr const char* kFirstGroup = "Main options";

// Returns true for the extension of an unsupported format. Any other extension names a folder.
bool names_unknown_video(const std::string& path) {
  constexpr std::array<std::string_view, 14> kFiles = {".avi", ".webm", ".mov",  ".m4v", ".mpg",
                                                       ".ts",  ".ogv",  ".mpeg", ".wmv", ".gif",
                                                       ".png", ".jpg",  ".jpeg", ".y4m"};
  return output_kind(path) == OutputKind::folder &&
         std::ranges::find(kFiles, lower_extension(path)) != kFiles.end();
}

void add_seconds_option(CLI::App& command, const std::string& name, double min_value,
                        double max_value, std::int64_t& variable_ns,
                        const std::string& default_text, const std::string& description) {
  const auto set_value = [=, &variable_ns](const std::string& text) {
    const auto value = parse_number(text);
    if (!value || !(*value >= min_value && *value <= max_value)) {
      usage_error(name, "is '{}'; give seconds from {:g} to {:g}", text, min_value, max_value);
    }
    variable_ns = nanoseconds(*value);
  };
  add_text_option(command, name, "SECONDS", set_value, description)->default_str(default_text);
}

CLI::Validator check_that(std::string expected, std::function<bool(const std::string&)> accepts) {
  return CLI::Validator(
      [expected = std::move(expected), accepts = std::move(accepts)](std::string& text) {
        return accepts(text) ? std::string() : fmt::format("{}: is not {}", text, expected);
      },
      "");
}

}  // namespace

std::string similar_option(const CLI::App& command, const std::string& name) {
  constexpr std::size_t kMaxTypos = 2;
  constexpr std::size_t kMaxLength = 100;  // longer words are no typos
  std::size_t min_typos = kMaxTypos + 1;
  std::string similar;
  if (name.size() > kMaxLength) return similar;
  for (const CLI::Option* option : command.get_options()) {
    if (!option->nonpositional() || option->get_name().empty()) continue;
    const std::size_t typos = edit_distance(name, option->get_name());
    if (typos >= min_typos) continue;
    min_typos = typos;
    similar = option->get_name();
  }
  return similar;
}

void start_group(CLI::App& command, const std::string& name) {
  command.option_defaults()->group(name);
}

void put_first(CLI::App& command, std::initializer_list<const char*> options) {
  for (const char* option : options) command.get_option(option)->group(kFirstGroup);
}

CLI::App& add_command(CLI::App& program, const std::string& name, const std::string& description,
                      const std::string& footer) {
  CLI::App& command = *program.add_subcommand(name, description);
  add_common_options(command);
  start_group(command, kFirstGroup);
  command.footer(footer);
  return command;
}

void add_common_options(CLI::App& command) {
  start_group(command, "General");
  command.get_help_ptr()->group("General");
  command.set_version_flag("--version", fmt::format("penumbra {}", program_version()),
                           "Print the version and exit");
  const auto set_value = [](const std::string& name) {
    if (set_log_level(name)) return;
    usage_error("--log-level", "{}: no such level; known: trace, debug, info, warning, error, off",
                name);
  };
  add_text_option(command, "--log-level", "LEVEL", set_value,
                  "Lowest level of messages: trace, debug, info, warning, error, off")
      ->default_str("warning");
}

CLI::Option* add_text_option(CLI::App& command, const std::string& name, const std::string& type,
                             const std::function<void(const std::string&)>& set_value,
                             const std::string& description) {
  return command.add_option_function<std::string>(name, set_value, description)->type_name(type);
}

CLI::Option* add_row_log_option(CLI::App& command, const std::string& name,
                                std::optional<std::filesystem::path>& file,
                                const std::string& description) {
  const auto set_file = [&file, name](const std::string& text) {
    if (!is_row_log(text)) usage_error(name, "{}: end it in .csv or .jsonl", text);
    file = text;
  };
  return add_text_option(command, name, "FILE", set_file, description);
}

CLI::Option* add_choice_option(CLI::App& command, const std::string& name,
                               const std::vector<std::string>& words, std::string& variable,
                               const std::string& description) {
  const std::string type = fmt::format("{}", fmt::join(words, "|"));
  return add_option(command, name, type, variable, description)
      ->check(CLI::IsMember(words).description(""));
}

CLI::Validator any_number() {
  return check_that("a number", [](const std::string& text) {
    const auto value = parse_number(text);
    return value && std::isfinite(*value);
  });
}

CLI::Validator in_range(double min_value, double max_value) {
  return check_that(fmt::format("a number from {} to {}", min_value, max_value),
                    [=](const std::string& text) {
                      const auto value = parse_number(text);
                      return value && *value >= min_value && *value <= max_value;
                    });
}

CLI::Validator in_range(int min_value, int max_value) {
  return check_that(fmt::format("a whole number from {} to {}", min_value, max_value),
                    [=](const std::string& text) {
                      const auto value = parse_integer(text);
                      return value && *value >= min_value && *value <= max_value;
                    });
}

CLI::Validator whole_number() {
  return check_that("a whole number from 0", [](const std::string& text) {
    const auto value = parse_integer(text);
    return value && *value >= 0;
  });
}

void add_off_flag(CLI::App& command, const std::string& name, bool& variable,
                  const std::string& description) {
  command.add_flag_callback(
      name, [&variable] { variable = false; }, description);
}

std::string known_techniques() {
  std::string words = joined_names(kShadowTechniqueNames, ", ");
  return words.insert(words.find("layered"), "cocl, ");
}

void set_technique(ShadowChoice& choice, const std::string& option, const std::string& name) {
  choice.cocl = name == kCocl;
  choice.plan.technique = value_named(kShadowTechniqueNames, choice.cocl ? "layered" : name);
  if (!choice.plan.technique) {
    usage_error(option, "{}: no such technique; known: {}", name, known_techniques());
  }
}

CLI::Option* add_shadow_options(CLI::App& command, ShadowChoice& choice) {
  PlanOptions& plan = choice.plan;
  start_group(command, "Shadows");
  CLI::Option* shadow = add_text_option(
      command, "--shadow", "TECHNIQUE",
      [&choice](const std::string& name) { set_technique(choice, "--shadow", name); },
      "Technique in place of the scene's: " + known_techniques());
  add_text_option(
      command, "--kernels", "KERNELS|FILE.json",
      [&choice](const std::string& name) {
        const KernelChoice given = kernel_choice_from(name);
        choice.plan.kernels = given.source;
        choice.kernel_file = given.file;
      },
      fmt::format("Points about which shadow layers grow and shrink: {}, or a kernel file",
                  joined_names(kKernelSourceNames, ", ")));
  add_word_option(command, "--light-mode", kLightModeNames, "mode", plan.light_mode,
                  "Size of the light: proportional to each part's thickness, or fixed");
  add_text_option(
      command, "--proxy", "auto|none",
      [&choice](const std::string& name) {
        choice.plan.proxies = choice.proxies_requested = name == "auto";
        if (name != "auto" && name != "none") {
          usage_error("--proxy", "{}: is neither auto nor none", name);
        }
      },
      "auto: reduced models of the scene cast where exact enough; none: objects cast themselves")
      ->default_str("auto");
  add_word_option(command, "--translucency", kTranslucencyNames, "mode", plan.translucency,
                  "How shadows darken the video; auto: the first that works")
      ->default_str("auto");
  add_word_option(command, "--layers", kLayerDrawingNames, "mode", plan.layers,
                  "How shadows are drawn: direct: face by face; mask: as one texture per plane; "
                  "auto: the cheaper")
      ->default_str("auto");
  command.add_flag("--show-rays", plan.light_rays,
                   "Draw rays from lights through vertices to their shadows, for hard, volume");
  add_off_flag(command, "--hide-walls", plan.walls,
               "Do not draw the virtual walls of the technique walls, only the shadows on them");
  return shadow;
}

KernelChoice kernel_choice_from(const std::string& text) {
  if (const auto source = value_named(kKernelSourceNames, text)) return {*source, std::nullopt};
  std::error_code ignored;
  if (std::filesystem::path(text).has_extension() || std::filesystem::exists(text, ignored)) {
    return {KernelSource::automatic, text};
  }
  usage_error("--kernels", "{}: no such kernels; known: {}, or a kernel file (.json)", text,
              joined_names(kKernelSourceNames, ", "));
}

void warn_of_unused_options(const ShadowChoice& choice) {
  const PlanOptions& plan = choice.plan;
  if (!plan.technique) return;
  const TechniqueTraits traits = traits_of(*plan.technique);
  const auto no_use = [&](std::string_view option) {
    log_warning("{}: has no effect with {} shadows", option, to_string(*plan.technique));
  };
  if (!plan.walls && *plan.technique != ShadowTechnique::walls) no_use("--hide-walls");
  if (traits.uses_kernels) return;
  if (choice.kernel_file ||
      plan.kernels.value_or(KernelSource::automatic) != KernelSource::automatic)
    no_use("--kernels");
  const bool is_fixed = traits.has_one_light_size && plan.light_mode == LightMode::fixed;
  if (plan.light_mode && !is_fixed) no_use("--light-mode");
  if (choice.proxies_requested) no_use("--proxy");
}

void warn_of_unused_options(const CLI::App& command, const TrackerOptions& tracking) {
  const CLI::Option* given = command.get_option_no_throw("--poses-from");
  if (given != nullptr && given->count() > 0) {
    for (const char* option : {"--tracking", "--pose-budget", "--no-background-search"}) {
      if (command.count(option) > 0)
        log_warning("{}: has no effect with --poses-from, because nothing is tracked", option);
    }
    return;
  }
  if (tracking.mode == TrackingMode::detect && tracking.pose_budget_px > 0.0) {
    log_warning("--pose-budget: has no effect with --tracking detect");
  }
}

PlanOptions plan_of(const ShadowChoice& choice) {
  PlanOptions plan = choice.plan;
  if (choice.cocl) {
    const KernelSource kernels = plan.kernels.value_or(KernelSource::automatic);
    if (choice.kernel_file ||
        (kernels != KernelSource::automatic && kernels != KernelSource::centroid)) {
      usage_error("--shadow", "cocl uses its own centroid kernels; leave out --kernels");
    }
    plan.kernels = KernelSource::centroid;
  }
  if (plan.light_mode == LightMode::fixed && plan.kernels == KernelSource::centroid) {
    usage_error("--light-mode", "fixed needs kernels with a thickness; cocl has none");
  }
  return plan;
}

void check_camera_output(const std::string& option, const std::filesystem::path& file) {
  if (camera_count(file) > 1) {
    usage_error(option, "{}: holds several cameras, and would hold one; name another file",
                file.string());
  }
  const std::string extension = lower_extension(file);
  if (extension != ".json" && extension != ".xml" && extension != ".cameramodel") return;
  usage_error(option,
              "{}: camera files are written as YAML; end the name in .yaml, or in .yml for "
              "OpenCV's format",
              file.string());
}

void check_camera_source(const std::string& source) {
  if (const auto address = parse_camera(source); !address)
    usage_error("--camera", "{}", address.error().message);
}

CLI::Option* add_camera_name_option(CLI::App& command, std::string& name) {
  return add_option(command, "--camera-name", "NAME", name,
                    "Which camera, if the file has several (of Kalibr, OpenCV stereo)");
}

void add_frames_option(CLI::App& command, FrameRange& frames) {
  const auto set_frames = [&frames](const std::string& text) {
    const auto range = parse_frame_range(text);
    if (!range) {
      usage_error("--frames", "{}: is not a range A:B with A < B (half open: A to B - 1)", text);
    }
    frames = *range;
  };
  add_text_option(command, "--frames", "A:B", set_frames,
                  "Only frames numbered A to B - 1; either may be omitted");
}

void add_size_option(CLI::App& command, const std::string& type, std::optional<int>& width,
                     std::optional<int>& height, const std::string& description) {
  const auto set_value = [&width, &height](std::string_view text) {
    constexpr std::int64_t kLargest = 16384;
    const std::size_t cross = std::min(text.find('x'), text.size() - 1);
    const auto columns = parse_integer(text.substr(0, cross));
    const auto rows = parse_integer(text.substr(cross + 1));
    if (!columns || !rows || std::min(*columns, *rows) < 1 || std::max(*columns, *rows) > kLargest)
      usage_error("--size", "{}: is not a size such as 640x480", text);
    width = static_cast<int>(*columns);
    height = static_cast<int>(*rows);
  };
  add_text_option(command, "--size", type, set_value, description);
}

CLI::Option* add_fps_option(CLI::App& command, std::optional<double>& fps) {
  return add_option(command, "--fps", "RATE", fps, "Rate to ask the camera for (default: 30)")
      ->check(in_range(0.1, 1000.0));
}

void add_pairing_options(CLI::App& command, PairingOptions& pairing) {
  start_group(command, "Ground truth");
  add_seconds_option(command, "--max-gap", 0.0, 1e6, pairing.max_gap_ns, "0.1",
                     "Longest interval in which the ground truth is interpolated; 0: never");
  add_seconds_option(command, "--time-offset", -4e9, 4e9, pairing.time_offset_ns, "0",
                     "Added to the times that are compared with the ground truth");
}

CLI::Option* add_poses_from_option(CLI::App& command, std::optional<std::string>& poses_from) {
  return add_option(
      command, "--poses-from", "groundtruth|FILE.tum", poses_from,
      "Draw with these poses, without tracking: the recording's truth, or a TUM file");
}

void add_tracking_options(CLI::App& command, TrackerOptions& tracking) {
  start_group(command, "Tracking");
  add_word_option(command, "--tracking", kTrackingModeNames, "mode", tracking.mode,
                  "accurate: all pixels at tag edges; fast: few; auto: few while the view moves; "
                  "detect: tag corners only")
      ->type_name("MODE")
      ->default_str("auto");
  const auto set_budget = [&tracking](const std::string& text) {
    const auto px = parse_number(text);
    if (!px || !std::isfinite(*px) || !(*px > 0.0)) {
      usage_error("--pose-budget", "{}: is not a number of pixels above 0", text);
    }
    tracking.pose_budget_px = *px;
  };
  add_text_option(command, "--pose-budget", "PX", set_budget,
                  "Use fewer pixels while the predicted overlay error stays below this");
  command.add_flag_callback(
      "--no-background-search", [&tracking] { tracking.search_timing = SearchTiming::in_frame; },
      "Search for lost tags within the frame, not in a thread: frames take longer");
}

CLI::Option* add_refine_map_option(CLI::App& command, RunRequest& request) {
  const auto is_yaml = [](const std::string& file) {
    const std::string extension = lower_extension(file);
    return names_standard_output(file) || extension == ".yaml" || extension == ".yml";
  };
  const auto set_file = [&request, is_yaml](const std::string& file) {
    request.refine_map = true;
    if (file.empty()) return;
    if (!is_yaml(file)) {
      usage_error("--refine-map",
                  "{}: is not a tags.yaml; name a file that ends in .yaml, or none (then put the "
                  "option last)",
                  file);
    }
    request.refined_map = file;
  };
  CLI::Option* option = add_text_option(
      command, "--refine-map", "[tags.yaml]", set_file,
      "Refine the tag map while tracking: poses of the tags, curved paper; written at the end");
  option->expected(0, 1);
  const auto set_camera = [&request, is_yaml](const std::string& file) {
    if (!is_yaml(file)) usage_error("--refine-camera", "{}: name a file that ends in .yaml", file);
    check_camera_output("--refine-camera", file);
    request.refined_camera = file;
  };
  add_text_option(command, "--refine-camera", "camera.yaml", set_camera,
                  "At the end, write the estimated row time and a refined lens")
      ->needs(option);
  return option;
}

CLI::Option* add_smooth_option(CLI::App& command, bool& smooth) {
  return command.add_flag("--smooth", smooth,
                          "Draw with a smoothed pose; written poses stay as measured");
}

void add_scene_option(CLI::App& command, RunRequest& request, const char* description) {
  add_option(command, "--scene", "FILE.json", request.scene, description);
}

void add_window_options(CLI::App& command, RunRequest& request) {
  start_group(command, "Window");
  add_off_flag(command, "--no-window", request.window, "Offscreen, even if there is a display");
  add_off_flag(command, "--no-hud", request.viewer.hud,
               "The window's HUD is hidden at first (H shows it)");
  command.add_flag("--fullscreen", request.viewer.full_screen, "The window fills the screen");
}

void set_run_options(const CLI::App& command, const ShadowChoice& shadow, RunRequest& request) {
  std::vector<std::filesystem::path> outputs;
  for (const char* name : {"--output", "--poses", "--report", "--group-poses", "--frame-log",
                           "--refine-map", "--refine-camera", "--save-scene", "--record"}) {
    const CLI::Option* option = command.get_option_no_throw(name);
    if (option == nullptr || option->count() == 0 || option->results().back().empty()) continue;
    outputs.emplace_back(option->results().back());
    if (const auto once = check_written_once(outputs, {}); !once)
      usage_error(name, "{}", once.error().message);
  }
  warn_of_unused_options(shadow);
  warn_of_unused_options(command, request.tracking);
  request.plan = plan_of(shadow);
  request.kernel_file = shadow.kernel_file;
}

std::filesystem::path bundled_scene(const std::filesystem::path& resources,
                                    const std::vector<ObjectRequest>& objects) {
  return resources / "scenes" / (objects.empty() ? "default.json" : "table.json");
}

Result<void> complete(RunRequest& request) {
  if (!request.scene.empty()) return {};
  PENUMBRA_TRY(const auto resources, find_resources());
  request.scene = bundled_scene(resources, request.objects);
  return {};
}

void add_frame_options(CLI::App& command, RunRequest& request, ShadowChoice& shadow) {
  start_group(command, "Drawing");
  add_option(command, "--threads", "N", request.threads,
             "1: one stage after another; more: side by side. The results are the same")
      ->check(in_range(1, 1024))
      ->capture_default_str();
  command.add_flag("--rectified", request.rectified,
                   "The image without the lens's distortion; the video is resampled");
  const auto set_samples = [&msaa = request.msaa](const std::string& text) {
    msaa.reset();
    if (text == "auto") return;
    constexpr std::int64_t kMaxSamples = 64;
    const auto samples = text == "off" ? 0 : parse_integer(text);
    if (!samples || *samples < 0 || *samples > kMaxSamples) {
      usage_error("--msaa", "{}: is neither auto, off nor a number of samples", text);
    }
    msaa = static_cast<int>(*samples);
  };
  add_text_option(
      command, "--msaa", "auto|off|N", set_samples,
      "Samples per pixel for smooth edges; auto: 4 on a GPU, else edges are smoothed after drawing")
      ->default_str("auto");
  const auto set_pixel_buffers = [&pixel_buffers = request.pixel_buffers](const std::string& text) {
    pixel_buffers.reset();
    if (text != "auto") pixel_buffers = text == "on";
  };
  add_text_option(command, "--pixel-buffers", "auto|on|off", set_pixel_buffers,
                  "Transfer pixels through buffers; auto: on with a GPU. The results are the same")
      ->check(CLI::IsMember({"auto", "on", "off"}).description(""))
      ->default_str("auto");
  add_off_flag(command, "--no-video-light", request.video_light,
               "Light virtual objects by the scene alone, without measuring the video's light");
  add_off_flag(command, "--no-skip", shadow.plan.skip,
               "Do all work, also what can't be seen or was done before; the results are the same");
}

void add_output_options(CLI::App& command, OutputRequest& request) {
  start_group(command, "Output");
  const auto set_output = [&request](const std::string& path) {
    if (names_standard_output(path)) {
      usage_error("--output", "{}: is for text, and these are frames; name a video or a folder",
                  path);
    }
    if (names_unknown_video(path)) {
      usage_error("--output",
                  "{}: end it in .mkv (FFV1, lossless) or .mp4 (H.264), or name a folder", path);
    }
    request.output = path;
  };
  add_text_option(
      command, "--output", "PATH", set_output,
      "Composited frames: *.mkv (FFV1, lossless), *.mp4 (H.264), or a folder of PNG images");
  CLI::Option* poses = add_option(command, "--poses", "FILE.tum", request.poses,
                                  "Tracked poses, as a TUM file; - is standard output");
  command
      .add_flag("--poses-all", request.poses_all,
                "Uncertain and held poses too, each after a line with its state")
      ->needs(poses);
  add_option(command, "--group-poses", "FOLDER", request.group_poses,
             "Poses (T_table_group) of the tag groups beside the table: NAME.tum of each");
  add_row_log_option(command, "--frame-log", request.frame_log,
                     "A row per frame and tag group, as *.csv or *.jsonl; - is standard output");
  add_option(command, "--report", "FILE.json", request.report,
             "Report with all measurements, as JSON; - is standard output");
  const auto set_scene = [&request](const std::string& file) {
    if (!names_standard_output(file) && lower_extension(file) != ".json") {
      usage_error("--save-scene", "{}: end it in .json", file);
    }
    request.saved_scene = file;
  };
  add_text_option(command, "--save-scene", "FILE.json", set_scene,
                  "The arrangement at the end, as a scene for --scene; - is standard output");
}

std::string written_files(const OutputRequest& request,
                          const std::optional<std::filesystem::path>& recording) {
  std::vector<std::string> paths;
  std::error_code ignored;
  for (const auto& path :
       {request.output, request.poses, request.group_poses, request.frame_log, request.report,
        request.refined_map, request.refined_camera, request.saved_scene, recording}) {
    if (path && !names_standard_output(path->string()) &&
        !std::filesystem::is_empty(*path, ignored))
      paths.push_back(path->string());
  }
  return paths.empty() ? "" : fmt::format("\nwrote {}\n", fmt::join(paths, ", "));
}

std::function<std::string(const std::string&)> length_check(std::string_view symbol,
                                                            double min_value, double max_value) {
  return [&unit = *length_unit_from_string(symbol), min_value, max_value](const std::string& text) {
    const auto in_range = [&](double value) { return value >= min_value && value <= max_value; };
    if (const auto value = parse_number(text); value && in_range(*value)) return std::string();
    const std::string message =
        fmt::format("is '{}'; give {} from {:g} to {:g}", text, unit.plural, min_value, max_value);
    const std::size_t end = std::min(text.find_first_not_of("0123456789.,+-"), text.size());
    std::string digits = text.substr(0, end);
    std::ranges::replace(digits, ',', '.');
    const auto number = parse_number(digits);
    if (!number) return message;
    const std::string_view given_symbol = trim(std::string_view(text).substr(end));
    for (const LengthUnit& given : kLengthUnits) {
      const double value = *number * given.length_m / unit.length_m;
      // For a number without a unit, suggests the first unit in which the number is in range.
      if (!in_range(value) || (!given_symbol.empty() && given.symbol != given_symbol)) continue;
      if (given.symbol == unit.symbol) return fmt::format("{}: {:g}", message, value);
      return fmt::format("{}: {:g} for {:g} {}", message, value, *number, given.symbol);
    }
    return message;
  };
}

void add_part_group_option(CLI::App& command, std::vector<std::string>& groups) {
  add_option(
      command, "--group", "all|NAME", groups,
      "Parts that share one light: all, or a node, mesh or object by name (*, ?); repeatable")
      ->allow_extra_args(false);
}

void add_unit_option(CLI::App& command, double& unit_m) {
  const auto set_value = [&unit_m](const std::string& symbol) {
    const LengthUnit* unit = length_unit_from_string(symbol);
    if (unit == nullptr) usage_error("--unit", "{}: is none of mm, cm, m and in", symbol);
    unit_m = unit->length_m;
  };
  add_text_option(command, "--unit", "mm|cm|m|in", set_value,
                  "Unit of the model's coordinates (default: m)");
}

void add_pose_options(CLI::App& command, std::optional<ModelPose>& pose) {
  const auto pose_of = [&pose]() -> ModelPose& { return pose ? *pose : pose.emplace(); };
  add_text_option(
      command, "--animation", "NAME|INDEX|all",
      [pose_of](const std::string& animation) {
        if (animation.empty()) usage_error("--animation", "is empty; give a name, an index or all");
        pose_of().animation = animation;
      },
      "Shape of the model in this animation (default: its rest pose)");
  const auto set_time = [pose_of](const std::string& text) {
    const auto time_s = parse_number(text);
    if (!time_s || !std::isfinite(*time_s)) {
      usage_error("--time", "{}: is not a number of seconds", text);
    }
    pose_of().time_s = *time_s;
  };
  add_text_option(command, "--time", "SECONDS", set_time,
                  "Time of the animation, which is the first one without --animation (default: 0)");
}

void claim_outputs(const CLI::App& command, std::initializer_list<const char*> options) {
  const char* first = nullptr;
  for (const char* option : options) {
    if (command.count(option) == 0) continue;
    const std::string& path = command.get_option(option)->results().back();
    if (!names_standard_output(path)) continue;
    if (first != nullptr) {
      usage_error(option, "{}: standard output is taken by {}; name a file for one of them", path,
                  first);
    }
    first = option;
  }
  if (first != nullptr) claim_standard_output();
}

}  // namespace penumbra
