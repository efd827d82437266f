// penumbra setup: from a sheet to print to a checked calibration, in one guided run.

#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <iostream>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "app/commands/configuration.hpp"
#include "app/commands/options.hpp"
#include "app/live/live_run.hpp"
#include "app/output/output_file.hpp"
#include "calib/target/target_sheet.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr double kRulerMm = 100.0;    // nominal length of the ruler on the sheet
constexpr double kMinRulerMm = 50.0;  // shorter or longer: a wrong measurement
constexpr double kMaxRulerMm = 200.0;
constexpr double kCheck_s = 3.0;           // length of the session that checks the result
constexpr double kMinTrackedShare = 0.75;  // of its frames

struct SetupOptions {
  std::filesystem::path folder;
  std::filesystem::path config;  // empty: the user's
  CameraRequest camera;
  std::string page = "a4";
  std::optional<double> measured_mm;
  bool window = true;
};

std::filesystem::path in_folder(const SetupOptions& options, const char* name) {
  return options.folder / name;
}

bool is_present(const std::filesystem::path& file) {
  std::error_code ignored;
  return std::filesystem::exists(file, ignored);
}

// Prints a question and returns the answer; "" for Enter alone. Returns nullopt at the end of
// standard input.
std::optional<std::string> ask(const std::string& question) {
  fmt::print("{} ", question);
  std::fflush(stdout);
  std::string answer;
  const bool answered = static_cast<bool>(std::getline(std::cin, answer));
  if (isatty(STDIN_FILENO) == 0) fmt::print("\n");
  if (!answered) return std::nullopt;
  return std::string(trim(answer));
}

// Returns the text in quotes if a shell would split or expand it.
std::string in_shell(const std::string& text) {
  constexpr std::string_view kPlain = "/.:_-+@%,=";
  const bool plain = !text.empty() && std::ranges::all_of(text, [&](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || kPlain.find(c) != kPlain.npos;
  });
  if (plain) return text;
  std::string quoted = "'";
  for (const char c : text) quoted += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return quoted + "'";
}

Result<double> ask_for_ruler() {
  bool wrong = false;
  while (true) {
    auto answer = ask("Length of the ruler on the paper in mm (Enter: 100):");
    if (!answer && wrong) return fail("the ruler's length was not given; give it with --measured");
    if (!answer || answer->empty()) return kRulerMm;
    std::ranges::replace(*answer, ',', '.');  // a decimal comma
    const auto length = parse_number(*answer);
    if (length && *length >= kMinRulerMm && *length <= kMaxRulerMm) return *length;
    fmt::print("{}: give a number from {:g} to {:g}\n", *answer, kMinRulerMm, kMaxRulerMm);
    wrong = true;
  }
}

Result<void> write_sheet_file(const SetupOptions& options) {
  PENUMBRA_TRY(const PageSize page, page_size_from_string(options.page));
  PENUMBRA_TRY(auto sheet, OutputFile::create(in_folder(options, "sheet.pdf")));
  if (const auto written = write_sheet(sheet.partial(), TagBoard{}, page); !written)
    return sheet.failed(written.error());
  return sheet.commit();
}

Result<void> write_tags_file(const SetupOptions& options, double measured_mm) {
  PENUMBRA_TRY(auto tags, OutputFile::create(in_folder(options, "tags.yaml")));
  if (const auto saved = save_target(tags.partial(), TagBoard{}, measured_mm / kRulerMm); !saved)
    return tags.failed(saved.error());
  return tags.commit();
}

// Step 1. Keeps the tag map of an earlier run, unless the ruler is measured again. Without one, a
// sheet that exists was written by a run that ended at the question.
Result<void> make_sheet(const SetupOptions& options) {
  const auto tags = in_folder(options, "tags.yaml");
  const auto sheet = in_folder(options, "sheet.pdf");
  if (is_present(tags)) {
    const auto scale = printed_scale_of(tags, TagBoard{});
    if (!options.measured_mm) {
      PENUMBRA_TRY_VOID(load_tag_map(tags));
      fmt::print("  {}: used as it is{}\n", tags.string(),
                 scale ? fmt::format(" (ruler: {:g} mm; --measured corrects it)", kRulerMm * *scale)
                       : std::string());
      return {};
    }
    if (!scale) {
      return fail(
          "{}: is not of the sheet that setup prints, so its scale can't be corrected; name "
          "another folder",
          tags.string());
    }
  } else if (is_present(sheet)) {
    fmt::print("  {}: exists, and is taken for the sheet of an earlier run\n", sheet.string());
  } else {
    PENUMBRA_TRY_VOID(write_sheet_file(options));
    fmt::print("  {}: print it at 100 %, glue it flat on card, and lay it on the table\n",
               sheet.string());
  }
  double measured_mm = options.measured_mm.value_or(kRulerMm);
  if (!options.measured_mm) {
    PENUMBRA_TRY(measured_mm, ask_for_ruler());
  }
  PENUMBRA_TRY_VOID(write_tags_file(options, measured_mm));
  fmt::print("  {}: tags of {:.2f} mm\n", tags.string(),
             1e3 * TagBoard{}.tag_size_m * measured_mm / kRulerMm);
  return {};
}

