#include "app/commands/options.hpp"

#include <algorithm>
#include <array>

#include "app/logging.hpp"
#include "app/output/frame_writer.hpp"
#include "app/output/output_file.hpp"
#include "app/report/versions.hpp"
#include "app/resources.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "render/model/model_size.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kCocl = "cocl";

template <class Names>
std::string joined_names(const Names& names, std::string_view separator) {
  std::string words;
  for (const auto& entry : names) {
    if (!words.empty()) words += separator;
    words += entry.name;
  }
  return words;
}

// A folder's name may have dots, but not the extension of a file.
bool names_unknown_video(const std::string& path) {
  constexpr std::array<std::string_view, 14> kFiles = {".avi", ".webm", ".mov",  ".m4v", ".mpg",
                                                       ".ts",  ".ogv",  ".mpeg", ".wmv", ".gif",
                                                       ".png", ".jpg",  ".jpeg", ".y4m"};
  return output_kind(path) == OutputKind::folder &&
         std::ranges::find(kFiles, lower_extension(path)) != kFiles.end();
}

std::optional<LayerDrawing> layer_drawing_from_string(const std::string& name) {
  if (name == "auto") return LayerDrawing::automatic;
  if (name == "direct") return LayerDrawing::direct;
  if (name == "mask") return LayerDrawing::mask;
  return std::nullopt;
}

void add_seconds_option(CLI::App& command, const std::string& name, double least, double most,
                        std::int64_t& variable_ns, const std::string& default_text,
                        const std::string& description) {
  const auto take = [=, &variable_ns](const std::string& text) {
    const auto value = parse_number(text);
    if (!value || !(*value >= least && *value <= most)) {
      usage_error(name, "is '{}'; give seconds from {:g} to {:g}", text, least, most);
    }
    variable_ns = nanoseconds(*value);
  };
  add_text_option(command, name, "SECONDS", take, description)->default_str(default_text);
}

}  // namespace

CLI::App& add_command(CLI::App& program, const std::string& name, const std::string& description,
                      const std::string& footer) {
  CLI::App& command = *program.add_subcommand(name, description);
  add_common_options(command);
  command.footer(footer);
  return command;
}

void add_common_options(CLI::App& command) {
  command.set_version_flag("--version", fmt::format("penumbra {}", program_version()),
                           "Print the version and exit");
  const auto take = [](const std::string& name) {
    if (set_log_level(name)) return;
    usage_error("--log-level", "{}: no such level; known: trace, debug, info, warning, error, off",
                name);
  };
  add_text_option(
      command, "--log-level", "LEVEL", take,
      "Lowest level of messages on standard error: trace, debug, info, warning, error, off")
      ->default_str("warning");
}

CLI::Option* add_text_option(CLI::App& command, const std::string& name, const std::string& type,
                             const std::function<void(const std::string&)>& take,
                             const std::string& description) {
  return command.add_option_function<std::string>(name, take, description)->type_name(type);
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
  choice.plan.technique = shadow_technique_from_string(choice.cocl ? "layered" : name);
  if (!choice.plan.technique) {
    usage_error(option, "{}: no such technique; known: {}", name, known_techniques());
  }
}

