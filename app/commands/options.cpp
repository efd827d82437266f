#include "app/commands/options.hpp"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <array>
#include <cctype>

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

// A folder may be named with dots, but not by what is meant as a file.
bool names_unknown_video(const std::string& path) {
  constexpr std::array<std::string_view, 14> kFiles = {".avi", ".webm", ".mov",  ".m4v", ".mpg",
                                                       ".ts",  ".ogv",  ".mpeg", ".wmv", ".gif",
                                                       ".png", ".jpg",  ".jpeg", ".y4m"};
  if (output_kind(path) != OutputKind::folder) return false;
  std::string extension = std::filesystem::path(path).extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return std::find(kFiles.begin(), kFiles.end(), extension) != kFiles.end();
}

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

std::string known_translucencies() {
  std::string list;
  for (const TranslucencyName& entry : kTranslucencyNames) {
    if (!list.empty()) list += ", ";
    list += entry.name;
  }
  return list;
}

void set_technique(ShadowChoice& choice, const std::string& option, const std::string& name) {
  const auto technique =
      shadow_technique_from_string(name == kCocl ? "layered" : std::string_view(name));
  if (!technique) {
    throw CLI::ValidationError(
        option, fmt::format("{}: no such technique; known: {}", name, known_techniques()));
  }
  choice.technique = technique;
  choice.cocl = name == kCocl;
}

CLI::Option* add_shadow_options(CLI::App& command, ShadowChoice& choice) {
  CLI::Option* shadow =
      command
          .add_option_function<std::string>(
              "--shadow",
              [&choice](const std::string& name) { set_technique(choice, "--shadow", name); },
              fmt::format("Technique of every shadow in place of the scene's: {}",
                          known_techniques()))
          ->type_name("TECHNIQUE");
  command
      .add_option_function<std::string>(
          "--kernels",
          [&choice](const std::string& name) {
            const KernelChoice given = kernel_choice_from(name);
            choice.kernels = given.source;
            choice.kernel_file = given.file;
          },
          fmt::format("Shadow kernels in place of the scene's: {} (auto: from the silhouette, for "
                      "each part; smooth: the same, blended; per-axis: from the sets of the three "
                      "axes; cocl: one for the whole object), or a kernel file for the objects of "
                      "as many vertices",
                      known_kernels()))
      ->type_name("KERNELS|FILE.json");
  command
      .add_option_function<std::string>(
          "--light-mode",
          [&choice](const std::string& name) { choice.light_mode = light_mode_choice_from(name); },
          "Light of layered shadows in place of the scene's: proportional (for each part by its "
          "thickness) or fixed (one size)")
      ->type_name("proportional|fixed");
  command
      .add_option_function<std::string>(
          "--proxy",
          [&choice](const std::string& name) {
            if (name != "auto" && name != "none") {
              throw CLI::ValidationError("--proxy",
                                         fmt::format("{}: is neither auto nor none", name));
            }
            choice.proxies = name == "auto";
            choice.asks_for_proxies = choice.proxies;
          },
          "auto: the reduced model that the scene names (\"proxy\") casts shadows in place of the "
          "object's; layered ones where their layers agree to 0.98; none: each object casts with "
          "its "
          "own mesh")
      ->type_name("auto|none")
      ->default_str("auto");
  command
      .add_option_function<std::string>(
          "--translucency",
          [&choice](const std::string& name) {
            const auto way = translucency_from_string(name);
            if (!way) {
              throw CLI::ValidationError(
                  "--translucency",
                  fmt::format("{}: no such way; known: {}", name, known_translucencies()));
            }
            choice.translucency = *way;
          },
          "How shadows, and what fades out, let the video shine through. blend: by the graphics "
          "hardware; mesh: black pixels in an ordered pattern, as many as light is missing; "
          "retexture: by fetching the video and writing it darker; geometry-mesh: black strips on "
          "the table, to compare with; auto: the first of blend, retexture, mesh that works")
      ->type_name("auto|blend|mesh|retexture|geometry-mesh")
      ->default_str("auto");
  command
      .add_option_function<std::string>(
          "--layers",
          [&choice](const std::string& name) {
            if (name != "auto" && name != "direct" && name != "mask") {
              throw CLI::ValidationError(
                  "--layers", fmt::format("{}: no such way; known: auto, direct, mask", name));
            }
            choice.layers = name == "mask"     ? LayerDrawing::mask
                            : name == "direct" ? LayerDrawing::direct
                                               : LayerDrawing::automatic;
          },
          "How layered, field and simple shadows are drawn. direct: each face by the graphics "
          "hardware, once a layer; mask: as a picture on the table, and on each height of what the "
          "shadow climbs, made of silhouettes, with smooth edges; auto: the mask, which takes "
          "less, but directly with several samples a pixel (--msaa) and few faces, and where all "
          "shadows on a plane are simple")
      ->type_name("auto|direct|mask")
      ->default_str("auto");
  command.add_flag("--show-rays", choice.light_rays,
                   "Draw rays from the lights through vertices of what casts to the points of the "
                   "shadow that belong to them, for hard and volume");
  return shadow;
}

