// penumbra calibrate: computes camera.yaml and its assessment from images of a printed target.

#include <fmt/chrono.h>

#include <array>
#include <cmath>
#include <ctime>
#include <fstream>
#include <memory>
#include <mutex>
#include <stop_token>

#include "app/calibration/calibration_capture.hpp"
#include "app/calibration/guide_window.hpp"
#include "app/calibration/image_folder.hpp"
#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/live/live_camera.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/progress.hpp"
#include "app/run_inputs.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/report/calibration_report.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

struct CalibrateOptions {
  std::filesystem::path source;
  std::filesystem::path target;
  std::filesystem::path output;
  std::filesystem::path report;
  std::filesystem::path compare;
  std::string compare_name;  // name of the camera in the file `compare`
  std::string model = "auto";
  std::string board = "auto";
  std::string format = "auto";
  std::optional<double> focus_position;
  int views = 60;
  bool window = true;
  bool is_step = false;    // another command goes on after it
  CameraRequest camera;    // used if the source is a camera
  CaptureOptions capture;  // used if the source is a camera or a recording played as one
};

CameraFileFormat format_of(const CalibrateOptions& options) {
  if (options.format == "ros") return CameraFileFormat::ros;
  if (options.format == "opencv") return CameraFileFormat::opencv;
  if (options.format == "kalibr") return CameraFileFormat::kalibr;
  return output_format_of(options.output);
}

CalibrationOptions calibration_options(const CalibrateOptions& options) {
  CalibrationOptions result;
  for (const DistortionModel model : kDistortionModels) {
    if (options.model == short_name(model)) result.model = model;
  }
  result.shape = value_named(kBoardShapeNames, options.board);
  result.max_views = options.views;
  result.for_kalibr = format_of(options) == CameraFileFormat::kalibr;
  return result;
}

void check_model_of_format(const CalibrateOptions& options) {
  const CameraFileFormat format = format_of(options);
  const std::optional<DistortionModel> model = calibration_options(options).model;
  if (!model || model_name(*model, format)) return;
  std::vector<std::string_view> possible;
  for (const DistortionModel other : kDistortionModels) {
    if (model_name(other, format)) possible.push_back(short_name(other));
  }
  usage_error("--model",
              "{}: {} is written as {}'s file, which has no such lens; name {}, or "
              "--format ros",
              options.model, options.output.string(), to_string(format),
              fmt::join(possible, " or "));
}

void print_summary(const CameraCalibration& calibration) {
  constexpr int kMaxPerReason = 8;
  const auto listed = images_to_report(calibration.images, kMaxPerReason);
  for (std::size_t i = 0; i < listed.size(); ++i) {
    if (!listed[i]) continue;
    const CalibrationImage& image = calibration.images[i];
    const std::string more = *listed[i] > 0 ? fmt::format(" and {} more", *listed[i]) : "";
    fmt::print("rejected: {}{}: {}\n", image.name, more, image.left_out);
  }
  fmt::print("{:<22}{:<9}{:>13}{:>17}\n", "lens", "board", "residual [px]", "held out [px]");
  for (const ModelTrial& trial : calibration.trials) {
    fmt::print("{:<22}{:<9}{:>13.3f}{:>17}{}\n", lens_name(trial), to_string(trial.shape),
               trial.rms_px, trial.held_out_px ? fmt::format("{:.3f}", *trial.held_out_px) : "-",
               trial.chosen             ? "  chosen"
               : trial.non_monotonic_px ? "  non-monotonic in the image"
                                        : "");
  }
  const CameraParameters& p = calibration.solution.camera.parameters();
  const Eigen::MatrixXd& covariance = calibration.solution.covariance;
  fmt::print(
      "views: {} of {} images, {} corners, {} outliers\n"
      "fx {:.3f} +- {:.3f}  fy {:.3f} +- {:.3f}  cx {:.3f} +- {:.3f}  cy {:.3f} +- {:.3f} px\n",
      calibration.solution.views.size(), calibration.images.size(), calibration.solution.corners,
      calibration.solution.outliers, p.fx, std::sqrt(covariance(0, 0)), p.fy,
      std::sqrt(covariance(1, 1)), p.cx, std::sqrt(covariance(2, 2)), p.cy,
      std::sqrt(covariance(3, 3)));
  if (const auto& tone = calibration.tone) {
    fmt::print(
        "camera response (tone_curve): light = grey ^ {:.2f} +- {:.2f}, by the tags' edges in {} "
        "views\n",
        tone->exponent, tone->sigma, tone->images);
  } else {
    fmt::print("camera response (tone_curve): unknown: {}\n", calibration.tone_unknown);
  }
  if (const auto& row_time = calibration.row_time) {
    fmt::print("shutter: the row time is {:.2f} +- {:.2f} us, by the moving target\n",
               row_time->seconds * 1e6, row_time->sigma_s * 1e6);
  }
  if (const auto& table = calibration.table) {
    fmt::print(
        "objects on the table are drawn to {:.2f} px (1 sigma; corners of a 0.2 m cube seen from "
        "{:.2f} m; with poses by another lens: {:.2f} px)\n",
        table->largest_tracked_px(), table->distance_m, table->largest_known_pose_px());
  }
}

