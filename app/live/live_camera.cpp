#include "app/live/live_camera.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "app/capture/libcamera_source.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"
#include "app/capture/v4l2/v4l2_source.hpp"
#include "app/recording/recording_feed.hpp"
#include "app/run_inputs.hpp"
#include "core/camera/camera_file.hpp"
#include "core/propagate.hpp"
#include "core/units.hpp"
#include "tracking/pose_confidence.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kRecordingPrefix = "recording:";
constexpr std::array<std::pair<std::string_view, CameraAddress::Kind>, 3> kCameraKinds = {
    {{"v4l2:", CameraAddress::Kind::v4l2},
     {"libcamera:", CameraAddress::Kind::libcamera},
     {kRecordingPrefix, CameraAddress::Kind::recording}}};

bool has_size_of(const StreamFormat& format, const CameraModel& camera) {
  return format.width == camera.width() && format.height == camera.height();
}

std::string size_mismatch(const CameraRequest& request, const StreamFormat& format,
                          const CameraModel& camera) {
  // The calibrated size is the default, so it is suggested only if another size was requested.
  const bool other_requested = (request.width && *request.width != camera.width()) ||
                               (request.height && *request.height != camera.height());
  return fmt::format(
      "{}: is a calibration of {}x{} px, but the camera gives {}x{} px; {}calibrate at this size "
      "(penumbra calibrate)",
      request.calibration.string(), camera.width(), camera.height(), format.width, format.height,
      other_requested ? fmt::format("ask for the calibrated one (--size {}x{}), or ",
                                    camera.width(), camera.height())
                      : std::string());
}

}  // namespace

Result<CameraAddress> parse_camera(const std::string& source) {
  using Kind = CameraAddress::Kind;
  std::error_code ignored;
  if (std::filesystem::is_directory(source, ignored)) {
    return fail("{0}: is a folder; to play a recording, give recording:{0}", source);
  }
  if (source.starts_with('/')) return CameraAddress{Kind::v4l2, source};
  for (const auto& [prefix, kind] : kCameraKinds) {
    if (source.starts_with(prefix) && source.size() > prefix.size()) {
      return CameraAddress{kind, source.substr(prefix.size())};
    }
  }
  return fail(
      "{}: is not a camera; give v4l2:/dev/video0 or libcamera:0 (penumbra devices lists "
      "them), or recording:FOLDER",
      source);
}

bool names_camera(const std::string& source) {
  return std::ranges::any_of(kCameraKinds,
                             [&](const auto& kind) { return source.starts_with(kind.first); });
}

std::optional<std::filesystem::path> played_recording(const std::string& source) {
  if (!source.starts_with(kRecordingPrefix)) return std::nullopt;
  return source.substr(kRecordingPrefix.size());
}

Result<void> check_camera(const CameraAddress& address) {
  if (address.kind != CameraAddress::Kind::v4l2) return {};
  PENUMBRA_TRY_VOID(V4l2Device::open(address.name));
  return {};
}

Result<Recording> open_as_camera(const CameraAddress& address) {
  OpenRecordingOptions options;
  options.require_camera = options.require_tags = false;
  return open_recording(address.name, options);
}

Result<std::unique_ptr<LiveSource>> open_camera(const CameraAddress& address,
                                                const CameraRequest& request,
                                                const CameraModel* camera) {
  if (address.kind == CameraAddress::Kind::recording) {
    PENUMBRA_TRY(const auto recording, open_as_camera(address));
    return open_recording_feed(recording, request.fps);
  }
  RequestedSettings requested;
  requested.width = request.width.value_or(camera ? camera->width() : requested.width);
  requested.height = request.height.value_or(camera ? camera->height() : requested.height);
  requested.fps = request.fps.value_or(requested.fps);
  requested.format = request.format;
  requested.recording = request.recorded;
  requested.controls = request.controls;
  if (address.kind == CameraAddress::Kind::libcamera) {
    return open_libcamera_source({requested, address.name, request.dma_buf});
  }
  return open_v4l2_source({requested, address.name, request.dma_buf});
}