KernelChoice kernel_choice_from(const std::string& text) {
  if (const auto source = kernel_source_from_string(text)) return {*source, std::nullopt};
  std::error_code ignored;
  if (std::filesystem::path(text).has_extension() || std::filesystem::exists(text, ignored)) {
    return {KernelSource::automatic, text};
  }
  throw CLI::ValidationError(
      "--kernels", fmt::format("{}: no such kernels; known: {}, or a kernel file (.json)", text,
                               known_kernels()));
}

LightMode light_mode_choice_from(const std::string& text) {
  const auto mode = light_mode_from_string(text);
  if (!mode) {
    throw CLI::ValidationError("--light-mode",
                               fmt::format("{}: no such mode; known: proportional, fixed", text));
  }
  return *mode;
}

void warn_of_no_use(const ShadowChoice& choice) {
  if (choice.technique && *choice.technique != ShadowTechnique::layered) {
    const auto no_use = [&](std::string_view option) {
      log_warning("{}: {} shadows have no use for it", option, to_string(*choice.technique));
    };
    if (choice.kernels && (choice.kernel_file || *choice.kernels != KernelSource::automatic)) {
      no_use("--kernels");
    }
    if (choice.light_mode &&
        !(*choice.technique == ShadowTechnique::field && *choice.light_mode == LightMode::fixed)) {
      no_use("--light-mode");
    }
    if (choice.asks_for_proxies) no_use("--proxy");
  }
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

void apply(const ShadowChoice& choice, PlanOptions& plan) {
  plan.technique = choice.technique;
  plan.kernels = choice.kernels;
  plan.light_mode = choice.light_mode;
  plan.proxies = choice.proxies;
  plan.light_rays = choice.light_rays;
  plan.translucency = choice.translucency;
  plan.layers = choice.layers;
  if (choice.cocl) {
    if (choice.kernel_file || (choice.kernels && *choice.kernels != KernelSource::automatic &&
                               *choice.kernels != KernelSource::centroid)) {
      throw CLI::ValidationError("--shadow", "cocl has kernels of its own; leave out --kernels");
    }
    plan.kernels = KernelSource::centroid;
  }
  if (plan.light_mode == LightMode::fixed && plan.kernels == KernelSource::centroid) {
    throw CLI::ValidationError("--light-mode",
                               "fixed needs kernels with a thickness; cocl has none");
  }
}

ImageSize image_size_from(const std::string& option, std::string_view text) {
  const std::size_t cross = text.find('x');
  const auto width = parse_integer(text.substr(0, cross));
  const auto height =
      cross == std::string_view::npos ? std::nullopt : parse_integer(text.substr(cross + 1));
  constexpr std::int64_t kLargest = 16384;
  if (!width || !height || *width < 1 || *height < 1 || *width > kLargest || *height > kLargest)
    throw CLI::ValidationError(option, fmt::format("{}: is not a size such as 640x480", text));
  return {static_cast<int>(*width), static_cast<int>(*height)};
}

CLI::Option* add_camera_name_option(CLI::App& command, std::string& name) {
  return command
      .add_option("--camera-name", name,
                  "Which camera of a file that holds several (Kalibr's camchain, stereo files of "
                  "OpenCV)")
      ->type_name("NAME");
}

void add_pairing_options(CLI::App& command, PairingOptions& pairing) {
  const auto seconds_from = [](const std::string& option, const std::string& text, double least,
                               double most) {
    const auto value = parse_number(text);
    if (!value || !(*value >= least && *value <= most)) {
      throw CLI::ValidationError(
          option, fmt::format("is '{}'; give seconds from {:g} to {:g}", text, least, most));
    }
    return nanoseconds(*value);
  };
  command
      .add_option_function<std::string>(
          "--max-gap",
          [seconds_from, &pairing](const std::string& text) {
            pairing.max_gap_ns = seconds_from("--max-gap", text, 0.0, 1e6);
          },
          "The ground truth is interpolated between two of its poses that are at most this far "
          "apart (0: not at all), and extrapolated by at most 10 ms before its first and after its "
          "last pose")
      ->type_name("SECONDS")
      ->default_str("0.1");
  command
      .add_option_function<std::string>(
          "--time-offset",
          [seconds_from, &pairing](const std::string& text) {
            pairing.time_offset_ns = seconds_from("--time-offset", text, -4e9, 4e9);
          },
          "Added to the estimate's times (in replay: the recording's): positive where its clock is "
          "behind that of the ground truth")
      ->type_name("SECONDS")
      ->default_str("0");
}

void add_tracking_options(CLI::App& command, TrackerOptions& tracking) {
  TrackingMode& mode = tracking.mode;
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
          "fast: a limited number of pixels; accurate: every pixel at an edge, but where motion "
          "blurs them; auto: fast while the view moves, accurate where it rests or few tags are "
          "seen; detect: every frame by detection, the baseline to compare with")
      ->type_name("fast|accurate|auto|detect")
      ->default_str("auto");
  command
      .add_option_function<double>(
          "--pose-budget",
          [&tracking](double px) {
            if (!std::isfinite(px) || !(px > 0.0)) {
              throw CLI::ValidationError("--pose-budget",
                                         fmt::format("is {}; give pixels above 0", px));
            }
            tracking.pose_budget_px = px;
          },
          "Stop sampling pixels where their noise is expected to move the overlay by less than "
          "this; fast never takes more than without it")
      ->type_name("PX");
  command.add_flag_callback(
      "--no-background-search", [&tracking] { tracking.search_timing = SearchTiming::in_frame; },
      "Search for groups of tags that were lost before the frame is done, not beside the tracking "
      "of the next ones: the same poses once they are found, but a frame that waits for it");
}