// Creates the camera file and, if requested, the report.
Result<std::vector<OutputFile>> create_outputs(const CalibrateOptions& options) {
  std::vector<OutputFile> outputs;
  for (const std::filesystem::path& path : {options.output, options.report}) {
    if (path.empty()) continue;
    PENUMBRA_TRY(auto file, OutputFile::create(path));
    outputs.push_back(std::move(file));
  }
  return outputs;
}

// Fails if the camera to compare with has another image size.
Result<void> check_comparable(const CalibrateOptions& options,
                              const std::optional<CameraModel>& earlier, int width, int height) {
  if (!earlier || (earlier->width() == width && earlier->height() == height)) return {};
  return fail("{}: is of {} x {} px, but the images are {} x {}; name a calibration of this size",
              options.compare.string(), earlier->width(), earlier->height(), width, height);
}

Result<void> read_images(const CalibrateOptions& options, const std::optional<CameraModel>& earlier,
                         InterruptWatch& interrupt, CameraCalibrator& calibrator) {
  const std::filesystem::path& source = options.source;
  std::optional<ProgressBar> progress;
  PENUMBRA_TRY_VOID(for_each_image(source, [&](const NamedImage& image) -> Result<bool> {
    for (const std::string& notice : image.notices) log_warning("{}", notice);
    if (!progress) progress.emplace(image.count, "images");
    if (image.luma.empty()) {
      calibrator.add_unreadable(image.name, image.unreadable);
    } else if (auto same = check_comparable(options, earlier, image.luma.width, image.luma.height);
               !same) {
      return tl::unexpected(same.error());
    } else if (auto added = calibrator.add(image.name, image.luma, image.timestamp_ns); !added) {
      return fail_in(source.string(), added.error());
    }
    progress->update(image.index + 1);
    return !interrupt.interrupted();
  }));
  return {};
}

// Opens a window for images of this size [px]. Returns null with --no-window or if that fails.
std::unique_ptr<GuideWindow> window_for(const CalibrateOptions& options, int width, int height) {
  if (!options.window) return nullptr;
  std::string why = "no display";
  if (display_available()) {
    auto window = GuideWindow::open(width, height);
    if (window) return std::move(*window);
    why = window.error().message;
  }
  fmt::print("{}; going on without a window\n", why);
  std::fflush(stdout);
  return nullptr;
}

// Returns the size of the first readable image.
Result<ImageSize> first_image_size(const std::filesystem::path& recording) {
  std::optional<ImageSize> size;
  PENUMBRA_TRY_VOID(for_each_image(recording, [&](const NamedImage& image) -> Result<bool> {
    if (!image.luma.empty()) size = ImageSize{image.luma.width, image.luma.height};
    return !size;
  }));
  if (!size) {
    return fail("{}: none of its images can be read; give PNG or JPEG images of the target",
                recording.string());
  }
  return *size;
}

struct GuidedCapture {
  Capture capture;
  std::unique_ptr<GuideWindow> window;  // null without a window
};

