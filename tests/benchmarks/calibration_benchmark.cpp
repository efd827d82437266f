// Compares our calibration with OpenCV's and mrcal's on the same corners of real photographs in one
// run: CPU time, residuals and held-out error. Prints Markdown.
//
//   calibration_benchmark FOLDER_OF_PHOTOGRAPHS
#include <fmt/format.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <opencv2/core/utility.hpp>
#include <optional>
#include <string>
#include <vector>

#include "app/calibration/image_folder.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/target/target.hpp"
#include "calib/target/target_detector.hpp"
#include "core/camera/camera_file.hpp"
#include "support/opencv_calibration.hpp"
#include "support/recording_folder.hpp"

namespace penumbra {
namespace {

using Views = std::vector<CalibrationView>;
using Calibrate = std::function<std::optional<test::CameraAndBoard>(const Views&)>;

struct Photographs {
  const char* folder;
  int columns;  // number of inner corners
  int rows;
  double square_m;
  bool charuco = false;  // with the first markers of DICT_4X4_50, 3/4 of a square wide
};
constexpr Photographs kSets[] = {{"opencv-chessboard", 9, 6, 0.025},
                                 {"swatbotics/calibration", 7, 5, 0.025},
                                 {"photonvision-calib/squares-lifecam-480", 10, 10, 0.0254},
                                 {"photonvision-calib/squares-gloworm-320x240", 8, 6, 0.0254},
                                 {"photonvision-calib/charuco-lifecam-480", 7, 7, 0.0254, true}};

Target target_of(const Photographs& set) {
  if (!set.charuco) return chessboard_target(set.columns, set.rows, set.square_m).value();
  CharucoBoard board;
  board.columns = set.columns + 1;
  board.rows = set.rows + 1;
  board.square_m = set.square_m;
  board.tag_m = 0.75 * set.square_m;
  board.family = TagFamily::aruco_4x4_50;
  return charuco_target(board).value();
}

// CPU time of this process, or of its finished child processes [ms].
double cpu_ms(int who) {
  rusage usage{};
  getrusage(who, &usage);
  const auto ms = [](const timeval& t) {
    return 1e3 * static_cast<double>(t.tv_sec) + 1e-3 * static_cast<double>(t.tv_usec);
  };
  return ms(usage.ru_utime) + ms(usage.ru_stime);
}

struct Corners {
  int width = 0;
  int height = 0;
  Views views;
};

Corners find_corners(const std::filesystem::path& folder, const Target& target) {
  TargetDetector detector = TargetDetector::create(target).value();
  Corners corners;
  const auto read = for_each_image(folder, [&](const NamedImage& image) -> Result<bool> {
    corners.width = image.luma.width;
    corners.height = image.luma.height;
    const TargetView view = detector.detect(image.luma);
    if (view.problem.empty()) corners.views.push_back({image.name, view.corners});
    return true;
  });
  if (!read) std::fprintf(stderr, "%s\n", read.error().message.c_str());
  return corners;
}

std::optional<test::CameraAndBoard> ours(const Corners& corners, const Target& target,
                                         const Views& views, const SolverOptions& options) {
  const auto solved =
      solve_intrinsics(corners.width, corners.height, target.points, views, options);
  if (!solved) return std::nullopt;
  return test::CameraAndBoard{solved->camera, solved->board, solved->rms_all_px};
}

bool has_mrcal() {
  return std::system("command -v mrcal-calibrate-cameras > /dev/null 2>&1") == 0;
}

// Runs Debian's mrcal as a program, so its time includes the start of the program. mrcal estimates
// the board warp but does not save it, so the held-out error uses a flat board.
std::optional<test::CameraAndBoard> mrcal(const Corners& corners, const Target& target,
                                          const Views& views) {
  const test::TemporaryFolder folder;
  {
    std::ofstream file(folder.path() / "corners.vnl");
    file << "# filename x y level\n";
    for (std::size_t v = 0; v < views.size(); ++v) {
      for (const TargetCorner& corner : views[v].corners)
        file << fmt::format("view-{}.png {} {} 0\n", v, corner.pixel.x(), corner.pixel.y());
    }
  }
  const std::string command = fmt::format(
      "cd '{}' && mrcal-calibrate-cameras --corners-cache corners.vnl --lensmodel "
      "LENSMODEL_OPENCV5 "
      "--focal {} --imagersize {} {} --object-spacing {} --object-width-n {} --object-height-n {} "
      "--outdir . 'view-*.png' > log 2>&1",
      folder.path().string(), corners.width, corners.width, corners.height, target.square_m,
      target.columns, target.rows);
  if (std::system(command.c_str()) != 0) return std::nullopt;
  const auto camera = load_camera(folder.path() / "camera-0.cameramodel");
  if (!camera) return std::nullopt;
  test::CameraAndBoard result{*camera, target.points, 0.0};
  if (const auto errors = pose_only_errors(result.camera, result.board, views))
    result.rms_px = rms_of(*errors);
  return result;
}

std::string number(std::optional<double> value, int digits = 3) {
  return value && std::isfinite(*value) ? fmt::format("{:.{}f}", *value, digits) : "-";
}

bool all_corners_seen(const Corners& corners, const Target& target) {
  return std::all_of(corners.views.begin(), corners.views.end(), [&](const CalibrationView& view) {
    return view.corners.size() == target.points.size();
  });
}

Views all_as_inliers(Views views) {
  for (CalibrationView& view : views) view.outlier.assign(view.corners.size(), false);
  return views;
}

// Runs each calibration on the same corners. `first_ms`: CPU time of the first row, OpenCV's.
void compare_on(const char* whose, const Corners& corners, const Target& target, double& first_ms) {
  const SolverOptions rigid_board;
  SolverOptions free_board;
  free_board.shape = BoardShape::free;
  const auto row = [&](const char* name, const char* board, int who, const Calibrate& calibrate) {
    const double before = cpu_ms(who);
    const auto found = calibrate(corners.views);
    const double ms = cpu_ms(who) - before;
    if (first_ms == 0.0) first_ms = ms;
    std::printf(
        "| %s | %s | %s | %s | %s | %s | %.0f | %.2f |\n", whose, name, board,
        number(found ? std::optional(found->camera.parameters().fx) : std::nullopt, 1).c_str(),
        number(found ? std::optional(found->rms_px) : std::nullopt).c_str(),
        number(test::held_out_px(corners.views, calibrate)).c_str(), ms, ms / first_ms);
    std::fflush(stdout);
  };
  row("OpenCV calibrateCamera", "as in file", RUSAGE_SELF, [&](const Views& views) {
    return test::opencv_calibration(corners.width, corners.height, target.points, views);
  });
  const bool complete = all_corners_seen(corners, target);
  if (complete && has_mrcal()) {
    row("mrcal, OPENCV5", "as in file (warped while solving)", RUSAGE_CHILDREN,
        [&](const Views& views) { return mrcal(corners, target, views); });
  }
  row("penumbra, every corner", "as in file", RUSAGE_SELF, [&](const Views& views) {
    return ours(corners, target, all_as_inliers(views), rigid_board);
  });
  row("penumbra, without outliers", "as in file", RUSAGE_SELF,
      [&](const Views& views) { return ours(corners, target, views, rigid_board); });
  if (complete) {
    row("OpenCV calibrateCameraRO", "solved for", RUSAGE_SELF, [&](const Views& views) {
      return test::opencv_calibration(corners.width, corners.height, target.points, views, true,
                                      target.columns - 1);
    });
  }
  row("penumbra, every corner", "solved for", RUSAGE_SELF,
      [&](const Views& views) { return ours(corners, target, all_as_inliers(views), free_board); });
  row("penumbra, without outliers", "solved for", RUSAGE_SELF,
      [&](const Views& views) { return ours(corners, target, views, free_board); });
}

void compare(const std::filesystem::path& root, const Photographs& set) {
  const std::filesystem::path folder = root / set.folder;
  const Target target = target_of(set);
  const Corners corners = find_corners(folder, target);
  if (corners.views.empty()) return;
  std::printf("**%s**, %zu views of %s%zu corners, %dx%d\n\n", set.folder, corners.views.size(),
              all_corners_seen(corners, target) ? "" : "up to ", target.points.size(),
              corners.width, corners.height);
  std::printf(
      "| corners | calibration | board | fx [px] | RMS [px] | held out [px] | CPU [ms] | / OpenCV "
      "|\n|---|---|---|---|---|---|---|---|\n");
  double first_ms = 0.0;
  compare_on("OpenCV's", corners, target, first_ms);

  // Runs the program on images, as users do: it detects the corners and chooses lens and board
  // model.
  const double before = cpu_ms(RUSAGE_SELF);
  CameraCalibrator calibrator = CameraCalibrator::create(target).value();
  const auto read = for_each_image(folder, [&](const NamedImage& image) -> Result<bool> {
    if (auto added = calibrator.add(image.name, image.luma); !added)
      return tl::unexpected(added.error());
    return true;
  });
  const auto calibration = calibrator.finish();
  const double ms = cpu_ms(RUSAGE_SELF) - before;
  if (read && calibration) {
    Corners detected = corners;
    detected.views.clear();
    for (const CalibrationImage& image : calibration->images) {
      if (image.solved >= 0) detected.views.push_back({image.name, image.view.corners});
    }
    compare_on("penumbra's", detected, target, first_ms);
    const CalibrationSolution& solution = calibration->solution;
    std::string lens;
    SolverOptions chosen;
    chosen.shape = solution.shape;
    for (const ModelTrial& trial : calibration->trials) {
      if (!trial.chosen) continue;
      lens = lens_name(trial);
      chosen.model = trial.model;
      chosen.without_k3 = trial.without_k3;
    }
    // The error covers all corners, as in the other rows; the program's report counts inliers only.
    const auto held_out = test::held_out_px(
        detected.views, [&](const Views& views) { return ours(detected, target, views, chosen); });
    std::printf(
        "| penumbra's | penumbra calibrate (%s; %zu views) | %s | %.1f | %.3f | %s | %.0f | %.2f "
        "|\n",
        lens.c_str(), solution.views.size(), std::string(to_string(solution.shape)).c_str(),
        solution.camera.parameters().fx, solution.rms_all_px, number(held_out).c_str(), ms,
        ms / first_ms);
  }
  std::printf("\n");
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "calibration_benchmark FOLDER_OF_PHOTOGRAPHS\n");
    return 2;
  }
  cv::setNumThreads(1);
  for (const penumbra::Photographs& set : penumbra::kSets) penumbra::compare(argv[1], set);
  return 0;
}