Result<void> check_size_or_offer_scaling(const CameraRequest& request, const CameraAddress& address,
                                         const StreamFormat& format, const CameraModel& camera) {
  if (has_size_of(format, camera)) return {};
  const std::string mismatch = size_mismatch(request, format, camera);
  if (request.scale_calibration || !scaled_to(camera, format.width, format.height)) {
    return fail("{}", mismatch);
  }
  const int larger = std::max(format.width, camera.width());
  const int times = larger / std::min(format.width, camera.width());
  const std::string size = address.kind == CameraAddress::Kind::recording
                               ? std::string()
                               : fmt::format("--size {}x{} ", format.width, format.height);
  return fail(
      "{}; or, if both sizes show the same view, {}x{} pixels of one taken together in the other, "
      "scale the calibration, which is exact then ({}--scale-calibration)",
      mismatch, times, times, size);
}

Result<CameraModel> calibration_at_size(const CameraRequest& request, const CameraAddress& address,
                                        const CameraModel& camera) {
  if (!request.scale_calibration) return camera;
  int width = request.width.value_or(camera.width());
  int height = request.height.value_or(camera.height());
  if (address.kind == CameraAddress::Kind::recording) {
    PENUMBRA_TRY(const auto feed, open_camera(address, request, &camera));
    width = feed->format().width;
    height = feed->format().height;
  }
  auto scaled = scaled_to(camera, width, height);
  if (!scaled) return fail_in(request.calibration.string(), scaled.error());
  return scaled;
}

Result<CameraModel> guessed_camera(double fov_deg, int width, int height) {
  // 1 sigma, as a fraction of the width: docs/live.md#without-a-calibration.
  constexpr double kLensError = 0.01;
  CameraParameters lens;
  lens.width = width;
  lens.height = height;
  lens.fx = lens.fy = 0.5 * width / std::tan(0.5 * radians(fov_deg));
  lens.cx = 0.5 * (width - 1);
  lens.cy = 0.5 * (height - 1);
  lens.name = "not calibrated";
  lens.overlay_sigma_px = std::max(kLensError * width, 2.0 * kTrackedOverlay_px);
  return CameraModel::make(lens);
}

Result<std::unique_ptr<LiveSource>> open_live_source(const CameraRequest& request,
                                                     const CameraModel* camera) {
  PENUMBRA_TRY(const auto address, parse_camera(request.source));
  PENUMBRA_TRY_VOID(check_camera(address));
  PENUMBRA_TRY(auto source, open_camera(address, request, camera));
  if (camera != nullptr && !has_size_of(source->format(), *camera)) {
    return fail("{}", size_mismatch(request, source->format(), *camera));
  }
  return source;
}

std::optional<std::string> focus_warning(const std::filesystem::path& calibration,
                                         const std::optional<FocusReading>& focus) {
  const auto calibrated = load_focus_position(calibration);
  if (!focus || !calibrated || std::abs(*calibrated - focus->position) <= 0.5 * focus->step) {
    return std::nullopt;
  }
  return fmt::format(
      "{}: was calibrated at focus_position {}, but the camera is focused at {:.4g}; ask for that "
      "focus (--focus {}), or calibrate again",
      calibration.string(), *calibrated, focus->position, *calibrated);
}

Result<std::filesystem::path> tags_for_camera(const std::optional<std::filesystem::path>& named,
                                              const CameraRequest& camera) {
  if (named) return *named;
  std::error_code ignored;
  std::string missing;
  if (const auto played = played_recording(camera.source)) {
    const auto recorded = *played / "tags.yaml";
    if (std::filesystem::exists(recorded, ignored)) return recorded;
    missing = recorded.string() + ", ";
  }
  if (camera.calibration.empty()) {
    return fail("--tags: no tag map is named{}{}; {}", missing.empty() ? "" : ", and there is no ",
                missing.substr(0, missing.rfind(',')), kTagMapRemedy);
  }
  const auto beside = camera.calibration.parent_path() / "tags.yaml";
  if (std::filesystem::exists(beside, ignored)) return beside;
  // A missing calibration is reported first, because the map is expected beside it.
  PENUMBRA_TRY_VOID(load_camera_file(camera.calibration, camera.camera_name));
  return fail("--tags: no tag map is named, and there is no {}{}; {}", missing, beside.string(),
              kTagMapRemedy);
}

}  // namespace penumbra
