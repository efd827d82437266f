#include "core/camera/sensor_file.hpp"

#include <algorithm>
#include <cmath>

#include "core/propagate.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

Result<CameraModel> read_sensor(const YamlFields& fields) {
  CameraParameters parameters;
  PENUMBRA_TRY(const auto camera_model, fields.text("camera_model", "give pinhole"));
  if (camera_model != "pinhole") {
    return fail("{}: is '{}'; only pinhole is known", fields.place_of("camera_model"),
                camera_model);
  }
  PENUMBRA_TRY(const auto model,
               fields.text("distortion_model", "give radial-tangential or equidistant"));
  if (model == "radial-tangential" || model == "radtan") {
    parameters.model = DistortionModel::plumb_bob;
  } else if (model == "equidistant") {
    parameters.model = DistortionModel::fisheye;
  } else {
    return fail("{}: is '{}'; give radial-tangential or equidistant",
                fields.place_of("distortion_model"), model);
  }
  PENUMBRA_TRY(const auto resolution,
               fields.numbers("resolution", 2, "give [width, height] in pixels"));
  PENUMBRA_TRY(const auto intrinsics,
               fields.numbers("intrinsics", 4, "give [fu, fv, cu, cv] in pixels"));
  PENUMBRA_TRY(const auto distortion,
               fields.numbers("distortion_coefficients", 4, "give the model's 4 coefficients"));
  for (const double side : resolution) {
    if (side != std::floor(side) || side < 1.0 || side > 32768.0) {
      return fail("{}: {} is not a number of pixels from 1 to 32768", fields.place_of("resolution"),
                  side);
    }
  }
  parameters.width = static_cast<int>(resolution[0]);
  parameters.height = static_cast<int>(resolution[1]);
  parameters.fx = intrinsics[0];
  parameters.fy = intrinsics[1];
  parameters.cx = intrinsics[2];
  parameters.cy = intrinsics[3];
  std::ranges::copy(distortion, parameters.distortion.begin());
  return with_place(fields.place(), CameraModel::make(parameters));
}

Result<Transform<frame::Body, frame::Sensor>> read_mounting(const YamlFields& fields) {
  constexpr const char* kRemedy = "give data: the 16 numbers of a 4x4 matrix, row by row";
  PENUMBRA_TRY(const auto matrix, fields.fields("T_BS", kRemedy));
  PENUMBRA_TRY(const auto numbers, matrix.numbers("data", 16, kRemedy));
  const Eigen::Matrix4d T =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(numbers.data());
  const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
  constexpr double kRounding = 1e-3;
  const bool rigid = (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() <= kRounding &&
                     R.determinant() > 0.0 &&
                     (T.row(3) - Eigen::RowVector4d(0.0, 0.0, 0.0, 1.0)).norm() <= kRounding;
  if (!rigid) return fail("{}: is not a rigid transform; {}", matrix.place_of("data"), kRemedy);
  return Transform<frame::Body, frame::Sensor>(R, T.topRightCorner<3, 1>());
}

template <class T>
Result<T> load_with(const std::filesystem::path& file, Result<T> (*read)(const YamlFields&)) {
  PENUMBRA_TRY(const auto root, load_yaml_map(file));
  try {
    return read(YamlFields(root, file.string()));
  } catch (const YAML::Exception& error) {
    return fail("{}: is not valid YAML ({}); correct the file", file.string(), error.msg);
  }
}

}  // namespace

Result<CameraModel> load_euroc_sensor(const std::filesystem::path& file) {
  return load_with(file, read_sensor);
}

Result<Transform<frame::Body, frame::Sensor>> load_euroc_mounting(
    const std::filesystem::path& file) {
  return load_with(file, read_mounting);
}

}  // namespace penumbra