Result<GuidedCapture> guide(const CalibrateOptions& options, const Target& target,
                            const std::optional<CameraModel>& earlier, InterruptWatch& interrupt,
                            CameraCalibrator& calibrator) {
  CaptureOptions capture = options.capture;
  capture.guide.model = calibration_options(options).model;
  capture.guide.for_kalibr = calibration_options(options).for_kalibr;
  const auto recording = played_recording(options.source.string());
  std::unique_ptr<LiveSource> camera;
  ImageSize size;
  if (recording) {
    PENUMBRA_TRY(size, first_image_size(*recording));
    // The gain of the final view of a full set, because sigma falls as 1 / sqrt(views).
    capture.guide.min_gain = 0.5 / options.views;
  } else {
    PENUMBRA_TRY(camera, open_live_source(options.camera));
    size = {camera->format().width, camera->format().height};
  }
  PENUMBRA_TRY_VOID(check_comparable(options, earlier, size.width, size.height));
  if (options.capture.keep) PENUMBRA_TRY_VOID(create_keep_folder(*options.capture.keep));
  GuidedCapture guided;
  guided.window = window_for(options, size.width, size.height);
  GuideWindow* window = guided.window.get();
  const CaptureSource source = camera ? CaptureSource(camera.get()) : CaptureSource(*recording);
  PENUMBRA_TRY(auto captured,
               capture_views(source, target, capture, interrupt, calibrator, window));
  constexpr int kMinViews = 3;
  if (captured.views < kMinViews) {
    const std::string why = captured.rejection_reason.empty()
                                ? ""
                                : fmt::format(" (most often: {})", captured.rejection_reason);
    const std::string counts = fmt::format(
        "{}: {} of {} image{} {} taken", options.source.string(), captured.views, captured.images,
        captured.images == 1 ? "" : "s", captured.views == 1 ? "was" : "were");
    if (captured.views == 0 && !captured.target_differences.empty())
      return fail("{}; {}", counts, fmt::join(captured.target_differences, "; "));
    return fail(
        "{}{}, and a camera needs at least {} views; show the whole target, sharp and still, "
        "tilted in several directions",
        counts, why, kMinViews);
  }
  if (captured.end == CaptureEnd::interrupted) {
    fmt::print("solving from {} views; Ctrl-C again ends it without a camera file\n",
               captured.views);
    std::fflush(stdout);
  }
  guided.capture = std::move(captured);
  return guided;
}

Result<CameraCalibration> solve_with_progress(GuideWindow* window, InterruptWatch& interrupt,
                                              CameraCalibrator& calibrator) {
  std::mutex mutex;
  SolvingStep latest;  // guarded by mutex
  ProgressBar progress(1);
  int shown = -1;
  return run_stoppable(
      interrupt,
      [&](std::stop_token stop) {
        return calibrator.finish(std::move(stop), [&](const SolvingStep& step) {
          const std::lock_guard lock(mutex);
          latest = step;
        });
      },
      [&] {
        const SolvingStep step = [&] {
          const std::lock_guard lock(mutex);
          return latest;
        }();
        if (step.step > 0) progress.update("solving: " + step.what, step.step, step.max_step);
        if (window == nullptr || window->closed()) return;
        if (step.step != shown) {
          shown = step.step;
          window->say(step.step == 0
                          ? "solving"
                          : fmt::format("solving, {} %: {}", 100 * (step.step - 1) / step.max_step,
                                        step.what));
        }
        window->refresh();
      });
}

tl::unexpected<Error> ended_early(const CalibrateOptions& options) {
  const std::string kept =
      options.capture.keep ? fmt::format("; the views are in {}", options.capture.keep->string())
                           : "";
  return fail("{}: ended early; no file was written{}", options.source.string(), kept);
}

Result<void> write_calibration(const CalibrateOptions& options, std::vector<OutputFile>& outputs,
                               const Target& target, const CameraCalibration& calibration,
                               const std::optional<CameraModel>& earlier) {
  const CameraModel& camera = calibration.solution.camera;
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  const std::string date = fmt::format("{:%Y-%m-%d}", *localtime_r(&now, &local));
  const CalibrationRecord record = record_of(calibration, target, date, options.focus_position);
  if (auto saved = save_camera(outputs[0].partial(), camera, format_of(options), &record); !saved)
    return outputs[0].failed(saved.error());
  if (!options.report.empty()) {
    ReportInput input;
    input.title = options.source.string();
    input.date = date;
    input.target = target.description;
    if (target.kind == TargetKind::chessboard)
      input.target += " (does not show whether the images are mirrored)";
    input.earlier = earlier;
    input.earlier_name = options.compare.string();
    PENUMBRA_TRY_VOID(write_whole(outputs[1], calibration_report(calibration, input)));
  }
  std::vector<OutputFile*> files;
  for (OutputFile& file : outputs) files.push_back(&file);
  return commit_together(files);
}