CLI::Option* add_smooth_option(CLI::App& command, bool& smooth) {
  return command.add_flag(
      "--smooth", smooth,
      "Draw with a smoothed pose: it shakes less where the view rests. Poses that are written stay "
      "as measured; the report and the HUD tell how late the drawn one is");
}

void add_scene_option(CLI::App& command, RunChoice& choice) {
  command.add_option("--scene", choice.scene, "Scene to draw (default: the program's own)")
      ->type_name("FILE.json");
}

void add_window_options(CLI::App& command, RunChoice& choice) {
  command.add_flag("--no-window", choice.no_window, "Offscreen, also where there is a display");
  command.add_flag("--no-hud", choice.no_hud, "The window's HUD is hidden at first (H shows it)");
}

Result<void> complete(const RunChoice& choice, RunRequest& request) {
  if (choice.scene) {
    request.scene = *choice.scene;
  } else {
    PENUMBRA_TRY(const auto resources, find_resources());
    request.scene = resources / "scenes" / "default.json";
  }
  request.kernel_file = choice.shadow.kernel_file;
  request.plan.skip = !choice.no_skip;
  request.window = !choice.no_window;
  request.viewer.hud = !choice.no_hud;
  return {};
}

void add_frame_options(CLI::App& command, RunRequest& request, RunChoice& choice,
                       const std::string& side_by_side) {
  command
      .add_option(
          "--threads", request.threads,
          "1: one stage after another; more: " + side_by_side + ". The results are the same")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str()
      ->type_name("N");
  command.add_flag("--rectified", request.rectified,
                   "The picture without the lens's distortion; the video is resampled");
  std::optional<int>* const msaa = &request.msaa;
  command
      .add_option_function<std::string>(
          "--msaa",
          [msaa](const std::string& text) {
            msaa->reset();
            if (text == "auto") return;
            constexpr std::int64_t kMost = 64;
            const auto samples = text == "off" ? 0 : parse_integer(text);
            if (!samples || *samples < 0 || *samples > kMost) {
              throw CLI::ValidationError(
                  "--msaa", fmt::format("{}: is neither auto, off nor a number of samples", text));
            }
            *msaa = static_cast<int>(*samples);
          },
          "Smooth edges of what is drawn, by so many samples of each pixel; auto: 4 on a GPU, off "
          "where a processor draws, for it pays for each")
      ->type_name("auto|off|N")
      ->default_str("auto");
  std::optional<bool>* const pixel_buffers = &request.pixel_buffers;
  command
      .add_option_function<std::string>(
          "--pixel-buffers",
          [pixel_buffers](const std::string& text) {
            pixel_buffers->reset();
            if (text != "auto") *pixel_buffers = text == "on";
          },
          "Pixels go to the GPU, and pictures that are written come from it, through buffers of "
          "the "
          "driver's, so that nobody waits for the other; auto: on with a GPU, off where a "
          "processor draws. The results are the same")
      ->check(CLI::IsMember({"auto", "on", "off"}))
      ->type_name("auto|on|off")
      ->default_str("auto");
  bool* const video_light = &request.video_light;
  command.add_flag_callback(
      "--no-video-light", [video_light] { *video_light = false; },
      "Light virtual objects as the scene says, whatever light the video shows");
  command.add_flag("--no-skip", choice.no_skip,
                   "Do all work, also what can't be seen or was done for an earlier frame; the "
                   "results are the same");
}

