// OpenCV's calibration on the same corners, for comparisons.
#pragma once

#include <Eigen/Core>
#include <opencv2/calib3d.hpp>
#include <optional>
#include <vector>

#include "calib/solver/intrinsics_solver.hpp"
#include "core/camera/camera_model.hpp"

namespace penumbra::test {

// Result of a calibration: camera and target.
struct CameraAndBoard {
  CameraModel camera;
  std::vector<Eigen::Vector3d> board;
  double rms_px = 0.0;  // RMS of the 2-D distance over all given corners
};

// Runs calibrateCamera with k1 k2 p1 p2 k3. With `release` it runs calibrateCameraRO, which also
// solves for the board and keeps `fixed_point`. Every view must contain every point. Returns
// nullopt if OpenCV fails.
inline std::optional<CameraAndBoard> opencv_calibration(int width, int height,
                                                        const std::vector<Eigen::Vector3d>& board,
                                                        const std::vector<CalibrationView>& views,
                                                        bool release = false, int fixed_point = 0) {
  std::vector<std::vector<cv::Point3f>> points;
  std::vector<std::vector<cv::Point2f>> pixels;
  for (const CalibrationView& view : views) {
    auto& p = points.emplace_back();
    auto& q = pixels.emplace_back();
    for (const TargetCorner& corner : view.corners) {
      const Eigen::Vector3f at = board[static_cast<std::size_t>(corner.point)].cast<float>();
      p.emplace_back(at.x(), at.y(), at.z());
      q.emplace_back(static_cast<float>(corner.pixel.x()), static_cast<float>(corner.pixel.y()));
    }
  }
  cv::Mat K;
  cv::Mat k;
  std::vector<cv::Mat> rvecs;
  std::vector<cv::Mat> tvecs;
  std::vector<cv::Point3f> solved_board;
  CameraAndBoard result;
  try {
    result.rms_px = release
                        ? cv::calibrateCameraRO(points, pixels, {width, height}, fixed_point, K, k,
                                                rvecs, tvecs, solved_board)
                        : cv::calibrateCamera(points, pixels, {width, height}, K, k, rvecs, tvecs);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = K.at<double>(0, 0);
  p.fy = K.at<double>(1, 1);
  p.cx = K.at<double>(0, 2);
  p.cy = K.at<double>(1, 2);
  for (int i = 0; i < 5; ++i) p.distortion[static_cast<std::size_t>(i)] = k.at<double>(i);
  const Result<CameraModel> camera = CameraModel::make(p);
  if (!camera) return std::nullopt;
  result.camera = *camera;
  result.board = board;
  for (std::size_t i = 0; i < solved_board.size() && i < board.size(); ++i)
    result.board[i] = {solved_board[i].x, solved_board[i].y, solved_board[i].z};
  return result;
}

// `held` true: returns the views whose index modulo `folds` is `fold`; false: the remaining views.
inline std::vector<CalibrationView> views_of_fold(const std::vector<CalibrationView>& views,
                                                  std::size_t fold, std::size_t folds, bool held) {
  std::vector<CalibrationView> chosen;
  for (std::size_t v = 0; v < views.size(); ++v) {
    if ((v % folds == fold) == held) chosen.push_back(views[v]);
  }
  return chosen;
}

// Returns the RMS reprojection error of the corners in held-out views [px]. Each fifth of the views
// is withheld in turn from `calibrate` (views -> optional<CameraAndBoard>); only the poses of the
// withheld views are fitted.
template <class Calibrate>
std::optional<double> held_out_px(const std::vector<CalibrationView>& views,
                                  const Calibrate& calibrate) {
  constexpr std::size_t kFolds = 5;
  double sum = 0.0;
  double count = 0.0;
  for (std::size_t fold = 0; fold < kFolds; ++fold) {
    const std::optional<CameraAndBoard> found =
        calibrate(views_of_fold(views, fold, kFolds, false));
    if (!found) return std::nullopt;
    const auto held_views = views_of_fold(views, fold, kFolds, true);
    const auto errors = pose_only_errors(found->camera, found->board, held_views);
    if (!errors || !std::isfinite(rms_of(*errors))) return std::nullopt;
    double corners = 0.0;
    for (const CalibrationView& view : held_views)
      corners += static_cast<double>(view.corners.size());
    sum += rms_of(*errors) * rms_of(*errors) * corners;
    count += corners;
  }
  return std::sqrt(sum / count);
}

}  // namespace penumbra::test
