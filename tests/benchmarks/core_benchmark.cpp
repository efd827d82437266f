// Compares the camera model's projection and inverse with OpenCV's: time and error. The error of a
// projection is its distance to OpenCV's; that of an inverse is the reprojection error of its ray.
#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <algorithm>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <random>
#include <string>
#include <vector>

#include "support/cameras.hpp"

namespace penumbra {
namespace {

std::vector<Eigen::Vector2d> pixels() {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> u(0.0, 639.0);
  std::uniform_real_distribution<double> v(0.0, 479.0);
  std::vector<Eigen::Vector2d> all(1024);
  for (Eigen::Vector2d& pixel : all) pixel = {u(random), v(random)};
  return all;
}

std::vector<Eigen::Vector3d> rays(const CameraModel& camera) {
  std::vector<Eigen::Vector3d> all;
  for (const Eigen::Vector2d& pixel : pixels()) all.push_back(camera.unproject(pixel).value());
  return all;
}

// The camera and the rays as OpenCV's types.
class OpenCvCamera {
 public:
  explicit OpenCvCamera(const CameraModel& camera)
      : fisheye_(camera.parameters().model == DistortionModel::fisheye) {
    const CameraParameters& p = camera.parameters();
    matrix_ = (cv::Mat_<double>(3, 3) << p.fx, 0, p.cx, 0, p.fy, p.cy, 0, 0, 1);
    const int count = coefficient_count(p.model);
    distortion_ = cv::Mat(1, count, CV_64F);
    for (int i = 0; i < count; ++i) {
      distortion_.at<double>(0, i) = p.distortion[static_cast<std::size_t>(i)];
    }
    for (const Eigen::Vector3d& ray : rays(camera)) rays_.emplace_back(ray.x(), ray.y(), ray.z());
    for (const Eigen::Vector2d& pixel : penumbra::pixels())
      pixels_.emplace_back(pixel.x(), pixel.y());
  }
  std::vector<cv::Point2d> project() const {
    const cv::Vec3d none(0, 0, 0);
    std::vector<cv::Point2d> pixels;
    if (fisheye_) {
      cv::fisheye::projectPoints(rays_, pixels, none, none, matrix_, distortion_);
    } else {
      cv::projectPoints(rays_, none, none, matrix_, distortion_, pixels);
    }
    return pixels;
  }
  std::vector<Eigen::Vector3d> unproject() const {
    std::vector<cv::Point2d> points;
    const cv::TermCriteria until(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 100, 1e-15);
    if (fisheye_) {
      cv::fisheye::undistortPoints(pixels_, points, matrix_, distortion_);
    } else {
      cv::undistortPoints(pixels_, points, matrix_, distortion_, cv::noArray(), cv::noArray(),
                          until);
    }
    std::vector<Eigen::Vector3d> all;
    for (const cv::Point2d& point : points) all.emplace_back(point.x, point.y, 1.0);
    return all;
  }

 private:
  bool fisheye_ = false;
  cv::Mat matrix_, distortion_;
  std::vector<cv::Point3d> rays_;
  std::vector<cv::Point2d> pixels_;
};

void count_items(benchmark::State& state, double error_px) {
  state.SetItemsProcessed(state.iterations() * static_cast<std::int64_t>(pixels().size()));
  state.counters["error_px"] = error_px;
}

double projection_error_px(const CameraModel& camera) {
  const std::vector<cv::Point2d> others = OpenCvCamera(camera).project();
  const std::vector<Eigen::Vector3d> all = rays(camera);
  double worst = 0.0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    worst = std::max(
        worst,
        (camera.project_unchecked(all[i]) - Eigen::Vector2d(others[i].x, others[i].y)).norm());
  }
  return worst;
}

double inverse_error_px(const CameraModel& camera,
                        const std::vector<Eigen::Vector3d>& unprojected) {
  const std::vector<Eigen::Vector2d> all = pixels();
  double worst = 0.0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    worst = std::max(worst, (camera.project_unchecked(unprojected[i]) - all[i]).norm());
  }
  return worst;
}

void project(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = test::lens_of(model);
  const std::vector<Eigen::Vector3d> all = rays(camera);
  for (auto _ : state) {
    for (const Eigen::Vector3d& ray : all) benchmark::DoNotOptimize(camera.project_unchecked(ray));
  }
  count_items(state, projection_error_px(camera));
}
void project_opencv(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = test::lens_of(model);
  const OpenCvCamera other(camera);
  for (auto _ : state) benchmark::DoNotOptimize(other.project());
  count_items(state, projection_error_px(camera));
}

void unproject(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = test::lens_of(model);
  const std::vector<Eigen::Vector2d> all = pixels();
  for (auto _ : state) {
    for (const Eigen::Vector2d& pixel : all) benchmark::DoNotOptimize(camera.unproject(pixel));
  }
  count_items(state, inverse_error_px(camera, rays(camera)));
}
void unproject_opencv(benchmark::State& state, DistortionModel model) {
  const CameraModel camera = test::lens_of(model);
  const OpenCvCamera other(camera);
  for (auto _ : state) benchmark::DoNotOptimize(other.unproject());
  count_items(state, inverse_error_px(camera, other.unproject()));
}

[[maybe_unused]] const bool kRegistered = [] {
  for (const DistortionModel model : kDistortionModels) {
    const std::string lens(to_string(model));
    const auto add = [&](const std::string& name, auto function) {
      benchmark::RegisterBenchmark((name).c_str(), function, model);
    };
    add("project " + lens + "/OpenCV", project_opencv);
    add("project " + lens + "/penumbra", project);
    add("unproject " + lens + "/OpenCV", unproject_opencv);
    add("unproject " + lens + "/penumbra", unproject);
  }
  return true;
}();

}  // namespace
}  // namespace penumbra