CLI::Option* add_shadow_options(CLI::App& command, ShadowChoice& choice) {
  PlanOptions& plan = choice.plan;
  CLI::Option* shadow = add_text_option(
      command, "--shadow", "TECHNIQUE",
      [&choice](const std::string& name) { set_technique(choice, "--shadow", name); },
      "Technique of every shadow in place of the scene's: " + known_techniques());
  add_text_option(
      command, "--kernels", "KERNELS|FILE.json",
      [&choice](const std::string& name) {
        const KernelChoice given = kernel_choice_from(name);
        choice.plan.kernels = given.source;
        choice.kernel_file = given.file;
      },
      fmt::format("Shadow kernels in place of the scene's: {} (auto: from the silhouette, for each "
                  "part; smooth: the same, blended; per-axis: from the sets of the three axes; "
                  "cocl: one for the whole object), or a kernel file for the objects of as many "
                  "vertices",
                  joined_names(kKernelSourceNames, ", ")));
  add_word_option(
      command, "--light-mode", "proportional|fixed", "mode", plan.light_mode,
      light_mode_from_string,
      "Light of layered shadows in place of the scene's: proportional (for each part by "
      "its thickness) or fixed (one size)");
  add_text_option(
      command, "--proxy", "auto|none",
      [&choice](const std::string& name) {
        choice.plan.proxies = choice.asks_for_proxies = name == "auto";
        if (name != "auto" && name != "none") {
          usage_error("--proxy", "{}: is neither auto nor none", name);
        }
      },
      "auto: the reduced model that the scene names (\"proxy\") casts shadows in place of the "
      "object's; layered ones where their layers agree to 0.98; none: each object casts with its "
      "own mesh")
      ->default_str("auto");
  add_word_option(
      command, "--translucency", joined_names(kTranslucencyNames, "|"), "way", plan.translucency,
      translucency_from_string,
      "How shadows, and what fades out, let the video shine through. blend: by the graphics "
      "hardware; mesh: black pixels in an ordered pattern, in proportion to the missing light; "
      "retexture: by fetching the video and writing it darker; geometry-mesh: black strips on the "
      "table, to compare with; auto: the first of blend, retexture, mesh that works")
      ->default_str("auto");
  add_word_option(
      command, "--layers", "auto|direct|mask", "way", plan.layers, layer_drawing_from_string,
      "Drawing of layered, field and simple shadows. direct: each face by the graphics hardware, "
      "once per layer; mask: as a mask on the table and at each height of a receiver, made of "
      "silhouettes, with smooth edges; auto: mask, which is faster, but direct with several "
      "samples per pixel (--msaa) and few faces, and if all shadows on a plane are simple")
      ->default_str("auto");
  command.add_flag("--show-rays", plan.light_rays,
                   "Draw rays from the lights through vertices of the casters to their points in "
                   "the shadow, for hard and volume");
  return shadow;
}

KernelChoice kernel_choice_from(const std::string& text) {
  if (const auto source = kernel_source_from_string(text)) return {*source, std::nullopt};
  std::error_code ignored;
  if (std::filesystem::path(text).has_extension() || std::filesystem::exists(text, ignored)) {
    return {KernelSource::automatic, text};
  }
  usage_error("--kernels", "{}: no such kernels; known: {}, or a kernel file (.json)", text,
              joined_names(kKernelSourceNames, ", "));
}

void warn_of_no_use(const ShadowChoice& choice) {
  const PlanOptions& plan = choice.plan;
  if (!plan.technique) return;
  const TechniqueTraits traits = traits_of(*plan.technique);
  if (traits.uses_kernels) return;
  const auto no_use = [&](std::string_view option) {
    log_warning("{}: {} shadows have no use for it", option, to_string(*plan.technique));
  };
  if (choice.kernel_file ||
      plan.kernels.value_or(KernelSource::automatic) != KernelSource::automatic)
    no_use("--kernels");
  const bool is_fixed = traits.has_one_light_size && plan.light_mode == LightMode::fixed;
  if (plan.light_mode && !is_fixed) no_use("--light-mode");
  if (choice.asks_for_proxies) no_use("--proxy");
}