void print_result(const CalibrateOptions& options, const Target& target,
                  const CameraCalibration& calibration, const std::optional<CameraModel>& earlier) {
  print_summary(calibration);
  if (target.kind == TargetKind::chessboard) {
    log_info("a chessboard can't show whether images are mirrored; targets with tags can");
  }
  if (earlier) {
    const ProjectionDifference difference =
        projection_difference(calibration.solution.camera, *earlier);
    fmt::print("differs from {} by {:.3f} px on average, {:.3f} px at most{}\n",
               options.compare.string(), difference.mean_px, difference.largest_px,
               difference.skipped > 0.0 ? fmt::format("; {:.1f} % of the image is not compared, "
                                                      "because one of the lenses does not reach it",
                                                      100.0 * difference.skipped)
                                        : "");
  }
  const CameraFileFormat format = format_of(options);
  fmt::print("camera: {}{}\n", options.output.string(),
             format == CameraFileFormat::ros ? std::string()
                                             : fmt::format(" ({}'s format)", to_string(format)));
  if (!options.report.empty()) fmt::print("report: {}\n", options.report.string());
  fmt::print("{}\n", calibration.verdict);
  std::fflush(stdout);
}

// Fails if `target` is the PDF to print, not its description. Pipes, readable only once, pass.
Result<void> check_is_no_sheet(const std::filesystem::path& target) {
  if (is_stream(target)) return {};
  std::ifstream file(target, std::ios::binary);
  std::array<char, 4> start{};
  file.read(start.data(), start.size());
  if (std::string_view(start.data(), start.size()) != "%PDF") return {};
  return fail(
      "{}: is a sheet to print; give the target.yaml or tags.yaml that penumbra target wrote "
      "beside it",
      target.string());
}

// Returns false if the user interrupted it after the camera file was written.
Result<bool> run_calibrate(const CalibrateOptions& options) {
  InterruptWatch interrupt;  // must precede the threads of window and camera
  PENUMBRA_TRY_VOID(check_is_no_sheet(options.target));
  PENUMBRA_TRY(const auto target, load_target(options.target));
  std::optional<CameraModel> earlier;
  if (!options.compare.empty()) {
    PENUMBRA_TRY(earlier, load_chosen_camera(options.compare, options.compare_name));
  }
  interrupt.hold();
  PENUMBRA_TRY(auto outputs, create_outputs(options));
  auto calibrator = CameraCalibrator::create(target, calibration_options(options));
  if (!calibrator) return fail_in(options.target.string(), calibrator.error());

  std::unique_ptr<GuideWindow> window;
  bool show_verdict = false;  // the window stays open with the verdict until a key is pressed
  if (names_camera(options.source.string())) {
    PENUMBRA_TRY(auto guided, guide(options, target, earlier, interrupt, *calibrator));
    window = std::move(guided.window);
    const CaptureEnd end = guided.capture.end;
    show_verdict = window && end != CaptureEnd::closed && end != CaptureEnd::interrupted &&
                   !options.capture.duration_s;
  } else {
    PENUMBRA_TRY_VOID(read_images(options, earlier, interrupt, *calibrator));
  }
  if (interrupt.interrupted()) return ended_early(options);
  const auto calibration = solve_with_progress(window.get(), interrupt, *calibrator);
  if (interrupt.interrupted()) return ended_early(options);
  const Result<void> written =
      calibration ? write_calibration(options, outputs, target, *calibration, earlier)
                  : fail_in(options.source.string(), calibration.error());
  if (written) print_result(options, target, *calibration, earlier);
  if (show_verdict) {
    if (written) {
      window->say(calibration->verdict, calibration->grade);
    } else {
      window->say(written.error().message, std::nullopt, true);
    }
    window->wait(interrupt, options.is_step && written ? "to go on" : "to end");
  }
  if (!written) return tl::unexpected(written.error());
  if (window && window->display_lost()) {
    return fail(
        "the connection to the display was lost; {} is solved from the views taken until then; run "
        "with --no-window where the display may go away",
        options.output.string());
  }
  return !interrupt.interrupted();
}

}  // namespace

Result<bool> calibrate_camera(const CameraRequest& camera, const CalibrationFiles& files,
                              bool window) {
  CalibrateOptions options;
  options.source = camera.source;
  options.camera = camera;
  options.target = files.target;
  options.output = files.camera;
  options.report = files.report;
  options.window = window;
  options.is_step = true;
  return run_calibrate(options);
}

