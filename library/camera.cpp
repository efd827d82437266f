#include <penumbra/camera.hpp>

#include "core/camera/camera_file.hpp"
#include "library/support.hpp"

namespace penumbra::types {
namespace {

penumbra::CameraParameters parameters_of(const CameraParameters& given) {
  penumbra::CameraParameters p;
  p.width = given.width;
  p.height = given.height;
  p.fx = given.fx;
  p.fy = given.fy;
  p.cx = given.cx;
  p.cy = given.cy;
  p.model = to_internal(given.model);
  p.distortion = given.distortion;
  p.tone_curve = given.tone_curve;
  p.rolling_shutter_row_s = given.rolling_shutter_row_s;
  p.overlay_sigma_px = given.overlay_sigma_px;
  return p;
}

}  // namespace

penumbra::CameraFileFormat format_of(CameraFileFormat format) {
  switch (format) {
    case CameraFileFormat::ros:
      return penumbra::CameraFileFormat::ros;
    case CameraFileFormat::opencv:
      return penumbra::CameraFileFormat::opencv;
    case CameraFileFormat::kalibr:
      return penumbra::CameraFileFormat::kalibr;
  }
  throw_failure("format: {} is no format of camera files", static_cast<int>(format));
}

penumbra::DistortionModel to_internal(DistortionModel model) {
  switch (model) {
    case DistortionModel::plumb_bob:
      return penumbra::DistortionModel::plumb_bob;
    case DistortionModel::rational:
      return penumbra::DistortionModel::rational;
    case DistortionModel::fisheye:
      return penumbra::DistortionModel::fisheye;
  }
  throw_failure("model: {} is no distortion model", static_cast<int>(model));
}

DistortionModel to_public(penumbra::DistortionModel model) {
  switch (model) {
    case penumbra::DistortionModel::plumb_bob:
      return DistortionModel::plumb_bob;
    case penumbra::DistortionModel::rational:
      return DistortionModel::rational;
    case penumbra::DistortionModel::fisheye:
      return DistortionModel::fisheye;
  }
  return DistortionModel::plumb_bob;
}

const penumbra::CameraModel& Access::model_of(const CameraModel& camera) {
  return camera.impl_->camera;
}
CameraModel Access::make(const penumbra::CameraModel& camera) {
  return CameraModel(std::make_shared<const CameraModel::Impl>(CameraModel::Impl{camera, {}}));
}

CameraModel::CameraModel(std::shared_ptr<const Impl> impl) : impl_(std::move(impl)) {}
CameraModel::CameraModel(const CameraModel&) = default;
CameraModel& CameraModel::operator=(const CameraModel&) = default;
CameraModel::~CameraModel() = default;

CameraModel::CameraModel(const CameraParameters& parameters)
    : impl_(std::make_shared<const Impl>(
          Impl{value_or_throw(
                   with_place("camera", penumbra::CameraModel::make(parameters_of(parameters)))),
               {}})) {}

CameraModel CameraModel::load(const std::filesystem::path& file, const std::string& name) {
  return guarded([&] {
    LoadedCamera loaded = value_or_throw(load_camera_file(file, name));
    return CameraModel(
        std::make_shared<const Impl>(Impl{std::move(loaded.camera), std::move(loaded.warnings)}));
  });
}

void CameraModel::save(const std::filesystem::path& file, CameraFileFormat format) const {
  guarded([&] { throw_if_failed(save_camera(file, impl_->camera, format_of(format))); });
}

CameraParameters CameraModel::parameters() const {
  const penumbra::CameraParameters& p = impl_->camera.parameters();
  return {.width = p.width,
          .height = p.height,
          .fx = p.fx,
          .fy = p.fy,
          .cx = p.cx,
          .cy = p.cy,
          .model = to_public(p.model),
          .distortion = p.distortion,
          .tone_curve = p.tone_curve,
          .rolling_shutter_row_s = p.rolling_shutter_row_s,
          .overlay_sigma_px = p.overlay_sigma_px};
}

const std::vector<std::string>& CameraModel::warnings() const {
  return impl_->warnings;
}

std::optional<Vector2> CameraModel::project(const Vector3& p_camera) const {
  const auto pixel = impl_->camera.project(to_eigen(p_camera));
  if (!pixel) return std::nullopt;
  return penumbra::to_public(*pixel);
}

std::optional<Vector3> CameraModel::unproject(const Vector2& pixel) const {
  const auto ray = impl_->camera.unproject(to_eigen(pixel));
  if (!ray) return std::nullopt;
  return penumbra::to_public(*ray);
}

}  // namespace penumbra::types