void add_output_options(CLI::App& command, OutputRequest& request) {
  command
      .add_option_function<std::string>(
          "--output",
          [&request](const std::string& path) {
            if (names_standard_output(path)) {
              throw CLI::ValidationError(
                  "--output", fmt::format("{}: is for text, and these are frames; name a video or "
                                          "a folder",
                                          path));
            }
            if (names_unknown_video(path)) {
              throw CLI::ValidationError(
                  "--output", fmt::format("{}: end it in .mkv (FFV1, lossless) or .mp4 (H.264), or "
                                          "name a folder",
                                          path));
            }
            request.output = path;
          },
          "Composited frames: *.mkv (FFV1, lossless), *.mp4 (H.264), or a folder of "
          "000000.png ... numbered by frame, which replace those of an earlier run")
      ->type_name("PATH");
  CLI::Option* poses = command
                           .add_option("--poses", request.poses,
                                       "Tracked poses, as a TUM file; - is standard output")
                           ->type_name("FILE.tum");
  command
      .add_flag("--poses-all", request.poses_all,
                "Uncertain and held poses too, each after a comment that says so")
      ->needs(poses);
  command
      .add_option("--group-poses", request.group_poses,
                  "Where the tags' groups beside the table are (a wall, a prop): NAME.tum of each, "
                  "with T_table_group, which is the identity where tags.yaml has it")
      ->type_name("FOLDER");
  command
      .add_option("--report", request.report, "What was measured, as JSON; - is standard output")
      ->type_name("FILE.json");
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
      // Without a unit, one in which the number makes sense.
      if (!in_range(value) || (!given_symbol.empty() && given.symbol != given_symbol)) continue;
      if (given.symbol == unit.symbol) return fmt::format("{}: {:g}", message, value);
      return fmt::format("{}: {:g} for {:g} {}", message, value, *number, given.symbol);
    }
    return message;
  };
}

void add_unit_option(CLI::App& command, double& unit_m) {
  command
      .add_option_function<std::string>(
          "--unit",
          [&unit_m](const std::string& symbol) {
            const LengthUnit* unit = length_unit_from_string(symbol);
            if (unit == nullptr) {
              throw CLI::ValidationError("--unit",
                                         fmt::format("{}: is none of mm, cm, m and in", symbol));
            }
            unit_m = unit->length_m;
          },
          "Unit of the model's coordinates (default: m)")
      ->type_name("mm|cm|m|in");
}

void claim_outputs(const CLI::App& command, std::initializer_list<const char*> options) {
  const char* first = nullptr;
  for (const char* option : options) {
    if (command.count(option) == 0) continue;
    const std::string& path = command.get_option(option)->results().back();
    if (!names_standard_output(path)) continue;
    if (first != nullptr) {
      throw CLI::ValidationError(
          option, fmt::format("{}: standard output is taken by {}; name a file for one of them",
                              path, first));
    }
    first = option;
  }
  if (first != nullptr) claim_standard_output();
}

void add_common_options(CLI::App& command) {
  command.set_version_flag("--version", fmt::format("penumbra {}", program_version()),
                           "Print the version and exit");
  command
      .add_option_function<std::string>(
          "--log-level",
          [](const std::string& name) {
            if (set_log_level(name)) return;
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