namespace {

void check_options(CLI::App& command, CalibrateOptions& options) {
  claim_outputs(command, {"--output", "--report"});
  const std::array outputs = {options.output, options.report};
  const std::array inputs = {options.source, options.target, options.compare};
  if (const auto once = check_written_once(outputs, inputs); !once)
    usage_error("--output", "{}", once.error().message);
  options.camera.source = options.source.string();
  const auto reject = [&command](std::initializer_list<const char*> names, const char* why) {
    for (const char* name : names) {
      if (command.count(name) > 0) usage_error(name, "is for a camera; {}", why);
    }
  };
  if (played_recording(options.camera.source)) {
    reject({"--size", "--fps"}, "a recording has its own");
  } else if (!names_camera(options.camera.source)) {
    reject({"--size", "--fps", "--duration", "--keep"}, "the source is a folder");
  }
  check_camera_output("--output", options.output);
  check_model_of_format(options);
}

}  // namespace

void add_calibrate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command =
      add_command(program, "calibrate",
                  "Calibrate a camera from images of a printed target, and judge the result",
                  "The last line is the verdict. The camera file is written for each verdict, but "
                  "not if the images do not determine a camera.\n"
                  "A chessboard looks the same in a mirror, and its lens would be mirrored too: "
                  "check that text in the images reads the right way, or calibrate with tags.\n"
                  "\n"
                  "Example:\n"
                  "  penumbra calibrate pictures --target aprilgrid.yaml --output camera.yaml "
                  "--report report.html\n"
                  "  penumbra calibrate v4l2:/dev/video0 --target target.yaml --output camera.yaml "
                  "--keep views");
  const auto options = std::make_shared<CalibrateOptions>();
  add_option(command, "SOURCE", "FOLDER|VIDEO|CAMERA", options->source,
             "A recording, a folder of images, a video file, or a camera as in penumbra live")
      ->required();
  add_option(command, "--target", "FILE", options->target,
             "Target: tags.yaml, aprilgrid.yaml, chessboard.yaml, or as penumbra target wrote")
      ->required();
  add_option(command, "--output", "camera.yaml", options->output, "The camera's file")->required();
  add_option(command, "--report", "report.html", options->report,
             "Report of the calibration, as one HTML file");
  start_group(command, "Solving");
  std::vector<std::string> models;
  for (const DistortionModel model : kDistortionModels) models.emplace_back(short_name(model));
  const std::string model_help = fmt::format(
      "Lens model: {}, or auto: the simplest that predicts the views", fmt::join(models, ", "));
  models.insert(models.begin(), "auto");
  add_option(command, "--model", "MODEL", options->model, model_help)
      ->check(CLI::IsMember(models).description(""))
      ->capture_default_str();
  add_option(
      command, "--board", "SHAPE", options->board,
      "Shape of the target: rigid (as in its file), bowed, free (an offset per corner), auto")
      ->check(CLI::IsMember({"auto", "rigid", "bowed", "free"}).description(""))
      ->capture_default_str();
  add_choice_option(
      command, "--format", {"auto", "ros", "opencv", "kalibr"}, options->format,
      "Format of the camera file; auto: of the file that it replaces, else by its name")
      ->capture_default_str();
  CLI::Option* compare = add_option(command, "--compare", "FILE", options->compare,
                                    "An earlier calibration to compare with");
  add_camera_name_option(command, options->compare_name)
      ->description("Camera in the file of --compare, if it has several")
      ->needs(compare);
  add_option(command, "--focus-position", "N", options->focus_position,
             "Focus position of the lens in the driver's units, stored in the file")
      ->check(any_number());
  add_option(command, "--views", "N", options->views, "Maximum number of views to solve from")
      ->check(in_range(3, 1000))
      ->capture_default_str();
  start_group(command, "Camera");
  add_option(command, "--keep", "FOLDER", options->capture.keep,
             "A new folder for the views taken from a camera or recording:FOLDER (PNG)");
  add_off_flag(command, "--no-window", options->window,
               "Guide on the terminal, even if there is a display");
  add_size_option(command, "WxH", options->camera.width, options->camera.height,
                  "Size of a camera's images");
  add_option(command, "--fps", "RATE", options->camera.fps, "Frame rate of a camera")
      ->check(in_range(0.1, 1000.0));
  add_option(command, "--duration", "SECONDS", options->capture.duration_s,
             "Time to take views from a camera (default: until there are enough)")
      ->check(in_range(0.1, 1e6));
  put_first(command, {"--model", "--compare", "--camera-name"});
  command.callback([options, &command, &chosen] {
    check_options(command, *options);
    chosen = [options]() -> Result<ExitCode> {
      PENUMBRA_TRY_VOID(run_calibrate(*options));
      return ExitCode::success;
    };
  });
}

}  // namespace penumbra