// Returns the command that goes on with the files of this run.
std::string this_command(const SetupOptions& options) {
  std::string text = "penumbra setup " + in_shell(options.folder.string()) + " --camera " +
                     in_shell(options.camera.source);
  if (options.camera.width && options.camera.height)
    text += fmt::format(" --size {}x{}", *options.camera.width, *options.camera.height);
  if (options.camera.fps) text += fmt::format(" --fps {:g}", *options.camera.fps);
  if (!options.window) text += " --no-window";
  if (!options.config.empty()) text += " --config " + in_shell(options.config.string());
  return text;
}

// Step 2. Returns false if the user interrupted it.
Result<bool> calibrate_lens(const SetupOptions& options) {
  const auto camera = in_folder(options, "camera.yaml");
  if (is_present(camera)) {
    std::optional<std::string> answer;
    do {
      answer = ask(fmt::format("  {} exists. Calibrate again? (y, Enter: no)", camera.string()));
      if (answer) answer = in_lower_case(*answer);
    } while (answer && !answer->empty() && *answer != "y" && *answer != "yes" && *answer != "n" &&
             *answer != "no");
    if (!answer || answer->empty() || answer->front() == 'n') return true;
  }
  fmt::print(
      "  Move the camera over the sheet as the {} shows, until the lens is known. Ctrl-C solves "
      "from the views taken so far.\n",
      options.window && display_available() ? "window" : "terminal");
  std::fflush(stdout);
  CalibrationFiles files;
  files.target = in_folder(options, "tags.yaml");
  files.camera = camera;
  files.report = in_folder(options, "calibration.html");
  return calibrate_camera(options.camera, files, options.window);
}

// Step 3. Returns false if the user interrupted it.
Result<bool> check(const SetupOptions& options) {
  fmt::print("  Hold the camera over the sheet for {:g} s and move it slowly.\n", kCheck_s);
  std::fflush(stdout);
  LiveRequest request;
  request.camera = options.camera;
  request.camera.width.reset();  // as calibrated
  request.camera.height.reset();
  request.camera.calibration = in_folder(options, "camera.yaml");
  request.tags = in_folder(options, "tags.yaml");
  request.window = options.window;
  request.duration_s = kCheck_s;
  PENUMBRA_TRY_VOID(complete(request));
  PENUMBRA_TRY(const auto report, run_live(request));
  if (report.failure) return tl::unexpected(*report.failure);
  if (report.interrupted || report.calibrates) return false;
  const double share = static_cast<double>(report.frames_tracked) / std::max(report.frames, 1);
  fmt::print("  tracked in {} of {} frames", report.frames_tracked, report.frames);
  if (report.tags_measured) {
    fmt::print("; residual {:.2f} px, predicted error {:.2f} px (medians)",
               report.reprojection_rms_px.median, report.expected_overlay_px.median);
  }
  fmt::print("\n");
  if (share < kMinTrackedShare) {
    return fail(
        "too few frames are tracked{}, so no configuration is written; show the whole sheet in "
        "good light, check that {} is of this sheet, and go on with: {}",
        report.reasons.empty()
            ? std::string()
            : fmt::format(" (most often: {})", text_of(report.reasons.front().first)),
        request.tags.string(), this_command(options));
  }
  if (report.systematic_error) {
    fmt::print("  The warning above names what would make it more accurate.\n");
  } else {
    fmt::print("  Good.\n");
  }
  return true;
}

// Returns a path for the configuration. Fails if YAML can't hold it.
Result<std::string> in_yaml(const std::string& path) {
  if (as_printable_line(path) != path) {
    return fail("{}: has characters that a configuration can't hold; rename it", path);
  }
  return in_quotes(path);
}

// Step 4. Never replaces a configuration.
Result<void> write_configuration(const SetupOptions& options) {
  std::error_code ignored;
  const auto absolute = [&](const std::filesystem::path& path) {
    return std::filesystem::absolute(path, ignored).string();
  };
  const auto played = played_recording(options.camera.source);
  PENUMBRA_TRY(const std::string camera,
               in_yaml(played ? "recording:" + absolute(*played) : options.camera.source));
  PENUMBRA_TRY(const std::string lens, in_yaml(absolute(in_folder(options, "camera.yaml"))));
  PENUMBRA_TRY(const std::string tags, in_yaml(absolute(in_folder(options, "tags.yaml"))));
  std::string text =
      fmt::format("live:\n  camera: {}\n  calibration: {}\n  tags: {}\n", camera, lens, tags);
  if (options.camera.fps) text += fmt::format("  fps: {:g}\n", *options.camera.fps);
  const auto file = options.config.empty() ? configuration_file() : std::optional(options.config);
  const std::string command = fmt::format("penumbra live --camera {} --calibration {} --tags {}",
                                          in_shell(options.camera.source),
                                          in_shell(in_folder(options, "camera.yaml").string()),
                                          in_shell(in_folder(options, "tags.yaml").string()));
  if (!file) {
    fmt::print("  There is no home folder for it. Start with: {}\n", command);
    return {};
  }
  if (is_present(*file)) {
    const auto present = read_text_file(*file, 1 << 20);
    if (present && *present == text) {
      fmt::print("  {}: has these options already. Start with: penumbra live\n", file->string());
    } else {
      fmt::print("  {}: stays as it is. Start with: {}\n  or write this into it:\n{}",
                 file->string(), command, text);
    }
    return {};
  }
  std::filesystem::create_directories(file->parent_path(), ignored);
  PENUMBRA_TRY(auto output, OutputFile::create(*file));
  PENUMBRA_TRY_VOID(write_text(output, text));
  fmt::print("  {}: written. Start with: penumbra live{}\n", file->string(),
             options.config.empty() ? std::string() : " --config " + in_shell(file->string()));
  return {};
}