void warn_of_no_use(const CLI::App& command, const TrackerOptions& tracking) {
  const CLI::Option* given = command.get_option_no_throw("--poses-from");
  if (given != nullptr && given->count() > 0) {
    for (const char* option : {"--tracking", "--pose-budget", "--no-background-search"}) {
      if (command.count(option) > 0)
        log_warning("{}: --poses-from has no use for it; nothing is tracked", option);
    }
    return;
  }
  if (tracking.mode == TrackingMode::detect && tracking.pose_budget_px > 0.0) {
    log_warning("--pose-budget: detection has no use for it; it samples what it finds");
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

CLI::Option* add_camera_name_option(CLI::App& command, std::string& name) {
  return add_option(command, "--camera-name", "NAME", name,
                    "Name of the camera in a file that holds several (Kalibr's camchain, stereo "
                    "files of OpenCV)");
}

void add_size_option(CLI::App& command, const std::string& type, std::optional<int>& width,
                     std::optional<int>& height, const std::string& description) {
  const auto take = [&width, &height](std::string_view text) {
    constexpr std::int64_t kLargest = 16384;
    const std::size_t cross = std::min(text.find('x'), text.size() - 1);
    const auto columns = parse_integer(text.substr(0, cross));
    const auto rows = parse_integer(text.substr(cross + 1));
    if (!columns || !rows || std::min(*columns, *rows) < 1 || std::max(*columns, *rows) > kLargest)
      usage_error("--size", "{}: is not a size such as 640x480", text);
    width = static_cast<int>(*columns);
    height = static_cast<int>(*rows);
  };
  add_text_option(command, "--size", type, take, description);
}

CLI::Option* add_fps_option(CLI::App& command, std::optional<double>& fps) {
  return add_option(command, "--fps", "RATE", fps, "Rate to ask the camera for (default: 30)")
      ->check(CLI::Range(0.1, 1000.0));
}

void add_pairing_options(CLI::App& command, PairingOptions& pairing) {
  add_seconds_option(
      command, "--max-gap", 0.0, 1e6, pairing.max_gap_ns, "0.1",
      "The ground truth is interpolated between two of its poses that are at most this far apart "
      "(0: not at all), and extrapolated by at most 10 ms before its first and after its last "
      "pose");
  add_seconds_option(
      command, "--time-offset", -4e9, 4e9, pairing.time_offset_ns, "0",
      "Added to the estimate's times (in replay: the recording's): positive where its clock is "
      "behind that of the ground truth");
}

CLI::Option* add_poses_from_option(CLI::App& command, std::optional<std::string>& poses_from) {
  return add_option(
      command, "--poses-from", "groundtruth|FILE.tum", poses_from,
      "Draw with given poses instead of tracking: groundtruth (the recording's), or a "
      "TUM file");
}

void add_tracking_options(CLI::App& command, TrackerOptions& tracking) {
  add_word_option(command, "--tracking", "fast|accurate|auto|detect", "way", tracking.mode,
                  tracking_mode_from_string,
                  "fast: a limited number of pixels; accurate: every pixel at an edge without "
                  "motion blur; auto: fast while the view moves, accurate while it rests or shows "
                  "few tags; detect: detection in every frame, as a baseline for comparisons")
      ->default_str("auto");
  const auto take_budget = [&tracking](double px) {
    if (!std::isfinite(px) || !(px > 0.0)) {
      usage_error("--pose-budget", "is {}; give pixels above 0", px);
    }
    tracking.pose_budget_px = px;
  };
  command
      .add_option_function<double>(
          "--pose-budget", take_budget,
          "Stop sampling pixels when their noise moves the overlay by less than this (prediction); "
          "fast never samples more than without it")
      ->type_name("PX");
  command.add_flag_callback(
      "--no-background-search", [&tracking] { tracking.search_timing = SearchTiming::in_frame; },
      "Search for lost groups of tags within the frame, not in the background of the next frames: "
      "the frame waits for the search, and groups that are found have the same poses");
}

CLI::Option* add_smooth_option(CLI::App& command, bool& smooth) {
  return command.add_flag(
      "--smooth", smooth,
      "Draw with a smoothed pose, which shakes less while the view rests. Written poses stay as "
      "measured; the report and the HUD show how late the drawn pose is");
}

void add_scene_option(CLI::App& command, RunRequest& request) {
  add_option(command, "--scene", "FILE.json", request.scene,
             "Scene to draw (default: the program's own)");
}

void add_window_options(CLI::App& command, RunRequest& request) {
  add_off_flag(command, "--no-window", request.window, "Offscreen, even if there is a display");
  add_off_flag(command, "--no-hud", request.viewer.hud,
               "The window's HUD is hidden at first (H shows it)");
}

void take_run_options(const CLI::App& command, const ShadowChoice& shadow, RunRequest& request) {
  warn_of_no_use(shadow);
  warn_of_no_use(command, request.tracking);
  request.plan = plan_of(shadow);
  request.kernel_file = shadow.kernel_file;
}

Result<void> complete(RunRequest& request) {
  if (!request.scene.empty()) return {};
  PENUMBRA_TRY(const auto resources, find_resources());
  request.scene = resources / "scenes" / "default.json";
  return {};
}

void add_frame_options(CLI::App& command, RunRequest& request, ShadowChoice& shadow,
                       const std::string& side_by_side) {
  add_option(command, "--threads", "N", request.threads,
             "1: one stage after another; more: " + side_by_side + ". The results are the same")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  command.add_flag("--rectified", request.rectified,
                   "The picture without the lens's distortion; the video is resampled");
  const auto take_samples = [&msaa = request.msaa](const std::string& text) {
    msaa.reset();
    if (text == "auto") return;
    constexpr std::int64_t kMost = 64;
    const auto samples = text == "off" ? 0 : parse_integer(text);
    if (!samples || *samples < 0 || *samples > kMost) {
      usage_error("--msaa", "{}: is neither auto, off nor a number of samples", text);
    }
    msaa = static_cast<int>(*samples);
  };
  add_text_option(command, "--msaa", "auto|off|N", take_samples,
                  "Smooth edges by this many samples per pixel; auto: 4 on a GPU, off with "
                  "software rendering, where each sample costs time")
      ->default_str("auto");
  const auto take_pixel_buffers = [&pixel_buffers =
                                       request.pixel_buffers](const std::string& text) {
    pixel_buffers.reset();
    if (text != "auto") pixel_buffers = text == "on";
  };
  add_text_option(command, "--pixel-buffers", "auto|on|off", take_pixel_buffers,
                  "Transfer pixels to and from the GPU through the driver's pixel buffers, so that "
                  "CPU and GPU do not wait for each other; auto: on with a GPU, off with software "
                  "rendering. The results are the same")
      ->check(CLI::IsMember({"auto", "on", "off"}))
      ->default_str("auto");
  add_off_flag(command, "--no-video-light", request.video_light,
               "Light virtual objects by the scene alone, without measuring the video's light");
  add_off_flag(command, "--no-skip", shadow.plan.skip,
               "Do all work, also what can't be seen or was done for an earlier frame; the results "
               "are the same");
}

void add_output_options(CLI::App& command, OutputRequest& request) {
  const auto take_output = [&request](const std::string& path) {
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
  add_text_option(command, "--output", "PATH", take_output,
                  "Composited frames: *.mkv (FFV1, lossless), *.mp4 (H.264), or a folder of "
                  "000000.png ... numbered by frame, which replace those of an earlier run");
  CLI::Option* poses = add_option(command, "--poses", "FILE.tum", request.poses,
                                  "Tracked poses, as a TUM file; - is standard output");
  command
      .add_flag("--poses-all", request.poses_all,
                "Uncertain and held poses too, each after a comment that says so")
      ->needs(poses);
  add_option(command, "--group-poses", "FOLDER", request.group_poses,
             "Poses of the tag groups beside the table (a wall, a prop): NAME.tum of each, with "
             "T_table_group, which is the identity where tags.yaml has it");
  add_option(command, "--report", "FILE.json", request.report,
             "Report with all measurements, as JSON; - is standard output");
}

std::function<std::string(const std::string&)> length_check(std::string_view symbol, double least,
                                                            double most) {
  return [&unit = *length_unit_from_string(symbol), least, most](const std::string& text) {
    const auto in_range = [&](double value) { return value >= least && value <= most; };
    if (const auto value = parse_number(text); value && in_range(*value)) return std::string();
    const std::string message =
        fmt::format("is '{}'; give {} from {:g} to {:g}", text, unit.plural, least, most);
    const std::size_t end = std::min(text.find_first_not_of("0123456789.,+-"), text.size());
    std::string digits = text.substr(0, end);
    std::ranges::replace(digits, ',', '.');
    const auto number = parse_number(digits);
    if (!number) return message;
    const std::string_view given_symbol = trim(std::string_view(text).substr(end));
    for (const LengthUnit& given : kLengthUnits) {
      const double value = *number * given.length_m / unit.length_m;
      // Without a unit, the first one that puts the number in range.
      if (!in_range(value) || (!given_symbol.empty() && given.symbol != given_symbol)) continue;
      if (given.symbol == unit.symbol) return fmt::format("{}: {:g}", message, value);
      return fmt::format("{}: {:g} for {:g} {}", message, value, *number, given.symbol);
    }
    return message;
  };
}

void add_part_group_option(CLI::App& command, std::vector<std::string>& groups) {
  add_option(command, "--group", "all|NAME", groups,
             "Parts that share one light: all, or a glTF node or mesh or OBJ object by its name (* "
             "and ? are wildcards); may be given again for other groups")
      ->allow_extra_args(false);
}

void add_unit_option(CLI::App& command, double& unit_m) {
  const auto take = [&unit_m](const std::string& symbol) {
    const LengthUnit* unit = length_unit_from_string(symbol);
    if (unit == nullptr) usage_error("--unit", "{}: is none of mm, cm, m and in", symbol);
    unit_m = unit->length_m;
  };
  add_text_option(command, "--unit", "mm|cm|m|in", take,
                  "Unit of the model's coordinates (default: m)");
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
