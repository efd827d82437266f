// Reads the camera parameters of EuRoC/ASL data sets.
#pragma once

#include <filesystem>

#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"

namespace penumbra {

// Reads mav0/cam0/sensor.yaml: resolution [width, height], camera_model pinhole, intrinsics [fu,
// fv, cu, cv], distortion_model radial-tangential (plumb_bob with k3 = 0) or equidistant (fisheye),
// distortion_coefficients of 4 numbers. Other keys are ignored. Errors name file and field.
[[nodiscard]] Result<CameraModel> load_euroc_sensor(const std::filesystem::path& file);

namespace frame {
struct Body;    // EuRoC's body frame, in practice the IMU
struct Sensor;  // the sensor that sensor.yaml describes
}  // namespace frame

// Reads T_BS of a EuRoC sensor.yaml. Fails if it is missing or not a rigid transform.
[[nodiscard]] Result<Transform<frame::Body, frame::Sensor>> load_euroc_mounting(
    const std::filesystem::path& file);

}  // namespace penumbra