// Fails if a step would replace or read something that no earlier run wrote.
Result<void> check_files(const SetupOptions& options) {
  if (is_present(in_folder(options, "calibration.html")) &&
      !is_present(in_folder(options, "camera.yaml"))) {
    return fail("{}: exists, but no camera.yaml beside it; name another folder",
                in_folder(options, "calibration.html").string());
  }
  std::error_code ignored;
  if (!options.config.empty() && std::filesystem::exists(options.config, ignored) &&
      !std::filesystem::is_regular_file(options.config, ignored)) {
    return fail("{}: is not a regular file; name a file for the configuration (--config)",
                options.config.string());
  }
  return {};
}

Result<ExitCode> ended_early(const SetupOptions& options) {
  fmt::print("ended before the configuration was written; go on with: {}\n", this_command(options));
  return ExitCode::success;
}

Result<ExitCode> set_up(const SetupOptions& options) {
  PENUMBRA_TRY_VOID(check_files(options));
  {
    // The camera is opened before anything is printed on paper.
    PENUMBRA_TRY(const auto camera, open_live_source(options.camera));
    fmt::print("camera: {}\n", camera->description());
  }
  std::error_code error;
  std::filesystem::create_directories(options.folder, error);
  if (error) return fail("{}: can't be created ({})", options.folder.string(), error.message());
  fmt::print("1 of 4: the sheet\n");
  PENUMBRA_TRY_VOID(make_sheet(options));
  fmt::print("2 of 4: the lens\n");
  PENUMBRA_TRY(const bool calibrated, calibrate_lens(options));
  if (!calibrated) return ended_early(options);
  fmt::print("3 of 4: a check\n");
  PENUMBRA_TRY(const bool checked, check(options));
  if (!checked) return ended_early(options);
  fmt::print("4 of 4: the configuration\n");
  PENUMBRA_TRY_VOID(write_configuration(options));
  return ExitCode::success;
}

}  // namespace

void add_setup_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "setup", "From a sheet to print to a calibrated camera, in one guided run",
      "Writes FOLDER/sheet.pdf and tags.yaml, takes views and calibrates the camera with the sheet "
      "(camera.yaml, calibration.html), checks that the sheet is tracked, and writes the "
      "configuration of penumbra live. A second run goes on with the files that exist.\n\n"
      "Example:\n"
      "  penumbra setup table --camera v4l2:/dev/video0");
  const auto options = std::make_shared<SetupOptions>();
  add_option(command, "FOLDER", "FOLDER", options->folder, "Folder for the files")->required();
  add_option(command, "--camera", "CAMERA", options->camera.source,
             "v4l2:DEVICE, libcamera:NUMBER, libcamera:NAME, or recording:FOLDER")
      ->capture_default_str();
  add_option(command, "--page", "PAGE", options->page,
             "Paper: a0 to a5, letter, legal, tabloid, or WIDTHxHEIGHT [mm]")
      ->capture_default_str();
  add_option(command, "--measured", "MM", options->measured_mm,
             "Measured length of the sheet's 100 mm ruler (default: asked)")
      ->check(length_check("mm", kMinRulerMm, kMaxRulerMm));
  add_size_option(command, "WxH", options->camera.width, options->camera.height,
                  "Size of the camera's images");
  add_fps_option(command, options->camera.fps);
  add_off_flag(command, "--no-window", options->window,
               "Guide on the terminal, even if there is a display");
  add_option(command, "--config", "FILE.yaml", options->config,
             "Configuration to write (default: penumbra/config.yaml in ~/.config)");
  command.callback([options, &chosen] {
    check_camera_source(options->camera.source);
    if (options->config == "-") usage_error("--config", "name a file, which live can read later");
    const auto page = page_size_from_string(options->page);
    if (!page) usage_error("--page", "{}", page.error().message);
    if (const auto fits = check_fits(TagBoard{}, *page); !fits)
      usage_error("--page", "{}", fits.error().message);
    chosen = [options] { return set_up(*options); };
  });
}

}  // namespace penumbra
