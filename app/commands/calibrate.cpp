// penumbra calibrate: pictures of a printed target in, camera.yaml and a verdict out.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <ctime>
#include <memory>
#include <optional>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/output/output_file.hpp"
#include "app/picture_source.hpp"
#include "app/progress.hpp"
#include "calib/calibration_report.hpp"
#include "calib/camera_calibration.hpp"
#include "core/camera_file.hpp"

namespace penumbra {
namespace {

std::string today() {
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  localtime_r(&now, &local);
  return fmt::format("{:04}-{:02}-{:02}", local.tm_year + 1900, local.tm_mon + 1, local.tm_mday);
}

struct CalibrateOptions {
  std::filesystem::path source;
  std::filesystem::path target;
  std::filesystem::path output;
  std::filesystem::path report;
  std::filesystem::path compare;
  std::string model = "auto";
  std::string board = "auto";
  std::string format = "auto";
  std::optional<double> focus_position;
  int views = 60;
};

CameraFileFormat format_of(const CalibrateOptions& options) {
  if (options.format == "ros") return CameraFileFormat::ros;
  if (options.format == "opencv") return CameraFileFormat::opencv;
  if (options.format == "kalibr") return CameraFileFormat::kalibr;
  const std::string name = options.output.filename().string();
  if (name.find("camchain") != std::string::npos) return CameraFileFormat::kalibr;
  return options.output.extension() == ".yml" ? CameraFileFormat::opencv : CameraFileFormat::ros;
}

CalibrationOptions calibration_options(const CalibrateOptions& options) {
  CalibrationOptions result;
  if (options.model == "plumb_bob") result.model = DistortionModel::plumb_bob;
  if (options.model == "rational") result.model = DistortionModel::rational;
  if (options.model == "fisheye") result.model = DistortionModel::fisheye;
  if (options.board == "rigid") result.shape = BoardShape::rigid;
  if (options.board == "bowed") result.shape = BoardShape::bowed;
  if (options.board == "free") result.shape = BoardShape::free;
  result.most_views = options.views;
  return result;
}

CalibrationRecord record_of(const CameraCalibration& calibration, const Target& target,
                            const std::string& date, std::optional<double> focus_position) {
  const CalibrationSolution& solution = calibration.solution;
  CalibrationRecord record;
  record.calibrated_on = date;
  record.target = target.description;
  record.views = static_cast<int>(solution.views.size());
  record.rms_px = solution.rms_px;
  record.held_out_px = calibration.held_out_px;
  record.projection_mean_px = calibration.uncertainty.mean_px;
  record.projection_largest_px = calibration.uncertainty.largest_px;
  for (Eigen::Index i = 0; i < solution.covariance.rows(); ++i)
    record.standard_deviations.push_back(std::sqrt(solution.covariance(i, i)));
  record.focus_position = focus_position;
  return record;
}

void print_summary(const CameraCalibration& calibration) {
  for (const CalibrationPicture& picture : calibration.pictures) {
    if (!picture.left_out.empty()) fmt::print("left out: {}: {}\n", picture.name, picture.left_out);
  }
  fmt::print("{:<22}{:<9}{:>13}{:>17}\n", "lens", "board", "residual [px]", "held out [px]");
  for (const ModelTrial& trial : calibration.trials) {
    fmt::print("{:<22}{:<9}{:>13.3f}{:>17}{}\n", to_string(trial.model), to_string(trial.shape),
               trial.rms_px, trial.held_out_px ? fmt::format("{:.3f}", *trial.held_out_px) : "-",
               trial.chosen ? "  chosen" : "");
  }
  const CameraParameters& p = calibration.solution.camera.parameters();
  const Eigen::MatrixXd& covariance = calibration.solution.covariance;
  fmt::print(
      "views: {} of {} pictures, {} corners, {} outliers\n"
      "fx {:.3f} +- {:.3f}  fy {:.3f} +- {:.3f}  cx {:.3f} +- {:.3f}  cy {:.3f} +- {:.3f} px\n",
      calibration.solution.views.size(), calibration.pictures.size(), calibration.solution.corners,
      calibration.solution.outliers, p.fx, std::sqrt(covariance(0, 0)), p.fy,
      std::sqrt(covariance(1, 1)), p.cx, std::sqrt(covariance(2, 2)), p.cy,
      std::sqrt(covariance(3, 3)));
}

Result<ExitCode> run_calibrate(const CalibrateOptions& options) {
  const auto target = load_target(options.target);
  if (!target) return tl::unexpected(target.error());
  std::optional<CameraModel> earlier;
  if (!options.compare.empty()) {
    auto loaded = load_camera(options.compare);
    if (!loaded) return tl::unexpected(loaded.error());
    earlier = std::move(*loaded);
  }
  InterruptWatch interrupt;
  interrupt.hold();
  auto output = OutputFile::create(options.output);
  if (!output) return tl::unexpected(output.error());
  std::optional<OutputFile> report;
  if (!options.report.empty()) {
    auto created = OutputFile::create(options.report);
    if (!created) return tl::unexpected(created.error());
    report.emplace(std::move(*created));
  }

  auto calibrator = CameraCalibrator::create(*target, calibration_options(options));
  if (!calibrator) return fail_in(options.target.string(), calibrator.error());
  bool interrupted = false;
  {
    std::optional<ProgressBar> progress;
    const auto read = for_each_picture(options.source, [&](const Picture& picture) -> Result<bool> {
      if (!progress) progress.emplace(picture.count, "pictures");
      if (picture.luma.empty()) {
        calibrator->add_unreadable(picture.name, picture.unreadable);
      } else if (auto added = calibrator->add(picture.name, picture.luma); !added) {
        return tl::unexpected(added.error());
      }
      progress->update(picture.index + 1);
      interrupted = interrupt.interrupted();
      return !interrupted;
    });
    if (!read) return tl::unexpected(read.error());
  }
  if (interrupted) return fail("{}: ended early; no file was written", options.source.string());
  const auto calibration = calibrator->finish();
  if (!calibration) return fail_in(options.source.string(), calibration.error());
  const CameraModel& camera = calibration->solution.camera;
  if (earlier && (earlier->width() != camera.width() || earlier->height() != camera.height())) {
    return fail(
        "{}: is of {} x {} px, but the pictures are {} x {}; name a calibration of this size",
        options.compare.string(), earlier->width(), earlier->height(), camera.width(),
        camera.height());
  }
  const std::string date = today();
  const CalibrationRecord record = record_of(*calibration, *target, date, options.focus_position);
  if (auto saved = save_camera(output->partial(), camera, format_of(options), &record); !saved)
    return output->failed(saved.error());
  if (report) {
    ReportInput input;
    input.title = options.source.string();
    input.date = date;
    input.target = target->description;
    input.earlier = earlier;
    input.earlier_name = options.compare.string();
    if (auto written = write_text(*report, calibration_report(*calibration, input)); !written)
      return tl::unexpected(written.error());
  }
  if (auto done = output->commit(); !done) return tl::unexpected(done.error());
  print_summary(*calibration);
  if (earlier) {
    const ProjectionDifference difference = projection_difference(camera, *earlier);
    fmt::print("differs from {} by {:.3f} px on average, {:.3f} px at most\n",
               options.compare.string(), difference.mean_px, difference.largest_px);
  }
  fmt::print("camera: {}\n", options.output.string());
  if (report) fmt::print("report: {}\n", options.report.string());
  fmt::print("{}\n", calibration->verdict);
  return ExitCode::success;
}

}  // namespace

void add_calibrate_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "calibrate",
      "Find a camera's lens from pictures of a printed target, and say what it is worth");
  add_common_options(*command);
  const auto options = std::make_shared<CalibrateOptions>();
  command
      ->add_option(
          "source", options->source,
          "A recording, or a folder of PNG or JPEG pictures; a camera.yaml in it is not read")
      ->required()
      ->type_name("SOURCE");
  command
      ->add_option("--target", options->target,
                   "What was printed: a tags.yaml, an aprilgrid.yaml, a chessboard.yaml, or what "
                   "penumbra target wrote")
      ->required()
      ->type_name("FILE");
  command->add_option("--output", options->output, "The camera's file")
      ->required()
      ->type_name("camera.yaml");
  command
      ->add_option("--report", options->report, "What the calibration rests on, as one HTML file")
      ->type_name("report.html");
  command
      ->add_option("--model", options->model,
                   "Lens: plumb_bob, rational, fisheye, or auto: the simplest that explains views "
                   "it has not seen")
      ->check(CLI::IsMember({"auto", "plumb_bob", "rational", "fisheye"}))
      ->capture_default_str();
  command
      ->add_option("--board", options->board,
                   "The target is rigid (as its file says), bowed, free (every corner a little "
                   "elsewhere), or auto")
      ->check(CLI::IsMember({"auto", "rigid", "bowed", "free"}))
      ->capture_default_str();
  command
      ->add_option("--format", options->format,
                   "Of the camera's file: ros, opencv, kalibr, or auto: by its name (*.yml is "
                   "OpenCV's, *camchain* Kalibr's)")
      ->check(CLI::IsMember({"auto", "ros", "opencv", "kalibr"}))
      ->capture_default_str();
  command->add_option("--compare", options->compare, "An earlier calibration to compare with")
      ->type_name("FILE");
  command->add_option("--focus-position", options->focus_position,
                      "Where the lens was focused, as its driver counts: kept in the file");
  command->add_option("--views", options->views, "Most views to solve from")
      ->check(CLI::Range(3, 1000))
      ->capture_default_str();
  command->footer(
      "The last line is the verdict. A camera file is written whatever it says, and none where the "
      "pictures\ncan't fix a camera.\n\n"
      "Example:\n"
      "  penumbra calibrate pictures --target aprilgrid.yaml --output camera.yaml --report "
      "report.html");
  command->callback([options, &chosen] {
    if (same_path(options->output, options->target) ||
        (!options->report.empty() && same_path(options->output, options->report))) {
      throw CLI::ValidationError(
          "--output", fmt::format("{}: is named for something else too; name files of their own",
                                  options->output.string()));
    }
    chosen = [options] { return run_calibrate(*options); };
  });
}

}  // namespace penumbra
